"""How many independent measurements a sensor's are worth whose errors change slowly.

What a sensor gets wrong in the same way for a while (a lens, a plate's reduction, a pixel's edge)
moves its line of sight as motion would. To a likelihood of white errors n frames are n witnesses of
that motion, and it takes the error for process noise. The witnesses are fewer by

    inflation = (sum over all lags of the covariance of the scores) / (information of one),

the score of a measurement being its whitened residual r times its loss's weight, the information
that weight; one for white errors of the stated sigma. A likelihood to the power 1 / inflation is
that of the slow part of the path as it ought to be (F. Pauli, W. Racugno, L. Ventura, *Bayesian
composite marginal likelihoods*, Statistica Sinica 21, 2011; M. Ribatet, D. Cooley, A. C. Davison,
*Bayesian inference from composite likelihoods*, Statistica Sinica 22, 2012). Each sensor has a
power of its own, for its errors are its own, and motion is what all see.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph import chi_square

if TYPE_CHECKING:
    from numpy.typing import NDArray

FALSE_ALARM = 1e-3
"""Chance that white errors of one kind of measurement are taken to be correlated."""

# Fewer measurements of a sensor say nothing of their correlation.
_LEAST = 32
# Fewer blocks than these do not tell a variance.
_BLOCKS = 8
# Errors that alternate add up to next to nothing, and by an estimate to less: no less than this
# share of their variance, for it is the logarithm that is compared.
_ALTERNATING = 0.1


def inflations(
    score: NDArray[np.float64],
    information: NDArray[np.float64],
    time_s: NDArray[np.float64],
    group: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return by how much the errors of sensors are worse than white ones of their sigmas, (g,).

    They are told only together: where the errors of none are correlated beyond chance, those of all
    count as white. Estimates, which are rough where a pass is not much longer than the
    correlation, are drawn towards each other (:func:`shrunk`).

    Parameters
    ----------
    score
        Shape (n, r): whitened residuals times the weights that they had in the estimate.
    information
        Shape (n,): these weights; of measurements that are left out, zero.
    time_s
        Shape (n,): times of the measurements.
    group
        Shape (n,): sensor of each, as numbers from zero on; all of one kind of measurement.

    Returns
    -------
    inflation
        At least one; exactly one where no correlation shows.
    """
    count = int(group.max(initial=-1)) + 1
    log, variance = np.zeros(count), np.full(count, np.inf)
    correlated = False
    for index in range(count):
        own = np.flatnonzero((group == index) & (information > 0.0))
        if own.size < _LEAST:
            continue
        own = own[np.argsort(time_s[own], kind="stable")]
        series = score[own][:, np.any(score[own] != 0.0, axis=0)]
        if not series.shape[1]:
            continue
        series = series - series.mean(axis=0)
        correlated = correlated or is_correlated(series, FALSE_ALARM / count)
        total, lags = long_run_variance(series)
        log[index] = np.log(total / (series.shape[1] * information[own].mean()))
        variance[index] = 2.0 * (2.0 * lags + 1.0) / series.size
    if not correlated:
        return np.ones(count)
    return np.maximum(np.exp(shrunk(log, variance)), 1.0)


def shrunk(value: NDArray[np.float64], variance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return estimates drawn towards their mean by as much as their own errors explain.

    The empirical best linear predictor of values that differ by a random effect, whose variance is
    that of R. DerSimonian, N. Laird, *Meta-analysis in clinical trials*, Controlled Clinical Trials
    7, 1986.

    Parameters
    ----------
    value
        Shape (n,).
    variance
        Shape (n,): of their errors; infinite where nothing is known, which becomes the mean.
    """
    weight = 1.0 / variance
    if not weight.any():
        return value
    mean = weight @ value / weight.sum()
    excess = weight @ (value - mean) ** 2 - (np.count_nonzero(weight) - 1)
    spread = weight.sum() - (weight @ weight) / weight.sum()
    between = max(excess / spread, 0.0) if spread > 0.0 else 0.0
    if between > 0.0:
        joint = 1.0 / (between + variance)
        mean = joint @ value / joint.sum()
    share = between / (between + variance)
    return np.asarray(mean + share * (value - mean))


def is_correlated(series: NDArray[np.float64], chance: float) -> bool:
    """Tell whether means over blocks vary more than those of white errors would.

    Parameters
    ----------
    series
        Shape (n, r): r series about their means.
    chance
        Of telling so of white errors, whatever their variance.
    """
    count, rows = series.shape
    unit = float(np.mean(series**2))
    lengths = [2**power for power in range(1, 63) if _BLOCKS * 2**power <= count]
    for length in lengths:
        blocks = count // length
        means = series[: blocks * length].reshape(blocks, length, rows).mean(axis=1)
        square = length * float(np.sum(means**2)) / unit
        if square > chi_square.exceeded(chance / len(lengths), blocks * rows):
            return True
    return False


def long_run_variance(series: NDArray[np.float64]) -> tuple[float, int]:
    """Return the sum of a series' autocovariances, that of r series added up, and up to which lag.

    The sum ends where that of two neighbouring lags is no longer above zero, and these pairs do not
    grow (C. J. Geyer, *Practical Markov chain Monte Carlo*, Statistical Science 7, 1992, section
    3.3).

    Parameters
    ----------
    series
        Shape (n, r): about their means.
    """
    count = series.shape[0]
    spectrum = np.abs(np.fft.rfft(series, 2 * count, axis=0)) ** 2
    covariance = np.fft.irfft(spectrum.sum(axis=1))[: count // 2 * 2] / count
    pairs = covariance.reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(pairs <= 0.0)
    pairs = np.minimum.accumulate(pairs[: ends[0]] if ends.size else pairs)
    total = max(2.0 * pairs.sum() - covariance[0], _ALTERNATING * covariance[0])
    return float(total), 2 * pairs.size - 1
