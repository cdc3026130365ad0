"""How much of long results a page draws, and numbers as short as a picture needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Limits:
    """The most of everything that is drawn of one result.

    Parameters
    ----------
    line
        Points of one line.
    frames
        Moments that the slider stops at.
    residuals
        Points of all panels of residuals together.
    panels
        Panels of residuals, and of errors that change.
    sensors
        Sensors on the map.
    rows
        Rows of a table.
    """

    line: int = 1000
    frames: int = 300
    residuals: int = 12000
    panels: int = 60
    sensors: int = 200
    rows: int = 60


def limits_for(count: int) -> Limits:
    """Return the limits of each of so many results on one page, so that it stays of one size."""
    if count <= 3:
        return Limits()
    share = 3.0 / count
    return Limits(
        line=max(150, round(1000 * share)),
        frames=max(60, round(300 * share)),
        residuals=max(600, round(12000 * share)),
        panels=max(12, round(60 * share)),
        sensors=max(40, round(200 * share)),
        rows=max(20, round(60 * share)),
    )


def thinned(values: NDArray[np.float64], most: int) -> NDArray[np.int64]:
    """Return rows of a line that still show its peaks, both ends among them.

    Parameters
    ----------
    values
        Shape (n,): what is drawn against the time, NaN allowed.
    most
        About how many rows are wanted; the line is cut into half as many pieces, and of each the
        lowest and the highest row are kept.

    Examples
    --------
    >>> peak = np.zeros(1000)
    >>> peak[437] = 1.0
    >>> rows = thinned(peak, 20)
    >>> bool(437 in rows), bool(rows.size <= 22)
    (True, True)
    """
    count = values.size
    if count <= most:
        return np.arange(count)
    edges = np.linspace(0, count, max(most // 2, 1) + 1).round().astype(np.int64)
    low = np.where(np.isnan(values), np.inf, values)
    high = np.where(np.isnan(values), -np.inf, values)
    kept = {0, count - 1}
    for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        kept.add(first + int(np.argmin(low[first:last])))
        kept.add(first + int(np.argmax(high[first:last])))
    return np.array(sorted(kept), dtype=np.int64)


def short(values: NDArray[np.float64], digits: int = 5) -> list[float | None]:
    """Return numbers for a picture: so many digits of the greatest, what is not finite as None.

    >>> short(np.array([1234.5678, 0.004, np.nan]))
    [1234.6, 0.0, None]
    """
    flat = np.asarray(values, dtype=np.float64).ravel()
    finite = np.isfinite(flat)
    largest = float(np.abs(flat[finite]).max()) if finite.any() else 0.0
    if largest == 0.0:
        return [0.0 if sound else None for sound in finite.tolist()]
    decimals = digits - 1 - int(np.floor(np.log10(largest)))
    kept = np.round(flat, decimals) + 0.0 if abs(decimals) < 300 else flat
    return [
        value if sound else None
        for value, sound in zip(kept.tolist(), finite.tolist(), strict=True)
    ]


def short_time(time_s: NDArray[np.float64]) -> list[float | None]:
    """Return times for a picture: to a hundred thousandth of their span."""
    span = float(np.ptp(time_s)) if time_s.size else 0.0
    if not np.isfinite(span) or span == 0.0:
        return [float(value) for value in time_s]
    decimals = 5 - int(np.floor(np.log10(span)))
    return [float(value) for value in np.round(time_s, decimals) + 0.0]
