"""How much a camera's own points scatter about a smooth pass over its sky."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import BSpline

if TYPE_CHECKING:
    from numpy.typing import NDArray

FLOOR_RAD = float(np.radians(0.1 / 60.0))
"""Smallest scatter returned, 0.1 arcmin: below it the catalogue and the optics dominate."""

_DEGREE = 5
_LEAST_TIMES = _DEGREE + 3
_TIMES_PER_SEGMENT = 4
_SEGMENTS_PER_SECOND = 2
_TIMES_PER_LONG_SEGMENT = (10, 7, 5, 4, 3)
# Rounding of directions, a hundred times.
_NOTHING_RAD = 1e-13


def angular_scatter_rad(
    time_s: NDArray[np.float64],
    azimuth_rad: NDArray[np.float64],
    elevation_rad: NDArray[np.float64],
) -> float | None:
    """Return the on-sky scatter of one camera's bearings, radians, from these alone.

    A straight path is a great circle on the sky of a fixed camera, and a smooth function of time
    along it. The scatter is the root mean square of the residuals across the great circle that fits
    best and along it about a quintic spline in time with two knots a second, both by least squares
    over the whole pass, each corrected for its fitted parameters. It is not a robust scale: a
    wander of the reduction over many frames, and bursts in which the image is saturated, are errors
    that the sigma has to cover, and medians would not see them.

    Points that repeat the direction of the point before (a frame shown twice) are left out, since
    they would pass for agreement; points of one time count as separate measurements.

    Parameters
    ----------
    time_s
        Shape (n,), in any order.
    azimuth_rad, elevation_rad
        Shape (n,), azimuth clockwise from north.

    Returns
    -------
    float or None
        At least :data:`FLOOR_RAD`; None if fewer than eight different times are left, which leave
        too little beyond the fitted parameters.
    """
    order = np.argsort(time_s, kind="stable")
    time, direction = time_s[order], _directions(azimuth_rad[order], elevation_rad[order])
    repeated = np.concatenate([[False], (np.diff(direction, axis=0) == 0.0).all(axis=1)])
    time, direction = time[~repeated], direction[~repeated]
    if np.unique(time).size < _LEAST_TIMES:
        return None
    count = time.size
    _, _, axes = np.linalg.svd(direction, full_matrices=False)
    across = np.arcsin(np.clip(direction @ axes[2], -1.0, 1.0))
    along = np.unwrap(np.arctan2(direction @ axes[1], direction @ axes[0]))
    basis = _spline_basis(time, _pass_segments(time))
    coefficients, *_ = np.linalg.lstsq(basis, along, rcond=None)
    residual = along - basis @ coefficients
    # A great circle has two parameters.
    variances = [
        float(across @ across) / (count - 2),
        float(residual @ residual) / (count - basis.shape[1]),
    ]
    return max(float(np.sqrt(np.mean(variances))), FLOOR_RAD)


def smooth_scatter_rad(
    time_s: NDArray[np.float64],
    azimuth_rad: NDArray[np.float64],
    elevation_rad: NDArray[np.float64],
) -> float | None:
    """Return the on-sky scatter of one sensor's bearings about any smooth path, radians.

    Unlike :func:`angular_scatter_rad` it does not take the path for straight: satellites and
    aircraft do not follow great circles of a station's sky. It is the root mean square of what is
    left, in the tangent plane, of a quintic spline through the directions, corrected for its
    parameters. The spline has a knot for ten times, and more of them, a knot for three at most, as
    long as what is left falls by more than chance would have it: a low satellite that is seen every
    few seconds turns too fast for the first.

    Parameters
    ----------
    time_s
        Shape (n,), in any order.
    azimuth_rad, elevation_rad
        Shape (n,), azimuth clockwise from north.

    Returns
    -------
    float or None
        None if fewer than eight different times leave too little beyond the fitted parameters, or
        the directions do not scatter at all.
    """
    order = np.argsort(time_s, kind="stable")
    time, direction = time_s[order], _directions(azimuth_rad[order], elevation_rad[order])
    times = np.unique(time).size
    if times < _LEAST_TIMES:
        return None
    square, freedom = np.inf, 0
    for each in _TIMES_PER_LONG_SEGMENT:
        basis = _spline_basis(time, max(times // each, 1))
        coefficients, *_ = np.linalg.lstsq(basis, direction, rcond=None)
        residual = direction - basis @ coefficients
        residual -= np.sum(residual * direction, axis=1)[:, None] * direction
        # Two coordinates on the sky, each with the spline's parameters.
        left, free = float(np.sum(residual**2)), 2 * (time.size - basis.shape[1])
        more = freedom - free
        if not freedom or (
            free > 0 and more > 0 and _falls_more_than_by_chance(square - left, more, left / free)
        ):
            square, freedom = left, free
    scatter = float(np.sqrt(square / freedom))
    return scatter if scatter > _NOTHING_RAD else None


def _falls_more_than_by_chance(fall: float, parameters: int, variance: float) -> bool:
    """Tell whether a fall of the squares is beyond four sigmas of that of needless parameters."""
    return bool(fall > parameters * variance * (1.0 + 4.0 * np.sqrt(2.0 / parameters)))


def _pass_segments(time_s: NDArray[np.float64]) -> int:
    most = (np.unique(time_s).size - _DEGREE) // _TIMES_PER_SEGMENT
    wanted = np.ceil(_SEGMENTS_PER_SECOND * (time_s[-1] - time_s[0]))
    return int(np.clip(wanted, 1, max(most, 1)))


def _spline_basis(time_s: NDArray[np.float64], segments: int) -> NDArray[np.float64]:
    """Return the values of the spline's basis functions, shape (n, degree + segments)."""
    low, high = float(time_s[0]), float(time_s[-1])
    edges = np.linspace(low, high, segments + 1)
    knots = np.concatenate([np.full(_DEGREE, low), edges, np.full(_DEGREE, high)])
    return np.asarray(BSpline.design_matrix(time_s, knots, _DEGREE).toarray())


def _directions(
    azimuth_rad: NDArray[np.float64], elevation_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return unit vectors towards east, north and up, shape (n, 3)."""
    cos = np.cos(elevation_rad)
    return np.stack(
        [cos * np.sin(azimuth_rad), cos * np.cos(azimuth_rad), np.sin(elevation_rad)], axis=1
    )
