"""Whether another sensor could be the wrong one.

Where all that a sensor measured was rejected, the others agree without it. With few sensors that
says little: leaving out another one may make the rest agree just as well, elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.rivals import read_attempt
from geograph.solver import Status, solve

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.problem import Problem
    from geograph.smoother import Smoother
    from geograph.solver import Solution

# A sensor was left out where this share of its measurements was rejected.
_LEFT_OUT = 0.9

# Another one could be wrong as well where the cost, less what chance gives to more or fewer
# measurements, is not above this: three sigmas.
RISE = 4.5
MOST_SENSORS = 12
STARTS = 3
ITERATIONS = 60


@dataclass(frozen=True, eq=False)
class Trial:
    """What came of leaving out one sensor; the cost is less what chance gives to its rows."""

    sensors: tuple[int, ...]
    rejected: NDArray[np.bool_]
    problem: Problem
    solution: Solution

    @property
    def cost(self) -> float:
        """Cost of the solution, and what chance gives to the measurements left out."""
        return self.solution.cost + 0.5 * int(self.rejected.sum())


def other_culprits(smoother: Smoother) -> str | None:
    """Return a sentence if the sensor that was left out is not the only one that could be wrong.

    Where the rest agrees better without another sensor, that one is left out instead.

    Parameters
    ----------
    smoother
        With its outliers found and solved without them.
    """
    if smoother.solution.status is not Status.CONVERGED or not smoother.rejected.any():
        return None
    own = own_measurements(smoother)
    lost = [i for i, mine in own.items() if smoother.rejected[mine].mean() >= _LEFT_OUT]
    if not lost or len(own) > MOST_SENSORS:
        return None
    now = Trial(tuple(lost), smoother.rejected, smoother.problem, smoother.solution)
    tried = [_without(smoother, own, lost, other) for other in own if [other] != lost]
    trials = sorted([now, *(one for one in tried if one is not None)], key=lambda one: one.cost)
    best = trials[0]
    if best.cost < now.cost - RISE:
        smoother.adopt(best.problem, best.solution, best.rejected)
    else:
        best = now
    names = smoother.prepared.recording.sensor_names
    said = [" and ".join(names[i] for i in one.sensors) for one in trials]
    others = [text for text, one in zip(said, trials, strict=True)
              if one is not best and one.cost <= best.cost + RISE]  # fmt: skip
    if not others:
        return None
    return (
        f"without {said[trials.index(best)]} the rest agrees, but so it does, elsewhere, without "
        f"{' or without '.join(others)}: which of them is wrong cannot be told; one more sensor or "
        "a known height would tell"
    )


def own_measurements(smoother: Smoother) -> dict[int, NDArray[np.bool_]]:
    """Return which measurements each sensor made, shape (n,), references not counted."""
    sensor = np.concatenate([family.sensor for family in smoother.families])
    return {int(i): sensor == i for i in np.unique(sensor)}


def _without(
    smoother: Smoother, own: dict[int, NDArray[np.bool_]], lost: list[int], other: int
) -> Trial | None:
    """Put sensors back and leave out another one; None if that leads nowhere."""
    back = np.any([own[i] for i in lost], axis=0)
    out = smoother.rejected & ~back | own[other]
    if out.all():
        return None
    weights = smoother.weights((~out).astype(np.float64))
    problem = smoother.problem.with_weights(weights, smoother.problem.loss)
    starts = [smoother.solution.values]
    starts += [read_attempt(attempt, problem) for attempt in smoother.attempts[:STARTS]]
    starts = [start for start in starts if np.isfinite(start.path).all()]
    found = [solve(problem, start, max_iterations=ITERATIONS) for start in starts]
    found = [one for one in found if one.status is Status.CONVERGED]
    if not found:
        return None
    return Trial((other,), out, problem, min(found, key=lambda one: one.cost))
