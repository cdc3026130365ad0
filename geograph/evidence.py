"""Evidence of the process noise about one linearisation point, with its derivatives.

With the measurements linearised once, the marginal likelihood of any noise is one elimination. In
the unknowns (x[0], w, constants) the prior does not depend on the noise, so that with the cost C at
the minimum of the linear model and the information H of these unknowns

    ln p(z | q) = -C(q) - 1/2 ln det H(q) + const.

For the logarithm t[k] of the variance in interval k, with the posterior mean and covariance of the
whitened noise w[k] (size n) and P[k, l] the covariances of two intervals,

    d ln p / d t[k]        = (|mean w[k]|^2 + tr P[k, k] - n) / 2,
    Fisher information     = |I - P[k, l]|^2 / 2 (Frobenius norm; I only where k = l).

Sources: the first is Fisher's identity, the E-step of R. H. Shumway, D. S. Stoffer, *An approach to
time series smoothing and forecasting using the EM algorithm*, J. Time Series Analysis 3, 1982; the
second follows from I - P = A^T (R + A A^T)^-1 A for measurements z = A w + noise of covariance R
(D. A. Harville, *Maximum likelihood approaches to variance component estimation*, JASA 72, 1977).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from geograph.eliminate import Elimination, NotPositiveDefiniteError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.eliminate import LinearSystem
    from geograph.families import Values
    from geograph.problem import Problem


_GRAINS = 500
# Intervals beyond which the information that two share is not counted.
_REACH = 60


@dataclass(frozen=True, eq=False)
class Scores:
    """Derivatives of the evidence by the log variances of the grains.

    Attributes
    ----------
    evidence
        ln p, up to a constant.
    score
        Shape (G,): first derivatives.
    information
        Shape (G, G): Fisher information; None if it was not asked for.
    """

    evidence: float
    score: NDArray[np.float64]
    information: NDArray[np.float64] | None = None


class Evidence:
    """Marginal likelihood of multiples of the process noise, the measurements linearised.

    Parameters
    ----------
    system
        With the noise that the multiples refer to.
    size
        Components of the path's noise; those of walks and platforms follow it.
    most
        Grains at most: where there are more intervals, neighbours form one.
    """

    def __init__(self, system: LinearSystem, size: int, *, most: int = _GRAINS) -> None:
        self.system, self.size = replace(system, by=None), size
        count = system.knots - 1
        width = max(-(-count // most), 1)
        self.first: NDArray[np.int64] = np.arange(0, count, width, dtype=np.int64)

    @classmethod
    def about(cls, problem: Problem, values: Values) -> Evidence:
        """Return the evidence about a point, for multiples of a problem's noise."""
        return cls(problem.linearise(values), problem.layout.path)

    @property
    def grains(self) -> int:
        """How many pieces of the path can have noise of their own."""
        return int(self.first.size)

    def by_interval(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return multiples of the intervals, shape (K - 1,), from those of the grains."""
        return np.repeat(times, np.diff(self.first, append=self.system.knots - 1))

    def of(self, times: NDArray[np.float64]) -> float:
        """Return the evidence of the noise multiplied, shape (G,), in each grain."""
        return log_evidence(self._scaled(times))[0]

    def scores(self, times: NDArray[np.float64], *, information: bool = False) -> Scores:
        """Return the evidence and its derivatives.

        Parameters
        ----------
        times
            Shape (G,): multiples of the noise.
        information
            Whether the Fisher information is wanted too.
        """
        system = self._scaled(times)
        evidence, by = log_evidence(system, noise=True)
        count = self.grains
        if by is None:
            return Scores(evidence, np.zeros(count), np.eye(count) if information else None)
        noise = _Noise(by, self.size)
        score = np.add.reduceat(noise.score(), self.first)
        return Scores(evidence, score, noise.information(self.first) if information else None)

    def _scaled(self, times: NDArray[np.float64]) -> LinearSystem:
        """Return the system with the path's noise multiplied in each interval."""
        system, m, times = self.system, self.size, self.by_interval(times)
        root, residual = system.noise_root.copy(), system.noise_residual.copy()
        root[:, :, :m] *= times[:, None, None]
        residual[:, :m] /= times[:, None]
        cost = system.cost + 0.5 * float(
            np.sum(residual[:, :m] ** 2) - np.sum(system.noise_residual[:, :m] ** 2)
        )
        return replace(system, noise_root=root, noise_residual=residual, cost=cost)


def log_evidence(system: LinearSystem, *, noise: bool = False) -> tuple[float, Elimination | None]:
    """Return ln p of a linear system up to a constant, and its elimination.

    Minus infinity and None if the system does not determine all unknowns. ``noise`` as of
    :class:`geograph.eliminate.Elimination`.
    """
    try:
        by = Elimination(system, noise=noise)
    except NotPositiveDefiniteError:
        return -np.inf, None
    value = by.solve().decrease - system.cost - by.half_log_determinant()
    return (float(value), by) if np.isfinite(value) else (-np.inf, None)


class _Noise:
    """Posterior of the path's whitened noise.

    Parameters
    ----------
    by
        The elimination, which writes w[k] = -gain (x[k+1], constants, 1) + what is free.
    size
        Components m of the path's part.
    """

    def __init__(self, by: Elimination, size: int) -> None:
        self.by, self.size = by, size
        step, marginals = by.solve(), by.marginals()
        d = by.system.knot_size
        # Covariances with the knot that follows, and with the constants.
        own, linked = by.gain[:, :size, :d], by.gain[:, :size, d:-1]
        self.with_next = -own @ marginals.knots[1:] - linked @ np.swapaxes(
            marginals.knot_constants[1:], 1, 2
        )
        self.with_constants = -own @ marginals.knot_constants[1:] - linked @ marginals.constants
        free = np.swapaxes(by.inverse_roots, 1, 2)
        # Of the whole noise, that of walks and platforms included, with the path's part of it.
        self.covariance = (
            free @ np.swapaxes(free[:, :size], 1, 2)
            - by.gain[:, :, :d] @ np.swapaxes(self.with_next, 1, 2)
            - by.gain[:, :, d:-1] @ np.swapaxes(self.with_constants, 1, 2)
        )
        moved = np.matmul(by.gain[:, :size, :d], step.knots[1:, :, None])[:, :, 0]
        ahead = by.gain[:, :size, d:] @ np.append(step.constants, 1.0)
        self.mean = by.system.noise_residual[:, :size] - moved - ahead
        self.variance = np.einsum("kii->k", self.covariance[:, :size])

    def score(self) -> NDArray[np.float64]:
        """Return the derivatives of the evidence by the intervals' log variances, (K - 1,)."""
        return np.asarray(0.5 * (np.sum(self.mean**2, axis=1) + self.variance - self.size))

    def information(self, first_of: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the Fisher information of the log variances of grains, shape (G, G).

        Parameters
        ----------
        first_of
            Shape (G,): first interval of each grain.
        """
        by, m, system = self.by, self.size, self.by.system
        d, count = system.knot_size, system.knots - 1
        grain = np.searchsorted(first_of, np.arange(count), side="right") - 1
        found = np.zeros((first_of.size, first_of.size))
        rest = np.eye(m) - self.covariance[:, :m]
        np.add.at(found, (grain, grain), 0.5 * np.sum(rest**2, axis=(1, 2)))
        # Covariances of the knot before each interval with the interval's own noise.
        inverse = system.inverse_transition
        first = inverse @ (np.swapaxes(self.with_next, 1, 2) - system.noise_root @ self.covariance)
        constants = self.with_constants.reshape(count * m, -1).T
        later = np.zeros((d, count * m))
        later[:, (count - 1) * m :] = first[-1]
        for k in range(count - 2, -1, -1):
            end = min(count, k + 1 + _REACH)
            tail = slice((k + 1) * m, end * m)
            known = np.concatenate([later[:, tail], constants[:, tail]])
            cross = by.gain[k, :m, :-1] @ known
            square = np.sum(cross**2, axis=0).reshape(-1, m).sum(axis=1)
            np.add.at(found, (grain[k], grain[k + 1 : end]), 0.5 * square)
            np.add.at(found, (grain[k + 1 : end], grain[k]), 0.5 * square)
            later[:, tail] = by.back[k, :, :-1] @ known
            later[:, k * m : (k + 1) * m] = first[k]
        return found
