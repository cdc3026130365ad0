"""Free fall: the acceleration of an object under gravity alone, and its propagation.

In ECEF axes the acceleration is that of the point mass and of the oblateness (J2), plus the
Coriolis and centrifugal terms of axes that turn with the Earth (O. Montenbruck, E. Gill, *Satellite
Orbits*, 2000, sections 3.2 and 5.2 in a frame turning about z). In a local frame it is standard
gravity downwards (-z).

The model of degree 4 adds the zonal harmonics J3 and J4. That of degree n has the potential energy
V = GM Jn R^n r^-(n+1) Pn(z/r) per mass, and so, with (n + 1) Pn + s Pn' = P'(n+1), the acceleration

    GM Jn R^n / r^(n+2) (P'(n+1) p/r - Pn' e_z).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.constants import (
    EARTH_GM_M3_S2,
    EARTH_J2,
    EARTH_J3,
    EARTH_J4,
    EARTH_RADIUS_M,
    EARTH_ROTATION_RAD_S,
    STANDARD_GRAVITY_M_S2,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.factors.forces import Forces

# The local error of a fourth-order step of 5 s in the lowest orbit is below a micrometre.
_LONGEST_STEP_S = 5.0

Degree = Literal[2, 4]
"""Highest zonal harmonic of a model of the Earth's gravity."""

_CORIOLIS = 2.0 * EARTH_ROTATION_RAD_S * np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 0]])


def acceleration(
    position_m: NDArray[np.float64],
    velocity_m_s: NDArray[np.float64],
    frame: Literal["ecef", "local"],
    degree: Degree = 2,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the acceleration of free fall and its derivatives.

    Parameters
    ----------
    position_m, velocity_m_s
        Shape (n, 3), in the frame; in ECEF away from the Earth's centre.
    frame
        ``"ecef"``: point mass, zonal harmonics, Coriolis, centrifugal; ``"local"``: uniform.
    degree
        2: J2 alone; 4: J2, J3 and J4.

    Returns
    -------
    acceleration_m_s2
        Shape (n, 3).
    by_position, by_velocity
        Shape (n, 3, 3), 1/s^2 and 1/s.
    """
    count = position_m.shape[0]
    if frame == "local":
        value = np.broadcast_to([0.0, 0.0, -STANDARD_GRAVITY_M_S2], (count, 3))
        return value.copy(), np.zeros((count, 3, 3)), np.zeros((count, 3, 3))
    p = position_m
    z = p[:, 2]
    r2 = np.einsum("ni,ni->n", p, p)
    r = np.sqrt(r2)
    # With k = 3/2 J2 GM R^2 / r^5 the oblate part is -k p (1 - 5 z^2/r^2) - 2 k z e_z.
    mass = EARTH_GM_M3_S2 / (r2 * r)
    k = 1.5 * EARTH_J2 * EARTH_RADIUS_M**2 * EARTH_GM_M3_S2 / (r2 * r2 * r)
    ratio = 5.0 * z**2 / r2
    radial = -mass - k * (1.0 - ratio)
    spin2 = EARTH_ROTATION_RAD_S**2
    value = radial[:, None] * p + velocity_m_s @ _CORIOLIS.T
    value[:, 2] -= 2.0 * k * z
    value[:, :2] += spin2 * p[:, :2]

    # d(radial)/dp, with d(mass)/dp = -3 mass p/r^2, dk/dp = -5 k p/r^2 and d(ratio)/dp below.
    by_p = (3.0 * mass + 5.0 * k * (1.0 - ratio) - 2.0 * k * ratio)[:, None] * p / r2[:, None]
    by_p[:, 2] += 10.0 * k * z / r2
    jacobian = radial[:, None, None] * np.eye(3) + p[:, :, None] * by_p[:, None, :]
    jacobian[:, 2, :] += (10.0 * k * z / r2)[:, None] * p
    jacobian[:, 2, 2] -= 2.0 * k
    jacobian[:, 0, 0] += spin2
    jacobian[:, 1, 1] += spin2
    if degree == 4:
        _add_higher_zonals(p, r, value, jacobian)
    return value, jacobian, np.broadcast_to(_CORIOLIS, (count, 3, 3))


def _add_higher_zonals(
    p: NDArray[np.float64],
    r: NDArray[np.float64],
    value: NDArray[np.float64],
    jacobian: NDArray[np.float64],
) -> None:
    """Add the accelerations of J3 and J4, and their derivatives by the position, in place."""
    u = p / r[:, None]
    s = u[:, 2]
    # Of P4', P4'', P3', P3'', and of P5', P5'', P4', P4''.
    third = (35.0 * s**3 - 15.0 * s) / 2.0, (105.0 * s**2 - 15.0) / 2.0
    second = (15.0 * s**2 - 3.0) / 2.0, 15.0 * s
    fourth = (315.0 * s**4 - 210.0 * s**2 + 15.0) / 8.0, (315.0 * s**3 - 105.0 * s) / 2.0
    # s changes by (e_z - s u) . dp / r.
    turn = -s[:, None] * u
    turn[:, 2] += 1.0
    for n, harmonic, (a, da), (b, db) in (
        (3, EARTH_J3, third, second),
        (4, EARTH_J4, fourth, third),
    ):
        size = EARTH_GM_M3_S2 * harmonic * EARTH_RADIUS_M**n / r ** (n + 2)
        value += (size * a)[:, None] * u
        value[:, 2] -= size * b
        size = (size / r)[:, None]
        outward = size * (da[:, None] * turn - ((n + 3) * a)[:, None] * u)
        jacobian += (size * a[:, None])[:, :, None] * np.eye(3) + u[:, :, None] * outward[:, None]
        jacobian[:, 2] -= size * (db[:, None] * turn - ((n + 2) * b)[:, None] * u)


def parts_of(step_s: NDArray[np.float64]) -> int:
    """Return into how many equal steps propagations of these lengths (n,) are divided."""
    longest = float(np.abs(step_s).max(initial=0.0))
    return max(1, int(np.ceil(longest / _LONGEST_STEP_S)))


def total_acceleration(
    state: NDArray[np.float64],
    time_s: NDArray[np.float64] | None,
    frame: Literal["ecef", "local"],
    degree: Degree = 2,
    forces: Forces | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the acceleration under gravity and all other forces, with its derivatives.

    Parameters
    ----------
    state
        Shape (n, 6 + e): position, velocity, and the forces' unknowns.
    time_s
        Shape (n,), seconds after the epoch; None only without forces.
    frame, degree
        See :func:`acceleration`.
    forces
        What acts beside gravity; None: nothing.

    Returns
    -------
    acceleration_m_s2
        Shape (n, 3).
    by_position, by_velocity, by_unknown
        Shapes (n, 3, 3), (n, 3, 3), (n, 3, e).
    """
    position, velocity, unknown = state[:, :3], state[:, 3:6], state[:, 6:]
    value, by_position, by_velocity = acceleration(position, velocity, frame, degree)
    if forces is None or time_s is None:
        return value, by_position, by_velocity, np.zeros((*value.shape, unknown.shape[1]))
    added, by_p, by_v, by_unknown = forces.acceleration(position, velocity, unknown, time_s)
    return value + added, by_position + by_p, by_velocity + by_v, by_unknown


def propagate(
    state: NDArray[np.float64],
    step_s: NDArray[np.float64],
    frame: Literal["ecef", "local"],
    degree: Degree = 2,
    *,
    forces: Forces | None = None,
    start_s: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Propagate free fall, with the exact derivative of the propagation.

    Classical fourth-order Runge-Kutta on the state and its variational equations, in equal steps of
    at most 5 s.

    Parameters
    ----------
    state
        Shape (n, 6 + e): position and velocity in the frame, metres and metres per second, and the
        forces' unknowns, which are constant.
    step_s
        Shape (n,): how far each is propagated, seconds (negative: back in time).
    frame, degree
        See :func:`acceleration`.
    forces, start_s
        What acts beside gravity, and when each starts, shape (n,), seconds after the epoch.

    Returns
    -------
    state
        Shape (n, 6 + e).
    jacobian
        Shape (n, 6 + e, 6 + e): derivative of the result by the given state.
    """
    step = np.asarray(step_s, dtype=np.float64)
    parts = parts_of(step)
    h = (step / parts)[:, None]
    x = np.array(state, dtype=np.float64)
    count, size = x.shape
    still = np.zeros((count, size - 6))
    jacobian = np.broadcast_to(np.eye(size), (count, size, size)).copy()
    # Rows of the unknowns stay those of the identity.
    phi = jacobian[:, :6].copy()

    def rates(
        x: NDArray[np.float64], phi: NDArray[np.float64], share: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        time = None if start_s is None else start_s + share * step
        value, by_p, by_v, by_u = total_acceleration(x, time, frame, degree, forces)
        lower = by_p @ phi[:, :3] + by_v @ phi[:, 3:]
        lower[:, :, 6:] += by_u
        return np.concatenate([x[:, 3:6], value, still], axis=1), np.concatenate(
            [phi[:, 3:], lower], 1
        )

    for part in range(parts):
        first, middle, last = part / parts, (part + 0.5) / parts, (part + 1) / parts
        k1, m1 = rates(x, phi, first)
        k2, m2 = rates(x + 0.5 * h * k1, phi + 0.5 * h[..., None] * m1, middle)
        k3, m3 = rates(x + 0.5 * h * k2, phi + 0.5 * h[..., None] * m2, middle)
        k4, m4 = rates(x + h * k3, phi + h[..., None] * m3, last)
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        phi = phi + h[..., None] / 6.0 * (m1 + 2.0 * m2 + 2.0 * m3 + m4)
    jacobian[:, :6] = phi
    return x, jacobian
