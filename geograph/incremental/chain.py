"""The chain of knots that is held, its linear pieces, and their elimination up to the newest knot.

The linear system is that of :mod:`geograph.eliminate`, kept interval by interval. ``forward[k]`` is
what all intervals before knot k say of it and of the sensors' constants: new measurements in the
last interval cost one step of the sweep, and a change further back costs the steps from there on.
Intervals that leave a fixed lag are dropped; what they said stays in ``forward[0]``, which is
their marginal prior.

Every piece is linear about its own point, and is written about the chain's reference, which stays
where it is: only the pieces that moved are linearised again.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import lapack

from geograph.blocks import Sums
from geograph.families import Values
from geograph.kernels import compiled
from geograph.sweep import NotPositiveDefiniteError, chain_marginals, substitute, sweep

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.incremental.isam import Isam
    from geograph.incremental.rows import Rows
    from geograph.sweep import Marginals


@dataclass(frozen=True, eq=False)
class Piece:
    """One interval between knots, linearised; never changed.

    Attributes
    ----------
    rows
        Measurements whose signals were emitted in it.
    block
        Shape (2d + s + 1, 2d + s + 1): their sums of products, about the chain's reference.
    inverse, root, noise
        Shapes (d, d), (d, d), (d,): inverse transition, noise root, and noise at the reference.
    path, chains, constants
        Shapes (2, 3m), (2, w), (s,): the point about which all that was linearised.
    """

    rows: Rows
    block: NDArray[np.float64]
    inverse: NDArray[np.float64]
    root: NDArray[np.float64]
    noise: NDArray[np.float64]
    path: NDArray[np.float64]
    chains: NDArray[np.float64]
    constants: NDArray[np.float64]

    def holding(self, rows: Rows) -> Piece:
        """Return the piece with other rows, which have yet to be linearised."""
        own = self.block, self.inverse, self.root, self.noise
        return Piece(rows, *own, self.path, self.chains, self.constants)


@dataclass(frozen=True, eq=False)
class Final:
    """The factorised information of the newest knot and the constants.

    Attributes
    ----------
    root
        Shape (d + s, d + s): its lower factor; None where the covariance is known already.
    step
        Shape (d + s,): increments from the reference.
    known
        Shape (d + s, d + s): the covariance, where it is known.
    """

    root: NDArray[np.float64] | None
    step: NDArray[np.float64]
    known: NDArray[np.float64] | None = None

    def distance(self, step: NDArray[np.float64]) -> float:
        """Return how far other increments are, in posterior sigmas."""
        gap = self.step - step
        if self.root is not None:
            return float(np.linalg.norm(self.root.T @ gap))
        return float(np.sqrt(gap @ np.linalg.solve(self.covariance(), gap)))

    def covariance(self) -> NDArray[np.float64]:
        """Return the covariance, shape (d + s, d + s), scaled."""
        return self._covariance

    @cached_property
    def _covariance(self) -> NDArray[np.float64]:
        if self.known is not None:
            return self.known
        assert self.root is not None
        if compiled is not None:
            covariance = np.empty_like(self.root)
            compiled.live_covariance(self.step.size, self.root, covariance)
            return covariance
        inverse, _ = lapack.dtrtri(self.root, lower=1)
        return np.asarray(inverse.T @ inverse)


@dataclass(eq=False)
class Chain:
    """Knots, references, estimates and pieces; lists are replaced or appended to, arrays are not.

    Attributes
    ----------
    scale
        Shape (d,): scales of a knot's components, SI for the path, 1 for the chains.
    knots_s
        K times.
    reference_path, reference_chains
        K states each: where the linear system is written.
    reference
        Shape (s,): the same of the constants.
    path, chains, constants
        Estimates; those of old knots are as old as the last full solution.
    pieces
        K - 1 of them.
    forward, other
        K of each: what is known of knot and constants from before; see the module.
    back, spread
        K - 1 of each, as in :class:`geograph.sweep.Sweep`.
    hold
        Shape (s + 1, s + 1): what is known of the constants alone (a shift in time, held).
    gone
        Intervals that were dropped.
    dirty
        The first piece that changed since the last elimination.
    behind
        The first piece that changed since the last sweep; the same, but with iSAM2.
    isam
        Who solves in place of the sweep, or None.
    """

    scale: NDArray[np.float64]
    size: int
    knots_s: list[float]
    reference_path: list[NDArray[np.float64]]
    reference_chains: list[NDArray[np.float64]]
    reference: NDArray[np.float64]
    path: list[NDArray[np.float64]]
    chains: list[NDArray[np.float64]]
    constants: NDArray[np.float64]
    pieces: list[Piece]
    forward: list[NDArray[np.float64]]
    other: list[NDArray[np.float64]]
    hold: NDArray[np.float64]
    back: list[NDArray[np.float64]] = field(default_factory=list)
    spread: list[NDArray[np.float64]] = field(default_factory=list)
    final: Final | None = None
    gone: int = 0
    dirty: int = 0
    behind: int = 0
    isam: Isam | None = None

    def copy(self) -> Chain:
        """Return a chain whose lists may be changed without changing this one's."""
        made = object.__new__(Chain)
        held = vars(made)
        for name, value in vars(self).items():
            held[name] = value.copy() if type(value) is list else value
        return made

    @property
    def knot_size(self) -> int:
        """Components d of a knot."""
        return int(self.scale.size)

    def values(self, first: int, last: int) -> Values:
        """Return the estimates of the knots from ``first`` up to and including ``last``."""
        return Values(
            np.array(self.path[first : last + 1]),
            np.array(self.chains[first : last + 1]).reshape(last + 1 - first, -1),
            self.constants,
        )

    def offset(self, k: int) -> NDArray[np.float64]:
        """Return the estimate of a knot less its reference, shape (d,), scaled."""
        return np.concatenate(
            [
                (self.path[k] - self.reference_path[k]) / self.scale[: self.size],
                self.chains[k] - self.reference_chains[k],
            ]
        )

    def place(self, k: int, offset: NDArray[np.float64]) -> None:
        """Set the estimate of a knot to its reference and an offset."""
        m = self.size
        self.path[k] = self.reference_path[k] + offset[:m] * self.scale[:m]
        self.chains[k] = self.reference_chains[k] + offset[m:]

    def changed(self, first: int) -> None:
        """Note that pieces from ``first`` on are to be eliminated again."""
        self.dirty, self.behind = min(self.dirty, first), min(self.behind, first)

    def eliminate(self) -> None:
        """Eliminate all pieces from the first one that changed.

        Raises
        ------
        NotPositiveDefiniteError
            If what is held does not determine the newest knot.
        """
        if self.isam is None:
            self.final = self._swept()
        else:
            self.final = Final(None, *self.isam.solve(self))
        self.dirty = len(self.pieces)

    def _swept(self) -> Final:
        """Eliminate by the sweep what changed since the last one."""
        first = self.behind
        pieces = self.pieces[first:]
        del self.forward[first + 1 :], self.other[first + 1 :]
        del self.back[first:], self.spread[first:]
        if compiled is not None:
            for piece in pieces:
                self._eliminate_one(piece)
        elif pieces:
            found = sweep(
                self.forward[first],
                blocks=Sums.of(np.array([piece.block for piece in pieces]), 2 * self.knot_size),
                inverse_transition=np.array([piece.inverse for piece in pieces]),
                noise_root=np.array([piece.root for piece in pieces]),
                noise_residual=np.array([piece.noise for piece in pieces]),
            )
            # Copies: a view would keep what is dropped.
            self.forward.extend(rows.copy() for rows in found.knots)
            other = self.other[first]
            for share in found.shares:
                other = other + share
                self.other.append(other)
            if len(pieces) == 1:
                self.back.append(found.back[0])
                self.spread.append(found.spread[0])
            else:
                self.back.extend(row.copy() for row in found.back)
                self.spread.extend(row.copy() for row in found.spread)
        self.behind = len(self.pieces)
        return self._finish()

    def _eliminate_one(self, piece: Piece) -> None:
        """Eliminate one interval, in compiled code that needs no stack of them."""
        before, known = self.forward[-1], self.other[-1]
        d, c = self.knot_size, known.shape[0]
        after, other = np.empty((d, d + c)), np.empty((c, c))
        back, spread = np.empty((d, d + c)), np.empty((d, d))
        if not compiled.live_eliminate(
            *(d, c, before, known, piece.block, piece.inverse, piece.root, piece.noise),
            *(after, other, back, spread),
        ):
            raise NotPositiveDefiniteError
        self.forward.append(after)
        self.other.append(other)
        self.back.append(back)
        self.spread.append(spread)

    def _finish(self) -> Final:
        d = self.knot_size
        if compiled is not None:
            c = self.other[-1].shape[0]
            root, step = np.empty((d + c - 1, d + c - 1)), np.empty(d + c - 1)
            if not compiled.live_finish(
                d, c, self.forward[-1], self.other[-1], self.hold, root, step
            ):
                raise NotPositiveDefiniteError
            return Final(root, step)
        knot, other = self.forward[-1], self.other[-1] + self.hold
        total = np.empty((d + other.shape[0], d + other.shape[0]))
        total[:d], total[d:, d:], total[d:, :d] = knot, other, knot[:, d:].T
        information = total[:-1, :-1]
        root, fault = lapack.dpotrf(information, lower=1, clean=1)
        if fault or not np.isfinite(root).all():
            raise NotPositiveDefiniteError
        step, _ = lapack.dpotrs(root, -total[:-1, -1], lower=1)
        if not np.isfinite(step).all():
            raise NotPositiveDefiniteError
        return Final(root, step)

    def solve(self, depth: int) -> None:
        """Bring the estimates of the constants and of the ``depth`` newest knots up to date."""
        assert self.final is not None
        if self.isam is not None:
            self.solve_all()
            return
        d, last = self.knot_size, len(self.knots_s) - 1
        following = self.final.step[:d]
        increments = self.final.step[d:]
        self.constants = self.reference + increments
        if compiled is not None:
            self._place_newest(last, depth)
            return
        self.place(last, following)
        known = np.append(increments, 1.0)
        for k in range(last - 1, max(last - depth, -1), -1):
            back = self.back[k]
            following = back[:, :d] @ following + back[:, d:] @ known
            self.place(k, following)

    def _place_newest(self, last: int, depth: int) -> None:
        """Bring the newest knots up to date, in compiled code."""
        assert self.final is not None
        d, m, following = self.knot_size, self.size, None
        step, c = self.final.step, self.reference.size + 1
        for k in range(last, max(last - max(depth, 1), -1), -1):
            offset, path, chains = np.empty(d), np.empty(m), np.empty(d - m)
            compiled.live_place(
                *(d, c, m, None if k == last else self.back[k], step, following, self.scale),
                *(self.reference_path[k], self.reference_chains[k], offset, path, chains),
            )
            self.path[k], self.chains[k], following = path, chains, offset

    def solve_all(self) -> None:
        """Bring all estimates up to date."""
        assert self.final is not None
        d, last = self.knot_size, len(self.knots_s) - 1
        increments = self.final.step[d:]
        self.constants = self.reference + increments
        if self.isam is not None:
            offsets = self.isam.offsets(self)
        else:
            back = np.array(self.back).reshape(last, d, -1)
            offsets = substitute(back, self.final.step[:d], increments)
        m = self.size
        path = np.array(self.reference_path) + offsets[:, :m] * self.scale[:m]
        chains = np.array(self.reference_chains).reshape(last + 1, -1) + offsets[:, m:]
        self.path, self.chains = list(path), list(chains)

    def marginals(self, first: int = 0) -> Marginals:
        """Return the covariances of all knots from ``first`` on, scaled."""
        final = self.final if self.isam is None else self._swept()
        assert final is not None
        assert final.root is not None
        d, width = self.knot_size, self.forward[0].shape[1]
        back = np.array(self.back[first:]).reshape(-1, d, width)
        spread = np.array(self.spread[first:]).reshape(-1, d, d)
        return chain_marginals(back, spread, final.root)

    def drop(self, count: int) -> None:
        """Let the oldest intervals go; what they said stays as the prior of the first knot kept."""
        if self.isam is not None:
            self._swept()
        for name in ("knots_s", "reference_path", "reference_chains", "path", "chains", "pieces",
                     "forward", "other", "back", "spread"):  # fmt: skip
            del getattr(self, name)[:count]
        self.gone += count
        self.behind = max(self.behind - count, 0)
        self.dirty = max(self.dirty - count, 0)
