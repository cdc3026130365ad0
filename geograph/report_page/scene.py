"""What the map and the view in space show: path, ellipsoids, sensors, truth, ground."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.export._place import epoch_of
from geograph.geodesy import enu_axes, geodetic_from_ecef
from geograph.io.instants import SECOND_NS, utc_text
from geograph.plot import _style as look
from geograph.plot._ground import sight_lines
from geograph.plot._plane import extent, plane_of
from geograph.report_page.graticule import graticule
from geograph.report_page.limits import short, short_time
from geograph.results.data import turned_covariance
from geograph.results.facts import place_text, rounded
from geograph.results.interpolate import columns_at
from geograph.units import fitting_unit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.plot._plane import Plane
    from geograph.report_page.limits import Limits
    from geograph.results import Results, SensorPath

_ELLIPSOIDS, _SIGHTS, _WAY, _LEAST_POINTS = 15, 10, 100, 400
_UPPER = np.triu_indices(3)


def scene(results: Results, limits: Limits) -> dict[str, Any]:
    """Return the description of map and space, in metres on the axes of the map's plane.

    Parameters
    ----------
    results
        Of one recording.
    limits
        Of what is drawn.

    Returns
    -------
    dict
        ``names`` of the three axes, ``path``, ``truth``, ``ground`` (the path's foot),
        ``frames`` (moments that the slider stops at), ``ellipsoids`` along the path and the
        ``factor`` by which they are drawn larger, ``sensors`` and ``graticule``. Points are three
        lists, one for each axis; covariances six lists, of the upper triangle.
    """
    plane = plane_of(results)
    time = path_times(results, limits)
    path = results.knots().at(time)[0]
    places = [place.position_m for place in results.sensors[: limits.sensors]]
    around = np.concatenate([path, *places])
    return {
        "names": ["east", "north", "up"] if results.frame == "ecef" else ["x", "y", "z"],
        "earth": results.frame == "ecef",
        "origin": plane.across.removeprefix("east of "),
        "static": results.static,
        "path": _points(plane, path),
        "truth": _truth(results, plane, limits),
        "ground": _ground(results, plane, path, around),
        "frames": _frames(results, plane, limits),
        **_ellipsoids(results, plane, around),
        "sensors": [
            _sensor(results, plane, index, place)
            for index, place in enumerate(results.sensors[: limits.sensors])
        ],
        "graticule": _graticule(results, plane, around),
        "near": _graticule(results, plane, path),
    }


def path_times(results: Results, limits: Limits) -> NDArray[np.float64]:
    """Return the times at which the path is drawn: few enough, and enough for a smooth line."""
    time = results.time_s
    if results.static:
        return time[:1]
    if time.size > limits.line:
        return time[look.some(time.size, limits.line)]
    parts = max(1, min(limits.line, _LEAST_POINTS) // time.size)
    share = np.arange(parts) / parts
    return np.append((time[:-1, None] + np.diff(time)[:, None] * share).ravel(), time[-1])


def _space(plane: Plane, position_m: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray((position_m - plane.origin_m) @ plane.axes.T)


def _points(plane: Plane, position_m: NDArray[np.float64]) -> list[list[float | None]]:
    return [short(column, 9) for column in _space(plane, position_m).T]


def _covariances(plane: Plane, covariance_m2: NDArray[np.float64]) -> list[list[float | None]]:
    turned = turned_covariance(plane.axes, covariance_m2)
    # A covariance is drawn whole or not at all.
    turned[~np.isfinite(turned).all(axis=(1, 2))] = np.nan
    return [short(turned[:, row, column], 9) for row, column in zip(*_UPPER, strict=True)]


def _truth(results: Results, plane: Plane, limits: Limits) -> list[list[float | None]] | None:
    if results.truth is None:
        return None
    known = results.truth.position_m
    return _points(plane, known[look.some(len(known), limits.line)])


def _ground(
    results: Results,
    plane: Plane,
    path: NDArray[np.float64],
    around: NDArray[np.float64],
) -> list[list[float | None]]:
    """Return the points below the path: on the ellipsoid, or on the lowest level of all."""
    chosen = path[look.some(len(path), _WAY)]
    if results.frame == "local":
        below = chosen.copy()
        below[:, 2] = around[:, 2].min()
    else:
        height = geodetic_from_ecef(chosen)[:, 2]
        below = chosen - height[:, None] * enu_axes(chosen)[:, 2]
    return _points(plane, below)


def _graticule(results: Results, plane: Plane, around: NDArray[np.float64]) -> list[dict[str, Any]]:
    if results.frame != "ecef":
        return []
    return [{"label": name, "xyz": _points(plane, line)} for name, line in graticule(around)]


def _ellipsoids(results: Results, plane: Plane, around: NDArray[np.float64]) -> dict[str, Any]:
    chosen = look.some(1 if results.static else results.time_s.size, _ELLIPSOIDS)
    covariance = results.position_covariance_m2[chosen]
    outline = look.ellipse_outline(plane.covariance(covariance))
    own = plane.project(around if results.static else results.position_m)
    return {
        "ellipsoids": {
            "xyz": _points(plane, results.position_m[chosen]),
            "covariance": _covariances(plane, covariance),
        },
        "factor": look.magnification(outline, extent(own)),
    }


def _frames(results: Results, plane: Plane, limits: Limits) -> dict[str, Any]:
    """Return the moments of the slider: when, where, how sure, and both as a text."""
    first, last = results.time_s[0], results.time_s[-1]
    if results.time_s.size == 1:
        first, last = time_span(results)
    moving = not results.static or any(place.moving for place in results.sensors)
    count = limits.frames if moving and last > first else 1
    time = np.linspace(first, last, count)
    return {
        "time": short_time(time),
        "clock": clocks(results, time),
        "xyz": _points(plane, results.knots().at(time)[0]),
        "covariance": _covariances(plane, _covariance_at(results, time)),
        "text": [
            f"{where}{', ' if fast else ''}{fast}; 1 sigma {sigma}"
            for where, fast, sigma in readings(results, time)
        ],
    }


def time_span(results: Results) -> tuple[float, float]:
    """Return when the recording began and ended; the path, where the summary does not say it."""
    found = results.summary.get("time_span_s")
    if isinstance(found, list | tuple) and len(found) == 2:
        first, last = found
        if isinstance(first, int | float) and isinstance(last, int | float):
            return float(first), float(last)
    return float(results.time_s[0]), float(results.time_s[-1])


def clocks(results: Results, time_s: NDArray[np.float64]) -> list[str]:
    """Return times as UTC, or as seconds where the recording has no epoch."""
    epoch = epoch_of(results)
    span = float(np.ptp(time_s))
    digits = 3 if span < 3600.0 else 0
    if epoch is None:
        # Rounded and 0 added, lest the first is "-0.000 s".
        digits = max(digits, 1)
        return [f"{round(float(value), digits) + 0.0:.{digits}f} s" for value in time_s]
    instants = epoch + np.round(time_s * SECOND_NS).astype(np.int64)
    return [utc_text(int(value), digits).replace("T", " ") + " UTC" for value in instants]


def readings(results: Results, time_s: NDArray[np.float64]) -> list[tuple[str, str, str]]:
    """Return texts of where the object was at times, how fast, and the sigmas of its position.

    The sigmas are along the axes of its own place, not those of the map's middle.
    """
    position, velocity = results.knots().at(time_s)
    covariance = _covariance_at(results, time_s)
    if results.frame == "ecef":
        where = [
            f"{place_text(latitude, longitude, 5)}, height {height:.0f} m"
            for latitude, longitude, height in geodetic_from_ecef(position)
        ]
        level, names = enu_axes(position), ("east", "north", "up")
    else:
        where = [f"x {x:.2f} m, y {y:.2f} m, z {z:.2f} m" for x, y, z in position + 0.0]
        level, names = np.broadcast_to(np.eye(3), (len(position), 3, 3)), ("x", "y", "z")
    spread = np.diagonal(turned_covariance(level, covariance), axis1=1, axis2=2)
    sigma = np.sqrt(np.maximum(spread, 0.0))
    # A height that is given has no sigma of its own.
    count = 2 if results.height_held else 3
    texts = []
    for row, place in enumerate(where):
        unit = fitting_unit("m", sigma[row, :count])
        pairs = zip(names[:count], sigma[row, :count], strict=True)
        parts = [f"{name} {rounded(value / unit.size)}" for name, value in pairs]
        fast = ""
        if velocity is not None and not results.static:
            fast = f"{rounded(float(np.linalg.norm(velocity[row])), 4)} m/s"
        texts.append((place, fast, f"{', '.join(parts)} {unit.name}"))
    return texts


def _covariance_at(results: Results, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
    inside = np.clip(time_s, results.time_s[0], results.time_s[-1])
    # Between a covariance that is not finite and another there is none.
    with np.errstate(invalid="ignore"):
        return columns_at(inside, results.time_s, results.position_covariance_m2)


def _sensor(results: Results, plane: Plane, index: int, place: SensorPath) -> dict[str, Any]:
    appearance = look.sensor_look(index)
    time, position = place.time_s, place.position_m
    for platform in results.platforms:
        if platform.sensor == place.sensor:
            time, position = platform.time_s, platform.position_m
    rows = look.some(time.size, 200)
    start, end, rejected = sight_lines(results, place)
    chosen = look.some(len(start), _SIGHTS) if len(start) else np.empty(0, dtype=np.int64)
    return {
        "name": place.sensor,
        "colour": appearance["color"],
        "marker": appearance["marker"],
        "time": short_time(time[rows]),
        "xyz": _points(plane, position[rows]),
        "sights": [
            _points(plane, np.stack([start[row], end[row]])) for row in chosen[~rejected[chosen]]
        ],
    }
