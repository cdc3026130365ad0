"""A track made up from known numbers, for tests of what comes after the smoother.

Nothing here is estimated: path, covariance, sensor errors and residuals are chosen, so that what a
file, a table or a picture shows of them can be checked.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from datetime import UTC, datetime
from types import SimpleNamespace

import numpy as np

from geograph.geodesy import ecef_from_geodetic, enu_axes
from geograph.measurements import Bearings, Truth
from geograph.recording import Recording, SmoothSettings
from geograph.sensors import Sensor, SensorErrors, Trajectory
from geograph.stretches import Stretches

LATITUDE, LONGITUDE = 51.93, -2.2


class MadeStatus(enum.StrEnum):
    converged = "converged"
    unobservable = "unobservable"
    iteration_limit = "iteration_limit"
    diverged = "diverged"


@dataclass(frozen=True)
class MadeEstimate:
    unit: str
    estimate: float
    sigma: float
    prior_sigma: float


def make_track(
    *,
    frame="ecef",
    knots=40,
    sensors=5,
    order=3,
    drifting=True,
    moving=False,
    status="converged",
    truth=False,
    outliers=2,
    name="made",
    sigma_m=60.0,
    seed=1,
):
    """Return something with the attributes of ``geograph.Track``."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, 8.0, knots) if knots > 1 else np.array([0.0])
    level, velocity, acceleration = _level_path(time)
    if frame == "ecef":
        origin = ecef_from_geodetic(LATITUDE, LONGITUDE, 0.0)
        turn = enu_axes(origin)
    else:
        origin, turn = np.zeros(3), np.eye(3)
    position = origin + level @ turn
    spread = sigma_m * (0.6 + 0.4 * np.cos(np.linspace(0.0, 6.0, knots)))
    shape = turn.T @ np.diag([1.0, 0.25, 2.0]) @ turn
    covariance = np.zeros((knots, 3 * order, 3 * order))
    for block in range(order):
        rows = slice(3 * block, 3 * block + 3)
        covariance[:, rows, rows] = (0.1**block * spread[:, None, None]) ** 2 * shape
    table = _sensors(sensors, origin, turn, drifting=drifting, moving=moving)
    bearings = _bearings(sensors)
    recording = Recording(
        name=name,
        frame=frame,
        sensors=table,
        bearings=bearings,
        epoch=datetime(2021, 2, 28, 21, 54, tzinfo=UTC) if frame == "ecef" else None,
        truth=Truth(time_s=time, position_m=position + 30.0, velocity_m_s=velocity @ turn)
        if truth
        else None,
    )
    residuals = _residuals(
        rng, bearings, table, origin + _level_path(bearings.time_s)[0] @ turn, outliers
    )
    return SimpleNamespace(
        recording=recording,
        settings=SmoothSettings(process_noise=10.0, spacing_s=0.2, loss="none"),
        order=order,
        time_s=time,
        state=np.zeros((knots, 3 * order)),
        covariance=covariance,
        position_m=position,
        velocity_m_s=velocity @ turn if order > 1 else None,
        acceleration_m_s2=acceleration @ turn if order > 2 else None,
        position_covariance_m2=covariance[:, :3, :3],
        ellipsoids=lambda probability: _ellipsoids(covariance[:, :3, :3], probability),
        sensor_errors=_errors(rng, table),
        sensor_error_at=lambda sensor, kind, t: (
            1e-4 * np.sin(np.asarray(t) + len(sensor) + len(kind)),
            np.full(np.shape(t), 3e-5),
        ),
        residuals=residuals,
        problem=SimpleNamespace(
            states=SimpleNamespace(
                platforms=[], stretches=Stretches([{} for _ in recording.sensors])
            )
        ),
        status=MadeStatus(status),
        summary=_summary(name, status, residuals, table, knots),
    )


def _level_path(time):
    decay = 1.0 - np.exp(-time / 8.0)
    level = np.stack([-20e3 + 90e3 * decay, 5e3 - 9e3 * decay, 75e3 - 60e3 * decay], axis=-1)
    rate = np.exp(-time / 8.0) / 8.0
    velocity = np.stack([90e3 * rate, -9e3 * rate, -60e3 * rate], axis=-1)
    return level, velocity, -velocity / 8.0


def _sensors(count, origin, turn, *, drifting, moving):
    table = {}
    for index in range(count):
        name = f"CAM{index:02d}"
        angle = 2.0 * np.pi * index / count
        place = origin + np.array([120e3 * np.cos(angle), 120e3 * np.sin(angle), 100.0]) @ turn
        where = {"position_m": place}
        if moving and index == 0:
            known = np.linspace(-1.0, 10.0, 12)
            step = known[:, None] * (np.array([2e3, 1e3, 0.0]) @ turn)
            where = {"trajectory": Trajectory(known, place + step)}
        table[name] = Sensor(
            name=name,
            axes="enu" if turn is not None and not np.allclose(turn, np.eye(3)) else "xyz",
            errors=SensorErrors(
                azimuth_bias_rad=2e-4,
                elevation_bias_rad=2e-4,
                azimuth_drift_rad_s=1e-5 if drifting else 0.0,
                clock_offset_s=1.0,
            ),
            **where,
        )
    return table


def _bearings(sensors, each=60):
    count = sensors * each
    time = np.tile(np.linspace(0.0, 8.0, each), sensors)
    sigma = np.full(count, 3e-4)
    return Bearings(
        time_s=time,
        sensor=np.repeat(np.arange(sensors), each),
        azimuth_rad=np.zeros(count),
        elevation_rad=np.zeros(count),
        sigma_azimuth_rad=sigma,
        sigma_elevation_rad=sigma,
        isotropic=np.ones(count, dtype=bool),
        line=np.arange(2, count + 2),
    )


def _residuals(rng, bearings, table, target, outliers):
    sensors = list(table.values())
    start = np.stack(
        [sensors[i].position_at(t) for i, t in zip(bearings.sensor, bearings.time_s, strict=True)]
    )
    sight = target - start
    if sensors[0].axes == "enu":
        sight = np.einsum("nij,nj->ni", enu_axes(start), sight)
        azimuth = np.arctan2(sight[:, 0], sight[:, 1])
    else:
        azimuth = np.arctan2(sight[:, 1], sight[:, 0])
    elevation = np.arctan2(sight[:, 2], np.hypot(sight[:, 0], sight[:, 1]))
    predicted = np.stack([azimuth, elevation], axis=-1).ravel()
    normalised = rng.standard_normal(predicted.size)
    rejected = np.zeros(predicted.size, dtype=bool)
    for index in rng.choice(len(bearings), outliers, replace=False):
        normalised[2 * index] = 400.0
        rejected[2 * index : 2 * index + 2] = True
    sigma = np.repeat(bearings.sigma_azimuth_rad, 2)
    return SimpleNamespace(
        time_s=np.repeat(bearings.time_s, 2),
        sensor=np.repeat(bearings.sensor, 2),
        reference=np.full(2 * len(bearings), -1),
        unit=np.full(2 * len(bearings), "rad"),
        kind=np.tile(["azimuth", "elevation"], len(bearings)),
        measured=predicted + normalised * sigma,
        predicted=predicted,
        residual=normalised * sigma,
        sigma=sigma,
        normalised=normalised,
        weight=np.where(rejected, 0.0, 1.0),
        rejected=rejected,
        line=np.repeat(bearings.line, 2),
    )


def _errors(rng, table):
    errors = {}
    for index, name in enumerate(table):
        states = {
            "azimuth_bias": MadeEstimate("rad", rng.normal(0, 2e-4), 4e-5, 2e-4),
            "elevation_bias": MadeEstimate("rad", rng.normal(0, 2e-4), 4e-5, 2e-4),
            "clock_offset": MadeEstimate("s", 3.6 if index == 1 else 0.01 * index, 0.02, 1.0),
        }
        if table[name].errors.azimuth_drift_rad_s:
            states["azimuth_drift"] = MadeEstimate("rad/s", rng.normal(0, 1e-5), 4e-6, 1e-5)
        errors[name] = states
    return errors


def _ellipsoids(covariance, probability):
    from scipy.stats import chi2

    values = np.full(covariance.shape[:2], np.inf)
    finite = np.isfinite(covariance).all(axis=(1, 2))
    values[finite] = np.linalg.eigvalsh(covariance[finite])[:, ::-1]
    return SimpleNamespace(semi_axes_m=np.sqrt(chi2.ppf(probability, 3) * values))


def _summary(name, status, residuals, table, knots):
    return {
        "name": name,
        "status": status,
        "message": "reached the tolerances" if status == "converged" else "the height is free",
        "iterations": 9,
        "cost": 301.5,
        "chi2": 603.0,
        "degrees_of_freedom": 580,
        "measurements": residuals.time_s.size // 2,
        "rejected": [
            {
                "sensor": list(table)[residuals.sensor[row]],
                "time_s": float(residuals.time_s[row]),
                "line": int(residuals.line[row]),
                "normalised": residuals.normalised[row],
            }
            for row in np.flatnonzero(residuals.rejected)[::2]
        ],
        "weakly_observed": [],
        "sensors": {
            sensor: {"measurements": 60, "rms_normalised": 1.0, "rejected": 0} for sensor in table
        },
        "flagged_sensors": ["CAM01 clock_offset is 3.6 prior sigmas from zero"],
        "knots": knots,
        "spacing_s": 0.2,
        "process_noise": 10.0,
        "seconds": 0.25,
        "first_guess": {"root": 0, "costs": [1.0, float("inf")]},
    }
