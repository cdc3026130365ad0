"""Recursive estimators of the time-difference study (Camlica 2009): Kalman filters.

Two forms are built, because what is public of the thesis does not say which is its own:

- :func:`extended_kalman`: the state is the emitter; range differences are linearised at the
  prediction. It has no range in its state, so manoeuvres and a change of reference cost nothing.
- :func:`range_kalman`: the state is the emitter and the range to the reference, which makes the
  equations linear (:func:`geograph.scenarios.tdoa_estimators.linear_rows`), as in the start from
  range and range rate. The *original* filter predicts the range at a constant rate: true enough
  while the sensors fly straight. The *manoeuvre-proof* one allows the rate to be any other at the
  next set. At a change of reference the range starts anew from the estimate of the emitter.

A static emitter has no process noise. A moving one has a velocity, with process noise on it.
Weights are those of the arrival times' noise alone, also where positions are noisy: the thesis
says nothing else. All runs are filtered at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.scenarios.moving_sensors import SENSOR_SPEED_M_S
from geograph.scenarios.tdoa_estimators import (
    SPEED_SIGMA_M_S,
    START_SETS,
    Differences,
    Estimates,
    difference_covariance,
    differences,
    linear_rows,
    predicted_differences,
    weighted_start,
    without_lost,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.scenarios.moving_sensors import Runs

Manoeuvres = Literal["original", "manoeuvre-proof"]

VELOCITY_NOISE = 1e-3
"""Process noise of a moving emitter, m/s^1.5: 0.01 m/s of velocity in 120 s."""


@dataclass
class _Filter:
    """A Kalman filter over many runs: state (runs, n), covariance (runs, n, n)."""

    state: NDArray[np.float64]
    covariance: NDArray[np.float64]

    def predict(self, transition: NDArray[np.float64], noise: NDArray[np.float64]) -> None:
        self.state = self.state @ transition.T
        self.covariance = transition @ self.covariance @ transition.T + noise

    def update(
        self,
        rows: NDArray[np.float64],
        residual: NDArray[np.float64],
        noise: NDArray[np.float64],
    ) -> None:
        """Take measurements of rows (runs, m, n), residuals (runs, m), covariance (runs?, m, m)."""
        across = self.covariance @ np.swapaxes(rows, 1, 2)
        gain = across @ np.linalg.inv(rows @ across + noise)
        self.state = self.state + np.einsum("rnm,rm->rn", gain, residual)
        # Joseph's form keeps the covariance positive.
        rest = np.eye(self.state.shape[1]) - gain @ rows
        self.covariance = rest @ self.covariance @ np.swapaxes(
            rest, 1, 2
        ) + gain @ noise @ np.swapaxes(gain, 1, 2)


def _velocity_model(
    size: int, interval_s: float, *, rate: int | None = None, rate_noise: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return transition and process noise of (x, y[, vx, vy][, range, rate]).

    ``size`` is that of the emitter's part; ``rate`` the index of the range, None without.
    """
    full = size if rate is None else size + 2
    transition, noise = np.eye(full), np.zeros((full, full))
    pairs = [(0, 2, VELOCITY_NOISE), (1, 3, VELOCITY_NOISE)] if size == 4 else []
    if rate is not None:
        pairs.append((rate, rate + 1, rate_noise))
    step = interval_s
    white = np.array([[step**3 / 3.0, step**2 / 2.0], [step**2 / 2.0, step]])
    for value, derivative, density in pairs:
        transition[value, derivative] = step
        noise[np.ix_([value, derivative], [value, derivative])] = density**2 * white
    return transition, noise


def extended_kalman(runs: Runs, *, reference: int = 0, moving: bool = False) -> Estimates:
    """Filter range differences with the emitter as the only state, from the first four sets on.

    The start is the linear least squares of those sets with its own covariance. One linearisation
    an update; iterating it changes the errors by less than 1 % here.

    Parameters
    ----------
    runs
        Arrival times.
    reference
        Column of the reference within a set, whichever sensor that is.
    moving
        Whether the emitter's velocity is a state, of prior sigma :data:`SPEED_SIGMA_M_S`.

    Returns
    -------
    Estimates; NaN before the fourth set, and from where a run diverged.
    """
    every = differences(runs, reference=reference)
    noise = difference_covariance(every.range_m.shape[2], runs.sigma_m)
    start = weighted_start(runs, reference=reference, moving=moving)
    size = 4 if moving else 2
    kalman = _Filter(start.state[:, :size], start.covariance[:, :size, :size])
    result = Estimates.empty(runs)
    _keep(result, START_SETS - 1, kalman)
    for k in range(START_SETS, runs.time_s.size):
        kalman.predict(*_velocity_model(size, float(runs.time_s[k] - runs.time_s[k - 1])))
        predicted, jacobian = predicted_differences(
            kalman.state[:, :2], every.sensor_m[:, k], every.reference_m[:, k]
        )
        rows = np.zeros((*jacobian.shape[:2], size))
        rows[..., :2] = jacobian
        kalman.update(rows, every.range_m[:, k] - predicted, noise)
        _keep(result, k, kalman)
    return result


def range_kalman(
    runs: Runs,
    *,
    manoeuvres: Manoeuvres = "manoeuvre-proof",
    reference: int = 0,
    moving: bool = False,
) -> Estimates:
    """Filter the linear equations with the range to the reference in the state.

    The measured range differences are in the equations' coefficients too, which biases the filter
    as their noise grows; the published recursive figures have such an excess over the bound.

    Not defined by what is public of the thesis: what makes a filter manoeuvre-proof. Here its rate
    of the range has the process noise by which it may change between two sets by twice the
    sensors' speed, as when they turn back. The original has none.

    Parameters
    ----------
    runs
        Arrival times.
    manoeuvres
        ``"original"`` or ``"manoeuvre-proof"``.
    reference
        Column of the reference within a set. Where that is another sensor than at the set before,
        the range and its rate start anew: see :func:`_change_reference`.
    moving
        Whether the emitter's velocity is a state, of prior sigma :data:`SPEED_SIGMA_M_S`.

    Returns
    -------
    Estimates; NaN before the fourth set, and from where a run diverged.
    """
    every = differences(runs, reference=reference)
    difference_noise = difference_covariance(every.range_m.shape[2], runs.sigma_m)
    start = weighted_start(runs, reference=reference, moving=moving)
    size = 4 if moving else 2
    kalman = _Filter(start.state, start.covariance)
    result = Estimates.empty(runs)
    _keep(result, START_SETS - 1, kalman)
    for k in range(START_SETS, runs.time_s.size):
        interval = float(runs.time_s[k] - runs.time_s[k - 1])
        jump = 2.0 * SENSOR_SPEED_M_S / np.sqrt(interval)
        rate_noise = jump if manoeuvres == "manoeuvre-proof" else 0.0
        kalman.predict(*_velocity_model(size, interval, rate=size, rate_noise=rate_noise))
        origin = every.reference_m[:, k]
        if runs.sensor[k, reference] != runs.sensor[k - 1, reference]:
            _change_reference(kalman, origin, size=size)
        one = Differences(origin[:, None], every.sensor_m[:, [k]], every.range_m[:, [k]])
        coefficients, right = (part[:, 0] for part in linear_rows(one, origin))
        rows = np.zeros((*coefficients.shape[:2], size + 2))
        rows[..., :2] = coefficients[..., :2]
        rows[..., size] = coefficients[..., 2]
        # The origin moves with the reference; the state counts from the frame's.
        right = right + np.einsum("rna,ra->rn", coefficients[..., :2], origin)
        distance = np.linalg.norm(kalman.state[:, None, :2] - every.sensor_m[:, k], axis=-1)
        noise = distance[:, :, None] * difference_noise * distance[:, None, :]
        kalman.update(rows, right - np.einsum("rnm,rm->rn", rows, kalman.state), noise)
        _keep(result, k, kalman)
    return result


def _change_reference(kalman: _Filter, reference_m: NDArray[np.float64], *, size: int) -> None:
    """Replace the range by that from the estimate to another reference, and forget its rate.

    The new range is |x - s|, linearised; its rate is zero with the sigma of the sensors' speed plus
    the emitter's.
    """
    sight = kalman.state[:, :2] - reference_m
    distance = np.linalg.norm(sight, axis=1)
    change = np.zeros((len(sight), size + 2, size + 2))
    change[:, np.arange(size), np.arange(size)] = 1.0
    change[:, size, :2] = sight / distance[:, None]
    kalman.covariance = change @ kalman.covariance @ np.swapaxes(change, 1, 2)
    kalman.covariance[:, -1, -1] = (SENSOR_SPEED_M_S + SPEED_SIGMA_M_S) ** 2
    kalman.state = np.concatenate(
        [kalman.state[:, :size], distance[:, None], np.zeros((len(sight), 1))], axis=1
    )


def _keep(result: Estimates, k: int, kalman: _Filter) -> None:
    result.position_m[:, k] = without_lost(kalman.state[:, :2])
    result.covariance_m2[:, k] = kalman.covariance[:, :2, :2]
