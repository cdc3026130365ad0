"""The problems that every contestant solves, written without geograph.

An object is driven by white noise on its jerk (or stands still). Sensors at known places take its
azimuth atan2(y, x) and elevation atan2(z, hypot(x, y)) along the line of sight (x, y, z) at random
times; each sensor has a bias and a drift in both. In a mixed pass the sensors also note when the
object's emissions arrive, by clocks that are off, and how much their received frequencies differ
from the first sensor's, by oscillators that are off. Unknown are position, velocity and
acceleration at the knots (the position alone of what stands still), and the errors of each sensor.
The cost is half the sum of squares of the rows of :mod:`equations`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import factorial
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

AZIMUTH, ELEVATION, AZIMUTH_DRIFT, ELEVATION_DRIFT, CLOCK, FREQUENCY = range(6)
"""Columns of a sensor's errors: rad, rad, rad/s, rad/s, s, Hz. A pass has the first E of them."""


@dataclass(frozen=True)
class Size:
    """How much data a pass has; knots are one second apart."""

    sensors: int
    bearings: int
    """Of each sensor."""
    knots: int
    emissions: int = 0
    """Sets of arrivals at all sensors; a moving object's give frequency differences as well."""

    @property
    def measurements(self) -> int:
        """Bearings, arrivals and frequency differences."""
        differences = self.emissions * (self.sensors - 1) if self.knots > 1 else 0
        return self.sensors * (self.bearings + self.emissions) + differences


SIZES = {
    "small": Size(4, 200, 50),
    "medium": Size(8, 800, 200),
    "large": Size(8, 8000, 2000),
    "static": Size(4, 0, 1, 60),
    "mixed": Size(8, 400, 200, 400),
    "huge": Size(8, 80000, 20000),
}
"""The last one is for ours alone, for how time grows, unless all are asked for."""


@dataclass(frozen=True, eq=False)
class Pass:
    """One simulated pass; SI units, states as (position, velocity, acceleration), D numbers.

    Attributes
    ----------
    sensor_m, sensor_m_s
        Shape (S, 3): positions at time zero, and velocities.
    error_sigma
        Shape (E,): prior sigmas of a sensor's errors.
    time_s, sensor, azimuth_rad, elevation_rad
        Shape (n,): the bearings, sorted by time.
    sigma_rad
        Shape (): of each bearing, on the sky.
    emitted_s
        Shape (m,): about when the emissions left, from the first guess: to 20 microseconds, in
        which the object moves by centimetres.
    toa_s, toa_sigma_s
        Shapes (m, S) and (): their arrival times by the sensors' clocks.
    fdoa_hz, fdoa_time_s
        Shapes (q, S - 1) and (q,): received frequencies of the first q emissions (all or none) less
        the first sensor's, and when that one received them.
    carrier_hz, fdoa_sigma_hz, speed_m_s
        Shape (): emitted frequency, sigma of each difference, speed of propagation.
    altitude_sigma_m
        Shape (): the knots' z is zero to within this; infinite: it is free.
    knots_s
        Shape (K,).
    noise
        Shape (): square root of the spectral density of the jerk.
    guess
        Shape (K, D): first guess.
    prior_sigma, scale
        Shape (D,): sigmas of the first knot's prior, and scales of the states.
    truth, true_errors
        Shapes (K, D) and (S, E).
    """

    sensor_m: NDArray[np.float64]
    sensor_m_s: NDArray[np.float64]
    error_sigma: NDArray[np.float64]
    time_s: NDArray[np.float64]
    sensor: NDArray[np.int64]
    azimuth_rad: NDArray[np.float64]
    elevation_rad: NDArray[np.float64]
    sigma_rad: NDArray[np.float64]
    emitted_s: NDArray[np.float64]
    toa_s: NDArray[np.float64]
    toa_sigma_s: NDArray[np.float64]
    fdoa_hz: NDArray[np.float64]
    fdoa_time_s: NDArray[np.float64]
    carrier_hz: NDArray[np.float64]
    fdoa_sigma_hz: NDArray[np.float64]
    speed_m_s: NDArray[np.float64]
    altitude_sigma_m: NDArray[np.float64]
    knots_s: NDArray[np.float64]
    noise: NDArray[np.float64]
    guess: NDArray[np.float64]
    prior_sigma: NDArray[np.float64]
    scale: NDArray[np.float64]
    truth: NDArray[np.float64]
    true_errors: NDArray[np.float64]

    @property
    def bearings_only(self) -> bool:
        """Whether the pass has neither arrivals nor frequency differences."""
        return self.emitted_s.size == 0

    @property
    def measurements(self) -> int:
        """Number of bearings, arrivals and frequency differences."""
        return int(self.time_s.size + self.toa_s.size + self.fdoa_hz.size)

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


def path_weights(
    knots_s: NDArray[np.float64], time_s: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the knot before each time, and what position and velocity take from both knots.

    Mean of the prior between two states: Psi = Q(tau) Phi(T - tau)^T Q(T)^-1 for the later one,
    Phi(tau) - Psi Phi(T) for the earlier one. The shapes are (n,), (n, 6), (n, 6): rows of
    (position, velocity, acceleration) of the earlier knot, then of the later; with one knot, which
    stands still, (n,), (n, 1), (n, 1).
    """
    if knots_s.size == 1:
        one = np.ones((time_s.size, 1))
        return np.zeros(time_s.size, dtype=np.int64), one, np.zeros_like(one)
    interval = np.clip(np.searchsorted(knots_s, time_s) - 1, 0, knots_s.size - 2)
    step = np.diff(knots_s)[interval]
    offset = time_s - knots_s[interval]
    rest = np.swapaxes(transition(step - offset), 1, 2)
    later = unit_noise(offset) @ rest @ np.linalg.inv(unit_noise(step))
    earlier = transition(offset) - later @ transition(step)
    both = np.concatenate([earlier, later], axis=2)
    return interval, both[:, 0], both[:, 1]


def line_of_sight_angles(line_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return azimuth and elevation of lines of sight, shape (n, 2)."""
    level = np.hypot(line_m[:, 0], line_m[:, 1])
    return np.stack([np.arctan2(line_m[:, 1], line_m[:, 0]), np.arctan2(line_m[:, 2], level)], 1)
