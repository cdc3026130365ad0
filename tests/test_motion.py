"""Motion models: whitened residuals, their derivatives, and what lies between and beyond knots."""

import numpy as np
import pytest
from differences import assert_derivative
from hypothesis import given, settings
from hypothesis import strategies as st

from geograph.errors import InputError
from geograph.factors.kinematics import noise_covariance
from geograph.motion import Density, Motion, kron_stack

PROFILE = settings(max_examples=60, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
STEPS = np.array([4.0, 11.0, 0.7])
KNOTS = np.concatenate([[2.0], 2.0 + np.cumsum(STEPS)])
MOTIONS = ("constant-position", "constant-velocity", "constant-acceleration", "ballistic")


def random_states(rng, motion, frame, *, speed=10.0):
    size = motion.order
    state = rng.normal(size=(4, 3 * size)) * np.repeat([100.0, speed, 1.0][:size], 3)
    if frame == "ecef":
        state[:, :3] += [7e6, -1e6, 2e6]
    return state


@PROFILE
@given(
    seeds,
    st.sampled_from(MOTIONS),
    st.sampled_from(["local", "ecef"]),
    st.sampled_from(["one", "axes", "along"]),
    st.sampled_from([1e3, 10.0, 1e-3]),
)
def test_derivatives_of_the_transitions(seed, name, frame, form, speed):
    """w = L^-1 (x2 - f(x1)): dw/dx2 is L^-1, dw/dx1 is -L^-1 F, also where the noise turns."""
    density = Density.of((1.0, 3.0, 0.2) if form == "axes" else 0.7)
    if form == "along" and name != "constant-position":
        density = Density.of(0.7, 30.0)
    motion = Motion(name, density, frame)
    state = random_states(np.random.default_rng(seed), motion, frame, speed=speed)
    found = motion.transitions(state, STEPS)
    size = state.shape[1]
    for k in range(3):
        inverse = np.linalg.inv(found.noise_root[k])
        analytic = np.concatenate([-inverse @ found.transition[k], inverse], axis=1)
        steps = np.tile(np.repeat([10.0, 1.0, 0.1][: motion.order], 3), 2)
        if motion.order > 1:
            steps[3:6] = 1e-3 * np.linalg.norm(state[k, 3:6])
        assert_derivative(
            analytic,
            lambda at, k=k: motion.transitions(at.reshape(2, size), STEPS[k : k + 1]).residual,
            state[k : k + 2].ravel(),
            steps,
            rtol=1e-6,
        )
    assert motion.cost(state, STEPS) == pytest.approx(0.5 * np.sum(found.residual**2))


@PROFILE
@given(seeds, st.sampled_from(MOTIONS), st.sampled_from([None, 5.0]))
def test_noise_roots_are_those_of_the_covariance(seed, name, along):
    if name == "constant-position":
        along = None
    motion = Motion(name, Density.of(0.5, along), "local")
    state = random_states(np.random.default_rng(seed), motion, "local")
    roots = motion.transitions(state, STEPS).noise_root
    covariance = motion.noise(state[:-1], STEPS)
    np.testing.assert_allclose(roots @ np.swapaxes(roots, 1, 2), covariance, rtol=1e-9, atol=1e-12)
    if along is None:
        expected = [np.kron(noise_covariance(motion.order, h), 0.25 * np.eye(3)) for h in STEPS]
        np.testing.assert_allclose(covariance, expected, rtol=1e-14)
        return
    # The acceleration's variance per unit time is along^2 on the velocity, across^2 beside it.
    last = covariance[:, -3:, -3:] / STEPS[:, None, None]
    for k in range(3):
        u = state[k, 3:6] / np.linalg.norm(state[k, 3:6])
        assert u @ last[k] @ u == pytest.approx(along**2)
        assert np.trace(last[k]) == pytest.approx(along**2 + 2 * 0.25)


@PROFILE
@given(seeds, st.sampled_from(MOTIONS), st.sampled_from(["local", "ecef"]))
def test_a_path_that_follows_the_mean_costs_nothing(seed, name, frame):
    motion = Motion(name, Density.of(1e-3), frame)
    state = random_states(np.random.default_rng(seed), motion, frame)
    for k, step in enumerate(STEPS):
        state[k + 1] = motion.predict(state[k : k + 1], np.array([step]))[0][0]
    assert motion.cost(state, STEPS) < 1e-6
    # And between the knots, and beyond them, it is that mean.
    times = np.linspace(KNOTS[0] - 3.0, KNOTS[-1] + 5.0, 60)
    read = motion.read(motion.path(KNOTS), state, times)
    mean, _ = motion.predict(np.repeat(state[:1], 60, axis=0), times - KNOTS[0])
    np.testing.assert_allclose(read[:, :3], mean[:, :3], rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(read[:, 3:], mean[:, 3:], rtol=0.0, atol=1e-7)


@PROFILE
@given(seeds, st.sampled_from(MOTIONS))
def test_reading_at_knots_and_joining_of_predictions(seed, name):
    motion = Motion(name, Density.of(1.0), "local")
    state = random_states(np.random.default_rng(seed), motion, "local")
    path = motion.path(KNOTS)
    np.testing.assert_allclose(motion.read(path, state, KNOTS), state, rtol=0.0, atol=1e-9)
    ends = np.array([KNOTS[0] - 1e-7, KNOTS[-1] + 1e-7])
    np.testing.assert_allclose(motion.read(path, state, ends), state[[0, -1]], rtol=0, atol=1e-4)


def test_static_has_one_state_and_no_noise():
    motion = Motion("static", Density.of(1.0), "local")
    state = np.array([[1.0, 2.0, 3.0]] * 4)
    found = motion.transitions(state, STEPS)
    assert not found.residual.any()
    assert not found.noise_root.any()
    assert not motion.noise(state[:-1], STEPS).any()
    np.testing.assert_array_equal(found.transition, [np.eye(3)] * 3)
    alone = motion.read(motion.path(KNOTS[:1]), state[:1], np.array([-5.0, 7.0]))
    np.testing.assert_array_equal(alone, state[:2])


def test_densities():
    assert Density.of(2.0) == Density((2.0, 2.0, 2.0))
    assert Density.of((1.0, 2.0, 3.0)).scaled(2.0) == Density((2.0, 4.0, 6.0))
    assert Density.of(1.0, 4.0).scaled(0.5) == Density.of(0.5, 2.0)
    assert Density.of(1.0, 4.0).largest == 4.0
    assert Density.of((1.0, 5.0, 2.0)).largest == 5.0
    velocity = np.array([[0.0, 3.0, 0.0], [1.0, 1.0, 0.0]])
    for density in (Density.of((1.0, 2.0, 3.0)), Density.of(2.0, 9.0)):
        product = density.square_root(velocity, 2) @ density.inverse_square_root(velocity, 2)
        np.testing.assert_allclose(product, [np.eye(3)] * 2, atol=1e-15)


def test_noise_along_a_velocity_that_is_no_state():
    with pytest.raises(InputError, match="needs a motion that has a velocity"):
        Motion("constant-position", Density.of(1.0, 2.0), "local")


def test_stacked_kronecker_products():
    rng = np.random.default_rng(0)
    left, right = rng.normal(size=(5, 3, 3)), rng.normal(size=(5, 2, 2))
    expected = [np.kron(a, b) for a, b in zip(left, right, strict=True)]
    np.testing.assert_array_equal(kron_stack(left, right), expected)
