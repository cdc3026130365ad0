"""Ellipsoids and circular errors against samples and integrals."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import erf
from scipy.stats import binom

from geograph.ellipsoids import circular_error_probable_m, ellipsoids
from geograph.errors import InputError


def random_covariance(rng, d):
    root = rng.normal(size=(d, d)) * np.logspace(0, 2, d)
    return root @ root.T


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("probability", [0.5, 0.95, 0.999])
def test_coverage(d, probability):
    """The share of samples inside; each case fails by chance once in a million."""
    rng = np.random.default_rng(d)
    covariance = random_covariance(rng, d)
    centre = rng.normal(size=d)
    found = ellipsoids(centre[None], covariance[None], probability)
    count = 200_000
    samples = rng.multivariate_normal(np.zeros(d), covariance, count)
    inside = np.sum((samples @ found.axes[0].T / found.semi_axes_m[0]) ** 2, axis=1) <= 1.0
    low, high = binom.interval(1 - 1e-6, count, probability)
    assert low <= inside.sum() <= high
    np.testing.assert_array_equal(found.center_m[0], centre)
    assert found.probability == probability


def test_axes_are_longest_first_and_of_the_frame():
    rng = np.random.default_rng(7)
    covariance = np.stack([random_covariance(rng, 3) for _ in range(20)])
    found = ellipsoids(np.zeros((20, 3)), covariance, 0.6)
    assert (np.diff(found.semi_axes_m, axis=1) <= 0.0).all()
    np.testing.assert_allclose(
        found.axes @ np.swapaxes(found.axes, 1, 2), [np.eye(3)] * 20, atol=1e-14
    )
    scale = found.semi_axes_m**2
    rebuilt = np.swapaxes(found.axes, 1, 2) * scale[:, None, :] @ found.axes
    ratio = rebuilt / covariance
    np.testing.assert_allclose(ratio, ratio[0, 0, 0], rtol=1e-8)
    # One, two and three sigma of a normal distribution in three dimensions.
    unit = ellipsoids(np.zeros((1, 3)), np.eye(3)[None], 0.19874804)
    np.testing.assert_allclose(unit.semi_axes_m, np.ones((1, 3)), rtol=1e-7)


def test_what_is_not_determined_has_no_ellipsoid():
    covariance = np.stack([np.eye(3), np.full((3, 3), np.nan), np.full((3, 3), np.inf)])
    found = ellipsoids(np.zeros((3, 3)), covariance, 0.9)
    assert np.isfinite(found.semi_axes_m[0]).all()
    assert np.isnan(found.semi_axes_m[1:]).all()


def test_flat_covariances_of_rounding_are_taken_as_flat():
    covariance = np.diag([1.0, 1.0, -1e-17])
    assert ellipsoids(np.zeros((1, 3)), covariance[None], 0.9).semi_axes_m[0, 2] == 0.0


@pytest.mark.parametrize("probability", [0.0, 1.0, -0.1, 95.0, np.nan])
def test_probability_out_of_range(probability):
    with pytest.raises(InputError, match="expected between 0 and 1"):
        ellipsoids(np.zeros((1, 3)), np.eye(3)[None], probability)


def chance_inside(radius, ratio):
    """Integrate a Gaussian of sigmas 1 and ratio over a disc: strips in x, closed form in y."""

    def strip(t):
        x, y = radius * np.sin(t), radius * np.cos(t)
        return y * np.exp(-(x**2) / 2) * erf(y / (ratio * np.sqrt(2.0)))

    edge = np.pi / 2 - min(10.0 * ratio, 1.0)
    value, _ = quad(strip, 0.0, np.pi / 2, epsabs=1e-14, epsrel=1e-13, limit=300, points=[edge])
    return 2.0 / np.sqrt(2.0 * np.pi) * value


@pytest.mark.parametrize("ratio", [1.0, 0.7, 0.3, 0.1, 0.01, 1e-3, 1e-6])
def test_half_of_the_probability_is_within_the_cep(ratio):
    rng = np.random.default_rng(3)
    turn = np.linalg.qr(rng.normal(size=(2, 2)))[0]
    covariance = 25.0 * turn @ np.diag([1.0, ratio**2]) @ turn.T
    radius = circular_error_probable_m(covariance[None])[0] / 5.0
    assert chance_inside(radius, ratio) == pytest.approx(0.5, abs=1e-9)


def test_circular_and_flat_limits():
    """sqrt(2 ln 2) of a circle; the normal distribution's quartile of a line; 0 of a point."""
    covariance = np.stack([np.eye(2), np.diag([0.0, 1.0]), np.zeros((2, 2))])
    found = circular_error_probable_m(4.0 * covariance)
    expected = [2.0 * np.sqrt(2.0 * np.log(2.0)), 2.0 * 0.6744897501960817, 0.0]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
