"""Station lists, and trajectories of moving sensors from GPX, OEM and two-line elements."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from made_pass import EPOCH, STATION_CSV, STATIONS, ecef, satellite, seen, tdm, utc

from geograph.errors import InputError
from geograph.io import ImportOptions, read_stations, read_tdm
from geograph.io.gpx import read_gpx
from geograph.io.instants import from_datetime
from geograph.io.oem import read_oem
from geograph.io.tle import read_tle
from geograph.io.trajectories import read_trajectory

if TYPE_CHECKING:
    from pathlib import Path

START = from_datetime(EPOCH)

TOML = """\
[sensors.Alpha]
geodetic = [52.1, 4.4, 20.0]
refraction = "standard"
[sensors.Alpha.errors]
azimuth_bias_deg = 0.02
[sensors.Bravo]
position_m = [4063000.0, 709000.0, 4849000.0]
[sensors.Van]
trajectory = "van.gpx"
[sensors.Van.errors]
position_m = 5.0
"""


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def gpx(count: int = 5, *, zone: str = "Z") -> str:
    points = "".join(
        f'<trkpt lat="{52.0 + 0.001 * n:.6f}" lon="10.5"><ele>{30 + n}</ele>'
        f"<time>{utc(20.0 * n - 0.5)}{zone}</time></trkpt>\n"
        for n in range(count)
    )
    return (
        '<?xml version="1.0"?>\n<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1">\n'
        f"<trk><name>van</name><trkseg>\n{points}</trkseg></trk></gpx>\n"
    )


def test_toml_is_the_header_of_a_recording(tmp_path: Path) -> None:
    write(tmp_path / "van.gpx", gpx())
    stations = read_stations(write(tmp_path / "list.toml", TOML))
    assert list(stations) == ["Alpha", "Bravo", "Van"]
    alpha = stations["Alpha"].sensor
    np.testing.assert_allclose(alpha.position_m, ecef(52.1, 4.4, 20.0), atol=1e-3)
    assert (alpha.refraction, alpha.errors.azimuth_bias_rad) == ("standard", np.radians(0.02))
    rows = [(time, "Van", 10.0 + time, 20.0) for time in (1.0, 30.0, 59.0)]
    text = tdm(rows)
    options = ImportOptions(stations=stations, sigma_deg=1.0)
    van = read_tdm(write(tmp_path / "a.tdm", text), options).sensors["Van"]
    assert van.errors.position_m == 5.0
    np.testing.assert_allclose(van.position_at(19.5), ecef(52.001, 10.5, 31.0), atol=1e-3)
    late = tdm([*rows, (90.0, "Van", 1.0, 2.0)])
    with pytest.raises(InputError, match=r"van.gpx: covers -0.5 to 79.5 s and the measurements"):
        read_tdm(write(tmp_path / "b.tdm", late), options)


def test_csv(tmp_path: Path) -> None:
    text = (
        "sensor,x_m,y_m,z_m,latitude_deg,longitude_deg,height_m,trajectory,azimuth_bias_deg,"
        "clock_offset_s\nA,4063000,709000,4849000,,,,,0.5,\nB,,,,-33.5,-70.25,600,,,0.1\n"
        "C,,,,,,,c.gpx,,\n"
    )
    stations = read_stations(write(tmp_path / "s.csv", text))
    assert stations["A"].sensor.errors.azimuth_bias_rad == np.radians(0.5)
    assert stations["B"].sensor.errors.clock_offset_s == 0.1
    np.testing.assert_allclose(
        stations["B"].sensor.position_m, ecef(-33.5, -70.25, 600.0), atol=1e-3
    )
    assert stations["C"].file == tmp_path / "c.gpx"


@pytest.mark.parametrize(
    ("name", "old", "new", "expected"),
    [
        ("s.csv", "Bravo", "Alpha", r"s.csv:3, column sensor: 'Alpha' is there twice"),
        ("s.csv", "52.1", "152.1", r"s.csv:2, column latitude_deg: .*152.1; expected"),
        ("s.csv", "52.1", "", r"s.csv:2, column latitude_deg: empty cell; expected all of"),
        ("s.csv", "52.1,4.4,20.0", ",,", r"s.csv:2: expected exactly one of latitude_deg"),
        ("s.csv", "height_m", "hight_m", r"column hight_m: unknown column.*height_m"),
        ("s.toml", "geodetic", "geodatic", r"s.toml:2, column sensors.Alpha.geodatic: unknown key"),
        ("s.toml", "[sensors.Alpha]", "[sensor.Alpha]", r"unknown key 'sensor'; did you mean sens"),
        ("s.toml", "van.gpx", "van.doc", r"is 'van.doc'; expected a file that ends in .csv"),
        ("s.toml", '"standard"', '"some"', r"unknown refraction 'some'"),
        ("s.txt", "", "", r"is not a station list; expected a .toml or .csv file"),
    ],
)
def test_bad_lists(tmp_path: Path, name: str, old: str, new: str, expected: str) -> None:
    text = TOML if name == "s.toml" else STATION_CSV
    assert old in text
    with pytest.raises(InputError, match=expected) as caught:
        read_stations(write(tmp_path / name, text.replace(old, new, 1)))
    assert "\n" not in str(caught.value)


def test_gpx(tmp_path: Path) -> None:
    trajectory = read_gpx(write(tmp_path / "a.gpx", gpx()), START)
    np.testing.assert_allclose(trajectory.time_s, [-0.5, 19.5, 39.5, 59.5, 79.5], atol=1e-6)
    np.testing.assert_allclose(trajectory.position_m[2], ecef(52.002, 10.5, 32.0), atol=1e-3)
    later = read_gpx(write(tmp_path / "a.gpx", gpx(zone="-01:30")), START, geoid_height_m=46.0)
    np.testing.assert_allclose(later.time_s - trajectory.time_s, 5400.0, atol=1e-6)
    np.testing.assert_allclose(later.position_m[2], ecef(52.002, 10.5, 78.0), atol=1e-3)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("<ele>31</ele>", "", r"a.gpx:5: track point has no <ele>"),
        ("52.001000", "north", r"a.gpx:5: lat is 'north'; expected a number from -90 to 90"),
        ("19:04:19", "19:03:19", r"a.gpx:5: is not later than the point before"),
        ("19:04:19", "19:74:19", r"a.gpx:5: time is .*; time of day 19:74:19"),
        ("<gpx", "<kml", "mismatched tag"),
        ("trkpt", "wpt", "mismatched tag|has 4 points"),
    ],
)
def test_bad_gpx(tmp_path: Path, old: str, new: str, expected: str) -> None:
    text = gpx()
    assert old in text
    with pytest.raises(InputError, match=expected):
        read_gpx(write(tmp_path / "a.gpx", text.replace(old, new, 1)), START)


def oem(frame: str, states: list[tuple[float, np.ndarray, np.ndarray]]) -> str:
    lines = [
        f"CCSDS_OEM_VERS = 2.0\nCREATION_DATE = {utc(0.0)}\nORIGINATOR = MADE\n\nMETA_START\n"
        "OBJECT_NAME = SAT\nOBJECT_ID = 2024-001A\nCENTER_NAME = EARTH\n"
        f"REF_FRAME = {frame}\nTIME_SYSTEM = UTC\nSTART_TIME = {utc(states[0][0])}\n"
        f"STOP_TIME = {utc(states[-1][0])}\nMETA_STOP\nCOMMENT made\n"
    ]
    for time, position, velocity in states:
        numbers = " ".join(f"{value:.9f}" for value in [*position / 1e3, *velocity / 1e3])
        lines.append(f"{utc(time)} {numbers}\n")
    return "".join(lines)


def earth_fixed_states(step: float = 60.0) -> list[tuple[float, np.ndarray, np.ndarray]]:
    return [
        (time, satellite(time), (satellite(time + 0.5) - satellite(time - 0.5)))
        for time in np.arange(-600.0, 900.0, step)
    ]


def test_oem_of_wide_steps_is_made_dense(tmp_path: Path) -> None:
    path = write(tmp_path / "a.oem", oem("ITRF2000", earth_fixed_states()))
    trajectory = read_oem(path, START, (0.0, 120.0))
    time = np.linspace(0.0, 120.0, 77)
    error = trajectory.position_at(time) - np.array([satellite(t) for t in time])
    # Seven decimals of a kilometre, a spline through points 10 s apart (w^4 h^4 r / 384 = 0.2 mm)
    # and one of degree 7 through points a minute apart.
    assert np.abs(error[20:-20]).max() < 5e-4
    # Near the ends of the points the spline is worse, which is why readers add a minute to a span.
    assert np.abs(error).max() < 3e-3


def test_oem_in_xml_and_covariance_passed_over(tmp_path: Path) -> None:
    states = earth_fixed_states(20.0)
    kvn = oem("ITRF2000", states) + "COVARIANCE_START\nEPOCH = 2024-03-20T19:04:00\n1.0\n"
    plain = read_oem(write(tmp_path / "a.oem", kvn + "COVARIANCE_STOP\n"), START, (0.0, 120.0))
    vectors = "".join(
        f"<stateVector><EPOCH>{utc(time)}</EPOCH>"
        + "".join(f"<{n}>{v / 1e3:.9f}</{n}>" for n, v in zip("XYZ", position, strict=True))
        + "</stateVector>\n"
        for time, position, _ in states
    )
    text = (
        '<oem id="CCSDS_OEM_VERS" version="2.0"><body><segment><metadata>'
        "<CENTER_NAME>EARTH</CENTER_NAME><REF_FRAME>ITRF2000</REF_FRAME>"
        f"<TIME_SYSTEM>UTC</TIME_SYSTEM></metadata><data>{vectors}</data></segment></body></oem>"
    )
    other = read_trajectory(write(tmp_path / "a.xml", text), START, (0.0, 120.0))
    np.testing.assert_array_equal(plain.position_m, other.position_m)


@pytest.mark.parametrize("frame", ["GCRF", "EME2000", "TEME"])
def test_inertial_frames_against_astropy(tmp_path: Path, frame: str) -> None:
    coordinates = pytest.importorskip("astropy.coordinates")
    from astropy import units as u
    from astropy.time import Time, TimeDelta
    from astropy.utils import iers

    times = np.arange(-50.0, 200.0, 10.0)
    inertial = np.array([[7e6 * np.cos(1e-3 * t), 7e6 * np.sin(1e-3 * t), 1e5 * t] for t in times])
    moment = Time(utc(0.0), scale="utc") + TimeDelta(times, format="sec")
    given = coordinates.CartesianRepresentation(*(inertial.T * u.m))
    with iers.conf.set_temp("auto_download", False):
        if frame == "TEME":
            start = coordinates.TEME(given, obstime=moment)
        elif frame == "GCRF":
            start = coordinates.GCRS(given, obstime=moment)
        else:
            start = coordinates.PrecessedGeocentric(given, equinox=Time("J2000"), obstime=moment)
        expected = start.transform_to(coordinates.ITRS(obstime=moment)).cartesian.xyz
    states = [(t, p, np.zeros(3)) for t, p in zip(times, inertial, strict=True)]
    found = read_oem(write(tmp_path / "a.oem", oem(frame, states)), START, (0.0, 120.0))
    expected_m = expected.to_value("m").T[np.isin(times, found.time_s)]
    # astropy's own table (IERS B) and ours (IERS A) differ by 0.1 mas, its frame bias by 1 mas.
    np.testing.assert_allclose(found.position_m, expected_m, atol=0.1)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("ITRF2000", "TOD", r"a.oem:9, column REF_FRAME: is 'TOD'; expected an ITRF, WGS84, GCRF"),
        ("EARTH", "MARS", r"column CENTER_NAME: is 'MARS'; expected EARTH"),
        ("TIME_SYSTEM = UTC\n", "", r"a.oem:5: metadata have no TIME_SYSTEM"),
        ("2024-03-20T18:55:00.000000 ", "2024-03-20T18:54:00.000000 ", r"a.oem:16: is not later"),
        ("2024-03-20T18:55:00.000000 ", "2024-03-20T18:55:00.000000 1 ", r"a.oem:16: has 8 words"),
        ("2024-03-20T18:55:00.000000 ", "2024-03-20T18:55:00.000000 x", r"a.oem:16: is 'x.*'; exp"),
        ("CCSDS_OEM_VERS", "CCSDS_TDM_VERS", "does not begin with CCSDS_OEM_VERS"),
    ],
)
def test_bad_oem(tmp_path: Path, old: str, new: str, expected: str) -> None:
    text = oem("ITRF2000", earth_fixed_states())
    assert old in text
    changed = text.replace(old, new, 1)
    with pytest.raises(InputError, match=expected):
        read_oem(write(tmp_path / "a.oem", changed), START, (0.0, 120.0))


def test_an_ephemeris_cut_short(tmp_path: Path) -> None:
    text = oem("ITRF2000", earth_fixed_states())
    for cut, expected in (
        (text.partition("META_STOP")[0], r"a.oem:5: ends within metadata; expected META_STOP"),
        (f"{text}COVARIANCE_START\n", r"ends within covariances; expected COVARIANCE_STOP"),
    ):
        with pytest.raises(InputError, match=expected):
            read_oem(write(tmp_path / "a.oem", cut), START, (0.0, 120.0))


def tle() -> str:
    """Return elements of a made orbit, with their checksums."""
    lines = [
        "1 99999U 24001A   24080.79444444  .00000000  00000-0  00000-0 0  999",
        "2 99999  51.6000 120.0000 0005000  30.0000 200.0000 15.50000000    1",
    ]
    out = ["MADE"]
    for line in lines:
        total = sum(int(c) if c.isdecimal() else c == "-" for c in line)
        out.append(f"{line}{total % 10}")
    return "\n".join(out) + "\n"


def test_tle_against_astropy(tmp_path: Path) -> None:
    sgp4 = pytest.importorskip("sgp4.api")
    coordinates = pytest.importorskip("astropy.coordinates")
    from astropy import units as u
    from astropy.time import Time, TimeDelta
    from astropy.utils import iers

    trajectory = read_tle(write(tmp_path / "a.tle", tle()), START, (0.0, 120.0))
    assert np.diff(trajectory.time_s).max() <= 10.0
    moment = Time(utc(0.0), scale="utc") + TimeDelta(trajectory.time_s, format="sec")
    satellite_of = sgp4.Satrec.twoline2rv(*tle().splitlines()[1:])
    _, position, _ = satellite_of.sgp4_array(moment.utc.jd1, moment.utc.jd2)
    given = coordinates.CartesianRepresentation(*(position.T * u.km))
    with iers.conf.set_temp("auto_download", False):
        turned = coordinates.TEME(given, obstime=moment).transform_to(
            coordinates.ITRS(obstime=moment)
        )
    np.testing.assert_allclose(
        trajectory.position_m, turned.cartesian.xyz.to_value("m").T, atol=0.1
    )


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("24080", "24081", r"a.tle:2: has the checksum '\d', and its digits add up to"),
        ("24080", "2408", r"a.tle:2: has 68 characters; expected the 69"),
        ("MADE\n", "MADE\nTWO\n", r"has 4 lines, 2 of elements; expected line 1 and line 2"),
        ("2 99999 ", "3 99999 ", r"has 3 lines, 1 of elements"),
    ],
)
def test_bad_tle(tmp_path: Path, old: str, new: str, expected: str) -> None:
    pytest.importorskip("sgp4")
    assert old in tle()
    with pytest.raises(InputError, match=expected):
        read_tle(write(tmp_path / "a.tle", tle().replace(old, new)), START, (0.0, 120.0))
    with pytest.raises(InputError, match="is wanted for 40 days"):
        read_tle(write(tmp_path / "b.tle", tle()), START, (0.0, 40 * 86400.0))


def test_a_satellite_that_watches_another(tmp_path: Path) -> None:
    """An ephemeris as a sensor of a recording, through the station list."""
    write(tmp_path / "watcher.oem", oem("ITRF2000", earth_fixed_states()))
    stations = read_stations(write(tmp_path / "s.csv", "sensor,trajectory\nAlpha,watcher.oem\n"))
    rows = [(time, "Alpha", *seen("Alpha", time)[:2]) for time in (10.0, 50.0, 90.0)]
    options = ImportOptions(stations=stations, sigma_deg=0.1)
    watcher = read_tdm(write(tmp_path / "a.tdm", tdm(rows)), options).sensors["Alpha"]
    np.testing.assert_allclose(watcher.position_at(50.0), satellite(50.0), atol=5e-3)
    assert STATIONS["Alpha"]
