"""The shipped recordings are what their original files say."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
import pytest

import geograph as gg
from geograph.cli import main
from geograph.errors import InputError
from geograph.examples import titles, write_example
from geograph.scenarios.examples import DATA, make_winchcombe

if TYPE_CHECKING:
    from pathlib import Path


def test_winchcombe_is_made_from_its_originals(tmp_path: Path) -> None:
    pytest.importorskip("astropy")
    make_winchcombe(tmp_path / "winchcombe")
    made, shipped = gg.read(tmp_path / "winchcombe"), gg.read(DATA / "winchcombe")
    assert made.settings == shipped.settings
    assert made.epoch == shipped.epoch
    assert made.sensor_names == shipped.sensor_names
    for name, sensor in shipped.sensors.items():
        np.testing.assert_allclose(made.sensors[name].position_m, sensor.position_m, atol=1e-6)
        ours = dataclasses.asdict(made.sensors[name].errors)
        assert ours == pytest.approx(dataclasses.asdict(sensor.errors), rel=1e-9)
    assert made.bearings is not None
    assert shipped.bearings is not None
    for entry in dataclasses.fields(shipped.bearings):
        np.testing.assert_allclose(
            getattr(made.bearings, entry.name), getattr(shipped.bearings, entry.name), rtol=1e-12
        )
    first_line = (tmp_path / "winchcombe" / "recording.toml").read_text().splitlines()[0]
    assert first_line == (DATA / "winchcombe" / "recording.toml").read_text().splitlines()[0]


def test_winchcombe_keeps_every_direction() -> None:
    rows = 0
    for file in (DATA / "winchcombe" / "original").glob("*.ecsv"):
        lines = [line for line in file.read_text().splitlines() if not line.startswith("#")]
        rows += len(lines) - 1
    shipped = gg.read(DATA / "winchcombe").bearings
    assert shipped is not None
    assert len(shipped) == rows == 800


def test_winchcombe_clock_priors() -> None:
    sensors = gg.read(DATA / "winchcombe").sensors
    assert {name: sensor.errors.clock_offset_s for name, sensor in sensors.items()} == {
        "AMS100": 1.0,
        "GBWL01": 1.0,
        "Loughborou_SW": 1.0,
        "DFNEXT065": 0.01,
        "UK000X": 5.0,
    }


def test_the_example_written_is_the_one_shipped(tmp_path: Path) -> None:
    assert "winchcombe" in titles()
    write_example("winchcombe", tmp_path / "w")
    shipped = {path.relative_to(DATA / "winchcombe") for path in DATA.glob("winchcombe/**/*")}
    written = {path.relative_to(tmp_path / "w") for path in (tmp_path / "w").glob("**/*")}
    assert written == shipped
    assert (tmp_path / "w" / "LICENSE").read_text().startswith("MIT License")


def test_a_set_is_written_as_a_folder_of_recordings_alone(tmp_path: Path) -> None:
    assert titles()["locards"].startswith("LocaRDS: 34 aircraft")
    written = write_example("locards", tmp_path / "l")
    assert written == sorted((tmp_path / "l").iterdir())
    shipped = DATA / "locards" / "recordings"
    assert [path.name for path in written] == sorted(path.name for path in shipped.iterdir())
    for path in written:
        names = {entry.name for entry in path.iterdir()}
        assert names == {entry.name for entry in (shipped / path.name).iterdir()}
        assert {"recording.toml", "arrivals.csv", "LICENSE.md"} <= names


def test_a_set_is_written_again_and_what_else_is_there_stays(tmp_path: Path) -> None:
    (first, *_) = write_example("locards", tmp_path)
    text = (first / "arrivals.csv").read_text()
    (first / "arrivals.csv").write_text("changed")
    (tmp_path / "notes.txt").write_text("mine")
    write_example("locards", tmp_path)
    assert (first / "arrivals.csv").read_text() == text
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_set_is_not_written_into_a_recording(tmp_path: Path) -> None:
    write_example("winchcombe", tmp_path / "w")
    before = sorted((tmp_path / "w").iterdir())
    with pytest.raises(InputError, match="is a recording, and example 'locards' is a set of them"):
        write_example("locards", tmp_path / "w")
    assert sorted((tmp_path / "w").iterdir()) == before


def test_a_set_is_written_whole_or_nothing_of_it_where_a_folder_is_taken(tmp_path: Path) -> None:
    (tmp_path / "set_2-894").mkdir()
    (tmp_path / "set_2-894" / "letter.txt").write_text("mine")
    with pytest.raises(InputError, match=r"set_2-894: holds other files \('letter.txt'\)"):
        write_example("locards", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["set_2-894"]


def test_an_unknown_example_is_told_the_known(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match="unknown example 'locard'; expected one of locards, winch"
    ):
        write_example("locard", tmp_path / "x")


def test_help_and_list_name_every_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["example", "--help"]) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in titles())
    assert main(["example", "--list"]) == 0
    assert capsys.readouterr().out.splitlines() == [f"{n:<16}{t}" for n, t in titles().items()]


def test_the_command_says_how_a_set_is_smoothed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["example", "locards", "-o", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert said == (
        f"wrote 34 recordings into {tmp_path}; smooth them with: "
        f"geograph smooth {tmp_path}/* -o RESULTS\n"
    )
