"""Attitude: from yaw, pitch and roll to a sensor's axes, and what a misalignment does to them.

**Body axes** are x forward, y right, z down. Yaw, pitch and roll turn north, east, down into them
in this order: yaw about down, pitch about the new y, roll about the new x (the aerospace sequence
3-2-1; B. L. Stevens, F. L. Lewis, *Aircraft Control and Simulation*, 1992, section 1.3),

    R = Rz(yaw) Ry(pitch) Rx(roll),    v(north, east, down) = R v(body).

A bearing's rows are azimuth zero (x), azimuth 90 degrees (y) and elevation 90 degrees (-z, "above"
the body's xy plane): with D = diag(1, 1, -1) and the rows north, east, up N of the place,

    axes = D R' D N.

Turning into a matrix is regular everywhere; a pitch of 90 degrees is a place like any other.

**Misalignment.** The true body axes are the recorded ones turned by a small rotation vector m about
their own x, y and z: a direction v in recorded body axes is Exp(-m) v in the true ones. The sign is
*true - recorded*: a sensor that looks further to the right than recorded has m about z above zero,
and reads azimuths that are too small.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

# Body z is down, and elevation grows upwards.
_UPWARD = np.array([1.0, 1.0, -1.0])

# Below this angle the closed forms of the exponential cancel; series are exact to 1e-16.
_SMALL_RAD = 1e-2


def ned_from_body(attitude_rad: ArrayLike) -> NDArray[np.float64]:
    """Return R, shape (..., 3, 3): its columns are the body axes in north, east, down.

    Parameters
    ----------
    attitude_rad
        Shape (..., 3): yaw (clockwise from north), pitch (nose up), roll (right wing down).
    """
    angles = np.asarray(attitude_rad, dtype=np.float64)
    (sy, sp, sr), (cy, cp, cr) = (
        np.moveaxis(part, -1, 0) for part in (np.sin(angles), np.cos(angles))
    )
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def body_axes(
    rotation: NDArray[np.float64], north_east_up: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the rows of body axes in the frame, shape (..., 3, 3); see the module.

    Parameters
    ----------
    rotation
        Shape (..., 3, 3): R of :func:`ned_from_body`.
    north_east_up
        Shape (..., 3, 3): rows north, east and up of the sensor's place, in the frame.
    """
    flipped = _UPWARD[:, None] * np.swapaxes(rotation, -1, -2) * _UPWARD
    return np.asarray(flipped @ north_east_up)


def body_axes_rate(
    rotation: NDArray[np.float64],
    turning_rad_s: NDArray[np.float64],
    north_east_up: NDArray[np.float64],
    north_east_up_rate: NDArray[np.float64] | None,
) -> NDArray[np.float64]:
    """Return the time derivative of :func:`body_axes`, shape (n, 3, 3), 1/s.

    With the body's angular rate w against north, east, down, in body axes, dR/dt = R [w]x.

    Parameters
    ----------
    rotation, north_east_up
        Shape (n, 3, 3), as of :func:`body_axes`.
    turning_rad_s
        Shape (n, 3): w, radians per second.
    north_east_up_rate
        Shape (n, 3, 3): derivative of those rows; None: they do not turn.
    """
    transposed = np.swapaxes(rotation, -1, -2)
    flipped = _UPWARD[:, None] * (-cross_matrix(turning_rad_s) @ transposed) * _UPWARD
    rate = np.asarray(flipped @ north_east_up)
    return rate if north_east_up_rate is None else rate + body_axes(rotation, north_east_up_rate)


def cross_matrix(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return [v]x, shape (n, 3, 3), with [v]x w = v x w, of vectors of shape (n, 3)."""
    x, y, z = vector[:, 0], vector[:, 1], vector[:, 2]
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


@dataclass(frozen=True, eq=False)
class Turned:
    """Lines of sight in the true axes of misaligned sensors.

    Attributes
    ----------
    line_of_sight_m
        Shape (n, 3).
    by_line_of_sight
        Shape (n, 3, 3): by the line of sight in recorded axes.
    by_misalignment
        Shape (n, 3, 3): by the rotation vector m, metres per radian; None if not asked for.
    """

    line_of_sight_m: NDArray[np.float64]
    by_line_of_sight: NDArray[np.float64]
    by_misalignment: NDArray[np.float64] | None


def misaligned(
    line_of_sight_m: NDArray[np.float64],
    misalignment_rad: NDArray[np.float64],
    *,
    jacobian: bool = False,
) -> Turned:
    """Return lines of sight in the true axes; see the module.

    The derivative is Exp(-m) [v]x J(m), J being the left Jacobian of the rotation group (T. D.
    Barfoot, *State Estimation for Robotics*, 2017, section 7.1.5).

    Parameters
    ----------
    line_of_sight_m
        Shape (n, 3): along a bearing's rows (forward, right, up), by the recorded attitude.
    misalignment_rad
        Shape (n, 3): m about body x, y and z.
    jacobian
        Whether the derivative by m is returned too.
    """
    cross = cross_matrix(misalignment_rad)
    square = cross @ cross
    angle2 = np.sum(misalignment_rad**2, axis=1)
    sine, versine, rest = _exponential_series(angle2)
    inverse = np.eye(3) - sine[:, None, None] * cross + versine[:, None, None] * square
    turn = _UPWARD[:, None] * inverse * _UPWARD
    value = np.matmul(turn, line_of_sight_m[:, :, None])[:, :, 0]
    if not jacobian:
        return Turned(value, turn, None)
    left = np.eye(3) + versine[:, None, None] * cross + rest[:, None, None] * square
    by_angles = inverse @ cross_matrix(line_of_sight_m * _UPWARD) @ left
    return Turned(value, turn, _UPWARD[:, None] * by_angles)


def _exponential_series(
    angle2: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return sin(a)/a, (1 - cos(a))/a^2 and (a - sin(a))/a^3 of squared angles, each (n,)."""
    sine = 1.0 - angle2 / 6.0 + angle2**2 / 120.0 - angle2**3 / 5040.0
    versine = 0.5 - angle2 / 24.0 + angle2**2 / 720.0 - angle2**3 / 40320.0
    rest = 1.0 / 6.0 - angle2 / 120.0 + angle2**2 / 5040.0 - angle2**3 / 362880.0
    large = angle2 > _SMALL_RAD**2
    if large.any():
        angle = np.sqrt(angle2[large])
        sine[large] = np.sin(angle) / angle
        versine[large] = 2.0 * (np.sin(0.5 * angle) / angle) ** 2
        rest[large] = (angle - np.sin(angle)) / angle**3
    return sine, versine, rest
