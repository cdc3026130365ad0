"""The shipped recordings are what their original files say."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
import pytest

import geograph as gg
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
