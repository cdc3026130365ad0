"""Flights over ground, made from geometry alone: positions, attitudes, and what they would see.

Nothing here uses the estimator's equations: attitudes are scipy's rotations, directions are vectors
in north, east, down, and angles are taken off them with the definitions of docs/conventions.md.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from geograph.measurements import Bearings
from geograph.sensors import Trajectory


@dataclass(frozen=True, eq=False)
class Flight:
    """Positions (x east, y north, z up) and yaw, pitch, roll at times."""

    time_s: np.ndarray
    position_m: np.ndarray
    attitude_rad: np.ndarray

    def trajectory(self):
        return Trajectory(self.time_s, self.position_m, self.attitude_rad)


def straight(start, course_deg, speed, duration, *, pitch_deg=2.0, rate=10.0):
    """Level flight along a course, clockwise from north, nose a little up."""
    time = np.arange(0.0, duration + 0.5 / rate, 1.0 / rate)
    course = np.radians(course_deg)
    way = np.stack([np.sin(course) * time, np.cos(course) * time, 0.0 * time], axis=1)
    angles = np.broadcast_to([course, np.radians(pitch_deg), 0.0], (time.size, 3)).copy()
    return Flight(time, np.asarray(start) + speed * way, angles)


def circle(centre, radius, speed, duration, *, bank_deg=25.0, rate=10.0):
    """A level turn to the right around a centre, banked."""
    time = np.arange(0.0, duration + 0.5 / rate, 1.0 / rate)
    angle = speed / radius * time
    way = np.stack([radius * np.sin(angle), radius * np.cos(angle), 0.0 * time], axis=1)
    # Clockwise from above: at the northernmost point it flies east.
    angles = np.stack([angle + np.pi / 2, 0.03 + 0.0 * time, np.radians(bank_deg) + 0.0 * time], 1)
    return Flight(time, np.asarray(centre) + way, angles)


def seen(flight, emitter_m, *, misalignment_rad=(0.0, 0.0, 0.0)):
    """Return azimuth and elevation of an emitter in body axes, each shape (n,), radians."""
    sight = np.asarray(emitter_m) - flight.position_m
    ned = np.stack([sight[:, 1], sight[:, 0], -sight[:, 2]], axis=1)
    recorded = Rotation.from_euler("ZYX", flight.attitude_rad)
    # The true body is the recorded one turned about its own axes.
    true = recorded * Rotation.from_rotvec(misalignment_rad)
    forward, right, down = true.inv().apply(ned).T
    return np.arctan2(right, forward), np.arctan2(-down, np.hypot(forward, right))


def measured(flights, emitter_m, sigma_rad, rng, *, misalignment_rad=(0.0, 0.0, 0.0), on_sky=True):
    """Return bearings of one emitter from flights, sensors numbered, with noise."""
    columns = []
    for index, flight in enumerate(flights):
        azimuth, elevation = seen(flight, emitter_m, misalignment_rad=misalignment_rad)
        noise = sigma_rad * rng.normal(size=(2, azimuth.size))
        if on_sky:
            # A small circle's worth of displacement around the direction.
            direction = np.stack(
                [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
                 np.sin(elevation)], axis=1,
            )  # fmt: skip
            east = np.stack([-np.sin(azimuth), np.cos(azimuth), 0.0 * azimuth], axis=1)
            north = np.cross(direction, east)
            moved = direction + np.tan(noise[0])[:, None] * east + np.tan(noise[1])[:, None] * north
            azimuth = np.arctan2(moved[:, 1], moved[:, 0])
            elevation = np.arctan2(moved[:, 2], np.hypot(moved[:, 0], moved[:, 1]))
        else:
            azimuth, elevation = azimuth + noise[0], elevation + noise[1]
            # An elevation past the pole is one on the other side.
            over = np.abs(elevation) > np.pi / 2
            elevation[over] = np.sign(elevation[over]) * np.pi - elevation[over]
            azimuth[over] += np.pi
        sensor = np.full(azimuth.size, index)
        columns.append([flight.time_s, sensor, azimuth, elevation])
    time, sensor, azimuth, elevation = (np.concatenate(part) for part in zip(*columns, strict=True))
    return Bearings(
        time_s=time,
        sensor=sensor.astype(np.int64),
        azimuth_rad=azimuth,
        elevation_rad=elevation,
        sigma_azimuth_rad=np.full(time.size, sigma_rad),
        sigma_elevation_rad=np.full(time.size, sigma_rad),
        isotropic=np.full(time.size, on_sky),
        line=np.arange(time.size) + 2,
    )
