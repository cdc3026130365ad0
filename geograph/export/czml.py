"""CZML for Cesium: the moving object with an ellipsoid that grows and shrinks, and the sensors."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.ellipsoids import ellipsoids
from geograph.export._place import Placed, placed, rounded, write_text
from geograph.io.instants import utc_text
from geograph.results.data import ELLIPSOID_PROBABILITY

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.results import Results, SensorPath
    from geograph.track import Track

_COLOUR = [225, 118, 59]
_SMALLEST_M = 1e-3


def write_czml(track: Track | Results, path: Path | str) -> None:
    """Write a path as CZML.

    Parameters
    ----------
    track
        A track or its results. The packet ``path`` has the position over time in Earth-fixed axes,
        its 95 % ellipsoid (radii and orientation over time) and its trail; sensors follow, a packet
        each.
    path
        The file; an older one is replaced.

    Raises
    ------
    InputError
        If the results have no place on the Earth, or the file cannot be written.
    """
    target = Path(path)
    place = placed(track, target)
    packets = [_document(place), _object(place)]
    packets += [
        _sensor(place, sensor, number) for number, sensor in enumerate(place.results.sensors)
    ]
    write_text(target, json.dumps(packets, ensure_ascii=False, allow_nan=False) + "\n")


def _interval(place: Placed) -> str:
    first, last = (utc_text(int(place.tai_ns[end]), 3) + "Z" for end in (0, -1))
    return f"{first}/{last}"


def _document(place: Placed) -> dict[str, Any]:
    packet: dict[str, Any] = {
        "id": "document",
        "name": place.results.name,
        "version": "1.0",
    }
    if place.results.time_s.size > 1:
        interval = _interval(place)
        packet["clock"] = {
            "interval": interval,
            "currentTime": interval.partition("/")[0],
            "multiplier": 1,
            "range": "LOOP_STOP",
            "step": "SYSTEM_CLOCK_MULTIPLIER",
        }
    return packet


def _samples(time_s: NDArray[np.float64], values: NDArray[np.float64], digits: int) -> list[float]:
    """Return times and values in turn, as CZML has samples."""
    return [
        number
        for time, row in zip(time_s, values, strict=True)
        for number in (round(float(time), 6), *rounded(row, digits))
    ]


def _object(place: Placed) -> dict[str, Any]:
    results = place.results
    epoch = utc_text(place.epoch_tai_ns, 3) + "Z"
    time, position = place.drawn()
    packet: dict[str, Any] = {
        "id": "path",
        "name": results.name,
        "description": f"Smoothed by geograph: {results.status}.",
        "point": {"pixelSize": 8, "color": {"rgba": [*_COLOUR, 255]}},
    }
    rows = place.ellipse_rows()
    radii, quaternions = ellipsoid_poses(
        results.position_m[rows], results.position_covariance_m2[rows]
    )
    if time.size == 1:
        packet["position"] = {"referenceFrame": "FIXED", "cartesian": rounded(position[0], 4)}
    else:
        packet["availability"] = _interval(place)
        packet["position"] = {
            "epoch": epoch,
            "referenceFrame": "FIXED",
            "interpolationAlgorithm": "LAGRANGE",
            "interpolationDegree": 5 if time.size > 5 else 1,
            "cartesian": _samples(time, position, 4),
        }
        packet["path"] = {
            "leadTime": 0,
            "width": 3,
            "material": {"solidColor": {"color": {"rgba": [*_COLOUR, 255]}}},
        }
    if not rows.size:
        return packet
    ellipsoid: dict[str, Any] = {
        "fill": True,
        "outline": True,
        "material": {"solidColor": {"color": {"rgba": [*_COLOUR, 60]}}},
        "outlineColor": {"rgba": [*_COLOUR, 160]},
    }
    if rows.size == 1:
        ellipsoid["radii"] = {"cartesian": rounded(radii[0], 4)}
        packet["orientation"] = {"unitQuaternion": rounded(quaternions[0], 12)}
    else:
        at = results.time_s[rows]
        ellipsoid["radii"] = {"epoch": epoch, "cartesian": _samples(at, radii, 4)}
        packet["orientation"] = {
            "epoch": epoch,
            "unitQuaternion": _samples(at, quaternions, 12),
        }
    packet["ellipsoid"] = ellipsoid
    return packet


def _sensor(place: Placed, sensor: SensorPath, number: int) -> dict[str, Any]:
    position: dict[str, Any] = {"referenceFrame": "FIXED"}
    if sensor.moving:
        position |= {
            "epoch": utc_text(place.epoch_tai_ns, 3) + "Z",
            "cartesian": _samples(sensor.time_s, sensor.position_m, 4),
        }
    else:
        position["cartesian"] = rounded(sensor.position_m[0], 4)
    return {
        "id": f"sensor {number}",
        "name": sensor.sensor,
        "position": position,
        "point": {"pixelSize": 6, "color": {"rgba": [70, 110, 180, 255]}},
        "label": {"text": sensor.sensor, "font": "12px sans-serif", "pixelOffset": {
            "cartesian2": [0, -14]}},
    }  # fmt: skip


def ellipsoid_poses(
    position_m: NDArray[np.float64], covariance_m2: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the 95 % ellipsoids as radii and rotations that change smoothly over time.

    Which axis is the longest may change from one knot to the next, and an axis has no sign; each
    ellipsoid's axes are therefore taken in the order and with the signs that turn least against the
    one before, so that what is interpolated between them does not tumble.

    Parameters
    ----------
    position_m, covariance_m2
        Shapes (n, 3) and (n, 3, 3), in Earth-fixed axes.

    Returns
    -------
    radii
        Shape (n, 3), metres, of at least a millimetre (Cesium draws none of zero).
    quaternions
        Shape (n, 4): x, y, z, w of the rotations from the ellipsoids' axes to the Earth's.
    """
    from scipy.spatial.transform import Rotation

    found = ellipsoids(position_m, covariance_m2, ELLIPSOID_PROBABILITY)
    radii = np.maximum(found.semi_axes_m, _SMALLEST_M)
    quaternions = np.empty((len(radii), 4))
    before = None
    for row, axes in enumerate(found.axes):
        order, turned = _nearest_axes(axes, before)
        radii[row] = radii[row][order]
        quaternion = Rotation.from_matrix(turned.T).as_quat()
        if row and quaternion @ quaternions[row - 1] < 0.0:
            quaternion = -quaternion
        quaternions[row] = quaternion
        before = turned
    return radii, quaternions


def _nearest_axes(
    axes: NDArray[np.float64], before: NDArray[np.float64] | None
) -> tuple[list[int], NDArray[np.float64]]:
    """Return the order of axes (rows) and the right-handed set nearest to another."""
    reference = np.eye(3) if before is None else before
    best, chosen = -np.inf, ([0, 1, 2], axes)
    for order in itertools.permutations(range(3)):
        turned = axes[list(order)].copy()
        turned *= np.where(np.sum(turned * reference, axis=1) < 0.0, -1.0, 1.0)[:, None]
        if np.linalg.det(turned) < 0.0:
            # The axis that fits worst is the cheapest to turn round.
            turned[np.argmin(np.abs(np.sum(turned * reference, axis=1)))] *= -1.0
        score = float(np.sum(turned * reference))
        if score > best + 1e-12:
            best, chosen = score, (list(order), turned)
    return chosen
