"""One sweep along a chain of knots, forwards in time, and one back for the covariances.

These are the two loops of the structured elimination (:mod:`geograph.eliminate`), for a whole pass
at once, or interval by interval as measurements arrive (:mod:`geograph.incremental`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import lapack

from geograph.kernels import compiled, flat

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.blocks import Sums


# What the compiled sweep keeps of each interval, as it names them.
_TURNED, _ALL, _LATER = range(3)


class NotPositiveDefiniteError(ArithmeticError):
    """The linear system does not determine all unknowns to working precision."""


@dataclass(frozen=True, eq=False)
class Marginals:
    """Marginal covariances of all unknowns, scaled.

    Attributes
    ----------
    knots
        Shape (K, d, d).
    neighbours
        Shape (K - 1, d, d): covariance of each knot with the following one.
    knot_constants
        Shape (K, d, s): covariance of each knot with the constant states.
    constants
        Shape (s, s).
    """

    knots: NDArray[np.float64]
    neighbours: NDArray[np.float64]
    knot_constants: NDArray[np.float64]
    constants: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sweep:
    """Intervals of a chain, eliminated one after another in the order of time.

    Attributes
    ----------
    knots
        Shape (n, d, d + s + 1): of each interval the rows of the knot after it over (knot,
        constants, gradient): all that it and the intervals before say of that knot. Of the last
        interval alone, shape (1, ...), if only the ends were asked for.
    shares
        Shape (n, s + 1, s + 1): what each interval adds to the rows of (constants, gradient); of
        all together, shape (1, ...), if only the ends were asked for.
    back, spread
        Shapes (n, d, d + s + 1), (n, d, d): x[k] = back (x[k+1], constants, 1) + spread v.
    half_log
        Half the log determinant of the information of the noises.
    square
        Twice the decrease of the cost that the noises' steps give.
    inverse_roots
        Shape (n, d, d): inverses of the factors of the noises' information; empty unless asked for.
    gain
        Shape (n, d, d + s + 1): w = -gain (x[k+1], constants, 1); empty unless asked for.
    """

    knots: NDArray[np.float64]
    shares: NDArray[np.float64]
    back: NDArray[np.float64]
    spread: NDArray[np.float64]
    half_log: float
    square: float
    inverse_roots: NDArray[np.float64]
    gain: NDArray[np.float64]


def sweep(
    knot: NDArray[np.float64],
    *,
    blocks: Sums,
    inverse_transition: NDArray[np.float64],
    noise_root: NDArray[np.float64],
    noise_residual: NDArray[np.float64],
    damping: float = 0.0,
    ends: bool = False,
    noise: bool = False,
) -> Sweep:
    """Eliminate the noise of every interval; turn the first knot's rows into the last one's.

    Parameters
    ----------
    knot
        Shape (d, d + s + 1): rows of the first knot over (knot, constants, gradient).
    blocks, inverse_transition, noise_root, noise_residual
        Of n intervals, as in :class:`LinearSystem`.
    damping
        Added to the information of the first knot of every interval.
    ends
        Whether what lies between the first knot and the last is not asked for.
    noise
        Whether ``inverse_roots`` and ``gain`` are asked for.

    Raises
    ------
    NotPositiveDefiniteError
        If the information of a noise is not positive definite.
    """
    if compiled is not None:
        given = (inverse_transition, noise_root, noise_residual)
        kept = _ALL if noise else _TURNED
        return _compiled_sweep(knot, blocks, given, damping=damping, ends=ends, kept=kept)
    d = knot.shape[0]
    # x[k] = A x[k+1] - B w.
    scaled_root = inverse_transition @ noise_root
    turn = np.concatenate([-scaled_root, inverse_transition], axis=2)
    rows = _turned_rows(turn, blocks.knots, noise_residual, damping)
    count, _, width = rows.shape
    inverse_roots = np.empty((count, d, d))
    rests = np.empty((count, d, width - d))
    before = np.empty((d, width))
    knots = np.empty((count, d, width - d))
    for k, (row, by) in enumerate(zip(rows, turn, strict=True)):
        # The knot's information, with x[k] written through w and x[k+1].
        np.matmul(knot[:, :d], by, out=before[:, : 2 * d])
        before[:, 2 * d :] = knot[:, d:]
        now = row + by.T @ before
        root, fault = lapack.dpotrf(now[:d, :d], lower=1, clean=1)
        if fault:
            raise NotPositiveDefiniteError
        inverse, _ = lapack.dtrtri(root, lower=1)
        rest = np.matmul(inverse, now[:d, d:], out=rests[k])
        inverse_roots[k] = inverse
        knot = np.subtract(now[d:, d:], rest[:, :d].T @ rest, out=knots[k])
        # Rounding that is not symmetric would grow over tens of thousands of knots.
        knot[:, :d] = 0.5 * (knot[:, :d] + knot[:, :d].T)
    beyond = rests[:, :, d:]
    taken = np.swapaxes(beyond, 1, 2) @ beyond
    if ends:
        knots = knots[-1:]
        shares = (blocks.others.sum(axis=0) - taken.sum(axis=0))[None]
    else:
        shares = blocks.others - taken
    gain = np.swapaxes(inverse_roots, 1, 2) @ rests
    back = scaled_root @ gain
    back[:, :, :d] += inverse_transition
    spread = scaled_root @ np.swapaxes(inverse_roots, 1, 2)
    half_log = -float(np.sum(np.log(np.einsum("kii->ki", inverse_roots))))
    square = float(np.sum(rests[:, :, -1] ** 2))
    if not noise:
        inverse_roots, gain = inverse_roots[:0], gain[:0]
    return Sweep(knots, shares, back, spread, half_log, square, inverse_roots, gain)


def _compiled_sweep(
    knot: NDArray[np.float64],
    blocks: Sums,
    given: tuple[NDArray[np.float64], ...],
    *,
    damping: float,
    ends: bool,
    kept: int,
) -> Sweep:
    """Return what :func:`sweep` does, from compiled code.

    With ``_LATER`` its ``gain`` are the rows of the noise, of which ``back`` and ``spread``, empty
    there, are made when they are asked for.
    """
    d, width = knot.shape
    count, rest = blocks.knots.shape[0], width - d
    held = 1 if ends else count
    knots, shares = np.empty((held, d, width)), np.empty((held, rest, rest))
    now, beside = (count if kept != _LATER else 0), (count if kept != _TURNED else 0)
    back, spread = np.empty((now, d, width)), np.empty((now, d, d))
    inverse_roots, gain = np.empty((beside, d, d)), np.empty((beside, d, width))
    sums = np.empty(2)
    summed = blocks.others.sum(axis=0) if ends else blocks.others
    arrays = map(flat, (knot, blocks.knots, summed, *given))
    results = (knots, shares, back, spread, sums, inverse_roots, gain)
    if not compiled.sweep(count, d, rest, int(ends), kept, damping, *arrays, *results):
        raise NotPositiveDefiniteError
    return Sweep(knots, shares, back, spread, float(sums[0]), float(sums[1]), inverse_roots, gain)


class Ends:
    """What a sweep says of the last knot and the constants; of the others when it is asked.

    Most systems are solved for a step alone. What covariances take (:attr:`turned_back`) is half as
    much work again, and is made the first time it is read.

    Parameters
    ----------
    knot, blocks, inverse_transition, noise_root, noise_residual, damping, noise
        As of :func:`sweep`.

    Attributes
    ----------
    knot
        Shape (d, d + s + 1): rows of the last knot over (knot, constants, gradient).
    share
        Shape (s + 1, s + 1): what all intervals add to the rows of (constants, gradient).
    half_log, square
        As of :class:`Sweep`.
    inverse_roots, gain
        As of :class:`Sweep`, where the noise was asked for.

    Raises
    ------
    NotPositiveDefiniteError
        If the information of a noise is not positive definite.
    """

    inverse_roots: NDArray[np.float64]
    gain: NDArray[np.float64]

    def __init__(
        self,
        knot: NDArray[np.float64],
        *,
        blocks: Sums,
        inverse_transition: NDArray[np.float64],
        noise_root: NDArray[np.float64],
        noise_residual: NDArray[np.float64],
        damping: float = 0.0,
        noise: bool = False,
    ) -> None:
        given = inverse_transition, noise_root, noise_residual
        self._by = inverse_transition, noise_root
        self._later = compiled is not None and not noise
        if self._later:
            found = _compiled_sweep(knot, blocks, given, damping=damping, ends=True, kept=_LATER)
        else:
            found = sweep(
                knot,
                blocks=blocks,
                inverse_transition=inverse_transition,
                noise_root=noise_root,
                noise_residual=noise_residual,
                damping=damping,
                ends=True,
                noise=noise,
            )
        self.knot, self.share = found.knots[0], found.shares[0]
        self.half_log, self.square = found.half_log, found.square
        if noise:
            self.inverse_roots, self.gain = found.inverse_roots, found.gain
        self._found = found

    @property
    def turned_back(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """``back`` and ``spread`` of :class:`Sweep`."""
        found = self._found
        if self._later:
            count, d, width = found.gain.shape
            back, spread = np.empty((count, d, width)), np.empty((count, d, d))
            arrays = map(flat, (*self._by, found.inverse_roots, found.gain))
            compiled.turn_back(count, d, width - d, *arrays, back, spread)
            # What they were made of goes: it is as large as they are.
            none = found.inverse_roots[:0].copy(), found.gain[:0].copy()
            found = replace(found, back=back, spread=spread, inverse_roots=none[0], gain=none[1])
            self._found, self._later = found, False
        return found.back, found.spread

    def substitute(
        self, last: NDArray[np.float64], constants: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the increments of all knots; see :func:`substitute`."""
        found = self._found
        if not self._later:
            return substitute(found.back, last, constants)
        count, d, width = found.gain.shape
        knots = np.empty((count + 1, d))
        knots[count] = last
        arrays = map(flat, (*self._by, found.inverse_roots, found.gain, constants))
        compiled.substitute_later(count, d, width - d, *arrays, knots)
        return knots


def _turned_rows(
    turn: NDArray[np.float64],
    blocks: NDArray[np.float64],
    noise_residual: NDArray[np.float64],
    damping: float,
) -> NDArray[np.float64]:
    """Return what measurements and noise add to the rows of (w, x[k+1]), for all intervals."""
    d = noise_residual.shape[1]
    index = np.arange(d)
    own = blocks[:, :d]
    if damping:
        own = own.copy()
        own[:, index, index] += damping
    first = np.swapaxes(turn, 1, 2) @ own
    # Columns of x[k] become columns of (w, x[k+1]).
    rows = np.concatenate([first[:, :, :d] @ turn, first[:, :, 2 * d :]], axis=2)
    cross = first[:, :, d : 2 * d]
    rows[:, :, d : 2 * d] += cross
    rows[:, d:, : 2 * d] += np.swapaxes(cross, 1, 2)
    rows[:, d:, d:] += blocks[:, d : 2 * d, d:]
    rows[:, index, index] += 1.0
    rows[:, index, -1] += noise_residual
    return rows


def substitute(
    back: NDArray[np.float64], last: NDArray[np.float64], constants: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the increments of all knots, shape (n + 1, d), from those of the last.

    Parameters
    ----------
    back
        Shape (n, d, d + s + 1), as in :class:`Sweep`.
    last, constants
        Shapes (d,), (s,): increments of the last knot and of the constants.
    """
    count, d = back.shape[0], last.size
    knots = np.empty((count + 1, d))
    knots[count] = following = last
    if count and compiled is not None:
        compiled.substitute(count, d, back.shape[2] - d, flat(back), flat(constants), knots)
    elif count:
        offset = back[:, :, d:] @ np.append(constants, 1.0)
        by_next = np.ascontiguousarray(back[:, :, :d])
        for k in range(count - 1, -1, -1):
            following = by_next[k] @ following + offset[k]
            knots[k] = following
    return knots


def chain_marginals(
    back: NDArray[np.float64], spread: NDArray[np.float64], final_root: NDArray[np.float64]
) -> Marginals:
    """Return all marginal covariances by one backward pass over a factorisation.

    The pass carries the covariance V of a knot if the constants were known, and the derivative G of
    its mean by the constants, so that only positive terms are added: the covariance is V + G S G^T,
    with S that of the constants.

    Parameters
    ----------
    back, spread
        Shapes (n, d, d + s + 1), (n, d, d), as in :class:`Sweep`.
    final_root
        Shape (d + s, d + s): lower factor of the information of (last knot, constants).
    """
    count, d, _ = spread.shape
    inverse, _ = lapack.dtrtri(final_root, lower=1)
    by_knot, by_constants = inverse[:d, :d], inverse[d:, d:]
    constants = by_constants.T @ by_constants
    last, lean = by_knot.T @ by_knot, -by_knot.T @ final_root[d:, :d].T
    if compiled is not None:
        return _compiled_marginals(back, spread, constants, last, lean)
    known = np.empty((count + 1, d, d))
    slope = np.empty((count + 1, d, constants.shape[0]))
    known[count], slope[count] = last, lean
    scatter = spread @ np.swapaxes(spread, 1, 2)
    for k in range(count - 1, -1, -1):
        by_next = back[k, :, :d]
        known[k] = by_next @ known[k + 1] @ by_next.T + scatter[k]
        slope[k] = by_next @ slope[k + 1] + back[k, :, d:-1]
    cross = slope @ constants
    knots = known + cross @ np.swapaxes(slope, 1, 2)
    knots = 0.5 * (knots + np.swapaxes(knots, 1, 2))
    by_next, by_known = back[:, :, :d], back[:, :, d:-1]
    neighbours = by_next @ knots[1:] + by_known @ np.swapaxes(cross[1:], 1, 2)
    return Marginals(knots, neighbours, cross, constants)


def _compiled_marginals(
    back: NDArray[np.float64],
    spread: NDArray[np.float64],
    constants: NDArray[np.float64],
    known: NDArray[np.float64],
    slope: NDArray[np.float64],
) -> Marginals:
    """Return what :func:`chain_marginals` does, from compiled code; the last two are of a knot."""
    count, d, _ = spread.shape
    size = constants.shape[0]
    knots, neighbours = np.empty((count + 1, d, d)), np.empty((count, d, d))
    cross = np.empty((count + 1, d, size))
    arrays = map(flat, (back, spread, constants, known, slope))
    compiled.marginals(count, d, size, *arrays, knots, neighbours, cross)
    return Marginals(knots, neighbours, cross, constants)
