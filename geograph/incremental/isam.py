"""The same pieces in GTSAM's iSAM2.

Each piece is two Jacobian factors, of its measurements and of its transition, wrapped in
``LinearContainerFactor``: GTSAM never calls Python. What is linearised again is swapped: its
factors are removed by their indices and new ones added. Everything is linear about the chain's
reference, so that iSAM2 has nothing to relinearise itself: its one threshold for all unknowns is
not used. It factorises with QR, because Cholesky breaks on stiff chains.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import gtsam
import numpy as np

from geograph.errors import InputError
from geograph.sweep import NotPositiveDefiniteError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.incremental.chain import Chain, Piece

# Eigenvalues below this part of the largest are rounding.
_RANK = 1e-14


class Isam:
    """A chain's linear system in iSAM2, brought up to date by what changed in the chain."""

    def __init__(self) -> None:
        self._solver: Any = None
        self._pieces: list[Piece] = []
        self._slots: list[list[int]] = []
        self._base: tuple[int, int, int] = (0, 0, 0)
        self._knots: list[float] = []

    def solve(self, chain: Chain) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return increments and covariance of the newest knot and the constants, scaled.

        Parameters
        ----------
        chain
            What is solved.

        Raises
        ------
        NotPositiveDefiniteError
            If the unknowns are not determined.
        InputError
            If parts of the state have no noise, which GTSAM could not whiten.
        """
        try:
            self._update(chain)
            keys = self._last_keys(chain)
            delta = self._solver.calculateBestEstimate()
            step = np.concatenate([delta.atVector(key) for key in keys])
            if len(keys) == 1:
                covariance = self._solver.marginalCovariance(keys[0])
            else:
                joint = self._solver.jointMarginalCovariance(keys)
                covariance = np.block([[joint.at(a, b) for b in keys] for a in keys])
        except RuntimeError as error:
            # IndeterminantLinearSystemException arrives as a RuntimeError; what has been updated
            # by halves is not used again.
            self._solver = None
            raise NotPositiveDefiniteError from error
        if not (np.isfinite(step).all() and np.isfinite(covariance).all()):
            self._solver = None
            raise NotPositiveDefiniteError
        return step, np.asarray(covariance)

    def offsets(self, chain: Chain) -> NDArray[np.float64]:
        """Return the increments of all knots, shape (K, d), scaled."""
        delta = self._solver.calculateBestEstimate()
        return np.array([delta.atVector(_knot(chain, k)) for k in range(len(chain.knots_s))])

    def _last_keys(self, chain: Chain) -> list[int]:
        keys = [_knot(chain, len(chain.knots_s) - 1)]
        return [*keys, _CONSTANTS] if chain.reference.size else keys

    def _update(self, chain: Chain) -> None:
        base = (chain.gone, id(chain.forward[0]), id(chain.hold))
        held = len(self._knots)
        # Where knots were put between others, or the prior changed, keys mean something else.
        same = self._knots[:-1] == chain.knots_s[: held - 1] and held <= len(chain.knots_s)
        new = gtsam.NonlinearFactorGraph()
        values = gtsam.Values()
        fresh = self._solver is None or base != self._base or not same
        if fresh:
            self._begin(chain, new, values)
        removed: list[int] = []
        changed = [
            k
            for k, piece in enumerate(chain.pieces)
            if k >= len(self._pieces) or self._pieces[k] is not piece
        ]
        for k in range(len(self._knots), len(chain.knots_s)):
            values.insert(_knot(chain, k), np.zeros(chain.knot_size))
        counts = []
        for k in changed:
            factors = _factors(chain, k)
            counts.append(len(factors))
            for factor in factors:
                new.push_back(factor)
            if k < len(self._slots):
                removed += self._slots[k]
        result = self._solver.update(new, values, removed)
        slots = list(result.getNewFactorsIndices())[1 if fresh else 0 :]
        edges = np.concatenate([[0], np.cumsum(counts)]).astype(int).tolist()
        for k, (low, high) in zip(changed, pairwise(edges), strict=True):
            own = [int(slot) for slot in slots[low:high]]
            if k < len(self._slots):
                self._slots[k] = own
            else:
                self._slots.append(own)
        self._pieces, self._knots = list(chain.pieces), list(chain.knots_s)

    def _begin(self, chain: Chain, graph: Any, values: Any) -> None:
        """Start anew with the prior of the first knot and the constants, which it adds."""
        parameters = gtsam.ISAM2Params()
        parameters.setFactorization("QR")
        parameters.enableRelinearization = False
        parameters.findUnusedFactorSlots = True
        self._solver = gtsam.ISAM2(parameters)
        d, size = chain.knot_size, chain.reference.size
        total = np.zeros((d + size + 1, d + size + 1))
        total[:d], total[d:, :d] = chain.forward[0], chain.forward[0][:, d:].T
        total[d:, d:] = chain.other[0] + chain.hold
        values.insert(_knot(chain, 0), np.zeros(d))
        keys = [(_knot(chain, 0), d)]
        if size:
            values.insert(_CONSTANTS, np.zeros(size))
            keys.append((_CONSTANTS, size))
        graph.push_back(_rows(total, keys))
        self._base = (chain.gone, id(chain.forward[0]), id(chain.hold))
        # Held, so that nothing else takes their place in memory.
        self._prior = chain.forward[0], chain.hold
        self._pieces, self._slots, self._knots = [], [], chain.knots_s[:1]


_CONSTANTS = gtsam.symbol("c", 0)


def _knot(chain: Chain, k: int) -> int:
    return int(gtsam.symbol("x", chain.gone + k))


def _factors(chain: Chain, k: int) -> list[Any]:
    """Return the factors of a piece: its measurements, if there are any, and its transition."""
    piece, d = chain.pieces[k], chain.knot_size
    if not np.einsum("ii->i", piece.root).all():
        raise InputError(
            "parts of the state have no process noise, which GTSAM cannot whiten; expected engine "
            "'structured'"
        )
    keys = [(_knot(chain, k), d), (_knot(chain, k + 1), d)]
    white = np.linalg.inv(piece.root)
    forward = np.linalg.inv(piece.inverse)
    unit = gtsam.noiseModel.Unit.Create(d)
    transition = gtsam.JacobianFactor(
        keys[0][0], -white @ forward, keys[1][0], white, -piece.noise, unit
    )
    found = [_wrapped(transition, keys)]
    if piece.block[:-1, :-1].any():
        if chain.reference.size:
            keys.append((_CONSTANTS, chain.reference.size))
        found.append(_rows(piece.block, keys))
    return found


def _rows(block: NDArray[np.float64], keys: list[tuple[int, int]]) -> Any:
    """Return the factor of an information block whose last column is the gradient."""
    # To a unit diagonal first: a prior holds its unknowns by very different amounts.
    scale = np.sqrt(np.diagonal(block[:-1, :-1]))
    scale = np.where(scale > 0.0, scale, 1.0)
    value, vector = np.linalg.eigh(block[:-1, :-1] / scale[:, None] / scale)
    kept = value > _RANK * value[-1]
    root = np.sqrt(value[kept])
    rows = root[:, None] * vector[:, kept].T * scale
    right = -(vector[:, kept].T @ (block[:-1, -1] / scale)) / root
    arguments: list[Any] = []
    jacobian: Any = gtsam.JacobianFactor
    first = 0
    for key, size in keys:
        arguments += [key, np.ascontiguousarray(rows[:, first : first + size])]
        first += size
    unit = gtsam.noiseModel.Unit.Create(right.size)
    return _wrapped(jacobian(*arguments, right, unit), keys)


def _wrapped(factor: Any, keys: list[tuple[int, int]]) -> Any:
    """Return a linear factor as one that iSAM2 takes, about zero."""
    point = gtsam.Values()
    for key, size in keys:
        point.insert(key, np.zeros(size))
    return gtsam.LinearContainerFactor(factor, point)
