"""Forces on a satellite beside the Earth's gravity: Moon and Sun, drag, an unknown acceleration.

All in ECEF, per mass. Moon and Sun are point masses at given places s (O. Montenbruck, E. Gill,
*Satellite Orbits*, 2000, section 3.3.1), less what they do to the Earth itself:

    a = GM ((s - p) / |s - p|^3 - s / |s|^3).

The air turns with the Earth, so that the velocity against it is that in ECEF (the same, section
3.5; b is drag coefficient times area over mass):

    a = -1/2 b rho(h) |v| v.

An unknown acceleration is constant along radial, transverse and normal axes of the orbit, or on
axes that do not turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from geograph.constants import (
    ATMOSPHERE_DENSITY_KG_M3,
    ATMOSPHERE_HEIGHT_M,
    ATMOSPHERE_SCALE_M,
    EARTH_FLATTENING,
    EARTH_RADIUS_M,
    EARTH_ROTATION_RAD_S,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

ForceAxes = Literal["rtn", "inertial"]
"""Axes of an unknown acceleration: radial, transverse, normal; or at rest, those of ECEF at time
zero."""

_ACCELERATION_NAMES = {
    "rtn": ("acceleration_radial", "acceleration_transverse", "acceleration_normal"),
    "inertial": ("acceleration_x", "acceleration_y", "acceleration_z"),
}

# Unknowns of forces are constants. This share of their prior sigmas, by which they may wander in a
# day, is far below what anything notices, and leaves a noise that can be divided by.
_WANDER_SHARE = 1e-6
_DAY_S = 86400.0

_SPIN = np.array([0.0, 0.0, EARTH_ROTATION_RAD_S])


@dataclass(frozen=True, eq=False, kw_only=True)
class Forces:
    """Which forces act beside the Earth's gravity, and what of them is unknown.

    Attributes
    ----------
    gm_m3_s2
        Gravitational parameters of other bodies, B of them.
    bodies_m
        Gives their places, shape (n, B, 3), ECEF metres, at times, shape (n,), seconds; None: there
        are none.
    drag_m2_kg
        Drag coefficient times area over mass; zero and a zero sigma: no drag.
    drag_sigma_m2_kg
        Its prior sigma; above zero its deviation is an unknown.
    acceleration_sigma_m_s2
        Prior sigma of each component of an unknown acceleration; zero: there is none.
    axes
        Axes of the unknown acceleration.
    """

    gm_m3_s2: tuple[float, ...] = ()
    bodies_m: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None
    drag_m2_kg: float = 0.0
    drag_sigma_m2_kg: float = 0.0
    acceleration_sigma_m_s2: float = 0.0
    axes: ForceAxes = "rtn"

    @property
    def drags(self) -> bool:
        """Whether there is drag."""
        return self.drag_m2_kg > 0.0 or self.drag_sigma_m2_kg > 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns, in the order of a state's components behind the velocity."""
        acceleration = _ACCELERATION_NAMES[self.axes] if self.acceleration_sigma_m_s2 > 0.0 else ()
        return (*acceleration, *(("drag_correction",) if self.drag_sigma_m2_kg > 0.0 else ()))

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the unknowns."""
        return tuple("m2/kg" if name == "drag_correction" else "m/s2" for name in self.names)

    @property
    def sigma(self) -> NDArray[np.float64]:
        """Prior sigmas of the unknowns, shape (e,); their prior means are zero."""
        return np.array(
            [
                self.drag_sigma_m2_kg if name == "drag_correction" else self.acceleration_sigma_m_s2
                for name in self.names
            ]
        )

    def wander(self, step_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return by how much the unknowns may change over steps, 1-sigma, shape (n, e)."""
        share = _WANDER_SHARE * np.sqrt(np.abs(step_s) / _DAY_S)
        return np.asarray(share[:, None] * self.sigma)

    def acceleration(
        self,
        position_m: NDArray[np.float64],
        velocity_m_s: NDArray[np.float64],
        unknown: NDArray[np.float64],
        time_s: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return what all of them add to the acceleration, with its derivatives.

        Parameters
        ----------
        position_m, velocity_m_s
            Shape (n, 3), ECEF.
        unknown
            Shape (n, e).
        time_s
            Shape (n,), seconds after the epoch.

        Returns
        -------
        acceleration_m_s2
            Shape (n, 3).
        by_position, by_velocity, by_unknown
            Shapes (n, 3, 3), (n, 3, 3), (n, 3, e).
        """
        count = position_m.shape[0]
        value, by_position = np.zeros((count, 3)), np.zeros((count, 3, 3))
        by_velocity, by_unknown = np.zeros((count, 3, 3)), np.zeros((count, 3, unknown.shape[1]))
        if self.bodies_m is not None:
            places = self.bodies_m(time_s)
            for index, gm in enumerate(self.gm_m3_s2):
                pull, gradient = third_body(position_m, places[:, index], gm)
                value += pull
                by_position += gradient
        if self.acceleration_sigma_m_s2 > 0.0:
            own = unknown[:, :3]
            if self.axes == "rtn":
                turned, axes, by_p, by_v = along_orbit(position_m, velocity_m_s, own)
                by_position += by_p
                by_velocity += by_v
            else:
                axes = resting_axes(time_s)
                turned = np.einsum("nij,nj->ni", axes, own)
            value += turned
            by_unknown[:, :, :3] = axes
        if self.drags:
            coefficient = np.full(count, self.drag_m2_kg)
            if self.drag_sigma_m2_kg > 0.0:
                coefficient += unknown[:, -1]
            unit, by_p, by_v = drag(position_m, velocity_m_s)
            value += coefficient[:, None] * unit
            by_position += coefficient[:, None, None] * by_p
            by_velocity += coefficient[:, None, None] * by_v
            if self.drag_sigma_m2_kg > 0.0:
                by_unknown[:, :, -1] = unit
        return value, by_position, by_velocity, by_unknown


def third_body(
    position_m: NDArray[np.float64], body_m: NDArray[np.float64], gm_m3_s2: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the pull of another body against that on the Earth, and its derivative.

    Parameters
    ----------
    position_m, body_m
        Shape (n, 3): the satellite and the body, in the same Earth-centred axes.
    gm_m3_s2
        The body's gravitational parameter.

    Returns
    -------
    acceleration_m_s2
        Shape (n, 3).
    by_position
        Shape (n, 3, 3), 1/s^2.
    """
    sight = body_m - position_m
    square = np.einsum("ni,ni->n", sight, sight)
    near = gm_m3_s2 / (square * np.sqrt(square))
    far = gm_m3_s2 / np.linalg.norm(body_m, axis=1) ** 3
    # near sight - far body, written so that the small difference keeps its digits.
    value = (near - far)[:, None] * sight - far[:, None] * position_m
    outer = sight[:, :, None] * sight[:, None, :]
    gradient = near[:, None, None] * (3.0 * outer / square[:, None, None] - np.eye(3))
    return value, gradient


@cache
def _logarithmic_density() -> Any:
    from scipy.interpolate import CubicSpline

    # Natural at the ground; above the table the last scale height goes on.
    ends: Any = ((2, 0.0), (1, -1.0 / ATMOSPHERE_SCALE_M[-1]))
    return CubicSpline(ATMOSPHERE_HEIGHT_M, np.log(ATMOSPHERE_DENSITY_KG_M3), bc_type=ends)


def density(
    height_m: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the density of a mean atmosphere, kg/m^3, and its derivative by height, shape (n,).

    The logarithms of :data:`geograph.constants.ATMOSPHERE_DENSITY_KG_M3` joined by a cubic spline,
    so that density and derivative have no steps; below the ground as there.
    """
    low, high = ATMOSPHERE_HEIGHT_M[0], ATMOSPHERE_HEIGHT_M[-1]
    inside = np.clip(height_m, low, high)
    spline = _logarithmic_density()
    above = np.maximum(height_m - high, 0.0) / ATMOSPHERE_SCALE_M[-1]
    value = np.exp(spline(inside) - above)
    slope = np.where(height_m < low, 0.0, spline(inside, 1))
    return value, value * slope


def height_along_radius(
    position_m: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the height above the ellipsoid along the radius, metres, and its gradient.

    At 1000 km it is at most 6 m less than that along the ellipsoid's normal, which is of no weight
    where the density halves over kilometres, and needs no iteration.

    Parameters
    ----------
    position_m
        Shape (n, 3), ECEF.

    Returns
    -------
    height_m
        Shape (n,).
    by_position
        Shape (n, 3).
    """
    r = np.linalg.norm(position_m, axis=1)
    up = position_m / r[:, None]
    s = up[:, 2]
    oblate = 1.0 / (1.0 - EARTH_FLATTENING) ** 2 - 1.0
    root = np.sqrt(1.0 + oblate * s**2)
    by_sine = EARTH_RADIUS_M * oblate * s / root**3
    turn = -s[:, None] * up
    turn[:, 2] += 1.0
    return r - EARTH_RADIUS_M / root, up + (by_sine / r)[:, None] * turn


def drag(
    position_m: NDArray[np.float64], velocity_m_s: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the drag of a ballistic coefficient of 1 m^2/kg, and its derivatives.

    Parameters
    ----------
    position_m, velocity_m_s
        Shape (n, 3), ECEF.

    Returns
    -------
    acceleration_m_s2
        Shape (n, 3).
    by_position, by_velocity
        Shape (n, 3, 3).
    """
    height, by_position = height_along_radius(position_m)
    rho, by_height = density(height)
    speed = np.linalg.norm(velocity_m_s, axis=1)
    unit = -0.5 * speed[:, None] * velocity_m_s
    along = velocity_m_s / np.where(speed > 0.0, speed, 1.0)[:, None]
    turning = speed[:, None, None] * np.eye(3) + velocity_m_s[:, :, None] * along[:, None, :]
    return (
        rho[:, None] * unit,
        by_height[:, None, None] * unit[:, :, None] * by_position[:, None, :],
        -0.5 * rho[:, None, None] * turning,
    )


def resting_axes(time_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the axes of ECEF at time zero, kept at rest, as columns in ECEF, shape (n, 3, 3)."""
    angle = EARTH_ROTATION_RAD_S * time_s
    cos, sin, zero = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    rows = [cos, sin, zero, -sin, cos, zero, zero, zero, zero + 1.0]
    return np.stack(rows, axis=1).reshape(-1, 3, 3)


def along_orbit(
    position_m: NDArray[np.float64],
    velocity_m_s: NDArray[np.float64],
    components: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return a vector given along radial, transverse and normal axes of the orbit.

    Radial is away from the Earth, normal along the angular momentum in axes at rest, transverse
    completes them (CCSDS 500.0-G-4, section 4.3.7.2).

    Parameters
    ----------
    position_m, velocity_m_s
        Shape (n, 3), ECEF.
    components
        Shape (n, 3).

    Returns
    -------
    vector
        Shape (n, 3), ECEF.
    axes
        Shape (n, 3, 3): radial, transverse, normal as columns.
    by_position, by_velocity
        Shape (n, 3, 3): derivatives of the vector.
    """
    eye = np.eye(3)
    r = np.linalg.norm(position_m, axis=1)
    radial = position_m / r[:, None]
    resting = velocity_m_s + np.cross(_SPIN, position_m)
    momentum = np.cross(position_m, resting)
    size = np.linalg.norm(momentum, axis=1)
    normal = momentum / size[:, None]
    transverse = np.cross(normal, radial)
    axes = np.stack([radial, transverse, normal], axis=2)
    radial_by_p = (eye - radial[:, :, None] * radial[:, None, :]) / r[:, None, None]
    across = (eye - normal[:, :, None] * normal[:, None, :]) / size[:, None, None]
    normal_by_v = across @ _cross(position_m)
    normal_by_p = normal_by_v @ _cross(_SPIN[None]) - across @ _cross(resting)
    by_normal, by_radial = -_cross(radial), _cross(normal)
    a, b, c = (components[:, index, None, None] for index in range(3))
    by_velocity = b * (by_normal @ normal_by_v) + c * normal_by_v
    by_position = (
        a * radial_by_p + b * (by_normal @ normal_by_p + by_radial @ radial_by_p) + c * normal_by_p
    )
    return np.einsum("nij,nj->ni", axes, components), axes, by_position, by_velocity


def _cross(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrices of cross products with vectors from the left, shape (n, 3, 3)."""
    x, y, z = vector.T
    zero = np.zeros_like(x)
    rows = [zero, -z, y, z, zero, -x, -y, x, zero]
    return np.stack(rows, axis=1).reshape(-1, 3, 3)
