"""Cramer-Rao bounds of the time-difference study, in plain NumPy from the geometry.

An authority independent of ``geograph.bounds``: nothing of the estimator is used. A set of arrival
times of one emission, r_i + c t0 + noise_i with an unknown t0, has the information

    J' (I - 1 1'/n) J / sigma^2,    J_i = (emitter - sensor_i) / r_i,

because removing the mean removes t0 and loses nothing else (all sigmas alike). That is the
information of the n - 1 time differences to any reference with their covariance sigma^2 (I + 1 1').
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.constants import SPEED_OF_LIGHT_M_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.scenarios.moving_sensors import MovingSensors


def bound_covariance(variant: MovingSensors) -> NDArray[np.float64]:
    """Return the bound of the emitter at the last set, from all sets.

    Position noise of the sensors that is independent at every set widens each arrival by its
    component along the line of sight. Where the platforms are known to fly straight, their places
    and velocities are unknowns beside the emitter, and the noisy positions are measurements.
    Constant offsets of the sensors are no part of the bound.

    Parameters
    ----------
    variant
        The scenario.

    Returns
    -------
    Shape (2, 2), square metres; (4, 4) with the velocity for a moving emitter, SI units.
    """
    size = 4 if variant.moving else 2
    if variant.straight_platforms:
        information = _straight_platforms(variant, size)
    else:
        sigma = float(np.hypot(SPEED_OF_LIGHT_M_S * variant.sigma_s, variant.position_noise_m))
        rows = _without_mean(_emitter_rows(variant, _directions(variant), size)) / sigma
        information = np.einsum("kna,knb->ab", rows, rows)
    # Scaled to correlations: positions and velocities differ by orders of magnitude.
    scale = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(scale[:, None] * information * scale) * scale[:, None] * scale
    return np.asarray(covariance[:size, :size])


def bound_m(variant: MovingSensors) -> float:
    """Return the bound on the RMS position error at the last set, metres."""
    return float(np.sqrt(np.trace(bound_covariance(variant)[:2, :2])))


def _directions(variant: MovingSensors) -> NDArray[np.float64]:
    """Return unit vectors from sensors to emitter, shape (sets, n, 2)."""
    time = variant.time_s
    places = variant.sensors_at(time[:, None])[np.arange(time.size)[:, None], variant.heard_by]
    sight = variant.emitter_at(time)[:, None, :] - places
    return np.asarray(sight / np.linalg.norm(sight, axis=-1, keepdims=True))


def _emitter_rows(
    variant: MovingSensors, direction: NDArray[np.float64], size: int
) -> NDArray[np.float64]:
    """Return derivatives of ranges with respect to the emitter at the last set, (sets, n, size)."""
    if size == 2:
        return direction
    since = (variant.time_s - variant.time_s[-1])[:, None, None]
    return np.concatenate([direction, since * direction], axis=-1)


def _without_mean(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(rows - rows.mean(axis=1, keepdims=True))


def efficient_errors(
    variant: MovingSensors, time_error_s: NDArray[np.float64], position_error_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the errors, to first order in the noise, of an estimator that meets the bound.

    The mean square of these errors is the bound exactly, so that how much worse an estimator is can
    be told from the same noise, free of how the noise of some runs happened to be drawn.

    Parameters
    ----------
    variant
        The scenario.
    time_error_s, position_error_m
        Shapes (runs, sets, all sensors) and (..., 2): noise of arrival times and positions.

    Returns
    -------
    Shape (runs, 2): of the emitter's place at the last set, metres.
    """
    size = 4 if variant.moving else 2
    sets = np.arange(variant.sets)[:, None]
    direction = _directions(variant)
    noise = SPEED_OF_LIGHT_M_S * time_error_s[:, sets, variant.heard_by]
    sigma = SPEED_OF_LIGHT_M_S * variant.sigma_s
    if variant.straight_platforms:
        rows = _platform_rows(variant, size)
        # Reported less true positions are the noise of the fixes.
        fixes = position_error_m / variant.position_noise_m
        pull = np.einsum("kna,rkn->ra", rows, noise / sigma)
        design = _fix_design(variant)
        for sensor in range(position_error_m.shape[2]):
            for axis in range(2):
                at = size + 4 * sensor + np.array([axis, axis + 2])
                pull[:, at] += fixes[:, :, sensor, axis] @ design
        information = _straight_platforms(variant, size)
    else:
        # A sensor that is said to be nearer to the emitter hears it late.
        moved = position_error_m[:, sets, variant.heard_by]
        noise = noise + np.einsum("knc,rknc->rkn", direction, moved)
        sigma = float(np.hypot(sigma, variant.position_noise_m))
        rows = _without_mean(_emitter_rows(variant, direction, size)) / sigma
        pull = np.einsum("kna,rkn->ra", rows, noise / sigma)
        information = np.einsum("kna,knb->ab", rows, rows)
    scale = 1.0 / np.sqrt(np.diag(information))
    step = np.linalg.solve(scale[:, None] * information * scale, (pull * scale).T).T * scale
    return np.asarray(step[:, :2])


def _fix_design(variant: MovingSensors) -> NDArray[np.float64]:
    """Return whitened derivatives of one coordinate's fixes by place and velocity, (sets, 2)."""
    time = variant.time_s
    return np.stack([np.ones_like(time), time], axis=-1) / variant.position_noise_m


def _platform_rows(variant: MovingSensors, size: int) -> NDArray[np.float64]:
    """Return whitened derivatives by the emitter and by each sensor's place and velocity."""
    time, heard = variant.time_s, variant.heard_by
    direction = _directions(variant)
    sensors = len(variant.group_m) + len(variant.second_group_m)
    rows = np.zeros((*heard.shape, size + 4 * sensors))
    rows[..., :size] = _emitter_rows(variant, direction, size)
    sets = np.arange(time.size)[:, None]
    for column in range(heard.shape[1]):
        first = size + 4 * heard[:, column]
        for axis in range(2):
            rows[sets[:, 0], column, first + axis] = -direction[:, column, axis]
            rows[sets[:, 0], column, first + 2 + axis] = -direction[:, column, axis] * time
    return _without_mean(rows) / (SPEED_OF_LIGHT_M_S * variant.sigma_s)


def _straight_platforms(variant: MovingSensors, size: int) -> NDArray[np.float64]:
    """Return the information of the emitter and then of each sensor's place and velocity."""
    rows, design = _platform_rows(variant, size), _fix_design(variant)
    information = np.einsum("kna,knb->ab", rows, rows)
    for sensor in range(len(variant.group_m) + len(variant.second_group_m)):
        for axis in range(2):
            at = size + 4 * sensor + np.array([axis, axis + 2])
            information[np.ix_(at, at)] += design.T @ design
    return np.asarray(information)
