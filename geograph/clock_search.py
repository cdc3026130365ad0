"""Clocks that may be seconds off, searched over their prior before the smoother starts.

The sensors are taken one after another, the surest clocks first. Each new one's bearings are held
against the path of the sensors before, over a grid of offsets; the first two, which have no path
yet, are fitted together at every offset. The grid is far coarser than what bearings tell about a
clock, so that its minima are refined before they are compared: at the right offset a stiff path
fits, next to it only a flexible one that leads anywhere. The best few hypotheses are kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize_scalar

from geograph.lines import angle, criteria, misfit
from geograph.time_shift import centred

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from geograph.initialise import FirstGuess

_SEARCH_SAMPLES = 40
_SEARCH_ROUNDS = 3
_SEARCH_STEPS = 41
_HYPOTHESES = 4
_PATH_SAMPLES = 400
_OFFSET_STEPS = 401
# Minima are refined to this share of the grid's step, in at most so many evaluations.
_REFINED_SHARE = 3e-3
_REFINEMENTS = 12
# A bearing further off than this many times the typical miss tells nothing about the clock.
_MISS_LIMIT = 10.0


@dataclass(frozen=True, eq=False)
class ClockSearch:
    """Searches the clocks of a recording.

    Attributes
    ----------
    finder
        Fits paths for given clock offsets.
    """

    finder: FirstGuess

    def hypotheses(self) -> list[NDArray[np.float64]]:
        """Search the clocks that matter, one after another, keeping the best few hypotheses."""
        count = len(self.finder.sensors)
        zero = np.zeros(count)
        prior = np.array([sensor.errors.clock_offset_s for sensor in self.finder.sensors])
        used = np.unique(self.finder.bearings.sensor)
        doubtful = [int(i) for i in used if prior[i] > 0.0 and self._matters(int(i), prior[i])]
        if not doubtful or self.finder.static:
            return [zero]
        known = [int(i) for i in used if i not in doubtful]
        doubtful.sort(key=lambda i: prior[i])
        if not known:
            # Nobody's clock is right: the surest one sets the time, its prior does the rest.
            known = [doubtful.pop(0)]
        samples = {i: self._sample(i) for i in (*known, *doubtful)}
        beam: list[tuple[float, NDArray[np.float64]]] = [(0.0, zero)]
        included = list(known)
        for sensor in doubtful:
            included.append(sensor)
            rows = np.concatenate([samples[i] for i in included])
            scored = []
            for score, clocks in beam:
                found: list[tuple[float, NDArray[np.float64]]] = []
                if len(included) > 2:
                    earlier = np.concatenate([samples[i] for i in included[:-1]])
                    found = self._against_path(sensor, prior[sensor], clocks, earlier)
                found = found or self._search(sensor, prior, clocks, rows)
                scored += [(score + extra, trial) for extra, trial in found]
            scored.sort(key=lambda entry: entry[0])
            beam = scored[:_HYPOTHESES]
        sensors = self.finder.sensors
        if (prior[used] > 0.0).all() and all(sensors[i].trajectory is None for i in used):
            # Only the priors say when it was: start where they are content.
            for _, clocks in beam:
                clocks[used] = centred(clocks[used], prior[used])
        return [clocks for _, clocks in beam]

    def _matters(self, sensor: int, prior_s: float) -> bool:
        """Tell whether a sensor's clock could be wrong by more than its angles can see."""
        rows = np.flatnonzero(self.finder.bearings.sensor == sensor)
        lines = self.finder.lines(
            np.zeros(len(self.finder.sensors)), rows[np.argsort(self.finder.bearings.time_s[rows])]
        )
        span = float(np.ptp(lines.time_s))
        if not span > 0.0:
            return True
        travel = np.linalg.norm(lines.direction[-1] - lines.direction[0])
        resolution = float(np.median(lines.sigma[np.isfinite(lines.sigma)]))
        return bool(prior_s * travel / span > 3.0 * resolution)

    def _sample(self, sensor: int) -> NDArray[np.int64]:
        rows = np.flatnonzero(self.finder.bearings.sensor == sensor)
        rows = rows[np.argsort(self.finder.bearings.time_s[rows], kind="stable")]
        pick = np.unique(np.linspace(0, rows.size - 1, _SEARCH_SAMPLES).round().astype(int))
        return np.asarray(rows[pick])

    def _against_path(
        self,
        sensor: int,
        prior_s: float,
        clock_s: NDArray[np.float64],
        earlier: NDArray[np.int64],
    ) -> list[tuple[float, NDArray[np.float64]]]:
        """Return (misfit, clocks) where a sensor's bearings meet the path of the others.

        The path is that of the sensors before, where these saw it; it is not bent to the new one's
        bearings. Empty if no offset brings half of the bearings onto the path.
        """
        spline = self.finder.best_fit(clock_s, earlier).spline
        low, high = float(spline.t[0]), float(spline.t[-1])
        rows = self._sample(sensor)
        without = clock_s.copy()
        without[sensor] = 0.0
        lines = self.finder.lines(without, rows)
        grid = np.linspace(low, high, _PATH_SAMPLES)
        miss = angle(spline(grid)[None] - lines.sensor_m[:, None], lines.direction[:, None])
        floor = max(float(np.median(miss.min(axis=1))), float(np.median(lines.sigma[:, 0])))
        limit = (_MISS_LIMIT * floor) ** 2

        def share(offset: float) -> float:
            time = lines.time_s - offset
            sight = spline(np.clip(time, low, high)) - lines.sensor_m
            square = np.minimum(angle(sight, lines.direction) ** 2, limit)
            square[(time < low) | (time > high)] = limit
            return float(np.mean(square)) / limit

        def score(offset: float) -> float:
            return rows.size * float(np.log(share(offset) + 1e-6)) + (offset / prior_s) ** 2

        found = []
        for value, offset in _deepest(score, np.linspace(-4.0, 4.0, _OFFSET_STEPS) * prior_s):
            if share(offset) < 0.5:
                trial = clock_s.copy()
                trial[sensor] = offset
                found.append((value, trial))
        return found

    def _search(
        self,
        sensor: int,
        prior_s: NDArray[np.float64],
        clock_s: NDArray[np.float64],
        rows: NDArray[np.int64],
    ) -> list[tuple[float, NDArray[np.float64]]]:
        """Return (score, clocks) at the local minima over one sensor's clock prior."""

        def score(offset: float) -> float:
            trial = clock_s.copy()
            trial[sensor] = offset
            lines = self.finder.lines(trial, rows)
            attempts = [self.finder.fit(lines, degree, 1, _SEARCH_ROUNDS) for degree in (1, 3)]
            if criteria(attempts)[1] < criteria(attempts)[0]:
                attempts.append(self.finder.fit(lines, 3, 4, _SEARCH_ROUNDS))
            return misfit(attempts) + float(offset / prior_s[sensor]) ** 2

        grid = np.linspace(-3.0, 3.0, _SEARCH_STEPS) * prior_s[sensor]
        found = []
        for value, offset in _deepest(score, grid):
            clocks = clock_s.copy()
            clocks[sensor] = offset
            found.append((value, clocks))
        return found


def _deepest(
    score: Callable[[float], float], grid: NDArray[np.float64]
) -> list[tuple[float, float]]:
    """Return (value, place) of the deepest local minima of a function, deepest first.

    Parameters
    ----------
    score
        The function.
    grid
        Shape (n,), evenly spaced: where minima are looked for, each to be refined between its
        neighbours.
    """
    values = np.array([score(float(place)) for place in grid])
    step = float(grid[1] - grid[0])
    found = []
    for index in _local_minima(values):
        place = float(grid[index])
        refined = minimize_scalar(
            score,
            bounds=(place - step, place + step),
            method="bounded",
            options={"xatol": _REFINED_SHARE * step, "maxiter": _REFINEMENTS},
        )
        better = refined.fun < values[index]
        found.append(
            (float(refined.fun), float(refined.x)) if better else (float(values[index]), place)
        )
    return sorted(found)


def _local_minima(values: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return indices of the deepest local minima of a sequence, deepest first."""
    padded = np.concatenate([[np.inf], values, [np.inf]])
    minima = np.flatnonzero((values <= padded[:-2]) & (values <= padded[2:]))
    return np.asarray(minima[np.argsort(values[minima])][:_HYPOTHESES])
