"""Residuals of every sensor and pair, in their own units and in their standard deviations."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from geograph.plot import _style as look
from geograph.units import fitting_unit

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from geograph.results import ResidualTable, Results


class _Kind(NamedTuple):
    """What measurements of a kind are called, one by one and together, and their look."""

    coordinate: str
    table: str
    unit: str
    marker: str
    colour: str


_KINDS = {
    "azimuth": _Kind("azimuth", "bearings", "rad", "o", look.BLUE),
    "elevation": _Kind("elevation", "bearings", "rad", "^", look.ORANGE),
    "toa": _Kind("arrival time", "arrival times", "s", "s", look.GREEN),
    "tdoa": _Kind("time difference", "time differences", "s", "D", look.PURPLE),
    "fdoa": _Kind("frequency difference", "frequency differences", "Hz", "v", look.SKY),
}
_NORMALISED_LIMIT = 6.0
_TALL_LAYOUT, _MOST_PANELS = 8, 40


def draw_normalised(results: Results, ax: Axes) -> None:
    """Draw all normalised residuals against time, a colour for each sensor."""
    _draw_expectation(ax, results.residuals)
    for index, place in enumerate(results.sensors):
        rows = results.residuals.of(place.sensor)
        if len(rows):
            style = look.sensor_look(index)
            label = place.sensor if len(results.sensors) <= 12 else "_"
            _scatter_normalised(ax, rows, label=label, **style)
    _mark_rejected(ax, results.residuals, normalised=True)
    look.label_time(ax, "time tag (s)")
    ax.set_ylabel("residual / sigma")


def _tag(rows: ResidualTable) -> str:
    """Return the label of an axis of time tags."""
    differences = rows.reference != ""
    if not differences.any():
        return "time tag, by the sensor's own clock (s)"
    return "time tag, by the reference's clock (s)" if differences.all() else "time tag (s)"


def residual_panels(results: Results) -> list[tuple[str, ResidualTable]]:
    """Return titles and residuals of all panels: one for each sensor, or pair, and unit.

    Where pairs would make too many, those of one sensor share a panel.
    """
    rows = results.residuals
    order = {place.sensor: index for index, place in enumerate(results.sensors)}
    units = list(dict.fromkeys(kind.unit for kind in _KINDS.values()))
    pairs = rows.reference
    keys = set(zip(rows.sensor.tolist(), pairs.tolist(), rows.unit.tolist(), strict=True))
    if len(keys) > _MOST_PANELS:
        # A reference of any name, so that differences stay apart from what is none.
        pairs = np.where(pairs != "", "others", "")
        keys = set(zip(rows.sensor.tolist(), pairs.tolist(), rows.unit.tolist(), strict=True))
    panels = []
    for sensor, reference, unit in sorted(
        keys,
        key=lambda key: (order[key[0]], key[1] != "", order.get(key[1], 0), units.index(key[2])),
    ):
        own = rows.where((rows.sensor == sensor) & (pairs == reference) & (rows.unit == unit))
        panels.append((f"{sensor} - {reference}" if reference else sensor, own))
    return panels


def residual_figure(results: Results) -> Figure:
    """Return a figure with the residuals of each sensor, or pair, and unit.

    Up to eight have a row each: residuals in their unit on the left, over their standard deviation
    on the right. More share a grid of the latter, with the former's RMS in the titles.
    """
    panels = residual_panels(results)
    if len(panels) > _TALL_LAYOUT:
        return _grid_figure(results, panels)
    figure = look.new_figure(10.5, 1.0 + 2.0 * max(len(panels), 1))
    look.headline(figure, results, f"residuals of each {_each(results)} (measured - predicted)")
    axes = figure.subplots(max(len(panels), 1), 2, squeeze=False, sharex=True)
    speed = results.summary.get("propagation_speed_m_s")
    for (left, right), (title, rows) in zip(axes, panels, strict=False):
        _draw_in_units(left, rows, title, speed)
        _draw_expectation(right, rows)
        _draw_kinds(right, rows)
        right.set_ylabel("residual / sigma")
    for ax in axes[-1]:
        look.label_time(ax, _tag(results.residuals))
    _legend(figure, axes.ravel().tolist())
    return figure


def _each(results: Results) -> str:
    differences = results.residuals.reference != ""
    if not differences.any():
        return "sensor"
    return "sensor less its reference" if differences.all() else "sensor and pair"


def _grid_figure(results: Results, panels: list[tuple[str, ResidualTable]]) -> Figure:
    columns = 4 if len(panels) <= 20 else 5
    count = math.ceil(len(panels) / columns)
    figure = look.new_figure(3.2 * columns, 1.2 + 1.9 * count)
    look.headline(figure, results, f"normalised residuals of each {_each(results)}")
    axes = figure.subplots(count, columns, squeeze=False, sharex=True, sharey=True)
    for ax, (title, rows) in zip(axes.flat, panels, strict=False):
        _draw_expectation(ax, results.residuals)
        _draw_kinds(ax, rows)
        used = rows.residual[~rows.rejected]
        rms = math.sqrt(float(np.mean(used**2))) if used.size else math.nan
        unit = fitting_unit(str(rows.unit[0]), rms)
        ax.set_title(f"{title}, RMS {rms / unit.size:.3g} {unit.name}")
    for ax in axes.flat[len(panels) :]:
        ax.set_axis_off()
    for ax in axes[:, 0]:
        ax.set_ylabel("residual / sigma")
    # The last row may end early: the time stands under the lowest panel of each column.
    for ax in axes.flat[max(len(panels) - columns, 0) : len(panels)]:
        ax.tick_params(labelbottom=True)
        look.label_time(ax, _tag(results.residuals))
    _legend(figure, axes.ravel().tolist())
    return figure


def _draw_expectation(ax: Axes, rows: ResidualTable) -> None:
    ax.axhspan(
        -look.NORMAL_95, look.NORMAL_95, color=look.PRIOR, alpha=0.6, lw=0, label="95 % band"
    )
    ax.axhline(0.0, color="0.4", lw=0.8)
    size = np.abs(rows.normalised[np.isfinite(rows.normalised)])
    reach = float(np.clip(1.1 * size.max(initial=0.0), 4.0, 1.08 * _NORMALISED_LIMIT))
    ax.set_ylim(-reach, reach)


def _kinds(rows: ResidualTable) -> list[str]:
    return list(dict.fromkeys(rows.kind.tolist()))


def _draw_kinds(ax: Axes, rows: ResidualTable) -> None:
    for name in _kinds(rows):
        kind = _KINDS[name]
        own = rows.where(rows.kind == name)
        _scatter_normalised(ax, own, label=kind.coordinate, marker=kind.marker, color=kind.colour)
    _mark_rejected(ax, rows, normalised=True)


def _scatter_normalised(
    ax: Axes, rows: ResidualTable, *, label: str, marker: str, color: str
) -> None:
    shown = ~rows.rejected
    value = np.clip(rows.normalised[shown], -_NORMALISED_LIMIT, _NORMALISED_LIMIT)
    ax.plot(
        rows.time_s[shown],
        value,
        ls="none",
        marker=marker,
        color=color,
        ms=_marker_size(len(rows)),
        alpha=0.7,
        mew=0,
        label=label,
    )


def _marker_size(count: int) -> float:
    return 4.0 if count < 200 else 2.5


def _mark_rejected(ax: Axes, rows: ResidualTable, *, normalised: bool, size: float = 1.0) -> None:
    """Cross out what was rejected; what lies beyond the axes stands at their edge."""
    if not rows.rejected.any():
        return
    time = rows.time_s[rows.rejected]
    if normalised:
        value = np.clip(rows.normalised[rows.rejected], -_NORMALISED_LIMIT, _NORMALISED_LIMIT)
    else:
        low, high = ax.get_ylim()
        value = np.clip(rows.residual[rows.rejected] / size, low, high)
        ax.set_ylim(low, high)
    ax.plot(
        time,
        value,
        ls="none",
        marker="x",
        color=look.ALARM,
        ms=6,
        mew=1.5,
        label="rejected",
        clip_on=False,
        zorder=5,
    )


def _draw_in_units(ax: Axes, rows: ResidualTable, title: str, speed_m_s: float | None) -> None:
    used = rows.residual[~rows.rejected]
    # A few gross values should not choose the unit for all.
    typical = np.quantile(np.abs(used), 0.98) if used.size else 0.0
    unit = fitting_unit(str(rows.unit[0]), typical)
    for name in _kinds(rows):
        kind = _KINDS[name]
        chosen = rows.where(rows.kind == name)
        shown = ~chosen.rejected
        ax.plot(
            chosen.time_s[shown],
            chosen.residual[shown] / unit.size,
            ls="none",
            marker=kind.marker,
            color=kind.colour,
            ms=_marker_size(len(chosen)),
            alpha=0.7,
            mew=0,
            label=kind.coordinate,
        )
    ax.axhline(0.0, color="0.4", lw=0.8)
    ax.margins(y=0.12)
    _mark_rejected(ax, rows, normalised=False, size=unit.size)
    lost = _measurements(rows.where(rows.rejected))
    note = f", {lost} rejected" if lost else ""
    what = _KINDS[str(rows.kind[0])].table
    ax.set_title(f"{title}: {_measurements(rows)} {what}{note}")
    ax.set_ylabel(f"residual ({unit.name})")
    if str(rows.unit[0]) == "s" and speed_m_s is not None and np.isfinite(speed_m_s):
        _add_metres(ax, unit.size * speed_m_s, largest=typical * speed_m_s)


def _add_metres(ax: Axes, size_m: float, *, largest: float) -> None:
    """Add an axis on the right that tells times as the way of the signal."""
    unit = fitting_unit("m", largest)
    ratio = size_m / unit.size

    def there(time: Any) -> Any:
        return time * ratio

    def back(way: Any) -> Any:
        return way / ratio

    right = ax.secondary_yaxis("right", functions=(there, back))
    right.set_ylabel(f"as range ({unit.name})")


def _measurements(rows: ResidualTable) -> int:
    """Return how many measurements rows are of: a bearing has two."""
    return max((int((rows.kind == kind).sum()) for kind in _kinds(rows)), default=0)


def _legend(figure: Figure, axes: list[Axes]) -> None:
    handles: dict[str, Artist] = {}
    for ax in axes:
        found, labels = ax.get_legend_handles_labels()
        handles |= dict(zip(labels, found, strict=True))
    if handles:
        figure.legend(
            list(handles.values()), list(handles), loc="outside lower left", ncols=len(handles)
        )
