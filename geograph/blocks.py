"""Information blocks: all measurements of one kind, added up per knot interval.

The whitened Jacobian rows of a family are laid out as dense rows over the columns

    [ knot k (path, walks) | knot k + 1 (path, walks) | constant sensor states | residual ],

gathered by interval, and multiplied with themselves in batches: one matrix of sums of products per
interval, whose last column is the gradient. Only the layout of the rows knows the sparsity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.families import Evaluation

# Measurements in one batch row: products of this many rows are where matrix multiplication is
# efficient, and intervals with few measurements waste little on padding.
_CHUNK = 64

# Bytes of dense rows held at once.
_BUFFER_BYTES = 64 * 2**20


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


class BlockSum:
    """Adds up one family's information per interval; keeps its bookkeeping between calls.

    Parameters
    ----------
    layout
        Columns of the rows.
    intervals
        Number of intervals.
    path_scale
        Shape (3m,): scales of the path's components, SI.
    """

    def __init__(
        self, layout: ColumnLayout, intervals: int, path_scale: NDArray[np.float64]
    ) -> None:
        self.layout = layout
        self.intervals = intervals
        self.path_scale = path_scale
        self._interval: NDArray[np.int64] | None = None

    def _plan(self, interval: NDArray[np.int64], rows: int) -> None:
        """Give every measurement a chunk and a slot in it."""
        if self._interval is not None and np.array_equal(self._interval, interval):
            return
        self._interval = interval
        order = np.argsort(interval, kind="stable")
        count = np.bincount(interval, minlength=self.intervals)
        size = int(min(max(count.max(), 1), _CHUNK))
        chunks = -(-count // size)
        first_chunk = np.concatenate([[0], np.cumsum(chunks)])
        first = np.concatenate([[0], np.cumsum(count)])
        rank = np.arange(interval.size) - first[interval[order]]
        self._chunk = np.empty(interval.size, dtype=np.int64)
        self._slot = np.empty(interval.size, dtype=np.int64)
        self._chunk[order] = first_chunk[interval[order]] + rank // size
        self._slot[order] = (rank % size) * rows
        self._size = size * rows
        self._filled = np.flatnonzero(count)
        self._starts = first_chunk[self._filled]
        self._chunks = int(first_chunk[-1])
        self._order = order

    def add(
        self, total: NDArray[np.float64], found: Evaluation, root_weight: NDArray[np.float64] | None
    ) -> None:
        """Add the family's sums of products to ``total``.

        Parameters
        ----------
        total
            Shape (intervals, width, width), changed in place.
        found
            An evaluation with derivatives.
        root_weight
            Shape (n,): square roots of the loss's weights, or None for ones.
        """
        self._plan(found.interval, found.residual.shape[1])
        width = self.layout.width
        per_pass = max(1, _BUFFER_BYTES // (8 * self._size * width))
        if self._chunks <= per_pass:
            dense = self._dense(found, root_weight, slice(None), 0, self._chunks)
            sums = np.matmul(dense.transpose(0, 2, 1), dense)
            if self._chunks == self.intervals == self._filled.size:
                total += sums
            else:
                total[self._filled] += np.add.reduceat(sums, self._starts, axis=0)
            return
        owner = np.repeat(self._filled, np.diff(np.concatenate([self._starts, [self._chunks]])))
        sorted_chunk = self._chunk[self._order]
        for low in range(0, self._chunks, per_pass):
            high = min(low + per_pass, self._chunks)
            a, b = np.searchsorted(sorted_chunk, [low, high])
            dense = self._dense(found, root_weight, self._order[a:b], low, high)
            np.add.at(total, owner[low:high], np.matmul(dense.transpose(0, 2, 1), dense))

    def _dense(
        self,
        found: Evaluation,
        root_weight: NDArray[np.float64] | None,
        selection: NDArray[np.int64] | slice,
        low: int,
        high: int,
    ) -> NDArray[np.float64]:
        """Lay out the rows of the chunks from low to high, shape (chunks, rows, width)."""
        assert found.by_knots is not None
        layout = self.layout
        rows = found.residual.shape[1]
        dense = np.zeros((high - low, self._size, layout.width))
        weight = np.ones(found.residual.shape[0]) if root_weight is None else root_weight
        everything = isinstance(selection, slice)
        by_knots = found.by_knots[selection] * self.path_scale
        chunk = self._chunk[selection] - low
        slot = self._slot[selection]
        if root_weight is not None:
            by_knots *= weight[selection][:, None, None, None]
        inside = None
        if not everything:
            inside = np.zeros(found.residual.shape[0], dtype=bool)
            inside[selection] = True
        for row in range(rows):
            target = slot + row
            dense[chunk, target, : layout.path] = by_knots[:, row, 0]
            if layout.chained:
                following = slice(layout.knot, layout.knot + layout.path)
                dense[chunk, target, following] = by_knots[:, row, 1]
            dense[chunk, target, -1] = (found.residual[:, row] * weight)[selection]
            for entry_row, column, value in self._sparse(found, row):
                keep = slice(None) if inside is None else inside[entry_row]
                at = entry_row[keep]
                dense[self._chunk[at] - low, self._slot[at] + row, column[keep]] = (
                    value[keep] * weight[at]
                )
        return dense

    def _sparse(
        self, found: Evaluation, row: int
    ) -> list[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]]:
        """Return (measurement, column, value) of the sensor states in one residual row."""
        layout = self.layout
        entries = []
        if found.constant_row.size:
            entries.append(
                (
                    found.constant_row,
                    layout.states + found.constant_column,
                    found.by_constants[:, row],
                )
            )
        if found.walk_row.size:
            value, fraction = found.by_walks[:, row], found.walk_fraction
            before = layout.path + found.walk_column
            entries.append((found.walk_row, before, value * (1.0 - fraction)))
            entries.append((found.walk_row, before + layout.knot, value * fraction))
        return entries
