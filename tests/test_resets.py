"""Errors that begin anew: at known times, and at times that are found."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from recordings import HEADER, valid_files, write_files

import geograph as gg
from geograph.eliminate import response
from geograph.reset_scan import Scanner, _statistics, rows_covariance
from geograph.scenarios.angles_worlds import angles_trial, variant
from geograph.scenarios.registry import scenario
from geograph.scenarios.resets_study import (
    accuracy_table,
    compare,
    detection_table,
    false_alarm_row,
    found_resets,
    known,
    with_times,
)
from geograph.sensors import Sensor, SensorErrors
from geograph.states import AZIMUTH, CLOCK, ELEVATION, SensorErrorTerms, SensorStates

SMALL = variant("levy-simple-calibrated", sensors=(3, 3), bearings=(60, 90))


def sensor(**changes):
    errors = SensorErrors(
        azimuth_bias_rad=0.1, azimuth_drift_rad_s=0.01, azimuth_instability_rad_sqrt_s=0.05,
        clock_offset_s=2.0,
    )  # fmt: skip
    return Sensor(name="A", position_m=np.zeros(3), errors=errors, **changes)


def test_every_stretch_has_its_own_bias_and_drift_and_a_walk_from_zero():
    states = SensorStates(
        [sensor(calibrations_s=(10.0, 20.0), clock_resets_s=(15.0,)), sensor()], [0, 1], 1.0
    )
    own = [state.name for state in states.constants if state.sensor == 0]
    assert own == [
        *("azimuth_bias", "azimuth_drift", "azimuth_bias_2", "azimuth_drift_2"),
        *("azimuth_bias_3", "azimuth_drift_3", "clock_offset", "clock_offset_2"),
    ]
    time = np.array([3.0, 10.0, 16.0, 25.0, 25.0])
    knots, scale = np.array([0.0, 8.0, 18.0, 30.0]), np.array([0.5, 0.5])
    which = np.array([0, 0, 0, 0, 1])
    terms = SensorErrorTerms(states, which, time, scale)
    constants = np.arange(1.0, states.size + 1.0)
    walks = np.array([[0.0, 0.0], [2.0, 2.0], [4.0, 4.0], [6.0, 6.0]])
    interval = np.searchsorted(knots, time, side="right") - 1
    found = terms.errors(constants, walks, terms.share(knots, interval, time))
    expected = [
        0.1 * 1 + 0.01 * 2 * 2.0 + 0.5 * 2.0 * 3.0 / 8.0,
        # Between knots 8 and 18 the later one alone is after the calibration.
        0.1 * 3 + 0.01 * 4 * 0.0 + 0.5 * 4.0,
        0.1 * 3 + 0.01 * 4 * 6.0 + 0.5 * 4.0,
        0.1 * 5 + 0.01 * 6 * 5.0 + 0.5 * 6.0,
        0.1 * 9 + 0.01 * 10 * 24.0 + 0.5 * (4.0 + 2.0 * 7.0 / 12.0),
    ]
    np.testing.assert_allclose(found[:, AZIMUTH], expected, rtol=1e-14)
    np.testing.assert_allclose(found[:, CLOCK], [14.0, 14.0, 16.0, 16.0, 22.0], rtol=1e-14)
    matrix, root = states.chain_transitions(knots, scale)
    np.testing.assert_allclose(matrix[:, 0, 0], [1.0, 1e-3, 1e-3])
    np.testing.assert_allclose(
        root[:, 0, 0], [0.1 * np.sqrt(8.0), *np.hypot(1e-3, 0.1 * np.sqrt([8.0, 10.0]))]
    )
    np.testing.assert_allclose(matrix[:, 1, 1], 1.0)


def test_a_known_calibration_is_as_good_as_another_sensor():
    """A sensor before and another one after it: the same path, errors and covariance."""
    world = replace(SMALL, calibrations=(1, 1), calibrations_known=True, instability_rad_sqrt_s=0.0)
    trial = angles_trial(5, world)
    recording, bearings = trial.recording, trial.recording.bearings
    sensors, index = dict(recording.sensors), bearings.sensor.copy()
    for number, name in enumerate(recording.sensor_names):
        (begun,) = sensors[name].calibrations_s
        sensors[name] = replace(sensors[name], calibrations_s=())
        # Counted from elsewhere a drift changes the prior of the bias: without one here.
        sensors[f"{name} later"] = replace(sensors[name], name=f"{name} later")
        index[(index == number) & (bearings.time_s >= begun)] = len(sensors) - 1

    def drop(entry):
        errors = replace(entry.errors, azimuth_drift_rad_s=0.0, elevation_drift_rad_s=0.0)
        return replace(entry, errors=errors)

    def plain(one):
        return replace(one, sensors={name: drop(entry) for name, entry in one.sensors.items()})

    one = gg.smooth(plain(recording))
    two = gg.smooth(
        plain(replace(recording, sensors=sensors, bearings=replace(bearings, sensor=index)))
    )
    scale = np.sqrt(np.diagonal(two.covariance, axis1=1, axis2=2))
    assert np.abs((one.state - two.state) / scale).max() < 1e-4
    np.testing.assert_allclose(one.covariance, two.covariance, rtol=1e-4, atol=1e-4 * scale.max())
    got = one.sensor_errors["S1"]["azimuth_bias_2"]
    assert got.estimate == pytest.approx(
        two.sensor_errors["S1 later"]["azimuth_bias"].estimate, rel=1e-5
    )


@pytest.fixture(scope="module")
def solved():
    trial = angles_trial(1, replace(SMALL, calibrations=(0, 0)))
    return gg.smooth(trial.recording)


def test_covariances_between_measurements_are_those_of_the_whole_system(solved):
    """Against the covariance of all unknowns with one function of one knot."""
    problem = solved.problem
    system = problem.linearise(solved.values)
    elimination = system.factorise()
    rng = np.random.default_rng(3)
    d, width = problem.layout.knot, problem.layout.width - 1
    interval = np.array([0, 2, 2, 7])
    rows = rng.standard_normal((4, 2, width))
    # The last one feels one knot alone.
    rows[3, :, d:] = 0.0
    found = rows_covariance(rows, interval, problem.layout, elimination, elimination.marginals())
    for channel in range(2):
        step = response(system, 7, rows[3, channel, :d])
        expected = [
            row[:d] @ step.knots[k]
            + row[d : 2 * d] @ step.knots[k + 1]
            + row[2 * d :] @ step.constants
            for k, pair in zip(interval, rows, strict=True)
            for row in pair
        ]
        np.testing.assert_allclose(found[:, 6 + channel], expected, rtol=1e-6)
    np.testing.assert_allclose(found, found.T)


def test_the_statistic_is_what_one_more_state_gains(solved):
    """T is twice what the cost falls by when a bias from some measurement on becomes a state."""
    problem, recording = solved.problem, solved.recording
    family = problem.families[0]
    rows = family.sensor == 1
    time = np.sort(family.time_s[rows])
    at = 31
    # An error of which nothing is known beforehand, so that the two do not differ by priors.
    wide = {
        name: replace(
            entry, errors=replace(SensorErrors(), azimuth_bias_rad=1e-2, elevation_bias_rad=1e-2)
        )
        for name, entry in recording.sensors.items()
    }
    free = gg.smooth(replace(recording, sensors=wide))
    begun = 0.5 * (time[at - 1] + time[at])
    wide["S2"] = replace(wide["S2"], calibrations_s=(begun,))
    cut = gg.smooth(replace(recording, sensors=wide))
    assert free.problem.states.size == cut.problem.states.size - 2
    gained = 2.0 * (free.summary["cost"] - cut.summary["cost"])
    elimination = free.problem.linearise(free.values).factorise()
    solution = type("Solved", (), {"values": free.values, "elimination": elimination})()
    scanner = Scanner(free.problem, solution, 0, (AZIMUTH, ELEVATION))
    stretch = scanner.rows_of(1)
    stretch = replace(stretch, scatter=1.0)
    found = scanner.exact(stretch.part(0, len(time)), at, 0.0)
    assert found is not None
    # The jump at that measurement itself, and not at the best one nearby.
    g = stretch.rows[:, :, :-1]
    size = g.shape[1]
    covariance = -rows_covariance(
        g, stretch.interval, scanner.layout, elimination, scanner.marginals
    ).reshape(len(g), size, len(g), size)
    index = np.arange(len(g))
    covariance[index, :, index, :] += stretch.information
    table = np.zeros((len(g) + 1, len(g) + 1, size, size))
    table[1:, 1:] = np.moveaxis(covariance, 2, 1).cumsum(axis=0).cumsum(axis=1)
    score = np.concatenate([np.zeros((1, size)), np.cumsum(stretch.rows[:, :, -1], axis=0)])
    best = _statistics(table, score, (np.array([at]), np.array([len(g)])), stretch.prior)
    assert best[0] == pytest.approx(gained, rel=2e-2, abs=1e-2)
    assert found[1] >= best[0] - 1e-9


def test_jumps_are_found_where_they_are():
    world = replace(SMALL, calibrations=(1, 2))
    trial = angles_trial(11, world)
    track = gg.smooth(trial.recording)
    found = found_resets(trial, track)
    assert (found.missed, found.false) == (0, 0)
    assert set(found.delay) == {0}
    truth = trial.sensor_truth
    for entry in track.summary["resets"]:
        assert entry["found"]
        own = truth.sensor == truth.names.index(entry["sensor"])
        at = int(np.searchsorted(truth.time_s[own], entry["time_s"]))
        jump = np.degrees(np.diff(truth.error[own], axis=0)[at - 1])
        for axis, name in enumerate(("azimuth", "elevation")):
            # 12 jumps, one of them beyond 4.5 sigmas once in 10 000 times; the walk goes on.
            sigma = entry[f"{name}_jump_sigma_deg"]
            assert abs(entry[f"{name}_jump_deg"] - jump[axis]) < 4.5 * sigma
    assert track.summary["chi2"] == pytest.approx(track.summary["degrees_of_freedom"], rel=0.25)
    # What is told of the errors over time jumps with them.
    entry = track.summary["resets"][0]
    low, high = entry["between_s"]
    estimate, sigma = track.sensor_error_at(entry["sensor"], "azimuth", [low, high])
    assert np.degrees(np.diff(estimate)[0]) == pytest.approx(
        entry["azimuth_jump_deg"], abs=3.0 * np.degrees(sigma.max())
    )
    same = gg.smooth(with_times(trial, known))
    gap = (track.at(300.0).position_m - same.at(300.0).position_m)[0]
    assert gap @ np.linalg.solve(same.at(300.0).position_covariance_m2[0], gap) < 0.1


def test_small_jumps_are_found_nearby_and_gross_errors_are_not_jumps():
    """6 sigmas among 270 measurements, 12 of them anywhere on the sky."""
    world = replace(SMALL, bearings=(90, 90), calibrations=(1, 1), outliers=12)
    trial = angles_trial(8, replace(world, jump_rad=30e-6))
    track = gg.smooth(trial.recording)
    assert len(track.summary["rejected"]) == 12
    found = found_resets(trial, track)
    assert (found.missed, found.false) == (0, 0)
    assert np.abs(found.delay).max() <= 3


def test_without_jumps_none_is_found():
    for seed in range(5):
        trial = angles_trial(seed, replace(SMALL, calibrations=(0, 0)))
        assert gg.smooth(trial.recording).summary["resets"] == []


def test_the_incremental_smoother_takes_known_times_and_refuses_to_find_them():
    world = replace(SMALL, calibrations=(1, 1), calibrations_known=True)
    recording = angles_trial(4, world).recording
    batch = gg.smooth(recording)
    smoother = gg.IncrementalSmoother.of(recording)
    for part in np.array_split(np.arange(len(recording.bearings)), 6):
        columns = {name: column[part] for name, column in vars(recording.bearings).items()}
        smoother.update(replace(recording.bearings, **columns))
    track = smoother.track()
    at = 300.0
    gap = (track.at(at).position_m - batch.at(at).position_m)[0]
    assert gap @ np.linalg.solve(batch.at(at).position_covariance_m2[0], gap) < 0.01
    assert "azimuth_bias_2" in track.sensor_errors["S1"]
    unknown = angles_trial(4, replace(world, calibrations_known=False)).recording
    with pytest.raises(gg.InputError, match="'S1' has calibrations_s = auto, which only the batch"):
        gg.IncrementalSmoother.of(unknown)


def written(folder, header):
    return write_files(folder, valid_files() | {"recording.toml": header})


def with_keys(text, errors=""):
    header = HEADER.replace('axes = "enu"\n', f'axes = "enu"\n{text}\n', 1)
    return header.replace("clock_offset_s = 1.0\n", f"clock_offset_s = 1.0\n{errors}")


def test_times_of_resets_are_written_and_read_again(tmp_path):
    text = "calibrations_s = [1.5, 2.25]\nclock_resets_s = [2.5]"
    for number, (line, expected) in enumerate(
        ((text, (1.5, 2.25)), ('calibrations_s = "auto"', "auto"))
    ):
        recording = gg.read(written(tmp_path / f"in{number}", with_keys(line)))
        assert recording.sensors["A"].calibrations_s == expected
        again = gg.write(recording, tmp_path / f"out{number}")
        assert again.sensors["A"].calibrations_s == expected
        assert again.sensors["A"].clock_resets_s == recording.sensors["A"].clock_resets_s


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("calibrations_s = 3.0", "is 3.0; expected a list of times"),
        ("calibrations_s = [3.0, 2.0]", "has 2 after 3; expected a list of times"),
        ('clock_resets_s = "auto"', "is 'auto'; expected a list of times"),
        ("calibrations_s = [nan]", "calibrations_s"),
    ],
)
def test_bad_times_of_resets_are_told(tmp_path, text, message):
    with pytest.raises(gg.InputError, match=message) as caught:
        gg.read(written(tmp_path / "in", with_keys(text)))
    assert "recording.toml:9" in str(caught.value) or caught.value.line is not None


def test_resets_need_an_error_that_begins_anew():
    for changes in ({"calibrations_s": "auto"}, {"clock_resets_s": (1.0,)}):
        with pytest.raises(gg.InputError, match="no error that begins anew"):
            Sensor(name="A", position_m=np.zeros(3), **changes)
    with pytest.raises(gg.InputError, match="expected increasing times"):
        sensor(calibrations_s=(2.0, 1.0))


def test_header_refuses_calibrations_without_errors(tmp_path):
    header = HEADER.replace("azimuth_bias_deg = 0.01\n", "").replace(
        'axes = "enu"\n', 'axes = "enu"\ncalibrations_s = "auto"\n', 1
    )
    with pytest.raises(gg.InputError, match="no error that would begin anew"):
        gg.read(written(tmp_path / "in", header))


def test_simulated_sensors_come_with_their_true_errors(tmp_path):
    chosen = scenario("levy-simple-calibrated")
    values = {"sensors": (2, 2), "bearings": (30, 30), "calibrations": (1, 1)}
    files = chosen.files_beside(3, values)
    gg.write(chosen.simulate(3, values), tmp_path / "pass", beside=files)
    assert gg.read(tmp_path / "pass").sensors["S1"].calibrations_s == "auto"
    with (tmp_path / "pass/truth_calibrations.csv").open() as file:
        begun = {row["sensor"]: float(row["time_s"]) for row in csv.DictReader(file)}
    with (tmp_path / "pass/truth_sensors.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 60
    for name, time in begun.items():
        own = [row for row in rows if row["sensor"] == name]
        value = np.array([float(row["azimuth_error_deg"]) for row in own])
        after = np.array([float(row["time_s"]) for row in own]) > time
        for part in (value[after], value[~after]):
            # 0.1 urad/s and a walk of as much in 600 s, beside biases to 500 urad.
            assert part.size < 2 or np.ptp(part) < np.degrees(8e-5)
    assert scenario("room").files_beside(0) == {}


def test_resets_are_held_against_true_ones():
    time = np.arange(100.0)
    found = compare(time, np.array([10.5, 50.5, 90.5]), [11.5, 48.5, 70.0])
    assert sorted(found.delay) == [-2, 1]
    assert (found.missed, found.false) == (1, 1)
    empty = compare(time, np.array([200.0]), [])
    assert (empty.delay, empty.missed, empty.false) == ((), 0, 0)


def test_study_prints_its_tables(monkeypatch):
    from geograph.scenarios import resets_study

    monkeypatch.setattr(resets_study, "JUMPS", (30.0,))
    own = {"sensors": SMALL.sensors, "bearings": SMALL.bearings}
    monkeypatch.setattr(
        resets_study, "_world", lambda _, **changes: replace(SMALL, **(changes | own))
    )
    assert "| 30 | 3 | 100.0 |" in detection_table("levy-simple", range(1))
    assert false_alarm_row("levy-simple", range(1)) == "| levy-simple | 1 | 0 | 95.00 |"
    table = accuracy_table("levy-simple", range(1), calibrations=(1, 1)).splitlines()
    assert [row.split("|")[1].strip() for row in table[2:]] == [
        *("times known", "found", "not handled")
    ]
    good, bad = (float(row.split("|")[4]) for row in (table[3], table[4]))
    assert good < 5.0 < bad
    json.dumps(table)
