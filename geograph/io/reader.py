"""Reading of recordings, format version 1 (docs/format.md)."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError
from geograph.io.constraint_table import CONSTRAINT_COLUMNS, constraints_of
from geograph.io.document import Document
from geograph.io.header import MIN_RADIUS_ECEF_M, Header, SensorEntry, read_header
from geograph.io.instants import instant_of
from geograph.io.measurement_tables import MEASUREMENT_COLUMNS, read_measurements
from geograph.io.messages import shown
from geograph.io.sensor_columns import TIME
from geograph.io.source import HEADER_NAME, FolderSource, Source, open_source
from geograph.io.tables import (
    MAX_COORDINATE_M,
    SUFFIXES,
    ColumnSpec,
    Kind,
    Table,
    find_table,
    read_table,
)
from geograph.io.trajectories import EPHEMERIS_SUFFIXES, MARGIN_S, Span, read_ephemeris
from geograph.measurements import Truth
from geograph.recording import Recording
from geograph.sensors import Sensor, Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from geograph.measurements import Constraints
    from geograph.recording import Frame
    from geograph.terrain import Terrain

# For which two-line elements are propagated where no measurement says when it is taken.
_FEED_SPAN_S = (-3600.0, 2.0 * 86400.0)

TABLES = (*MEASUREMENT_COLUMNS, "constraints", "truth")

_POSITION = tuple(ColumnSpec(name, limit=MAX_COORDINATE_M) for name in ("x_m", "y_m", "z_m"))
_VELOCITY = tuple(ColumnSpec(name, required=False) for name in ("vx_m_s", "vy_m_s", "vz_m_s"))

TRUTH_COLUMNS = (TIME, *_POSITION, *_VELOCITY)
TRAJECTORY_COLUMNS = (
    TIME,
    *_POSITION,
    *(
        ColumnSpec(name, Kind.ANGLE, required=False, limit=360.0)
        for name in ("yaw", "pitch", "roll")
    ),
)


def _slip(stem: str) -> str:
    """Return what is left of a file's name when the usual slips are taken off it."""
    return "".join(letter for letter in stem.casefold() if letter.isalnum()).rstrip("s")


_BY_SLIP = {_slip(name): name for name in TABLES} | {
    "toa": "arrivals",
    "tdoa": "time_differences",
    "fdoa": "frequency_differences",
}


def read(path: Path | str) -> Recording:
    """Read a recording.

    Parameters
    ----------
    path
        Its folder, or a .zip archive of one.

    Returns
    -------
    Recording
        Named after the folder or archive. Rows keep the order of the file, and ``line`` holds their
        lines; those of a Parquet file are counted as in the CSV file of the same table.

    Raises
    ------
    InputError
        If anything in the recording is wrong: the first thing found, in one line.
    """
    source = open_source(path)
    document, header, setup = _read_setup(source, _measured_span)
    _check_file_names(source, header)
    measured = read_measurements(
        source,
        document,
        setup.sensors,
        speed_m_s=header.propagation_speed_m_s,
        epoch=header.epoch,
    )
    recording = replace(
        setup,
        bearings=measured.bearings,
        arrivals=measured.arrivals,
        time_differences=measured.time_differences,
        frequency_differences=measured.frequency_differences,
        constraints=_read_constraints(source, setup.terrain),
    )
    if recording.terrain is not None:
        from geograph.ground import check_ground

        check_ground(recording)
    return replace(recording, truth=_read_truth(source, recording.time_span_s))


def read_setup(path: Path | str) -> Recording:
    """Read a recording without its measurements: header and trajectories, for a live feed.

    Parameters
    ----------
    path
        Its folder, or a .zip archive of one. It may have tables, which are not read. Two-line
        elements of a sensor are taken for two days from the epoch.

    Returns
    -------
    Recording
        Without a measurement.

    Raises
    ------
    InputError
        If anything in what is read is wrong: the first thing found, in one line.
    """
    return _read_setup(open_source(path), lambda _: _FEED_SPAN_S)[2]


def _measured_span(source: Source) -> Span:
    """Return the time that a recording's measurements span, with a margin for clocks."""
    low, high = np.inf, -np.inf
    for name, columns in MEASUREMENT_COLUMNS.items():
        file = find_table(source, name)
        if file is None:
            continue
        numbers = read_table(source, file, columns, may_be_empty=True).numbers
        time = numbers["toa_s" if name == "arrivals" else "time_s"]
        if time.size:
            low, high = min(low, float(time.min())), max(high, float(time.max()))
    # Without a measurement there is another message to come.
    return (low - MARGIN_S, high + MARGIN_S) if low <= high else (-MARGIN_S, MARGIN_S)


def _read_setup(
    source: Source, span_of: Callable[[Source], Span]
) -> tuple[Document, Header, Recording]:
    if not source.has(HEADER_NAME):
        raise InputError(
            f"no {HEADER_NAME} in it; expected a recording's folder, or a .zip of one",
            path=source.path,
        )
    header_place = source.place(HEADER_NAME)
    document = Document.parse(source.read_bytes(HEADER_NAME), header_place)
    header = read_header(document)
    recording = Recording(
        name=source.name,
        frame=header.frame,
        sensors={
            name: _read_sensor(source, document, entry, header, span_of)
            for name, entry in header.sensors.items()
        },
        terrain=_read_terrain(source, document, header),
        epoch=header.epoch,
        propagation_speed_m_s=header.propagation_speed_m_s,
        propagation_sigma_m_s=header.propagation_sigma_m_s,
        settings=header.settings,
        path=source.path,
    )
    return document, header, recording


def _check_file_names(source: Source, header: Header) -> None:
    trajectories = {entry.trajectory for entry in header.sensors.values()}
    for name in source.names():
        stem, dot, suffix = name.rpartition(".")
        if dot + suffix.lower() not in SUFFIXES or name in trajectories:
            continue
        table = _BY_SLIP.get(_slip(stem))
        if (
            table is not None
            and name not in (table + end for end in SUFFIXES)
            and find_table(source, table) is None
        ):
            raise InputError(
                f"is not a table's name; did you mean {table}{dot}{suffix.lower()}? rename it",
                path=source.place(name),
            )


def _read_sensor(
    source: Source,
    document: Document,
    entry: SensorEntry,
    header: Header,
    span_of: Callable[[Source], Span],
) -> Sensor:
    trajectory, frame = None, header.frame
    if entry.trajectory is not None:
        if not source.has(entry.trajectory):
            document.fail(
                ("sensors", entry.name, "trajectory"),
                f"{shown(entry.trajectory)} is not in the recording; expected the name of a .csv "
                "or .parquet file in its folder",
            )
        if entry.trajectory.endswith(EPHEMERIS_SUFFIXES):
            assert header.epoch is not None
            trajectory = read_ephemeris(
                source.place(entry.trajectory),
                instant_of(header.epoch, source.place(HEADER_NAME)),
                span_of(source),
                content=source.read_bytes(entry.trajectory),
            )
        else:
            trajectory = _read_trajectory(source, entry.trajectory, frame)
        if entry.axes == "body" and trajectory.attitude_rad is None:
            raise InputError(
                f"has no yaw, pitch and roll, and sensor {shown(entry.name)} has axes body; "
                "expected yaw_deg, pitch_deg and roll_deg",
                path=source.place(entry.trajectory),
                line=1,
            )
    sensor = Sensor(
        name=entry.name,
        position_m=entry.position_m,
        trajectory=trajectory,
        axes=entry.axes,
        errors=entry.errors,
        correlation=entry.correlation,
        refraction=entry.refraction,
        platform_process_noise=entry.platform_process_noise,
        attitude_rad=entry.attitude_rad,
        unusual_attitude=entry.unusual_attitude,
        calibrations_s=entry.calibrations_s,
        clock_resets_s=entry.clock_resets_s,
    )
    if entry.trajectory is not None and entry.axes == "body":
        from geograph.attitude import check_attitude

        try:
            check_attitude(sensor, frame)
        except InputError as error:
            raise InputError(
                error.reason, path=source.place(entry.trajectory), column=error.column
            ) from None
    return sensor


def read_trajectory_table(path: Path) -> Trajectory:
    """Read a trajectory in ECEF from a table of the recording format, wherever it stands.

    Raises
    ------
    InputError
        If it is missing or wrong.
    """
    return _read_trajectory(FolderSource(path.parent), path.name, "ecef")


def _read_trajectory(source: Source, name: str, frame: Frame) -> Trajectory:
    table = read_table(source, name, TRAJECTORY_COLUMNS)
    if len(table) < 2:
        raise InputError("has one row; expected at least two times", path=table.place)
    _check_increasing(table)
    position = _columns(table, ("x_m", "y_m", "z_m"))
    if frame == "ecef":
        radius = np.linalg.norm(position, axis=1)
        table.check(
            radius >= MIN_RADIUS_ECEF_M,
            "x_m",
            f"with y_m and z_m nearer than {MIN_RADIUS_ECEF_M:g} m to the Earth's centre; "
            "expected Earth-centred Earth-fixed metres",
        )
    angles = [table.column_of(name) for name in ("yaw", "pitch", "roll")]
    if any(angles) and not all(angles):
        raise InputError(
            "has only some of yaw, pitch and roll; expected all three or none",
            path=table.place,
            line=1,
        )
    attitude = None
    if all(angles):
        attitude = np.stack([table.angle_rad(name) for name in ("yaw", "pitch", "roll")], axis=1)
    return Trajectory(table.numbers["time_s"], position, attitude)


def _read_terrain(source: Source, document: Document, header: Header) -> Terrain | None:
    entry = header.terrain
    if entry is None:
        return None
    if not source.has(entry.file):
        document.fail(
            ("terrain",),
            f"{shown(entry.file)} is not in the recording; expected the name of a GeoTIFF in its "
            "folder",
        )
    from geograph.terrain import Terrain

    return Terrain.from_file(
        source.raster_location(entry.file),
        frame=header.frame,
        heights=entry.heights,
        geoid_undulation_m=entry.geoid_undulation_m,
        name=str(source.place(entry.file)),
    )


def _read_constraints(source: Source, terrain: Terrain | None) -> Constraints | None:
    name = find_table(source, "constraints")
    if name is None:
        return None
    table = read_table(source, name, CONSTRAINT_COLUMNS)
    return constraints_of(table, terrain=terrain is not None)


def _read_truth(source: Source, span_s: tuple[float, float]) -> Truth | None:
    name = find_table(source, "truth")
    if name is None:
        return None
    table = read_table(source, name, TRUTH_COLUMNS)
    _check_increasing(table)
    time = table.numbers["time_s"]
    first, last = span_s
    if time[-1] < first or time[0] > last:
        raise InputError(
            f"covers {time[0]:.9g} to {time[-1]:.9g} s and the measurements {first:.9g} to "
            f"{last:.9g} s; expected times that overlap; is it of another recording or epoch?",
            path=table.place,
            line=int(table.line[0]),
            column="time_s",
        )
    names = [spec.name for spec in _VELOCITY]
    present = [label for label in names if label in table.numbers]
    if present and present != names:
        raise InputError(
            f"has {', '.join(present)} only; expected all of {', '.join(names)}, or none",
            path=table.place,
            line=1,
            column=present[0],
        )
    return Truth(
        time_s=time,
        position_m=_columns(table, ("x_m", "y_m", "z_m")),
        velocity_m_s=_columns(table, names) if present else None,
    )


def _check_increasing(table: Table) -> None:
    time = table.numbers["time_s"]
    later = np.concatenate([[True], np.diff(time) > 0.0])
    table.check(
        later, "time_s", "expected later than the row before; sort the rows and drop repeats"
    )


def _columns(table: Table, names: tuple[str, ...] | list[str]) -> NDArray[np.float64]:
    return np.stack([table.numbers[name] for name in names], axis=1)
