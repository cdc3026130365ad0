"""Paths between knots: continuity, derivatives, and free fall."""

import numpy as np
import pytest
from differences import assert_derivative, derivative
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from geograph.constants import EARTH_GM_M3_S2, EARTH_ROTATION_RAD_S
from geograph.factors.gravity import acceleration, propagate
from geograph.path import BallisticPath, KinematicPath

PROFILE = settings(max_examples=40, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
KNOTS = np.array([-3.0, 4.0, 9.0, 21.0])


def random_path(rng, kind):
    """Return a path and states of its knots that belong to no smooth motion."""
    if kind in (1, 2, 3):
        state = rng.normal(size=(4, 3 * kind)) * np.repeat([100.0, 10.0, 1.0][:kind], 3)
        return KinematicPath(KNOTS, kind), state
    state = rng.normal(size=(4, 6)) * np.repeat([100.0, 10.0], 3)
    if kind == "ecef":
        state[:, :3] += [7e6, 1e5, -2e6]
        state[:, 3:] += [-1e3, 5e3, 3e3]
    return BallisticPath(KNOTS, kind), state


kinds = st.sampled_from([1, 2, 3, "local", "ecef"])


@PROFILE
@given(seeds, kinds)
def test_it_passes_through_its_knots(seed, kind):
    path, state = random_path(np.random.default_rng(seed), kind)
    position, velocity = path.at_state(state, jacobian=False).position_velocity(path.locate(KNOTS))
    np.testing.assert_allclose(position, state[:, :3], rtol=1e-15, atol=1e-12)
    if kind != 1:
        np.testing.assert_allclose(velocity, state[:, 3:6], rtol=1e-12, atol=1e-10)


@PROFILE
@given(seeds, kinds)
def test_velocity_is_the_derivative_of_position(seed, kind):
    rng = np.random.default_rng(seed)
    path, state = random_path(rng, kind)
    times = np.concatenate(
        [KNOTS[:-1] + rng.uniform(0.1, 0.9, 3) * np.diff(KNOTS), [KNOTS[0] - 2.0, KNOTS[-1] + 3.0]]
    )
    held = path.at_state(state, jacobian=False)

    def position(shift):
        return held.position_velocity(path.locate(times + shift[0]))[0]

    _, velocity = held.position_velocity(path.locate(times))
    if kind in ("local", "ecef"):
        # Beyond the knots the polynomial goes on; results there are read by Motion.read.
        velocity, position_of = velocity[:3], position

        def position(shift):
            return position_of(shift)[:3]

    scale = np.abs(state[:, :3]).max()
    np.testing.assert_allclose(
        derivative(position, [0.0], [0.02])[:, 0],
        velocity.ravel(),
        rtol=0.0,
        atol=1e-9 * scale if kind == "ecef" else 5e-6,
    )


@PROFILE
@given(seeds, kinds)
def test_derivatives_by_both_neighbours(seed, kind):
    rng = np.random.default_rng(seed)
    path, state = random_path(rng, kind)
    times = np.concatenate([rng.uniform(KNOTS[0], KNOTS[-1], 4), KNOTS])
    place = path.locate(times)
    by_position, by_velocity = rng.normal(size=(2, times.size, 2, 3))
    by_velocity *= 5.0

    def read(vector, use_velocity):
        held = path.at_state(vector.reshape(state.shape), jacobian=False)
        position, velocity = held.position_velocity(place)
        value = np.einsum("nrc,nc->nr", by_position, position)
        if use_velocity:
            value += np.einsum("nrc,nc->nr", by_velocity, velocity)
        return value

    held = path.at_state(state, jacobian=True)
    steps = np.tile(np.repeat([10.0, 1.0, 0.1][: state.shape[1] // 3], 3), 4)
    for use_velocity in (False, True):
        chained = held.chain(place, by_position, by_velocity if use_velocity else None)
        dense = np.zeros((times.size, 2, 4, state.shape[1]))
        for n, k in enumerate(place.interval):
            dense[n, :, k] += chained[n, :, 0]
            dense[n, :, k + 1] += chained[n, :, 1]
        assert_derivative(
            dense, lambda at, u=use_velocity: read(at, u), state.ravel(), steps, rtol=1e-7
        )


def test_places_are_clipped_to_the_first_and_last_interval():
    place = KinematicPath(KNOTS, 2).locate(np.array([-10.0, -3.0, 3.9, 4.0, 21.0, 30.0]))
    np.testing.assert_array_equal(place.interval, [0, 0, 0, 1, 2, 2])
    np.testing.assert_array_equal(place.offset_s, [-7.0, 0.0, 6.9, 0.0, 12.0, 21.0])
    np.testing.assert_array_equal(place.step_s, [7.0, 7.0, 7.0, 5.0, 12.0, 12.0])


def test_one_knot_stands_still():
    path = KinematicPath(np.array([5.0]), 1)
    place = path.locate(np.array([-100.0, 5.0, 1e6]))
    position, velocity = path.at_state(np.array([[1.0, 2.0, 3.0]])).position_velocity(place)
    np.testing.assert_array_equal(position, [[1.0, 2.0, 3.0]] * 3)
    np.testing.assert_array_equal(velocity, np.zeros((3, 3)))


@pytest.mark.parametrize(("step", "bound"), [(10.0, 1e-6), (30.0, 3e-6), (60.0, 2.5e-5)])
def test_free_fall_between_knots(step, bound):
    """Good to 0.02 mm over 60 s on a circle 200 km up; below 30 s the steps of 5 s decide."""
    radius = 6.58e6
    speed = np.sqrt(EARTH_GM_M3_S2 / radius)
    turning = EARTH_ROTATION_RAD_S * radius
    start = np.array([radius, 0.0, 0.0, 0.0, 0.6 * speed - turning, 0.8 * speed])

    def rates(_, state):
        value, _, _ = acceleration(state[None, :3], state[None, 3:], "ecef")
        return np.concatenate([state[3:], value[0]])

    times = np.linspace(0.0, step, 41)
    truth = solve_ivp(
        rates, (0.0, step), start, method="DOP853", rtol=1e-13, atol=1e-8, t_eval=times
    ).y.T
    end, _ = propagate(start[None], np.array([step]), "ecef")
    path = BallisticPath(np.array([0.0, step]), "ecef")
    held = path.at_state(np.stack([start, end[0]]), jacobian=False)
    found, _ = held.position_velocity(path.locate(times))
    assert np.abs(found - truth[:, :3]).max() < bound


def test_a_miss_is_shared_as_by_constant_velocity():
    """What noise on the acceleration adds between two knots is the cubic through the miss."""
    rng = np.random.default_rng(0)
    _, state = random_path(rng, "local")
    fall, _ = propagate(state[:-1], np.diff(KNOTS), "local")
    path = BallisticPath(KNOTS, "local")
    times = np.linspace(KNOTS[1], KNOTS[2], 9)
    found, _ = path.at_state(state, jacobian=False).position_velocity(path.locate(times))
    pure, _ = propagate(np.repeat(state[1:2], 9, axis=0), times - KNOTS[1], "local")
    miss = KinematicPath(KNOTS[1:3], 2)
    blocks = np.stack([np.zeros(6), state[2] - fall[1]])
    added, _ = miss.at_state(blocks).position_velocity(miss.locate(times))
    np.testing.assert_allclose(found, pure[:, :3] + added, rtol=0.0, atol=1e-10)
