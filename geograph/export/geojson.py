"""GeoJSON (RFC 7946): the path, its 95 % ellipses over ground, and the sensors.

Lines and rings that cross the 180th meridian are cut there (section 3.1.9 of the RFC), and rings
around a pole are closed along it.
"""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.export._place import Placed, placed, rounded, write_text
from geograph.geodesy import geodetic_from_ecef

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from geograph.results import Results
    from geograph.track import Track

_DEGREE_DIGITS, _METRE_DIGITS = 8, 3


def write_geojson(track: Track | Results, path: Path | str) -> None:
    """Write a path as a collection of GeoJSON features.

    Parameters
    ----------
    track
        A track or its results. Features have a property ``kind``: ``path`` (of an object at rest,
        ``position``), ``ellipse`` (at most 200, with ``time``, ``semi_major_m``, ``semi_minor_m``
        and ``probability``), and ``sensor`` with its ``name``. Heights above the ellipsoid are the
        third coordinate.
    path
        The file; an older one is replaced.

    Raises
    ------
    InputError
        If the results have no place on the Earth, or the file cannot be written.
    """
    target = Path(path)
    place = placed(track, target)
    features = [_path(place), *_ellipses(place), *_sensors(place.results)]
    collection = {"type": "FeatureCollection", "features": features}
    write_text(target, json.dumps(collection, ensure_ascii=False, allow_nan=False) + "\n")


def _feature(geometry: dict[str, Any], properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _position(latitude: float, longitude: float, height: float) -> list[float]:
    return [
        *rounded([longitude, latitude], _DEGREE_DIGITS),
        *rounded([height], _METRE_DIGITS),
    ]


def _path(place: Placed) -> dict[str, Any]:
    results = place.results
    time, position = place.drawn()
    geodetic = geodetic_from_ecef(position)
    properties: dict[str, Any] = {"kind": "path", "name": results.name, "status": results.status}
    if time.size == 1:
        properties["kind"] = "position"
        geometry = {"type": "Point", "coordinates": _position(*geodetic[0])}
        return _feature(geometry, properties)
    properties |= {"start": place.texts(time[:1])[0], "end": place.texts(time[-1:])[0]}
    parts = [[_position(*point) for point in part] for part in cut_line(geodetic)]
    if len(parts) == 1:
        properties["times"] = place.texts(time)
        return _feature({"type": "LineString", "coordinates": parts[0]}, properties)
    return _feature({"type": "MultiLineString", "coordinates": parts}, properties)


def _ellipses(place: Placed) -> Iterator[dict[str, Any]]:
    rows = place.ellipse_rows()
    outlines, semi_axes = place.ellipses(rows)
    times = place.times()
    probability = place.results.summary.get("ellipsoid_probability", 0.95)
    for row, outline, (major, minor) in zip(rows, outlines, semi_axes, strict=True):
        polygons = [[[_position(*point) for point in ring]] for ring in cut_ring(outline)]
        whole = len(polygons) == 1
        geometry = {
            "type": "Polygon" if whole else "MultiPolygon",
            "coordinates": polygons[0] if whole else polygons,
        }
        yield _feature(
            geometry,
            {
                "kind": "ellipse",
                "time": times[row],
                "semi_major_m": round(float(major), _METRE_DIGITS),
                "semi_minor_m": round(float(minor), _METRE_DIGITS),
                "probability": probability,
            },
        )


def _sensors(results: Results) -> Iterator[dict[str, Any]]:
    for sensor in results.sensors:
        geodetic = geodetic_from_ecef(sensor.position_m)
        if sensor.moving:
            parts = [[_position(*point) for point in part] for part in cut_line(geodetic)]
            geometry: dict[str, Any] = {
                "type": "LineString" if len(parts) == 1 else "MultiLineString",
                "coordinates": parts[0] if len(parts) == 1 else parts,
            }
        else:
            geometry = {"type": "Point", "coordinates": _position(*geodetic[0])}
        yield _feature(geometry, {"kind": "sensor", "name": sensor.sensor})


def _unwrapped(geodetic: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points with longitudes that do not jump by a turn from one to the next."""
    points = geodetic.copy()
    points[:, 1] = np.degrees(np.unwrap(np.radians(geodetic[:, 1])))
    return points


def cut_line(geodetic: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return the parts of a line between crossings of the 180th meridian.

    Parameters
    ----------
    geodetic
        Shape (n, 3): latitude, longitude (deg), height (m).

    Returns
    -------
    list
        Each of shape (m, 3), m of at least 2, with longitudes from -180 to 180.
    """
    points = _unwrapped(geodetic)
    parts: list[tuple[int, list[NDArray[np.float64]]]] = []
    for before, after in itertools.pairwise(points):
        here = before
        for there in [*_crossings(before, after), after]:
            middle = 0.5 * (here[1] + there[1])
            along_the_edge = here[1] == there[1] and (here[1] + 180.0) % 360.0 == 0.0
            strip = int(np.floor((middle + 180.0) / 360.0))
            if not parts or (parts[-1][0] != strip and not along_the_edge):
                parts.append((strip, [here]))
            parts[-1][1].append(there)
            here = there
    turned = []
    for strip, part in parts:
        line = np.array(part)
        line[:, 1] -= 360.0 * strip
        turned.append(line)
    return turned


def _crossings(
    before: NDArray[np.float64], after: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Return where a straight piece crosses the 180th meridian, its ends not counted."""
    found = []
    for edge in _edges(before[1], after[1]):
        part = (edge - before[1]) / (after[1] - before[1])
        crossing = before + part * (after - before)
        crossing[1] = edge
        found.append(crossing)
    return found


def _edges(start: float, end: float) -> list[float]:
    """Return the odd multiples of 180 degrees strictly between two longitudes, in their order."""
    low, high = min(start, end), max(start, end)
    first = int(np.floor((low + 180.0) / 360.0)) + 1
    last = int(np.ceil((high + 180.0) / 360.0)) - 1
    edges = [360.0 * turn - 180.0 for turn in range(first, last + 1)]
    return edges if end > start else edges[::-1]


def _wrapped(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a part with longitudes from -180 to 180; it lies within one turn between edges."""
    middle = 0.5 * (points[:, 1].min() + points[:, 1].max())
    shifted = points.copy()
    shifted[:, 1] -= 360.0 * np.round(middle / 360.0)
    return shifted


def cut_ring(geodetic: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return the parts of the inside of a ring on either side of the 180th meridian, as rings.

    Parameters
    ----------
    geodetic
        Shape (n, 3): latitude, longitude (deg), height (m), the last point equal to the first,
        anticlockwise seen from above.

    Returns
    -------
    list
        Each of shape (m, 3), closed, anticlockwise, with longitudes from -180 to 180.
    """
    points = _unwrapped(geodetic)
    turn = points[-1, 1] - points[0, 1]
    if abs(turn) > 180.0:
        # Around a pole: along it from the end back to the start.
        pole = 90.0 if turn > 0.0 else -90.0
        height = points[0, 2]
        ends = [[pole, points[-1, 1], height], [pole, points[0, 1], height], points[0]]
        points = np.concatenate([points, np.array(ends)])
    low, high = points[:, 1].min(), points[:, 1].max()
    first = int(np.floor((low + 180.0) / 360.0))
    last = int(np.ceil((high + 180.0) / 360.0))
    rings = []
    for strip in range(first, max(last, first + 1)):
        west, east = 360.0 * strip - 180.0, 360.0 * strip + 180.0
        part = _clipped(_clipped(points, west, keep=1.0), east, keep=-1.0)
        if part.shape[0] > 3:
            rings.append(_wrapped(part))
    return rings


def _clipped(points: NDArray[np.float64], longitude: float, *, keep: float) -> NDArray[np.float64]:
    """Return a closed ring cut off at a meridian (Sutherland and Hodgman, 1974)."""
    if points.shape[0] < 2:
        return points
    side = keep * (points[:, 1] - longitude)
    kept: list[NDArray[np.float64]] = []
    for index in range(points.shape[0] - 1):
        here, there = side[index], side[index + 1]
        if here >= 0.0:
            kept.append(points[index])
        if (here > 0.0 > there) or (here < 0.0 < there):
            crossing = points[index] + here / (here - there) * (points[index + 1] - points[index])
            crossing[1] = longitude
            kept.append(crossing)
    if kept:
        kept.append(kept[0])
    return np.array(kept).reshape(-1, 3)
