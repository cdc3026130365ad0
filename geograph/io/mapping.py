"""Mapping files: which columns of somebody's table mean what, in which unit.

A mapping is TOML (docs/formats.md) or, in Python, a dictionary of the same shape.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from geograph.errors import InputError
from geograph.io.document import Document, KeyPath
from geograph.io.instants import TimeSystem
from geograph.io.messages import listed, shown
from geograph.io.source import read_file

if TYPE_CHECKING:
    from collections.abc import Mapping

ANGLES = {
    "deg": math.pi / 180.0,
    "rad": 1.0,
    "mrad": 1e-3,
    "arcmin": math.pi / 10800.0,
    "arcsec": math.pi / 648000.0,
    "gon": math.pi / 200.0,
    "mil": math.pi / 3200.0,
}
"""Units of angles in radians; the mil is that of 6400 to the circle."""

TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
FREQUENCIES = {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6, "GHz": 1e9}
LENGTHS = {"m": 1.0, "km": 1e3, "ft": 0.3048}
PLACES = {"deg": 1.0, "rad": 180.0 / math.pi, "ddmm": math.nan}
"""Units of latitude and longitude in degrees; ``ddmm`` are the degrees and minutes of NMEA 0183."""

UNITS = {
    "azimuth": ANGLES,
    "elevation": ANGLES,
    "latitude": PLACES,
    "longitude": PLACES,
    "height": LENGTHS,
    "tdoa": TIMES,
    "fdoa": FREQUENCIES,
    "carrier": FREQUENCIES,
}
_SIGMA_UNITS = {
    "bearings": ANGLES,
    "arrivals": TIMES,
    "time_differences": TIMES,
    "frequency_differences": FREQUENCIES,
}
QUANTITIES = {
    "bearings": (("time", "sensor", "azimuth"), ("elevation", "sigma")),
    "arrivals": (("time", "sensor", "emission", "sigma"), ()),
    "time_differences": (("time", "sensor", "reference", "tdoa", "sigma"), ()),
    "frequency_differences": (("time", "sensor", "reference", "fdoa", "carrier", "sigma"), ()),
}
"""By kind of table: what must be mapped, and what may be."""

_POSITION = ("latitude", "longitude", "height")
_TEXTS = ("sensor", "reference", "emission")
TIME_FORMATS = ("iso", "unix", "unix_ms", "unix_us", "unix_ns", "gps", "seconds")
_FILE_KEYS = ("delimiter", "decimal", "comment", "skip_lines", "header", "where", "checksum")


@dataclass(frozen=True)
class Quantity:
    """Where a quantity comes from: columns, or a constant.

    Attributes
    ----------
    columns
        Names of the columns; of a number more than one are added up, of a time they are joined.
    constant
        In place of columns: text, or a number in ``unit``.
    unit
        Of a number.
    scale
        Of that unit in ours: radians (degrees for latitude and longitude), seconds, hertz, metres.
    hemisphere
        Column of N, S, E or W beside a latitude or longitude, or None.
    """

    columns: tuple[str, ...] = ()
    constant: str | float | None = None
    unit: str = ""
    scale: float = 1.0
    hemisphere: str | None = None


@dataclass(frozen=True)
class TimeColumn:
    """How times are written.

    Attributes
    ----------
    columns
        Joined by a blank.
    format
        One of ``TIME_FORMATS``, or a pattern of :meth:`datetime.datetime.strptime`.
    system
        Time system.
    utc_offset_s
        Local time less UTC.
    """

    columns: tuple[str, ...]
    format: str
    system: TimeSystem = "UTC"
    utc_offset_s: float = 0.0


@dataclass(frozen=True)
class TableMapping:
    """A mapping file as read.

    Attributes
    ----------
    kind
        Kind of measurements.
    time
        How times are written.
    quantities
        The others, by name.
    epoch
        Instant of second zero for times in seconds, or None.
    delimiter, decimal, comment, skip_lines, header, checksum
        How the file is written.
    where
        Values that a row must have in some columns to be read.
    """

    kind: str
    time: TimeColumn
    quantities: dict[str, Quantity]
    epoch: datetime | None = None
    delimiter: str = ","
    decimal: str = "."
    comment: str = "#"
    skip_lines: int = 0
    header: bool = True
    checksum: bool = False
    where: tuple[tuple[str, tuple[str, ...]], ...] = ()

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns that are used."""
        names = [*self.time.columns, *(name for name, _ in self.where)]
        for quantity in self.quantities.values():
            names += [*quantity.columns, *([quantity.hemisphere] if quantity.hemisphere else [])]
        return tuple(dict.fromkeys(names))


def read_mapping(given: Path | str | Mapping[str, Any]) -> TableMapping:
    """Return a mapping from its TOML file, or from a dictionary of the same shape.

    Raises
    ------
    InputError
        If anything in it is wrong.
    """
    if isinstance(given, (str, Path)):
        place = Path(given)
        document = Document.parse(read_file(place), place)
    else:
        document = Document(Path("mapping"), "", dict(given))
    root = document.table((), document.root, ("kind", "epoch", "file", "columns"))
    kind = document.choice(("kind",), root.get("kind", "bearings"), tuple(QUANTITIES))
    entries = document.table(("columns",), root.get("columns", {}), None)
    needed, optional = QUANTITIES[kind]
    known = (*needed, *optional, *_POSITION)
    document.table(("columns",), entries, known)
    for name in needed:
        if name not in entries:
            document.fail(
                ("columns",), f"no {name}; expected {', '.join(needed)} for {kind}; map it"
            )
    placed = [name for name in _POSITION if name in entries]
    if placed and len(placed) < 3:
        document.fail(
            ("columns", placed[0]), f"without all of {', '.join(_POSITION)}; expected all or none"
        )
    time = _time(document, entries["time"])
    epoch = root.get("epoch")
    if epoch is not None and not (isinstance(epoch, datetime) and epoch.tzinfo is not None):
        document.fail(("epoch",), f"is {shown(str(epoch))}; expected a date and time with its zone")
    if time.format == "seconds" and epoch is None:
        document.fail(
            ("columns", "time"), "is in seconds without an epoch; expected epoch at the top"
        )
    return TableMapping(
        kind=kind,
        time=time,
        quantities={
            name: _quantity(document, name, entry, kind)
            for name, entry in entries.items()
            if name != "time"
        },
        epoch=None if epoch is None else epoch.astimezone(UTC),
        **_file(document, root.get("file", {})),
    )


def _names(document: Document, path: KeyPath, value: object) -> tuple[str, ...]:
    """Return one name of a column or several, as text or a list of texts; a number counts too."""
    values = value if isinstance(value, list) else [value]
    names = []
    for entry in values:
        if isinstance(entry, int) and not isinstance(entry, bool) and 0 < entry < 10**6:
            names.append(str(entry))
        else:
            names.append(document.text_of(path, entry))
    if not names or not all(names):
        document.fail(path, "names no column; expected one")
    return tuple(names)


def _time(document: Document, value: object) -> TimeColumn:
    path = ("columns", "time")
    if not isinstance(value, dict):
        return TimeColumn(_names(document, path, value), "iso")
    table = document.table(path, value, ("column", "format", "system", "utc_offset_hours"))
    if "column" not in table:
        document.fail(path, "has no column; expected one, or several that are joined")
    form = document.text_of((*path, "format"), table.get("format", "iso"))
    if form not in TIME_FORMATS and "%" not in form:
        document.fail(
            (*path, "format"),
            f"is {shown(form)}; expected one of {listed(TIME_FORMATS)}, or a pattern such as "
            "%d.%m.%Y %H:%M:%S.%f",
        )
    system = document.choice((*path, "system"), table.get("system", "UTC"), get_args(TimeSystem))
    offset = document.number(
        (*path, "utc_offset_hours"), table.get("utc_offset_hours", 0.0), low=-15.0, high=15.0
    )
    if offset and (system != "UTC" or (form not in ("iso",) and "%" not in form)):
        document.fail(
            (*path, "utc_offset_hours"), "is for calendar times of zones; expected system UTC"
        )
    return TimeColumn(
        _names(document, (*path, "column"), table["column"]),
        form,
        next(name for name in get_args(TimeSystem) if name == system),
        offset * 3600.0,
    )


def _quantity(document: Document, name: str, value: object, kind: str) -> Quantity:
    path = ("columns", name)
    if name in _TEXTS:
        if isinstance(value, dict):
            table = document.table(path, value, ("column", "value"))
            if ("column" in table) == ("value" in table):
                document.fail(path, "expected exactly one of column and value")
            if "value" in table:
                return Quantity(constant=document.text_of((*path, "value"), table["value"]))
            value = table["column"]
        columns = _names(document, path, value)
        if len(columns) > 1:
            document.fail(path, f"has {len(columns)} columns; expected one")
        return Quantity(columns)
    units = _SIGMA_UNITS[kind] if name == "sigma" else UNITS[name]
    if not isinstance(value, dict):
        document.fail(
            path,
            f'is {shown(value)}; expected {{ column = "...", unit = "..." }} with a unit of '
            + ", ".join(units),
        )
    table = document.table(path, value, ("column", "value", "unit", "hemisphere"))
    if ("column" in table) == ("value" in table):
        document.fail(path, "expected exactly one of column and value")
    if "unit" not in table:
        document.fail(path, f"has no unit; expected one of {', '.join(units)}")
    unit = document.choice((*path, "unit"), table["unit"], units)
    hemisphere = None
    if "hemisphere" in table:
        if name not in ("latitude", "longitude") or "value" in table:
            document.fail((*path, "hemisphere"), "is for a column of latitude or longitude")
        hemisphere = document.text_of((*path, "hemisphere"), table["hemisphere"])
    if "value" in table:
        number = document.number((*path, "value"), table["value"])
        if unit == "ddmm":
            document.fail((*path, "unit"), "ddmm is for columns; expected deg")
        return Quantity(constant=number, unit=unit, scale=units[unit])
    columns = _names(document, (*path, "column"), table["column"])
    return Quantity(columns, unit=unit, scale=units[unit], hemisphere=hemisphere)


def _file(document: Document, value: object) -> dict[str, Any]:
    path = ("file",)
    table = document.table(path, value, _FILE_KEYS)
    found: dict[str, Any] = {}
    for key in ("delimiter", "decimal", "comment"):
        if key in table:
            found[key] = document.text_of((*path, key), table[key])
    if len(found.get("delimiter", ",")) != 1 and found.get("delimiter") != "blank":
        document.fail(
            (*path, "delimiter"), 'expected one character, or "blank" for any number of blanks'
        )
    if found.get("decimal", ".") not in (".", ","):
        document.fail((*path, "decimal"), "expected a point or a comma")
    for key in ("header", "checksum"):
        if key in table:
            if not isinstance(table[key], bool):
                document.fail((*path, key), f"is {shown(table[key])}; expected true or false")
            found[key] = table[key]
    if "skip_lines" in table:
        lines = document.number((*path, "skip_lines"), table["skip_lines"], low=0.0, high=1e6)
        found["skip_lines"] = int(lines)
    where = document.table((*path, "where"), table.get("where", {}), None)
    found["where"] = tuple(
        (name, _values(document, (*path, "where", name), entry)) for name, entry in where.items()
    )
    return found


def _values(document: Document, path: KeyPath, value: object) -> tuple[str, ...]:
    values = value if isinstance(value, list) else [value]
    return tuple(document.text_of(path, entry) for entry in values)


def wrong(place: Path, line: int, column: str, message: str) -> InputError:
    """Return the error of one cell."""
    return InputError(message, path=place, line=line, column=column)
