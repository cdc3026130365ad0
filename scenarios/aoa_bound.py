"""Cramer-Rao bounds of the study from the air, in plain NumPy from the geometry.

An authority independent of ``geograph.bounds``: nothing of the estimator is used. The bound is
recursive: after each step it is the inverse of the information of all angles so far. The published
number of a scenario is the root mean square over the steps of the bound on the horizontal error.

With d = R (x - s) = (a, b, c) the sight along forward, right and up,

    azimuth = atan2(b, a),   elevation = atan2(c, h),   h = hypot(a, b)
    d azimuth / d d = (-b, a, 0) / h^2
    d elevation / d d = (-a c / h, -b c / h, h) / |d|^2

On known ground x = (p, ground(p)): the unknowns are the two horizontal coordinates, and the slope
of the ground enters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.scenarios.airborne import Airborne


def angle_rows(scenario: Airborne) -> NDArray[np.float64]:
    """Return derivatives of the angles with respect to the true place, shape (k, n, 2, 3), rad/m.

    Elevations that are not measured have rows of zero.
    """
    time = scenario.time_s
    axes = scenario.axes_at(time)
    sight = np.einsum(
        "knij,knj->kni", axes, scenario.emitter_at(time)[:, None] - scenario.receivers_at(time)
    )
    a, b, c = np.moveaxis(sight, -1, 0)
    h = np.hypot(a, b)
    azimuth = np.stack([-b, a, np.zeros_like(a)], axis=-1) / h[..., None] ** 2
    elevation = np.stack([-a * c / h, -b * c / h, h], axis=-1)
    elevation /= np.sum(sight**2, axis=-1)[..., None]
    if scenario.azimuth_only:
        elevation[:] = 0.0
    return np.asarray(np.einsum("knmi,knij->knmj", np.stack([azimuth, elevation], axis=-2), axes))


def recursive_bound(scenario: Airborne, *, height_known: bool = False) -> NDArray[np.float64]:
    """Return the bound on a static emitter's place after each step.

    Parameters
    ----------
    scenario
        With a static emitter.
    height_known
        Where the ground is not known: whether the height of the emitter is. The printed bounds of
        the scenarios without terrain are those (docs/accuracy.md).

    Returns
    -------
    Shape (k, 2, 2) on known ground or at a known height, (k, 3, 3) otherwise, square metres;
    infinite until the angles so far tell every coordinate.

    Raises
    ------
    ValueError
        If the emitter moves.
    """
    if scenario.moving:
        raise ValueError(f"scenario {scenario.name} has a moving emitter; expected a static one")
    rows = angle_rows(scenario) / scenario.sigma_rad
    if scenario.terrain_known:
        rows = rows @ on_ground(scenario)
    elif height_known:
        rows = rows[..., :2]
    information = np.cumsum(np.einsum("knma,knmb->kab", rows, rows), axis=0)
    covariance = np.full_like(information, np.inf)
    told = np.linalg.cond(information) < 1e15
    covariance[told] = np.linalg.inv(information[told])
    return covariance


def efficient_errors(scenario: Airborne, noise_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the errors, to first order in the noise, of an estimator that meets the bound.

    The mean square of these is the bound after the last step exactly, so that how much worse an
    estimator is can be told from the same noise, free of how it happened to be drawn.

    Parameters
    ----------
    scenario
        With a static emitter.
    noise_rad
        Shape (runs, 2, k, n): errors of azimuth and elevation.

    Returns
    -------
    Shape (runs, 2): horizontal, after the last step, metres.
    """
    rows = angle_rows(scenario) / scenario.sigma_rad
    if scenario.terrain_known:
        rows = rows @ on_ground(scenario)
    pull = np.einsum("knma,rmkn->ra", rows, noise_rad / scenario.sigma_rad)
    return np.asarray((pull @ recursive_bound(scenario)[-1])[:, :2])


def on_ground(scenario: Airborne) -> NDArray[np.float64]:
    """Return d(x, y, ground) / d(x, y) at the emitter, shape (3, 2)."""
    slope = scenario.terrain.gradient(*scenario.target_m[:2])
    return np.concatenate([np.eye(2), slope[None]])


def horizontal_m(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the root of the sum of the first two variances, shape (...), metres."""
    return np.asarray(np.sqrt(covariance[..., 0, 0] + covariance[..., 1, 1]))


def sequence_bound_m(scenario: Airborne, *, height_known: bool = False) -> float:
    """Return the root mean square over the steps of the bound on the horizontal error, metres."""
    bound = horizontal_m(recursive_bound(scenario, height_known=height_known))
    return float(np.sqrt(np.mean(bound**2)))
