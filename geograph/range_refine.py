"""Splines fitted to arrival times, differences and bearings by robust Levenberg-Marquardt.

The loss is on the scale of the residuals themselves: first one that grows like the absolute value,
so that a start from far away is drawn in by all rows, then Cauchy's, so that the end is not by the
few that are wrong (P. W. Holland, R. E. Welsch, *Robust regression using iteratively reweighted
least-squares*, Commun. Stat. A 6, 1977).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import BSpline

from geograph.factors.constraints import altitude
from geograph.lines import Attempt, robust_scale
from geograph.range_residuals import LEAST_SCALE, Evaluator, Residuals

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.range_data import RangeData

# Last rounds, with a scale of their own each, iterations within one, relative gain that ends it.
_ROUNDS = 2
_ITERATIONS = 12
_ENOUGH = 1e-4
_MOST_DAMPING = 1e8

# What heights may be off by in the first rounds, in distances: their surface is curved. The loss
# of these rounds is that of the absolute value.
_SOFT_HEIGHT = (1e-2, 1e-3)

# Farther away, in sizes of the array, nothing is told apart.
_FARTHEST = 1e4

# A step moves no coefficient farther than this share of the distance.
_LONGEST_STEP = 0.5


def knots_of(low_s: float, high_s: float, degree: int, segments: int) -> NDArray[np.float64]:
    """Return the knots of a clamped spline over a span, widened if it has no length."""
    if not high_s > low_s:
        high_s = low_s + 1.0
    inner = np.linspace(low_s, high_s, segments + 1)
    return np.concatenate([np.full(degree, low_s), inner, np.full(degree, high_s)])


def constant_spline(point_m: NDArray[np.float64], time_s: NDArray[np.float64]) -> BSpline:
    """Return a path that stays at a point, shape (3,), over the span of some times."""
    knots = knots_of(float(time_s.min()), float(time_s.max()), 0, 1)
    return BSpline(knots, point_m[None, :].astype(np.float64), 0)


def reshaped(spline: BSpline, time_s: NDArray[np.float64], degree: int, segments: int) -> BSpline:
    """Return a path of another flexibility that is as close to a given one as it can be.

    Parameters
    ----------
    spline
        The path.
    time_s
        Shape (n,): times that the new one spans.
    degree, segments
        Of the new one.
    """
    knots = knots_of(float(time_s.min()), float(time_s.max()), degree, segments)
    dense = np.linspace(knots[0], knots[-1], 8 * (degree + segments))
    value = state_of(spline, dense)[0]
    centre = value.mean(axis=0)
    basis = BSpline.design_matrix(dense, knots, degree).toarray()
    coefficients = np.linalg.lstsq(basis, value - centre, rcond=None)[0]
    return BSpline(knots, coefficients + centre, degree)


def state_of(
    spline: BSpline, time_s: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return position and velocity, shapes (n, 3); straight on outside the span."""
    inside = np.clip(time_s, spline.t[0], spline.t[-1])
    velocity = np.asarray(spline(inside, 1)) if spline.k else np.zeros((inside.size, 3))
    return np.asarray(spline(inside)) + (time_s - inside)[:, None] * velocity, velocity


def evaluate(
    evaluator: Evaluator,
    spline: BSpline,
    emitted_s: NDArray[np.float64] | None = None,
    *,
    jacobian: bool = False,
) -> Residuals:
    """Return the residuals of a path at its own times of emission.

    Parameters
    ----------
    evaluator
        Of the data.
    spline
        The path.
    emitted_s
        Shape (events,): times of emission so far; None: found from the times of arrival.
    jacobian
        Whether derivatives are wanted.
    """

    def state(time: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return state_of(spline, time)

    if emitted_s is None:
        emitted_s = evaluator.start_s
        for _ in range(3 if spline.k else 1):
            emitted_s = evaluator(state, emitted_s).emitted_s
    return evaluator(state, emitted_s, jacobian=jacobian)


def refined(evaluator: Evaluator, spline: BSpline) -> Attempt:
    """Return the path of the same flexibility that fits best, near a given one.

    Parameters
    ----------
    evaluator
        Of the data.
    spline
        Where to start.
    """
    found = evaluate(evaluator, spline, jacobian=True)
    return finished(evaluator, *_drawn_in(evaluator, spline, found))


def drawn_in(evaluator: Evaluator, spline: BSpline) -> tuple[BSpline, Residuals]:
    """Return the first half of :func:`refined`: a path drawn in by all rows, and its residuals.

    Parameters
    ----------
    evaluator, spline
        As of :func:`refined`.
    """
    return _drawn_in(evaluator, spline, evaluate(evaluator, spline, jacobian=True))


def _drawn_in(evaluator: Evaluator, spline: BSpline, found: Residuals) -> tuple[BSpline, Residuals]:
    for soft in _SOFT_HEIGHT:
        loss = _Loss(max(robust_scale(found.value), LEAST_SCALE), True, soft)
        spline, found = _minimised(evaluator, spline, found, loss)
    return spline, found


def finished(evaluator: Evaluator, spline: BSpline, found: Residuals) -> Attempt:
    """Return the second half of :func:`refined`: the path that is best but for a few wrong rows.

    Parameters
    ----------
    evaluator
        Of the data.
    spline, found
        From :func:`drawn_in`.
    """
    for _ in range(_ROUNDS):
        loss = _Loss(3.0 * max(robust_scale(found.value), LEAST_SCALE), False, 0.0)
        before = spline
        spline, found = _minimised(evaluator, spline, found, loss)
        moved = np.abs(spline.c - before.c).max()
        if moved <= 1e-6 * float(np.median(found.distance_m)):
            break
    return _attempt(spline, found)


def fitted(evaluator: Evaluator, spline: BSpline) -> Attempt:
    """Return a path as it is, with its residuals on given data."""
    found = evaluate(evaluator, spline)
    return _attempt(spline, found)


def _attempt(spline: BSpline, found: Residuals) -> Attempt:
    # Ranges know no behind.
    return Attempt(spline, found.value[:, None], int(spline.c.size), _range(found), 0.0)


def _range(found: Residuals) -> float:
    return float(np.median(found.distance_m)) if found.distance_m.size else 0.0


@dataclass(frozen=True)
class _Loss:
    """What residuals cost: like their absolute value, or their logarithm, beyond a scale.

    ``soft`` is what heights may be off by, in distances.
    """

    scale: float
    absolute: bool
    soft: float

    def cost(self, value: NDArray[np.float64]) -> float:
        """Return the sum."""
        square = (value / self.scale) ** 2
        rows = 2.0 * (np.sqrt(1.0 + square) - 1.0) if self.absolute else np.log1p(square)
        return self.scale**2 * float(rows.sum())

    def weight(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the weights of least squares, shape (n,)."""
        square = (value / self.scale) ** 2
        return np.asarray(1.0 / (np.sqrt(1.0 + square) if self.absolute else 1.0 + square))


def _minimised(
    evaluator: Evaluator, spline: BSpline, found: Residuals, loss: _Loss
) -> tuple[BSpline, Residuals]:
    data = evaluator.data
    damping = 1e-3
    cost = _cost(data, spline, found, loss)
    for _ in range(_ITERATIONS):
        information, pull = _normal(data, spline, found, loss)
        size = np.diag(information).copy()
        size = np.maximum(size, 1e-9 * float(size.max(initial=0.0)) + 1e-300)
        gained = 0.0
        while damping < _MOST_DAMPING:
            step = np.linalg.lstsq(information + damping * np.diag(size), -pull, rcond=None)[0]
            step = step.reshape(spline.c.shape)
            longest = _LONGEST_STEP * max(_range(found), _spread(data))
            step *= min(1.0, longest / max(float(np.linalg.norm(step, axis=1).max()), 1e-300))
            tried = BSpline(spline.t, spline.c + step, spline.k)
            now = evaluate(evaluator, tried, found.emitted_s, jacobian=True)
            after = _cost(data, tried, now, loss)
            if after < cost:
                gained = (cost - after) / max(cost, 1e-300)
                spline, found, cost = tried, now, after
                damping = max(0.1 * damping, 1e-9)
                break
            damping *= 10.0
        if gained < _ENOUGH:
            break
    return spline, found


def _spread(data: RangeData) -> float:
    places = data.ranges.motion.position_m
    return float(np.linalg.norm(np.ptp(places, axis=0))) if places.size else 0.0


def _height_rows(
    data: RangeData, spline: BSpline, soft_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return whitened misfits of known heights, their directions, and their times."""
    heights = data.heights
    inside = np.clip(heights.time_s, spline.t[0], spline.t[-1])
    height, up = altitude(np.asarray(spline(inside)), data.frame)
    sigma = np.hypot(heights.sigma, soft_m)
    value = (height - heights.value) / sigma
    # Where the ellipsoid has no height, at the Earth's centre, a start is not drawn anywhere.
    good = np.isfinite(value) & np.isfinite(up).all(axis=1)
    return value[good], (up / sigma[:, None])[good], inside[good]


def too_far(data: RangeData, spline: BSpline) -> bool:
    """Tell whether a path leads to where the measurements tell nothing apart, or nowhere."""
    places = data.ranges.motion.position_m
    spread = _spread(data)
    if not spread > 0.0:
        return not bool(np.isfinite(spline.c).all())
    away = np.linalg.norm(spline.c - places.mean(axis=0), axis=1).max()
    return not bool(away < _FARTHEST * spread)


def _cost(data: RangeData, spline: BSpline, found: Residuals, loss: _Loss) -> float:
    if too_far(data, spline):
        return np.inf
    cost = loss.cost(found.value)
    if data.heights.value.size:
        cost += float((_height_rows(data, spline, loss.soft * _range(found))[0] ** 2).sum())
    return cost if np.isfinite(cost) else np.inf


def _basis(spline: BSpline, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the basis functions at times in the span, shape (n, b)."""
    if spline.k == 0 and len(spline.c) == 1:
        return np.ones((time_s.size, 1))
    return np.asarray(BSpline.design_matrix(time_s, spline.t, spline.k).toarray())


def _normal(
    data: RangeData, spline: BSpline, found: Residuals, loss: _Loss
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the normal equations' matrix and gradient."""
    low, high = spline.t[0], spline.t[-1]
    inside = np.clip(found.emitted_s, low, high)
    basis = _basis(spline, inside)
    rate = np.zeros_like(basis)
    if spline.k:
        count = basis.shape[1]
        rate = np.asarray(BSpline(spline.t, np.eye(count), spline.k)(inside, 1))
        basis = basis + (found.emitted_s - inside)[:, None] * rate
    event = found.event
    design = np.einsum("nc,nb->nbc", found.by_position, basis[event])
    design += np.einsum("nc,nb->nbc", found.by_velocity, rate[event])
    design = design.reshape(event.size, -1)
    weight = loss.weight(found.value)
    rows = len(data.ranges)
    if rows:
        # The time of emission takes up what all rows of a group have in common.
        group, slope = data.ranges.group, found.slope[:rows]
        start = np.searchsorted(group, np.arange(data.ranges.origin_s.size))
        force = weight[:rows] * slope
        taken = np.add.reduceat(force[:, None] * design[:rows], start, axis=0)
        taken /= np.add.reduceat(force * slope, start)[:, None]
        design[:rows] -= slope[:, None] * taken[group]
    information = design.T @ (weight[:, None] * design)
    pull = design.T @ (weight * found.value)
    if data.heights.value.size:
        value, up, time = _height_rows(data, spline, loss.soft * _range(found))
        at = _basis(spline, time)
        extra = np.einsum("nc,nb->nbc", up, at).reshape(value.size, -1)
        information += extra.T @ extra
        pull += extra.T @ value
    return information, pull
