"""The GTSAM graph of a problem is the problem: cost, estimate and covariance."""

from dataclasses import replace
from functools import cache

import gtsam
import numpy as np
import pytest

import geograph as gg
from geograph.eliminate import Elimination
from geograph.errors import InputError
from geograph.families import Values
from geograph.graph import graph_of, knot_key, sensor_key
from geograph.losses import Loss
from geograph.measurements import Constraints
from geograph.scenarios import ground_pass, low_orbit_pass, room
from geograph.smoother import first_problem
from geograph.solver import Status, solve

# In posterior sigmas, far below 1e-6 of any coordinate: light times are solved to a microsecond,
# and derivatives are taken at those times.
SAME = 1e-5


def constrained(seed):
    """An aircraft at a height that is known over the whole flight, and a speed at one instant."""
    recording = ground_pass(seed, target="aircraft", stations=3, bearings=15)
    table = Constraints(
        time_s=np.array([np.nan, 20.0]),
        kind=("altitude_m", "speed_m_s"),
        value=np.array([10_000.0, 250.0]),
        sigma=np.array([50.0, 5.0]),
        line=np.zeros(2, dtype=np.int64),
    )
    return replace(recording, constraints=table)


def placed(seed):
    """A source of sound whose x is known at one instant, and y and z over the whole path."""
    recording = room(seed, order=2, sensors=3, bearings=20)
    table = Constraints(
        time_s=np.array([recording.bearings.time_s[5], np.nan, np.nan]),
        kind=("x_m", "y_m", "z_m"),
        value=recording.truth.position_m.mean(axis=0),
        sigma=np.array([0.5, 2.0, 1.0]),
        line=np.zeros(3, dtype=np.int64),
    )
    return replace(recording, constraints=table)


RECORDINGS = {
    "walks, light, satellites": lambda: low_orbit_pass(1, sensors=3, bearings=25),
    "free fall, ground": lambda: low_orbit_pass(
        2, path="two-body", platform="ground", sensors=3, bearings=25, clock_offset_s=0.05
    ),
    "along and across, clocks": lambda: ground_pass(3, stations=3, bearings=25),
    "clock drifts": lambda: ground_pass(
        4, target="aircraft", stations=3, bearings=25, drift_rad_s=1e-5, clock_drift_s_s=1e-3
    ),
    "known height and speed": lambda: constrained(5),
    "known coordinates": lambda: placed(10),
    "sound, order 1": lambda: room(6, order=1, sensors=3, bearings=20),
    "sound, order 2": lambda: room(7, order=2, sensors=3, bearings=20, clock_offset_s=0.02),
    "sound, order 3": lambda: room(8, order=3, sensors=3, bearings=20),
    "per coordinate, correlated": lambda: low_orbit_pass(
        9, sensors=3, bearings=20, per_coordinate=True, correlation=0.3
    ),
}


def settled(problem, values):
    """Solve down to rounding."""
    solution = solve(problem, values)
    assert solution.status is Status.CONVERGED
    values = solution.values
    for _ in range(60):
        step = Elimination(problem.linearise(values)).solve()
        values = problem.moved(values, step)
        if step.decrease < 1e-16:
            break
    return values


@cache
def solved(name, loss="none"):
    """A problem of a few intervals, and its solution."""
    recording = RECORDINGS[name]()
    problem, values = first_problem(recording, recording.settings.replace(loss="none"))
    values = settled(problem, values)
    problem.refresh(values)
    problem = problem.with_weights(problem.weights, Loss(loss))
    return problem, settled(problem, values)


def scaled_difference(problem, one, other, marginals):
    """Return the largest difference of two estimates, in posterior sigmas."""
    m = problem.layout.path
    knots = np.sqrt(np.einsum("kii->ki", marginals.knots))
    path = (one.path - other.path) / problem.path_scale / knots[:, :m]
    walks = (one.walks - other.walks) / knots[:, m:]
    constants = (one.constants - other.constants) / np.sqrt(np.diagonal(marginals.constants))
    return max(np.abs(part).max(initial=0.0) for part in (path, walks, constants))


def nudged(problem, values, marginals, share):
    """Return a point some share of a sigma away in every unknown."""
    rng = np.random.default_rng(0)
    m = problem.layout.path
    knots = share * np.sqrt(np.einsum("kii->ki", marginals.knots))
    knots = knots * rng.normal(size=knots.shape)
    spread = share * np.sqrt(np.diagonal(marginals.constants))
    return Values(
        values.path + knots[:, :m] * problem.path_scale,
        values.walks + knots[:, m:],
        values.constants + spread * rng.normal(size=spread.shape),
    )


def within_its_intervals(problem, values, marginals):
    """Return a point as far away as leaves every emission between its two knots.

    A factor keeps the knots that it was made with; the batch engine takes others when an emission
    moves past a knot.
    """

    def intervals(point):
        return np.concatenate([f.interval for f in problem.evaluate(point, jacobian=False)])

    for share in 3.0 * 0.5 ** np.arange(12):
        away = nudged(problem, values, marginals, share)
        if np.array_equal(intervals(away), intervals(values)):
            return away
    raise AssertionError("an emission stands at a knot")


def descend(built, values, rounds):
    """Gauss-Newton steps by GTSAM's own elimination."""
    for _ in range(rounds):
        linear = built.graph.linearize(values)
        tree = linear.eliminateMultifrontal(built.ordering(), gtsam.EliminateQR)
        values = values.retract(tree.optimize())
    return values


def assert_same_covariance(found, expected):
    sigma = np.sqrt(np.diagonal(expected))
    np.testing.assert_allclose(
        found / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), rtol=0.0, atol=1e-6
    )


@pytest.mark.parametrize("stacking", ["interval", "measurement"])
@pytest.mark.parametrize("name", RECORDINGS)
def test_cost_estimate_and_covariance_are_the_same(name, stacking):
    problem, values = solved(name)
    marginals = Elimination(problem.linearise(values)).marginals()
    built = graph_of(problem, values, stacking=stacking)
    at = built.encode(values)
    assert built.graph.error(at) == pytest.approx(problem.cost(values), rel=1e-9)

    # The cost agrees away from the solution, too.
    away = within_its_intervals(problem, values, marginals)
    assert built.graph.error(built.encode(away)) == pytest.approx(problem.cost(away), rel=1e-8)

    start = built.encode(nudged(problem, values, marginals, 0.3))
    found = built.decode(descend(built, start, 10))
    assert scaled_difference(problem, found, values, marginals) < SAME

    tree = built.graph.linearize(at).eliminateMultifrontal(built.ordering(), gtsam.EliminateQR)
    for k in range(problem.knots_s.size):
        assert_same_covariance(tree.marginalCovariance(knot_key(k)), marginals.knots[k])
    for sensor in {state.sensor for state in problem.states.constants}:
        columns = problem.states.of_sensor(sensor)
        assert_same_covariance(
            tree.marginalCovariance(sensor_key(sensor)),
            marginals.constants[np.ix_(columns, columns)],
        )


def test_stackings_differ_in_factors_alone():
    problem, values = solved("walks, light, satellites")
    whole = graph_of(problem, values)
    single = graph_of(problem, values, stacking="measurement")
    occupied = np.unique(problem.evaluate(values, jacobian=False)[0].interval).size
    sensors = 3
    assert whole.graph.size() == problem.knots_s.size + sensors + occupied
    assert single.graph.size() == problem.knots_s.size + sensors + 75


@pytest.mark.parametrize("stacking", ["interval", "measurement"])
@pytest.mark.parametrize("loss", ["huber", "cauchy", "geman-mcclure"])
def test_losses_have_the_same_cost_and_minimum(loss, stacking):
    """Their curvature differs (GTSAM squares a root), so GTSAM needs more steps."""
    problem, values = solved("along and across, clocks", loss)
    marginals = Elimination(problem.linearise(values)).marginals()
    built = graph_of(problem, values, stacking=stacking)
    away = within_its_intervals(problem, values, marginals)
    for point in (values, away):
        assert built.graph.error(built.encode(point)) == pytest.approx(
            problem.cost(point), rel=1e-8
        )
    start = built.encode(nudged(problem, values, marginals, 0.1))
    found = built.decode(descend(built, start, 70))
    assert scaled_difference(problem, found, values, marginals) < SAME


@pytest.mark.parametrize("stacking", ["interval", "measurement"])
def test_weights_of_measurements(stacking):
    problem, values = solved("walks, light, satellites")
    rng = np.random.default_rng(0)
    weight = rng.choice([0.0, 0.3, 1.0], 75)
    problem = problem.with_weights([weight])
    values = settled(problem, values)
    marginals = Elimination(problem.linearise(values)).marginals()
    built = graph_of(problem, values, stacking=stacking)
    at = built.encode(values)
    assert built.graph.error(at) == pytest.approx(problem.cost(values), rel=1e-9)
    tree = built.graph.linearize(at).eliminateMultifrontal(built.ordering(), gtsam.EliminateQR)
    for k in range(problem.knots_s.size):
        assert_same_covariance(tree.marginalCovariance(knot_key(k)), marginals.knots[k])


def test_a_weighted_residual_of_exactly_zero_keeps_its_weight():
    """Where cost over square is 0 / 0, its limit is taken."""
    problem, values = solved("sound, order 2")
    family = problem.families[0]
    bearing, _, _ = family.predicted(problem.path, values)
    perfect = replace(
        family.bearings, azimuth_rad=bearing[:, 0].copy(), elevation_rad=bearing[:, 1].copy()
    )
    exact = type(family)(
        perfect, geometry=family.geometry, states=family.states, walk_scale=family.walk_scale,
        speed_m_s=family.speed_m_s, weight=family.weight,
        position_noise_m=family.position_noise_m,
    )  # fmt: skip
    problem.families[0], before = exact, problem.families[0]
    try:
        other = problem.with_weights([np.full(len(exact), 0.25)], Loss("cauchy"))
        exact.refresh(other.path, values)
        expected = Elimination(other.linearise(values)).marginals()
        built = graph_of(other, values)
        linear = built.graph.linearize(built.encode(values))
        tree = linear.eliminateMultifrontal(built.ordering(), gtsam.EliminateQR)
        assert_same_covariance(tree.marginalCovariance(knot_key(1)), expected.knots[1])
    finally:
        problem.families[0] = before


def test_values_go_both_ways():
    problem, values = solved("walks, light, satellites")
    built = graph_of(problem, values)
    marginals = Elimination(problem.linearise(values)).marginals()
    away = nudged(problem, values, marginals, 5.0)
    back = built.decode(built.encode(away))
    np.testing.assert_allclose(back.path, away.path, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(back.walks, away.walks, rtol=1e-14)
    np.testing.assert_array_equal(back.constants, away.constants)


def test_build_unpacks_to_a_graph_and_its_first_guess():
    recording = room(3, sensors=3, bearings=20)
    built = gg.build(recording)
    graph, values = built
    assert isinstance(graph, gtsam.NonlinearFactorGraph)
    params = gtsam.LevenbergMarquardtParams()
    params.setLinearSolverType("MULTIFRONTAL_QR")
    params.setRelativeErrorTol(1e-12)
    params.setOrdering(built.ordering())
    found = gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()
    estimate = built.decode(found)
    again = settled(built.problem, estimate)
    marginals = Elimination(built.problem.linearise(again)).marginals()
    assert scaled_difference(built.problem, estimate, again, marginals) < 1e-3


def test_a_static_object_with_walks_is_refused():
    problem, values = solved("walks, light, satellites")
    motion = gg.motion.Motion("static", problem.motion.density, "ecef")
    static = problem.with_motion(problem.motion)
    static.motion = motion
    with pytest.raises(InputError, match="use constant-position with a small process_noise"):
        graph_of(static, values)
