"""How much work a check-up may do, counted and not timed: the same recording, the same answer."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from geograph.initialise import RANGE_ROUNDS, FirstGuess

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from geograph.initialise import PathFit
    from geograph.lines import Attempt, Lines

# Units of work, each most of a millisecond of one core, after which no hypothesis more is tried.
_MOST = 6000.0

# Work of one fit of six rounds: itself, for each bearing, and for each cubed unknown.
_FIT, _BEARING, _UNKNOWN = 3.0, 3e-3, 2e-6
# Work of holding a sensor's bearings against a path of some others, over its clock's prior.
_CLOCK = 20.0


@dataclass(eq=False)
class Effort:
    """Work done so far, and what was left undone.

    Attributes
    ----------
    spent
        Units of work.
    undone
        What was not tried, each in words.
    """

    spent: float = 0.0
    undone: list[str] = field(default_factory=list)

    def spend(self, work: float) -> None:
        """Count some work."""
        self.spent += work

    def allows(self, what: str) -> bool:
        """Tell whether there is work left for something; if not, note that it was not done."""
        if self.spent < _MOST:
            return True
        if what not in self.undone:
            self.undone.append(what)
        return False


@dataclass(eq=False)
class CountedGuess(FirstGuess):
    """A first guess whose fits are counted.

    Parameters
    ----------
    effort
        Where they are counted.
    """

    effort: Effort = field(kw_only=True)
    # Of many mistakes tried nearly all lead to no fit, and that soon.
    patient: bool = False

    def fit(self, lines: Lines, degree: int, segments: int, rounds: int = RANGE_ROUNDS) -> Attempt:
        """Fit one spline, and count it."""
        size = 3 * (degree + segments)
        work = _FIT + _BEARING * lines.time_s.size + _UNKNOWN * size**3
        self.effort.spend(work * rounds / RANGE_ROUNDS)
        return super().fit(lines, degree, segments, rounds)

    def best_fit(
        self, clock_s: NDArray[np.float64], rows: NDArray[np.int64] | None = None
    ) -> PathFit:
        """Fit splines of several flexibilities; those through some rows are for clocks' sake."""
        if rows is not None:
            self.effort.spend(_CLOCK)
        return super().best_fit(clock_s, rows)
