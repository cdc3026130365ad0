"""Seeded passes: an object that crosses a field of sensors, and its bearings.

The object starts at 2 km/s, 100 km above a flat field of sensors that is as long as its way, and is
driven by white noise on its jerk; the simulation steps exactly from one time to the next, over
knots and bearings alike.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from model import (
    ERRORS,
    Pass,
    Size,
    line_of_sight_angles,
    transition,
    unit_noise_root,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

SPEED_M_S = 2000.0
HEIGHT_M = 100e3
NOISE = 0.01
SIGMA_RAD = 50e-6
BIAS_SIGMA_RAD = 500e-6
DRIFT_SIGMA_RAD_S = 1e-6
OFF_M, OFF_M_S = 5e3, 50.0
_PRIOR_SIGMA = np.repeat([1e8, 1e6, 1e4], 3)
_SCALE = np.repeat([50.0, 2.5, 0.125], 3)


def simulate(size: Size, *, seed: int = 1) -> Pass:
    """Return a pass of a given size."""
    rng = np.random.default_rng(seed)
    duration = size.knots - 1.0
    length = SPEED_M_S * duration
    sensor_m = np.stack(
        [
            np.linspace(-0.1, 1.1, size.sensors) * length,
            rng.uniform(-3e5, 3e5, size.sensors),
            rng.uniform(0.0, 1e3, size.sensors),
        ],
        axis=1,
    )
    knots = np.linspace(0.0, duration, size.knots)
    count = size.sensors * size.bearings
    time = np.sort(rng.uniform(0.0, duration, count))
    sensor = rng.permutation(np.repeat(np.arange(size.sensors), size.bearings))
    states = _drive(rng, np.concatenate([knots, time]))
    truth, seen = states[: size.knots], states[size.knots :]
    sigma = np.repeat([BIAS_SIGMA_RAD, DRIFT_SIGMA_RAD_S], 2)
    errors = rng.normal(size=(size.sensors, ERRORS)) * sigma
    angles = line_of_sight_angles(seen[:, :3] - sensor_m[sensor])
    noise = SIGMA_RAD * rng.normal(size=(count, 2))
    # White noise on the sky: in azimuth it is wider by 1 / cos(elevation).
    noise[:, 0] /= np.cos(angles[:, 1])
    angles += noise + errors[sensor, :2] + errors[sensor, 2:] * time[:, None]
    guess = truth.copy()
    guess[:, :3] += OFF_M * _direction(rng)
    guess[:, 3:6] += OFF_M_S * _direction(rng)
    return Pass(
        sensor_m=sensor_m,
        error_sigma=sigma,
        time_s=time,
        sensor=sensor,
        azimuth_rad=angles[:, 0],
        elevation_rad=angles[:, 1],
        sigma_rad=np.array(SIGMA_RAD),
        knots_s=knots,
        noise=np.array(NOISE),
        guess=guess,
        prior_sigma=_PRIOR_SIGMA,
        scale=_SCALE,
        truth=truth,
        true_errors=errors,
    )


def _drive(rng: np.random.Generator, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return exact samples of the driven object at any times, shape (n, 9)."""
    order = np.argsort(time_s, kind="stable")
    steps = np.diff(time_s[order], prepend=0.0)
    turn = transition(steps)
    shock = NOISE * unit_noise_root(steps) @ rng.normal(size=(steps.size, 3, 3))
    state = np.array([[0.0, 0.0, HEIGHT_M], [SPEED_M_S, 0.0, 0.0], [0.0, 0.0, 0.0]])
    states = np.empty((steps.size, 9))
    for target, matrix, jump in zip(order, turn, shock, strict=True):
        state = matrix @ state + jump
        states[target] = state.ravel()
    return states


def _direction(rng: np.random.Generator) -> NDArray[np.float64]:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))
