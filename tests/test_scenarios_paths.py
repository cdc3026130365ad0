"""Random paths against the analytic moments of integrated white noise.

Seeds are fixed. Chi-square statistics are asked to lie in the central band that a right sampler
leaves once in a million draws of the seed.
"""

from math import factorial

import numpy as np
import pytest
from scipy.integrate import fixed_quad
from scipy.stats import chi2

from geograph.scenarios.paths import (
    SampledBody,
    StraightBody,
    fine_grid,
    interpolation_sigma_m,
    noise_shape,
    sample_path,
)

FALSE_ALARM = 1e-6


def assert_chi_square(statistic, degrees):
    low, high = chi2.ppf([FALSE_ALARM / 2.0, 1.0 - FALSE_ALARM / 2.0], degrees)
    assert low < statistic < high, f"{statistic:.1f} is not within {low:.1f} to {high:.1f}"


def joint_covariance(order, times, noise=1.0):
    """Covariance of the states at several times, all started at zero, by quadrature."""
    size = order * len(times)
    covariance = np.zeros((size, size))
    for a, s in enumerate(times):
        for b, t in enumerate(times):
            for i in range(order):
                for j in range(order):
                    m, n = order - 1 - i, order - 1 - j

                    def kernel(u, s=s, t=t, m=m, n=n):
                        return (s - u) ** m / factorial(m) * (t - u) ** n / factorial(n)

                    value, _ = fixed_quad(kernel, 0.0, min(s, t), n=6)
                    covariance[a * order + i, b * order + j] = noise**2 * value
    return covariance


def assert_sample_covariance(draws, covariance):
    """Bartlett's test that zero-mean draws, shape (n, p), have a covariance."""
    n, p = draws.shape
    white = np.linalg.solve(np.linalg.cholesky(covariance), draws.T)
    sample = white @ white.T / n
    _, logdet = np.linalg.slogdet(sample)
    statistic = n * (np.trace(sample) - logdet - p)
    correction = 1.0 - (2.0 * p + 1.0 - 2.0 / (p + 1.0)) / (6.0 * n)
    assert_chi_square(statistic * correction, p * (p + 1) / 2)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_states_at_two_times_have_the_analytic_covariance(order):
    rng = np.random.default_rng(order)
    grid = np.sort(np.concatenate([[0.0, 1.3, 3.1], rng.uniform(0.0, 3.1, 7)]))
    ends = np.searchsorted(grid, [1.3, 3.1])
    draws = np.stack(
        [sample_path(rng, grid, np.zeros((order, 3)), noise=0.7)[ends] for _ in range(1500)]
    )
    flat = np.moveaxis(draws, -1, 1).reshape(-1, 2 * order)
    assert_sample_covariance(flat, joint_covariance(order, [1.3, 3.1], 0.7))


@pytest.mark.parametrize("order", [1, 2, 3])
def test_noise_free_path_is_a_polynomial(order):
    rng = np.random.default_rng(1)
    initial = rng.standard_normal((order, 3))
    grid = np.sort(rng.uniform(2.0, 9.0, 12))
    state = sample_path(rng, grid, initial, noise=1e-300)
    elapsed = grid - grid[0]
    expected = sum(elapsed[:, None] ** k / factorial(k) * initial[k][None, :] for k in range(order))
    np.testing.assert_allclose(state[:, 0], expected, rtol=1e-12, atol=1e-12)


def test_noise_per_axis():
    rng = np.random.default_rng(2)
    draws = np.stack(
        [
            sample_path(rng, np.array([0.0, 2.0]), np.zeros((1, 3)), noise=(1.0, 0.1, 10.0))[1, 0]
            for _ in range(2000)
        ]
    )
    assert_sample_covariance(draws, 2.0 * np.diag([1.0, 0.01, 100.0]))


def test_noise_along_the_velocity():
    rng = np.random.default_rng(3)
    velocity = np.array([3000.0, 4000.0, 0.0])
    initial = np.stack([np.zeros(3), velocity, np.zeros(3)])
    grid = np.linspace(0.0, 2.0, 21)
    draws = np.stack(
        [
            sample_path(rng, grid, initial, noise=0.5, along=20.0)[-1, 0] - 2.0 * velocity
            for _ in range(1500)
        ]
    )
    turned = draws @ np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]]).T
    variance = joint_covariance(3, [2.0])[0, 0]
    assert_sample_covariance(turned, variance * np.diag([400.0, 0.25, 0.25]))


def test_noise_follows_a_velocity_that_turns():
    direction = np.array([0.0, 0.0, -2.0])
    np.testing.assert_allclose(noise_shape(1.0, 3.0, direction), np.diag([1.0, 1.0, 3.0]))
    np.testing.assert_allclose(noise_shape(1.0, 3.0, np.zeros(3)), np.eye(3))


@pytest.mark.parametrize(
    ("initial", "noise"), [(np.zeros((1, 3)), 1.0), (np.zeros((2, 3)), (1.0,) * 3)]
)
def test_noise_along_needs_a_velocity_and_one_number(initial, noise):
    with pytest.raises(ValueError, match="noise along the velocity needs"):
        sample_path(np.random.default_rng(0), np.arange(3.0), initial, noise=noise, along=1.0)


def test_a_repeated_time_repeats_the_state():
    state = sample_path(
        np.random.default_rng(0), np.array([0.0, 1.0, 1.0]), np.zeros((3, 3)), noise=1.0
    )
    np.testing.assert_array_equal(state[1], state[2])


@pytest.mark.parametrize("order", [1, 2, 3])
def test_interpolation_reproduces_polynomials(order):
    rng = np.random.default_rng(4)
    polynomial = [np.polynomial.Polynomial(rng.standard_normal(2 * order)) for _ in range(3)]
    time = np.sort(rng.uniform(-2.0, 2.0, 6))
    state = np.stack(
        [np.stack([p.deriv(k)(time) for p in polynomial], axis=-1) for k in range(order)], axis=1
    )
    body = SampledBody(time, state)
    asked = rng.uniform(time[0], time[-1], (4, 5))
    expected = np.stack([p(asked) for p in polynomial], axis=-1)
    np.testing.assert_allclose(body.position_at(asked), expected, rtol=1e-10, atol=1e-10)
    slope = np.stack([p.deriv()(asked) for p in polynomial], axis=-1)
    np.testing.assert_allclose(body.velocity_at(asked), slope, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_interpolation_sigma_is_the_conditional_one(order):
    # Given the states at both ends, by conditioning the joint normal distribution; the start is
    # known, being zero.
    covariance = joint_covariance(order, [1.0, 2.0], 0.3)
    middle, cross = covariance[0, 0], covariance[0, order:]
    conditional = middle - cross @ np.linalg.solve(covariance[order:, order:], cross)
    expected = interpolation_sigma_m(order=order, noise=0.3, step_s=2.0)
    assert np.sqrt(conditional) == pytest.approx(expected, rel=1e-9)
    # And the Hermite polynomial is the conditional mean.
    weights = np.linalg.solve(covariance[order:, order:], cross)
    end = np.random.default_rng(5).standard_normal((order, 3))
    body = SampledBody(np.array([0.0, 2.0]), np.stack([np.zeros((order, 3)), end]))
    np.testing.assert_allclose(body.position_at(1.0), weights @ end, rtol=1e-9)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_fine_grid_keeps_its_tolerance(order):
    grid = fine_grid((-1.0, 4.0), order=order, noise=0.2, tolerance_m=0.01)
    step = np.diff(grid)
    assert grid[0] == -1.0
    assert grid[-1] == 4.0
    assert step.max() <= 0.5 + 1e-12
    assert interpolation_sigma_m(order=order, noise=0.2, step_s=step.max()) <= 0.01 * (1 + 1e-9)


def test_fine_grid_refuses_what_it_cannot_hold():
    with pytest.raises(ValueError, match="allow a larger tolerance_m"):
        fine_grid((0.0, 200.0), order=1, noise=10.0)


def test_a_sampled_body_is_nowhere_outside_its_samples():
    body = SampledBody(np.array([0.0, 1.0]), np.zeros((2, 1, 3)))
    with pytest.raises(ValueError, match=r"known from 0.0 to 1.0 s; asked from 0.5 to 1.5 s"):
        body.position_at([0.5, 1.5])


def test_straight_body():
    body = StraightBody(np.array([1.0, 2.0, 3.0]), np.array([0.5, 0.0, -1.0]))
    np.testing.assert_allclose(body.position_at(2.0), [2.0, 2.0, 1.0])
    assert body.position_at(np.zeros((2, 4))).shape == (2, 4, 3)
    assert body.velocity_at(np.zeros((2, 4))).shape == (2, 4, 3)
