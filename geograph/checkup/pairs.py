"""How nearly the rays of two sensors meet, without any path."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.checkup.fits import SHARE
from geograph.lines import angle

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.checkup.fits import Case
    from geograph.lines import Lines

# In a search for one difference of clocks, and for each of many.
_CLOCK_STEPS, _SHIFT_STEPS = 161, 21
# Units of work of holding all rays of two sensors against each other.
_MISS_WORK = 0.2
_COMMON = 0.25


def pair_miss(case: Case) -> float:
    """Return the angle within which most rays of two sensors pass each other, radians.

    Rays of the first are held against those of the second at the same times, interpolated, for all
    differences of the two clocks within their priors, of which the best counts. Infinite where less
    than three, or a quarter, have a time in common, or a sensor has no elevations.
    """
    return float(shift_misses(case, case.active[0], [0.0], _CLOCK_STEPS)[0])


def shift_misses(
    case: Case, sensor: int, shifts_s: Sequence[float], steps: int = _SHIFT_STEPS
) -> NDArray[np.float64]:
    """Return the angles within which most rays pass each other, for errors of one clock.

    Parameters
    ----------
    case
        Of two sensors.
    sensor
        To the times of which the seconds are added.
    shifts_s
        Seconds, of any number.
    steps
        In which the clocks' priors are searched about each.

    Returns
    -------
    ndarray
        One angle for each, radians; infinite as in :func:`pair_miss`.
    """
    other = next(index for index in case.active if index != sensor)
    lines = case.finder().lines(np.zeros(len(case.sensors)))
    if lines.azimuth_only.any():
        return np.full(len(shifts_s), np.inf)
    own, others = _of(lines, sensor), _of(lines, other)
    prior = float(np.linalg.norm([case.sensors[i].errors.clock_offset_s for i in case.active]))
    offsets = prior * np.linspace(-4.0, 4.0, steps) if prior > 0.0 else np.zeros(1)
    case.effort.spend(_MISS_WORK * offsets.size * len(shifts_s))
    return np.array(
        [min(_miss(own, others, shift + float(o)) for o in offsets) for shift in shifts_s]
    )


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
