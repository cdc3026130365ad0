"""First guesses of orbits from directions: two of them joined, then free fall through all.

Of a circular orbit two directions leave one unknown, the distance at the first: the radius follows,
with it where the second line of sight is met, the plane, and the speed. That distance is scanned,
and the best circles through the first directions are where a fit of free fall begins
(O. Montenbruck, E. Gill, *Satellite Orbits*, 2000, sections 2.4 and 8.1, for both steps). Where no
circle leads to a fit, the orbit is not one: both distances are scanned, and an orbit of any
eccentricity laid through each pair (R. H. Gooding, *A new procedure for the solution of the
classical problem of minimal orbit determination from three lines of sight*, Celest. Mech. Dyn.
Astron. 66, 1996, searches the same two distances). The fit takes up later directions little by
little, so that each finds an orbit that is already near.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import least_squares

from geograph.constants import (
    EARTH_GM_M3_S2,
    EARTH_RADIUS_M,
    EARTH_ROTATION_RAD_S,
    SPEED_OF_LIGHT_M_S,
)
from geograph.factors.light_time import turn_to_reception
from geograph.initialise import PathFit
from geograph.orbit_arcs import along, lambert
from geograph.shooting import fall

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from geograph.factors.forces import Forces
    from geograph.initialise import FirstGuess
    from geograph.lines import Lines

_SPIN = np.array([0.0, 0.0, EARTH_ROTATION_RAD_S])
_FIRST_S = 1800.0
_FIRST_TIMES = 6
_GROWTH = 3.0
_NEAREST_M, _FARTHEST_M, _DISTANCES = 1.5e5, 6e7, 600
_CIRCLES = 3
_SPLINE_S = 30.0
# Root mean square of residuals, in sigmas, beyond which a fit is not trusted; and that from which
# another kind of orbit is tried.
_MISFIT = 10.0
_DOUBTFUL = 1.5
# From so many sigmas down a trial is fitted to its end.
_PROMISING = 300.0
# Width of the loss, in sigmas; how often a fit goes on, and the share that is no progress.
_WIDTH = 3.0
_SETTLING, _STILL = 6, 0.9
# Orbits through the first directions that may try to take up the others.
_GROWN = 4
# From so many directions on, what fits is the orbit, and no other one fits better by chance.
_MANY = 50

# Steps of a fit, and of a trial.
_STEPS, _TRIAL_STEPS = 30, 12

# Distances of an eccentric orbit at both directions; directions that judge it; orbits refined.
_ARC_DISTANCES = 70
_JUDGES = 12
_ARCS = 6
_REFINEMENTS = 15
_LOG_STEP, _LONGEST_LOG_STEP = 1e-5, 0.3


def orbit_fits(finder: FirstGuess, forces: Forces | None = None) -> list[PathFit]:
    """Return the orbit through all directions, or nothing if none fits.

    Parameters
    ----------
    finder
        Bearings of a recording in ECEF, and their sensors.
    forces
        What acts beside gravity; what is unknown of it is fitted, too.
    """
    clock = np.zeros(len(finder.sensors))
    lines = finder.lines(clock)
    times = np.unique(lines.time_s)
    start, last = float(times[0]), float(times[-1])
    if lines.azimuth_only.any() or times.size < 3:
        return []
    span = max(_FIRST_S, float(times[min(_FIRST_TIMES, times.size) - 1]) - start)
    early = lines.time_s <= start + span
    found: list[_Fit] = []
    for search in (_circles, _arcs):
        for state in search(_early(lines, start, early)):
            fit = _fitted(lines, start, state, early, most=_TRIAL_STEPS)
            if fit.misfit < _PROMISING:
                found.append(_whole_fit(lines, start, fit, early, forces))
                if found[-1].misfit < _DOUBTFUL and early.sum() >= _MANY:
                    break
        found.sort(key=lambda fit: (fit.beyond, fit.misfit))
        # By chance a wrong orbit meets few directions well, but not as well as the right one, and
        # one that is far enough away meets any.
        good = bool(found) and not found[0].beyond and found[0].misfit < _good(early)
        if search is _circles and not good:
            continue
        for fit in found[:_GROWN]:
            best = _grown(lines, start, span, fit, forces)
            if best is not None:
                return [_path(lines, start, last, best, clock)]
        found.clear()
    return []


def _good(rows: NDArray[np.bool_]) -> float:
    """Return the misfit up to which nothing speaks against an orbit through so many directions.

    Two standard deviations of the robust scale of as many white residuals (1.17 over the root of
    their number, of which a direction has two).
    """
    return min(_DOUBTFUL, 1.0 + 2.0 * 1.17 / float(np.sqrt(2.0 * rows.sum())))


def _grown(
    lines: Lines, start_s: float, span_s: float, best: _Fit, forces: Forces | None
) -> _Fit | None:
    """Return an orbit that has taken up all directions, or None where it does not meet them."""
    last = float(lines.time_s.max())
    while start_s + span_s < last:
        span_s *= _GROWTH
        best = _whole_fit(lines, start_s, best, lines.time_s <= start_s + span_s, forces)
        if best.misfit > _PROMISING:
            return None
    return best if best.misfit <= _MISFIT else None


def _path(
    lines: Lines, start: float, last: float, best: _Fit, clock: NDArray[np.float64]
) -> PathFit:
    """Return an orbit as a spline."""
    count = max(int(np.ceil((last - start) / _SPLINE_S)), 6)
    time = np.linspace(start - 1.0, last + 1.0, count + 1)
    positions = fall(best.state, start, time, best.forces)[0][:, :3]
    spline = make_interp_spline(time, positions, k=5)
    distance = np.linalg.norm(spline(lines.time_s) - lines.sensor_m, axis=1)
    return PathFit(spline, clock, 0.0, float(np.median(distance)), 0.0)


@dataclass(frozen=True, eq=False)
class _Fit:
    """An orbit through some directions.

    Attributes
    ----------
    misfit
        Robust root mean square residual, in sigmas.
    state
        At the start, ECEF, with the forces' unknowns behind it.
    forces
        What it was fitted with, beside gravity.
    """

    misfit: float
    state: NDArray[np.float64]
    forces: Forces | None

    @property
    def beyond(self) -> bool:
        """Whether it is farther away than any that was looked for."""
        return float(np.linalg.norm(self.state[:3])) > 2.0 * _FARTHEST_M


@dataclass(frozen=True, eq=False)
class _Early:
    """The first directions on axes at rest, those of ECEF at the start."""

    time_s: NDArray[np.float64]
    place_m: NDArray[np.float64]
    direction: NDArray[np.float64]
    sigma: NDArray[np.float64]

    def scores(self, position_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return angles to places, shape (n, k, 3), over sigmas, shape (n, k)."""
        sight = position_m - self.place_m
        cosine = np.einsum("nki,ki->nk", sight, self.direction) / np.linalg.norm(sight, axis=2)
        return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)) / self.sigma)

    def some(self, rows: NDArray[np.int64]) -> _Early:
        """Return some of them."""
        return _Early(self.time_s[rows], self.place_m[rows], self.direction[rows], self.sigma[rows])


def _early(lines: Lines, start_s: float, early: NDArray[np.bool_]) -> _Early:
    time = lines.time_s[early] - start_s
    return _Early(
        time,
        # Turned back by what the Earth turned since.
        turn_to_reception(lines.sensor_m[early], -time, EARTH_ROTATION_RAD_S),
        turn_to_reception(lines.direction[early], -time, EARTH_ROTATION_RAD_S),
        np.hypot(*lines.sigma[early].T),
    )


def _arcs(early: _Early) -> list[NDArray[np.float64]]:
    """Return the best orbits of any eccentricity, states in ECEF at the start, shape (6,) each."""
    sequence = np.argsort(early.time_s, kind="stable")
    judged = early.some(sequence[np.linspace(0, sequence.size - 1, _JUDGES).astype(np.int64)])
    time, first, second = judged.time_s, 0, _JUDGES - 1
    gap = float(time[second] - time[first])
    if not gap > 0.0:
        return []
    scanned = np.geomspace(_NEAREST_M, _FARTHEST_M, _ARC_DISTANCES)
    pairs = np.stack(np.meshgrid(scanned, scanned, indexing="ij"), axis=-1).reshape(-1, 2)

    def orbits(
        distance: NDArray[np.float64], *, far: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return places and velocities at the start, and angles missed, of pairs of distances."""
        r1 = judged.place_m[first] + distance[:, :1] * judged.direction[first]
        r2 = judged.place_m[second] + distance[:, 1:] * judged.direction[second]
        velocity = lambert(r1, r2, gap, far=far)
        return r1, velocity, judged.scores(along(r1, velocity, time - time[first]))

    found: list[tuple[float, NDArray[np.float64]]] = []
    for far in (False, True):
        r1, _, missed = orbits(pairs, far=far)
        score = np.mean(missed**2, axis=1)
        inside = np.linalg.norm(r1, axis=1) < EARTH_RADIUS_M
        score = np.where(np.isfinite(score) & ~inside, score, np.inf).reshape(2 * [scanned.size])
        edged = np.pad(score, 1, constant_values=np.inf)
        around = [
            edged[1 + i : edged.shape[0] - 1 + i, 1 + j : edged.shape[1] - 1 + j]
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
            if i or j
        ]
        least = np.flatnonzero((score <= np.min(around, axis=0)) & np.isfinite(score))
        least = least[np.argsort(score.ravel()[least])][:_ARCS]
        if not least.size:
            continue
        solved = _refined(partial(orbits, far=far), pairs[least])
        for place, speed, missed in zip(*orbits(solved, far=far), strict=True):
            if np.isfinite(missed).all():
                moving = speed - np.cross(_SPIN, place)
                found.append((float(np.mean(missed**2)), np.concatenate([place, moving])))
    found.sort(key=lambda entry: entry[0])
    return [state for _, state in found[:_CIRCLES]]


def _refined(
    orbits: Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], ...]],
    distance: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return pairs of distances, shape (n, 2), where two bodies come nearest to the directions.

    Levenberg-Marquardt on their logarithms, all pairs at once.
    """
    at = np.log(distance)
    count = len(at)
    damping = np.full(count, 1e-3)
    moves = np.concatenate([np.zeros((1, 2)), _LOG_STEP * np.eye(2)])

    def missed(logarithm: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.nan_to_num(orbits(np.exp(logarithm))[2], nan=1e9, posinf=1e9)

    for _ in range(_REFINEMENTS):
        here, first, second = missed((at + moves[:, None]).reshape(-1, 2)).reshape(3, count, -1)
        slope = np.stack([first - here, second - here], axis=2) / _LOG_STEP
        square = np.swapaxes(slope, 1, 2) @ slope
        diagonal = np.einsum("nii->ni", square)
        diagonal += damping[:, None] * diagonal + 1e-12
        gradient = np.einsum("nki,nk->ni", slope, here)
        step = np.linalg.solve(square, gradient[..., None])[..., 0]
        there = at - np.clip(step, -_LONGEST_LOG_STEP, _LONGEST_LOG_STEP)
        better = np.sum(missed(there) ** 2, axis=1) < np.sum(here**2, axis=1)
        at = np.where(better[:, None], there, at)
        damping *= np.where(better, 0.1, 30.0)
    return np.asarray(np.exp(at))


def _circles(early: _Early) -> list[NDArray[np.float64]]:
    """Return the best circular orbits, states in ECEF at the start, shape (6,) each."""
    time, place, direction = early.time_s, early.place_m, early.direction
    first, second = int(np.argmin(time)), int(np.argmax(time))
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
        score = np.where(possible, np.mean(early.scores(at) ** 2, axis=1), np.inf)
        edge = np.concatenate([[np.inf], score, [np.inf]])
        for index in np.flatnonzero((score < edge[:-2]) & (score <= edge[2:])):
            velocity = rate[index] * aside[index] - np.cross(_SPIN, r1[index])
            found.append((float(score[index]), np.concatenate([r1[index], velocity])))
    found.sort(key=lambda entry: entry[0])
    return [state for _, state in found[:_CIRCLES]]


def _whole_fit(
    lines: Lines,
    start_s: float,
    best: _Fit,
    rows: NDArray[np.bool_],
    forces: Forces | None,
) -> _Fit:
    """Return a fit of free fall, or with the forces where that one is not good, or was not.

    Free fall is propagated a hundred times as quickly, and most forces move an object by less than
    its first guess has to be good for.
    """
    if best.forces is None:
        best = _settled(lines, start_s, best, rows, None)
        if forces is None or best.misfit < _DOUBTFUL:
            return best
    return _settled(lines, start_s, best, rows, forces)


def _settled(
    lines: Lines, start_s: float, best: _Fit, rows: NDArray[np.bool_], forces: Forces | None
) -> _Fit:
    """Return a fit that is not on its way any more.

    Far off, a loss that is as narrow as the noise has hardly a slope: it is as wide as the misfit
    first.
    """
    width = max(best.misfit, _WIDTH)
    found = _fitted(lines, start_s, best.state, rows, forces, width=width)
    for _ in range(_SETTLING):
        before = found
        if found.misfit < _DOUBTFUL and width <= _WIDTH:
            break
        width = max(min(found.misfit, 0.3 * width), _WIDTH)
        found = _fitted(lines, start_s, found.state, rows, forces, width=width)
        if width <= _WIDTH and found.misfit > _STILL * before.misfit:
            break
    return found


def _deviations(
    states: NDArray[np.float64],
    jacobian: NDArray[np.float64],
    place_m: NDArray[np.float64],
    *,
    across: NDArray[np.float64],
    sigma: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how far directions are from states at reception, in sigmas, and derivatives.

    Parameters
    ----------
    states, jacobian
        Shapes (n, 6), (n, 6, k): ECEF, and derivatives by k unknowns.
    place_m
        Shape (n, 3): sensors.
    across, sigma
        Shapes (n, 2, 3), (n, 2): unit vectors across each direction, and sigmas along them.

    Returns
    -------
    residual, derivative
        Shapes (2 n,), (2 n, k).
    """
    # The object was farther back when the light left, in axes that do not turn.
    inertial = states[:, 3:] + np.cross(_SPIN, states[:, :3])
    delay = np.linalg.norm(states[:, :3] - place_m, axis=1) / SPEED_OF_LIGHT_M_S
    sight = states[:, :3] - delay[:, None] * inertial - place_m
    distance = np.linalg.norm(sight, axis=1)
    white = 1.0 / (sigma * distance[:, None])
    residual = np.einsum("nki,ni->nk", across, sight) * white
    by_state = np.einsum("nki,nij->nkj", across, jacobian[:, :3]) * white[..., None]
    by_distance = np.einsum("ni,nij->nj", sight, jacobian[:, :3]) / distance[:, None] ** 2
    by_state -= residual[..., None] * by_distance[:, None]
    return residual.ravel(), by_state.reshape(residual.size, -1)


def _fitted(
    lines: Lines,
    start_s: float,
    state: NDArray[np.float64],
    rows: NDArray[np.bool_],
    forces: Forces | None = None,
    *,
    most: int = _STEPS,
    width: float = _WIDTH,
) -> _Fit:
    """Return the orbit through some directions.

    The forces' unknowns, behind the state, are held by their priors.
    """
    time, place = lines.time_s[rows], lines.sensor_m[rows]
    across, sigma = lines.across[rows], lines.sigma[rows]
    prior = np.zeros(0) if forces is None else forces.sigma
    held = np.concatenate([np.zeros((prior.size, 6)), np.diag(1.0 / prior)], axis=1)
    kept: dict[bytes, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}

    def evaluate(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        key = x.tobytes()
        if key not in kept:
            kept.clear()
            # A trial may lead through the Earth's centre; what is not finite is told below.
            with np.errstate(all="ignore"):
                states, jacobian = fall(x, start_s, time, forces)
                found = _deviations(states, jacobian, place, across=across, sigma=sigma)
            if not (np.isfinite(found[0]).all() and np.isfinite(found[1]).all()):
                found = np.full(residual.size, 1e9), np.zeros((residual.size, x.size))
            kept[key] = found
        return kept[key]

    def residuals(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([evaluate(x)[0], x[6:] / prior])

    def derivatives(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([evaluate(x)[1], held])

    solved = least_squares(
        residuals,
        np.concatenate([state, np.zeros(6 + prior.size - state.size)]),
        jac=derivatives,
        x_scale=np.concatenate([np.repeat([1e5, 1e2], 3), prior]),
        loss="cauchy",
        f_scale=width,
        max_nfev=most,
    )
    residual = evaluate(solved.x)[0]
    return _Fit(float(np.sqrt(np.median(residual**2)) / 0.6745), solved.x, forces)
