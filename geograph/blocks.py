"""Information blocks: all measurements of one kind, added up per knot interval.

The whitened Jacobian rows of a family are laid out as dense rows over the columns

    [ knot k (path, walks) | knot k + 1 (path, walks) | constant sensor states | residual ],

sorted by interval, and multiplied with themselves: one matrix of sums of products per interval,
whose last column is the gradient. What concerns the constant states alone is the same for all
intervals and needs to be held once. Only the layout of the rows knows the sparsity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import blas

from geograph.common import project
from geograph.families.base import ByPosition
from geograph.kernels import compiled, flat, indices

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from geograph.common import Common
    from geograph.families import Evaluation

# Bytes of dense rows held at once: as much as stays in a processor's cache between the filling and
# the products.
_BUFFER_BYTES = 2**20


@dataclass(frozen=True)
class ColumnLayout:
    """Columns of the dense rows.

    Attributes
    ----------
    path
        Path components of a knot, 3m.
    walks
        Walks at a knot.
    constants
        Constant sensor states.
    chained
        Whether there is a following knot (false for a static object).
    """

    path: int
    walks: int
    constants: int
    chained: bool

    @property
    def knot(self) -> int:
        """Components of one knot."""
        return self.path + self.walks

    @property
    def states(self) -> int:
        """First column of the constant states."""
        return 2 * self.knot if self.chained else self.knot

    @property
    def width(self) -> int:
        """Number of columns, the residual's included."""
        return self.states + self.constants + 1


@dataclass(frozen=True, eq=False)
class Sums:
    """Sums of products of n intervals.

    Attributes
    ----------
    knots
        Shape (n, k, k + c): rows of the k components of the interval's knots, over these, the
        constant states and the gradient.
    others
        Shape (n, c, c) or (1, c, c): rows of the constant states and the gradient over these, of
        each interval or of all together.
    """

    knots: NDArray[np.float64]
    others: NDArray[np.float64]

    @classmethod
    def zeros(cls, layout: ColumnLayout, intervals: int, *, apart: bool = False) -> Sums:
        """Return sums of nothing.

        Parameters
        ----------
        layout
            Columns of the rows.
        intervals
            How many there are.
        apart
            Whether each interval keeps its own sums of the constant states.
        """
        rest = layout.width - layout.states
        return cls(
            np.zeros((intervals, layout.states, layout.width)),
            np.zeros((intervals if apart else 1, rest, rest)),
        )

    @classmethod
    def of(cls, full: NDArray[np.float64], states: int) -> Sums:
        """Return whole matrices, shape (n, width, width), as sums; ``states`` as in the layout."""
        return cls(full[:, :states], full[:, states:, states:])

    def full(self) -> NDArray[np.float64]:
        """Return whole matrices, shape (n, width, width); what belongs to all is in the first."""
        count, states, width = self.knots.shape
        full = np.zeros((count, width, width))
        full[:, :states] = self.knots
        full[:, states:, :states] = np.swapaxes(self.knots[:, :, states:], 1, 2)
        full[: self.others.shape[0], states:, states:] = self.others
        return full


@dataclass(frozen=True, eq=False)
class _Pass:
    """Measurements whose rows are held at once.

    Attributes
    ----------
    measurements
        Which these are, sorted by interval.
    place
        Shape (n,): place of each measurement of the family among them, where it is one of them.
    constants, walks
        Which entries of the evaluation's constant states and walks belong to them.
    runs
        (interval, first measurement, end) of each interval in the pass.
    """

    measurements: slice | NDArray[np.int64]
    place: NDArray[np.int64]
    constants: slice | NDArray[np.int64]
    walks: slice | NDArray[np.int64]
    runs: list[tuple[int, int, int]]


class BlockSum:
    """Adds up one family's information per interval; keeps its bookkeeping between calls.

    Parameters
    ----------
    layout
        Columns of the rows.
    path_scale
        Shape (3m,): scales of the path's components, SI.
    """

    def __init__(self, layout: ColumnLayout, path_scale: NDArray[np.float64]) -> None:
        self.layout = layout
        # Of both neighbours, so that NumPy sees one long row where there are no walks.
        self._knots_scale = np.stack([path_scale, path_scale])
        self._planned: tuple[NDArray[np.int64], ...] | None = None
        self._passes: list[_Pass] = []
        self._repeated = False
        self._buffer = np.empty((0, 0, 0))

    def _plan(self, found: Evaluation) -> None:
        """Divide the measurements into passes, if they are not divided as they are now."""
        now = (found.interval, found.constant_row, found.walk_row)
        group = None if found.common is None else found.common.group
        if self._planned is not None and all(map(np.array_equal, self._planned, now)):
            return
        self._planned = now
        # A platform's velocity is felt through its position's and its velocity's channel.
        place = found.walk_row * max(self.layout.walks, 1) + found.walk_column
        self._repeated = bool(np.unique(place).size < place.size)
        count, rows = found.residual.shape
        held = max(1, _BUFFER_BYTES // (8 * rows * self.layout.width))
        order = np.argsort(found.interval, kind="stable")
        whole = count <= held and np.array_equal(order, np.arange(count))
        rank = np.empty(count, dtype=np.int64)
        rank[order] = np.arange(count)
        self._passes = []
        for low, high in _bounds(count, held, None if group is None else group[order]):
            part = order[low:high]
            interval = found.interval[part]
            edges = np.flatnonzero(np.diff(interval, prepend=-1, append=-1)).tolist()
            runs = [(int(interval[first]), first, end) for first, end in pairwise(edges)]
            everything = slice(None)
            own = (rank >= low) & (rank < high)
            self._passes.append(
                _Pass(
                    everything if whole else part,
                    rank - low,
                    everything if whole else np.flatnonzero(own[found.constant_row]),
                    everything if whole else np.flatnonzero(own[found.walk_row]),
                    runs,
                )
            )
        largest = max((part.runs[-1][2] for part in self._passes), default=0)
        self._buffer = np.empty((largest, rows, self.layout.width))

    def add(self, total: Sums, found: Evaluation, root_weight: NDArray[np.float64] | None) -> None:
        """Add the family's sums of products to ``total``.

        Parameters
        ----------
        total
            Changed in place.
        found
            An evaluation with derivatives.
        root_weight
            Shape (n,): square roots of the loss's weights, or None for ones.
        """
        if compiled is not None:
            by = found.by_path
            alike = isinstance(by, ByPosition) and by.start is not None
            if found.common is None and not (alike and not found.walk_row.size):
                self._add_compiled(total, found, root_weight)
            else:
                self._add_groups(total, found, root_weight)
            return
        self._plan(found)
        rows, width = found.residual.shape[1], self.layout.width
        states, apart = self.layout.states, total.others.shape[0] > 1
        for part in self._passes:
            dense = self._fill(part, found, root_weight).reshape(-1, width)
            for interval, first, end in part.runs:
                own = dense[first * rows : end * rows]
                product = blas.dgemm(1.0, own.T, own.T, trans_b=True)
                total.knots[interval] += product[:states]
                total.others[interval if apart else 0] += product[states:, states:]

    def _add_compiled(
        self, total: Sums, found: Evaluation, root_weight: NDArray[np.float64] | None
    ) -> None:
        """Do what :meth:`add` does, in compiled code, without laying out the rows."""
        layout, by = self.layout, found.by_path
        count, rows = found.residual.shape
        order, by_path, weights = 0, None, None
        if isinstance(by, ByPosition) and by.rates is None:
            order, by_path, weights = by.weights.shape[1] // 2, by.by_position, by.weights
        else:
            by_path = found.by_knots
        compiled.add_blocks(
            *(total.knots.shape[0], total.others.shape[0]),
            *(layout.path, layout.walks, layout.constants, int(layout.chained)),
            *(count, rows, order, found.constant_row.size, found.walk_row.size),
            *(total.knots, total.others),
            flat(found.residual),
            indices(found.interval),
            flat(by_path),
            flat(weights),
            self._knots_scale[0],
            *_of_errors(found),
            flat(root_weight),
        )

    def _add_groups(
        self, total: Sums, found: Evaluation, root_weight: NDArray[np.float64] | None
    ) -> None:
        """Do the same where measurements come in groups: of one emission, or with an unknown."""
        layout, by, common = self.layout, found.by_path, found.common
        start = held = None
        if common is not None:
            start, held = common.start, flat(common.by_common)
        order = 0
        factors: tuple[NDArray[np.float64] | None, ...]
        if isinstance(by, ByPosition) and by.start is not None and not found.walk_row.size:
            order, start = by.weights.shape[1] // 2, by.start
            factors = (by.by_position, by.weights, by.by_velocity, by.rates)
        else:
            factors = (found.by_knots, None, None, None)
        assert start is not None
        compiled.add_shared(
            *(total.knots.shape[0], total.others.shape[0]),
            *(layout.path, layout.walks, layout.constants, int(layout.chained)),
            *(found.residual.shape[0], order, start.size),
            *(found.constant_row.size, found.walk_row.size),
            *(total.knots, total.others),
            flat(found.residual),
            indices(found.interval),
            *map(flat, factors),
            self._knots_scale[0],
            *_of_errors(found),
            flat(root_weight),
            indices(start),
            held,
            None if common is None else flat(common.information),
        )

    def _fill(
        self, part: _Pass, found: Evaluation, root_weight: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """Lay out the rows of a pass, shape (measurements, rows, width)."""
        assert found.by_knots is not None
        layout = self.layout
        by_knots = found.by_knots[part.measurements]
        dense = self._buffer[: by_knots.shape[0]]
        dense[:] = 0.0
        knots = dense[:, :, : layout.states].reshape(*dense.shape[:2], -1, layout.knot)
        scale = self._knots_scale[: knots.shape[2]]
        np.multiply(by_knots[:, :, : knots.shape[2]], scale, out=knots[..., : layout.path])
        entry = part.constants
        at = part.place[found.constant_row[entry]]
        dense[at, :, layout.states + found.constant_column[entry]] = found.by_constants[entry]
        entry = part.walks
        if found.walk_row[entry].size:
            at = part.place[found.walk_row[entry]]
            before = layout.path + found.walk_column[entry]
            by_walks = found.by_walks[entry]
            first = by_walks * found.walk_before[entry][:, None]
            second = by_walks * found.walk_after[entry][:, None]
            if self._repeated:
                columns = np.swapaxes(dense, 1, 2)
                np.add.at(columns, (at, before), first)
                np.add.at(columns, (at, before + layout.knot), second)
            else:
                dense[at, :, before] = first
                dense[at, :, before + layout.knot] = second
        dense[:, :, -1] = found.residual[part.measurements]
        if root_weight is not None:
            dense *= root_weight[part.measurements][:, None, None]
        if found.common is not None:
            self._take_up(dense[:, 0], part, found.common, root_weight)
        return dense

    def _take_up(
        self,
        dense: NDArray[np.float64],
        part: _Pass,
        common: Common,
        root_weight: NDArray[np.float64] | None,
    ) -> None:
        """Eliminate the unknowns that measurements share from the rows of a pass."""
        by_common = common.by_common[part.measurements]
        if root_weight is not None:
            by_common = by_common * root_weight[part.measurements]
        group = common.group[part.measurements]
        start = np.flatnonzero(np.diff(group, prepend=-1))
        local = np.cumsum(np.diff(group, prepend=-1) != 0) - 1
        project(dense, by_common, local, start, common.information[group[start]])


def dense_rows(
    found: Evaluation, layout: ColumnLayout, path_scale: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the rows of a few measurements, shape (n, r, width), in their own order.

    Parameters
    ----------
    found
        An evaluation with derivatives.
    layout
        Columns of the rows.
    path_scale
        Shape (3m,): scales of the path's components, SI.
    """
    # Every measurement an interval of its own: passes keep their order.
    apart = replace(found, interval=np.arange(found.interval.size), common=None)
    rows = BlockSum(layout, path_scale)
    rows._plan(apart)
    return np.concatenate([rows._fill(part, apart, None).copy() for part in rows._passes])


def _bounds(count: int, held: int, group: NDArray[np.int64] | None) -> Iterator[tuple[int, int]]:
    """Yield ranges of at most so many measurements, or as many as one group has."""
    low = 0
    while low < count:
        high = min(low + held, count)
        if group is not None and high < count:
            # Back to where a group ends, or on to the end of one that is larger than a pass.
            ends = np.flatnonzero(np.diff(group)) + 1
            before = ends[(ends > low) & (ends <= high)]
            after = ends[ends > high]
            high = int(before[-1]) if before.size else int(after[0]) if after.size else count
        yield low, high
        low = high


def _of_errors(found: Evaluation) -> tuple[Any, ...]:
    """Return derivatives by the sensors' errors as compiled code takes them."""
    return (
        indices(found.constant_row),
        indices(found.constant_column),
        flat(found.by_constants),
        indices(found.walk_row),
        indices(found.walk_column),
        flat(found.walk_before),
        flat(found.walk_after),
        flat(found.by_walks),
    )
