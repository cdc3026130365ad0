"""First guesses of orbits from directions: a circle through two, then free fall through all.

Of a circular orbit two directions leave one unknown, the distance at the first: the radius follows,
with it where the second line of sight is met, the plane, and the speed. That distance is scanned,
and the best circles through the directions of the first half hour are where a fit of free fall
begins (O. Montenbruck, E. Gill, *Satellite Orbits*, 2000, sections 2.4 and 8.1, for both steps). It
takes up later directions little by little, so that each finds an orbit that is already near.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from scipy.optimize import least_squares

from geograph.constants import (
    EARTH_GM_M3_S2,
    EARTH_RADIUS_M,
    EARTH_ROTATION_RAD_S,
    SPEED_OF_LIGHT_M_S,
)
from geograph.factors.gravity import acceleration
from geograph.factors.light_time import turn_to_reception
from geograph.initialise import PathFit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.initialise import FirstGuess
    from geograph.lines import Lines

_SPIN = np.array([0.0, 0.0, EARTH_ROTATION_RAD_S])
_FIRST_S = 1800.0
_GROWTH = 3.0
_NEAREST_M, _FARTHEST_M, _DISTANCES = 1.5e5, 6e7, 600
_CIRCLES = 3
_SPLINE_S = 30.0
# Root mean square of residuals, in sigmas, beyond which a fit is not trusted.
_MISFIT = 10.0


def orbit_fits(finder: FirstGuess) -> list[PathFit]:
    """Return the orbit through all directions, or nothing if none fits.

    Parameters
    ----------
    finder
        Bearings of a recording in ECEF, and their sensors.
    """
    clock = np.zeros(len(finder.sensors))
    lines = finder.lines(clock)
    start = float(lines.time_s.min())
    if lines.azimuth_only.any() or not np.ptp(lines.time_s) > 0.0:
        return []
    best: tuple[float, NDArray[np.float64]] | None = None
    early = lines.time_s <= start + _FIRST_S
    for state in _circles(lines, start):
        found = _fitted(lines, start, state, early)
        if best is None or found[0] < best[0]:
            best = found
    if best is None:
        return []
    last, span = float(lines.time_s.max()), _FIRST_S
    while start + span < last:
        span *= _GROWTH
        best = _fitted(lines, start, best[1], lines.time_s <= start + span)
    if best[0] > _MISFIT:
        return []
    count = max(int(np.ceil((last - start) / _SPLINE_S)), 6)
    time = np.linspace(start - 1.0, last + 1.0, count + 1)
    positions = _fall(best[1], start, time)[0][:, :3]
    spline = make_interp_spline(time, positions, k=5)
    distance = np.linalg.norm(spline(lines.time_s) - lines.sensor_m, axis=1)
    return [PathFit(spline, clock, 0.0, float(np.median(distance)), 0.0)]


def _circles(lines: Lines, start_s: float) -> list[NDArray[np.float64]]:
    """Return the best circular orbits, states in ECEF at the start, shape (6,) each."""
    early = lines.time_s <= start_s + _FIRST_S
    time = lines.time_s[early] - start_s
    # Axes at rest, those of ECEF at the start: turned back by what the Earth turned since.
    place = turn_to_reception(lines.sensor_m[early], -time, EARTH_ROTATION_RAD_S)
    direction = turn_to_reception(lines.direction[early], -time, EARTH_ROTATION_RAD_S)
    first, second = int(np.argmin(time)), int(np.argmax(time))
    sigma = np.hypot(*lines.sigma[early].T)
    scanned = np.geomspace(_NEAREST_M, _FARTHEST_M, _DISTANCES)
    r1 = place[first] + scanned[:, None] * direction[first]
    radius = np.linalg.norm(r1, axis=1)
    along = float(place[second] @ direction[second])
    square = along**2 - float(place[second] @ place[second]) + radius**2
    found: list[tuple[float, NDArray[np.float64]]] = []
    for sign in (1.0, -1.0):
        distance = -along + sign * np.sqrt(np.maximum(square, 0.0))
        r2 = place[second] + distance[:, None] * direction[second]
        normal = np.cross(r1, r2)
        length = np.linalg.norm(normal, axis=1)
        possible = (square > 0.0) & (distance > 0.0) & (length > 0.0) & (radius > EARTH_RADIUS_M)
        normal /= np.where(length > 0.0, length, 1.0)[:, None]
        rate = np.sqrt(EARTH_GM_M3_S2 / radius**3)
        aside = np.cross(normal, r1)
        phase = rate[:, None] * time
        at = np.cos(phase)[..., None] * r1[:, None] + np.sin(phase)[..., None] * aside[:, None]
        sight = at - place
        cosine = np.einsum("kni,ni->kn", sight, direction) / np.linalg.norm(sight, axis=2)
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        score = np.where(possible, np.mean((angle / sigma) ** 2, axis=1), np.inf)
        edge = np.concatenate([[np.inf], score, [np.inf]])
        for index in np.flatnonzero((score < edge[:-2]) & (score <= edge[2:])):
            velocity = rate[index] * aside[index] - np.cross(_SPIN, r1[index])
            found.append((float(score[index]), np.concatenate([r1[index], velocity])))
    found.sort(key=lambda entry: entry[0])
    return [state for _, state in found[:_CIRCLES]]


def _fall(
    state: NDArray[np.float64], start_s: float, time_s: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return states at times, shape (n, 6), and derivatives by the first, shape (n, 6, 6).

    Parameters
    ----------
    state
        Shape (6,): at the start, ECEF.
    start_s, time_s
        The start, and times, shape (n,), seconds.
    """

    def rates(_: float, packed: NDArray[np.float64]) -> NDArray[np.float64]:
        x, phi = packed[:6], packed[6:].reshape(6, 6)
        value, by_position, by_velocity = acceleration(x[None, :3], x[None, 3:], "ecef", 4)
        lower = by_position[0] @ phi[:3] + by_velocity[0] @ phi[3:]
        return np.concatenate([x[3:], value[0], phi[3:].ravel(), lower.ravel()])

    order, inverse = np.unique(time_s, return_inverse=True)
    result = np.empty((order.size, 42))
    packed = np.concatenate([state, np.eye(6).ravel()])
    for later in (True, False):
        rows = np.flatnonzero(order >= start_s if later else order < start_s)
        if not rows.size:
            continue
        rows = rows if later else rows[::-1]
        end = order[rows[-1]] + (1.0 if later else -1.0)
        solved = solve_ivp(
            rates,
            (start_s, end),
            packed,
            method="DOP853",
            t_eval=order[rows],
            rtol=1e-10,
            atol=1e-4,
        )
        result[rows] = solved.y.T if solved.y.shape[1] == rows.size else np.nan
    whole = result[inverse]
    return whole[:, :6], whole[:, 6:].reshape(-1, 6, 6)


def _fitted(
    lines: Lines, start_s: float, state: NDArray[np.float64], rows: NDArray[np.bool_]
) -> tuple[float, NDArray[np.float64]]:
    """Return the orbit through some directions and its root mean square residual, in sigmas."""
    time, place = lines.time_s[rows], lines.sensor_m[rows]
    across, sigma = lines.across[rows], lines.sigma[rows]
    kept: dict[bytes, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}

    def evaluate(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        key = x.tobytes()
        if key not in kept:
            kept.clear()
            states, jacobian = _fall(x, start_s, time)
            # The object was farther back when the light left, in axes that do not turn.
            inertial = states[:, 3:] + np.cross(_SPIN, states[:, :3])
            delay = np.linalg.norm(states[:, :3] - place, axis=1) / SPEED_OF_LIGHT_M_S
            sight = states[:, :3] - delay[:, None] * inertial - place
            distance = np.linalg.norm(sight, axis=1)
            white = 1.0 / (sigma * distance[:, None])
            residual = np.einsum("nki,ni->nk", across, sight) * white
            by_state = np.einsum("nki,nij->nkj", across, jacobian[:, :3]) * white[..., None]
            by_distance = np.einsum("ni,nij->nj", sight, jacobian[:, :3]) / distance[:, None] ** 2
            by_state -= residual[..., None] * by_distance[:, None]
            finite = np.isfinite(residual).all() and np.isfinite(by_state).all()
            kept[key] = (
                (residual.ravel(), by_state.reshape(-1, 6))
                if finite
                else (np.full(residual.size, 1e9), np.zeros((residual.size, 6)))
            )
        return kept[key]

    def residuals(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return evaluate(x)[0]

    def derivatives(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return evaluate(x)[1]

    solved = least_squares(
        residuals,
        state,
        jac=derivatives,
        x_scale=np.repeat([1e5, 1e2], 3),
        loss="cauchy",
        f_scale=3.0,
        max_nfev=30,
    )
    residual = evaluate(solved.x)[0]
    return float(np.sqrt(np.median(residual**2)) / 0.6745), solved.x
