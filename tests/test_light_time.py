"""Emission and light time against roots of the equation in axes that do not turn."""

import numpy as np
import pytest
from differences import assert_derivative
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from geograph.constants import EARTH_ROTATION_RAD_S, SPEED_OF_LIGHT_M_S
from geograph.factors.light_time import light_time_correction, sight, turn_to_reception
from geograph.families import BearingFamily, Values
from geograph.frames import SensorGeometry
from geograph.measurements import Bearings
from geograph.motion import Density, Motion
from geograph.sensors import Sensor
from geograph.states import SensorStates

PROFILE = settings(max_examples=60, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


def turned(vector, angle):
    """Turn a vector about z by an angle, anticlockwise."""
    rotation = np.array(
        [[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]]
    )
    return rotation @ vector


def inertial_light_time(position, velocity, sensor, spin, speed):
    """Solve |p(t - tau) - s(t)| = c tau in the axes of the frame at reception (t = 0), by root."""

    def miss(tau):
        return np.linalg.norm(turned(position - velocity * tau, -spin * tau) - sensor) - speed * tau

    upper = 1.0
    while miss(upper) > 0.0:
        upper *= 2.0
    return brentq(miss, 0.0, upper, xtol=1e-15, rtol=1e-15)


def test_axes_turn_with_the_frame():
    """What stands still in the frame moves east while the signal is under way."""
    point, delay = np.array([[4.2e7, 0.0, 1e6]]), np.array([0.5])
    moved = turn_to_reception(point, delay, EARTH_ROTATION_RAD_S)
    expected = turned(point[0], -EARTH_ROTATION_RAD_S * 0.5)
    np.testing.assert_allclose(moved[0], expected, rtol=1e-15)
    assert moved[0, 1] < 0.0


def test_sagnac_correction_by_hand():
    """A signal going east chases its receiver: omega (r_receiver x r_emitter)_z / c^2 longer.

    The usual first-order form (N. Ashby, Living Rev. Relativ. 6, 2003, section 2), for an emitter
    in geostationary distance 0.5 rad west of a receiver on the equator:
    7.292115e-5 * 6.378137e6 * 4.2164e7 * sin(0.5) / 299792458^2 = 104.6 ns.
    """
    emitter = 4.2164e7 * np.array([np.cos(-0.5), np.sin(-0.5), 0.0])
    receiver = 6.378137e6 * np.array([1.0, 0.0, 0.0])
    still = np.linalg.norm(emitter - receiver) / SPEED_OF_LIGHT_M_S
    found = solved(emitter[None], np.zeros((1, 3)), receiver[None], EARTH_ROTATION_RAD_S)
    area = emitter[0] * receiver[1] - emitter[1] * receiver[0]
    expected = EARTH_ROTATION_RAD_S * area / SPEED_OF_LIGHT_M_S**2
    assert expected == pytest.approx(104.6e-9, rel=1e-3)
    # The next order is a velocity over c (1e-5) smaller.
    assert found.light_time_s[0] - still == pytest.approx(expected, rel=3e-5)


def solved(position, velocity, sensor, spin, speed=SPEED_OF_LIGHT_M_S):
    """Iterate the library's correction on straight motion in the frame."""
    tau = np.zeros(position.shape[0])
    for _ in range(30):
        found = sight(position - velocity * tau[:, None], velocity, sensor, tau, spin)
        change = light_time_correction(found, speed)
        tau = tau + change
        if np.abs(change).max() < 1e-14:
            break
    return sight(position - velocity * tau[:, None], velocity, sensor, tau, spin)


@PROFILE
@given(seeds, st.sampled_from([0.0, EARTH_ROTATION_RAD_S]), st.sampled_from([3e8, 3e5, 2e4]))
def test_delay_is_the_root_in_axes_at_rest(seed, spin, speed):
    rng = np.random.default_rng(seed)
    position, sensor = rng.normal(size=(2, 5, 3)) * 3e6
    velocity = rng.normal(size=(5, 3)) * 3e3
    assume(np.linalg.norm(velocity, axis=1).max() < 0.5 * speed)
    found = solved(position, velocity, sensor, spin, speed)
    for row in range(5):
        root = inertial_light_time(position[row], velocity[row], sensor[row], spin, speed)
        np.testing.assert_allclose(found.light_time_s[row], root, rtol=1e-12)
        seen = turned(position[row] - velocity[row] * root, -spin * root) - sensor[row]
        np.testing.assert_allclose(found.line_of_sight_m[row], seen, rtol=0.0, atol=1e-5)


@PROFILE
@given(seeds, st.sampled_from([0.0, EARTH_ROTATION_RAD_S, 1e-3]), st.sampled_from([3e8, 4e4]))
def test_aberration_is_the_derivative_of_the_line_of_sight(seed, spin, speed):
    rng = np.random.default_rng(seed)
    position, sensor = rng.normal(size=(2, 1, 3)) * 3e6
    velocity = rng.normal(size=(1, 3)) * 3e3
    assume(np.linalg.norm(position - sensor) > 1e6)
    # A frame that spins fast carries the object along at spin times distance.
    assume(spin * 1e7 < 0.5 * speed)
    found = solved(position, velocity, sensor, spin, speed)
    # E is by a displacement of the emission in axes at reception: minus that of the sensor.
    for analytic, read in (
        (-found.aberration(speed)[0], lambda s: s.line_of_sight_m[0]),
        (-found.light_time_gradient(speed)[0][None], lambda s: s.light_time_s),
    ):
        assert_derivative(
            analytic,
            lambda at, read=read: read(solved(position, velocity, at[None], spin, speed)),
            sensor[0],
            3e3,
            rtol=1e-7,
        )


@pytest.mark.parametrize("frame", ["ecef", "local"])
@pytest.mark.parametrize("speed", [SPEED_OF_LIGHT_M_S, 2e4])
def test_whole_family_sees_the_object_where_it_emitted(frame, speed):
    """A family's prediction for a bent path and slow signals, against the root."""
    rng = np.random.default_rng(3)
    spin = EARTH_ROTATION_RAD_S if frame == "ecef" else 0.0
    knots = np.linspace(-400.0, 100.0, 6)
    motion = Motion("constant-acceleration", Density.of(1.0), frame)
    path = motion.path(knots)
    state = rng.normal(size=(6, 9)) * np.repeat([1e4, 50.0, 1.0], 3)
    state[:, :3] += np.array([6.7e6, 1e5, -2e5]) + np.outer(knots, [900.0, -700.0, 300.0])
    sensors = [Sensor(name="A", position_m=np.array([6.3e6, 4e5, 1e5]), axes="xyz")]
    times = rng.uniform(-200.0, 100.0, 12)
    zero = np.zeros(12)
    table = Bearings(
        time_s=times, sensor=zero.astype(np.int64), azimuth_rad=zero, elevation_rad=zero,
        sigma_azimuth_rad=zero + 1e-3, sigma_elevation_rad=zero + 1e-3,
        isotropic=np.ones(12, dtype=bool), line=zero.astype(np.int64),
    )  # fmt: skip
    family = BearingFamily(
        table, geometry=SensorGeometry(sensors, frame), states=SensorStates(sensors, [0], 0.0),
        walk_scale=np.empty(0), speed_m_s=speed, weight=np.ones(12),
        position_noise_m=np.zeros(12),
    )  # fmt: skip
    values = Values(state, np.zeros((6, 0)), np.zeros(0))
    bearing, distance, emitted = family.predicted(path, values)
    held = path.at_state(state, jacobian=False)

    def position(time):
        return held.position_velocity(path.locate(np.array([time])))[0][0]

    for row, time in enumerate(times):

        def seen(tau, time=time):
            return turned(position(time - tau), -spin * tau) - sensors[0].position_m

        root = brentq(
            lambda tau: np.linalg.norm(seen(tau)) - speed * tau,
            0.0,
            200.0,
            xtol=1e-14,
            rtol=1e-15,
        )
        line = seen(root)
        assert emitted[row] == pytest.approx(time - root, abs=2e-6)
        assert distance[row] == pytest.approx(np.linalg.norm(line), abs=1e-4)
        expected = [np.arctan2(line[1], line[0]), np.arctan2(line[2], np.hypot(line[0], line[1]))]
        np.testing.assert_allclose(bearing[row], expected, rtol=0.0, atol=1e-10)
