"""How nearly the rays of two sensors meet, without any path."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.checkup.fits import SHARE
from geograph.lines import angle

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.checkup.fits import Case
    from geograph.lines import Lines

_CLOCK_STEPS = 161
_COMMON = 0.25


def pair_miss(case: Case) -> float:
    """Return the angle within which most rays of two sensors pass each other, radians.

    Rays of the first are held against those of the second at the same times, interpolated, for all
    differences of the two clocks within their priors, of which the best counts. Infinite where less
    than three, or a quarter, have a time in common, or a sensor has no elevations.
    """
    first, second = case.active
    finder = case.finder()
    lines = finder.lines(np.zeros(len(case.sensors)))
    if lines.azimuth_only.any():
        return float("inf")
    one, other = _of(lines, first), _of(lines, second)
    clocks = [case.sensors[i].errors.clock_offset_s for i in case.active]
    prior = float(np.linalg.norm(clocks))
    offsets = prior * np.linspace(-4.0, 4.0, _CLOCK_STEPS) if prior > 0.0 else np.zeros(1)
    return min(_miss(one, other, float(offset)) for offset in offsets)


def _of(
    lines: Lines, sensor: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    rows = np.flatnonzero(lines.sensor == sensor)
    time, index = np.unique(lines.time_s[rows], return_index=True)
    return time, lines.sensor_m[rows[index]], lines.direction[rows[index]]


def _miss(
    one: tuple[NDArray[np.float64], ...], other: tuple[NDArray[np.float64], ...], offset_s: float
) -> float:
    time, place, direction = one
    inside = (time + offset_s >= other[0][0]) & (time + offset_s <= other[0][-1])
    if np.count_nonzero(inside) < max(3, _COMMON * inside.size):
        return float("inf")
    place, direction = place[inside], direction[inside]
    at = time[inside] + offset_s
    there, towards = (
        np.stack([np.interp(at, other[0], column) for column in table.T], axis=1)
        for table in other[1:]
    )
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    return float(np.quantile(ray_miss(place, direction, there, towards), SHARE))


def ray_miss(
    one_m: NDArray[np.float64],
    direction: NDArray[np.float64],
    other_m: NDArray[np.float64],
    towards: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the larger angle by which two rays miss a point between them, shape (n,), radians.

    The point is the middle of the shortest line between the rays, or, if that leaves less, one far
    away between their directions.

    Parameters
    ----------
    one_m, other_m
        Shape (n, 3): where the rays begin.
    direction, towards
        Shape (n, 3): their unit vectors.
    """
    base = other_m - one_m
    cosine = np.sum(direction * towards, axis=1)
    along, along_other = np.sum(base * direction, axis=1), np.sum(base * towards, axis=1)
    sine = np.maximum(1.0 - cosine**2, 1e-15)
    reach = np.maximum((along - cosine * along_other) / sine, 0.0)
    reach_other = np.maximum(cosine * reach - along_other, 0.0)
    point = 0.5 * (one_m + reach[:, None] * direction + other_m + reach_other[:, None] * towards)
    near = np.maximum(angle(point - one_m, direction), angle(point - other_m, towards))
    return np.asarray(np.minimum(near, 0.5 * angle(direction, towards)))
