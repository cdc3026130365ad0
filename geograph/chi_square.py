"""Quantiles of the chi-square distribution.

From :mod:`scipy.special`: importing :mod:`scipy.stats` takes as long as smoothing a fireball.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import gammainccinv, gammaincinv

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def quantile(probability: ArrayLike, freedom: ArrayLike) -> NDArray[np.float64]:
    """Return what a chi-square stays below with a probability; its distribution, inverted.

    Parameters
    ----------
    probability
        0 to 1, any shape.
    freedom
        Degrees of freedom, above 0, of a shape that goes with it.
    """
    half = 0.5 * np.asarray(freedom, dtype=np.float64)
    found = gammaincinv(half, np.asarray(probability, dtype=np.float64))
    return np.asarray(2.0 * found, dtype=np.float64)


def exceeded(chance: ArrayLike, freedom: ArrayLike) -> NDArray[np.float64]:
    """Return what a chi-square exceeds with a probability; exact however small that is.

    Parameters
    ----------
    chance
        0 to 1, any shape.
    freedom
        As of :func:`quantile`.
    """
    half = 0.5 * np.asarray(freedom, dtype=np.float64)
    found = gammainccinv(half, np.asarray(chance, dtype=np.float64))
    return np.asarray(2.0 * found, dtype=np.float64)


def median(freedom: ArrayLike) -> NDArray[np.float64]:
    """Return the medians; see :func:`quantile`."""
    return quantile(0.5, freedom)
