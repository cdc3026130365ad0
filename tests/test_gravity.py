"""Free fall against potentials and against integration in axes that do not turn."""

import numpy as np
import pytest
from differences import assert_derivative, derivative
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial.legendre import legval
from scipy.integrate import solve_ivp

from geograph.constants import (
    EARTH_GM_M3_S2,
    EARTH_J2,
    EARTH_J3,
    EARTH_J4,
    EARTH_RADIUS_M,
    EARTH_ROTATION_RAD_S,
)
from geograph.factors.gravity import acceleration, propagate
from geograph.geodesy import ecef_from_geodetic

PROFILE = settings(max_examples=60, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
SPIN = np.array([0.0, 0.0, EARTH_ROTATION_RAD_S])


def potential(position, degree=2):
    """Return -GM/r (1 - sum Jn (R/r)^n Pn(sin latitude)), the usual zonal expansion."""
    r = np.linalg.norm(position)
    series = sum(
        harmonic * (EARTH_RADIUS_M / r) ** n * legval(position[2] / r, np.eye(n + 1)[n])
        for n, harmonic in ((2, EARTH_J2), (3, EARTH_J3), (4, EARTH_J4))
        if n <= degree
    )
    return -EARTH_GM_M3_S2 / r * (1.0 - series)


def random_state(rng):
    """An object between the ground and 6 000 km up, at up to 12 km/s in any direction."""
    direction = rng.normal(size=3)
    position = direction / np.linalg.norm(direction) * rng.uniform(6.3e6, 12.4e6)
    velocity = rng.normal(size=3)
    return position, velocity / np.linalg.norm(velocity) * rng.uniform(0.0, 12e3)


@PROFILE
@given(seeds, st.sampled_from([2, 4]))
def test_acceleration_is_the_gradient_and_the_turning(seed, degree):
    position, velocity = random_state(np.random.default_rng(seed))
    gravity = -derivative(lambda at: [potential(at, degree)], position, 1e4)[0]
    turning = -2.0 * np.cross(SPIN, velocity) - np.cross(SPIN, np.cross(SPIN, position))
    found, _, _ = acceleration(position[None], velocity[None], "ecef", degree)
    np.testing.assert_allclose(found[0], gravity + turning, rtol=0.0, atol=1e-8)


@PROFILE
@given(seeds, st.sampled_from([("ecef", 2), ("ecef", 4), ("local", 2)]))
def test_derivatives_of_the_acceleration(seed, model):
    position, velocity = random_state(np.random.default_rng(seed))
    _, by_position, by_velocity = acceleration(position[None], velocity[None], *model)
    assert_derivative(
        by_position[0],
        lambda at: acceleration(at[None], velocity[None], *model)[0],
        position,
        6e3,
        rtol=1e-8,
        floor=1e-3,
    )
    assert_derivative(
        by_velocity[0],
        lambda at: acceleration(position[None], at[None], *model)[0],
        velocity,
        10.0,
        rtol=1e-8,
        floor=1e-3,
    )


def test_local_gravity_is_standard_and_downwards():
    found, _, _ = acceleration(np.ones((2, 3)), np.ones((2, 3)), "local")
    np.testing.assert_array_equal(found, [[0.0, 0.0, -9.80665]] * 2)


@pytest.mark.parametrize(
    ("latitude", "normal_gravity", "legendre"),
    [(0.0, 9.7803253359, 3.0 / 8.0), (90.0, 9.8321849378, 1.0)],
)
def test_gravity_on_the_ellipsoid(latitude, normal_gravity, legendre):
    """WGS 84's normal gravity (NIMA TR8350.2, table 3.4), less its next zonal term.

    The ellipsoid's own J4 of -2.37e-6 adds -5 J4 GM R^4 / r^6 P4(sin latitude), 1e-4 m/s^2; J6 and
    the difference between the ellipsoid's J2 and that of EGM96 stay below 2e-6 m/s^2.
    """
    position = ecef_from_geodetic(latitude, 30.0, 0.0)
    found, _, _ = acceleration(position[None], np.zeros((1, 3)), "ecef")
    r = np.linalg.norm(position)
    fourth = 5.0 * 2.37091222e-6 * EARTH_GM_M3_S2 * EARTH_RADIUS_M**4 / r**6 * legendre
    assert np.linalg.norm(found[0]) + fourth == pytest.approx(normal_gravity, abs=2e-6)


def inertial_fall(position, velocity, duration):
    """Integrate in axes at rest that coincide with the turning ones at the start, to 1e-13."""

    def rates(_, state):
        gravity = -derivative(lambda at: [potential(at)], state[:3], 3e4)[0]
        return np.concatenate([state[3:], gravity])

    start = np.concatenate([position, velocity + np.cross(SPIN, position)])
    end = solve_ivp(rates, (0.0, duration), start, method="DOP853", rtol=1e-13, atol=1e-6).y[:, -1]
    angle = -EARTH_ROTATION_RAD_S * duration
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]]
    )
    place = turn @ end[:3]
    return place, turn @ end[3:] - np.cross(SPIN, place)


@pytest.mark.parametrize("duration", [7.0, 60.0, 200.0, -120.0])
def test_propagation_against_axes_at_rest(duration):
    for seed in range(3):
        rng = np.random.default_rng(seed)
        direction, aside = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
        position, velocity = 6.7e6 * direction, 7.5e3 * aside
        found, _ = propagate(
            np.concatenate([position, velocity])[None], np.array([duration]), "ecef"
        )
        place, speed = inertial_fall(position, velocity, duration)
        # Steps of 5 s cost below a micrometre each, which later ones carry along.
        np.testing.assert_allclose(found[0, :3], place, rtol=0.0, atol=1e-4)
        np.testing.assert_allclose(found[0, 3:], speed, rtol=0.0, atol=1e-6)


def test_jacobi_constant_is_kept():
    """Energy less angular speed times axial momentum: v^2/2 + U - w^2 (x^2 + y^2)/2 in ECEF."""
    rng = np.random.default_rng(1)
    for _ in range(5):
        position, _ = random_state(rng)
        aside = np.cross(position, rng.normal(size=3))
        velocity = aside / np.linalg.norm(aside) * 7e3

        def constant(state):
            turning = 0.5 * EARTH_ROTATION_RAD_S**2 * np.sum(state[:2] ** 2)
            return 0.5 * np.sum(state[3:] ** 2) + potential(state[:3]) - turning

        start = np.concatenate([position, velocity])
        end, _ = propagate(start[None], np.array([600.0]), "ecef")
        assert constant(end[0]) == pytest.approx(constant(start), rel=1e-11)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(seeds, st.sampled_from([0.3, 5.0, 33.0, 60.0, -20.0]), st.sampled_from(["ecef", "local"]))
def test_derivative_of_the_propagation(seed, duration, frame):
    state = np.concatenate(random_state(np.random.default_rng(seed)))
    step = np.array([duration])
    _, jacobian = propagate(state[None], step, frame)
    assert_derivative(
        jacobian[0],
        lambda at: propagate(at[None], step, frame)[0][0],
        state,
        np.repeat([6e3, 6.0], 3),
        rtol=1e-8,
    )


def test_many_states_at_once_are_each_on_its_own():
    rng = np.random.default_rng(2)
    states = np.stack([np.concatenate(random_state(rng)) for _ in range(4)])
    together, _ = propagate(states, np.full(4, 31.0), "ecef")
    for row in range(4):
        alone, _ = propagate(states[row : row + 1], np.array([31.0]), "ecef")
        np.testing.assert_array_equal(together[row], alone[0])


def test_projectile_in_a_local_frame():
    end, _ = propagate(np.array([[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]]), np.array([2.0]), "local")
    expected = [9.0, 12.0, 15.0 - 0.5 * 9.80665 * 4.0, 4.0, 5.0, 6.0 - 2.0 * 9.80665]
    np.testing.assert_allclose(end[0], expected, rtol=1e-14)


def test_three_orbits_in_steps_of_a_minute():
    """Transitions from knot to knot over a gap, against one integration in axes at rest."""
    position = np.array([6.9e6, 0.0, 0.0])
    velocity = np.array([0.0, 4.2e3, 6.1e3])

    def rates(_, state):
        p = state[:3]
        gravity, _, _ = acceleration(p[None], np.zeros((1, 3)), "ecef", 4)
        # Zonal harmonics are the same in axes at rest; what turns is taken off again.
        return np.concatenate([state[3:], gravity[0] + np.cross(SPIN, np.cross(SPIN, p))])

    start = np.concatenate([position, velocity + np.cross(SPIN, position)])
    duration = 3.0 * 5700.0
    end = solve_ivp(rates, (0.0, duration), start, method="DOP853", rtol=1e-13, atol=1e-6).y[:, -1]
    angle = -EARTH_ROTATION_RAD_S * duration
    cos, sin = np.cos(angle), np.sin(angle)
    expected = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ end[:3]
    state = np.concatenate([position, velocity])[None]
    whole = np.eye(6)
    for _ in range(285):
        state, jacobian = propagate(state, np.array([60.0]), "ecef", 4)
        whole = jacobian[0] @ whole
    assert np.linalg.norm(state[0, :3] - expected) < 0.01
    # The product of the steps' derivatives is the derivative of the whole.
    moved = []
    for sign in (1.0, -1.0):
        other = np.concatenate([position + sign * np.array([3.0, 0.0, 0.0]), velocity])[None]
        for _ in range(285):
            other, _ = propagate(other, np.array([60.0]), "ecef", 4)
        moved.append(other[0])
    np.testing.assert_allclose(whole[:, 0], (moved[0] - moved[1]) / 6.0, rtol=1e-5, atol=1e-8)
