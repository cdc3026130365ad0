"""Factor-graph smoothing for passive geolocation.

From passive measurements by imperfect sensors (biases, drifts, bad clocks) geograph estimates the
whole path of the object and the errors of every sensor at once, with honest covariances.

Conventions, declared once here and carried by names ever after: SI units inside (metres, seconds,
radians); times are seconds after the recording's epoch (UTC); positions are ECEF (WGS 84) or in the
recording's local Cartesian frame; azimuth is clockwise from north in ``enu`` axes and from x
towards y in ``xyz`` axes; *measured = predicted + error*.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from geograph import export as export
    from geograph import io as io
    from geograph.bound_grid import BoundMap, bound_map
    from geograph.bounds import PathBound, bound
    from geograph.checkup import Finding, doctor
    from geograph.ellipsoids import Ellipsoids
    from geograph.errors import GeographError, InputError, SolveError, UpdateError
    from geograph.graph import GtsamGraph, build
    from geograph.incremental.estimate import Estimate, RowName, Tracking
    from geograph.incremental.motion import (
        Ballistic,
        ConstantAcceleration,
        ConstantPosition,
        ConstantVelocity,
        Static,
    )
    from geograph.incremental.smoother import IncrementalSmoother
    from geograph.io import read, write
    from geograph.likelihood import LikelihoodMap
    from geograph.measurements import (
        Arrivals,
        Bearings,
        Constraints,
        FrequencyDifferences,
        TimeDifferences,
        Truth,
    )
    from geograph.recording import Recording, SmoothSettings
    from geograph.report_page import write_report
    from geograph.sensors import Sensor, SensorErrors, Trajectory
    from geograph.signal import Signal
    from geograph.smoother import smooth
    from geograph.solver import Status
    from geograph.terrain import Terrain
    from geograph.track import SensorEstimate, Track, TrackPoints

__version__ = "0.1.0"

__all__ = [
    "Arrivals",
    "Ballistic",
    "Bearings",
    "BoundMap",
    "ConstantAcceleration",
    "ConstantPosition",
    "ConstantVelocity",
    "Constraints",
    "Ellipsoids",
    "Estimate",
    "Finding",
    "FrequencyDifferences",
    "GeographError",
    "GtsamGraph",
    "IncrementalSmoother",
    "InputError",
    "LikelihoodMap",
    "PathBound",
    "Recording",
    "RowName",
    "Sensor",
    "SensorErrors",
    "SensorEstimate",
    "Signal",
    "SmoothSettings",
    "SolveError",
    "Static",
    "Status",
    "Terrain",
    "TimeDifferences",
    "Track",
    "TrackPoints",
    "Tracking",
    "Trajectory",
    "Truth",
    "UpdateError",
    "__version__",
    "bound",
    "bound_map",
    "build",
    "doctor",
    "read",
    "smooth",
    "write",
    "write_report",
]

# Imported when first asked for: GTSAM and SciPy take most of a second, and neither an error message
# nor the help of a command needs them.
_HOMES = {
    "Arrivals": "geograph.measurements",
    "Ballistic": "geograph.incremental.motion",
    "Bearings": "geograph.measurements",
    "BoundMap": "geograph.bound_grid",
    "ConstantAcceleration": "geograph.incremental.motion",
    "ConstantPosition": "geograph.incremental.motion",
    "ConstantVelocity": "geograph.incremental.motion",
    "Constraints": "geograph.measurements",
    "Ellipsoids": "geograph.ellipsoids",
    "Estimate": "geograph.incremental.estimate",
    "Finding": "geograph.checkup",
    "FrequencyDifferences": "geograph.measurements",
    "GeographError": "geograph.errors",
    "GtsamGraph": "geograph.graph",
    "IncrementalSmoother": "geograph.incremental.smoother",
    "InputError": "geograph.errors",
    "LikelihoodMap": "geograph.likelihood",
    "PathBound": "geograph.bounds",
    "Recording": "geograph.recording",
    "RowName": "geograph.incremental.estimate",
    "Sensor": "geograph.sensors",
    "SensorErrors": "geograph.sensors",
    "SensorEstimate": "geograph.track",
    "Signal": "geograph.signal",
    "SmoothSettings": "geograph.recording",
    "SolveError": "geograph.errors",
    "Static": "geograph.incremental.motion",
    "Status": "geograph.solver",
    "Terrain": "geograph.terrain",
    "TimeDifferences": "geograph.measurements",
    "Track": "geograph.track",
    "TrackPoints": "geograph.track",
    "Tracking": "geograph.incremental.estimate",
    "Trajectory": "geograph.sensors",
    "Truth": "geograph.measurements",
    "UpdateError": "geograph.errors",
    "bound": "geograph.bounds",
    "bound_map": "geograph.bound_grid",
    "build": "geograph.graph",
    "doctor": "geograph.checkup",
    "read": "geograph.io",
    "smooth": "geograph.smoother",
    "write": "geograph.io",
    "write_report": "geograph.report_page",
}


_PACKAGES = ("export", "io")
"""Packages whose functions are called by their full names, as in ``gg.export.write``."""


def __getattr__(name: str) -> Any:
    if name in _PACKAGES:
        return import_module(f"{__name__}.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    setattr(sys.modules[__name__], name, value)
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
