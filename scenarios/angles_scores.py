"""How honest and how good estimates are: NEES, coverage, divergence from chi-square, improvement.

**The divergence.** NEES values are counted in bins of chi-square with three degrees of freedom: 19
bins of equal probability hold 95 % of it; the upper 5 % is cut at the probabilities 1e-2, 1e-3,
..., 1e-12 of the tail. With p the share of the values in a bin and q the bin's probability, the
Kullback-Leibler divergence is the sum of p ln(p / q). It is exactly zero for the true shares, grows
with NEES that are too small (up to ln 20 = 3.0) and too large (up to 27.6, all beyond 1e-12), and
does not depend on a choice of width. From N independent values of a true chi-square it is not zero
but about (bins - 1) / (2 N), G. A. Miller's bias of entropies (1955): :func:`divergence_bias`
draws it.
Values along one path go together, so that N is between the number of trials and that of values.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

if TYPE_CHECKING:
    from numpy.typing import NDArray

AXES = 3
"""Degrees of freedom of a position."""

TAIL = np.concatenate([np.linspace(1.0, 0.05, 20), 10.0 ** -np.arange(2.0, 13.0), [0.0]])
"""Probabilities above the edges of the bins."""

_LIMIT_95 = float(chi2.ppf(0.95, AXES))
_RESAMPLES = 200


def nees(error_m: NDArray[np.float64], covariance_m2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return e' P^-1 e, shape (n,), of errors, shape (n, 3), and covariances, shape (n, 3, 3).

    Infinite where a covariance is singular or not finite.
    """
    result = np.full(len(error_m), np.inf)
    finite = np.isfinite(covariance_m2).all(axis=(1, 2)) & np.isfinite(error_m).all(axis=1)
    good = np.flatnonzero(finite)
    good = good[np.linalg.eigvalsh(covariance_m2[good])[:, 0] > 0.0]
    solved = np.linalg.solve(covariance_m2[good], error_m[good][..., None])[..., 0]
    result[good] = np.einsum("ni,ni->n", error_m[good], solved)
    return result


def shares(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the shares of NEES values in the bins, which add up to one."""
    tail = chi2.sf(values, AXES)
    # Edges descend; a value on an edge belongs to the bin of the larger tail.
    index = np.searchsorted(-TAIL, -tail, side="left") - 1
    count = np.bincount(np.clip(index, 0, TAIL.size - 2), minlength=TAIL.size - 1)
    return np.asarray(count / values.size)


def divergence(values: NDArray[np.float64]) -> float:
    """Return the Kullback-Leibler divergence of NEES values from chi-square, see the module."""
    found, expected = shares(values), -np.diff(TAIL)
    some = found > 0.0
    return float(np.sum(found[some] * np.log(found[some] / expected[some])))


def divergence_bias(count: int, *, draws: int = 200, seed: int = 0) -> float:
    """Return the mean divergence of independent draws from chi-square itself.

    Parameters
    ----------
    count
        Number of values.
    draws, seed
        How many sets are drawn, and from which seed.
    """
    rng = np.random.default_rng(seed)
    return float(np.mean([divergence(rng.chisquare(AXES, count)) for _ in range(draws)]))


@dataclass(frozen=True)
class Figure:
    """A number with its standard error."""

    value: float
    error: float

    def text(self, digits: int = 2) -> str:
        """Return both as text."""
        return f"{self.value:.{digits}f}±{self.error:.{digits}f}"


@dataclass(frozen=True)
class Honesty:
    """What the NEES of many trials say.

    Attributes
    ----------
    anees
        Mean of all; 3 for an honest covariance.
    divergence
        From chi-square.
    coverage
        Share within the 95 % ellipsoid, 7.815.
    """

    anees: Figure
    divergence: Figure
    coverage: Figure


def honesty(values: NDArray[np.float64], *, seed: int = 0) -> Honesty:
    """Score NEES of many trials; trials are independent, the values of one are not.

    Parameters
    ----------
    values
        Shape (trials, points).
    seed
        Of the resampling (bootstrap over trials) that gives the divergence's standard error.
    """
    trials = len(values)
    inside = (values <= _LIMIT_95).mean(axis=1)
    mean = values.mean(axis=1)
    rng = np.random.default_rng(seed)
    again = [divergence(values[rng.integers(0, trials, trials)].ravel()) for _ in range(_RESAMPLES)]
    root = np.sqrt(max(trials - 1, 1))
    return Honesty(
        Figure(float(mean.mean()), float(np.std(mean) / root)),
        Figure(divergence(values.ravel()), float(np.std(again))),
        Figure(float(inside.mean()), float(inside.std() / root)),
    )


@dataclass(frozen=True)
class Improvement:
    """How much smaller errors are than the baseline's, trial by trial.

    Attributes
    ----------
    trials
        Number of trials in which both converged.
    share
        Share of them in which the error is smaller.
    mean, median
        Mean and median of 1 - error / baseline's error.
    """

    trials: int
    share: Figure
    mean: Figure
    median: float


def improvement(rms_m: NDArray[np.float64], baseline_m: NDArray[np.float64]) -> Improvement:
    """Compare errors with the baseline's of the same trials, both of shape (n,), n at least 1."""
    gain = 1.0 - rms_m / baseline_m
    better = (gain > 0.0).mean()
    root = np.sqrt(max(gain.size - 1, 1))
    return Improvement(
        gain.size,
        Figure(float(better), float(np.sqrt(better * (1.0 - better)) / root)),
        Figure(float(gain.mean()), float(gain.std() / root)),
        float(np.median(gain)),
    )
