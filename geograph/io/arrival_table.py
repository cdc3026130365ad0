"""``arrivals``: when emissions of the object arrived at sensors (docs/format.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.io.messages import shown
from geograph.io.sensor_columns import check_covered, sensor_indices
from geograph.io.tables import MAX_TIME_S, ColumnSpec, Kind
from geograph.measurements import Arrivals

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from geograph.io.tables import Table
    from geograph.sensors import Sensor

MIN_SIGMA_S = 1e-15
"""Smallest sigma of a time: light goes a third of a micrometre in it, below any ranging."""

ARRIVAL_COLUMNS = (
    ColumnSpec("emission", Kind.LABEL),
    ColumnSpec("sensor", Kind.TEXT),
    ColumnSpec("toa_s", limit=MAX_TIME_S),
    ColumnSpec("sigma_s", limit=MAX_TIME_S),
)


def valid_label(label: str) -> bool:
    """Return whether an emission can be called so in a table."""
    return bool(label) and label.isprintable() and label == label.strip()


def arrivals_of(table: Table, sensors: Mapping[str, Sensor], *, partial: bool = False) -> Arrivals:
    """Return what a table of arrivals holds; emissions are numbered as they first appear.

    Parameters
    ----------
    table
        As read with :data:`ARRIVAL_COLUMNS`.
    sensors
        By name, in the order of their indices.
    partial
        Whether these are some of more rows, so that the others of an emission may be elsewhere.

    Raises
    ------
    InputError
        At the first cell that is wrong, at a sensor that is there twice in one emission, or if no
        emission has two rows and the table is not partial.
    """
    label = table.texts["emission"]
    for code, value in enumerate(label.values):
        if not valid_label(value):
            table.fail(
                int(np.argmax(label.codes == code)),
                "emission",
                "expected printable text or a number, the same in all rows of one emission",
                given=shown(value) if value else "empty cell",
            )
    sensor = sensor_indices(table, "sensor", sensors)
    toa, sigma = table.numbers["toa_s"], table.numbers["sigma_s"]
    table.check(
        sigma >= MIN_SIGMA_S, "sigma_s", f"expected a sigma above 0 (at least {MIN_SIGMA_S:g} s)"
    )
    _check_resolution(table, toa, sigma)
    check_covered(table, "toa_s", sensor, sensors)
    _check_once(table, label.codes, sensor, tuple(sensors))
    if len(table) and not partial and np.bincount(label.codes).max() < 2:
        table.fail(
            0,
            "emission",
            "expected rows of the same emission to have the same label: the time of an emission is "
            "not known, so its arrival at one sensor alone says nothing",
            given="no two rows of the table have the same",
        )
    return Arrivals(
        emission=label.codes,
        sensor=sensor,
        toa_s=toa,
        sigma_s=sigma,
        emission_names=label.values,
        line=table.line,
    )


def _check_resolution(
    table: Table, toa_s: NDArray[np.float64], sigma_s: NDArray[np.float64]
) -> None:
    """Refuse times so far from zero that a double does not hold them to their sigma."""
    spacing = np.spacing(np.abs(toa_s))
    coarse = spacing > sigma_s
    if coarse.any():
        row = int(np.argmax(coarse))
        table.fail(
            row,
            "toa_s",
            f"a number of that size is kept to {spacing[row]:.2g} s and its sigma is "
            f"{sigma_s[row]:.2g} s; expected times nearer to 0; put the epoch near the first "
            "arrival and count from there",
        )


def _check_once(
    table: Table, emission: NDArray[np.int64], sensor: NDArray[np.int64], names: tuple[str, ...]
) -> None:
    key = emission * len(names) + sensor
    order = np.argsort(key, kind="stable")
    again = np.flatnonzero(np.diff(key[order]) == 0) + 1
    if again.size:
        at = again[np.argmin(order[again])]
        row, before = int(order[at]), int(order[at - 1])
        label = table.texts["emission"].values[emission[row]]
        table.fail(
            row,
            "sensor",
            f"expected each sensor once in an emission; emission {shown(label)} has it on line "
            f"{table.line[before]} already; remove one or give it another emission",
            given=f"{shown(names[sensor[row]])} is there twice",
        )
