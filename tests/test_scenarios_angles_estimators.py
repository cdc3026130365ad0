"""The published estimators of satellites, angles only, and how they are scored."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from geograph.consistency import TAIL, divergence, divergence_bias, nees, shares
from geograph.scenarios.angles_bias import bmod, significant_lines
from geograph.scenarios.angles_estimators import (
    Kinematic,
    first_states,
    fitted_errors,
    optimise,
    optimise_path,
    triangulation,
)
from geograph.scenarios.angles_scores import honesty, improvement
from geograph.scenarios.angles_windows import Windows, cut, predict
from geograph.scenarios.angles_worlds import WORLDS, angles_recording
from geograph.scenarios.kepler import random_elliptic_satellite
from geograph.scenarios.observation import observe_bearings

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

SIGMA = 50e-6


@dataclass(frozen=True, eq=False)
class Parabola:
    """A body of constant acceleration in Earth-fixed axes: what the estimators suppose."""

    position_m: NDArray[np.float64]
    velocity_m_s: NDArray[np.float64]
    acceleration_m_s2: NDArray[np.float64]

    def position_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        time = np.asarray(time_s, dtype=np.float64)[..., None]
        moved = time * self.velocity_m_s + time**2 / 2.0 * self.acceleration_m_s2
        return np.asarray(self.position_m + moved)

    def velocity_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        time = np.asarray(time_s, dtype=np.float64)[..., None]
        return np.asarray(self.velocity_m_s + time * self.acceleration_m_s2)

    def states(self, time_s: NDArray[np.float64], order: int) -> NDArray[np.float64]:
        blocks = [
            self.position_at(time_s),
            self.velocity_at(time_s),
            np.tile(self.acceleration_m_s2, (time_s.size, 1)),
        ]
        return np.concatenate(blocks[:order], axis=1)


def made(
    *, order: int = 3, noise: float = 0.0, seed: int = 0, count: int = 10, size: int = 40
) -> tuple[Windows, Parabola]:
    """Return windows over 100 s of three satellites, and the object."""
    rng = np.random.default_rng(seed)
    path = Parabola(
        np.array([7e6, 0.0, 1e6]),
        np.array([100.0, 6e3, 2e3]) if order > 1 else np.zeros(3),
        np.array([-6.0, 1.0, 2.0]) if order > 2 else np.zeros(3),
    )
    bodies = []
    while len(bodies) < 3:
        body = random_elliptic_satellite(rng, perigee_m=(1e6, 4e6), eccentricity=(0.0, 0.3))
        off = np.linalg.norm(body.position_at(0.0) - path.position_m)
        if 1e6 < off < 5e6:
            bodies.append(body)
    tag = np.sort(rng.uniform(0.0, 100.0, count * size))
    sensor = rng.integers(0, 3, tag.size)
    seen = observe_bearings(path, bodies, tag, sensor, axes=["xyz"] * 3)
    angles = np.stack([seen.azimuth_rad, seen.elevation_rad], axis=-1)
    angles += noise * rng.standard_normal(angles.shape)
    place = np.empty((tag.size, 3))
    for index, body in enumerate(bodies):
        place[sensor == index] = body.position_at(tag[sensor == index])
    shape = (count, size)
    tag = tag.reshape(shape)
    windows = Windows(
        time_s=(tag[:, 0] + tag[:, -1]) / 2.0,
        tag_s=tag,
        sensor=sensor.reshape(shape),
        place_m=place.reshape(*shape, 3),
        angles_rad=angles.reshape(*shape, 2),
        sigma_rad=np.full(shape, SIGMA),
    )
    return windows, path


def test_the_truth_leaves_no_residual() -> None:
    windows, path = made()
    found = predict(windows, path.states(windows.time_s, 3))
    assert np.abs(found.residual_rad).max() < 1e-12


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), order=st.integers(1, 3))
def test_derivatives_agree_with_finite_differences(seed: int, order: int) -> None:
    windows, path = made(size=6, count=3)
    rng = np.random.default_rng(seed)
    scale = np.repeat([3e4, 3e2, 10.0][:order], 3)
    state = path.states(windows.time_s, order) + scale * rng.standard_normal((3, 3 * order))
    found = predict(windows, state).jacobian
    for column in range(3 * order):
        step = np.zeros(3 * order)
        step[column] = (10.0, 10.0, 1.0)[column // 3]
        up, down = predict(windows, state + step), predict(windows, state - step)
        slope = (down.residual_rad - up.residual_rad) / (2.0 * step[column])
        # The light time moves with the state, which the derivative leaves out: v / c, 3e-5.
        np.testing.assert_allclose(
            found[..., column], slope, atol=1e-3 * np.abs(found[..., column]).max() + 1e-13
        )


@pytest.mark.parametrize("order", [1, 2, 3])
def test_without_noise_the_truth_comes_back(order: int) -> None:
    windows, path = made(order=order)
    found = optimise(windows, order)
    assert found.converged.all()
    np.testing.assert_allclose(
        found.position_m, path.position_at(windows.time_s), atol=1e-2, rtol=0.0
    )
    if order > 1:
        together = optimise_path(windows, order, intersection=False)
        np.testing.assert_allclose(
            together.position_m, path.position_at(windows.time_s), atol=1e-2, rtol=0.0
        )


def test_triangulation_finds_what_stands() -> None:
    windows, path = made(order=1)
    # The turn of the Earth in 15 ms at 7000 km is 8 m, which it ignores.
    assert np.abs(triangulation(windows).position_m - path.position_m).max() < 20.0


def test_starts_are_finite_differences() -> None:
    windows, path = made(order=2)
    start = first_states(windows, 3)
    assert np.abs(start[1:-1, 3:6] - path.velocity_m_s).max() < 1e3
    np.testing.assert_allclose(
        start[:, 6:], np.gradient(start[:, 3:6], windows.time_s, axis=0), rtol=1e-12
    )


@pytest.mark.parametrize("order", [2, 3])
def test_windows_of_white_noise_have_honest_covariances(order: int) -> None:
    """200 independent windows; chi-square band with a false alarm of 1e-3, fixed seeds."""
    values = []
    for seed in range(20):
        windows, path = made(order=order, noise=SIGMA, seed=seed)
        found = optimise(windows, order)
        error = found.position_m - path.position_at(windows.time_s)
        values.append(nees(error, found.position_covariance_m2))
    total = np.concatenate(values)
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 3 * total.size)
    assert low < total.sum() < high


def test_the_whole_path_without_kinematics_to_speak_of_is_the_windows_one_by_one() -> None:
    windows, _ = made(noise=SIGMA)
    loose = Kinematic(position_m=1e12, velocity_m_s=1e12, acceleration_m_s2=1e12)
    together = optimise_path(windows, 3, kinematic=loose, intersection=False)
    alone = optimise(windows, 3)
    np.testing.assert_allclose(together.state, alone.state, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(together.covariance, alone.covariance, rtol=1e-4, atol=1e-6)


def test_kinematics_that_hold_make_the_path_better_than_its_windows() -> None:
    alone, together = [], []
    tight = Kinematic(position_m=0.1, velocity_m_s=0.1, acceleration_m_s2=0.1)
    for seed in range(5):
        windows, path = made(noise=SIGMA, seed=seed)
        truth = path.position_at(windows.time_s)
        alone.append(np.sum((optimise(windows, 3).position_m - truth) ** 2))
        found = optimise_path(windows, 3, kinematic=tight, intersection=False)
        together.append(np.sum((found.position_m - truth) ** 2))
    assert np.sum(together) < 0.5 * np.sum(alone)


def test_covariance_intersection_counts_a_window_as_one_measurement() -> None:
    windows, _ = made(noise=SIGMA)
    plain, crossed = optimise(windows, 2), optimise(windows, 2, intersection=True)
    np.testing.assert_allclose(plain.position_m, crossed.position_m, atol=5.0, rtol=0.0)
    np.testing.assert_allclose(crossed.covariance, windows.size * plain.covariance, rtol=1e-3)


def test_appended_biases_and_drifts_are_found() -> None:
    windows, path = made(size=80)
    constants = 1e-4 * np.array([3, -2, 1, 4, 1, -3]), 1e-6 * np.array([1, 2, -1, 2, -1, 1])
    wrong = windows.corrected(-fitted_errors(windows, np.concatenate(constants)))
    tight = Kinematic(position_m=0.1, velocity_m_s=0.1, acceleration_m_s2=0.1)
    found = optimise_path(wrong, 3, kinematic=tight, intersection=False, biased=True)
    assert found.converged.all()
    np.testing.assert_allclose(found.constants, np.concatenate(constants), atol=2e-6)
    worst = np.abs(found.position_m - path.position_at(windows.time_s)).max()
    blind = optimise_path(wrong, 3, kinematic=tight, intersection=False)
    assert worst < 0.05 * np.abs(blind.position_m - path.position_at(windows.time_s)).max()


def test_lines_are_read_off_residuals_where_they_are_significant() -> None:
    windows, _ = made(size=80)
    rng = np.random.default_rng(1)
    constants = np.zeros(12)
    constants[[1, 9]] = 200e-6, 5e-6
    residual = fitted_errors(windows, constants) + SIGMA * rng.standard_normal(
        windows.angles_rad.shape
    )
    found = significant_lines(windows, residual)
    assert set(np.flatnonzero(found)) == {1, 9}
    np.testing.assert_allclose(found[[1, 9]], constants[[1, 9]], rtol=0.15)


def test_bmod_leaves_good_measurements_alone_and_improves_biased_ones() -> None:
    windows, path = made(noise=SIGMA, size=80)
    clean = bmod(windows)
    assert clean.converged.all()
    np.testing.assert_allclose(clean.state, optimise_path(windows, 3).state, atol=30.0, rtol=1e-3)
    constants = np.zeros(12)
    constants[[0, 4]] = 2e-3, -2e-3
    for seed in range(3):
        windows, path = made(noise=SIGMA, size=80, seed=seed)
        wrong = windows.corrected(-fitted_errors(windows, constants))
        truth = path.position_at(windows.time_s)
        before, after = optimise_path(wrong, 3), bmod(wrong)
        # The residuals go down to the noise; most of the error is what they do not show.
        left = wrong.corrected(fitted_errors(wrong, after.constants))
        assert np.std(predict(wrong, before.state).residual_rad) > 10.0 * SIGMA
        assert np.std(predict(left, after.state).residual_rad) < 1.1 * SIGMA
        assert np.linalg.norm(after.position_m - truth) < np.linalg.norm(before.position_m - truth)


def test_kinematic_confidence_is_what_the_paper_adds() -> None:
    windows, _ = made(noise=SIGMA)
    found = optimise_path(windows, 3)
    expected = (
        found.covariance[:, :3, :3]
        + 9.0 * found.covariance[:, 3:6, 3:6]
        + 81.0 / 4.0 * found.covariance[:, 6:, 6:]
    )
    np.testing.assert_allclose(found.kinematic_covariance_m2(3.0), expected)
    still = optimise(windows, 1)
    np.testing.assert_array_equal(still.kinematic_covariance_m2(3.0), still.covariance)


def test_one_that_diverges_says_so() -> None:
    windows, _ = made(noise=SIGMA)
    mad = replace(windows, angles_rad=windows.angles_rad[::-1, ::-1] + 1.0)
    assert not optimise_path(mad, 3, biased=True).converged.all()


def test_recordings_are_cut_evenly() -> None:
    recording = angles_recording(1, "levy-simple")
    windows = cut(recording, 40, 1e-4)
    assert windows.tag_s.shape == (40, len(recording.bearings or ()) // 40)
    assert (np.diff(windows.tag_s.ravel()) > 0.0).all()
    sensor = list(recording.sensors.values())[windows.sensor[7, 3]]
    np.testing.assert_allclose(windows.place_m[7, 3], sensor.position_at(windows.tag_s[7, 3]))
    with pytest.raises(ValueError, match="expected at least 5 in each"):
        cut(recording, 2000, 1e-4)
    with pytest.raises(ValueError, match="axes xyz"):
        cut(replace(recording, bearings=None), 40, 1e-4)


def test_divergence_is_zero_for_the_true_shares_and_named_at_both_ends() -> None:
    middle = (TAIL[:-1] + TAIL[1:]) / 2.0
    assert shares(chi2.isf(middle[:20], 3)).tolist() == pytest.approx(
        [0.05] * 19 + [0, 0.05, *[0] * 10], abs=0.06
    )
    assert divergence(np.zeros(100)) == pytest.approx(np.log(20.0))
    assert divergence(np.full(100, np.inf)) == pytest.approx(12.0 * np.log(10.0))
    # The quantiles of chi-square itself, a thousand to each of the first bins.
    even = chi2.isf((np.arange(20_000) + 0.5) / 20_000, 3)
    assert divergence(even) < 1e-3


def test_divergence_of_true_draws_is_the_known_bias() -> None:
    """Miller's (bins - 1) / (2 N); of 31 bins those of a chance below 1 / N are empty."""
    assert divergence_bias(1000) == pytest.approx(22 / 2000, rel=0.15)
    assert divergence_bias(100) > 5.0 * divergence_bias(1000)


def test_nees_of_bad_covariances_is_infinite() -> None:
    covariance = np.stack([np.eye(3), -np.eye(3), np.full((3, 3), np.nan)])
    assert nees(np.ones((3, 3)), covariance).tolist() == [3.0, np.inf, np.inf]


def test_honest_draws_score_as_honest() -> None:
    found = honesty(np.random.default_rng(2).chisquare(3, (400, 10)))
    assert abs(found.anees.value - 3.0) < 4.0 * found.anees.error
    assert abs(found.coverage.value - 0.95) < 4.0 * found.coverage.error
    assert found.divergence.value < 0.02
    assert found.divergence.error < 0.01


def test_improvement_is_counted_trial_by_trial() -> None:
    found = improvement(np.array([1.0, 3.0, 1.0, 1.0]), np.array([2.0, 2.0, 4.0, 10.0]))
    assert found.share.value == 0.75
    assert found.mean.value == pytest.approx(np.mean([0.5, -0.5, 0.75, 0.9]))
    assert found.median == pytest.approx(0.625)
    assert found.trials == 4


def test_every_world_has_windows_enough() -> None:
    for world in WORLDS.values():
        assert world.sensors[0] * world.bearings[0] // world.windows >= 5
