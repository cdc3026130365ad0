"""Process noise of greatest marginal likelihood: one value, one along the velocity, stages.

The first guess of the noise may be decades off, so that one value is sought by solving for each
(:func:`tune_noise`). What comes after starts from its estimate, about which the measurements are
linearised: each evidence is then a single elimination (:mod:`geograph.evidence`), and the solve
that follows decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from geograph import chi_square
from geograph.evidence import Evidence, log_evidence
from geograph.motion import Density
from geograph.process_noise import least_noise
from geograph.serial_correlation import inflations
from geograph.solver import Status, solve
from geograph.stage_search import Partition, find_partition, threshold
from geograph.stages import Stages

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.motion import Motion
    from geograph.problem import Problem
    from geograph.smoother import Smoother
    from geograph.solver import Solution

FALSE_ALARM = 1e-3
"""Chance that noise alike in all directions is taken to follow the velocity."""

_ROUNDS = 4
# Ratios of the noise along the velocity to that across it that are looked at.
_RATIO = np.log(1e4)
_SETTLED = 0.1

# Negative evidence of a noise at which there is none. Searches take differences: it is finite.
_IMPOSSIBLE = 1e100


@dataclass(frozen=True, eq=False)
class _Kept:
    """Where the smoother was, to go back to."""

    problem: Problem
    solution: Solution
    ignored: float

    @classmethod
    def of(cls, smoother: Smoother) -> _Kept:
        return cls(smoother.problem, smoother.solution, smoother.ignored)

    def restore(self, smoother: Smoother) -> None:
        smoother.problem, smoother.solution = self.problem, self.solution
        smoother.ignored = self.ignored


def solved_evidence(solution: Solution) -> float:
    """Return the log marginal likelihood (Laplace) of a solve's noise, up to a constant."""
    if solution.elimination is None or not np.isfinite(solution.cost):
        return -np.inf
    return -solution.cost - solution.elimination.half_log_determinant()


def tune(smoother: Smoother) -> None:
    """Find the process noise as the settings ask: its value, its direction, its stages.

    Errors that a sensor has for a while look like motion. Where they show in what is left of its
    measurements, these count as the fewer that they are worth from then on
    (:mod:`geograph.serial_correlation`), in the evidence and in the estimate, and the noise is
    found again, until it stands.

    Parameters
    ----------
    smoother
        Solved with a noise that is about right; its problem, solution and ``worth`` are changed.
    """
    automatic = smoother.automatic
    if automatic:
        _tune_all_along(smoother)
    for _ in range(_ROUNDS if automatic else 0):
        before = smoother.problem.motion.density
        if not _weigh(smoother):
            break
        _tune_all_along(smoother)
        if _apart(before, smoother.problem.motion.density) < _SETTLED:
            break
    if smoother.settings.stages == "auto":
        tune_stages(smoother)


def _tune_all_along(smoother: Smoother) -> None:
    """Find the noise of the whole path."""
    tune_noise(smoother, 1.0)
    tune_direction(smoother)


def _apart(before: Density, after: Density) -> float:
    """Return by how much, as a logarithm, noise differs where it differs most."""
    logs = [
        np.log([*density.axes, density.along or density.axes[0]]) for density in (before, after)
    ]
    return float(np.abs(logs[0] - logs[1]).max())


def _weigh(smoother: Smoother) -> bool:
    """Let measurements count as what they are worth; tell whether any count as fewer."""
    problem, before = smoother.problem, smoother.worth
    found = problem.evaluate(smoother.solution.values, jacobian=False)
    shares = []
    # Families that sensors measured stand before all others. Kinds differ too much to be compared.
    parts = zip(smoother.families, found, smoother.split(smoother.rejected), strict=False)
    for family, part, rejected in parts:
        slope = problem.loss.value_and_weight(np.sum(part.residual**2, axis=1))[1]
        weight = np.where(rejected, 0.0, slope)
        _, group = np.unique(family.sensor, return_inverse=True)
        score = weight[:, None] * part.residual
        shares.append(1.0 / inflations(score, weight, family.time_s, group)[group])
    worth = np.concatenate(shares)
    smoother.worth = None if (worth == 1.0).all() else worth
    if before is None and smoother.worth is None:
        return False
    kept = (~smoother.rejected).astype(np.float64) if smoother.rejected.any() else None
    smoother.change(problem.with_weights(smoother.weights(kept)))
    return True


def tune_noise(smoother: Smoother, decades: float) -> None:
    """Set the process noise, alike in all directions, to the value of greatest evidence.

    Parameters
    ----------
    smoother
        Its problem and solution are changed.
    decades
        How far to search either way.
    """
    least = _least(smoother)
    good = _Kept.of(smoother)
    for _ in range(3):
        centre = smoother.problem.motion.density.axes[0]
        low = np.log(max(centre * 10.0**-decades, least))
        high = max(np.log(centre * 10.0**decades), low + 1.0)
        best = minimize_scalar(
            lambda log_noise: _negative_evidence(smoother, log_noise),
            bounds=(low, high),
            method="bounded",
            options={"xatol": 0.05, "maxiter": 30},
        )
        noise = float(np.exp(best.x))
        _adopt(smoother, _alike(smoother, noise), smoother.problem.stages)
        if smoother.solution.status is Status.CONVERGED:
            good = _Kept.of(smoother)
        elif smoother.solution.status is Status.DIVERGED:
            # The evidence was that of a rougher solve: back to the best noise that has a path.
            good.restore(smoother)
            break
        if 0.5 < noise / centre < 2.0:
            break
        decades = min(decades, 2.0)


def _negative_evidence(smoother: Smoother, log_noise: float) -> float:
    """Return the negative log marginal likelihood (Laplace), up to a constant."""
    problem = smoother.problem.with_motion(_alike(smoother, float(np.exp(log_noise))))
    solution = solve(problem, smoother.solution.values, max_iterations=20, tolerance=1e-4)
    smoother.iterations += solution.iterations
    found = solved_evidence(solution)
    if np.isfinite(found) and solution.status is Status.CONVERGED:
        smoother.solution = solution
    if np.isfinite(found):
        return -found
    # Nothing is determined at this noise, and more so farther away from one that stands.
    away = abs(log_noise - float(np.log(smoother.problem.motion.density.axes[0])))
    return _IMPOSSIBLE * (1.0 + away)


def _alike(smoother: Smoother, noise: float) -> Motion:
    return smoother.problem.motion.with_density(Density.of(noise))


def _least(smoother: Smoother) -> float:
    return least_noise(smoother.problem.motion.order, smoother.resolution)


def _adopt(smoother: Smoother, motion: Motion, stages: Stages | None) -> None:
    """Solve with other noise, and over the knots that it asks for."""
    smoother.change(smoother.problem.with_stages(motion, stages))
    smoother.respace()


def tune_direction(smoother: Smoother) -> None:
    """Let the noise along the velocity differ from that across it, if the evidence asks for it.

    Parameters
    ----------
    smoother
        Solved with noise alike in all directions; its problem and solution are changed.
    """
    if smoother.problem.motion.order == 1 or smoother.problem.knots_s.size < 2:
        return
    before = _Kept.of(smoother)
    limit = 0.5 * float(chi_square.exceeded(FALSE_ALARM, 1))
    for index in range(_ROUNDS):
        search = _Directional(smoother)
        if index == 0 and not search.promises(0.5 * limit):
            return
        moved = search.best()
        _adopt(smoother, search.motion(search.point), smoother.problem.stages)
        if moved < _SETTLED:
            break
    after = smoother.solution
    good = after.status is Status.CONVERGED
    if not good or solved_evidence(after) < solved_evidence(before.solution) + limit:
        before.restore(smoother)


class _Directional:
    """Evidence of noise across and along the velocity about the present estimate.

    Parameters
    ----------
    smoother
        Not changed.
    """

    def __init__(self, smoother: Smoother) -> None:
        self.problem, self.values = smoother.problem, smoother.solution.values
        self.system = self.problem.linearise(self.values)
        density = self.problem.motion.density
        across = density.axes[0]
        self.point = np.log([across, density.along or across])
        self.low = np.log(_least(smoother))

    def motion(self, point: NDArray[np.float64]) -> Motion:
        """Return the motion with noise exp(point): across and along."""
        across, along = np.exp(point).tolist()
        return self.problem.motion.with_density(Density.of(across, along))

    def __call__(self, point: NDArray[np.float64]) -> float:
        """Return the negative evidence."""
        if point.min() < self.low or abs(point[1] - point[0]) > _RATIO:
            return _IMPOSSIBLE
        changed = self.problem.with_motion(self.motion(point))
        found = log_evidence(changed.with_transitions(self.system, self.values))[0]
        return min(-found, _IMPOSSIBLE)

    def promises(self, gain: float) -> bool:
        """Tell whether another ratio at the same product of all three raises the evidence."""
        turn = np.array([-1.0, 2.0]) / 3.0
        present = self(self.point)
        if present >= _IMPOSSIBLE:
            return False
        found = minimize_scalar(
            lambda ratio: self(self.point + ratio * turn),
            bounds=(-0.7 * _RATIO, 0.7 * _RATIO),
            method="bounded",
            options={"xatol": 0.2, "maxiter": 25},
        )
        rise = present - float(found.fun)
        self.point = self.point + float(found.x) * turn if rise > gain else self.point
        return rise > gain

    def best(self) -> float:
        """Move to the point of greatest evidence, and return by how much that is off."""
        corner = np.array([[0.0, 0.0], [0.7, 0.0], [0.0, 0.7]])
        found = minimize(
            self,
            self.point,
            method="Nelder-Mead",
            options={
                "initial_simplex": self.point + corner,
                "xatol": 0.03,
                "fatol": 0.01,
                "maxfev": 80,
            },
        )
        present = self.problem.motion.density
        start = np.log([present.axes[0], present.along or present.axes[0]])
        self.point = np.asarray(found.x)
        return float(np.abs(self.point - start).max())


def tune_stages(smoother: Smoother) -> None:
    """Cut the path's time into stages of different noise, where the evidence asks for it.

    Parameters
    ----------
    smoother
        Solved with one noise; its problem and solution are changed.
    """
    if smoother.problem.knots_s.size < 3 or smoother.problem.motion.static:
        return
    before = _Kept.of(smoother)
    grains = 0
    for _ in range(_ROUNDS):
        problem = smoother.problem
        evidence = Evidence.about(problem, smoother.solution.values)
        grains = max(grains, evidence.grains)
        edges = problem.knots_s[np.append(evidence.first, problem.steps_s.size)]
        start = _partition(problem.stages, edges)
        found = find_partition(evidence, start)
        motion, stages = _staged(problem, edges, found)
        same = np.array_equal(found.edges, start.edges)
        settled = same and np.abs(found.logs).max(initial=0.0) < _SETTLED
        if settled:
            break
        _adopt(smoother, motion, stages)
    stages = smoother.problem.stages
    if stages is None:
        return
    after = smoother.solution
    limit = (stages.count - 1) * threshold(grains, 1)
    good = after.status is Status.CONVERGED
    if not good or solved_evidence(after) < solved_evidence(before.solution) + limit:
        before.restore(smoother)


def _partition(stages: Stages | None, edges_s: NDArray[np.float64]) -> Partition:
    """Return present stages as pieces of the grains between some times."""
    count = edges_s.size - 1
    inner = np.zeros(0, dtype=np.int64)
    if stages is not None:
        inner = np.unique(np.abs(edges_s[:, None] - stages.from_s).argmin(axis=0))
    cuts = np.concatenate([[0], inner[(inner > 0) & (inner < count)], [count]])
    return Partition(cuts.astype(np.int64), np.zeros(cuts.size - 1), -np.inf)


def _staged(
    problem: Problem, edges_s: NDArray[np.float64], found: Partition
) -> tuple[Motion, Stages | None]:
    """Return the motion and the stages of a partition whose multiples refer to a problem's."""
    middle = 0.5 * (edges_s[found.edges[:-1]] + edges_s[found.edges[1:]])
    times = np.exp(0.5 * found.logs)
    if problem.stages is not None:
        times = times * problem.stages.at(middle)
    if times.size == 1:
        return problem.motion.scaled(float(times[0])), None
    stages = Stages(edges_s[found.edges[1:-1]], times / times[0])
    return problem.motion.scaled(float(times[0])), stages
