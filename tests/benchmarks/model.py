"""The problem that every contestant solves, written without geograph.

An object is driven by white noise on its jerk. Sensors at known places take its azimuth atan2(y, x)
and elevation atan2(z, hypot(x, y)) along the line of sight (x, y, z) at random times; each sensor
has a bias and a drift in both. Unknown are position, velocity and acceleration at the knots and the
four errors of each sensor. The cost is half the sum of squares of

- each bearing's residual over its sigma: the logarithmic map of the predicted direction in the
  tangent plane of the measured one, freed from the sensor's errors, its first component times the
  ratio of the cosines of the measured and the freed elevation (rounded off at the zenith), because
  the noise is isotropic where the sensor measured; between knots, the position is the mean of the
  prior given both neighbours;
- the whitened noise between knots, the first knot's deviation from the first guess over wide
  sigmas, and the sensors' errors over their prior sigmas.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import factorial
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

ERRORS = 4
"""Errors of one sensor: azimuth bias, elevation bias (rad), their drifts (rad/s)."""

ZENITH_ROUNDING = 0.02
"""Sine of the distance from the zenith within which cosines of elevations are rounded off."""


@dataclass(frozen=True)
class Size:
    """How much data a pass has; knots are one second apart."""

    sensors: int
    bearings: int
    """Of each sensor."""
    knots: int


SIZES = {"small": Size(4, 200, 50), "medium": Size(8, 800, 200), "large": Size(8, 8000, 2000)}


@dataclass(frozen=True, eq=False)
class Pass:
    """One simulated pass; SI units, states as (position, velocity, acceleration).

    Attributes
    ----------
    sensor_m
        Shape (S, 3).
    error_sigma
        Shape (4,): prior sigmas of a sensor's errors.
    time_s, sensor, azimuth_rad, elevation_rad
        Shape (n,): the bearings, sorted by time.
    sigma_rad
        Shape (): of each bearing, on the sky.
    knots_s
        Shape (K,).
    noise
        Shape (): square root of the spectral density of the jerk.
    guess
        Shape (K, 9): first guess.
    prior_sigma, scale
        Shape (9,): sigmas of the first knot's prior, and scales of the states.
    truth, true_errors
        Shapes (K, 9) and (S, 4).
    """

    sensor_m: NDArray[np.float64]
    error_sigma: NDArray[np.float64]
    time_s: NDArray[np.float64]
    sensor: NDArray[np.int64]
    azimuth_rad: NDArray[np.float64]
    elevation_rad: NDArray[np.float64]
    sigma_rad: NDArray[np.float64]
    knots_s: NDArray[np.float64]
    noise: NDArray[np.float64]
    guess: NDArray[np.float64]
    prior_sigma: NDArray[np.float64]
    scale: NDArray[np.float64]
    truth: NDArray[np.float64]
    true_errors: NDArray[np.float64]

    def save(self, path: Path) -> None:
        """Write the pass as an ``.npz`` file."""
        np.savez(path, **{field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls, path: Path) -> Pass:
        """Read what :meth:`save` wrote."""
        with np.load(path) as stored:
            return cls(**{field.name: stored[field.name] for field in fields(cls)})


def transition(step_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Phi of one axis, shape (n, 3, 3)."""
    matrix = np.zeros((step_s.size, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            matrix[:, i, j] = step_s ** (j - i) / factorial(j - i)
    return matrix


def unit_noise(step_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Q of one axis for unit density, shape (n, 3, 3)."""
    rows = [
        [step_s**5 / 20, step_s**4 / 8, step_s**3 / 6],
        [step_s**4 / 8, step_s**3 / 3, step_s**2 / 2],
        [step_s**3 / 6, step_s**2 / 2, step_s],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def unit_noise_root(step_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lower Cholesky factors of :func:`unit_noise`, shape (n, 3, 3)."""
    unit = np.linalg.cholesky(unit_noise(np.ones(1)))[0]
    return step_s[:, None, None] ** np.array([2.5, 1.5, 0.5])[:, None] * unit


def position_weights(data: Pass) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the knot before each bearing, and the weights of both knots' blocks, (n,), (n, 6).

    Mean of the prior between two states: Psi = Q(tau) Phi(T - tau)^T Q(T)^-1 for the later one,
    Phi(tau) - Psi Phi(T) for the earlier one.
    """
    interval = np.clip(np.searchsorted(data.knots_s, data.time_s) - 1, 0, data.knots_s.size - 2)
    step = np.diff(data.knots_s)[interval]
    offset = data.time_s - data.knots_s[interval]
    rest = np.swapaxes(transition(step - offset), 1, 2)
    later = unit_noise(offset) @ rest @ np.linalg.inv(unit_noise(step))
    earlier = transition(offset) - later @ transition(step)
    return interval, np.concatenate([earlier[:, 0], later[:, 0]], axis=1)


def line_of_sight_angles(line_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return azimuth and elevation of lines of sight, shape (n, 2)."""
    level = np.hypot(line_m[:, 0], line_m[:, 1])
    return np.stack([np.arctan2(line_m[:, 1], line_m[:, 0]), np.arctan2(line_m[:, 2], level)], 1)


def cost(data: Pass, path: NDArray[np.float64], errors: NDArray[np.float64]) -> float:
    """Return the cost of an estimate.

    Parameters
    ----------
    data
        The pass.
    path
        Shape (K, 9).
    errors
        Shape (S, 4).
    """
    interval, weights = position_weights(data)
    blocks = path.reshape(-1, 3, 3)
    both = np.concatenate([blocks[:-1], blocks[1:]], axis=1)[interval]
    line = np.einsum("nj,njc->nc", weights, both) - data.sensor_m[data.sensor]
    own = errors[data.sensor]
    azimuth = data.azimuth_rad - own[:, 0] - own[:, 2] * data.time_s
    elevation = data.elevation_rad - own[:, 1] - own[:, 3] * data.time_s
    zero = np.zeros_like(azimuth)
    sa, ca, se, ce = np.sin(azimuth), np.cos(azimuth), np.sin(elevation), np.cos(elevation)
    axes = np.array([[-sa, ca, zero], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]])
    across, up, along = np.einsum("rcn,nc->rn", axes, line)
    sine = np.hypot(across, up)
    stretch = np.arctan2(sine, along) / sine / data.sigma_rad
    level2 = np.cos(data.elevation_rad) ** 2 + ZENITH_ROUNDING**2
    ratio2 = level2 / (ce**2 + ZENITH_ROUNDING**2)
    total = float(np.sum(stretch**2 * (ratio2 * across**2 + up**2)))
    steps = np.diff(data.knots_s)
    gap = blocks[1:] - transition(steps) @ blocks[:-1]
    total += float(np.sum((np.linalg.solve(unit_noise_root(steps), gap) / data.noise) ** 2))
    total += float(np.sum(((path[0] - data.guess[0]) / data.prior_sigma) ** 2))
    total += float(np.sum((errors / data.error_sigma) ** 2))
    return 0.5 * total
