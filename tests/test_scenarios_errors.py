"""Simulated sensor errors: their sizes, signs and independence.

Seeds are fixed; statistics are asked to lie where a right simulator's do but once in a million.
"""

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from geograph.scenarios.observation import direction_from_angles
from geograph.scenarios.sensor_errors import (
    TrueErrors,
    add_sky_noise,
    correlated_normals,
    draw_errors,
    draw_outliers,
    error_history,
    random_walk,
)
from geograph.sensors import SensorErrors

PRIOR = SensorErrors(
    azimuth_bias_rad=5e-4,
    elevation_bias_rad=1e-3,
    azimuth_drift_rad_s=1e-7,
    azimuth_instability_rad_sqrt_s=2e-7,
    clock_offset_s=3.0,
)
NAMES = ("azimuth_bias_rad", "elevation_bias_rad", "azimuth_drift_rad_s", "clock_offset_s")


def assert_chi_square(statistic, degrees):
    low, high = chi2.ppf([5e-7, 1.0 - 5e-7], degrees)
    assert low < statistic < high, f"{statistic:.1f} is not within {low:.1f} to {high:.1f}"


def angle_between(first, second):
    return 2.0 * np.arcsin(np.linalg.norm(first - second, axis=-1) / 2.0)


def test_normal_errors_have_their_prior_sigma():
    rng = np.random.default_rng(0)
    draws = [draw_errors(rng, PRIOR) for _ in range(500)]
    for name in NAMES:
        values = np.array([getattr(d, name) for d in draws]) / getattr(PRIOR, name)
        assert_chi_square(np.sum(values**2), 500)
    assert all(d.elevation_drift_rad_s == 0.0 for d in draws)
    assert {d.azimuth_instability_rad_sqrt_s for d in draws} == {2e-7}


def test_uniform_errors_have_their_prior_sigma():
    rng = np.random.default_rng(1)
    draws = [draw_errors(rng, PRIOR, draw="uniform") for _ in range(500)]
    for name in NAMES:
        values = np.array([getattr(d, name) for d in draws]) / getattr(PRIOR, name)
        assert kstest(values, "uniform", args=(-np.sqrt(3.0), 2.0 * np.sqrt(3.0))).pvalue > 1e-6
    diffusion = np.array([d.azimuth_instability_rad_sqrt_s for d in draws]) / 2e-7
    assert kstest(diffusion, "uniform", args=(0.0, np.sqrt(3.0))).pvalue > 1e-6


def test_one_prior_does_not_change_the_draws_of_the_others():
    other = SensorErrors(azimuth_bias_rad=5e-4, clock_offset_s=0.0, clock_drift_s_s=1.0)
    first = draw_errors(np.random.default_rng(2), PRIOR)
    second = draw_errors(np.random.default_rng(2), other)
    assert first.azimuth_bias_rad == second.azimuth_bias_rad
    assert second.clock_offset_s == 0.0


def test_errors_that_are_not_simulated_are_refused():
    with pytest.raises(ValueError, match="misalignment_rad is not simulated"):
        draw_errors(np.random.default_rng(0), SensorErrors(misalignment_rad=1e-3))


def test_random_walk_gains_its_variance_independently():
    rng = np.random.default_rng(3)
    elapsed = np.sort(rng.uniform(0.0, 50.0, 2000))
    walk = random_walk(rng, elapsed, 0.2)
    steps = np.diff(walk, prepend=0.0) / (0.2 * np.sqrt(np.diff(elapsed, prepend=0.0)))
    assert_chi_square(np.sum(steps**2), 2000)
    lag = np.sum(steps[1:] * steps[:-1]) / np.sqrt(1999)
    assert abs(lag) < 4.9


def test_history_is_bias_drift_and_walk():
    elapsed = np.array([0.0, 1.0, 10.0])
    errors = TrueErrors(
        azimuth_bias_rad=1.0,
        azimuth_drift_rad_s=0.5,
        elevation_bias_rad=-2.0,
        clock_offset_s=3.0,
        clock_drift_s_s=-0.1,
    )
    history = error_history(np.random.default_rng(4), errors, elapsed)
    np.testing.assert_allclose(history.azimuth_rad, [1.0, 1.5, 6.0])
    np.testing.assert_allclose(history.elevation_rad, [-2.0, -2.0, -2.0])
    np.testing.assert_allclose(history.clock_s, [3.0, 2.9, 2.0])


@pytest.mark.parametrize("axes", ["enu", "xyz"])
@pytest.mark.parametrize("elevation_deg", [0.0, 45.0, -89.99, 89.99])
def test_sky_noise_is_isotropic_even_at_the_zenith(axes, elevation_deg):
    rng = np.random.default_rng(5)
    count, sigma = 2000, 1e-3
    azimuth = rng.uniform(0.0, 2.0 * np.pi, count)
    elevation = np.full(count, np.radians(elevation_deg))
    offset = sigma * rng.standard_normal((count, 2))
    before = direction_from_angles(azimuth, elevation, axes=axes)
    moved = direction_from_angles(*add_sky_noise(azimuth, elevation, offset, axes=axes), axes=axes)
    np.testing.assert_allclose(angle_between(before, moved), np.hypot(*offset.T), rtol=1e-9)
    assert_chi_square(np.sum((angle_between(before, moved) / sigma) ** 2), 2 * count)


@pytest.mark.parametrize("axes", ["enu", "xyz"])
def test_sky_noise_components_go_along_azimuth_and_elevation(axes):
    azimuth, elevation = np.array([1.0, 1.0]), np.array([1.1, 1.1])
    offset = np.array([[1e-6, 0.0], [0.0, 1e-6]])
    got = add_sky_noise(azimuth, elevation, offset, axes=axes)
    np.testing.assert_allclose(got[0] - azimuth, [1e-6 / np.cos(1.1), 0.0], atol=1e-11)
    np.testing.assert_allclose(got[1] - elevation, [0.0, 1e-6], atol=1e-11)


def test_no_noise_moves_nothing():
    azimuth, elevation = np.array([0.2, 6.0]), np.array([-1.0, 0.5])
    got = add_sky_noise(azimuth, elevation, np.zeros((2, 2)), axes="enu")
    np.testing.assert_allclose(got, [azimuth, elevation], atol=1e-15)


def test_correlated_noise():
    rng = np.random.default_rng(6)
    draws = np.stack([correlated_normals(rng, 3, 0.36) for _ in range(3000)])
    assert_chi_square(np.sum(draws[:, 0] ** 2), 6000)
    # The sum of three has the variance 3 + 6 rho.
    assert_chi_square(np.sum(draws.sum(axis=1) ** 2) / (3 + 6 * 0.36), 6000)
    assert np.ptp(correlated_normals(rng, 5, 1.0), axis=0).max() == 0.0


def test_outliers_lie_anywhere_or_at_their_distance():
    rng = np.random.default_rng(7)
    azimuth, elevation = rng.uniform(-3.0, 3.0, 1000), rng.uniform(-1.5, 1.5, 1000)
    got = draw_outliers(rng, azimuth, elevation, axes="xyz", offset_rad=0.1)
    apart = angle_between(
        direction_from_angles(*got, axes="xyz"),
        direction_from_angles(azimuth, elevation, axes="xyz"),
    )
    np.testing.assert_allclose(apart, 0.1, rtol=1e-9)
    azimuth, elevation = draw_outliers(rng, azimuth, elevation, axes="xyz")
    # Uniform on the sphere: the height is uniform (Archimedes), and so is the azimuth.
    assert kstest(np.sin(elevation), "uniform", args=(-1.0, 2.0)).pvalue > 1e-6
    assert kstest(azimuth, "uniform", args=(-np.pi, 2.0 * np.pi)).pvalue > 1e-6
