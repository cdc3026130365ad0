"""Repairs of a recording's mistakes, and the words for them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.checkup.findings import Finding, degrees_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from geograph.checkup.corrections import Correction
    from geograph.checkup.fits import Case

# Repairs that differ by less than this factor do equally well.
ALIKE = 2.0
# Spans of two sensors' times that differ by more hint at another unit.
_ODD_TIMES = 300.0
_TIME_UNITS = ("milliseconds", "seconds-as-milliseconds")


@dataclass(frozen=True, eq=False)
class Repair:
    """A correction of some sensors that makes bearings meet.

    Attributes
    ----------
    correction, sensors
        What is corrected, of which sensors (indices).
    before, after
        Misfits, radians; before, pi stands for "no time in common".
    """

    correction: Correction
    sensors: tuple[int, ...]
    before: float
    after: float


def odd_times(case: Case) -> bool:
    """Tell whether one sensor's times span hundreds of times more, or less, than the others'."""
    time, sensor = case.bearings.time_s, case.bearings.sensor
    spans = np.array([float(np.ptp(time[sensor == i])) for i in case.active])
    spans = spans[spans > 0.0]
    return bool(spans.size > 1 and spans.max() > _ODD_TIMES * spans.min())


def best_finding(case: Case, found: Sequence[Repair]) -> Finding:
    """Return the finding of the best repair, with up to two others that do as well."""
    ordered = sorted(found, key=lambda repair: repair.after)
    alike = [repair for repair in ordered if repair.after < ALIKE * ordered[0].after]
    # A stable sort: the usual mistake first, then the one that fits best.
    odd = odd_times(case)
    alike.sort(key=lambda r: not (r.correction.usual or (odd and r.correction.kind in _TIME_UNITS)))
    others = [r for r in alike[1:] if r.correction.kind != alike[0].correction.kind]
    return repair_finding(case, alike[0], others[:2])


def _names(case: Case, sensors: Sequence[int]) -> str:
    return ", ".join(case.sensors[index].name for index in sensors)


def repair_finding(case: Case, repair: Repair, others: Sequence[Repair] = ()) -> Finding:
    """Return a repair in words, with others that do as well."""
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


def contradiction(case: Case, sensors: Sequence[int], misfit: float) -> Finding:
    """Return in words that some sensors contradict the others, or one another."""
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
