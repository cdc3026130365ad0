"""A long recording: a body that circles among sensors with biases and drifts, for as long as asked.

Drawn from geometry, without geograph's equations.
"""

from __future__ import annotations

import numpy as np

import geograph as gg

RADIUS_M, HEIGHT_M, AWAY_M = 2000.0, 1000.0, 4000.0
TURN_RAD_S = 0.02
SIGMA_RAD, BIAS_RAD, DRIFT_RAD_S = 1e-4, 1e-3, 1e-9
# The circle's jerk, over the square root of the time in which it turns by one radian.
NOISE = RADIUS_M * TURN_RAD_S**3 * TURN_RAD_S**-0.5


def long_pass(duration_s: float, bearings: int, *, sensors: int = 5, seed: int = 1) -> gg.Recording:
    """Return a recording of the circling body.

    Parameters
    ----------
    duration_s
        From the first bearing to about the last.
    bearings
        Of all sensors together, at random times.
    sensors, seed
        Number of sensors, evenly around, and what seeds the noise.
    """
    rng = np.random.default_rng(seed)
    around = np.arange(sensors) * 2.0 * np.pi / sensors
    places = AWAY_M * np.stack([np.cos(around), np.sin(around), 0.0 * around], axis=1)
    errors = gg.SensorErrors(
        azimuth_bias_rad=BIAS_RAD,
        elevation_bias_rad=BIAS_RAD,
        azimuth_drift_rad_s=DRIFT_RAD_S,
        elevation_drift_rad_s=DRIFT_RAD_S,
    )
    bias = rng.normal(size=(sensors, 2)) * BIAS_RAD
    drift = rng.normal(size=(sensors, 2)) * DRIFT_RAD_S
    time = np.sort(rng.uniform(0.0, duration_s, bearings))
    sensor = rng.integers(0, sensors, bearings)
    angle = TURN_RAD_S * time
    at = np.stack(
        [RADIUS_M * np.cos(angle), RADIUS_M * np.sin(angle), HEIGHT_M + 0.0 * angle], axis=1
    )
    line = at - places[sensor]
    elevation = np.arctan2(line[:, 2], np.hypot(line[:, 0], line[:, 1]))
    noise = SIGMA_RAD * rng.normal(size=(bearings, 2))
    error = bias[sensor] + drift[sensor] * time[:, None] + noise
    # White noise on the sky: in azimuth it is wider by 1 / cos(elevation).
    error[:, 0] += noise[:, 0] * (1.0 / np.cos(elevation) - 1.0)
    sigma = np.full(bearings, SIGMA_RAD)
    table = gg.Bearings(
        time_s=time,
        sensor=sensor,
        azimuth_rad=np.arctan2(line[:, 1], line[:, 0]) + error[:, 0],
        elevation_rad=elevation + error[:, 1],
        sigma_azimuth_rad=sigma,
        sigma_elevation_rad=sigma,
        isotropic=np.ones(bearings, dtype=bool),
        line=np.arange(bearings),
    )
    truth = np.linspace(0.0, duration_s, 1001)
    turned = TURN_RAD_S * truth
    position = np.stack(
        [RADIUS_M * np.cos(turned), RADIUS_M * np.sin(turned), HEIGHT_M + 0.0 * turned], axis=1
    )
    return gg.Recording(
        name=f"circling-{duration_s:g}s",
        frame="local",
        sensors={
            f"S{i}": gg.Sensor(name=f"S{i}", position_m=place, axes="xyz", errors=errors)
            for i, place in enumerate(places)
        },
        bearings=table,
        truth=gg.Truth(time_s=truth, position_m=position),
        propagation_speed_m_s=np.inf,
        settings=gg.SmoothSettings(motion="constant-acceleration", process_noise=NOISE),
    )
