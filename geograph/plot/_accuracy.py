"""Figures of the accuracy studies: ours beside what was published, from the studies' tables."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from geograph.plot import _style as look

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

Rows = dict[str, dict[str, str]]
"""A table: by the first cell of each row, its other cells by the titles of their columns."""

# Estimators of the satellites' study that are drawn: the names that theirs begin with.
_SHOWN = ("acceleration", "velocity, CI", "BMod", "BDNLO", "factor", "graph")

_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


def tables(text: str) -> list[Rows]:
    """Return the tables of a Markdown text; columns of one title are told apart by a number."""
    found: list[Rows] = []
    titles: list[str] | None = None
    for line in text.splitlines():
        if not line.startswith("|"):
            titles = None
            continue
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if titles is None:
            titles = [f"{t} {cells[:i].count(t) + 1}" if t in cells[:i] else t
                      for i, t in enumerate(cells)]  # fmt: skip
            found.append({})
        elif set(line) - set("|- "):
            found[-1][cells[0]] = dict(zip(titles[1:], cells[1:], strict=False))
    return found


def number(cell: str | None) -> float:
    """Return the first number of a cell, NaN if it has none."""
    match = _NUMBER.search(cell or "")
    return float(match[0]) if match else float("nan")


def spread(cell: str | None) -> float:
    """Return the standard error of a cell, 0 if it has none."""
    return number((cell or "").partition("±")[2]) if "±" in (cell or "") else 0.0


def printed(cell: str | None) -> float:
    """Return the published figure in brackets of a cell, NaN if it has none."""
    return number((cell or "").partition("(")[2]) if "(" in (cell or "") else float("nan")


def draw(texts: Mapping[str, str], folder: Path) -> dict[str, list[Path]]:
    """Draw all figures that the studies' texts give, and return their files by study.

    Parameters
    ----------
    texts
        Markdown of each study, by its name.
    folder
        Where the files are put.
    """
    from geograph.io.atomic import replacing_file

    made: dict[str, list[Path]] = {}
    for name, (needed, figure_of) in _FIGURES.items():
        given = [tables(texts.get(part, "")) for part in needed]
        if not given[0]:
            continue
        with look.style():
            figure = figure_of(*given)
            path = folder / f"{name}.png"
            with replacing_file(path) as staging:
                figure.savefig(staging, format="png")
        made.setdefault(needed[0], []).append(path)
    return made


def _figure(columns: int, *, height: float = 3.6) -> tuple[Figure, list[Axes]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.6 * columns, height), layout="constrained")
    axes = figure.subplots(1, columns, squeeze=False)[0]
    return figure, list(axes)


def _logarithmic(axis: Axis) -> None:
    """Label a logarithmic axis in plain numbers; powers would need mathematical text."""
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("")


def _tdoa(estimators: list[Rows], graph: list[Rows]) -> Figure:
    """Error over the noise of arrival times, for both emitters."""
    figure, axes = _figure(2)
    ours = estimators[0]
    theirs = graph[0] if graph else {}
    sigma = np.array([1.0, 5.0, 10.0])
    looks = (("pseudo", look.ORANGE, "^"), ("range-kalman", look.GREEN, "s"),
             ("post", look.PURPLE, "D"))  # fmt: skip
    for emitter, ax in zip((1, 2), axes, strict=True):
        names = [f"emitter-{emitter}-{value:g}ns" for value in sigma]
        rows = [ours.get(name, {}) for name in names]
        ax.plot(sigma, [number(row.get("bound")) for row in rows], "k-", label="bound")
        for index, (column, colour, marker) in enumerate(looks):
            mine = [number(row.get(column)) for row in rows]
            title = "published" if not index else f"published {index + 1}"
            ax.plot(sigma, mine, color=colour, label=column)
            ax.plot(sigma, [number(row.get(title)) for row in rows], marker, mfc="none",
                    color=colour, label="published")  # fmt: skip
        if theirs:
            made = [number(theirs.get(name, {}).get("RMS")) for name in names]
            ax.plot(sigma, made, "o", color=look.BLUE, label="factor graph")
        ax.set(title=f"emitter {emitter}", xlabel="sigma of a pulse (ns)", ylabel="RMS error (m)",
               xscale="log", yscale="log")  # fmt: skip
        ax.set_xticks(sigma, ["1", "5", "10"])
        _logarithmic(ax.yaxis)
    axes[0].legend(ncols=2)
    return figure


def _aoa(estimators: list[Rows], bounds: list[Rows], graph: list[Rows]) -> Figure:
    """Error over the sequence of every scenario."""
    figure, (ax,) = _figure(1)
    figure.set_size_inches(8.0, 4.0)
    rows = estimators[0]
    names = list(rows)
    at = np.arange(len(names), dtype=float)
    looks = (("least squares", "printed", look.ORANGE, "^"), ("EKF", "printed 2", look.GREEN, "s"),
             ("UKF", "printed 3", look.PURPLE, "D"))  # fmt: skip
    for index, (column, title, colour, marker) in enumerate(looks):
        x = at + 0.16 * (index - 1)
        ax.plot(x, [number(rows[n].get(column)) for n in names], marker, color=colour, label=column)
        ax.plot(x, [number(rows[n].get(title)) for n in names], marker, mfc="none", color=colour,
                label="published")  # fmt: skip
    if graph:
        mine = [number(graph[0].get(name, {}).get("sequence")) for name in names]
        ax.plot(at + 0.32, mine, "o", color=look.BLUE, label="factor graph")
    if bounds:
        least = [number(bounds[0].get(name, {}).get("bound")) for name in names]
        ax.plot(at, least, "k_", markersize=18, label="bound, height known")
    ax.set(ylabel="RMS horizontal error over the sequence (m)", yscale="log")
    ax.set_xticks(at, names)
    _logarithmic(ax.yaxis)
    ax.legend(ncols=2)
    return figure


def _angles(found: list[Rows], graph: list[Rows]) -> Figure:
    """Improvement over the baseline, ANEES and divergence of each world's estimators."""
    figure, axes = _figure(3, height=4.8)
    labels, cells = [], []
    worlds = ("sprang-simple", "sprang-staged", "levy-simple", "levy-staged")
    for world, table in zip(worlds, found, strict=False):
        for name, row in table.items():
            if name.startswith(_SHOWN):
                labels.append(f"{world}: {name}")
                cells.append(row)
    for world, table in zip(worlds[2:], graph, strict=False):
        for name, row in table.items():
            if name.startswith(("factor", "graph")):
                labels.append(f"{world}: {name}, own seeds")
                cells.append(row)
    at = np.arange(len(labels), dtype=float)[::-1]
    panels = (("by %, mean", "better than the baseline by (%)", None),
              ("ANEES", "ANEES (3 expected)", 3.0), ("KL", "KL of NEES", None))  # fmt: skip
    for ax, (column, title, expected) in zip(axes, panels, strict=True):
        values = np.array([number(row.get(column)) for row in cells])
        ax.errorbar(values, at, xerr=[spread(row.get(column)) for row in cells], fmt="o",
                    color=look.BLUE, label="ours")  # fmt: skip
        ax.plot([printed(row.get(column)) for row in cells], at, "D", mfc="none",
                color=look.VERMILION, label="published")  # fmt: skip
        if expected is not None:
            ax.axvline(expected, color="k", linewidth=0.8)
        positive = values[np.isfinite(values)]
        if column != "by %, mean" and positive.size and (positive > 0).all():
            ax.set_xscale("log")
            _logarithmic(ax.xaxis)
        ax.set_xlabel(title)
        ax.set_yticks(at, labels if ax is axes[0] else [""] * len(labels))
        ax.set_ylim(-0.7, len(labels) - 0.3)
    axes[-1].legend()
    return figure


def _cases(found: list[Rows], *, ratio: str, expected: float | None = None) -> Figure:
    """Error over the bound, and ANEES in its band, of the cases of a study."""
    figure, axes = _figure(2, height=1.2 + 0.22 * sum(map(len, found)))
    rows = {name: row for table in found for name, row in table.items()}
    at = np.arange(len(rows), dtype=float)[::-1]
    cells = list(rows.values())
    axes[0].errorbar([number(row.get(ratio)) for row in cells], at,
                     xerr=[1.96 * spread(row.get(ratio)) for row in cells], fmt="o",
                     color=look.BLUE)  # fmt: skip
    axes[0].axvline(1.0, color="k", linewidth=0.8)
    axes[0].set_xlabel("RMSE / bound (bars 95 %)")
    axes[0].set_yticks(at, list(rows))
    for y, row in zip(at, cells, strict=True):
        ends = [number(part) for part in row.get("99 % band", "").split("to")]
        if len(ends) == 2:
            axes[1].plot(ends, [y, y], color=look.BAND, linewidth=5, solid_capstyle="butt")
    axes[1].plot([number(row.get("ANEES")) for row in cells], at, "o", color=look.BLUE)
    if expected is not None:
        axes[1].axvline(expected, color="k", linewidth=0.8)
    axes[1].set_xlabel("ANEES and its 99 % band")
    axes[1].set_yticks(at, [""] * len(rows))
    return figure


_FIGURES: dict[str, tuple[tuple[str, ...], Callable[..., Figure]]] = {
    "tdoa-estimators": (("tdoa-estimators", "tdoa-graph"), _tdoa),
    "mixed": (("mixed",), lambda found: _cases(found, ratio="ratio", expected=1.0)),
    "aoa-estimators": (("aoa-estimators", "aoa-bounds", "aoa-graph"), _aoa),
    "angles-published": (("angles-published", "angles-graph"), _angles),
    "orbits": (("orbits",), lambda found: _cases(found, ratio="RMSE / bound", expected=3.0)),
}
"""Each figure: the studies whose tables it needs, the first at least, and who draws it."""
