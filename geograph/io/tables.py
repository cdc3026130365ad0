"""Tables of a recording: which columns they have, in which unit, and what their cells may hold.

A table is declared as a tuple of :class:`ColumnSpec`; :func:`read_table` reads a CSV or Parquet
file against it, and whatever does not fit is an error that names file, line and column.
Lines of a Parquet file are counted as in the CSV file of the same table: its first row is line 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from geograph.errors import InputError
from geograph.io.messages import expected_one_of, listed, plain, shown

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from geograph.io.source import Source

SUFFIXES = (".csv", ".parquet")

MAX_TIME_S = 1e11
"""Largest time tag: 3000 years; beyond it the unit is not seconds."""

MAX_COORDINATE_M = 1e15
"""Largest coordinate: a tenth of a light year; beyond it squares lose their meaning."""

MAX_VALUE = 1e15
"""Largest value of other columns."""


NO_ROWS = "has no rows; expected at least one below the header"


class Kind(Enum):
    """What the cells of a column hold."""

    NUMBER = "number"
    ANGLE = "angle"
    TEXT = "text"
    LABEL = "label"
    """Text too, for which Parquet files may have integers or floats."""


@dataclass(frozen=True)
class ColumnSpec:
    """One column of a table.

    Parameters
    ----------
    name
        Its name; for an angle without the unit, which is ``_deg`` or ``_rad`` in the file.
    kind
        What its cells hold.
    required
        Whether the column must be there.
    may_be_empty
        Whether a cell may be empty, which reads as NaN.
    limit
        Largest magnitude, in the unit of the name (degrees or radians: given as degrees).
    """

    name: str
    kind: Kind = Kind.NUMBER
    required: bool = True
    may_be_empty: bool = False
    limit: float = MAX_VALUE

    @property
    def is_text(self) -> bool:
        """Whether its cells are kept as text."""
        return self.kind in (Kind.TEXT, Kind.LABEL)

    @property
    def names_in_file(self) -> tuple[str, ...]:
        """Names that the column may have in a file."""
        if self.kind is Kind.ANGLE:
            return (f"{self.name}_deg", f"{self.name}_rad")
        return (self.name,)


@dataclass(frozen=True, eq=False)
class TextColumn:
    """A column of text: ``values[codes[i]]`` is the text of row i."""

    codes: NDArray[np.int64]
    values: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Table:
    """A table as it stands in its file.

    Parameters
    ----------
    place
        The file, for messages.
    line
        Shape (n,): line of every row.
    numbers
        Columns of numbers by their names in the file, each of shape (n,); NaN: an empty cell.
    texts
        Columns of text by name.
    """

    place: Path
    line: NDArray[np.int64]
    numbers: dict[str, NDArray[np.float64]]
    texts: dict[str, TextColumn]

    def __len__(self) -> int:
        return int(self.line.size)

    def column_of(self, quantity: str) -> str | None:
        """Return the name in the file of an angle given without unit, or None if it is absent."""
        for name in (f"{quantity}_deg", f"{quantity}_rad"):
            if name in self.numbers:
                return name
        return None

    def angle_rad(self, quantity: str) -> NDArray[np.float64]:
        """Return an angle in radians, shape (n,); NaN throughout if the column is absent."""
        name = self.column_of(quantity)
        if name is None:
            return np.full(len(self), np.nan)
        values = self.numbers[name]
        return np.radians(values) if name.endswith("_deg") else values

    def check(
        self, valid: NDArray[np.bool_], column: str, expected: str, *, given: str | None = None
    ) -> None:
        """Raise InputError at the first row where ``valid`` is false."""
        if not valid.all():
            self.fail(int(np.argmin(valid)), column, expected, given=given)

    def fail(self, row: int, column: str, expected: str, *, given: str | None = None) -> NoReturn:
        """Raise InputError at a row and column."""
        if given is None:
            given = f"{self.numbers[column][row]:.15g}"
        raise InputError(
            f"{given}; {expected}", path=self.place, line=int(self.line[row]), column=plain(column)
        )


def find_table(source: Source, stem: str) -> str | None:
    """Return the name of the file that holds a table, or None; InputError if there are two."""
    present = [stem + suffix for suffix in SUFFIXES if source.has(stem + suffix)]
    if len(present) > 1:
        raise InputError(
            f"both {present[0]} and {present[1]} are there; expected one; remove the other",
            path=source.path,
        )
    return present[0] if present else None


def read_table(
    source: Source, name: str, specs: Sequence[ColumnSpec], *, may_be_empty: bool = False
) -> Table:
    """Read one file as a table.

    Parameters
    ----------
    source
        The recording.
    name
        File name; its suffix says the format.
    specs
        The columns that the table may have.
    may_be_empty
        Whether a header without rows is a table, of length zero.

    Raises
    ------
    InputError
        If the file is missing or damaged, a column is missing, unknown, there twice or in two
        units, a cell does not fit its column, or there is no row.
    """
    place = source.place(name)
    content = source.read_bytes(name)
    if name.endswith(".parquet"):
        from geograph.io.parquet_table import parse_parquet as parse
    else:
        from geograph.io.csv_table import parse_csv as parse
    table = parse(content, place, specs)
    if not len(table) and not may_be_empty:
        raise InputError(NO_ROWS, path=place)
    check_magnitudes(table, specs)
    return table


def match_columns(
    names: Sequence[str], specs: Sequence[ColumnSpec], place: Path, *, line: int | None
) -> list[ColumnSpec]:
    """Return the declaration of every column of a file, in the file's order.

    Raises
    ------
    InputError
        If a column is unknown, nameless, there twice, in two units, or a required one is missing.
    """
    by_name = {name: spec for spec in specs for name in spec.names_in_file}
    seen: dict[str, str] = {}
    matched = []
    for number, name in enumerate(names, start=1):
        if not name:
            raise InputError(
                f"column {number} has no name; expected one of {listed(by_name)}",
                path=place,
                line=line,
            )
        spec = by_name.get(name)
        if spec is None:
            hint = "; separate columns by commas" if ";" in name or "\t" in name else ""
            raise InputError(
                f"unknown column {shown(name)}; {expected_one_of(name, by_name)}{hint}",
                path=place,
                line=line,
                column=plain(name),
            )
        if spec.name in seen:
            other = seen[spec.name]
            twice = "there twice" if other == name else f"there beside {other}"
            raise InputError(
                f"{name} is {twice}; expected one column of {spec.name}; remove the other",
                path=place,
                line=line,
                column=name,
            )
        seen[spec.name] = name
        matched.append(spec)
    for spec in specs:
        if spec.required and spec.name not in seen:
            raise InputError(
                f"column {' or '.join(spec.names_in_file)} is missing; found {listed(names)}; "
                "add it",
                path=place,
                line=line,
                column=spec.names_in_file[0],
            )
    return matched


def check_magnitudes(table: Table, specs: Sequence[ColumnSpec]) -> None:
    """Raise InputError at the first number beyond the limit of its column."""
    for spec in specs:
        for name in spec.names_in_file:
            if name not in table.numbers:
                continue
            limit, hint = spec.limit, ""
            if spec.kind is Kind.ANGLE:
                hint = "; is the column in another unit?"
                if name.endswith("_rad"):
                    limit = float(np.radians(limit))
            values = table.numbers[name]
            fits = np.isnan(values) | (np.abs(values) <= limit)
            table.check(fits, name, f"expected {-limit:.6g} to {limit:.6g}{hint}")


def bad_number(text: str, spec: ColumnSpec) -> str:
    """Return what is wrong with the text of a cell that should be a finite number."""
    stripped = text.strip()
    expected = "expected a finite number"
    if not stripped:
        empty = "" if spec.may_be_empty else "empty cell; "
        return f"{empty}{expected}; fill it in or remove the row"
    try:
        value = float(stripped)
    except ValueError:
        return f"{shown(text)} is not a number; {expected}"
    if np.isnan(value):
        instead = "leave the cell empty" if spec.may_be_empty else "remove the row"
        return f"{shown(text)} is not a number; {expected}; {instead}"
    if np.isinf(value):
        return f"{shown(text)} is infinite; {expected}; remove the row"
    # Python's own notation, such as 1_000 or digits of other scripts.
    return f"{shown(text)} is not a plain number; {expected} such as -12.5 or 1e-3"


class TextBuilder:
    """Collects a column of text piece by piece, each different text stored once."""

    def __init__(self) -> None:
        self._vocabulary: dict[str, int] = {}
        self._pieces: list[NDArray[np.int64]] = []

    def extend(self, values: Sequence[str]) -> None:
        """Append texts."""
        codes = self._vocabulary
        self._pieces.append(
            np.array([codes.setdefault(value, len(codes)) for value in values], dtype=np.int64)
        )

    def column(self) -> TextColumn:
        """Return what was collected."""
        pieces = self._pieces or [np.empty(0, dtype=np.int64)]
        return TextColumn(np.concatenate(pieces), tuple(self._vocabulary))
