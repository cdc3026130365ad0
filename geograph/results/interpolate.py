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

from geograph.path import KinematicPath

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.path import Order

_ORDERS: dict[int, Order] = {1: 1, 2: 2, 3: 3}


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
        inside = np.clip(time_s, self.time_s[0], self.time_s[-1])
        velocity = self.velocity_m_s
        if self.time_s.size == 1:
            still = np.repeat(self.position_m, inside.size, axis=0)
            return still, None if velocity is None else np.repeat(velocity, inside.size, axis=0)
        blocks = [self.position_m, velocity, self.acceleration_m_s2]
        known = [block for block in blocks if block is not None]
        path = KinematicPath(self.time_s, _ORDERS[len(known)])
        held = path.at_state(np.concatenate(known, axis=1))
        position, rate = held.position_velocity(path.locate(inside))
        return position, None if velocity is None else rate


def columns_at(
    time_s: NDArray[np.float64], known_s: NDArray[np.float64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return columns interpolated linearly, shape (n, ...), of values of shape (k, ...)."""
    flat = values.reshape(known_s.size, -1)
    columns = [np.interp(time_s, known_s, column) for column in flat.T]
    return np.stack(columns, axis=-1).reshape(-1, *values.shape[1:])
