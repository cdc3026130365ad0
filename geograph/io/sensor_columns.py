"""Columns that name sensors, and the times at which moving sensors must have been somewhere."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.io.messages import expected_one_of, shown
from geograph.io.source import HEADER_NAME
from geograph.io.tables import MAX_TIME_S, ColumnSpec

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from geograph.io.tables import Table
    from geograph.sensors import Sensor

TIME = ColumnSpec("time_s", limit=MAX_TIME_S)
"""The column of times that most tables have."""


def sensor_indices(table: Table, column: str, sensors: Mapping[str, Sensor]) -> NDArray[np.int64]:
    """Return the indices of the sensors that a column names, shape (n,).

    Parameters
    ----------
    table
        The table.
    column
        Its column of names.
    sensors
        By name, in the order of their indices.

    Raises
    ------
    InputError
        At the first name that the header does not have.
    """
    text = table.texts[column]
    index = {name: position for position, name in enumerate(sensors)}
    lookup = np.array([index.get(value, -1) for value in text.values], dtype=np.int64)
    found = lookup[text.codes]
    if (found < 0).any():
        row = int(np.argmax(found < 0))
        given = text.values[text.codes[row]]
        table.fail(
            row,
            column,
            f"{expected_one_of(given, sensors)}; name it as in {HEADER_NAME}",
            given=f"unknown sensor {shown(given)}" if given else "empty cell",
        )
    return found


def check_covered(
    table: Table, column: str, sensor: NDArray[np.int64], sensors: Mapping[str, Sensor]
) -> None:
    """Raise InputError at the first row whose time is outside its moving sensor's trajectory.

    Parameters
    ----------
    table
        The table.
    column
        Its column of times, seconds.
    sensor
        Shape (n,): index of the sensor whose position is needed.
    sensors
        By name, in the order of their indices.
    """
    time = table.numbers[column]
    for index, (label, entry) in enumerate(sensors.items()):
        if entry.trajectory is not None:
            first, last = entry.trajectory.time_s[[0, -1]]
            table.check(
                (sensor != index) | ((time >= first) & (time <= last)),
                column,
                f"outside the trajectory of sensor {shown(label)}; expected {first:.9g} to "
                f"{last:.9g} s; extend the trajectory or remove the row",
            )
