"""A fall through many times at once, with its derivatives: pieces side by side, then joined.

Where forces act beside gravity a fall goes through NumPy, which takes as long for one state as for
a hundred: pieces of an orbit are propagated together, and joined by Newton's method.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.integrate import solve_ivp

from geograph.factors.gravity import acceleration, propagate
from geograph.falls import propagated
from geograph.kernels import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.factors.forces import Forces

# Pieces of an orbit that are propagated side by side, and when they are joined well enough: what is
# left is the square of the last move over thousands of kilometres.
_PIECE_S = 60.0
_ROUNDS, _ROUND_M = 8, 1.0


def fall(
    state: NDArray[np.float64],
    start_s: float,
    time_s: NDArray[np.float64],
    forces: Forces | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return states at times, shape (n, 6), and derivatives by the first, shape (n, 6, 6 + e).

    Parameters
    ----------
    state
        Shape (6 + e,): at the start, ECEF, with the forces' unknowns.
    start_s, time_s
        The start, and times, shape (n,), seconds.
    forces
        What acts beside gravity.
    """
    order, inverse = np.unique(time_s, return_inverse=True)
    states, derivatives = np.empty((order.size, 6)), np.empty((order.size, 6, state.size))
    for later in (True, False):
        rows = np.flatnonzero(order >= start_s if later else order < start_s)
        if rows.size:
            rows = rows if later else rows[::-1]
            states[rows], derivatives[rows] = _outwards(state, start_s, order[rows], forces)
    return states[inverse], derivatives[inverse]


def _outwards(
    state: NDArray[np.float64],
    start_s: float,
    time_s: NDArray[np.float64],
    forces: Forces | None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what :func:`fall` does at times that lead away from the start one after another.

    Multiple shooting: short pieces are propagated side by side, each from where the last round had
    its start, and are joined by their derivatives (J. Stoer, R. Bulirsch, *Introduction to
    Numerical Analysis*, 2002, section 7.3.5), which doubles the digits in every round.
    """
    gap = np.diff(time_s, prepend=start_s)
    pieces = np.maximum(np.ceil(np.abs(gap) / _PIECE_S), 1).astype(np.int64)
    step = np.repeat(gap / pieces, pieces)
    begin = start_s + np.concatenate([[0.0], np.cumsum(step[:-1])])
    wanted = np.cumsum(pieces)
    at = _reference(state[:6], start_s, step)
    unknown = np.broadcast_to(state[6:], (step.size, state.size - 6))
    for _ in range(_ROUNDS):
        if forces is None:
            after, turn = propagated(at[:-1], step, "ecef", 4)
        else:
            given = np.concatenate([at[:-1], unknown], axis=1)
            after, turn = propagate(given, step, "ecef", 4, forces=forces, start_s=begin)
        moved = np.zeros_like(at)
        for k in range(step.size):
            moved[k + 1] = after[k, :6] - at[k + 1] + turn[k, :6, :6] @ moved[k]
        at = at + moved
        if not np.abs(moved[:, :3]).max() > _ROUND_M:
            break
    by = np.empty((step.size + 1, 6, state.size))
    by[0] = np.eye(6, state.size)
    for k in range(step.size):
        by[k + 1] = turn[k, :6, :6] @ by[k]
        by[k + 1, :, 6:] += turn[k, :6, 6:]
    return at[wanted], by[wanted]


def _reference(
    state: NDArray[np.float64], start_s: float, step_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return states in free fall about which pieces are joined, shape (n + 1, 6)."""
    at = np.empty((step_s.size + 1, 6))
    at[0] = state
    if compiled is not None:
        for k in range(step_s.size):
            at[k + 1] = propagated(at[k][None], step_s[k : k + 1], "ecef", 4)[0][0]
        return at

    def rates(_: float, x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([x[3:], acceleration(x[None, :3], x[None, 3:], "ecef", 4)[0][0]])

    time = start_s + np.cumsum(step_s)
    solved = solve_ivp(
        rates, (start_s, time[-1]), state, method="DOP853", t_eval=time, rtol=1e-8, atol=1e-3
    )
    at[1:] = solved.y.T if solved.y.shape[1] == time.size else np.nan
    return at
