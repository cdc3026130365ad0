"""Simulated orbits against Kepler's equation, conserved quantities and the secular J2 rate."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import chi2

from geograph.constants import EARTH_GM_M3_S2, EARTH_J2, EARTH_RADIUS_M, EARTH_ROTATION_RAD_S
from geograph.scenarios.orbits import (
    CircularOrbit,
    EarthFixedBody,
    free_fall,
    gravity,
    sample_perturbed_fall,
    turned_about_z,
)
from geograph.scenarios.paths import StraightBody

INCLINATION = np.radians(63.0)
ELEMENTS = (7.5e6, 0.08)


def perigee_state():
    """Position and velocity at perigee on the x axis, in an inclined plane."""
    a, e = ELEMENTS
    speed = np.sqrt(EARTH_GM_M3_S2 / a * (1.0 + e) / (1.0 - e))
    return np.array(
        [
            [a * (1.0 - e), 0.0, 0.0],
            [0.0, speed * np.cos(INCLINATION), speed * np.sin(INCLINATION)],
        ]
    )


def kepler_position(time):
    a, e = ELEMENTS
    mean = np.sqrt(EARTH_GM_M3_S2 / a**3) * time
    anomaly = brentq(lambda x: x - e * np.sin(x) - mean, mean - 1.0, mean + 1.0, xtol=1e-15)
    along, across = a * (np.cos(anomaly) - e), a * np.sqrt(1.0 - e**2) * np.sin(anomaly)
    return np.array([along, across * np.cos(INCLINATION), across * np.sin(INCLINATION)])


def test_two_body_orbit_obeys_keplers_equation():
    body = free_fall(perigee_state(), (0.0, 7000.0), j2=False)
    times = np.random.default_rng(0).uniform(0.0, 7000.0, 50)
    expected = np.array([kepler_position(t) for t in times])
    np.testing.assert_allclose(body.position_at(times), expected, rtol=0.0, atol=1e-3)


@pytest.mark.parametrize("j2", [False, True])
def test_energy_and_axial_momentum_are_kept(j2):
    body = free_fall(perigee_state(), (0.0, 7000.0), j2=j2)
    times = np.linspace(0.0, 7000.0, 333)
    p, v = body.position_at(times), body.velocity_at(times)
    r = np.linalg.norm(p, axis=-1)
    oblate = EARTH_J2 * (EARTH_RADIUS_M / r) ** 2 * (1.5 * (p[:, 2] / r) ** 2 - 0.5) if j2 else 0.0
    energy = 0.5 * np.sum(v**2, axis=-1) - EARTH_GM_M3_S2 / r * (1.0 - oblate)
    axial = p[:, 0] * v[:, 1] - p[:, 1] * v[:, 0]
    np.testing.assert_allclose(energy, energy[0], rtol=1e-10)
    np.testing.assert_allclose(axial, axial[0], rtol=1e-10)
    if not j2:
        np.testing.assert_allclose(
            np.cross(p, v), np.cross(p[:1], v[:1]) + 0 * p, rtol=1e-10, atol=1
        )


def test_oblateness_turns_the_node_at_the_secular_rate():
    a = 7.2e6
    rate = np.sqrt(EARTH_GM_M3_S2 / a**3)
    tilt = np.radians(50.0)
    initial = np.array([[a, 0.0, 0.0], [0.0, a * rate * np.cos(tilt), a * rate * np.sin(tilt)]])
    span = 20 * 2.0 * np.pi / rate
    body = free_fall(initial, (0.0, span), j2=True, step_s=10.0)
    times = np.linspace(0.0, span, 4000)
    normal = np.cross(body.position_at(times), body.velocity_at(times))
    node = np.unwrap(np.arctan2(normal[:, 0], -normal[:, 1]))
    expected = -1.5 * rate * EARTH_J2 * (EARTH_RADIUS_M / a) ** 2 * np.cos(tilt)
    assert np.polyfit(times, node, 1)[0] == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("j2", [False, True])
def test_gravity_is_the_gradient_of_its_potential(j2):
    def potential(p):
        r = np.sqrt(np.sum(p**2))
        oblate = EARTH_J2 * (EARTH_RADIUS_M / r) ** 2 * (3.0 * (p[2] / r) ** 2 - 1.0) / 2.0
        return EARTH_GM_M3_S2 / r * (1.0 - (oblate if j2 else 0.0))

    rng = np.random.default_rng(1)
    for place in rng.uniform(-8e6, 8e6, (20, 3)):
        step = 1e-3
        expected = [potential(place + 1j * step * axis).imag / step for axis in np.eye(3)]
        np.testing.assert_allclose(gravity(place, j2=j2), expected, rtol=1e-12, atol=1e-13)


def test_a_geostationary_satellite_stands():
    radius = (EARTH_GM_M3_S2 / EARTH_ROTATION_RAD_S**2) ** (1.0 / 3.0)
    orbit = CircularOrbit(radius, np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), 0.4)
    seen = EarthFixedBody(orbit)
    times = np.linspace(-1e4, 1e4, 11)
    expected = radius * np.array([np.cos(0.4), np.sin(0.4), 0.0])
    np.testing.assert_allclose(seen.position_at(times), np.tile(expected, (11, 1)), atol=1e-6)
    np.testing.assert_allclose(seen.velocity_at(times), np.zeros((11, 3)), atol=1e-9)


def test_a_circular_orbit_is_a_free_fall():
    first, second = np.array([0.0, 0.6, 0.8]), np.array([1.0, 0.0, 0.0])
    orbit = CircularOrbit(7e6, first, second, 1.0)
    initial = np.stack([orbit.position_at(-5.0), orbit.velocity_at(-5.0)])
    body = free_fall(initial, (-5.0, 300.0), j2=False)
    times = np.linspace(-5.0, 300.0, 77)
    np.testing.assert_allclose(body.position_at(times), orbit.position_at(times), atol=1e-5)


def test_earth_fixed_velocity_is_the_derivative_of_the_position():
    body = EarthFixedBody(free_fall(perigee_state(), (0.0, 300.0), j2=True))
    times = np.linspace(10.0, 290.0, 9)
    slope = (body.position_at(times + 0.05) - body.position_at(times - 0.05)) / 0.1
    np.testing.assert_allclose(body.velocity_at(times), slope, atol=1e-4)


def test_a_fixed_star_moves_westwards_for_the_turning_earth():
    body = EarthFixedBody(StraightBody(np.array([1e7, 0.0, 0.0])))
    assert body.position_at(100.0)[1] < 0.0
    np.testing.assert_allclose(turned_about_z([1.0, 0.0, 5.0], np.pi / 2), [0, 1, 5], atol=1e-15)


def test_an_undisturbed_fall_is_a_free_fall():
    times = np.linspace(0.0, 200.0, 401)
    state = sample_perturbed_fall(
        np.random.default_rng(0), times, perigee_state(), noise=1e-12, j2=True
    )
    body = free_fall(perigee_state(), (0.0, 200.0), j2=True)
    np.testing.assert_allclose(state[:, 0], body.position_at(times), atol=1e-5)


def test_a_disturbed_fall_deviates_as_integrated_noise_does():
    # Over 20 s the gradient of gravity (1e-6 / s^2) changes the variances by less than 1e-3.
    times, noise, along = np.linspace(0.0, 20.0, 21), 0.3, 3.0
    body = free_fall(perigee_state(), (0.0, 20.0), j2=True)
    fall = np.stack([body.position_at(20.0), body.velocity_at(20.0)])
    rng = np.random.default_rng(6)
    draws = np.stack(
        [
            sample_perturbed_fall(rng, times, perigee_state(), noise=noise, along=along)[-1] - fall
            for _ in range(400)
        ]
    )
    relative = EarthFixedBody(body).velocity_at(0.0)
    direction = relative / np.linalg.norm(relative)
    covariance = np.array([[20.0**3 / 3, 20.0**2 / 2], [20.0**2 / 2, 20.0]])
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    aside = np.cross(direction, [0.0, 0.6, 0.8])
    aside /= np.linalg.norm(aside)
    for axis, sigma in ((direction, along), (aside, noise)):
        statistic = float(np.sum((draws @ axis @ white.T / sigma) ** 2))
        low, high = chi2.ppf([5e-7, 1.0 - 5e-7], 800)
        # The path turns by a degree in 20 s, which brings (0.02 * 10)^2 of the noise along across.
        assert low < statistic < high * 1.04
