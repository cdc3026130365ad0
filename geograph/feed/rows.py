"""One measurement a line: a JSON object with the names of a table's columns (docs/live.md)."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from geograph.errors import InputError
from geograph.io.constraint_table import CONSTRAINT_COLUMNS
from geograph.io.measurement_tables import MEASUREMENT_COLUMNS
from geograph.io.messages import expected_one_of, listed, plain, shown
from geograph.io.tables import ColumnSpec, Kind, bad_number, match_columns

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

TABLE_COLUMNS: Mapping[str, tuple[ColumnSpec, ...]] = {
    **MEASUREMENT_COLUMNS,
    "constraints": CONSTRAINT_COLUMNS,
}
"""Columns of every table that a line may belong to."""

LONGEST_LINE = 1 << 16
"""Bytes; what is longer is no measurement, and is not kept in memory."""

_TABLE_KEY = "table"
_SIGNS = {
    "azimuth_deg": "bearings",
    "azimuth_rad": "bearings",
    "toa_s": "arrivals",
    "tdoa_s": "time_differences",
    "fdoa_hz": "frequency_differences",
    "kind": "constraints",
}
"""Keys that say what kind of measurement a line holds."""

_DEEPEST = 20


class Line(NamedTuple):
    """A line of a feed as it came.

    Attributes
    ----------
    number
        Which one it is, from 1.
    text
        Its bytes, without the end of the line.
    cut
        Whether the end of it is missing: it was too long, or the connection ended.
    """

    number: int
    text: bytes
    cut: bool = False


@dataclass(frozen=True, slots=True)
class Row:
    """One measurement.

    Parameters
    ----------
    number
        Which line of the feed it is, from 1.
    line
        Line of the file that it stands in, by which it is named.
    place
        What that file is called.
    table
        Table that it belongs to.
    cells
        Its values by the names of the table's columns; None: an empty cell.
    """

    number: int
    line: int
    place: str
    table: str
    cells: Mapping[str, float | str | None]

    @property
    def time_s(self) -> float | None:
        """Its time tag, or None for what holds along the whole path."""
        value = self.cells.get("toa_s" if self.table == "arrivals" else "time_s")
        return value if isinstance(value, float) else None

    @property
    def key(self) -> bytes:
        """Digest of what it says: equal for lines that say the same."""
        text = json.dumps([self.table, sorted(self.cells.items())])
        return hashlib.blake2b(text.encode(), digest_size=8).digest()


class RowParser:
    """Makes rows of lines.

    Parameters
    ----------
    place
        What the feed is called in messages.
    """

    def __init__(self, place: Path | str) -> None:
        self._place = str(place)
        self._shapes: dict[tuple[str, ...], tuple[str, list[ColumnSpec]]] = {}

    def parse(self, line: Line) -> Row | None:
        """Return the row of a line, or None if the line is blank.

        Raises
        ------
        InputError
            If it is not a measurement: what is wrong, with the line's number and the column.
        """
        if not line.text.strip() and not line.cut:
            return None
        given = self._object(line)
        kind = given.pop(_TABLE_KEY, None)
        names = tuple(given)
        shape = self._shapes.get((str(kind), *names)) if isinstance(kind, str | None) else None
        if shape is None:
            table = self._table(kind, names, line)
            specs = match_columns(names, TABLE_COLUMNS[table], self._path, line=line.number)
            shape = table, specs
            if len(self._shapes) < 1000:
                self._shapes[str(kind), *names] = shape
        table, specs = shape
        cells = {
            name: self._cell(name, value, spec, line)
            for (name, value), spec in zip(given.items(), specs, strict=True)
        }
        return Row(line.number, line.number, self._place, table, cells)

    @property
    def _path(self) -> Path:
        from pathlib import Path

        return Path(self._place)

    def _fail(self, line: Line, message: str, column: str | None = None) -> InputError:
        return InputError(
            message,
            path=self._place,
            line=line.number,
            column=None if column is None else plain(column),
        )

    def _object(self, line: Line) -> dict[str, Any]:
        if line.cut:
            what = f"is longer than {LONGEST_LINE} bytes" if line.text else "ends in the middle"
            raise self._fail(line, f"{what}; expected one measurement a line")
        try:
            text = line.text.decode("utf-8-sig" if line.number == 1 else "utf-8")
            # Brackets by the thousand would exhaust the parser's stack.
            if text.count("[") + text.count("{") > _DEEPEST:
                raise ValueError("is nested too deeply")
            value = json.loads(text, object_pairs_hook=_unique)
        except UnicodeDecodeError as error:
            bad = error.object[error.start]
            raise self._fail(line, f"byte 0x{bad:02x} is not UTF-8; expected UTF-8") from None
        except json.JSONDecodeError as error:
            raise self._fail(
                line,
                f"{shown(error.doc.strip())} is not JSON ({error.msg}, character "
                f"{error.pos + 1}); expected one JSON object a line",
            ) from None
        except ValueError as error:
            raise self._fail(line, f"{error}; expected one flat JSON object a line") from None
        if not isinstance(value, dict):
            raise self._fail(line, f"{shown(value)} is not a JSON object; expected one a line")
        return value

    def _table(self, kind: object, names: tuple[str, ...], line: Line) -> str:
        if kind is not None:
            if not isinstance(kind, str) or kind not in TABLE_COLUMNS:
                expected = expected_one_of(str(kind), TABLE_COLUMNS)
                raise self._fail(line, f"unknown table {shown(kind)}; {expected}", _TABLE_KEY)
            return kind
        found = {_SIGNS[name]: name for name in names if name in _SIGNS}
        if len(found) == 1:
            return next(iter(found))
        if found:
            raise self._fail(
                line,
                f"{' and '.join(found.values())} in one line; expected one measurement a line",
            )
        for name in names:
            near = expected_one_of(name, _SIGNS)
            if near.startswith("did you mean"):
                raise self._fail(line, f"unknown column {shown(name)}; {near}", name)
        raise self._fail(
            line,
            f"found {listed(names) if names else 'no keys'}; expected a measurement, which has one "
            f"of {listed(_SIGNS)}",
        )

    def _cell(self, name: str, value: Any, spec: ColumnSpec, line: Line) -> float | str | None:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if spec.is_text:
            if number and spec.kind is Kind.LABEL:
                return str(value)
            if isinstance(value, str):
                return value.strip()
            given = "empty cell" if value is None else f"{shown(value)} is not text"
            wanted = "text or a number" if spec.kind is Kind.LABEL else "text"
            raise self._fail(line, f"{given}; expected {wanted}", name)
        if value is None and spec.may_be_empty:
            return None
        if not number:
            given = "empty cell" if value is None else f"{shown(value)} is not a number"
            raise self._fail(line, f"{given}; expected a finite number", name)
        try:
            result = float(value)
        except OverflowError:
            result = math.inf
        if not math.isfinite(result):
            raise self._fail(line, bad_number(str(result), spec), name)
        return result


def row_text(row: Row) -> str:
    """Return the line, without its end, that reads back as a row; its numbers to the last digit."""
    return json.dumps(row.cells, ensure_ascii=False)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{shown(twice)} is there twice")
    return found
