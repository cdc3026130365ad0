"""Platforms: moving sensors whose own path is estimated from noisy fixes.

The points of such a sensor's trajectory are fixes, each with an independent error. Its path is a
state of constant velocity driven by white noise on the acceleration (order 2 of
:mod:`geograph.factors.kinematics`), counted from the straight line that fits the fixes best, so
that numbers stay small; that line changes nothing, because the prior is the same along any straight
line.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from geograph.sensors import Sensor


@dataclass(frozen=True, eq=False)
class StraightLine:
    """Even motion along a straight line.

    Attributes
    ----------
    time_s
        Time at which it is at ``start_m``.
    start_m, rate_m_s
        Shape (3,): position then, and velocity.
    """

    time_s: float
    start_m: NDArray[np.float64]
    rate_m_s: NDArray[np.float64]

    def position_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return positions, shape (..., 3), metres, at times in seconds (any shape)."""
        since = np.asarray(time_s, dtype=np.float64) - self.time_s
        return np.asarray(self.start_m + since[..., None] * self.rate_m_s)

    def velocity_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return velocities, shape (..., 3), metres per second, at times in seconds."""
        return np.broadcast_to(self.rate_m_s, (*np.shape(time_s), 3))

    def acceleration_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return accelerations, shape (..., 3), m/s^2: zero."""
        return np.zeros((*np.shape(time_s), 3))

    def motion_at(
        self, time_s: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return positions, velocities and accelerations, each shape (n, 3)."""
        return self.position_at(time_s), self.velocity_at(time_s), self.acceleration_at(time_s)

    def pieces(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the line as one piece of a cubic; see :class:`geograph.frames.SensorPieces`."""
        none = np.zeros(3)
        return np.array([self.time_s]), np.stack([none, none, self.rate_m_s, self.start_m])[None]


@dataclass(frozen=True, eq=False)
class Platform:
    """A sensor whose path is estimated.

    Attributes
    ----------
    sensor
        Index of the sensor.
    process_noise
        Square root of the spectral density of the acceleration, m/s^1.5.
    sigma_m
        Standard deviation of a fix, per axis.
    time_s, fix_m
        Shapes (n,), (n, 3): the fixes.
    line
        The line that they fit best.
    """

    sensor: int
    process_noise: float
    sigma_m: float
    time_s: NDArray[np.float64]
    fix_m: NDArray[np.float64]
    line: StraightLine


def best_line(time_s: NDArray[np.float64], position_m: NDArray[np.float64]) -> StraightLine:
    """Return the straight line that fits positions best.

    Parameters
    ----------
    time_s
        Shape (n,), n of at least 2.
    position_m
        Shape (n, 3).
    """
    middle = float(time_s.mean())
    centre = position_m.mean(axis=0)
    since = time_s - middle
    return StraightLine(middle, centre, since @ (position_m - centre) / float(since @ since))


def platforms_of(sensors: Sequence[Sensor], active: Sequence[int]) -> list[Platform]:
    """Return the sensors, of those that measured, whose paths are estimated.

    Parameters
    ----------
    sensors
        In the order of their indices.
    active
        Indices of those that measured.
    """
    found = []
    for index in active:
        sensor = sensors[index]
        noise, fixes = sensor.platform_process_noise, sensor.trajectory
        if noise is None or fixes is None:
            continue
        line = best_line(fixes.time_s, fixes.position_m)
        found.append(
            Platform(
                index, noise, sensor.errors.position_noise_m, fixes.time_s, fixes.position_m, line
            )
        )
    return found
