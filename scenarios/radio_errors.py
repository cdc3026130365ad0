"""What is wrong with simulated receivers of arrival times and frequencies.

Signs are those of the recording format: *measured = true + error*. A clock's error is added to the
times of arrival and to the time tags that its receiver gives, a frequency's to the frequencies that
it receives. A position error is what has to be added to the recorded position to make the true one.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.scenarios.sensor_errors import (
    Draw,
    ErrorHistory,
    TrueErrors,
    draw_errors,
    error_history,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.sensors import SensorErrors


@dataclass(frozen=True, kw_only=True)
class ReceiverErrors(TrueErrors):
    """The errors that one simulated receiver has; SI units.

    Parameters
    ----------
    frequency_offset_hz, frequency_drift_hz_s
        Error of the frequencies that it receives, at the carrier, and its rate.
    position_m
        True less recorded position.
    """

    frequency_offset_hz: float = 0.0
    frequency_drift_hz_s: float = 0.0
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


def draw_receiver_errors(
    rng: np.random.Generator, prior: SensorErrors, *, draw: Draw = "normal"
) -> ReceiverErrors:
    """Draw one receiver's errors from their priors.

    Parameters
    ----------
    rng
        Source of randomness; it is asked for the same numbers whatever the priors are.
    prior
        Standard deviations. ``position_noise_m`` is not drawn here: it differs at every epoch.
    draw
        See :func:`geograph.scenarios.sensor_errors.draw_errors`. Frequencies and positions are
        always normal.

    Raises
    ------
    ValueError
        If the prior holds an error that a simulated receiver does not have.
    """
    known = dataclasses.replace(
        prior,
        frequency_offset_hz=0.0,
        frequency_drift_hz_s=0.0,
        position_m=0.0,
        position_noise_m=0.0,
    )
    common = draw_errors(rng, known, draw=draw)
    offset, drift, *place = rng.standard_normal(5).tolist()
    x, y, z = (prior.position_m * value for value in place)
    return ReceiverErrors(
        **vars(common),
        frequency_offset_hz=prior.frequency_offset_hz * offset,
        frequency_drift_hz_s=prior.frequency_drift_hz_s * drift,
        position_m=(x, y, z),
    )


@dataclass(frozen=True, eq=False)
class Histories:
    """The errors of all receivers at their receptions; each of shape (n,), SI units."""

    azimuth_rad: NDArray[np.float64]
    elevation_rad: NDArray[np.float64]
    clock_s: NDArray[np.float64]
    frequency_hz: NDArray[np.float64]

    def part(self, rows: slice, shape: tuple[int, ...]) -> Histories:
        """Return some of the rows in another shape."""
        return Histories(*(column[rows].reshape(shape) for column in vars(self).values()))


def draw_histories(
    rng: np.random.Generator,
    errors: Sequence[ReceiverErrors],
    receiver: NDArray[np.int64],
    time_s: NDArray[np.float64],
) -> Histories:
    """Return bias + drift * elapsed + walk of all errors at all receptions.

    Receptions of one receiver at one time have the same errors, whatever was measured then.

    Parameters
    ----------
    rng
        Source of randomness of the walks.
    errors
        Those of each receiver.
    receiver
        Shape (n,), integer: which one receives.
    time_s
        Shape (n,): true times of reception, in any order, seconds.
    """
    elapsed = time_s - time_s.min()
    columns = np.empty((4, time_s.size))
    for index, own in enumerate(errors):
        rows = np.flatnonzero(receiver == index)
        rows = rows[np.argsort(elapsed[rows], kind="stable")]
        found: ErrorHistory = error_history(rng, own, elapsed[rows])
        columns[:3, rows] = found.azimuth_rad, found.elevation_rad, found.clock_s
        columns[3, rows] = own.frequency_offset_hz + own.frequency_drift_hz_s * elapsed[rows]
    return Histories(*columns)
