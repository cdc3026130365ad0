"""The tables of measurements that a recording has: any of them, and at least one row in all."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from geograph.errors import InputError
from geograph.io.arrival_table import ARRIVAL_COLUMNS, arrivals_of
from geograph.io.bearing_table import BEARING_COLUMNS, bearings_of
from geograph.io.difference_tables import (
    FREQUENCY_DIFFERENCE_COLUMNS,
    TIME_DIFFERENCE_COLUMNS,
    frequency_differences_of,
    time_differences_of,
)
from geograph.io.messages import listed
from geograph.io.tables import NO_ROWS, find_table, read_table

if TYPE_CHECKING:
    from collections.abc import Mapping
    from datetime import datetime

    from geograph.io.document import Document
    from geograph.io.source import Source
    from geograph.io.tables import Table
    from geograph.measurements import Arrivals, Bearings, FrequencyDifferences, TimeDifferences
    from geograph.sensors import Sensor

MEASUREMENT_COLUMNS = {
    "bearings": BEARING_COLUMNS,
    "arrivals": ARRIVAL_COLUMNS,
    "time_differences": TIME_DIFFERENCE_COLUMNS,
    "frequency_differences": FREQUENCY_DIFFERENCE_COLUMNS,
}
"""Columns of every table of measurements, by its name."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MeasurementTables:
    """The tables of measurements of a recording; None: there is none, or it has no row."""

    bearings: Bearings | None = None
    arrivals: Arrivals | None = None
    time_differences: TimeDifferences | None = None
    frequency_differences: FrequencyDifferences | None = None


def read_measurements(
    source: Source,
    document: Document,
    sensors: Mapping[str, Sensor],
    *,
    speed_m_s: float,
    epoch: datetime | None = None,
) -> MeasurementTables:
    """Read all tables of measurements.

    Parameters
    ----------
    source
        The recording.
    document
        Its header, for messages.
    sensors
        By name, in the order of their indices.
    speed_m_s
        Speed of propagation.
    epoch
        Instant of time zero.

    Raises
    ------
    InputError
        If no table has a row, a table needs a finite speed and there is none, or one is wrong.
    """
    tables: dict[str, Table] = {}
    for name, columns in MEASUREMENT_COLUMNS.items():
        file = find_table(source, name)
        if file is not None:
            tables[name] = read_table(source, file, columns, may_be_empty=True)
    if not tables:
        raise InputError(
            "no table of measurements in it; expected at least one of "
            f"{listed(MEASUREMENT_COLUMNS)} (.csv or .parquet); add one",
            path=source.path,
        )
    filled = {name: table for name, table in tables.items() if len(table)}
    if not filled:
        raise InputError(NO_ROWS, path=next(iter(tables.values())).place)
    for name, table in filled.items():
        if name != "bearings" and not math.isfinite(speed_m_s):
            document.fail(
                ("propagation_speed_m_s",),
                f"is inf and {table.place.name} is there, whose values depend on the speed of the "
                "signal; expected a finite speed; give it or remove the table",
            )
    bearings, arrivals = filled.get("bearings"), filled.get("arrivals")
    times, frequencies = filled.get("time_differences"), filled.get("frequency_differences")
    return MeasurementTables(
        bearings=None if bearings is None else bearings_of(bearings, sensors, epoch),
        arrivals=None if arrivals is None else arrivals_of(arrivals, sensors),
        time_differences=None if times is None else time_differences_of(times, sensors),
        frequency_differences=(
            None
            if frequencies is None
            else frequency_differences_of(frequencies, sensors, speed_m_s=speed_m_s)
        ),
    )
