"""Levenberg-Marquardt over a problem's structured linear systems.

Plain Gauss-Newton steps as long as they lower the cost; damping, in scaled unknowns, is switched
on when one does not, and grows and fades with the agreement of cost and linear model (J. Nocedal,
S. J. Wright, *Numerical Optimization*, 2nd ed., 2006, section 10.3; H. B. Nielsen, *Damping
parameter in Marquardt's method*, IMM-REP-1999-05).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from geograph.eliminate import NotPositiveDefiniteError

if TYPE_CHECKING:
    from geograph.eliminate import Factorisation, LinearSystem, Step
    from geograph.families import Values
    from geograph.problem import Problem

# Predicted decrease at which the estimate is final, in units of the cost. The estimate is then
# within sqrt(2e-9) posterior sigmas of the minimum, and the step predicted is still taken.
TOLERANCE = 1e-9

# A minimum that rounding hides is within this many tolerances (5 % of a posterior sigma).
_ROUNDING = 1e6

# A plain step that promises no more than so many tolerances, and does not keep it, was rounding:
# with a small process noise the position's last digits are worth that much.
_LOST_IN_ROUNDING = 100.0

_FIRST_DAMPING = 1e-4
_LARGEST_DAMPING = 1e14


class Status(StrEnum):
    """How a solve ended."""

    CONVERGED = "converged"
    """The estimate is the minimum, and the data determine it."""

    ITERATION_LIMIT = "iteration_limit"
    """The limit of iterations came first; the estimate is the best point so far."""

    DIVERGED = "diverged"
    """No step lowers the cost, or the cost is not finite."""

    UNOBSERVABLE = "unobservable"
    """The data do not determine the path; the summary says what is missing."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the solver ended.

    Attributes
    ----------
    values
        The estimate.
    status
        How it ended.
    cost
        Cost at the estimate.
    iterations
        Linear systems solved with a step accepted.
    elimination
        Undamped factorisation at the last linearisation point; None if there is none.
    """

    values: Values
    status: Status
    cost: float
    iterations: int
    elimination: Factorisation | None


def solve(
    problem: Problem, values: Values, *, max_iterations: int = 100, tolerance: float = TOLERANCE
) -> Solution:
    """Minimise a problem's cost from a first guess.

    Parameters
    ----------
    problem
        What is solved.
    values
        First guess.
    max_iterations
        Limit of accepted steps.
    tolerance
        Predicted decrease of the cost, relative to the cost where that exceeds one, at which the
        solve ends.

    Returns
    -------
    solution
        With status converged, iteration_limit or diverged.
    """
    damping, growth = 0.0, 2.0
    system = problem.linearise(values)
    if not np.isfinite(system.cost):
        return Solution(values, Status.DIVERGED, system.cost, 0, None)
    for iteration in range(max_iterations):
        elimination, step, damping = _damped_step(system, damping)
        if step is None or elimination is None:
            return Solution(values, Status.DIVERGED, system.cost, iteration, None)
        small = step.decrease <= tolerance * max(1.0, system.cost)
        candidate = problem.moved(values, step)
        if small and damping == 0.0:
            # The last step is within the quadratic model's accuracy: it is taken unseen unless
            # rounding makes it worse.
            cost = problem.cost(candidate)
            if not cost <= system.cost + 1e-9 * max(1.0, system.cost):
                candidate, cost = values, system.cost
            return Solution(candidate, Status.CONVERGED, cost, iteration + 1, elimination)
        before, whole = system.cost, damping == 0.0
        if whole:
            # A system is larger than all else that is held: the old one goes before the next one is
            # made, and is made again where its step was no good.
            del system, elimination
            system = problem.linearise(candidate)
            cost = system.cost
        else:
            cost = problem.cost(candidate)
        gain = (before - cost) / max(step.decrease, 1e-300) if np.isfinite(cost) else -1.0
        if gain > 1e-3:
            values = candidate
            if not whole:
                system = problem.linearise(values)
            damping = _relaxed(damping, gain)
            growth = 2.0
            continue
        if whole:
            system = problem.linearise(values)
        lost = whole and step.decrease <= _LOST_IN_ROUNDING * tolerance * max(1.0, system.cost)
        if small or lost:
            return _stuck(values, system, iteration + 1, tolerance=tolerance)
        damping = damping * growth if damping > 0.0 else _FIRST_DAMPING
        growth *= 2.0
        if damping > _LARGEST_DAMPING:
            return _stuck(values, system, iteration, tolerance=tolerance)
    return Solution(values, Status.ITERATION_LIMIT, system.cost, max_iterations, _undamped(system))


def _stuck(values: Values, system: LinearSystem, iterations: int, *, tolerance: float) -> Solution:
    """End a solve that was damped down to nothing, and still found no descent.

    At a minimum it is rounding that decides there. Anywhere else the cost has a kink, or does not
    follow its derivatives, and the step with the least damping would still gain something.
    """
    elimination, step, damping = _damped_step(system, 0.0)
    left = np.inf if step is None else step.decrease
    converged = left <= _ROUNDING * tolerance * max(1.0, system.cost)
    return Solution(
        values,
        Status.CONVERGED if converged else Status.DIVERGED,
        system.cost,
        iterations,
        elimination if damping == 0.0 else None,
    )


def _relaxed(damping: float, gain: float) -> float:
    """Return the damping after an accepted step."""
    if damping == 0.0:
        return 0.0
    relaxed = damping * max(1.0 / 3.0, 1.0 - (2.0 * min(gain, 1.5) - 1.0) ** 3)
    return 0.0 if relaxed < 1e-7 else relaxed


def _damped_step(
    system: LinearSystem, damping: float
) -> tuple[Factorisation | None, Step | None, float]:
    """Factorise with as little damping as makes the system positive definite."""
    while damping <= _LARGEST_DAMPING:
        try:
            elimination = system.factorise(damping)
        except NotPositiveDefiniteError:
            damping = _FIRST_DAMPING if damping == 0.0 else damping * 10.0
            continue
        step = elimination.solve()
        if np.isfinite(step.decrease) and np.isfinite(step.knots).all():
            return elimination, step, damping
        damping = _FIRST_DAMPING if damping == 0.0 else damping * 10.0
    return None, None, damping


def _undamped(system: LinearSystem) -> Factorisation | None:
    try:
        return system.factorise()
    except NotPositiveDefiniteError:
        return None
