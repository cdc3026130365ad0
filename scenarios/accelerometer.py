"""Pointing errors that accumulate in an inertial unit until it is calibrated.

R. Sprang, *Non-linear optimization applied to angle-of-arrival satellite-based geolocation with
correlated measurements*, AFIT 2015: an accelerometer of resolution V rounds, its error is uniform
between -V/2 and V/2 and new at every sample, and what points the sensor integrates it twice. At
random times a calibration sets the error and its rate to zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Accelerometer:
    """An inertial unit that points a sensor.

    Parameters
    ----------
    resolution_rad_s2
        V: step of the quantised angular acceleration.
    sample_s
        Time between two samples.
    calibration_s
        Mean time between two calibrations; their times are a Poisson process.

    Raises
    ------
    ValueError
        If one of them is not above zero.
    """

    resolution_rad_s2: float
    sample_s: float = 0.1
    calibration_s: float = 20.0

    def __post_init__(self) -> None:
        if not min(self.resolution_rad_s2, self.sample_s, self.calibration_s) > 0.0:
            raise ValueError(f"{self}: expected all above 0")

    @property
    def density(self) -> float:
        """Square root of the spectral density of the angular acceleration, rad/s^1.5."""
        return float(self.resolution_rad_s2 * np.sqrt(self.sample_s / 12.0))

    def rms_rad(self, duration_s: float) -> float:
        """Return the root mean square of the error over a pass that starts calibrated, radians.

        At the age a since the last calibration the variance is q^2 a^3 / 3. At the time t the age
        is exponential with the mean c, but at most t, so that the mean of a^3 is

            6 c^3 - exp(-t / c) (6 c^3 + 6 c^2 t + 3 c t^2),

        averaged here over the pass.

        Parameters
        ----------
        duration_s
            Length of the pass.
        """
        c = self.calibration_s
        t = np.linspace(0.0, duration_s, 2001)
        cube = 6.0 * c**3 - np.exp(-t / c) * (6.0 * c**3 + 6.0 * c**2 * t + 3.0 * c * t**2)
        return float(self.density * np.sqrt(np.mean(cube) / 3.0))


@dataclass(frozen=True, eq=False)
class AccumulatedBias:
    """One sensor's errors of azimuth and elevation over a pass.

    Parameters
    ----------
    time_s
        Shape (m,): times of the samples, seconds.
    error_rad
        Shape (m, 2): azimuth and elevation.
    calibration_s
        Shape (k,): times of the calibrations.
    """

    time_s: NDArray[np.float64]
    error_rad: NDArray[np.float64]
    calibration_s: NDArray[np.float64]

    def at(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the errors of the latest sample, shape (n, 2), radians, at times in seconds."""
        index = np.searchsorted(self.time_s, time_s, side="right") - 1
        return self.error_rad[np.clip(index, 0, self.time_s.size - 1)]


def accumulate(
    rng: np.random.Generator, unit: Accelerometer, span_s: tuple[float, float]
) -> AccumulatedBias:
    """Draw one sensor's errors over a span; the unit was calibrated at its start.

    Parameters
    ----------
    rng
        Source of randomness.
    unit
        What points the sensor.
    span_s
        First and last time, seconds.
    """
    start, end = span_s
    count = int(np.ceil((end - start) / unit.sample_s)) + 1
    time = np.asarray(start + unit.sample_s * np.arange(count), dtype=np.float64)
    gaps = rng.exponential(unit.calibration_s, int(10 + 4 * (end - start) / unit.calibration_s))
    calibration = start + np.cumsum(gaps)
    calibration = calibration[calibration < end]
    half = unit.resolution_rad_s2 / 2.0
    acceleration = rng.uniform(-half, half, (count, 2))
    error = np.zeros((count, 2))
    cuts = np.searchsorted(time, np.concatenate([[start], calibration, [np.inf]]))
    for low, high in pairwise(cuts):
        rate = np.cumsum(unit.sample_s * acceleration[low:high], axis=0)
        # The first sample after a calibration is zero: the sums lag by one.
        error[low + 1 : high] = np.cumsum(unit.sample_s * rate, axis=0)[: max(high - low - 1, 0)]
    return AccumulatedBias(time, error, calibration)
