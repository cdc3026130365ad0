"""Charts of the residuals: a panel for each sensor, or pair, and unit; and who the outliers are."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.plot import _style as look
from geograph.plot._residuals import residual_panels
from geograph.report_page.charts import chart, level
from geograph.report_page.limits import short, short_time
from geograph.units import fitting_unit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.report_page.limits import Limits
    from geograph.results import ResidualTable, Results

_LOOKS = {
    "azimuth": ("azimuth", "o", look.BLUE),
    "elevation": ("elevation", "^", look.ORANGE),
    "toa": ("arrival time", "s", look.GREEN),
    "tdoa": ("time difference", "D", look.PURPLE),
    "fdoa": ("frequency difference", "v", look.SKY),
}
_EDGE = 6.0
"""Residuals of more sigmas are drawn at the edge, so that one does not flatten all others."""

_NAMED = 3
_LEAST_OF_A_PANEL = 60


def residual_charts(results: Results, limits: Limits) -> tuple[list[dict[str, Any]], int, int]:
    """Return charts of normalised residuals, how many are drawn, and how many panels are left out.

    Parameters
    ----------
    results
        Of one recording.
    limits
        Of what is drawn. Rejected residuals are drawn first, then every so manieth of the others.
    """
    panels = residual_panels(results)
    shown = panels[: limits.panels]
    each = max(_LEAST_OF_A_PANEL, limits.residuals // max(len(shown), 1))
    times = results.residuals.time_s
    span = [float(times.min()), float(times.max())] if times.size else None
    charts, drawn = [], 0
    for title, rows in shown:
        kept = _kept(rows, each)
        drawn += kept.size
        charts.append(_panel(title, rows, rows.where(_mask(kept, len(rows))), span))
    return charts, drawn, len(panels) - len(shown)


def _mask(rows: NDArray[np.int64], count: int) -> NDArray[np.bool_]:
    mask = np.zeros(count, dtype=np.bool_)
    mask[rows] = True
    return mask


def _kept(rows: ResidualTable, most: int) -> NDArray[np.int64]:
    if len(rows) <= most:
        return np.arange(len(rows))
    lost, good = np.flatnonzero(rows.rejected), np.flatnonzero(~rows.rejected)
    # Half of the room at most is theirs, should a sensor be rejected as a whole.
    lost = lost[look.some(lost.size, most // 2)] if lost.size else lost
    good = good[look.some(good.size, most - lost.size)] if good.size else good
    return np.sort(np.concatenate([lost, good]))


def _panel(
    title: str, everything: ResidualTable, rows: ResidualTable, span: list[float] | None
) -> dict[str, Any]:
    layers: list[dict[str, Any]] = [
        {
            "kind": "levels",
            "low": -look.NORMAL_95,
            "high": look.NORMAL_95,
            "colour": "#eaf4fb",
            "label": "95 % of honest residuals",
        },
        level(0.0),
    ]
    for kind in dict.fromkeys(rows.kind.tolist()):
        label, marker, colour = _LOOKS.get(kind, (kind, "o", look.BLUE))
        own = rows.where((rows.kind == kind) & ~rows.rejected)
        if len(own):
            layers.append(_points(own, label=label, marker=marker, colour=colour))
    lost = rows.where(rows.rejected)
    if len(lost):
        layers.append(_points(lost, label="rejected", marker="x", colour=look.ALARM, size=4.5))
        layers.append(_names(lost))
    used = everything.residual[~everything.rejected]
    rms = math.sqrt(float(np.mean(used**2))) if used.size else math.nan
    unit = fitting_unit(str(everything.unit[0]), rms)
    fit = f"RMS {rms / unit.size:.3g} {unit.name}" if used.size else "none used"
    out = int(everything.rejected.sum())
    reach = float(np.abs(rows.normalised[np.isfinite(rows.normalised)]).max(initial=3.0))
    edge = min(_EDGE, max(3.5, 1.1 * reach))
    return chart(
        title,
        "time tag (s)",
        "residual / sigma",
        layers,
        note=f"{fit}, {used.size} used" + (f", {out} rejected" if out else ""),
        y_range=[-edge, edge],
        x_range=span,
        clamp=True,
    )


def _points(rows: ResidualTable, **look_of: Any) -> dict[str, Any]:
    return {
        "kind": "points",
        "x": short_time(rows.time_s),
        "y": short(rows.normalised, 4),
        "tips": [_tip(rows, row) for row in range(len(rows))] if look_of["marker"] == "x" else [],
        **look_of,
    }


def _tip(rows: ResidualTable, row: int) -> str:
    unit = fitting_unit(str(rows.unit[row]), float(rows.residual[row]))
    kind = _LOOKS.get(str(rows.kind[row]), (str(rows.kind[row]),))[0]
    where = f", line {rows.line[row]}" if rows.line[row] else ""
    return (
        f"{kind} at {rows.time_s[row]:.9g} s{where}: {rows.residual[row] / unit.size:+.4g} "
        f"{unit.name}, {rows.normalised[row]:+.3g} sigma"
    )


def _names(lost: ResidualTable) -> dict[str, Any]:
    """Return names of the greatest outliers: their lines in the recording's table, or times."""
    size = np.where(np.isfinite(lost.normalised), np.abs(lost.normalised), np.inf)
    order = np.argsort(-size, kind="stable")
    chosen: list[int] = []
    seen: set[str] = set()
    for row in order.tolist():
        name = _place(lost, row)
        if name not in seen:
            seen.add(name)
            chosen.append(row)
        if len(chosen) == _NAMED:
            break
    return {
        "kind": "names",
        "x": short_time(lost.time_s[chosen]),
        "y": short(lost.normalised[chosen], 4),
        "names": [_place(lost, row) for row in chosen],
        "colour": look.ALARM,
        "label": "",
    }


def _place(rows: ResidualTable, row: int) -> str:
    return f"line {rows.line[row]}" if rows.line[row] else f"{rows.time_s[row]:.6g} s"
