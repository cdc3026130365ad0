"""Further first guesses where arrivals and differences do not fit the estimate.

First guesses take the errors of clocks for white noise. Where those errors are wide, such a guess
cannot tell a path from its mirror image behind the plane of the sensors, or is nowhere near; the
solver, to which they are constants, ends in a minimum that leaves residuals far outside. Then the
mirror image of that minimum is tried, and, where the clocks are as loose as the sensors are apart,
straight paths through and past them. An estimate that does fit may be the mirror image of the
truth, too, where the sensors are nearly in a plane: it is held against its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from geograph.families import Values
from geograph.initialise import PathFit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.prepare import Prepared
    from geograph.problem import Problem
    from geograph.rivals import Attempt

_FEWEST_SENSORS = 3

# Sensors whose spread across a plane is more than this share of that along it tell the sides apart.
_THICK = 0.5
_DIRECTIONS = 8

# Clocks are loose where their priors, as lengths, are above this share of the spread of sensors.
_LOOSE = 0.3


def further_fits(prepared: Prepared, attempt: Attempt, *, misfit: bool) -> list[PathFit]:
    """Return more first guesses for a recording whose best attempt does not fit.

    Parameters
    ----------
    prepared
        The recording.
    attempt
        The best of those made.
    misfit
        Whether that leaves residuals far outside. Clocks that are loose ask for more guesses
        without it, too.

    Returns
    -------
    fits
        None where nothing but bearings was measured, or by fewer than three sensors.
    """
    places = _places(prepared)
    if set(prepared.recording.tables) <= {"bearings"} or len(places) < _FEWEST_SENSORS:
        return []
    middle, axes, flat = _plane(places)
    found = []
    if misfit and flat:
        mirror = _mirrored(attempt, middle, axes[2])
        found += [] if mirror is None else [mirror]
    radius = float(np.linalg.norm(places - middle, axis=1).mean())
    clocks = [prepared.sensors[i].errors.clock_offset_s for i in _active(prepared)]
    if np.median(clocks) * prepared.recording.propagation_speed_m_s > _LOOSE * radius > 0.0:
        found += _straight(prepared, middle, axes, radius)
    return found


def mirror_image(prepared: Prepared, problem: Problem, values: Values) -> Values | None:
    """Return an estimate with its path mirrored in the plane of the sensors.

    Parameters
    ----------
    prepared
        The recording.
    problem, values
        The estimate.

    Returns
    -------
    image
        None where that would be no rival: with bearings, constraints or gravity, which tell the
        sides apart, or with fewer than three sensors, or none in a plane.
    """
    recording = prepared.recording
    told = recording.bearings is not None or recording.constraints is not None
    if told or problem.motion.ballistic:
        return None
    places = _places(prepared)
    if len(places) < _FEWEST_SENSORS:
        return None
    middle, axes, flat = _plane(places)
    if not flat:
        return None
    normal = axes[2]
    path = values.path.copy()
    path[:, :3] -= middle
    for block in range(0, 3 * problem.motion.order, 3):
        own = path[:, block : block + 3]
        own -= 2.0 * (own @ normal)[:, None] * normal
    path[:, :3] += middle
    return Values(path, values.walks, values.constants)


def _plane(places_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], bool]:
    """Return the middle of places, their principal axes in rows, and whether they are flat."""
    middle = places_m.mean(axis=0)
    _, spread, axes = np.linalg.svd(places_m - middle, full_matrices=True)
    spread = np.append(spread, np.zeros(3 - spread.size))
    return middle, axes, bool(spread[1] > 0.0 and spread[2] < _THICK * spread[1])


def _active(prepared: Prepared) -> NDArray[np.int64]:
    """Return the indices of the sensors that measured."""
    tables = prepared.recording.tables.values()
    used = [table.sensor for table in tables]
    used += [table.reference for table in tables if hasattr(table, "reference")]
    return np.unique(np.concatenate(used))


def _places(prepared: Prepared) -> NDArray[np.float64]:
    """Return where the sensors that measured are in the middle of the recording, shape (n, 3)."""
    low, high = prepared.recording.time_span_s
    sensors = [prepared.sensors[index] for index in _active(prepared)]
    return np.array([sensor.position_at(np.array([0.5 * (low + high)]))[0] for sensor in sensors])


def _mirrored(
    attempt: Attempt, middle_m: NDArray[np.float64], normal: NDArray[np.float64]
) -> PathFit | None:
    """Return the mirror image of an attempt's path in a plane."""
    knots, path = attempt.problem.knots_s, attempt.solution.values.path[:, :3]
    if not np.isfinite(path).all():
        return None
    image = path - 2.0 * ((path - middle_m) @ normal)[:, None] * normal
    spline = (
        make_interp_spline(knots, image, k=min(3, knots.size - 1))
        if knots.size > 1
        else BSpline(np.array([knots[0] - 0.5, knots[0] + 0.5]), image, 0)
    )
    return PathFit(spline, attempt.fit.clock_s, attempt.fit.score, attempt.fit.range_m, 0.0)


def _straight(
    prepared: Prepared,
    middle_m: NDArray[np.float64],
    axes: NDArray[np.float64],
    radius_m: float,
) -> list[PathFit]:
    """Return straight paths across the sensors, on both sides of their plane, in all directions."""
    low, high = prepared.recording.time_span_s
    high = high if high > low else low + 1.0
    clocks = np.zeros(len(prepared.sensors))
    angles = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    found = []
    for side in (-0.5, 0.5):
        for angle in angles:
            ahead = np.cos(angle) * axes[0] + np.sin(angle) * axes[1]
            start = middle_m + radius_m * (side * axes[2] - ahead)
            ends = np.stack([start, start + 2.0 * radius_m * ahead])
            spline = BSpline(np.array([low, low, high, high]), ends, 1)
            found.append(PathFit(spline, clocks, 0.0, radius_m, 0.0))
    return found
