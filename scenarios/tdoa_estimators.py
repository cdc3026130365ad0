"""Closed-form starts and windowed maximum likelihood from time differences (Camlica 2009).

Everything works on many runs at once. Ranges are times times the speed of light; a range
difference is the arrival at a sensor less that at the reference, of the same set, with covariance
sigma^2 (I + 1 1'). Sensors are taken where they say that they were at the set.

The thesis is known to us by its figures alone. What it leaves open, and what was chosen, is said in
each function; docs/accuracy.md says which choice comes how near to the published figures.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.constants import SPEED_OF_LIGHT_M_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.scenarios.moving_sensors import Runs

START_SETS = 4
"""Sets from which recursions start."""

SPEED_SIGMA_M_S = 90.0
"""Prior sigma of each component of a moving emitter's velocity: the thesis's greatest speed."""

LOST_M = 1e6
"""An estimate farther than this from the origin, ten times the emitters' distance, has diverged."""

SECOND_SENSOR = 1
"""Reference of the windowed maximum likelihood, as a column of the set."""


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates after every set.

    Attributes
    ----------
    position_m
        Shape (runs, sets, 2), metres; NaN before the first estimate.
    covariance_m2
        Shape (runs, sets, 2, 2): what the estimator believes, square metres.
    """

    position_m: NDArray[np.float64]
    covariance_m2: NDArray[np.float64]

    @classmethod
    def empty(cls, runs: Runs) -> Estimates:
        """Return estimates that are all NaN, to be filled."""
        shape = (len(runs), runs.time_s.size, 2)
        return cls(np.full(shape, np.nan), np.full((*shape, 2), np.nan))


@dataclass(frozen=True, eq=False)
class Differences:
    """Range differences of sets, with where their sensors are.

    Attributes
    ----------
    reference_m
        Shape (runs, k, 2): the reference at each set.
    sensor_m
        Shape (runs, k, n - 1, 2): the other sensors.
    range_m
        Shape (runs, k, n - 1): their measured range less the reference's.
    """

    reference_m: NDArray[np.float64]
    sensor_m: NDArray[np.float64]
    range_m: NDArray[np.float64]


def differences(runs: Runs, *, reference: int = 0, sets: slice = slice(None)) -> Differences:
    """Return the range differences of sets to a reference.

    Parameters
    ----------
    runs
        Arrival times.
    reference
        Column of the reference within the set: 0 for the group's first sensor.
    sets
        Which sets.

    Raises
    ------
    ValueError
        If there is no such column.
    """
    count = runs.toa_s.shape[2]
    if not 0 <= reference < count:
        raise ValueError(f"reference {reference}; expected a column from 0 to {count - 1}")
    others = [column for column in range(count) if column != reference]
    toa, places = runs.toa_s[:, sets], runs.sensor_m[:, sets]
    return Differences(
        places[:, :, reference],
        places[:, :, others],
        SPEED_OF_LIGHT_M_S * (toa[:, :, others] - toa[:, :, [reference]]),
    )


def without_lost(position_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return positions, shape (runs, 2), with NaN for those that have diverged."""
    near = np.linalg.norm(position_m, axis=-1, keepdims=True) < LOST_M
    return np.where(near, position_m, np.nan)


def difference_covariance(count: int, sigma_m: float) -> NDArray[np.float64]:
    """Return the covariance, shape (count, count), of range differences to one reference."""
    return np.asarray(sigma_m**2 * (np.eye(count) + 1.0))


def predicted_differences(
    position_m: NDArray[np.float64],
    sensor_m: NDArray[np.float64],
    reference_m: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return range differences and their derivatives.

    Parameters
    ----------
    position_m, reference_m
        Shape (..., 2): emitter and reference, metres.
    sensor_m
        Shape (..., n, 2): the other sensors.

    Returns
    -------
    difference_m
        Shape (..., n): range of the sensor less that of the reference.
    jacobian
        Shape (..., n, 2), with respect to the emitter.
    """
    sight = position_m[..., None, :] - sensor_m
    distance = np.linalg.norm(sight, axis=-1)
    sight_reference = position_m - reference_m
    distance_reference = np.linalg.norm(sight_reference, axis=-1)
    jacobian = (
        sight / distance[..., None]
        - (sight_reference / distance_reference[..., None])[..., None, :]
    )
    return distance - distance_reference[..., None], jacobian


@dataclass(frozen=True, eq=False)
class Start:
    """Solution of the linear equations of some sets.

    Attributes
    ----------
    state
        Shape (runs, n): emitter (m) and, where it moves, its velocity (m/s); range to the reference
        (m) and, of several sets, its rate (m/s); all at the last of the sets.
    covariance
        Shape (runs, n, n), of the state.
    """

    state: NDArray[np.float64]
    covariance: NDArray[np.float64]


def linear_rows(
    sets: Differences, origin_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the equations of sets, linear in the emitter and the range to the reference.

    From r_i = r + d_i and r_i^2 = |x - s_i|^2, with d_i the measured range difference:

        (s - s_i)' x - d_i r = (d_i^2 - |s_i|^2 + |s|^2) / 2

    (Chan and Ho 1994, equations 6 and 7.) Its error is r_i times that of d_i, to first order.

    Parameters
    ----------
    sets
        Range differences.
    origin_m
        Shape (runs, 2): places are counted from here, so that their squares stay small.

    Returns
    -------
    rows
        Shape (runs, k, n, 3): coefficients of x, y and r.
    right
        Shape (runs, k, n).
    """
    sensor = sets.sensor_m - origin_m[:, None, None]
    reference = (sets.reference_m - origin_m[:, None])[:, :, None]
    rows = np.concatenate([reference - sensor, -sets.range_m[..., None]], axis=-1)
    squares = np.sum(reference**2, axis=-1) - np.sum(sensor**2, axis=-1)
    return rows, 0.5 * (sets.range_m**2 + squares)


def weighted_start(
    runs: Runs,
    *,
    first: int = 0,
    sets: int = START_SETS,
    reference: int = 0,
    moving: bool = False,
) -> Start:
    """Start from one set, or from several: weighted least squares of the linear equations.

    The unknowns are the emitter, the range to the reference and, of several sets, the rate of that
    range, taken as constant over them: the reference moves between sets. The range is not tied to
    the emitter. Weights need the ranges r_i: first they are taken alike, then from the solution,
    once (as in Chan and Ho 1994 for near emitters).

    Parameters
    ----------
    runs
        Arrival times; the reference must be the same sensor in all sets used.
    first, sets
        Index of the first set, and how many.
    reference
        Column of the reference.
    moving
        Whether the emitter has a velocity, of prior sigma :data:`SPEED_SIGMA_M_S`. A few sets
        hardly tell it; but a start that takes a moving emitter as static is wrong by many of its
        own sigmas.
    """
    window = slice(first, first + sets)
    used = differences(runs, reference=reference, sets=window)
    origin = used.reference_m[:, -1]
    rows, right = linear_rows(used, origin)
    since = (runs.time_s[window] - runs.time_s[window][-1])[:, None, None]
    parts = [rows[..., :2], rows[..., :2] * since] if moving else [rows[..., :2]]
    parts += [rows[..., 2:], rows[..., 2:] * since] if sets > 1 else [rows[..., 2:]]
    rows = np.concatenate(parts, axis=-1)
    prior = np.zeros(rows.shape[-1])
    prior[2:4] = SPEED_SIGMA_M_S**-2 if moving else 0.0
    noise = difference_covariance(rows.shape[2], runs.sigma_m)
    # The scale of the first weights does not matter; this keeps the covariance near its size.
    distance = np.full(right.shape, 1e5)
    for _ in range(2):
        inverse = np.linalg.inv(distance[..., :, None] * noise * distance[..., None, :])
        weighted = np.einsum("rkna,rknm->rkam", rows, inverse)
        information = np.einsum("rkam,rkmb->rab", weighted, rows) + np.diag(prior)
        covariance = np.linalg.inv(information)
        normal = np.einsum("rkam,rkm->ra", weighted, right)
        state = np.einsum("rab,rb->ra", covariance, normal)
        distance = np.linalg.norm(
            state[:, None, None, :2] + origin[:, None, None] - used.sensor_m, axis=-1
        )
    state[:, :2] += origin
    return Start(state, covariance)


def pseudo_recursive(
    runs: Runs,
    *,
    window: int = 20,
    reference: int = SECOND_SENSOR,
    correlated: bool = False,
    steps: int = 1,
) -> Estimates:
    """Maximum likelihood from the latest sets, each time from the estimate before.

    At each set the latest ``window`` sets are linearised at the last estimate and solved by least
    squares (Gauss-Newton, Foy 1976). It forgets what left the window: hence pseudo-recursive.

    Not defined by what is public of the thesis: the number of sets behind its tables, the reference
    and the weights. The published figures come out, for both emitters and all noise levels, with 20
    sets, the second sensor as reference, and the range differences taken as independent, which they
    are not; with their true covariance the same window does better (docs/accuracy.md).

    Parameters
    ----------
    runs
        Arrival times.
    window
        Number of sets fused; 1, 5, 10 and 20 in the thesis.
    reference
        Column of the reference within the set.
    correlated
        Whether the weights know that differences share the reference's error.
    steps
        Gauss-Newton steps at each set.

    Returns
    -------
    Estimates; NaN from where a run diverged.
    """
    start = weighted_start(runs, reference=reference)
    position = start.state[:, :2]
    every = differences(runs, reference=reference)
    count = every.range_m.shape[2]
    noise = difference_covariance(count, runs.sigma_m)
    weights = np.linalg.inv(noise if correlated else np.diag(np.diag(noise)))
    result = Estimates.empty(runs)
    for last in range(START_SETS - 1, runs.time_s.size):
        sets = slice(max(0, last + 1 - window), last + 1)
        for _ in range(steps):
            difference, jacobian = predicted_differences(
                position[:, None], every.sensor_m[:, sets], every.reference_m[:, sets]
            )
            weighted = np.einsum("rkna,nm->rkam", jacobian, weights)
            residual = every.range_m[:, sets] - difference
            covariance = np.linalg.inv(np.einsum("rkam,rkmb->rab", weighted, jacobian))
            step = np.einsum("rkam,rkm->ra", weighted, residual)
            position = without_lost(position + np.einsum("rab,rb->ra", covariance, step))
        result.position_m[:, last] = position
        result.covariance_m2[:, last] = covariance
    return result
