"""Structured elimination against dense algebra, and against arithmetic of 60 digits."""

from dataclasses import replace

import numpy as np
import pytest
import stiff_chain
from hypothesis import given, settings
from hypothesis import strategies as st

from geograph.blocks import Sums
from geograph.eliminate import Elimination, LinearSystem, NotPositiveDefiniteError

PROFILE = settings(max_examples=60, deadline=None, derandomize=True)


def random_system(rng, knots, d, s, *, undriven=0, rows=3):
    """Return a system of random measurements; the last ``undriven`` components have no noise."""
    states = 2 * d if knots > 1 else d
    width = states + s + 1
    dense = rng.normal(size=(max(knots - 1, 1), rows, width))
    root = np.tril(rng.normal(size=(knots - 1, d, d))) + 2.0 * np.eye(d)
    root[:, :, d - undriven :] = 0.0
    return LinearSystem(
        blocks=Sums.of(np.swapaxes(dense, 1, 2) @ dense, states),
        inverse_transition=np.eye(d) + 0.3 * rng.normal(size=(knots - 1, d, d)) / d,
        noise_root=root * rng.choice([1.0, 1e-2]),
        noise_residual=rng.normal(size=(knots - 1, d)) * (np.arange(d) < d - undriven),
        prior_information=rng.uniform(0.1, 1.0, d),
        prior_gradient=rng.normal(size=d),
        constants=rng.normal(size=s),
        cost=3.0,
    )


def dense_form(system, damping):
    """Return information and gradient of (x[0], w[0], w[1], ..., constants), and all x by them."""
    d, s, count = system.knot_size, system.constants.size, system.knots - 1
    size = d + count * d + s
    states = [np.eye(d, size)]
    for k in range(count):
        forward = np.linalg.inv(system.inverse_transition[k])
        noise = np.zeros((d, size))
        noise[:, d + k * d : 2 * d + k * d] = system.noise_root[k]
        states.append(forward @ states[-1] + noise)
    constants = np.eye(size)[size - s :]
    information, gradient = np.zeros((size, size)), np.zeros(size)
    for k, block in enumerate(system.blocks.full()):
        parts = states[k : k + 2] if count else states[:1]
        turn = np.concatenate([*parts, constants])
        information += turn.T @ block[:-1, :-1] @ turn
        gradient += turn.T @ block[:-1, -1]
    for k in range(count):
        noise = np.eye(size)[d + k * d : 2 * d + k * d]
        information += noise.T @ noise
        gradient += noise.T @ system.noise_residual[k]
    information += states[0].T @ np.diag(system.prior_information) @ states[0]
    gradient += states[0].T @ system.prior_gradient
    information += constants.T @ constants
    gradient += constants.T @ system.constants
    undamped = information.copy()
    everything = np.concatenate([*states, constants])
    information += damping * everything.T @ everything
    return information, gradient, undamped, states, constants


shapes = st.tuples(st.integers(1, 5), st.integers(1, 4), st.integers(0, 3))


@PROFILE
@given(st.integers(0, 2**32 - 1), shapes, st.sampled_from([0.0, 1e-3, 10.0]), st.integers(0, 4))
def test_step_decrease_and_covariances(seed, shape, damping, undriven):
    knots, d, s = shape
    system = random_system(np.random.default_rng(seed), knots, d, s, undriven=min(undriven, d))
    information, gradient, undamped, states, constants = dense_form(system, damping)
    point = -np.linalg.solve(information, gradient)
    elimination = Elimination(system, damping)
    step = elimination.solve()
    close = {"rtol": 1e-8, "atol": 1e-10}
    np.testing.assert_allclose(step.knots, [state @ point for state in states], **close)
    np.testing.assert_allclose(step.constants, constants @ point, **close)
    decrease = -(gradient @ point + 0.5 * point @ undamped @ point)
    assert step.decrease == pytest.approx(decrease, rel=1e-8, abs=1e-10)

    covariance = np.linalg.inv(information)
    found = elimination.marginals()
    for k, state in enumerate(states):
        np.testing.assert_allclose(found.knots[k], state @ covariance @ state.T, **close)
        np.testing.assert_allclose(
            found.knot_constants[k], state @ covariance @ constants.T, **close
        )
        if k:
            np.testing.assert_allclose(
                found.neighbours[k - 1], states[k - 1] @ covariance @ state.T, **close
            )
    np.testing.assert_allclose(found.constants, constants @ covariance @ constants.T, **close)
    if damping == 0.0:
        _, expected = np.linalg.slogdet(information)
        assert elimination.half_log_determinant() == pytest.approx(0.5 * expected, abs=1e-9)


def test_the_system_is_left_as_it_was():
    """A damped attempt after an undamped one starts from the same numbers."""
    system = random_system(np.random.default_rng(0), 4, 3, 2)
    parts = {**vars(system), **vars(system.blocks)}
    del parts["blocks"]
    before = {name: np.copy(value) for name, value in parts.items()}
    Elimination(system, 5.0).solve()
    Elimination(system).marginals()
    for name, value in parts.items():
        np.testing.assert_array_equal(value, before[name])


def test_damping_takes_out_what_is_not_determined():
    system = random_system(np.random.default_rng(1), 3, 2, 1)
    system = replace(
        system,
        blocks=Sums(*map(np.zeros_like, vars(system.blocks).values())),
        prior_information=np.zeros(2),
    )
    with pytest.raises(NotPositiveDefiniteError):
        Elimination(system)
    assert np.isfinite(Elimination(system, 1e-3).solve().knots).all()


@pytest.mark.parametrize("knots", [1, 4])
@pytest.mark.parametrize("bad", [np.nan, -1e9])
def test_an_indefinite_system_is_refused(knots, bad):
    system = random_system(np.random.default_rng(2), knots, 3, 2)
    blocks = replace(system.blocks, knots=system.blocks.knots.copy())
    blocks.knots[0, 0, 0] += bad
    with pytest.raises(NotPositiveDefiniteError):
        Elimination(replace(system, blocks=blocks))


# Noise from a thousand times that of a measurement, in a second, to a millionth of a millionth.
@pytest.mark.parametrize("noise", [1e3, 1.0, 1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12])
def test_a_stiff_chain_keeps_its_digits(noise):
    """200 knots: 1e-10 of the covariance whatever the noise (measured: below 2e-11)."""
    truth = stiff_chain.exactly(200, noise)
    estimate, covariance = stiff_chain.errors(stiff_chain.structured(200, noise), truth)
    assert estimate < 1e-11
    assert covariance < 1e-10


def test_other_ways_lose_them():
    """Why the noise is eliminated instead of the states (docs/design.md)."""
    truth = stiff_chain.exactly(200, 1e-4)
    _, information = stiff_chain.errors(stiff_chain.in_information_form(200, 1e-4), truth)
    _, triangle = stiff_chain.errors(stiff_chain.by_orthogonal_triangle(200, 1e-4), truth)
    assert information > 1e-6
    assert 1e-11 < triangle < 1e-6
    with pytest.raises(np.linalg.LinAlgError):
        stiff_chain.in_information_form(200, 1e-6)
