"""A way to the minimum where sensors' errors are large against the noise of a measurement.

The cost of angles whose biases are 10 000 sigmas wide is a curved valley with steep sides: from a
guess that knows nothing of the biases a solver follows it for hundreds of steps, or ends in another
one. With all measurements weighed down until their noise is as wide as those errors the cost is
smooth, and its minimum a path that leaves the errors near their priors. The weights then grow by
decades, each minimum the guess for the next: the idea of graduated non-convexity (A. Blake, A.
Zisserman, *Visual Reconstruction*, 1987), with the noise as its scale.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.solver import solve
from geograph.states import ELEVATION, MISALIGNMENT

if TYPE_CHECKING:
    from geograph.families import Values
    from geograph.knots import Resolution
    from geograph.prepare import Prepared
    from geograph.problem import Problem

NARROW = 30.0
"""Errors below so many sigmas bend nothing."""

# The first noise is wider than the errors by this.
_WIDER = 10.0
_GROWTH = 10.0
_ITERATIONS = 50
_TOLERANCE = 1e-4


def width(prepared: Prepared, resolved: Resolution) -> float:
    """Return how many sigmas of a measured direction the widest constant error of angles is.

    Parameters
    ----------
    prepared
        The recording.
    resolved
        With the sigma of its angles.
    """
    sizes = [
        state.sigma * (prepared.span_s if state.drift else 1.0)
        for state in prepared.states.constants
        if state.channel <= ELEVATION or state.channel >= MISALIGNMENT
    ]
    return max(sizes, default=0.0) / resolved.sigma_rad


def softened(problem: Problem, values: Values, wide: float) -> tuple[Values, int] | None:
    """Return a guess that wide errors do not lead astray, and the iterations that it took.

    Parameters
    ----------
    problem
        To be solved, without weights.
    values
        First guess.
    wide
        From :func:`width`.

    Returns
    -------
    found
        None where errors are not wide.
    """
    if not wide > NARROW:
        return None
    weight, iterations = (_WIDER * wide) ** -2.0, 0
    while weight < 1.0:
        weights = [np.full(len(family), weight) for family in problem.families]
        soft = problem.with_weights(weights)
        solution = solve(soft, values, max_iterations=_ITERATIONS, tolerance=_TOLERANCE)
        if not np.isfinite(solution.values.path).all():
            return None
        values, iterations = solution.values, iterations + solution.iterations
        weight *= _GROWTH
    return values, iterations
