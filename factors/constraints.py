"""Constraints on the object itself: height, coordinate and speed, with their gradients."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.factors.kinematics import unit_vectors
from geograph.geodesy import enu_axes, geodetic_from_ecef

if TYPE_CHECKING:
    from numpy.typing import NDArray


def altitude(
    position_m: NDArray[np.float64], frame: Literal["ecef", "local"]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return heights, shape (n,), metres, and their gradients by position, shape (n, 3).

    The height above the ellipsoid grows along its outward normal at unit rate, exactly; in a local
    frame the height is z.

    Parameters
    ----------
    position_m
        Shape (n, 3), in the frame.
    frame
        ``"ecef"`` or ``"local"``.
    """
    if frame == "local":
        return coordinate(position_m, 2)
    return geodetic_from_ecef(position_m)[:, 2], enu_axes(position_m)[:, 2]


def coordinate(
    position_m: NDArray[np.float64], axis: Literal[0, 1, 2]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return one coordinate, shape (n,), metres, and its gradients by position, shape (n, 3).

    Parameters
    ----------
    position_m
        Shape (n, 3), in the frame.
    axis
        Which: x, y or z of the frame.
    """
    gradient = np.zeros_like(position_m)
    gradient[:, axis] = 1.0
    return position_m[:, axis], gradient


def speed(
    velocity_m_s: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return speeds, shape (n,), and their gradients by velocity, shape (n, 3).

    The gradient of an object at rest is taken as zero.

    Parameters
    ----------
    velocity_m_s
        Shape (n, 3), metres per second, in the frame.
    """
    return np.linalg.norm(velocity_m_s, axis=1), unit_vectors(velocity_m_s)
