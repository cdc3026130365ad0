"""``geograph simulate``: every scenario is a recording that reads back, with its truth."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from geograph.cli import main
from geograph.errors import InputError
from geograph.io import read
from geograph.scenarios import parameters
from geograph.scenarios.angles_worlds import WORLDS, angles_recording
from geograph.scenarios.moving_sensors import VARIANTS
from geograph.scenarios.registry import scenario, scenarios, simulate
from geograph.scenarios.sound import Microphones

# One of each kind of world; the variants of one study differ in numbers alone.
KINDS = [
    *WORLDS,
    "low-orbit",
    "fireball",
    "aircraft-cameras",
    "room",
    "microphones",
    "multilateration",
    "indoor",
    "drone",
    "ship",
    "formation",
    "platforms",
    "degenerate-two-arrivals",
    "kallin-5-5deg",
    "kallin-road-mountains",
    "camlica-emitter-1-straight-0.75m",
]


def test_every_scenario_has_title_source_and_parameters():
    known = scenarios()
    assert set(KINDS) <= set(known)
    assert sum(name.startswith("camlica-") for name in known) == len(VARIANTS)
    for name, each in known.items():
        assert each.name == name
        assert each.title
        assert each.source
        for key, value in each.parameters().items():
            assert each.parse(key, parameters.show(value)) == value, key


@pytest.mark.parametrize("name", KINDS)
def test_a_scenario_is_written_with_truth_and_reads_back(name, tmp_path, capsys):
    assert main(["simulate", name, "-o", str(tmp_path / "one"), "--seed", "5"]) == 0
    assert "with the truth; smooth it with: geograph smooth" in capsys.readouterr().out
    found, made = read(tmp_path / "one"), simulate(name, {}, 5)
    assert found.sensor_names == made.sensor_names
    np.testing.assert_array_equal(found.truth.position_m, made.truth.position_m)
    for kind, table in made.tables.items():
        assert len(found.tables[kind]) == len(table)
    low, high = made.time_span_s
    assert made.truth.time_s[0] <= low + 0.1 * (high - low)
    assert made.truth.time_s[-1] >= high - 0.1 * (high - low)


def test_seeds_and_parameters_make_the_recording(tmp_path):
    def measured(*arguments):
        folder = tmp_path / "again"
        assert main(["simulate", "levy-simple", "-o", str(folder), *arguments]) == 0
        return (folder / "bearings.csv").read_bytes()

    first = measured("--seed", "3", "--set", "sensors=3", "--set", "bearings=20:30")
    assert first == measured("--seed", "3", "--set", "bearings=20:30", "--set", "sensors=3:3")
    assert first != measured("--seed", "4", "--set", "sensors=3", "--set", "bearings=20:30")
    own = angles_recording(3, "levy-simple", sensors=(3, 3), bearings=(20, 30))
    assert len(first.splitlines()) == len(own.bearings) + 1


def test_parameters_are_of_their_defaults_types():
    kind = Microphones()
    assert parameters.parse(kind, "tone_hz", "440") == 440.0
    assert parameters.parse(kind, "tone_hz", "none") is None
    assert parameters.parse(kind, "flat", "yes") is True
    assert parameters.parse(kind, "heard", "pairs") == "pairs"
    assert parameters.parse(kind, "claps", "12") == 12
    world = WORLDS["levy-staged"]
    changed = parameters.changed(world, {"stages.count": 2, "sensors": (4, 4)})
    assert changed == dataclasses.replace(
        world, sensors=(4, 4), stages=dataclasses.replace(world.stages, count=2)
    )
    drone = scenario("drone")
    assert drone.parse("kinds", "time:frequency") == ("time", "frequency")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("claps", "1.5", r"claps=1.5; expected a whole number from 0 to 1000000$"),
        ("claps", "1e9", r"claps=1e9; expected a whole number from 0"),
        ("claps", "many", r"claps=many; expected a whole number$"),
        ("sigma_s", "none", r"sigma_s=none; expected a number$"),
        ("sigma_s", "nan", r"sigma_s=nan; expected a number$"),
        ("tone_hz", "loud", r"tone_hz=loud; expected a number or none$"),
        ("flat", "perhaps", r"flat=perhaps; expected true or false$"),
        ("clap", "3", r"unknown parameter 'clap'; did you mean claps"),
    ],
)
def test_what_does_not_fit_a_parameter_is_said(name, text, message):
    with pytest.raises(InputError, match=message):
        parameters.parse(Microphones(), name, text)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["levvy-simple"], "unknown scenario 'levvy-simple'; did you mean levy-simple or"),
        ([], "expected a scenario and -o DIR"),
        (["levy-simple", "--set", "sensors"], "--set 'sensors'; expected NAME=VALUE"),
        (["levy-simple", "--set", "sensors=1:2:3"], "sensors=1:2:3; expected 2 numbers"),
        (["levy-simple", "--set", "sensors=1"], "1 sensors; expected at least 2"),
        (["levy-simple", "--set", "bearings=0"], "cannot be simulated"),
        (["room", "--set", "order=2", "--set", "order=3"], "--set order is given twice"),
        (["room", "--set", "path=x"], "scenario room: unknown parameter 'path'"),
        (["room", "--set", "sigma_rad=-1"], "a sigma_azimuth_rad of -1; expected above 0"),
        (["room", "--seed", "-1"], "Invalid value for '--seed'"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(arguments, message, tmp_path, capsys):
    assert main(["simulate", *arguments, "-o", str(tmp_path / "new")]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_the_list_shows_scenarios_and_parameters(capsys):
    assert main(["simulate", "--list"]) == 0
    shown = capsys.readouterr().out
    assert all(f"{name} " in shown for name in scenarios())
    assert main(["simulate", "levy-staged", "--list"]) == 0
    shown = capsys.readouterr().out
    assert "Levy et al." in shown
    assert "  stages.thrust_m_s2      3.0" in shown
