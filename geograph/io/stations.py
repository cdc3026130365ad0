"""Station lists: where sensors stand or move, for formats whose files do not say it.

A list is TOML, with the tables ``[sensors.NAME]`` of a recording's header, or CSV, a row for each
sensor. Trajectories may be files of several kinds, named beside the list (docs/formats.md).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from geograph.errors import InputError
from geograph.io.document import Document
from geograph.io.header import SensorEntry, read_header, valid_sensor_name
from geograph.io.instants import SECOND_NS
from geograph.io.messages import listed, nearest, plain, shown
from geograph.io.source import FolderSource, read_file
from geograph.io.tables import MAX_COORDINATE_M, ColumnSpec, Kind, Table, read_table
from geograph.sensors import Sensor, SensorErrors, Trajectory

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from geograph.sensors import Refraction

TRAJECTORY_SUFFIXES = (".csv", ".gpx", ".oem", ".parquet", ".tle", ".xml")

_ERROR_KEYS = {
    entry.name.replace("_rad", "_deg"): entry.name
    for entry in dataclasses.fields(SensorErrors)
    if entry.name != "misalignment_rad"
}
_COLUMNS = (
    ColumnSpec("sensor", Kind.TEXT),
    ColumnSpec("latitude_deg", required=False, may_be_empty=True, limit=90.0),
    ColumnSpec("longitude_deg", required=False, may_be_empty=True, limit=360.0),
    ColumnSpec("height_m", required=False, may_be_empty=True, limit=1e12),
    *(
        ColumnSpec(name, required=False, may_be_empty=True, limit=MAX_COORDINATE_M)
        for name in ("x_m", "y_m", "z_m")
    ),
    ColumnSpec("trajectory", Kind.TEXT, required=False),
    ColumnSpec("refraction", Kind.TEXT, required=False),
    *(ColumnSpec(name, required=False, may_be_empty=True) for name in _ERROR_KEYS),
)


@dataclass(frozen=True, eq=False)
class Station:
    """A sensor of a list, its trajectory perhaps still a file to be read.

    Attributes
    ----------
    sensor
        As it is but for the trajectory, which stands still at the Earth's centre when ``file`` says
        where to read it.
    file
        File of its trajectory, or None.
    fixes
        Instants, shape (n,), and ECEF positions, shape (n, 3), metres, of one that moves; or None.
    """

    sensor: Sensor
    file: Path | None = None
    fixes: tuple[NDArray[np.int64], NDArray[np.float64]] | None = None


Stations = dict[str, Station]


def read_stations(path: Path | str) -> Stations:
    """Read a station list.

    Parameters
    ----------
    path
        TOML or CSV, by its suffix.

    Raises
    ------
    InputError
        If anything in it is wrong.
    """
    place = Path(path)
    if place.suffix.lower() == ".toml":
        return _from_toml(place)
    if place.suffix.lower() == ".csv":
        return _from_csv(place)
    raise InputError("is not a station list; expected a .toml or .csv file", path=place)


def as_stations(given: Mapping[str, Station | Sensor] | Path | str | None) -> Stations:
    """Return stations, however they are given: read, as sensors, or by the path of their list."""
    if given is None:
        return {}
    if isinstance(given, (str, Path)):
        return read_stations(given)
    return {
        name: value if isinstance(value, Station) else Station(value)
        for name, value in given.items()
    }


def matched(name: str, stations: Stations) -> str | None:
    """Return the station that a participant's name means, by case too if it must; or None."""
    if name in stations:
        return name
    folded = [known for known in stations if known.casefold() == name.casefold()]
    return folded[0] if len(folded) == 1 else None


def missing(name: str, stations: Stations) -> str:
    """Return what to say of a sensor that no station list knows."""
    if not stations:
        return (
            f"sensor {shown(name)} has no position here; expected a station list, a .toml or .csv "
            "file with its place; give it as --stations, or stations="
        )
    near = nearest(name, stations)
    guess = f"did you mean {plain(near)}? " if near else ""
    return (
        f"sensor {shown(name)} is not in the station list; {guess}expected one of "
        f"{listed(stations)}; add it to the list"
    )


def resolve(station: Station, name: str, epoch_tai_ns: int, span_s: tuple[float, float]) -> Sensor:
    """Return a station as a sensor of a recording.

    Parameters
    ----------
    station
        Of the list.
    name
        What the sensor is called in the recording.
    epoch_tai_ns
        The recording's epoch.
    span_s
        First and last time of its measurements; the trajectory is read for these.

    Raises
    ------
    InputError
        If its trajectory cannot be read or does not cover the span.
    """
    if station.fixes is not None:
        moments, position = station.fixes
        moving = Trajectory((moments - epoch_tai_ns) / SECOND_NS, position)
        return dataclasses.replace(station.sensor, name=name, position_m=None, trajectory=moving)
    if station.file is None:
        return dataclasses.replace(station.sensor, name=name)
    from geograph.io.trajectories import MARGIN_S, read_trajectory

    first, last = span_s
    trajectory = read_trajectory(station.file, epoch_tai_ns, (first - MARGIN_S, last + MARGIN_S))
    if not trajectory.time_s[0] <= first <= last <= trajectory.time_s[-1]:
        raise InputError(
            f"covers {trajectory.time_s[0]:.9g} to {trajectory.time_s[-1]:.9g} s and the "
            f"measurements of {shown(name)} {first:.9g} to {last:.9g} s; expected all of them; "
            "give a longer trajectory",
            path=station.file,
        )
    return dataclasses.replace(station.sensor, name=name, position_m=None, trajectory=trajectory)


def _from_toml(place: Path) -> Stations:
    document = Document.parse(read_file(place), place)
    root = document.table((), document.root, ("sensors",))
    files: dict[str, Path] = {}
    tables: dict[str, Any] = {}
    entries = document.table(("sensors",), root.get("sensors", {}), None)
    for name, table in entries.items():
        tables[name] = table
        if isinstance(table, dict) and "trajectory" in table:
            key = ("sensors", name, "trajectory")
            given = document.text_of(key, table["trajectory"])
            if not given.isprintable() or not given.lower().endswith(TRAJECTORY_SUFFIXES):
                document.fail(
                    key,
                    f"is {shown(given)}; expected a file that ends in "
                    + ", ".join(TRAJECTORY_SUFFIXES),
                )
            files[name] = place.parent / given
            # A name that the header's reader takes; the file itself is read later.
            tables[name] = table | {"trajectory": "later.csv"}
    whole = {"format": 1, "frame": "ecef", "epoch": _ANY_EPOCH, "sensors": tables}
    header = read_header(Document(place, document.text, whole))
    return {
        name: Station(_sensor(entry), files.get(name)) for name, entry in header.sensors.items()
    }


def _sensor(entry: SensorEntry) -> Sensor:
    moving = entry.trajectory is not None
    return Sensor(
        name=entry.name,
        position_m=None if moving else entry.position_m,
        trajectory=_LATER if moving else None,
        axes=entry.axes,
        errors=entry.errors,
        correlation=entry.correlation,
        refraction=entry.refraction,
        platform_process_noise=entry.platform_process_noise,
    )


def _from_csv(place: Path) -> Stations:
    table = read_table(FolderSource(place.parent), place.name, _COLUMNS)
    stations: Stations = {}
    names = table.texts["sensor"]
    for row in range(len(table)):
        name = names.values[names.codes[row]]
        if not valid_sensor_name(name):
            table.fail(row, "sensor", "expected printable text", given=f"is {shown(name)}")
        if name in stations:
            table.fail(row, "sensor", "expected each once", given=f"{shown(name)} is there twice")
        file = _text(table, row, "trajectory")
        if file and not file.lower().endswith(TRAJECTORY_SUFFIXES):
            table.fail(
                row,
                "trajectory",
                "expected a file that ends in " + ", ".join(TRAJECTORY_SUFFIXES),
                given=f"is {shown(file)}",
            )
        refraction = _text(table, row, "refraction") or "none"
        if refraction not in ("none", "standard"):
            table.fail(row, "refraction", "expected none or standard", given=f"is {refraction!r}")
        sensor = Sensor(
            name=name,
            position_m=None if file else _position(table, row),
            trajectory=_LATER if file else None,
            errors=_errors(table, row),
            refraction=cast("Refraction", refraction),
        )
        path = place.parent / file if file else None
        stations[name] = Station(sensor, path)
    return stations


def _text(table: Table, row: int, column: str) -> str:
    found = table.texts.get(column)
    return "" if found is None else found.values[found.codes[row]]


def _given(table: Table, row: int, names: Sequence[str]) -> list[float] | None:
    """Return a row's numbers of some columns, None where it has none; InputError where some."""
    values = [table.numbers[name][row] if name in table.numbers else np.nan for name in names]
    missing_names = [name for name, value in zip(names, values, strict=True) if np.isnan(value)]
    if len(missing_names) == len(names):
        return None
    if missing_names:
        column = missing_names[0]
        raise InputError(
            f"empty cell; expected all of {', '.join(names)} or none",
            path=table.place,
            line=int(table.line[row]),
            column=column,
        )
    return [float(value) for value in values]


def _position(table: Table, row: int) -> NDArray[np.float64]:
    geodetic = _given(table, row, ("latitude_deg", "longitude_deg", "height_m"))
    earth_fixed = _given(table, row, ("x_m", "y_m", "z_m"))
    if (geodetic is None) == (earth_fixed is None):
        raise InputError(
            "expected exactly one of latitude_deg, longitude_deg and height_m, of x_m, y_m and "
            "z_m, and of a trajectory",
            path=table.place,
            line=int(table.line[row]),
        )
    if geodetic is not None:
        from geograph.geodesy import ecef_from_geodetic

        return ecef_from_geodetic(*geodetic)
    return np.array(earth_fixed)


def _errors(table: Table, row: int) -> SensorErrors:
    values = {}
    for column, name in _ERROR_KEYS.items():
        if column in table.numbers and not np.isnan(value := table.numbers[column][row]):
            if value < 0.0:
                table.fail(row, column, "expected at least 0", given=f"is {value:g}")
            values[name] = float(np.radians(value)) if name != column else float(value)
    return SensorErrors(**values)


_LATER = Trajectory(np.array([0.0, 1.0]), np.zeros((2, 3)))
_ANY_EPOCH = datetime(2000, 1, 1, tzinfo=UTC)
