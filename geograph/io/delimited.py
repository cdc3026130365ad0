"""Delimited text and logs as rows of named cells, as a mapping describes their layout."""

from __future__ import annotations

import csv
from functools import reduce
from operator import xor
from typing import TYPE_CHECKING

from geograph.errors import InputError
from geograph.io.mapping import TableMapping, wrong
from geograph.io.messages import expected_one_of, plain, shown
from geograph.io.source import decode, read_file

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

Cells = dict[str, str]
"""One row: texts by column."""


def check_columns(
    layout: TableMapping, present: Sequence[str], place: Path, line: int | None
) -> None:
    """Raise InputError unless every column of a mapping is there once."""
    for name in layout.columns:
        if present.count(name) != 1:
            what = f"no column {shown(name)}" if name not in present else f"two columns {name!r}"
            raise InputError(
                f"{what}, which the mapping names; {expected_one_of(name, present)}; check the "
                "mapping",
                path=place,
                line=line,
                column=plain(name),
            )


def text_rows(path: Path, layout: TableMapping) -> Iterator[tuple[int, Cells]]:
    """Yield the rows that the mapping wants, with their lines."""
    text = decode(read_file(path), path).replace("\r\n", "\n").replace("\r", "\n")
    names: list[str] | None = None
    for number, line in enumerate(text.split("\n"), start=1):
        comment = layout.comment and line.lstrip().startswith(layout.comment)
        if number <= layout.skip_lines or not line.strip() or comment:
            continue
        cells = _cells(line, layout, path, number)
        if names is None and layout.header:
            names = [cell.strip() for cell in cells]
            check_columns(layout, names, path, number)
            continue
        known = names if names is not None else [str(n) for n in range(1, len(cells) + 1)]
        row = dict(zip(known, (cell.strip() for cell in cells), strict=False))
        if any(row.get(name) not in values for name, values in layout.where):
            continue
        missing = [name for name in layout.columns if name not in row]
        if missing:
            raise wrong(
                path,
                number,
                plain(missing[0]),
                f"has {len(cells)} cells; expected one in this column",
            )
        yield number, row


def _cells(line: str, layout: TableMapping, path: Path, number: int) -> list[str]:
    if layout.checksum:
        line = _unwrapped(line.strip(), path, number)
    if layout.delimiter == "blank":
        return line.split()
    try:
        return next(csv.reader([line], delimiter=layout.delimiter, strict=True))
    except (csv.Error, TypeError, ValueError) as error:
        raise InputError(
            f"is not delimited by {layout.delimiter!r} ({error})", path=path, line=number
        ) from None


def _unwrapped(line: str, path: Path, number: int) -> str:
    """Return a sentence of NMEA 0183 without its checksum, which must be right."""
    body, star, given = line.partition("*")
    start = body.find("$")
    total = reduce(xor, (ord(letter) for letter in body[start + 1 :]), 0)
    if start < 0 or not star or given.upper() != f"{total:02X}":
        raise InputError(
            f"ends in {shown(star + given)}; expected a sentence from $ to *{total:02X}, its "
            "checksum; remove the line, or set checksum = false",
            path=path,
            line=number,
        )
    return body
