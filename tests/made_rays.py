"""Random objects and sensors that move along parabolas, for checking arrivals and differences."""

from dataclasses import dataclass

import numpy as np

from geograph.constants import EARTH_ROTATION_RAD_S, SPEED_OF_LIGHT_M_S
from geograph.factors.arrival import SensorMotion, trace


@dataclass(frozen=True)
class World:
    """Speed of propagation, turning of the frame, and the sizes of what moves in it."""

    speed_m_s: float
    spin_rad_s: float
    length_m: float
    object_m_s: float
    sensor_m_s: float

    @property
    def time_s(self):
        """What the faster one takes for the length: on which everything bends."""
        return self.length_m / max(self.object_m_s, self.sensor_m_s)


WORLDS = {
    "sound": World(340.0, 0.0, 1e3, 60.0, 15.0),
    "sound, turning": World(340.0, 1e-2, 1e3, 30.0, 30.0),
    "fast source": World(340.0, 0.0, 1e3, 150.0, 5.0),
    "light, satellites": World(SPEED_OF_LIGHT_M_S, EARTH_ROTATION_RAD_S, 7e6, 7e3, 7e3),
    "light, aircraft": World(SPEED_OF_LIGHT_M_S, EARTH_ROTATION_RAD_S, 3e5, 250.0, 100.0),
    "light, still": World(SPEED_OF_LIGHT_M_S, 0.0, 1e4, 100.0, 1e-9),
    "close by": World(340.0, 0.0, 0.5, 20.0, 5.0),
}


class Pair:
    """One object and sensors, with everything that a derivative may move as one vector.

    The vector: position (3) and velocity (3) of the object at time zero; position and velocity of
    every sensor at time zero (6 each); the time of emission; the logarithm of the speed.
    """

    def __init__(self, seed, world, sensors=1):
        rng = np.random.default_rng(seed)
        self.world, self.sensors = world, sensors
        t = world.time_s
        self.acceleration = rng.normal(size=3) * world.object_m_s / t
        self.sensor_acceleration = rng.normal(size=(sensors, 3)) * world.sensor_m_s / t
        direction = rng.normal(size=(sensors, 3))
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        start = rng.normal(size=3) * world.length_m
        # Never nearer than a third of the length: bounds on what bends.
        place = start + direction * world.length_m * rng.uniform(0.3, 1.5, (sensors, 1))
        speeds = world.sensor_m_s * rng.normal(size=(sensors, 3))
        velocity = world.object_m_s * rng.normal(size=3)
        self.point = np.concatenate(
            [start, velocity, np.concatenate([place, speeds], axis=1).ravel(), [0.0, 0.0]]
        )
        h = 1e-3
        self.steps = np.concatenate(
            [
                np.full(3, h * world.length_m),
                np.full(3, h * world.length_m / t),
                np.tile(np.repeat([h * world.length_m, h * world.length_m / t], 3), sensors),
                [h * t, h],
            ]
        )

    @property
    def subsonic(self):
        """Whether nothing is near the speed of its signal."""
        speeds = [np.linalg.norm(self.point[3:6]), *np.linalg.norm(self._starts()[:, 3:], axis=1)]
        return max(speeds) < 0.8 * self.world.speed_m_s

    def _starts(self, point=None):
        point = self.point if point is None else point
        return point[6:-2].reshape(self.sensors, 6)

    def object_at(self, point, time):
        """Position and velocity of the object, each shape (3,)."""
        a = self.acceleration
        return point[:3] + point[3:6] * time + 0.5 * a * time**2, point[3:6] + a * time

    def sensors_at(self, point, time):
        """Motion of the sensors at times, shape (sensors,)."""
        start, t = self._starts(point), np.broadcast_to(time, self.sensors)[:, None]
        a = self.sensor_acceleration
        return SensorMotion(
            start[:, :3] + start[:, 3:] * t + 0.5 * a * t**2, start[:, 3:] + a * t, a
        )

    def rays(self, point=None, emitted=None):
        """Signals of one emission to all sensors."""
        point = self.point if point is None else point
        emitted = point[-2] if emitted is None else emitted
        position, velocity = self.object_at(point, emitted)
        return trace(
            np.tile(position, (self.sensors, 1)),
            np.tile(velocity, (self.sensors, 1)),
            lambda delay: self.sensors_at(point, emitted + delay),
            speed_m_s=self.world.speed_m_s * np.exp(point[-1]),
            spin_rad_s=self.world.spin_rad_s,
        )
