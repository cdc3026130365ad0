"""What makes a geometry singular: from where the sensors look, and at what slope of ground.

With one receiver and an object that is held to a surface, two geometries say nothing of a place (M.
Kallin, *Airborne angle-only geolocalization*, 2021, chapter 3): the object straight below the
receiver, where its azimuth means nothing, and the receiver in the tangent plane of the surface,
where the line of sight grazes it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.factors.constraints import altitude
from geograph.factors.light_time import sight
from geograph.factors.terrain import height_above_terrain
from geograph.families import AltitudeFamily, BearingFamily, TerrainFamily

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.families import Values
    from geograph.problem import Problem

# Bearings within this many of their sigmas of a pole of their axes, or within the angle, count as
# at it; so do lines of sight at the ground.
_SIGMAS = 3.0
_NEAR_RAD = np.radians(3.0)

STRAIGHT_BELOW = "straight below the sensors, where azimuths say nothing"
GRAZING = "the lines of sight graze the ground there"


@dataclass(frozen=True)
class Vantage:
    """How bearings look at an object.

    Attributes
    ----------
    pole_rad
        The greatest angle of a bearing from the pole of its sensor's axes, if its sigmas are those
        of the coordinates; infinite otherwise.
    grazing_rad
        The greatest angle between a line of sight and the surface that the object is held to;
        infinite if there is none.
    sigma_rad
        Median sigma of the bearings.
    """

    pole_rad: float
    grazing_rad: float
    sigma_rad: float

    @property
    def reason(self) -> str:
        """Which of the two singular cases it is, or nothing."""
        near = max(_NEAR_RAD, _SIGMAS * self.sigma_rad)
        if self.pole_rad < _NEAR_RAD:
            return STRAIGHT_BELOW
        return GRAZING if self.grazing_rad < near else ""

    @property
    def sentence(self) -> str:
        """The case, and what would help; or nothing."""
        if self.reason == STRAIGHT_BELOW:
            return (
                f"the object is {STRAIGHT_BELOW} (all bearings within "
                f"{np.degrees(self.pole_rad):.2g} deg of their axes' pole); give the sigmas on the "
                "sky, or fly past it"
            )
        if self.reason == GRAZING:
            return (
                f"{GRAZING} (at {np.degrees(self.grazing_rad):.2g} deg at most), so that the "
                "distance along them is not determined; look from higher above it"
            )
        return ""


def vantage(problem: Problem, values: Values) -> Vantage | None:
    """Return how the bearings of a problem look at the object; None if it has none.

    Parameters
    ----------
    problem, values
        The object's path, and what was measured of it.
    """
    bearings = next((f for f in problem.families if isinstance(f, BearingFamily)), None)
    if bearings is None or len(problem.families) > 2:
        return None
    state = problem.path.at_state(values.path, jacobian=False)
    position, velocity = state.position_velocity(problem.path.locate(bearings.time_s))
    poses = bearings.geometry.poses(bearings.sensor, bearings.time_s)
    seen = sight(position, velocity, poses.position_m, np.zeros(len(bearings)), 0.0)
    direction = seen.line_of_sight_m / seen.distance_m[:, None]
    in_axes = np.matmul(poses.axes, direction[:, :, None])[:, :, 0]
    pole = np.arctan2(np.hypot(in_axes[:, 0], in_axes[:, 1]), np.abs(in_axes[:, 2]))
    coordinates = ~bearings.bearings.isotropic | bearings.azimuth_only
    normal = _normals(problem, position)
    grazing = np.inf
    # An azimuth alone sees a plane, which no ground can graze.
    if normal is not None and not bearings.azimuth_only.any():
        grazing = float(np.arcsin(np.abs(np.einsum("nc,nc->n", normal, direction))).max())
    sigma = np.fmin(bearings.bearings.sigma_azimuth_rad, bearings.bearings.sigma_elevation_rad)
    return Vantage(
        float(pole.max()) if coordinates.all() else np.inf, grazing, float(np.median(sigma))
    )


def _normals(problem: Problem, position_m: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return unit normals of the surface that the object is held to, shape (n, 3)."""
    for family in problem.families:
        if isinstance(family, TerrainFamily) and family.surface is not None:
            _, normal = height_above_terrain(
                position_m, family.frame, family.surface, jacobian=True
            )
            assert normal is not None
            return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))
        if isinstance(family, AltitudeFamily):
            return altitude(position_m, family.frame)[1]
    return None
