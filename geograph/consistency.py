"""How honest covariances are: NEES, its band, coverage, and the divergence from chi-square.

**NEES.** The normalised estimation error squared of an error e with covariance P is e' P^-1 e. For
an honest covariance it is chi-square with as many degrees of freedom as there are axes, and N times
the mean of N independent ones (the average NEES, ANEES) is chi-square with N times as many
(Y. Bar-Shalom, X. R. Li, T. Kirubarajan, *Estimation with Applications to Tracking and Navigation*,
2001, section 5.4.2).

**The divergence.** NEES values are counted in bins of chi-square: 19 bins of equal probability hold
95 % of it; the upper 5 % is cut at the probabilities 1e-2, 1e-3, ..., 1e-12 of the tail. With p the
share of the values in a bin and q the bin's probability, the Kullback-Leibler divergence is the sum
of p ln(p / q). It is exactly zero for the true shares, grows with NEES that are too small (up to
ln 20 = 3.0) and too large (up to 27.6, all beyond 1e-12), and does not depend on a choice of width.
From N independent values of a true chi-square it is not zero but about (bins - 1) / (2 N), G. A.
Miller's bias of entropies (1955): :func:`divergence_bias` draws it. Values along one path go
together, so that N is between the number of paths and that of values.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph import chi_square

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

AXES = 3
"""Degrees of freedom of a position."""

TAIL = np.concatenate([np.linspace(1.0, 0.05, 20), 10.0 ** -np.arange(2.0, 13.0), [0.0]])
"""Probabilities above the edges of the bins."""


def nees(
    error: NDArray[np.float64], covariance: NDArray[np.float64], *, undefined: float = np.inf
) -> NDArray[np.float64]:
    """Return e' P^-1 e of each row, shape (n,).

    Parameters
    ----------
    error
        Shape (n, d).
    covariance
        Shape (n, d, d), in the square of the unit of the errors.
    undefined
        What stands where a covariance is singular or anything is not finite.
    """
    result = np.full(len(error), undefined)
    finite = np.isfinite(covariance).all(axis=(1, 2)) & np.isfinite(error).all(axis=1)
    good = np.flatnonzero(finite)
    values, vectors = np.linalg.eigh(covariance[good])
    positive = values[:, 0] > 0.0
    good, values, vectors = good[positive], values[positive], vectors[positive]
    turned = np.einsum("nji,nj->ni", vectors, error[good])
    result[good] = np.sum(turned**2 / values, axis=1)
    return result


def limit(probability: ArrayLike, axes: int = AXES) -> NDArray[np.float64]:
    """Return the NEES within which an honest one lies with a probability, in the same shape."""
    return chi_square.quantile(probability, axes)


def mean_band(count: int, axes: int = AXES, *, alarm: float = 0.01) -> tuple[float, float]:
    """Return where the mean of independent honest NEES lies, but for a rate of false alarms.

    Parameters
    ----------
    count
        How many there are.
    axes
        Degrees of freedom of each.
    alarm
        Probability of being outside, half of it on either side.
    """
    low, high = limit([0.5 * alarm, 1.0 - 0.5 * alarm], count * axes) / count
    return float(low), float(high)


def counts(values: NDArray[np.float64], axes: int = AXES) -> NDArray[np.int64]:
    """Return how many NEES values lie in each bin of :data:`TAIL`; NaN in none."""
    from scipy.special import chdtrc

    tail = chdtrc(axes, values[~np.isnan(values)])
    # Edges descend; a value on an edge belongs to the bin of the larger tail.
    index = np.searchsorted(-TAIL, -tail, side="left") - 1
    return np.bincount(np.clip(index, 0, TAIL.size - 2), minlength=TAIL.size - 1)


def shares(values: NDArray[np.float64], axes: int = AXES) -> NDArray[np.float64]:
    """Return the shares of NEES values in the bins, which add up to one."""
    return np.asarray(counts(values, axes) / values.size)


def divergence(values: NDArray[np.float64], axes: int = AXES) -> float:
    """Return the Kullback-Leibler divergence of NEES values from chi-square, see the module."""
    return _divergence(counts(values, axes))


def divergence_bias(count: int, axes: int = AXES, *, draws: int = 200, seed: int = 0) -> float:
    """Return the mean divergence of independent draws from chi-square itself.

    Parameters
    ----------
    count
        Number of values.
    axes
        Degrees of freedom.
    draws, seed
        How many sets are drawn, and from which seed.
    """
    rng = np.random.default_rng(seed)
    return float(np.mean([divergence(rng.chisquare(axes, count), axes) for _ in range(draws)]))


def divergence_error(
    values: NDArray[np.float64], axes: int = AXES, *, draws: int = 200, seed: int = 0
) -> float:
    """Return the standard error of the divergence, by resampling whole runs (bootstrap).

    Parameters
    ----------
    values
        Shape (runs, points): runs are independent, the values of one are not.
    axes
        Degrees of freedom.
    draws, seed
        How many samples are drawn, and from which seed.
    """
    rng, runs = np.random.default_rng(seed), len(values)
    each = np.array([counts(row, axes) for row in values])
    again = [_divergence(each[rng.integers(0, runs, runs)].sum(axis=0)) for _ in range(draws)]
    return float(np.std(again))


def _divergence(count: NDArray[np.int64]) -> float:
    found, expected = count / max(int(count.sum()), 1), -np.diff(TAIL)
    some = found > 0.0
    return float(np.sum(found[some] * np.log(found[some] / expected[some])))
