"""``time_differences`` and ``frequency_differences`` of pairs of sensors (docs/format.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.io.arrival_table import MIN_SIGMA_S
from geograph.io.messages import shown
from geograph.io.sensor_columns import TIME, check_covered, sensor_indices
from geograph.io.tables import MAX_TIME_S, ColumnSpec, Kind
from geograph.measurements import FrequencyDifferences, TimeDifferences

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from geograph.io.tables import Table
    from geograph.sensors import Sensor

MIN_SIGMA_HZ = 1e-12
"""Smallest sigma of a frequency: a cycle in 30 000 years."""

MIN_CARRIER_HZ = 1e-6
"""Smallest carrier: a cycle in twelve days."""

_PAIR = (TIME, ColumnSpec("sensor", Kind.TEXT), ColumnSpec("reference", Kind.TEXT))

TIME_DIFFERENCE_COLUMNS = (
    *_PAIR,
    ColumnSpec("tdoa_s", limit=MAX_TIME_S),
    ColumnSpec("sigma_s", limit=MAX_TIME_S),
    ColumnSpec("sigma_reference_s", required=False, may_be_empty=True, limit=MAX_TIME_S),
)
FREQUENCY_DIFFERENCE_COLUMNS = (
    *_PAIR,
    ColumnSpec("fdoa_hz"),
    ColumnSpec("carrier_hz"),
    ColumnSpec("sigma_hz"),
    ColumnSpec("sigma_reference_hz", required=False, may_be_empty=True),
)


def time_differences_of(table: Table, sensors: Mapping[str, Sensor]) -> TimeDifferences:
    """Return what a table of time differences holds.

    Parameters
    ----------
    table
        As read with :data:`TIME_DIFFERENCE_COLUMNS`.
    sensors
        By name, in the order of their indices.

    Raises
    ------
    InputError
        At the first cell that is wrong.
    """
    sensor, reference = _pairs(table, sensors)
    table.check(
        table.numbers["sigma_s"] >= MIN_SIGMA_S,
        "sigma_s",
        f"expected a sigma above 0 (at least {MIN_SIGMA_S:g} s)",
    )
    shared = _shared(table, "s", [reference, table.numbers["time_s"]])
    return TimeDifferences(
        time_s=table.numbers["time_s"],
        sensor=sensor,
        reference=reference,
        tdoa_s=table.numbers["tdoa_s"],
        sigma_s=table.numbers["sigma_s"],
        sigma_reference_s=shared,
        line=table.line,
    )


def frequency_differences_of(
    table: Table, sensors: Mapping[str, Sensor], *, speed_m_s: float
) -> FrequencyDifferences:
    """Return what a table of frequency differences holds.

    Parameters
    ----------
    table
        As read with :data:`FREQUENCY_DIFFERENCE_COLUMNS`.
    sensors
        By name, in the order of their indices.
    speed_m_s
        Speed of propagation, finite.

    Raises
    ------
    InputError
        At the first cell that is wrong.
    """
    sensor, reference = _pairs(table, sensors)
    carrier, difference = table.numbers["carrier_hz"], table.numbers["fdoa_hz"]
    table.check(
        carrier >= MIN_CARRIER_HZ,
        "carrier_hz",
        "expected the frequency that the object emits, above 0 (at least "
        f"{MIN_CARRIER_HZ:g} Hz): without it a difference of frequency is no speed",
    )
    with np.errstate(over="ignore"):
        possible = np.abs(difference) <= carrier * (SPEED_OF_LIGHT_M_S / speed_m_s)
    table.check(
        possible,
        "fdoa_hz",
        "with carrier_hz of that row means speeds beyond that of light; expected both in hertz",
    )
    table.check(
        table.numbers["sigma_hz"] >= MIN_SIGMA_HZ,
        "sigma_hz",
        f"expected a sigma above 0 (at least {MIN_SIGMA_HZ:g} Hz)",
    )
    shared = _shared(table, "hz", [reference, table.numbers["time_s"], carrier])
    return FrequencyDifferences(
        time_s=table.numbers["time_s"],
        sensor=sensor,
        reference=reference,
        fdoa_hz=difference,
        carrier_hz=carrier,
        sigma_hz=table.numbers["sigma_hz"],
        sigma_reference_hz=shared,
        line=table.line,
    )


def _pairs(
    table: Table, sensors: Mapping[str, Sensor]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the indices of sensors and references, both where they must be."""
    sensor = sensor_indices(table, "sensor", sensors)
    reference = sensor_indices(table, "reference", sensors)
    same = sensor == reference
    if same.any():
        row = int(np.argmax(same))
        table.fail(
            row,
            "reference",
            "expected another sensor than in the column sensor; correct or remove the row",
            given=f"{shown(tuple(sensors)[sensor[row]])} is its own reference",
        )
    check_covered(table, "time_s", reference, sensors)
    check_covered(table, "time_s", sensor, sensors)
    return sensor, reference


def _shared(
    table: Table, unit: str, received: list[NDArray[np.int64] | NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Return the part of the sigmas that the reference brought in, 0 where none is given.

    ``received`` are the columns that tell one signal at a reference from another: rows that agree
    in them share one error of one size.
    """
    column, whole = f"sigma_reference_{unit}", f"sigma_{unit}"
    if column not in table.numbers:
        return np.zeros(len(table))
    shared = np.nan_to_num(table.numbers[column], nan=0.0)
    table.check(shared >= 0.0, column, "expected at least 0 (0: no part of the error is shared)")
    table.check(
        shared < table.numbers[whole],
        column,
        f"expected less than {whole} of that row, of which it is the reference's part",
    )
    order = np.lexsort(received)
    begins = np.zeros(len(table), dtype=bool)
    begins[:1] = True
    for key in received:
        begins[1:] |= np.diff(key[order]) != 0
    first = order[np.flatnonzero(begins)][np.cumsum(begins) - 1]
    differs = shared[order] != shared[first]
    if differs.any():
        at = int(np.argmin(np.where(differs, order, len(table))))
        row, other = int(order[at]), int(first[at])
        table.fail(
            row,
            column,
            f"expected {shared[other]:.15g} as on line {table.line[other]}, of the same signal at "
            "the same reference: it is the sigma of one error, common to both rows",
            given=f"{shared[row]:.15g}",
        )
    return shared
