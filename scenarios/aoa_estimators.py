"""Recursive estimators of the study from the air (Kallin 2021), and their common start.

Weighted least squares here, the Kalman filters in :mod:`geograph.scenarios.aoa_kalman`. All of them
begin with Gauss-Newton on the first step's angles, from points on circles of several ranges; all
work on many runs at once. What the thesis leaves open, and what was chosen, is said in each
function; docs/accuracy.md says how near to the published figures each choice comes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.scenarios.aoa_model import AngleModel, wrapped

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.scenarios.airborne import Runs

LARGEST_RANGE_M = 7e3
"""Farthest from the first receiver, over ground, that an estimate is allowed to be."""

START_RANGES_M = (1e3, 2.5e3, 4e3, 5.5e3, 7e3)
"""Ranges of the circles from which Gauss-Newton starts."""

START_ITERATIONS = 10


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates after every step.

    Attributes
    ----------
    position_m
        Shape (runs, steps, 3), metres.
    covariance_m2
        Shape (runs, steps, n, n): what the estimator believes of its unknowns, the first two being
        x and y, square metres.
    """

    position_m: NDArray[np.float64]
    covariance_m2: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Start:
    """What recursions begin with, after the first step.

    Attributes
    ----------
    state
        Shape (runs, n).
    covariance
        Shape (runs, n, n).
    """

    state: NDArray[np.float64]
    covariance: NDArray[np.float64]


class Recorder:
    """Collects estimates step by step."""

    def __init__(self, model: AngleModel) -> None:
        runs, steps = model.runs.azimuth_rad.shape[:2]
        self._model = model
        self._position = np.full((runs, steps, 3), np.nan)
        self._covariance = np.full((runs, steps, model.size, model.size), np.nan)

    def keep(self, step: int, state: NDArray[np.float64], covariance: NDArray[np.float64]) -> None:
        """Keep states, shape (runs, n), and covariances, shape (runs, n, n), of a step."""
        self._position[:, step] = self._model.place(state)
        self._covariance[:, step] = covariance

    @property
    def estimates(self) -> Estimates:
        """What was kept."""
        return Estimates(self._position, self._covariance)


def within_reach(model: AngleModel, state: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return states, shape (..., n), moved back along the ground into the largest range."""
    origin = model.runs.receiver_m[0, 0, :2]
    offset = state[..., :2] - origin
    distance = np.linalg.norm(offset, axis=-1, keepdims=True)
    back = np.minimum(1.0, LARGEST_RANGE_M / np.maximum(distance, 1.0))
    if model.ground is not None:
        return np.asarray(origin + back * offset)
    # Along the line of sight: the height goes with the range.
    height = model.runs.receiver_m[0, 0, 2]
    rest = height + back * (state[..., 2:] - height)
    return np.concatenate([origin + back * offset, rest], axis=-1)


def gauss_newton_start(model: AngleModel) -> Start:
    """Return the best of Gauss-Newton's solutions of the first step, and its covariance.

    The starts are where circles of the given ranges around the first receiver meet the azimuth that
    it measured, at the height where its elevation puts it or on the ground. No published word says
    how far: estimates beyond :data:`LARGEST_RANGE_M` are moved back, or one step of a flat
    elevation would put the emitter at the horizon.

    Parameters
    ----------
    model
        Measurements, and what is known of the ground.
    """
    runs = model.runs
    state = _circle(model)
    measured = model.measured(0)[:, None]
    damping = 1e-6 * np.eye(model.size)
    for _ in range(START_ITERATIONS):
        angle, rows = model.linearise(state, 0)
        residual = wrapped(measured - angle) / runs.scenario.sigma_rad
        rows = rows / runs.scenario.sigma_rad
        across = np.swapaxes(rows, -1, -2)
        information = across @ rows
        # A touch of damping, against ranges that the first step hardly tells.
        scale = np.trace(information, axis1=-2, axis2=-1)[..., None, None]
        step = np.linalg.solve(information + scale * damping, across @ residual[..., None])
        state = within_reach(model, state + step[..., 0])
    angle, rows = model.linearise(state, 0)
    cost = np.sum(wrapped(measured - angle) ** 2, axis=-1)
    best = np.argmin(cost, axis=1)
    every = np.arange(len(runs))
    chosen = rows[every, best] / runs.scenario.sigma_rad
    information = np.swapaxes(chosen, -1, -2) @ chosen
    covariance = np.linalg.inv(information + LARGEST_RANGE_M**-2 * np.eye(model.size))
    return Start(state[every, best], covariance)


def _circle(model: AngleModel) -> NDArray[np.float64]:
    """Return starts on circles around the first receiver, shape (runs, ranges, n)."""
    runs = model.runs
    azimuth = runs.azimuth_rad[:, 0, 0]
    forward, right = runs.axes[0, 0, 0, :2], runs.axes[0, 0, 1, :2]
    direction = np.cos(azimuth)[:, None] * forward + np.sin(azimuth)[:, None] * right
    origin = runs.receiver_m[0, 0]
    ranges = np.array(START_RANGES_M)
    flat = origin[:2] + ranges[:, None] * direction[:, None]
    if model.ground is not None:
        return np.asarray(flat)
    drop = ranges * np.tan(np.clip(runs.elevation_rad[:, 0, :1], -1.2, -0.02))
    return np.concatenate([flat, (origin[2] + drop)[..., None]], axis=-1)


def weighted_least_squares(runs: Runs, *, iterations: int = 1) -> Estimates:
    """Estimate by recursive weighted least squares: each step's angles, linearised at the estimate.

    Parameters
    ----------
    runs
        What was measured.
    iterations
        Linearisations of each step's angles; more than one repeats the step at its own result.
    """
    model = AngleModel.of(runs)
    start = gauss_newton_start(model)
    state, covariance = start.state, start.covariance
    noise = model.noise()
    kept = Recorder(model)
    kept.keep(0, state, covariance)
    for k in range(1, runs.azimuth_rad.shape[1]):
        before, point = state, state
        for _ in range(iterations):
            angle, rows = model.linearise(point, k)
            across = covariance @ np.swapaxes(rows, -1, -2)
            gain = across @ np.linalg.inv(rows @ across + noise)
            moved = np.einsum("rmn,rn->rm", rows, before - point)
            residual = wrapped(model.measured(k) - angle) - moved
            point = within_reach(model, before + np.einsum("rnm,rm->rn", gain, residual))
        state = point
        covariance = _joseph(covariance, gain, rows, noise)
        kept.keep(k, state, covariance)
    return kept.estimates


def _joseph(
    covariance: NDArray[np.float64],
    gain: NDArray[np.float64],
    rows: NDArray[np.float64],
    noise: NDArray[np.float64],
) -> NDArray[np.float64]:
    rest = np.eye(covariance.shape[-1]) - gain @ rows
    return rest @ covariance @ np.swapaxes(rest, -1, -2) + gain @ noise @ np.swapaxes(gain, -1, -2)
