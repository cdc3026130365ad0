"""Two-body orbits of any eccentricity below one, in axes that do not turn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.constants import EARTH_GM_M3_S2, EARTH_RADIUS_M
from geograph.scenarios.orbits import EarthFixedBody
from geograph.scenarios.places import random_axes

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from geograph.scenarios.paths import Body

_NEWTON_STEPS = 50


@dataclass(frozen=True, eq=False)
class EllipticOrbit:
    """A two-body elliptic orbit in inertial axes (Vallado, 4th edition, section 2.2).

    Parameters
    ----------
    semi_major_m
        Half of the long axis.
    eccentricity
        From 0, a circle, to below 1.
    first, second
        Shape (3,), unit vectors at right angles: towards the perigee, and along the velocity there.
    mean_anomaly_rad
        At time zero.
    """

    semi_major_m: float
    eccentricity: float
    first: NDArray[np.float64]
    second: NDArray[np.float64]
    mean_anomaly_rad: float

    @property
    def rate_rad_s(self) -> float:
        """Mean motion."""
        return float(np.sqrt(EARTH_GM_M3_S2 / self.semi_major_m**3))

    def _anomaly(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return eccentric anomalies, shape (..., 1): Kepler's equation by Newton's method."""
        mean = self.mean_anomaly_rad + self.rate_rad_s * np.asarray(time_s, dtype=np.float64)
        # From half a turn the iteration converges monotonically for every eccentricity.
        turns = np.floor(mean / (2.0 * np.pi)) * 2.0 * np.pi
        within = mean - turns
        anomaly = np.full_like(within, np.pi)
        for _ in range(_NEWTON_STEPS):
            step = (anomaly - self.eccentricity * np.sin(anomaly) - within) / (
                1.0 - self.eccentricity * np.cos(anomaly)
            )
            anomaly = anomaly - step
            if np.abs(step).max(initial=0.0) < 1e-14:
                break
        return np.asarray(anomaly + turns)[..., None]

    def position_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return inertial positions, shape (..., 3), metres, at times in seconds (any shape)."""
        anomaly = self._anomaly(time_s)
        short = np.sqrt(1.0 - self.eccentricity**2)
        along = np.cos(anomaly) - self.eccentricity
        return np.asarray(
            self.semi_major_m * (along * self.first + short * np.sin(anomaly) * self.second)
        )

    def velocity_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return inertial velocities, shape (..., 3), metres per second."""
        anomaly = self._anomaly(time_s)
        short = np.sqrt(1.0 - self.eccentricity**2)
        rate = self.rate_rad_s / (1.0 - self.eccentricity * np.cos(anomaly))
        turning = short * np.cos(anomaly) * self.second - np.sin(anomaly) * self.first
        return np.asarray(self.semi_major_m * rate * turning)


def random_elliptic_satellite(
    rng: np.random.Generator,
    *,
    perigee_m: tuple[float, float],
    eccentricity: tuple[float, float],
) -> Body:
    """Draw an orbit in any plane, as the turning Earth sees it.

    Parameters
    ----------
    rng
        Source of randomness.
    perigee_m
        Least and greatest height of the perigee above the equator's radius, metres.
    eccentricity
        Least and greatest eccentricity.
    """
    first, second = random_axes(rng)
    oblong = rng.uniform(*eccentricity)
    nearest = EARTH_RADIUS_M + rng.uniform(*perigee_m)
    mean_anomaly = rng.uniform(0.0, 2.0 * np.pi)
    return EarthFixedBody(
        EllipticOrbit(nearest / (1.0 - oblong), oblong, first, second, mean_anomaly)
    )
