"""Structured elimination: the linear system of a chain of knots with sensor states at its end.

In every interval the later knot is written through the noise, x[k+1] = F x[k] + L w[k], and the
elimination takes out w[k] instead of x[k]. The block that is factorised is then I + (what the
measurements add), never smaller than the identity, however small the noise: the elimination of x[k]
itself subtracts two informations of the size of the inverse noise covariance, and loses as many
digits as the posterior is wider than the noise (docs/design.md has the measurement). The same form
allows parts of the state that have no noise at all.

Source: the two-filter and information forms in G. J. Bierman, *Factorization Methods for Discrete
Sequential Estimation* (1977), chapter VI and X (process noise states eliminated in place of the
state).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import lapack

from geograph.sweep import (
    Ends,
    Marginals,
    NotPositiveDefiniteError,
    chain_marginals,
    substitute,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.blocks import Sums

__all__ = [
    "Elimination",
    "Factorisation",
    "LinearSystem",
    "Marginals",
    "NotPositiveDefiniteError",
    "Step",
    "response",
]


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """A linearised problem in scaled increments.

    Unknowns are the increments of K knots (d each) and of s constant states.

    Attributes
    ----------
    blocks
        Sums of products of the measurements' rows in K - 1 intervals, of 2d components each, or in
        one of d for one knot; the last column is the gradient.
    inverse_transition
        Shape (K - 1, d, d): F^-1.
    noise_root
        Shape (K - 1, d, d): L; columns of zeros where nothing drives the state.
    noise_residual
        Shape (K - 1, d): w at the linearisation point.
    prior_information, prior_gradient
        Shape (d,): diagonal prior of the first knot.
    constants
        Shape (s,): constant states at the linearisation point (their prior is standard normal).
    cost
        Cost at the linearisation point.
    by
        What factorises it; None: :class:`Elimination`.
    """

    blocks: Sums
    inverse_transition: NDArray[np.float64]
    noise_root: NDArray[np.float64]
    noise_residual: NDArray[np.float64]
    prior_information: NDArray[np.float64]
    prior_gradient: NDArray[np.float64]
    constants: NDArray[np.float64]
    cost: float
    by: type[Factorisation] | None = None

    def factorise(self, damping: float = 0.0) -> Factorisation:
        """Factorise the system.

        Parameters
        ----------
        damping
            Added to the information of every scaled unknown (Levenberg-Marquardt).

        Raises
        ------
        NotPositiveDefiniteError
            If the unknowns are not determined to working precision.
        """
        return (self.by or Elimination)(self, damping)

    @property
    def knot_size(self) -> int:
        """Components d of one knot."""
        return int(self.prior_information.size)

    @property
    def knots(self) -> int:
        """Number of knots K."""
        return int(self.noise_residual.shape[0]) + 1


@dataclass(frozen=True, eq=False)
class Step:
    """A solution of the linear system.

    Attributes
    ----------
    knots
        Shape (K, d): increments of the knots, scaled.
    constants
        Shape (s,): increments of the constant states, scaled.
    decrease
        Decrease of the cost that the linear model predicts.
    """

    knots: NDArray[np.float64]
    constants: NDArray[np.float64]
    decrease: float


class Factorisation(ABC):
    """What a factorisation of the chain gives: steps, covariances, determinant.

    Whoever factorises fills in, for x[k] written through what follows it and unit noise v,

        x[k] = back (x[k+1], constants, 1) + spread v,

    and the factor of the information of the last knot and the constants.
    """

    system: LinearSystem
    damping: float
    _final_root: NDArray[np.float64]
    _final_gradient: NDArray[np.float64]

    @abstractmethod
    def __init__(self, system: LinearSystem, damping: float = 0.0) -> None: ...

    @abstractmethod
    def _decrease(self, knots: NDArray[np.float64], constants: NDArray[np.float64]) -> float:
        """Return the decrease of the cost that the linear model predicts for the solution."""

    @property
    @abstractmethod
    def turned_back(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """``back``, shape (K - 1, d, d + s + 1), and ``spread``, shape (K - 1, d, d)."""

    @property
    def back(self) -> NDArray[np.float64]:
        """Shape (K - 1, d, d + s + 1): x[k] = back (x[k+1], constants, 1) + what is free."""
        return self.turned_back[0]

    def solve(self) -> Step:
        """Return the increments that minimise the (damped) linear model."""
        d = self.system.knot_size
        last, _ = lapack.dpotrs(self._final_root, -self._final_gradient, lower=1)
        constants = last[d:]
        knots = last[None, :d]
        if self.system.knots > 1:
            knots = self._substituted(last[:d], constants)
        return Step(knots, constants, self._decrease(knots, constants))

    def _substituted(
        self, last: NDArray[np.float64], constants: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the increments of all knots from those of the last."""
        return substitute(self.back, last, constants)

    def marginals(self) -> Marginals:
        """Return all marginal covariances; see :func:`chain_marginals`."""
        return chain_marginals(*self.turned_back, self._final_root)

    @abstractmethod
    def half_log_determinant(self) -> float:
        """Return half the log determinant of the information of (x[0], w, constants)."""


class Elimination(Factorisation):
    """The factorised linear system.

    Parameters
    ----------
    system
        What is factorised.
    damping
        Added to the information of every scaled unknown (Levenberg-Marquardt).
    noise
        Whether what the posterior says of the noise itself is kept.

    Attributes
    ----------
    inverse_roots, gain
        As of :class:`geograph.sweep.Sweep`, of systems with more than one knot, where the noise was
        asked for.

    Raises
    ------
    NotPositiveDefiniteError
        If the unknowns are not determined to working precision.
    """

    inverse_roots: NDArray[np.float64]
    gain: NDArray[np.float64]

    def __init__(self, system: LinearSystem, damping: float = 0.0, *, noise: bool = False) -> None:
        self.system = system
        self.damping = damping
        d = system.knot_size
        constants = system.constants
        self._a = system.inverse_transition
        # Rows of the current knot, and of the constants and the gradient, over (knot, constants,
        # gradient).
        size = d + constants.size
        knot = np.zeros((d, size + 1))
        knot.reshape(-1)[:: size + 2] = system.prior_information
        knot[:, -1] = system.prior_gradient
        other = np.zeros((constants.size + 1, constants.size + 1))
        other.reshape(-1)[:: constants.size + 2] = 1.0
        other[:-1, -1] = other[-1, :-1] = constants
        self._half_log = self._square = 0.0
        self._ends: Ends | None = None
        if system.knots > 1:
            ends = self._ends = Ends(
                knot,
                blocks=system.blocks,
                inverse_transition=self._a,
                noise_root=system.noise_root,
                noise_residual=system.noise_residual,
                damping=damping,
                noise=noise,
            )
            knot, other = ends.knot, other + ends.share
            self._half_log, self._square = ends.half_log, ends.square
            if noise:
                self.inverse_roots, self.gain = ends.inverse_roots, ends.gain
        else:
            knot = knot + system.blocks.knots[0]
            others = system.blocks.others
            other += others[0] if len(others) == 1 else others.sum(axis=0)
        information = np.empty((size, size))
        information[:d], information[d:, :d] = knot[:, :-1], knot[:, d:-1].T
        information[d:, d:] = other[:-1, :-1]
        if damping:
            information.reshape(-1)[:: size + 1] += damping
        root, fault = lapack.dpotrf(information, lower=1, clean=1)
        if fault or not np.isfinite(root).all():
            raise NotPositiveDefiniteError
        self._final_root = root
        self._final_gradient = np.concatenate([knot[:, -1], other[:-1, -1]])

    @property
    def turned_back(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """``back`` and ``spread``."""
        if self._ends is None:
            d = self.system.knot_size
            return np.empty((0, d, self._final_root.shape[0] + 1)), np.empty((0, d, d))
        return self._ends.turned_back

    def _substituted(
        self, last: NDArray[np.float64], constants: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        assert self._ends is not None
        return self._ends.substitute(last, constants)

    def _decrease(self, knots: NDArray[np.float64], constants: NDArray[np.float64]) -> float:
        # With the damped information H, -gradient.step = gradient' H^-1 gradient is the sum of the
        # squares that the factorisation has made of the gradient.
        rest, _ = lapack.dtrtrs(self._final_root, self._final_gradient, lower=1)
        squares = float(np.sum(knots**2) + np.sum(constants**2)) if self.damping else 0.0
        return 0.5 * (self._square + float(rest @ rest) + self.damping * squares)

    def half_log_determinant(self) -> float:
        """Return half the log determinant of the information of (x[0], w, constants)."""
        value = self._half_log + float(np.sum(np.log(np.diagonal(self._final_root))))
        # From the last knot's coordinates to the first one's.
        _, log_inverse = np.linalg.slogdet(self._a)
        return value - float(np.sum(log_inverse))


def response(system: LinearSystem, knot: int, direction: NDArray[np.float64]) -> Step:
    """Return the covariance of all unknowns with one function of one knot.

    Parameters
    ----------
    system
        The linear system.
    knot
        Index of the knot.
    direction
        Shape (d,): the function's gradient by the knot's scaled unknowns.

    Raises
    ------
    NotPositiveDefiniteError
        If the unknowns are not determined to working precision.
    """
    d = system.knot_size
    sums, others = system.blocks.knots.copy(), system.blocks.others.copy()
    sums[:, :, -1] = others[:, :, -1] = others[:, -1] = 0.0
    block = min(knot, sums.shape[0] - 1)
    sums[block, (knot - block) * d : (knot - block + 1) * d, -1] = -direction
    quiet = replace(
        system,
        blocks=replace(system.blocks, knots=sums, others=others),
        noise_residual=np.zeros_like(system.noise_residual),
        prior_gradient=np.zeros_like(system.prior_gradient),
        constants=np.zeros_like(system.constants),
    )
    return quiet.factorise().solve()
