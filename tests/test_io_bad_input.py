"""Each kind of wrong recording has its own one-line message."""

from __future__ import annotations

import io
import os
import re
import struct
import zipfile
from typing import TYPE_CHECKING

import pytest
from recordings import BEARINGS, HEADER, valid_files, write_files

import geograph as gg
from geograph.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path


def message_of(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        gg.read(path)
    text = str(caught.value)
    assert "\n" not in text
    return text


# File, what is replaced in it, by what, and the message.
CASES = {
    "missing column": (
        "bearings.csv",
        "azimuth_deg",
        "elevation_rad",
        r"bearings.csv:1, column elevation_deg: .* beside elevation_rad",
    ),
    "unknown column": (
        "bearings.csv",
        "azimuth_deg",
        "azimut_deg",
        r"bearings.csv:1, column azimut_deg: unknown column.*did you mean azimuth_deg\?",
    ),
    "semicolons": (
        "bearings.csv",
        "time_s,sensor,",
        "time_s;sensor;",
        r"unknown column.*separate columns by commas",
    ),
    "duplicate column": (
        "bearings.csv",
        "azimuth_deg,elevation_deg",
        "time_s,elevation_deg",
        r"bearings.csv:1, column time_s: time_s is there twice",
    ),
    "nameless column": ("bearings.csv", "azimuth_deg", "", r"bearings.csv:1: column 3 has no name"),
    "text": (
        "bearings.csv",
        "290.5",
        "abc",
        r"bearings.csv:2, column azimuth_deg: 'abc' is not a number; expected a finite number",
    ),
    "underscore": ("bearings.csv", "290.5", "2_90", r":2, column azimuth_deg: '2_90' is not a pl"),
    "other digits": ("bearings.csv", "290.5", "٣", r":2, column azimuth_deg: .* is not a plain n"),
    "empty cell": ("bearings.csv", "290.5", " ", r":2, column azimuth_deg: empty cell; expected"),
    "nan": (
        "bearings.csv",
        "2.0,B two,-170.0",
        "2.0,B two,NaN",
        r"bearings.csv:3, column azimuth_deg: 'NaN' is not a number",
    ),
    "nan elevation": (
        "bearings.csv",
        "21.25",
        "nan",
        r":2, column elevation_deg: .*leave the cell",
    ),
    "infinite": (
        "bearings.csv",
        "3.0,A",
        "inf,A",
        r"bearings.csv:4, column time_s: 'inf' is infinite",
    ),
    "overflow": ("bearings.csv", "3.0,A", "1e999,A", r"bearings.csv:4, column time_s: '1e999' is"),
    "huge time": (
        "bearings.csv",
        "3.0,A",
        "1.6e18,A",
        r":4, column time_s: 1.6e\+18; expected -1e",
    ),
    "unknown sensor": (
        "bearings.csv",
        "3.0,A,",
        "3.0,Btwo,",
        r"bearings.csv:4, column sensor: unknown sensor 'Btwo'; did you mean B two\?",
    ),
    "no sensor": ("bearings.csv", "3.0,A,", "3.0,,", r"bearings.csv:4, column sensor: empty cell"),
    "zero sigma": (
        "bearings.csv",
        "5.0,0.02",
        "5.0,0",
        r"bearings.csv:3, column sigma_deg: 0; expected a sigma above 0",
    ),
    "negative sigma": ("bearings.csv", "5.0,0.02", "5.0,-0.02", r":3, column sigma_deg: -0.02;"),
    "empty sigma": ("bearings.csv", "5.0,0.02", "5.0,", r":3, column sigma_deg: empty cell;"),
    "outside trajectory": (
        "bearings.csv",
        "2.0,B two",
        "10.5,B two",
        r"bearings.csv:3, column time_s: 10.5; outside the trajectory of sensor 'B two'; "
        r"expected 0 to 10 s",
    ),
    "elevation": (
        "bearings.csv",
        "21.25",
        "90.5",
        r"bearings.csv:2, column elevation_deg: 90.5; expected -90 to 90; is the column in an",
    ),
    "azimuth": (
        "bearings.csv",
        "290.5",
        "361",
        r":2, column azimuth_deg: 361; expected -360 to 360",
    ),
    "ragged": (
        "bearings.csv",
        "2.0,B two,",
        "2.0,B two,1,",
        r"bearings.csv:3: 6 cells; expected 5",
    ),
    "quotes": ("bearings.csv", "2.0,B two", '2.0,"B two', r"bearings.csv:\d: is not valid CSV"),
    "no toml": ("recording.toml", "format = 1", "format 1", r"recording.toml:1: is not valid TOML"),
    "version": (
        "recording.toml",
        "format = 1",
        "format = 2",
        r":1, column format: format version 2",
    ),
    "version true": ("recording.toml", "format = 1", "format = true", r"format version True"),
    "no version": ("recording.toml", "format = 1", "", r"recording.toml: format is missing"),
    "no frame": ("recording.toml", 'frame = "ecef"', "", r"recording.toml: frame is missing"),
    "frame": (
        "recording.toml",
        '"ecef"',
        '"ecfe"',
        r":2, column frame: unknown .*did you mean ecef",
    ),
    "no epoch": ("recording.toml", "epoch = 2021-02-28T21:54:00Z", "", r"epoch is missing"),
    "local epoch": ("recording.toml", "54:00Z", "54:00", r"toml:3, column epoch: .*expected a UTC"),
    "text epoch": ("recording.toml", "2021-02-28T21:54:00Z", '"now"', r"column epoch: is 'now'"),
    "unknown key": (
        "recording.toml",
        "axes =",
        "axis =",
        r"axis: unknown key 'axis'; did you mean",
    ),
    "unknown error": (
        "recording.toml",
        "azimuth_bias_deg",
        "azimut_bias_deg",
        r"toml:9, column sensors.A.errors.azimut_bias_deg: .*did you mean azimuth_bias_deg\?",
    ),
    "two units": (
        "recording.toml",
        "clock_offset_s = 1.0",
        "azimuth_bias_rad = 0.1",
        r"toml:10, column sensors.A.errors.azimuth_bias_rad: .*in the other unit",
    ),
    "negative prior": (
        "recording.toml",
        "clock_offset_s = 1.0",
        "clock_offset_s = -1.0",
        r"toml:10, column sensors.A.errors.clock_offset_s: prior sigma is -1; expected at least 0",
    ),
    "text prior": (
        "recording.toml",
        "_s = 1.0",
        '_s = "1"',
        r"clock_offset_s: is '1'; expected a fi",
    ),
    "true prior": ("recording.toml", "_s = 1.0", "_s = true", r"clock_offset_s: is True; expected"),
    "huge prior": (
        "recording.toml",
        "_s = 1.0",
        "_s = 1" + "0" * 400,
        r"is a huge integer; expected",
    ),
    "misalignment": (
        "recording.toml",
        "clock_offset_s = 1.0",
        "misalignment_deg = 1.0",
        r"misalignment_deg: misalignment needs axes body",
    ),
    "no position": (
        "recording.toml",
        "geodetic = [51.5, -0.4, 78.0]",
        "",
        r"recording.toml:5, column sensors.A: sensor 'A' has no position; expected exactly one",
    ),
    "two positions": (
        "recording.toml",
        'trajectory = "b.csv"',
        'trajectory = "b.csv"\nposition_m = [7e6, 0, 0]',
        r"toml:12, column sensors.B two: sensor 'B two' has position_m and trajectory; expected",
    ),
    "duplicate sensor": (
        "recording.toml",
        '[sensors."B two"]',
        "[sensors.A]",
        r"recording.toml:12, column sensors.A: duplicate sensor 'A' \(first on line 5\)",
    ),
    "latitude": (
        "recording.toml",
        "[51.5,",
        "[151.5,",
        r"toml:6, column sensors.A.geodetic: is \[15",
    ),
    "two coordinates": (
        "recording.toml",
        "[51.5, ",
        "[",
        r"geodetic: is \[-0.4, 78.0\]; expected \[",
    ),
    "geodetic as metres": (
        "recording.toml",
        "geodetic = [",
        "position_m = [",
        r"sensors.A.position_m: is 93.\d+ m from the Earth's centre; .*or geodetic =",
    ),
    "no sensors": (
        "recording.toml",
        HEADER[HEADER.index("[sensors.A]") : HEADER.index("[smooth]")],
        "",
        r"recording.toml: no sensors; expected a table",
    ),
    "sensor name": ("recording.toml", '"B two"', '" B"', r"sensor name ' B'; expected printable"),
    "missing trajectory": (
        "recording.toml",
        "b.csv",
        "c.csv",
        r"toml:13.*'c.csv' is not in the rec",
    ),
    "trajectory outside": (
        "recording.toml",
        "b.csv",
        "../b.csv",
        r"'../b.csv'; expected the name of",
    ),
    "axes": ("recording.toml", '"xyz"', '"xzy"', r"unknown axes 'xzy'; did you mean xyz\?"),
    "refraction": (
        "recording.toml",
        '"xyz"',
        '"xyz"\nrefraction = "standard"',
        r"refraction: refraction needs axes enu; given axes xyz",
    ),
    "correlation": (
        "recording.toml",
        '"xyz"',
        '"xyz"\ncorrelation = 1.5',
        r"toml:15, column .*correlation: is 1.5; expected a finite number from 0 to 1",
    ),
    "terrain": (
        "recording.toml",
        "[smooth]",
        '[terrain]\na = "b"',
        r"is a table; expected text in quotes",
    ),
    "speed": (
        "recording.toml",
        "[sensors.A]",
        "propagation_speed_m_s = 0\n[sensors.A]",
        r"propagation_speed_m_s: is 0; expected above 0, or inf",
    ),
    "motion": (
        "recording.toml",
        "constant-velocity",
        "constant-velocty",
        r"toml:17, column smooth.motion: unknown motion .*did you mean constant-velocity\?",
    ),
    "loss": (
        "recording.toml",
        "process_noise = 10.0",
        'loss = "Cauchy"',
        r"unknown loss 'Cauchy'; di",
    ),
    "noise": (
        "recording.toml",
        "noise = 10.0",
        "noise = 0",
        r"toml:18, column smooth.process_noise:",
    ),
    "noise list": (
        "recording.toml",
        "noise = 10.0",
        "noise = [1, 2]",
        r"expected one or three numbe",
    ),
    "noise word": ("recording.toml", "noise = 10.0", 'noise = "aut"', r"did you mean auto\?"),
    "iterations": (
        "recording.toml",
        "process_noise = 10.0",
        "max_iterations = 1.5",
        r"whole number",
    ),
    "smooth list": (
        "recording.toml",
        "[smooth]",
        "[[smooth]]",
        r"smooth: is \[.*; expected a table",
    ),
    "truth range": (
        "truth.csv",
        "0.0,6500000.0,0.0,0.0\n4.0,",
        "100.0,6500000.0,0.0,0.0\n104.0,",
        r"truth.csv:2, column time_s: covers 100 to 104 s and the measurements 1 to 3 s",
    ),
    "truth order": ("truth.csv", "4.0,", "0.0,", r"truth.csv:3, column time_s: 0; expected later"),
    "truth velocity": ("truth.csv", "z_m", "z_m,vx_m_s", r"truth.csv:\d"),
    "trajectory order": (
        "b.csv",
        "5.0,",
        "15.0,",
        r"b.csv:4, column time_s: 10; expected later than",
    ),
    "trajectory units": (
        "b.csv",
        "7000000.0,1",
        "7000.0,1",
        r"b.csv:3, column x_m: 7000; with y_m",
    ),
    "trajectory yaw": (
        "b.csv",
        "time_s,x_m,y_m,z_m\n0.0",
        "yaw_deg,x_m,y_m,z_m\n0.0",
        r"b.csv:1, column time_s: column time_s is missing",
    ),
    "constraint kind": (
        "constraints.csv",
        "altitude_m",
        "altitud_m",
        r":2, column kind: unknown kind",
    ),
    "terrain constraint": (
        "constraints.csv",
        "altitude_m",
        "height_above_terrain_m",
        r"constraints.csv:2, column kind: height_above_terrain_m; expected a terrain in recording",
    ),
    "constraint sigma": (
        "constraints.csv",
        "11000.0,50.0",
        "11000.0,0",
        r":3, column sigma: 0; exp",
    ),
    "constraint speed": (
        "constraints.csv",
        "11000.0,",
        "-1,",
        r":3, column value: -1; expected a sp",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_message(tmp_path: Path, case: str) -> None:
    name, old, new, expected = CASES[case]
    files = valid_files()
    assert old in files[name]
    files[name] = files[name].replace(old, new, 1)
    assert re.search(expected, message_of(write_files(tmp_path, files)))


def test_missing_column_is_named(tmp_path: Path) -> None:
    files = valid_files()
    files["bearings.csv"] = "time_s,sensor,sigma_deg\n1.0,A,0.1\n"
    assert re.search(
        r"bearings.csv:1, column azimuth_deg: column azimuth_deg or azimuth_rad is missing; "
        r"found time_s, sensor, sigma_deg",
        message_of(write_files(tmp_path, files)),
    )


@pytest.mark.parametrize(
    ("header", "row", "expected"),
    [
        ("time_s", "1", "column time_s: time_s is there twice"),
        ("elevation_deg", "1", "column elevation_deg: elevation_deg is there twice"),
        ("sigma_elevation_deg", "1", "bearings.csv:1, column sigma_deg: no sigma; found"),
        ("sigma_deg,sigma_azimuth_deg,sigma_elevation_deg", "1,1,1", "sigma given twice"),
        ("sigma_deg,sigma_azimuth_deg,sigma_elevation_deg", ",1,", "_elevation_deg: empty cell"),
        ("sigma_azimuth_deg", "1", "column sigma_elevation_deg: column is missing"),
        ("sigma_azimuth_deg,sigma_elevation_rad", "1,0", "column sigma_elevation_rad: 0; expected"),
    ],
)
def test_sigmas(tmp_path: Path, header: str, row: str, expected: str) -> None:
    files = valid_files()
    files["bearings.csv"] = f"time_s,sensor,azimuth_deg,elevation_deg,{header}\n1.0,A,10,20,{row}\n"
    assert expected in message_of(write_files(tmp_path, files))


def test_missing_folder(tmp_path: Path) -> None:
    assert "no such file or folder" in message_of(tmp_path / "nothing")


def test_pipes_are_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert "pipe: is not a regular file" in message_of(tmp_path / "pipe")
    write_files(tmp_path, valid_files())
    (tmp_path / "truth.csv").unlink()
    os.mkfifo(tmp_path / "truth.csv")
    assert "truth.csv: is not a regular file" in message_of(tmp_path)


def test_folder_without_recording(tmp_path: Path) -> None:
    assert "no recording.toml in it" in message_of(tmp_path)


def test_header_in_place_of_folder(tmp_path: Path) -> None:
    write_files(tmp_path, valid_files())
    assert "expected its folder" in message_of(tmp_path / "recording.toml")


def test_no_measurement(tmp_path: Path) -> None:
    files = valid_files()
    del files["bearings.csv"]
    assert "no table of measurements in it" in message_of(write_files(tmp_path, files))


@pytest.mark.parametrize("name", ["bearings.csv", "truth.csv", "b.csv", "constraints.csv"])
def test_empty_tables(tmp_path: Path, name: str) -> None:
    files = valid_files()
    files[name] = files[name].splitlines()[0] + "\n"
    assert f"{name}: has no rows" in message_of(write_files(tmp_path, files))


@pytest.mark.parametrize("name", valid_files())
def test_empty_files(tmp_path: Path, name: str) -> None:
    files = valid_files()
    files[name] = ""
    assert re.search(f"{name}.*is empty", message_of(write_files(tmp_path, files)))


@pytest.mark.parametrize("name", valid_files())
def test_folders_in_place_of_files(tmp_path: Path, name: str) -> None:
    files = valid_files()
    del files[name]
    write_files(tmp_path, files)
    (tmp_path / name).mkdir()
    assert f"{name}: is a folder; expected a file" in message_of(tmp_path)


@pytest.mark.parametrize("name", valid_files())
def test_not_utf8(tmp_path: Path, name: str) -> None:
    files = {key: text.encode() for key, text in valid_files().items()}
    files[name] = files[name].replace(b"\n", b"\n\xe9", 1)
    assert f"{name}:2: byte 0xe9 is not UTF-8" in message_of(write_files(tmp_path, files))


def test_both_formats_of_a_table(tmp_path: Path) -> None:
    write_files(tmp_path, valid_files() | {"bearings.parquet": ""})
    assert "both bearings.csv and bearings.parquet are there" in message_of(tmp_path)


def test_misspelt_table(tmp_path: Path) -> None:
    files = valid_files()
    files["Truth.csv"] = files.pop("truth.csv")
    assert "did you mean truth.csv?" in message_of(write_files(tmp_path, files))


def test_geodetic_in_a_local_frame(tmp_path: Path) -> None:
    files = valid_files()
    files["recording.toml"] = files["recording.toml"].replace('"ecef"', '"local"')
    assert "geodetic needs the frame ecef" in message_of(write_files(tmp_path, files))


def parquet(columns: dict[str, object]) -> bytes:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet as module

    file = io.BytesIO()
    module.write_table(pyarrow.table(columns), file)
    return file.getvalue()


PARQUET = {
    "time_s": [1.0, 2.0],
    "sensor": ["A", "A"],
    "azimuth_deg": [10.0, 11.0],
    "sigma_deg": [0.1, 0.1],
}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"azimuth_deg": ["a", "b"]}, "column azimuth_deg: holds 'string'; expected numbers"),
        ({"azimuth_deg": [1.0, None]}, ":3, column azimuth_deg: empty cell"),
        ({"azimuth_deg": [float("nan"), 1.0]}, ":2, column azimuth_deg: nan is not a finite"),
        ({"azimuth_deg": [float("inf"), 1.0]}, ":2, column azimuth_deg: inf is not a finite"),
        ({"azimuth_deg": [True, False]}, "holds 'bool'; expected numbers"),
        ({"sensor": [1, 2]}, "column sensor: holds 'int64'; expected text"),
        ({"sensor": ["A", None]}, ":3, column sensor: empty cell"),
        ({"colour": [1.0, 2.0]}, "column colour: unknown column"),
    ],
)
def test_parquet_cells(tmp_path: Path, changes: dict[str, object], expected: str) -> None:
    files = {key: text.encode() for key, text in valid_files().items()}
    del files["bearings.csv"]
    files["bearings.parquet"] = parquet(PARQUET | changes)
    assert expected in message_of(write_files(tmp_path, files))


@pytest.mark.parametrize("damage", ["truncated", "garbage", "empty"])
def test_damaged_parquet(tmp_path: Path, damage: str) -> None:
    whole = parquet(PARQUET)
    content = {"truncated": whole[: len(whole) // 2], "garbage": b"x" * 500, "empty": b""}[damage]
    files = {key: text.encode() for key, text in valid_files().items()}
    del files["bearings.csv"]
    files["bearings.parquet"] = content
    text = message_of(write_files(tmp_path, files))
    assert "bearings.parquet: is " in text
    assert ("is empty" if damage == "empty" else "not a whole Parquet file") in text


def zip_of(path: Path, files: dict[str, str]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return path


def test_zip_not_an_archive(tmp_path: Path) -> None:
    (tmp_path / "a.zip").write_bytes(b"PK\x03\x04 and nothing more")
    assert "a.zip: is not a zip archive" in message_of(tmp_path / "a.zip")


def test_zip_with_path_traversal(tmp_path: Path) -> None:
    path = zip_of(tmp_path / "a.zip", valid_files() | {"../evil.csv": "x"})
    assert "'../evil.csv' points out of the archive" in message_of(path)


def test_zip_encrypted(tmp_path: Path) -> None:
    path = zip_of(tmp_path / "a.zip", valid_files())
    content = bytearray(path.read_bytes())
    # Bit 0 of the flags of the first entry of the central directory.
    place = content.index(b"PK\x01\x02") + 8
    struct.pack_into("<H", content, place, 1)
    path.write_bytes(content)
    assert "is encrypted" in message_of(path)


def test_zip_damaged_member(tmp_path: Path) -> None:
    path = zip_of(tmp_path / "a.zip", valid_files())
    content = bytearray(path.read_bytes())
    content[60:80] = bytes(20)
    path.write_bytes(content)
    assert "recording.toml: cannot be unpacked" in message_of(path)


def test_zip_without_recording(tmp_path: Path) -> None:
    path = zip_of(tmp_path / "a.zip", {"bearings.csv": BEARINGS})
    assert "holds 0 files recording.toml" in message_of(path)


def test_zip_of_two_recordings(tmp_path: Path) -> None:
    files = {f"{folder}/{n}": t for folder in "ab" for n, t in valid_files().items()}
    assert "holds 2 files recording.toml" in message_of(zip_of(tmp_path / "a.zip", files))
