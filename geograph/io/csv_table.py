"""CSV files as tables: comma separated, UTF-8, a header in the first line (RFC 4180)."""

from __future__ import annotations

import csv
import io
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError
from geograph.io.messages import plain
from geograph.io.source import decode
from geograph.io.tables import ColumnSpec, Table, TextBuilder, bad_number, match_columns

if TYPE_CHECKING:
    from _csv import Reader
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

# Large enough for the speed of whole columns; small enough that the garbage collector has little to
# walk through, and that the texts of a long table are never all in memory.
_ROWS_AT_ONCE = 1 << 9


def parse_csv(content: bytes, place: Path, specs: Sequence[ColumnSpec]) -> Table:
    """Return the table in a CSV file; blank lines are skipped, spaces around cells are dropped.

    Parameters
    ----------
    content
        The file.
    place
        How it is called in messages.
    specs
        The columns it may have.

    Raises
    ------
    InputError
        See :func:`geograph.io.tables.read_table`.
    """
    text = decode(content, place)
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        header = next(reader, None)
        if not header:
            found = "is empty" if not text.strip() else "has no header in its first line"
            raise InputError(f"{found}; expected a header and rows", path=place, line=1)
        names = [name.strip() for name in header]
        matched = match_columns(names, specs, place, line=1)
        builder = _Builder(place, names, matched)
        # Only within quotes can a row go over several lines.
        pieces = _quoted_pieces(reader) if '"' in text else _plain_pieces(reader)
        for rows, lines in pieces:
            if [] not in rows:
                builder.add(rows, lines)
            elif kept := [index for index, row in enumerate(rows) if row]:
                builder.add([rows[index] for index in kept], lines[kept])
    except csv.Error as error:
        raise InputError(
            f"is not valid CSV ({error}); expected commas between cells and paired quotes",
            path=place,
            line=reader.line_num,
        ) from None
    return builder.table()


def _plain_pieces(reader: Reader) -> Iterator[tuple[list[list[str]], NDArray[np.int64]]]:
    line = reader.line_num + 1
    while rows := list(islice(reader, _ROWS_AT_ONCE)):
        yield rows, np.arange(line, line + len(rows), dtype=np.int64)
        line += len(rows)


def _quoted_pieces(reader: Reader) -> Iterator[tuple[list[list[str]], NDArray[np.int64]]]:
    """Yield rows with the lines in which they begin."""
    line = reader.line_num + 1
    while True:
        rows, lines = [], []
        for row in islice(reader, _ROWS_AT_ONCE):
            rows.append(row)
            lines.append(line)
            line = reader.line_num + 1
        if not rows:
            return
        yield rows, np.array(lines, dtype=np.int64)


class _Builder:
    """Converts rows to columns, a piece of the file at a time."""

    def __init__(self, place: Path, names: list[str], specs: list[ColumnSpec]) -> None:
        self._place = place
        self._columns = list(zip(names, specs, strict=True))
        self._lines: list[NDArray[np.int64]] = []
        self._numbers: dict[str, list[NDArray[np.float64]]] = {
            name: [] for name, spec in self._columns if not spec.is_text
        }
        self._texts = {name: TextBuilder() for name, spec in self._columns if spec.is_text}

    def add(self, rows: list[list[str]], lines: NDArray[np.int64]) -> None:
        width = len(self._columns)
        if set(map(len, rows)) != {width}:
            row, line = next((r, n) for r, n in zip(rows, lines, strict=True) if len(r) != width)
            raise InputError(
                f"{len(row)} cells; expected {width} as in the header; is a comma missing or "
                "one too many?",
                path=self._place,
                line=int(line),
            )
        self._lines.append(lines)
        for (name, spec), cells in zip(self._columns, zip(*rows, strict=True), strict=True):
            if spec.is_text:
                self._texts[name].extend([cell.strip() for cell in cells])
            else:
                self._numbers[name].append(self._convert(name, spec, cells, lines))

    def _convert(
        self, name: str, spec: ColumnSpec, cells: Sequence[str], lines: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        joined = "".join(cells)
        # float() also takes 1_000 and digits of other scripts, which nobody means in a table.
        if joined.isascii() and "_" not in joined:
            try:
                values = np.array(
                    [float(cell) if cell or not spec.may_be_empty else np.nan for cell in cells]
                )
            except ValueError:
                pass
            else:
                finite = int(np.isfinite(values).sum())
                if finite == len(cells) or (
                    spec.may_be_empty and finite + cells.count("") == len(cells)
                ):
                    return values
        return self._convert_one_by_one(name, spec, cells, lines)

    def _convert_one_by_one(
        self, name: str, spec: ColumnSpec, cells: Sequence[str], lines: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        values = np.empty(len(cells))
        for index, (cell, line) in enumerate(zip(cells, lines, strict=True)):
            text = cell.strip()
            if not text and spec.may_be_empty:
                values[index] = np.nan
                continue
            number = _plain_number(text)
            if number is None:
                raise InputError(
                    bad_number(cell, spec), path=self._place, line=int(line), column=plain(name)
                )
            values[index] = number
        return values

    def table(self) -> Table:
        return Table(
            place=self._place,
            line=np.concatenate([np.empty(0, dtype=np.int64), *self._lines]),
            numbers={
                name: np.concatenate([np.empty(0), *pieces])
                for name, pieces in self._numbers.items()
            },
            texts={name: builder.column() for name, builder in self._texts.items()},
        )


def _plain_number(text: str) -> float | None:
    if not text.isascii() or "_" in text:
        return None
    try:
        value = float(text)
    except ValueError:
        return None
    return value if np.isfinite(value) else None
