"""The check-up of a recording before it is solved: what a colleague would say.

Bearings are held against the smoother's own first guess of the path. Only where they miss it by far
more than sigmas and priors of biases and clocks allow are the mistakes that people make tried, each
with its repair: one is named when it makes the bearings meet.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from geograph.checkup.bearings import check_bearings
from geograph.checkup.findings import Finding
from geograph.checkup.fits import as_written
from geograph.checkup.scatter import check_scatter
from geograph.checkup.signals import check_signals
from geograph.checkup.speeds import check_speed
from geograph.checkup.summary import summary_of

if TYPE_CHECKING:
    from typing import Any

    from geograph.checkup.fits import Meeting
    from geograph.recording import Recording

__all__ = ["Finding", "check", "doctor", "summary"]

_ORDER = ("problem", "question", "note")


def doctor(recording: Recording) -> list[Finding]:
    """Return what a colleague would point out before solving, problems first; empty: nothing.

    Parameters
    ----------
    recording
        As read.

    Raises
    ------
    InputError
        If a sensor's axes are not supported.
    """
    return check(recording)[0]


def check(recording: Recording) -> tuple[list[Finding], dict[str, Any]]:
    """Return findings (:func:`doctor`) and what the recording holds (:func:`summary`)."""
    whole = as_written(recording)
    return _findings(recording, whole), summary_of(recording, whole)


def summary(recording: Recording) -> dict[str, Any]:
    """Return what a recording holds (:func:`geograph.checkup.summary.summary_of`)."""
    return summary_of(recording, as_written(recording))


def _findings(recording: Recording, whole: Meeting | None) -> list[Finding]:
    if not recording.tables:
        return [
            Finding(
                severity="problem",
                kind="empty",
                sensor="",
                file="recording.toml",
                text="the recording has no measurement",
                remedy="add a table, such as bearings.csv",
            )
        ]
    found = check_signals(recording)
    if whole is not None:
        # Where a sensor's mistake is named, the speed of the path is that mistake's.
        said = check_bearings(whole) or check_speed(whole)
        found += [*said, *_undone(whole.case.effort.undone, named=bool(said))]
    # Angles in another unit than their sigmas' scatter by less.
    other = {
        name for entry in found if entry.kind == "radians" for name in entry.sensor.split(", ")
    }
    found += [entry for entry in check_scatter(recording) if entry.sensor not in other]
    return sorted(found, key=lambda finding: _ORDER.index(finding.severity))


def _undone(names: list[str], *, named: bool) -> list[Finding]:
    if not names:
        return []
    return [
        Finding(
            severity="note" if named else "question",
            kind="not-tried",
            sensor="",
            file="bearings",
            text=f"bearings do not meet, and not all was tried: {', '.join(names)}",
            remedy="give the doctor fewer sensors at a time, such as two or three that should meet",
        )
    ]
