"""Known coordinates of the path, as a first guess uses them: rows linear in the position."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import BSpline

from geograph.lines import Rows

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.measurements import Constraints
    from geograph.recording import Frame

_NAMES = ("x_m", "y_m", "z_m")

WHOLE_TIMES = 20
"""At how many times a first guess puts what is known along the whole path."""


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Known coordinates of the path.

    Attributes
    ----------
    axis
        Shape (n, 3): unit vector of each.
    time_s
        Shape (n,); NaN: along the whole path.
    value, sigma
        Shape (n,), metres.
    """

    axis: NDArray[np.float64]
    time_s: NDArray[np.float64]
    value: NDArray[np.float64]
    sigma: NDArray[np.float64]

    @classmethod
    def of(cls, table: Constraints | None) -> Coordinates:
        """Return those of a table of constraints, which may be none."""
        kinds = () if table is None else table.kind
        rows = [row for row, kind in enumerate(kinds) if kind in _NAMES]
        if table is None or not rows:
            empty = np.zeros(0)
            return cls(np.zeros((0, 3)), empty, empty, empty)
        axis = np.eye(3)[[_NAMES.index(kinds[row]) for row in rows]]
        return cls(axis, table.time_s[rows], table.value[rows], table.sigma[rows])

    def __len__(self) -> int:
        return int(self.value.size)

    def whole(self) -> Coordinates:
        """Return those along the whole path alone."""
        own = np.isnan(self.time_s)
        return Coordinates(self.axis[own], self.time_s[own], self.value[own], self.sigma[own])

    def place(self, frame: Frame) -> NDArray[np.float64]:
        """Return where they say that the object is, shape (1, 3); (0, 3) if they do not say it.

        In a local frame x and y are enough, and a z that is not known is 0.
        """
        known = np.abs(self.axis).sum(axis=0) > 0.0
        if not known[: 2 if frame == "local" else 3].all():
            return np.zeros((0, 3))
        weight = 1.0 / self.sigma**2
        total = weight @ self.axis
        return np.divide(
            (weight * self.value) @ self.axis, total, out=np.zeros(3), where=total > 0.0
        )[None]

    def rows(self, spline: BSpline) -> Rows:
        """Return them as conditions on a spline's coefficients.

        One along the whole path is put at many times, which together count once.
        """
        low, high = spline.t[0], spline.t[-1]
        whole = np.isnan(self.time_s)
        span = np.linspace(low, high, WHOLE_TIMES)
        index = np.arange(len(self))
        which = np.concatenate([index[~whole], np.repeat(index[whole], span.size)])
        time = np.concatenate([self.time_s[~whole], np.tile(span, int(whole.sum()))])
        sigma = self.sigma[which] * np.where(whole[which], np.sqrt(span.size), 1.0)
        at = BSpline.design_matrix(np.clip(time, low, high), spline.t, spline.k).toarray()
        return Rows(at, self.axis[which], self.value[which], 1.0 / sigma)
