"""Linear least squares through lines of sight: the pieces of the first guess.

Every measurement gives rows e . (p(t) - S) = 0 for directions e across its line of sight; a path
that is linear in its coefficients is then a linear problem (:mod:`geograph.initialise`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from scipy.interpolate import BSpline

# Median length of a vector of 0 to 3 standard normal components: the root of chi-square's median.
_MEDIAN_LENGTH = np.sqrt([1.0, 0.454936, 1.386294, 2.365974])

# Functions of which it does not pay to look for those that are not zero.
_FEW = 8

# Functions from which on the equations are solved as a band.
_MANY = 64

# What pulls towards the anchor, over the mean weight of the data.
_RIDGE = 1e-12


@dataclass(frozen=True, eq=False)
class Lines:
    """Linear constraints e . (p(t) - S) = 0 of n measurements.

    Attributes
    ----------
    time_s, sensor, sensor_m
        Shapes (n,), (n,), (n, 3): time by the sensor's corrected clock, sensor, its position.
    axes
        Shape (n, 3, 3): the sensor's axes in the frame.
    direction, across
        Shapes (n, 3), (n, 2, 3): unit vectors along the line, and towards azimuth and elevation.
    sigma
        Shape (n, 2), radians: across the line, biases included; inf where there is no elevation.
    azimuth_only
        Shape (n,).
    """

    time_s: NDArray[np.float64]
    sensor: NDArray[np.int64]
    sensor_m: NDArray[np.float64]
    axes: NDArray[np.float64]
    direction: NDArray[np.float64]
    across: NDArray[np.float64]
    sigma: NDArray[np.float64]
    azimuth_only: NDArray[np.bool_]

    @cached_property
    def values(self) -> NDArray[np.float64]:
        """Shape (n, 2): the sensors' places along ``across``."""
        return np.asarray(np.einsum("nkc,nc->nk", self.across, self.sensor_m))

    @cached_property
    def products(self) -> NDArray[np.float64]:
        """Shape (n, 2, 3, 3): outer products of ``across``."""
        return np.asarray(self.across[..., :, None] * self.across[..., None, :])


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of a least-squares problem: weight (direction . (functions . coefficients) - value)."""

    functions: NDArray[np.float64]
    direction: NDArray[np.float64]
    value: NDArray[np.float64]
    weight: NDArray[np.float64]


def stacked(parts: Sequence[Rows]) -> Rows:
    """Return the rows of all parts, at least one."""
    return Rows(
        np.concatenate([part.functions for part in parts]),
        np.concatenate([part.direction for part in parts]),
        np.concatenate([part.value for part in parts]),
        np.concatenate([part.weight for part in parts]),
    )


@dataclass(frozen=True, eq=False)
class Attempt:
    """One fit: the path, whitened residuals (n, 2), and how flexible it is.

    Attributes
    ----------
    spline
        Position as a function of time.
    normalised
        Shape (n, 2): residuals over sigma times distance.
    coefficients
        Number of coefficients.
    range_m
        Median distance from the sensors.
    behind
        Share of the measurements with the object behind the sensor.
    nearest_m
        Median distance from the sensor that is nearest, where that was asked for.
    """

    spline: BSpline
    normalised: NDArray[np.float64]
    coefficients: int
    range_m: float
    behind: float
    nearest_m: float = float("inf")

    @cached_property
    def scale(self) -> float:
        """Robust standard deviation of the residuals."""
        return robust_scale(self.normalised)


def angle(sight: NDArray[np.float64], direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return angles between vectors and unit vectors, shapes (..., 3), radians."""
    along = np.sum(sight * direction, axis=-1)
    across = np.linalg.norm(sight - along[..., None] * direction, axis=-1)
    return np.asarray(np.arctan2(across, along))


def bounded_squares(attempt: Attempt, limit: float) -> float:
    """Return the sum of squared residuals, each measurement's bounded.

    The bound is the square of a limit for each of its components; they are taken together, so that
    a measurement of which one component is met does not count as half explained.
    """
    table = attempt.normalised.reshape(len(attempt.normalised), -1)
    most = limit**2 * np.count_nonzero(table, axis=1)
    return float(np.minimum(np.sum(table**2, axis=1), most).sum())


def misfit(attempts: Sequence[Attempt]) -> float:
    """Return the best criterion among fits, each on its own scale.

    It compares different clock offsets, for which no common scale is known beforehand.
    """
    return min(float(criteria([entry])[0]) for entry in attempts)


def criteria(attempts: Sequence[Attempt]) -> NDArray[np.float64]:
    """Return the Bayesian information criterion of fits, their noise level unknown.

    Residuals are bounded at six times the scale of the tightest fit, so that outliers do not ask
    for flexibility. That scale allows for what the fit's own coefficients took from the residuals.
    """
    rows = max(int(np.count_nonzero(attempts[0].normalised)), 2)
    scale = min(
        entry.scale * np.sqrt(rows / max(rows - entry.coefficients, 1)) for entry in attempts
    )
    floor = 1e-12
    values = []
    for entry in attempts:
        mean = bounded_squares(entry, max(6.0 * scale, floor)) / rows
        values.append(rows * np.log(mean + floor) + entry.coefficients * np.log(rows))
    return np.array(values)


def robust_scale(normalised: NDArray[np.float64]) -> float:
    """Return the robust standard deviation of residuals: the median size of a measurement's.

    A path may meet one component of every measurement and miss the other, as a point level with
    the sensors meets elevations alone: half of all components would then make any scale small. A
    measurement with several components therefore counts once, by the length of its residual over
    the median length of as many standard normal ones.

    Parameters
    ----------
    normalised
        Shape (n,) or (n, k), k up to 3: whitened residuals; zeros stand for what was not measured.
    """
    table = normalised.reshape(len(normalised), -1)
    if table.shape[1] == 1:
        length = np.abs(table[table != 0.0])
        return float(np.median(length) / _MEDIAN_LENGTH[1]) if length.size else 0.0
    seen = np.count_nonzero(table, axis=1)
    used = seen > 0
    if not used.any():
        return 0.0
    length = np.linalg.norm(table[used], axis=1)
    return float(np.median(length / _MEDIAN_LENGTH[seen[used]]))


def robust_weights(normalised: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Cauchy weights on the scale of the residuals themselves, shape (n,)."""
    scale = max(robust_scale(normalised), 1e-9)
    return np.asarray(1.0 / (1.0 + np.sum(normalised**2, axis=1) / (3.0 * scale) ** 2))


def weighted_lines(
    basis: NDArray[np.float64],
    lines: Lines,
    white: NDArray[np.float64],
    anchor: NDArray[np.float64],
    *extra: Rows,
) -> NDArray[np.float64]:
    """Solve for the spline's coefficients, shape (b, 3), by regularised least squares.

    The pull towards the anchor, a millionth of the data's own weight, decides only what the data
    leave open.
    """
    size = 3 * basis.shape[1]
    target = np.zeros(size)
    # Rows of the same functions are added up before they meet these; relative to the anchor, so
    # that large coordinates do not cost digits.
    weight = white**2
    square = np.einsum("nk,nkij->nij", weight, lines.products)
    pull = np.einsum("nk,nkc->nc", weight * (lines.values - lines.across @ anchor), lines.across)
    designs = []
    for part in extra:
        value = (part.value - part.direction @ anchor) * part.weight
        weighed = part.direction * part.weight[:, None]
        if part.functions is basis:
            square += weighed[:, :, None] * weighed[:, None, :]
            pull += weighed * value[:, None]
            continue
        designs.append((part.functions[:, :, None] * weighed[:, None, :]).reshape(-1, size))
        target += designs[-1].T @ value
    target += (basis.T @ pull).ravel()
    banded = basis.shape[1] > _MANY and not designs
    solution = _solved_in_band(basis, square, target) if banded else None
    if solution is None:
        information = _products(basis, square).reshape(size, size)
        for design in designs:
            information += design.T @ design
        information[np.diag_indices(size)] += _RIDGE * float(np.trace(information)) / size
        solution = np.asarray(np.linalg.solve(information, target))
    # A spline's basis adds up to one everywhere: a constant is the same in every coefficient.
    return np.asarray(solution.reshape(-1, 3) + anchor)


def _neighbours(functions: NDArray[np.float64]) -> tuple[NDArray[np.int64], int]:
    """Return the first function that is not zero in each row, (n,), and how many follow at most."""
    count = functions.shape[1]
    found = functions != 0.0
    first = np.argmax(found, axis=1)
    width = int((count - np.argmax(found[:, ::-1], axis=1) - first).max(initial=1))
    return np.minimum(first, count - width), width


def _solved_in_band(
    functions: NDArray[np.float64], square: NDArray[np.float64], target: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Return the solution of what :func:`_products` gives, of which only a band is not zero.

    None if rounding leaves it without a Cholesky factor.
    """
    from scipy.linalg import solveh_banded

    size = target.size
    first, width = _neighbours(functions)
    index = first[:, None] + np.arange(width)
    own = np.take_along_axis(functions, index, axis=1)
    column = (3 * index[:, :, None] + np.arange(3)).reshape(len(own), -1)
    value = np.einsum("na,nb,nij->naibj", own, own, square).reshape(*column.shape, -1)
    below = column[:, :, None] - column[:, None, :]
    kept = below >= 0
    place = below * size + column[:, None, :]
    band = np.bincount(place[kept], value[kept], minlength=3 * width * size).reshape(-1, size)
    band[0] += _RIDGE * float(band[0].sum()) / size
    try:
        return np.asarray(solveh_banded(band, target, lower=True))
    except np.linalg.LinAlgError:
        return None


def _products(functions: NDArray[np.float64], square: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return sums of f_i f_j M over rows with functions f and matrices M, shape (b, 3, b, 3).

    Few of a spline's functions are not zero at a time, and they are neighbours.

    Parameters
    ----------
    functions
        Shape (n, b).
    square
        Shape (n, 3, 3).
    """
    count = functions.shape[1]
    if count <= _FEW:
        weighed = functions[:, :, None] * square.reshape(-1, 1, 9)
        product = functions.T @ weighed.reshape(len(functions), -1)
        return np.asarray(product.reshape(count, count, 3, 3).transpose(0, 2, 1, 3))
    first, width = _neighbours(functions)
    total = np.zeros((count, 3, count, 3))
    order = np.argsort(first, kind="stable")
    edges = np.flatnonzero(np.diff(first[order], prepend=-1, append=count))
    for low, high in pairwise(edges.tolist()):
        rows = order[low:high]
        begin = int(first[rows[0]])
        part = slice(begin, begin + width)
        own = functions[rows, part]
        weighed = own[:, :, None] * square[rows].reshape(-1, 1, 9)
        product = own.T @ weighed.reshape(rows.size, -1)
        total[part, :, part] += product.reshape(width, width, 3, 3).transpose(0, 2, 1, 3)
    return total
