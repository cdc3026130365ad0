"""Factors of arrivals and differences: derivatives through GTSAM, and the problems they solve."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_scene import NEXT, OBJECT, World

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.errors import InputError
from geograph.factors import (
    Receiver,
    arrivals_factor,
    frequency_difference_factor,
    frequency_differences_factor,
    kinematic_factor,
    position_fix_factor,
    prior_factor,
    time_difference_factor,
    time_differences_factor,
)

PROFILE = settings(max_examples=40, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
orders = st.sampled_from([1, 2, 3])
worlds = st.sampled_from([("local", 340.0), ("local", SPEED_OF_LIGHT_M_S), ("ecef", 3e8)])


@PROFILE
@given(seeds, orders, worlds, st.booleans())
def test_arrivals_with_the_emission_as_a_key(seed, order, kind, between):
    world = World(seed, *kind, order, between=between)
    world.add(5, np.array([world.time * world.speed]), np.array([1e-2 * world.length]))
    toa = world.time + world.rng.uniform(0.5, 2.0, 4) * world.length / world.speed
    factor = arrivals_factor(
        OBJECT, toa, 0.01 * world.length / world.speed, world.receivers, emission_key=5,
        **world.options,
    )  # fmt: skip
    assert factor.dim() == 4
    world.check(factor)


def exact_arrivals(world, count=4):
    """Arrival times that the world's values predict, for an emission at its time."""
    values = world.values()
    values.insert(999, np.array([world.time * world.speed]))
    zero = arrivals_factor(
        OBJECT, np.zeros(count), 1.0, world.receivers, emission_key=999, **world.options
    )
    return zero.unwhitenedError(values)


@PROFILE
@given(seeds, orders, worlds, st.booleans())
def test_arrivals_without_an_emission(seed, order, kind, between):
    """The cost's gradient with large residuals, and all derivatives with none."""
    world = World(seed, *kind, order, between=between)
    toa = exact_arrivals(world)
    sigma = 0.01 * world.length / world.speed * world.rng.uniform(0.5, 2.0, 4)
    exact = arrivals_factor(OBJECT, toa, sigma, world.receivers, **world.options)
    np.testing.assert_allclose(exact.unwhitenedError(world.values()), 0.0, atol=1e-7)
    world.check(exact)
    off = arrivals_factor(
        OBJECT, toa + 3.0 * sigma * world.rng.normal(size=4), sigma, world.receivers,
        **world.options,
    )  # fmt: skip
    world.check(off, function=lambda value: value, rtol=1e-5)


@PROFILE
@given(seeds, orders, worlds, st.booleans())
def test_time_differences(seed, order, kind, between):
    world = World(seed, *kind, order, between=between)
    scale = 0.01 * world.length / world.speed
    factor = time_differences_factor(
        OBJECT,
        world.rng.normal(size=3) * world.length / world.speed,
        scale * world.rng.uniform(1.0, 2.0, 3),
        world.receivers[1:],
        world.receivers[0],
        sigma_reference_s=0.7 * scale,
        time_s=world.time,
        **world.options,
    )
    assert factor.dim() == 3
    world.check(factor)


@PROFILE
@given(seeds, orders, worlds, st.booleans())
def test_frequency_differences(seed, order, kind, between):
    world = World(seed, *kind, order, between=between)
    root = world.rng.normal(size=(3, 3)) + 3.0 * np.eye(3)
    factor = frequency_differences_factor(
        OBJECT,
        world.rng.normal(size=3) * 100.0,
        None,
        world.receivers[1:],
        world.receivers[0],
        carrier_hz=100.0 * world.speed / world.pace,
        covariance_hz2=root @ root.T,
        time_s=world.time,
        **world.options,
    )
    world.check(factor)


@pytest.mark.parametrize("frame", ["local", "ecef"])
def test_arrivals_weigh_as_all_time_differences_with_their_full_covariance(frame):
    """Cost and information of one set are those of n - 1 differences, whichever the reference."""
    world = World(3, frame, SPEED_OF_LIGHT_M_S, 1, between=False)
    sigma = np.array([1e-8, 2e-8, 0.5e-8, 3e-8])
    toa = exact_arrivals(world) + sigma * world.rng.normal(size=4)
    # The object does not move here, and neither do the receivers: times are differences alone.
    still = [Receiver(position_m=r.position_m, clock_key=r.clock_key) for r in world.receivers]
    options = {"speed_m_s": world.speed, "frame": frame}
    whole = arrivals_factor(OBJECT, toa, sigma, still, **options)
    values = world.values()
    information = whole.linearize(values).information()
    keys = list(whole.keys())
    for reference in range(4):
        others = [index for index in range(4) if index != reference]
        factor = time_differences_factor(
            OBJECT,
            toa[others] - toa[reference],
            np.hypot(sigma[others], sigma[reference]),
            [still[index] for index in others],
            still[reference],
            sigma_reference_s=sigma[reference],
            time_s=toa[reference],
            **options,
        )
        # Differences of the sizes of the receivers' errors over the speed of light are nothing.
        assert factor.error(values) == pytest.approx(whole.error(values), rel=1e-6)
        found = factor.linearize(values)
        ordering = gtsam.Ordering()
        for key in keys:
            ordering.push_back(key)
        graph = gtsam.GaussianFactorGraph()
        graph.push_back(found)
        jacobian = graph.jacobian(ordering)[0]
        np.testing.assert_allclose(
            jacobian.T @ jacobian, information, rtol=0.0, atol=1e-6 * np.abs(information).max()
        )


def test_one_difference_is_a_stack_of_one():
    world = World(4, "local", 340.0, 2, between=False)
    first, second = world.receivers[:2]
    pairs = [
        (
            time_difference_factor(OBJECT, 0.1, 0.01, first, second, **world.options),
            time_differences_factor(OBJECT, [0.1], [0.01], [first], second, **world.options),
        ),
        (
            frequency_difference_factor(
                OBJECT, 3.0, 0.5, first, second, carrier_hz=1e4, **world.options
            ),
            frequency_differences_factor(
                OBJECT, [3.0], None, [first], second, carrier_hz=1e4,
                covariance_hz2=[[0.25]], **world.options,
            ),
        ),
    ]  # fmt: skip
    for one, other in pairs:
        assert one.error(world.values()) == pytest.approx(other.error(world.values()), rel=1e-12)
        assert list(one.keys()) == list(other.keys())


def test_two_receivers_may_share_a_clock():
    """What is common to both ends of a difference leaves no trace in it, at rest."""
    ends = [Receiver(position_m=[x, 0.0, 0.0], clock_key=7) for x in (0.0, 500.0)]
    factor = time_difference_factor(0, 0.5, 0.1, *ends, speed_m_s=340.0, frame="local")
    values = gtsam.Values()
    values.insert(0, np.array([100.0, 200.0, 50.0]))
    values.insert(7, np.array([12.0]))
    jacobian, _ = factor.linearize(values).jacobian()
    assert list(factor.keys()) == [0, 7]
    np.testing.assert_allclose(jacobian[0, 3], 0.0, atol=1e-12)
    moved = gtsam.Values(values)
    moved.update(7, np.array([-30.0]))
    assert factor.error(moved) == pytest.approx(factor.error(values), rel=1e-12)


def optimised(graph, values):
    params = gtsam.LevenbergMarquardtParams()
    params.setRelativeErrorTol(1e-14)
    params.setAbsoluteErrorTol(1e-14)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()


def test_a_graph_of_emissions_finds_object_clocks_and_their_errors():
    """Twelve emissions of an aircraft, one receiver with a wrong clock; GTSAM alone solves it.

    The emissions' exact times are made from geometry: straight flight, receivers that stand still,
    no turning frame, light times as distances over the speed of light.
    """
    c, clock, flight = SPEED_OF_LIGHT_M_S, 4e-7, np.array([180.0, -90.0, 5.0])
    start = np.array([20e3, 30e3, 9e3])
    places = np.array(
        [[0, 0, 0], [60e3, 0, 100], [0, 60e3, 300], [60e3, 60e3, 50], [3e4, 3e4, 0.0]]
    )
    receivers = [
        Receiver(position_m=place, clock_key=100 if index == 2 else None)
        for index, place in enumerate(places)
    ]
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(12):
        # Emitted three microseconds after the knot's time, which nobody knows.
        emitted = 3e-6
        at = start + flight * (10.0 * k + emitted)
        toa = emitted + np.linalg.norm(at - places, axis=1) / c
        toa[2] += clock
        heard = [0, 1, 2, 3, 4] if k % 2 else [0, 2, 3, 4]
        graph.push_back(
            arrivals_factor(
                k, toa[heard], 1e-8, [receivers[i] for i in heard], order=2, frame="local"
            )
        )
        if k:
            graph.push_back(kinematic_factor(k - 1, k, 10.0, 1.0, order=2))
        guess = start + flight * 10.0 * k + np.array([4e3, -3e3, 2e3])
        values.insert(k, np.concatenate([guess, np.zeros(3)]))
    graph.push_back(prior_factor(100, [0.0], [1e3]))
    values.insert(100, np.zeros(1))
    found = optimised(graph, values)
    # What is left is what the clock's prior charges for its error.
    assert graph.error(found) == pytest.approx(0.5 * (c * clock / 1e3) ** 2, rel=1e-3)
    for k in range(12):
        state = found.atVector(k)
        np.testing.assert_allclose(state[:3], start + flight * 10.0 * k, atol=1e-2)
        np.testing.assert_allclose(state[3:], flight, atol=1e-3)
    # Metres, as the docstring says.
    assert found.atVector(100)[0] == pytest.approx(c * clock, abs=1e-2)


def test_a_graph_of_differences_finds_a_moving_source_and_a_platform():
    """Time and frequency differences to a platform whose own state is estimated from two fixes."""
    c, carrier = SPEED_OF_LIGHT_M_S, 1e9
    state = np.array([30e3, 40e3, 5e3, 150.0, -60.0, 10.0])
    platform = np.array([1000.0, -2000.0, 8000.0, 120.0, 90.0, 0.0])
    still = np.array([[0.0, 0, 0], [50e3, 0, 100], [0, 50e3, 200], [50e3, 45e3, 0]])

    def received(place, velocity):
        """When and at which frequency the signal of time zero is received, by bisection."""
        low, high = 0.0, 1.0
        for _ in range(200):
            middle = 0.5 * (low + high)
            gap = np.linalg.norm(state[:3] - place - velocity * middle) - c * middle
            low, high = (middle, high) if gap > 0.0 else (low, middle)
        line = state[:3] - place - velocity * low
        unit = line / np.linalg.norm(line)
        return low, carrier * (c + unit @ velocity) / (c + unit @ state[3:])

    ends = [Receiver(position_m=place) for place in still]
    own = Receiver(position_m=np.zeros(3), position_key=1, position_order=2)
    time, frequency = received(platform[:3], platform[3:])
    there = np.array([received(place, np.zeros(3)) for place in still])
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    common = {"time_s": time, "order": 2, "frame": "local"}
    graph.push_back(
        time_differences_factor(
            0, there[:, 0] - time, 2e-8, ends, own, sigma_reference_s=1e-8, **common
        )
    )
    graph.push_back(
        frequency_differences_factor(
            0, there[:, 1] - frequency, 0.1, ends, own, carrier_hz=carrier, **common
        )
    )
    graph.push_back(position_fix_factor(1, platform[:3], 1.0, order=2))
    graph.push_back(position_fix_factor(2, platform[:3] + 10.0 * platform[3:], 1.0, order=2))
    graph.push_back(kinematic_factor(1, 2, 10.0, 0.1))
    values.insert(0, state + np.array([3e3, -2e3, 1e3, 20.0, -20.0, 5.0]))
    values.insert(1, platform + np.array([30.0, 20.0, -10.0, 5.0, 5.0, 5.0]))
    values.insert(2, platform)
    found = optimised(graph, values)
    np.testing.assert_allclose(found.atVector(0)[:3], state[:3], atol=0.05)
    np.testing.assert_allclose(found.atVector(0)[3:], state[3:], atol=0.01)
    np.testing.assert_allclose(found.atVector(1), platform, atol=1e-3)


@PROFILE
@given(seeds, orders, st.booleans())
def test_position_fixes(seed, order, between):
    world = World(seed, "ecef", 3e8, order, between=between)
    options = {"order": order}
    if between:
        options |= {"next_key": NEXT, "step_s": 10.0, "offset_s": 4.0}
    fix = np.array([6.4e6, 1e6, -2e5])
    factor = position_fix_factor(OBJECT, fix, (10.0, 20.0, 5.0), **options)
    world.check(factor, rtol=1e-7)
    if not between:
        expected = (world.vectors[0][:3] - fix) / [10.0, 20.0, 5.0]
        np.testing.assert_allclose(factor.unwhitenedError(world.values()), expected)


A, B, C = (Receiver(position_m=[x, 0.0, 0.0]) for x in (0.0, 1.0, 2.0))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Receiver(position_m=[0.0, 1.0]), "position_m is"),
        (lambda: Receiver(position_m=[0, 0, 0], velocity_m_s=[np.nan, 0, 0]), "velocity_m_s is"),
        (lambda: Receiver(position_m=[0, 0, 0], position_order=4), "position_order is 4"),
        (lambda: arrivals_factor(0, [0.0, 1.0], 1.0, [A, B, C]), "expected 3 finite numbers"),
        (lambda: arrivals_factor(0, [0.0, np.inf], 1.0, [A, B]), "toa_s is"),
        (lambda: arrivals_factor(0, [0.0, 1.0], [1.0, 0.0], [A, B]), "sigma_s is"),
        (lambda: arrivals_factor(0, [0.0], 1.0, [A]), "has 1 arrivals; expected at least 2"),
        (lambda: arrivals_factor(0, [0.0] * 2, 1.0, [A, B], order=4), "order is 4"),
        (lambda: arrivals_factor(0, [0.0] * 2, 1.0, [A, B], next_key=1), "step_s is 0.0"),
        (lambda: arrivals_factor(0, [0.0] * 2, 1.0, [A, B], speed_m_s=np.inf), "speed_m_s is inf"),
        (lambda: arrivals_factor(0, [0.0] * 2, 1.0, [A, B], frame="eci"), "frame is 'eci'"),
        (lambda: arrivals_factor(0, [0.0] * 2, 1.0, [A, B], speed_key=0), "key 0 holds 3 numbers"),
        (lambda: time_difference_factor(0, np.nan, 1.0, A, B), "tdoa_s is"),
        (lambda: time_difference_factor(0, 0.0, -1.0, A, B), "sigma_s is"),
        (
            lambda: time_differences_factor(0, [0, 0], [1, 1], [A, B], C, sigma_reference_s=1.0),
            "below every sigma_s",
        ),
        (lambda: time_differences_factor(0, [0, 0], None, [A, B], C), "exactly one of them"),
        (
            lambda: time_differences_factor(0, [0, 0], 1.0, [A, B], C, covariance_s2=np.eye(2)),
            "exactly one of them",
        ),
        (
            lambda: time_differences_factor(0, [0, 0], None, [A, B], C, covariance_s2=np.eye(3)),
            r"covariance_s2 has shape \(3, 3\)",
        ),
        (
            lambda: time_differences_factor(
                0, [0, 0], None, [A, B], C, covariance_s2=[[1.0, 2.0], [2.0, 1.0]]
            ),
            "not positive definite",
        ),
        (
            lambda: time_differences_factor(
                0, [0, 0], None, [A, B], C, covariance_s2=[[1.0, 0.2], [0.1, 1.0]]
            ),
            "not symmetric",
        ),
        (
            lambda: frequency_difference_factor(0, 0.0, 1.0, A, B, carrier_hz=0.0),
            "carrier_hz is 0.0",
        ),
        (lambda: position_fix_factor(0, [0, 0], 1.0), "position_m is"),
        (lambda: position_fix_factor(0, [0, 0, 0], 0.0), "sigma_m is 0.0"),
        (lambda: position_fix_factor(0, [0, 0, 0], 1.0, next_key=1), "step_s is 0.0"),
    ],
)
def test_wrong_numbers_are_named(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_a_value_of_the_wrong_size_is_named():
    factor = time_difference_factor(0, 0.0, 1.0, A, B)
    values = gtsam.Values()
    values.insert(0, np.zeros(6))
    with pytest.raises(InputError, match="key 0 holds 6 numbers; expected 3"):
        factor.error(values)
