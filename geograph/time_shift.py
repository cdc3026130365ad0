"""The time that all clocks have in common.

Where every sensor that measured stands still and has a clock of its own, path and clocks may be
shifted in time together without any measurement noticing: only the clocks' priors say when it was.
At the best estimate the shift is that of least prior cost, sum of c_i / p_i^2 = 0 over the clocks
c_i with prior sigmas p_i, and its posterior variance is exactly 1 / sum of 1 / p_i^2.

To a solver in the states of knots at fixed times the shift is a curved valley: slow to follow, and
seen as determined by a linearisation at any one point. So the shift is held at its known optimum
while solving, and its known variance is added to the covariances afterwards, along the derivative
of every unknown by the shift: minus the rate of change of the path, and one for every clock.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from geograph.states import CLOCK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.eliminate import Marginals
    from geograph.families import Values
    from geograph.measurements import Constraints
    from geograph.motion import Motion
    from geograph.problem import Problem
    from geograph.sensors import Sensor
    from geograph.states import SensorStates

# How much tighter the shift is held than the priors would: its own share of the variance is then
# one in 1e8, and the system stays well conditioned.
_TIGHTNESS = 1e4


@dataclass(frozen=True, eq=False)
class TimeShift:
    """A shift in time that only the clocks' priors determine.

    Attributes
    ----------
    row
        Shape (s,): gradient of (shift / sigma) by the scaled constant states; of unit length.
    by_shift
        Shape (s,): derivative of the scaled constant states by the shift, 1/s.
    sigma_s
        Posterior standard deviation of the shift, seconds.
    """

    row: NDArray[np.float64]
    by_shift: NDArray[np.float64]
    sigma_s: float

    def residual(self, constants: NDArray[np.float64]) -> float:
        """Return the whitened residual that holds the shift at its optimum."""
        return _TIGHTNESS * float(self.row @ constants)

    def add(
        self, block: NDArray[np.float64], columns: slice, constants: NDArray[np.float64]
    ) -> None:
        """Add the residual's products to an information block whose last column is the gradient.

        Parameters
        ----------
        block
            Changed in place.
        columns
            Those of the constant states.
        constants
            Shape (s,): where the residual is linearised.
        """
        row, residual = _TIGHTNESS * self.row, self.residual(constants)
        block[columns, columns] += np.outer(row, row)
        block[columns, -1] += row * residual
        block[-1, columns] += row * residual
        block[-1, -1] += residual**2

    def widened(self, marginals: Marginals, problem: Problem, values: Values) -> Marginals:
        """Return marginal covariances with the variance of the shift added.

        Parameters
        ----------
        marginals
            Of the problem with the shift held.
        problem, values
            For the path's rate of change at the knots.
        """
        by_knots = np.zeros((values.path.shape[0], problem.layout.knot))
        rate = rates(problem.motion, values.path, problem.knots_s)
        by_knots[:, : problem.layout.path] = -rate / problem.path_scale
        knots, constants = self.sigma_s * by_knots, self.sigma_s * self.by_shift
        return replace(
            marginals,
            knots=marginals.knots + knots[:, :, None] * knots[:, None, :],
            neighbours=marginals.neighbours + knots[:-1, :, None] * knots[1:, None, :],
            knot_constants=marginals.knot_constants + knots[:, :, None] * constants,
            constants=marginals.constants + np.outer(constants, constants),
        )


def rates(
    motion: Motion, path: NDArray[np.float64], knots_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the mean rate of change of the knots' states, shape (K, size), SI units."""
    step = 1e-3
    ahead, _ = motion.predict(path, np.full(path.shape[0], step), knots_s)
    behind, _ = motion.predict(path, np.full(path.shape[0], -step), knots_s)
    return np.asarray((ahead - behind) / (2.0 * step))


def time_shift(
    states: SensorStates,
    sensors: tuple[Sensor, ...],
    active: list[int],
    constraints: Constraints | None,
) -> TimeShift | None:
    """Return the shift that a recording leaves to its clocks' priors, or None if it leaves none.

    Parameters
    ----------
    states
        All sensor-error states.
    sensors
        In the order of their indices.
    active
        Indices of the sensors that measured.
    constraints
        Those at given times tie the path to time.
    """
    clocks = [int(states.bias_column[index, CLOCK]) for index in active]
    moving = any(sensors[index].trajectory is not None for index in active)
    timed = constraints is not None and bool(np.isfinite(constraints.time_s).any())
    if moving or timed or min(clocks, default=-1) < 0:
        return None
    # Those of every stretch: the shift moves a clock before and after it is set.
    offsets = [
        column
        for column, state in enumerate(states.constants)
        if state.channel == CLOCK and not state.drift
    ]
    by_shift = np.zeros(states.size)
    by_shift[offsets] = 1.0 / states.sigma[offsets]
    length = float(np.linalg.norm(by_shift))
    return TimeShift(by_shift / length, by_shift, 1.0 / length)


def centred(clock_s: NDArray[np.float64], prior_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return clock offsets shifted together to the least prior cost.

    Parameters
    ----------
    clock_s, prior_s
        Shape (n,): offsets and their prior sigmas, all above zero.
    """
    weight = prior_s**-2.0
    return np.asarray(clock_s - weight @ clock_s / weight.sum())
