"""Position fixes of platforms whose path is estimated."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.families.base import Evaluation, Family, Values
from geograph.states import POSITION, SensorErrorTerms

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.path import Path, PathState
    from geograph.platforms import Platform
    from geograph.states import SensorStates


class FixFamily(Family):
    """The fixes of one platform within the span of the knots.

    Parameters
    ----------
    platform
        Its fixes and the line that they are counted from.
    states
        Sensor-error states of the problem.
    chain_scale
        Shape (w,): scales of the chains, SI.
    rows
        Which fixes.
    """

    name = "trajectory"
    rows = 3

    def __init__(
        self,
        platform: Platform,
        states: SensorStates,
        chain_scale: NDArray[np.float64],
        rows: NDArray[np.int64],
    ) -> None:
        self.platform = platform
        self.states = states
        self.chain_scale = chain_scale
        self._rows = rows
        self.time_s = platform.time_s[rows]
        self.line = np.zeros(rows.size, dtype=np.int64)
        self.row_count = 3 * rows.size
        sensor = np.full(rows.size, platform.sensor, dtype=np.int64)
        self.terms = SensorErrorTerms(states, sensor, self.time_s, chain_scale)
        self._none = np.zeros(states.size)
        self._fix = platform.fix_m[rows] - platform.line.position_at(self.time_s)

    def subset(self, index: NDArray[np.int64]) -> FixFamily:
        """Return the family of some of its fixes."""
        return FixFamily(self.platform, self.states, self.chain_scale, self._rows[index])

    def evaluate(
        self, path: Path, state: PathState, values: Values, *, jacobian: bool
    ) -> Evaluation:
        """Evaluate all fixes at one point."""
        del state
        interval = path.locate(self.time_s).interval
        share = self.terms.share(path.knots_s, interval, self.time_s)
        # A constant offset is between the fixes and the sensor: the platform's path is without it.
        position = self.terms.errors(self._none, values.walks, share)[:, POSITION : POSITION + 3]
        sigma = self.platform.sigma_m
        residual = (position - self._fix) / sigma
        entry = self.terms.chains
        axis = entry.channel - POSITION
        own = (axis >= 0) & (axis < 3)
        row, column = entry.row[own], entry.column[own]
        by = np.zeros((row.size, 3))
        by[np.arange(row.size), axis[own]] = entry.basis[own] / sigma
        none = np.empty(0, dtype=np.int64)
        size = path.size
        return Evaluation(
            residual,
            interval,
            np.zeros((len(self), 3, 2, size)) if jacobian else None,
            none,
            none,
            np.empty((0, 3)),
            row,
            column,
            share.before[own],
            share.after[own],
            by,
        )
