"""Pictures of a Cramer-Rao bound: along the path, and as a map."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.bound_grid import to_plane
from geograph.geodesy import geodetic_from_ecef
from geograph.plot import _style as look
from geograph.plot._plane import extent, length_unit
from geograph.results.data import turned_covariance
from geograph.units import fitting_unit

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from geograph.bound_grid import BoundMap
    from geograph.bounds import PathBound
    from geograph.recording import Frame

_ELLIPSES, _MOST_LABELS, _MOST_BARS = 15, 12, 30
_LOG_RATIO = 20.0


def save_pictures(bound: PathBound, over: BoundMap | None, target: Path, map_target: Path) -> None:
    """Draw the bound along the path, and the map if there is one, into files.

    Parameters
    ----------
    bound, over
        Along the path, and as a map or None.
    target, map_target
        PNG files to write.
    """
    with look.style():
        bound_figure(bound).savefig(target, format="png")
        if over is not None:
            map_figure(over).savefig(map_target, format="png")


def bound_figure(bound: PathBound) -> Figure:
    """Return a figure of the bound over time and in plan view, and of the sensors' errors."""
    figure = look.new_figure(13.0, 7.0)
    where = "true" if bound.evaluated_at == "truth" else "estimated"
    text = f"{bound.recording.name}: Cramer-Rao bound along the {where} path"
    figure.suptitle(
        text if bound.observable else f"{text}, NOT OBSERVABLE",
        x=0.01,
        ha="left",
        fontsize=12,
        color=look.BLACK if bound.observable else look.ALARM,
    )
    bars = _bars(bound)
    left, right = figure.subfigures(1, 2, squeeze=False, width_ratios=[1.2, 1.0])[0]
    draw_plan(bound, left.subplots())
    if not bars:
        draw_sigmas(bound, right.subplots())
        return figure
    # More room for more names.
    share = min(0.12 * len(bars), 1.5)
    over, under = right.subplots(2, 1, height_ratios=[1.0, max(share, 0.4)])
    draw_sigmas(bound, over)
    _draw_bars(bars, under)
    return figure


def draw_sigmas(bound: PathBound, ax: Axes) -> None:
    """Draw horizontal and vertical sigmas against time; a wide range on a logarithmic scale."""
    height = "height" if bound.frame == "ecef" else "z"
    lines = {
        "horizontal (root mean square)": (bound.sigma_horizontal_m, look.PATH, "-"),
        f"{height} (1 sigma)": (bound.sigma_height_m, look.VERMILION, "--"),
        "circular error probable": (bound.cep_m(), look.GREEN, ":"),
    }
    every = np.concatenate([values for values, _, _ in lines.values()])
    unit = fitting_unit("m", every)
    time = bound.time_s
    if time.size == 1:
        # One knot stands for the whole recording.
        time = np.asarray(bound.recording.time_span_s)
    for label, (values, colour, style) in lines.items():
        shown = np.broadcast_to(values, time.shape) / unit.size
        ax.plot(time, shown, style, color=colour, lw=1.8, label=label)
    finite = every[np.isfinite(every) & (every > 0.0)]
    if finite.size and finite.max() > _LOG_RATIO * finite.min():
        ax.set_yscale("log")
        _plain_ticks(ax.yaxis)
    else:
        ax.set_ylim(bottom=0.0)
    epoch = bound.recording.epoch
    since = "" if epoch is None else f" after {epoch:%Y-%m-%d %H:%M:%S} UTC"
    look.label_time(ax, f"time{since} (s)")
    ax.set_ylabel(f"bound ({unit.name})")
    ax.legend(loc="best")


def draw_plan(bound: PathBound, ax: Axes) -> None:
    """Draw the path over ground with the bound's 95 % ellipses, and the sensors."""
    middle = bound.position_m[bound.time_s.size // 2]
    track = to_plane(bound.position_m, middle, bound.frame)
    axes = _plane_axes(middle, bound.frame)
    outline = look.ellipse_outline(turned_covariance(axes, bound.position_covariance_m2))
    span = np.linspace(*bound.recording.time_span_s, 100)
    sensors = {
        name: to_plane(sensor.position_at(span), middle, bound.frame)
        for name, sensor in bound.recording.sensors.items()
    }
    shown = np.concatenate([track, *sensors.values()])
    factor = look.magnification(outline, extent(shown))
    unit = length_unit(extent(shown))
    _draw_sensors(ax, sensors, unit.size)
    label = "95 % ellipses of the bound" + (
        f", drawn {factor:.0f} times larger" if factor > 1.0 else ""
    )
    for knot in look.some(len(track), _ELLIPSES):
        if np.isfinite(outline[knot]).all():
            ring = (track[knot] + factor * outline[knot]) / unit.size
            ax.fill(*ring.T, fc=look.BAND, ec=look.PATH, alpha=0.35, lw=0.7, zorder=3, label=label)
            label = "_"
    style = "-" if len(track) > 1 else "o"
    ax.plot(
        *track.T / unit.size,
        style,
        color=look.PATH,
        lw=2.0,
        zorder=4,
        label="path" if len(track) > 1 else "object",
    )
    if len(track) > 1:
        ax.plot(*track[0] / unit.size, "o", color=look.PATH, mfc="white", zorder=6, label="start")
    _label_plane(ax, middle, bound.frame, unit.name)
    ax.margins(0.1)
    ax.legend(loc="upper left", bbox_to_anchor=(0.0, -0.1), ncols=3, borderaxespad=0.0)


def _plane_axes(middle_m: NDArray[np.float64], frame: Frame) -> NDArray[np.float64]:
    """Return the two directions of a plan view as rows, shape (2, 3)."""
    return to_plane(middle_m + np.eye(3), middle_m, frame).T if frame == "ecef" else np.eye(3)[:2]


def _label_plane(ax: Axes, middle_m: NDArray[np.float64], frame: Frame, unit: str) -> None:
    across, along = "x", "y"
    if frame == "ecef":
        latitude, longitude, _ = geodetic_from_ecef(middle_m)
        where = (
            f"{abs(latitude):.4f}° {'N' if latitude >= 0 else 'S'} "
            f"{abs(longitude):.4f}° {'E' if longitude >= 0 else 'W'}"
        )
        across, along = f"east of {where}", f"north of {where}"
    ax.set_xlabel(f"{across} ({unit})")
    ax.set_ylabel(f"{along} ({unit})")
    ax.set_aspect("equal", adjustable="datalim")


def _draw_sensors(ax: Axes, sensors: dict[str, NDArray[np.float64]], unit: float) -> None:
    for index, (name, points) in enumerate(sensors.items()):
        appearance = look.sensor_look(index)
        way = points / unit
        if np.ptp(way, axis=0).max() > 0.0:
            ax.plot(*way.T, color=appearance["color"], lw=1.0, zorder=5)
        ax.plot(*way[-1], ls="none", mec="black", mew=0.6, ms=7, zorder=7, **appearance)
        if len(sensors) <= _MOST_LABELS:
            ax.annotate(
                name,
                way[-1],
                xytext=(5, 5),
                textcoords="offset points",
                fontsize=8,
                zorder=8,
                bbox={"fc": "white", "ec": "none", "alpha": 0.6, "pad": 0.5},
            )
    ax.plot([], [], ls="none", marker="o", color="0.6", mec="black", mew=0.6, label="sensors")


def _bars(bound: PathBound) -> list[tuple[str, float, str]]:
    """Return name, share of the prior and text of every sensor error, the best known first."""
    bars = []
    for name, states in bound.sensor_bounds.items():
        for state, entry in states.items():
            if not np.isfinite(entry.sigma):
                continue
            unit = fitting_unit(entry.unit, entry.sigma)
            text = f"{entry.sigma / unit.size:.3g} {unit.name}"
            bars.append(
                (f"{name} {state.replace('_', ' ')}", entry.sigma / entry.prior_sigma, text)
            )
    bars.sort(key=lambda bar: bar[1])
    return bars[:_MOST_BARS]


def _draw_bars(bars: list[tuple[str, float, str]], ax: Axes) -> None:
    rank = np.arange(len(bars))
    size = 8.0 if len(bars) <= 16 else 6.0
    ax.barh(rank, [100.0 * share for _, share, _ in bars], color=look.BAND, height=0.7)
    for place, (_, share, text) in zip(rank, bars, strict=True):
        ax.text(100.0 * share, float(place), f" {text}", va="center", fontsize=size)
    ax.set_yticks(rank, [name for name, _, _ in bars], fontsize=size)
    # A single bar is not to fill the whole height.
    ax.set_ylim(max(len(bars), 4) - 0.4, -0.6)
    ax.set_xlim(0.0, 125.0)
    ax.axvline(100.0, color=look.BLACK, lw=0.8, ls=":")
    ax.set_xlabel("bound of the sensors' errors (% of the prior sigma)")
    ax.grid(visible=False, axis="y")


def map_figure(over: BoundMap) -> Figure:
    """Return a figure of the bound as a map, with contour lines and the sensors."""
    figure = look.new_figure(9.0, 7.5)
    figure.suptitle(
        f"{over.recording.name}: Cramer-Rao bound of an emitter that stands still",
        x=0.01,
        ha="left",
        fontsize=12,
    )
    draw_map(over, figure.subplots())
    return figure


def draw_map(over: BoundMap, ax: Axes) -> None:
    """Draw the horizontal bound over the positions of the emitter, on a logarithmic scale."""
    from matplotlib.colors import LogNorm

    sigma = np.where(over.observable, over.sigma_horizontal_m, np.nan)
    known = sigma[np.isfinite(sigma)]
    ground = length_unit(max(float(np.ptp(over.east_m)), 1e-9))
    east, north = over.east_m / ground.size, over.north_m / ground.size
    if known.size:
        unit = fitting_unit("m", float(np.median(known)))
        # Cells beside a sensor must not take all the colours.
        norm = LogNorm(*(np.quantile(known, [0.01, 0.99]) * [0.999, 1.001] / unit.size))
        options: dict[str, Any] = {"cmap": "viridis_r", "norm": norm, "shading": "nearest"}
        mesh = ax.pcolormesh(east, north, sigma / unit.size, **options)
        levels = _levels(known / unit.size)
        if len(levels):
            lines = ax.contour(
                east, north, sigma / unit.size, levels=levels, colors="white", linewidths=0.9
            )
            ax.clabel(lines, fmt=lambda value: f"{value:g} {unit.name}", fontsize=8)
        bar = ax.figure.colorbar(mesh, ax=ax, label=f"horizontal root mean square ({unit.name})")
        _plain_ticks(bar.ax.yaxis)
    if not over.observable.all():
        ax.set_facecolor("0.85")
        ax.fill([], [], color="0.85", label="not observable")
    if over.recording.terrain is not None:
        draw_ground(ax, over.position_m, over.frame, east, north)
    _draw_sensors(ax, over.sensor_plane_m(), ground.size)
    _label_plane(ax, over.center_m, over.frame, ground.name)
    half = 0.5 * (east[1] - east[0])
    ax.set_aspect("equal", adjustable="box")
    ax.set_xlim(east[0] - half, east[-1] + half)
    ax.set_ylim(north[0] - half, north[-1] + half)
    ax.legend(loc="upper left", bbox_to_anchor=(0.0, -0.09), ncols=3, borderaxespad=0.0)


def draw_ground(
    ax: Axes,
    position_m: NDArray[np.float64],
    frame: Frame,
    east: NDArray[np.float64],
    north: NDArray[np.float64],
) -> None:
    """Draw thin contour lines of the ground.

    Parameters
    ----------
    ax
        Where.
    position_m
        Shape (b, a, 3): positions on the ground.
    frame
        Their frame.
    east, north
        Shapes (a,), (b,): columns and rows, in the axes' unit.
    """
    height = geodetic_from_ecef(position_m)[..., 2] if frame == "ecef" else position_m[..., 2]
    if float(np.ptp(height)) > 1.0:
        ax.contour(east, north, height, levels=12, colors="black", linewidths=0.4, alpha=0.5)
        ax.plot([], [], color="black", linewidth=0.4, alpha=0.5, label="height of the ground")


def _plain_ticks(axis: Axis) -> None:
    """Label a logarithmic axis with plain numbers, 1, 2 and 5 times powers of ten."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(_plain_number)
    axis.set_minor_formatter(NullFormatter())


def _plain_number(value: float, _: float) -> str:
    return f"{value:g}"


def _levels(values: NDArray[np.float64], most: int = 9) -> NDArray[np.float64]:
    """Return round levels, 1, 2 or 5 times powers of ten, inside the range of values."""
    low, high = float(values.min()), float(values.max())
    powers = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1.0)
    for steps in ((1.0, 2.0, 5.0), (1.0, 3.0), (1.0,)):
        levels = np.sort(np.outer(steps, 10.0**powers).ravel())
        levels = levels[(levels > low) & (levels < high)]
        if levels.size <= most:
            return levels
    return levels[:: int(np.ceil(levels.size / most))]
