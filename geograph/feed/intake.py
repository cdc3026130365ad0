"""From a source to batches: what waits goes into one update, and nothing is dropped.

A thread reads the source into a queue of bounded length. When the engine is behind, the queue
fills, the thread waits, and whoever writes to the pipe or the connection waits with it.
"""

from __future__ import annotations

import math
import queue
import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from geograph.errors import InputError
from geograph.feed.rows import Line, Row, RowParser
from geograph.feed.sources import POLL_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from geograph.feed.sources import Source

QUEUE_LENGTH = 2048
"""Lines that wait at most in the queue, which is also the most that go into one update."""


@dataclass
class Batch:
    """Rows for one update.

    Attributes
    ----------
    rows
        In the order in which they came.
    last
        Number of the last line that was read for it.
    """

    rows: list[Row] = field(default_factory=list)
    last: int = 0


@dataclass(frozen=True)
class _End:
    error: BaseException | None


class Intake:
    """Reads a source in a thread, and gives its rows in batches.

    Parameters
    ----------
    source
        The feed.
    every_s
        Seconds of the feed's own time in one batch, which then waits for the first row of the
        next; None: whatever waits.
    on_error
        Called with what is wrong with a line that is no measurement.
    skip
        Tells of a row whether it is known already and is to be passed over.
    """

    def __init__(
        self,
        source: Source,
        *,
        every_s: float | None,
        on_error: Callable[[InputError], None],
        skip: Callable[[Line | Row], bool] = lambda _: False,
    ) -> None:
        self._source = source
        self._every_s = every_s
        self._on_error = on_error
        self._skip = skip
        self._parser = RowParser(source.place)
        self._queue: queue.Queue[Line | Row | _End] = queue.Queue(QUEUE_LENGTH)
        self._stop = threading.Event()
        self._gone = threading.Event()
        self._thread = threading.Thread(target=self._read, name="feed", daemon=True)
        self.lines = 0

    def stop(self) -> None:
        """Ask for the end; may be called from a signal handler.

        What was taken from a pipe or a connection, and nobody could read again, is still given;
        what waits of a file or a recording is not.
        """
        self._stop.set()

    @property
    def stopped(self) -> bool:
        """Whether the end was asked for."""
        return self._stop.is_set()

    def batches(self) -> Iterator[Batch]:
        """Yield batches until the source ends or the end is asked for.

        Raises
        ------
        InputError, OSError
            What the source raised.
        """
        self._thread.start()
        make = self._waiting() if self._every_s is None else self._slots(self._every_s)
        try:
            yield from make
        finally:
            self._stop.set()
            self._gone.set()
            self._thread.join(5.0 * POLL_S)

    def _read(self) -> None:
        error: BaseException | None = None
        try:
            for item in self._source.items(self._stop):
                if not self._put(item):
                    return
        except Exception as raised:
            error = raised
        self._put(_End(error))

    @property
    def _ended(self) -> bool:
        """Whether what is still in the queue is not wanted."""
        return self._gone.is_set() or (self._stop.is_set() and self._source.numbered)

    def _put(self, item: Line | Row | _End) -> bool:
        while not self._ended:
            try:
                self._queue.put(item, timeout=POLL_S)
            except queue.Full:
                continue
            return True
        return False

    def _next(self) -> Line | Row | _End | None:
        """Return the next of the queue as soon as it is there; None: the end was asked for."""
        while not self._ended:
            try:
                return self._queue.get(timeout=POLL_S)
            except queue.Empty:
                continue
        return None

    def _row(self, item: Line | Row) -> Row | None:
        """Return the row of an item, or None if it is none or is known already."""
        self.lines += 1
        if self._skip(item):
            return None
        if isinstance(item, Row):
            return item
        try:
            row = self._parser.parse(item)
        except InputError as error:
            self._on_error(error)
            return None
        return None if row is None or self._skip(row) else row

    def _waiting(self) -> Iterator[Batch]:
        while (item := self._next()) is not None:
            batch, count = Batch(), 0
            while not isinstance(item, _End):
                count += 1
                batch.last = item.number
                row = self._row(item)
                if row is not None:
                    batch.rows.append(row)
                if count == QUEUE_LENGTH:
                    break
                try:
                    item = self._queue.get_nowait()
                except queue.Empty:
                    break
            if batch.rows:
                yield batch
            if isinstance(item, _End):
                _raise(item)
                return

    def _slots(self, every_s: float) -> Iterator[Batch]:
        batch, slot = Batch(), -math.inf
        while (item := self._next()) is not None:
            row = None if isinstance(item, _End) else self._row(item)
            at = None if row is None or row.time_s is None else math.floor(row.time_s / every_s)
            later = at is not None and at > slot > -math.inf and not _belongs(row, batch)
            if batch.rows and (later or isinstance(item, _End) or len(batch.rows) == QUEUE_LENGTH):
                yield batch
                batch, slot = Batch(), -math.inf
            if isinstance(item, _End):
                _raise(item)
                return
            batch.last = item.number
            if row is not None:
                batch.rows.append(row)
                if at is not None and slot == -math.inf:
                    slot = at


def _belongs(row: Row | None, batch: Batch) -> bool:
    """Whether a row is of an emission whose last row is in the batch."""
    if row is None or row.table != "arrivals" or not batch.rows:
        return False
    return batch.rows[-1].cells.get("emission") == row.cells["emission"]


def _raise(end: _End) -> None:
    if end.error is not None:
        raise end.error
