"""Writing of recordings, format version 1 (docs/format.md)."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import zipfile
from dataclasses import fields, replace
from datetime import UTC
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.errors import InputError
from geograph.io.atomic import (
    RECORDING_FILES,
    RECORDING_MARKERS,
    check_replaceable,
    replacing_file,
    replacing_folder,
)
from geograph.io.header import FORMAT_VERSION, valid_sensor_name
from geograph.io.messages import shown
from geograph.io.reader import read
from geograph.io.source import HEADER_NAME, numbered
from geograph.recording import SmoothSettings
from geograph.sensors import SensorErrors

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.measurements import Bearings
    from geograph.recording import Recording
    from geograph.sensors import Sensor

    Columns = dict[str, NDArray[np.float64] | Sequence[str]]

TableFormat = Literal["csv", "parquet"]

# Any date would do; a fixed one makes equal recordings equal archives.
_ZIP_DATE = (1980, 1, 1, 0, 0, 0)


def write(
    recording: Recording,
    path: Path | str,
    *,
    overwrite: bool = False,
    tables: TableFormat = "csv",
) -> Recording:
    """Write a recording, whole or not at all, such that it reads back equal.

    Every number is written with the digits that give the same binary number again: angles in
    degrees where degrees can, in radians where they cannot; fixed sensors by geodetic coordinates
    where these give the same position, by coordinates where they do not. Names of files and lines
    are those of what was written; a row of azimuth alone comes back as not isotropic.

    Parameters
    ----------
    recording
        What to write.
    path
        A folder, or a .zip archive if its name ends so.
    overwrite
        Whether an older recording there is replaced.
    tables
        Format of the tables.

    Returns
    -------
    Recording
        As read back from what was written.

    Raises
    ------
    InputError
        If the recording would not be valid when read (the message names the file it would have
        had), something else is there, or it cannot be written.
    """
    target = Path(path)
    files = _files(recording, tables, target)
    is_zip = target.suffix.lower() == ".zip"
    if is_zip:
        if target.exists() and not overwrite:
            raise InputError("is there already; name another or allow to overwrite", path=target)
        with replacing_file(target) as staging:
            _write_zip(staging, files)
            written = _read_back(staging, target)
    else:
        if not overwrite:
            check_replaceable(target, markers=())
        with replacing_folder(target, markers=RECORDING_MARKERS, own=RECORDING_FILES) as staging:
            for name, content in files.items():
                (staging / name).write_bytes(content)
            written = _read_back(staging, target)
    return replace(written, name=target.stem if is_zip else target.resolve().name, path=target)


def _read_back(staging: Path, target: Path) -> Recording:
    try:
        return read(staging)
    except InputError as error:
        place = error.path
        if place is not None and place.is_relative_to(staging):
            place = target / place.relative_to(staging)
        raise InputError(
            f"cannot be written as a recording: {error.reason}",
            path=place,
            line=error.line,
            column=error.column,
        ) from None


def _write_zip(path: Path, files: dict[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            info = zipfile.ZipInfo(name, _ZIP_DATE)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            archive.writestr(info, content)


def _files(recording: Recording, tables: TableFormat, target: Path) -> dict[str, bytes]:
    """Return the files of a recording by name."""
    if tables not in ("csv", "parquet"):
        raise InputError(f"tables are {shown(tables)}; expected csv or parquet")
    columns: dict[str, Columns] = {}
    if recording.bearings is not None:
        columns["bearings"] = _bearing_columns(recording.bearings, recording.sensor_names)
    if recording.constraints is not None:
        columns["constraints"] = {
            "time_s": recording.constraints.time_s,
            "kind": recording.constraints.kind,
            "value": recording.constraints.value,
            "sigma": recording.constraints.sigma,
        }
    if recording.truth is not None:
        columns["truth"] = _path_columns(recording.truth.time_s, recording.truth.position_m)
        velocity = recording.truth.velocity_m_s
        if velocity is not None:
            for index, name in enumerate(("vx_m_s", "vy_m_s", "vz_m_s")):
                columns["truth"][name] = velocity[:, index]
    trajectories = {}
    for name, sensor in recording.sensors.items():
        if sensor.trajectory is not None:
            stem = "trajectory_" + re.sub(r"[^A-Za-z0-9._-]", "_", name)[:100]
            # Told apart without regard to case, as some file systems do.
            taken = {other.casefold() for other in columns}
            stem = next(other for other in numbered(stem) if other.casefold() not in taken)
            columns[stem] = _path_columns(sensor.trajectory.time_s, sensor.trajectory.position_m)
            attitude = sensor.trajectory.attitude_rad
            if attitude is not None:
                for index, angle in enumerate(("yaw", "pitch", "roll")):
                    columns[stem].update(_angle_column(angle, attitude[:, index]))
            trajectories[name] = f"{stem}.{tables}"
    header = _header(recording, trajectories, target)
    files = {HEADER_NAME: header.encode("utf-8")}
    for stem, table in columns.items():
        name = f"{stem}.{tables}"
        files[name] = _table_bytes(table, tables, target / name)
    return files


def _table_bytes(columns: Columns, tables: TableFormat, place: Path) -> bytes:
    if tables == "parquet":
        from geograph.io.parquet_table import parquet_bytes

        return parquet_bytes(columns, place)
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*(_cells(column) for column in columns.values()), strict=True))
    return file.getvalue().encode("utf-8")


def _cells(column: NDArray[np.float64] | Sequence[str]) -> Sequence[str]:
    if not isinstance(column, np.ndarray):
        return column
    # repr gives the shortest digits that read back as the same number.
    return ["" if math.isnan(value) else repr(value) for value in column.tolist()]


def _path_columns(time_s: NDArray[np.float64], position_m: NDArray[np.float64]) -> Columns:
    x, y, z = position_m.T
    return {"time_s": time_s, "x_m": x, "y_m": y, "z_m": z}


def _bearing_columns(bearings: Bearings, names: tuple[str, ...]) -> Columns:
    columns: Columns = {
        "time_s": bearings.time_s,
        "sensor": [names[index] for index in bearings.sensor],
    }
    columns.update(_angle_column("azimuth", bearings.azimuth_rad))
    azimuth_only = np.isnan(bearings.elevation_rad)
    if not azimuth_only.all():
        columns.update(_angle_column("elevation", bearings.elevation_rad))
    sky = bearings.isotropic | azimuth_only
    if sky.any():
        columns.update(_angle_column("sigma", np.where(sky, bearings.sigma_azimuth_rad, np.nan)))
    if not sky.all():
        for name, sigma in (
            ("sigma_azimuth", bearings.sigma_azimuth_rad),
            ("sigma_elevation", bearings.sigma_elevation_rad),
        ):
            columns.update(_angle_column(name, np.where(sky, np.nan, sigma)))
    return columns


def _angle_column(name: str, angle_rad: NDArray[np.float64]) -> Columns:
    degrees = exact_degrees(angle_rad)
    return {f"{name}_rad": angle_rad} if degrees is None else {f"{name}_deg": degrees}


def exact_degrees(angle_rad: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the degrees that convert to exactly these radians, or None if some have none.

    Conversion from degrees skips some numbers and repeats others, so angles that came from degrees
    always have an answer, and the one of fewest digits is preferred; others may have none.

    Parameters
    ----------
    angle_rad
        Any shape, radians; NaN stays NaN.
    """
    nearest = np.degrees(angle_rad)
    candidates = [
        *(np.round(nearest, digits) for digits in (6, 9, 12, 13, 14, 15)),
        nearest,
        np.nextafter(nearest, np.inf),
        np.nextafter(nearest, -np.inf),
    ]
    degrees = np.full_like(nearest, np.nan)
    found = np.isnan(angle_rad)
    for candidate in candidates:
        fits = ~found & (np.radians(candidate) == angle_rad)
        degrees[fits] = candidate[fits]
        found |= fits
    return degrees if found.all() else None


def _header(recording: Recording, trajectories: dict[str, str], target: Path) -> str:
    lines = [f"format = {FORMAT_VERSION}", f"frame = {_text(recording.frame)}"]
    epoch = recording.epoch
    if epoch is not None:
        if epoch.tzinfo is None:
            raise InputError(
                "epoch has no time zone; expected an instant in UTC", path=target, column="epoch"
            )
        lines.append(f"epoch = {epoch.astimezone(UTC).replace(tzinfo=None).isoformat()}Z")
    if recording.propagation_speed_m_s != SPEED_OF_LIGHT_M_S:
        lines.append(f"propagation_speed_m_s = {_number(recording.propagation_speed_m_s)}")
    for name, sensor in recording.sensors.items():
        if not valid_sensor_name(name) or name != sensor.name:
            raise InputError(
                f"sensor {shown(name)} is called {shown(sensor.name)}; expected one printable "
                "name with no blanks around it",
                path=target,
            )
        lines += _sensor_lines(sensor, trajectories.get(name), recording.frame)
    settings = _settings_lines(recording.settings)
    return "\n".join([*lines, "", "[smooth]", *settings]) + "\n"


def _sensor_lines(sensor: Sensor, trajectory: str | None, frame: str) -> list[str]:
    table = f"sensors.{_key(sensor.name)}"
    lines = ["", f"[{table}]"]
    if trajectory is not None:
        lines.append(f"trajectory = {_text(trajectory)}")
    elif sensor.position_m is not None:
        geodetic = _exact_geodetic(sensor.position_m) if frame == "ecef" else None
        name, values = ("position_m", sensor.position_m) if geodetic is None else geodetic
        lines.append(f"{name} = [{', '.join(_number(value) for value in values.tolist())}]")
    lines.append(f"axes = {_text(sensor.axes)}")
    if sensor.correlation:
        lines.append(f"correlation = {_number(sensor.correlation)}")
    if sensor.refraction != "none":
        lines.append(f"refraction = {_text(sensor.refraction)}")
    errors = []
    for entry in fields(SensorErrors):
        value = float(getattr(sensor.errors, entry.name))
        if value:
            name = entry.name
            degrees = exact_degrees(np.array(value)) if "_rad" in name else None
            if degrees is not None:
                name, value = name.replace("_rad", "_deg"), float(degrees)
            errors.append(f"{name} = {_number(value)}")
    return [*lines, f"[{table}.errors]", *errors] if errors else lines


def _exact_geodetic(
    position_m: NDArray[np.float64],
) -> tuple[str, NDArray[np.float64]] | None:
    from geograph.geodesy import ecef_from_geodetic, geodetic_from_ecef

    geodetic = geodetic_from_ecef(position_m)
    if not np.isfinite(geodetic).all():
        return None
    for digits, height_digits in ((5, 1), (6, 2), (7, 3), (8, 3), (10, 4), (12, 6)):
        rounded = np.array([*np.round(geodetic[:2], digits), np.round(geodetic[2], height_digits)])
        if (ecef_from_geodetic(*rounded) == position_m).all():
            return "geodetic", rounded
    return None


def _settings_lines(settings: SmoothSettings) -> list[str]:
    lines = []
    for entry in fields(SmoothSettings):
        value = getattr(settings, entry.name)
        # The motion is always named: the other values have their meaning by it.
        if value is None or (value == entry.default and entry.name != "motion"):
            continue
        if isinstance(value, str):
            written = _text(value)
        elif isinstance(value, tuple):
            written = f"[{', '.join(_number(part) for part in value)}]"
        else:
            written = str(value) if isinstance(value, int) else _number(value)
        lines.append(f"{entry.name} = {written}")
    return lines


def _number(value: float) -> str:
    number = float(value)
    return "inf" if math.isinf(number) else repr(number)


def _text(value: str) -> str:
    # Basic strings of TOML have JSON's escapes.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _text(name)
