"""What an incremental smoother says after every update."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy as np
    from numpy.typing import NDArray

    from geograph.recording import Frame
    from geograph.track import SensorEstimate


class Tracking(StrEnum):
    """How far an incremental smoother is."""

    COLLECTING = "collecting"
    """The measurements so far do not determine the path; the message says what is missing."""

    TRACKING = "tracking"
    """The newest knot is estimated."""


@dataclass(frozen=True)
class RowName:
    """What a measurement is called.

    Attributes
    ----------
    table
        Name of its table, or kind of its constraint.
    sensor
        Name of its sensor; empty for a constraint.
    time_s
        Its time tag.
    line
        Line of the file that it came from, or 0.
    """

    table: str
    sensor: str
    time_s: float
    line: int

    def __str__(self) -> str:
        """Return it in words."""
        of = f" of {self.sensor}" if self.sensor else ""
        where = f", line {self.line}" if self.line else ""
        return f"{self.table}{of} at {self.time_s:.10g} s{where}"


class SensorErrorsLater(Mapping[str, "dict[str, SensorEstimate]"]):
    """Errors by sensor and state, worked out when they are first asked for.

    Who follows the object from update to update reads them now and then: they would take as long
    as a tenth of an update.

    Parameters
    ----------
    work
        Gives them.
    """

    def __init__(self, work: Callable[[], dict[str, dict[str, SensorEstimate]]]) -> None:
        self._work: Callable[[], dict[str, dict[str, SensorEstimate]]] | None = work
        self._found: dict[str, dict[str, SensorEstimate]] = {}

    @property
    def _all(self) -> dict[str, dict[str, SensorEstimate]]:
        if self._work is not None:
            self._found = self._work()
            self._work = None
        return self._found

    def __getitem__(self, name: str) -> dict[str, SensorEstimate]:
        return self._all[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all)

    def __len__(self) -> int:
        return len(self._all)

    def __repr__(self) -> str:
        """Return them as a dictionary is printed."""
        return repr(self._all)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as a dictionary."""
        return dict, (self._all,)


@dataclass(frozen=True, eq=False, kw_only=True)
class Estimate:
    """The newest knot, the sensors' errors, and what became of the measurements.

    Attributes
    ----------
    status, message
        How far the smoother is, and one sentence about it.
    time_s
        Time of the newest knot; None while it collects.
    state, covariance
        Shapes (3m,), (3m, 3m): position, velocity, acceleration as far as the motion has them, SI
        units, in the frame; None while it collects.
    frame
        ``"ecef"`` or ``"local"``.
    sensor_errors
        By sensor and state, of the sensors that have measured.
    knots
        How many are held.
    used
        Measurements that count, or did when they left the lag.
    waiting
        Those that do not fit, and wait for later ones to judge them.
    rejected
        Those that later ones spoke against; they are asked again as long as they are held.
    duplicates, late
        Those of the last update that came again, or came after the lag: named, not used.
    duplicate_count, late_count, rejected_count
        How many in all.
    rebuilt
        How often the linear system was made anew.
    """

    status: Tracking
    message: str
    frame: Frame
    time_s: float | None = None
    state: NDArray[np.float64] | None = None
    covariance: NDArray[np.float64] | None = None
    sensor_errors: Mapping[str, dict[str, SensorEstimate]] = field(default_factory=dict)
    knots: int = 0
    used: int = 0
    waiting: tuple[RowName, ...] = ()
    rejected: tuple[RowName, ...] = ()
    duplicates: tuple[RowName, ...] = ()
    late: tuple[RowName, ...] = ()
    duplicate_count: int = 0
    late_count: int = 0
    rejected_count: int = 0
    rebuilt: int = 0
