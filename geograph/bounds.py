"""The Cramer-Rao bound: how well any estimator could do.

The posterior bound of a problem at a point is the inverse of its information there, measurements
and priors together, with all nuisance states (H. L. Van Trees, *Detection, Estimation, and
Modulation Theory*, part I, 1968, section 2.4.3). Evaluated at the truth of many simulated passes
and averaged, it bounds the mean squared error of every estimator.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from geograph.families import Values
    from geograph.problem import Problem


@dataclass(frozen=True, eq=False)
class Bound:
    """Cramer-Rao bound of all unknowns.

    Attributes
    ----------
    time_s
        Shape (K,): times of the knots.
    covariance
        Shape (K, 3m, 3m): of the knots' states, SI units.
    constants
        Shape (s, s): of the constant sensor states, SI units, in the order of the problem's states.
    """

    time_s: NDArray[np.float64]
    covariance: NDArray[np.float64]
    constants: NDArray[np.float64]


def cramer_rao_bound(problem: Problem, values: Values) -> Bound:
    """Return the posterior Cramer-Rao bound of a problem at a point.

    Parameters
    ----------
    problem
        Measurements (their values do not matter to the bound of bearings near the point), sensors,
        motion, priors.
    values
        The point, for instance the simulated truth.

    Raises
    ------
    NotPositiveDefiniteError
        If the information is singular.
    """
    marginals = problem.linearise(values).factorise().marginals()
    size = problem.layout.path
    scale, sigma = problem.path_scale, problem.states.sigma
    return Bound(
        problem.knots_s,
        marginals.knots[:, :size, :size] * scale[:, None] * scale,
        marginals.constants * sigma[:, None] * sigma,
    )
