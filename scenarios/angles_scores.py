"""How honest and how good estimates are over many trials, with standard errors.

NEES, coverage and the divergence from chi-square are those of :mod:`geograph.consistency`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.consistency import divergence, divergence_error, limit

if TYPE_CHECKING:
    from numpy.typing import NDArray


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
    inside = (values <= limit(0.95)).mean(axis=1)
    mean = values.mean(axis=1)
    root = np.sqrt(max(trials - 1, 1))
    return Honesty(
        Figure(float(mean.mean()), float(np.std(mean) / root)),
        Figure(divergence(values.ravel()), divergence_error(values, seed=seed)),
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
