"""SciPy with an analytic sparse Jacobian of all rows, in scaled unknowns.

The pattern is laid out once and only its values are filled in at an iteration; the rows themselves
are evaluated for all measurements at once (:mod:`equations`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
from equations import Rows, kinematics, tables
from scipy.optimize import least_squares
from scipy.sparse.linalg import splu

from contestants.base import TOLERANCE, Contestant, Estimate, Run, Stages
from contestants.timing import seconds

if TYPE_CHECKING:
    from model import Pass
    from numpy.typing import NDArray
    from scipy.sparse.linalg import SuperLU

_ITERATIONS = 100

# Columns of right-hand sides at once for marginals.
_COLUMNS = 450


class SparseProblem:
    """All rows and their Jacobian in scaled deviations from the first guess."""

    def __init__(self, data: Pass) -> None:
        self.data = data
        knots, width = data.guess.shape
        self.path_size = knots * width
        self.shape = (data.sensor_m.shape[0], data.error_sigma.size)
        self.size = self.path_size + self.shape[0] * self.shape[1]
        self._tables = tables(data)
        span = np.arange(width * min(knots, 2))
        self._scale = np.tile(data.scale, min(knots, 2))
        self._sigma = np.tile(data.error_sigma, self.shape[0])
        before, after = kinematics(data)
        both = np.concatenate([before * data.scale, after * data.scale], axis=2)
        columns = [
            np.concatenate([t.interval[:, None] * width + span, self.path_size + t.column], axis=1)
            for t in self._tables
        ]
        rows_each = [t.rows for t in self._tables]
        if knots > 1:
            columns.append(np.arange(knots - 1)[:, None] * width + span)
            rows_each.append(width)
        columns += [
            np.arange(width)[:, None],
            self.path_size + np.arange(self._sigma.size)[:, None],
        ]
        rows_each += [1, 1]
        constant = [both.ravel(), data.scale / data.prior_sigma, np.ones(self._sigma.size)]
        if np.isfinite(data.altitude_sigma_m):
            columns.append(np.arange(knots)[:, None] * width + 2)
            rows_each.append(1)
            constant.append(np.full(knots, data.scale[2] / data.altitude_sigma_m))
        spread = [np.repeat(c, r, axis=0) for c, r in zip(columns, rows_each, strict=True)]
        self._indices = np.concatenate([c.ravel() for c in spread])
        widths = np.concatenate([np.full(c.shape[0], c.shape[1]) for c in spread])
        self._pointers = np.concatenate([[0], np.cumsum(widths)])
        self._constant = np.concatenate(constant)
        linear = self._constant.size
        # The rows that are linear: their Jacobian, and their residuals at the first guess.
        first = int(np.searchsorted(self._pointers, self._pointers[-1] - linear))
        self._linear = sp.csr_array(
            (
                self._constant,
                self._indices[-linear:] if linear else self._indices[:0],
                self._pointers[first:] - self._pointers[first],
            ),
            shape=(widths.size - first, self.size),
        )
        drift = np.einsum("kij,kj->ki", before, data.guess[:-1])
        drift += np.einsum("kij,kj->ki", after, data.guess[1:])
        start = [drift.ravel(), np.zeros(width + self._sigma.size)]
        if np.isfinite(data.altitude_sigma_m):
            start.append(data.guess[:, 2] / data.altitude_sigma_m)
        self._start = np.concatenate(start)
        self._held: tuple[NDArray[np.float64], list[Rows]] | None = None

    def unpack(self, unknown: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """Return path and errors of scaled unknowns."""
        path = self.data.guess + unknown[: self.path_size].reshape(-1, self.data.scale.size) * (
            self.data.scale
        )
        return path, (unknown[self.path_size :] * self._sigma).reshape(self.shape)

    def _rows(self, unknown: NDArray[np.float64]) -> list[Rows]:
        # Residuals and Jacobian are asked for at the same place one after the other.
        if self._held is None or not np.array_equal(self._held[0], unknown):
            path, errors = self.unpack(unknown)
            self._held = unknown.copy(), [t.evaluate(path, errors) for t in self._tables]
        return self._held[1]

    def residuals(self, unknown: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return all rows."""
        rows = [row.residual.ravel() for row in self._rows(unknown)]
        return np.concatenate([*rows, self._start + self._linear @ unknown])

    def jacobian(self, unknown: NDArray[np.float64]) -> sp.csr_array:
        """Return the derivatives of all rows."""
        values = []
        for table, rows in zip(self._tables, self._rows(unknown), strict=True):
            by_errors = rows.by_errors * self._sigma[table.column][:, None]
            values.append(np.concatenate([rows.by_knots * self._scale, by_errors], axis=2).ravel())
        values.append(self._constant)
        shape = (self._pointers.size - 1, self.size)
        return sp.csr_array((np.concatenate(values), self._indices, self._pointers), shape=shape)

    def factorised(self, jacobian: sp.csr_array) -> SuperLU:
        """Return the factorisation of the normal equations, in the order of time."""
        normal = (jacobian.T @ jacobian).tocsc()
        options = {"SymmetricMode": True}
        return splu(normal, permc_spec="NATURAL", diag_pivot_thresh=0.0, options=options)

    def covariances(self, jacobian: sp.csr_array) -> NDArray[np.float64]:
        """Return the marginal covariances of all knots, SI units."""
        factor = self.factorised(jacobian)
        width = self.data.scale.size
        found = np.empty((self.path_size // width, width, width))
        step = _COLUMNS // width * width
        for first in range(0, self.path_size, step):
            last = min(first + step, self.path_size)
            right = np.zeros((self.size, last - first))
            right[np.arange(first, last), np.arange(last - first)] = 1.0
            part = factor.solve(right)[first:last]
            blocks = part.reshape(-1, width, part.shape[1] // width, width)
            knots = np.arange(blocks.shape[0])
            found[first // width : last // width] = blocks[knots, :, knots]
        return np.asarray(found * self.data.scale[:, None] * self.data.scale)


class _SparseRun(Run):
    def __init__(self, data: Pass) -> None:
        self._problem = SparseProblem(data)
        self._unknown = np.zeros(self._problem.size)

    def marginals(self) -> NDArray[np.float64]:
        return self._problem.covariances(self._problem.jacobian(self._unknown))


class _LeastSquaresRun(_SparseRun):
    def solve(self) -> Estimate:
        problem = self._problem
        # In unknowns counted from zero, not from the first guess: the trust region starts with
        # their length. The inner solver's defaults (1e-6, regularised) never come close.
        data = problem.data
        start = np.zeros(problem.size)
        start[: problem.path_size] = (data.guess / data.scale).ravel()
        found = least_squares(
            lambda unknown: problem.residuals(unknown - start),
            start,
            jac=lambda unknown: problem.jacobian(unknown - start),
            method="trf",
            tr_solver="lsmr",
            tr_options={"regularize": False, "atol": 1e-10, "btol": 1e-10, "maxiter": 5000},
            x_scale=1.0,
            ftol=TOLERANCE,
            xtol=1e-15,
            gtol=1e-15,
            max_nfev=_ITERATIONS,
        )
        self._unknown = found.x - start
        return Estimate(*problem.unpack(self._unknown), found.njev)


class _GaussNewtonRun(_SparseRun):
    def solve(self) -> Estimate:
        problem = self._problem
        for iteration in range(_ITERATIONS):
            residual, jacobian = problem.residuals(self._unknown), problem.jacobian(self._unknown)
            gradient = jacobian.T @ residual
            step = problem.factorised(jacobian).solve(-gradient)
            decrease = -0.5 * float(gradient @ step)
            self._unknown = self._unknown + step
            if decrease <= TOLERANCE * max(1.0, 0.5 * float(residual @ residual)):
                return Estimate(*problem.unpack(self._unknown), iteration + 1)
        raise RuntimeError(f"no minimum within {_ITERATIONS} iterations")

    def stages(self) -> Stages:
        problem, here = self._problem, self._unknown
        jacobian = problem.jacobian(here)

        def linearise() -> None:
            problem._held = None
            problem.jacobian(here)

        return Stages(
            seconds(linearise, repeats=3),
            seconds(lambda: problem.factorised(jacobian), repeats=3),
        )


class LeastSquares(Contestant):
    """SciPy's own optimizer."""

    name = "scipy-least-squares"
    about = (
        "scipy.optimize.least_squares (trf, lsmr), analytic sparse Jacobian; SuperLU's marginals"
    )
    too_slow = frozenset({"medium", "large", "huge", "mixed"})

    def set_up(self, data: Pass) -> Run:
        return _LeastSquaresRun(data)


class SparseGaussNewton(Contestant):
    """SciPy's sparse factorisation in a loop of one's own."""

    name = "scipy-gauss-newton"
    about = "Gauss-Newton by hand: the same Jacobian, normal equations by scipy.sparse's SuperLU"

    def set_up(self, data: Pass) -> Run:
        return _GaussNewtonRun(data)
