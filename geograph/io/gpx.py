"""Tracks of satellite navigation receivers: GPX 1.0 and 1.1."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError
from geograph.geodesy import ecef_from_geodetic
from geograph.io.instants import MINUTE_NS, parse_instant
from geograph.io.messages import shown
from geograph.io.source import read_file
from geograph.io.trajectories import check_order, seconds_after
from geograph.io.xml_lines import Element, parse_xml
from geograph.sensors import Trajectory

if TYPE_CHECKING:
    from pathlib import Path

_ZONE = re.compile(r"(.*T.*)([+-])(\d\d):(\d\d)", re.ASCII)
_HIGHEST_M = 1e8


def read_gpx(
    path: Path, epoch_tai_ns: int, *, geoid_height_m: float = 0.0, content: bytes | None = None
) -> Trajectory:
    """Read the track points of a GPX file as a trajectory in ECEF.

    Parameters
    ----------
    path
        The file; the points of all its tracks and segments make one trajectory.
    epoch_tai_ns
        Instant from which seconds count (:mod:`geograph.io.instants`).
    geoid_height_m
        Height of mean sea level above the ellipsoid, which is added to ``ele``: that is meant from
        mean sea level, though not all receivers keep to it.
    content
        What the file holds, if it is in an archive.

    Raises
    ------
    InputError
        If it is no GPX, a point lacks a time or a height, or times do not increase.
    """
    root = parse_xml(read_file(path) if content is None else content, path)
    if root.name != "gpx":
        raise InputError(f"is XML of <{root.name[:40]}>; expected <gpx>", path=path, line=root.line)
    points = list(root.below("trkpt"))
    rows = [_point(point, path) for point in points]
    tai = np.array([row[0] for row in rows], dtype=np.int64)
    check_order(path, tai, np.array([point.line for point in points], dtype=np.int64))
    latitude, longitude, height = np.array([row[1:] for row in rows]).T
    position = ecef_from_geodetic(latitude, longitude, height + geoid_height_m)
    return Trajectory(seconds_after(tai, epoch_tai_ns), position)


def _point(point: Element, path: Path) -> tuple[int, float, float, float]:
    time, elevation = point.first("time"), point.first("ele")
    if time is None or elevation is None:
        raise InputError(
            f"track point has no <{'time' if time is None else 'ele'}>; expected a time and a "
            "height at each",
            path=path,
            line=point.line,
        )
    try:
        instant = _instant(time.text.strip())
    except ValueError as error:
        raise InputError(
            f"time is {shown(time.text.strip())}; {error}", path=path, line=time.line
        ) from None
    return (
        instant,
        _number(point, "lat", point.attributes.get("lat", ""), 90.0, path),
        _number(point, "lon", point.attributes.get("lon", ""), 180.0, path),
        _number(elevation, "ele", elevation.text.strip(), _HIGHEST_M, path),
    )


def _instant(text: str) -> int:
    """Return the instant of an XML time with its zone, by default UTC."""
    found = _ZONE.fullmatch(text)
    if found is None:
        return parse_instant(text)
    minutes = int(found[3]) * 60 + int(found[4])
    return parse_instant(found[1]) + (MINUTE_NS if found[2] == "-" else -MINUTE_NS) * minutes


def _number(element: Element, name: str, text: str, limit: float, path: Path) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) <= limit:
        raise InputError(
            f"{name} is {shown(text)}; expected a number from {-limit:g} to {limit:g}",
            path=path,
            line=element.line,
        )
    return value
