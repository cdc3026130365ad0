"""Whether measurements scatter by as much as their sigmas say.

Each measurement is predicted from its neighbours in time by the polynomial through them; what is
left, over the size of the weights, is noise where the signal is smooth. A signal that is not adds
to it, so that the least value of several polynomials is taken.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.checkup.findings import Finding

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.recording import Recording

# Sigmas may be wrong by this factor without a word.
_FACTOR = 30.0
_FEWEST = 12
_NEIGHBOURS = (2, 4, 6)
_UNITS = {
    "bearings": {57.3: "degrees and radians", 60.0: "degrees and arc minutes",
                 3600.0: "degrees and arc seconds"},
    "time_differences": {1e3: "s and ms", 1e6: "s and µs", 1e9: "s and ns"},
    "frequency_differences": {1e3: "Hz and kHz", 1e6: "Hz and MHz"},
}  # fmt: skip


def scatter(time_s: NDArray[np.float64], value: NDArray[np.float64]) -> float:
    """Return the standard deviation of a smooth signal's noise; NaN if there is too little of it.

    Parameters
    ----------
    time_s, value
        Shape (n,), any order; equal times are passed over.
    """
    time, first = np.unique(time_s, return_index=True)
    value = value[first]
    if time.size < _FEWEST:
        return float("nan")
    return min(_left(time, value, count) for count in _NEIGHBOURS)


def _left(time: NDArray[np.float64], value: NDArray[np.float64], neighbours: int) -> float:
    half = neighbours // 2
    centre = np.arange(half, time.size - half)
    steps = np.array([step for step in range(-half, half + 1) if step])
    near = time[centre[:, None] + steps]
    weight = np.ones(near.shape)
    for one in range(neighbours):
        for other in range(neighbours):
            if one != other:
                gap = near[:, one] - near[:, other]
                weight[:, one] *= (time[centre] - near[:, other]) / gap
    off = value[centre] - np.sum(weight * value[centre[:, None] + steps], axis=1)
    # 1.4826 median absolute value is the standard deviation of normal noise.
    return float(1.4826 * np.median(np.abs(off) / np.sqrt(1.0 + np.sum(weight**2, axis=1))))


def check_scatter(recording: Recording) -> list[Finding]:
    """Return the sensors whose measurements scatter far more, or far less, than their sigmas."""
    found = []
    names = recording.sensor_names
    table = recording.bearings
    if table is not None:
        for index in np.unique(table.sensor):
            rows = table.sensor == index
            sigma = float(np.median(table.sigma_elevation_rad[rows]))
            value = table.elevation_rad[rows]
            if not np.isfinite(value).all():
                value = np.unwrap(table.azimuth_rad[rows])
                sigma = float(np.median(table.sigma_azimuth_rad[rows]))
            ratio = scatter(table.time_s[rows], value) / sigma
            found += _judged("bearings", names[index], ratio)
    for kind, values, sigmas in (
        ("time_differences", "tdoa_s", "sigma_s"),
        ("frequency_differences", "fdoa_hz", "sigma_hz"),
    ):
        differences = getattr(recording, kind)
        if differences is None:
            continue
        pairs = np.stack([differences.sensor, differences.reference], axis=1)
        for sensor, reference in np.unique(pairs, axis=0):
            rows = (differences.sensor == sensor) & (differences.reference == reference)
            ratio = scatter(differences.time_s[rows], getattr(differences, values)[rows])
            ratio /= float(np.median(getattr(differences, sigmas)[rows]))
            found += _judged(kind, names[sensor], ratio)
    return found


def _judged(table: str, sensor: str, ratio: float) -> list[Finding]:
    # Values that repeat exactly, as rounded ones do, have no scatter to judge by.
    if not ratio > 0.0 or 1.0 / _FACTOR <= ratio <= _FACTOR:
        return []
    size = max(ratio, 1.0 / ratio)
    unit = min(_UNITS[table], key=lambda factor: abs(np.log(size / factor)))
    more = "more" if ratio > 1.0 else "less"
    text = f"{table} of {sensor} scatter by {size:.2g} times {more} than their sigmas say"
    if abs(np.log(size / unit)) < np.log(4.0):
        text += f"; {_UNITS[table][unit]} differ by {unit:.3g}"
    return [
        Finding(
            severity="problem",
            kind="sigma-unit",
            sensor=sensor,
            file=table,
            text=text,
            remedy="give sigmas in the unit that the column's name says",
        )
    ]
