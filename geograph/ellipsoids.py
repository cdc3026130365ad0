"""Confidence ellipsoids and circular errors of Gaussian positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph import chi_square
from geograph.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Ellipsoids:
    """Confidence ellipsoids.

    Attributes
    ----------
    center_m
        Shape (n, d): centres, metres; d is 3, or 2 for horizontal ellipses.
    semi_axes_m
        Shape (n, d): lengths of the semi-axes, longest first, metres.
    axes
        Shape (n, d, d): rows are the unit vectors of the semi-axes, in the frame of the centres.
    probability
        Chance that the truth lies inside, if the covariances are right.
    """

    center_m: NDArray[np.float64]
    semi_axes_m: NDArray[np.float64]
    axes: NDArray[np.float64]
    probability: float


def ellipsoids(
    center_m: NDArray[np.float64], covariance_m2: NDArray[np.float64], probability: float
) -> Ellipsoids:
    """Return confidence ellipsoids of Gaussian positions.

    The semi-axes are the eigenvectors of the covariance, scaled by the square root of eigenvalue
    times the quantile of chi-square with d degrees of freedom.

    Parameters
    ----------
    center_m
        Shape (n, d), metres.
    covariance_m2
        Shape (n, d, d), square metres.
    probability
        Between 0 and 1, exclusive.

    Raises
    ------
    InputError
        If the probability is out of range.
    """
    if not 0.0 < probability < 1.0:
        raise InputError(f"probability is {probability}; expected between 0 and 1, exclusive")
    values = np.full(covariance_m2.shape[:-1], np.nan)
    vectors = np.full(covariance_m2.shape, np.nan)
    # Covariances of what is not determined are not finite, and nor are their ellipsoids.
    finite = np.isfinite(covariance_m2).all(axis=(-2, -1))
    values[finite], vectors[finite] = np.linalg.eigh(covariance_m2[finite])
    quantile = float(chi_square.quantile(probability, center_m.shape[-1]))
    semi_axes = np.sqrt(np.maximum(values, 0.0) * quantile)[..., ::-1]
    return Ellipsoids(center_m, semi_axes, np.swapaxes(vectors, -1, -2)[..., ::-1, :], probability)


def circular_error_probable_m(covariance_m2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return radii of circles that hold half of the probability, shape (n,), metres.

    Exact to rounding for centred Gaussians in the plane (the distribution of the radial error;
    R. S. Hoyt, Proc. IRE 35, 1947): with the plane stretched so that the Gaussian is round, the
    chance inside a radius r is the average over the directions a there of
    1 - exp(-r^2 / (2 (s1^2 cos^2 a + s2^2 sin^2 a))), solved for one half.

    Parameters
    ----------
    covariance_m2
        Shape (n, 2, 2), square metres.
    """
    values = np.maximum(np.linalg.eigvalsh(covariance_m2), 0.0)
    large = values[:, 1]
    safe = np.where(large > 0.0, large, 1.0)
    ratio = np.clip(values[:, 0] / safe, 0.0, 1.0)
    angle = (np.arange(256) + 0.5) * (np.pi / 2 / 256)
    spread = np.cos(angle) ** 2 + np.sin(angle) ** 2 * ratio[:, None]
    low, high = np.zeros(ratio.size), np.full(ratio.size, 2.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        inside = 1.0 - np.mean(np.exp(-0.5 * middle[:, None] ** 2 / spread), axis=1)
        low, high = np.where(inside < 0.5, middle, low), np.where(inside < 0.5, high, middle)
    return np.asarray(0.5 * (low + high) * np.sqrt(large))
