"""Writing of recordings, format version 1 (docs/format.md)."""

from __future__ import annotations

import csv
import io
import math
import re
import tempfile
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.errors import InputError
from geograph.io.atomic import (
    RECORDING_FILES,
    RECORDING_MARKERS,
    check_replaceable,
    replacing_file,
    replacing_folder,
)
from geograph.io.header_text import header_text
from geograph.io.messages import shown
from geograph.io.reader import read
from geograph.io.source import HEADER_NAME, numbered
from geograph.io.table_columns import table_columns, trajectory_columns
from geograph.io.terrain_file import save_terrain

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from geograph.io.table_columns import Columns
    from geograph.recording import Recording

TableFormat = Literal["csv", "parquet"]

# Any date would do; a fixed one makes equal recordings equal archives.
_ZIP_DATE = (1980, 1, 1, 0, 0, 0)


def write(
    recording: Recording,
    path: Path | str,
    *,
    overwrite: bool = False,
    tables: TableFormat = "csv",
    beside: Mapping[str, str] | None = None,
) -> Recording:
    """Write a recording, whole or not at all, such that it reads back equal.

    Every number is written with the digits that give the same binary number again: angles in
    degrees where degrees can, in radians where they cannot; fixed sensors by geodetic coordinates
    where these give the same position, by coordinates where they do not. Names of files and lines
    are those of what was written; a row of azimuth alone comes back as not isotropic, emissions are
    numbered as they first appear and have names, and a table without a row comes back as none.

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
    beside
        Text of further CSV files, by their names, which a reader leaves alone.

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
    files |= {name: text.encode() for name, text in (beside or {}).items()}
    is_zip = target.suffix.lower() == ".zip"
    if is_zip:
        if target.exists() and not overwrite:
            raise InputError("is there already; name another or allow to overwrite", path=target)
        with replacing_file(target) as staging:
            _write_zip(staging, files)
            if recording.terrain is not None:
                with tempfile.TemporaryDirectory() as folder:
                    raster = save_terrain(recording.terrain, Path(folder))
                    with zipfile.ZipFile(staging, "a") as archive:
                        archive.write(raster, raster.name)
            written = _read_back(staging, target)
    else:
        if not overwrite:
            check_replaceable(target, markers=())
        with replacing_folder(target, markers=RECORDING_MARKERS, own=RECORDING_FILES) as staging:
            for name, content in files.items():
                (staging / name).write_bytes(content)
            if recording.terrain is not None:
                save_terrain(recording.terrain, staging)
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
    columns = table_columns(recording, target)
    trajectories = {}
    for name, sensor in recording.sensors.items():
        if sensor.trajectory is not None:
            stem = "trajectory_" + re.sub(r"[^A-Za-z0-9._-]", "_", name)[:100]
            # Told apart without regard to case, as some file systems do.
            taken = {other.casefold() for other in columns}
            stem = next(other for other in numbered(stem) if other.casefold() not in taken)
            columns[stem] = trajectory_columns(sensor.trajectory)
            trajectories[name] = f"{stem}.{tables}"
    files = {HEADER_NAME: header_text(recording, trajectories, target).encode("utf-8")}
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
