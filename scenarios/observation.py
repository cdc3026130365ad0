"""What sensors see: light time and directions, from geometry alone.

Everything happens in inertial axes: the sensor is put where it is at reception, the object where it
was at emission, each by the turn of the Earth at its own time; the light time is the one at which
the distance between the two is travelled; and the line of sight is turned back by the Earth's angle
at reception.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.constants import EARTH_ROTATION_RAD_S, SPEED_OF_LIGHT_M_S
from geograph.scenarios.orbits import turned_about_z

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from pyproj import Transformer

    from geograph.recording import Frame
    from geograph.scenarios.paths import Body

SeenAxes = Literal["enu", "xyz"]
_MOST_ITERATIONS = 500


@dataclass(frozen=True, eq=False)
class Observed:
    """Error-free observations.

    Parameters
    ----------
    azimuth_rad, elevation_rad
        Shape (n,), in the axes of each sensor.
    emission_time_s
        Shape (n,), seconds: when what was received left the object.
    range_m
        Shape (n,), metres: what it travelled.
    """

    azimuth_rad: NDArray[np.float64]
    elevation_rad: NDArray[np.float64]
    emission_time_s: NDArray[np.float64]
    range_m: NDArray[np.float64]


def light_time(
    path: Body,
    sensor_m: NDArray[np.float64],
    time_s: NDArray[np.float64],
    *,
    propagation_speed_m_s: float = SPEED_OF_LIGHT_M_S,
    rotation_rad_s: float = EARTH_ROTATION_RAD_S,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Solve the light-time equation and return delays and lines of sight.

    Parameters
    ----------
    path
        The object, in axes that turn about z at ``rotation_rad_s``.
    sensor_m
        Shape (n, 3): the sensors at reception, in the same axes.
    time_s
        Shape (n,): times of reception, seconds.
    propagation_speed_m_s
        Speed of the signal, metres per second; ``inf``: seen where it is.
    rotation_rad_s
        Rate at which the axes turn, rad/s; 0 in a local frame.

    Returns
    -------
    delay_s
        Shape (n,): reception minus emission, seconds.
    line_of_sight_m
        Shape (n, 3): from sensor to object, in the axes of the frame at reception.

    Raises
    ------
    RuntimeError
        If the delay does not settle (an object as fast as its signal).
    """
    sensor_inertial = turned_about_z(sensor_m, rotation_rad_s * time_s)

    def sight(delay: NDArray[np.float64]) -> NDArray[np.float64]:
        emission = time_s - delay
        return turned_about_z(path.position_at(emission), rotation_rad_s * emission) - (
            sensor_inertial
        )

    delay = np.zeros_like(time_s)
    change = np.inf
    for _ in range(_MOST_ITERATIONS):
        following = np.linalg.norm(sight(delay), axis=-1) / propagation_speed_m_s
        before, change = change, float(np.max(np.abs(following - delay), initial=0.0))
        delay = following
        # A contraction, down to where rounding stops it.
        if change <= 1e-15 or (change < 1e-11 and change >= before):
            break
    else:
        raise RuntimeError(f"light times do not settle (last change {change:.3g} s)")
    return delay, turned_about_z(sight(delay), -rotation_rad_s * time_s)


@lru_cache(maxsize=256)
def _topocentric(x: float, y: float, z: float) -> Transformer:
    from pyproj import Transformer

    return Transformer.from_pipeline(
        f"+proj=topocentric +ellps=WGS84 +X_0={x!r} +Y_0={y!r} +Z_0={z!r}"
    )


def east_north_up(
    sensor_ecef_m: NDArray[np.float64], line_of_sight_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return lines of sight, shape (n, 3), in the topocentric axes of PROJ.

    Parameters
    ----------
    sensor_ecef_m, line_of_sight_m
        Shape (n, 3), metres, ECEF axes.
    """
    result = np.empty_like(line_of_sight_m)
    places, which = np.unique(sensor_ecef_m, axis=0, return_inverse=True)
    for index, place in enumerate(places):
        rows = which.ravel() == index
        x, y, z = (place + line_of_sight_m[rows]).T
        pipeline = _topocentric(*(float(value) for value in place))
        result[rows] = np.stack(pipeline.transform(x, y, z), axis=-1)
    return result


def ecef_from_east_north_up(
    place_ecef_m: NDArray[np.float64], vector: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return a vector of east, north and up at a place, shape (3,), in ECEF axes."""
    pipeline = _topocentric(*(float(value) for value in place_ecef_m))
    # PROJ moves points: over a long way, so that little is lost in the difference.
    scale = 1e6
    point = np.array(pipeline.transform(*(scale * vector), direction="INVERSE"))
    result: NDArray[np.float64] = (point - place_ecef_m) / scale
    return result


def angles_from_direction(
    direction: NDArray[np.float64], *, axes: SeenAxes
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return azimuth and elevation in radians of directions, shape (..., 3), of any length.

    Parameters
    ----------
    direction
        East, north and up for ``"enu"`` (azimuth from north to east, 0 to 2 pi), x, y and z for
        ``"xyz"`` (azimuth from x to y, -pi to pi).
    axes
        Which of the two.
    """
    first, second, third = np.moveaxis(direction, -1, 0)
    elevation = np.arctan2(third, np.hypot(first, second))
    if axes == "enu":
        return np.mod(np.arctan2(first, second), 2.0 * np.pi), elevation
    return np.arctan2(second, first), elevation


def direction_from_angles(
    azimuth_rad: NDArray[np.float64], elevation_rad: NDArray[np.float64], *, axes: SeenAxes
) -> NDArray[np.float64]:
    """Return unit vectors, shape (..., 3); the inverse of :func:`angles_from_direction`."""
    level = np.cos(elevation_rad)
    along, aside = level * np.cos(azimuth_rad), level * np.sin(azimuth_rad)
    pair = (aside, along) if axes == "enu" else (along, aside)
    return np.stack([*pair, np.sin(elevation_rad)], axis=-1)


def observe_bearings(
    path: Body,
    sensors: Sequence[Body],
    time_s: NDArray[np.float64],
    sensor: NDArray[np.int64],
    *,
    axes: Sequence[SeenAxes],
    frame: Frame = "ecef",
    propagation_speed_m_s: float = SPEED_OF_LIGHT_M_S,
) -> Observed:
    """Return what error-free sensors see of an object.

    Parameters
    ----------
    path
        The object.
    sensors
        The sensors, in the same frame.
    time_s
        Shape (n,): true times of reception, seconds.
    sensor
        Shape (n,), integer: which sensor receives.
    axes
        Axes of each sensor: ``"enu"`` or ``"xyz"``. In a local frame, east, north and up are x, y
        and z.
    frame
        ``"ecef"``, which turns, or ``"local"``, which does not.
    propagation_speed_m_s
        Speed of the signal, metres per second; ``inf``: seen where it is.
    """
    turning = EARTH_ROTATION_RAD_S if frame == "ecef" else 0.0
    azimuth, elevation, emission, distance = np.empty((4, time_s.size))
    for index, (body, kind) in enumerate(zip(sensors, axes, strict=True)):
        rows = sensor == index
        place = np.asarray(body.position_at(time_s[rows]))
        delay, sight = light_time(
            path,
            place,
            time_s[rows],
            propagation_speed_m_s=propagation_speed_m_s,
            rotation_rad_s=turning,
        )
        emission[rows] = time_s[rows] - delay
        distance[rows] = np.linalg.norm(sight, axis=-1)
        if kind == "enu" and frame == "ecef":
            sight = east_north_up(place, sight)
        azimuth[rows], elevation[rows] = angles_from_direction(sight, axes=kind)
    return Observed(azimuth, elevation, emission, distance)
