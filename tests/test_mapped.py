"""Tables of any layout through a mapping."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from functools import reduce
from operator import xor
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from made_pass import EPOCH, STATION_CSV, STATIONS, ecef, seen, sightings, utc

from geograph.errors import InputError
from geograph.io import ImportOptions, read_frame, read_mapped, read_stations

if TYPE_CHECKING:
    from pathlib import Path


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.fixture
def options(tmp_path: Path) -> ImportOptions:
    return ImportOptions(stations=read_stations(write(tmp_path / "stations.csv", STATION_CSV)))


ROWS = sightings(step_s=10.0)

MAPPING = """\
kind = "bearings"
[file]
delimiter = ";"
decimal = ","
skip_lines = 1
[columns]
time = { column = ["Datum", "Zeit"], format = "%d.%m.%Y %H:%M:%S.%f", utc_offset_hours = 1 }
sensor = "Station"
azimuth = { column = "Az", unit = "gon" }
elevation = { column = "El", unit = "mrad" }
sigma = { value = 0.6, unit = "arcmin" }
"""


def german() -> str:
    lines = ["Ein Titel; mit Semikolon", "Datum;Zeit;El;Az;Bemerkung;Station", "# nichts"]
    for time, station, azimuth, elevation in ROWS:
        local = EPOCH + timedelta(seconds=time, hours=1)
        numbers = f"{np.radians(elevation) * 1e3:.9f};{azimuth / 0.9:.9f}".replace(".", ",")
        clock = local.strftime("%d.%m.%Y;%H:%M:%S.%f")
        lines.append(f'{clock};{numbers};"ja; gut";{station}')
    return "\n".join(lines)


def test_somebodys_table(tmp_path: Path, options: ImportOptions) -> None:
    table, mapping = write(tmp_path / "a.txt", german()), write(tmp_path / "m.toml", MAPPING)
    recording = read_mapped(table, mapping, options)
    bearings = recording.bearings
    assert bearings is not None
    assert recording.epoch == EPOCH
    assert recording.sensor_names == tuple(STATIONS)
    np.testing.assert_allclose(bearings.time_s, [row[0] for row in ROWS], atol=1e-6)
    np.testing.assert_allclose(np.degrees(bearings.azimuth_rad), [r[2] for r in ROWS], atol=1e-8)
    np.testing.assert_allclose(np.degrees(bearings.elevation_rad), [r[3] for r in ROWS], atol=1e-8)
    np.testing.assert_allclose(np.degrees(bearings.sigma_azimuth_rad), 0.01, rtol=1e-12)
    assert bearings.line.tolist() == list(range(4, 4 + len(ROWS)))


@pytest.mark.parametrize(
    ("form", "text"),
    [
        ("iso", "2024-03-20T19:05:01.5"),
        ("unix", f"{EPOCH.timestamp() + 61.5}"),
        ("unix_ms", f"{(EPOCH.timestamp() + 61.5) * 1e3:.0f}"),
        ("unix_us", f"{(EPOCH.timestamp() + 61.5) * 1e6:.0f}"),
        ("unix_ns", f"{round((EPOCH.timestamp() + 61.5) * 1e9)}"),
        ("gps", f"{EPOCH.timestamp() + 61.5 - 315964800 + 18}"),
        ("seconds", "61.5"),
        ("%H-%M-%S,%f on %d/%m/%y", "19-05-01,5 on 20/03/24"),
        ("%Y-%m-%dT%H:%M:%S.%f%z", "2024-03-20T20:05:01.5+0100"),
    ],
)
def test_time_formats(tmp_path: Path, options: ImportOptions, form: str, text: str) -> None:
    mapping = {
        "epoch": EPOCH,
        "columns": {
            "time": {"column": "t", "format": form},
            "sensor": {"value": "Alpha"},
            "azimuth": {"column": "az", "unit": "deg"},
            "sigma": {"value": 1.0, "unit": "deg"},
        },
    }
    found = read_mapped(write(tmp_path / "a.csv", f't,az\n"{text}",12\n'), mapping, options)
    assert found.epoch == EPOCH + timedelta(minutes=1)
    assert found.bearings is not None
    assert found.bearings.time_s.tolist() == pytest.approx([1.5], abs=2e-7)
    assert np.isnan(found.bearings.elevation_rad).all()


def sentence(*fields: object) -> str:
    body = ",".join(map(str, fields))
    return f"${body}*{reduce(xor, map(ord, body)):02X}\n"


NMEA: dict[str, Any] = {
    "file": {"header": False, "checksum": True, "where": {"1": ["$DFBRG", "$DFBRQ"]}},
    "columns": {
        "time": {"column": ["10", "2"], "format": "%d%m%y %H%M%S.%f"},
        "sensor": {"value": "Van"},
        "azimuth": {"column": [7, 8], "unit": "deg"},
        "latitude": {"column": 3, "unit": "ddmm", "hemisphere": "4"},
        "longitude": {"column": 5, "unit": "ddmm", "hemisphere": "6"},
        "height": {"value": 30.0, "unit": "m"},
        "sigma": {"column": 9, "unit": "deg"},
    },
}


def test_a_direction_finder_on_the_move(tmp_path: Path) -> None:
    """Relative bearing and heading are added; the position is that of each sentence."""
    lines = ["$GPGSV,3,1,11*4A\n", sentence("GPGSV", 3, 1, 11)]
    lines += [
        sentence(
            "DFBRG", f"12000{second}.50", f"520{second}.3000", "N", "01030.0000", "W", "350.5",
            20 + second, 2.5, "010624",
        )
        for second in range(4)
    ]  # fmt: skip
    text = "".join(lines[1:])
    recording = read_mapped(write(tmp_path / "a.log", text), NMEA)
    bearings, van = recording.bearings, recording.sensors["Van"]
    assert bearings is not None
    assert recording.epoch == datetime(2024, 6, 1, 12, tzinfo=UTC)
    assert bearings.time_s.tolist() == [0.5, 1.5, 2.5, 3.5]
    np.testing.assert_allclose(np.degrees(bearings.azimuth_rad), [10.5, 11.5, 12.5, 13.5])
    np.testing.assert_allclose(np.degrees(bearings.sigma_azimuth_rad), 2.5)
    for second, time in enumerate(bearings.time_s):
        place = ecef(52.0 + (second + 0.3) / 60.0, -10.5, 30.0)
        np.testing.assert_allclose(van.position_at(time), place, atol=1e-3)
    with pytest.raises(InputError, match=r"a.log:2: ends in .*expected a sentence from \$ to \*"):
        read_mapped(write(tmp_path / "a.log", text.replace("DFBRG,120000", "DFBRG,120009")), NMEA)
    still = text.replace("5201", "5200").replace("5202", "5200").replace("5203", "5200")
    plain = {**NMEA, "file": {"header": False, "where": {"1": "$DFBRG"}}}
    stars = still.replace("*", ",*")
    found = read_mapped(write(tmp_path / "b.log", stars), plain)
    assert found.sensors["Van"].trajectory is None


def test_other_kinds(tmp_path: Path, options: ImportOptions) -> None:
    rows = [(10.0 + n, name, seen(name, 10.0)[2]) for n in (0, 1) for name in STATIONS]
    text = "e,at,who,us\n" + "".join(
        f"{int(time)},{utc(time + delay)},{name},0.1\n" for time, name, delay in rows
    )
    columns: dict[str, Any] = {
        "time": "at", "sensor": "who", "emission": "e", "sigma": {"column": "us", "unit": "us"},
    }  # fmt: skip
    arrivals = read_mapped(
        write(tmp_path / "a.csv", text), {"kind": "arrivals", "columns": columns}, options
    ).arrivals
    assert arrivals is not None
    np.testing.assert_allclose(arrivals.toa_s, [t + d for t, _, d in rows], atol=1e-6)
    np.testing.assert_allclose(arrivals.sigma_s, 1e-7)
    assert arrivals.emission_names == ("10", "11")
    pairs = f"at,a,b,ns,f\n{utc(1.0)},Bravo,Alpha,-1500,12.5\n"
    common: dict[str, Any] = {"time": "at", "sensor": "a", "reference": "b"}
    times = read_mapped(
        write(tmp_path / "b.csv", pairs),
        {"kind": "time_differences", "columns": common | {
            "tdoa": {"column": "ns", "unit": "ns"}, "sigma": {"value": 30, "unit": "ns"}}},
        options,
    ).time_differences  # fmt: skip
    assert times is not None
    assert (times.tdoa_s[0], times.sigma_s[0]) == pytest.approx((-1.5e-6, 3e-8))
    frequencies = read_mapped(
        tmp_path / "b.csv",
        {"kind": "frequency_differences", "columns": common | {
            "fdoa": {"column": "f", "unit": "kHz"}, "sigma": {"value": 1, "unit": "Hz"},
            "carrier": {"value": 437.5, "unit": "MHz"}}},
        options,
    ).frequency_differences  # fmt: skip
    assert frequencies is not None
    assert (frequencies.fdoa_hz[0], frequencies.carrier_hz[0]) == (12500.0, 437.5e6)


FRAME: dict[str, Any] = {
    "columns": {
        "time": "when",
        "sensor": "who",
        "azimuth": {"column": "az", "unit": "deg"},
        "elevation": {"column": "el", "unit": "deg"},
        "sigma": {"value": 0.01, "unit": "deg"},
    }
}


@pytest.mark.parametrize("library", ["pandas", "polars"])
@pytest.mark.parametrize("zone", [None, "UTC", "Europe/Berlin"])
def test_frames(options: ImportOptions, library: str, zone: str | None) -> None:
    module = pytest.importorskip(library)
    times = [EPOCH.replace(tzinfo=None) + timedelta(seconds=row[0]) for row in ROWS]
    columns = dict(
        zip(("who", "az", "el"), zip(*(row[1:] for row in ROWS), strict=True), strict=True)
    )
    frame = module.DataFrame({"when": times} | {name: list(v) for name, v in columns.items()})
    if zone is not None and library == "pandas":
        frame["when"] = frame["when"].dt.tz_localize("UTC").dt.tz_convert(zone)
    elif zone is not None:
        column = module.col("when").dt.replace_time_zone("UTC").dt.convert_time_zone(zone)
        frame = frame.with_columns(column)
    recording = read_frame(frame, FRAME, options)
    bearings = recording.bearings
    assert bearings is not None
    np.testing.assert_allclose(bearings.time_s, [row[0] for row in ROWS], atol=1e-6)
    # Numbers come through to the last bit but for the unit.
    np.testing.assert_array_equal(bearings.azimuth_rad, np.array(columns["az"]) * (np.pi / 180.0))
    with pytest.raises(InputError, match=r"frame, column az: no column 'az', which the mapping"):
        read_frame(frame.rename({"az": "azi"}) if library == "polars" else
                   frame.rename(columns={"az": "azi"}), FRAME, options)  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"Az", unit = "gon"', '"Azi", unit = "gon"', r"a.txt:2, column Azi: no column 'Azi'.*Az"),
        ('unit = "gon"', 'unit = "grad"', r"m.toml:\d+, column columns.azimuth.unit: unknown unit"),
        (', unit = "gon"', "", r"has no unit; expected one of deg, rad"),
        ('sensor = "Station"\n', "", r"column columns: no sensor; expected time, sensor, azimuth"),
        ("azimuth =", "azimut =", r"unknown key 'azimut'; did you mean azimuth\?"),
        ('"bearings"', '"bearing"', r"column kind: unknown kind 'bearing'"),
        ("%d.%m.%Y", "d.m.Y", r"a.txt:4, column Datum: is '20.03.2024 20:0|does not match"),
        ("%d.%m.%Y %H:%M:%S.%f", "german", r"is 'german'; expected one of iso, unix"),
        ("utc_offset_hours = 1", "utc_offset_hours = 25", r"is 25; expected a finite number from"),
        ("utc_offset_hours = 1", 'system = "GMT"', r"unknown system 'GMT'"),
        ('";"', '";;"', "expected one character"),
        ("skip_lines = 1", "skip_lines = -1", r"is -1; expected a finite number from 0"),
        ("{ value = 0.6, unit", "{ unit", r"expected exactly one of column and value"),
        ("sigma =", "height = { value = 1, unit = 'm' }\nsigma =", r"without all of latitude"),
        ('decimal = ","', 'decimal = "."', r"a.txt:4, column Az: is '.*'; expected a number \(gon"),
        ('decimal = ","', 'header = "no"', r"is 'no'; expected true or false"),
    ],
)
def test_bad_mappings(
    tmp_path: Path, options: ImportOptions, old: str, new: str, expected: str
) -> None:
    assert old in MAPPING
    mapping = write(tmp_path / "m.toml", MAPPING.replace(old, new))
    with pytest.raises(InputError, match=expected) as caught:
        read_mapped(write(tmp_path / "a.txt", german()), mapping, options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        (f"{utc(1.0)},Alpha,x,40,0.1", r"a.csv:2, column az: is 'x'; expected a number \(deg\)"),
        (f"{utc(1.0)},Alpha,,40,0.1", r"column az: empty cell; expected a number"),
        (f"{utc(1.0)},Alpha,nan,40,0.1", r"column az: is 'nan'"),
        (f"{utc(1.0)},Alpha,10,140,0.1", r"column el: makes elevation 2.44346095; expected -90"),
        (f"{utc(1.0)},Alpha,10,40,-0.1", r"column s: makes sigma .*; expected above 0"),
        (f"{utc(1.0)},,10,40,0.1", r"column who: is ''; expected the sensor"),
        (f"{utc(1.0)},Delta,10,40,0.1", r"a.csv:2: sensor 'Delta' is not in the station list"),
        ("yesterday,Alpha,10,40,0.1", r"column t: is 'yesterday'; expected a time such as"),
        (f"{utc(1.0)},Alpha,10", r"a.csv:2, column el: has 3 cells; expected one"),
        ("", r"has no row that the mapping reads"),
    ],
)
def test_bad_rows(tmp_path: Path, options: ImportOptions, row: str, expected: str) -> None:
    mapping = {
        "columns": {
            "time": "t", "sensor": "who", "azimuth": {"column": "az", "unit": "deg"},
            "elevation": {"column": "el", "unit": "deg"}, "sigma": {"column": "s", "unit": "deg"},
        }
    }  # fmt: skip
    with pytest.raises(InputError, match=expected):
        read_mapped(write(tmp_path / "a.csv", f"t,who,az,el,s\n{row}\n"), mapping, options)
