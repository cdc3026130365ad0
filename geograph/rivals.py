"""Other paths that fit as well: the roots of an ambiguous geometry.

Range differences from few sensors, or from sensors in a line or a plane, often fit two places
exactly. Every first guess is solved; those that ended elsewhere are solved once more as the final
problem, and what comes close to the best cost is a rival that the measurements do not rule out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.families import Values
from geograph.geodesy import geodetic_from_ecef
from geograph.hypotheses import Hypothesis, off_terrain, weigh
from geograph.resets import carried
from geograph.solver import Solution, Status, solve

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.initialise import PathFit
    from geograph.knots import Resolution
    from geograph.problem import Problem
    from geograph.recording import Frame

# A path is another one where it is further away than this many of the estimate's sigmas, and as
# likely as the estimate's own surroundings at three sigmas.
_SEPARATE_SIGMAS = 6.0
_RISE = 4.5
_ITERATIONS = 100


@dataclass(frozen=True, eq=False)
class Attempt:
    """What one first guess led to.

    Attributes
    ----------
    fit
        The first guess.
    problem, solution, resolution
        The problem that it made, its solution, and what was resolved there.
    """

    fit: PathFit
    problem: Problem
    solution: Solution
    resolution: Resolution


@dataclass(frozen=True, eq=False)
class Rival:
    """Another path that fits.

    Attributes
    ----------
    rise
        Its cost less that of the estimate.
    time_s, position_m
        When it is furthest from the estimate, and where it is then, shape (3,).
    distance_m
        How far from the estimate that is.
    weight
        Its share of the posterior, among all that were found.
    """

    rise: float
    time_s: float
    position_m: NDArray[np.float64]
    distance_m: float
    weight: float

    def sentence(self, frame: Frame) -> str:
        """Return a sentence that names it."""
        if frame == "ecef":
            latitude, longitude, height = geodetic_from_ecef(self.position_m[None])[0]
            place = f"{latitude:.5f} deg, {longitude:.5f} deg, {height:.0f} m"
        else:
            place = "({:.6g}, {:.6g}, {:.6g}) m".format(*self.position_m)
        return (
            f"another path fits too (cost {self.rise:+.2g}, weight {self.weight:.2g}): at t = "
            f"{self.time_s:.6g} s it is at {place}, {self.distance_m:.4g} m from this one; one "
            "more sensor, a bearing or a known height would tell which"
        )


def find_rivals(
    problem: Problem, solution: Solution, starts: list[Values]
) -> tuple[Solution, list[Rival], list[Hypothesis]]:
    """Return the best solution from all starts, and the others that the data do not rule out.

    Last come all that were found, with their weights, the best first; those that end on ground
    whose height is not known are not among them.

    Parameters
    ----------
    problem, solution
        The final problem and its solution.
    starts
        Where else to start from.
    """
    found = [solution]
    for start in starts:
        if not np.isfinite(start.path).all() or not _separate(problem, solution, start):
            continue
        other = solve(problem, start, max_iterations=_ITERATIONS)
        known = (_separate(problem, entry, other.values) for entry in found)
        lost = off_terrain(problem, other.values).size
        if other.status is Status.CONVERGED and all(known) and not lost:
            found.append(other)
    best = min(found, key=lambda entry: entry.cost)
    if len(found) > 1 and best.cost < solution.cost - 1e-3:
        solution = best
    found = [solution, *(entry for entry in found if entry is not solution)]
    found = [entry for entry in found if entry.elimination is not None]
    gaps = [
        np.linalg.norm(entry.values.path[:, :3] - solution.values.path[:, :3], axis=1)
        for entry in found
    ]
    if len(found) < 2 or found[0] is not solution:
        return solution, [], []
    hypotheses = weigh(problem, found, int(np.argmax(np.max(gaps, axis=0))))
    rivals = []
    for other, gap, own in zip(found[1:], gaps[1:], hypotheses[1:], strict=True):
        rise = other.cost - solution.cost
        if rise <= _RISE:
            k = int(np.argmax(gap))
            place, away = other.values.path[k, :3], float(gap[k])
            rivals.append(Rival(rise, float(problem.knots_s[k]), place, away, own.weight))
    rivals.sort(key=lambda rival: -rival.weight)
    return solution, rivals, [hypotheses[0], *sorted(hypotheses[1:], key=lambda h: -h.weight)]


def read_attempt(attempt: Attempt, problem: Problem) -> Values:
    """Return an attempt's estimate at the knots of another problem.

    Parameters
    ----------
    attempt
        What a first guess led to.
    problem
        The other problem, of the same recording.
    """
    own, values = attempt.problem, attempt.solution.values
    path = own.motion.read(own.path, values.path, problem.knots_s)
    chains = np.zeros((problem.knots_s.size, values.walks.shape[1]))
    for column, chain in enumerate(values.walks.T):
        chains[:, column] = np.interp(problem.knots_s, own.knots_s, chain)
    # Resets may have been found since.
    return Values(path, chains, carried(own.states, problem.states, values.constants))


def _separate(problem: Problem, solution: Solution, values: Values) -> bool:
    """Tell whether a path is beyond the uncertainty of a solution at some knot."""
    if solution.elimination is None:
        return False
    scale = problem.path_scale[:3]
    covariance = solution.elimination.marginals().knots[:, :3, :3]
    gap = (values.path[:, :3] - solution.values.path[:, :3]) / scale
    square = np.einsum("ki,ki->k", gap, np.linalg.solve(covariance, gap[:, :, None])[:, :, 0])
    return bool((square > _SEPARATE_SIGMAS**2).any())
