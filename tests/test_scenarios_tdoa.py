"""The scenarios of moving sensors: geometry, noise, recordings and bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from geograph import read, write
from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.scenarios.moving_sensors import (
    EMITTERS_M,
    FIRST_GROUP_M,
    SECOND_GROUP_M,
    VARIANTS,
    MovingSensors,
    arrival_times,
    recordings,
    simulate,
)
from geograph.scenarios.tdoa_bound import bound_covariance, bound_m

# Camlica 2009, by the reference notes: bounds with the sensors known, with position noise that is
# independent at every set, and with platforms known to fly straight; emitters 1 and 2.
KNOWN = {1: (31.87, 159.3, 318.7), 2: (41.19, 205.9, 411.9)}
NOISY = {1: (46.3, 254.1, 505.2), 2: (59.9, 328.4, 653.0)}
STRAIGHT = {1: (46.3, 249.4, 472.3), 2: (59.8, 323.5, 617.1)}


@pytest.mark.parametrize("number", [1, 2])
def test_bounds_are_those_of_the_reference(number: int) -> None:
    """To half a unit of the last digit given (and 0.01 for what was rounded twice)."""
    for nanoseconds, expected in zip((1, 5, 10), KNOWN[number], strict=True):
        half = 0.006 if nanoseconds == 1 else 0.06
        ours = bound_m(VARIANTS[f"emitter-{number}-{nanoseconds}ns"])
        assert ours == pytest.approx(expected, abs=half)
    for kind, values in (("position", NOISY), ("straight", STRAIGHT)):
        for noise, expected in zip((0.1, 0.75, 1.5), values[number], strict=True):
            ours = bound_m(VARIANTS[f"emitter-{number}-{kind}-{noise}m"])
            assert ours == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize(
    "name", ["emitter-1-1ns", "emitter-2-moving-60m_s", "emitter-1-two-groups", "emitter-2-1ns"]
)
def test_bound_is_that_of_differences_with_their_covariance(name: str) -> None:
    """Derivatives by differences of the simulated arrivals, weights by the inverse of H N H'."""
    variant = VARIANTS[name]
    size = 4 if variant.moving else 2
    last = variant.time_s[-1]
    step = np.array([10.0, 10.0, 0.1, 0.1])[:size]
    sets = np.arange(variant.sets)[:, None]

    def heard(change: np.ndarray) -> np.ndarray:
        velocity = np.zeros(2) if size == 2 else change[2:]
        place = np.array(variant.emitter_m) + change[:2] - velocity * last
        moved = replace(
            variant,
            emitter_m=tuple(place),
            emitter_velocity_m_s=tuple(np.array(variant.emitter_velocity_m_s) + velocity),
        )
        return arrival_times(moved)[sets, variant.heard_by]

    columns = [(heard(row) - heard(-row)) / (2.0 * row.sum()) for row in np.diag(step)]
    jacobian = SPEED_OF_LIGHT_M_S * np.stack(columns, axis=-1)
    to_third = np.delete(np.eye(4), 2, axis=0) - np.eye(4)[2]
    differences = to_third @ jacobian
    noise = to_third @ to_third.T * (SPEED_OF_LIGHT_M_S * variant.sigma_s) ** 2
    information = np.einsum("kna,nm,kmb->ab", differences, np.linalg.inv(noise), differences)
    np.testing.assert_allclose(np.linalg.inv(information), bound_covariance(variant), rtol=2e-3)


def test_what_more_is_known_lowers_the_bound() -> None:
    for number in (1, 2):
        for noise in (0.1, 0.75, 1.5):
            known = bound_m(VARIANTS[f"emitter-{number}-1ns"])
            straight = bound_m(VARIANTS[f"emitter-{number}-straight-{noise}m"])
            noisy = bound_m(VARIANTS[f"emitter-{number}-position-{noise}m"])
            assert known < straight < noisy
    # Twice as many sets, half of them on the way back over the same places.
    there, back = (bound_m(VARIANTS[f"emitter-1-{name}"]) for name in ("1ns", "turn-back"))
    assert back == pytest.approx(there / np.sqrt(2.0), rel=1e-3)


def test_every_variant_of_the_thesis_is_there_for_both_emitters() -> None:
    for number, place in enumerate(EMITTERS_M, start=1):
        of_emitter = [v for v in VARIANTS.values() if v.name.startswith(f"emitter-{number}-")]
        assert len(of_emitter) == 18
        assert {v.emitter_m for v in of_emitter} == {place}
        assert {v.sigma_toa_s for v in of_emitter} == {1e-9, 5e-9, 10e-9}
        assert {v.common_offset_m for v in of_emitter} == {0.0, 5.0, 20.0, 50.0}
        assert {v.emitter_velocity_m_s[0] for v in of_emitter} == {0.0, 30.0, 60.0, 90.0}
        assert {len(v.group_m) for v in of_emitter} == {3, 4}
    standard = VARIANTS["emitter-1-1ns"]
    assert standard.sigma_s == pytest.approx(1e-9 / np.sqrt(10.0))
    np.testing.assert_array_equal(standard.time_s, np.arange(2.0, 121.0, 2.0))


@pytest.mark.parametrize("name", list(VARIANTS))
def test_arrivals_obey_the_light_time_equation(name: str) -> None:
    variant = VARIANTS[name]
    toa = arrival_times(variant)
    emission = variant.time_s[:, None]
    emitter = variant.emitter_at(variant.time_s)[:, None]
    travelled = np.linalg.norm(variant.sensors_at(toa) - emitter, axis=-1)
    # A time of 240 s has a last bit of 9 micrometres.
    np.testing.assert_allclose(SPEED_OF_LIGHT_M_S * (toa - emission), travelled, atol=2e-5)
    moved = np.linalg.norm(variant.sensors_at(toa) - variant.sensors_at(emission), axis=-1)
    if variant.turn_back_s is None:
        assert 0.013 < moved.min() < moved.max() < 0.019


def test_sensors_fly_along_x_and_turn_back() -> None:
    variant = VARIANTS["emitter-1-turn-back"]
    times = np.array([[0.0], [100.0], [120.0], [140.0], [240.0]])
    place = variant.sensors_at(times)
    np.testing.assert_array_equal(place[..., 1], np.tile(np.array(FIRST_GROUP_M)[:, 1], (5, 1)))
    along = place[..., 0] - np.array(FIRST_GROUP_M)[:, 0]
    np.testing.assert_array_equal(along, np.tile([[0.0], [5e3], [6e3], [5e3], [0.0]], (1, 4)))


def test_second_group_takes_over_half_way() -> None:
    variant = VARIANTS["emitter-1-two-groups"]
    runs = simulate(variant, [0])
    np.testing.assert_array_equal(runs.sensor[29], [0, 1, 2, 3])
    np.testing.assert_array_equal(runs.sensor[30], [4, 5, 6, 7])
    start = np.array(SECOND_GROUP_M)
    np.testing.assert_allclose(runs.sensor_m[0, 30] - start, np.tile([62 * 50.0, 0.0], (4, 1)))


def test_noise_has_the_stated_spread_and_is_independent() -> None:
    """Two-sided, false alarm 1e-6 for each of the sums of squares and of the correlations."""
    variant = VARIANTS["emitter-2-position-0.75m"]
    runs = simulate(variant, range(300))
    true = variant.sensors_at(variant.time_s[:, None])
    for error, sigma in (
        (runs.toa_s - arrival_times(variant), variant.sigma_s),
        (runs.sensor_m - true, 0.75),
    ):
        square = float(np.sum((error / sigma) ** 2))
        low, high = chi2.ppf([5e-7, 1.0 - 5e-7], error.size)
        assert low < square < high
        flat = error.reshape(300, -1)[:, : 60 * 4]
        for shifted in (np.roll(flat, 1, axis=0), np.roll(flat, 1, axis=1)):
            correlation = float(np.mean(flat * shifted)) / sigma**2
            assert abs(correlation) < 4.9 / np.sqrt(flat.size)


def test_runs_are_seeded_each_and_by_variant() -> None:
    variant = VARIANTS["emitter-1-1ns"]
    several = simulate(variant, [5, 6, 7])
    np.testing.assert_array_equal(several.toa_s[1], simulate(variant, [6]).toa_s[0])
    assert not np.array_equal(several.toa_s[0], several.toa_s[1])
    noise = several.toa_s - arrival_times(variant)
    other = VARIANTS["emitter-1-5ns"]
    scaled = simulate(other, [5, 6, 7]).toa_s - arrival_times(other)
    assert not np.allclose(scaled, 5.0 * noise, atol=1e-11)


@pytest.mark.parametrize(
    "name", ["emitter-1-1ns", "emitter-2-straight-1.5m", "emitter-1-two-groups"]
)
def test_recordings_hold_the_simulated_runs(name: str) -> None:
    variant = VARIANTS[name]
    runs = simulate(variant, [3, 4])
    for index, recording in enumerate(recordings(variant, [3, 4])):
        assert recording.name == f"{name}-{3 + index}"
        assert recording.frame == "local"
        assert recording.propagation_speed_m_s == SPEED_OF_LIGHT_M_S
        arrivals = recording.arrivals
        assert arrivals is not None
        toa = arrivals.toa_s.reshape(runs.toa_s.shape[1:])
        np.testing.assert_array_equal(toa, runs.toa_s[index])
        np.testing.assert_array_equal(arrivals.sensor.reshape(toa.shape), runs.sensor)
        np.testing.assert_array_equal(arrivals.sigma_s, variant.sigma_s)
        np.testing.assert_array_equal(np.bincount(arrivals.emission), 4)
        sensors = list(recording.sensors.values())
        for k, time in enumerate(runs.time_s):
            for column, sensor in enumerate(runs.sensor[k]):
                at = sensors[sensor].position_at(time)
                np.testing.assert_allclose(at[:2], runs.sensor_m[index, k, column], atol=1e-6)
                assert at[2] == 0.0


def test_recordings_say_what_is_known() -> None:
    straight = next(recordings(VARIANTS["emitter-1-straight-0.75m"], [0]))
    noisy = next(recordings(VARIANTS["emitter-1-position-0.75m"], [0]))
    assert all(s.platform_process_noise == 0.0 for s in straight.sensors.values())
    assert all(s.platform_process_noise is None for s in noisy.sensors.values())
    assert {s.errors.position_noise_m for s in noisy.sensors.values()} == {0.75}
    offset = next(recordings(VARIANTS["emitter-1-offset-20m"], [0]))
    np.testing.assert_allclose(offset.sensors["S1"].position_at(0.0), [1020.0, 0.0, 0.0], atol=1e-6)
    assert noisy.settings.motion == "static"
    moving = next(recordings(VARIANTS["emitter-2-moving-90m_s"], [0]))
    assert moving.settings.motion == "constant-velocity"
    assert moving.truth is not None
    np.testing.assert_allclose(moving.truth.position_m[60], [65e3 + 120.0 * 90.0, 80e3, 0.0])
    assert moving.constraints is not None
    assert moving.constraints.kind == ("altitude_m",)


def test_impossible_groups_are_refused() -> None:
    with pytest.raises(ValueError, match="2 sensors; expected at least 3"):
        MovingSensors(name="few", group_m=FIRST_GROUP_M[:2])
    with pytest.raises(ValueError, match="groups of 4 and 3 sensors; expected the same number"):
        MovingSensors(name="odd", second_group_m=SECOND_GROUP_M[:3])


@pytest.mark.parametrize("name", ["emitter-1-5ns", "emitter-2-position-0.75m"])
def test_recordings_can_be_written(tmp_path, name):
    (recording,) = recordings(VARIANTS[name], [3])
    write(recording, tmp_path / name)
    again = read(tmp_path / name)
    assert np.array_equal(again.arrivals.toa_s, recording.arrivals.toa_s)
    assert again.sensors["S1"].trajectory.time_s[-1] > recording.arrivals.toa_s.max()
