"""Times of arrival that no place of the object explains.

Two sensors hear an emission at times that differ by no more than their distance over the speed of
propagation.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from geograph.checkup.findings import Finding

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.recording import Recording

# Measurements beyond the bound that are no outliers any more.
_SHARE = 0.5
_SIGMAS = 8.0
_UNITS = {1e-3: "ms", 1e-6: "µs", 1e-9: "ns"}


def check_signals(recording: Recording) -> list[Finding]:
    """Return the sensors whose arrival times differ by more than their distances allow."""
    if not np.isfinite(recording.propagation_speed_m_s):
        return []
    return [*_differences(recording), *_arrivals(recording)]


def _limit(
    recording: Recording,
    one: NDArray[np.int64],
    other: NDArray[np.int64],
    time_s: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return baselines over speed, and what clocks' and positions' priors add, shape (n,), s."""
    sensors = tuple(recording.sensors.values())
    speed = recording.propagation_speed_m_s
    slack = 3.0 * recording.propagation_sigma_m_s
    slowest = max(speed - slack, 0.5 * speed)
    span = np.ptp(time_s)
    own = np.array(
        [
            s.errors.clock_offset_s
            + s.errors.clock_drift_s_s * span
            + s.errors.clock_instability_s_sqrt_s * np.sqrt(span)
            + (s.errors.position_m + s.errors.position_noise_m) / speed
            for s in sensors
        ]
    )
    ends = np.empty((2, time_s.size, 3))
    for end, index in zip(ends, (one, other), strict=True):
        for sensor in np.unique(index):
            rows = index == sensor
            end[rows] = sensors[sensor].position_at(time_s[rows])
    apart = np.linalg.norm(ends[0] - ends[1], axis=1) / slowest
    # Moving sensors, and a turning Earth, have moved while the signal was under way.
    return apart * (1.0 + 1e-3), _SIGMAS * (own[one] + own[other])


def _differences(recording: Recording) -> list[Finding]:
    table = recording.time_differences
    if table is None or not len(table):
        return []
    limit, slack = _limit(recording, table.sensor, table.reference, table.time_s)
    noise = _SIGMAS * table.sigma_s
    found = []
    for index in np.unique(table.sensor):
        rows = table.sensor == index
        size = np.abs(table.tdoa_s[rows])
        most = limit[rows] + slack[rows]
        if np.mean(size > most + noise[rows]) < _SHARE:
            continue
        name = recording.sensor_names[index]
        text = (
            f"time differences of {name} are as large as {np.median(size):.3g} s; its distance "
            f"from the reference allows {np.median(limit[rows]):.3g} s"
        )
        text += _unit_text(size, most, noise[rows])
        found.append(_finding(name, "time_differences", text))
    return found


def _unit_text(
    size: NDArray[np.float64], most: NDArray[np.float64], noise: NDArray[np.float64]
) -> str:
    """Return the unit in which values, and their noise with them, would be possible."""
    for factor, unit in _UNITS.items():
        if (factor * (size - noise) <= most).mean() > 1.0 - 0.5 * _SHARE:
            return f"; as {unit} instead of s they would fit"
    return ""


def _arrivals(recording: Recording) -> list[Finding]:
    table = recording.arrivals
    if table is None or not len(table):
        return []
    one, other = _pairs(table.emission)
    if not one.size:
        return []
    sensor, second = table.sensor[one], table.sensor[other]
    limit, slack = _limit(recording, sensor, second, table.toa_s[one])
    noise = _SIGMAS * np.hypot(table.sigma_s[one], table.sigma_s[other])
    lag = table.toa_s[one] - table.toa_s[other]
    beyond = np.abs(lag) > limit + slack + noise
    pairs = np.stack([np.minimum(sensor, second), np.maximum(sensor, second)], axis=1)
    distinct, which = np.unique(pairs, axis=0, return_inverse=True)
    share = np.bincount(which.ravel(), weights=beyond) / np.bincount(which.ravel())
    bad = distinct[share >= _SHARE].tolist()
    if not bad:
        return []
    counts = Counter(index for pair in bad for index in pair)
    worst, most = counts.most_common(1)[0]
    names = recording.sensor_names
    alone = len(bad) == most and (len(counts) > 2 or len(np.unique(table.sensor)) == 2)
    if not alone:
        fits = _unit_text(np.abs(lag), limit + slack, noise)
        text = (
            f"arrival times of one emission differ by {np.median(np.abs(lag)):.3g} s; the sensors' "
            f"distances allow {np.median(limit):.3g} s{fits}"
        )
        return [_finding(", ".join(names[i] for i in sorted(counts)), "arrivals", text)]
    rows = (sensor == worst) | (second == worst)
    signed = np.where(sensor == worst, lag, -lag)[rows]
    text = (
        f"{names[worst]} hears emissions {np.median(signed):+.6g} s after the others; their "
        f"distances allow {np.median(limit[rows]):.3g} s"
    )
    whole = round(float(np.median(signed)))
    fits = np.abs(signed - whole) <= (limit + slack + noise)[rows]
    if whole and fits.mean() > 1.0 - 0.5 * _SHARE:
        text += f"; with its clock set by {-whole:+d} s they would fit"
    return [_finding(names[worst], "arrivals", text)]


def _pairs(emission: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return all pairs of rows of one emission."""
    order = np.argsort(emission, kind="stable")
    one, other = [], []
    for group in np.split(order, np.flatnonzero(np.diff(emission[order])) + 1):
        first, second = np.triu_indices(group.size, 1)
        one.append(group[first])
        other.append(group[second])
    return np.concatenate(one), np.concatenate(other)


def _finding(sensor: str, file: str, text: str) -> Finding:
    return Finding(
        severity="problem",
        kind="beyond-baseline",
        sensor=sensor,
        file=file,
        text=text,
        remedy="check the unit of the times, the clocks, the places and propagation_speed_m_s",
    )
