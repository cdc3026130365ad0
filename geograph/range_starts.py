"""First guesses of the path from arrival times, time and frequency differences.

Candidates are the best places of a coarse grid, the closed form of all sets together and smooth
paths through fixes of single sets (:mod:`geograph.range_seeds`), each refined by robust
Levenberg-Marquardt steps (:mod:`geograph.range_refine`). The best are made more flexible as long as
the Bayesian information criterion says so. Where the best leaves residuals far outside, the same is
done with each sensor left out: a receiver whose clock is off by a millisecond spoils no start. All
are compared on the whole data with residuals bounded on one scale.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.factors.constraints import altitude
from geograph.initialise import PathFit
from geograph.lines import criteria, robust_scale
from geograph.range_data import range_data
from geograph.range_refine import (
    constant_spline,
    drawn_in,
    finished,
    fitted,
    refined,
    reshaped,
    state_of,
    too_far,
)
from geograph.range_residuals import Evaluator
from geograph.range_seeds import seeds

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

    from geograph.frames import SensorGeometry
    from geograph.lines import Attempt
    from geograph.range_data import RangeData
    from geograph.range_residuals import Residuals
    from geograph.recording import Recording

# Rows that starts are fitted to at last, at first, and with a sensor left out.
_MOST_ROWS = 1500
_FEW_ROWS = 300
_BRIEF_ROWS = 150

# Fits that are made more flexible, and that are returned.
_GROWN = 3
_RETURNED = 6

# A criterion worse by more than this is no root of the same measurements.
_HOPELESS = 40.0

_MOST_SEGMENTS = 32
_WORSE = 3

# Residuals are far outside where their robust scale, or this share of them, is beyond so many
# sigmas; at most so many sensors are then left out in turn.
_WIDE_SCALE = 3.0
_NOISE_SCALE = 1.5
_FAR_SIGMAS = 6.0
_FAR_SHARE = 0.05
_MOST_LEFT_OUT = 12
_FEWEST_SENSORS = 3

# Paths closer than this share of the distance are one, at last and halfway there.
_SAME = 1e-3
_NEAR = 1e-2

# An object deeper than the deepest sea is the mirror image of one above the ground.
_DEEPEST_M = -12e3
_BELOW_GROUND = 20.0


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A fit, and all data that it may be refined on."""

    fit: Attempt
    evaluator: Evaluator


def range_fits(recording: Recording, geometry: SensorGeometry, *, static: bool) -> list[PathFit]:
    """Return first guesses of the path, the most promising first; at least one.

    What the measurements leave open, the range of a far object or nearly everything, is some
    plausible value.

    Parameters
    ----------
    recording
        With arrivals, time or frequency differences; bearings help to choose.
    geometry
        Poses of its sensors.
    static
        Whether the object stands still.
    """
    data = range_data(recording, geometry).thinned(_MOST_ROWS)
    whole = Evaluator(data)
    found = _distinct(_candidates(data, static=static), whole)
    grown = [_grown(one, static=static) for one in found[:_GROWN]]
    found = _distinct(grown + found[_GROWN:], whole)
    if _far_outside(fitted(whole, found[0].fit.spline)):
        others = _distinct(_without_each(data, static=static), whole)
        found = _distinct(found + [_grown(one, static=static) for one in others[:_GROWN]], whole)
    final = _ranked([candidate.fit.spline for candidate in found], whole)
    sensors = len(recording.sensors)
    return [
        PathFit(fit.spline, np.zeros(sensors), score, fit.range_m, 0.0)
        for score, fit in final[:_RETURNED]
        if score <= final[0][0] + _HOPELESS
    ]


def _candidates(data: RangeData, *, static: bool, brief: bool = False) -> list[_Candidate]:
    """Return every seed, refined; the object stands still or moves evenly."""
    every, evaluator = Evaluator(data), Evaluator(data.thinned(_BRIEF_ROWS if brief else _FEW_ROWS))
    found: list[_Candidate] = []
    for part in seeds(data, static=static, brief=brief):
        rough = [one for one in part if np.isfinite(one.c).all()]
        # A height that is known may itself be that far away.
        rough = [one for one in rough if not too_far(data, one)] or rough[:1]
        fits = _refined(evaluator, rough, static=static)
        found += [_Candidate(fit, every) for fit in fits]
        if any(_explained(fit) for fit in fits):
            break
    if not found:
        middle = constant_spline(data.sensor_places().mean(axis=0), data.times())
        found = [_Candidate(fit, every) for fit in _refined(evaluator, [middle], static=static)]
    return found


def _refined(evaluator: Evaluator, rough: list[BSpline], *, static: bool) -> list[Attempt]:
    """Return seeds refined, each place that they lead to once."""
    data = evaluator.data
    degree = 0 if static or evaluator.events < 2 else 1
    drawn = []
    for seed in rough:
        time = data.times() - _light_time(data, seed)
        segments = len(seed.c) - seed.k
        if seed.k > degree and len(seed.c) <= _most_coefficients(evaluator):
            path = reshaped(seed, time, seed.k, segments)
        else:
            path = reshaped(seed, time, degree, 1)
        drawn.append(drawn_in(evaluator, path))
    # Most seeds are drawn to the same few places by now; from each the end is the same.
    drawn.sort(key=lambda one: float(np.sqrt(1.0 + one[1].value ** 2).sum()))
    kept: list[tuple[BSpline, Residuals]] = []
    for spline, left in drawn:
        size = max(float(np.median(left.distance_m)), 1e-9) if left.distance_m.size else 1e-9
        if all(_gap(spline, other) > _NEAR * size for other, _ in kept):
            kept.append((spline, left))
    return [finished(evaluator, *one) for one in kept]


def _gap(one: BSpline, other: BSpline) -> float:
    """Return the greatest difference of two paths' coordinates along the first, metres."""
    if len(one.c) != len(other.c):
        return np.inf
    time = np.linspace(one.t[0], one.t[-1], 9)
    return float(np.abs(state_of(one, time)[0] - state_of(other, time)[0]).max())


def _light_time(data: RangeData, spline: BSpline) -> float:
    """Return how long a signal from the middle of a path to the sensors is under way, seconds."""
    middle = state_of(spline, np.array([data.times().mean()]))[0]
    distance = np.linalg.norm(data.sensor_places() - middle, axis=1)
    return float(np.median(distance)) / data.speed_m_s


def _without_each(data: RangeData, *, static: bool) -> list[_Candidate]:
    """Return the best candidates with each sensor left out in turn."""
    heard = np.concatenate(
        [
            data.ranges.sensor,
            data.bearings.sensor,
            data.differences.sensor,
            data.differences.reference,
        ]
    )
    names, count = np.unique(heard, return_counts=True)
    if names.size <= _FEWEST_SENSORS:
        return []
    found = []
    for sensor in names[np.argsort(-count, kind="stable")][:_MOST_LEFT_OUT]:
        part = data.without(int(sensor))
        if not len(part):
            continue
        evaluator = Evaluator(part)
        found += _distinct(_candidates(part, static=static, brief=True), evaluator)[:2]
    return found


def _explained(fit: Attempt) -> bool:
    """Tell whether a fit leaves hardly more than the noise."""
    return robust_scale(fit.normalised) <= _NOISE_SCALE and not _far_outside(fit)


def _far_outside(fit: Attempt) -> bool:
    if robust_scale(fit.normalised) > _WIDE_SCALE:
        return True
    return (
        bool(np.mean(np.abs(fit.normalised) > _FAR_SIGMAS) > _FAR_SHARE)
        if fit.normalised.size
        else False
    )


def _ranked(splines: list[BSpline], whole: Evaluator) -> list[tuple[float, Attempt]]:
    """Return paths with their scores on common data and one scale, the best first."""
    fits = [fitted(whole, spline) for spline in splines]
    fits = [fit for fit in fits if np.isfinite(fit.normalised).all()] or fits[:1]
    scores = criteria(fits) + [_implausible(fit, whole.data) for fit in fits]
    order = np.argsort(scores, kind="stable")
    return [(float(scores[index]), fits[index]) for index in order]


def _implausible(fit: Attempt, data: RangeData) -> float:
    if data.frame != "ecef":
        return 0.0
    middle = 0.5 * (fit.spline.t[0] + fit.spline.t[-1])
    height = altitude(state_of(fit.spline, np.array([middle]))[0], data.frame)[0][0]
    return 0.0 if height > _DEEPEST_M else _BELOW_GROUND


def _distinct(found: list[_Candidate], whole: Evaluator) -> list[_Candidate]:
    """Return candidates, the best first, of those that lie together only the best."""
    if not found:
        return []
    by_spline = {id(candidate.fit.spline): candidate for candidate in found}
    kept: list[tuple[Attempt, _Candidate]] = []
    for _, fit in _ranked([candidate.fit.spline for candidate in found], whole):
        size = _SAME * max(fit.range_m, 1e-9)
        if all(_gap(fit.spline, other.spline) > size for other, _ in kept):
            kept.append((fit, by_spline[id(fit.spline)]))
    return [candidate for _, candidate in kept]


def _most_coefficients(evaluator: Evaluator) -> int:
    """Return how many coefficients of each coordinate the data could bear out.

    With more than half as many unknowns as measurements a robust fit meets some of them exactly and
    takes the rest for outliers.
    """
    data = evaluator.data
    measured = len(data.ranges) - data.ranges.origin_s.size + len(data.differences)
    measured += int(np.isfinite(data.bearing_sigma).sum())
    free = 2 if data.heights.value.size else 3
    return max(1, min(evaluator.events, measured // (2 * free)))


def _grown(candidate: _Candidate, *, static: bool) -> _Candidate:
    """Return a candidate refined on all of its data, as flexible as these bear out."""
    evaluator = candidate.evaluator
    fit = refined(evaluator, candidate.fit.spline)
    if static:
        return _Candidate(fit, evaluator)
    most = _most_coefficients(evaluator)
    tried = [fit]
    worse = 0
    options = [(degree, 1) for degree in range(6)]
    options += [(3, 2**power) for power in range(2, 10) if 2**power <= _MOST_SEGMENTS]
    for degree, segments in options:
        if degree + segments <= len(fit.spline.c):
            continue
        if degree + segments > most or worse >= _WORSE:
            break
        best = tried[int(np.argmin(criteria(tried)))]
        time = evaluator.start_s - best.range_m / evaluator.data.speed_m_s
        tried.append(refined(evaluator, reshaped(best.spline, time, degree, segments)))
        worse = 0 if int(np.argmin(criteria(tried))) == len(tried) - 1 else worse + 1
    return _Candidate(tried[int(np.argmin(criteria(tried)))], evaluator)
