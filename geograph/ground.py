"""Rays and the ground: where they meet, and whether a recording and its terrain fit together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError
from geograph.factors.constraints import altitude
from geograph.geodesy import ecef_from_geodetic, geodetic_from_ecef

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.recording import Frame, Recording
    from geograph.terrain import Terrain

# Rasters are off by this much in steep ground; a sensor deeper than that is not where it is said to
# be, or the raster's heights are above something else.
_DEEPEST_M = 30.0
_MOST_CHECKED = 400

# Hardly any slope is steeper than 45 degrees for long, so that a ray so much above ground does not
# meet it sooner than this.
_STEEPEST = 1.0
_DEEP_M, _HIGH_M = 2000.0, 9000.0
_MOST_STEPS = 4000
_HALVINGS = 30


@dataclass(frozen=True, eq=False)
class Crossings:
    """Where rays meet the ground.

    Attributes
    ----------
    ray
        Shape (c,): index of the ray, growing; several crossings of a ray go outwards.
    position_m
        Shape (c, 3).
    """

    ray: NDArray[np.int64]
    position_m: NDArray[np.float64]


def crossings(
    start_m: NDArray[np.float64],
    direction: NDArray[np.float64],
    terrain: Terrain,
    *,
    height_m: float = 0.0,
) -> Crossings:
    """Return every place where rays meet the ground, or a surface so much above it.

    A ray is followed in steps that no slope could hide ground in, and every change of side is
    halved down to rounding. Places that a ridge in front hides are among them: a signal may bend
    around it, and the measurement alone does not tell.

    Parameters
    ----------
    start_m, direction
        Shapes (n, 3): where rays begin, and unit vectors along them.
    terrain
        The ground.
    height_m
        Height of the surface above it.
    """
    frame = terrain.frame

    def gap(ray: NDArray[np.int64], way: NDArray[np.float64]) -> NDArray[np.float64]:
        position = start_m[ray] + way[:, None] * direction[ray]
        ground, _ = terrain.elevation(position)
        return altitude(position, frame)[0] - ground - height_m

    least = terrain.spacing_m
    corner = terrain.corners_m()
    reach = np.linalg.norm(start_m[:, None] - corner, axis=2).max(axis=1) + least
    active = np.arange(start_m.shape[0])
    way = np.zeros(active.size)
    side = gap(active, way)
    found: list[tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]] = []
    for _ in range(_MOST_STEPS):
        if not active.size:
            break
        following = way + np.maximum(least, np.abs(side) / (1.0 + _STEEPEST))
        there = gap(active, following)
        crossed = (side > 0.0) != (there > 0.0)
        if crossed.any():
            found.append((active[crossed], way[crossed], following[crossed]))
        # Deep under ground and high above it, and ever more so, no ray meets it again.
        gone = ((there < -_DEEP_M) & (there < side)) | ((there > _HIGH_M) & (there > side))
        kept = (following < reach[active]) & ~gone
        active, way, side = active[kept], following[kept], there[kept]
    if not found:
        return Crossings(np.empty(0, dtype=np.int64), np.empty((0, 3)))
    ray, low, high = (np.concatenate(part) for part in zip(*found, strict=True))
    above = gap(ray, low) > 0.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        same = (gap(ray, middle) > 0.0) == above
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    place = start_m[ray] + high[:, None] * direction[ray]
    order = np.lexsort((high, ray))
    order = order[terrain.known(place[order])]
    return Crossings(ray[order], place[order])


def on_ground(
    position_m: NDArray[np.float64], terrain: Terrain, height_m: float = 0.0
) -> NDArray[np.float64]:
    """Return positions, shape (n, 3), moved straight up or down to a height above the ground."""
    ground, _ = terrain.elevation(position_m)
    return at_altitude(position_m, ground + height_m, terrain.frame)


def at_altitude(
    position_m: NDArray[np.float64], altitude_m: NDArray[np.float64], frame: Frame
) -> NDArray[np.float64]:
    """Return positions, shape (n, 3), moved straight up or down to given heights, shape (n,)."""
    if frame == "local":
        return np.column_stack([position_m[:, :2], altitude_m])
    geodetic = geodetic_from_ecef(position_m)
    return ecef_from_geodetic(geodetic[:, 0], geodetic[:, 1], altitude_m)


def check_ground(recording: Recording) -> None:
    """Raise InputError if terrain and sensors do not belong together.

    Parameters
    ----------
    recording
        With a terrain. Sensors beyond it are let be as long as one is over it: an aircraft off the
        coast looks at the land.
    """
    terrain = recording.terrain
    if terrain is None or terrain.checked is recording.sensors:
        return
    over = False
    for name, sensor in recording.sensors.items():
        path = sensor.trajectory
        times = np.zeros(1) if path is None else path.time_s
        if times.size > _MOST_CHECKED:
            times = times[np.linspace(0, times.size - 1, _MOST_CHECKED).round().astype(int)]
        position = np.atleast_2d(sensor.position_at(times))
        known = terrain.known(position)
        over |= bool(known.any())
        ground, _ = terrain.elevation(position)
        height = np.where(known, altitude(position, recording.frame)[0] - ground, np.inf)
        lowest = int(np.argmin(height))
        if height[lowest] < -_DEEPEST_M:
            when = "" if path is None else f" at t = {times[lowest]:.6g} s"
            raise InputError(
                f"sensor {name!r} is {-height[lowest]:.4g} m below the ground of "
                f"{terrain.raster.name}{when}; are heights above the ellipsoid and above the geoid "
                "mixed up, or is the raster of another place? mend one of them",
                path=recording.path,
            )
    if not over:
        raise InputError(
            f"no sensor is over the terrain, which covers {terrain.extent_text()}; expected a "
            "raster of the ground below them; is it of another place, or its reference system "
            "wrong?",
            path=terrain.raster.name,
        )
    terrain.checked = recording.sensors
