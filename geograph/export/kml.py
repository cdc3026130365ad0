"""KML 2.2: path, ground track, 95 % ellipses over ground with their times, sensors.

Heights are written as they are, above the ellipsoid; programs take them as above the geoid, which
is as much off as the two are apart (at most about 100 m).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as Xml

from geograph.export._place import Placed, placed, write_text
from geograph.export.geojson import cut_line, cut_ring
from geograph.geodesy import geodetic_from_ecef

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from geograph.results import Results
    from geograph.track import Track

KML, GX = "http://www.opengis.net/kml/2.2", "http://www.google.com/kml/ext/2.2"
# Colours of KML are aabbggrr.
_STYLES = {
    "path": ("ff3b76e1", 3, None),
    "ground": ("99606060", 2, None),
    "ellipse": ("cc3b76e1", 1, "333b76e1"),
}


def write_kml(track: Track | Results, path: Path | str) -> None:
    """Write a path as KML.

    Parameters
    ----------
    track
        A track or its results. The file has folders ``path`` (a track with its times, which has a
        time slider, and a line), ``ground track``, ``ellipses`` (at most 200, each shown while it
        is the nearest in time) and ``sensors``.
    path
        The file; an older one is replaced.

    Raises
    ------
    InputError
        If the results have no place on the Earth, or the file cannot be written.
    """
    target = Path(path)
    place = placed(track, target)
    Xml.register_namespace("", KML)
    Xml.register_namespace("gx", GX)
    root = Xml.Element(f"{{{KML}}}kml")
    document = _add(root, "Document")
    _add(document, "name", _plain(place.results.name))
    _add(document, "description", f"Smoothed by geograph: {place.results.status}.")
    for name, (line, width, fill) in _STYLES.items():
        _style(document, name, line, width, fill)
    _path(document, place)
    _ellipses(document, place)
    _sensors(document, place.results)
    Xml.indent(root, " ")
    text = Xml.tostring(root, encoding="unicode", xml_declaration=False)
    write_text(target, f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n')


def _plain(text: str) -> str:
    """Return a text without what XML cannot hold."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def _add(parent: Xml.Element, name: str, text: str | None = None, **attributes: str) -> Xml.Element:
    namespace, _, tag = name.rpartition(":")
    element = Xml.SubElement(parent, f"{{{GX if namespace else KML}}}{tag}", attributes)
    element.text = text
    return element


def _style(document: Xml.Element, name: str, line: str, width: int, fill: str | None) -> None:
    style = _add(document, "Style", id=name)
    strokes = _add(style, "LineStyle")
    _add(strokes, "color", line)
    _add(strokes, "width", str(width))
    if fill is not None:
        _add(_add(style, "PolyStyle"), "color", fill)


def _folder(parent: Xml.Element, name: str) -> Xml.Element:
    folder = _add(parent, "Folder")
    _add(folder, "name", name)
    return folder


def _coordinates(geodetic: NDArray[np.float64]) -> str:
    return " ".join(
        f"{longitude:.8f},{latitude:.8f},{height:.3f}" for latitude, longitude, height in geodetic
    )


def _placemark(parent: Xml.Element, name: str, style: str | None = None) -> Xml.Element:
    mark = _add(parent, "Placemark")
    _add(mark, "name", _plain(name))
    if style is not None:
        _add(mark, "styleUrl", f"#{style}")
    return mark


def _holder(parent: Xml.Element, parts: int) -> Xml.Element:
    """Return what takes the parts of a shape that the 180th meridian cuts."""
    return parent if parts == 1 else _add(parent, "MultiGeometry")


def _line(parent: Xml.Element, geodetic: NDArray[np.float64], mode: str) -> None:
    parts = cut_line(geodetic)
    holder = _holder(parent, len(parts))
    for part in parts:
        line = _add(holder, "LineString")
        if mode == "clampToGround":
            _add(line, "tessellate", "1")
        _add(line, "altitudeMode", mode)
        _add(line, "coordinates", _coordinates(part))


def _point(parent: Xml.Element, geodetic: NDArray[np.float64]) -> None:
    point = _add(parent, "Point")
    _add(point, "altitudeMode", "absolute")
    _add(point, "coordinates", _coordinates(geodetic[None]))


def _path(document: Xml.Element, place: Placed) -> None:
    name = place.results.name
    time, position = place.drawn()
    geodetic = geodetic_from_ecef(position)
    folder = _folder(document, "path")
    if time.size == 1:
        _point(_placemark(folder, name), geodetic[0])
        return
    track = _add(_placemark(folder, name, "path"), "gx:Track")
    _add(track, "altitudeMode", "absolute")
    for text in place.texts(time):
        _add(track, "when", text)
    for latitude, longitude, height in geodetic:
        _add(track, "gx:coord", f"{longitude:.8f} {latitude:.8f} {height:.3f}")
    _line(_placemark(folder, f"{name}: whole path", "path"), geodetic, "absolute")
    ground = _folder(document, "ground track")
    _line(_placemark(ground, f"{name}: ground track", "ground"), geodetic, "clampToGround")


def _ellipses(document: Xml.Element, place: Placed) -> None:
    rows = place.ellipse_rows()
    if not rows.size:
        return
    outlines, semi_axes = place.ellipses(rows)
    folder = _folder(document, "ellipses")
    times, spans = place.times(), place.spans(rows)
    for row, outline, (major, minor), (begin, end) in zip(
        rows, outlines, semi_axes, spans, strict=True
    ):
        mark = _add(folder, "Placemark")
        _add(mark, "name", times[row])
        _add(mark, "description", f"95 % ellipse: semi-axes {major:.1f} m and {minor:.1f} m")
        span = _add(mark, "TimeSpan")
        _add(span, "begin", begin)
        _add(span, "end", end)
        _add(mark, "styleUrl", "#ellipse")
        rings = cut_ring(outline)
        holder = _holder(mark, len(rings))
        for ring in rings:
            polygon = _add(holder, "Polygon")
            _add(polygon, "altitudeMode", "absolute")
            boundary = _add(_add(polygon, "outerBoundaryIs"), "LinearRing")
            _add(boundary, "coordinates", _coordinates(ring))


def _sensors(document: Xml.Element, results: Results) -> None:
    folder = _folder(document, "sensors")
    for sensor in results.sensors:
        geodetic = geodetic_from_ecef(sensor.position_m)
        if sensor.moving:
            _line(_placemark(folder, sensor.sensor, "ground"), geodetic, "absolute")
        else:
            _point(_placemark(folder, sensor.sensor), geodetic[0])
