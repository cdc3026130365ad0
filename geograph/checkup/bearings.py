"""Whose bearings do not meet those of the others, and which correction would make them meet."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from geograph.checkup.corrections import CORRECTIONS, Correction, shift, shifts, small_numbers
from geograph.checkup.findings import Finding
from geograph.checkup.fits import against, meet, tolerances
from geograph.checkup.pairs import pair_miss, shift_misses
from geograph.checkup.repairs import (
    ALIKE,
    Repair,
    best_finding,
    contradiction,
    odd_times,
    repair_finding,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from geograph.checkup.fits import Case, Meeting

# A correction must make the misfit so many times smaller, ...
_GAIN = 8.0
# ... and, without one, a misfit must be as large as this to be called a contradiction.
_CONTRADICTION_RAD = np.radians(2.0)
# Corrections that look best against the others' path are tried with all sensors together; so are
# clock errors that bring two sensors' rays nearest.
_TRIED = 3
_TRIED_SHIFTS = 10
# Clock errors within so many sigmas of the priors are no mistakes.
_SIGMAS = 8.0
# So many sensors, one left out, can be trusted to agree only if each of them is right.
_MAJORITY = 3


def check_bearings(whole: Meeting) -> list[Finding]:
    """Return whose bearings do not meet those of the others, or seem to be radians.

    Parameters
    ----------
    whole
        The bearings as written, and the path through them.
    """
    case = whole.case
    if len(case.active) < 2:
        return _lone(case)
    strangers = [i for i in case.active if _apart(case, i)]
    if whole.excess <= 1.0 and not strangers:
        return []
    if _meet_in_pairs(case):
        return []
    kept = [i for i in case.active if i not in strangers]
    rest = meet(case.only(kept)) if strangers and len(kept) > 1 else whole
    without = _without_one(case, kept) if rest.excess > 1.0 and len(kept) > _MAJORITY else []
    one = bool(without) and without[0][1].excess <= 1.0
    if not (one or odd_times(case) or rest.excess <= 1.0):
        together = _together(case, whole)
        if together:
            return [best_finding(case, together)]
    if len(case.active) == 2:
        return _two(case, whole)
    return _several(whole, rest, without) if len(kept) > 1 else []


def _lone(case: Case) -> list[Finding]:
    table, sensor = case.bearings, case.active[0]
    wide = len(table) > 2 and np.ptp(np.degrees(table.azimuth_rad)) > 2.0
    if not (wide and small_numbers(table.azimuth_rad, table.elevation_rad)):
        return []
    name = case.sensors[sensor].name
    return [
        Finding(
            severity="question",
            kind="radians",
            sensor=name,
            file="bearings",
            text=f"all angles of {name}, in degrees, are small enough to be radians",
            remedy="if they are radians, call the columns azimuth_rad and elevation_rad",
        )
    ]


def _apart(case: Case, sensor: int) -> bool:
    """Tell whether a sensor measured only when no other did, whatever clocks' priors allow.

    One other sensor whose clock may be anything is no witness: the median prior of the others
    counts.
    """
    time, own = case.bearings.time_s, case.bearings.sensor == sensor
    clock = {i: case.sensors[i].errors.clock_offset_s for i in case.active}
    others = float(np.median([clock[i] for i in case.active if i != sensor]))
    prior = 4.0 * float(np.hypot(clock[sensor], others))
    low, high = float(time[own].min()) - prior, float(time[own].max()) + prior
    return not bool(((time[~own] >= low) & (time[~own] <= high)).any())


def _meet_in_pairs(case: Case) -> bool:
    """Tell whether a first guess that misses is to blame itself: all pairs of rays meet.

    Rays that nearly coincide, or clocks that are far off, can mislead it. More than two sensors
    whose clocks are right are not asked: in a plane any two rays meet.
    """
    if len(case.active) > 2 and not any(
        case.sensors[index].errors.clock_offset_s > 0.0 for index in case.active
    ):
        return False
    allowed = tolerances(case)
    return all(
        pair_miss(case.only([one, other])) <= max(allowed[one], allowed[other])
        for one, other in combinations(case.active, 2)
    )


def _applied(case: Case, correction: Correction, sensors: Sequence[int]) -> Case | None:
    changed: Case | None = case
    for sensor in sensors:
        changed = None if changed is None else correction.apply(changed, sensor)
    return changed


def _repairs(before: float, after: float, meeting: Meeting) -> bool:
    return before > _GAIN * after and meeting.excess <= 2.0


def _together(case: Case, whole: Meeting) -> list[Repair]:
    """Return the mistakes that all sensors may share, each of which would explain it."""
    apart = any(_apart(case, i) for i in case.active)
    before = np.pi if apart else max(whole.misfit.values())
    found = []
    for correction in CORRECTIONS:
        changed = _applied(case, correction, case.active)
        if changed is None or (apart and any(_apart(changed, i) for i in case.active)):
            continue
        if not case.effort.allows("mistakes that all sensors share"):
            break
        meeting = meet(changed)
        after = max(meeting.misfit.values())
        if _repairs(before, after, meeting):
            found.append(Repair(correction, tuple(case.active), before, after))
    return found


def _candidates(case: Case, sensor: int) -> list[tuple[Correction, Case]]:
    """Return all corrections of a sensor with their cases."""
    found = []
    for correction in (*CORRECTIONS, *(shift(seconds) for seconds in _shifts(case, sensor))):
        changed = correction.apply(case, sensor)
        if changed is not None:
            found.append((correction, changed))
    return found


def _shifts(case: Case, sensor: int) -> list[float]:
    """Return clock errors beyond a sensor's prior that leave it times in common with others.

    Of two sensors' clock errors only those that bring their rays nearest.
    """
    time, own = case.bearings.time_s, case.bearings.sensor == sensor
    low, high = float(time[~own].min()), float(time[~own].max())
    # What priors allow between a clock and the surest other one is the smoother's to find.
    prior = min(case.sensors[i].errors.clock_offset_s for i in case.active if i != sensor)
    least = max(_SIGMAS * np.hypot(case.sensors[sensor].errors.clock_offset_s, prior), 0.5)
    found = [
        seconds
        for seconds in shifts()
        if abs(seconds) > least
        and np.mean((time[own] + seconds >= low) & (time[own] + seconds <= high)) >= 0.5
    ]
    if len(case.active) > 2 or len(found) <= _TRIED_SHIFTS:
        return found
    miss = shift_misses(case, sensor, found)
    return [found[index] for index in np.argsort(miss, kind="stable")[:_TRIED_SHIFTS]]


def _two(case: Case, whole: Meeting) -> list[Finding]:
    """Return what would make the bearings of two sensors meet."""
    before = max(whole.misfit.values())
    if any(_apart(case, i) for i in case.active):
        before = np.pi
    found = []
    for sensor in case.active:
        for correction, changed in _candidates(case, sensor):
            if _apart(changed, sensor):
                continue
            if not case.effort.allows(f"more mistakes of {case.sensors[sensor].name}"):
                break
            meeting = meet(changed)
            after = max(meeting.misfit.values())
            if _repairs(before, after, meeting):
                found.append(Repair(correction, (sensor,), before, after))
    if found:
        return [best_finding(case, found)]
    if before < np.pi and before > max(_CONTRADICTION_RAD, *tolerances(case).values()):
        return [contradiction(case, case.active, before)]
    return []


def _without_one(case: Case, kept: Sequence[int]) -> list[tuple[int, Meeting]]:
    """Return how the others meet without each sensor in turn, the best first."""
    trials = []
    for sensor in kept:
        if not case.effort.allows("which sensor contradicts the others"):
            return []
        trials.append((sensor, meet(case.only([other for other in kept if other != sensor]))))
    return sorted(trials, key=lambda trial: trial[1].excess)


def _several(
    whole: Meeting, rest: Meeting, without: Sequence[tuple[int, Meeting]]
) -> list[Finding]:
    """Return what is wrong with one sensor or more of at least three.

    Parameters
    ----------
    whole
        All bearings, as written.
    rest
        Those of the sensors that share time with others.
    without
        How these meet without each in turn, if that is known.
    """
    case, current = whole.case, rest
    kept = list(rest.case.active)
    out = [i for i in case.active if i not in kept]
    choice: list[tuple[int, Meeting]] = []
    while current.excess > 1.0 and len(kept) > 2:
        trials = list(without) if current is rest and without else _without_one(case, kept)
        if not trials:
            break
        choice = [trial for trial in trials if trial[1].excess <= 1.0]
        sensor, current = trials[0]
        kept.remove(sensor)
        out.append(sensor)
    if current.excess > 1.0:
        worst = max(whole.misfit.values())
        return [contradiction(case, case.active, worst)] if worst > _CONTRADICTION_RAD else []
    if len(out) == 1 and len(choice) > 1:
        return _one_of(case, choice)
    findings = []
    for sensor in out:
        repair, before = _against_path(case, sensor, current)
        if repair is not None:
            findings.append(repair_finding(case, repair))
        elif np.pi > before > _CONTRADICTION_RAD:
            findings.append(contradiction(case, [sensor], before))
    return findings


def _one_of(case: Case, choice: Sequence[tuple[int, Meeting]]) -> list[Finding]:
    """Return what is wrong where leaving out any of several sensors would do."""
    found, worst = [], 0.0
    for sensor, path in choice:
        repair, before = _against_path(case, sensor, path)
        worst = max(worst, before if before < np.pi else 0.0)
        if repair is not None:
            found.append(repair)
    if found:
        return [best_finding(case, found)]
    if worst > _CONTRADICTION_RAD:
        return [contradiction(case, [sensor for sensor, _ in choice], worst)]
    return []


def _against_path(case: Case, sensor: int, path: Meeting) -> tuple[Repair | None, float]:
    """Return the best repair of a sensor beside others that agree, and its misfit as written."""
    before = min(against(path, case, sensor), np.pi)
    undone = f"mistakes of {case.sensors[sensor].name}"
    scored = []
    for correction, changed in _candidates(case.only([*path.case.active, sensor]), sensor):
        if not case.effort.allows(undone):
            break
        after = against(path, changed, sensor)
        if before > _GAIN * after:
            scored.append((after, correction, changed))
    least = min((entry[0] for entry in scored), default=0.0)
    scored.sort(key=lambda entry: (not (entry[1].usual and entry[0] < ALIKE * least), entry[0]))
    found: list[Repair] = []
    for _, correction, changed in scored[:_TRIED]:
        if found and not case.effort.allows(undone):
            break
        meeting = meet(changed)
        after = meeting.misfit[sensor]
        if _repairs(before, after, meeting):
            found.append(Repair(correction, (sensor,), before, after))
    if not found:
        return None, before
    least = min(repair.after for repair in found)
    usual = [r for r in found if r.correction.usual and r.after < ALIKE * least]
    return (usual or sorted(found, key=lambda repair: repair.after))[0], before
