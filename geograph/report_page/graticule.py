"""Lines of latitude and longitude on the ellipsoid around some positions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.geodesy import ecef_from_geodetic, geodetic_from_ecef

if TYPE_CHECKING:
    from numpy.typing import NDArray

_STEPS_DEG = (30.0, 15.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
_FEWEST, _POINTS, _SEEN = 4, 41, 0.2
_SMALLEST_DEG, _LEAST_COSINE = 0.002, 0.05


def graticule(position_m: NDArray[np.float64]) -> list[tuple[str, NDArray[np.float64]]]:
    """Return lines of latitude and longitude at height zero, with their names.

    Parameters
    ----------
    position_m
        Shape (n, 3), metres, ECEF: what the lines are to be around.

    Returns
    -------
    list
        Names such as ``52°N`` and ``2.5°W``, and points of shape (m, 3), metres, ECEF.
    """
    latitude, longitude, _ = geodetic_from_ecef(position_m).T
    middle = longitude[longitude.size // 2]
    # About the middle of the path, so that the 180th meridian is a line as all others.
    east = (longitude - middle + 180.0) % 360.0 - 180.0 + middle
    # As wide as high on the ground, as a map is.
    squeeze = max(float(np.cos(np.radians(latitude).mean())), _LEAST_COSINE)
    size = max(float(np.ptp(latitude)), float(np.ptp(east)) * squeeze, _SMALLEST_DEG)
    half = (0.5 + _SEEN) * size
    centre = 0.5 * (latitude.min() + latitude.max()), 0.5 * (east.min() + east.max())
    south, north = max(centre[0] - half, -90.0), min(centre[0] + half, 90.0)
    reach = min(half / squeeze, 180.0)
    west, far_east = centre[1] - reach, centre[1] + reach
    lines = []
    for value in _multiples(south, north):
        along = np.linspace(west, far_east, _POINTS)
        lines.append((_name(value, "NS"), _line(np.full(_POINTS, value), along)))
    for value in _multiples(west, far_east):
        along = np.linspace(south, north, _POINTS)
        turned = (value + 180.0) % 360.0 - 180.0
        lines.append((_name(turned, "EW"), _line(along, np.full(_POINTS, value))))
    return lines


def _multiples(low: float, high: float) -> list[float]:
    """Return round degrees from low to high: a step that gives four or more."""
    step = next((s for s in _STEPS_DEG if (high - low) / s >= _FEWEST), _STEPS_DEG[-1])
    first, last = int(np.ceil(low / step)), int(np.floor(high / step))
    return [round(index * step, 6) for index in range(first, last + 1)]


def _name(value: float, signs: str) -> str:
    sign = "" if abs(value) in (0.0, 180.0) else signs[0] if value > 0.0 else signs[1]
    return f"{abs(value):.6g}°{sign}"


def _line(
    latitude_deg: NDArray[np.float64], longitude_deg: NDArray[np.float64]
) -> NDArray[np.float64]:
    return np.asarray(ecef_from_geodetic(latitude_deg, longitude_deg, np.zeros(latitude_deg.size)))
