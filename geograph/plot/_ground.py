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

    from geograph.results import PlatformPath, Results, SensorPath

_ELLIPSES, _SIGHT_LINES, _MOST_LABELS, _MOST_FIXES = 15, 12, 12, 200
# Sensors on a smaller part of a picture than this cannot be told apart on it.
_CROWDED = 0.2


def draw_path(results: Results, ax: Axes, *, sensors: bool, legend: bool = True) -> None:
    """Draw the path on axes of equal scale; ``sensors``: with them and their sight lines."""
    plane = plane_of(results)
    # An object at rest has the same state at all knots.
    track = plane.project(results.position_m[:1] if results.static else results.position_m)
    places = _sensor_points(results, plane)
    spread = extent(track)
    if results.static and sensors:
        spread = extent(np.concatenate([track, *places]))
    outline, factor = _ellipses(results, plane, track, spread)
    near = np.concatenate([track, (track[:, None] + outline).reshape(-1, 2)])
    shown = np.concatenate([near, *places]) if sensors else near
    unit = length_unit(extent(shown))
    if sensors:
        _draw_sensors(results, ax, plane, unit.size, crowded=sensors_crowded(results))
    _draw_truth(results, ax, plane, unit.size)
    _draw_ellipses(results, ax, track, outline, factor=factor, unit=unit.size)
    if results.static:
        ax.plot(*track.T / unit.size, "o", ms=5, color=look.PATH, zorder=7, label="position")
    else:
        drawn = plane.project(results.knots().at(look.dense(results.time_s))[0])
        ax.plot(*drawn.T / unit.size, color=look.PATH, lw=2.2, zorder=4, label="path")
        _draw_ends(ax, track / unit.size)
    _label(ax, plane, unit.name)
    ax.margins(0.14 if sensors else 0.08)
    if legend:
        _legend(ax, columns=2 if results.static else 3)


def draw_sensors_alone(results: Results, ax: Axes, *, legend: bool = True) -> None:
    """Draw the sensors, their ways and fixes, on axes of equal scale that hold nothing else."""
    plane = plane_of(results)
    unit = length_unit(extent(np.concatenate(_sensor_points(results, plane))))
    _draw_sensors(results, ax, plane, unit.size, crowded=False, sights=False)
    _label(ax, plane, unit.name)
    ax.margins(0.14)
    if legend:
        _legend(ax)


def sensors_crowded(results: Results) -> bool:
    """Whether the sensors are so far from the object that they are a mere spot beside it."""
    plane = plane_of(results)
    places = np.concatenate(_sensor_points(results, plane))
    whole = np.concatenate([places, plane.project(results.position_m)])
    return len(results.sensors) > 1 and extent(places) < _CROWDED * extent(whole)


def _sensor_points(results: Results, plane: Plane) -> list[NDArray[np.float64]]:
    return [plane.project(place.position_m) for place in results.sensors]


def _label(ax: Axes, plane: Plane, unit: str) -> None:
    ax.set_xlabel(f"{plane.across} ({unit})")
    ax.set_ylabel(f"{plane.along} ({unit})")
    ax.set_aspect("equal", adjustable="datalim")


def _legend(ax: Axes, columns: int = 2) -> None:
    ax.legend(loc="upper left", bbox_to_anchor=(0.0, -0.13), ncols=columns, borderaxespad=0.0)


def _draw_truth(results: Results, ax: Axes, plane: Plane, unit: float) -> None:
    if results.truth is None:
        return
    true = plane.project(results.truth.position_m) / unit
    if float(np.ptp(true, axis=0).max()) > 0.0:
        ax.plot(*true.T, "--", color=look.TRUTH, lw=1.2, zorder=5, label="truth")
    else:
        ax.plot(*true[0], "x", color=look.TRUTH, ms=9, mew=1.5, zorder=6, label="truth")


def _ellipses(
    results: Results, plane: Plane, track: NDArray[np.float64], spread: float
) -> tuple[NDArray[np.float64], float]:
    chosen = look.some(len(track), _ELLIPSES)
    outline = look.ellipse_outline(plane.covariance(results.position_covariance_m2[chosen]))
    factor = look.magnification(outline, spread)
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
    label = "95 % ellipse" if results.static else "95 % ellipses"
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


def _draw_sensors(
    results: Results, ax: Axes, plane: Plane, unit: float, *, crowded: bool, sights: bool = True
) -> None:
    """Draw where the sensors were; crowded ones share one name."""
    names = len(results.sensors) <= _MOST_LABELS and not crowded
    platforms = {platform.sensor: platform for platform in results.platforms}
    for index, place in enumerate(results.sensors):
        appearance = look.sensor_look(index)
        colour = appearance["color"]
        platform = platforms.get(place.sensor)
        if sights:
            _draw_sight_lines(results, ax, place, plane, colour=colour, unit=unit)
        points = _way(place, platform, plane) / unit
        if place.moving:
            ax.plot(*points.T, color=colour, lw=1.0)
        if platform is not None and not crowded:
            fixes = place.position_m[look.some(len(place.position_m), _MOST_FIXES)]
            ax.plot(*plane.project(fixes).T / unit, ".", color=colour, ms=3, alpha=0.6, zorder=2)
        ax.plot(
            *points[-1], ls="none", mec="black", mew=0.6, ms=7, zorder=7, label="_", **appearance
        )
        if names:
            _name(ax, place.sensor, points[-1])
    if crowded:
        ends = [points[-1] for points in _sensor_points(results, plane)]
        _name(ax, f"{len(results.sensors)} sensors", np.mean(ends, axis=0) / unit, away=9.0)
    _sensor_legend(results, ax, sights=sights, fixes=bool(platforms) and not crowded)


def _way(place: SensorPath, platform: PlatformPath | None, plane: Plane) -> NDArray[np.float64]:
    if platform is None:
        return plane.project(place.position_m)
    return plane.project(platform.knots().at(look.dense(platform.time_s))[0])


def _name(ax: Axes, text: str, point: NDArray[np.float64], away: float = 5.0) -> None:
    ax.annotate(
        text,
        (float(point[0]), float(point[1])),
        xytext=(away, 5),
        textcoords="offset points",
        fontsize=8,
        zorder=8,
        bbox={"fc": "white", "ec": "none", "alpha": 0.6, "pad": 0.5},
    )


def _sensor_legend(results: Results, ax: Axes, *, sights: bool, fixes: bool) -> None:
    moving = any(place.moving for place in results.sensors)
    label = "sensors, at their last places" if moving else "sensors"
    style: dict[str, Any] = {"marker": "o", "color": "0.6", "mec": "black", "mew": 0.6}
    ax.plot([], [], ls="-" if moving else "none", lw=1.0, label=label, **style)
    if fixes:
        ax.plot([], [], ls="none", marker=".", ms=3, color="0.6", label="their fixes")
    bearings = results.residuals.kind == "azimuth"
    if sights and bearings.any():
        ax.plot([], [], color="0.6", lw=0.7, label="bearings")
        if results.residuals.rejected[bearings].any():
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
        if not rows.size:
            continue
        rows = rows[look.some(rows.size, _SIGHT_LINES)]
        lines = np.stack([plane.project(start[rows]), plane.project(end[rows])]) / unit
        ax.plot(lines[..., 0], lines[..., 1], lw=0.7, zorder=1, **style)


def sight_lines(
    results: Results, place: SensorPath
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Return ends of a sensor's bearings, each (n, 3), and which were rejected, (n,).

    A line has the direction measured and the length of the distance to the path. Where that
    direction needs what results do not hold (an attitude, the sidereal time), or there is no
    elevation, the line ends at the path. A sensor that measured no bearing has none.
    """
    azimuth = results.residuals.of(place.sensor, "azimuth")
    elevation = results.residuals.of(place.sensor, "elevation")
    time = azimuth.time_s
    start = columns_at(time, place.time_s, place.position_m)
    for platform in results.platforms:
        if platform.sensor == place.sensor:
            start = platform.knots().at(time)[0]
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
