"""One sensor that is wrong in all it measured, among others that agree.

Rejection of single measurements keeps those of a wrong sensor that agree by chance, and the path
is drawn to them; or it spreads the error over the priors of all. Where an estimate is such a
compromise, every sensor is left out as a whole in turn, with all measurements of the others put
back. One of them is wrong if the others agree without it, better than all did before, and its own
measurements are then far beyond their sigmas: wrong, and not only noisy.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from geograph import chi_square
from geograph.culprits import ITERATIONS, MOST_SENSORS, RISE, STARTS, Trial, own_measurements
from geograph.rivals import read_attempt
from geograph.robust import WRONG, plain_limits
from geograph.solver import Status, solve

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.problem import Problem
    from geograph.smoother import Smoother
    from geograph.solver import Solution

FALSE_ALARM = 1e-3
"""Chance that measurements which agree are taken for a compromise, and looked at again."""

# A sensor is judged by no fewer measurements.
_LEAST = 10
# Shares of a sensor's measurements: where so many were rejected it is looked at again; where most,
# it counts as left out.
_MANY = 0.25
_MAJORITY = 0.5
_ROUNDS = 4


def leave_out_wrong_sensor(smoother: Smoother) -> bool:
    """Leave out the sensor that is wrong as a whole, if there is one; tell whether there is.

    Parameters
    ----------
    smoother
        With its outliers found and solved without them; its problem, solution, ``rejected`` and
        ``worth`` are changed. A process noise that is to be found is then to be found again.
    """
    lone = smoother.solution.status is not Status.CONVERGED or smoother.undecided
    if lone or not smoother.robust:
        return False
    own = own_measurements(smoother)
    if not 2 < len(own) <= MOST_SENSORS or not _compromise(smoother, own):
        return False
    worth, smoother.worth = smoother.worth, None
    kept = (~smoother.rejected).astype(np.float64)
    problem = smoother.problem.with_weights(smoother.weights(kept))
    solution = solve(problem, smoother.solution.values, max_iterations=ITERATIONS)
    now = _charged(smoother, own, solution.cost, smoother.rejected)
    trials = [one for sensor in own if (one := _without(smoother, own, sensor)) is not None]
    costs = [_charged(smoother, own, one.solution.cost, one.rejected) for one in trials]
    if not trials or min(costs) > now - RISE:
        smoother.worth = worth
        return False
    best = trials[int(np.argmin(costs))]
    smoother.adopt(best.problem, best.solution, best.rejected)
    return True


def _compromise(smoother: Smoother, own: dict[int, NDArray[np.bool_]]) -> bool:
    """Tell whether many of a sensor's measurements were rejected, or what is left disagrees."""
    rejected = smoother.rejected
    if any(rejected[mine].mean() > _MANY for mine in own.values()):
        return True
    rows = np.array([smoother.rows[~rejected].sum()])
    return bool(2.0 * smoother.solution.cost > chi_square.exceeded(FALSE_ALARM, rows)[0])


def _charged(
    smoother: Smoother,
    own: dict[int, NDArray[np.bool_]],
    cost: float,
    rejected: NDArray[np.bool_],
) -> float:
    """Return a cost with what was left out: at its limit, or as chance has it for whole sensors."""
    charge = 0.5 * plain_limits(rejected.size, smoother.rows)
    for mine in own.values():
        if rejected[mine].mean() > _MAJORITY:
            charge[mine] = 0.5 * smoother.rows[mine]
    return cost + float(charge[rejected].sum())


def _without(smoother: Smoother, own: dict[int, NDArray[np.bool_]], sensor: int) -> Trial | None:
    """Solve without a sensor; None if the others do not agree, or it does not disagree much."""
    mine = own[sensor]
    if mine.sum() < _LEAST or mine.all():
        return None
    problem = smoother.problem.with_weights(smoother.weights((~mine).astype(np.float64)))
    starts = [smoother.solution.values]
    starts += [read_attempt(attempt, problem) for attempt in smoother.attempts[:STARTS]]
    starts = [start for start in starts if np.isfinite(start.path).all()]
    solutions = [solve(problem, start, max_iterations=ITERATIONS) for start in starts]
    trial = _settled(smoother, mine, problem, min(solutions, key=lambda one: one.cost))
    if trial is None:
        return None
    rows = smoother.rows[~trial.rejected].sum()
    agree = 2.0 * trial.solution.cost <= chi_square.exceeded(FALSE_ALARM, np.array([rows]))[0]
    square = smoother.squares(trial.problem, trial.solution.values)[mine]
    wide = float(np.median(square / chi_square.median(smoother.rows[mine])))
    return replace(trial, sensors=(sensor,)) if agree and wide > WRONG else None


def _settled(
    smoother: Smoother, mine: NDArray[np.bool_], problem: Problem, solution: Solution
) -> Trial | None:
    """Leave out outliers of other sensors, too, until the choice stands."""
    limit, out = plain_limits(mine.size, smoother.rows), mine
    for _ in range(_ROUNDS):
        again = mine | (smoother.squares(problem, solution.values) > limit)
        if again.all() or np.array_equal(again, out):
            break
        out = again
        problem = problem.with_weights(smoother.weights((~out).astype(np.float64)))
        solution = solve(problem, solution.values, max_iterations=ITERATIONS)
    if solution.status is not Status.CONVERGED:
        return None
    return Trial((), out, problem, solution)
