"""``constraints``: what is known of the path itself (docs/format.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast, get_args

import numpy as np

from geograph.io.messages import expected_one_of, shown
from geograph.io.tables import MAX_TIME_S, ColumnSpec, Kind
from geograph.measurements import ConstraintKind, Constraints

if TYPE_CHECKING:
    from geograph.io.tables import Table

CONSTRAINT_COLUMNS = (
    ColumnSpec("time_s", may_be_empty=True, limit=MAX_TIME_S),
    ColumnSpec("kind", Kind.TEXT),
    ColumnSpec("value"),
    ColumnSpec("sigma"),
)


def constraints_of(table: Table, *, terrain: bool) -> Constraints:
    """Return what a table of constraints holds.

    Parameters
    ----------
    table
        As read with :data:`CONSTRAINT_COLUMNS`.
    terrain
        Whether the recording has a terrain that heights above it can be counted from.

    Raises
    ------
    InputError
        At the first cell that is wrong.
    """
    kinds = table.texts["kind"]
    for code, kind in enumerate(kinds.values):
        if kind in get_args(ConstraintKind):
            continue
        row = int(np.argmax(kinds.codes == code))
        what = f"unknown kind {shown(kind)}" if kind else "empty cell"
        table.fail(row, "kind", expected_one_of(kind, get_args(ConstraintKind)), given=what)
    ground = np.array([kind == "height_above_terrain_m" for kind in kinds.values])[kinds.codes]
    if not terrain and ground.any():
        table.fail(
            int(np.argmax(ground)),
            "kind",
            "expected a terrain in recording.toml beside it; name its GeoTIFF there",
            given="height_above_terrain_m",
        )
    value, sigma = table.numbers["value"], table.numbers["sigma"]
    table.check(sigma >= 1e-12, "sigma", "expected a sigma above 0 (at least 1e-12)")
    speeds = np.array([kind == "speed_m_s" for kind in kinds.values])[kinds.codes]
    table.check(~speeds | (value >= 0.0), "value", "expected a speed of at least 0 m/s")
    return Constraints(
        time_s=table.numbers["time_s"],
        kind=tuple(cast("ConstraintKind", kinds.values[code]) for code in kinds.codes),
        value=value,
        sigma=sigma,
        line=table.line,
    )
