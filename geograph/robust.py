"""Outliers: which measurements do not belong, found by graduated non-convexity.

Truncated least squares counts a measurement as it is up to a threshold and not at all beyond. Its
cost is reached from the convex one through a family of costs that grow less and less convex (H.
Yang, P. Antonante, V. Tzoumas, L. Carlone, *Graduated non-convexity for robust spatial perception*,
IEEE RA-L 5, 2020, section IV-B). The threshold belongs to a chance of 1 % that any good measurement
of the recording is rejected, on the scale of each sensor's own residuals where these are wider than
stated.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph import chi_square

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

FALSE_ALARM = 0.01
"""Chance that a recording without outliers loses one measurement."""

_ANNEALING = 2.0
_STAGES = 40
_LEAST_CONTROL = 0.1
_SCALE_ROUNDS = 10

# Ratio of variances beyond which a sensor is wrong rather than noisy: ten times as wide as most.
WRONG = 100.0


def thresholds(
    square: NDArray[np.float64],
    rows: NDArray[np.int64],
    group: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return the squared whitened residual at which each measurement is an outlier, shape (n,).

    Parameters
    ----------
    square
        Shape (n,): squared whitened residuals.
    rows
        Shape (n,): residual rows of each measurement, 1 or 2.
    group
        Shape (n,): sensor of each measurement.
    """
    limit = plain_limits(square.size, rows)
    return np.asarray(limit * sensor_scales(square, rows, group)[group])


def plain_limits(count: int, rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the squared whitened residual at which one of ``count`` measurements is an outlier.

    Parameters
    ----------
    count
        Measurements in all.
    rows
        Shape (n,): residual rows of those that are judged.
    """
    # The upper quantile of chi-square.
    return chi_square.exceeded(FALSE_ALARM / max(count, 1), rows)


def sensor_scales(
    square: NDArray[np.float64], rows: NDArray[np.int64], group: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return by how much each sensor's residuals exceed their variance, at least 1, shape (g,).

    The median of the squared residuals over the median of chi-square: half of a sensor's
    measurements may be outliers. A sensor far wider than most is not noisy but wrong, and its
    measurements are judged by their stated variance.
    """
    count = int(group.max(initial=-1)) + 1
    scales = np.ones(count)
    ratio = square / chi_square.median(rows)
    for index in range(count):
        own = ratio[group == index]
        if own.size >= _SCALE_ROUNDS:
            scales[index] = max(1.0, float(np.median(own)))
    # The lower median: with two sensors the better one is the measure.
    typical = float(np.sort(scales)[(count - 1) // 2]) if count else 1.0
    scales[scales > WRONG * typical] = typical
    return scales


def anneal(
    solve: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    square: NDArray[np.float64],
    rows: NDArray[np.int64],
    group: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Return which measurements are kept, shape (n,), by graduated non-convexity.

    Parameters
    ----------
    solve
        Solves with given weights, shape (n,), from where it last ended, and returns squared
        whitened residuals, shape (n,).
    square
        Squared whitened residuals of a robust estimate to start from.
    rows, group
        As in :func:`thresholds`.
    """
    limit = thresholds(square, rows, group)
    worst = float(np.max(square / limit, initial=0.0))
    if worst <= 1.0:
        return np.ones(square.size, dtype=bool)
    # Where even the worst residual is on the convex branch, but not so convex that residuals far
    # outside count: the start is a robust estimate, and bearings half a turn off are not linear.
    control = max(1.0 / (2.0 * worst - 1.0), _LEAST_CONTROL)
    kept = square <= limit
    for _ in range(_STAGES):
        ratio = square / limit
        weight = np.sqrt(control * (control + 1.0) / np.maximum(ratio, 1e-300)) - control
        weight[ratio <= control / (control + 1.0)] = 1.0
        weight[ratio >= (control + 1.0) / control] = 0.0
        square = solve(np.clip(weight, 0.0, 1.0))
        limit = thresholds(square, rows, group)
        kept = square <= limit
        if control > 1e3:
            break
        control *= _ANNEALING
    return _settled(solve, kept, rows, group)


def _settled(
    solve: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    kept: NDArray[np.bool_],
    rows: NDArray[np.int64],
    group: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Alternate between solving and choosing until the choice stands."""
    for _ in range(_SCALE_ROUNDS):
        square = solve(kept.astype(np.float64))
        again = square <= thresholds(square, rows, group)
        if np.array_equal(again, kept):
            break
        kept = again
    return kept
