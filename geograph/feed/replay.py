"""A recording as a feed: its measurements in the order of time, at once or in step with a clock."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geograph.feed.rows import Row, row_text
from geograph.io.source import open_source
from geograph.io.table_columns import table_columns
from geograph.io.tables import find_table

if TYPE_CHECKING:
    from collections.abc import Iterator
    from threading import Event

    from geograph.feed.rows import Line
    from geograph.recording import Recording


class ReplaySource:
    """The measurements of a recording.

    Parameters
    ----------
    recording
        With its measurements.
    rate
        Seconds of the recording in a second of the clock; None: as fast as they are taken.
    begin_after
        Number of the last row that is not to be waited for: those before it are known already.
    """

    numbered = True

    def __init__(
        self, recording: Recording, *, rate: float | None = None, begin_after: int = 0
    ) -> None:
        self.place = str(recording.path or recording.name)
        self.rows = rows_of(recording)
        self._rate = rate
        self.begin_after = begin_after

    def items(self, stop: Event) -> Iterator[Line | Row]:
        """Yield rows, each at its time."""
        start: float | None = None
        for row in self.rows:
            if self._rate is not None and row.number > self.begin_after and row.time_s is not None:
                now = time.monotonic()
                if start is None:
                    start = now - row.time_s / self._rate
                stop.wait(max(0.0, start + row.time_s / self._rate - now))
            if stop.is_set():
                return
            yield row


def rows_of(recording: Recording) -> list[Row]:
    """Return all measurements and constraints of a recording, in the order of their time tags.

    What holds along the whole path comes first, and the arrivals of one emission stand together, at
    the time of the first.
    """
    place = Path(recording.path or recording.name)
    found: list[tuple[float, str, int, dict[str, float | str | None]]] = []
    for name, columns in table_columns(recording, place).items():
        if name == "truth":
            continue
        table = recording.constraints if name == "constraints" else recording.tables[name]
        assert table is not None
        values = [
            [None if math.isnan(value) else value for value in column.tolist()]
            if isinstance(column, np.ndarray)
            else list(column)
            for column in columns.values()
        ]
        order = table.time_s
        if recording.arrivals is not None and name == "arrivals":
            order = _first_arrivals(recording.arrivals.emission, order)
        rows = zip(order.tolist(), table.line.tolist(), zip(*values, strict=True), strict=True)
        found += [
            (
                -math.inf if math.isnan(at) else at,
                name,
                line,
                {
                    key: value
                    for key, value in zip(columns, cells, strict=True)
                    if value is not None or key == "time_s"
                },
            )
            for at, line, cells in rows
        ]
    found.sort(key=lambda entry: entry[0])
    places = _files(recording)
    return [
        Row(number, line or number, places.get(name, str(place)), name, cells)
        for number, (_, name, line, cells) in enumerate(found, start=1)
    ]


def json_lines(recording: Recording) -> Iterator[str]:
    """Yield a recording's measurements as the lines of a feed, each with its end.

    Parameters
    ----------
    recording
        With its measurements; numbers are written to the last digit.
    """
    for row in rows_of(recording):
        yield row_text(row) + "\n"


def _first_arrivals(emission: np.ndarray, toa_s: np.ndarray) -> np.ndarray:
    numbers, code = np.unique(emission, return_inverse=True)
    first = np.full(numbers.size, np.inf)
    np.minimum.at(first, code, toa_s)
    return np.asarray(first[code])


def _files(recording: Recording) -> dict[str, str]:
    """Return how the files of a recording's tables are called, by table."""
    if recording.path is None:
        return {}
    source = open_source(recording.path)
    named = {name: find_table(source, name) for name in (*recording.tables, "constraints")}
    return {name: str(source.place(file)) for name, file in named.items() if file is not None}
