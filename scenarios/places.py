"""Where simulated sensors stand or fly so that they see the object throughout a pass."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from geograph.constants import EARTH_RADIUS_M
from geograph.scenarios.observation import observe_bearings
from geograph.scenarios.orbits import CircularOrbit, EarthFixedBody
from geograph.scenarios.paths import StraightBody

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray
    from pyproj import Geod, Transformer

    from geograph.scenarios.observation import SeenAxes
    from geograph.scenarios.paths import Body

_MOST_DRAWS = 20_000
_CHECKS = 41
_GRAZING_HEIGHT_M = 100e3
_HIGHEST_ELEVATION_RAD = np.radians(85.0)
_LOWEST_ELEVATION_RAD = np.radians(10.0)
_SHORTEST_RANGE_M = 100e3


@cache
def _cartesian() -> Transformer:
    from pyproj import Transformer

    return Transformer.from_pipeline("+proj=cart +ellps=WGS84")


@cache
def _ellipsoid() -> Geod:
    from pyproj import Geod

    return Geod(ellps="WGS84")


def ecef(latitude_deg: float, longitude_deg: float, height_m: float) -> NDArray[np.float64]:
    """Return the ECEF position, shape (3,), metres, of a geodetic place on WGS 84."""
    place = _cartesian().transform(longitude_deg, latitude_deg, height_m, radians=False)
    return np.array(place, dtype=np.float64)


def geodetic(position_ecef_m: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return latitude (deg), longitude (deg) and height (m) of an ECEF position, shape (3,)."""
    longitude, latitude, height = _cartesian().transform(
        *position_ecef_m, direction="INVERSE", radians=False
    )
    return float(latitude), float(longitude), float(height)


def displaced(
    latitude_deg: float, longitude_deg: float, *, azimuth_deg: float, distance_m: float
) -> tuple[float, float]:
    """Return latitude and longitude (deg) at a distance along a geodesic of WGS 84."""
    longitude, latitude, _ = _ellipsoid().fwd(longitude_deg, latitude_deg, azimuth_deg, distance_m)
    return float(latitude), float(longitude)


def random_axes(rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw two unit vectors at right angles, shape (2, 3), uniform over all orientations."""
    first, other = rng.standard_normal((2, 3))
    first /= np.linalg.norm(first)
    second = other - (other @ first) * first
    return np.stack([first, second / np.linalg.norm(second)])


def random_satellite(rng: np.random.Generator) -> Body:
    """Draw a circular orbit 500 to 2000 km high in any plane, as the turning Earth sees it."""
    first, second = random_axes(rng)
    radius = EARTH_RADIUS_M + rng.uniform(500e3, 2000e3)
    return EarthFixedBody(CircularOrbit(radius, first, second, rng.uniform(0.0, 2.0 * np.pi)))


def random_ground_station(
    rng: np.random.Generator, path: Body, duration_s: float, *, farthest_m: float
) -> Body:
    """Draw a place on the ground within a distance of a random point of the ground track."""
    below = geodetic(path.position_at(rng.uniform(0.0, duration_s)))
    latitude, longitude = displaced(
        below[0],
        below[1],
        azimuth_deg=rng.uniform(0.0, 360.0),
        distance_m=farthest_m * np.sqrt(rng.uniform()),
    )
    return StraightBody(ecef(latitude, longitude, rng.uniform(0.0, 3000.0)))


def clearance_m(first_m: NDArray[np.float64], second_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far straight lines between positions, shape (..., 3), pass from the origin."""
    line = second_m - first_m
    nearest = -np.sum(first_m * line, axis=-1) / np.sum(line**2, axis=-1)
    point = first_m + np.clip(nearest, 0.0, 1.0)[..., None] * line
    return np.asarray(np.linalg.norm(point, axis=-1))


def sees(path: Body, sensor: Body, duration_s: float, *, axes: SeenAxes) -> bool:
    """Say whether a sensor sees the object from time 0 to the duration.

    A satellite (axes ``"xyz"``) looks past the Earth and 100 km of atmosphere, from 100 km off or
    farther; the ground (``"enu"``) sees what is 10 degrees or more above its horizon. No line of
    sight is within 5 degrees of the pole of the sensor's axes, where azimuth means nothing.
    """
    time = np.linspace(0.0, duration_s, _CHECKS)
    place = np.asarray(sensor.position_at(time))
    target = path.position_at(time)
    if np.linalg.norm(target - place, axis=-1).min() < _SHORTEST_RANGE_M:
        return False
    if axes == "xyz" and clearance_m(place, target).min() < EARTH_RADIUS_M + _GRAZING_HEIGHT_M:
        return False
    seen = observe_bearings(path, [sensor], time, np.zeros(_CHECKS, dtype=np.int64), axes=[axes])
    if np.abs(seen.elevation_rad).max() > _HIGHEST_ELEVATION_RAD:
        return False
    return axes == "xyz" or bool(seen.elevation_rad.min() >= _LOWEST_ELEVATION_RAD)


def draw_seeing(draw: Callable[[], Body], path: Body, duration_s: float, *, axes: SeenAxes) -> Body:
    """Draw sensors until one sees the object throughout.

    Raises
    ------
    RuntimeError
        If none of a great many does.
    """
    for _ in range(_MOST_DRAWS):
        sensor = draw()
        if sees(path, sensor, duration_s, axes=axes):
            return sensor
    raise RuntimeError(f"none of {_MOST_DRAWS} sensors sees the object for {duration_s} s")
