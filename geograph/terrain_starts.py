"""First guesses on the ground: where the rays of bearings meet the terrain.

Every crossing of every ray is a candidate. Those that agree best with all bearings go downhill on
the ground, in east and north alone, and every place that they end in is a first guess of its own:
with one sensor and mountains there are as many as the ray crosses slopes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import BSpline

from geograph.errors import InputError
from geograph.factors.constraints import altitude
from geograph.geodesy import enu_axes
from geograph.ground import crossings, on_ground
from geograph.initialise import PathFit
from geograph.known_heights import Heights

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.ground import Crossings
    from geograph.initialise import FirstGuess
    from geograph.known_coordinates import Coordinates
    from geograph.lines import Lines
    from geograph.measurements import Constraints
    from geograph.recording import Recording
    from geograph.terrain import Terrain

_MOST_BEARINGS = 100
_MOST_RAYS = 40
_MOST_SEEDS = 16
_MOST_STARTS = 6
_ROUNDS = 25

# Cost, above that of the best, of a guess that no measurements would bring back.
_HOPELESS = 30.0

# Where residuals stop to count in full, sigmas.
_BOUND = 4.0

# Spread of the ground's height where nothing is known of the place, metres.
_RELIEF_M = 300.0


def ground_height(constraints: Constraints | None) -> float | None:
    """Return the height above ground that the whole path is held to, or None."""
    if constraints is None:
        return None
    for kind, time, value in zip(
        constraints.kind, constraints.time_s, constraints.value, strict=True
    ):
        if kind == "height_above_terrain_m" and np.isnan(time):
            return float(value)
    return None


def levelled(recording: Recording) -> Recording:
    """Return a recording whose heights above terrain are roughly known heights.

    For first guesses that know of heights alone: the ground is as high as below the sensors.
    """
    table, terrain = recording.constraints, recording.terrain
    rows = [] if table is None else [kind == "height_above_terrain_m" for kind in table.kind]
    if table is None or terrain is None or not any(rows):
        return recording
    low = recording.time_span_s[0]
    places = np.array([sensor.position_at(low) for sensor in recording.sensors.values()])
    ground, _ = terrain.elevation(places)
    flat = np.array(rows)
    spread = np.hypot(table.sigma, max(_RELIEF_M, float(np.std(ground))))
    level = replace(
        table,
        kind=tuple(
            "altitude_m" if own else kind for kind, own in zip(table.kind, rows, strict=True)
        ),
        value=np.where(flat, table.value + float(np.mean(ground)), table.value),
        sigma=np.where(flat, spread, table.sigma),
    )
    return replace(recording, constraints=level)


def terrain_fits(finder: FirstGuess, terrain: Terrain, height_m: float) -> list[PathFit]:
    """Return first guesses on the ground, the best first; none where no elevation was measured.

    Parameters
    ----------
    finder
        The bearings, and how lines are fitted to them.
    terrain
        The ground.
    height_m
        Height of the object above it.

    Raises
    ------
    InputError
        If no bearing meets the ground.
    """
    clock = np.zeros(len(finder.sensors))
    count = len(finder.bearings)
    pick = np.unique(np.linspace(0, count - 1, min(count, _MOST_BEARINGS)).round().astype(np.int64))
    lines = finder.lines(clock, pick)
    if lines.azimuth_only.all():
        return []
    level = np.flatnonzero(~lines.azimuth_only)
    # Any of them will do where the object stands still; where it moves they are its path.
    few = level[:: -(-level.size // _MOST_RAYS)] if finder.static else level
    met = crossings(lines.sensor_m[few], lines.direction[few], terrain, height_m=height_m)
    if not met.ray.size and few.size < level.size:
        met = crossings(lines.sensor_m[level], lines.direction[level], terrain, height_m=height_m)
    # One that moves need not be elsewhere where it is known to be at one time.
    known = finder.coordinates if finder.static else finder.coordinates.whole()
    told = known.place(terrain.frame)
    if not met.ray.size and told.size and not finder.static:
        return []
    if not met.ray.size and not told.size:
        raise InputError(
            f"none of {level.size} bearings looked at meets the terrain within "
            f"{terrain.extent_text()}, to which the object is held {height_m:g} m above ground; "
            "check axes, signs of the elevations, heights and the extent of the raster, or remove "
            "the constraint"
        )
    search = _Search(lines, terrain, height_m, count / pick.size, known)
    places, cost = search.minima(np.concatenate([met.position_m, told]))
    if finder.static:
        return [_standing(lines, place, score) for place, score in zip(places, cost, strict=True)]
    return [_moving(finder, lines, met, level, place) for place in places]


def _standing(lines: Lines, place: NDArray[np.float64], score: float) -> PathFit:
    low, high = float(lines.time_s.min()), float(lines.time_s.max())
    ends = np.array([low, high if high > low else low + 1.0])
    away = float(np.median(np.linalg.norm(place - lines.sensor_m, axis=1)))
    sensors = int(lines.sensor.max()) + 1
    return PathFit(BSpline(ends, place[None], 0), np.zeros(sensors), score, away, 0.0)


def _moving(
    finder: FirstGuess,
    lines: Lines,
    met: Crossings,
    level: NDArray[np.int64],
    place: NDArray[np.float64],
) -> PathFit:
    """Return a path through bearings as high as the ground where each of them meets it.

    Of the crossings of a ray the one nearest to a place counts.
    """
    away = np.linalg.norm(met.position_m - place, axis=1)
    order = np.lexsort((away, met.ray))
    first = order[np.diff(met.ray[order], prepend=-1) > 0]
    height, _ = altitude(met.position_m[first], finder.geometry.frame)
    spread = max(1.4826 * float(np.median(np.abs(height - np.median(height)))), 1.0)
    known = Heights(lines.time_s[level[met.ray[first]]], height, np.full(height.size, spread))
    kept = finder.heights
    finder.heights = known
    try:
        return finder.best_fit(np.zeros(len(finder.sensors)))
    finally:
        finder.heights = kept


@dataclass(eq=False)
class _Search:
    """Looks for places on the ground that fit all bearings, many at a time.

    Attributes
    ----------
    lines
        A share of the bearings.
    terrain, height_m
        The ground, and the object's height above it.
    share
        Bearings in all for each of these.
    known
        Coordinates of the place that are known.
    """

    lines: Lines
    terrain: Terrain
    height_m: float
    share: float
    known: Coordinates

    def residuals(self, place: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return angles across the lines over sigma, shape (p, n + c, 2), for places (p, 3).

        The last c are the misfits of known coordinates, with nothing in the second column.
        """
        lines = self.lines
        sight = place[:, None] - lines.sensor_m
        away = np.maximum(np.linalg.norm(sight, axis=2), 1e-6)
        across = np.einsum("nkc,pnc->pnk", lines.across, sight) / away[..., None]
        along = np.einsum("nc,pnc->pn", lines.direction, sight) / away
        sine = np.maximum(np.linalg.norm(across, axis=2), 1e-12)
        angle = np.arctan2(sine, along)
        turned = across * (angle / sine)[..., None] / lines.sigma
        misfit = (place @ self.known.axis.T - self.known.value) * self._known_weight()
        return np.concatenate([turned, _first_of_two(misfit)], axis=1)

    def _known_weight(self) -> NDArray[np.float64]:
        # Each counts once, whatever share of the bearings is looked at.
        return np.asarray(1.0 / (self.known.sigma * np.sqrt(self.share)))

    def cost(self, residual: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return bounded costs, shape (p,)."""
        square = np.sum(residual**2, axis=2)
        return np.asarray(0.5 * _BOUND**2 * np.log1p(square / _BOUND**2).sum(axis=1) * self.share)

    def minima(
        self, candidates_m: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return different places, shape (p, 3), and their costs, the best first."""
        seeds = self._spread(candidates_m)
        place, cost = self._downhill(seeds)
        known = self.terrain.known(place)
        if known.any():
            place, cost = place[known], cost[known]
        chosen: list[int] = []
        for index in np.argsort(cost):
            if cost[index] > cost.min() + _HOPELESS or len(chosen) == _MOST_STARTS:
                break
            apart = np.linalg.norm(place[chosen] - place[index], axis=1)
            if not chosen or apart.min() > self._near(place[index]):
                chosen.append(int(index))
        return place[chosen], cost[chosen]

    def _near(self, place: NDArray[np.float64]) -> float:
        """Return how far apart two places are at least that count as two."""
        away = float(np.median(np.linalg.norm(place - self.lines.sensor_m, axis=1)))
        sigma = float(np.median(self.lines.sigma[np.isfinite(self.lines.sigma)]))
        count = len(self.lines.time_s)
        return max(self.terrain.spacing_m, away * sigma / float(np.sqrt(count)))

    def _spread(self, candidates_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return candidates that fit well and are not all in one place."""
        cost = np.concatenate(
            [self.cost(self.residuals(part)) for part in np.array_split(
                candidates_m, max(1, len(candidates_m) // 100)
            )]
        )  # fmt: skip
        left = np.argsort(cost)
        chosen: list[int] = []
        lines = self.lines
        sigma = float(np.median(lines.sigma[np.isfinite(lines.sigma)]))
        while left.size and len(chosen) < _MOST_SEEDS:
            place = candidates_m[left[0]]
            chosen.append(int(left[0]))
            away = float(np.median(np.linalg.norm(place - lines.sensor_m, axis=1)))
            radius = max(2.0 * self.terrain.spacing_m, 0.5 * away * sigma)
            apart = np.linalg.norm(candidates_m[left] - place, axis=1)
            left = left[apart > radius]
        return candidates_m[chosen]

    def _downhill(
        self, place: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return where damped Gauss-Newton steps over the ground end, and the costs there."""
        count = place.shape[0]
        damping, done = np.full(count, 1e-3), np.zeros(count, dtype=np.bool_)
        place = on_ground(place, self.terrain, self.height_m)
        residual = self.residuals(place)
        cost = self.cost(residual)
        axes = np.broadcast_to(np.eye(3), (count, 3, 3))
        for _ in range(_ROUNDS):
            if self.terrain.frame == "ecef":
                axes = enu_axes(place)
            jacobian = self._slopes(place, axes)
            weight = 1.0 / (1.0 + np.sum(residual**2, axis=2) / _BOUND**2)
            normal = np.einsum("pnki,pn,pnkj->pij", jacobian, weight, jacobian)
            right = np.einsum("pnki,pn,pnk->pi", jacobian, weight, residual)
            scale = np.einsum("pii->pi", normal)
            damped = normal + (damping[:, None] * scale + 1e-30)[:, :, None] * np.eye(2)
            move = -np.linalg.solve(damped, right[:, :, None])[:, :, 0]
            trial = on_ground(
                place + np.einsum("pi,pic->pc", move, axes[:, :2]), self.terrain, self.height_m
            )
            other = self.residuals(trial)
            value = self.cost(other)
            better = value < cost
            gain = cost - value
            damping = np.where(better, 0.2 * damping, 8.0 * np.maximum(damping, 1e-4))
            place = np.where(better[:, None], trial, place)
            residual = np.where(better[:, None, None], other, residual)
            cost = np.where(better, value, cost)
            done |= (np.abs(gain) < 1e-3) | (damping > 1e4)
            if done.all():
                break
        return place, cost

    def _slopes(self, place: NDArray[np.float64], axes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return about the residuals' derivatives by east and north, shape (p, n + c, 2, 2).

        Steps follow the slope of the ground.
        """
        _, slope = self.terrain.elevation(place, jacobian=True)
        assert slope is not None
        climb = np.einsum("pic,pc->pi", axes[:, :2], slope)
        tangent = axes[:, :2] + climb[:, :, None] * axes[:, 2:]
        sight = place[:, None] - self.lines.sensor_m
        away = np.maximum(np.linalg.norm(sight, axis=2), 1e-6)
        # Of across . sight / away; the angle's curvature is left out.
        across = np.einsum("nkc,pic->pnki", self.lines.across, tangent)
        value = np.einsum("nkc,pnc->pnk", self.lines.across, sight) / away[..., None] ** 2
        across -= value[..., None] * np.einsum("pnc,pic->pni", sight, tangent)[:, :, None]
        across /= (self.lines.sigma * away[..., None])[..., None]
        known = np.einsum("mc,pic,m->pmi", self.known.axis, tangent, self._known_weight())
        return np.concatenate([across, np.stack([known, np.zeros_like(known)], axis=2)], axis=1)


def _first_of_two(value: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([value, np.zeros_like(value)], axis=2)
