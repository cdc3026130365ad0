"""Factor-graph smoothing for passive geolocation.

From passive measurements by imperfect sensors (biases, drifts, bad clocks) geograph estimates the
whole path of the object and the errors of every sensor at once, with honest covariances.

Conventions, declared once here and carried by names ever after: SI units inside (metres, seconds,
radians); times are seconds after the recording's epoch (UTC); positions are ECEF (WGS 84) or in the
recording's local Cartesian frame; azimuth is clockwise from north in ``enu`` axes and from x
towards y in ``xyz`` axes; *measured = predicted + error*.
"""

from __future__ import annotations

from geograph.ellipsoids import Ellipsoids
from geograph.errors import GeographError, InputError, SolveError
from geograph.graph import GtsamGraph, build
from geograph.io import read, write
from geograph.measurements import Bearings, Constraints, Truth
from geograph.recording import Recording, SmoothSettings
from geograph.sensors import Sensor, SensorErrors, Trajectory
from geograph.smooth import smooth
from geograph.solver import Status
from geograph.track import SensorEstimate, Track, TrackPoints

__version__ = "0.1.0"

__all__ = [
    "Bearings",
    "Constraints",
    "Ellipsoids",
    "GeographError",
    "GtsamGraph",
    "InputError",
    "Recording",
    "Sensor",
    "SensorErrors",
    "SensorEstimate",
    "SmoothSettings",
    "SolveError",
    "Status",
    "Track",
    "TrackPoints",
    "Trajectory",
    "Truth",
    "__version__",
    "build",
    "read",
    "smooth",
    "write",
]
