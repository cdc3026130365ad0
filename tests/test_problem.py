"""Problems: the linear system is the cost's own gradient and Gauss-Newton matrix."""

import numpy as np
import pytest
from differences import assert_derivative
from hypothesis import given, settings
from hypothesis import strategies as st
from made_problem import Kind, dense_jacobian, pack, random_problem, unpack

from geograph.eliminate import Elimination
from geograph.losses import Loss
from geograph.motion import Density

MOTIONS = ("constant-position", "constant-velocity", "constant-acceleration", "ballistic")

kinds = st.builds(
    Kind,
    frame=st.sampled_from(["local", "ecef"]),
    motion=st.sampled_from(MOTIONS),
    along=st.booleans(),
    per_axis=st.booleans(),
    enu=st.booleans(),
    clocks=st.booleans(),
    walks=st.booleans(),
    constraints=st.booleans(),
    knots=st.integers(2, 4),
)


def scales(problem, values):
    """Return what one scaled unit of every unknown is, in the order of ``pack``."""
    return np.concatenate(
        [
            np.tile(problem.path_scale, values.path.shape[0]),
            np.ones(values.walks.size + values.constants.size),
        ]
    )


def dense_gradient(problem, values):
    """Return the gradient by all scaled unknowns, from the linear system."""
    system = problem.linearise(values)
    d, m = problem.layout.knot, problem.layout.path
    knots = values.path.shape[0]
    by_knots = np.zeros((knots, d))
    column = system.blocks.full()[:, :-1, -1]
    by_knots[0] += system.prior_gradient
    by_constants = system.constants + column[:, 2 * d if knots > 1 else d :].sum(axis=0)
    if knots == 1:
        by_knots[0] += column[0, :d]
    for k in range(knots - 1):
        by_knots[k] += column[k, :d]
        by_knots[k + 1] += column[k, d : 2 * d]
        if problem.motion.static:
            continue
        # w = L^-1 (dx[k+1] - F dx[k]).
        pull = np.linalg.solve(system.noise_root[k].T, system.noise_residual[k])
        by_knots[k + 1] += pull
        by_knots[k] -= np.linalg.inv(system.inverse_transition[k]).T @ pull
    return np.concatenate([by_knots[:, :m].ravel(), by_knots[:, m:].ravel(), by_constants])


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32 - 1),
    kind=kinds,
    loss=st.sampled_from(["none", "huber", "cauchy", "geman-mcclure"]),
    weighted=st.booleans(),
)
def test_the_linear_system_holds_the_gradient_of_the_cost(seed, kind, loss, weighted):
    """All of it at once: measurements, losses, weights, priors, transitions, walks."""
    rng = np.random.default_rng(seed)
    if kind.motion == "constant-position" and kind.along:
        return
    problem, values = random_problem(rng, kind)
    weights = [rng.random(len(f)) if weighted else None for f in problem.families]
    problem = problem.with_weights(weights, Loss(loss))
    point, scale = pack(values), scales(problem, values)
    gradient = dense_gradient(problem, values)
    # One direction at a time of a few random ones: the cost is one number.
    for _ in range(4):
        direction = rng.normal(size=point.size) * scale * 0.01

        def cost(shift, direction=direction):
            return [problem.cost(unpack(point + shift[0] * direction, values))]

        slope = gradient @ (direction / scale)
        size = np.abs(gradient) @ np.abs(direction / scale)
        assert_derivative(
            np.array([[slope]]), cost, np.zeros(1), 1e-2, rtol=1e-6,
            floor=1e-2 * size + 1e-9 * problem.cost(values),
        )  # fmt: skip
    assert problem.linearise(values).cost == pytest.approx(problem.cost(values), rel=1e-12)


@pytest.mark.parametrize("motion", [*MOTIONS, "static"])
def test_blocks_are_the_gauss_newton_matrix(motion):
    kind = Kind(motion=motion, walks=motion != "static", constraints=True, form="mixed")
    rng = np.random.default_rng(5)
    problem, values = random_problem(rng, kind)
    weights = [rng.random(len(f)) for f in problem.families]
    problem = problem.with_weights(weights)
    expected, scale = 0.0, scales(problem, values)
    for found, weight in zip(problem.evaluate(values, jacobian=True), weights, strict=True):
        rows = dense_jacobian(found, values) * scale
        expected += rows.T @ (rows * np.repeat(weight, found.residual.shape[1])[:, None])
    system = problem.linearise(values)
    d, m, w = problem.layout.knot, problem.layout.path, problem.layout.walks
    knots = values.path.shape[0]
    place = {}
    for k in range(knots):
        place[k] = [
            *range(k * m, k * m + m),
            *range(knots * m + k * w, knots * m + k * w + w),
        ]
    constants = list(range(knots * d, expected.shape[0]))
    total = np.zeros_like(expected)
    for k, block in enumerate(system.blocks.full()):
        index = place[k] + (place[k + 1] if knots > 1 else []) + constants
        total[np.ix_(index, index)] += block[:-1, :-1]
    np.testing.assert_allclose(total, expected, rtol=0.0, atol=1e-11 * np.abs(expected).max())


def test_copies_share_all_but_what_is_changed():
    problem, values = random_problem(np.random.default_rng(1), Kind())
    other = problem.with_motion(problem.motion.with_density(Density.of(123.0)))
    assert other.motion.density.largest == 123.0
    assert problem.motion.density.largest != 123.0
    assert other.families[0] is problem.families[0]
    weighted = problem.with_weights([np.zeros(9)])
    assert weighted.cost(values) == pytest.approx(problem.prior_cost(values))
    assert weighted.loss == problem.loss


def test_a_moved_point_and_its_prediction():
    """The linear model's decrease is the cost's own, in the limit of short steps."""
    problem, values = random_problem(np.random.default_rng(2), Kind(walks=True), bearings=40)
    system = problem.linearise(values)
    heavy = 1e8
    step = Elimination(system, heavy).solve()
    moved = problem.moved(values, step)
    decrease = problem.cost(values) - problem.cost(moved)
    assert step.decrease > 0.0
    assert decrease == pytest.approx(step.decrease, rel=1e-3)


def test_the_first_knots_prior_seen_from_an_origin():
    problem, values = random_problem(np.random.default_rng(3), Kind(walks=True))
    mean, sigma = problem.start_prior(values)
    m = problem.layout.path
    np.testing.assert_allclose(
        values.path[0] + mean[:m] * problem.path_scale, problem.prior.mean, rtol=1e-12
    )
    np.testing.assert_allclose(sigma[:m] * problem.path_scale, problem.prior.sigma)
    np.testing.assert_array_equal(mean[m:], 0.0)


def test_measurements_counted_once():
    kind = Kind(form="azimuth", constraints=True)
    problem, _ = random_problem(np.random.default_rng(4), kind)
    assert problem.measurement_rows == 9 + 3 + 3
