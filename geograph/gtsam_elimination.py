"""The same linear system, eliminated by GTSAM.

The information blocks of the measurements go to GTSAM as Hessian factors, the transitions and
priors as they are; GTSAM eliminates in the order of time with the constants last. It is the
reference for :class:`geograph.eliminate.Elimination` and can be chosen in its place
(``geograph.smooth(recording, elimination="gtsam")``); docs/design.md has what each is good for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gtsam
import numpy as np

from geograph.eliminate import Factorisation, LinearSystem, NotPositiveDefiniteError
from geograph.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray


class GtsamElimination(Factorisation):
    """The linear system, factorised by ``GaussianFactorGraph.eliminateSequential``.

    Parameters
    ----------
    system
        What is factorised.
    damping
        Added to the information of every scaled unknown (Levenberg-Marquardt).

    Raises
    ------
    NotPositiveDefiniteError
        If GTSAM finds the system indeterminate.
    InputError
        If parts of the state have no noise, which GTSAM could not whiten.
    """

    def __init__(self, system: LinearSystem, damping: float = 0.0) -> None:
        self.system = system
        self.damping = damping
        graph = gtsam.GaussianFactorGraph()
        self._add_measurements(graph)
        self._add_priors(graph)
        if system.knots > 1:
            self._add_transitions(graph)
        ordering = gtsam.Ordering()
        for key in self._keys():
            ordering.push_back(key)
        try:
            conditionals = graph.eliminateSequential(ordering)
        except RuntimeError as error:
            # IndeterminantLinearSystemException arrives as a RuntimeError.
            raise NotPositiveDefiniteError from error
        self._read(conditionals)

    def _keys(self) -> list[int]:
        keys = [gtsam.symbol("x", k) for k in range(self.system.knots)]
        if self.system.constants.size:
            keys.append(gtsam.symbol("c", 0))
        return keys

    def _add_measurements(self, graph: gtsam.GaussianFactorGraph) -> None:
        """Add one Hessian factor for the measurements of every interval."""
        system = self.system
        d, s = system.knot_size, system.constants.size
        sizes = [d, d, s] if system.knots > 1 else [d, s]
        edges = np.concatenate([[0], np.cumsum(sizes)])
        for k, block in enumerate(system.blocks.full()):
            keys = [gtsam.symbol("x", k + j) for j in range(len(sizes) - 1)]
            keys.append(gtsam.symbol("c", 0))
            used = [j for j in range(len(sizes)) if sizes[j]]
            part = [slice(edges[j], edges[j + 1]) for j in range(len(sizes))]
            arguments: list[Any] = [keys[j] for j in used]
            for i in used:
                arguments += [block[part[i], part[j]] for j in used if j >= i]
                arguments.append(-block[part[i], -1])
            arguments.append(float(block[-1, -1]))
            graph.push_back(gtsam.HessianFactor(*arguments))

    def _add_priors(self, graph: gtsam.GaussianFactorGraph) -> None:
        """Add the first knot's prior, that of the constants, and the damping."""
        system = self.system
        d, s = system.knot_size, system.constants.size
        for k in range(system.knots):
            information = np.full(d, self.damping)
            gradient = np.zeros(d)
            if k == 0:
                information, gradient = (
                    information + system.prior_information,
                    (system.prior_gradient),
                )
            if information.any():
                key = gtsam.symbol("x", k)
                graph.push_back(gtsam.HessianFactor(key, np.diag(information), -gradient, 0.0))
        if s:
            information = np.full(s, 1.0 + self.damping)
            graph.push_back(
                gtsam.HessianFactor(
                    gtsam.symbol("c", 0), np.diag(information), -system.constants, 0.0
                )
            )

    def _add_transitions(self, graph: gtsam.GaussianFactorGraph) -> None:
        system = self.system
        if not np.einsum("kii->ki", system.noise_root).all():
            raise InputError(
                "parts of the state have no process noise, which GTSAM cannot whiten; expected "
                "elimination 'structured' for a static object with random walks"
            )
        unit = gtsam.noiseModel.Unit.Create(system.knot_size)
        whiten = np.linalg.inv(system.noise_root)
        forward = np.linalg.inv(system.inverse_transition)
        self._whiten, self._forward = whiten, forward
        for k in range(system.knots - 1):
            graph.push_back(
                gtsam.JacobianFactor(
                    gtsam.symbol("x", k),
                    -whiten[k] @ forward[k],
                    gtsam.symbol("x", k + 1),
                    whiten[k],
                    -system.noise_residual[k],
                    unit,
                )
            )

    def _read(self, conditionals: gtsam.GaussianBayesNet) -> None:
        """Take the conditionals of all knots, and the factor of the last one with the constants."""
        system = self.system
        d, s, count = system.knot_size, system.constants.size, system.knots - 1
        self._back = np.empty((count, d, d + s + 1))
        self._spread = np.empty((count, d, d))
        self._roots = np.empty((count, d, d))
        for k in range(count):
            conditional = conditionals.at(k)
            root = conditional.R()
            inverse = np.linalg.inv(root)
            self._roots[k], self._spread[k] = root, inverse
            self._back[k, :, :-1] = -inverse @ _by_parents(conditional, k, d, s)
            self._back[k, :, -1] = inverse @ conditional.d()
        last = conditionals.at(count)
        upper = np.zeros((d + s, d + s))
        right = np.zeros(d + s)
        upper[:d, :d], right[:d] = last.R(), last.d()
        if s:
            final = conditionals.at(count + 1)
            upper[:d, d:], upper[d:, d:] = last.S(), final.R()
            right[d:] = final.d()
        if not (np.isfinite(upper).all() and np.diagonal(upper).all()):
            raise NotPositiveDefiniteError
        self._final_root = np.ascontiguousarray(upper.T)
        self._final_gradient = -upper.T @ right

    @property
    def turned_back(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """``back`` and ``spread``."""
        return self._back, self._spread

    def _decrease(self, knots: NDArray[np.float64], constants: NDArray[np.float64]) -> float:
        """Return half of -gradient.step, and the damping."""
        system = self.system
        slope = float(system.prior_gradient @ knots[0] + system.constants @ constants)
        by_knots, d = system.blocks.knots[:, :, -1], system.knot_size
        slope += float(np.sum(system.blocks.others[:, :-1, -1] @ constants))
        if system.knots > 1:
            slope += float(np.sum(by_knots[:, :d] * knots[:-1] + by_knots[:, d:] * knots[1:]))
            predicted = np.matmul(self._forward, knots[:-1, :, None])
            noise = np.matmul(self._whiten, knots[1:, :, None] - predicted)[:, :, 0]
            slope += float(np.sum(system.noise_residual * noise))
        else:
            slope += float(by_knots[0] @ knots[0])
        squares = float(np.sum(knots**2) + np.sum(constants**2))
        return -0.5 * slope + 0.5 * self.damping * squares

    def half_log_determinant(self) -> float:
        """Return half the log determinant of the information of (x[0], w, constants)."""
        value = float(np.sum(np.log(np.abs(np.diagonal(self._final_root)))))
        if self.system.knots > 1:
            roots = np.diagonal(self._roots, axis1=1, axis2=2)
            value += float(np.sum(np.log(np.abs(roots))))
            # From the knots' coordinates to those of the noise.
            value -= float(np.sum(np.linalg.slogdet(self._whiten)[1]))
        return value


def _by_parents(
    conditional: gtsam.GaussianConditional, knot: int, size: int, constants: int
) -> NDArray[np.float64]:
    """Return a conditional's matrix over (x[k+1], constants), in this order."""
    following = gtsam.symbol("x", knot + 1)
    matrix = np.zeros((size, size + constants))
    column = 0
    joined = conditional.S()
    for key in list(conditional.keys())[1:]:
        width = size if key == following else constants
        start = 0 if key == following else size
        matrix[:, start : start + width] = joined[:, column : column + width]
        column += width
    return matrix
