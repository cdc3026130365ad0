"""The light time: where the object was when it emitted what a sensor receives.

A signal received at t was emitted at t - tau with tau = |P - S(t)| / c, where P is the object's
position at emission in axes that do not turn while the signal is under way. In ECEF these are the
Earth-fixed axes at reception: P = Rz(-omega tau) p(t - tau) (the Sagnac correction; N. Ashby,
*Relativity in the Global Positioning System*, Living Rev. Relativ. 6, 2003, section 2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def turn_to_reception(
    vector: NDArray[np.float64], light_time_s: NDArray[np.float64], spin_rad_s: float
) -> NDArray[np.float64]:
    """Return vectors of the frame at emission in the axes of the frame at reception.

    Parameters
    ----------
    vector
        Shape (n, 3), any unit.
    light_time_s
        Shape (n,), seconds.
    spin_rad_s
        Angular speed of the frame about z (zero for a local frame), radians per second.
    """
    if spin_rad_s == 0.0:
        return vector
    angle = spin_rad_s * light_time_s
    sine, cosine = np.sin(angle), np.cos(angle)
    x, y = vector[:, 0], vector[:, 1]
    turned = np.array(vector, dtype=np.float64)
    turned[:, 0] = cosine * x + sine * y
    turned[:, 1] = cosine * y - sine * x
    return turned


@dataclass(frozen=True, eq=False)
class Sight:
    """Lines of sight at reception, and what their derivatives need.

    Attributes
    ----------
    line_of_sight_m
        Shape (n, 3): P - S in the frame's axes at reception.
    distance_m
        Shape (n,).
    light_time_s
        Shape (n,).
    velocity_m_s
        Shape (n, 3): the object's velocity in the frame, in the axes at reception.
    inertial_velocity_m_s
        Shape (n, 3): with the frame's turning added.
    """

    line_of_sight_m: NDArray[np.float64]
    distance_m: NDArray[np.float64]
    light_time_s: NDArray[np.float64]
    velocity_m_s: NDArray[np.float64]
    inertial_velocity_m_s: NDArray[np.float64]

    def aberration(self, speed_m_s: float) -> NDArray[np.float64]:
        """Return E = I - V u^T / (c + u.V), shape (n, 3, 3).

        A displacement g of object against sensor, at fixed emission time, changes the line of sight
        by E g: part of it is taken back because the signal is then emitted at another time.

        Parameters
        ----------
        speed_m_s
            Speed of propagation c.
        """
        row = self.light_time_gradient(speed_m_s)
        return np.asarray(np.eye(3) - self.inertial_velocity_m_s[:, :, None] * row[:, None, :])

    def light_time_gradient(self, speed_m_s: float) -> NDArray[np.float64]:
        """Return u^T / (c + u.V), shape (n, 3): light time by displacement, seconds per metre."""
        unit = self.line_of_sight_m / self.distance_m[:, None]
        closing = np.einsum("ni,ni->n", unit, self.inertial_velocity_m_s)
        return np.asarray(unit / (speed_m_s + closing)[:, None])


def sight(
    position_m: NDArray[np.float64],
    velocity_m_s: NDArray[np.float64],
    sensor_m: NDArray[np.float64],
    light_time_s: NDArray[np.float64],
    spin_rad_s: float,
) -> Sight:
    """Return the lines of sight for given positions at emission and light times.

    Parameters
    ----------
    position_m, velocity_m_s
        Shape (n, 3): the object at emission, in the frame at emission.
    sensor_m
        Shape (n, 3): the sensor at reception.
    light_time_s
        Shape (n,).
    spin_rad_s
        Angular speed of the frame about z, radians per second.
    """
    turned = turn_to_reception(position_m, light_time_s, spin_rad_s)
    velocity = turn_to_reception(velocity_m_s, light_time_s, spin_rad_s)
    inertial = velocity
    if spin_rad_s != 0.0:
        inertial = velocity + spin_rad_s * np.stack(
            [-turned[:, 1], turned[:, 0], np.zeros(turned.shape[0])], axis=1
        )
    line = turned - sensor_m
    distance = np.sqrt(np.einsum("ni,ni->n", line, line))
    return Sight(line, distance, light_time_s, velocity, inertial)


def light_time_correction(found: Sight, speed_m_s: float) -> NDArray[np.float64]:
    """Return the Newton correction of the light time, shape (n,), seconds.

    The root of |P(tau)| - c tau = 0, whose derivative by tau is -(u.V + c).

    Parameters
    ----------
    found
        Lines of sight for the light times so far.
    speed_m_s
        Speed of propagation c.
    """
    unit = found.line_of_sight_m / found.distance_m[:, None]
    closing = np.einsum("ni,ni->n", unit, found.inertial_velocity_m_s)
    return np.asarray((found.distance_m - speed_m_s * found.light_time_s) / (speed_m_s + closing))
