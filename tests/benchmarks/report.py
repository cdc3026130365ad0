"""The tables that are printed."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from contestants import CONTESTANTS
from model import SIZES

if TYPE_CHECKING:
    from measure import Measured

OURS = "geograph"

# Beyond this relative difference of the cost, a contestant has not found the same minimum.
SAME_COST = 1e-4

Results = dict[str, dict[str, "Measured | str"]]
"""By size and contestant; a string says why there is no measurement."""


def found(results: Results, size: str, name: str) -> Measured | None:
    """Return a measurement if there is one."""
    entry = results.get(size, {}).get(name)
    return None if isinstance(entry, str) else entry


def at_minimum(results: Results, size: str, name: str) -> bool:
    """Return whether a contestant reached the lowest cost that any reached."""
    theirs = found(results, size, name)
    costs = [entry.cost for entry in results.get(size, {}).values() if not isinstance(entry, str)]
    return theirs is not None and theirs.cost <= (1.0 + SAME_COST) * min(costs)


HEADER = (
    "contestant", "set-up", "solve", "iterations", "linearise", "eliminate", "marginals",
    "solve + marginals", "memory", "RMSE", "sigma", "cost", "to ours",
)  # fmt: skip
UNITS = ("", "ms", "ms", "", "ms each", "ms each", "ms", "ms", "MB", "m", "m", "", "times")


def rows(results: Results, size: str) -> list[tuple[str, ...]]:
    """Return the table of one size."""
    ours = found(results, size, OURS)
    table = []
    for name, entry in results[size].items():
        if isinstance(entry, str):
            table.append((name, entry, *[""] * (len(HEADER) - 2)))
            continue
        cost = f"{entry.cost:.4f}"
        if not CONTESTANTS[name].same_cost:
            cost += " filter"
        elif not at_minimum(results, size, name):
            cost += " DIFFERS"
        table.append(
            (
                name,
                milliseconds(entry.set_up_s),
                milliseconds(entry.solve_s),
                str(entry.iterations),
                milliseconds(entry.linearise_s),
                milliseconds(entry.eliminate_s),
                milliseconds(entry.marginals_s),
                milliseconds(entry.total_s),
                f"{entry.memory_mb:.0f}",
                f"{entry.rmse_m:.3f}",
                f"{entry.sigma_m:.3f}",
                cost,
                f"{entry.total_s / ours.total_s:.1f}" if ours else "",
            )
        )
    return table


def milliseconds(value: float | None) -> str:
    """Return seconds as milliseconds, or a dash."""
    if value is None:
        return "-"
    return f"{1e3 * value:.2f}" if value < 0.1 else f"{1e3 * value:.0f}"


def heading(size: str) -> str:
    """Return a line that says what a size is."""
    entry = SIZES[size]
    parts = []
    if entry.bearings:
        parts.append(f"{entry.bearings} bearings")
    if entry.emissions:
        parts.append(f"{entry.emissions} arrival times")
    knots = f"{entry.knots} knots" if entry.knots > 1 else "an emitter that stands still"
    also = ""
    if entry.emissions and entry.knots > 1:
        also = f", {entry.emissions * (entry.sensors - 1)} frequency differences"
    return f"{size}: {entry.sensors} sensors x {' and '.join(parts)}{also}, {knots}"


def show(results: Results, size: str) -> None:
    """Print the table of one size."""
    table = rows(results, size)
    if sys.stdout.isatty():
        from rich.console import Console
        from rich.table import Table

        drawn = Table(title=heading(size), title_justify="left")
        for name, unit in zip(HEADER, UNITS, strict=True):
            title = f"{name}\n{unit}" if unit else name
            drawn.add_column(title, justify="right" if name != HEADER[0] else "left")
        for row in table:
            drawn.add_row(*row)
        Console().print(drawn)
        return
    titled = [HEADER, UNITS, *table]
    full = [row for row in titled if any(row[2:])]
    widths = [max(len(row[column]) for row in full) for column in range(len(HEADER))]
    print(f"\n{heading(size)}")
    for row in titled:
        cells = [row[0].ljust(widths[0])]
        if any(row[2:]):
            cells += [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        else:
            cells.append(row[1])
        print("  ".join(cells).rstrip(), flush=True)
