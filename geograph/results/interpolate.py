"""A path between its knots.

The mean of a Gaussian-process path with white noise on its n-th derivative is, between two knots,
the Hermite polynomial of degree 2n - 1 through their states (Barfoot, *State Estimation for
Robotics*, section 3.4): linear for positions alone, cubic with velocities, quintic with
accelerations. So the tables of knots hold the whole path, but for gravity within an interval.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from scipy.interpolate import PPoly


@dataclass(frozen=True, eq=False, kw_only=True)
class Knots:
    """States at knots.

    Parameters
    ----------
    time_s
        Shape (k,), strictly increasing.
    position_m, velocity_m_s, acceleration_m_s2
        Shape (k, 3); the latter two None where there is none.
    """

    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    velocity_m_s: NDArray[np.float64] | None = None
    acceleration_m_s2: NDArray[np.float64] | None = None

    def at(
        self, time_s: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """Return position and velocity, each (n, 3), at times; the ends hold beyond the ends.

        One knot is an object at rest. Velocity is None where the knots have none.
        """
        from scipy.interpolate import CubicHermiteSpline

        inside = np.clip(time_s, self.time_s[0], self.time_s[-1])
        velocity = self.velocity_m_s
        if self.time_s.size == 1:
            still = np.repeat(self.position_m, inside.size, axis=0)
            return still, None if velocity is None else np.repeat(velocity, inside.size, axis=0)
        if velocity is None:
            return columns_at(inside, self.time_s, self.position_m), None
        path: PPoly
        if self.acceleration_m_s2 is None:
            path = CubicHermiteSpline(self.time_s, self.position_m, velocity)
        else:
            path = _quintic(self.time_s, self.position_m, velocity, self.acceleration_m_s2)
        return path(inside), path(inside, 1)


def _quintic(
    time_s: NDArray[np.float64],
    position: NDArray[np.float64],
    velocity: NDArray[np.float64],
    acceleration: NDArray[np.float64],
) -> PPoly:
    """Return the piecewise polynomial of degree five through position and two derivatives."""
    from scipy.interpolate import PPoly

    step = np.diff(time_s)[:, None]
    speed, bend = velocity[:-1] * step, acceleration[:-1] * step**2 / 2.0
    # What the parabola of the first end leaves to the second: in value, slope and curvature.
    value = np.diff(position, axis=0) - speed - bend
    slope = np.diff(velocity, axis=0) * step - 2.0 * bend
    curvature = np.diff(acceleration, axis=0) * step**2 / 2.0
    terms = [
        6.0 * value - 3.0 * slope + curvature,
        -15.0 * value + 7.0 * slope - 2.0 * curvature,
        10.0 * value - 4.0 * slope + curvature,
        bend,
        speed,
        position[:-1],
    ]
    return PPoly(np.stack([c / step ** (5 - i) for i, c in enumerate(terms)]), time_s)


def columns_at(
    time_s: NDArray[np.float64], known_s: NDArray[np.float64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return columns interpolated linearly, shape (n, ...), of values of shape (k, ...)."""
    flat = values.reshape(known_s.size, -1)
    columns = [np.interp(time_s, known_s, column) for column in flat.T]
    return np.stack(columns, axis=-1).reshape(-1, *values.shape[1:])
