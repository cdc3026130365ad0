"""BMod of Levy et al.: biases and drifts read off the residuals, taken off, and so on.

The baseline (acceleration + velocity, covariance intersection, kinematic model) is optimised; a
straight line in time is fitted to the residuals of each sensor and angle; where its bias or its
drift is significant it is taken off the measurements; and the baseline is optimised again, until
nothing significant is left. What is significant is not stated in what we have: here, a coefficient
beyond three of its standard errors, by the sigma that the baseline takes for the measurements.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.scenarios.angles_estimators import (
    Kinematic,
    PathEstimate,
    fitted_errors,
    optimise_path,
)
from geograph.scenarios.angles_windows import Windows, predict

if TYPE_CHECKING:
    from numpy.typing import NDArray

_ROUNDS = 30
_SIGNIFICANT = 3.0


def bmod(
    windows: Windows, *, kinematic: Kinematic | None = None, rounds: int = _ROUNDS
) -> PathEstimate:
    """Return the baseline on measurements that were corrected until no line was left in them.

    Parameters
    ----------
    windows
        The measurements.
    kinematic
        Standard deviations of the transitions; None: the usual ones.
    rounds
        How many corrections at most; if that many are not enough it has not converged.

    Returns
    -------
    estimate
        With the sum of all corrections as its constants.
    """
    estimate = optimise_path(windows, 3, kinematic=kinematic)
    sensors = int(windows.sensor.max()) + 1
    constants = np.zeros(4 * sensors)
    clean = windows
    for _ in range(rounds):
        if not estimate.converged.all():
            break
        line = significant_lines(clean, predict(clean, estimate.state).residual_rad)
        if not line.any():
            break
        constants = constants + line
        clean = windows.corrected(fitted_errors(windows, constants))
        estimate = optimise_path(clean, 3, kinematic=kinematic, start=estimate.state)
    else:
        estimate = _not_converged(estimate)
    return PathEstimate(
        estimate.time_s, estimate.state, estimate.covariance, estimate.converged, constants
    )


def _not_converged(estimate: PathEstimate) -> PathEstimate:
    return PathEstimate(
        estimate.time_s, estimate.state, estimate.covariance, np.zeros_like(estimate.converged)
    )


def significant_lines(windows: Windows, residual_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fit a bias and a drift to the residuals of each sensor and angle.

    Parameters
    ----------
    windows
        The measurements.
    residual_rad
        Shape (M, n, 2).

    Returns
    -------
    constants
        As in :class:`geograph.scenarios.angles_estimators.PathEstimate`, zero where a coefficient
        is within three standard errors of it.
    """
    sensors = int(windows.sensor.max()) + 1
    elapsed = windows.tag_s - windows.tag_s.min()
    result = np.zeros((2, 2, sensors))
    for index in range(sensors):
        rows = windows.sensor == index
        if rows.sum() < 3:
            continue
        line = np.stack([np.ones(int(rows.sum())), elapsed[rows]], axis=-1)
        inverse = np.linalg.inv(line.T @ line)
        found = inverse @ line.T @ residual_rad[rows]
        error = windows.sigma_rad[rows].mean() * np.sqrt(np.diag(inverse))[:, None]
        result[:, :, index] = np.where(np.abs(found) > _SIGNIFICANT * error, found, 0.0)
    return result.reshape(-1)
