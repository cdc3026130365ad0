"""The algebra of closed-form fixes: weights, roots and the relation among the unknowns.

See :mod:`geograph.closed_form` for the equations. Unknowns are (y, b, lambda), with k coordinates
y, and lambda = |y|^2 - b^2.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

# Singular values below this share of the greatest are rounding: rows are in units of the array.
_RANK_TOLERANCE = 1e-12

# Rounds of the second step, and halvings of one that does not gain.
_RELATION_ROUNDS = 10
_HALVINGS = 6


def check_arrivals(
    sensor_m: NDArray[np.float64], toa_s: NDArray[np.float64], speed_m_s: float
) -> None:
    """Refuse positions and arrival times whose shapes or values cannot be.

    Parameters
    ----------
    sensor_m
        Expected: shape (n, 2) or (n, 3), finite.
    toa_s
        Expected: shape (n,), finite, n of at least 1.
    speed_m_s
        Expected: finite, above 0.

    Raises
    ------
    InputError
        If anything else is given.
    """
    if sensor_m.ndim != 2 or sensor_m.shape[1] not in (2, 3) or toa_s.shape != sensor_m.shape[:1]:
        raise InputError(
            f"sensors have shape {sensor_m.shape} and arrival times {toa_s.shape}; "
            "expected (n, 2) or (n, 3), and (n,)"
        )
    if not toa_s.size:
        raise InputError("no arrival time; expected at least one")
    if not (np.isfinite(sensor_m).all() and np.isfinite(toa_s).all()):
        raise InputError("a sensor's position or an arrival time is not finite; remove such rows")
    if not (np.isfinite(speed_m_s) and speed_m_s > 0.0):
        raise InputError(f"speed of propagation is {speed_m_s}; expected finite and above 0")


def whitening(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return W with W'W the inverse of a covariance of arrivals, to a common error of all.

    The common error is free, so that adding to it changes nothing; it makes the covariance of
    differences against one sensor, whose own row is zero, regular.

    Parameters
    ----------
    covariance
        Shape (N, N).

    Raises
    ------
    InputError
        If no variance is positive, or one is not finite.
    """
    variance = np.diag(covariance)
    if not np.isfinite(covariance).all() or not (variance > 0.0).any() or (variance < 0.0).any():
        raise InputError("sigmas of arrival times are not finite and above 0; expected both")
    least = float(variance[variance > 0.0].min())
    values, vectors = np.linalg.eigh(covariance + least)
    floor = 1e-9 * least
    return np.asarray(vectors.T / np.sqrt(np.maximum(values, floor))[:, None])


def linear_roots(
    matrix: NDArray[np.float64], value: NDArray[np.float64], weights: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Return the solutions (y, b, lambda) of weighted linear equations that obey the relation.

    The least certain combination of the unknowns is found by singular values and then from lambda =
    |y|^2 - b^2. Where the quadratic has no real root, the place of its least misfit is taken.

    Parameters
    ----------
    matrix, value
        Shapes (N, k + 2) and (N,).
    weights
        Shape (N, N): whitens the equations.
    """
    left, values, rows = np.linalg.svd(weights @ matrix, full_matrices=True)
    width = matrix.shape[1]
    size = np.zeros(width)
    size[: values.size] = values
    known = size > _RANK_TOLERANCE * size[0]
    seen = left.T @ (weights @ value)
    share = np.zeros(width)
    share[: values.size] = np.where(
        known[: values.size],
        seen[: values.size] / np.where(known[: values.size], values, 1.0),
        0.0,
    )
    found = []
    free = np.flatnonzero(~known)
    for column in free if free.size else [width - 1]:
        rest = share.copy()
        rest[column] = 0.0
        base, along = rest @ rows, rows[column]
        found += [base + step * along for step in _relation_steps(base, along)]
    if not free.size:
        found.append(share @ rows)
    return found


def _relation_steps(base: NDArray[np.float64], along: NDArray[np.float64]) -> list[float]:
    """Return the steps t for which base + t along obeys lambda = |y|^2 - b^2."""
    square = float(along[:-2] @ along[:-2] - along[-2] ** 2)
    half = float(base[:-2] @ along[:-2] - base[-2] * along[-2] - 0.5 * along[-1])
    rest = float(base[:-2] @ base[:-2] - base[-2] ** 2 - base[-1])
    discriminant = half * half - square * rest
    if discriminant <= 0.0:
        return [-half / square if square != 0.0 else 0.0]
    # The sum that does not cancel; the other root by their product.
    larger = -(half + np.copysign(np.sqrt(discriminant), half))
    return [rest / larger] + ([larger / square] if abs(square) > 1e-15 else [])


def impose(
    matrix: NDArray[np.float64],
    value: NDArray[np.float64],
    unknowns: NDArray[np.float64],
    weights_at: Callable[[NDArray[np.float64]], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Return the unknowns that obey the relation and fit the equations best, near given ones.

    Parameters
    ----------
    matrix, value
        As in :func:`linear_roots`.
    unknowns
        Shape (k + 2,): where to start.
    weights_at
        Returns what whitens the equations, shape (N, N), for given unknowns.
    """
    free = _obeying(unknowns[:-1])
    for _ in range(_RELATION_ROUNDS):
        weights = weights_at(free)
        residual = weights @ (matrix @ free - value)
        if not np.isfinite(residual).all():
            break
        slope = weights @ (
            matrix[:, :-1]
            + 2.0 * matrix[:, -1:] * np.concatenate([free[:-2], -free[-2:-1]])[None, :]
        )
        step = np.linalg.lstsq(slope, residual, rcond=_RANK_TOLERANCE)[0]
        before, cost = free, float(residual @ residual)
        for halving in range(_HALVINGS):
            tried = _obeying(before[:-1] - step * 0.5**halving)
            left = weights @ (matrix @ tried - value)
            if float(left @ left) <= cost:
                free = tried
                break
        if np.linalg.norm((free - before)[:-1]) <= 1e-13 * np.linalg.norm(free[:-1]):
            break
    return free


def _obeying(free: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (y, b, lambda) for given (y, b)."""
    return np.append(free, free[:-1] @ free[:-1] - free[-1] ** 2)
