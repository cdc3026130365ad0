"""Tables of any layout, through a mapping: delimited text, logs, pandas and polars frames."""

from __future__ import annotations

import math
from datetime import UTC, date, datetime
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.errors import InputError
from geograph.geodesy import ecef_from_geodetic
from geograph.io.delimited import Cells, check_columns, text_rows
from geograph.io.instants import (
    SECOND_NS,
    clock_ns,
    day_ns,
    from_datetime,
    in_system,
    parse_instant,
    utc_to_tai_ns,
)
from geograph.io.mapping import Quantity, TableMapping, read_mapping, wrong
from geograph.io.messages import plain, shown
from geograph.io.rows import Difference, ImportOptions, Reception, Row, Sighting
from geograph.io.sightings import recording_of
from geograph.io.stations import Station
from geograph.sensors import Sensor

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from geograph.recording import Recording

_UNIX = {"unix": 0, "unix_ms": 3, "unix_us": 6, "unix_ns": 9}
# 1980-01-06T00:00:00 UTC, the origin of GPS time.
_GPS_ORIGIN = parse_instant("1980-01-06T00:00:00")


def read_mapped(
    paths: Path | str | Sequence[Path | str],
    mapping: Path | str | Mapping[str, Any],
    options: ImportOptions | None = None,
) -> Recording:
    """Read delimited text of any layout as one recording.

    Parameters
    ----------
    paths
        Files of one layout.
    mapping
        The mapping file, or a dictionary of the same shape; see docs/formats.md.
    options
        What the tables do not say: stations, sigmas, priors.

    Raises
    ------
    InputError
        If the mapping is wrong, or a cell is not as it says.
    """
    files = [paths] if isinstance(paths, (str, Path)) else list(paths)
    layout = read_mapping(mapping)
    reader = _Rows(layout)
    for file in map(Path, files):
        for number, cells in text_rows(file, layout):
            reader.add(cells, file, number)
    return reader.recording(Path(files[0]), options)


def read_frame(
    frame: Any, mapping: Path | str | Mapping[str, Any], options: ImportOptions | None = None
) -> Recording:
    """Read a pandas or polars frame as a recording.

    Parameters
    ----------
    frame
        Whose columns are taken by ``frame[name]``; dates and times in it are UTC where they have no
        zone. A column of numbers for times needs its format in the mapping.
    mapping
        As for :func:`read_mapped`; its table ``file`` does not count, but for ``where``.
    options
        As there.

    Raises
    ------
    InputError
        If the mapping is wrong, a column is missing, or a cell is not as it says; lines in messages
        count rows from 1.
    """
    layout = read_mapping(mapping)
    present = [str(name) for name in frame.columns]
    place = Path("frame")
    check_columns(layout, present, place, None)
    columns = []
    for name in layout.columns:
        series = frame[name]
        values = series.to_list() if hasattr(series, "to_list") else list(series)
        columns.append([_cell_text(value) for value in values])
    reader = _Rows(layout)
    for number, cells in enumerate(zip(*columns, strict=True), start=1):
        reader.add(dict(zip(layout.columns, cells, strict=True)), place, number)
    return reader.recording(place, options)


def _cell_text(value: Any) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, datetime):
        if value.tzinfo is not None:
            value = value.astimezone(UTC).replace(tzinfo=None)
        # Of pandas' missing times too.
        return "" if str(value) == "NaT" else str(value.isoformat())
    if isinstance(value, date):
        return f"{value.isoformat()}T00:00:00"
    return repr(value) if isinstance(value, float) else str(value)


class _Rows:
    """Collects rows."""

    def __init__(self, layout: TableMapping) -> None:
        self.layout = layout
        self.rows: list[Row] = []
        self.places: dict[str, list[tuple[int, tuple[float, float, float], Path, int]]] = {}

    def add(self, cells: Cells, place: Path, line: int) -> None:
        """Add one row."""
        time = self._instant(cells, place, line)
        number = {
            name: self._number(name, quantity, cells, place, line)
            for name, quantity in self.layout.quantities.items()
            if name not in ("sensor", "reference", "emission")
        }
        text = {
            name: self._text(name, quantity, cells, place, line)
            for name, quantity in self.layout.quantities.items()
            if name in ("sensor", "reference", "emission")
        }
        if "latitude" in number:
            at = (number["latitude"], number["longitude"], number["height"])
            self.places.setdefault(text["sensor"], []).append((time, at, place, line))
        common: dict[str, Any] = {"tai_ns": time, "place": place, "line": line}
        if self.layout.kind == "bearings":
            self.rows.append(
                Sighting(
                    sensor=text["sensor"],
                    first_rad=number["azimuth"],
                    second_rad=number.get("elevation", math.nan),
                    sigma_rad=number.get("sigma", math.nan),
                    **common,
                )
            )
        elif self.layout.kind == "arrivals":
            self.rows.append(
                Reception(
                    sensor=text["sensor"],
                    emission=text["emission"],
                    sigma_s=number["sigma"],
                    **common,
                )
            )
        else:
            self.rows.append(
                Difference(
                    sensor=text["sensor"],
                    reference=text["reference"],
                    value=number.get("tdoa", number.get("fdoa", math.nan)),
                    carrier_hz=number.get("carrier", math.nan),
                    sigma=number["sigma"],
                    **common,
                )
            )

    def recording(self, place: Path, options: ImportOptions | None) -> Recording:
        """Return the recording of all rows."""
        if not self.rows:
            raise InputError("has no row that the mapping reads; expected one at least", path=place)
        chosen = ImportOptions() if options is None else options
        stations = dict(chosen.stations)
        for name, found in self.places.items():
            stations[name] = _placed(name, found, stations.get(name))
        return recording_of(self.rows, _with_stations(chosen, stations))

    def _instant(self, cells: Cells, place: Path, line: int) -> int:
        form = self.layout.time
        text = " ".join(cells[name] for name in form.columns)
        try:
            return _instant(text, self.layout)
        except (ValueError, OverflowError) as error:
            raise wrong(place, line, plain(form.columns[0]), f"is {shown(text)}; {error}") from None

    def _text(self, name: str, quantity: Quantity, cells: Cells, place: Path, line: int) -> str:
        if quantity.constant is not None:
            return str(quantity.constant)
        text = cells[quantity.columns[0]]
        if not text or not text.isprintable():
            raise wrong(
                place, line, plain(quantity.columns[0]), f"is {shown(text)}; expected the {name}"
            )
        return text

    def _number(self, name: str, quantity: Quantity, cells: Cells, place: Path, line: int) -> float:
        if quantity.constant is not None:
            value = float(quantity.constant) * quantity.scale
        else:
            texts = [cells[column] for column in quantity.columns]
            optional = name in ("elevation", "sigma") and self.layout.kind == "bearings"
            if optional and not any(texts):
                return math.nan
            value = 0.0
            for column, text in zip(quantity.columns, texts, strict=True):
                value += self._parsed(text, quantity, place, line, column)
            if quantity.hemisphere is not None:
                value *= self._sign(name, quantity.hemisphere, cells, place, line)
        low, high, expected = _LIMITS.get(name, (-1e15, 1e15, "a number of at most 1e15"))
        if name == "azimuth" and len(quantity.columns) > 1:
            value = math.remainder(value, 2.0 * math.pi)
        if not low <= value <= high:
            column = quantity.columns[0] if quantity.columns else name
            raise wrong(
                place, line, plain(column), f"makes {name} {value:.9g}; expected {expected}"
            )
        return value

    def _parsed(self, text: str, quantity: Quantity, place: Path, line: int, column: str) -> float:
        written = text.replace(",", ".") if self.layout.decimal == "," else text
        try:
            if "_" in written or not written.isascii():
                raise ValueError
            value = float(written)
            if not math.isfinite(value):
                raise ValueError
        except ValueError:
            raise wrong(
                place,
                line,
                plain(column),
                f"is {shown(text)}; expected a number ({quantity.unit})"
                if text
                else f"empty cell; expected a number ({quantity.unit})",
            ) from None
        if quantity.unit != "ddmm":
            return value * quantity.scale
        degrees, minutes = divmod(abs(value), 100.0)
        if minutes >= 60.0:
            raise wrong(
                place, line, plain(column), f"is {shown(text)}; expected minutes below 60 (ddmm)"
            )
        return math.copysign(degrees + minutes / 60.0, value)

    def _sign(self, name: str, column: str, cells: Cells, place: Path, line: int) -> float:
        letters = {"N": 1.0, "S": -1.0} if name == "latitude" else {"E": 1.0, "W": -1.0}
        if cells[column] not in letters:
            raise wrong(
                place,
                line,
                plain(column),
                f"is {shown(cells[column])}; expected {' or '.join(letters)}",
            )
        return letters[cells[column]]


_LIMITS = {
    "azimuth": (-2.0 * math.pi, 2.0 * math.pi, "-360 to 360 degrees (shown in radians)"),
    "elevation": (-math.pi / 2, math.pi / 2, "-90 to 90 degrees (shown in radians)"),
    "sigma": (1e-15, 1e9, "above 0"),
    "carrier": (1e-6, 1e15, "above 0"),
    "latitude": (-90.0, 90.0, "-90 to 90 degrees"),
    "longitude": (-360.0, 360.0, "-360 to 360 degrees"),
    "height": (-3e5, 1e12, "a height in metres"),
}


def _with_stations(options: ImportOptions, stations: dict[str, Station]) -> ImportOptions:
    from dataclasses import replace

    return replace(options, stations=stations)


def _placed(
    name: str,
    found: list[tuple[int, tuple[float, float, float], Path, int]],
    listed: Station | None,
) -> Station:
    """Return a sensor whose place stands in its rows, with the priors of the station list."""
    by_time: dict[int, tuple[float, float, float]] = {}
    for time, at, place, line in found:
        if by_time.setdefault(time, at) != at:
            raise InputError(
                f"has sensor {shown(name)} at another place at the same time; expected one",
                path=place,
                line=line,
            )
    times = sorted(by_time)
    position = ecef_from_geodetic(*np.array([by_time[time] for time in times]).T)
    sensor = Sensor(name=name, position_m=position[0])
    if listed is not None:
        from dataclasses import replace

        sensor = replace(listed.sensor, name=name, position_m=position[0], trajectory=None)
    if len(set(by_time.values())) == 1:
        return Station(sensor)
    return Station(sensor, fixes=(np.array(times, dtype=np.int64), position))


def _instant(text: str, layout: TableMapping) -> int:
    form = layout.time
    offset = round(form.utc_offset_s * SECOND_NS)
    if form.format == "iso":
        return parse_instant(text, form.system) - offset
    if "%" in form.format:
        try:
            moment = datetime.strptime(text, form.format)
        # Python's own message holds the whole text.
        except ValueError:
            raise ValueError(f"expected the form {shown(form.format)}") from None
        if moment.tzinfo is not None:
            return from_datetime(moment)
        start = day_ns(moment.year, moment.month, moment.day)
        nanoseconds = moment.microsecond * 1000
        time = clock_ns(
            start, moment.hour, moment.minute, moment.second, nanoseconds, system=form.system
        )
        return time - offset
    try:
        number = Decimal(text.replace(",", ".") if layout.decimal == "," else text)
    except InvalidOperation:
        raise ValueError("expected a number") from None
    if not number.is_finite() or abs(number) > Decimal(10) ** 20:
        raise ValueError("expected a number of seconds")
    if form.format in _UNIX:
        count = int(number * Decimal(10) ** (9 - _UNIX[form.format]))
        time = utc_to_tai_ns(count) if form.system == "UTC" else in_system(count, form.system)
    else:
        count = int(number * SECOND_NS)
        if form.format == "gps":
            time = _GPS_ORIGIN + count
        else:
            time = from_datetime(layout.epoch or datetime(2000, 1, 1, tzinfo=UTC)) + count
    if not _FIRST <= time <= _LAST:
        raise ValueError("expected a time from 1972 to 2199; check the format")
    return time


_FIRST, _LAST = parse_instant("1972-01-01T00:00:00"), parse_instant("2199-12-31T00:00:00")
