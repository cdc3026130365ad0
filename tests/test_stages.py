"""Process noise that changes in stages, and process noise found along the velocity."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import geograph as gg
from geograph.cli.run_smooth import settings_from
from geograph.errors import InputError
from geograph.examples import write_example
from geograph.geodesy import ecef_from_geodetic
from geograph.graph import graph_of
from geograph.io import read
from geograph.io.writer import write
from geograph.results.facts import stage_text
from geograph.scenarios import ground_pass
from geograph.scenarios.noise_study import STAGED, WAYS, row, run
from geograph.scenarios.staged_noise import StagedNoise, staged_flight
from geograph.smoother import first_problem
from geograph.stage_search import threshold
from geograph.stages import Stages

# Where McMullan et al. (2023) put the fireball of Winchcombe, from 16 cameras.
WINCHCOMBE = (
    (51.940114, -2.096335, 27554.0),
    (51.932321, -2.214677, 35000.0),
    (51.926179, -2.308090, 40800.0),
    (51.922228, -2.368260, 44500.0),
)


def rms_m(track):
    truth = track.recording.truth
    error = track.at(truth.time_s).position_m - truth.position_m
    return np.sqrt(np.mean(np.sum(error**2, axis=1)))


def test_multiples_of_intervals_add_up_as_variances_do():
    stages = Stages.of([(2.0, 3.0), (5.0, 0.5)])
    np.testing.assert_array_equal(stages.at(np.array([0.0, 2.0, 4.9, 9.0])), [1.0, 3.0, 3.0, 0.5])
    times = stages.over(np.array([0.0, 1.0, 3.0, 5.0, 6.0]))
    np.testing.assert_allclose(times**2, [1.0, 5.0, 9.0, 0.25])
    assert stages.pairs() == ((2.0, 3.0), (5.0, 0.5))


@pytest.mark.parametrize("levels", [1, 2])
def test_the_price_of_a_window(levels):
    expected = 0.5 * chi2.isf(0.01 / (50 * 51 / 2), levels)
    assert threshold(50, levels) == pytest.approx(expected, rel=1e-9)


def test_stages_are_found_and_used():
    flight = staged_flight(1)
    one = gg.smooth(flight.recording, **WAYS["auto"])
    true = gg.smooth(flight.recording)
    track = gg.smooth(flight.recording, **WAYS["stages"])
    found = track.summary["stages"]
    assert [entry["to_s"] for entry in found[:-1]] == pytest.approx(flight.boundary_s, abs=3.0)
    noise = [entry["process_noise"][0] for entry in found]
    assert np.abs(np.log(np.array(noise) / [0.3, 10.0, 0.3])).max() < np.log(2.0)
    assert one.summary["stages"] == []
    assert rms_m(track) < 1.1 * rms_m(true)
    assert rms_m(track) < 0.8 * rms_m(one)
    assert "s: process noise 11.6" in stage_text(found[1])
    # What was found can be given.
    again = gg.smooth(flight.recording, track.settings.replace(spacing_s=None))
    assert again.summary["cost"] == pytest.approx(track.summary["cost"], rel=1e-3)
    assert again.summary["stages"] == found


def test_one_noise_is_not_cut():
    """The chance of a false alarm is 1 % a flight: 5 % in all."""
    kind = StagedNoise(noise=(0.3,), motion="constant-acceleration", events=150)
    for seed in range(5):
        track = gg.smooth(staged_flight(seed, kind).recording, **WAYS["stages"])
        assert track.summary["stages"] == []
        assert track.settings.stages is None


def regular(motion):
    """Return a flight with bearings at whole even seconds, of all four sensors."""
    kind = StagedNoise(motion=motion, noise=(1.0, 5.0), events=124, duration_s=60.0)
    made = staged_flight(3, kind).recording
    bearings = made.bearings
    time = np.repeat(np.arange(0.0, 62.0, 2.0), 4)
    return replace(made, bearings=replace(bearings, time_s=time))


@pytest.mark.parametrize("motion", ["constant-velocity", "constant-acceleration", "ballistic"])
def test_between_knots_and_beyond_them_the_noise_is_that_of_the_stage(motion):
    """Where nothing is measured, knots add nothing: half of them say the same."""
    given = {"stages": ((20.0, 6.0), (40.0, 0.5)), "loss": "none"}
    wide = gg.smooth(regular(motion), spacing_s=2.0, **given)
    fine = gg.smooth(regular(motion), spacing_s=1.0, **given)
    assert fine.time_s.size == 2 * wide.time_s.size - 1
    time = np.array([-3.0, 0.5, 19.0, 20.5, 21.0, 39.0, 41.0, 64.0])
    a, b = wide.at(time), fine.at(time)
    sigma = np.sqrt(np.einsum("nii->ni", b.covariance))
    assert (np.abs(a.state - b.state) / sigma).max() < 1e-3
    for one, other in zip(a.covariance, b.covariance, strict=True):
        assert np.abs(one - other).max() < 1e-4 * np.abs(other).max()


@pytest.mark.parametrize("motion", ["constant-velocity", "ballistic"])
def test_the_graph_has_the_same_stages(motion):
    problem, values = first_problem(
        regular(motion),
        gg.SmoothSettings(motion=motion, process_noise=1.0, stages=((20.0, 6.0),), spacing_s=10.0),
    )
    values = replace(values, path=values.path * 1.001)
    built = graph_of(problem, values)
    assert built.graph.error(built.values) == pytest.approx(problem.cost(values), rel=1e-9)
    system = built.graph.linearize(built.values).hessian()[0]
    other, _ = graph_of(problem.with_stages(problem.motion, None), values)
    assert not np.allclose(other.linearize(built.values).hessian()[0], system)


@pytest.mark.parametrize(
    "given", ["none", 3.0, (), ((1.0, 2.0, 3.0),), ((2.0, 1.0), (1.0, 1.0)), ((0.0, 0.0),)]
)
def test_stages_that_are_none(given):
    with pytest.raises(InputError, match="or pairs"):
        gg.SmoothSettings(stages=given)


def test_stages_in_files_and_flags(tmp_path):
    made = staged_flight(0, StagedNoise(events=20)).recording
    assert isinstance(made.settings.stages, tuple)
    write(made, tmp_path / "rec")
    assert read(tmp_path / "rec").settings == made.settings
    header = tmp_path / "rec" / "recording.toml"
    text = header.read_text()
    line = next(line for line in text.splitlines() if line.startswith("stages"))
    for bad, message in (("[1.0]", "pairs"), ('"all"', "auto"), ("[[1.0, -1.0]]", "above 0")):
        header.write_text(text.replace(line, f"stages = {bad}"))
        with pytest.raises(InputError, match=message):
            read(tmp_path / "rec")
    assert settings_from({"stages": "auto"}) == {"stages": "auto"}
    assert settings_from({"stages": "none"}) == {"stages": None}
    assert settings_from({"stages": "10:3,20:0.5"}) == {"stages": ((10.0, 3.0), (20.0, 0.5))}
    with pytest.raises(InputError, match="FROM_S:TIMES"):
        settings_from({"stages": "10"})


def test_the_incremental_smoother_says_what_to_do_instead():
    made = staged_flight(0, StagedNoise(events=20)).recording
    with pytest.raises(InputError, match="call change_process_noise"):
        gg.IncrementalSmoother.of(made)
    gg.IncrementalSmoother.of(made, stages=None)


def test_a_first_guess_of_much_noise_does_not_win_by_its_cost():
    """Of this pass's first guesses one is rough: its noise, a guess as well, fits anything."""
    track = gg.smooth(ground_pass(109), process_noise="auto", raise_on_failure=False)
    assert track.status == "converged"
    assert rms_m(track) < 1000.0


def test_winchcombe_without_a_hand_picked_noise(tmp_path):
    recording = gg.read(write_example("winchcombe", tmp_path / "w")[0])

    def away(track):
        path = track.at(np.linspace(*track.time_s[[0, -1]], 3000)).position_m
        return [np.linalg.norm(path - ecef_from_geodetic(*p), axis=1).min() for p in WINCHCOMBE]

    picked, found = gg.smooth(recording), gg.smooth(recording, process_noise="auto")
    assert picked.settings.process_noise == 10.0
    assert found.settings.process_noise_along > 5.0 * found.settings.process_noise
    assert (np.array(away(found)) <= away(picked)).all()
    # Its errors change with the object's place in the picture (correlation of frames: 0.95).
    assert found.summary["sensors"]["AMS100"]["worth"] < 20.0


def test_the_study():
    outcome = run(STAGED["bearings, constant acceleration"], range(2, 4))
    assert outcome.failed == 0
    assert (outcome.stages == 3).all()
    assert outcome.ratio("stages")[0] < outcome.ratio("auto")[0]
    assert row("some", outcome).count("|") == 11
