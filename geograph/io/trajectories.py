"""Trajectories of moving sensors from files of several kinds, in ECEF after a recording's epoch."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError
from geograph.io.instants import SECOND_NS

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from geograph.sensors import Trajectory

Span = tuple[float, float]
"""First and last second, after the epoch, for which a trajectory is wanted."""

MARGIN_S = 60.0
"""Of a trajectory that is read for some seconds, this much more is read on either side."""

LONGEST_STEP_S = 10.0
"""Points of an ephemeris farther apart are made denser, because a recording's cubic spline between
them would miss a low orbit by 3 dm a minute apart, but by less than 1 mm at this step."""

_DEGREE = 7


EPHEMERIS_SUFFIXES = (".gpx", ".oem", ".tle", ".xml")
"""Files of trajectories that are not tables of a recording."""


def read_trajectory(path: Path, epoch_tai_ns: int, span_s: Span) -> Trajectory:
    """Read a trajectory, by the suffix of its file.

    Parameters
    ----------
    path
        ``.csv`` or ``.parquet`` of a recording (seconds after the epoch), ``.gpx``, ``.oem`` or
        ``.xml`` (a CCSDS ephemeris), or ``.tle``.
    epoch_tai_ns
        Instant from which seconds count (:mod:`geograph.io.instants`).
    span_s
        Seconds for which it is wanted; what is far outside is not kept.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    if path.suffix.lower() in EPHEMERIS_SUFFIXES:
        return read_ephemeris(path, epoch_tai_ns, span_s)
    from geograph.io.reader import read_trajectory_table

    return read_trajectory_table(path)


def read_ephemeris(
    path: Path, epoch_tai_ns: int, span_s: Span, *, content: bytes | None = None
) -> Trajectory:
    """Read a trajectory from a file with one of :data:`EPHEMERIS_SUFFIXES`.

    Parameters
    ----------
    path, epoch_tai_ns, span_s
        As of :func:`read_trajectory`.
    content
        What the file holds, if it is in an archive.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix == ".gpx":
        from geograph.io.gpx import read_gpx

        return read_gpx(path, epoch_tai_ns, content=content)
    if suffix == ".tle":
        from geograph.io.tle import read_tle

        return read_tle(path, epoch_tai_ns, span_s, content=content)
    from geograph.io.oem import read_oem

    return read_oem(path, epoch_tai_ns, span_s, content=content)


def seconds_after(tai_ns: NDArray[np.int64], epoch_tai_ns: int) -> NDArray[np.float64]:
    """Return instants as seconds after an epoch."""
    return np.asarray((tai_ns - epoch_tai_ns) / SECOND_NS, dtype=np.float64)


def check_order(path: Path, tai_ns: NDArray[np.int64], lines: NDArray[np.int64]) -> None:
    """Raise InputError unless there are two points at least and their times increase."""
    if tai_ns.size < 2:
        raise InputError(f"has {tai_ns.size} points with a time; expected at least two", path=path)
    late = np.diff(tai_ns) > 0
    if not late.all():
        raise InputError(
            "is not later than the point before; expected times that increase; sort the points "
            "and drop repeats",
            path=path,
            line=int(lines[1:][~late][0]),
        )


def made_dense(
    time_s: NDArray[np.float64], position_m: NDArray[np.float64], span_s: Span
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the part of an ephemeris within a span, with points no farther apart than 10 s.

    Parameters
    ----------
    time_s
        Shape (n,), increasing.
    position_m
        Shape (n, 3), on axes in which the motion is smooth.
    span_s
        What is wanted; less where the ephemeris ends.

    Returns
    -------
    time_s, position_m
        The points themselves where they are dense, else of the spline of degree 7 through them
        (less with fewer than 8 points).
    """
    from scipy.interpolate import make_interp_spline

    # Beyond the span so many that its ends are inner points.
    near = np.searchsorted(time_s, span_s) + np.array([-8, 8])
    part = slice(max(int(near[0]), 0), max(int(near[1]), 0))
    time, position = time_s[part], position_m[part]
    if time.size < 2 or np.diff(time).max() <= LONGEST_STEP_S:
        return time, position
    first, last = max(time[0], span_s[0]), min(time[-1], span_s[1])
    if not first < last:
        return time, position
    degree = min(_DEGREE, (time.size - 1) // 2 * 2 + 1 if time.size > 2 else 1)
    degree = degree if degree < time.size else degree - 2
    dense = np.linspace(first, last, int(np.ceil((last - first) / LONGEST_STEP_S)) + 1)
    if dense.size < 2:
        dense = np.array([first, last])
    return dense, np.asarray(make_interp_spline(time, position, k=max(degree, 1))(dense))
