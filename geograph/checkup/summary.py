"""What a recording holds: spans, rates, numbers, and how its sensors see each other's rays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.lines import angle

if TYPE_CHECKING:
    from geograph.checkup.fits import Meeting
    from geograph.recording import Recording


def summary_of(recording: Recording, whole: Meeting | None) -> dict[str, Any]:
    """Return spans, rates and numbers of every sensor and table, baselines and crossing angles.

    Parameters
    ----------
    recording
        As read.
    whole
        How its bearings meet (:func:`geograph.checkup.fits.as_written`).

    Returns
    -------
    dict
        ``name``, ``frame``; ``tables``: for each its rows, span and, for each sensor, rows, first
        and last time (s) and median rate (1/s); ``baselines_m``: least and largest distance of two
        sensors, or None; ``crossing_deg``: least, median and largest over sensors' pairs of the
        angle at the object, or None without bearings of two sensors.
    """
    tables: dict[str, Any] = {}
    used: set[int] = set()
    for name, table in recording.tables.items():
        entry: dict[str, Any] = {"rows": len(table), "span_s": float(np.ptp(table.time_s))}
        entry["sensors"] = {}
        for index in np.unique(table.sensor):
            time = np.sort(table.time_s[table.sensor == index])
            gaps = np.diff(time)
            gap = float(np.median(gaps[gaps > 0.0])) if (gaps > 0.0).any() else None
            entry["sensors"][recording.sensor_names[index]] = {
                "rows": int(time.size),
                "first_s": float(time[0]),
                "last_s": float(time[-1]),
                "rate_hz": None if gap is None else 1.0 / gap,
            }
            used.add(int(index))
        used |= {int(i) for i in np.unique(getattr(table, "reference", np.empty(0, int)))}
        tables[name] = entry
    return {
        "name": recording.name,
        "frame": recording.frame,
        "tables": tables,
        "baselines_m": _baselines(recording, sorted(used)),
        "crossing_deg": _crossing(whole),
    }


def _baselines(recording: Recording, used: list[int]) -> list[float] | None:
    if len(used) < 2:
        return None
    middle = sum(recording.time_span_s) / 2.0
    sensors = tuple(recording.sensors.values())
    place = np.stack([sensors[index].position_at(middle) for index in used])
    apart = np.linalg.norm(place[:, None] - place[None], axis=2)[np.triu_indices(len(used), 1)]
    return [float(apart.min()), float(apart.max())]


def _crossing(whole: Meeting | None) -> list[float] | None:
    if whole is None or len(whole.case.active) < 2:
        return None
    case, path = whole.case, whole.fit
    middle = np.asarray(path.spline(0.5 * (path.spline.t[0] + path.spline.t[-1])))
    when = np.array([float(np.median(case.bearings.time_s))])
    sight = np.stack([middle - case.sensors[i].position_at(when)[0] for i in case.active])
    sight /= np.linalg.norm(sight, axis=1)[:, None]
    one, other = np.triu_indices(len(case.active), 1)
    found = np.degrees(angle(sight[one], sight[other]))
    # Rays that meet head on determine as little as parallel ones.
    found = np.minimum(found, 180.0 - found)
    return [float(found.min()), float(np.median(found)), float(found.max())]
