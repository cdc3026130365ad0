"""A recording's geometry at a known path: its problem as if it were measured without any error.

What a bound needs, and nothing is solved: only times, sensors and sigmas of the measurements enter.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from geograph.eliminate import NotPositiveDefiniteError
from geograph.families import BearingFamily
from geograph.initialise import PathFit
from geograph.losses import Loss
from geograph.prepare import prepare
from geograph.smoother import Smoother
from geograph.solver import Solution, Status

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from geograph.families import Values
    from geograph.measurements import Truth
    from geograph.problem import Problem
    from geograph.recording import Recording, SmoothSettings

# A truth table may leave out this share of the measurements' span at either end, where the path
# is continued straight on.
_TRUTH_SLACK = 0.1


def covers(truth: Truth, recording: Recording, *, static: bool) -> bool:
    """Tell whether a truth table covers the span of a recording's measurements.

    Parameters
    ----------
    truth
        The table.
    recording
        The measurements.
    static
        Whether the object stands still: one row is then enough.
    """
    low, high = recording.time_span_s
    if static or not len(truth):
        return bool(len(truth))
    slack = _TRUTH_SLACK * (high - low)
    return bool(truth.time_s[0] <= low + slack and truth.time_s[-1] >= high - slack)


def truth_path(truth: Truth, recording: Recording, *, static: bool) -> PathFit:
    """Return the true path in the form of a first guess.

    Parameters
    ----------
    truth
        The table, with at least one row.
    recording
        For the distance from its sensors.
    static
        Whether the object stands still, at the mean of the table's positions.
    """
    if static or len(truth) == 1:
        return point_path(truth.position_m.mean(axis=0), recording)
    degree = min(3, len(truth) - 1)
    return _fit(make_interp_spline(truth.time_s, truth.position_m, k=degree), recording)


def point_path(position_m: ArrayLike, recording: Recording) -> PathFit:
    """Return an object that stands still, shape (3,), in the form of a first guess."""
    low, high = recording.time_span_s
    ends = np.array([low, high if high > low else low + 1.0])
    return _fit(BSpline(ends, np.asarray(position_m, dtype=np.float64).reshape(1, 3), 0), recording)


def _fit(spline: BSpline, recording: Recording) -> PathFit:
    fit = PathFit(spline, np.zeros(len(recording.sensors)), 0.0, 1.0, 0.0)
    away = distances(recording, lambda time_s: fit.state(time_s, 1))
    return replace(fit, range_m=float(np.median(away)))


def distances(
    recording: Recording, position_at: Callable[[NDArray[np.float64]], NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Return the distances from the sensors at all measurements, shape (n,), metres.

    Parameters
    ----------
    recording
        Sensors and times.
    position_at
        The path: positions, shape (n, 3), at times, shape (n,).
    """
    found = []
    for table in recording.tables.values():
        position = position_at(table.time_s)
        for index, sensor in enumerate(recording.sensors.values()):
            own = table.sensor == index
            away = position[own] - sensor.position_at(table.time_s[own])
            found.append(np.linalg.norm(away, axis=1))
    return np.concatenate(found)


def planned(recording: Recording, settings: SmoothSettings, fit: PathFit) -> Smoother:
    """Return a smoother that stands at a path, as if it had been measured without any error.

    Parameters
    ----------
    recording
        Times, sensors and sigmas; what was measured does not matter.
    settings
        Motion and process noise.
    fit
        The path.

    Raises
    ------
    InputError
        If the recording has no measurement.
    """
    smoother = _at_path(recording, settings, fit)
    ideal = _with_ideal_bearings(recording, smoother.problem, smoother.solution.values)
    return smoother if ideal is None else _at_path(ideal, settings, fit)


def moved(smoother: Smoother, position_m: NDArray[np.float64]) -> tuple[Problem, Values]:
    """Return the problem of an object that stands still at another place, and that point.

    Parameters
    ----------
    smoother
        Of :func:`planned`, for an object that stands still. Its knots, weak priors and scales are
        kept; they are of no weight.
    position_m
        Shape (3,): the other place.
    """
    problem, values = smoother.problem, smoother.solution.values
    place = np.broadcast_to(position_m, values.path.shape).copy()
    values = replace(values, path=place)
    ideal = _with_ideal_bearings(smoother.prepared.recording, problem, values)
    if ideal is not None:
        problem = problem.changed(families=prepare(ideal).families(problem.knots_s))
    problem.refresh(values)
    return problem, values


def _at_path(recording: Recording, settings: SmoothSettings, fit: PathFit) -> Smoother:
    smoother = Smoother(prepare(recording), settings)
    problem, values = smoother.start(fit, Loss("none"))
    stand_at(smoother, problem, values)
    if settings.spacing_s is not None:
        # What lies between knots that are wide apart is noise, too.
        smoother.bring_up_to_date(values)
    return smoother


def stand_at(smoother: Smoother, problem: Problem, values: Values) -> None:
    """Let a smoother stand at a point, as if it were the solution.

    Parameters
    ----------
    smoother
        Changed in place.
    problem, values
        The point. Its factorisation is absent where the information is singular.
    """
    smoother.problem = problem
    smoother.solution = Solution(values, Status.CONVERGED, 0.0, 0, None)


def factorised(smoother: Smoother) -> None:
    """Factorise the problem where a smoother stands; see :func:`stand_at`."""
    values = smoother.solution.values
    system = smoother.problem.linearise(values)
    try:
        elimination = system.factorise()
    except NotPositiveDefiniteError:
        return
    smoother.solution = Solution(values, Status.CONVERGED, system.cost, 0, elimination)


def _with_ideal_bearings(
    recording: Recording, problem: Problem, values: Values
) -> Recording | None:
    """Return the recording with bearings that point at the path, or None if it has no bearings.

    They are linearised about the measured direction, which a plan need not have right.
    """
    for family in problem.families:
        if isinstance(family, BearingFamily):
            predicted, _, _ = family.predicted(problem.path, values)
            elevation = np.where(family.azimuth_only, np.nan, predicted[:, 1])
            table = replace(family.bearings, azimuth_rad=predicted[:, 0], elevation_rad=elevation)
            # What the family holds is free of refraction already.
            sensors = {
                name: replace(sensor, refraction="none")
                for name, sensor in recording.sensors.items()
            }
            return replace(recording, bearings=table, sensors=sensors)
    return None
