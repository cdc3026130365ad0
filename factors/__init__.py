"""Measurement equations and GTSAM factors of passive geolocation.

Each observable is one vectorised NumPy function with optional Jacobians in a module of its own; the
batch engine, the Cramer-Rao bound, the residual report and the factors below all call it. Nothing
here knows of files, recordings or solvers.

``bearing`` (azimuth and elevation), ``attitude`` (body axes, misalignment), ``light_time``
(emission and reception), ``aberration`` (directions against the stars), ``refraction``,
``kinematics`` (Gaussian-process priors, transitions, interpolation), ``gravity`` (free fall),
``arrival`` (light time to moving sensors, Doppler), ``difference`` (of arrival time and received
frequency), ``constraints`` (height, coordinate, speed), ``terrain`` (height above ground),
``adapter`` (GTSAM's callback), ``standalone``, ``standalone_radio`` and ``standalone_priors``
(factors for anybody's graph), ``scene`` (receivers of radio signals), ``noise`` (of stacked
measurements).
"""

from geograph.factors.adapter import FactorError, vector_factor
from geograph.factors.attitude import body_axes, ned_from_body
from geograph.factors.scene import Receiver
from geograph.factors.standalone import (
    ballistic_factor,
    bearing_factor,
    kinematic_factor,
    random_walk_factor,
)
from geograph.factors.standalone_priors import (
    altitude_factor,
    position_fix_factor,
    prior_factor,
    terrain_factor,
)
from geograph.factors.standalone_radio import (
    arrivals_factor,
    frequency_difference_factor,
    frequency_differences_factor,
    time_difference_factor,
    time_differences_factor,
)

__all__ = [
    "FactorError",
    "Receiver",
    "altitude_factor",
    "arrivals_factor",
    "ballistic_factor",
    "bearing_factor",
    "body_axes",
    "frequency_difference_factor",
    "frequency_differences_factor",
    "kinematic_factor",
    "ned_from_body",
    "position_fix_factor",
    "prior_factor",
    "random_walk_factor",
    "terrain_factor",
    "time_difference_factor",
    "time_differences_factor",
    "vector_factor",
]
