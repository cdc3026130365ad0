"""The picture: what each contestant took at each size, as bars."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from contestants import CONTESTANTS
from report import OURS, Results, at_minimum

if TYPE_CHECKING:
    from pathlib import Path

_COLOURS = ("#4477aa", "#66ccee", "#228833", "#ccbb44", "#ee8866", "#aa3377", "#bbbbbb", "#775533",
            "#ddaacc")  # fmt: skip


def draw(results: Results, path: Path) -> None:
    """Draw solve and marginals of all contestants, a group of bars a size."""
    from matplotlib.figure import Figure

    # What nobody else was asked to solve is no comparison.
    sizes = [
        s for s in results if sum(_bar(results, s, name) is not None for name in CONTESTANTS) > 1
    ]
    names = [name for name in CONTESTANTS if any(_bar(results, s, name) for s in sizes)]
    if not names:
        return
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    axes = figure.add_subplot()
    width = 0.85 / len(names)
    for index, name in enumerate(names):
        colour = "black" if name == OURS else _COLOURS[(index - 1) % len(_COLOURS)]
        labelled = False
        for group, size in enumerate(sizes):
            bar = _bar(results, size, name)
            if bar is None:
                continue
            seconds, hatch = bar
            axes.bar(
                group + (index + 0.5) * width - 0.425,
                1e3 * seconds,
                0.92 * width,
                color=colour if not hatch else "none",
                edgecolor=colour,
                hatch=hatch,
                label=None if labelled else name,
            )
            labelled = True
    axes.set_yscale("log")
    axes.set_xticks(range(len(sizes)), [f"{size}" for size in sizes])
    axes.set_ylabel("solve and marginals of all knots (ms)")
    axes.grid(True, axis="y", alpha=0.25)
    axes.set_axisbelow(True)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside right upper", frameon=False)
    axes.set_title("hatched: stopped, or not at the minimum", fontsize="small", loc="right")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _bar(results: Results, size: str, name: str) -> tuple[float, str] | None:
    """Return seconds and the hatch of a bar, or None where there is nothing to draw."""
    entry = results.get(size, {}).get(name)
    if entry is None:
        return None
    if isinstance(entry, str):
        stopped = re.fullmatch(r"> ([\d.]+) s", entry)
        return (float(stopped[1]), "////") if stopped else None
    same = not CONTESTANTS[name].same_cost or at_minimum(results, size, name)
    return entry.total_s, "" if same else "////"
