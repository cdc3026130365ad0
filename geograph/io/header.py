"""``recording.toml``: the frame, the epoch, the sensors and how to smooth (docs/format.md)."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal, cast, get_args

import numpy as np

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.errors import InputError
from geograph.io.header_resets import read_calibrations, read_clock_resets
from geograph.io.header_terrain import TerrainEntry, file_name, read_terrain_entry
from geograph.io.messages import shown
from geograph.io.tables import MAX_COORDINATE_M, MAX_VALUE
from geograph.io.trajectories import EPHEMERIS_SUFFIXES
from geograph.recording import AccelerationAxes, Frame, LossName, MotionName, SmoothSettings
from geograph.sensors import SensorErrors

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.io.document import Document, KeyPath
    from geograph.sensors import Axes, Refraction

FORMAT_VERSION = 1

MIN_RADIUS_ECEF_M = 6.0e6
"""Nothing that observes the sky is nearer to the Earth's centre than this."""

_TOP_KEYS = (
    "format",
    "frame",
    "epoch",
    "propagation_speed_m_s",
    "propagation_sigma_m_s",
    "sensors",
    "smooth",
    "terrain",
    "terrain_heights",
    "geoid_undulation_m",
)
_SENSOR_KEYS = (
    "geodetic",
    "position_m",
    "trajectory",
    "axes",
    "attitude_deg",
    "attitude_rad",
    "unusual_attitude",
    "errors",
    "correlation",
    "refraction",
    "platform_process_noise",
    "calibrations_s",
    "clock_resets_s",
)
_DEGREES_KEYS = {
    entry.name.replace("_rad", "_deg"): entry.name
    for entry in fields(SensorErrors)
    if "_rad" in entry.name
}
_METRE_KEYS = {
    "clock_offset_m": "clock_offset_s",
    "clock_drift_m_s": "clock_drift_s_s",
    "clock_instability_m_sqrt_s": "clock_instability_s_sqrt_s",
}
"""Errors of clocks by the way of the signal in their time: divided by the speed of propagation."""
_AXES = ("enu", "xyz", "body", "radec")


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorEntry:
    """A sensor as the header has it: like ``geograph.Sensor``, its trajectory still a file name."""

    name: str
    position_m: NDArray[np.float64] | None
    trajectory: str | None
    axes: Axes
    errors: SensorErrors
    correlation: float
    refraction: Refraction
    platform_process_noise: float | None
    attitude_rad: NDArray[np.float64] | None
    unusual_attitude: bool
    calibrations_s: tuple[float, ...] | Literal["auto"]
    clock_resets_s: tuple[float, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class Header:
    """What ``recording.toml`` says."""

    frame: Frame
    epoch: datetime | None
    propagation_speed_m_s: float
    propagation_sigma_m_s: float
    sensors: dict[str, SensorEntry]
    settings: SmoothSettings
    terrain: TerrainEntry | None


def read_header(document: Document) -> Header:
    """Return what a header says; raises InputError at the first thing that is wrong in it."""
    _check_version(document)
    root = document.table((), document.root, _TOP_KEYS)
    if "frame" not in root:
        document.fail((), "frame is missing; expected ecef or local; add it")
    frame = cast("Frame", document.choice(("frame",), root["frame"], get_args(Frame)))
    speed, sigma = _speed(document, root)
    if "sensors" not in root:
        document.fail((), "no sensors; expected a table [sensors.NAME] for each; add them")
    entries = document.table(("sensors",), root["sensors"], None)
    if not entries:
        document.fail(("sensors",), "no sensors; expected a table [sensors.NAME] for each")
    return Header(
        frame=frame,
        epoch=_epoch(document, root.get("epoch"), frame),
        propagation_speed_m_s=speed,
        propagation_sigma_m_s=sigma,
        sensors={
            name: _sensor(document, name, entry, frame, speed) for name, entry in entries.items()
        },
        settings=_settings(document, root.get("smooth", {})),
        terrain=read_terrain_entry(document, root, frame),
    )


def _check_version(document: Document) -> None:
    version = document.root.get("format")
    if version is None:
        document.fail((), f"format is missing; expected format = {FORMAT_VERSION}; add it")
    if isinstance(version, bool) or version != FORMAT_VERSION:
        document.fail(
            ("format",),
            f"format version {shown(version)}; expected {FORMAT_VERSION}, the one that this "
            "version of geograph reads",
        )


def _speed(document: Document, root: dict[str, Any]) -> tuple[float, float]:
    """Return the speed of propagation and its prior sigma, metres per second."""
    key, sigma_key = ("propagation_speed_m_s",), ("propagation_sigma_m_s",)
    speed = document.number(key, root.get(key[0], SPEED_OF_LIGHT_M_S), infinite=True)
    if not speed > 0.0:
        document.fail(key, f"is {speed:g}; expected above 0, or inf")
    sigma = document.number(sigma_key, root.get(sigma_key[0], 0.0), high=MAX_VALUE)
    if sigma < 0.0:
        document.fail(sigma_key, f"prior sigma is {sigma:g}; expected at least 0 (0: known)")
    if sigma > 0.0 and math.isinf(speed):
        document.fail(
            sigma_key,
            f"is {sigma:g} and propagation_speed_m_s is inf; expected a finite speed beside it; "
            "give the speed or remove the sigma",
        )
    return speed, sigma


def _epoch(document: Document, value: object, frame: Frame) -> datetime | None:
    expected = "expected a UTC date and time such as 2021-02-28T21:54:00Z (without quotes)"
    if value is None:
        if frame == "ecef":
            document.fail((), f"epoch is missing; {expected}; add it")
        return None
    if not isinstance(value, datetime) or value.tzinfo is None:
        document.fail(("epoch",), f"is {shown(str(value))}; {expected}")
    try:
        return value.astimezone(UTC)
    except OverflowError:
        document.fail(("epoch",), f"is {shown(str(value))}; {expected}")


def _sensor(
    document: Document, name: str, value: object, frame: Frame, speed_m_s: float
) -> SensorEntry:
    path = ("sensors", name)
    if not valid_sensor_name(name):
        document.fail(
            path,
            f"sensor name {shown(name)}; expected printable text with no blanks around it; "
            "rename it",
        )
    table = document.table(path, value, _SENSOR_KEYS)
    given = [key for key in ("geodetic", "position_m", "trajectory") if key in table]
    if len(given) != 1:
        what = f"has {' and '.join(given)}" if given else "has no position"
        document.fail(
            path,
            f"sensor {shown(name)} {what}; expected exactly one of geodetic, position_m and "
            "trajectory",
        )
    trajectory = table.get("trajectory")
    axes = _axes(document, (*path, "axes"), table.get("axes"), frame)
    refraction = document.choice(
        (*path, "refraction"), table.get("refraction", "none"), ("none", "standard")
    )
    if refraction != "none" and axes != "enu":
        document.fail((*path, "refraction"), f"refraction needs axes enu; given axes {axes}")
    errors = _errors(document, (*path, "errors"), table.get("errors", {}), speed_m_s)
    if errors.misalignment_rad > 0.0 and axes != "body":
        given = [key for key in table["errors"] if key.startswith("misalignment")]
        document.fail(
            (*path, "errors", given[0]),
            f"misalignment needs axes body, which it turns; given axes {axes}",
        )
    unusual = table.get("unusual_attitude", False)
    if not isinstance(unusual, bool):
        document.fail((*path, "unusual_attitude"), f"is {shown(unusual)}; expected true or false")
    return SensorEntry(
        name=name,
        position_m=_position(document, path, table, frame) if trajectory is None else None,
        trajectory=(
            None
            if trajectory is None
            else file_name(
                document,
                (*path, "trajectory"),
                trajectory,
                (".csv", ".parquet", *(EPHEMERIS_SUFFIXES if frame == "ecef" else ())),
                ".csv or .parquet file"
                + (", or of an ephemeris (.oem, .tle, .xml, .gpx)" if frame == "ecef" else ""),
            )
        ),
        axes=axes,
        errors=errors,
        correlation=document.number(
            (*path, "correlation"), table.get("correlation", 0.0), low=0.0, high=1.0
        ),
        refraction=cast("Refraction", refraction),
        platform_process_noise=_platform(document, path, table, errors),
        attitude_rad=_attitude(document, path, table, axes),
        unusual_attitude=unusual,
        calibrations_s=read_calibrations(document, path, table, errors),
        clock_resets_s=read_clock_resets(document, path, table, errors),
    )


def _attitude(
    document: Document, path: KeyPath, table: dict[str, Any], axes: Axes
) -> NDArray[np.float64] | None:
    """Return yaw, pitch and roll of a fixed sensor, radians, shape (3,), or None."""
    names = [name for name in ("attitude_deg", "attitude_rad") if name in table]
    needed = axes == "body" and "trajectory" not in table
    if not names and not needed:
        return None
    if not names:
        document.fail(
            (*path, "axes"),
            "axes body of a fixed sensor need its attitude; expected attitude_deg = [yaw, pitch, "
            "roll]; add it",
        )
    key = (*path, names[-1])
    if len(names) > 1:
        document.fail(
            key, "attitude_rad is there beside attitude_deg; expected one of them; remove the other"
        )
    if not needed:
        given = f"given axes {axes}" if axes != "body" else "a moving one has it in its trajectory"
        document.fail(key, f"is for fixed sensors with axes body; {given}; remove it")
    limit = 360.0 if names[0] == "attitude_deg" else 2.0 * math.pi
    angles = np.array(_three(document, key, table[names[0]], "[yaw, pitch, roll]", limit))
    return np.radians(angles) if names[0] == "attitude_deg" else angles


def _platform(
    document: Document, path: KeyPath, table: dict[str, Any], errors: SensorErrors
) -> float | None:
    if "platform_process_noise" not in table:
        return None
    key = (*path, "platform_process_noise")
    noise = document.number(key, table["platform_process_noise"], high=MAX_VALUE)
    if noise < 0.0:
        document.fail(key, f"is {noise:g}; expected at least 0 (0: straight and even)")
    missing = None
    if "trajectory" not in table:
        missing = "a trajectory, whose points are fixes of the position"
    elif errors.position_noise_m == 0.0:
        missing = "position_noise_m above 0 in its errors, the sigma of each fix"
    if missing is not None:
        document.fail(key, f"is {noise:g}; expected {missing}; add it or remove this key")
    return noise


def valid_sensor_name(name: str) -> bool:
    """Return whether a sensor of that name can stand in a recording's tables."""
    plain = bool(name) and name.isprintable() and name == name.strip()
    # Results keep that name for what belongs to the recording as a whole.
    return plain and name != "(recording)"


def _axes(document: Document, path: KeyPath, value: object, frame: Frame) -> Axes:
    if value is None:
        return "enu" if frame == "ecef" else "xyz"
    axes = cast("Axes", document.choice(path, value, _AXES))
    if axes == "radec" and frame != "ecef":
        document.fail(path, f"axes radec need the frame ecef, which knows the Earth; given {frame}")
    return axes


def _position(
    document: Document, path: KeyPath, table: dict[str, Any], frame: Frame
) -> NDArray[np.float64]:
    if "position_m" in table:
        key = (*path, "position_m")
        limit = MAX_COORDINATE_M
        position = np.array(
            _three(document, key, table["position_m"], "[x, y, z] in metres", limit)
        )
        radius = math.hypot(*position)
        if frame == "ecef" and radius < MIN_RADIUS_ECEF_M:
            document.fail(
                key,
                f"is {radius:.6g} m from the Earth's centre; expected Earth-centred Earth-fixed "
                "metres, or geodetic = [latitude deg, longitude deg, height m]",
            )
        return position
    key = (*path, "geodetic")
    if frame == "local":
        document.fail(key, "geodetic needs the frame ecef; expected position_m in a local frame")
    what = "[latitude deg, longitude deg, height m]"
    latitude, longitude, height = _three(document, key, table["geodetic"], what, 1e12)
    if abs(latitude) > 90.0 or abs(longitude) > 360.0 or height < -3e5:
        document.fail(
            key,
            f"is [{latitude:g}, {longitude:g}, {height:g}]; expected {what} with the latitude "
            "from -90 to 90 and the height above the ellipsoid",
        )
    from geograph.geodesy import ecef_from_geodetic

    return ecef_from_geodetic(latitude, longitude, height)


def _three(
    document: Document, path: KeyPath, value: object, what: str, limit: float
) -> tuple[float, float, float]:
    if not isinstance(value, list) or len(value) != 3:
        document.fail(path, f"is {shown(value)}; expected {what}")
    x, y, z = (document.number(path, entry, low=-limit, high=limit) for entry in value)
    return x, y, z


def _pairs(document: Document, path: KeyPath, value: object) -> tuple[tuple[float, float], ...]:
    if not isinstance(value, list) or not all(
        isinstance(pair, list) and len(pair) == 2 for pair in value
    ):
        document.fail(
            path,
            f'is {shown(value)}; expected "auto", or pairs [from_s, times] in the order of time',
        )
    return tuple(
        (
            document.number(path, start, low=-MAX_VALUE, high=MAX_VALUE),
            document.number(path, times, high=MAX_VALUE),
        )
        for start, times in value
    )


def _errors(document: Document, path: KeyPath, value: object, speed_m_s: float) -> SensorErrors:
    names = [entry.name for entry in fields(SensorErrors)]
    other_units = _DEGREES_KEYS | _METRE_KEYS
    values: dict[str, float] = {}
    given: dict[str, str] = {}
    for key, entry in document.table(path, value, sorted([*names, *other_units])).items():
        where = (*path, key)
        name = other_units.get(key, key)
        if name in given:
            document.fail(
                where,
                f"{key} is there beside {given[name]}, the same in the other unit; expected one "
                "of them; remove the other",
            )
        given[name] = key
        number = document.number(where, entry, high=MAX_VALUE)
        if number < 0.0:
            document.fail(where, f"prior sigma is {number:g}; expected at least 0 (0: known)")
        if key in _METRE_KEYS:
            number = _clock(document, where, number, speed_m_s)
        values[name] = math.radians(number) if key in _DEGREES_KEYS else number
    return SensorErrors(**values)


def _clock(document: Document, path: KeyPath, value: float, speed_m_s: float) -> float:
    """Return an error of a clock, given by the way of the signal, in seconds."""
    seconds = value / speed_m_s
    if math.isinf(speed_m_s) or not seconds <= MAX_VALUE:
        document.fail(
            path,
            f"is {value:g} and propagation_speed_m_s {speed_m_s:g}, by which it is divided; "
            f"expected a speed that makes it seconds; give {_METRE_KEYS[path[-1]]} instead",
        )
    return seconds


def _settings(document: Document, value: object) -> SmoothSettings:
    path = ("smooth",)
    table = document.table(path, value, [entry.name for entry in fields(SmoothSettings)])
    values: dict[str, Any] = {}
    for key, entry in table.items():
        where = (*path, key)
        if key == "motion":
            values[key] = document.choice(where, entry, get_args(MotionName))
        elif key == "loss":
            values[key] = document.choice(where, entry, get_args(LossName))
        elif key == "acceleration_axes":
            values[key] = document.choice(where, entry, get_args(AccelerationAxes))
        elif key in ("moon", "sun"):
            values[key] = entry
        elif key == "max_iterations":
            if isinstance(entry, bool) or not isinstance(entry, int):
                document.fail(where, f"is {shown(entry)}; expected a whole number above 0")
            values[key] = int(document.number(where, entry, low=1.0, high=1e6))
        elif key == "process_noise" and isinstance(entry, list):
            values[key] = _three(document, where, entry, "one or three numbers", MAX_VALUE)
        elif key in ("process_noise", "stages") and isinstance(entry, str):
            values[key] = document.choice(where, entry, ("auto",))
        elif key == "stages":
            values[key] = _pairs(document, where, entry)
        else:
            values[key] = document.number(where, entry, high=MAX_VALUE)
    try:
        return SmoothSettings(**values)
    except InputError as error:
        document.fail((*path, *((error.column,) if error.column else ())), error.reason)
