"""Tables, targets and the picture."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from contestants import CONTESTANTS
from model import SIZES

if TYPE_CHECKING:
    from pathlib import Path

    from measure import Measured

OURS = "geograph"

# Beyond this relative difference of the cost, a contestant has not found the same minimum.
SAME_COST = 1e-4

Results = dict[str, dict[str, "Measured | str"]]
"""By size and contestant; a string says why there is no measurement."""


@dataclass(frozen=True)
class Target:
    """A figure that has to hold."""

    text: str
    value: float | None
    limit: float
    at_least: bool

    @property
    def holds(self) -> bool:
        """Whether it was measured and holds."""
        if self.value is None:
            return False
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    def __str__(self) -> str:
        value = "not measured" if self.value is None else f"{self.value:.1f}"
        bound = "at least" if self.at_least else "at most"
        return f"{'holds' if self.holds else 'FAILS'}: {self.text}: {value} ({bound} {self.limit})"


def found(results: Results, size: str, name: str) -> Measured | None:
    """Return a measurement if there is one."""
    entry = results.get(size, {}).get(name)
    return None if isinstance(entry, str) else entry


def same_minimum(results: Results, size: str, name: str) -> bool:
    """Return whether a contestant reached the cost that ours reached."""
    theirs, ours = found(results, size, name), found(results, size, OURS)
    if theirs is None or ours is None:
        return False
    return abs(theirs.cost - ours.cost) <= SAME_COST * ours.cost


def targets(results: Results) -> list[Target]:
    """Return the three figures that have to hold."""

    def ratio(above: Measured | None, below: Measured | None) -> float | None:
        return above.total_s / below.total_s if above and below else None

    def against(name: str) -> float | None:
        # A faster way to another place is no contestant.
        if not same_minimum(results, "medium", name):
            return None
        return ratio(found(results, "medium", name), found(results, "medium", OURS))

    return [
        Target(
            "times faster than one Python factor a bearing (medium)",
            against("gtsam-per-bearing"),
            50.0,
            True,
        ),
        Target("times faster than our reference path (medium)", against("reference"), 2.0, True),
        Target(
            "times as long for ten times the data (large over medium)",
            ratio(found(results, "large", OURS), found(results, "medium", OURS)),
            12.0,
            False,
        ),
    ]


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
        same = not CONTESTANTS[name].same_cost or same_minimum(results, size, name)
        cost = f"{entry.cost:.4f}" if same else f"{entry.cost:.4f} DIFFERS"
        table.append(
            (
                name,
                _milliseconds(entry.set_up_s),
                _milliseconds(entry.solve_s),
                str(entry.iterations),
                _milliseconds(entry.linearise_s),
                _milliseconds(entry.eliminate_s),
                _milliseconds(entry.marginals_s),
                _milliseconds(entry.total_s),
                f"{entry.memory_mb:.0f}",
                f"{entry.rmse_m:.3f}",
                f"{entry.sigma_m:.3f}",
                cost,
                f"{entry.total_s / ours.total_s:.1f}" if ours else "",
            )
        )
    return table


def _milliseconds(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{1e3 * value:.2f}" if value < 0.1 else f"{1e3 * value:.0f}"


def heading(size: str) -> str:
    """Return a line that says what a size is."""
    entry = SIZES[size]
    return f"{size}: {entry.sensors} sensors x {entry.bearings} bearings, {entry.knots} knots"


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
        cells += [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        print("  ".join(cells).rstrip())


def draw(results: Results, path: Path) -> None:
    """Draw solve and marginals of all contestants against the amount of data."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    axes = figure.add_subplot()
    for name in CONTESTANTS:
        points = [
            (entry.sensors * entry.bearings, measured.total_s)
            for size, entry in SIZES.items()
            if (measured := found(results, size, name)) is not None
        ]
        if points:
            bearings, total = zip(*points, strict=True)
            axes.loglog(bearings, total, "o-", label=name, lw=2.5 if name == OURS else 1.2)
    axes.set_xlabel("bearings")
    axes.set_ylabel("solve and marginals of all knots (s)")
    axes.grid(True, which="both", alpha=0.25)
    axes.legend(frameon=False)
    figure.savefig(path, dpi=150)
