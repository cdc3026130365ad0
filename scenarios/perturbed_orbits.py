"""Satellites under all that the orbital motion knows, written apart from it, in axes at rest.

The inertial axes are those of the Earth-fixed frame at time zero, as in
:mod:`geograph.scenarios.orbits`. Zonal harmonics are the Cartesian expressions of R. R. Bate,
D. D. Mueller, J. E. White, *Fundamentals of Astrodynamics*, 1971, section 9.7; Moon and Sun follow
the short series of O. Montenbruck, E. Gill, *Satellite Orbits*, 2000, section 3.3.2; the air is the
table of piecewise exponentials (D. A. Vallado, *Fundamentals of Astrodynamics and Applications*,
4th edition, section 8.6.2), and turns with the Earth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.constants import (
    ATMOSPHERE_DENSITY_KG_M3,
    ATMOSPHERE_HEIGHT_M,
    ATMOSPHERE_SCALE_M,
    EARTH_GM_M3_S2,
    EARTH_J2,
    EARTH_J3,
    EARTH_J4,
    EARTH_RADIUS_M,
    MOON_GM_M3_S2,
    SUN_GM_M3_S2,
)
from geograph.scenarios.orbits import earth_velocity, turned_about_z
from geograph.scenarios.paths import unit_transition
from geograph.scenarios.places import geodetic

if TYPE_CHECKING:
    from datetime import datetime

    from numpy.typing import NDArray

_CENTURY_DAYS = 36525.0
_ARCSECOND = np.pi / 648000.0


@dataclass(frozen=True, kw_only=True)
class Forces:
    """What acts on a simulated satellite beside the zonal harmonics to degree 4.

    Parameters
    ----------
    moon, sun
        Whether they pull.
    drag_m2_kg
        Drag coefficient times area over mass.
    constant_m_s2
        An acceleration that is constant along radial, transverse and normal axes, or at rest.
    axes
        ``"rtn"`` or ``"inertial"``.
    """

    moon: bool = False
    sun: bool = False
    drag_m2_kg: float = 0.0
    constant_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axes: Literal["rtn", "inertial"] = "rtn"


def zonal_gravity(position_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the pull of the Earth with J2, J3 and J4, shape (3,), m/s^2."""
    x, y, z = position_m
    r = float(np.sqrt(x * x + y * y + z * z))
    pull = EARTH_GM_M3_S2 / r**3
    s2 = (z / r) ** 2
    second = 1.5 * EARTH_J2 * (EARTH_RADIUS_M / r) ** 2
    third = 2.5 * EARTH_J3 * (EARTH_RADIUS_M / r) ** 3
    fourth = 0.625 * EARTH_J4 * (EARTH_RADIUS_M / r) ** 4
    level = (
        1.0
        + second * (1.0 - 5.0 * s2)
        + third * (3.0 - 7.0 * s2) * z / r
        - fourth * (3.0 - 42.0 * s2 + 63.0 * s2**2)
    )
    upright = (
        z * (1.0 + second * (3.0 - 5.0 * s2) - fourth * (15.0 - 70.0 * s2 + 63.0 * s2**2))
        + third * (6.0 * s2 - 7.0 * s2**2 - 0.6) * r
    )
    return np.array([-pull * level * x, -pull * level * y, -pull * upright])


def sidereal_angle(epoch: datetime) -> float:
    """Return the Greenwich mean sidereal angle, radians (UT1 as UTC; Montenbruck & Gill, 5.19)."""
    days = epoch.timestamp() / 86400.0 + 2440587.5 - 2451545.0
    whole = np.floor(days - 0.5) + 0.5
    seconds = (days - whole) * 86400.0
    t0, t = whole / _CENTURY_DAYS, days / _CENTURY_DAYS
    angle = 24110.54841 + 8640184.812866 * t0 + 1.002737909350795 * seconds + 0.093104 * t**2
    return float(angle % 86400.0) * 2.0 * np.pi / 86400.0


def moon_and_sun(epoch: datetime, time_s: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the places of Moon and Sun, each shape (3,), metres, in the world's axes at rest.

    Good to some arc minutes: equator and equinox are the mean ones of date.

    Parameters
    ----------
    epoch
        Instant of time zero.
    time_s
        Seconds after it.
    """
    # 69 s are TT less UTC, to a second or two in this century.
    days = (epoch.timestamp() + time_s + 69.0) / 86400.0 + 2440587.5 - 2451545.0
    t = days / _CENTURY_DAYS
    l0 = np.radians(218.31617 + (481267.88088 - 1.3972) * t)
    m, ls = np.radians(134.96292 + 477198.86753 * t), np.radians(357.52543 + 35999.04944 * t)
    f, d = np.radians(93.27283 + 483202.01873 * t), np.radians(297.85027 + 445267.11135 * t)
    terms = (
        *((22640, m), (769, 2 * m), (-4586, m - 2 * d), (2370, 2 * d), (-668, ls), (-412, 2 * f)),
        *((-212, 2 * m - 2 * d), (-206, m + ls - 2 * d), (192, m + 2 * d), (-165, ls - 2 * d)),
        *((148, m - ls), (-125, d), (-110, m + ls), (-55, 2 * f - 2 * d)),
    )
    longitude = l0 + _ARCSECOND * sum(size * np.sin(angle) for size, angle in terms)
    lead = f + longitude - l0 + _ARCSECOND * (412 * np.sin(2 * f) + 541 * np.sin(ls))
    sidewards = (
        *((18520, lead), (-526, f - 2 * d), (44, m + f - 2 * d), (-31, -m + f - 2 * d)),
        *((-25, -2 * m + f), (-23, ls + f - 2 * d), (21, -m + f), (11, -ls + f - 2 * d)),
    )
    latitude = _ARCSECOND * sum(size * np.sin(angle) for size, angle in sidewards)
    outwards = (
        *((385000, 0.0), (-20905, m), (-3699, 2 * d - m), (-2956, 2 * d), (-570, 2 * m)),
        *((246, 2 * m - 2 * d), (-205, ls - 2 * d), (-171, m + 2 * d), (-152, m + ls - 2 * d)),
    )
    distance = 1e3 * sum(size * np.cos(angle) for size, angle in outwards)
    moon = _equatorial(longitude, latitude, distance, t)
    mean = np.radians(357.5256 + 35999.049 * t)
    longitude = (
        np.radians(282.94) + mean + _ARCSECOND * (6892 * np.sin(mean) + 72 * np.sin(2 * mean))
    )
    distance = 1e9 * (149.619 - 2.499 * np.cos(mean) - 0.021 * np.cos(2 * mean))
    sun = _equatorial(longitude, 0.0, distance, t)
    start = sidereal_angle(epoch)
    return turned_about_z(moon, -start), turned_about_z(sun, -start)


def _equatorial(
    longitude: float, latitude: float, distance: float, t: float
) -> NDArray[np.float64]:
    """Return a place on the mean equator of date from ecliptic coordinates of 2000."""
    longitude += np.radians(1.3972 * t)
    oblique = np.radians(23.43929111 - 0.0130042 * t)
    cos, sin = np.cos(oblique), np.sin(oblique)
    x = np.cos(latitude) * np.cos(longitude)
    y, z = np.cos(latitude) * np.sin(longitude), np.sin(latitude)
    return distance * np.array([x, cos * y - sin * z, sin * y + cos * z])


def acceleration(
    state: NDArray[np.float64], time_s: float, epoch: datetime, forces: Forces
) -> NDArray[np.float64]:
    """Return the acceleration of a state, shape (2, 3), in axes at rest, shape (3,), m/s^2."""
    position, velocity = state
    total = zonal_gravity(position)
    if forces.moon or forces.sun:
        for place, gm, acts in zip(
            moon_and_sun(epoch, time_s),
            (MOON_GM_M3_S2, SUN_GM_M3_S2),
            (forces.moon, forces.sun),
            strict=True,
        ):
            if acts:
                away = place - position
                total = total + gm * (
                    away / np.linalg.norm(away) ** 3 - place / np.linalg.norm(place) ** 3
                )
    if forces.drag_m2_kg:
        against = velocity - earth_velocity(position)
        # The ellipsoid is the same however the Earth has turned.
        rho = air_density(geodetic(position)[2])
        total = total - 0.5 * rho * forces.drag_m2_kg * np.linalg.norm(against) * against
    if any(forces.constant_m_s2):
        axes = np.eye(3)
        if forces.axes == "rtn":
            up = position / np.linalg.norm(position)
            across = np.cross(position, velocity)
            across /= np.linalg.norm(across)
            axes = np.stack([up, np.cross(across, up), across])
        total = total + np.array(forces.constant_m_s2) @ axes
    return total


def air_density(height_m: float) -> float:
    """Return the density of the air, kg/m^3: exponential from each row of the table to the next."""
    row = max(int(np.searchsorted(ATMOSPHERE_HEIGHT_M, height_m, side="right")) - 1, 0)
    fallen = (height_m - ATMOSPHERE_HEIGHT_M[row]) / ATMOSPHERE_SCALE_M[row]
    return float(ATMOSPHERE_DENSITY_KG_M3[row] * np.exp(-fallen))


def sample_orbit(
    rng: np.random.Generator,
    time_s: NDArray[np.float64],
    initial: NDArray[np.float64],
    *,
    noise: float,
    epoch: datetime,
    forces: Forces,
) -> NDArray[np.float64]:
    """Draw an orbit under forces and white noise on the acceleration, in axes at rest.

    Runge-Kutta steps and exactly integrated noise, as
    :func:`geograph.scenarios.orbits.sample_perturbed_fall`.

    Parameters
    ----------
    rng
        Source of randomness.
    time_s
        Shape (m,), rising, seconds; the orbit starts at the first. Steps of 5 s are good to a
        micrometre each in the lowest orbit.
    initial
        Shape (2, 3): position and velocity at the first time.
    noise
        Square root of the spectral density, m/s^1.5.
    epoch, forces
        Instant of time zero, and what acts.

    Returns
    -------
    state
        Shape (m, 2, 3).
    """

    def rates(state: NDArray[np.float64], time: float) -> NDArray[np.float64]:
        return np.stack([state[1], acceleration(state, time, epoch, forces)])

    _, factor = unit_transition(2)
    draws = np.einsum("ij,mjd->mid", factor, rng.standard_normal((time_s.size - 1, 2, 3)))
    state = np.empty((time_s.size, 2, 3))
    state[0] = initial
    for index, step in enumerate(np.diff(time_s)):
        now, time = state[index], float(time_s[index])
        first = rates(now, time)
        second = rates(now + 0.5 * step * first, time + 0.5 * step)
        third = rates(now + 0.5 * step * second, time + 0.5 * step)
        fourth = rates(now + step * third, time + step)
        kick = noise * np.array([[step**1.5], [step**0.5]]) * draws[index]
        state[index + 1] = now + step / 6.0 * (first + 2.0 * (second + third) + fourth) + kick
    return state
