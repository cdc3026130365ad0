"""Receptions and their frequencies: against closed forms, scalar solvers, and the library.

The simulator and :mod:`geograph.factors.arrival` share no equation; each is held to the other.
"""

import numpy as np
import pytest
from scipy.optimize import brentq

from geograph.constants import EARTH_ROTATION_RAD_S, SPEED_OF_LIGHT_M_S
from geograph.factors.arrival import SensorMotion, doppler, trace
from geograph.factors.difference import frequency_difference, time_difference
from geograph.scenarios.observation import light_time
from geograph.scenarios.orbits import CircularOrbit, EarthFixedBody, turned_about_z
from geograph.scenarios.paths import StraightBody
from geograph.scenarios.places import ecef
from geograph.scenarios.radio_aircraft import Multilateration, multilateration_world
from geograph.scenarios.radio_mixed import mixed_world
from geograph.scenarios.radio_orbit import Formation, formation_world
from geograph.scenarios.radio_platforms import Platforms, platforms_world
from geograph.scenarios.radio_reception import receive
from geograph.scenarios.sound import Microphones, microphones_world

ORBIT = EarthFixedBody(CircularOrbit(7.1e6, np.array([0.0, 0.6, 0.8]), np.array([1.0, 0, 0]), 0.3))
GROUND = StraightBody(ecef(48.0, 11.0, 500.0))
TIMES = np.array([0.0, 77.0, 3600.0, 40_000.0])


def on_earth(path, receiver, times):
    return receive(
        path,
        receiver,
        times,
        propagation_speed_m_s=SPEED_OF_LIGHT_M_S,
        rotation_rad_s=EARTH_ROTATION_RAD_S,
    )


def in_air(path, receiver, times, speed=343.0):
    return receive(path, receiver, times, propagation_speed_m_s=speed, rotation_rad_s=0.0)


@pytest.mark.parametrize("speed", [343.0, 60.0, SPEED_OF_LIGHT_M_S])
def test_straight_flights_solve_the_quadratic(speed):
    times = np.linspace(-3.0, 9.0, 25)
    path = StraightBody(np.array([120.0, -40.0, 30.0]), np.array([-30.0, 15.0, 5.0]))
    receiver = StraightBody(np.array([-10.0, 5.0, 2.0]), np.array([8.0, -20.0, 1.0]))
    found = in_air(path, receiver, times, speed)
    # |d - w tau| = c tau with d from the receiver to the object at emission, w the receiver's.
    line, moving = path.position_at(times) - receiver.position_at(times), receiver.velocity_m_s
    a, b, c = speed**2 - moving @ moving, line @ moving, np.sum(line**2, axis=-1)
    np.testing.assert_allclose(found.delay_s, (-b + np.sqrt(b**2 + a * c)) / a, rtol=1e-13)


@pytest.mark.parametrize(("path", "receiver"), [(ORBIT, GROUND), (GROUND, ORBIT)])
def test_delays_on_the_turning_earth_equal_a_scalar_solution(path, receiver):
    found = on_earth(path, receiver, TIMES)
    for t, delay in zip(TIMES, found.delay_s, strict=True):
        place = turned_about_z(path.position_at(t), EARTH_ROTATION_RAD_S * t)

        def miss(tau, t=t, place=place):
            there = turned_about_z(receiver.position_at(t + tau), EARTH_ROTATION_RAD_S * (t + tau))
            return np.linalg.norm(place - there) - SPEED_OF_LIGHT_M_S * tau

        assert delay == pytest.approx(brentq(miss, 0.0, 1.0, xtol=1e-16, rtol=1e-14), rel=1e-12)


@pytest.mark.parametrize(("path", "receiver"), [(ORBIT, GROUND), (GROUND, ORBIT)])
def test_receptions_and_emissions_are_each_others_inverse(path, receiver):
    delay = on_earth(path, receiver, TIMES).delay_s
    received = TIMES + delay
    back, _ = light_time(path, receiver.position_at(received), received)
    # A time of 40000 s has steps of 7 ps, in which an orbit goes 50 nm.
    np.testing.assert_allclose(back, delay, atol=1e-15)


def test_a_signal_that_never_catches_its_receiver_is_refused():
    away = StraightBody(np.array([9.0, 0, 0]), np.array([400.0, 0, 0]))
    with pytest.raises(RuntimeError, match="receptions do not settle"):
        in_air(StraightBody(np.zeros(3)), away, np.array([1.0]))


@pytest.mark.parametrize(
    ("path", "receiver", "speed", "turning"),
    [
        (ORBIT, GROUND, SPEED_OF_LIGHT_M_S, EARTH_ROTATION_RAD_S),
        (GROUND, ORBIT, SPEED_OF_LIGHT_M_S, EARTH_ROTATION_RAD_S),
        (
            StraightBody(np.array([120.0, -40.0, 30.0]), np.array([-30.0, 15.0, 5.0])),
            StraightBody(np.array([-10.0, 5.0, 2.0]), np.array([8.0, -20.0, 1.0])),
            343.0,
            0.0,
        ),
    ],
)
def test_shift_is_the_derivative_of_the_reception_time(path, receiver, speed, turning):
    times, step = np.array([0.0, 3.0, 77.0]), 0.005

    def delay(t):
        return receive(
            path, receiver, t, propagation_speed_m_s=speed, rotation_rad_s=turning
        ).delay_s

    # Central differences to the fourth order, of delays that are small beside the times.
    near = (delay(times + step) - delay(times - step)) / (2.0 * step)
    far = (delay(times + 2.0 * step) - delay(times - 2.0 * step)) / (4.0 * step)
    slope = (4.0 * near - far) / 3.0
    shift = receive(
        path, receiver, times, propagation_speed_m_s=speed, rotation_rad_s=turning
    ).shift
    np.testing.assert_allclose(shift, -slope / (1.0 + slope), rtol=1e-8, atol=1e-14)


@pytest.mark.parametrize(
    ("source", "receiver", "ratio"),
    [
        (40.0, 0.0, 343.0 / (343.0 - 40.0)),
        (-40.0, 0.0, 343.0 / (343.0 + 40.0)),
        (0.0, -40.0, (343.0 + 40.0) / 343.0),
        (0.0, 40.0, (343.0 - 40.0) / 343.0),
        (30.0, 30.0, 1.0),
    ],
)
def test_doppler_shift_of_the_textbook(source, receiver, ratio):
    # Both on the x axis, the receiver 500 m ahead; at t = 1 s.
    found = in_air(
        StraightBody(np.zeros(3), np.array([source, 0.0, 0.0])),
        StraightBody(np.array([500.0, 0.0, 0.0]), np.array([receiver, 0.0, 0.0])),
        np.array([1.0]),
    )
    assert 1.0 + found.shift[0] == pytest.approx(ratio, rel=1e-14)


def test_an_emitter_in_the_place_of_its_receiver_is_heard_at_once():
    here = StraightBody(np.array([3.0, 4.0, 5.0]))
    found = in_air(here, here, np.array([0.0, 10.0]))
    assert found.delay_s.tolist() == [0.0, 0.0]
    assert found.shift.tolist() == [0.0, 0.0]


def test_a_moving_emitter_in_the_place_of_its_receiver_gives_finite_numbers():
    here = StraightBody(np.zeros(3))
    through = StraightBody(np.array([-10.0, 0.0, 0.0]), np.array([10.0, 0.0, 0.0]))
    found = in_air(through, here, np.array([0.0, 1.0, 2.0]))
    assert np.isfinite(found.shift).all()
    assert found.delay_s[1] == 0.0


WORLDS = {
    "satellites hear a ship": lambda: formation_world(1, Formation(satellites=3, emitter="ship")),
    "satellites hear a beacon": lambda: formation_world(2, Formation(shared=False)),
    "receivers hear an aircraft": lambda: multilateration_world(3, Multilateration(path="turns")),
    "cameras and receivers": lambda: mixed_world(4),
    "platforms": lambda: platforms_world(5, Platforms(emitter_m_s=(80.0, 30.0), sigma_hz=1.0)),
    "moving microphones": lambda: microphones_world(
        6, Microphones(heard="differences", tone_hz=200.0, microphone_m_s=15.0)
    ),
}


def library_rays(world, sensor, emitted):
    """Rays of the library from the true path to the sensors as they really are."""

    def motion(time):
        position, velocity, acceleration = np.empty((3, sensor.size, 3))
        for index in np.unique(sensor):
            rows, body = sensor == index, world.receivers[index].body
            position[rows] = body.position_at(time[rows])
            velocity[rows] = body.velocity_at(time[rows])
            acceleration[rows] = 0.0
        return SensorMotion(position, velocity, acceleration)

    return trace(
        world.path.position_at(emitted),
        world.path.velocity_at(emitted),
        lambda delay: motion(emitted + delay),
        speed_m_s=world.propagation_speed_m_s,
        spin_rad_s=EARTH_ROTATION_RAD_S if world.recording.frame == "ecef" else 0.0,
    )


@pytest.mark.parametrize("name", WORLDS)
def test_the_library_predicts_what_the_simulator_made(name):
    world = WORLDS[name]()
    recording, speed = world.recording, world.propagation_speed_m_s
    tables = set(recording.tables) - {"bearings"}
    assert tables
    for label in tables:
        table, rows = recording.tables[label], world.rows[label]
        ray = library_rays(world, table.sensor, rows.emission_time_s)
        if label == "arrivals":
            late = rows.exact - rows.emission_time_s - ray.light_time_s
            # Numbers of seconds up to 120 have steps of 14 fs, which is 4 um of light.
            assert np.abs(late).max() < 1e-14 + 1e-8 / speed
            continue
        other = library_rays(world, table.reference, rows.emission_time_s)
        if label == "time_differences":
            off = speed * (time_difference(ray, other) - rows.exact)
            assert np.abs(off).max() < 1e-8
        else:
            predicted = frequency_difference(ray, other, table.carrier_hz)
            assert np.abs(rows.exact).max() > 1.0
            np.testing.assert_allclose(predicted, rows.exact, atol=1e-14 * table.carrier_hz[0])


@pytest.mark.parametrize("name", WORLDS)
def test_the_simulator_receives_what_the_library_traces(name):
    world = WORLDS[name]()
    turning = EARTH_ROTATION_RAD_S if world.recording.frame == "ecef" else 0.0
    emitted = np.random.default_rng(0).uniform(0.0, 8.0, 50)
    for index, receiver in enumerate(world.receivers):
        ray = library_rays(world, np.full(50, index), emitted)
        found = receive(
            world.path,
            receiver.body,
            emitted,
            propagation_speed_m_s=world.propagation_speed_m_s,
            rotation_rad_s=turning,
        )
        miss = world.propagation_speed_m_s * (found.delay_s - ray.light_time_s)
        assert np.abs(miss).max() < 1e-8
        np.testing.assert_allclose(found.shift, doppler(ray), rtol=1e-9, atol=1e-14)
