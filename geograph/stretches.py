"""Stretches of a sensor's errors between its resets.

A calibration, or a clock that is set, ends one stretch and begins another. Azimuth and elevation
are reset together; a clock by itself. Columns of states are kept in tables with a row for each
sensor, its first stretch, and behind these a row for every stretch after a reset of any kind.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from geograph.sensors import Sensor

_NEVER = np.empty(0)


def pointing_resets_s(sensor: Sensor) -> NDArray[np.float64]:
    """Return the known times at which azimuth and elevation errors begin anew, shape (r,)."""
    return _NEVER if sensor.calibrations_s == "auto" else np.array(sensor.calibrations_s)


def clock_resets_s(sensor: Sensor) -> NDArray[np.float64]:
    """Return the known times at which a clock's error begins anew, shape (r,)."""
    return np.array(sensor.clock_resets_s)


class Stretches:
    """Which stretch of which sensor a time belongs to.

    Parameters
    ----------
    resets_s
        For each sensor the times of its resets by channel, increasing.
    """

    def __init__(self, resets_s: Sequence[Mapping[int, NDArray[np.float64]]]) -> None:
        self._resets = resets_s
        self._merged = [
            np.unique(np.concatenate([_NEVER, *channels.values()])) for channels in resets_s
        ]
        later = [merged.size for merged in self._merged]
        first = np.cumsum([len(resets_s), *later])
        self._first: list[int] = first[:-1].tolist()
        self.rows = int(first[-1])
        """Rows of the tables."""
        self.any = self.rows > len(resets_s)
        """Whether there are resets at all."""

    def of(self, sensor: int, channel: int) -> NDArray[np.float64]:
        """Return the times of an error's resets, shape (r,)."""
        return self._resets[sensor].get(channel, _NEVER)

    def row(self, sensor: NDArray[np.int64], time_s: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return rows of the tables, shape (n,), for sensors and times by their clocks.

        What is measured at the very time of a reset is after it.
        """
        row = np.array(sensor, dtype=np.int64)
        if not self.any:
            return row
        for index, merged in enumerate(self._merged):
            if merged.size:
                own = np.flatnonzero(sensor == index)
                stretch = np.searchsorted(merged, time_s[own], side="right")
                row[own] = np.where(stretch > 0, self._first[index] + stretch - 1, index)
        return row

    def rows_of(self, sensor: int, channel: int, stretch: int) -> list[int]:
        """Return the rows of the tables in which an error is in one of its stretches."""
        merged = self._merged[sensor]
        own = np.searchsorted(self.of(sensor, channel), merged, side="right")
        rows = [sensor, *range(self._first[sensor], self._first[sensor] + merged.size)]
        return [row for row, at in zip(rows, [0, *own.tolist()], strict=True) if at == stretch]


@dataclass(frozen=True, eq=False)
class WalkCuts:
    """Which stretch of a walk is read, by n readings.

    A knot on the other side of a reset says nothing of the walk on this side.

    Attributes
    ----------
    resets_s
        Of every walk the times of its resets.
    column, stretch
        Shape (n,): which walk, and how many of its resets were before.
    """

    resets_s: list[NDArray[np.float64]]
    column: NDArray[np.int64]
    stretch: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        resets_s: list[NDArray[np.float64]],
        column: NDArray[np.int64],
        time_s: NDArray[np.float64],
    ) -> WalkCuts:
        """Return what readings of some walks at times (n,) by their sensors' clocks read."""
        stretch = np.zeros(column.size, dtype=np.int64)
        for walk, resets in enumerate(resets_s):
            own = column == walk
            stretch[own] = np.searchsorted(resets, time_s[own], side="right")
        return cls(resets_s, column, stretch)

    def weighed(
        self,
        knots_s: NDArray[np.float64],
        at: NDArray[np.int64],
        before: NDArray[np.float64],
        after: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the weights of the knots before and after, those across a reset left out."""
        before, after = before.copy(), after.copy()
        for walk, resets in enumerate(self.resets_s):
            if not resets.size:
                continue
            own = np.flatnonzero(self.column == walk)
            of_knot = np.searchsorted(resets, knots_s, side="right")
            first = of_knot[at[own]] == self.stretch[own]
            second = of_knot[at[own] + 1] == self.stretch[own]
            before[own] = np.where(first, np.where(second, before[own], 1.0), 0.0)
            after[own] = np.where(second, np.where(first, after[own], 1.0), 0.0)
        return before, after
