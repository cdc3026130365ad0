"""Recordings are read as they stand, and what is written reads back equal."""

from __future__ import annotations

import dataclasses
import pathlib
import re
import zipfile
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np
import pytest
from recordings import BEARINGS, all_files, assert_equal, valid_files, write_files

import geograph as gg
from geograph.errors import InputError
from geograph.io import convert
from geograph.io.header import _METRE_KEYS, _SENSOR_KEYS, _TOP_KEYS
from geograph.io.measurement_tables import MEASUREMENT_COLUMNS
from geograph.io.reader import CONSTRAINT_COLUMNS, TRAJECTORY_COLUMNS, TRUTH_COLUMNS
from geograph.recording import SmoothSettings
from geograph.sensors import SensorErrors

if TYPE_CHECKING:
    from pathlib import Path


def test_values_as_they_stand(tmp_path: Path) -> None:
    recording = gg.read(write_files(tmp_path / "pass", valid_files()))
    assert recording.name == "pass"
    assert recording.frame == "ecef"
    assert recording.epoch == datetime(2021, 2, 28, 21, 54, tzinfo=UTC)
    assert recording.sensor_names == ("A", "B two")
    first, second = recording.sensors.values()
    # The closed form on WGS 84, with N the radius of curvature in the prime vertical.
    assert first.position_m is not None
    latitude, longitude, e2 = np.radians(51.5), np.radians(-0.4), 6.69437999014e-3
    n = 6378137.0 / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
    across = (n + 78.0) * np.cos(latitude)
    z = (n * (1.0 - e2) + 78.0) * np.sin(latitude)
    expected = [across * np.cos(longitude), across * np.sin(longitude), z]
    np.testing.assert_allclose(first.position_m, expected, atol=1e-6)
    assert np.degrees(first.errors.azimuth_bias_rad) == pytest.approx(0.01, rel=1e-12)
    assert first.errors.clock_offset_s == 1.0
    assert first.axes == "enu"
    assert second.trajectory is not None
    np.testing.assert_array_equal(second.trajectory.position_m[1], [7e6, 1e3, 0.0])
    bearings = recording.bearings
    assert bearings is not None
    np.testing.assert_array_equal(bearings.time_s, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(bearings.sensor, [0, 1, 0])
    np.testing.assert_array_equal(bearings.line, [2, 3, 4])
    np.testing.assert_allclose(np.degrees(bearings.azimuth_rad), [290.5, -170.0, 291.5])
    np.testing.assert_allclose(np.degrees(bearings.elevation_rad), [21.25, -5.0, 20.25])
    np.testing.assert_allclose(np.degrees(bearings.sigma_elevation_rad), [0.01, 0.02, 0.01])
    assert bearings.isotropic.all()
    assert recording.constraints is not None
    assert recording.constraints.kind == ("altitude_m", "speed_m_s")
    np.testing.assert_array_equal(recording.constraints.time_s, [np.nan, 2.0])
    assert recording.truth is not None
    assert recording.truth.velocity_m_s is None
    assert recording.settings == SmoothSettings(motion="constant-velocity", process_noise=10.0)


def test_defaults_of_a_local_frame(tmp_path: Path) -> None:
    header = 'format = 1\nframe = "local"\n[sensors.S]\nposition_m = [0, 0, 0]\n'
    table = "time_s,sensor,azimuth_rad,sigma_rad\n1,S,0.5,0.01\n"
    recording = gg.read(write_files(tmp_path, {"recording.toml": header, "bearings.csv": table}))
    assert recording.epoch is None
    assert recording.sensors["S"].axes == "xyz"
    assert recording.bearings is not None
    assert np.isnan(recording.bearings.elevation_rad).all()
    assert not recording.bearings.isotropic.any()
    np.testing.assert_array_equal(recording.bearings.sigma_azimuth_rad, [0.01])
    assert recording.settings == SmoothSettings()


def test_mixed_sigmas_and_azimuth_only_rows(tmp_path: Path) -> None:
    files = valid_files()
    files["bearings.csv"] = (
        "time_s,sensor,azimuth_deg,elevation_rad,sigma_deg,sigma_azimuth_rad,sigma_elevation_deg\n"
        "1,A,10,0.2,1,,\n2,A,10,0.2,,0.1,2\n3,A,10,,1,,\n4,A,10,,,0.1,\n"
    )
    bearings = gg.read(write_files(tmp_path, files)).bearings
    assert bearings is not None
    np.testing.assert_array_equal(bearings.isotropic, [True, False, False, False])
    np.testing.assert_array_equal(np.isnan(bearings.elevation_rad), [False, False, True, True])
    degree = np.pi / 180.0
    np.testing.assert_allclose(bearings.sigma_azimuth_rad, [degree, 0.1, degree, 0.1])
    np.testing.assert_allclose(bearings.sigma_elevation_rad[:2], [degree, 2.0 * degree])


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("\ufeff" + BEARINGS, [2, 3, 4]),
        (BEARINGS.replace("\n", "\r\n"), [2, 3, 4]),
        (BEARINGS.replace("2.0,", "\n\n2.0,"), [2, 5, 6]),
        (BEARINGS.replace(",", " , "), [2, 3, 4]),
        (BEARINGS.replace("B two", '"B two\n"'), [2, 3, 5]),
        (BEARINGS.rstrip("\n"), [2, 3, 4]),
    ],
    ids=["mark", "crlf", "blank lines", "spaces", "quoted line break", "no last line break"],
)
def test_variants_of_csv(tmp_path: Path, text: str, lines: list[int]) -> None:
    plain = gg.read(write_files(tmp_path / "a", valid_files()))
    variant = gg.read(write_files(tmp_path / "b", valid_files() | {"bearings.csv": text}))
    assert_equal(plain, variant)
    assert variant.bearings is not None
    np.testing.assert_array_equal(variant.bearings.line, lines)


def test_lines_beyond_the_first_piece(tmp_path: Path) -> None:
    header, row, *_ = BEARINGS.splitlines()
    files = valid_files()
    files["bearings.csv"] = "\n".join([header, *[row] * 70_000, row.replace("290.5", "x"), row])
    with pytest.raises(InputError, match=r"bearings\.csv:70002, column azimuth_deg: 'x' is not"):
        gg.read(write_files(tmp_path, files))


@pytest.mark.parametrize("folder", ["", "inside/"])
def test_zip(tmp_path: Path, folder: str) -> None:
    plain = gg.read(write_files(tmp_path / "plain", valid_files()))
    with zipfile.ZipFile(tmp_path / "pass.zip", "w") as archive:
        for name, text in valid_files().items():
            archive.writestr(folder + name, text)
    recording = gg.read(tmp_path / "pass.zip")
    assert recording.name == "pass"
    assert_equal(plain, recording)


@pytest.mark.parametrize("tables", ["csv", "parquet"])
@pytest.mark.parametrize("suffix", ["", ".zip"])
def test_conversions_there_and_back(tmp_path: Path, tables: str, suffix: str) -> None:
    original = gg.read(write_files(tmp_path / "a", all_files()))
    converted = convert([tmp_path / "a"], tmp_path / f"b{suffix}", tables=tables)
    assert converted.name == "b"
    assert converted.path == tmp_path / f"b{suffix}"
    assert_equal(original, converted)
    assert list(original.tables) == list(MEASUREMENT_COLUMNS)
    for name, table in original.tables.items():
        np.testing.assert_array_equal(table.line, converted.tables[name].line)
    assert_equal(original, convert([tmp_path / f"b{suffix}"], tmp_path / "c"))
    # Angles that were given in degrees are in degrees again, with their own digits.
    for name in MEASUREMENT_COLUMNS:
        assert (tmp_path / "c" / f"{name}.csv").read_text() == all_files()[f"{name}.csv"]


def test_writing_never_leaves_an_invalid_recording(tmp_path: Path) -> None:
    recording = gg.read(write_files(tmp_path / "a", valid_files()))
    bare = dataclasses.replace(recording, bearings=None, truth=None)
    with pytest.raises(InputError, match=r"cannot be written as a recording: .*no table of meas"):
        gg.write(bare, tmp_path / "b")
    assert [entry.name for entry in tmp_path.iterdir()] == ["a"]
    nameless = dataclasses.replace(recording, epoch=datetime(2021, 1, 1))
    with pytest.raises(InputError, match="epoch has no time zone"):
        gg.write(nameless, tmp_path / "b")


def test_writing_overwrites_only_recordings_and_only_when_told(tmp_path: Path) -> None:
    recording = gg.read(write_files(tmp_path / "a", valid_files()))
    with pytest.raises(InputError, match="not overwritten"):
        gg.write(recording, tmp_path / "a")
    (tmp_path / "a" / "truth.csv").unlink()
    gg.write(recording, tmp_path / "a", overwrite=True)
    assert gg.read(tmp_path / "a").truth is not None
    results = write_files(tmp_path / "results", {"summary.json": "{}"})
    with pytest.raises(InputError, match="holds other files"):
        gg.write(recording, results, overwrite=True)
    assert (results / "summary.json").read_text() == "{}"
    with pytest.raises(InputError, match="is there already"):
        gg.write(recording, write_files(tmp_path, {"c.zip": "mine"}) / "c.zip")


def test_convert_refuses_mixtures(tmp_path: Path) -> None:
    write_files(tmp_path / "a", valid_files())
    write_files(tmp_path, {"x.ecsv": ""})
    with pytest.raises(InputError, match="expected one format"):
        convert([tmp_path / "x.ecsv", tmp_path / "a"], tmp_path / "out")
    with pytest.raises(InputError, match="convert one at a time"):
        convert([tmp_path / "a", tmp_path / "a"], tmp_path / "out")
    with pytest.raises(InputError, match="has its own sensors, sigmas and priors"):
        convert([tmp_path / "a"], tmp_path / "out", sigma_deg=0.1)
    assert not (tmp_path / "out").exists()


def test_the_recording_of_the_document(tmp_path: Path) -> None:
    text = (pathlib.Path(__file__).parents[1] / "docs" / "format.md").read_text(encoding="utf-8")
    header, table = (re.search(f"```{kind}\n(.*?)```", text, re.DOTALL) for kind in ("toml", "csv"))
    assert header is not None
    assert table is not None
    write_files(tmp_path, {"recording.toml": header[1], "bearings.csv": table[1]})
    recording = gg.read(tmp_path)
    assert recording.sensor_names == ("DFNEXT065", "UK000X")
    assert recording.bearings is not None
    assert len(recording.bearings) == 4


def test_the_document_names_every_key_and_column() -> None:
    text = (pathlib.Path(__file__).parents[1] / "docs" / "format.md").read_text(encoding="utf-8")
    columns = CONSTRAINT_COLUMNS + TRUTH_COLUMNS + TRAJECTORY_COLUMNS
    for more in MEASUREMENT_COLUMNS.values():
        columns += more
    names = {spec.names_in_file[0] for spec in columns}
    names |= {*MEASUREMENT_COLUMNS, *_TOP_KEYS, *_SENSOR_KEYS, *_METRE_KEYS}
    names |= {entry.name.replace("_rad", "_deg") for entry in dataclasses.fields(SensorErrors)}
    # How the equations are solved is not a property of a recording.
    names |= {entry.name for entry in dataclasses.fields(SmoothSettings)} - {"elimination"}
    assert {name for name in names if name not in text} == set()


def test_a_long_table_is_read_whole(tmp_path: Path) -> None:
    count = 200_000
    header = 'format = 1\nframe = "local"\n[sensors.S]\nposition_m = [0, 0, 0]\n'
    rows = (f"{0.001 * i!r},S,{i % 360}.123456789,{i % 90}.5,0.01" for i in range(count))
    table = "time_s,sensor,azimuth_deg,elevation_deg,sigma_deg\n" + "\n".join(rows)
    write_files(tmp_path, {"recording.toml": header, "bearings.csv": table})
    recording = gg.read(tmp_path)
    assert recording.bearings is not None
    assert len(recording.bearings) == count
