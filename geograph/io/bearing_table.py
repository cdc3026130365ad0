"""``bearings``: directions, and their sigmas in either of two ways (docs/format.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError
from geograph.io.sensor_columns import TIME, check_covered, sensor_indices
from geograph.io.tables import ColumnSpec, Kind
from geograph.measurements import Bearings

if TYPE_CHECKING:
    from collections.abc import Mapping
    from datetime import datetime

    from numpy.typing import NDArray

    from geograph.io.tables import Table
    from geograph.sensors import Sensor

MIN_SIGMA_RAD = 1e-12
"""Smallest sigma of a bearing: a fifth of a microarcsecond, below any instrument."""

BEARING_COLUMNS = (
    TIME,
    ColumnSpec("sensor", Kind.TEXT),
    ColumnSpec("azimuth", Kind.ANGLE, limit=360.0),
    ColumnSpec("elevation", Kind.ANGLE, required=False, may_be_empty=True, limit=90.0),
    ColumnSpec("sigma", Kind.ANGLE, required=False, may_be_empty=True, limit=360.0),
    ColumnSpec("sigma_azimuth", Kind.ANGLE, required=False, may_be_empty=True, limit=360.0),
    ColumnSpec("sigma_elevation", Kind.ANGLE, required=False, may_be_empty=True, limit=360.0),
)


def bearings_of(
    table: Table, sensors: Mapping[str, Sensor], epoch: datetime | None = None
) -> Bearings:
    """Return what a table of bearings holds.

    Parameters
    ----------
    table
        As read with :data:`BEARING_COLUMNS`.
    sensors
        By name, in the order of their indices.
    epoch
        Instant of time zero, which sensors with axes ``radec`` need.

    Raises
    ------
    InputError
        At the first cell that is wrong.
    """
    sensor = sensor_indices(table, "sensor", sensors)
    azimuth, elevation = table.angle_rad("azimuth"), table.angle_rad("elevation")
    isotropic, sigma_azimuth, sigma_elevation = _sigmas(table, np.isnan(elevation))
    check_covered(table, "time_s", sensor, sensors)
    check_stars(table, sensor, elevation, sensors, epoch)
    return Bearings(
        time_s=table.numbers["time_s"],
        sensor=sensor,
        azimuth_rad=azimuth,
        elevation_rad=elevation,
        sigma_azimuth_rad=sigma_azimuth,
        sigma_elevation_rad=sigma_elevation,
        isotropic=isotropic,
        line=table.line,
    )


def check_stars(
    table: Table,
    sensor: NDArray[np.int64],
    declination_rad: NDArray[np.float64],
    sensors: Mapping[str, Sensor],
    epoch: datetime | None,
) -> None:
    """Raise InputError at the first row against the stars that lacks what these need.

    Parameters
    ----------
    table
        The table.
    sensor, declination_rad
        Shape (n,): index of the sensor, and its second angle.
    sensors
        By name, in the order of their indices.
    epoch
        Instant of time zero.
    """
    against = np.array([entry.axes == "radec" for entry in sensors.values()], dtype=bool)
    rows = against[sensor]
    if not rows.any():
        return
    assert epoch is not None
    table.check(
        ~(rows & np.isnan(declination_rad)),
        table.column_of("elevation") or "elevation_deg",
        "expected a declination: a right ascension alone has no aberration to be taken off",
        given="empty cell" if table.column_of("elevation") else "column is missing",
    )
    from geograph.earth import UNKNOWN_ORIENTATION, orientation_known

    time = table.numbers["time_s"]
    known = np.ones(time.size, dtype=bool)
    known[rows] = orientation_known(epoch, time[rows], table.place)
    table.check(known, "time_s", f"after {epoch:%Y-%m-%dT%H:%M:%SZ}, {UNKNOWN_ORIENTATION}")


def _sigmas(
    table: Table, azimuth_only: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64]]:
    """Return which rows are isotropic, and the sigmas of azimuth and elevation."""
    named = {key: table.column_of(key) for key in ("sigma", "sigma_azimuth", "sigma_elevation")}
    if named["sigma"] is None and named["sigma_azimuth"] is None:
        raise InputError(
            f"no sigma; found {', '.join([*table.numbers, *table.texts])}; expected sigma_deg, or "
            "sigma_azimuth_deg and sigma_elevation_deg (or _rad); add it",
            path=table.place,
            line=1,
            column="sigma_deg",
        )
    for key, column in named.items():
        if column is not None:
            values = table.angle_rad(key)
            table.check(
                np.isnan(values) | (values >= MIN_SIGMA_RAD),
                column,
                f"expected a sigma above 0 (at least {MIN_SIGMA_RAD:g} rad)",
            )
    sky, azimuth = table.angle_rad("sigma"), table.angle_rad("sigma_azimuth")
    elevation = table.angle_rad("sigma_elevation")
    column = named["sigma"] or named["sigma_azimuth"] or "sigma_deg"
    has_sky, has_azimuth = ~np.isnan(sky), ~np.isnan(azimuth)
    table.check(
        has_sky | has_azimuth,
        column,
        "expected a sigma above 0; fill it in or remove the row",
        given="empty cell",
    )
    table.check(
        ~(has_sky & (has_azimuth | ~np.isnan(elevation))),
        column,
        "expected either it or sigma_azimuth and sigma_elevation; empty the other cells",
        given="sigma given twice",
    )
    table.check(
        has_sky | azimuth_only | ~np.isnan(elevation),
        named["sigma_elevation"] or "sigma_elevation_deg",
        "expected a sigma above 0 beside sigma_azimuth; fill it in",
        given="empty cell" if named["sigma_elevation"] else "column is missing",
    )
    # The sigma of an azimuth alone is that of the coordinate; the other is filled in, not used.
    isotropic = has_sky & ~azimuth_only
    sigma_azimuth = np.where(has_sky, sky, azimuth)
    sigma_elevation = np.where(has_sky | azimuth_only, sigma_azimuth, elevation)
    return isotropic, sigma_azimuth, sigma_elevation
