"""Platforms whose path is estimated: their fixes about that path."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.geodesy import enu_axes
from geograph.plot import _style as look
from geograph.plot._time import time_label
from geograph.results.data import turned_covariance
from geograph.results.interpolate import columns_at
from geograph.units import fitting_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from geograph.results import PlatformPath, Results

_MOST = 8


def platform_figure(results: Results) -> Figure:
    """Return a figure of the fixes less the estimated paths, with the 95 % bands of the latter.

    A row for each platform, the first eight of many; a column for each axis.
    """
    shown = results.platforms[:_MOST]
    every = ("east", "north", "up") if results.frame == "ecef" else ("x", "y", "z")
    axes = every[: 2 if results.height_held else 3]
    figure = look.new_figure(4.2 * len(axes), 1.3 + 1.9 * len(shown))
    several = f", {_MOST} of {len(results.platforms)}" if len(results.platforms) > _MOST else ""
    look.headline(figure, results, f"platforms: fixes - estimated path{several}")
    panels = figure.subplots(len(shown), len(axes), squeeze=False, sharex=True)
    for row, platform in zip(panels, shown, strict=True):
        _draw_platform(results, platform, row, axes)
    for ax in panels[-1]:
        look.label_time(ax, time_label(results))
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=2)
    return figure


def _draw_platform(
    results: Results, platform: PlatformPath, row: NDArray[np.object_], axes: tuple[str, ...]
) -> None:
    place = next(place for place in results.sensors if place.sensor == platform.sensor)
    inside = (place.time_s >= platform.time_s[0]) & (place.time_s <= platform.time_s[-1])
    time = place.time_s[inside]
    estimate, _ = platform.knots().at(time)
    error = place.position_m[inside] - estimate
    covariance = platform.position_covariance_m2
    if results.frame == "ecef":
        error = np.einsum("nij,nj->ni", enu_axes(estimate), error)
        covariance = turned_covariance(enu_axes(platform.position_m), covariance)
    sigma = np.sqrt(np.maximum(np.einsum("kii->ki", covariance), 0.0))
    fine = look.dense(platform.time_s)
    half = look.NORMAL_95 * columns_at(fine, platform.time_s, sigma)
    unit = fitting_unit("m", error[:, : len(axes)], half[:, : len(axes)])
    for index, name in enumerate(axes):
        ax: Axes = row[index]
        band = half[:, index] / unit.size
        ax.fill_between(
            fine, -band, band, color=look.BAND, alpha=0.45, lw=0, label="95 % band of the path"
        )
        ax.axhline(0.0, color=look.PATH, lw=1.2)
        ax.plot(time, error[:, index] / unit.size, ".", color=look.ORANGE, ms=4, label="fixes")
        ax.set_ylabel(f"{name} ({unit.name})")
    row[0].set_title(platform.sensor)
