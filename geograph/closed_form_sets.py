"""Where an emitter is, in closed form, from many sets of arrival times at moving sensors.

Every set k, one emission, gives the equations of :mod:`geograph.closed_form`,

    2 s_ki . x_k - 2 z_ki b_k - lambda_k = |s_ki|^2 - z_ki^2,

with x_k = p + v t_k one position, or even motion, common to all sets. They are linear in p, v, all
b_k and lambda_k, and are solved together, weighted by the covariance 4 D N D of each set.

**Range as a polynomial.** A b_k of its own for every set leaves the range of a far emitter to the
difference of nearly equal columns, and noise in them draws it inward. With times counted from the
mean of their set, z_ki - mean_i(z_ki), the unknown -b_k is the mean range of the set's sensors,
which changes evenly in time: a polynomial of order 1 (range and range rate) or 2 takes the place of
the many b_k (S. Camlica, *Recursive passive localization methods using time difference of arrival*,
METU 2009, does so with the range to a reference sensor).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.errors import InputError
from geograph.factors.constraints import altitude
from geograph.spherical import check_arrivals, whitening

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

_ROUNDS = 6
_HEIGHT_ROUNDS = 20
_LEAST_RADIUS_M = 1e6

# Singular values below this share of the greatest are rounding: columns are scaled to one.
_RANK_TOLERANCE = 1e-11
_FLAT_TOLERANCE = 1e-9

# Answers this many sizes of the array away are rounding.
_FARTHEST = 1e12


@dataclass(frozen=True, eq=False)
class SetFix:
    """An emitter's position and velocity from many sets.

    Attributes
    ----------
    time_s
        Time that the position belongs to: the mean of the sets' first arrivals, less the light
        time.
    position_m, velocity_m_s
        Shape (d,); the velocity of a static emitter is zero.
    cost
        Sum of squared range residuals over sigmas, each set with its own time of emission.
    """

    time_s: float
    position_m: NDArray[np.float64]
    velocity_m_s: NDArray[np.float64]
    cost: float


def multi_set(
    sensor_m: ArrayLike,
    toa_s: ArrayLike,
    sigma_s: ArrayLike,
    emission: ArrayLike,
    *,
    speed_m_s: float,
    sensor: ArrayLike | None = None,
    velocity: bool = False,
    range_order: Literal[1, 2] | None = None,
    height_m: float | None = None,
    frame: Literal["ecef", "local"] = "local",
) -> list[SetFix]:
    """Return the roots of the weighted linear equations of all sets together, the cheapest first.

    There is one root, or two where all sensors stay in one plane (on one line in 2-D). What the
    sets leave open is the solution of least distance from the array.

    Parameters
    ----------
    sensor_m
        Shape (n, 2) or (n, 3): sensors when they heard it, metres.
    toa_s, sigma_s
        Shape (n,): times of arrival and their standard deviations, seconds.
    emission
        Shape (n,), integer: rows with the same number are a set.
    speed_m_s
        Speed of propagation.
    sensor
        Shape (n,), integer: which sensor; sets of the same sensors share one polynomial. None: all
        sets are of the same sensors.
    velocity
        Whether the emitter moves evenly; otherwise it stands still.
    range_order
        Order of the polynomial of the mean range in time; None: each set its own.
    height_m, frame
        As in :func:`geograph.closed_form.chan_ho`.

    Raises
    ------
    InputError
        If shapes differ, a value is not finite, or a sigma is not positive.
    """
    sets = _Sets(sensor_m, toa_s, sigma_s, emission, sensor=sensor, speed_m_s=speed_m_s)
    solver = _Solver(sets, velocity, range_order)
    if height_m is None:
        found = solver.roots(np.zeros(sets.dimension), np.eye(sets.dimension))
    elif sets.dimension != 3:
        raise InputError(f"height_m is {height_m} in a plane; expected None, or sensors in space")
    else:
        found = _at_height(solver, height_m, frame)
    found.sort(key=lambda fix: fix.cost)
    return found


class _Sets:
    """All sets in units of the array: relative to the mean position, time and arrival."""

    def __init__(
        self,
        sensor_m: ArrayLike,
        toa_s: ArrayLike,
        sigma_s: ArrayLike,
        emission: ArrayLike,
        *,
        sensor: ArrayLike | None,
        speed_m_s: float,
    ) -> None:
        place, toa = np.asarray(sensor_m, dtype=np.float64), np.asarray(toa_s, dtype=np.float64)
        check_arrivals(place, toa, speed_m_s)
        sigma, number = np.asarray(sigma_s, dtype=np.float64), np.asarray(emission)
        which = np.zeros(toa.size, dtype=np.int64) if sensor is None else np.asarray(sensor)
        if not sigma.shape == number.shape == which.shape == toa.shape:
            raise InputError(
                f"sigmas, emissions and sensors have shapes {sigma.shape}, {number.shape} and "
                f"{which.shape}; expected {toa.shape}"
            )
        _, code = np.unique(number, return_inverse=True)
        self.rows = [np.flatnonzero(code == k) for k in range(int(code.max()) + 1)]
        self.centre = place.mean(axis=0)
        spread = float(np.sqrt(np.mean(np.sum((place - self.centre) ** 2, axis=1))))
        self.unit = spread if spread > 0.0 else 1.0
        self.speed = speed_m_s
        self.sensor = (place - self.centre) / self.unit
        first = np.array([toa[rows].min() for rows in self.rows])
        self.first = first
        self.middle = float(first.mean())
        span = float(np.ptp(first))
        self.span = span if span > 0.0 else 1.0
        self.time = (first - self.middle) / self.span
        self.range, self.white = [], []
        scale = speed_m_s / self.unit
        for rows in self.rows:
            self.range.append((toa[rows] - toa[rows].mean()) * scale)
            self.white.append(whitening(np.diag((sigma[rows] * scale) ** 2)))
        heard = [tuple(sorted(which[rows])) for rows in self.rows]
        self.group = np.array([sorted(set(heard)).index(entry) for entry in heard])

    @property
    def dimension(self) -> int:
        """Number of coordinates."""
        return int(self.sensor.shape[1])

    def distances(
        self, position: NDArray[np.float64], rate: NDArray[np.float64]
    ) -> list[NDArray[np.float64]]:
        """Return the distances of every set's sensors."""
        return [
            np.linalg.norm(position + rate * time - self.sensor[rows], axis=1)
            for rows, time in zip(self.rows, self.time, strict=True)
        ]

    def fix(self, position: NDArray[np.float64], rate: NDArray[np.float64]) -> SetFix:
        """Return position and change over the span, in the array's units, with their cost."""
        distances = self.distances(position, rate)
        cost = 0.0
        for z, white, distance in zip(self.range, self.white, distances, strict=True):
            delay, ones = white @ (z - distance), white.sum(axis=1)
            left = delay - ones * (float(ones @ delay) / float(ones @ ones))
            cost += float(left @ left)
        light = np.mean([distance.min() for distance in distances]) * self.unit / self.speed
        return SetFix(
            self.middle - float(light),
            self.centre + self.unit * position,
            rate * (self.unit / self.span),
            cost,
        )


@dataclass(frozen=True, eq=False)
class _Solver:
    sets: _Sets
    velocity: bool
    range_order: int | None

    def roots(self, origin: NDArray[np.float64], basis: NDArray[np.float64]) -> list[SetFix]:
        """Return the roots among origin + basis y, in the array's units, origin normal to it."""
        sets = self.sets
        # Out of the sensors' own plane, squares alone tell the distance.
        inside = (sets.sensor - origin) @ basis
        _, values, rows = np.linalg.svd(inside, full_matrices=True)
        size = np.zeros(basis.shape[1])
        size[: values.size] = values
        seen = size > _FLAT_TOLERANCE * max(size[0], 1e-300)
        across = basis @ rows[~seen][0] if not seen.all() else None
        basis = basis @ rows[seen].T
        count = basis.shape[1]
        distances: list[NDArray[np.float64]] | None = None
        position, rate, square = origin, np.zeros_like(origin), 0.0
        for _ in range(_ROUNDS):
            solution, offsets = self._solve(origin, basis, distances)
            if not np.abs(solution).max(initial=0.0) < _FARTHEST:
                break
            position = origin + basis @ solution[:count]
            if self.velocity:
                rate = basis @ solution[count : 2 * count]
            if across is not None:
                square = self._square(position, rate, offsets, distances)
            out = position if across is None else position + np.sqrt(square) * across
            distances = sets.distances(out, rate)
        if across is None or square == 0.0:
            return [sets.fix(position, rate)]
        step = np.sqrt(square) * across
        return [sets.fix(position + step, rate), sets.fix(position - step, rate)]

    def _solve(
        self,
        origin: NDArray[np.float64],
        basis: NDArray[np.float64],
        distances: list[NDArray[np.float64]] | None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the common unknowns, and b of every set, given the distances so far."""
        sets, order = self.sets, self.range_order
        groups = int(sets.group.max()) + 1
        width = 0 if order is None else (order + 1) * groups
        blocks, targets = [], []
        for k, rows in enumerate(sets.rows):
            s, z = sets.sensor[rows], sets.range[k]
            distance = None if distances is None else distances[k]
            weights = self._weights(k, distance)
            value = np.sum((s - origin) ** 2, axis=1) - z**2
            if distance is not None:
                # Times of arrival without their noise: it would draw the emitter inward.
                measured, z = z, distance - distance.mean()
                value = value - 2.0 * (measured - z) * distance.mean()
            columns = 2.0 * s @ basis
            parts = [columns, columns * sets.time[k]] if self.velocity else [columns]
            ranges = np.zeros((z.size, width))
            own = [-np.ones(z.size)]
            if order is None:
                own.append(-2.0 * z)
            else:
                first = int(sets.group[k]) * (order + 1)
                powers = sets.time[k] ** np.arange(order + 1)
                ranges[:, first : first + order + 1] = 2.0 * z[:, None] * powers
            design = weights @ np.column_stack([*parts, ranges])
            # What the set's own unknowns can take up says nothing of the common ones.
            q = np.linalg.qr(weights @ np.column_stack(own), mode="complete")[0][:, len(own) :]
            blocks.append(q.T @ design)
            targets.append(q.T @ (weights @ value))
        matrix, target = np.concatenate(blocks), np.concatenate(targets)
        scale = np.linalg.norm(matrix, axis=0)
        scale[scale == 0.0] = 1.0
        solution = np.linalg.lstsq(matrix / scale, target, rcond=_RANK_TOLERANCE)[0] / scale
        if order is None:
            return solution, np.full(len(sets.rows), np.nan)
        ranges = solution[-width:].reshape(groups, order + 1)
        powers = sets.time[:, None] ** np.arange(order + 1)
        return solution, -np.sum(ranges[sets.group] * powers, axis=1)

    def _weights(self, k: int, distance: NDArray[np.float64] | None) -> NDArray[np.float64]:
        """Return what whitens the equations of one set, to its own lambda."""
        white = self.sets.white[k]
        if distance is None:
            distance = np.ones(white.shape[0])
        floor = 1.0 / np.linalg.norm(white, axis=0)
        safe = np.hypot(distance, floor)
        if self.range_order is None or safe.size == 1:
            return np.asarray(white / safe)
        # Times are counted from their mean: its error is taken off all of them.
        count = safe.size
        centred = np.eye(count) - 1.0 / count
        spread = centred @ np.linalg.inv(white)
        covariance = (spread @ spread.T) * np.outer(safe, safe)
        return whitening(covariance)

    def _square(
        self,
        position: NDArray[np.float64],
        rate: NDArray[np.float64],
        offsets: NDArray[np.float64],
        distances: list[NDArray[np.float64]] | None,
    ) -> float:
        """Return the square of the distance from the sensors' plane, zero at least.

        Each set's b and lambda are those that its own equations leave, and lambda + b^2 - |x|^2 is
        that square.
        """
        sets = self.sets
        found, weight = [], []
        for k, rows in enumerate(sets.rows):
            s, z = sets.sensor[rows], sets.range[k]
            at = position + rate * sets.time[k]
            weights = self._weights(k, None if distances is None else distances[k])
            left = 2.0 * s @ at - np.sum(s**2, axis=1) + z**2
            if np.isfinite(offsets[k]):
                left, own = left - 2.0 * z * offsets[k], np.ones((z.size, 1))
            else:
                own = np.column_stack([np.ones(z.size), 2.0 * z])
            answer = np.linalg.lstsq(weights @ own, weights @ left, rcond=_RANK_TOLERANCE)[0]
            b = offsets[k] if np.isfinite(offsets[k]) else answer[1]
            found.append(answer[0] + b**2 - at @ at)
            weight.append(float(z.size >= own.shape[1]))
        total = np.average(found, weights=weight) if any(weight) else 0.0
        return float(max(total, 0.0))


def _at_height(solver: _Solver, height_m: float, frame: Literal["ecef", "local"]) -> list[SetFix]:
    """Return the roots at a height, the ellipsoid's tangent plane taken at the roots themselves."""
    sets = solver.sets

    def at(point: NDArray[np.float64]) -> list[SetFix]:
        height, up = altitude(point[None, :], frame)
        foot = (point + (height_m - height[0]) * up[0] - sets.centre) / sets.unit
        _, _, rows = np.linalg.svd(up)
        return solver.roots(up[0] * float(up[0] @ foot), rows[1:].T)

    found = []
    for start in at(sets.centre):
        fix = start
        for _ in range(_HEIGHT_ROUNDS if frame == "ecef" else 0):
            before = fix.position_m
            if np.linalg.norm(before) < _LEAST_RADIUS_M:
                break
            fix = min(at(before), key=lambda one: float(np.linalg.norm(one.position_m - before)))
            if np.linalg.norm(fix.position_m - before) < 1e-6:
                break
        found.append(fix)
    return found
