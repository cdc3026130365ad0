"""Stages: pieces of the path's time in which the process noise differs.

In every stage the noise is a multiple of the motion's own, in all directions alike. A transition's
whitened residual is then divided by the multiple and its noise multiplied; the transition itself
does not change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Stages:
    """Piecewise constant multiples of a motion's process noise.

    Attributes
    ----------
    from_s
        Shape (S - 1,): growing times at which all stages but the first begin, seconds.
    times
        Shape (S,): the noise of each stage over that of the motion, which is the first one's.
    """

    from_s: NDArray[np.float64]
    times: NDArray[np.float64]

    @classmethod
    def of(cls, given: Sequence[tuple[float, float]]) -> Stages:
        """Return the stages of a setting; see :class:`geograph.SmoothSettings`."""
        start, times = np.array(given, dtype=np.float64).reshape(-1, 2).T
        return cls(start, np.concatenate([[1.0], times]))

    def pairs(self) -> tuple[tuple[float, float], ...]:
        """Return them as a setting; see :meth:`of`."""
        return tuple(zip(self.from_s.tolist(), self.times[1:].tolist(), strict=True))

    @property
    def count(self) -> int:
        """How many there are."""
        return int(self.times.size)

    def at(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the multiples that hold at some times, shape (n,)."""
        return np.asarray(self.times[np.searchsorted(self.from_s, time_s, side="right")])

    def over(self, knots_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the multiples of the intervals between knots, shape (K - 1,).

        Where a stage begins between two knots the mean square over the interval is taken, which is
        what the noise adds up to.

        Parameters
        ----------
        knots_s
            Shape (K,).
        """
        first, last = knots_s[:-1], knots_s[1:]
        edges = np.concatenate([[-np.inf], self.from_s, [np.inf]])
        low = np.maximum(first[:, None], edges[:-1])
        high = np.minimum(last[:, None], edges[1:])
        share = np.maximum(high - low, 0.0) / (last - first)[:, None]
        return np.asarray(np.sqrt(share @ self.times**2))


def check_stages(given: object) -> None:
    """Raise where a setting of stages is none.

    Raises
    ------
    InputError
        If it is neither None nor ``"auto"`` nor pairs of growing times and numbers above 0.
    """
    if given is None or given == "auto":
        return
    expected = 'expected "auto", or pairs (from_s, times) with growing times and numbers above 0'
    try:
        pairs = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        pairs = np.empty(0)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or not np.isfinite(pairs).all():
        raise InputError(f"stages is {given!r}; {expected}", column="stages")
    if not ((np.diff(pairs[:, 0]) > 0.0).all() and (pairs[:, 1] > 0.0).all()):
        raise InputError(f"stages is {given!r}; {expected}", column="stages")
