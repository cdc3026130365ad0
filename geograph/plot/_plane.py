"""The plane that a path is drawn on: east and north about its middle, or x and y."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.geodesy import enu_axes, geodetic_from_ecef
from geograph.results.data import turned_covariance
from geograph.units import Unit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.recording import Frame
    from geograph.results import Results


@dataclass(frozen=True, eq=False)
class Plane:
    """Tangent plane of the ellipsoid at the path's middle, or the level plane of a local frame.

    Parameters
    ----------
    origin_m
        Shape (3,), in the recording's frame.
    axes
        Shape (3, 3): rows are the directions to the right, up the page, and out of it.
    across, along
        Names of the first two directions, without unit.
    """

    origin_m: NDArray[np.float64]
    axes: NDArray[np.float64]
    across: str
    along: str

    def project(self, position_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return coordinates on the plane, shape (..., 2), metres."""
        return np.asarray((position_m - self.origin_m) @ self.axes[:2].T)

    def covariance(self, covariance_m2: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return covariances on the plane, shape (..., 2, 2)."""
        return turned_covariance(self.axes[:2], covariance_m2)


def plane_of(results: Results) -> Plane:
    """Return the plane that suits a path."""
    # The knot nearest to the middle: the mean of a long path would lie below the ground.
    return plane_at(results.position_m[results.time_s.size // 2], results.frame)


def plane_at(middle: NDArray[np.float64], frame: Frame) -> Plane:
    """Return the plane that suits what is around a position, shape (3,), metres."""
    if frame == "local":
        return Plane(np.zeros(3), np.eye(3), "x", "y")
    latitude, longitude, _ = geodetic_from_ecef(middle)
    where = (
        f"{abs(latitude):.4f}° {'N' if latitude >= 0 else 'S'} "
        f"{abs(longitude):.4f}° {'E' if longitude >= 0 else 'W'}"
    )
    return Plane(middle, enu_axes(middle), f"east of {where}", f"north of {where}")


def length_unit(extent_m: float) -> Unit:
    """Return metres for what is smaller than five kilometres, else kilometres."""
    return Unit("m", 1.0) if extent_m < 5000.0 else Unit("km", 1000.0)


def extent(points: NDArray[np.float64]) -> float:
    """Return the greater side of the box around points, shape (n, 2); NaN are left out."""
    points = points[np.isfinite(points).all(axis=-1)]
    return float(np.ptp(points, axis=0).max()) if len(points) else 0.0
