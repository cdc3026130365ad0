"""Time and frequency differences: signs, geometry, and every derivative."""

import numpy as np
import pytest
from differences import assert_derivative
from effort import examples
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from made_rays import WORLDS, Pair
from scipy.optimize import brentq

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.factors.arrival import SensorMotion, trace
from geograph.factors.difference import (
    frequency_difference,
    frequency_difference_gradient,
    time_difference,
    time_difference_gradient,
)

PROFILE = settings(max_examples=examples(25, 60), deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
worlds = st.sampled_from(sorted(WORLDS))
SENSOR, REFERENCE = np.array([0]), np.array([1])


def at_arrival(pair, arrived):
    """Both rays of the emission that arrives at the reference at a time, by Brent's method."""

    def solve(point):
        # Where the vector has a time of emission, it is that of the arrival here.
        target = arrived + point[-2]
        wide = 0.5 * arrived + 1e-9
        emitted = brentq(
            lambda time: time + pair.rays(point, time).light_time_s[1] - target, -wide, wide,
            xtol=1e-17 * arrived,
        )  # fmt: skip
        ray = pair.rays(point, emitted)
        return ray.take(SENSOR), ray.take(REFERENCE)

    return solve


def rows(gradient, received):
    """Derivatives in the order of a pair's vector, all motion being given at time zero."""
    sensor, reference = received
    parts = [
        gradient.by_position[0],
        gradient.by_velocity[0],
        gradient.by_sensor_position[0],
        gradient.by_sensor_position[0] * sensor + gradient.by_sensor_velocity[0],
        gradient.by_reference_position[0],
        gradient.by_reference_position[0] * reference + gradient.by_reference_velocity[0],
        gradient.by_time,
        gradient.by_speed,
    ]
    return np.concatenate(parts)[None]


def made(seed, name):
    pair = Pair(seed, WORLDS[name], sensors=2)
    assume(pair.subsonic)
    ray = pair.rays()
    steps = pair.steps.copy()
    steps[-2] = min(steps[-2], 1e-2 * ray.light_time_s.min())
    return pair, ray, steps


@PROFILE
@given(seeds, worlds)
def test_derivatives_of_time_differences(seed, name):
    pair, ray, steps = made(seed, name)
    solve = at_arrival(pair, float(ray.light_time_s[1]))
    found = time_difference_gradient(ray.take(SENSOR), ray.take(REFERENCE))
    # A common time moves both ends alike; what is left of it is what its rounding moves.
    floor = 1e-3 * pair.world.length_m / pair.world.speed_m_s
    assert_derivative(
        rows(found, ray.light_time_s), lambda point: time_difference(*solve(point)), pair.point,
        steps, rtol=1e-6, floor=1e-3 * floor,
    )  # fmt: skip


@PROFILE
@given(seeds, worlds)
def test_derivatives_of_frequency_differences(seed, name):
    pair, ray, steps = made(seed, name)
    solve = at_arrival(pair, float(ray.light_time_s[1]))
    carrier = np.array([pair.world.speed_m_s / pair.world.object_m_s])
    found = frequency_difference_gradient(
        ray.take(SENSOR), ray.take(REFERENCE), carrier, pair.acceleration[None]
    )
    assert_derivative(
        rows(found, ray.light_time_s),
        lambda point: frequency_difference(*solve(point), carrier),
        pair.point,
        steps,
        rtol=1e-5,
        floor=1e-5,
    )


def rays_to(places, rates, position, velocity, speed):
    place, rate = np.array(places, float), np.array(rates, float)
    count = len(place)
    return trace(
        np.tile(np.array(position, float), (count, 1)),
        np.tile(np.array(velocity, float), (count, 1)),
        lambda delay: SensorMotion(
            place + delay[:, None] * rate, rate, np.zeros_like(rate)
        ),
        speed_m_s=speed,
        spin_rad_s=0.0,
    )  # fmt: skip


def test_signs_of_both_differences():
    """The object is nearer to the reference, and flies away from it towards the sensor."""
    ray = rays_to(
        [[1000.0, 0, 0], [-300.0, 0, 0]], np.zeros((2, 3)), [0, 0, 0], [10.0, 0, 0], 340.0
    )
    sensor, reference = ray.take(SENSOR), ray.take(REFERENCE)
    # tdoa = arrival(sensor) - arrival(reference), 700 m of sound.
    assert time_difference(sensor, reference)[0] == pytest.approx(700.0 / 340.0, rel=1e-14)
    # fdoa = received(sensor) - received(reference), the sensor's is higher.
    shift = frequency_difference(sensor, reference, np.array([1000.0]))[0]
    assert shift == pytest.approx(1000.0 * (340.0 / 330.0 - 340.0 / 350.0), rel=1e-13)


@PROFILE
@given(seeds, worlds)
def test_exchanging_the_ends_changes_the_sign(seed, name):
    pair, ray, _ = made(seed, name)
    del pair
    one, two = ray.take(SENSOR), ray.take(REFERENCE)
    carrier = np.array([1e9])
    assert time_difference(one, two) == -time_difference(two, one)
    assert frequency_difference(one, two, carrier) == -frequency_difference(two, one, carrier)


def test_light_differences_between_things_at_rest_are_distances():
    """The derivative by position is the difference of unit vectors over c."""
    ray = rays_to(
        [[3e4, 0, 0], [0, 4e4, 0]], np.zeros((2, 3)), [0, 0, 1e4], np.zeros(3), SPEED_OF_LIGHT_M_S
    )
    sensor, reference = ray.take(SENSOR), ray.take(REFERENCE)
    found = time_difference_gradient(sensor, reference)
    one = np.array([-3.0, 0.0, 1.0]) / np.sqrt(10.0)
    two = np.array([0.0, -4.0, 1.0]) / np.sqrt(17.0)
    np.testing.assert_allclose(found.by_position[0], (one - two) / SPEED_OF_LIGHT_M_S, rtol=1e-14)
    np.testing.assert_allclose(found.by_sensor_position[0], -one / SPEED_OF_LIGHT_M_S, rtol=1e-14)
    np.testing.assert_allclose(found.by_reference_position[0], two / SPEED_OF_LIGHT_M_S, rtol=1e-14)
    # At rest the time of day says nothing.
    np.testing.assert_allclose(found.by_time, 0.0, atol=1e-16)


def test_frequency_differences_feel_velocity_as_times_feel_position():
    """For light and slow objects: d(fdoa)/dv = -(f / c)(u_sensor - u_reference)."""
    ray = rays_to(
        [[3e4, 0, 0], [0, 4e4, 0]], np.zeros((2, 3)), [0, 0, 1e4], [200.0, 100.0, 0],
        SPEED_OF_LIGHT_M_S,
    )  # fmt: skip
    sensor, reference = ray.take(SENSOR), ray.take(REFERENCE)
    times = time_difference_gradient(sensor, reference)
    shifts = frequency_difference_gradient(sensor, reference, np.array([1e9]), np.zeros((1, 3)))
    np.testing.assert_allclose(shifts.by_velocity, -1e9 * times.by_position, rtol=1e-5)
