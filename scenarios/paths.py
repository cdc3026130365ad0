"""Bodies that move: fixed ones, straight ones, and random paths of integrated white noise.

Nothing here is shared with the estimator. A random path is drawn exactly at the nodes of a fine
grid and joined between them by the Hermite polynomial through the states, whose distance from the
random path is known (:func:`interpolation_sigma_m`) and is kept far below what a sensor can see.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial
from typing import TYPE_CHECKING, Protocol

import numpy as np
from scipy.interpolate import PPoly
from scipy.linalg import expm

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

Noise = float | tuple[float, float, float]
"""Square root of a spectral density, SI: one for all axes, or one for each."""

_MOST_NODES = 400_000


class Body(Protocol):
    """Anything that is somewhere at every time, in the axes of its recording."""

    def position_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return positions, shape (..., 3), metres, at times in seconds (any shape)."""
        ...

    def velocity_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return velocities, shape (..., 3), metres per second, at times in seconds."""
        ...


@dataclass(frozen=True, eq=False)
class StraightBody:
    """A body that stands, or moves in a straight line at constant speed.

    Parameters
    ----------
    position_m
        Shape (3,), metres: where it is at time zero.
    velocity_m_s
        Shape (3,), metres per second; None: it stands.
    """

    position_m: NDArray[np.float64]
    velocity_m_s: NDArray[np.float64] | None = None

    def position_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return positions, shape (..., 3), metres, at times in seconds (any shape)."""
        time = np.asarray(time_s, dtype=np.float64)
        return self.position_m + time[..., None] * self.velocity_at(time)

    def velocity_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return velocities, shape (..., 3), metres per second, at times in seconds."""
        velocity = np.zeros(3) if self.velocity_m_s is None else self.velocity_m_s
        return np.broadcast_to(velocity, (*np.shape(time_s), 3))


class SampledBody:
    """A body known by its states at many times, joined by Hermite polynomials.

    Between two nodes stands the polynomial of degree 2 n - 1 that agrees with position and the
    first n - 1 derivatives at both, which is the conditional mean of an n-fold integrated white
    noise.

    Parameters
    ----------
    time_s
        Shape (m,), strictly increasing, m >= 2, seconds.
    state
        Shape (m, n, 3): position, velocity, ... in metres and seconds, n from 1 to 3.
    """

    def __init__(self, time_s: NDArray[np.float64], state: NDArray[np.float64]) -> None:
        order = state.shape[1]
        step = np.diff(time_s)
        powers = step[:, None] ** np.arange(order)
        # Derivatives with respect to s = (t - t_k) / step at both ends of every interval.
        start = state[:-1] * powers[..., None]
        end = state[1:] * powers[..., None]
        low = start / np.array([factorial(k) for k in range(order)])[:, None]
        derivative = np.array(
            [
                [factorial(k) / factorial(k - j) if k >= j else 0.0 for k in range(2 * order)]
                for j in range(order)
            ]
        )
        rest = end - np.einsum("jk,mkd->mjd", derivative[:, :order], low)
        high = np.einsum("jk,mkd->mjd", np.linalg.inv(derivative[:, order:]), rest)
        coefficients = np.concatenate([low, high], axis=1)
        coefficients /= (step[:, None] ** np.arange(2 * order))[..., None]
        descending = np.moveaxis(coefficients[:, ::-1], 0, 1)
        self._position = PPoly(np.ascontiguousarray(descending), time_s, extrapolate=False)
        self._velocity = self._position.derivative()

    def position_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return positions, shape (..., 3), metres; ValueError outside of the nodes."""
        return self._inside(self._position(np.asarray(time_s, dtype=np.float64)), time_s)

    def velocity_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return velocities, shape (..., 3), metres per second; ValueError outside of the nodes."""
        return self._inside(self._velocity(np.asarray(time_s, dtype=np.float64)), time_s)

    def _inside(self, value: ArrayLike, time_s: ArrayLike) -> NDArray[np.float64]:
        array = np.asarray(value, dtype=np.float64)
        if not np.isfinite(array).all():
            raise ValueError(
                f"a body is known from {self._position.x[0]} to {self._position.x[-1]} s; "
                f"asked from {np.min(time_s)} to {np.max(time_s)} s"
            )
        return array


def interpolation_sigma_m(*, order: int, noise: float, step_s: float) -> float:
    """Return the standard deviation of a random path about its interpolation, half-way, metres.

    An n-fold integrated white noise with both end states known deviates from the Hermite
    polynomial through them by a variance of q^2 (h / 4)^(2 n - 1) / ((2 n - 1) ((n - 1)!)^2) in the
    middle of the interval h, where it is greatest.

    Parameters
    ----------
    order
        n: how many times white noise is integrated to make a position.
    noise
        q, square root of its spectral density, SI.
    step_s
        h, seconds.
    """
    power = 2 * order - 1
    return float(noise * np.sqrt((step_s / 4.0) ** power / power) / factorial(order - 1))


def fine_grid(
    span_s: tuple[float, float],
    *,
    order: int,
    noise: float,
    tolerance_m: float = 1e-3,
    longest_step_s: float = 0.5,
) -> NDArray[np.float64]:
    """Return times between which a random path deviates from its interpolation by a tolerance.

    Parameters
    ----------
    span_s
        First and last time, seconds.
    order, noise
        As in :func:`interpolation_sigma_m`.
    tolerance_m
        The greatest standard deviation between nodes, metres.
    longest_step_s
        Limit of the step, seconds.

    Raises
    ------
    ValueError
        If that takes too many nodes to hold.
    """
    power = 2 * order - 1
    scale = (tolerance_m * factorial(order - 1) / noise) ** 2 * power
    step = min(longest_step_s, 4.0 * scale ** (1.0 / power))
    nodes = int(np.ceil((span_s[1] - span_s[0]) / step)) + 1
    if nodes > _MOST_NODES:
        raise ValueError(
            f"a path of order {order} with noise {noise} takes {nodes} nodes for {tolerance_m} m; "
            f"expected at most {_MOST_NODES}: allow a larger tolerance_m"
        )
    return np.linspace(span_s[0], span_s[1], max(nodes, 2))


def unit_transition(order: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the transition of a chain of integrators over one second, and its noise's factor.

    By Van Loan's method (IEEE Trans. Automatic Control 23(3), 1978): the exponential of one matrix
    made of the chain and of the unit white noise that drives its last link holds both the
    transition matrix and the covariance, of which the lower Cholesky factor is returned.

    Parameters
    ----------
    order
        Number of integrators, at least 1.

    Returns
    -------
    transition, factor
        Each of shape (order, order).
    """
    chain = np.diag(np.ones(order - 1), 1)
    driven = np.zeros((order, order))
    driven[-1, -1] = 1.0
    exponential = expm(np.block([[-chain, driven], [np.zeros_like(chain), chain.T]]))
    transition = exponential[order:, order:].T
    covariance = transition @ exponential[:order, order:]
    return transition, np.linalg.cholesky((covariance + covariance.T) / 2.0)


def noise_shape(
    noise: Noise, along: float | None, velocity_m_s: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    """Return the symmetric square root, shape (3, 3), of a spectral density.

    Parameters
    ----------
    noise
        In all directions, per axis, or, where ``along`` is given, across the velocity.
    along
        Along the velocity; None: no direction is special.
    velocity_m_s
        Shape (3,); needed where ``along`` is given. A body at rest has the noise across.
    """
    shape = np.diag(np.broadcast_to(np.asarray(noise, dtype=np.float64), (3,)))
    if along is None or velocity_m_s is None:
        return shape
    speed = float(np.linalg.norm(velocity_m_s))
    if speed == 0.0:
        return shape
    direction = velocity_m_s / speed
    across = float(np.asarray(noise))
    result: NDArray[np.float64] = shape + (along - across) * np.outer(direction, direction)
    return result


def sample_path(
    rng: np.random.Generator,
    time_s: NDArray[np.float64],
    initial: NDArray[np.float64],
    *,
    noise: Noise,
    along: float | None = None,
) -> NDArray[np.float64]:
    """Draw the states of an integrated white noise at given times.

    Without ``along`` the draw is exact at any times: the states of a chain of integrators over a
    step h, each times its power of h, behave as those over one second do, with the noise times
    h^(n - 1/2). With ``along`` the direction is frozen over each step (Euler-Maruyama), so the
    steps have to be short against the time in which the path turns.

    Parameters
    ----------
    rng
        Source of randomness.
    time_s
        Shape (m,), increasing, seconds; the path starts at the first.
    initial
        Shape (n, 3): position, velocity, ... at the first time; the noise drives the last row.
    noise
        Square root of the spectral density, SI; across the velocity where ``along`` is given.
    along
        The same along the velocity; needs n of at least 2.

    Returns
    -------
    state
        Shape (m, n, 3).

    Raises
    ------
    ValueError
        If ``along`` is given for a state without velocity or with one noise per axis.
    """
    order = initial.shape[0]
    if along is not None and (order < 2 or np.ndim(noise) != 0):
        raise ValueError("noise along the velocity needs a velocity and one number across")
    transition, factor = unit_transition(order)
    shape = noise_shape(noise, None, None)
    draws = np.einsum(
        "ij,mjd->mid", factor, rng.standard_normal((max(time_s.size - 1, 0), order, 3))
    )
    state = np.empty((time_s.size, order, 3))
    state[0] = initial
    for index, step in enumerate(np.diff(time_s)):
        powers = step ** np.arange(order)[:, None]
        if along is not None:
            shape = noise_shape(noise, along, state[index, 1])
        kick = step ** (order - 0.5) * draws[index] @ shape
        # A repeated time repeats the state; dividing by its powers of the step would not.
        state[index + 1] = (
            state[index] if step == 0.0 else (transition @ (powers * state[index]) + kick) / powers
        )
    return state
