"""How far an estimate may move before what was linearised about it is linearised again.

Let e be the change of all whitened residuals beyond their linear part. The estimate of the linear
system is then off by P J'e, which is at most |e| of its own posterior sigmas, in any direction,
because J P J' <= 1. So |e| is held below a small part of a sigma: each of n scalar rows may be
off by that over sqrt(n). Moving every unknown of one kind by h changes a residual by r(h) + r(-h)
- 2 r(0) beyond its linear part, twice e; e grows with the square of h. That gives the distance
for each kind. The step h is the posterior sigma of the kind, so that it is the curvature where
the estimate may yet go that counts. With a loss, residuals are those of the weighted least
squares: their weights follow the estimate, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from geograph.incremental.rows import FIXES, join, take
from geograph.kernels import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.families import Values
    from geograph.incremental.chain import Chain
    from geograph.incremental.model import Measured, Model
    from geograph.incremental.rows import Rows

TOLERANCE = 0.02
"""Posterior sigmas by which what is not linear may put an estimate off."""

# Posterior sigmas by which what leaves a lag may put the newest estimate off.
_LET_GO = 0.2

# Rows that the curvature is taken from: the newest, where the object is.
_ROWS = 32

# As many pieces are asked one by one; more of them in one pass over stacks.
_FEW = 16

# A step is no smaller than what rounding leaves of a second difference.
_LEAST_STEP = 1e-3


@dataclass(frozen=True, eq=False)
class Limits:
    """How far each kind of unknown may move from where it was linearised, scaled.

    Attributes
    ----------
    path
        Shape (m,): position, velocity, acceleration; lengths of their vectors.
    chains, constants
        Shapes (w,), (s,): walks and platforms, and constants.
    sigma
        Shape (s,): of the constants, when the limits were set.
    """

    path: NDArray[np.float64]
    chains: NDArray[np.float64]
    constants: NDArray[np.float64]
    sigma: NDArray[np.float64]

    def unsure(self) -> NDArray[np.bool_]:
        """Tell which constants may yet move by more than what is let go would bear, shape (s,).

        What an interval says is then fixed where it was linearised last. With the square of a
        distance, a constant's sigma of r limits puts an estimate off by r^2 tolerances.
        """
        return np.asarray(self.sigma > np.sqrt(_LET_GO / TOLERANCE) * self.constants)

    def moved(self, chain: Chain, first: int) -> list[int]:
        """Return the pieces from ``first`` on whose estimate left their linearisation."""
        if compiled is not None and len(chain.pieces) - first <= _FEW:
            return [k for k in range(first, len(chain.pieces)) if self._left(chain, k)]
        pieces = chain.pieces[first:]
        scale = chain.scale[: chain.size]
        path = np.array(chain.path[first:])
        at = np.array([piece.path for piece in pieces])
        gap = np.abs(np.stack([path[:-1], path[1:]], axis=1) - at) / scale
        # What is unknown of the forces enters as good as linearly.
        gap = gap[..., : 3 * self.path.size]
        blocks = np.sqrt(np.sum(gap.reshape(*gap.shape[:2], -1, 3) ** 2, axis=3))
        far = (blocks > self.path).any(axis=(1, 2))
        if self.chains.size:
            chains = np.array(chain.chains[first:])
            at = np.array([piece.chains for piece in pieces])
            gap = np.abs(np.stack([chains[:-1], chains[1:]], axis=1) - at)
            far |= (gap > self.chains).any(axis=(1, 2))
        if self.constants.size:
            at = np.array([piece.constants for piece in pieces])
            far |= (np.abs(chain.constants - at) > self.constants).any(axis=1)
        return [first + int(k) for k in np.flatnonzero(far)]

    def _left(self, chain: Chain, k: int) -> bool:
        """Tell in compiled code whether the estimate left the linearisation of one piece."""
        piece, path, chains = chain.pieces[k], chain.path, chain.chains
        return bool(
            compiled.live_moved(
                *(self.path.size, chain.size, self.chains.size, self.constants.size, chain.scale),
                *(self.path, self.chains, self.constants, path[k], path[k + 1], piece.path),
                *(chains[k], chains[k + 1], piece.chains, chain.constants, piece.constants),
            )
        )


def limits(model: Model, chain: Chain, total_rows: int) -> Limits:
    """Return the limits that the measurements of the newest intervals set.

    Parameters
    ----------
    model, chain
        After an elimination.
    total_rows
        Scalar rows that count in all.
    """
    assert chain.final is not None
    m, d = chain.size, chain.knot_size
    sigma = np.sqrt(np.diagonal(chain.final.covariance()))
    rows, low = _newest(chain)
    path = model.motion.path(np.array(chain.knots_s[low:]))
    values = chain.values(low, len(chain.knots_s) - 1)
    families = list(model.families(rows))
    allowed = TOLERANCE / np.sqrt(max(total_rows, 1))

    # Else all that families hold fixed is when walks are read, which no such step moves.
    noise_changes = model.between or model.noisy

    def residual(at: Values) -> NDArray[np.float64]:
        renew = noise_changes or at is values
        found = model.evaluate_families(families, path, at, low, jacobian=False, refresh=renew)
        return np.concatenate([_weighted(model, part) for part in found] or [np.zeros(1)])

    here = residual(values)

    def distance(there: Values, back: Values, step: float) -> float:
        second = np.abs(residual(there) + residual(back) - 2.0 * here).max(initial=0.0)
        # Beyond the linear part is half of the second difference; it grows with the square.
        return step * float(np.sqrt(2.0 * allowed / max(float(second), 1e-300)))

    order = model.motion.order
    blocks = np.full(order, np.inf)
    for block in range(min(order, 2)):
        own = slice(3 * block, 3 * block + 3)
        step = max(float(np.linalg.norm(sigma[own])), _LEAST_STEP)
        for axis in range(3):
            by = np.zeros(m)
            by[3 * block + axis] = step * chain.scale[3 * block + axis]
            there, back = (replace(values, path=values.path + side * by) for side in (1, -1))
            blocks[block] = min(blocks[block], distance(there, back, step))
    constants = np.full(values.constants.size, np.inf)
    states = model.prepared.states
    kinds: dict[tuple[int, bool], list[int]] = {}
    for column, state in enumerate(states.constants):
        kinds.setdefault((state.channel, state.drift), []).append(column)
    for columns in kinds.values():
        by = np.zeros(constants.size)
        by[columns] = np.maximum(sigma[d:][columns], _LEAST_STEP)
        there, back = (replace(values, constants=values.constants + s * by) for s in (1, -1))
        constants[columns] = by[columns] * distance(there, back, 1.0)
    chains = np.full(d - m, np.inf)
    for column in range(d - m):
        by = np.zeros(d - m)
        by[column] = step = max(float(sigma[m + column]), _LEAST_STEP)
        there, back = (replace(values, walks=values.walks + s * by) for s in (1, -1))
        chains[column] = distance(there, back, step)
    return Limits(blocks, chains, constants, sigma[d:])


def _weighted(model: Model, part: Measured) -> NDArray[np.float64]:
    """Return residuals whose squares are what the loss makes of them."""
    residual = part.found.residual
    weight = part.columns["kept"][part.order].astype(np.float64)
    if model.loss.name != "none":
        square = np.einsum("ij,ij->i", residual, residual)
        weight = weight * model.loss.value_and_weight(square)[1]
    return np.asarray((residual * np.sqrt(weight)[:, None]).ravel())


def _newest(chain: Chain) -> tuple[Rows, int]:
    """Return some of the newest rows, and the first knot that they need."""
    held: list[Rows] = []
    size, k = 0, len(chain.pieces)
    while k and size < _ROWS:
        k -= 1
        rows = {kind: c for kind, c in chain.pieces[k].rows.items() if kind != FIXES}
        held.append(rows)
        size += sum(columns["ident"].size for columns in rows.values())
    rows = join(held or [{}])
    return {kind: take(c, slice(None, 2 * _ROWS)) for kind, c in rows.items()}, max(k - 1, 0)
