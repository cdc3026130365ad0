"""Where sensors are and how their axes lie, at many times in one pass.

Rows of a sensor's axes are the direction of azimuth zero, of azimuth 90 degrees and of elevation 90
degrees, in the recording's frame (see :mod:`geograph.factors.bearing`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from geograph.constants import EARTH_ROTATION_RAD_S
from geograph.errors import InputError
from geograph.factors.arrival import SensorMotion
from geograph.factors.attitude import body_axes, body_axes_rate, ned_from_body
from geograph.geodesy import enu_axes, enu_axes_rate
from geograph.platforms import best_line

if TYPE_CHECKING:
    from collections.abc import Sequence
    from datetime import datetime
    from pathlib import Path

    from numpy.typing import NDArray

    from geograph.attitude import AttitudeSpline
    from geograph.earth import CelestialAxes, Stars
    from geograph.platforms import StraightLine
    from geograph.recording import Frame
    from geograph.sensors import Sensor, Trajectory

# East, north, up to north, east, up.
_NORTH_EAST_UP = np.array([1, 0, 2])


def frame_spin_rad_s(frame: Frame) -> float:
    """Return the angular speed of a frame about its z axis, radians per second."""
    return EARTH_ROTATION_RAD_S if frame == "ecef" else 0.0


@dataclass(frozen=True, eq=False)
class SensorPoses:
    """Poses of sensors at n times, in the frame.

    Attributes
    ----------
    position_m, velocity_m_s
        Shape (n, 3).
    axes
        Shape (n, 3, 3).
    axes_rate
        Shape (n, 3, 3), 1/s; None where no axes turn.
    """

    position_m: NDArray[np.float64]
    velocity_m_s: NDArray[np.float64]
    axes: NDArray[np.float64]
    axes_rate: NDArray[np.float64] | None


@dataclass(frozen=True, eq=False)
class SensorPieces:
    """All sensors' ways as pieces of cubics; one that stands still has one piece.

    Attributes
    ----------
    first
        Shape (S + 1,): the pieces of sensor s are number first[s] to first[s + 1] - 1.
    edges_s
        Shape (p,): when each piece begins; its powers are of the time since.
    parts
        Shape (p, 4, 3): coefficients of the third power to the zeroth, SI.
    """

    first: NDArray[np.int64]
    edges_s: NDArray[np.float64]
    parts: NDArray[np.float64]


class SensorGeometry:
    """The sensors of one recording, ready to be asked for their poses.

    Parameters
    ----------
    sensors
        In the order of their indices.
    frame
        The recording's frame.
    epoch, path
        Instant of time zero, which axes ``radec`` need, and the recording's place for messages.

    Raises
    ------
    InputError
        If a sensor has axes ``radec`` and there is no epoch, or the frame is local.
    """

    def __init__(
        self,
        sensors: Sequence[Sensor],
        frame: Frame,
        *,
        epoch: datetime | None = None,
        path: Path | None = None,
    ) -> None:
        self.sensors = sensors
        self.frame: Frame = frame
        self.against_stars = np.array([sensor.axes == "radec" for sensor in sensors], dtype=bool)
        self.celestial = self._celestial(epoch, path)
        count = len(sensors)
        self._position = np.zeros((count, 3))
        self._axes = np.zeros((count, 3, 3))
        self._moving = np.zeros(count, dtype=bool)
        # A platform whose path is estimated is counted from the line that its fixes fit best.
        self._movers: dict[int, Trajectory | StraightLine] = {}
        self._attitudes: dict[int, AttitudeSpline] = {}
        for index, sensor in enumerate(sensors):
            self._axes[index] = np.eye(3)
            if sensor.trajectory is not None:
                self._moving[index] = True
                fixes = sensor.trajectory
                if sensor.axes == "body":
                    assert fixes.attitude is not None
                    self._attitudes[index] = fixes.attitude
                self._movers[index] = (
                    fixes
                    if sensor.platform_process_noise is None
                    else best_line(fixes.time_s, fixes.position_m)
                )
                continue
            assert sensor.position_m is not None
            self._position[index] = sensor.position_m
            if sensor.axes in ("enu", "body"):
                self._axes[index] = self._enu(sensor.position_m)
            if sensor.axes == "body":
                assert sensor.attitude_rad is not None
                rotation = ned_from_body(sensor.attitude_rad)
                self._axes[index] = body_axes(rotation, self._axes[index])

    def _celestial(self, epoch: datetime | None, path: Path | None) -> CelestialAxes | None:
        if not self.against_stars.any():
            return None
        name = self.sensors[int(np.argmax(self.against_stars))].name
        if self.frame != "ecef" or epoch is None:
            what = "no epoch" if self.frame == "ecef" else f"frame {self.frame}"
            raise InputError(
                f"sensor {name!r} has axes radec and the recording has {what}; expected frame "
                "ecef and an epoch, without which the sky has no place",
                path=path,
            )
        from geograph.earth import CelestialAxes

        return CelestialAxes(epoch, path)

    def _enu(self, position_m: NDArray[np.float64]) -> NDArray[np.float64]:
        if self.frame == "local":
            return np.broadcast_to(np.eye(3), (*position_m.shape[:-1], 3, 3))[
                ..., _NORTH_EAST_UP, :
            ]
        return enu_axes(position_m)[..., _NORTH_EAST_UP, :]

    def poses(self, sensor: NDArray[np.int64], time_s: NDArray[np.float64]) -> SensorPoses:
        """Return the poses of sensors (indices, shape (n,)) at times (shape (n,), seconds)."""
        position = self._position[sensor]
        axes = self._axes[sensor]
        velocity = np.zeros_like(position)
        rate: NDArray[np.float64] | None = None
        moving = np.unique(sensor[self._moving[sensor]]) if self._movers else ()
        for index in moving:
            rows = np.flatnonzero(sensor == index)
            mover, sensor_axes = self._movers[int(index)], self.sensors[int(index)].axes
            position[rows] = mover.position_at(time_s[rows])
            velocity[rows] = mover.velocity_at(time_s[rows])
            if sensor_axes in ("xyz", "radec"):
                continue
            axes[rows] = self._enu(position[rows])
            turning = None
            if self.frame == "ecef":
                turning = enu_axes_rate(position[rows], velocity[rows])[:, _NORTH_EAST_UP]
            attitude = self._attitudes.get(int(index))
            if attitude is not None:
                rotation, spin = attitude.at(time_s[rows])
                turning = body_axes_rate(rotation, spin, axes[rows], turning)
                axes[rows] = body_axes(rotation, axes[rows])
            if turning is not None:
                rate = np.zeros_like(axes) if rate is None else rate
                rate[rows] = turning
        rows = np.flatnonzero(self.against_stars[sensor])
        if rows.size:
            assert self.celestial is not None
            rate = np.zeros_like(axes) if rate is None else rate
            axes[rows], rate[rows] = self.celestial.at(time_s[rows])
        return SensorPoses(position, velocity, axes, rate)

    @cached_property
    def at_rest(self) -> SensorPoses | None:
        """Poses of all sensors in their order, if none moves or turns; otherwise None."""
        if self._movers or self.against_stars.any():
            return None
        every = np.arange(len(self.sensors))
        return self.poses(every, np.zeros(every.size))

    def stars(
        self, sensor: NDArray[np.int64], time_s: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], Stars] | None:
        """Return which rows are measured against the stars, and what these need; None: none.

        Parameters
        ----------
        sensor, time_s
            Shape (n,): indices, and times in seconds.

        Raises
        ------
        InputError
            If astropy is missing, or the Earth's orientation at a time is not known.
        """
        rows = np.flatnonzero(self.against_stars[sensor])
        if not rows.size:
            return None
        assert self.celestial is not None
        self.celestial.cover(time_s[rows])
        return rows, self.celestial.stars(time_s[rows])

    def motion(self, sensor: NDArray[np.int64], time_s: NDArray[np.float64]) -> SensorMotion:
        """Return how sensors (indices, shape (n,)) move at times (shape (n,), seconds)."""
        position = self._position[sensor]
        velocity, acceleration = np.zeros_like(position), np.zeros_like(position)
        for index, mover in self._movers.items():
            rows = np.flatnonzero(sensor == index)
            if rows.size:
                found = mover.motion_at(time_s[rows])
                position[rows], velocity[rows], acceleration[rows] = found
        return SensorMotion(position, velocity, acceleration)

    def places(self, sensor: NDArray[np.int64], time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where sensors (indices, shape (n,)) are at times (shape (n,)), shape (n, 3)."""
        position = self._position[sensor]
        for index, mover in self._movers.items():
            rows = np.flatnonzero(sensor == index)
            if rows.size:
                position[rows] = mover.position_at(time_s[rows])
        return position

    @cached_property
    def pieces(self) -> SensorPieces:
        """The ways of all sensors, as compiled code reads them."""
        edges, parts = [], []
        for index in range(len(self.sensors)):
            mover = self._movers.get(index)
            if mover is None:
                still = np.zeros((1, 4, 3))
                still[0, 3] = self._position[index]
                own = np.zeros(1), still
            else:
                own = mover.pieces()
            edges.append(own[0])
            parts.append(own[1])
        first = np.cumsum([0, *(part.size for part in edges)])
        # Without a sensor there is nothing to join.
        return SensorPieces(
            first.astype(np.int64),
            np.concatenate([np.empty(0), *edges]),
            np.ascontiguousarray(np.concatenate([np.empty((0, 4, 3)), *parts])),
        )

    def moves(self, sensor: NDArray[np.int64]) -> bool:
        """Tell whether any of some sensors moves."""
        return bool(self._moving[sensor].any())
