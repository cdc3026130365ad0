"""Tables of rows, checked as those of files are."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geograph.errors import InputError
from geograph.feed.rows import TABLE_COLUMNS
from geograph.io.arrival_table import arrivals_of
from geograph.io.bearing_table import bearings_of
from geograph.io.constraint_table import constraints_of
from geograph.io.difference_tables import frequency_differences_of, time_differences_of
from geograph.io.tables import Kind, Table, TextBuilder, check_magnitudes

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from datetime import datetime

    from geograph.feed.rows import Row
    from geograph.measurements import Constraints, Measurements
    from geograph.sensors import Sensor


class Checked(NamedTuple):
    """Rows that can be used, and what is wrong with the others.

    Attributes
    ----------
    rows
        Those that can be, in their order.
    tables
        What these hold: one for each kind of measurement and unit of angle.
    errors
        One for each row that cannot be.
    """

    rows: list[Row]
    tables: list[Measurements | Constraints]
    errors: list[InputError]


class Assembler:
    """Makes tables of rows.

    Parameters
    ----------
    sensors
        By name, in the order of their indices.
    speed_m_s
        Speed of propagation.
    terrain
        Whether there is a terrain that heights above it can be counted from.
    epoch
        Instant of time zero, which sensors with axes ``radec`` need.
    """

    def __init__(
        self,
        sensors: Mapping[str, Sensor],
        speed_m_s: float,
        *,
        terrain: bool = False,
        epoch: datetime | None = None,
    ) -> None:
        self._sensors = sensors
        self._speed_m_s = speed_m_s
        self._terrain = terrain
        self._epoch = epoch

    def tables(self, rows: Sequence[Row]) -> list[Measurements | Constraints]:
        """Return what rows hold.

        Raises
        ------
        InputError
            At a row that is wrong, by itself or beside the others.
        """
        groups: dict[tuple[str, ...], list[Row]] = {}
        for row in rows:
            units = sorted(name for name in row.cells if name.endswith("_rad"))
            groups.setdefault((row.table, *units), []).append(row)
        return [self._measurements(_table(group)) for group in groups.values()]

    def check(self, rows: Iterable[Row]) -> Checked:
        """Return what of some rows can be used, and why the others cannot."""
        kept = list(rows)
        try:
            return Checked(kept, self.tables(kept), [])
        except InputError:
            kept, errors = self._one_by_one(kept)
        while True:
            try:
                return Checked(kept, self.tables(kept), errors)
            except InputError as error:
                # Each is right by itself: two of them contradict each other.
                where = (str(error.path), error.line)
                rest = [row for row in kept if (row.place, row.line) != where]
                if len(rest) == len(kept):
                    raise
                kept = rest
                errors.append(error)

    def _one_by_one(self, rows: Sequence[Row]) -> tuple[list[Row], list[InputError]]:
        kept, errors = [], []
        for row in rows:
            try:
                self.tables([row])
                kept.append(row)
            except InputError as error:
                errors.append(error)
        return kept, errors

    def _measurements(self, named: tuple[str, Table]) -> Measurements | Constraints:
        name, table = named
        check_magnitudes(table, TABLE_COLUMNS[name])
        if name == "constraints":
            return constraints_of(table, terrain=self._terrain)
        if name == "bearings":
            return bearings_of(table, self._sensors, self._epoch)
        if not math.isfinite(self._speed_m_s):
            raise InputError(
                f"{name} depend on the speed of the signal, and propagation_speed_m_s is inf; "
                "expected a finite speed in recording.toml",
                path=table.place,
                line=int(table.line[0]),
            )
        if name == "arrivals":
            return arrivals_of(table, self._sensors, partial=True)
        if name == "time_differences":
            return time_differences_of(table, self._sensors)
        return frequency_differences_of(table, self._sensors, speed_m_s=self._speed_m_s)


def _table(rows: Sequence[Row]) -> tuple[str, Table]:
    """Return rows of one kind and one choice of units as a table; what is absent is empty."""
    first = rows[0]
    present: set[str] = set().union(*(row.cells for row in rows))
    numbers, texts = {}, {}
    for spec in TABLE_COLUMNS[first.table]:
        if spec.is_text:
            builder = TextBuilder()
            builder.extend([str(row.cells[spec.name]) for row in rows])
            texts[spec.name] = builder.column()
            continue
        candidates = spec.names_in_file
        name = next((name for name in candidates if name in present), candidates[0])
        if spec.kind is not Kind.ANGLE or name in present or spec.required:
            values = [row.cells.get(name) for row in rows]
            numbers[name] = np.array([np.nan if value is None else value for value in values])
    if first.table == "bearings" and not {"sigma_deg", "sigma_rad"} & numbers.keys():
        # Of a file without the column the header is to blame, here the row.
        numbers["sigma_deg"] = np.full(len(rows), np.nan)
    table = Table(
        place=Path(first.place),
        line=np.array([row.line for row in rows], dtype=np.int64),
        numbers={name: column.astype(np.float64) for name, column in numbers.items()},
        texts=texts,
    )
    return first.table, table
