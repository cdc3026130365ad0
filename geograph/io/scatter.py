"""How much a camera's own points scatter about a smooth path on its sky."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

FLOOR_RAD = float(np.radians(0.1 / 60.0))
"""Smallest scatter returned, 0.1 arcmin: below it the catalogue and the optics dominate."""

_HALF_WINDOW_S = 1.0
_DEGREE = 4
_LEAST_TIMES = _DEGREE + 4
# Of the absolute value of a normal variable: sigma over median.
_SIGMA_OF_MEDIAN = 1.482602218505602
# A point that nearly fixes its own polynomial has no residual to speak of.
_GREATEST_LEVERAGE = 0.9


def angular_scatter_rad(
    time_s: NDArray[np.float64],
    azimuth_rad: NDArray[np.float64],
    elevation_rad: NDArray[np.float64],
) -> float | None:
    """Return the robust on-sky scatter of one camera's bearings, radians, from these alone.

    About every point a polynomial of degree 4 in time is fitted by least squares to the points
    within 1 s (or the nearest eight, where there are fewer), in the tangent plane of the point's
    direction (gnomonic projection). The point's residual is divided by the square root of one minus
    its leverage, which makes the residuals of white noise of one variance, and taken along and
    across the motion. Of each component the median absolute value over its value for the normal
    distribution is the scatter; the result is the root mean square of the two, at least
    :data:`FLOOR_RAD`. Two seconds are short enough for the path of a fireball to be such a
    polynomial, and long enough for wander of the reduction over some frames to count as scatter.

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
        None if fewer than eight different times are left.
    """
    order = np.argsort(time_s, kind="stable")
    time, direction = time_s[order], _directions(azimuth_rad[order], elevation_rad[order])
    repeated = np.concatenate([[False], (np.diff(direction, axis=0) == 0.0).all(axis=1)])
    time, direction = time[~repeated], direction[~repeated]
    if np.unique(time).size < _LEAST_TIMES:
        return None
    residuals = [
        residual
        for index in range(time.size)
        if (residual := _residual(index, time, direction)) is not None
    ]
    if not residuals:
        return None
    components = _SIGMA_OF_MEDIAN * np.median(np.abs(residuals), axis=0)
    return max(float(np.sqrt(np.mean(components**2))), FLOOR_RAD)


def _directions(
    azimuth_rad: NDArray[np.float64], elevation_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return unit vectors towards east, north and up, shape (n, 3)."""
    cos = np.cos(elevation_rad)
    return np.stack(
        [cos * np.sin(azimuth_rad), cos * np.cos(azimuth_rad), np.sin(elevation_rad)], axis=1
    )


def _residual(
    index: int, time_s: NDArray[np.float64], direction: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Return one point's residual along and across the motion, radians, shape (2,)."""
    window = _window(index, time_s)
    centre = direction[index]
    # Any two directions across the line of sight: the motion turns them below.
    first = np.cross(np.eye(3)[np.argmin(np.abs(centre))], centre)
    first /= np.linalg.norm(first)
    plane = np.stack([first, np.cross(centre, first)], axis=1)
    depth = direction[window] @ centre
    window, depth = window[depth > 0.5], depth[depth > 0.5]
    if np.unique(time_s[window]).size < _LEAST_TIMES:
        return None
    points = direction[window] @ plane / depth[:, None]
    middle = 0.5 * (time_s[window[0]] + time_s[window[-1]])
    half = 0.5 * (time_s[window[-1]] - time_s[window[0]])
    basis = np.polynomial.chebyshev.chebvander((time_s[window] - middle) / half, _DEGREE)
    orthogonal, _ = np.linalg.qr(basis)
    place = int(np.flatnonzero(window == index)[0])
    leverage = float(orthogonal[place] @ orthogonal[place])
    if leverage > _GREATEST_LEVERAGE:
        return None
    # The point itself is the origin of its tangent plane.
    residual = -(orthogonal[place] @ (orthogonal.T @ points)) / np.sqrt(1.0 - leverage)
    # The second Chebyshev term is the mean rate, which the first two columns span.
    motion = orthogonal[:, 1] @ points
    speed = float(np.linalg.norm(motion))
    along = motion / speed if speed > 0.0 else np.array([1.0, 0.0])
    return np.array([residual @ along, residual @ np.array([-along[1], along[0]])])


def _window(index: int, time_s: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the points about one, in order of time; at the ends the window is moved inwards."""
    half = _HALF_WINDOW_S
    first, last = float(time_s[0]), float(time_s[-1])
    centre = float(np.clip(time_s[index], min(first + half, last), max(last - half, first)))
    near = np.flatnonzero(np.abs(time_s - centre) <= half * (1.0 + 1e-9))
    if np.unique(time_s[near]).size < _LEAST_TIMES or index not in near:
        distances = np.abs(time_s - time_s[index])
        times = np.unique(distances)
        # Two points may lie at one distance, one on each side; then a few more are taken.
        reach = times[min(_LEAST_TIMES, times.size) - 1]
        near = np.flatnonzero(distances <= reach)
    return near.astype(np.int64)
