"""All rows between two knots as one vectorised function, for optimizers that take factors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from equations import Table, kinematics, tables

if TYPE_CHECKING:
    from collections.abc import Sequence

    from equations import Index
    from model import Pass
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class _Part:
    table: Table
    index: Index
    columns: NDArray[np.int64]
    """Shape (n, e): where each measurement's errors stand among those of the stack's sensors."""


class Stack:
    """The rows of one interval (of all measurements, where there is one knot).

    Unknowns are scaled deviations from the first guess. The kinematic rows of the interval and
    what else is linear in its knots belong to it.

    Attributes
    ----------
    knots, sensors
        Indices of the knots and sensors that it depends on.
    rows
        Number of rows.
    width, errors
        Numbers of a knot's state and of a sensor's errors.
    """

    def __init__(
        self,
        data: Pass,
        knots: tuple[int, ...],
        parts: Sequence[tuple[Table, Index]],
        *,
        measurements_only: bool = False,
    ) -> None:
        self._data = data
        self.knots = knots
        self.width = data.guess.shape[1]
        self.errors = data.error_sigma.size
        each = max(self.errors, 1)
        felt = [np.unique(table.column[index] // each) for table, index in parts]
        self.sensors = np.unique(np.concatenate([*felt, np.empty(0, dtype=np.int64)])).tolist()
        place = np.zeros(data.sensor_m.shape[0], dtype=np.int64)
        place[self.sensors] = np.arange(len(self.sensors))
        self._parts = []
        for table, index in parts:
            column = table.column[index]
            self._parts.append(_Part(table, index, place[column // each] * each + column % each))
        self._guess = np.concatenate([data.guess[k] for k in knots])
        self._scale = np.tile(data.scale, len(knots))
        self._sigma = np.tile(data.error_sigma, len(self.sensors))
        self._all_errors = np.zeros((data.sensor_m.shape[0], self.errors))
        self._linear, self._offset = np.empty((0, self._guess.size)), np.empty(0)
        if not measurements_only:
            self._linear, self._offset = self._linear_rows()
        measured = sum(part.columns.shape[0] * part.table.rows for part in self._parts)
        self.rows = measured + self._offset.size

    def _linear_rows(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        data, width = self._data, self.width
        span = self._guess.size
        matrices, offsets = [], []
        if len(self.knots) == 2:
            steps = slice(self.knots[0], self.knots[0] + 2)
            pair = _part_of(data, steps)
            matrix = np.concatenate([part[0] for part in pair], axis=1)
            matrices.append(matrix)
            offsets.append(matrix @ self._guess)
        if self.knots[0] == 0:
            matrices.append(np.eye(width, span) / data.prior_sigma[:, None])
            offsets.append(np.zeros(width))
        if np.isfinite(data.altitude_sigma_m):
            # Of the later knot alone, but for the first: each knot's once.
            owned = self.knots if self.knots[0] == 0 else self.knots[1:]
            for knot in owned:
                row = np.zeros((1, span))
                row[0, (knot - self.knots[0]) * width + 2] = 1.0 / data.altitude_sigma_m
                matrices.append(row)
                offsets.append(row @ self._guess)
        if not matrices:
            return np.empty((0, span)), np.empty(0)
        return np.concatenate(matrices) * self._scale, np.concatenate(offsets)

    def evaluate(
        self,
        knots: Sequence[NDArray[np.float64]],
        sensors: Sequence[NDArray[np.float64]],
        *,
        derivatives: bool = True,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return residuals and their derivatives by knots, then sensors (zeros if not wanted)."""
        deviation = np.concatenate(knots)
        blocks = (self._guess + deviation * self._scale).reshape(1, -1, 3)
        span = deviation.size
        errors = self._all_errors
        if self._sigma.size:
            own = np.concatenate(sensors) * self._sigma
            errors = errors.copy()
            errors[self.sensors] = own.reshape(len(self.sensors), -1)
        width = span + self._sigma.size
        residual, jacobian = np.empty(self.rows), np.zeros((self.rows if derivatives else 0, width))
        first = 0
        for part in self._parts:
            count = part.columns.shape[0]
            rows = part.table.at(
                np.broadcast_to(blocks, (count, *blocks.shape[1:])),
                errors,
                part.index,
                jacobian=derivatives,
            )
            last = first + rows.residual.size
            residual[first:last] = rows.residual.ravel()
            if not derivatives:
                first = last
                continue
            jacobian[first:last, :span] = rows.by_knots.reshape(last - first, span) * self._scale
            if part.columns.shape[1]:
                by_errors = rows.by_errors * self._sigma[part.columns][:, None]
                place = np.repeat(span + part.columns, part.table.rows, axis=0)
                line = np.arange(first, last)[:, None]
                jacobian[line, place] = by_errors.reshape(last - first, -1)
            first = last
        residual[first:] = self._offset + self._linear @ deviation
        if derivatives:
            jacobian[first:, :span] = self._linear
        return residual, jacobian


def _part_of(data: Pass, knots: slice) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    from dataclasses import replace

    return kinematics(replace(data, knots_s=data.knots_s[knots]))


def stacks(data: Pass) -> list[Stack]:
    """Return one stack for each interval."""
    found = tables(data)
    count = max(data.knots_s.size - 1, 1)
    edges = [np.searchsorted(table.interval, np.arange(count + 1)) for table in found]
    stacked = []
    for k in range(count):
        parts = [
            (table, slice(int(edge[k]), int(edge[k + 1])))
            for table, edge in zip(found, edges, strict=True)
            if edge[k + 1] > edge[k]
        ]
        knots = (k, k + 1) if data.knots_s.size > 1 else (0,)
        stacked.append(Stack(data, knots, parts))
    return stacked
