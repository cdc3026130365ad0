"""Where a feed comes from: standard input, a file (also one that is being written), TCP.

A source is iterated over in a thread of its own, which waits whenever the engine is behind.
"""

from __future__ import annotations

import os
import select
import stat
from typing import TYPE_CHECKING, Protocol

from geograph.errors import InputError
from geograph.feed.rows import LONGEST_LINE, Line

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from threading import Event

    from geograph.feed.rows import Row

_PIECE = 1 << 16
POLL_S = 0.1
"""How often a waiting source looks whether it is to stop, seconds."""


class Source(Protocol):
    """A feed.

    Attributes
    ----------
    place
        What it is called in messages.
    numbered
        Whether the same line has the same number whenever the source is read from its start.
    """

    @property
    def place(self) -> str:
        """What it is called in messages."""

    @property
    def numbered(self) -> bool:
        """Whether a line has the same number whenever the source is read from its start."""

    def items(self, stop: Event) -> Iterator[Line | Row]:
        """Yield lines, or rows that need no parsing, until the end or until ``stop`` is set."""


class LineSplitter:
    """Cuts what is read into lines; of a line too long for memory only the fact is kept."""

    def __init__(self) -> None:
        self._rest = b""
        self._skipping = False

    def feed(self, data: bytes) -> Iterator[tuple[bytes, bool]]:
        """Yield texts of whole lines, and whether each was too long."""
        *whole, rest = (self._rest + data).split(b"\n")
        for text in whole:
            long = self._skipping or len(text) > LONGEST_LINE
            self._skipping = False
            yield (text[:100], True) if long else (text.rstrip(b"\r"), False)
        if len(rest) > LONGEST_LINE:
            self._skipping, rest = True, rest[:100]
        self._rest = rest

    def rest(self) -> bytes:
        """Return what stands after the last end of a line."""
        return self._rest


class PipeSource:
    """Lines of a file descriptor: standard input.

    Parameters
    ----------
    descriptor
        Open for reading.
    place
        What it is called in messages.
    """

    numbered = False

    def __init__(self, descriptor: int = 0, place: str = "stdin") -> None:
        self._descriptor = descriptor
        self.place = place

    def items(self, stop: Event) -> Iterator[Line | Row]:
        """Yield lines until the writer closes."""
        splitter, number = LineSplitter(), 0
        regular = stat.S_ISREG(os.fstat(self._descriptor).st_mode)
        while not stop.is_set():
            if not regular and not select.select([self._descriptor], [], [], POLL_S)[0]:
                continue
            data = os.read(self._descriptor, _PIECE)
            for text, cut in splitter.feed(data):
                number += 1
                yield Line(number, text, cut)
            if not data:
                if splitter.rest():
                    yield Line(number + 1, splitter.rest())
                return


class FileSource:
    """Lines of a file.

    Parameters
    ----------
    path
        The file.
    follow
        Whether to wait for more at its end, as it is being written.

    Raises
    ------
    InputError
        If it cannot be read.
    """

    numbered = True

    def __init__(self, path: Path, *, follow: bool = False) -> None:
        self.place = str(path)
        self._follow = follow
        try:
            self._descriptor = os.open(path, os.O_RDONLY)
        except OSError as error:
            raise InputError(f"cannot be read ({error.strerror})", path=path) from None

    def items(self, stop: Event) -> Iterator[Line | Row]:
        """Yield lines; of a file that is followed only those that are ended.

        Raises
        ------
        InputError
            If the file became shorter than what was read of it.
        """
        splitter, number, offset = LineSplitter(), 0, 0
        while not stop.is_set():
            data = os.read(self._descriptor, _PIECE)
            offset += len(data)
            for text, cut in splitter.feed(data):
                number += 1
                yield Line(number, text, cut)
            if data:
                continue
            if not self._follow:
                if splitter.rest():
                    yield Line(number + 1, splitter.rest())
                return
            if os.fstat(self._descriptor).st_size < offset:
                raise InputError(
                    "became shorter while it was followed; expected a file that only grows; start "
                    "again, with another journal",
                    path=self.place,
                )
            stop.wait(POLL_S)
