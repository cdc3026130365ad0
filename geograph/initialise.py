"""The first guess: a path and clock offsets from the measurements alone.

A bearing, whatever the range, says that the object lies on a line: for both directions e across the
line, e . (p(t) - S) = 0, with a standard deviation of sigma times the range. With p(t) linear in
its coefficients (a polynomial, or a cubic spline for long passes) that is a linear least-squares
problem, solved again with better ranges and robust weights (pseudo-linear estimator; S. C. Nardone,
A. G. Lindgren, K. F. Gong, *Fundamental properties and performance of conventional bearings-only
target motion analysis*, IEEE TAC 29, 1984). The number of coefficients is chosen by the Bayesian
information criterion. Clocks that may be wrong by more than their sensor's angular resolution are
searched over their prior, one sensor after another, keeping several hypotheses.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import BSpline

from geograph.errors import InputError
from geograph.factors.constraints import altitude

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.frames import SensorGeometry
    from geograph.measurements import Bearings, Constraints
    from geograph.sensors import Sensor

# Share of measurements with the object behind the sensor at which the fit is not trusted, and how
# strongly the object is pulled in front, relative to a bearing's weight at the nominal distance.
_SUSPICIOUS_SHARE = 0.1
_WEAK_PULL = 1e-6
_STRONG_PULL = 1e-2

_RANGE_ROUNDS = 6
_RANGE_TOLERANCE = 1e-3
_SEARCH_SAMPLES = 40
_SEARCH_ROUNDS = 3
_SEARCH_STEPS = 41
_HYPOTHESES = 4
_PATH_SAMPLES = 400
_OFFSET_STEPS = 401
# A bearing further off than this many times the typical miss tells nothing about the clock.
_MISS_LIMIT = 10.0
_MOST_SEGMENTS = 256

# Where nothing fixes the range, the object is put this far away: a meteor's distance in the sky, or
# a multiple of the array in a local frame. The result is then reported as unobservable.
_NOMINAL_RANGE_M = 100e3
_NOMINAL_BASELINES = 10.0


@dataclass(frozen=True, eq=False)
class PathFit:
    """A smooth path through the measurements.

    Attributes
    ----------
    spline
        Position as a function of time, metres; its derivatives give velocity and acceleration.
    clock_s
        Shape (sensors,): clock offsets that go with it.
    score
        Bayesian information criterion of the fit; smaller is better.
    range_m
        Median distance from the sensors.
    behind
        Share of the measurements that have the object behind the sensor.
    """

    spline: BSpline
    clock_s: NDArray[np.float64]
    score: float
    range_m: float
    behind: float

    def state(self, time_s: NDArray[np.float64], order: int) -> NDArray[np.float64]:
        """Return position and its derivatives up to order - 1, shape (n, 3 order), SI units.

        Outside the span of the measurements the path is continued straight on.
        """
        low, high = self.spline.t[0], self.spline.t[-1]
        inside = np.clip(time_s, low, high)
        beyond = (time_s - inside)[:, None]
        position, velocity = self.spline(inside), self.spline(inside, 1)
        blocks = [position + beyond * velocity, velocity, self.spline(inside, 2)]
        blocks[2][beyond[:, 0] != 0.0] = 0.0
        return np.concatenate(blocks[:order], axis=1)


@dataclass(frozen=True, eq=False)
class _Lines:
    """Linear constraints e . (p(t) - S) = 0 of a set of measurements."""

    time_s: NDArray[np.float64]
    sensor: NDArray[np.int64]
    sensor_m: NDArray[np.float64]
    axes: NDArray[np.float64]
    direction: NDArray[np.float64]
    across: NDArray[np.float64]
    sigma: NDArray[np.float64]
    azimuth_only: NDArray[np.bool_]

    def take(self, index: NDArray[np.int64]) -> _Lines:
        return _Lines(**{name: column[index] for name, column in vars(self).items()})


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of a least-squares problem: weight (direction . (functions . coefficients) - value)."""

    functions: NDArray[np.float64]
    direction: NDArray[np.float64]
    value: NDArray[np.float64]
    weight: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Heights:
    time_s: NDArray[np.float64]
    value: NDArray[np.float64]
    sigma: NDArray[np.float64]


@dataclass(eq=False)
class FirstGuess:
    """Finds paths and clock offsets to start the smoother from.

    Parameters
    ----------
    bearings
        The table, elevations free of refraction.
    constraints
        Known heights, or None.
    sensors
        In the order of their indices.
    geometry
        Their poses.
    speed_m_s
        Speed of propagation.
    static
        Whether the object stands still.
    """

    bearings: Bearings
    constraints: Constraints | None
    sensors: Sequence[Sensor]
    geometry: SensorGeometry
    speed_m_s: float
    static: bool
    _heights: _Heights | None = field(init=False)

    def __post_init__(self) -> None:
        self._pull = _WEAK_PULL
        self._heights = self._known_heights()
        self._nominal = self._nominal_range()

    def _known_heights(self) -> _Heights | None:
        table = self.constraints
        if table is None:
            return None
        rows = np.array([kind == "altitude_m" for kind in table.kind], dtype=bool)
        if not rows.any():
            return None
        time, value, sigma = table.time_s[rows], table.value[rows], table.sigma[rows]
        whole = np.isnan(time)
        span = np.linspace(self.bearings.time_s.min(), self.bearings.time_s.max(), 20)
        count = int(whole.sum())
        return _Heights(
            np.concatenate([time[~whole], np.tile(span, count)]),
            np.concatenate([value[~whole], np.repeat(value[whole], span.size)]),
            np.concatenate([sigma[~whole], np.repeat(sigma[whole], span.size)]),
        )

    def _nominal_range(self) -> float:
        if self.geometry.frame == "ecef":
            return _NOMINAL_RANGE_M
        poses = self.geometry.poses(self.bearings.sensor, self.bearings.time_s)
        spread = float(np.linalg.norm(np.ptp(poses.position_m, axis=0)))
        return _NOMINAL_BASELINES * spread if spread > 0.0 else 1.0

    def lines(self, clock_s: NDArray[np.float64], index: NDArray[np.int64] | None = None) -> _Lines:
        """Return the constraints with every sensor's clock set to a given offset."""
        table = self.bearings
        rows = np.arange(len(table)) if index is None else index
        sensor = table.sensor[rows]
        time = table.time_s[rows] - clock_s[sensor]
        poses = self.geometry.poses(sensor, time)
        azimuth = table.azimuth_rad[rows]
        azimuth_only = np.isnan(table.elevation_rad[rows])
        elevation = np.where(azimuth_only, 0.0, table.elevation_rad[rows])
        sin_a, cos_a, sin_e, cos_e = (
            np.sin(azimuth), np.cos(azimuth), np.sin(elevation), np.cos(elevation)
        )  # fmt: skip
        zero = np.zeros_like(azimuth)
        own = np.stack(
            [
                np.stack([cos_e * cos_a, cos_e * sin_a, sin_e], axis=1),
                np.stack([-sin_a, cos_a, zero], axis=1),
                np.stack([-sin_e * cos_a, -sin_e * sin_a, cos_e], axis=1),
            ],
            axis=1,
        )
        in_frame = own @ poses.axes
        bias = np.array(
            [np.hypot(s.errors.azimuth_bias_rad, s.errors.elevation_bias_rad) for s in self.sensors]
        )[sensor]
        sigma_azimuth = table.sigma_azimuth_rad[rows] * np.where(
            table.isotropic[rows] | azimuth_only, 1.0, np.maximum(cos_e, 1e-3)
        )
        sigma = np.stack([sigma_azimuth, table.sigma_elevation_rad[rows]], axis=1)
        sigma[azimuth_only, 1] = np.inf
        return _Lines(
            time,
            sensor,
            np.asarray(poses.position_m),
            poses.axes,
            in_frame[:, 0],
            in_frame[:, 1:],
            np.hypot(sigma, bias[:, None]),
            azimuth_only,
        )

    def fits(self) -> list[PathFit]:
        """Return first guesses, the most promising first; at least one.

        Raises
        ------
        InputError
            If there is no measurement.
        """
        if not len(self.bearings):
            raise InputError("no bearing to start from; expected at least one")
        found = [self.best_fit(clock) for clock in self._clock_hypotheses()]
        found.sort(key=lambda fit: fit.score)
        if found[0].behind > _SUSPICIOUS_SHARE:
            # Lines know no direction: rays may meet elsewhere, or nowhere but far away.
            self._pull = _STRONG_PULL
            found.append(self.best_fit(found[0].clock_s))
            self._pull = _WEAK_PULL
        return found

    def best_fit(
        self, clock_s: NDArray[np.float64], rows: NDArray[np.int64] | None = None
    ) -> PathFit:
        """Return the fit of the right flexibility for given clock offsets.

        Parameters
        ----------
        clock_s
            Shape (sensors,), seconds.
        rows
            Indices of the bearings to fit; None: all.
        """
        lines = self.lines(clock_s, rows)
        candidates = []
        worse = 0
        for degree, segments in self._flexibilities(lines):
            attempt = self._fit(lines, degree, segments)
            candidates.append(attempt)
            scores = _scores(candidates)
            worse = 0 if np.argmin(scores) == len(scores) - 1 else worse + 1
            if worse >= 3:
                break
        scores = _scores(candidates)
        best = int(np.argmin(scores))
        chosen = candidates[best]
        return PathFit(chosen.spline, clock_s, float(scores[best]), chosen.range_m, chosen.behind)

    def _flexibilities(self, lines: _Lines) -> list[tuple[int, int]]:
        """Return (degree, segments) of growing flexibility that the data could determine."""
        if self.static:
            return [(0, 1)]
        distinct = np.unique(lines.time_s).size
        rows = int(np.isfinite(lines.sigma).sum())
        most = max(1, min(distinct, rows // 3))
        options = [(degree, 1) for degree in range(6)]
        segments = 4
        while segments <= _MOST_SEGMENTS:
            options.append((3, segments))
            segments *= 2
        return [option for option in options if option[0] + option[1] <= most] or [(0, 1)]

    def _fit(
        self, lines: _Lines, degree: int, segments: int, rounds: int = _RANGE_ROUNDS
    ) -> _Attempt:
        """Fit one spline, with ranges, light times and robust weights found by iteration."""
        low, high = float(lines.time_s.min()), float(lines.time_s.max())
        if not high > low:
            high = low + 1.0
        knots = np.concatenate(
            [np.full(degree, low), np.linspace(low, high, segments + 1), np.full(degree, high)]
        )
        count = degree + segments
        time = lines.time_s
        distance = np.full(time.size, self._nominal)
        weight = np.ones(time.size)
        anchor = self._anchor(lines)
        coefficients = np.zeros((count, 3))
        normalised = np.zeros((time.size, 2))
        for iteration in range(rounds):
            basis = BSpline.design_matrix(np.clip(time, low, high), knots, degree).toarray()
            white = 1.0 / (lines.sigma * distance[:, None])
            coefficients = _weighted_lines(
                basis, lines, white * np.sqrt(weight)[:, None], anchor, self._outward(basis, lines)
            )
            if self._heights is not None:
                coefficients = self._with_heights(
                    BSpline(knots, coefficients, degree), basis, lines, white=white, anchor=anchor
                )
            sight = basis @ coefficients - lines.sensor_m
            before = distance
            distance = np.maximum(np.linalg.norm(sight, axis=1), 1e-6 * self._nominal)
            white = 1.0 / (lines.sigma * distance[:, None])
            normalised = np.einsum("nkc,nc->nk", lines.across, sight) * white
            if iteration >= 1:
                weight = _robust_weights(normalised)
            if iteration >= 3 and (np.abs(distance - before) < _RANGE_TOLERANCE * before).all():
                break
            if np.isfinite(self.speed_m_s):
                time = lines.time_s - distance / self.speed_m_s
        along = np.einsum("nc,nc->n", lines.direction, sight)
        return _Attempt(
            BSpline(knots, coefficients, degree),
            normalised,
            3 * count,
            float(np.median(distance)),
            float(np.mean(along[~lines.azimuth_only] < 0.0))
            if not lines.azimuth_only.all()
            else 0.0,
        )

    def _anchor(self, lines: _Lines) -> NDArray[np.float64]:
        """Return a point in sight of the sensors, for what the data leave open."""
        return np.asarray(
            lines.sensor_m.mean(axis=0) + self._nominal * lines.direction.mean(axis=0)
        )

    def _with_heights(
        self,
        spline: BSpline,
        basis: NDArray[np.float64],
        lines: _Lines,
        *,
        white: NDArray[np.float64],
        anchor: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Solve again with heights linearised about the path so far."""
        heights = self._heights
        assert heights is not None
        inside = np.clip(heights.time_s, spline.t[0], spline.t[-1])
        at = BSpline.design_matrix(inside, spline.t, spline.k).toarray()
        position = np.asarray(spline(inside))
        if self.geometry.frame == "ecef" and not _plausible(position):
            position = np.broadcast_to(lines.sensor_m.mean(axis=0), position.shape).copy()
        height, up = altitude(position, self.geometry.frame)
        target = np.einsum("nc,nc->n", up, position) - height + heights.value
        known = _Rows(at, up, target, 1.0 / heights.sigma)
        return _weighted_lines(basis, lines, white, anchor, self._outward(basis, lines), known)

    def _outward(self, basis: NDArray[np.float64], lines: _Lines) -> _Rows:
        """Return the weak wish that the object be in front of the sensors, at a nominal distance.

        It decides between the object and the sensor itself, which lies on all of its own lines.
        """
        value = np.einsum("nc,nc->n", lines.direction, lines.sensor_m) + self._nominal
        weight = np.full(value.size, self._pull / (self._nominal * np.median(lines.sigma[:, 0])))
        return _Rows(basis, lines.direction, value, weight)

    def _clock_hypotheses(self) -> list[NDArray[np.float64]]:
        """Search the clocks that matter, one after another, keeping the best few hypotheses."""
        count = len(self.sensors)
        zero = np.zeros(count)
        prior = np.array([sensor.errors.clock_offset_s for sensor in self.sensors])
        used = np.unique(self.bearings.sensor)
        doubtful = [
            int(i) for i in used if prior[i] > 0.0 and self._clock_matters(int(i), prior[i])
        ]
        if not doubtful or self.static:
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
        return [clocks for _, clocks in beam]

    def _clock_matters(self, sensor: int, prior_s: float) -> bool:
        """Tell whether a sensor's clock could be wrong by more than its angles can see."""
        rows = np.flatnonzero(self.bearings.sensor == sensor)
        lines = self.lines(
            np.zeros(len(self.sensors)), rows[np.argsort(self.bearings.time_s[rows])]
        )
        span = float(np.ptp(lines.time_s))
        if not span > 0.0:
            return True
        travel = np.linalg.norm(lines.direction[-1] - lines.direction[0])
        resolution = float(np.median(lines.sigma[np.isfinite(lines.sigma)]))
        return bool(prior_s * travel / span > 3.0 * resolution)

    def _sample(self, sensor: int) -> NDArray[np.int64]:
        rows = np.flatnonzero(self.bearings.sensor == sensor)
        rows = rows[np.argsort(self.bearings.time_s[rows], kind="stable")]
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
        spline = self.best_fit(clock_s, earlier).spline
        low, high = float(spline.t[0]), float(spline.t[-1])
        rows = self._sample(sensor)
        without = clock_s.copy()
        without[sensor] = 0.0
        lines = self.lines(without, rows)
        grid = np.linspace(low, high, _PATH_SAMPLES)
        miss = _angle(spline(grid)[None] - lines.sensor_m[:, None], lines.direction[:, None])
        floor = max(float(np.median(miss.min(axis=1))), float(np.median(lines.sigma[:, 0])))
        limit = (_MISS_LIMIT * floor) ** 2
        offsets = np.linspace(-4.0, 4.0, _OFFSET_STEPS) * prior_s
        misfit = np.empty(offsets.size)
        for index, offset in enumerate(offsets):
            time = lines.time_s - offset
            sight = spline(np.clip(time, low, high)) - lines.sensor_m
            square = np.minimum(_angle(sight, lines.direction) ** 2, limit)
            square[(time < low) | (time > high)] = limit
            misfit[index] = float(np.mean(square)) / limit
        score = rows.size * np.log(misfit + 1e-6) + (offsets / prior_s) ** 2
        found = []
        for index in _local_minima(score):
            if misfit[index] < 0.5:
                trial = clock_s.copy()
                trial[sensor] = offsets[index]
                found.append((float(score[index]), trial))
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
            lines = self.lines(trial, rows)
            attempts = [self._fit(lines, degree, 1, _SEARCH_ROUNDS) for degree in (1, 3)]
            if _scores(attempts)[1] < _scores(attempts)[0]:
                attempts.append(self._fit(lines, 3, 4, _SEARCH_ROUNDS))
            return _misfit(attempts) + float(offset / prior_s[sensor]) ** 2

        grid = np.linspace(-3.0, 3.0, _SEARCH_STEPS) * prior_s[sensor]
        values = np.array([score(float(offset)) for offset in grid])
        found = []
        for index in _local_minima(values):
            clocks = clock_s.copy()
            clocks[sensor] = grid[index]
            found.append((float(values[index]), clocks))
        return found


@dataclass(frozen=True, eq=False)
class _Attempt:
    spline: BSpline
    normalised: NDArray[np.float64]
    coefficients: int
    range_m: float
    behind: float


def _local_minima(values: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return indices of the deepest local minima of a sequence, deepest first."""
    padded = np.concatenate([[np.inf], values, [np.inf]])
    minima = np.flatnonzero((values <= padded[:-2]) & (values <= padded[2:]))
    return np.asarray(minima[np.argsort(values[minima])][:_HYPOTHESES])


def _angle(sight: NDArray[np.float64], direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return angles between vectors and unit vectors, shapes (..., 3), radians."""
    along = np.sum(sight * direction, axis=-1)
    across = np.linalg.norm(sight - along[..., None] * direction, axis=-1)
    return np.asarray(np.arctan2(across, along))


def _plausible(position_m: NDArray[np.float64]) -> bool:
    """Tell whether ECEF positions lie where heights are well defined."""
    return bool((np.linalg.norm(position_m, axis=1) > 1e6).all())


def _squares(attempt: _Attempt, limit: float) -> float:
    return float(np.minimum(attempt.normalised**2, limit**2).sum())


def _misfit(attempts: Sequence[_Attempt]) -> float:
    """Return the best criterion among fits, each on its own scale.

    It compares different clock offsets, for which no common scale is known beforehand.
    """
    return min(float(_scores([entry])[0]) for entry in attempts)


def _scores(attempts: Sequence[_Attempt]) -> NDArray[np.float64]:
    """Return the Bayesian information criterion of fits, their noise level unknown.

    Residuals are bounded at six times the scale of the tightest fit, so that outliers do not ask
    for flexibility.
    """
    scale = min(_scale(entry.normalised) for entry in attempts)
    rows = max(int(np.count_nonzero(attempts[0].normalised)), 2)
    floor = 1e-12
    values = []
    for entry in attempts:
        mean = _squares(entry, max(6.0 * scale, floor)) / rows
        values.append(rows * np.log(mean + floor) + entry.coefficients * np.log(rows))
    return np.array(values)


def _scale(normalised: NDArray[np.float64]) -> float:
    """Return the robust standard deviation of residuals (1.4826 median absolute value)."""
    used = np.abs(normalised[normalised != 0.0])
    return float(1.4826 * np.median(used)) if used.size else 0.0


def _robust_weights(normalised: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Cauchy weights on the scale of the residuals themselves, shape (n,)."""
    scale = max(_scale(normalised), 1e-9)
    return np.asarray(1.0 / (1.0 + np.sum(normalised**2, axis=1) / (3.0 * scale) ** 2))


def _weighted_lines(
    basis: NDArray[np.float64],
    lines: _Lines,
    white: NDArray[np.float64],
    anchor: NDArray[np.float64],
    *extra: _Rows,
) -> NDArray[np.float64]:
    """Solve for the spline's coefficients, shape (b, 3), by regularised least squares.

    The pull towards the anchor, a millionth of the data's own weight, decides only what the data
    leave open.
    """
    size = 3 * basis.shape[1]
    information = np.zeros((size, size))
    target = np.zeros(size)
    across = lines.across
    values = np.einsum("nkc,nc->nk", across, lines.sensor_m)
    rows = [_Rows(basis, across[:, k], values[:, k], white[:, k]) for k in range(2)]
    for part in (*rows, *extra):
        design = (part.functions[:, :, None] * part.direction[:, None, :]).reshape(-1, size)
        design = design * part.weight[:, None]
        information += design.T @ design
        # Relative to the anchor, so that large coordinates do not cost digits.
        target += design.T @ ((part.value - part.direction @ anchor) * part.weight)
    information[np.diag_indices(size)] += 1e-12 * float(np.trace(information)) / size
    solution = np.linalg.solve(information, target).reshape(-1, 3)
    # A spline's basis adds up to one everywhere: a constant is the same in every coefficient.
    return np.asarray(solution + anchor)
