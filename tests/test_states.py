"""Sensor-error states: which there are and what they add."""

import numpy as np

from geograph.sensors import Sensor, SensorErrors
from geograph.states import (
    AZIMUTH,
    CHANNELS,
    CLOCK,
    ELEVATION,
    POSITION,
    VELOCITY,
    SensorErrorTerms,
    SensorStates,
)

SENSORS = [
    Sensor(name="A", position_m=np.zeros(3), errors=SensorErrors(azimuth_bias_rad=0.1)),
    Sensor(name="B", position_m=np.zeros(3)),
    Sensor(
        name="C",
        position_m=np.zeros(3),
        errors=SensorErrors(
            azimuth_bias_rad=0.2,
            elevation_bias_rad=0.3,
            azimuth_drift_rad_s=0.01,
            elevation_drift_rad_s=0.02,
            azimuth_instability_rad_sqrt_s=0.05,
            clock_offset_s=4.0,
            clock_drift_s_s=0.5,
            clock_instability_s_sqrt_s=0.06,
            position_m=7.0,
        ),
    ),
    Sensor(name="silent", position_m=np.zeros(3), errors=SensorErrors(clock_offset_s=1.0)),
]
STATES = SensorStates(SENSORS, [0, 1, 2], 100.0)


def test_names_units_and_order():
    table = [(state.sensor, state.name, state.unit, state.sigma) for state in STATES.constants]
    assert table == [
        (0, "azimuth_bias", "rad", 0.1),
        (2, "azimuth_bias", "rad", 0.2),
        (2, "azimuth_drift", "rad/s", 0.01),
        (2, "elevation_bias", "rad", 0.3),
        (2, "elevation_drift", "rad/s", 0.02),
        (2, "clock_offset", "s", 4.0),
        (2, "clock_drift", "s/s", 0.5),
        (2, "position_x", "m", 7.0),
        (2, "position_y", "m", 7.0),
        (2, "position_z", "m", 7.0),
    ]
    walks = [(walk.sensor, walk.name, walk.unit, walk.diffusion) for walk in STATES.walks]
    assert walks == [(2, "azimuth_walk", "rad", 0.05), (2, "clock_walk", "s", 0.06)]
    assert STATES.size == 10
    assert STATES.of_sensor(0) == [0]
    assert STATES.of_sensor(1) == STATES.of_sensor(3) == []
    assert STATES.of_sensor(2) == list(range(1, 10))


def test_errors_are_bias_and_drift_and_walk():
    """error(t) = bias + drift (t - t0) + walk, each in units of its scale."""
    sensor, time = np.array([2, 0, 1, 2]), np.array([100.0, 103.0, 104.0, 110.0])
    terms = SensorErrorTerms(STATES, sensor, time, np.array([0.5, 0.25]))
    constants = np.array([3.0, 1.0, 2.0, -1.0, 0.5, 0.25, -2.0, 1.0, 2.0, 3.0])
    expected = np.zeros((4, CHANNELS))
    expected[0, [AZIMUTH, ELEVATION, CLOCK]] = 0.2, -0.3, 1.0
    expected[1, AZIMUTH] = 0.3
    expected[3, [AZIMUTH, ELEVATION, CLOCK]] = (
        0.2 + 2.0 * 0.01 * 10.0,
        -0.3 + 0.5 * 0.02 * 10.0,
        1.0 - 2.0 * 0.5 * 10.0,
    )
    expected[[0, 3], POSITION:VELOCITY] = 7.0, 14.0, 21.0
    np.testing.assert_allclose(terms.errors(constants), expected, atol=1e-15)

    walks = np.array([[0.0, 0.0], [1.0, -2.0], [3.0, 4.0]])
    knots, interval = np.array([0.0, 10.0, 20.0]), np.array([0, 0, 1, 1])
    share = terms.share(knots, interval, np.array([5.0, 1.0, 13.0, 12.5]))
    expected[0, [AZIMUTH, CLOCK]] += 0.5 * 0.5, 0.25 * -1.0
    expected[3, [AZIMUTH, CLOCK]] += 0.5 * 1.5, 0.25 * -0.5
    found = terms.errors(constants, walks, share)
    np.testing.assert_allclose(found, expected, atol=1e-15)


def test_sensors_without_errors_have_no_states():
    states = SensorStates(SENSORS[1:2], [0], 0.0)
    assert states.size == 0
    assert not states.walks
    terms = SensorErrorTerms(states, np.zeros(3, dtype=int), np.zeros(3), np.empty(0))
    assert not terms.errors(np.empty(0)).any()
