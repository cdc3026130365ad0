"""Writing of ``recording.toml`` (docs/format.md)."""

from __future__ import annotations

import json
import math
import re
from dataclasses import fields
from datetime import UTC
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.errors import InputError
from geograph.io.header import FORMAT_VERSION, valid_sensor_name
from geograph.io.messages import shown
from geograph.io.table_columns import exact_degrees
from geograph.recording import SmoothSettings
from geograph.sensors import SensorErrors

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from geograph.recording import Recording
    from geograph.sensors import Sensor
    from geograph.terrain import Terrain


def header_text(recording: Recording, trajectories: Mapping[str, str], target: Path) -> str:
    """Return the header of a recording, such that every number reads back equal.

    Parameters
    ----------
    recording
        What it is the header of.
    trajectories
        Files of the moving sensors, by the sensors' names.
    target
        The recording to be written, for messages.

    Raises
    ------
    InputError
        If the epoch has no time zone or a sensor's name cannot stand in a header.
    """
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
    if recording.propagation_sigma_m_s:
        lines.append(f"propagation_sigma_m_s = {_number(recording.propagation_sigma_m_s)}")
    terrain = recording.terrain
    if terrain is not None:
        lines.append(f"terrain = {_text(terrain_name(terrain))}")
        if terrain.heights is not None:
            lines.append(f"terrain_heights = {_text(terrain.heights)}")
        if terrain.geoid_undulation_m is not None:
            lines.append(f"geoid_undulation_m = {_number(terrain.geoid_undulation_m)}")
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


def terrain_name(terrain: Terrain) -> str:
    """Return the name of the file that a terrain is written to."""
    stem = PurePath(terrain.raster.name).stem
    return f"{stem or 'terrain'}.tif"


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
    if sensor.attitude_rad is not None:
        degrees = exact_degrees(sensor.attitude_rad)
        name, angles = ("attitude_rad", sensor.attitude_rad)
        if degrees is not None:
            name, angles = ("attitude_deg", degrees)
        lines.append(f"{name} = [{', '.join(_number(value) for value in angles.tolist())}]")
    if sensor.unusual_attitude:
        lines.append("unusual_attitude = true")
    if sensor.correlation:
        lines.append(f"correlation = {_number(sensor.correlation)}")
    if sensor.refraction != "none":
        lines.append(f"refraction = {_text(sensor.refraction)}")
    if sensor.platform_process_noise is not None:
        lines.append(f"platform_process_noise = {_number(sensor.platform_process_noise)}")
    lines += _reset_lines(sensor)
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


def _reset_lines(sensor: Sensor) -> list[str]:
    lines = []
    for name in ("calibrations_s", "clock_resets_s"):
        times = getattr(sensor, name)
        if times == "auto":
            lines.append(f'{name} = "auto"')
        elif times:
            lines.append(f"{name} = [{', '.join(_number(time) for time in times)}]")
    return lines


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
        elif isinstance(value, bool):
            written = str(value).lower()
        elif isinstance(value, tuple):
            written = _list(value)
        else:
            written = str(value) if isinstance(value, int) else _number(value)
        lines.append(f"{entry.name} = {written}")
    return lines


def _list(values: tuple[Any, ...]) -> str:
    parts = [_list(part) if isinstance(part, tuple) else _number(part) for part in values]
    return f"[{', '.join(parts)}]"


def _number(value: float) -> str:
    number = float(value)
    return "inf" if math.isinf(number) else repr(number)


def _text(value: str) -> str:
    # Basic strings of TOML have JSON's escapes.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _text(name)
