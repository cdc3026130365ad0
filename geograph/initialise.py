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

from geograph.clock_search import ClockSearch
from geograph.errors import InputError
from geograph.known_coordinates import Coordinates
from geograph.known_heights import Heights
from geograph.lines import Attempt, Lines, Rows, criteria, robust_weights, stacked, weighted_lines

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

# Distances below this share of the nominal one are none: the path has ended on the sensors
# themselves. It is then pulled this much harder than noise pulls it to the sensors.
_COLLAPSED = 2e-6
_OVER_NOISE = 10.0

# A fit stands if it misses known heights by no more than this many times their sigma and what the
# best fit misses.
_MOST_MISSED = 10.0

RANGE_ROUNDS = 6
_RANGE_TOLERANCE = 1e-3

# Share of the span by which light times may change without moving a path that one looks at.
_SAME_TIME = 1e-6

# The flexibility of the most flexible spline needs no more bearings than this.
_MOST_BEARINGS = 6000

# Sigmas that residuals have where a fit is none, and where it is one. A path that goes round and
# round is no better met by a few more coefficients, and all at once by enough of them.
_NO_FIT, _FITS = 10.0, 2.0

# Segments of a spline where nothing fits with fewer. With more of them, some would hang on two or
# three bearings.
_LONG_SEGMENTS = 1024

# Where nothing fixes the range, the object is put this far away: a meteor's distance in the sky, or
# a multiple of the array in a local frame. The result is then reported as unobservable.
_NOMINAL_RANGE_M = 100e3
_NOMINAL_BASELINES = 10.0
_NOMINAL_LOCAL_RANGE_M = 10e3


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
    nearest_m
        Median distance from the sensor that is nearest, where lines were fitted.
    """

    spline: BSpline
    clock_s: NDArray[np.float64]
    score: float
    range_m: float
    behind: float
    nearest_m: float = float("inf")

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


@dataclass(eq=False)
class FirstGuess:
    """Finds paths and clock offsets to start the smoother from.

    Parameters
    ----------
    bearings
        The table, elevations free of refraction.
    constraints
        Known heights and coordinates, or None.
    sensors
        In the order of their indices.
    geometry
        Their poses.
    speed_m_s
        Speed of propagation.
    static
        Whether the object stands still.
    most_segments
        Of the most flexible spline, unless nothing fits.
    patient
        Whether more flexible ones are tried for as long as nothing fits.
    """

    bearings: Bearings
    constraints: Constraints | None
    sensors: Sequence[Sensor]
    geometry: SensorGeometry
    speed_m_s: float
    static: bool
    most_segments: int = 256
    patient: bool = True
    heights: Heights | None = field(init=False)
    coordinates: Coordinates = field(init=False)

    def __post_init__(self) -> None:
        self._pull = _WEAK_PULL
        self.heights = Heights.of(self.constraints)
        self.coordinates = Coordinates.of(self.constraints)
        self._nominal = self._nominal_range()

    def _nominal_range(self) -> float:
        if self.geometry.frame == "ecef":
            return _NOMINAL_RANGE_M
        poses = self.geometry.poses(self.bearings.sensor, self.bearings.time_s)
        spread = float(np.linalg.norm(np.ptp(poses.position_m, axis=0)))
        return _NOMINAL_BASELINES * spread if spread > 0.0 else _NOMINAL_LOCAL_RANGE_M

    def lines(self, clock_s: NDArray[np.float64], index: NDArray[np.int64] | None = None) -> Lines:
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
            [
                np.linalg.norm([e.azimuth_bias_rad, e.elevation_bias_rad, e.misalignment_rad])
                for e in (sensor.errors for sensor in self.sensors)
            ]
        )[sensor]
        sigma_azimuth = table.sigma_azimuth_rad[rows] * np.where(
            table.isotropic[rows] | azimuth_only, 1.0, np.maximum(cos_e, 1e-3)
        )
        sigma = np.stack([sigma_azimuth, table.sigma_elevation_rad[rows]], axis=1)
        sigma[azimuth_only, 1] = np.inf
        return Lines(
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
        found = [self.best_fit(clock) for clock in ClockSearch(self).hypotheses()]
        found.sort(key=lambda fit: fit.score)
        collapsed = self._collapsed(found[0].nearest_m)
        if collapsed or found[0].behind > _SUSPICIOUS_SHARE:
            # Lines know no direction: rays may meet elsewhere, or nowhere but far away; and those
            # of one place meet there, which wins where that place's sigmas are far the smallest.
            noise = float(np.median(self.bearings.sigma_azimuth_rad)) if collapsed else 0.0
            self._pull = max(_STRONG_PULL, _OVER_NOISE * noise)
            again = self.best_fit(found[0].clock_s)
            self._pull = _WEAK_PULL
            found = [again] if collapsed else [*found, again]
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
            Indices of the bearings to fit; None: all, or evenly spread ones of very many.
        """
        lines = self.lines(clock_s, self._thinned() if rows is None else rows)
        candidates: list[Attempt] = []
        worse = 0
        for degree, segments in self._flexibilities(lines):
            standing = self._standing(candidates)
            scale = min((entry.scale for entry in standing), default=np.inf)
            if worse >= 3 and (scale < _NO_FIT or not self.patient):
                break
            if segments > self.most_segments and scale < _FITS:
                break
            candidates.append(self.fit(lines, degree, segments))
            standing = self._standing(candidates)
            leading = standing[int(np.argmin(criteria(standing)))]
            worse = 0 if leading is candidates[-1] else worse + 1
        standing = self._standing(candidates)
        scores = criteria(standing)
        best = int(np.argmin(scores))
        chosen = standing[best]
        return PathFit(
            chosen.spline,
            clock_s,
            float(scores[best]),
            chosen.range_m,
            chosen.behind,
            chosen.nearest_m,
        )

    def _standing(self, candidates: list[Attempt]) -> list[Attempt]:
        """Return the fits whose residuals mean something, or all of them.

        Residuals are angles. At a sensor, or very far away, a path is off by none whatever it does.
        """
        found = [entry for entry in candidates if not self._collapsed(entry.nearest_m)]
        heights = self.heights
        if found and heights is not None:
            missed = [heights.missed(entry.spline, self.geometry.frame) for entry in found]
            found = [
                entry
                for entry, miss in zip(found, missed, strict=True)
                if miss <= _MOST_MISSED * (1.0 + min(missed))
            ]
        return found or candidates

    def _collapsed(self, nearest_m: float) -> bool:
        return nearest_m <= _COLLAPSED * self._nominal

    def _thinned(self) -> NDArray[np.int64] | None:
        """Return bearings spread evenly over every sensor's, where there are more than it takes."""
        count = len(self.bearings)
        if count <= _MOST_BEARINGS:
            return None
        order = np.lexsort((self.bearings.time_s, self.bearings.sensor))
        pick = np.unique(np.linspace(0, count - 1, _MOST_BEARINGS).round().astype(np.int64))
        return np.asarray(order[pick])

    def _flexibilities(self, lines: Lines) -> list[tuple[int, int]]:
        """Return (degree, segments) of growing flexibility that the data could determine."""
        if self.static:
            return [(0, 1)]
        distinct = np.unique(lines.time_s).size
        rows = int(np.isfinite(lines.sigma).sum())
        most = max(1, min(distinct, rows // 3))
        options = [(degree, 1) for degree in range(6)]
        segments = 4
        alone = self.heights is None and not len(self.coordinates)
        while segments <= (_LONG_SEGMENTS if alone else self.most_segments):
            options.append((3, segments))
            segments *= 2
        return [option for option in options if option[0] + option[1] <= most] or [(0, 1)]

    def fit(self, lines: Lines, degree: int, segments: int, rounds: int = RANGE_ROUNDS) -> Attempt:
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
        basis, taken = np.empty((0, 0)), np.full(time.size, np.inf)
        for iteration in range(rounds):
            if not np.abs(time - taken).max(initial=0.0) <= _SAME_TIME * (high - low):
                taken = time
                basis = BSpline.design_matrix(np.clip(time, low, high), knots, degree).toarray()
            white = 1.0 / (lines.sigma * distance[:, None])
            coefficients = weighted_lines(
                basis, lines, white * np.sqrt(weight)[:, None], anchor, self._outward(basis, lines)
            )
            if self.heights is not None or len(self.coordinates):
                coefficients = self._with_known(
                    BSpline(knots, coefficients, degree), basis, lines, white=white, anchor=anchor
                )
            sight = basis @ coefficients - lines.sensor_m
            before = distance
            distance = np.maximum(np.linalg.norm(sight, axis=1), 1e-6 * self._nominal)
            white = 1.0 / (lines.sigma * distance[:, None])
            normalised = np.einsum("nkc,nc->nk", lines.across, sight) * white
            if iteration >= 1:
                weight = robust_weights(normalised)
            if iteration >= 3 and (np.abs(distance - before) < _RANGE_TOLERANCE * before).all():
                break
            if np.isfinite(self.speed_m_s):
                time = lines.time_s - distance / self.speed_m_s
        along = np.einsum("nc,nc->n", lines.direction, sight)
        return Attempt(
            BSpline(knots, coefficients, degree),
            normalised,
            3 * count,
            float(np.median(distance)),
            float(np.mean(along[~lines.azimuth_only] < 0.0))
            if not lines.azimuth_only.all()
            else 0.0,
            min(float(np.median(distance[lines.sensor == i])) for i in np.unique(lines.sensor)),
        )

    def _anchor(self, lines: Lines) -> NDArray[np.float64]:
        """Return a point in sight of the sensors, for what the data leave open."""
        return np.asarray(
            lines.sensor_m.mean(axis=0) + self._nominal * lines.direction.mean(axis=0)
        )

    def _with_known(
        self,
        spline: BSpline,
        basis: NDArray[np.float64],
        lines: Lines,
        *,
        white: NDArray[np.float64],
        anchor: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Solve again with coordinates, and heights linearised about the path so far."""
        parts = [self.coordinates.rows(spline)] if len(self.coordinates) else []
        if self.heights is not None:
            parts.append(self.heights.rows(spline, self.geometry.frame, lines.sensor_m))
        known = stacked(parts)
        return weighted_lines(basis, lines, white, anchor, self._outward(basis, lines), known)

    def _outward(self, basis: NDArray[np.float64], lines: Lines) -> Rows:
        """Return the weak wish that the object be in front of the sensors, at a nominal distance.

        It decides between the object and the sensor itself, which lies on all of its own lines.
        """
        value = np.einsum("nc,nc->n", lines.direction, lines.sensor_m) + self._nominal
        weight = np.full(value.size, self._pull / (self._nominal * np.median(lines.sigma[:, 0])))
        return Rows(basis, lines.direction, value, weight)
