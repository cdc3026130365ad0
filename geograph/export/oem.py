"""CCSDS orbit ephemeris messages (502.0-B-3) with covariance, in keyword = value notation.

States are the knots, in kilometres on the axes of the ITRF2000, with which WGS 84 (G1150 and later)
agrees to a centimetre or two. The covariance is that of position and velocity at every knot.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError
from geograph.export._place import Placed, placed, write_text
from geograph.io.instants import utc_text
from geograph.io.messages import shown

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.results import Results
    from geograph.track import Track

REFERENCE_FRAME = "ITRF2000"


def write_oem(
    track: Track | Results,
    path: Path | str,
    *,
    object_name: str | None = None,
    object_id: str | None = None,
    originator: str = "GEOGRAPH",
    created: datetime | None = None,
) -> None:
    """Write a path as an orbit ephemeris message.

    Parameters
    ----------
    track
        A track or its results; an object at rest has two states, at its first and last knot.
    path
        The file; an older one is replaced.
    object_name, object_id
        By default the recording's name; the identifier is meant to be the international
        designation, such as ``1998-067A``.
    originator, created
        Of the header; created now by default.

    Raises
    ------
    InputError
        If the path has no velocity, the covariance is not finite, or a name is not plain text.
    """
    target = Path(path)
    place = placed(track, target)
    results = place.results
    velocity, covariance = _motion(place, target)
    name = results.name if object_name is None else object_name
    for given in (name, object_id or name, originator):
        if not (given.isascii() and given.isprintable() and 0 < len(given) <= 100):
            raise InputError(
                f"cannot be written with the name {shown(given)}; expected plain printable text; "
                "give object_name",
                path=target,
            )
    rows = place.rows if not results.static else np.array([0, results.time_s.size - 1])
    if rows[0] == rows[-1]:
        rows = rows[:1]
    times = [utc_text(int(place.tai_ns[row]), 9) for row in rows]
    moment = datetime.now(UTC) if created is None else created.astimezone(UTC)
    lines = [
        "CCSDS_OEM_VERS = 2.0",
        f"COMMENT smoothed by geograph: {results.status}",
        f"CREATION_DATE = {moment.strftime('%Y-%m-%dT%H:%M:%S')}",
        f"ORIGINATOR = {originator}",
        "",
        "META_START",
        f"OBJECT_NAME = {name}",
        f"OBJECT_ID = {object_id or name}",
        "CENTER_NAME = EARTH",
        f"REF_FRAME = {REFERENCE_FRAME}",
        "TIME_SYSTEM = UTC",
        f"START_TIME = {times[0]}",
        f"STOP_TIME = {times[-1]}",
        *(["INTERPOLATION = HERMITE", "INTERPOLATION_DEGREE = 3"] if rows.size > 1 else []),
        "META_STOP",
        "",
    ]
    for row, time in zip(rows, times, strict=True):
        state = np.concatenate([results.position_m[row], velocity[row]]) * 1e-3
        lines.append(" ".join([time, *(_text(value) for value in state)]))
    lines += ["", "COVARIANCE_START"]
    for row, time in zip(rows, times, strict=True):
        lines += [f"EPOCH = {time}", f"COV_REF_FRAME = {REFERENCE_FRAME}"]
        lines += [
            " ".join(_text(value) for value in covariance[row, line, : line + 1] * 1e-6)
            for line in range(6)
        ]
    lines.append("COVARIANCE_STOP")
    write_text(target, "\n".join(lines) + "\n")


def _text(value: float) -> str:
    """Return a number with the digits that make it the same again."""
    return format(float(value), ".17g") if "e" in repr(float(value)) else repr(float(value))


def _motion(place: Placed, path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return velocities (k, 3) and covariances of position and velocity (k, 6, 6)."""
    results = place.results
    count = results.time_s.size
    velocity, covariance = results.velocity_m_s, results.motion_covariance
    if results.static:
        velocity = np.zeros((count, 3))
        covariance = np.zeros((count, 6, 6))
        covariance[:, :3, :3] = results.position_covariance_m2
    if velocity is None:
        raise InputError(
            "cannot hold a path without velocity, which the motion constant-position has; "
            "expected another motion; smooth with --motion constant-velocity",
            path=path,
        )
    if covariance is None:
        raise InputError(
            "needs the covariance of velocity, which these results, of an earlier version, do not "
            "have; smooth the recording again",
            path=path,
        )
    finite = np.isfinite(covariance).all(axis=(1, 2))
    if not finite.all():
        time = results.time_s[np.argmin(finite)]
        raise InputError(
            f"cannot hold the covariance at {time:.9g} s, which is not finite: the data do not "
            "determine the state there; the summary says what is not observable",
            path=path,
        )
    return velocity, covariance
