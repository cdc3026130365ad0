"""Kinematic transitions: Gaussian-process priors driven by white noise.

A path of order m is a state of m blocks (position, velocity, acceleration) whose highest derivative
is driven by white noise of unit spectral density: on velocity (m = 1), acceleration (m = 2) or jerk
(m = 3). Everything here is the scalar (one axis) m-by-m form; a path in space is its Kronecker
product with a 3-by-3 matrix, because the three axes are driven alike up to a linear map.

Sources: T. D. Barfoot, *State Estimation for Robotics* (2nd ed., 2024), section 11.1 (exactly
sparse Gaussian-process priors); Y. Bar-Shalom, X. R. Li, T. Kirubarajan, *Estimation with
Applications to Tracking and Navigation* (2001), section 6.2 (transition and noise of integrated
white noise).
"""

from __future__ import annotations

from functools import cache
from math import factorial
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def transition(order: int, step_s: ArrayLike) -> NDArray[np.float64]:
    """Return the transition matrices of one axis, shape (..., m, m).

    The entry (i, j) is dt^(j - i) / (j - i)! on and above the diagonal.

    Parameters
    ----------
    order
        Number of blocks m, 1 to 3.
    step_s
        Time steps dt, any shape, seconds; negative steps go back in time.
    """
    step = np.asarray(step_s, dtype=np.float64)
    matrix = np.zeros((*step.shape, order, order))
    for i in range(order):
        for j in range(i, order):
            matrix[..., i, j] = step ** (j - i) / factorial(j - i)
    return matrix


def noise_covariance(order: int, step_s: ArrayLike) -> NDArray[np.float64]:
    """Return the covariance that unit white noise adds to one axis, shape (..., m, m).

    The entry (i, j), counted from zero, is dt^n / (n (m-1-i)! (m-1-j)!) with n = 2m - 1 - i - j.

    Parameters
    ----------
    order
        Number of blocks m, 1 to 3.
    step_s
        Time steps dt >= 0, any shape, seconds.
    """
    step = np.asarray(step_s, dtype=np.float64)
    matrix = np.empty((*step.shape, order, order))
    for i in range(order):
        for j in range(order):
            power = 2 * order - 1 - i - j
            scale = power * factorial(order - 1 - i) * factorial(order - 1 - j)
            matrix[..., i, j] = step**power / scale
    return matrix


@cache
def unit_noise_square_root(order: int) -> NDArray[np.float64]:
    """Return the lower Cholesky factor of a unit step's noise, shape (m, m), not to be changed.

    Parameters
    ----------
    order
        Number of blocks m, 1 to 3.
    """
    return np.asarray(np.linalg.cholesky(noise_covariance(order, 1.0)))


def noise_square_root(order: int, step_s: ArrayLike) -> NDArray[np.float64]:
    """Return the lower Cholesky factors of :func:`noise_covariance`, shape (..., m, m).

    The factor of a unit step is scaled, so that steps of any length are equally well conditioned.

    Parameters
    ----------
    order
        Number of blocks m, 1 to 3.
    step_s
        Time steps dt >= 0, any shape, seconds.
    """
    step = np.asarray(step_s, dtype=np.float64)
    unit = unit_noise_square_root(order)
    powers = order - 0.5 - np.arange(order)
    return np.asarray(step[..., None, None] ** powers[:, None] * unit)


def _hermite_coefficients(order: int) -> NDArray[np.float64]:
    """Return polynomial coefficients, shape (2m, 2m): row = data, column = power of s.

    The data are value and m - 1 derivatives at s = 0, then the same at s = 1.
    """
    size = 2 * order
    conditions = np.zeros((size, size))
    for derivative in range(order):
        conditions[derivative, derivative] = factorial(derivative)
        for power in range(derivative, size):
            conditions[order + derivative, power] = factorial(power) / factorial(power - derivative)
    # The exact coefficients are multiples of one half; rounding takes the inversion's error away.
    return np.asarray(np.round(2.0 * np.linalg.inv(conditions).T) / 2.0)


_HERMITE = {order: _hermite_coefficients(order) for order in (1, 2, 3)}


def hermite_coefficients(order: int) -> NDArray[np.float64]:
    """Return the coefficients of :func:`interpolation_weights`, shape (2m, 2m), not to be changed.

    Parameters
    ----------
    order
        Number of blocks m, 1 to 3.

    Returns
    -------
    coefficients
        Row = weight of a unit step, column = power of the share of the interval that has passed.
    """
    return _HERMITE[order]


def interpolation_weights(
    order: int, step_s: ArrayLike, offset_s: ArrayLike, *, derivative: int = 0
) -> NDArray[np.float64]:
    """Return the weights of both neighbours in the path between them, shape (n, 2m).

    The mean of the prior between two states, given both, is the Hermite polynomial of degree 2m - 1
    through them (Barfoot 2024, equation 11.15 with the matrices above). Beyond the interval the
    nearer state is extrapolated by its Taylor polynomial, which is the mean of the prior there.

    Parameters
    ----------
    order
        Number of blocks m, 1 to 3.
    step_s
        Shape (n,): length of the interval, seconds, > 0.
    offset_s
        Shape (n,): time since the interval's first state, seconds.
    derivative
        Which derivative of the position with respect to time is wanted.

    Returns
    -------
    weights
        Columns 0 to m - 1 multiply position, velocity, ... of the first state, columns m to 2m - 1
        those of the second.
    """
    step = np.asarray(step_s, dtype=np.float64)
    offset = np.asarray(offset_s, dtype=np.float64)
    s = offset / step
    coefficients = _HERMITE[order]
    size = 2 * order
    powers = np.zeros((*s.shape, size))
    for power in range(derivative, size):
        factor = factorial(power) / factorial(power - derivative)
        powers[..., power] = factor * s ** (power - derivative)
    weights = np.asarray(powers @ coefficients.T)
    units = step[..., None] ** np.tile(np.arange(order), 2) / step[..., None] ** derivative
    weights *= units
    for outside, since, first in ((s < 0.0, offset, 0), (s > 1.0, offset - step, order)):
        if outside.any():
            weights[outside] = 0.0
            for block in range(derivative, order):
                power = block - derivative
                weights[outside, first + block] = since[outside] ** power / factorial(power)
    return weights


def interpolation_matrices(
    order: int, step_s: ArrayLike, offset_s: ArrayLike
) -> NDArray[np.float64]:
    """Return the weights of both neighbours in the whole state between them, shape (n, m, 2m).

    Row i is :func:`interpolation_weights` of derivative i; see there for the arguments.
    """
    rows = [interpolation_weights(order, step_s, offset_s, derivative=row) for row in range(order)]
    return np.stack(rows, axis=-2)


def conditional_covariance(
    order: int, step_s: ArrayLike, offset_s: ArrayLike
) -> NDArray[np.float64]:
    """Return what the prior leaves uncertain between two known states, shape (n, m, m).

    Q(tau) - Psi Q(dt) Psi^T inside the interval (Barfoot 2024, section 11.1.4), Q of the time since
    the nearer state beyond it; for unit spectral density.

    Parameters
    ----------
    order
        Number of blocks m, 1 to 3.
    step_s
        Shape (n,): length of the interval, seconds, > 0.
    offset_s
        Shape (n,): time since the interval's first state, seconds.
    """
    step = np.asarray(step_s, dtype=np.float64)
    offset = np.asarray(offset_s, dtype=np.float64)
    inside = np.clip(offset, 0.0, step)
    psi = interpolation_matrices(order, step, inside)[..., order:]
    covariance = noise_covariance(order, inside) - psi @ noise_covariance(
        order, step
    ) @ np.swapaxes(psi, -1, -2)
    after = np.maximum(offset - step, 0.0)
    before = np.maximum(-offset, 0.0)
    covariance += noise_covariance(order, after)
    back = transition(order, -before)
    covariance += back @ noise_covariance(order, before) @ np.swapaxes(back, -1, -2)
    # Cancellation at the ends of the interval leaves rounding noise of either sign.
    diagonal = np.einsum("...ii->...i", covariance)
    np.maximum(diagonal, 0.0, out=diagonal)
    return np.asarray(covariance)


def spatial_square_root(
    velocity_m_s: NDArray[np.float64], across: float, along: float
) -> NDArray[np.float64]:
    """Return symmetric square roots of an along/across-velocity noise density, shape (n, 3, 3).

    S = across I + (along - across) u u^T with the unit velocity u; isotropic where the velocity
    vanishes. Its inverse has the same form with 1/across and 1/along.

    Parameters
    ----------
    velocity_m_s
        Shape (n, 3), any unit: only its direction counts.
    across, along
        Square roots of the spectral density.
    """
    unit = unit_vectors(velocity_m_s)
    outer = unit[..., :, None] * unit[..., None, :]
    return np.asarray(across * np.eye(3) + (along - across) * outer)


def spatial_square_root_derivative(
    velocity_m_s: NDArray[np.float64], across: float, along: float, vector: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return d(S v)/d(velocity) for S of :func:`spatial_square_root`, shape (n, k, 3, 3).

    Parameters
    ----------
    velocity_m_s
        Shape (n, 3).
    across, along
        Square roots of the spectral density (or their inverses, for the inverse of S).
    vector
        Shape (n, k, 3): the vectors v that S multiplies.
    """
    speed = np.linalg.norm(velocity_m_s, axis=-1)[..., None, None]
    unit = unit_vectors(velocity_m_s)
    moving = speed > 0.0
    turn = (np.eye(3) - unit[..., :, None] * unit[..., None, :]) / np.where(moving, speed, 1.0)
    turn = np.where(moving, turn, 0.0)
    dot = np.einsum("nc,nkc->nk", unit, vector)
    by_unit = dot[..., None, None] * np.eye(3) + unit[:, None, :, None] * vector[..., None, :]
    return np.asarray((along - across) * by_unit @ turn[:, None])


def unit_vectors(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vectors over their lengths, shape (..., 3); zero where the length is zero."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.asarray(np.divide(vector, length, out=np.zeros_like(vector), where=length > 0.0))
