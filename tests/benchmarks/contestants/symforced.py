"""symforce: its optimizer over one vectorised factor an interval."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from contestants.base import TOLERANCE, Contestant, Estimate, Run
from contestants.stacked import Stack, stacks

if TYPE_CHECKING:
    from collections.abc import Callable

    from model import Pass
    from numpy.typing import NDArray

    Linearised = tuple[NDArray[np.float64], ...]


def _linearisation(stack: Stack) -> Callable[..., Linearised]:
    knots = len(stack.knots)

    def linearise(*values: NDArray[np.float64]) -> Linearised:
        flat = [value.ravel() for value in values]
        residual, jacobian = stack.evaluate(flat[:knots], flat[knots:])
        # The optimizer reads the lower triangle, and negates the right-hand side itself.
        return residual, jacobian, np.tril(jacobian.T @ jacobian), jacobian.T @ residual

    return linearise


def _prior(value: NDArray[np.float64]) -> Linearised:
    flat = value.ravel()
    eye = np.eye(flat.size)
    return flat, eye, eye, flat


class _SymforceRun(Run):
    def __init__(self, data: Pass) -> None:
        import symforce

        if "symforce.symbolic" not in sys.modules:
            symforce.set_epsilon_to_number()
        from symforce.opt.numeric_factor import NumericFactor
        from symforce.opt.optimizer import Optimizer
        from symforce.values import Values

        self._data = data
        self._knots = [f"x{k}" for k in range(data.knots_s.size)]
        errors = data.error_sigma.size
        self._sensors = [f"s{s}" for s in range(data.sensor_m.shape[0])] if errors else []
        factors = []
        for stack in stacks(data):
            keys = [self._knots[k] for k in stack.knots]
            keys += [self._sensors[s] for s in stack.sensors] if errors else []
            factors.append(NumericFactor(keys, keys, _linearisation(stack)))
        factors += [NumericFactor([key], [key], _prior) for key in self._sensors]
        params = Optimizer.Params(
            verbose=False,
            iterations=100,
            initial_lambda=1e-4,
            early_exit_min_reduction=TOLERANCE,
        )
        self._optimizer = Optimizer(factors, params=params)
        self._values = Values()
        for key in self._knots:
            self._values[key] = np.zeros((data.scale.size, 1))
        for key in self._sensors:
            self._values[key] = np.zeros((errors, 1))

    def solve(self) -> Estimate:
        found = self._optimizer.optimize(self._values)
        self._values = found.optimized_values
        data = self._data
        deviation = np.stack([np.ravel(self._values[key]) for key in self._knots])
        errors = np.zeros((data.sensor_m.shape[0], data.error_sigma.size))
        if self._sensors:
            scaled = np.stack([np.ravel(self._values[key]) for key in self._sensors])
            errors[:] = scaled * data.error_sigma
        # The first entry is the first guess.
        return Estimate(data.guess + deviation * data.scale, errors, len(found.iterations) - 1)

    def marginals(self) -> NDArray[np.float64]:
        found = self._optimizer.compute_all_covariances(self._values)
        scaled = np.stack([found[key] for key in self._knots])
        return np.asarray(scaled * self._data.scale[:, None] * self._data.scale)


class Symforce(Contestant):
    """symforce from Python."""

    name = "symforce"
    about = "symforce's optimizer: a NumPy factor an interval, its own covariances"
    too_slow = frozenset({"large", "huge"})

    @classmethod
    def missing(cls) -> str | None:
        return None if find_spec("symforce") else "symforce"

    def set_up(self, data: Pass) -> Run:
        return _SymforceRun(data)
