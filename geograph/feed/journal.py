"""The journal: measurements on disk before they are used, so that nothing is lost (docs/live.md).

A text file, one record a line: the CRC-32 of its JSON as eight hexadecimal digits, the length of
the JSON in bytes, and the JSON. The first record says of which configuration it is; each other
holds the rows of one update. A record is appended and forced to disk before the engine sees its
rows, so that a process killed at any moment leaves whole records and at most one that is torn,
whose rows nobody has used.
"""

from __future__ import annotations

import fcntl
import json
import os
import zlib
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from geograph.errors import InputError
from geograph.feed.intake import Batch
from geograph.feed.rows import Row

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

FORMAT_VERSION = 1
_NAME = "geograph journal"


@dataclass(frozen=True)
class Resumed:
    """What a journal held when it was opened.

    Attributes
    ----------
    batches
        Of every update, in their order.
    torn_bytes
        Size of the torn record that was cut off.
    """

    batches: list[Batch] = field(default_factory=list)
    torn_bytes: int = 0

    @property
    def last(self) -> int:
        """Number of the last line that was read."""
        return self.batches[-1].last if self.batches else 0

    def rows(self) -> Iterator[Row]:
        """Yield all rows."""
        for batch in self.batches:
            yield from batch.rows


class Journal:
    """A journal, opened for appending; one process at a time has it.

    Parameters
    ----------
    path
        The file, made if absent.
    header
        Facts that must be the same whenever it is opened, by what a message calls them.

    Attributes
    ----------
    resumed
        What it held.

    Raises
    ------
    InputError
        If it is no journal, is damaged, belongs to another configuration, or is in use.
    OSError
        If it cannot be written.
    """

    def __init__(self, path: Path, header: Mapping[str, str]) -> None:
        self._path = path
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError as error:
            raise InputError(
                f"cannot be opened ({error.strerror}); expected a journal, or a name for a new one",
                path=path,
            ) from None
        try:
            self._lock()
            self._end = 0
            self.resumed = self._read(header)
            if not self._end:
                self._append(_header(header))
                _sync_folder(path)
        except BaseException:
            os.close(self._descriptor)
            raise

    def append(self, batch: Batch) -> None:
        """Append the rows of one update and force them to disk.

        Raises
        ------
        OSError
            If that fails. The journal then ends with the last whole record.
        """
        rows = [[row.number, row.line, row.place, row.table, row.cells] for row in batch.rows]
        self._append({"last": batch.last, "rows": rows})

    def close(self) -> None:
        """Close the file, and let others have it."""
        os.close(self._descriptor)

    def _append(self, value: Mapping[str, Any]) -> None:
        record = memoryview(_record(value))
        try:
            written = 0
            while written < len(record):
                written += os.pwrite(self._descriptor, record[written:], self._end + written)
            os.fsync(self._descriptor)
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._descriptor, self._end)
            reason = (
                f"{error.strerror}; the journal is whole up to the update before, and what came "
                "after it was not used; make room and give the same command again"
            )
            raise OSError(error.errno, reason, str(self._path)) from error
        self._end += len(record)

    def _lock(self) -> None:
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(
                "is in use by another process; expected a journal of its own for each",
                path=self._path,
            ) from None

    def _read(self, header: Mapping[str, str]) -> Resumed:
        with open(self._descriptor, "rb", closefd=False) as file:
            content = file.read()
        records, end = self._records(content)
        if records:
            self._check_header(records[0], header)
        elif not _record(_header(header)).startswith(content):
            raise InputError(
                "is not a journal of geograph and is not overwritten; name another",
                path=self._path,
            )
        torn = len(content) - end
        if torn:
            os.ftruncate(self._descriptor, end)
        self._end = end
        return Resumed([_batch(record) for record in records[1:]], torn)

    def _records(self, content: bytes) -> tuple[list[dict[str, Any]], int]:
        """Return the whole records, and where the last of them ends."""
        records: list[dict[str, Any]] = []
        end = 0
        for number, line in enumerate(content.splitlines(keepends=True), start=1):
            value = _value(line)
            if value is None:
                if records and not _may_be_torn(content[end:]):
                    raise InputError(
                        "is damaged, and more stands behind it; expected a journal as it was "
                        "written; bring back a copy of it, or begin another",
                        path=self._path,
                        line=number,
                    )
                break
            records.append(value)
            end += len(line)
        return records, end

    def _check_header(self, found: Mapping[str, Any], header: Mapping[str, str]) -> None:
        if found.get("journal") != _NAME or found.get("format") != FORMAT_VERSION:
            raise InputError(
                f"is not a journal of format {FORMAT_VERSION}; name another", path=self._path
            )
        for name, value in header.items():
            if found.get(name) != value:
                raise InputError(
                    f"belongs to other {name}; expected those of the command that began it; give "
                    "that command, or name another journal",
                    path=self._path,
                )


def _header(facts: Mapping[str, str]) -> dict[str, Any]:
    return {"journal": _NAME, "format": FORMAT_VERSION, **facts}


def _record(value: Mapping[str, Any]) -> bytes:
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":")).encode()
    return b"%08x %d " % (zlib.crc32(text), len(text)) + text + b"\n"


def _may_be_torn(tail: bytes) -> bool:
    """Whether what follows the whole records is the beginning of one, or one never forced to disk.

    A record that was used is followed by nothing or by another one, so that the end of a torn one
    is the end of the file.
    """
    _, digits, text = (*tail.split(b" ", 2), b"", b"")[:3]
    if digits.isdigit() and len(digits) <= 12:
        return len(text) <= int(digits) + 1
    return b"\n" not in tail[:-1]


def _value(line: bytes) -> dict[str, Any] | None:
    """Return what a record holds, or None if it is not whole."""
    digits, length, text = (*line.split(b" ", 2), b"", b"")[:3]
    if not text.endswith(b"\n") or length != b"%d" % (len(text) - 1):
        return None
    if digits != b"%08x" % zlib.crc32(text[:-1]):
        return None
    value = json.loads(text)
    return value if isinstance(value, dict) else None


def _batch(record: Mapping[str, Any]) -> Batch:
    return Batch([Row(*fields) for fields in record["rows"]], record["last"])


def _sync_folder(path: Path) -> None:
    descriptor = os.open(path.absolute().parent, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
