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

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import lapack

if TYPE_CHECKING:
    from numpy.typing import NDArray


class NotPositiveDefiniteError(ArithmeticError):
    """The linear system does not determine all unknowns to working precision."""


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """A linearised problem in scaled increments.

    Unknowns are the increments of K knots (d each) and of s constant states.

    Attributes
    ----------
    blocks
        Shape (K - 1, 2d + s + 1, 2d + s + 1), or (1, d + s + 1, d + s + 1) for one knot: sums of
        products of the measurements' rows; the last column is the gradient.
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
    """

    blocks: NDArray[np.float64]
    inverse_transition: NDArray[np.float64]
    noise_root: NDArray[np.float64]
    noise_residual: NDArray[np.float64]
    prior_information: NDArray[np.float64]
    prior_gradient: NDArray[np.float64]
    constants: NDArray[np.float64]
    cost: float

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


@dataclass(frozen=True, eq=False)
class Marginals:
    """Marginal covariances of all unknowns, scaled.

    Attributes
    ----------
    knots
        Shape (K, d, d).
    neighbours
        Shape (K - 1, d, d): covariance of each knot with the following one.
    knot_constants
        Shape (K, d, s): covariance of each knot with the constant states.
    constants
        Shape (s, s).
    """

    knots: NDArray[np.float64]
    neighbours: NDArray[np.float64]
    knot_constants: NDArray[np.float64]
    constants: NDArray[np.float64]


class Elimination:
    """The factorised linear system.

    Parameters
    ----------
    system
        What is factorised.
    damping
        Added to the information of every scaled unknown (Levenberg-Marquardt).

    Raises
    ------
    NotPositiveDefiniteError
        If the unknowns are not determined to working precision.
    """

    def __init__(self, system: LinearSystem, damping: float = 0.0) -> None:
        self.system = system
        self.damping = damping
        d = system.knot_size
        count = system.knots - 1
        # Unknowns of one step: (w, x[k+1], constants), with x[k] = A x[k+1] - B w.
        self._a = system.inverse_transition
        self._b = system.inverse_transition @ system.noise_root
        size = d + system.constants.size
        information = np.zeros((size + 1, size + 1))
        diagonal = np.arange(size)
        information[diagonal, diagonal] = np.concatenate(
            [system.prior_information, np.ones(system.constants.size)]
        )
        information[:-1, -1] = np.concatenate([system.prior_gradient, system.constants])
        information[-1, :-1] = information[:-1, -1]
        self._roots = np.empty((count, d, d))
        self._rests = np.empty((count, d, size + 1))
        information = self._sweep(information) if count else information + system.blocks[0]
        information[diagonal[:d], diagonal[:d]] += damping
        information[diagonal[d:], diagonal[d:]] += damping
        self.final_information = information[:-1, :-1]
        root, fault = lapack.dpotrf(self.final_information, lower=1)
        if fault or not np.isfinite(root).all():
            raise NotPositiveDefiniteError
        self._final_root = np.tril(root)
        self._final_gradient = information[:-1, -1]

    def _sweep(self, information: NDArray[np.float64]) -> NDArray[np.float64]:
        """Eliminate the noise of every interval; return the last knot's information."""
        system = self.system
        d = system.knot_size
        width = 2 * d + system.constants.size + 1
        rest = slice(d, width)
        # Columns of [x[k] by (w, x[k+1])]; the measurements' share is turned for all k at once.
        turn = np.concatenate([-self._b, self._a], axis=2)
        blocks = system.blocks
        if self.damping:
            blocks = blocks.copy()
            index = np.arange(d)
            blocks[:, index, index] += self.damping
        first = np.swapaxes(turn, 1, 2) @ blocks[:, :d]
        total = np.zeros((blocks.shape[0], width, width))
        total[:, rest, rest] = blocks[:, rest, rest]
        total[:, : 2 * d, : 2 * d] += first[:, :, :d] @ turn
        cross = first[:, :, d:]
        total[:, : 2 * d, rest] += cross
        total[:, rest, : 2 * d] += np.swapaxes(cross, 1, 2)
        index = np.arange(d)
        total[:, index, index] += 1.0
        total[:, index, -1] += system.noise_residual
        total[:, -1, index] += system.noise_residual
        beyond = slice(2 * d, width)
        potrf, trtrs = lapack.dpotrf, lapack.dtrtrs
        for k in range(blocks.shape[0]):
            now = total[k]
            w = turn[k]
            moved = w.T @ information[:d]
            now[: 2 * d, : 2 * d] += moved[:, :d] @ w
            carried = moved[:, d:]
            now[: 2 * d, beyond] += carried
            now[beyond, : 2 * d] += carried.T
            now[beyond, beyond] += information[d:, d:]
            root, fault = potrf(now[:d, :d], lower=1, clean=1)
            if fault:
                raise NotPositiveDefiniteError
            solved, _ = trtrs(root, now[:d, d:], lower=1)
            self._roots[k] = root
            self._rests[k] = solved
            information = now[d:, d:] - solved.T @ solved
        return information

    def solve(self) -> Step:
        """Return the increments that minimise the (damped) linear model."""
        system = self.system
        d = system.knot_size
        count = system.knots - 1
        last, _ = lapack.dpotrs(self._final_root, -self._final_gradient, lower=1)
        knots = np.empty((count + 1, d))
        constants = last[d:]
        knots[count] = last[:d]
        noise = np.empty((count, d))
        # With the constants known, the rows' right-hand sides are the same for all intervals.
        fixed = self._rests[:, :, d:-1] @ constants + self._rests[:, :, -1]
        noise_fixed = _solve_transposed(self._roots, fixed)
        gain = _solve_transposed(self._roots, self._rests[:, :, :d])
        by_next = self._a + self._b @ gain
        offset = (self._b @ noise_fixed[:, :, None])[:, :, 0]
        following = knots[count]
        for k in range(count - 1, -1, -1):
            following = by_next[k] @ following + offset[k]
            knots[k] = following
        if count:
            noise = -(gain @ knots[1:, :, None])[:, :, 0] - noise_fixed
        return Step(knots, constants, self._decrease(knots, constants, noise))

    def _decrease(
        self,
        knots: NDArray[np.float64],
        constants: NDArray[np.float64],
        noise: NDArray[np.float64],
    ) -> float:
        """Return the decrease predicted by the model: half of -gradient.step, and the damping."""
        system = self.system
        slope = float(system.prior_gradient @ knots[0] + system.constants @ constants)
        gradient = system.blocks[:, :-1, -1]
        d = system.knot_size
        if system.knots > 1:
            slope += float(np.sum(gradient[:, :d] * knots[:-1]))
            slope += float(np.sum(gradient[:, d : 2 * d] * knots[1:]))
            slope += float(np.sum(gradient[:, 2 * d :] @ constants))
            slope += float(np.sum(system.noise_residual * noise))
        else:
            slope += float(gradient[0] @ np.concatenate([knots[0], constants]))
        squares = float(np.sum(knots**2) + np.sum(constants**2))
        return -0.5 * slope + 0.5 * self.damping * squares

    def marginals(self) -> Marginals:
        """Return all marginal covariances by one backward pass over the factorisation."""
        d = self.system.knot_size
        count = self.system.knots - 1
        size = self._final_root.shape[0]
        inverse, _ = lapack.dtrtrs(self._final_root, np.eye(size), lower=1)
        joint = inverse.T @ inverse
        constants = joint[d:, d:].copy()
        knots = np.empty((count + 1, d, d))
        cross = np.empty((count + 1, d, size - d))
        neighbours = np.empty((count, d, d))
        knots[count], cross[count] = joint[:d, :d], joint[:d, d:]
        # x[k] = gain (x[k+1], constants) + spread (unit noise).
        gain = self._b @ _solve_transposed(self._roots, self._rests[:, :, :-1])
        gain[:, :, :d] += self._a
        spread = self._b @ _solve_transposed(self._roots, np.eye(d)[None])
        scatter = spread @ np.swapaxes(spread, 1, 2)
        for k in range(count - 1, -1, -1):
            moved = gain[k] @ joint
            top = moved @ gain[k].T + scatter[k]
            neighbours[k] = moved[:, :d]
            knots[k] = 0.5 * (top + top.T)
            cross[k] = moved[:, d:]
            joint[:d, :d] = knots[k]
            joint[:d, d:] = cross[k]
            joint[d:, :d] = cross[k].T
        return Marginals(knots, neighbours, cross, constants)

    def half_log_determinant(self) -> float:
        """Return half the log determinant of the information of (x[0], w, constants)."""
        value = float(np.sum(np.log(np.diagonal(self._final_root))))
        value += float(np.sum(np.log(np.diagonal(self._roots, axis1=1, axis2=2))))
        # From the last knot's coordinates to the first one's.
        _, log_inverse = np.linalg.slogdet(self._a)
        return value - float(np.sum(log_inverse))


def _solve_transposed(root: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return R^-T right for stacks of lower factors R, shapes (n, d, d) and (n, d[, m])."""
    upper = np.swapaxes(root, 1, 2)
    if right.ndim == 2:
        return np.asarray(np.linalg.solve(upper, right[:, :, None])[:, :, 0])
    if right.shape[0] != root.shape[0]:
        right = np.broadcast_to(right, (root.shape[0], *right.shape[1:]))
    return np.asarray(np.linalg.solve(upper, right))
