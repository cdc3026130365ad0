"""The check-up of a recording before it is solved: what a colleague would say.

Bearings are held against the smoother's own first guess of the path. Only where they miss it by far
more than sigmas and priors of biases and clocks allow are the mistakes that people make tried, each
with its repair: one is named when it makes the bearings meet.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from geograph.checkup.bearings import check_bearings
from geograph.checkup.findings import Finding
from geograph.checkup.scatter import check_scatter
from geograph.checkup.signals import check_signals
from geograph.checkup.speeds import check_speed
from geograph.checkup.summary import summary

if TYPE_CHECKING:
    from geograph.recording import Recording

__all__ = ["Finding", "doctor", "summary"]


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
    found = [
        *check_bearings(recording),
        *check_speed(recording),
        *check_signals(recording),
    ]
    # Angles in another unit than their sigmas' scatter by less.
    other = {
        name for entry in found if entry.kind == "radians" for name in entry.sensor.split(", ")
    }
    found += [entry for entry in check_scatter(recording) if entry.sensor not in other]
    order = ("problem", "question", "note")
    return sorted(found, key=lambda finding: order.index(finding.severity))
