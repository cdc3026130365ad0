"""Residuals of every sensor, in units of angle and of their standard deviations."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from geograph.plot import _style as look
from geograph.units import fitting_unit

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from geograph.results import ResidualTable, Results

_KIND_LOOK = (("o", look.BLUE), ("^", look.ORANGE), ("s", look.GREEN), ("D", look.PURPLE))
_NORMALISED_LIMIT = 6.0
_TALL_LAYOUT = 8
_TAG = "time tag, by the sensor's own clock (s)"


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
    look.label_time(ax, _TAG)
    ax.set_ylabel("residual / sigma")


def residual_figure(results: Results) -> Figure:
    """Return a figure with the residuals of each sensor.

    Up to eight sensors have a row each: residuals in their unit on the left, over their standard
    deviation on the right. More share a grid of the latter, with the former's RMS in the titles.
    """
    measured = [
        place.sensor for place in results.sensors if len(results.residuals.of(place.sensor))
    ]
    if len(measured) > _TALL_LAYOUT:
        return _grid_figure(results, measured)
    figure = look.new_figure(10.0, 1.0 + 2.0 * max(len(measured), 1))
    look.headline(figure, results, "residuals of each sensor (measured - predicted)")
    axes = figure.subplots(max(len(measured), 1), 2, squeeze=False, sharex=True)
    for (left, right), sensor in zip(axes, measured, strict=False):
        rows = results.residuals.of(sensor)
        _draw_in_units(left, rows, sensor)
        _draw_expectation(right, rows)
        _draw_kinds(right, rows)
        right.set_ylabel("residual / sigma")
    for ax in axes[-1]:
        look.label_time(ax, _TAG)
    _legend(figure, axes.ravel().tolist())
    return figure


def _grid_figure(results: Results, sensors: list[str]) -> Figure:
    columns = 4 if len(sensors) <= 20 else 5
    count = math.ceil(len(sensors) / columns)
    figure = look.new_figure(3.2 * columns, 1.2 + 1.9 * count)
    look.headline(figure, results, "normalised residuals of each sensor")
    axes = figure.subplots(count, columns, squeeze=False, sharex=True, sharey=True)
    for ax, sensor in zip(axes.flat, sensors, strict=False):
        rows = results.residuals.of(sensor)
        _draw_expectation(ax, results.residuals)
        _draw_kinds(ax, rows)
        used = rows.residual[~rows.rejected]
        rms = math.sqrt(float(np.mean(used**2))) if used.size else math.nan
        unit = fitting_unit(str(rows.unit[0]), rms)
        ax.set_title(f"{sensor}, RMS {rms / unit.size:.3g} {unit.name}")
    for ax in axes.flat[len(sensors) :]:
        ax.set_axis_off()
    for ax in axes[:, 0]:
        ax.set_ylabel("residual / sigma")
    for ax in axes[-1]:
        look.label_time(ax, _TAG)
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
    for kind, (marker, colour) in zip(_kinds(rows), _KIND_LOOK, strict=False):
        _scatter_normalised(ax, _of_kind(rows, kind), label=kind, marker=marker, color=colour)
    _mark_rejected(ax, rows, normalised=True)


def _of_kind(rows: ResidualTable, kind: str) -> ResidualTable:
    return rows.of(str(rows.sensor[0]), kind)


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


def _draw_in_units(ax: Axes, rows: ResidualTable, sensor: str) -> None:
    used = rows.residual[~rows.rejected]
    # A few gross values should not choose the unit for all.
    typical = np.quantile(np.abs(used), 0.98) if used.size else 0.0
    unit = fitting_unit(str(rows.unit[0]), typical)
    for kind, (marker, colour) in zip(_kinds(rows), _KIND_LOOK, strict=False):
        chosen = _of_kind(rows, kind)
        shown = ~chosen.rejected
        ax.plot(
            chosen.time_s[shown],
            chosen.residual[shown] / unit.size,
            ls="none",
            marker=marker,
            color=colour,
            ms=_marker_size(len(chosen)),
            alpha=0.7,
            mew=0,
            label=kind,
        )
    ax.axhline(0.0, color="0.4", lw=0.8)
    ax.margins(y=0.12)
    _mark_rejected(ax, rows, normalised=False, size=unit.size)
    lost = np.unique(rows.line[rows.rejected]).size
    note = f", {lost} rejected" if lost else ""
    ax.set_title(f"{sensor}: {_measurements(rows)} measurements{note}")
    ax.set_ylabel(f"residual ({unit.name})")


def _measurements(rows: ResidualTable) -> int:
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
