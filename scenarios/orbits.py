"""Bodies under the Earth's gravity, integrated in axes that do not turn.

The inertial axes are those of the Earth-fixed frame at time zero; at time t the Earth-fixed frame
is turned by the Earth's rate times t about z. Neither Coriolis nor centrifugal terms occur
anywhere: they are the estimator's business.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.integrate import solve_ivp

from geograph.constants import (
    EARTH_GM_M3_S2,
    EARTH_J2,
    EARTH_RADIUS_M,
    EARTH_ROTATION_RAD_S,
)
from geograph.scenarios.paths import SampledBody, noise_shape, unit_transition

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from geograph.scenarios.paths import Body, Noise


def turned_about_z(vector: ArrayLike, angle_rad: ArrayLike) -> NDArray[np.float64]:
    """Return vectors, shape (..., 3), turned about z by angles in radians (counter-clockwise)."""
    x, y, z = np.moveaxis(np.asarray(vector, dtype=np.float64), -1, 0)
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return np.stack(
        np.broadcast_arrays(cos * x - sin * y, sin * x + cos * y, z + 0.0 * cos), axis=-1
    )


@dataclass(frozen=True, eq=False)
class EarthFixedBody:
    """A body known in inertial axes, as the turning Earth sees it.

    Parameters
    ----------
    inertial
        The body in inertial axes.
    """

    inertial: Body

    def position_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return ECEF positions, shape (..., 3), metres, at times in seconds (any shape)."""
        angle = EARTH_ROTATION_RAD_S * np.asarray(time_s, dtype=np.float64)
        return turned_about_z(self.inertial.position_at(time_s), -angle)

    def velocity_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return velocities relative to the turning Earth, shape (..., 3), metres per second."""
        angle = EARTH_ROTATION_RAD_S * np.asarray(time_s, dtype=np.float64)
        relative = self.inertial.velocity_at(time_s) - earth_velocity(
            self.inertial.position_at(time_s)
        )
        return turned_about_z(relative, -angle)


def earth_velocity(position_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the velocity of the turning Earth at inertial positions, shape (..., 3), m/s."""
    x, y, _ = np.moveaxis(position_m, -1, 0)
    return EARTH_ROTATION_RAD_S * np.stack([-y, x, np.zeros_like(x)], axis=-1)


@dataclass(frozen=True, eq=False)
class CircularOrbit:
    """A two-body circular orbit in inertial axes.

    Parameters
    ----------
    radius_m
        Distance from the centre of the Earth.
    first, second
        Shape (3,), unit vectors at right angles: where the body is at phase zero, and a quarter of
        a turn later.
    phase_rad
        Phase at time zero.
    """

    radius_m: float
    first: NDArray[np.float64]
    second: NDArray[np.float64]
    phase_rad: float

    def _phase(self, time_s: ArrayLike) -> tuple[float, NDArray[np.float64]]:
        rate = float(np.sqrt(EARTH_GM_M3_S2 / self.radius_m**3))
        time = np.asarray(time_s, dtype=np.float64)
        return rate, self.phase_rad + rate * time[..., None]

    def position_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return inertial positions, shape (..., 3), metres, at times in seconds (any shape)."""
        _, phase = self._phase(time_s)
        return self.radius_m * (np.cos(phase) * self.first + np.sin(phase) * self.second)

    def velocity_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return inertial velocities, shape (..., 3), metres per second."""
        rate, phase = self._phase(time_s)
        return self.radius_m * rate * (np.cos(phase) * self.second - np.sin(phase) * self.first)


def gravity(position_m: NDArray[np.float64], *, j2: bool) -> NDArray[np.float64]:
    """Return the acceleration of free fall in inertial axes, shape (..., 3), m/s^2.

    The gradient of GM / r (1 - J2 (a / r)^2 (3 z^2 / r^2 - 1) / 2), with the Earth's axis as z
    (Vallado, *Fundamentals of Astrodynamics and Applications*, 4th edition, section 8.6).

    Parameters
    ----------
    position_m
        Shape (..., 3), metres.
    j2
        Whether the Earth is oblate.
    """
    square = np.sum(position_m**2, axis=-1, keepdims=True)
    pull: NDArray[np.float64] = -EARTH_GM_M3_S2 * position_m / square**1.5
    if not j2:
        return pull
    flattening = 1.5 * EARTH_J2 * EARTH_RADIUS_M**2 / square
    height = 5.0 * position_m[..., 2:] ** 2 / square
    return np.asarray(pull * (1.0 + flattening * (np.array([1.0, 1.0, 3.0]) - height)))


def free_fall(
    initial: NDArray[np.float64], span_s: tuple[float, float], *, j2: bool, step_s: float = 1.0
) -> SampledBody:
    """Return a body in free fall, in inertial axes.

    Integrated by DOP853 to a relative 1e-12 and tabulated with its acceleration; the quintic
    between two rows a second apart is good to a nanometre in a low orbit.

    Parameters
    ----------
    initial
        Shape (2, 3): inertial position and velocity at the first time.
    span_s
        First and last time, seconds.
    j2
        Whether the Earth is oblate.
    step_s
        Step of the table, seconds.

    Raises
    ------
    RuntimeError
        If the integrator fails (a body that falls into the centre).
    """

    def derivative(_: float, state: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([state[3:], gravity(state[:3], j2=j2)])

    nodes = max(int(np.ceil((span_s[1] - span_s[0]) / step_s)) + 1, 2)
    time = np.linspace(span_s[0], span_s[1], nodes)
    # The rows come from the integrator's dense output, which is worse than its own steps unless
    # these are kept short.
    result = solve_ivp(
        derivative,
        span_s,
        initial.ravel(),
        method="DOP853",
        t_eval=time,
        rtol=1e-12,
        atol=1e-9,
        max_step=20.0,
    )
    if not result.success:
        raise RuntimeError(f"an orbit could not be integrated: {result.message}")
    state = np.moveaxis(result.y.reshape(2, 3, nodes), -1, 0)
    acceleration = gravity(state[:, 0], j2=j2)[:, None]
    return SampledBody(time, np.concatenate([state, acceleration], axis=1))


def sample_perturbed_fall(
    rng: np.random.Generator,
    time_s: NDArray[np.float64],
    initial: NDArray[np.float64],
    *,
    noise: Noise,
    along: float | None = None,
    j2: bool = True,
) -> NDArray[np.float64]:
    """Draw a free fall disturbed by white noise on the acceleration, in inertial axes.

    Each step is a Runge-Kutta step of the fall (order 4; exact to rounding at steps below a
    second) and a draw of the exactly integrated noise of that step, which leaves out only what
    the gradient of gravity (1e-6 / s^2) does to the noise within one step.

    Parameters
    ----------
    rng
        Source of randomness.
    time_s
        Shape (m,), strictly increasing, seconds; the fall starts at the first.
    initial
        Shape (2, 3): inertial position and velocity at the first time.
    noise
        Square root of the spectral density of the acceleration, m/s^1.5. Three numbers are along
        the inertial axes.
    along
        The same along the velocity relative to the turning Earth; ``noise`` is then across it.
    j2
        Whether the Earth is oblate.

    Returns
    -------
    state
        Shape (m, 2, 3): positions and velocities.
    """

    def derivative(state: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([state[1], gravity(state[0], j2=j2)])

    _, factor = unit_transition(2)
    draws = np.einsum("ij,mjd->mid", factor, rng.standard_normal((time_s.size - 1, 2, 3)))
    state = np.empty((time_s.size, 2, 3))
    state[0] = initial
    for index, step in enumerate(np.diff(time_s)):
        now = state[index]
        first = derivative(now)
        second = derivative(now + 0.5 * step * first)
        third = derivative(now + 0.5 * step * second)
        fourth = derivative(now + step * third)
        shape = noise_shape(noise, along, now[1] - earth_velocity(now[0]))
        kick = np.array([[step**1.5], [step**0.5]]) * draws[index] @ shape
        state[index + 1] = now + step / 6.0 * (first + 2.0 * (second + third) + fourth) + kick
    return state
