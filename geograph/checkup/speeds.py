"""Whether the object that bearings describe moves at a speed that anything has."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.checkup.findings import Finding
from geograph.factors.constraints import altitude

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.checkup.fits import Meeting
    from geograph.recording import Recording

# Meteors reach 72 km/s. Below the least speed, over the least way, nothing is tracked but snails;
# in low orbits, balloons being below and geostationary satellites above, nothing stands still.
_FASTEST_M_S = 100e3
_SLOWEST_M_S = 0.3
_SLOWEST_IN_SPACE_M_S = 300.0
_LEAST_WAY_M = 300.0
_LEAST_SPAN_S = 300.0
_LOW_ORBIT_M = (120e3, 20e6)


def check_speed(meeting: Meeting) -> list[Finding]:
    """Return whether times of all sensors seem to be in another unit.

    Only where the bearings meet: elsewhere the path means nothing.

    Parameters
    ----------
    meeting
        The bearings as written, and the path through them.
    """
    case, recording = meeting.case, meeting.case.recording
    if len(case.active) < 2 or recording.settings.motion == "static":
        return []
    time = np.unique(case.bearings.time_s)
    if meeting.excess > 1.0 or time.size < 5:
        return []
    place = meeting.fit.spline(time)
    way = float(np.linalg.norm(place[-1] - place[0]))
    speed = way / float(np.ptp(time))
    long = float(np.ptp(time)) > _LEAST_SPAN_S and way > _LEAST_WAY_M
    if speed > _FASTEST_M_S:
        severity, unit = "problem", "multiplied by 1000"
    elif long and speed < (_SLOWEST_IN_SPACE_M_S if _in_space(recording, place) else _SLOWEST_M_S):
        severity, unit = "question", "divided by 1000, as if they were milliseconds"
    else:
        return []
    return [
        Finding(
            severity="problem" if severity == "problem" else "question",
            kind="time-unit",
            sensor="",
            file="bearings",
            text=f"the object would move at {speed:.3g} m/s; with all times {unit}, at "
            f"{speed / 1000.0 if severity == 'problem' else speed * 1000.0:.3g} m/s",
            remedy="give times in seconds after the epoch",
        )
    ]


def _in_space(recording: Recording, place: NDArray[np.float64]) -> bool:
    """Tell whether a path is where only what orbits stays up."""
    if recording.frame != "ecef" or not (np.linalg.norm(place, axis=1) > 1e6).all():
        return False
    height = float(np.median(altitude(place, "ecef")[0]))
    return _LOW_ORBIT_M[0] < height < _LOW_ORBIT_M[1]
