"""Measurement equations and GTSAM factors of passive geolocation.

Each observable is one vectorised NumPy function with optional Jacobians in a module of its own; the
batch engine, the Cramer-Rao bound, the residual report and the factors below all call it. Nothing
here knows of files, recordings or solvers.

``bearing`` (azimuth and elevation), ``light_time`` (emission and reception), ``refraction``,
``kinematics`` (Gaussian-process priors, transitions, interpolation), ``gravity`` (free fall),
``constraints`` (height, speed), ``adapter`` (GTSAM's callback), ``standalone`` (factors for
anybody's graph).
"""

from geograph.factors.adapter import FactorError, vector_factor
from geograph.factors.standalone import (
    altitude_factor,
    ballistic_factor,
    bearing_factor,
    kinematic_factor,
    prior_factor,
    random_walk_factor,
)

__all__ = [
    "FactorError",
    "altitude_factor",
    "ballistic_factor",
    "bearing_factor",
    "kinematic_factor",
    "prior_factor",
    "random_walk_factor",
    "vector_factor",
]
