"""Whose bearings do not meet those of the others, and which correction would make them meet."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from geograph.checkup.corrections import CORRECTIONS, Correction, shift, shifts, small_numbers
from geograph.checkup.findings import Finding, degrees_text
from geograph.checkup.fits import against, meet, meet_at, tolerances, written
from geograph.checkup.pairs import pair_miss

if TYPE_CHECKING:
    from collections.abc import Sequence

    from geograph.checkup.fits import Case, Meeting
    from geograph.recording import Recording

# A correction must make the misfit so many times smaller, ...
_GAIN = 8.0
# ... and, without one, a misfit must be as large as this to be called a contradiction.
_CONTRADICTION_RAD = np.radians(2.0)
# Corrections that look best against the others' path are tried with all sensors together.
_TRIED = 3
# Clock errors within so many sigmas of the priors are no mistakes.
_SIGMAS = 8.0
# Repairs that differ by less than this factor do equally well.
_ALIKE = 2.0
# Spans of two sensors' times that differ by more hint at another unit.
_ODD_TIMES = 300.0
_TIME_UNITS = ("milliseconds", "seconds-as-milliseconds")


@dataclass(frozen=True, eq=False)
class _Repair:
    correction: Correction
    sensors: tuple[int, ...]
    before: float
    after: float


def check_bearings(recording: Recording) -> list[Finding]:
    """Return whose bearings do not meet those of the others, or seem to be radians."""
    case = written(recording)
    if case is None:
        return []
    if len(case.active) < 2:
        return _lone(case)
    whole = meet(case)
    strangers = [i for i in case.active if _apart(case, i)]
    if whole.excess <= 1.0 and not strangers:
        return []
    if _meet_in_pairs(case):
        return []
    together = [] if _odd_times(case) or whole.excess <= 1.0 else _together(case, whole)
    if together:
        return [_best(case, together)]
    return _two(case, whole) if len(case.active) == 2 else _several(case, whole, strangers)


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
    """Tell whether a sensor measured only when no other did."""
    time, own = case.bearings.time_s, case.bearings.sensor == sensor
    prior = 4.0 * max(s.errors.clock_offset_s for s in case.sensors)
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


def _odd_times(case: Case) -> bool:
    """Tell whether one sensor's times span hundreds of times more, or less, than the others'."""
    time, sensor = case.bearings.time_s, case.bearings.sensor
    spans = np.array([float(np.ptp(time[sensor == i])) for i in case.active])
    spans = spans[spans > 0.0]
    return bool(spans.size > 1 and spans.max() > _ODD_TIMES * spans.min())


def _applied(case: Case, correction: Correction, sensors: Sequence[int]) -> Case | None:
    changed: Case | None = case
    for sensor in sensors:
        changed = None if changed is None else correction.apply(changed, sensor)
    return changed


def _repairs(before: float, after: float, meeting: Meeting) -> bool:
    return before > _GAIN * after and meeting.excess <= 2.0


def _together(case: Case, whole: Meeting) -> list[_Repair]:
    """Return the mistakes that all sensors may share, each of which would explain it."""
    apart = any(_apart(case, i) for i in case.active)
    before = np.pi if apart else max(whole.misfit.values())
    found = []
    for correction in CORRECTIONS:
        changed = _applied(case, correction, case.active)
        if changed is None or (apart and any(_apart(changed, i) for i in case.active)):
            continue
        meeting = meet(changed)
        after = max(meeting.misfit.values())
        if _repairs(before, after, meeting):
            found.append(_Repair(correction, tuple(case.active), before, after))
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
    """Return clock errors beyond a sensor's prior that leave it times in common with others."""
    time, own = case.bearings.time_s, case.bearings.sensor == sensor
    low, high = float(time[~own].min()), float(time[~own].max())
    # What priors allow between a clock and the surest other one is the smoother's to find.
    prior = min(case.sensors[i].errors.clock_offset_s for i in case.active if i != sensor)
    least = max(_SIGMAS * np.hypot(case.sensors[sensor].errors.clock_offset_s, prior), 0.5)
    return [
        seconds
        for seconds in shifts()
        if abs(seconds) > least
        and np.mean((time[own] + seconds >= low) & (time[own] + seconds <= high)) >= 0.5
    ]


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
            shifted = correction.kind in ("clock-seconds", "time-zone")
            meeting = meet_at(changed, whole.fit.clock_s) if shifted else meet(changed)
            after = max(meeting.misfit.values())
            if _repairs(before, after, meeting):
                found.append(_Repair(correction, (sensor,), before, after))
    if found:
        return [_best(case, found)]
    if before < np.pi and before > max(_CONTRADICTION_RAD, *tolerances(case).values()):
        return [_contradiction(case, case.active, before)]
    return []


def _several(case: Case, whole: Meeting, strangers: Sequence[int]) -> list[Finding]:
    """Return what is wrong with one sensor or more of at least three."""
    kept, out = list(case.active), list(strangers)
    kept = [i for i in kept if i not in out]
    if len(kept) < 2:
        return []
    current = meet(case.only(kept)) if out else whole
    choice: list[tuple[int, Meeting]] = []
    while current.excess > 1.0 and len(kept) > 2:
        trials = [(i, meet(case.only([k for k in kept if k != i]))) for i in kept]
        trials.sort(key=lambda trial: trial[1].excess)
        choice = [trial for trial in trials if trial[1].excess <= 1.0]
        sensor, current = trials[0]
        kept.remove(sensor)
        out.append(sensor)
    if current.excess > 1.0:
        worst = max(whole.misfit.values())
        return [_contradiction(case, case.active, worst)] if worst > _CONTRADICTION_RAD else []
    if len(out) == 1 and len(choice) > 1:
        return _one_of(case, choice)
    findings = []
    for sensor in out:
        repair, before = _against_path(case, sensor, current)
        if repair is not None:
            findings.append(_finding(case, repair))
        elif np.pi > before > _CONTRADICTION_RAD:
            findings.append(_contradiction(case, [sensor], before))
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
        return [_best(case, found)]
    if worst > _CONTRADICTION_RAD:
        return [_contradiction(case, [sensor for sensor, _ in choice], worst)]
    return []


def _against_path(case: Case, sensor: int, path: Meeting) -> tuple[_Repair | None, float]:
    """Return the best repair of a sensor beside others that agree, and its misfit as written."""
    before = min(against(path, case, sensor), np.pi)
    scored = []
    for correction, changed in _candidates(case.only([*path.case.active, sensor]), sensor):
        after = against(path, changed, sensor)
        if before > _GAIN * after:
            scored.append((after, correction, changed))
    least = min((entry[0] for entry in scored), default=0.0)
    scored.sort(key=lambda entry: (not (entry[1].usual and entry[0] < _ALIKE * least), entry[0]))
    found = []
    for _, correction, changed in scored[:_TRIED]:
        meeting = meet(changed)
        after = meeting.misfit[sensor]
        if _repairs(before, after, meeting):
            found.append(_Repair(correction, (sensor,), before, after))
    if not found:
        return None, before
    least = min(repair.after for repair in found)
    usual = [r for r in found if r.correction.usual and r.after < _ALIKE * least]
    return (usual or sorted(found, key=lambda repair: repair.after))[0], before


def _best(case: Case, found: Sequence[_Repair]) -> Finding:
    """Return the finding of the best repair, with up to two others that do as well."""
    ordered = sorted(found, key=lambda repair: repair.after)
    alike = [repair for repair in ordered if repair.after < _ALIKE * ordered[0].after]
    # A stable sort: the usual mistake first, then the one that fits best.
    odd = _odd_times(case)
    alike.sort(key=lambda r: not (r.correction.usual or (odd and r.correction.kind in _TIME_UNITS)))
    others = [r for r in alike[1:] if r.correction.kind != alike[0].correction.kind]
    return _finding(case, alike[0], others[:2])


def _names(case: Case, sensors: Sequence[int]) -> str:
    return ", ".join(case.sensors[index].name for index in sensors)


def _finding(case: Case, repair: _Repair, others: Sequence[_Repair] = ()) -> Finding:
    whose = _names(case, repair.sensors)
    after = degrees_text(np.degrees(repair.after))
    if len(repair.sensors) > 1:
        said = repair.correction.said(case, repair.sensors[0]).replace("its ", "their ")
        said = f"{said} (all sensors alike)"
        if repair.correction.place:
            said += f"; that was {case.sensors[repair.sensors[0]].name}"
    else:
        said = repair.correction.said(case, repair.sensors[0])
    if repair.before < np.pi:  # pi stands for "no time in common"
        text = (
            f"{said}, bearings of {whose} meet to {after} instead of "
            f"{degrees_text(np.degrees(repair.before))}"
        )
    else:
        text = (
            f"{said}, bearings of {whose} meet those of the others to {after}; they share no time"
        )
    for other in others:
        text += (
            f"; or {_names(case, other.sensors)} {other.correction.said(case, other.sensors[0])}"
        )
    return Finding(
        severity="problem",
        kind=repair.correction.kind,
        sensor=whose,
        file="recording.toml" if repair.correction.place else "bearings",
        text=text,
        remedy=repair.correction.remedy,
    )


def _contradiction(case: Case, sensors: Sequence[int], misfit: float) -> Finding:
    whose = _names(case, sensors)
    if len(sensors) == 1:
        text = f"{whose} contradicts all the others: its bearings miss their path by "
    elif len(sensors) < len(case.active):
        text = f"one of {whose} contradicts the others: bearings miss by "
    else:
        text = f"bearings of {whose} do not meet: they miss by "
    return Finding(
        severity="problem",
        kind="contradiction",
        sensor=whose,
        file="recording.toml",
        text=text + degrees_text(np.degrees(misfit)) + ", and no correction known here repairs it",
        remedy="check the place, the axes, the clock and the target of the sensor",
    )
