"""Ceres through pyceres: one cost function an interval, vectorised NumPy with its derivatives."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from contestants.base import TOLERANCE, Contestant, Estimate, Run
from contestants.stacked import Stack, stacks

if TYPE_CHECKING:
    from model import Pass
    from numpy.typing import NDArray


class _CeresRun(Run):
    def __init__(self, data: Pass) -> None:
        import pyceres

        class Interval(pyceres.CostFunction):  # type: ignore[misc]
            """The rows of one stack."""

            def __init__(self, stack: Stack) -> None:
                super().__init__()
                self._stack = stack
                sizes = [data.scale.size] * len(stack.knots)
                sizes += [data.error_sigma.size] * len(stack.sensors)
                self._ends = np.cumsum([0, *sizes])
                self.set_num_residuals(stack.rows)
                self.set_parameter_block_sizes(sizes)

            def Evaluate(self, parameters, residuals, jacobians) -> bool:  # type: ignore[no-untyped-def]  # noqa: N802
                knots = len(self._stack.knots)
                residual, jacobian = self._stack.evaluate(
                    parameters[:knots], parameters[knots:], derivatives=jacobians is not None
                )
                residuals[:] = residual
                if jacobians is not None:
                    for index, block in enumerate(jacobians):
                        if block is not None:
                            first, last = self._ends[index : index + 2]
                            block[:] = jacobian[:, first:last].ravel()
                return True

        self._data = data
        self._module = pyceres
        self._knots = [np.zeros(data.scale.size) for _ in data.knots_s]
        errors = data.error_sigma.size
        self._sensors = [np.zeros(errors) for _ in data.sensor_m] if errors else []
        self._problem = pyceres.Problem()
        for stack in stacks(data):
            blocks = [self._knots[k] for k in stack.knots]
            if errors:
                blocks += [self._sensors[s] for s in stack.sensors]
            self._problem.add_residual_block(Interval(stack), None, blocks)
        for sensor in self._sensors:
            prior = pyceres.factors.NormalPrior(np.zeros(errors), np.eye(errors))
            self._problem.add_residual_block(prior, None, [sensor])

    def solve(self) -> Estimate:
        options = self._module.SolverOptions()
        options.linear_solver_type = self._module.LinearSolverType.SPARSE_NORMAL_CHOLESKY
        options.function_tolerance = TOLERANCE
        options.parameter_tolerance = options.gradient_tolerance = 1e-15
        options.max_num_iterations = 100
        options.initial_trust_region_radius = 1e16
        options.num_threads = 1
        options.logging_type = self._module.LoggingType.SILENT
        summary = self._module.SolverSummary()
        self._module.solve(options, self._problem, summary)
        data = self._data
        path = data.guess + np.stack(self._knots) * data.scale
        errors = np.zeros((data.sensor_m.shape[0], data.error_sigma.size))
        if self._sensors:
            errors[:] = np.stack(self._sensors) * data.error_sigma
        iterations = summary.num_successful_steps + summary.num_unsuccessful_steps
        return Estimate(path, errors, iterations)

    def marginals(self) -> NDArray[np.float64]:
        options = self._module.CovarianceOptions()
        options.algorithm_type = self._module.CovarianceAlgorithmType.SPARSE_QR
        options.num_threads = 1
        covariance = self._module.Covariance(options)
        if not covariance.compute([(knot, knot) for knot in self._knots], self._problem):
            raise RuntimeError("Ceres gave no covariances")
        scaled = np.stack([covariance.get_covariance_block(knot, knot) for knot in self._knots])
        return np.asarray(scaled * self._data.scale[:, None] * self._data.scale)


class Ceres(Contestant):
    """Ceres from Python."""

    name = "pyceres"
    about = "Ceres: a NumPy cost function an interval, sparse Cholesky; covariances by sparse QR"

    @classmethod
    def missing(cls) -> str | None:
        return None if find_spec("pyceres") else "pyceres"

    def set_up(self, data: Pass) -> Run:
        return _CeresRun(data)
