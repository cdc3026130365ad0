"""How well bearings meet: the smoother's own first guess, and each sensor's angle to it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.checkup.effort import CountedGuess, Effort
from geograph.frames import SensorGeometry
from geograph.lines import angle
from geograph.prepare import without_refraction

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.initialise import FirstGuess, PathFit
    from geograph.lines import Lines
    from geograph.measurements import Bearings
    from geograph.recording import Recording
    from geograph.sensors import Sensor

# Bearings that are looked at: of all sensors together, and at most and at least of each.
_ROWS = 600
_MOST_ROWS, _FEWEST_ROWS = 60, 20

# So few bearings do not determine more.
_SEGMENTS = 64

# The share of a sensor's bearings that must lie within what is called its misfit.
SHARE = 0.7

# Misfits up to this many sigmas (biases' priors included), or this angle, need no explanation.
_SIGMAS = 8.0
_LEAST_RAD = np.radians(0.1)
_CLOCK_STEPS = 41

# Units of work of holding a sensor against a path.
_OFFSET_WORK = 0.2


@dataclass(frozen=True, eq=False)
class Case:
    """Bearings and sensors, as written or as they would be with a correction.

    Attributes
    ----------
    bearings, sensors, recording
        Thinned and free of refraction; in the order of their indices; as read.
    effort
        Where work is counted, common to all cases of a check-up.
    """

    bearings: Bearings
    sensors: tuple[Sensor, ...]
    recording: Recording
    effort: Effort

    def only(self, chosen: Sequence[int]) -> Case:
        """Return the case with the bearings of some sensors."""
        rows = np.flatnonzero(np.isin(self.bearings.sensor, list(chosen)))
        return dataclasses.replace(self, bearings=taken(self.bearings, rows))

    def finder(self) -> FirstGuess:
        """Return what fits paths to the case."""
        return CountedGuess(
            self.bearings,
            self.recording.constraints,
            self.sensors,
            SensorGeometry(self.sensors, self.recording.frame),
            self.recording.propagation_speed_m_s,
            self.recording.settings.motion == "static",
            _SEGMENTS,
            effort=self.effort,
        )

    @property
    def active(self) -> list[int]:
        """Indices of the sensors that have bearings."""
        return [int(index) for index in np.unique(self.bearings.sensor)]


@dataclass(frozen=True, eq=False)
class Meeting:
    """How a case's bearings meet.

    Attributes
    ----------
    case, fit
        The bearings, and the path through them.
    misfit
        By sensor: angle within which most of its bearings pass the path, radians.
    """

    case: Case
    fit: PathFit
    misfit: dict[int, float]

    @property
    def excess(self) -> float:
        """The largest misfit over what needs no explanation."""
        allowed = tolerances(self.case)
        return max(value / allowed[index] for index, value in self.misfit.items())


def taken(table: Bearings, rows: NDArray[np.int64]) -> Bearings:
    """Return some rows of a table."""
    names = [entry.name for entry in dataclasses.fields(table)]
    return dataclasses.replace(table, **{name: getattr(table, name)[rows] for name in names})


def written(recording: Recording) -> Case | None:
    """Return the case of a recording as written, thinned and free of refraction."""
    table = recording.bearings
    if table is None or not len(table):
        return None
    sensors = tuple(recording.sensors.values())
    rows = []
    used = np.unique(table.sensor)
    most = int(np.clip(_ROWS // used.size, _FEWEST_ROWS, _MOST_ROWS))
    for index in used:
        own = np.flatnonzero(table.sensor == index)
        own = own[np.argsort(table.time_s[own], kind="stable")]
        rows.append(own[np.unique(np.linspace(0, own.size - 1, most).round().astype(int))])
    table = without_refraction(taken(table, np.concatenate(rows)), sensors)
    return Case(table, sensors, recording, Effort())


def as_written(recording: Recording) -> Meeting | None:
    """Return how a recording's bearings meet; None without any."""
    case = written(recording)
    return None if case is None else meet(case)


def tolerances(case: Case) -> dict[int, float]:
    """Return by sensor the misfit that needs no explanation, radians."""
    lines = case.finder().lines(np.zeros(len(case.sensors)))
    return {
        index: max(_SIGMAS * float(np.median(lines.sigma[lines.sensor == index, 0])), _LEAST_RAD)
        for index in case.active
    }


def meet(case: Case) -> Meeting:
    """Fit a path to all bearings of a case."""
    finder = case.finder()
    tried = []
    for fit in finder.fits()[:2]:
        lines = finder.lines(fit.clock_s)
        off = angles(fit, lines)
        misfit = {i: float(np.quantile(off[lines.sensor == i], SHARE)) for i in case.active}
        tried.append(Meeting(case, fit, misfit))
    return min(tried, key=lambda meeting: meeting.excess)


def angles(fit: PathFit, lines: Lines) -> NDArray[np.float64]:
    """Return by how much lines of sight miss a path, shape (n,), radians."""
    low, high = float(fit.spline.t[0]), float(fit.spline.t[-1])
    sight = fit.spline(np.clip(lines.time_s, low, high)) - lines.sensor_m
    flat = lines.azimuth_only
    up = lines.axes[:, 2]
    level = sight - np.sum(sight * up, axis=1)[:, None] * up
    return angle(np.where(flat[:, None], level, sight), lines.direction)


def against(path: Meeting, case: Case, sensor: int) -> float:
    """Return the misfit of a sensor to the path of others, its clock searched over its prior.

    Parameters
    ----------
    path
        Of the others.
    case
        With the sensor's bearings.
    sensor
        Its index.

    Returns
    -------
    float
        Radians; infinite where less than half of its bearings are within the path's time, or
        fewer than three.
    """
    finder = case.only([sensor]).finder()
    low, high = float(path.fit.spline.t[0]), float(path.fit.spline.t[-1])
    slack = 0.02 * (high - low)
    prior = case.sensors[sensor].errors.clock_offset_s
    offsets = prior * np.linspace(-4.0, 4.0, _CLOCK_STEPS) if prior > 0.0 else np.zeros(1)
    case.effort.spend(_OFFSET_WORK * offsets.size)
    best = np.inf
    for offset in offsets:
        clock = np.zeros(len(case.sensors))
        clock[sensor] = offset
        lines = finder.lines(clock)
        # Sound needs its time to arrive; light's does not show here.
        distance = np.linalg.norm(
            path.fit.spline(np.clip(lines.time_s, low, high)) - lines.sensor_m, axis=1
        )
        sent = lines.time_s - distance / case.recording.propagation_speed_m_s
        lines = dataclasses.replace(lines, time_s=sent)
        inside = (sent >= low - slack) & (sent <= high + slack)
        if np.count_nonzero(inside) < max(3, 0.5 * inside.size):
            continue
        best = min(best, float(np.quantile(angles(path.fit, lines)[inside], SHARE)))
    return best
