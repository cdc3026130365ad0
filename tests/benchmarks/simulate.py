"""Seeded passes: an object that crosses a field of sensors, and what they measure.

The object starts at 2 km/s, 100 km above a flat field of sensors that is as long as its way, and is
driven by white noise on its jerk; the simulation steps exactly from one time to the next, over
knots and measurements alike. What stands still is the first emitter of the scenario
:mod:`geograph.scenarios.moving_sensors`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from model import CLOCK, FREQUENCY, Pass, Size, line_of_sight_angles, transition, unit_noise_root

if TYPE_CHECKING:
    from numpy.typing import NDArray

SPEED_M_S = 2000.0
HEIGHT_M = 100e3
NOISE = 0.01
SIGMA_RAD = 50e-6
BIAS_SIGMA_RAD = 500e-6
DRIFT_SIGMA_RAD_S = 1e-6
CLOCK_SIGMA_S, TOA_SIGMA_S = 1e-6, 30e-9
FREQUENCY_SIGMA_HZ, FDOA_SIGMA_HZ, CARRIER_HZ = 20.0, 1.0, 1e9
LIGHT_M_S = 299792458.0
OFF_M, OFF_M_S = 5e3, 50.0
_PRIOR_SIGMA = np.repeat([1e8, 1e6, 1e4], 3)
_SCALE = np.repeat([50.0, 2.5, 0.125], 3)


def simulate(size: Size, *, seed: int = 1) -> Pass:
    """Return a pass of a given size."""
    if size.knots == 1:
        return _static(size, seed)
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
    emitted = np.sort(rng.uniform(0.0, duration, size.emissions))
    states = _drive(rng, np.concatenate([knots, time, emitted]))
    truth, seen, heard = np.split(states, [size.knots, size.knots + count])
    sigma = np.repeat([BIAS_SIGMA_RAD, DRIFT_SIGMA_RAD_S], 2)
    if size.emissions:
        sigma = np.append(sigma, [CLOCK_SIGMA_S, FREQUENCY_SIGMA_HZ])
    errors = rng.normal(size=(size.sensors, sigma.size)) * sigma
    angles = line_of_sight_angles(seen[:, :3] - sensor_m[sensor])
    noise = SIGMA_RAD * rng.normal(size=(count, 2))
    # White noise on the sky: in azimuth it is wider by 1 / cos(elevation).
    noise[:, 0] /= np.cos(angles[:, 1])
    angles += noise + errors[sensor, :2] + errors[sensor, 2:4] * time[:, None]
    guess = truth.copy()
    off = OFF_M * _direction(rng)
    guess[:, :3] += off
    guess[:, 3:6] += OFF_M_S * _direction(rng)
    return Pass(
        sensor_m=sensor_m,
        sensor_m_s=np.zeros_like(sensor_m),
        error_sigma=sigma,
        time_s=time,
        sensor=sensor,
        azimuth_rad=angles[:, 0],
        elevation_rad=angles[:, 1],
        sigma_rad=np.array(SIGMA_RAD),
        **_heard(rng, emitted, heard, sensor_m=sensor_m, errors=errors, off_m=off),
        altitude_sigma_m=np.array(np.inf),
        knots_s=knots,
        noise=np.array(NOISE),
        guess=guess,
        prior_sigma=_PRIOR_SIGMA,
        scale=_SCALE,
        truth=truth,
        true_errors=errors,
    )


def _heard(
    rng: np.random.Generator,
    emitted_s: NDArray[np.float64],
    states: NDArray[np.float64],
    *,
    sensor_m: NDArray[np.float64],
    errors: NDArray[np.float64],
    off_m: NDArray[np.float64],
) -> dict[str, NDArray[np.float64]]:
    """Return the columns of arrivals and frequency differences."""
    line = sensor_m - states[:, None, :3]
    distance = np.linalg.norm(line, axis=2)
    arrived = emitted_s[:, None] + distance / LIGHT_M_S
    nothing = {"fdoa_hz": np.empty((0, sensor_m.shape[0] - 1)), "fdoa_time_s": np.empty(0)}
    columns = {
        "emitted_s": emitted_s,
        "toa_s": arrived,
        "toa_sigma_s": np.array(TOA_SIGMA_S),
        "carrier_hz": np.array(CARRIER_HZ),
        "fdoa_sigma_hz": np.array(FDOA_SIGMA_HZ),
        "speed_m_s": np.array(LIGHT_M_S),
    } | nothing
    if not emitted_s.size:
        return columns
    closing = np.einsum("nsc,nc->ns", line, states[:, 3:6]) / distance
    received = CARRIER_HZ * LIGHT_M_S / (LIGHT_M_S - closing) + errors[:, FREQUENCY]
    noise = FDOA_SIGMA_HZ * rng.normal(size=(emitted_s.size, sensor_m.shape[0] - 1))
    noted = arrived + errors[:, CLOCK] + TOA_SIGMA_S * rng.normal(size=arrived.shape)
    guessed = np.linalg.norm(line - off_m, axis=2) / LIGHT_M_S
    return columns | {
        "emitted_s": (noted - guessed).mean(axis=1),
        "toa_s": noted,
        "fdoa_hz": received[:, 1:] - received[:, :1] + noise,
        "fdoa_time_s": arrived[:, 0] + errors[0, CLOCK],
    }


def _static(size: Size, seed: int) -> Pass:
    """Return arrival times at moving sensors of an emitter that stands still in the plane z = 0."""
    from dataclasses import replace

    from geograph.scenarios import moving_sensors as study

    base = study.VARIANTS["emitter-1-1ns"]
    variant = replace(base, sets=size.emissions, group_m=base.group_m[: size.sensors])
    toa = study.simulate(variant, [seed]).toa_s[0]
    rng = np.random.default_rng(seed)
    plane = np.zeros((1, 3))
    plane[0, :2] = variant.emitter_m
    sensor_m = np.zeros((size.sensors, 3))
    sensor_m[:, :2] = variant.group_m
    velocity = np.zeros_like(sensor_m)
    velocity[:, 0] = study.SENSOR_SPEED_M_S
    guess = plane.copy()
    guess[:, :2] += OFF_M * np.array([0.6, 0.8]) * rng.choice([-1.0, 1.0], 2)
    away = np.linalg.norm(sensor_m + velocity * toa[:, :, None] - guess[0], axis=2)
    empty = np.empty(0)
    return Pass(
        sensor_m=sensor_m,
        sensor_m_s=velocity,
        error_sigma=empty,
        time_s=empty,
        sensor=np.empty(0, dtype=np.int64),
        azimuth_rad=empty,
        elevation_rad=empty,
        sigma_rad=np.array(SIGMA_RAD),
        emitted_s=(toa - away / LIGHT_M_S).mean(axis=1),
        toa_s=toa,
        toa_sigma_s=np.array(variant.sigma_s),
        fdoa_hz=np.empty((0, size.sensors - 1)),
        fdoa_time_s=empty,
        carrier_hz=np.array(CARRIER_HZ),
        fdoa_sigma_hz=np.array(FDOA_SIGMA_HZ),
        speed_m_s=np.array(LIGHT_M_S),
        altitude_sigma_m=np.array(study.ALTITUDE_SIGMA_M),
        knots_s=np.zeros(1),
        noise=np.array(NOISE),
        guess=guess,
        prior_sigma=np.full(3, 1e8),
        scale=np.full(3, 50.0),
        truth=plane,
        true_errors=np.empty((size.sensors, 0)),
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
