"""Where a path may be, before anything is fitted: grids, and fixes in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from geograph.closed_form import chan_ho
from geograph.closed_form_sets import multi_set
from geograph.factors.arrival import SensorMotion, trace
from geograph.factors.constraints import altitude
from geograph.lines import Attempt, criteria, robust_weights
from geograph.range_refine import constant_spline, evaluate, knots_of
from geograph.range_residuals import Evaluator, group_medians

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from geograph.closed_form import Fix
    from geograph.range_data import RangeData

# Grid: directions, and distances from the array's middle in its sizes, evenly on a logarithm.
_DIRECTIONS = 80
_AZIMUTHS = 32
_NEAREST, _FARTHEST, _DISTANCES = 0.1, 300.0, 14
_NOMINAL_SIZE_M = 10e3
_GRID_ROWS = 150
_LIKELY = 200
_GRID_SEEDS, _BRIEF_SEEDS = 6, 2

# Sets that are fixed one by one; planes tangent to the ellipsoid take many rounds each.
_SETS, _SETS_AT_HEIGHT, _BRIEF_SETS = 30, 10, 8
_MULTI_SETS = 30

# Fixes are trusted to no more than this share of their distance.
_FIX_SHARE = 1e-5
_CERTAIN_CHI2 = 16.0


@dataclass(frozen=True, eq=False)
class _TimedFix:
    time_s: float
    position_m: NDArray[np.float64]
    covariance_m2: NDArray[np.float64]
    chi2: float


def seeds(data: RangeData, *, static: bool, brief: bool = False) -> Iterator[list[BSpline]]:
    """Yield paths to refine: rough, and more than are needed.

    The second list is for what the first does not explain. A root that the equations of all sets of
    an object at rest do not have is not there; of a moving one, single sets may know another.

    Parameters
    ----------
    data
        The measurements.
    static
        Whether the object stands still.
    brief
        Whether a few will do.
    """
    if brief:
        yield grid_seeds(data, _BRIEF_SEEDS) + fix_seeds(data, _BRIEF_SETS, static=static)
        return
    found = multi_set_seeds(data, static=static)
    grid = grid_seeds(data, _GRID_SEEDS)
    if static and found:
        yield found + grid[:_BRIEF_SEEDS]
        found, grid = [], grid[_BRIEF_SEEDS:]
    most = _SETS_AT_HEIGHT if data.heights.value.size and data.frame == "ecef" else _SETS
    yield found + grid + fix_seeds(data, most, static=static)


def grid_seeds(data: RangeData, most: int) -> list[BSpline]:
    """Return the best local minima of a grid of static places, the best first, at most so many."""
    few = data.thinned(_GRID_ROWS)
    points = _grid(data)
    shape = points.shape[:-1]
    cost = _static_costs(few, points.reshape(-1, 3)).reshape(shape)
    cost = np.where(np.isfinite(cost), cost, np.inf)
    least = np.ones(shape, dtype=bool)
    # Neighbours along the distance; directions are compared by nearness below.
    least[:, 1:] &= cost[:, 1:] <= cost[:, :-1]
    least[:, :-1] &= cost[:, :-1] <= cost[:, 1:]
    order = np.argsort(np.where(least, cost, np.inf), axis=None)
    centre = _centre(data)
    kept: list[NDArray[np.float64]] = []
    for index in order:
        if len(kept) == most:
            break
        point = points.reshape(-1, 3)[index]
        size = np.linalg.norm(point - centre)
        if all(np.linalg.norm(point - other) > 0.5 * size for other in kept):
            kept.append(point)
    return [constant_spline(point, data.times()) for point in kept]


def _centre(data: RangeData) -> NDArray[np.float64]:
    return np.asarray(data.sensor_places().mean(axis=0))


def _grid(data: RangeData) -> NDArray[np.float64]:
    """Return places, shape (directions, distances, 3)."""
    places = data.sensor_places()
    centre = places.mean(axis=0)
    size = float(np.sqrt(np.mean(np.sum((places - centre) ** 2, axis=1))))
    size = size if size > 0.0 else _NOMINAL_SIZE_M
    distance = size * np.geomspace(_NEAREST, _FARTHEST, _DISTANCES)
    height = data.heights.at(float(data.times().mean()))
    if height is None:
        # Fibonacci's sphere: even, and no two directions opposite each other's.
        number = np.arange(_DIRECTIONS) + 0.5
        z = 1.0 - 2.0 * number / _DIRECTIONS
        turn = np.pi * (1.0 + np.sqrt(5.0)) * number
        level = np.sqrt(1.0 - z**2)
        unit = np.stack([level * np.cos(turn), level * np.sin(turn), z], axis=1)
        return np.asarray(centre + unit[:, None, :] * distance[:, None])
    _, up = altitude(centre[None, :], data.frame)
    up = up if np.isfinite(up).all() else np.array([[0.0, 0.0, 1.0]])
    _, _, axes = np.linalg.svd(up)
    turn = 2.0 * np.pi * np.arange(_AZIMUTHS) / _AZIMUTHS
    unit = np.cos(turn)[:, None] * axes[1] + np.sin(turn)[:, None] * axes[2]
    points = centre + unit[:, None, :] * distance[:, None]
    flat = points.reshape(-1, 3)
    for _ in range(3):
        now, normal = altitude(flat, data.frame)
        good = np.isfinite(now) & np.isfinite(normal).all(axis=1)
        flat = np.where(good[:, None], flat + (height - now)[:, None] * normal, flat)
    return np.asarray(flat.reshape(points.shape))


def _static_costs(data: RangeData, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sum of absolute whitened residuals, smooth at zero, of places, shape (h,)."""
    ranges = data.ranges
    count, rows, groups = points.shape[0], len(ranges), ranges.origin_s.size
    cost = np.zeros(count)
    if rows:
        still = np.zeros((count * rows, 3))
        motion = SensorMotion(
            np.tile(ranges.motion.position_m, (count, 1)),
            np.tile(ranges.motion.velocity_m_s, (count, 1)),
            still,
        )
        ray = trace(
            np.repeat(points, rows, axis=0),
            still,
            lambda _: motion,
            speed_m_s=data.speed_m_s,
            spin_rad_s=data.spin_rad_s,
        )
        white = np.tile(1.0 / ranges.sigma_s, count)
        asked = np.tile(ranges.delay_s, count) - ray.light_time_s
        group = (np.arange(count)[:, None] * groups + ranges.group).ravel()
        middle = group_medians(asked, white, group, count * groups)
        left = ((asked - middle[group]) * white).reshape(count, rows)
        cost += np.sqrt(1.0 + left**2).sum(axis=1)
    if len(data.bearings) or (len(data.differences) and not rows):
        # Frequencies depend on the velocity, which a place alone does not have.
        rest = Evaluator(data)
        likely = np.argsort(cost, kind="stable")[: _LIKELY if rows else count]
        extra = np.full(count, np.inf)
        for number in likely:
            path = constant_spline(points[number], data.times())
            left = evaluate(rest, path).value[rows:]
            left = left if not rows else left[: 2 * len(data.bearings)]
            extra[number] = float(np.sqrt(1.0 + left**2).sum())
        cost += extra
    return cost


def multi_set_seeds(data: RangeData, *, static: bool) -> list[BSpline]:
    """Return the roots of all sets together, static and moving evenly."""
    ranges = data.ranges
    groups = ranges.origin_s.size
    if groups < 2:
        return []
    chosen = np.zeros(groups, dtype=bool)
    chosen[np.linspace(0, groups - 1, min(groups, _MULTI_SETS)).round().astype(np.int64)] = True
    part = ranges.take(chosen[ranges.group] & (np.bincount(ranges.group) >= 3)[ranges.group])
    if not len(part):
        return []
    found: list[BSpline] = []
    time = data.times()
    for velocity in (False,) if static else (False, True):
        fixes = multi_set(
            part.motion.position_m,
            part.origin_s[part.group] + part.delay_s,
            part.sigma_s,
            part.group,
            speed_m_s=data.speed_m_s,
            sensor=part.sensor,
            velocity=velocity,
            height_m=data.heights.at(float(time.mean())),
            frame=data.frame,
        )
        for fix in fixes:
            if velocity:
                knots = knots_of(float(time.min()), float(time.max()), 1, 1)
                ends = np.array([knots[0], knots[-1]]) - fix.time_s
                found.append(BSpline(knots, fix.position_m + ends[:, None] * fix.velocity_m_s, 1))
            else:
                found.append(constant_spline(fix.position_m, time))
    return found


def fix_seeds(data: RangeData, most: int, *, static: bool) -> list[BSpline]:
    """Return smooth paths through fixes of single sets, one for each root of the surest set.

    Parameters
    ----------
    data
        The measurements.
    most
        Number of sets that are fixed.
    static
        Whether the object stands still.
    """
    ranges = data.ranges
    known = bool(data.heights.value.size)
    origins = np.unique(ranges.origin_s)
    picked = origins[
        np.linspace(0, origins.size - 1, min(origins.size, most)).round().astype(np.int64)
    ]
    history: list[list[_TimedFix]] = []
    for origin in np.unique(picked):
        fixes = _set_fixes(data, float(origin), least=3 if known else 4)
        if fixes:
            history.append(fixes)
    if not history:
        return []
    centre = _centre(data)

    def doubt(fix: _TimedFix) -> float:
        spread = float(np.sqrt(max(np.trace(fix.covariance_m2), 0.0)))
        return spread / (1e-9 + float(np.linalg.norm(fix.position_m - centre)))

    surest = min(range(len(history)), key=lambda k: doubt(history[k][0]))
    found = []
    for root in history[surest][:2]:
        chosen = {surest: root}
        for step in (1, -1):
            last, index = root, surest + step
            while 0 <= index < len(history):
                near = [
                    float(np.linalg.norm(fix.position_m - last.position_m))
                    for fix in history[index]
                ]
                last = chosen[index] = history[index][int(np.argmin(near))]
                index += step
        found.append(_through(list(chosen.values()), data, centre, static=static))
    return found


def _set_fixes(data: RangeData, origin_s: float, *, least: int) -> list[_TimedFix]:
    """Return the fixes of the groups of one time, joined where sensors are common to them."""
    ranges = data.ranges
    rows = np.flatnonzero(ranges.origin_s[ranges.group] == origin_s)
    sensors, which = np.unique(ranges.sensor[rows], return_inverse=True)
    _, group = np.unique(ranges.group[rows], return_inverse=True)
    count, groups = sensors.size, int(group.max()) + 1
    links = coo_array(
        (np.ones(rows.size), (which, count + group)), shape=(count + groups, count + groups)
    )
    label = connected_components(links, directed=False)[1][:count]
    part = np.flatnonzero(label == np.bincount(label).argmax())
    if part.size < least:
        return []
    # Arrivals at the sensors, the groups' own times of emission eliminated.
    weight = ranges.sigma_s[rows] ** -2.0
    design = np.zeros((rows.size, count + groups))
    design[np.arange(rows.size), which] = 1.0
    design[np.arange(rows.size), count + group] = 1.0
    scale = float(weight.max())
    information = design.T @ (design * (weight / scale)[:, None])
    covariance = np.linalg.pinv(information, hermitian=True)
    arrival = covariance @ (design.T @ (ranges.delay_s[rows] * weight / scale))
    shared = np.asarray(covariance[np.ix_(part, part)] / scale, dtype=np.float64)
    place = np.zeros((count, 3))
    np.add.at(place, which, ranges.motion.position_m[rows])
    place /= np.bincount(which)[:, None]
    # Delays were split between sensors and groups: counted from the origin again.
    offset = float(np.median(ranges.delay_s[rows] - arrival[which]))
    fixes: list[Fix] = chan_ho(
        place[part],
        arrival[part] + offset,
        _symmetric(shared),
        speed_m_s=data.speed_m_s,
        height_m=data.heights.at(origin_s),
        frame=data.frame,
    )
    least_cost = fixes[0].cost
    return [
        _TimedFix(origin_s + fix.emission_s, fix.position_m, fix.covariance_m2, fix.cost)
        for fix in fixes
        if fix.cost <= least_cost + _CERTAIN_CHI2
    ]


def _symmetric(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a covariance with a common error that makes every variance positive."""
    even = 0.5 * (covariance + covariance.T)
    spread = float(np.abs(even).max())
    return even + max(spread - float(np.diag(even).min()), 0.0)


def _through(
    fixes: list[_TimedFix], data: RangeData, centre: NDArray[np.float64], *, static: bool
) -> BSpline:
    """Return the polynomial path through fixes, as flexible as they bear out."""
    time = np.array([fix.time_s for fix in fixes])
    position = np.array([fix.position_m for fix in fixes])
    size = float(np.median(np.linalg.norm(position - centre, axis=1)))
    floor = (_FIX_SHARE * max(size, 1e-3)) ** 2
    whiten = []
    for fix in fixes:
        values, vectors = np.linalg.eigh(fix.covariance_m2)
        whiten.append(vectors.T / np.sqrt(np.maximum(values, floor))[:, None])
    white = np.array(whiten)
    span = data.times()
    low, high = min(time.min(), span.min()), max(time.max(), span.max())
    attempts = []
    options = [(degree, 1) for degree in range(4)] + [(3, 4), (3, 8), (3, 16)]
    # With more, some fixes would be met exactly and the rest taken for outliers.
    most = 1 if static else max(1, len(fixes) // 2)
    for degree, segments in [option for option in options if sum(option) <= most]:
        knots = knots_of(float(low), float(high), degree, segments)
        basis = BSpline.design_matrix(time, knots, degree).toarray()
        design = np.einsum("nij,nb->nibj", white, basis).reshape(3 * len(fixes), -1)
        target = np.einsum("nij,nj->ni", white, position - centre)
        weight = np.ones(len(fixes))
        for _ in range(6):
            root = np.repeat(np.sqrt(weight), 3)
            solution = np.linalg.lstsq(design * root[:, None], target.ravel() * root, rcond=1e-12)[
                0
            ]
            left = target - (design @ solution).reshape(-1, 3)
            weight = robust_weights(left)
        spline = BSpline(knots, solution.reshape(-1, 3) + centre, degree)
        attempts.append(Attempt(spline, left, solution.size, size, 0.0))
    return attempts[int(np.argmin(criteria(attempts)))].spline
