"""Factors for anybody's graph: derivatives through GTSAM, and the problems they solve."""

import gtsam
import numpy as np
import pytest
from differences import assert_derivative
from hypothesis import given, settings
from hypothesis import strategies as st
from made_ground import hills, local_terrain

from geograph.errors import InputError
from geograph.factors import (
    altitude_factor,
    ballistic_factor,
    bearing_factor,
    kinematic_factor,
    prior_factor,
    random_walk_factor,
    terrain_factor,
)
from geograph.factors.gravity import propagate
from geograph.factors.kinematics import noise_covariance, transition
from geograph.geodesy import ecef_from_geodetic, enu_axes

PROFILE = settings(max_examples=40, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
orders = st.sampled_from([1, 2, 3])


def check(factor, vectors, steps, *, rtol=1e-7):
    """Compare a factor's linearisation in GTSAM with differences of its error."""

    def values_of(point):
        values, used = gtsam.Values(), 0
        for key, vector in enumerate(vectors):
            values.insert(key, point[used : used + vector.size])
            used += vector.size
        return values

    point = np.concatenate(vectors)
    jacobian, right = factor.linearize(values_of(point)).jacobian()
    np.testing.assert_array_equal(-right, factor.unwhitenedError(values_of(point)))
    assert_derivative(
        jacobian,
        lambda at: factor.unwhitenedError(values_of(at)),
        point,
        np.concatenate(steps),
        rtol=rtol,
    )


@PROFILE
@given(seeds, orders, st.sampled_from(["sky", "pair", "azimuth"]), st.booleans(), st.booleans())
def test_bearing(seed, order, form, between, biased):
    rng = np.random.default_rng(seed)
    powers = np.repeat([1.0, 0.1, 0.01][:order], 3)
    first, second = 300.0 * rng.normal(size=(2, 3 * order)) * powers + np.repeat(
        [500.0, 0.0, 0.0][:order], 3
    )
    vectors, steps = [first], [0.1 * powers]
    options = {}
    if between:
        vectors, steps = [first, second], [0.1 * powers] * 2
        options = {"next_key": 1, "step_s": 10.0, "offset_s": rng.uniform(0.0, 10.0)}
    if biased:
        options["error_key"] = len(vectors)
        vectors.append(rng.normal(size=2) * 0.1)
        steps.append(np.full(2, 1e-4))
    if rng.random() < 0.5:
        options["misalignment_key"] = len(vectors)
        vectors.append(rng.normal(size=3) * rng.choice([1e-6, 0.05, 1.0]))
        steps.append(np.full(3, 1e-4))
    factor = bearing_factor(
        0,
        rng.uniform(-0.5, 1.0),
        None if form == "azimuth" else rng.uniform(-0.5, 1.0),
        0.01 if form == "sky" else (0.01, 0.03),
        sensor_m=rng.normal(size=3) * 50.0 - 500.0,
        axes=np.linalg.qr(rng.normal(size=(3, 3)))[0],
        order=order,
        **options,
    )
    assert factor.dim() == (1 if form == "azimuth" else 2)
    check(factor, vectors, steps, rtol=1e-6)


@PROFILE
@given(seeds, orders, st.sampled_from(["one", "axes", "along"]))
def test_kinematic(seed, order, form):
    rng = np.random.default_rng(seed)
    powers = np.repeat([1.0, 0.1, 0.01][:order], 3)
    vectors = list(100.0 * rng.normal(size=(2, 3 * order)) * powers)
    noise = (1.0, 2.0, 0.3) if form == "axes" else 0.7
    along = 20.0 if form == "along" and order > 1 else None
    factor = kinematic_factor(0, 1, 8.0, noise, order=order, process_noise_along=along)
    steps = 0.05 * powers
    if along is not None:
        steps[3:6] = 1e-3 * np.linalg.norm(vectors[0][3:6])
    check(factor, vectors, [steps, steps], rtol=1e-6)


@PROFILE
@given(seeds, st.sampled_from(["ecef", "local"]))
def test_ballistic(seed, frame):
    rng = np.random.default_rng(seed)
    position, velocity = rng.normal(size=(2, 3))
    position *= 7e6 / np.linalg.norm(position)
    state = np.concatenate([position, 5e3 * velocity])
    after = propagate(state[None], np.array([17.0]), frame)[0][0]
    steps = np.repeat([7e3, 7.0], 3)
    factor = ballistic_factor(0, 1, 17.0, 0.5, frame=frame)
    check(factor, [state, after + rng.normal(size=6) * steps], [steps, steps])


@PROFILE
@given(seeds, orders, st.sampled_from(["ecef", "local"]))
def test_altitude(seed, order, frame):
    rng = np.random.default_rng(seed)
    position = ecef_from_geodetic(rng.uniform(-90, 90), rng.uniform(-180, 180), 1e5)
    state = np.concatenate([position, rng.normal(size=3 * order - 3)])
    factor = altitude_factor(0, 9e4, 30.0, order=order, frame=frame)
    if frame == "ecef":
        error = gtsam.Values()
        error.insert(0, state)
        assert factor.unwhitenedError(error)[0] == pytest.approx(1e4 / 30.0, abs=1e-4)
    check(factor, [state], [np.repeat([3e3, 1.0, 1.0][:order], 3)])


def test_random_walk():
    factor = random_walk_factor(0, 1, 4.0, 0.5, size=2)
    vectors = [np.array([1.0, 2.0]), np.array([3.0, -2.0])]
    check(factor, vectors, [np.ones(2)] * 2)
    values = gtsam.Values()
    for key, vector in enumerate(vectors):
        values.insert(key, vector)
    # One standard deviation after 4 s is 0.5 * 2.
    np.testing.assert_allclose(factor.unwhitenedError(values), [2.0, -4.0])


@PROFILE
@given(orders, st.floats(0.1, 50.0), seeds)
def test_kinematic_cost_is_that_of_the_prior_density(order, step, seed):
    """Half the squared Mahalanobis distance under N(Phi x, Q (x) diag(noise^2))."""
    rng = np.random.default_rng(seed)
    first, second = rng.normal(size=(2, 3 * order))
    noise = np.array([0.5, 1.0, 3.0])
    phi = np.kron(transition(order, step), np.eye(3))
    covariance = np.kron(noise_covariance(order, step), np.diag(noise**2))
    miss = second - phi @ first
    scale = np.sqrt(np.diag(covariance))
    white = miss / scale
    expected = 0.5 * white @ np.linalg.solve(covariance / np.outer(scale, scale), white)
    values = gtsam.Values()
    values.insert(0, first)
    values.insert(1, second)
    factor = kinematic_factor(0, 1, step, tuple(noise), order=order)
    assert factor.error(values) == pytest.approx(expected, rel=1e-8)


def test_three_bearings_fix_a_point_and_a_bias():
    """A small graph solved by GTSAM alone: north-east-up axes, one biased sensor."""
    truth = ecef_from_geodetic(48.1, 11.3, 9000.0)
    bias = np.array([0.004, -0.002])
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    point, error = 0, 1
    for index, (latitude, longitude) in enumerate([(48.0, 11.0), (48.2, 11.1), (48.0, 11.5)]):
        sensor = ecef_from_geodetic(latitude, longitude, 500.0)
        axes = enu_axes(sensor)[[1, 0, 2]]
        a, b, c = axes @ (truth - sensor)
        measured = np.array([np.arctan2(b, a), np.arctan2(c, np.hypot(a, b))])
        biased = index == 0
        graph.push_back(
            bearing_factor(
                point,
                *(measured + biased * bias),
                1e-4,
                sensor_m=sensor,
                axes=axes,
                error_key=error if biased else None,
            )
        )
    graph.push_back(prior_factor(error, np.zeros(2), [1.0, 1.0]))
    values.insert(point, truth + np.array([3000.0, -2000.0, 1000.0]))
    values.insert(error, np.zeros(2))
    found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    np.testing.assert_allclose(found.atVector(point), truth, rtol=0.0, atol=1e-3)
    np.testing.assert_allclose(found.atVector(error), bias, rtol=0.0, atol=1e-7)


def test_prior():
    factor = prior_factor(0, [1.0, 2.0], [0.5, 4.0])
    values = gtsam.Values()
    values.insert(0, np.array([2.0, -2.0]))
    assert factor.error(values) == pytest.approx(0.5 * (4.0 + 1.0))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: bearing_factor(0, 0.0, 0.0, 0.0, sensor_m=[0, 0, 0]), "sigma_rad is 0.0"),
        (lambda: bearing_factor(0, 0.0, 0.0, (1.0, -1.0), sensor_m=[0, 0, 0]), "sigma_rad is"),
        (lambda: bearing_factor(0, np.nan, 0.0, 1.0, sensor_m=[0, 0, 0]), "bearing is"),
        (lambda: bearing_factor(0, 0.0, np.inf, 1.0, sensor_m=[0, 0, 0]), "bearing is"),
        (lambda: bearing_factor(0, 0.0, 0.0, 1.0, sensor_m=[0, 0]), "sensor_m is"),
        (lambda: bearing_factor(0, 0.0, 0.0, 1.0, sensor_m=[0, 0, np.nan]), "sensor_m is"),
        (
            lambda: bearing_factor(0, 0.0, 0.0, 1.0, sensor_m=[0, 0, 0], axes=np.eye(2)),
            r"axes have shape \(2, 2\)",
        ),
        (
            lambda: bearing_factor(0, 0.0, 0.0, 1.0, sensor_m=[0, 0, 0], next_key=1),
            "step_s is 0.0",
        ),
        (lambda: kinematic_factor(0, 1, 0.0, 1.0), "step 0.0 s"),
        (lambda: kinematic_factor(0, 1, 1.0, (1.0, 0.0, 1.0)), "above 0"),
        (
            lambda: kinematic_factor(0, 1, 1.0, 1.0, order=1, process_noise_along=2.0),
            "noise along the velocity",
        ),
        (
            lambda: kinematic_factor(0, 1, 1.0, (1.0, 2.0, 1.0), process_noise_along=2.0),
            "noise along the velocity",
        ),
        (lambda: ballistic_factor(0, 1, -1.0, 1.0), "step -1.0 s"),
        (lambda: random_walk_factor(0, 1, 1.0, 0.0), "instability 0.0"),
        (lambda: altitude_factor(0, np.nan, 1.0), "altitude is nan"),
        (lambda: altitude_factor(0, 1.0, 0.0), "sigma above 0"),
        (lambda: prior_factor(0, [1.0, 2.0], [1.0]), r"mean of shape \(2,\)"),
        (lambda: prior_factor(0, [1.0], [0.0]), "prior has sigmas"),
    ],
)
def test_wrong_numbers_are_named(make, message):
    with pytest.raises(InputError, match=message):
        make()


@PROFILE
@given(seeds, orders)
def test_height_above_terrain(seed, order):
    rng = np.random.default_rng(seed)
    terrain = local_terrain(hills, low=-500.0, high=500.0)
    state = np.concatenate([rng.uniform(-400.0, 400.0, 2), rng.normal(size=3 * order - 2) * 50.0])
    factor = terrain_factor(0, 3.0, 2.0, surface=terrain, order=order, frame="local")
    expected = (state[2] - terrain.elevation(state[None, :3])[0][0] - 3.0) / 2.0
    values = gtsam.Values()
    values.insert(0, state)
    assert factor.unwhitenedError(values)[0] == pytest.approx(expected)
    # Short steps: curvatures jump from cell to cell.
    check(factor, [state], [np.full(3 * order, 1e-4)], rtol=1e-4)


def test_height_above_terrain_needs_numbers():
    with pytest.raises(InputError, match="height above terrain is nan"):
        terrain_factor(0, np.nan, 1.0, surface=local_terrain(hills), frame="local")
