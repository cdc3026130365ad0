"""Arrival times and received frequencies: geometry, textbooks, and every derivative."""

import numpy as np
import pytest
from differences import assert_derivative
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from made_rays import WORLDS, Pair
from scipy.optimize import brentq

from geograph.constants import EARTH_ROTATION_RAD_S, SPEED_OF_LIGHT_M_S
from geograph.factors.arrival import (
    SensorMotion,
    arrival_gradient,
    doppler,
    doppler_gradient,
    emission_gradient,
    trace,
)

PROFILE = settings(max_examples=60, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
worlds = st.sampled_from(sorted(WORLDS))


def still(position):
    """Sensors that do not move."""
    place = np.atleast_2d(np.asarray(position, dtype=float))
    return lambda _: SensorMotion(place, np.zeros_like(place), np.zeros_like(place))


def even(position, velocity):
    """Sensors in even motion, at a position when the signal is emitted."""
    place, rate = np.atleast_2d(np.asarray(position, float)), np.atleast_2d(velocity)
    return lambda delay: SensorMotion(place + delay[:, None] * rate, rate, np.zeros_like(rate))


def one_ray(position, velocity, sensor_at, *, speed=SPEED_OF_LIGHT_M_S, spin=0.0):
    return trace(
        np.atleast_2d(np.asarray(position, float)),
        np.atleast_2d(np.asarray(velocity, float)),
        sensor_at,
        speed_m_s=speed,
        spin_rad_s=spin,
    )


def rows(gradient, rates):
    """Derivatives of one ray in the order of a pair's vector, motion being given at time zero.

    ``rates`` are the reception's time after zero; emissions are at zero.
    """
    place, rate = gradient.by_sensor_position[0], gradient.by_sensor_velocity[0]
    return np.concatenate(
        [
            gradient.by_position[0],
            gradient.by_velocity[0],
            place,
            place * rates + rate,
            gradient.by_emission,
            gradient.by_speed,
        ]
    )[None]


@PROFILE
@given(seeds, worlds)
def test_derivatives_of_arrival_times(seed, name):
    pair = Pair(seed, WORLDS[name])
    assume(pair.subsonic)
    ray = pair.rays()
    assert_derivative(
        rows(arrival_gradient(ray), ray.light_time_s[0]),
        lambda point: point[-2] + pair.rays(point).light_time_s,
        pair.point,
        pair.steps,
        rtol=1e-6,
    )


@PROFILE
@given(seeds, worlds)
def test_derivatives_of_received_frequencies(seed, name):
    pair = Pair(seed, WORLDS[name])
    assume(pair.subsonic)
    ray = pair.rays()
    # A Doppler shift is a speed over that of propagation: rounding of distances over light times.
    noise = 1e-16 * np.abs(pair.point[:3]).max() / pair.world.length_m
    assert_derivative(
        rows(doppler_gradient(ray, pair.acceleration[None]), ray.light_time_s[0]),
        lambda point: doppler(pair.rays(point)),
        pair.point,
        pair.steps,
        rtol=1e-5,
        floor=1e5 * noise,
    )


@PROFILE
@given(seeds, worlds)
def test_derivatives_of_the_emission_of_a_given_arrival(seed, name):
    """Solved here by Brent's method, with nothing from the code but the light time."""
    pair = Pair(seed, WORLDS[name])
    assume(pair.subsonic)
    ray = pair.rays()
    arrived = float(ray.light_time_s[0])

    def emission(point):
        # Where the vector's own time of emission stands, there is the time of arrival here.
        target = arrived + point[-2]
        wide = 0.3 * arrived + 1e-12
        return [
            brentq(
                lambda time: time + pair.rays(point, time).light_time_s[0] - target, -wide, wide,
                xtol=1e-17 * arrived,
            )
        ]  # fmt: skip

    steps = pair.steps.copy()
    steps[-2] = 1e-3 * arrived
    assert_derivative(rows(emission_gradient(ray), arrived), emission, pair.point, steps, rtol=1e-5)


@PROFILE
@given(seeds, worlds)
def test_the_distance_is_that_of_the_signals_way(seed, name):
    """c tau = |P - S(t_r)| with P turned by hand into the axes at reception."""
    pair = Pair(seed, WORLDS[name])
    assume(pair.subsonic)
    world, ray = pair.world, pair.rays()
    tau = float(ray.light_time_s[0])
    angle = -world.spin_rad_s * tau
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0, 0, 1.0]]
    )
    sensor = pair.sensors_at(pair.point, tau).position_m[0]
    way = np.linalg.norm(turn @ pair.point[:3] - sensor)
    assert world.speed_m_s * tau == pytest.approx(way, rel=1e-12, abs=2e-9)


@PROFILE
@given(seeds, st.sampled_from(["sound", "light, satellites", "light, aircraft"]))
def test_a_start_elsewhere_leads_to_the_same_ray(seed, name):
    pair = Pair(seed, WORLDS[name])
    assume(pair.subsonic)
    fresh = pair.rays()
    position, velocity = pair.object_at(pair.point, 0.0)
    for factor in (0.0, 0.5, 1.0, 3.0):
        again = trace(
            position[None], velocity[None], lambda delay: pair.sensors_at(pair.point, delay),
            speed_m_s=pair.world.speed_m_s, spin_rad_s=pair.world.spin_rad_s,
            light_time_s=factor * fresh.light_time_s,
        )  # fmt: skip
        gap = np.abs(again.light_time_s - fresh.light_time_s).max() * pair.world.speed_m_s
        assert gap <= 1e-8
        np.testing.assert_allclose(again.unit, fresh.unit, rtol=0.0, atol=1e-12)


def test_reciprocity_at_rest():
    """At rest, in axes that do not turn, the way there is as long as the way back."""
    rng = np.random.default_rng(1)
    one, two = rng.normal(size=(2, 20, 3)) * 1e5
    none = np.zeros((20, 3))
    there = one_ray(one, none, still(two))
    back = one_ray(two, none, still(one))
    np.testing.assert_allclose(there.light_time_s, back.light_time_s, rtol=1e-15)
    np.testing.assert_allclose(there.unit, -back.unit, rtol=0.0, atol=1e-15)
    np.testing.assert_array_equal(doppler(there), 0.0)


def test_a_turning_frame_breaks_reciprocity_by_sagnac():
    """There less back is 4 w A / c^2, A the area of the triangle with the axis, seen along it.

    N. Ashby, Relativity in the Global Positioning System, Living Rev. Relativ. 6 (2003), section 2:
    the correction is 2 w A / c^2 one way, 207.4 ns once around the equator (equation 6).
    """
    radius = 6378137.0
    angles = np.linspace(0.0, 2.0 * np.pi, 401)
    ring = radius * np.stack([np.cos(angles), np.sin(angles), np.zeros(401)], axis=1)
    none = np.zeros((400, 3))
    spin = EARTH_ROTATION_RAD_S
    east = one_ray(ring[:-1], none, still(ring[1:]), spin=spin).light_time_s.sum()
    west = one_ray(ring[1:], none, still(ring[:-1]), spin=spin).light_time_s.sum()
    assert 0.5 * (east - west) == pytest.approx(207.4e-9, abs=0.05e-9)
    # Between the poles and along a meridian there is none.
    pole = np.array([0.0, 0.0, radius])
    up = one_ray(pole, none[0], still(ring[0]), spin=spin)
    down = one_ray(ring[0], none[0], still(pole), spin=spin)
    assert abs(up.light_time_s[0] - down.light_time_s[0]) < 1e-16


def test_a_satellite_of_gps_over_the_horizon_and_the_zenith():
    """Figures of the interface: 67 ms from the zenith, 86 ms from the horizon, to a millisecond.

    Orbit radius 26 560 km: P. Misra, P. Enge, Global Positioning System, 2nd ed., 2006, chapter 4,
    where the range goes from about 20 000 to 26 000 km and the Doppler shift of a satellite in
    inertial axes is at most about 0.9 km/s along the line of sight (5 kHz at L1).
    """
    radius, earth = 26_560e3, 6_371e3
    speed = np.sqrt(3.986004418e14 / radius)
    receiver = np.array([earth, 0.0, 0.0])
    low = np.arccos(earth / radius)
    where = radius * np.array([[1.0, 0.0, 0.0], [np.cos(low), np.sin(low), 0.0]])
    moving = speed * np.array([[0.0, 1.0, 0.0], [-np.sin(low), np.cos(low), 0.0]])
    # Axes that do not turn, and a receiver that does not either.
    ray = one_ray(where, moving, still(np.tile(receiver, (2, 1))))
    np.testing.assert_allclose(ray.light_time_s, [67.3e-3, 86.0e-3], atol=1e-3)
    shift = 1575.42e6 * doppler(ray)
    assert abs(shift[0]) < 1.0
    # From the horizon v r_e / r, receding.
    expected = -1575.42e6 * speed * earth / radius / SPEED_OF_LIGHT_M_S
    assert shift[1] == pytest.approx(expected, rel=1e-4)
    assert 4.5e3 < -shift[1] < 5.5e3


@pytest.mark.parametrize(
    ("source", "receiver", "expected"),
    [
        # The textbook's four: f' = f (c +- v_r) / (c -+ v_s), along the line.
        (30.0, 0.0, 340.0 / (340.0 - 30.0)),
        (-30.0, 0.0, 340.0 / (340.0 + 30.0)),
        (0.0, 30.0, (340.0 - 30.0) / 340.0),
        (0.0, -30.0, (340.0 + 30.0) / 340.0),
        (20.0, 50.0, (340.0 - 50.0) / (340.0 - 20.0)),
    ],
)
def test_the_doppler_shift_of_the_textbook(source, receiver, expected):
    """Source at the left, receiver at the right, speeds to the right; sound."""
    ray = one_ray(
        [0.0, 0.0, 0.0], [source, 0.0, 0.0],
        even([100.0, 0.0, 0.0], [receiver, 0.0, 0.0]), speed=340.0,
    )  # fmt: skip
    assert doppler(ray)[0] + 1.0 == pytest.approx(expected, rel=1e-13)


@PROFILE
@given(seeds, worlds)
def test_the_doppler_shift_is_the_rate_of_arrival(seed, name):
    """Two crests, emitted a moment apart: their arrivals are that over the ratio apart."""
    pair = Pair(seed, WORLDS[name])
    assume(pair.subsonic)
    h = 1e-3 * pair.world.time_s
    late = h + pair.rays(emitted=h).light_time_s[0]
    early = -h + pair.rays(emitted=-h).light_time_s[0]
    half = 0.5 * h
    late_half = half + pair.rays(emitted=half).light_time_s[0]
    early_half = -half + pair.rays(emitted=-half).light_time_s[0]
    coarse, fine = (late - early) / (2.0 * h), (late_half - early_half) / h
    ratio = 1.0 / (doppler(pair.rays())[0] + 1.0)
    assert (4.0 * fine - coarse) / 3.0 == pytest.approx(ratio, rel=1e-9)


def test_turning_axes_shift_no_frequency_between_things_at_rest_in_them():
    """A rigid array that turns: distances stay, and so do all frequencies."""
    rng = np.random.default_rng(2)
    one, two = rng.normal(size=(2, 10, 3)) * 1e6
    ray = one_ray(one, np.zeros((10, 3)), still(two), spin=EARTH_ROTATION_RAD_S)
    np.testing.assert_allclose(doppler(ray), 0.0, atol=1e-16)


def test_rays_are_taken_whole():
    pair = Pair(5, WORLDS["light, satellites"], sensors=3)
    ray = pair.rays()
    index = np.array([2, 0, 2])
    part = ray.take(index)
    np.testing.assert_array_equal(part.light_time_s, ray.light_time_s[index])
    np.testing.assert_array_equal(part.sensor.position_m, ray.sensor.position_m[index])
    np.testing.assert_array_equal(doppler(part), doppler(ray)[index])


def test_no_rays_at_all():
    empty = np.empty((0, 3))
    ray = trace(
        empty, empty, lambda _: SensorMotion(empty, empty, empty), speed_m_s=340.0, spin_rad_s=0.0
    )
    assert ray.light_time_s.shape == (0,)
    assert doppler(ray).shape == (0,)
    assert arrival_gradient(ray).by_position.shape == (0, 3)


def test_an_object_at_its_sensor_gives_numbers():
    """The light time is zero there, and has no derivative; nothing is infinite."""
    place = np.array([1.0, 2.0, 3.0])
    ray = one_ray(place, [1.0, 0.0, 0.0], still(place), speed=340.0)
    assert ray.light_time_s[0] == 0.0
    assert np.isfinite(arrival_gradient(ray).by_position).all()
