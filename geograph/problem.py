"""A smoothing problem: knots, motion, families of measurements, sensor states, and their scales.

The cost is, with whitened residuals r,

    sum of rho(|r|^2) / 2 over measurements + sum of |r|^2 / 2 over transitions and priors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from geograph.blocks import BlockSum, ColumnLayout, Sums
from geograph.common import settled
from geograph.eliminate import LinearSystem, Step
from geograph.losses import Loss
from geograph.motion import inverse_stack

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.eliminate import Factorisation
    from geograph.families import Evaluation, Family, Values
    from geograph.motion import Motion
    from geograph.recording import EliminationName
    from geograph.stages import Stages
    from geograph.states import SensorStates
    from geograph.time_shift import TimeShift


@dataclass(frozen=True, eq=False)
class PathPrior:
    """Weak prior of the first knot, so that every problem is determined.

    Attributes
    ----------
    mean
        Shape (3m,), SI.
    sigma
        Shape (3m,), SI; chosen so wide that data that determine the path do not feel it. Those of
        the forces' unknowns, which follow, are as given.
    """

    mean: NDArray[np.float64]
    sigma: NDArray[np.float64]

    def centred(self, state: NDArray[np.float64], size: int) -> PathPrior:
        """Return the prior about another state, whose first components, so many, are the path's.

        The forces' unknowns, which follow, keep theirs.
        """
        return replace(self, mean=np.concatenate([state[:size], self.mean[size:]]))

    def as_wide_as(self, sigma: NDArray[np.float64]) -> PathPrior:
        """Return the prior with the path's sigmas, shape (3m,), at least as wide as given ones."""
        size = sigma.size
        wide = np.maximum(self.sigma[:size], sigma)
        return replace(self, sigma=np.concatenate([wide, self.sigma[size:]]))


class Problem:
    """All that the solver needs to know.

    Parameters
    ----------
    motion
        Motion model with its noise.
    knots_s
        Shape (K,): times of the knots; one for a static object without walks.
    families
        Measurements.
    states
        Sensor-error states.
    walk_scale
        Shape (w,): scales of the chains, SI (:meth:`geograph.states.SensorStates.chain_scale`).
    prior
        Weak prior of the first knot.
    path_scale
        Shape (3m,): scales of the path's components, SI.
    loss
        Loss of each measurement.
    weights
        For each family, fixed weights of its measurements (graduated non-convexity), or None.
    elimination
        ``"structured"`` or ``"gtsam"``: who factorises the linear systems.
    shift
        A shift in time that is held at its optimum, or None.
    stages
        Multiples of the motion's noise over time, or None.
    """

    def __init__(
        self,
        *,
        motion: Motion,
        knots_s: NDArray[np.float64],
        families: Sequence[Family],
        states: SensorStates,
        walk_scale: NDArray[np.float64],
        prior: PathPrior,
        path_scale: NDArray[np.float64],
        loss: Loss | None = None,
        weights: Sequence[NDArray[np.float64] | None] | None = None,
        elimination: EliminationName = "structured",
        shift: TimeShift | None = None,
        stages: Stages | None = None,
    ) -> None:
        self.motion = motion
        self.knots_s = knots_s
        self.path = motion.path(knots_s)
        self.families = list(families)
        self.states = states
        self.walk_scale = walk_scale
        self.prior = prior
        self.path_scale = path_scale
        self.loss = loss or Loss("none")
        self.weights = list(weights) if weights is not None else [None] * len(self.families)
        self.elimination: EliminationName = elimination
        self.shift = shift
        self.stages = stages
        self.steps_s = np.diff(knots_s)
        self.noise_times = None if stages is None else stages.over(knots_s)
        self.layout = ColumnLayout(
            motion.size, walk_scale.size, states.size, chained=knots_s.size > 1
        )
        self.scale = np.concatenate([path_scale, np.ones(walk_scale.size)])
        self._chain_start = states.chain_start_sigma()
        self._chains = states.chain_transitions(knots_s, walk_scale)
        self._sums = [BlockSum(self.layout, path_scale) for _ in self.families]
        self._constant_transitions: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def with_weights(
        self, weights: Sequence[NDArray[np.float64] | None], loss: Loss | None = None
    ) -> Problem:
        """Return the problem with other weights (and loss), sharing all else."""
        return self.changed(weights=weights, loss=loss or self.loss)

    def with_motion(self, motion: Motion) -> Problem:
        """Return the problem with other process noise, sharing all else."""
        return self.changed(motion=motion)

    def with_stages(self, motion: Motion, stages: Stages | None) -> Problem:
        """Return the problem with other process noise and other stages, sharing all else."""
        return self.changed(motion=motion, stages=stages)

    def without_shift(self) -> Problem:
        """Return the problem with the clocks' common time left free, sharing all else."""
        return self if self.shift is None else self.changed(shift=None)

    def changed(self, **changes: object) -> Problem:
        """Return the problem with some of its arguments changed, sharing all else."""
        arguments: dict[str, object] = {
            "motion": self.motion,
            "knots_s": self.knots_s,
            "families": self.families,
            "states": self.states,
            "walk_scale": self.walk_scale,
            "prior": self.prior,
            "path_scale": self.path_scale,
            "loss": self.loss,
            "weights": self.weights,
            "elimination": self.elimination,
            "shift": self.shift,
            "stages": self.stages,
        }
        return Problem(**(arguments | changes))  # type: ignore[arg-type]

    @cached_property
    def _prior_information(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Scales of the path over the prior's sigmas, and information of the first knot, scaled."""
        ratio = self.path_scale / self.prior.sigma
        return ratio, np.concatenate([ratio**2, self._chain_start**-2.0])

    @property
    def measurement_rows(self) -> int:
        """Scalar measurements in all."""
        return sum(family.row_count for family in self.families)

    def start_prior(self, origin: Values) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return mean and sigma of the first knot's prior, each shape (d,), scaled, from an origin.

        Path components are deviations from the origin's first knot, walks are as they are.
        """
        mean = (self.prior.mean - origin.path[0]) / self.path_scale
        sigma = self.prior.sigma / self.path_scale
        return (
            np.concatenate([mean, np.zeros(self._chain_start.size)]),
            np.concatenate([sigma, self._chain_start]),
        )

    def evaluate(self, values: Values, *, jacobian: bool) -> list[Evaluation]:
        """Evaluate all families at one point, unknowns that measurements share at their best."""
        state = self.path.at_state(values.path, jacobian=jacobian)
        return [
            settled(family.evaluate(self.path, state, values, jacobian=jacobian), weight, self.loss)
            for family, weight in zip(self.families, self.weights, strict=True)
        ]

    def _measurement_cost(
        self, found: Evaluation, weight: NDArray[np.float64] | None
    ) -> tuple[float, NDArray[np.float64] | None]:
        """Return a family's cost and the weights of its measurements' information."""
        held = 0.0 if found.common is None else found.common.cost
        if weight is None and self.loss.name == "none":
            return held + 0.5 * float(np.vdot(found.residual, found.residual)), None
        square = np.einsum("ij,ij->i", found.residual, found.residual)
        if self.loss.name == "none":
            assert weight is not None
            return held + 0.5 * float(weight @ square), weight
        value, slope = self.loss.value_and_weight(square)
        if weight is not None:
            return held + 0.5 * float(weight @ value), weight * slope
        return held + 0.5 * float(value.sum()), slope

    def cost(self, values: Values) -> float:
        """Return the cost at one point; not finite where a prediction is not."""
        total = self.prior_cost(values)
        point = self.path, self.path.at_state(values.path, jacobian=False), values
        for family, weight in zip(self.families, self.weights, strict=True):
            share = None
            if self.loss.name == "none":
                share = family.add_to(None, *point, weight=weight, scale=self.path_scale)
            if share is None:
                found = settled(family.evaluate(*point, jacobian=False), weight, self.loss)
                share, _ = self._measurement_cost(found, weight)
            total += share
        return total

    def prior_cost(self, values: Values) -> float:
        """Return the share of transitions and priors in the cost."""
        return self._start_cost(values) + 0.5 * float(np.sum(self._noise_residual(values) ** 2))

    def _start_cost(self, values: Values) -> float:
        """Return the cost of the priors of the first knot and of the constant states."""
        start = (values.path[0] - self.prior.mean) / self.prior.sigma
        total = float(start @ start + values.constants @ values.constants)
        if self.knots_s.size > 1:
            total += float(np.sum((values.walks[0] / self._chain_start) ** 2))
        if self.shift is not None:
            total += self.shift.residual(values.constants) ** 2
        return 0.5 * total

    def chains(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the chains' transitions and noise roots, each shape (K - 1, w, w), scaled."""
        return self._chains

    def _noise_residual(
        self, values: Values, path_residual: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Return whitened residuals of all transitions of path and walks, shape (K - 1, d)."""
        if self.knots_s.size == 1:
            return np.zeros((0, self.layout.knot))
        if path_residual is None:
            path_residual = self.motion.residual(values.path, self.steps_s, self.knots_s[:-1])
        if self.noise_times is not None:
            path_residual = path_residual / self.noise_times[:, None]
        if not values.walks.shape[1]:
            return path_residual
        return np.concatenate([path_residual, chain_noise(values.walks, *self._chains)], axis=1)

    def linearise(self, values: Values) -> LinearSystem:
        """Return the linear system of scaled increments at one point."""
        blocks = Sums.zeros(self.layout, max(self.knots_s.size - 1, 1))
        inverse, noise_root, residual = self._transitions(values)
        cost = self._start_cost(values) + 0.5 * float(np.vdot(residual, residual))
        state = self.path.at_state(values.path, jacobian=True)
        point = self.path, state, values
        for family, weight, total in zip(self.families, self.weights, self._sums, strict=True):
            share = None
            if self.loss.name == "none":
                share = family.add_to(blocks, *point, weight=weight, scale=self.path_scale)
            if share is None:
                found = settled(family.evaluate(*point, jacobian=True), weight, self.loss)
                share, information_weight = self._measurement_cost(found, weight)
                root = None if information_weight is None else np.sqrt(information_weight)
                total.add(blocks, found, root)
            cost += share
        if self.shift is not None:
            self.shift.add(blocks.others[0], slice(0, self.layout.constants), values.constants)
        ratio, information = self._prior_information
        start = (values.path[0] - self.prior.mean) / self.prior.sigma
        gradient = np.concatenate([ratio * start, values.walks[0] / self._chain_start**2])
        return LinearSystem(
            blocks,
            inverse,
            noise_root,
            residual,
            information,
            gradient,
            values.constants,
            cost,
            by=self._factorisation(),
        )

    def with_transitions(self, system: LinearSystem, values: Values) -> LinearSystem:
        """Return a linear system with the process noise of this problem.

        Parameters
        ----------
        system
            Of a problem that differs in its process noise alone.
        values
            Where that was linearised.
        """
        inverse, root, residual = self._transitions(values)
        change = np.sum(residual**2) - np.sum(system.noise_residual**2)
        return replace(
            system,
            inverse_transition=inverse,
            noise_root=root,
            noise_residual=residual,
            cost=system.cost + 0.5 * float(change),
        )

    def _factorisation(self) -> type[Factorisation] | None:
        if self.elimination == "structured":
            return None
        # Imported here: the structured solver alone does without GTSAM.
        from geograph.gtsam_elimination import GtsamElimination

        return GtsamElimination

    def _transitions(
        self, values: Values
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return inverse transitions, noise roots and residuals of whole knots, scaled."""
        count, d, m = self.knots_s.size - 1, self.layout.knot, self.layout.path
        if not count:
            return np.zeros((0, d, d)), np.zeros((0, d, d)), np.zeros((0, d))
        if self._constant_transitions is not None:
            return *self._constant_transitions, self._noise_residual(values)
        found = self.motion.linear(values.path, self.steps_s, self.path_scale, self.knots_s[:-1])
        residual = self._noise_residual(values, found.residual)
        inverse = np.zeros((count, d, d))
        root = np.zeros((count, d, d))
        inverse[:, :m, :m] = found.inverse
        root[:, :m, :m] = found.noise_root
        if self.noise_times is not None:
            root[:, :m, :m] *= self.noise_times[:, None, None]
        matrix, noise = self._chains
        inverse[:, m:, m:] = inverse_stack(matrix)
        root[:, m:, m:] = noise
        if self.motion.constant:
            self._constant_transitions = inverse, root
        return inverse, root, residual

    def moved(self, values: Values, step: Step) -> Values:
        """Return the point a step away."""
        m = self.layout.path
        return type(values)(
            values.path + step.knots[:, :m] * self.path_scale,
            values.walks + step.knots[:, m:],
            values.constants + step.constants,
        )

    def refresh(self, values: Values) -> None:
        """Bring what families hold fixed during a solve up to date with an estimate."""
        for family in self.families:
            family.refresh(self.path, values)


def chain_noise(
    chains: NDArray[np.float64], matrix: NDArray[np.float64], root: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return whitened residuals of the transitions of walks and platforms, shape (K - 1, w).

    Parameters
    ----------
    chains
        Shape (K, w), scaled.
    matrix, root
        Transitions and noise roots, each shape (K - 1, w, w).
    """
    gap = chains[1:] - np.matmul(matrix, chains[:-1, :, None])[:, :, 0]
    quiet = np.einsum("kii->ki", root) == 0.0
    # A platform without noise keeps to its line; whatever the gap, it is rounding.
    solvable = root + np.where(quiet, 1.0, 0.0)[:, :, None] * np.eye(root.shape[1])
    return np.where(quiet, 0.0, np.linalg.solve(solvable, gap[:, :, None])[:, :, 0])
