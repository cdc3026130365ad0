"""When a sensor's errors begin anew, in its table of ``recording.toml``."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

from geograph.io.messages import shown
from geograph.io.tables import MAX_TIME_S

if TYPE_CHECKING:
    from geograph.io.document import Document, KeyPath
    from geograph.sensors import SensorErrors


def read_calibrations(
    document: Document, path: KeyPath, table: dict[str, Any], errors: SensorErrors
) -> tuple[float, ...] | Literal["auto"]:
    """Return when azimuth and elevation are calibrated, or ``"auto"``."""
    pointing = [
        value for name, value in vars(errors).items() if name.startswith(("azimuth_", "elevation_"))
    ]
    what = "bias, drift or instability of azimuth or elevation"
    if table.get("calibrations_s") == "auto":
        _check_errors(document, (*path, "calibrations_s"), pointing, what)
        return "auto"
    return _times(document, path, "calibrations_s", table, what, known=pointing, other=' or "auto"')


def read_clock_resets(
    document: Document, path: KeyPath, table: dict[str, Any], errors: SensorErrors
) -> tuple[float, ...]:
    """Return when the clock is set."""
    clock = [value for name, value in vars(errors).items() if name.startswith("clock_")]
    what = "clock offset, drift or instability"
    return _times(document, path, "clock_resets_s", table, what, known=clock)


def _times(
    document: Document,
    path: KeyPath,
    name: str,
    table: dict[str, Any],
    what: str,
    *,
    known: list[float],
    other: str = "",
) -> tuple[float, ...]:
    value, where = table.get(name, []), (*path, name)
    expected = f"expected a list of times in seconds, increasing, such as [12.5, 40.0]{other}"
    if not isinstance(value, list):
        document.fail(where, f"is {shown(value)}; {expected}")
    times = tuple(
        document.number(where, entry, low=-MAX_TIME_S, high=MAX_TIME_S) for entry in value
    )
    for before, after in pairwise(times):
        if not after > before:
            document.fail(where, f"has {after:g} after {before:g}; {expected}")
    if times:
        _check_errors(document, where, known, what)
    return times


def _check_errors(document: Document, path: KeyPath, known: list[float], what: str) -> None:
    if not max(known) > 0.0:
        document.fail(
            path,
            f"is there, and no error that would begin anew; expected a {what} above 0 in the "
            "errors; add it or remove this key",
        )
