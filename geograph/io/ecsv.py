"""Fireball recordings in the GFE standard: one ECSV file of directions for each camera.

The standard of the Global Fireball Exchange (UK Fireball Alliance; J. Rowe et al., *Using
incompatible fireball camera systems to find meteorites*, EPSC 2020, 856) fixes columns ``datetime``
(UTC), ``azimuth`` (degrees east of north) and ``altitude`` (degrees above the horizon) and the keys
``obs_latitude``, ``obs_longitude`` (degrees) and ``obs_elevation`` (metres above mean sea level) of
the header. Other columns are not read: right ascension and declination repeat the same directions,
with units that differ between networks.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.errors import InputError
from geograph.geodesy import ecef_from_geodetic
from geograph.io.messages import expected_one_of, shown
from geograph.io.scatter import angular_scatter_rad
from geograph.io.source import decode, numbered, read_file
from geograph.measurements import Bearings
from geograph.recording import Recording, SmoothSettings
from geograph.sensors import Sensor, SensorErrors

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

PerCamera = float | Mapping[str, float]
"""One value for all cameras, or values by camera; cameras not named keep the default."""

DEFAULT_CLOCK_OFFSET_S = 1.0
DEFAULT_BIAS_DEG = 0.02

FIREBALL_SETTINGS = SmoothSettings(
    motion="constant-acceleration",
    process_noise=10.0,
    process_noise_along=1000.0,
    spacing_s=0.2,
    loss="cauchy",
)
"""A decelerating body deviates along its path, hardly across it; single frames can be far off."""

# Digits beyond nanoseconds are dropped.
_UTC_TIME = re.compile(
    r"(\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d(?:\.\d{1,9})?)?)(?:(?<=\.\d{9})\d+)?(?:Z|z|\+00:00)?",
    re.ASCII,
)
_MINUTE_NS = 60_000_000_000


@dataclass(frozen=True, eq=False)
class _Camera:
    """One file's directions."""

    place: Path
    name: str
    geodetic: tuple[float, float, float]
    time_ns: NDArray[np.int64]
    azimuth_rad: NDArray[np.float64]
    elevation_rad: NDArray[np.float64]


def read_ecsv(
    paths: Path | str | Sequence[Path | str],
    *,
    clock_offset_s: PerCamera = DEFAULT_CLOCK_OFFSET_S,
    bias_deg: PerCamera | None = None,
    sigma_deg: PerCamera | None = None,
    geoid_height_m: PerCamera = 0.0,
    settings: SmoothSettings = FIREBALL_SETTINGS,
    name: str = "fireball",
) -> Recording:
    """Read fireball files of the GFE standard as one recording in ECEF.

    Sensors are named by the file's ``camera_id`` (else ``telescope``, ``location``, or the file
    itself; names that repeat get _2, _3, ...). The epoch is the minute in which the first direction
    was taken. Every direction of every file is kept.

    Parameters
    ----------
    paths
        Files, or folders of .ecsv files.
    clock_offset_s
        Prior 1-sigma of every camera's clock offset, seconds: a number, or (this and the following)
        numbers by camera, with that of all others under ``""``.
    bias_deg
        Prior 1-sigma of azimuth and elevation biases, degrees. By default 0.02.
    sigma_deg
        On-sky sigma of a direction, degrees. By default each camera's own scatter
        (:func:`geograph.io.scatter.angular_scatter_rad`).
    geoid_height_m
        Height of mean sea level above the ellipsoid at the cameras, metres, which is added to
        ``obs_elevation``. By default 0: one offset common to all cameras (about 50 m in England)
        moves the whole path by as much, and not all networks keep to the standard here.
    settings
        Settings of the recording.
    name
        Name of the recording.

    Raises
    ------
    InputError
        If a file is not ECSV, lacks a column or key, or holds a value out of range; if a camera has
        too few points to tell its scatter and no sigma is given; if astropy is not installed.
    """
    files = ecsv_files([paths] if isinstance(paths, (str, Path)) else paths)
    cameras = _distinct([_read_camera(file) for file in files])
    names = [camera.name for camera in cameras]
    epoch_ns = min(int(camera.time_ns.min()) for camera in cameras) // _MINUTE_NS * _MINUTE_NS
    sensors, tables = {}, []
    for index, camera in enumerate(cameras):
        time = (camera.time_ns - epoch_ns) / 1e9
        given = option_value(sigma_deg, camera.name, names, "sigma_deg")
        sigma = np.radians(given) if given is not None else _scatter(camera, time)
        bias = option_value(bias_deg, camera.name, names, "bias_deg")
        if bias is None:
            bias = DEFAULT_BIAS_DEG
        undulation = option_value(geoid_height_m, camera.name, names, "geoid_height_m") or 0.0
        latitude, longitude, elevation = camera.geodetic
        offset = option_value(clock_offset_s, camera.name, names, "clock_offset_s")
        sensors[camera.name] = Sensor(
            name=camera.name,
            position_m=ecef_from_geodetic(latitude, longitude, elevation + undulation),
            axes="enu",
            errors=SensorErrors(
                azimuth_bias_rad=float(np.radians(bias)),
                elevation_bias_rad=float(np.radians(bias)),
                clock_offset_s=DEFAULT_CLOCK_OFFSET_S if offset is None else offset,
            ),
        )
        tables.append(_bearings(index, camera, time, float(sigma)))
    return Recording(
        name=name,
        frame="ecef",
        sensors=sensors,
        bearings=_joined(tables),
        epoch=datetime.fromtimestamp(epoch_ns // 1_000_000_000, tz=UTC),
        settings=settings,
    )


def ecsv_files(paths: Sequence[Path | str]) -> list[Path]:
    """Return the files meant by files and folders, in order; raises InputError if there is none."""
    files: list[Path] = []
    for path in map(Path, paths):
        if not path.is_dir():
            files.append(path)
            continue
        found = sorted(entry for entry in path.iterdir() if entry.suffix.lower() == ".ecsv")
        if not found:
            raise InputError("no .ecsv file in it; expected one for each camera", path=path)
        files += found
    if not files:
        raise InputError("no file given; expected .ecsv files, or a folder of them")
    return files


def _read_camera(path: Path) -> _Camera:
    content = read_file(path)
    text = decode(content, path)
    try:
        from astropy.io import ascii as astropy_ascii
    except ImportError:
        raise InputError(
            "is an ECSV file and astropy is not installed; run pip install 'geograph[ecsv]'",
            path=path,
        ) from None
    try:
        # Units and types that astropy frowns upon are common, and settled below.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            table = astropy_ascii.read(text.splitlines(), format="ecsv", guess=False)
            columns = {name: table[name] for name in table.colnames}
            meta = dict(table.meta)
    # The reader and its YAML parser raise errors of many kinds on damaged files.
    except Exception as error:
        raise InputError(
            f"is not valid ECSV ({str(error)[:120]}); expected a file of the GFE standard",
            path=path,
        ) from None
    lines = _row_lines(text)
    for column in ("datetime", "azimuth", "altitude"):
        if column not in columns:
            raise InputError(
                f"no column {column}; {expected_one_of(column, columns)}; expected datetime, "
                "azimuth and altitude of the GFE standard",
                path=path,
                column=column,
            )
    if not len(table):
        raise InputError("has no rows; expected at least one direction", path=path)
    latitude = _meta_number(meta, "obs_latitude", path, 90.0)
    longitude = _meta_number(meta, "obs_longitude", path, 360.0)
    return _Camera(
        place=path,
        name=_camera_name(meta, path),
        geodetic=(latitude, longitude, _meta_number(meta, "obs_elevation", path, 1e5)),
        time_ns=_times_ns(columns["datetime"], path, lines),
        azimuth_rad=_angles(columns["azimuth"], path, lines, "azimuth", 360.0),
        elevation_rad=_angles(columns["altitude"], path, lines, "altitude", 90.0),
    )


def _row_lines(text: str) -> list[int]:
    rows = [
        number
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.startswith("#")
    ]
    return rows[1:]


def _camera_name(meta: Mapping[str, Any], path: Path) -> str:
    for key in ("camera_id", "telescope", "location"):
        words = str(meta.get(key, "")).split()
        name = "".join(letter for letter in " ".join(words) if letter.isprintable())
        if name:
            return name
    return "".join(letter for letter in path.stem if letter.isprintable()).strip() or "camera"


def _meta_number(meta: Mapping[str, Any], key: str, path: Path, limit: float) -> float:
    value = meta.get(key)
    expected = f"expected a number from {-limit:g} to {limit:g} in the header"
    if value is None:
        raise InputError(f"{key} is missing; {expected}; add it", path=path, column=key)
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = float("nan")
    if isinstance(value, bool) or not abs(number) <= limit:
        raise InputError(f"is {shown(value)}; {expected}", path=path, column=key)
    return number


def _times_ns(column: Any, path: Path, lines: list[int]) -> NDArray[np.int64]:
    # Times that astropy has already made into objects of its own are UTC in ISO form again.
    texts = [str(value).strip() for value in getattr(column, "isot", column)]
    times = np.empty(len(texts), dtype=np.int64)
    for row, text in enumerate(texts):
        found = _UTC_TIME.fullmatch(text)
        try:
            # Only years that nanoseconds in 64 bits can count.
            if found is None or not 1700 < int(text[:4]) < 2250:
                raise ValueError
            times[row] = np.datetime64(found[1], "ns").astype(np.int64)
        except ValueError:
            raise InputError(
                f"is {shown(text)}; expected a UTC time such as 2021-02-28T21:54:15.760",
                path=path,
                line=lines[row] if len(lines) == len(texts) else None,
                column="datetime",
            ) from None
    return times


def _angles(
    column: Any, path: Path, lines: list[int], name: str, limit_deg: float
) -> NDArray[np.float64]:
    """Return radians; a unit other than radians (deg2, say) is taken for the standard's degrees."""
    masked = np.ma.getmaskarray(np.ma.asarray(column))
    try:
        values = np.ma.filled(np.ma.asarray(column).astype(np.float64), np.nan)
    except (TypeError, ValueError):
        raise InputError("holds text; expected degrees", path=path, column=name) from None
    if values.ndim != 1:
        raise InputError("holds lists; expected degrees", path=path, column=name)
    if str(getattr(column, "unit", None)) in ("rad", "radian"):
        values = np.degrees(values)
    valid = np.abs(values) <= limit_deg
    if not valid.all():
        row = int(np.argmin(valid))
        given = "empty cell" if masked[row] else f"is {values[row]:g}"
        raise InputError(
            f"{given}; expected {-limit_deg:g} to {limit_deg:g} degrees",
            path=path,
            line=lines[row] if len(lines) == len(values) else None,
            column=name,
        )
    return np.asarray(np.radians(values))


def _distinct(cameras: list[_Camera]) -> list[_Camera]:
    taken: set[str] = set()
    renamed = []
    for camera in cameras:
        name = next(other for other in numbered(camera.name) if other not in taken)
        taken.add(name)
        renamed.append(
            _Camera(
                camera.place,
                name,
                camera.geodetic,
                camera.time_ns,
                camera.azimuth_rad,
                camera.elevation_rad,
            )
        )
    return renamed


def option_value(option: PerCamera | None, name: str, names: list[str], what: str) -> float | None:
    """Return a camera's value of an option, None where it is not given; or InputError."""
    if not isinstance(option, Mapping):
        return None if option is None else _checked(option, what)
    for key in option:
        if key and key not in names:
            raise InputError(f"{what} names {shown(key)}; {expected_one_of(key, names)}")
    given = option.get(name, option.get(""))
    return None if given is None else _checked(given, what)


def _checked(value: float, what: str) -> float:
    lowest = {"geoid_height_m": -1e3, "sigma_deg": 1e-9}.get(what, 0.0)
    if not isinstance(value, (int, float, np.number)) or not lowest <= value <= 1e6:
        raise InputError(f"{what} is {shown(value)}; expected a number of at least {lowest:g}")
    return float(value)


def _scatter(camera: _Camera, time_s: NDArray[np.float64]) -> float:
    scatter = angular_scatter_rad(time_s, camera.azimuth_rad, camera.elevation_rad)
    if scatter is None:
        raise InputError(
            f"camera {shown(camera.name)} has {time_s.size} points, too few to tell their scatter; "
            "expected points at eight different times; give sigma_deg",
            path=camera.place,
        )
    # More digits than a scatter has would suggest that they mean something.
    return float(np.radians(float(f"{np.degrees(scatter):.3g}")))


def _bearings(index: int, camera: _Camera, time_s: NDArray[np.float64], sigma: float) -> Bearings:
    count = time_s.size
    return Bearings(
        time_s=time_s,
        sensor=np.full(count, index, dtype=np.int64),
        azimuth_rad=camera.azimuth_rad,
        elevation_rad=camera.elevation_rad,
        sigma_azimuth_rad=np.full(count, sigma),
        sigma_elevation_rad=np.full(count, sigma),
        isotropic=np.ones(count, dtype=bool),
        line=np.zeros(count, dtype=np.int64),
    )


def _joined(tables: list[Bearings]) -> Bearings:
    names = vars(tables[0])
    return Bearings(
        **{name: np.concatenate([getattr(table, name) for table in tables]) for name in names}
    )
