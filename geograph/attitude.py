"""Attitudes of moving sensors: interpolated between samples, and questioned where implausible."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError
from geograph.factors.attitude import ned_from_body
from geograph.geodesy import enu_axes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.recording import Frame
    from geograph.sensors import Sensor, Trajectory

# No aircraft turns faster for long, and none at all as fast as the second. Beyond the third, from
# one sample to the next, it is not known which way round it turned.
_LONG_RAD_S = np.radians(60.0)
_EVER_RAD_S = np.radians(1000.0)
_STEP_RAD = np.radians(100.0)

# Yaw in the other unit is suspected where it follows the course over ground this closely for most
# samples, and as given for few.
_FOLLOWS_RAD = np.radians(15.0)
_MOST, _FEW = 0.8, 0.2
_UNDER_WAY_M_S = 3.0

OVERRIDE = "unusual_attitude"
"""Key of a sensor whose attitude is used as it is, however unusual."""


class AttitudeSpline:
    """Attitude of a sensor over time: a cubic spline on the rotation group.

    Rotation vectors between samples are cubic in time, with angular rates and accelerations that
    are continuous (scipy's ``RotationSpline``; N. Mayorov); yaw, pitch and roll themselves, which
    wrap and are singular at a pitch of 90 degrees, are never interpolated.

    Parameters
    ----------
    time_s
        Shape (n,), strictly increasing.
    attitude_rad
        Shape (n, 3): yaw, pitch, roll.
    """

    def __init__(self, time_s: NDArray[np.float64], attitude_rad: NDArray[np.float64]) -> None:
        from scipy.spatial.transform import Rotation, RotationSpline

        self._spline = RotationSpline(time_s, Rotation.from_matrix(ned_from_body(attitude_rad)))

    def at(self, time_s: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return rotations from body to north, east, down and body rates at times, shape (n,).

        Returns
        -------
        rotation, rate_rad_s
            Shapes (n, 3, 3) and (n, 3), the rate in body axes.
        """
        if not time_s.size:
            return np.empty((0, 3, 3)), np.empty((0, 3))
        return np.asarray(self._spline(time_s).as_matrix()), np.asarray(self._spline(time_s, 1))


def check_attitude(sensor: Sensor, frame: Frame) -> None:
    """Raise InputError, its ``line`` the row, if the attitudes of a sensor are implausible.

    Parameters
    ----------
    sensor
        Attitudes that its bearings do not use, or that it declares unusual, are not looked at.
    frame
        The recording's frame.
    """
    trajectory = sensor.trajectory
    if trajectory is None or sensor.axes != "body" or sensor.unusual_attitude:
        return
    found = attitude_question(trajectory, frame)
    if found is not None:
        row, text = found
        raise InputError(
            f"of sensor {sensor.name!r}: {text} (t = {trajectory.time_s[row]:.6g} s); are degrees "
            f"and radians mixed up? mend the column's unit, or set {OVERRIDE} = true for the "
            "sensor to use it as it is",
            line=row,
            column="yaw",
        )


# A map of the bound asks for every cell.
@lru_cache(maxsize=64)
def attitude_question(trajectory: Trajectory, frame: Frame) -> tuple[int, str] | None:
    """Return what is implausible in the attitudes of a trajectory, with the sample; None: nothing.

    Parameters
    ----------
    trajectory
        With attitudes.
    frame
        The recording's frame.
    """
    attitude = trajectory.attitude_rad
    assert attitude is not None
    velocity = trajectory.velocity_at(trajectory.time_s)
    if frame == "ecef":
        axes = enu_axes(trajectory.position_m)
        velocity = np.matmul(axes, velocity[:, :, None])[:, :, 0]
    course_rad = np.arctan2(velocity[:, 0], velocity[:, 1])
    speed_m_s = np.hypot(velocity[:, 0], velocity[:, 1])
    under_way = speed_m_s > _UNDER_WAY_M_S
    if under_way.any():
        yaw, course = attitude[under_way, 0], course_rad[under_way]
        given = _following(yaw, course)
        for other, factor in (("radians", 180.0 / np.pi), ("degrees", np.pi / 180.0)):
            if given < _FEW and _following(yaw * factor, course) > _MOST:
                return int(np.argmax(under_way)), (
                    f"yaw follows the course over ground as {other} and not as the unit of its "
                    "column"
                )
    rotation = ned_from_body(attitude)
    turn = _angles(np.swapaxes(rotation[:-1], 1, 2) @ rotation[1:])
    rate = turn / np.diff(trajectory.time_s)
    worst = int(np.argmax(rate))
    if rate[worst] > _EVER_RAD_S or float(np.median(rate)) > _LONG_RAD_S:
        return worst + 1, (
            f"the attitude turns at {np.degrees(np.median(rate)):.4g} deg/s all the time, and at "
            f"{np.degrees(rate[worst]):.4g} deg/s here"
        )
    widest = int(np.argmax(turn))
    if turn[widest] > _STEP_RAD:
        return widest + 1, (
            f"the attitude turns by {np.degrees(turn[widest]):.4g} deg from one row to the next, "
            "too far to tell which way"
        )
    return None


def _following(yaw_rad: NDArray[np.float64], course_rad: NDArray[np.float64]) -> float:
    """Return the share of samples whose yaw is about the course."""
    off = np.abs(np.mod(yaw_rad - course_rad + np.pi, 2.0 * np.pi) - np.pi)
    return float(np.mean(off < _FOLLOWS_RAD))


def _angles(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angles that rotations turn by, shape (n,), radians."""
    cosine = 0.5 * (np.trace(rotation, axis1=1, axis2=2) - 1.0)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))
