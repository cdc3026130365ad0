"""WGS 84 geodesy: positions between geodetic and Earth-centred Earth-fixed axes, local directions.

Conversions are PROJ's (through pyproj); what they do not give, the directions of east, north and up
and how these turn when a sensor moves, stands here.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from geograph.constants import EARTH_FLATTENING, EARTH_RADIUS_M

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray
    from pyproj import Transformer

_ECCENTRICITY_SQUARED = EARTH_FLATTENING * (2.0 - EARTH_FLATTENING)


@cache
def _transformer(to_ecef: bool) -> Transformer:
    # Imported here: PROJ's start-up would otherwise be paid by recordings in a local frame.
    from pyproj import Transformer

    geodetic, ecef = "EPSG:4979", "EPSG:4978"
    source, target = (geodetic, ecef) if to_ecef else (ecef, geodetic)
    return Transformer.from_crs(source, target, always_xy=True)


def ecef_from_geodetic(
    latitude_deg: ArrayLike, longitude_deg: ArrayLike, height_m: ArrayLike
) -> NDArray[np.float64]:
    """Return the ECEF position, shape (..., 3), metres, of geodetic coordinates on WGS 84.

    Parameters
    ----------
    latitude_deg, longitude_deg
        Geodetic latitude and longitude (east positive) in degrees, shapes that broadcast.
    height_m
        Height above the ellipsoid in metres.
    """
    latitude, longitude, height = np.broadcast_arrays(
        *(np.asarray(v, dtype=np.float64) for v in (latitude_deg, longitude_deg, height_m))
    )
    x, y, z = _transformer(True).transform(longitude, latitude, height)
    return np.stack([np.asarray(x), np.asarray(y), np.asarray(z)], axis=-1)


def geodetic_from_ecef(position_ecef_m: ArrayLike) -> NDArray[np.float64]:
    """Return latitude (deg), longitude (deg) and height (m), shape (..., 3), of ECEF positions.

    Parameters
    ----------
    position_ecef_m
        Shape (..., 3), metres.
    """
    position = np.asarray(position_ecef_m, dtype=np.float64)
    x, y, z = np.moveaxis(position, -1, 0)
    longitude, latitude, height = _transformer(False).transform(x, y, z)
    return np.stack([np.asarray(latitude), np.asarray(longitude), np.asarray(height)], axis=-1)


def enu_axes(position_ecef_m: ArrayLike) -> NDArray[np.float64]:
    """Return the directions of east, north and up as the rows of (..., 3, 3) rotations.

    A vector v in ECEF axes has the components ``enu_axes(p) @ v`` towards east, north and the
    ellipsoid's outward normal at p. At the poles, where east is undefined, the meridian of
    longitude zero is taken.

    Parameters
    ----------
    position_ecef_m
        Shape (..., 3), metres.
    """
    geodetic = np.radians(geodetic_from_ecef(position_ecef_m)[..., :2])
    latitude, longitude = geodetic[..., 0], geodetic[..., 1]
    sin_lat, cos_lat = np.sin(latitude), np.cos(latitude)
    sin_lon, cos_lon = np.sin(longitude), np.cos(longitude)
    zero = np.zeros_like(latitude)
    east = np.stack([-sin_lon, cos_lon, zero], axis=-1)
    north = np.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat], axis=-1)
    up = np.stack([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat], axis=-1)
    return np.stack([east, north, up], axis=-2)


def metres_per_radian(
    latitude_rad: NDArray[np.float64], height_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return metres to the east and to the north for a radian of longitude and of latitude.

    (N + h) cos(latitude) and M + h, with the ellipsoid's radii of curvature N (prime vertical) and
    M (meridian).

    Parameters
    ----------
    latitude_rad, height_m
        Any one shape.
    """
    root = np.sqrt(1.0 - _ECCENTRICITY_SQUARED * np.sin(latitude_rad) ** 2)
    normal = EARTH_RADIUS_M / root
    meridian = normal * (1.0 - _ECCENTRICITY_SQUARED) / root**2
    return (normal + height_m) * np.cos(latitude_rad), meridian + height_m


def enu_axes_rate(position_ecef_m: ArrayLike, velocity_ecef_m_s: ArrayLike) -> NDArray[np.float64]:
    """Return the time derivative of :func:`enu_axes` along a motion, shape (..., 3, 3), 1/s.

    The axes turn with the rates of latitude and longitude; see :func:`metres_per_radian`.

    Parameters
    ----------
    position_ecef_m, velocity_ecef_m_s
        Shape (..., 3), metres and metres per second in ECEF axes.
    """
    position = np.asarray(position_ecef_m, dtype=np.float64)
    velocity = np.asarray(velocity_ecef_m_s, dtype=np.float64)
    axes = enu_axes(position)
    geodetic = geodetic_from_ecef(position)
    sin_lat = axes[..., 2, 2]
    cos_lat = np.hypot(axes[..., 2, 0], axes[..., 2, 1])
    east_m, north_m = metres_per_radian(np.radians(geodetic[..., 0]), geodetic[..., 2])
    east_rate, north_rate, _ = np.moveaxis(np.einsum("...ij,...j->...i", axes, velocity), -1, 0)
    latitude_rate, longitude_rate = north_rate / north_m, east_rate / east_m
    east, north, up = axes[..., 0, :], axes[..., 1, :], axes[..., 2, :]
    spin = longitude_rate[..., None]
    tilt = latitude_rate[..., None]
    sin, cos = sin_lat[..., None], cos_lat[..., None]
    return np.stack(
        [
            spin * (sin * north - cos * up),
            -spin * sin * east - tilt * up,
            spin * cos * east + tilt * north,
        ],
        axis=-2,
    )
