"""Estimated sensor errors against their priors, and over time where they change."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.plot import _style as look
from geograph.plot._time import time_label
from geograph.results.facts import estimate_text
from geograph.states import RECORDING_NAME
from geograph.units import fitting_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from geograph.results import ErrorCurve, ErrorState, Results

_OVERVIEW_ROWS = 24


def draw_errors_in_sigmas(results: Results, ax: Axes) -> None:
    """Draw estimates over their prior sigmas, a row for each; the most surprising if many."""
    errors = [error for error in results.errors if error.prior_sigma > 0.0]
    errors.sort(key=lambda error: -abs(error.estimate) / error.prior_sigma)
    shown = errors[:_OVERVIEW_ROWS]
    if not shown:
        ax.text(0.5, 0.5, "no errors of sensors are estimated", ha="center", va="center")
        ax.set_axis_off()
        return
    ax.axvspan(-1.0, 1.0, color=look.PRIOR, alpha=0.8, lw=0, label="prior, 1 sigma")
    for edge in (-3.0, 3.0):
        ax.axvline(edge, color="0.5", lw=0.8, ls="--")
    for row, error in enumerate(shown):
        scale = error.prior_sigma
        colour = look.ALARM if error.surprising else look.BLUE
        spread = look.NORMAL_95 * error.sigma / scale
        ax.errorbar(error.estimate / scale, row, xerr=spread, fmt="o", ms=4, color=colour, lw=1.5)
    ax.set_yticks(range(len(shown)), [_row_label(error) for error in shown], fontsize=7.5)
    ax.set_ylim(len(shown) - 0.4, -0.6)
    reach = max(3.4, *(abs(e.estimate) / e.prior_sigma * 1.15 for e in shown))
    ax.set_xlim(-reach, reach)
    ax.set_xlabel("error / prior sigma (95 % bars)")
    if len(errors) > len(shown):
        ax.set_title(f"the {len(shown)} greatest of {len(errors)} sensor errors")
    ax.grid(axis="y", visible=False)


def _row_label(error: ErrorState) -> str:
    unit = fitting_unit(error.unit, error.estimate, error.sigma)
    owner = "" if error.sensor == RECORDING_NAME else f"{error.sensor} "
    return f"{owner}{error.state.replace('_', ' ')}  {estimate_text(error, unit)} {unit.name}"


def error_figure(results: Results) -> Figure:
    """Return a figure of all sensor errors: a panel a state, and one for each that changes."""
    states = list(dict.fromkeys(error.state for error in results.errors))
    kinds = list(dict.fromkeys(curve.kind for curve in results.curves))
    sensors = len({error.sensor for error in results.errors})
    columns = min(3, max(len(states), len(kinds), 1))
    rows = -(-max(len(states), 1) // columns)
    height = 1.1 + 0.3 * max(sensors, 3)
    lower = -(-len(kinds) // columns)
    figure = look.new_figure(max(4.2 * columns, 7.0), 0.8 + height * rows + 2.8 * lower)
    look.headline(figure, results, "sensor errors")
    grid = figure.add_gridspec(rows + lower, columns, height_ratios=[height] * rows + [2.8] * lower)
    if states:
        figure.supxlabel(
            "bars: 95 %; grey: prior, 1 sigma; (!): more than 3 prior sigmas from zero",
            fontsize=9,
            x=0.01,
            ha="left",
        )
    else:
        ax = figure.add_subplot(grid[0, 0])
        ax.text(0.5, 0.5, "no errors of sensors are estimated", ha="center", va="center")
        ax.set_axis_off()
    for index, state in enumerate(states):
        ax = figure.add_subplot(grid[index // columns, index % columns])
        _draw_state(ax, [error for error in results.errors if error.state == state])
    for index, kind in enumerate(kinds):
        ax = figure.add_subplot(grid[rows + index // columns, index % columns])
        draw_curves(results, ax, kind)
    return figure


def _draw_state(ax: Axes, errors: list[ErrorState]) -> None:
    unit = fitting_unit(
        errors[0].unit,
        [error.estimate for error in errors],
        [look.NORMAL_95 * error.sigma for error in errors],
    )
    for row, error in enumerate(errors):
        prior = error.prior_sigma / unit.size
        ax.barh(row, 2 * prior, left=-prior, height=0.8, color=look.PRIOR, lw=0, label="_")
        colour = look.ALARM if error.surprising else look.BLUE
        spread = look.NORMAL_95 * error.sigma / unit.size
        ax.errorbar(error.estimate / unit.size, row, xerr=spread, fmt="o", ms=4, color=colour)
    ax.axvline(0.0, color="0.4", lw=0.8)
    names = [f"{e.sensor} (!)" if e.surprising else e.sensor for e in errors]
    ax.set_yticks(range(len(errors)), names)
    ax.set_ylim(len(errors) - 0.4, -0.6)
    _limit_to_estimates(ax, errors, unit.size)
    ax.set_title(errors[0].state.replace("_", " "))
    ax.set_xlabel(unit.name)
    ax.locator_params(axis="x", nbins=6)
    ax.grid(axis="y", visible=False)


def _limit_to_estimates(ax: Axes, errors: list[ErrorState], size: float) -> None:
    """Keep a prior that is wide against all estimates from hiding them."""
    reach = max(abs(e.estimate) + look.NORMAL_95 * e.sigma for e in errors) / size
    if np.isfinite(reach) and reach > 0.0:
        priors = [e.prior_sigma / size for e in errors]
        reach = 1.1 * max(reach, min(max(priors), 5.0 * reach))
        ax.set_xlim(-reach, reach)


def draw_curves(results: Results, ax: Axes, kind: str) -> None:
    """Draw one kind of error against time, a line for each sensor where it changes."""
    curves = [curve for curve in results.curves if curve.kind == kind]
    order = [place.sensor for place in results.sensors]
    spread = [part for curve in curves for part in (curve.estimate, look.NORMAL_95 * curve.sigma)]
    unit = fitting_unit(curves[0].unit, *spread)
    for curve in curves:
        colour = look.sensor_look(order.index(curve.sensor))["color"]
        _draw_curve(ax, curve, colour=colour, size=unit.size)
    if len(curves) <= 8:
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0)
    ax.set_title(f"{kind} error over time, with 95 % bands")
    ax.set_ylabel(f"{kind} error ({unit.name})")
    look.label_time(ax, time_label(results))


def _draw_curve(ax: Axes, curve: ErrorCurve, *, colour: str, size: float) -> None:
    half = look.NORMAL_95 * curve.sigma
    low, high = (curve.estimate - half) / size, (curve.estimate + half) / size
    ax.fill_between(curve.time_s, low, high, color=colour, alpha=0.2, lw=0)
    ax.plot(curve.time_s, curve.estimate / size, color=colour, lw=1.4, label=curve.sensor)
