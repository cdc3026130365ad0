"""Known heights of the path, as a first guess uses them: rows linearised about a path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import BSpline

from geograph.factors.constraints import altitude
from geograph.known_coordinates import WHOLE_TIMES
from geograph.lines import Rows

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.measurements import Constraints
    from geograph.recording import Frame


@dataclass(frozen=True, eq=False)
class Heights:
    """Known heights of the path.

    Attributes
    ----------
    time_s
        Shape (n,); NaN: along the whole path.
    value, sigma
        Shape (n,), metres.
    """

    time_s: NDArray[np.float64]
    value: NDArray[np.float64]
    sigma: NDArray[np.float64]

    @classmethod
    def of(cls, table: Constraints | None) -> Heights | None:
        """Return those of a table of constraints; None if it has none."""
        if table is None:
            return None
        rows = np.array([kind == "altitude_m" for kind in table.kind], dtype=bool)
        if not rows.any():
            return None
        return cls(table.time_s[rows], table.value[rows], table.sigma[rows])

    def rows(self, spline: BSpline, frame: Frame, sensor_m: NDArray[np.float64]) -> Rows:
        """Return them as conditions on a spline's coefficients, linearised about it.

        Parameters
        ----------
        spline
            The path so far; where it is too deep for a height, the place of the sensors stands in.
        frame
            Of the positions.
        sensor_m
            Shape (m, 3): places of the sensors.
        """
        time, which = self._times(spline)
        at = BSpline.design_matrix(time, spline.t, spline.k).toarray()
        position = np.asarray(spline(time))
        if frame == "ecef" and not _plausible(position):
            position = np.broadcast_to(sensor_m.mean(axis=0), position.shape).copy()
        height, up = altitude(position, frame)
        target = np.einsum("nc,nc->n", up, position) - height + self.value[which]
        return Rows(at, up, target, 1.0 / self.sigma[which])

    def missed(self, spline: BSpline, frame: Frame) -> float:
        """Return by how many sigmas a path misses them, in the median."""
        time, which = self._times(spline)
        position = np.asarray(spline(time))
        if frame == "ecef" and not _plausible(position):
            return float("inf")
        height, _ = altitude(position, frame)
        return float(np.median(np.abs(height - self.value[which]) / self.sigma[which]))

    def _times(self, spline: BSpline) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return times within a spline, and whose they are.

        What is known along the whole path is put at so many times that no piece of it goes free.
        """
        low, high = float(spline.t[0]), float(spline.t[-1])
        index = np.arange(self.value.size)
        whole = np.isnan(self.time_s)
        span = np.linspace(low, high, max(WHOLE_TIMES, 2 * spline.t.size))
        time = np.concatenate([self.time_s[~whole], np.tile(span, int(whole.sum()))])
        which = np.concatenate([index[~whole], np.repeat(index[whole], span.size)])
        return np.clip(time, low, high), which


def _plausible(position_m: NDArray[np.float64]) -> bool:
    """Tell whether ECEF positions lie where heights are well defined."""
    return bool((np.linalg.norm(position_m, axis=1) > 1e6).all())
