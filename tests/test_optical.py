"""Reports of observers: IOD, UK and 80-column astrometry, and right ascension on the engine's sky.

Lines are made from the geometry of made_pass, whose axes that do not turn are here set onto those
of the GCRS, so that directions against stars can be worked out from positions alone.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
import pytest
from made_pass import STATIONS, ecef, seen, utc

import geograph as gg
from geograph.errors import InputError
from geograph.io import ImportOptions, read_iod, read_mpc, read_stations, read_tdm, read_uk

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from geograph.measurements import Bearings
    from geograph.recording import Recording

pytest.importorskip("astropy")
LIGHT = 299792458.0
ARCSEC = np.pi / 648000.0


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.fixture
def options(tmp_path: Path) -> ImportOptions:
    rows = zip(("4353", "0001", "500"), STATIONS.values(), strict=True)
    text = "sensor,latitude_deg,longitude_deg,height_m\n" + "".join(
        f"{name},{lat},{lon},{height}\n" for name, (lat, lon, height) in rows
    )
    return ImportOptions(stations=read_stations(write(tmp_path / "sites.csv", text)))


def bearings_of(recording: Recording) -> Bearings:
    assert recording.bearings is not None
    return recording.bearings


def stellar(time_s: NDArray[np.float64], name: str) -> tuple[NDArray, NDArray, NDArray]:
    """Return right ascension, declination (rad) against the stars, and the ECEF direction.

    Worked out in axes that rest with the Sun's system from positions of astropy's Earth: observer
    at reception, object at emission, light time between. Nothing is said of aberration: it is what
    the Earth's own motion makes.
    """
    from astropy import units as u
    from astropy.coordinates import GCRS, ITRS, CartesianRepresentation, get_body_barycentric_posvel
    from astropy.time import Time, TimeDelta
    from astropy.utils import iers

    with iers.conf.set_temp("auto_download", False):
        start = Time(utc(0.0), scale="utc")
        moment = start + TimeDelta(time_s, format="sec")
        site = ecef(*STATIONS[name])
        frame = ITRS(CartesianRepresentation(*(site * u.m)), obstime=moment)
        place = frame.transform_to(GCRS(obstime=moment)).cartesian.xyz.to_value("m").T
        _, earth = get_body_barycentric_posvel("earth", moment)
    speed = earth.xyz.to_value("m/s").T
    # An object that moves evenly in the GCRS: 1500 km above the station, 7 km/s.
    up = place[0] / np.linalg.norm(place[0])
    along = np.cross(up, [0.2, 0.1, 1.0])
    along /= np.linalg.norm(along)
    middle = time_s.mean()
    delay = np.zeros(time_s.size)
    for _ in range(6):
        emitted = place[0] + 1.5e6 * up + (time_s - delay - middle)[:, None] * 7e3 * along
        # The Earth was elsewhere when the light left; the observer counts from where it is now.
        barycentric = emitted - delay[:, None] * speed - place
        delay = np.linalg.norm(barycentric, axis=1) / LIGHT
    direction = barycentric / np.linalg.norm(barycentric, axis=1)[:, None]
    # What the smoother predicts: both in axes that move with the Earth and do not turn.
    geocentric = emitted - place
    geocentric /= np.linalg.norm(geocentric, axis=1)[:, None]
    with iers.conf.set_temp("auto_download", False):
        far = CartesianRepresentation(*(geocentric.T * 1e6 * u.m))
        turned = GCRS(far, obstime=moment).transform_to(ITRS(obstime=moment))
    level = turned.cartesian.xyz.to_value("m").T / 1e6
    ascension = np.arctan2(direction[:, 1], direction[:, 0]) % (2.0 * np.pi)
    return ascension, np.arcsin(direction[:, 2]), level


def sexagesimal(value: float, digits: int) -> str:
    total = round(abs(value) * 3600.0 * 10**digits)
    whole, rest = divmod(total, 10**digits)
    minutes, seconds = divmod(whole, 60)
    fraction = f".{rest:0{digits}d}" if digits else ""
    return f"{minutes // 60:02} {minutes % 60:02} {seconds:02}{fraction}"


def mpc_line(time_s: float, ascension: float, declination: float, station: str) -> str:
    day = 20 + (19 * 3600 + 4 * 60 + time_s) / 86400.0
    sign = "-" if declination < 0.0 else "+"
    first = f"     K24001A  C2024 03 {day:09.6f}"
    right = sexagesimal(np.degrees(ascension) / 15.0, 3)
    line = f"{first:<32}{right:<12}{sign}{sexagesimal(np.degrees(declination), 2)}"
    return f"{line:<77}{station}"


def test_directions_against_stars_are_those_that_the_smoother_predicts(
    tmp_path: Path, options: ImportOptions
) -> None:
    days = np.array([20.8, 60.48, 86.4])
    ascension, declination, level = stellar(days, "Alpha")
    message = ["CCSDS_TDM_VERS = 2.0\nCREATION_DATE = 2024-03-20T00:00:00\nORIGINATOR = MADE\n"
               "META_START\nTIME_SYSTEM = UTC\nPARTICIPANT_1 = 4353\nPARTICIPANT_2 = X\n"
               "MODE = SEQUENTIAL\nPATH = 2,1\nANGLE_TYPE = RADEC\nREFERENCE_FRAME = ICRF\n"
               "META_STOP\nDATA_START\n"]  # fmt: skip
    for time, right, up in zip(days, ascension, declination, strict=True):
        message.append(
            f"ANGLE_1 = {utc(time)} {np.degrees(right):.10f}\n"
            f"ANGLE_2 = {utc(time)} {np.degrees(up):.10f}\n"
        )
    path = write(tmp_path / "a.tdm", "".join([*message, "DATA_STOP\n"]))
    chosen = ImportOptions(stations=options.stations, sigma_deg=0.001)
    found = bearings_of(read_tdm(path, chosen))
    east, north, up = gg.geodesy.enu_axes(ecef(*STATIONS["Alpha"])) @ level.T
    expected = np.stack([np.arctan2(east, north) % (2 * np.pi), np.arcsin(up)])
    given = np.stack([found.azimuth_rad, found.elevation_rad])
    # Earth orientation (1 mas), the Sun's deflection of starlight (5 mas), second order (0.5 mas);
    # azimuths near the zenith count by the cosine. The aberration is 20".
    error = (given - expected) * np.stack([np.cos(expected[1]), np.ones(3)])
    assert np.abs(error).max() < 0.02 * ARCSEC


def test_mpc(tmp_path: Path, options: ImportOptions) -> None:
    # Whole millionths of a day, which is all that the format holds.
    days = np.arange(1, 12) * 8.64 + 0.048
    ascension, declination, level = stellar(days, "Charlie")
    text = "".join(
        mpc_line(*row, "500") + "\n" for row in zip(days, ascension, declination, strict=True)
    )
    recording = read_mpc(write(tmp_path / "a.mpc", text), options)
    found = bearings_of(recording)
    np.testing.assert_allclose(found.time_s, days, atol=1e-4)
    east, north, up = gg.geodesy.enu_axes(ecef(*STATIONS["Charlie"])) @ level.T
    # Hundredths of seconds of time and of arc.
    np.testing.assert_allclose(found.elevation_rad, np.arcsin(up), atol=0.1 * ARCSEC)
    np.testing.assert_allclose(
        np.cos(found.elevation_rad) * np.sin(found.azimuth_rad), east, atol=0.1 * ARCSEC
    )
    assert north.shape == (11,)
    sigma = np.unique(found.sigma_azimuth_rad)
    assert sigma.size == 1
    assert sigma[0] < 0.1 * ARCSEC


def digits(value: float, shape: str) -> str:
    """Return degrees packed into digits; the inverse of what is tested, with Python's integers."""
    unit = value / 15.0 if shape[0] == "H" else value
    decimals = sum(letter.islower() for letter in shape)
    per = 3600 if "SS" in shape else 60 if "MM" in shape else 1
    total, fraction = divmod(round(unit * per * 10**decimals), 10**decimals)
    head = shape.count("H") or shape.count("D")
    text = f"{total // per:0{head}d}"
    if per == 3600:
        text += f"{total // 60 % 60:02d}{total % 60:02d}"
    elif per == 60:
        text += f"{total % 60:02d}"
    return text + (f"{fraction:0{decimals}d}" if decimals else "")


IOD = {
    "1": ("HHMMSSs", "DDMMSS", 1.0, 30.0 * ARCSEC),
    "2": ("HHMMmmm", "DDMMmm", 2.0, 1800.0 * ARCSEC),
    "3": ("HHMMmmm", "DDdddd", 2.0, np.radians(30.0)),
    "4": ("DDDMMSS", "DDMMSS", 1.0, 30.0 * ARCSEC),
    "5": ("DDDMMmm", "DDMMmm", 1.0, 1800.0 * ARCSEC),
    "6": ("DDDdddd", "DDdddd", 1.0, np.radians(30.0)),
    "7": ("HHMMSSs", "DDdddd", 1.0, np.radians(30.0)),
}


@pytest.mark.parametrize("code", list(IOD))
def test_iod_formats(tmp_path: Path, options: ImportOptions, code: str) -> None:
    first, second, _, sigma = IOD[code]
    rows, lines = [], []
    for time in (11.25, 31.5, 60.0):
        azimuth, elevation, _ = seen("Alpha", time)
        rows.append((azimuth, elevation))
        clock = re.sub(r"[-T:.]", "", utc(time))[:17]
        lines.append(
            f"12345 24 001A   4353 G {clock} 56 {code}5 "
            f"{digits(azimuth, first)}+{digits(elevation, second)} 39\n"
        )
    recording = read_iod(write(tmp_path / "a.iod", "".join(lines)), options)
    found = bearings_of(recording)
    np.testing.assert_allclose(found.time_s, [11.25, 31.5, 60.0], atol=1e-9)
    np.testing.assert_allclose(found.sigma_azimuth_rad, sigma, rtol=1e-12)
    # The uncertainty of the time tags, 5 10^-2 s, is the clock's.
    assert recording.sensors["4353"].errors.clock_offset_s == pytest.approx(0.05)
    if first[0] == "D":
        half = np.radians(0.5 / (3600.0 if "SS" in second else 6000.0 if "MM" in second else 1e4))
        np.testing.assert_allclose(found.azimuth_rad, np.radians(rows)[:, 0], atol=1.01 * half)
        np.testing.assert_allclose(found.elevation_rad, np.radians(rows)[:, 1], atol=1.01 * half)


def test_all_forms_of_one_direction_agree(tmp_path: Path, options: ImportOptions) -> None:
    """RA 45 deg, Dec 30 deg is the same in every form of both formats."""
    lines = [
        f"12345 24 001A   4353 G 20240320190500000 56 {code}5 {digits(45.0, first):<7}"
        f"+{digits(30.0, second):<6} 39\n"
        for code, (first, second, _, _) in IOD.items() if first[0] == "H"
    ]  # fmt: skip
    uk = [
        f"24001014353240320{'1905000000'}{'005  '}1{code}{digits(45.0, first)}"
        f"+{digits(30.0, second)}{accuracy}5\n"
        for code, first, second, accuracy in (
            ("1", "HHMMSSss", "DDMMSSs", "0300"),
            ("2", "HHMMmmmm", "DDMMmmm", "0050"),
            ("3", "HHMMmmmm", "DDddddd", "0008"),
        )
    ]
    ours = bearings_of(read_iod(write(tmp_path / "a.iod", "".join(lines)), options))
    theirs = bearings_of(read_uk(write(tmp_path / "a.uk", "".join(uk)), options))
    for found in (ours, theirs):
        assert np.ptp(found.azimuth_rad) < 1e-12
        assert found.azimuth_rad[0] == pytest.approx(ours.azimuth_rad[0], abs=1e-12)
        assert found.elevation_rad[0] == pytest.approx(ours.elevation_rad[0], abs=1e-12)
    np.testing.assert_allclose(
        np.degrees(theirs.sigma_azimuth_rad), [30.0 / 3600.0, 0.5 / 60.0, 0.008], rtol=1e-12
    )
    # Equinox 1950 is 50 years of precession away: two thirds of a degree.
    old = bearings_of(
        read_iod(write(tmp_path / "b.iod", lines[0].replace(" 15 ", " 14 ")), options)
    )
    turn = np.degrees(old.azimuth_rad[0] - ours.azimuth_rad[0]) * np.cos(ours.elevation_rad[0])
    rise = np.degrees(old.elevation_rad[0] - ours.elevation_rad[0])
    assert 0.4 < np.hypot(turn, rise) < 0.9


def test_equinoxes_against_astropy(tmp_path: Path, options: ImportOptions) -> None:
    from astropy import units as u
    from astropy.coordinates import FK4, FK5, SkyCoord
    from astropy.time import Time

    def elevation(code: str) -> tuple[float, float]:
        line = f"12345 24 001A   4353 G 20240320190500000 56 1{code} 0300000+300000 39\n"
        found = bearings_of(read_iod(write(tmp_path / "a.iod", line), options))
        return float(found.azimuth_rad[0]), float(found.elevation_rad[0])

    moment = Time("2024-03-20T19:05:00")
    frames = {
        "4": FK4(equinox="B1950", obstime=moment),
        "0": FK5(equinox=moment),
        "6": FK5(equinox="J2050"),
    }
    for code, frame in frames.items():
        icrs = SkyCoord(45.0 * u.deg, 30.0 * u.deg, frame=frame).icrs
        text = (
            "CCSDS_TDM_VERS = 2.0\nMETA_START\nTIME_SYSTEM = UTC\nPARTICIPANT_1 = 4353\n"
            "PARTICIPANT_2 = X\nPATH = 2,1\nANGLE_TYPE = RADEC\nREFERENCE_FRAME = ICRF\n"
            f"META_STOP\nDATA_START\nANGLE_1 = 2024-080T19:05:00 {icrs.ra.deg:.12f}\n"
            f"ANGLE_2 = 2024-080T19:05:00 {icrs.dec.deg:.12f}\nDATA_STOP\n"
        )
        chosen = ImportOptions(stations=options.stations, sigma_deg=1.0)
        direct = bearings_of(read_tdm(write(tmp_path / "a.tdm", text), chosen))
        assert elevation(code) == pytest.approx(
            (float(direct.azimuth_rad[0]), float(direct.elevation_rad[0])), abs=1e-9
        )


def test_uk_horizontal_codes_say_whether_refraction_was_taken_off(
    tmp_path: Path, options: ImportOptions
) -> None:
    line = "240010100012403201905000000000051{}{}+{}05005\n"
    forms = [("DDDMMSSs", "DDMMSSs"), ("DDDMMmmm", "DDMMmmm"), ("DDDddddd", "DDddddd")]
    for code in range(4, 10):
        first, second = forms[(code - 4) % 3]
        text = line.format(code, digits(120.5, first), digits(40.25, second))
        recording = read_uk(write(tmp_path / "a.uk", text), options)
        found = bearings_of(recording)
        assert np.degrees(found.azimuth_rad[0]) == pytest.approx(120.5)
        assert np.degrees(found.elevation_rad[0]) == pytest.approx(40.25)
        assert recording.sensors["0001"].refraction == ("none" if code < 7 else "standard")
    both = "".join(
        line.format(code, digits(120.5, "DDDMMSSs"), digits(40.25, "DDMMSSs")) for code in (4, 7)
    )
    with pytest.raises(
        InputError, match=r"a.uk:2: is not corrected for refraction unlike that in line 1"
    ):
        read_uk(write(tmp_path / "a.uk", both), options)


GOOD = "12345 24 001A   4353 G 20240320190500000 56 65 1205000+402500 39"
MPC = mpc_line(8.64, 1.0, 0.5, "500")


def test_lines_without_a_direction_and_other_objects(
    tmp_path: Path, options: ImportOptions
) -> None:
    text = (
        f"# made\n\n{GOOD}\n                4353 C 20240320\n"
        "12345 24 001A   4353 F 20240320190600000 27                      B-005 05\n"
    )
    assert len(bearings_of(read_iod(write(tmp_path / "a.iod", text), options))) == 1
    more = f"{text}{GOOD.replace('12345 24 001A', '54321 24 002B')}\n"
    path = write(tmp_path / "a.iod", more)
    with pytest.raises(InputError, match="has 2 objects, 12345, 54321; expected one; name it"):
        read_iod(path, options)
    for target in ("54321", "24 002B"):
        assert bearings_of(read_iod(path, options, target=target)).line.tolist() == [6]
    with pytest.raises(InputError, match=r"target '1' is not in reports.*expected one of 12345"):
        read_iod(path, options, target="1")
    with pytest.raises(InputError, match="has no position"):
        read_iod(write(tmp_path / "b.iod", "                4353 C 20240320\n"), options)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("4353", "43 3", r"a.iod:1, column 17-20: is '43 3'; expected a station of four digits"),
        ("4353", "9999", r"a.iod:1: sensor '9999' is not in the station list"),
        (" 65 ", " 85 ", r"column 45: is '8'; expected an angle format from 1 to 7"),
        (" 65 ", " 17 ", r"column 46: is '7'; expected an epoch code"),
        ("1205000+", "12O5000+", r"column 48-54: is '12O5000'; expected digits DDDdddd"),
        ("1205000+", "3605000+", r"column 48-54: is 360.5 degrees; expected less than 360"),
        ("+402500", "*402500", r"column 55: is '\*'; expected a sign"),
        ("+402500", "+952500", r"column 55-61: is 95.25 degrees; expected 90 at most"),
        (" 39", " x9", r"column 63-64: is 'x9'; expected two digits MX"),
        ("20240320", "20240231", r"column 24-40: is '20240231190500000'; day"),
        ("1905", "1965", r"time of day 19:65"),
        ("65 1205000+402500", "45 1206100+402500", r"expected digits DDDMMSS below 60"),
    ],
)
def test_bad_iod(tmp_path: Path, options: ImportOptions, old: str, new: str, expected: str) -> None:
    assert old in GOOD
    with pytest.raises(InputError, match=expected) as caught:
        read_iod(write(tmp_path / "a.iod", GOOD.replace(old, new)), options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("  C2024", "  S2024", r"a.mpc:1, column 15: is 'S', observed from a spacecraft, which is"),
        ("  C2024", "  R2024", "measured by radar"),
        ("2024 03", "2024 13", r"column 16-32: is '2024 13.*'; month"),
        ("2024 03", "2024-03", r"expected a date as"),
        ("03 49", "24 01", r"column 33-44: .*expected 24 at most"),
        ("03 49", "xx 49", r"column 33-44: .*expected three numbers"),
        ("03 49 1", "057 17 ", r"column 33-44: .*expected three numbers"),
        ("2024 03", "K24 03 ", r"expected a date as .*K210228:215346123"),
        ("+28", " 28", r"column 45: is ' '; expected the sign"),
        ("500", "5 0", r"column 78-80: is '5 0'; expected an observatory"),
        ("500", "500 and more", r"column 81-89: has 89 columns; expected 80"),
    ],
)
def test_bad_mpc(tmp_path: Path, options: ImportOptions, old: str, new: str, expected: str) -> None:
    assert old in MPC
    with pytest.raises(InputError, match=expected):
        read_mpc(write(tmp_path / "a.mpc", MPC.replace(old, new)), options)


def test_times_of_astrometry_to_the_millisecond(tmp_path: Path, options: ImportOptions) -> None:
    """The same instant in three forms, with the lines about the observer before it."""
    chosen = ImportOptions(stations=options.stations, sigma_deg=0.01)
    head = "COD 500\nOBS A. Nobody\nTEL 0.3-m f/4 reflector\nNET Gaia DR3\n"
    for form, expected in (
        ("2024 03 20.794568", 50.6752),
        ("K240320.794567890", 50.665696),
        ("K240320:190410666", 10.666),
        ("K240320:190410", 10.0),
    ):
        line = MPC[:15] + f"{form:<17}" + MPC[32:]
        recording = read_mpc(write(tmp_path / "a.mpc", f"{head}{line}\n"), chosen)
        assert recording.epoch is not None
        assert recording.epoch.isoformat() == "2024-03-20T19:04:00+00:00"
        # 0.794567890 of a day is 19:04:10.665696.
        found = bearings_of(recording).time_s.tolist()
        assert found == pytest.approx([expected % 40.0], abs=1e-6)


def test_times_outside_the_tables_of_the_earth(tmp_path: Path, options: ImportOptions) -> None:
    text = GOOD.replace(" 65 1205000", " 15 1205000").replace("20240320", "20990320")
    with pytest.raises(InputError, match=r"holds a time on 2099-03-20, for which the tables"):
        read_iod(write(tmp_path / "a.iod", text), options)
