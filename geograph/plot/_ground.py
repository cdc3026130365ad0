"""The path over ground: sensors, sight lines and ellipses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.geodesy import enu_axes
from geograph.plot import _style as look
from geograph.plot._plane import Plane, extent, length_unit, plane_of
from geograph.results.interpolate import columns_at

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from geograph.results import Results, SensorPath

_ELLIPSES, _SIGHT_LINES = 15, 12


def draw_path(results: Results, ax: Axes, *, sensors: bool, legend: bool = True) -> None:
    """Draw the path on axes of equal scale; ``sensors``: with them and their sight lines."""
    plane = plane_of(results)
    track = plane.project(results.position_m)
    places = [plane.project(place.position_m) for place in results.sensors]
    outline, factor = _ellipses(results, plane, track)
    near = np.concatenate([track, (track[:, None] + outline).reshape(-1, 2)])
    shown = np.concatenate([near, *places]) if sensors else near
    unit = length_unit(extent(shown))
    if sensors:
        _draw_sensors(results, ax, plane, unit.size)
    if results.truth is not None:
        true = plane.project(results.truth.position_m) / unit.size
        ax.plot(*true.T, "--", color=look.TRUTH, lw=1.2, zorder=5, label="truth")
    _draw_ellipses(results, ax, track, outline, factor=factor, unit=unit.size)
    if results.time_s.size > 1:
        drawn = plane.project(results.knots().at(look.dense(results.time_s))[0])
        ax.plot(*drawn.T / unit.size, color=look.PATH, lw=2.2, zorder=4, label="path")
        _draw_ends(ax, track / unit.size)
    else:
        ax.plot(*track.T / unit.size, "o", color=look.PATH, zorder=5, label="position")
    ax.set_xlabel(f"{plane.across} ({unit.name})")
    ax.set_ylabel(f"{plane.along} ({unit.name})")
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.14 if sensors else 0.08)
    if legend:
        ax.legend(loc="upper left", bbox_to_anchor=(0.0, -0.13), ncols=3, borderaxespad=0.0)


def _ellipses(
    results: Results, plane: Plane, track: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    chosen = look.some(len(track), _ELLIPSES)
    outline = look.ellipse_outline(plane.covariance(results.position_covariance_m2[chosen]))
    factor = look.magnification(outline, extent(track))
    full = np.full((len(track), outline.shape[1], 2), np.nan)
    full[chosen] = outline * factor
    return full, factor


def _draw_ellipses(
    results: Results,
    ax: Axes,
    track: NDArray[np.float64],
    outline: NDArray[np.float64],
    *,
    factor: float,
    unit: float,
) -> None:
    label = "95 % ellipses" if results.time_s.size > 1 else "95 % ellipse"
    if factor > 1.0:
        label += f", drawn {factor:.0f} times larger"
    for centre, shape in zip(track, outline, strict=True):
        if np.isfinite(shape).all():
            ring = (centre + shape) / unit
            ax.fill(*ring.T, fc=look.BAND, ec=look.PATH, alpha=0.35, lw=0.7, zorder=3, label=label)
            label = "_"


def _draw_ends(ax: Axes, track: NDArray[np.float64]) -> None:
    ax.plot(*track[0], "o", color=look.PATH, mfc="white", ms=6, zorder=6, label="start")
    ax.plot(*track[-1], "s", color=look.PATH, ms=6, zorder=6, label="end")


def _draw_sensors(results: Results, ax: Axes, plane: Plane, unit: float) -> None:
    labels = len(results.sensors) <= 12
    for index, place in enumerate(results.sensors):
        appearance = look.sensor_look(index)
        points = plane.project(place.position_m) / unit
        _draw_sight_lines(results, ax, place, plane, colour=appearance["color"], unit=unit)
        if place.moving:
            ax.plot(*points.T, color=appearance["color"], lw=1.0)
        ax.plot(
            *points[-1], ls="none", mec="black", mew=0.6, ms=7, zorder=7, label="_", **appearance
        )
        if labels:
            ax.annotate(
                place.sensor,
                points[-1],
                xytext=(5, 5),
                textcoords="offset points",
                fontsize=8,
                zorder=8,
                bbox={"fc": "white", "ec": "none", "alpha": 0.6, "pad": 0.5},
            )
    ax.plot([], [], ls="none", marker="o", color="0.6", mec="black", mew=0.6, label="sensors")
    ax.plot([], [], color="0.6", lw=0.7, label="bearings")
    if results.residuals.rejected.any():
        ax.plot([], [], color=look.ALARM, lw=0.7, ls=":", label="rejected bearings")


def _draw_sight_lines(
    results: Results, ax: Axes, place: SensorPath, plane: Plane, *, colour: str, unit: float
) -> None:
    """Draw some of a sensor's bearings as measured, each as long as the path is away."""
    start, end, rejected = sight_lines(results, place)
    styles: tuple[tuple[NDArray[np.bool_], dict[str, Any]], ...] = (
        (~rejected, {"color": colour, "alpha": 0.45}),
        (rejected, {"color": look.ALARM, "ls": ":", "alpha": 0.8}),
    )
    for wanted, style in styles:
        rows = np.flatnonzero(wanted)
        rows = rows[look.some(rows.size, _SIGHT_LINES)] if rows.size else rows
        lines = np.stack([plane.project(start[rows]), plane.project(end[rows])]) / unit
        ax.plot(lines[..., 0], lines[..., 1], lw=0.7, zorder=1, **style)


def sight_lines(
    results: Results, place: SensorPath
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Return ends of a sensor's bearings, each (n, 3), and which were rejected, (n,).

    A line has the direction measured and the length of the distance to the path. Where that
    direction needs what results do not hold (an attitude, the sidereal time), or there is no
    elevation, the line ends at the path.
    """
    azimuth = results.residuals.of(place.sensor, "azimuth")
    elevation = results.residuals.of(place.sensor, "elevation")
    time = azimuth.time_s
    start = columns_at(time, place.time_s, place.position_m)
    target, _ = results.knots().at(time)
    rejected = azimuth.rejected
    if place.axes in ("enu", "xyz") and len(azimuth) == len(elevation):
        rejected = rejected | elevation.rejected
        distance = np.linalg.norm(target - start, axis=-1, keepdims=True)
        direction = _direction(azimuth.measured, elevation.measured, place.axes)
        if place.axes == "enu" and results.frame == "ecef":
            direction = np.einsum("ni,nij->nj", direction, enu_axes(start))
        target = start + distance * direction
    return start, target, rejected


def _direction(
    azimuth: NDArray[np.float64], elevation: NDArray[np.float64], axes: str
) -> NDArray[np.float64]:
    flat = np.cos(elevation)
    first, second = flat * np.cos(azimuth), flat * np.sin(azimuth)
    # Azimuth is counted from north (the second axis) in enu, from x (the first) in xyz.
    level = (second, first) if axes == "enu" else (first, second)
    return np.stack([*level, np.sin(elevation)], axis=-1)
