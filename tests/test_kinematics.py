"""Gaussian-process priors against the matrix exponential and against Gaussian conditioning."""

import numpy as np
import pytest
from differences import assert_derivative
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from geograph.factors.kinematics import (
    conditional_covariance,
    interpolation_matrices,
    interpolation_weights,
    noise_covariance,
    noise_square_root,
    spatial_square_root,
    spatial_square_root_derivative,
    transition,
    unit_vectors,
)

PROFILE = settings(max_examples=60, deadline=None, derandomize=True)
orders = st.sampled_from([1, 2, 3])
steps = st.floats(1e-3, 1e3)
shares = st.floats(0.0, 1.0)


def scaled(order, step):
    """Units in which blocks of a state are of the same size: step^0, step^-1, step^-2."""
    return step ** -np.arange(order, dtype=float)


def van_loan(order, step):
    """Return transition and noise covariance by one matrix exponential (C. Van Loan, 1978)."""
    drift = np.diag(np.ones(order - 1), 1)
    noise = np.zeros((order, order))
    noise[-1, -1] = 1.0
    block = expm(np.block([[-drift, noise], [np.zeros_like(drift), drift.T]]) * step)
    phi = block[order:, order:].T
    return phi, phi @ block[:order, order:]


@PROFILE
@given(orders, st.floats(1e-2, 10.0))
def test_transition_and_noise_are_those_of_the_matrix_exponential(order, step):
    phi, noise = van_loan(order, step)
    np.testing.assert_allclose(transition(order, step), phi, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(noise_covariance(order, step), noise, rtol=1e-9)
    np.testing.assert_allclose(transition(order, -step), np.linalg.inv(phi), rtol=1e-12, atol=1e-12)


@PROFILE
@given(orders, st.floats(1e-6, 1e6))
def test_noise_square_root(order, step):
    root = noise_square_root(order, step)
    assert not np.triu(root, 1).any()
    np.testing.assert_allclose(root @ root.T, noise_covariance(order, step), rtol=1e-13)


@PROFILE
@given(orders, steps, steps)
def test_two_steps_are_one(order, first, second):
    phi = transition(order, second)
    np.testing.assert_allclose(
        phi @ transition(order, first), transition(order, first + second), rtol=1e-12
    )
    carried = phi @ noise_covariance(order, first) @ phi.T + noise_covariance(order, second)
    np.testing.assert_allclose(carried, noise_covariance(order, first + second), rtol=1e-12)


@PROFILE
@given(orders, steps, shares)
def test_interpolation_is_the_textbook_formula(order, step, share):
    """Psi = Q(tau) Phi(h - tau)^T Q(h)^-1, Lambda = Phi(tau) - Psi Phi(h) (Barfoot, eq. 11.15)."""
    tau = share * step
    _, q_tau = van_loan(order, share)
    _, q_step = van_loan(order, 1.0)
    phi_rest, phi_step, phi_tau = (expm(np.diag(np.ones(order - 1), 1) * x) for x in
                                   (1.0 - share, 1.0, share))  # fmt: skip
    psi = q_tau @ phi_rest.T @ np.linalg.inv(q_step)
    expected = np.concatenate([phi_tau - psi @ phi_step, psi], axis=1)
    # In units of the step, in which nothing is badly scaled.
    unit = scaled(order, step)
    found = interpolation_matrices(order, np.array([step]), np.array([tau]))[0]
    found = found / unit[:, None] * np.tile(unit, 2)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-10)


@PROFILE
@given(orders, steps, shares)
def test_conditional_covariance_is_that_of_the_joint_gaussian(order, step, share):
    """Condition the middle of three states of the chain, first one known, on the last."""
    _, first = van_loan(order, share)
    phi, second = van_loan(order, 1.0 - share)
    joint = np.block([[first, first @ phi.T], [phi @ first, phi @ first @ phi.T + second]])
    middle, cross, last = joint[:order, :order], joint[:order, order:], joint[order:, order:]
    expected = middle - cross @ np.linalg.solve(last, cross.T)
    found = conditional_covariance(order, np.array([step]), np.array([share * step]))[0]
    powers = step ** (order - 0.5 - np.arange(order))
    np.testing.assert_allclose(found / np.outer(powers, powers), expected, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize(("order", "value"), [(1, 1 / 4), (2, 1 / 192), (3, 1 / 20480)])
def test_conditional_variance_in_the_middle(order, value):
    """Of the Brownian bridge and its integrals, pinned at both ends with all derivatives."""
    found = conditional_covariance(order, np.array([1.0]), np.array([0.5]))[0, 0, 0]
    assert found == pytest.approx(value, rel=1e-9)


@PROFILE
@given(orders, steps, st.floats(1e-6, 5.0))
def test_beyond_the_interval_the_nearer_state_is_predicted(order, step, far):
    beyond = far * step
    for offset, block, back in ((step + beyond, 1, beyond), (-beyond, 0, -beyond)):
        found = interpolation_matrices(order, np.array([step]), np.array([offset]))[0]
        expected = np.zeros((order, 2 * order))
        expected[:, block * order : (block + 1) * order] = transition(order, back)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * beyond**order)
    found = conditional_covariance(
        order, np.array([step, step]), np.array([step + beyond, -beyond])
    )
    powers = np.outer(*[beyond ** (order - 0.5 - np.arange(order))] * 2)
    phi = transition(order, -1.0)
    unit = noise_covariance(order, 1.0)
    np.testing.assert_allclose(found[0] / powers, unit, rtol=0.0, atol=1e-12 * (1 + 1 / far**5))
    np.testing.assert_allclose(
        found[1] / powers, phi @ unit @ phi.T, rtol=0.0, atol=1e-12 * (1 + 1 / far**5)
    )


@PROFILE
@given(orders, steps)
def test_extrapolation_continues_the_path(order, step):
    """Value and derivatives up to the order join at both ends."""
    small = 1e-9 * step
    unit = scaled(order, step)
    for end in (0.0, step):
        at = interpolation_matrices(
            order, np.full(3, step), np.array([end - small, end, end + small])
        )
        at = at / unit[:, None] * np.tile(unit, 2)
        np.testing.assert_allclose(at[[0, 2]], at[[1, 1]], rtol=0.0, atol=1e-6)


@PROFILE
@given(orders, steps, st.floats(0.01, 0.99))
def test_derivative_weights_are_derivatives(order, step, share):
    def weights(at, derivative):
        return interpolation_weights(order, np.array([step]), at, derivative=derivative)[0]

    for derivative in range(1, order):
        assert_derivative(
            weights(np.array([share * step]), derivative)[:, None],
            lambda at, d=derivative - 1: weights(at, d),
            np.array([share * step]),
            1e-3 * step,
            rtol=1e-9,
        )


@PROFILE
@given(
    st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3),
    st.sampled_from([1e-6, 1e-3, 1.0, 1e4]),
    st.integers(0, 1000),
)
def test_along_and_across_the_velocity(direction, speed, seed):
    """Also for speeds near zero: only the direction counts, and it turns by 1 / speed."""
    rng = np.random.default_rng(seed)
    velocity = np.array([direction]) * speed
    root = spatial_square_root(velocity, 2.0, 30.0)[0]
    u = velocity[0] / np.linalg.norm(velocity)
    np.testing.assert_allclose(root @ u, 30.0 * u, rtol=0.0, atol=1e-13)
    aside = np.cross(u, rng.normal(size=3))
    np.testing.assert_allclose(root @ aside, 2.0 * aside, rtol=0, atol=1e-12)
    inverse = spatial_square_root(velocity, 1.0 / 2.0, 1.0 / 30.0)[0]
    np.testing.assert_allclose(root @ inverse, np.eye(3), atol=1e-13)
    vectors = rng.normal(size=(1, 2, 3))
    found = spatial_square_root_derivative(velocity, 2.0, 30.0, vectors)[0]
    assert_derivative(
        found.reshape(6, 3),
        lambda at: vectors[0] @ spatial_square_root(at[None], 2.0, 30.0)[0],
        velocity[0],
        1e-3 * np.linalg.norm(velocity),
        rtol=1e-9,
    )


def test_an_object_at_rest_has_isotropic_noise():
    rest = np.zeros((1, 3))
    np.testing.assert_array_equal(unit_vectors(rest), rest)
    np.testing.assert_array_equal(spatial_square_root(rest, 2.0, 30.0)[0], 2.0 * np.eye(3))
    slope = spatial_square_root_derivative(rest, 2.0, 30.0, np.ones((1, 1, 3)))
    np.testing.assert_array_equal(slope, np.zeros((1, 1, 3, 3)))
