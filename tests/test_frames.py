"""Poses of sensors: which axes they have, and how these move."""

from datetime import UTC, datetime

import numpy as np
import pytest
from differences import derivative

from geograph.constants import EARTH_ROTATION_RAD_S
from geograph.errors import InputError
from geograph.frames import SensorGeometry, frame_spin_rad_s
from geograph.geodesy import ecef_from_geodetic
from geograph.sensors import Sensor, Trajectory

PLACE = ecef_from_geodetic(48.0, 11.0, 500.0)
TIMES = np.linspace(0.0, 100.0, 21)


def orbit(frame):
    """A sensor on a satellite, or on a carousel."""
    centre, radius = (np.zeros(3), 7e6) if frame == "ecef" else (np.ones(3), 50.0)
    phase = 0.011 * TIMES
    circle = np.stack([np.cos(phase), 0.6 * np.sin(phase), 0.8 * np.sin(phase)], axis=1)
    return Trajectory(TIMES, centre + radius * circle)


def geometry(frame):
    return SensorGeometry(
        [
            Sensor(name="fixed enu", position_m=PLACE, axes="enu"),
            Sensor(name="fixed xyz", position_m=PLACE, axes="xyz"),
            Sensor(name="moving enu", trajectory=orbit(frame), axes="enu"),
            Sensor(name="moving xyz", trajectory=orbit(frame), axes="xyz"),
        ],
        frame,
    )


def test_only_ecef_turns():
    assert frame_spin_rad_s("ecef") == EARTH_ROTATION_RAD_S
    assert frame_spin_rad_s("local") == 0.0


@pytest.mark.parametrize("frame", ["ecef", "local"])
def test_moving_sensors_and_their_axes(frame):
    """Velocities and turning axes are the time derivatives of positions and axes."""
    sensor = np.array([2, 0, 3, 2, 1, 2])
    time = np.array([3.0, 50.0, 61.7, 42.0, 10.0, 98.3])
    found = geometry(frame).poses(sensor, time)

    def read(name):
        def at(shift):
            return getattr(geometry(frame).poses(sensor, time + shift[0]), name)

        return derivative(at, [0.0], [0.05])[:, 0]

    np.testing.assert_allclose(found.velocity_m_s.ravel(), read("position_m"), rtol=0.0, atol=1e-4)
    turning = read("axes").reshape(6, 3, 3)
    rate = np.zeros((6, 3, 3)) if found.axes_rate is None else found.axes_rate
    np.testing.assert_allclose(rate, turning, rtol=0.0, atol=1e-9)
    assert (np.abs(turning).max() > 1e-4) == (frame == "ecef")
    np.testing.assert_array_equal(found.position_m[[1, 4]], [PLACE, PLACE])
    assert not found.velocity_m_s[[1, 4]].any()


def test_rows_of_the_axes_are_north_east_up():
    axes = geometry("ecef").poses(np.array([0]), np.array([0.0])).axes[0]
    up = axes[2]
    assert np.degrees(np.arcsin(up[2])) == pytest.approx(48.0, abs=1e-9)
    assert axes[0, 2] == pytest.approx(np.cos(np.radians(48.0)))
    assert axes[1, 2] == 0.0
    # Clockwise from north seen from above: north x east points down.
    np.testing.assert_allclose(np.cross(axes[0], axes[1]), -up, atol=1e-15)


def test_local_enu_is_y_x_z_and_xyz_is_the_frame():
    found = geometry("local").poses(np.array([0, 1]), np.zeros(2))
    np.testing.assert_array_equal(found.axes[0], [[0, 1, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_array_equal(found.axes[1], np.eye(3))


@pytest.mark.parametrize(
    ("frame", "epoch", "what"),
    [("ecef", None, "no epoch"), ("local", datetime(2024, 3, 20, tzinfo=UTC), "frame local")],
)
def test_the_sky_needs_an_epoch_and_the_earth(frame, epoch, what):
    sensor = Sensor(name="S7", position_m=PLACE, axes="radec")
    with pytest.raises(InputError, match=rf"'S7' has axes radec and the recording has {what}; exp"):
        SensorGeometry([sensor], frame, epoch=epoch)


@pytest.mark.parametrize("count", [2, 3, 4, 9])
def test_motion_is_read_from_the_spline_in_one_go(count):
    rng = np.random.default_rng(count)
    edges = np.sort(rng.uniform(0.0, 9.0, count))
    path = Trajectory(time_s=edges, position_m=rng.normal(size=(count, 3)))
    # At its points, between them, and beyond both ends.
    time = np.concatenate([edges, np.linspace(edges[0] - 1.0, edges[-1] + 1.0, 20)])
    read = path.motion_at(time)
    exact = path.position_at(time), path.velocity_at(time), path.acceleration_at(time)
    for found, expected in zip(read, exact, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
