"""Measurements as they are held: columns by kind, each row with a number of its own.

Every kind is a dictionary of columns of equal length. Beside those of its table a row has ``ident``
(a number of its own), ``kept`` (whether it counts), ``judged`` (whether what came later has been
asked about one that does not count) and ``delay_s`` (about how long its signal took).
"""

from __future__ import annotations

from dataclasses import fields, replace
from math import isnan
from typing import TYPE_CHECKING, Any, Final, get_args

import numpy as np

from geograph.errors import UpdateError
from geograph.kernels import compiled
from geograph.measurements import (
    Arrivals,
    Bearings,
    ConstraintKind,
    Constraints,
    FrequencyDifferences,
    TimeDifferences,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from geograph.measurements import Measurements

Columns = dict[str, "NDArray[Any]"]
Rows = dict[str, Columns]
"""Columns by kind: the tables that sensors fill, each kind of constraint, and fixes."""

TABLES: Final[dict[str, type]] = {
    "bearings": Bearings,
    "arrivals": Arrivals,
    "time_differences": TimeDifferences,
    "frequency_differences": FrequencyDifferences,
}
CONSTRAINTS: Final = get_args(ConstraintKind)
FIXES: Final = "fixes"

_OWN: Final = ("ident", "kept", "judged", "delay_s")
_NAMES = {table: name for name, table in TABLES.items()}
_FIELDS = {
    name: tuple(entry.name for entry in fields(table) if entry.name != "emission_names")
    for name, table in TABLES.items()
}
_INTEGERS: Final = {"line", "sensor", "reference", "emission"}
_BEARING: Final = (
    *("time_s", "sensor", "azimuth_rad", "elevation_rad"),
    *("sigma_azimuth_rad", "sigma_elevation_rad"),
)
# Columns in which a value that is not a number means something.
_MAY_BE_MISSING: Final = ("elevation_rad", "sigma_elevation_rad")
_IDENTITY: Final = {"line", *_OWN}


class Emissions:
    """Numbers of emissions that have names: the same name is the same emission in every table.

    New names are only noted until :meth:`commit`, and forgotten by :meth:`begin`.
    """

    def __init__(self) -> None:
        self._held: dict[str, int] = {}
        self._names: dict[int, str] = {}
        self._fresh: dict[str, int] = {}
        self._next = 0

    def __len__(self) -> int:
        return len(self._held)

    def begin(self) -> None:
        """Forget what an update noted that was not committed."""
        self._fresh = {}

    def number(self, name: str) -> int:
        """Return the number of a name, a new one if it was not known."""
        known = self._held.get(name)
        if known is not None:
            return known
        return self._fresh.setdefault(name, self._next + len(self._fresh))

    def commit(self, gone: Iterable[int]) -> None:
        """Take over new names, and let those of emissions go that nothing is held of."""
        self._next += len(self._fresh)
        self._held.update(self._fresh)
        self._names.update((number, name) for name, number in self._fresh.items())
        self._fresh = {}
        for number in gone:
            name = self._names.pop(number, None)
            if name is not None:
                del self._held[name]


def time_column(kind: str) -> str:
    """Return the name of a kind's time tags."""
    return "toa_s" if kind == "arrivals" else "time_s"


def count(rows: Rows) -> int:
    """Return the number of rows of all kinds."""
    return sum(columns["ident"].size for columns in rows.values())


def take(columns: Columns, chosen: NDArray[Any] | slice) -> Columns:
    """Return some rows, by a mask, by indices, or from one to another."""
    return {name: column[chosen] for name, column in columns.items()}


def join(parts: Sequence[Rows]) -> Rows:
    """Return the rows of several parts, kind by kind."""
    if len(parts) == 1:
        return dict(parts[0])
    held: dict[str, list[Columns]] = {}
    for part in parts:
        for kind, columns in part.items():
            held.setdefault(kind, []).append(columns)
    return {
        kind: columns[0]
        if len(columns) == 1
        else {name: np.concatenate([c[name] for c in columns]) for name in columns[0]}
        for kind, columns in held.items()
    }


def choose(rows: Rows, chosen: dict[str, NDArray[Any]]) -> Rows:
    """Return some rows of every kind; kinds of which nothing is left are left out."""
    result = {}
    for kind, columns in rows.items():
        part = take(columns, chosen[kind])
        if part["ident"].size:
            result[kind] = part
    return result


def table_of(kind: str, columns: Columns) -> Measurements:
    """Return the table of a kind's rows."""
    return TABLES[kind](**{name: columns[name] for name in _FIELDS[kind]})  # type: ignore[no-any-return]


def numbered_table(kind: str, columns: Columns) -> Measurements:
    """Return the table of a kind's rows, their own numbers in place of the lines."""
    return replace(table_of(kind, columns), line=columns["ident"])


def keys(kind: str, columns: Columns) -> list[tuple[Any, ...]]:
    """Return what tells rows apart: everything that was measured, but not the line."""
    parts = [column.tolist() for name, column in columns.items() if name not in _IDENTITY]
    for place, name in enumerate(name for name in columns if name not in _IDENTITY):
        if name in _MAY_BE_MISSING and np.isnan(columns[name]).any():
            # What is not a number is not equal to itself.
            parts[place] = [None if isnan(value) else value for value in parts[place]]
    return [(kind, *values) for values in zip(*parts, strict=True)]


def read(
    measurements: Measurements | Constraints | Iterable[Measurements | Constraints],
    *,
    sensors: int,
    first: int,
    emissions: Emissions,
) -> Rows:
    """Return given tables as rows, checked.

    Parameters
    ----------
    measurements
        One table, or several.
    sensors
        Number of sensors.
    first
        Number of the first row.
    emissions
        Numbers of emissions that have names; new ones are noted.

    Raises
    ------
    UpdateError
        If a value is not finite, a sigma not above zero, a sensor unknown or its own reference, or
        something is no table.
    """
    known = (*TABLES.values(), Constraints)
    tables: list[Any]
    tables = [measurements] if isinstance(measurements, known) else [*measurements]  # type: ignore[misc]
    parts: list[Rows] = []
    for table in tables:
        if not isinstance(table, known):
            raise UpdateError(
                f"update was given {type(table).__name__}; expected tables: Bearings, Arrivals, "
                "TimeDifferences, FrequencyDifferences or Constraints"
            )
        given: Any = table
        if len(given):
            part = (
                _constraints(given) if isinstance(given, Constraints) else _table(given, emissions)
            )
            for kind, columns in part.items():
                _check(kind, columns, sensors)
            parts.append(part)
    if not parts:
        return {}
    rows = join(parts)
    for kind, columns in rows.items():
        rows[kind] = numbered(columns, first)
        first += columns["line"].size
    return rows


def numbered(columns: Columns, first: int) -> Columns:
    """Return columns with those of our own, rows numbered from ``first`` on."""
    size = columns["line"].size
    return columns | {
        "ident": np.arange(first, first + size),
        "kept": np.ones(size, dtype=bool),
        "judged": np.zeros(size, dtype=bool),
        "delay_s": np.zeros(size),
    }


def _table(table: Measurements, emissions: Emissions) -> Rows:
    kind = _NAMES[type(table)]
    # Copies: what is held stays as it is, whatever becomes of the table.
    columns = {name: _column(name, getattr(table, name)) for name in _FIELDS[kind]}
    if isinstance(table, Arrivals) and table.emission_names:
        names = [table.emission_names[index] for index in table.emission.tolist()]
        columns["emission"] = np.array([emissions.number(name) for name in names], dtype=np.int64)
    return {kind: columns}


def _column(name: str, given: Any) -> NDArray[Any]:
    """Return a copy of a column, of the type that compiled code takes if it holds such numbers."""
    column = np.array(given, order="C")
    if name in _INTEGERS:
        return column.astype(np.int64, copy=False) if column.dtype.kind in "iu" else column
    return column.astype(np.float64, copy=False) if column.dtype.kind in "iuf" else column


def _constraints(table: Constraints) -> Rows:
    kinds = np.array(table.kind)
    return {
        kind: {
            name: np.asarray(getattr(table, name))[kinds == kind]
            for name in ("time_s", "value", "sigma", "line")
        }
        for kind in CONSTRAINTS
        if (kinds == kind).any()
    }


def _check(kind: str, columns: Columns, sensors: int) -> None:
    """Refuse what no update could use."""
    if kind == "bearings" and compiled is not None:
        named = [columns[name] for name in _BEARING]
        plain = all(c.dtype == (np.int64 if c is named[1] else np.float64) for c in named)
        if plain and compiled.sound_bearings(named[0].size, sensors, *named):
            return
    if "reference" in columns:
        _check_references(kind, columns)
    for name, column in columns.items():
        if name in ("line", "isotropic", "emission"):
            continue
        if name in ("sensor", "reference"):
            good = (column >= 0) & (column < sensors)
            expected = f"an index from 0 to {sensors - 1}"
        else:
            good = np.isfinite(column)
            expected = "a finite number"
            if name in _MAY_BE_MISSING or (name == "time_s" and kind in CONSTRAINTS):
                good = good | np.isnan(column)
            if name.startswith("sigma") and "reference" not in name:
                good = good & ~(column <= 0.0)
                expected = "a finite number above 0"
        if not good.all():
            row = int(np.argmin(good))
            line = int(columns["line"][row])
            raise UpdateError(
                f"{kind}: {name} is {column[row]}; expected {expected}", line=line, column=name
            )


def _check_references(kind: str, columns: Columns) -> None:
    """Refuse differences of a sensor with itself."""
    own = columns["reference"] == columns["sensor"]
    if own.any():
        row = int(np.argmax(own))
        raise UpdateError(
            f"{kind}: sensor and reference are both {columns['sensor'][row]}; expected two "
            "different sensors",
            line=int(columns["line"][row]),
            column="reference",
        )
