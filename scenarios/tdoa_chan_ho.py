"""Chan and Ho's closed form for each set, and the fusion of its fixes ("post-processing").

Y. T. Chan and K. C. Ho, *A simple and efficient estimator for hyperbolic location*, IEEE
Transactions on Signal Processing 42(8), 1994, pp. 1905-1915. Two least squares: the first with the
range to the reference as a third unknown, the second with the squares of the coordinates, which
ties that range to them. All runs and sets are solved at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.scenarios.tdoa_estimators import (
    Estimates,
    difference_covariance,
    differences,
    linear_rows,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.scenarios.moving_sensors import Runs

_TIES = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
"""The squares of x, y and r in those of x and y: r^2 = x^2 + y^2 from the reference."""


@dataclass(frozen=True, eq=False)
class Fixes:
    """One position from each set.

    Attributes
    ----------
    position_m
        Shape (runs, sets, 2), metres.
    covariance_m2
        Shape (runs, sets, 2, 2), square metres.
    """

    position_m: NDArray[np.float64]
    covariance_m2: NDArray[np.float64]


def chan_ho(runs: Runs, *, reference: int = 0) -> Fixes:
    """Locate the emitter from each set of at least four arrival times.

    The second step yields squares; each coordinate takes the sign of the first step's solution,
    seen from the reference: that resolves the ambiguity. Where noise makes a square negative the
    first step's coordinate is kept (1994 says nothing of it; the emitter is then nearly abreast of
    the reference).

    The covariance is that of the second step (1994, equation 25), at the estimate.

    Parameters
    ----------
    runs
        Arrival times.
    reference
        Column of the reference.

    Raises
    ------
    ValueError
        If there are fewer than four sensors: the first step has three unknowns.
    """
    if runs.toa_s.shape[2] < 4:
        raise ValueError(
            f"{runs.toa_s.shape[2]} sensors; Chan and Ho's first step needs at least 4 in a plane"
        )
    runs_count, sets = runs.toa_s.shape[:2]
    flat = differences(runs, reference=reference)
    origin = flat.reference_m.reshape(-1, 2)
    sensor = flat.sensor_m.reshape(runs_count * sets, 1, -1, 2)
    single = type(flat)(origin[:, None], sensor, flat.range_m.reshape(runs_count * sets, 1, -1))
    rows, right = (part[:, 0] for part in linear_rows(single, origin))
    noise = difference_covariance(rows.shape[1], runs.sigma_m)
    first, covariance = _first_step(rows, right, sensor[:, 0] - origin[:, None], noise)
    # Errors of the squares, from those of x, y and r.
    spread = 4.0 * first[:, :, None] * covariance * first[:, None, :]
    weighted = np.einsum("ai,rab->rib", _TIES, np.linalg.inv(spread))
    of_squares = np.linalg.inv(weighted @ _TIES)
    squares = np.einsum("rij,rjb,rb->ri", of_squares, weighted, first**2)
    squares = np.where(squares > 0.0, squares, first[:, :2] ** 2)
    relative = np.sqrt(squares) * np.sign(first[:, :2])
    fix_covariance = of_squares / (4.0 * relative[:, :, None] * relative[:, None, :])
    return Fixes(
        (relative + origin).reshape(runs_count, sets, 2),
        fix_covariance.reshape(runs_count, sets, 2, 2),
    )


def _first_step(
    rows: NDArray[np.float64],
    right: NDArray[np.float64],
    sensor_m: NDArray[np.float64],
    noise: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return x, y and r, counted from the reference, shape (m, 3), with their covariance.

    First with all ranges alike (1994, equation 14b), then with those of that solution (14a).
    """
    weights = np.asarray(np.broadcast_to(np.linalg.inv(noise), (len(rows), *noise.shape)))
    for repeat in range(2):
        weighted = np.swapaxes(rows, 1, 2) @ weights
        covariance = np.asarray(np.linalg.inv(weighted @ rows))
        state = np.einsum("rab,rbn,rn->ra", covariance, weighted, right)
        if repeat == 0:
            distance = np.linalg.norm(state[:, None, :2] - sensor_m, axis=-1)
            weights = np.asarray(np.linalg.inv(distance[:, :, None] * noise * distance[:, None, :]))
    return state, covariance


def post_processing(runs: Runs, *, reference: int = 0, moving: bool = False) -> Estimates:
    """Fuse the fixes of all sets so far, each weighted by the inverse of its covariance.

    For a moving emitter its velocity is a second pair of unknowns, and the estimates are those at
    the latest set. (What the thesis did there is not public.) Weights come from the fixes
    themselves, so that a fix that is too near by chance weighs too much: a bias that grows with the
    noise, and with it the published figures of 10 ns and 1.5 m.

    Parameters
    ----------
    runs
        Arrival times.
    reference
        Column of the reference.
    moving
        Whether to estimate a velocity.

    Returns
    -------
    Estimates from the first set on, or from the second for a moving emitter.
    """
    fixes = chan_ho(runs, reference=reference)
    since = runs.time_s - runs.time_s[0]
    basis = np.stack([np.ones_like(since), since], axis=-1)[:, : 2 if moving else 1]
    design = np.einsum("kp,ij->kipj", basis, np.eye(2)).reshape(since.size, 2, -1)
    weights = np.linalg.inv(fixes.covariance_m2)
    weighted = np.einsum("kia,rkij->rkaj", design, weights)
    information = np.cumsum(np.einsum("rkaj,kjb->rkab", weighted, design), axis=1)
    normal = np.cumsum(np.einsum("rkaj,rkj->rka", weighted, fixes.position_m), axis=1)
    result = Estimates.empty(runs)
    first = 1 if moving else 0
    covariance = np.linalg.inv(information[:, first:])
    state = np.einsum("rkab,rkb->rka", covariance, normal[:, first:])
    at = design[first:]
    result.position_m[:, first:] = np.einsum("kia,rka->rki", at, state)
    result.covariance_m2[:, first:] = np.einsum("kia,rkab,kjb->rkij", at, covariance, at)
    return result


def two_intersections(runs: Runs, *, reference: int = 0) -> NDArray[np.float64]:
    """Return both points that three sensors' range differences allow, for each set.

    With three sensors the linear equations give the emitter as a linear function of its range to
    the reference; tying the two together leaves a quadratic (Chan and Ho 1994, section III).

    Parameters
    ----------
    runs
        Arrival times of three sensors.
    reference
        Column of the reference.

    Returns
    -------
    Shape (runs, sets, 2, 2), metres: root, coordinate; the root of smaller range first, NaN where
    a root is no intersection (its range is negative, or the roots are complex).

    Raises
    ------
    ValueError
        If there are not three sensors.
    """
    if runs.toa_s.shape[2] != 3:
        raise ValueError(f"{runs.toa_s.shape[2]} sensors; two intersections are those of 3")
    pairs = differences(runs, reference=reference)
    toward = pairs.reference_m[:, :, None] - pairs.sensor_m
    right = 0.5 * (pairs.range_m**2 - np.sum(toward**2, axis=-1))
    inverse = np.linalg.inv(toward)
    constant = np.einsum("rkab,rkb->rka", inverse, right)
    slope = np.einsum("rkab,rkb->rka", inverse, pairs.range_m)
    # |constant + slope r|^2 = r^2.
    a = np.sum(slope**2, axis=-1) - 1.0
    b = np.sum(constant * slope, axis=-1)
    c = np.sum(constant**2, axis=-1)
    with np.errstate(invalid="ignore"):
        half = np.sqrt(b * b - a * c)
    ranges = np.sort(np.stack([(-b - half) / a, (-b + half) / a], axis=-1), axis=-1)
    ranges = np.where(ranges > 0.0, ranges, np.nan)
    points = constant[:, :, None] + slope[:, :, None] * ranges[..., None]
    return np.asarray(points + pairs.reference_m[:, :, None])
