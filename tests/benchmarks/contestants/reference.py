"""The reference path: the same problem as a GTSAM graph of one Python factor an interval.

The loop is in Python, because factors called from GTSAM's own optimizers receive a copy of all
values at every call.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import gtsam
import numpy as np

from contestants.base import TOLERANCE, Contestant, Estimate, Run, Stages
from contestants.engine import estimate_of, problem_of
from contestants.timing import seconds
from geograph.graph import GtsamGraph, graph_of, knot_key

if TYPE_CHECKING:
    from model import Pass
    from numpy.typing import NDArray

_ITERATIONS = 100


class _ReferenceRun(Run):
    def __init__(self, built: GtsamGraph) -> None:
        self._built = built
        self._ordering = built.ordering()
        self._values = built.values
        self._by_qr = False
        self._linear: gtsam.GaussianFactorGraph

    def solve(self) -> Estimate:
        """Gauss-Newton to the decrease that the linear model predicts, as in the engine."""
        graph, values = self._built.graph, self._values
        for iteration in range(_ITERATIONS):
            self._linear = graph.linearize(values)
            step = self._step()
            before = self._linear.error(step.Zero(step))
            decrease = before - self._linear.error(step)
            values = values.retract(step)
            if decrease <= TOLERANCE * max(1.0, before):
                self._values = values
                decoded = self._built.decode(values)
                return estimate_of(self._built.problem, decoded, iteration + 1)
        raise RuntimeError(f"no minimum within {_ITERATIONS} iterations")

    def _step(self) -> gtsam.VectorValues:
        if not self._by_qr:
            try:
                return self._linear.optimize(self._ordering)
            except RuntimeError:
                # Cholesky, the fast one, calls long chains indeterminate that are not.
                self._by_qr = True
        return self._linear.optimize(self._ordering, gtsam.EliminateQR)

    def marginals(self) -> NDArray[np.float64]:
        tree = self._linear.eliminateMultifrontal(self._ordering, gtsam.EliminateQR)
        scale = self._built.problem.scale
        knots = range(self._built.origin.path.shape[0])
        scaled = np.stack([tree.marginalCovariance(knot_key(k)) for k in knots])
        return np.asarray(scaled * scale[:, None] * scale)

    def stages(self) -> Stages:
        return Stages(
            seconds(lambda: self._built.graph.linearize(self._values), repeats=3),
            seconds(self._step, repeats=3),
        )


class Reference(Contestant):
    """geograph's GTSAM graph."""

    name = "reference"
    about = "our factors stacked per interval in a GTSAM graph, Gauss-Newton loop in Python"

    def set_up(self, data: Pass) -> Run:
        problem, values = problem_of(data)
        return _ReferenceRun(graph_of(problem, values, stacking="interval"))
