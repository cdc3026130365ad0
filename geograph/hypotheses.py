"""Places that the measurements leave possible, with their weights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.families import TerrainFamily
from geograph.geodesy import geodetic_from_ecef

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.families import Values
    from geograph.problem import Problem
    from geograph.recording import Frame
    from geograph.solver import Solution


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One path that the measurements leave possible.

    Attributes
    ----------
    weight
        Its share of the posterior, 0 to 1.
    cost
        Its cost.
    time_s, position_m
        A time, and where the object is then, shape (3,).
    sigma_m
        The largest sigma of that position.
    """

    weight: float
    cost: float
    time_s: float
    position_m: NDArray[np.float64]
    sigma_m: float

    def facts(self, frame: Frame) -> dict[str, Any]:
        """Return it in the types of JSON."""
        told: dict[str, Any] = {
            "weight": self.weight,
            "cost": self.cost,
            "time_s": self.time_s,
            "position_m": self.position_m.tolist(),
            "sigma_m": self.sigma_m,
        }
        if frame == "ecef":
            latitude, longitude, height = geodetic_from_ecef(self.position_m)
            told |= {
                "latitude_deg": float(latitude),
                "longitude_deg": float(longitude),
                "height_m": float(height),
            }
        return told


def weigh(problem: Problem, solutions: Sequence[Solution], knot: int) -> list[Hypothesis]:
    """Return converged solutions of one problem as hypotheses, in the order given.

    Each minimum of the cost holds about exp(-cost) / sqrt(det(information)) of the posterior
    (Laplace's method; D. J. C. MacKay, *Information Theory, Inference, and Learning Algorithms*,
    2003, chapter 27).

    Parameters
    ----------
    problem
        What they solve.
    solutions
        With factorisations.
    knot
        Index of the knot at which they are told apart.
    """
    logs = []
    for solution in solutions:
        assert solution.elimination is not None
        logs.append(-solution.cost - solution.elimination.half_log_determinant())
    shares = np.exp(np.array(logs) - max(logs))
    shares /= shares.sum()
    scale = problem.path_scale[:3]
    found = []
    for share, solution in zip(shares, solutions, strict=True):
        assert solution.elimination is not None
        covariance = solution.elimination.marginals().knots[knot, :3, :3] * scale[:, None] * scale
        found.append(
            Hypothesis(
                float(share),
                solution.cost,
                float(problem.knots_s[knot]),
                solution.values.path[knot, :3],
                float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0))),
            )
        )
    return found


def off_terrain(problem: Problem, values: Values) -> NDArray[np.float64]:
    """Return the times at which a path is held to ground that is not known, shape (n,).

    Parameters
    ----------
    problem, values
        The path, and what it is held to.
    """
    found = [np.empty(0)]
    state = problem.path.at_state(values.path, jacobian=False)
    for family in problem.families:
        if isinstance(family, TerrainFamily) and family.surface is not None:
            position, _ = state.position_velocity(problem.path.locate(family.time_s))
            found.append(family.time_s[~family.surface.known(position)])
    return np.concatenate(found)
