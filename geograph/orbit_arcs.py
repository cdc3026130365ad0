"""Orbits through two places in a given time, and along them: two bodies, many at once.

Universal variables: R. R. Bate, D. D. Mueller, J. E. White, *Fundamentals of Astrodynamics*, 1971,
sections 4.4 and 5.3; the bisection is that of D. A. Vallado, *Fundamentals of Astrodynamics and
Applications*, 4th ed., 2013, algorithm 58. Axes are at rest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.constants import EARTH_GM_M3_S2

if TYPE_CHECKING:
    from numpy.typing import NDArray

_ROOT_GM = float(np.sqrt(EARTH_GM_M3_S2))
_BISECTIONS = 50
_NEWTON_STEPS = 25
_SERIES = 1e-3


def stumpff(psi: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (1 - cos x) / x^2 and (x - sin x) / x^3 of x^2 = psi, of any sign, in its shape."""
    root = np.sqrt(np.abs(psi))
    safe = np.where(root > _SERIES, root, 1.0)
    ellipse = psi > 0.0
    cosine = np.where(ellipse, np.cos(safe), np.cosh(np.minimum(safe, 300.0)))
    sine = np.where(ellipse, np.sin(safe), np.sinh(np.minimum(safe, 300.0)))
    c2 = np.abs(1.0 - cosine) / safe**2
    c3 = np.abs(safe - sine) / safe**3
    small = root <= _SERIES
    return (
        np.where(small, 0.5 - psi / 24.0, c2),
        np.where(small, 1.0 / 6.0 - psi / 120.0, c3),
    )


def lambert(
    first_m: NDArray[np.float64], second_m: NDArray[np.float64], time_s: float, *, far: bool
) -> NDArray[np.float64]:
    """Return velocities at the first place, shape (n, 3), m/s; not numbers where there are none.

    Parameters
    ----------
    first_m, second_m
        Shape (n, 3).
    time_s
        From the first to the second, in less than a revolution.
    far
        Whether the way is that of more than half a turn.
    """
    r1, r2 = np.linalg.norm(first_m, axis=1), np.linalg.norm(second_m, axis=1)
    product = np.maximum(r1 * r2 + np.einsum("ni,ni->n", first_m, second_m), 0.0)
    size = (-1.0 if far else 1.0) * np.sqrt(product)
    low, high = np.full(r1.size, -4.0 * np.pi**2), np.full(r1.size, 4.0 * np.pi**2)

    def reach(psi: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        c2, c3 = stumpff(psi)
        y = r1 + r2 + size * (psi * c3 - 1.0) / np.sqrt(c2)
        held = np.maximum(y, 0.0)
        lasts = (np.sqrt(held / c2) ** 3 * c3 + size * np.sqrt(held)) / _ROOT_GM
        return y, lasts

    for _ in range(_BISECTIONS):
        psi = 0.5 * (low + high)
        y, lasts = reach(psi)
        short = (lasts < time_s) | (y < 0.0)
        low, high = np.where(short, psi, low), np.where(short, high, psi)
    y, lasts = reach(0.5 * (low + high))
    good = (y > 0.0) & (np.abs(lasts / time_s - 1.0) < 1e-3) & (product > 0.0)
    g = size * np.sqrt(np.where(good, y, 1.0)) / _ROOT_GM
    with np.errstate(divide="ignore", invalid="ignore"):
        velocity = (second_m - (1.0 - y / r1)[:, None] * first_m) / g[:, None]
    return np.asarray(np.where(good[:, None], velocity, np.nan))


def along(
    position_m: NDArray[np.float64], velocity_m_s: NDArray[np.float64], time_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return places after times, shape (n, k, 3), metres.

    Parameters
    ----------
    position_m, velocity_m_s
        Shape (n, 3), at time zero.
    time_s
        Shape (k,).
    """
    r = np.linalg.norm(position_m, axis=1)[:, None]
    outward = np.einsum("ni,ni->n", position_m, velocity_m_s)[:, None] / _ROOT_GM
    alpha = 2.0 / r - np.einsum("ni,ni->n", velocity_m_s, velocity_m_s)[:, None] / EARTH_GM_M3_S2
    time = np.broadcast_to(time_s, (r.size, time_s.size))
    chi = _ROOT_GM * time / r
    for _ in range(_NEWTON_STEPS):
        c2, c3 = stumpff(alpha * chi**2)
        reached = outward * chi**2 * c2 + (1.0 - alpha * r) * chi**3 * c3 + r * chi
        distance = chi**2 * c2 * (1.0 - alpha * r) + outward * chi * (1.0 - alpha * chi**2 * c3) + r
        step = (_ROOT_GM * time - reached) / np.maximum(distance, 1e3)
        # From far off a full step may overshoot by revolutions.
        chi = chi + np.clip(step, -2e3, 2e3)
    c2, c3 = stumpff(alpha * chi**2)
    f = 1.0 - chi**2 / r * c2
    g = time - chi**3 * c3 / _ROOT_GM
    return np.asarray(f[..., None] * position_m[:, None] + g[..., None] * velocity_m_s[:, None])
