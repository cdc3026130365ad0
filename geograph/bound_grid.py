"""The Cramer-Rao bound as a map: how well an emitter that stands still is found, wherever it is."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.bounds import located, posterior
from geograph.eliminate import NotPositiveDefiniteError
from geograph.ellipsoids import ellipsoids
from geograph.errors import InputError
from geograph.geodesy import ecef_from_geodetic, enu_axes, geodetic_from_ecef
from geograph.ground import on_ground
from geograph.observability import UNOBSERVABLE_SHARE
from geograph.planned import distances, moved, planned, point_path
from geograph.recording import NO_FORCES
from geograph.signal import Signal, with_signal
from geograph.terrain_starts import ground_height
from geograph.threads import single_blas_thread
from geograph.vantage import GRAZING, STRAIGHT_BELOW, vantage

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from geograph.families import Values
    from geograph.problem import Problem
    from geograph.recording import Frame, Recording, SmoothSettings
    from geograph.smoother import Smoother

PROBABILITY = 0.95
"""Probability of the ellipses whose semi-axes a map holds."""

SINGULAR = "the measurements say nothing of one direction at all"
AT_A_SENSOR = "a sensor stands there"
TOO_WIDE = (
    f"the least error exceeds {100 * UNOBSERVABLE_SHARE:.0f} % of the distance from the sensors"
)
NO_GROUND = "the terrain has no height there"
REASONS = (SINGULAR, AT_A_SENSOR, TOO_WIDE, NO_GROUND, STRAIGHT_BELOW, GRAZING)
"""Why cells of a map are not observable."""

_MOST_CELLS = 1000
# The sensors and the emitter fill this share of a map of automatic extent.
_FILLED = 0.8
# An emitter this much nearer to a sensor than the size of the map is where the sensor is.
_AT_SENSOR_SHARE = 1e-6


@dataclass(frozen=True, eq=False)
class BoundMap:
    """The bound for an emitter that stands still, over a grid of its positions.

    Attributes
    ----------
    frame
        ``"ecef"`` or ``"local"``.
    center_m
        Shape (3,): the middle of the grid, in the frame.
    east_m, north_m
        Shape (c,): the columns and rows of the grid, counted from the middle over the tangent
        plane there; x and y themselves in a local frame.
    position_m
        Shape (c, c, 3): of the cells, rows going north, in the frame; all of one height, or as far
        above the terrain as the recording's constraint says.
    covariance_m2
        Shape (c, c, 2, 2): the bound of east and north (x and y); NaN where there is none.
    reason
        Shape (c, c): why a cell is not observable; empty where it is.
    recording
        Whose sensors, times and sigmas these are.
    """

    frame: Frame
    center_m: NDArray[np.float64]
    east_m: NDArray[np.float64]
    north_m: NDArray[np.float64]
    position_m: NDArray[np.float64]
    covariance_m2: NDArray[np.float64]
    reason: NDArray[np.str_]
    recording: Recording

    @property
    def observable(self) -> NDArray[np.bool_]:
        """Shape (c, c): where the geometry determines the emitter."""
        return np.asarray(self.reason == "")

    @property
    def sigma_horizontal_m(self) -> NDArray[np.float64]:
        """Root mean square of the horizontal distance, shape (c, c), metres.

        Infinite where the emitter is not observable.
        """
        root = np.sqrt(np.trace(self.covariance_m2, axis1=2, axis2=3))
        return np.where(self.observable, root, np.inf)

    @property
    def semi_axes_m(self) -> NDArray[np.float64]:
        """Semi-axes of the 95 % ellipses, longest first, shape (c, c, 2), metres."""
        flat = self.covariance_m2.reshape(-1, 2, 2)
        found = ellipsoids(np.zeros((len(flat), 2)), flat, PROBABILITY).semi_axes_m
        shape = self.reason.shape
        return np.where(self.observable[..., None], found.reshape(*shape, 2), np.inf)

    def geodetic(self) -> NDArray[np.float64] | None:
        """Return latitude, longitude (deg), height (m), shape (c, c, 3); None in a local frame."""
        return geodetic_from_ecef(self.position_m) if self.frame == "ecef" else None

    def sensor_plane_m(self) -> dict[str, NDArray[np.float64]]:
        """Return the way of every sensor over the plane of the grid, each shape (n, 2), metres."""
        span = np.linspace(*self.recording.time_span_s, 50)
        return {
            name: to_plane(
                sensor.position_at(span if sensor.trajectory is not None else span[:1]),
                self.center_m,
                self.frame,
            )
            for name, sensor in self.recording.sensors.items()
        }


def to_plane(
    position_m: NDArray[np.float64], center_m: NDArray[np.float64], frame: Frame
) -> NDArray[np.float64]:
    """Return the coordinates of positions, shape (..., 3), on the plane of a map, shape (..., 2).

    Parameters
    ----------
    position_m
        In the frame, metres.
    center_m
        Shape (3,): the middle of the map.
    frame
        In ``"ecef"`` east and north of the middle on its tangent plane, in ``"local"`` x and y.
    """
    if frame == "local":
        return np.asarray(position_m[..., :2])
    return np.asarray((position_m - center_m) @ enu_axes(center_m)[:2].T)


def bound_map(
    recording: Recording,
    settings: SmoothSettings | None = None,
    *,
    center_m: ArrayLike | None = None,
    extent_m: float | None = None,
    cells: int = 41,
    signal: Signal | None = None,
    on_row: Callable[[], object] | None = None,
    **changes: Any,
) -> BoundMap:
    """Return the Cramer-Rao bound of an emitter that stands still, over a grid of positions.

    Parameters
    ----------
    recording
        Sensors, times and sigmas of the measurements; measured values do not matter.
    settings
        The recording's own by default; the motion is ``static`` whatever they say.
    center_m
        Shape (3,), in the frame: the middle of the grid, whose height all cells have unless the
        emitter is held to the terrain; or shape (n, 3), a path whose middle it is. None: the true
        path, or the estimate.
    extent_m
        Side of the grid. None: that which holds the sensors, and the path, around the middle.
    cells
        Cells along a side.
    signal
        As in :func:`geograph.bounds.bound`.
    on_row
        Called after every row of the grid.
    **changes
        Single settings by name, over those above.

    Raises
    ------
    InputError
        If the recording has no measurement, or the grid is not one.
    SolveError
        If no middle is given, and there is neither a truth nor an estimate.
    """
    chosen = (settings or recording.settings).replace(**changes)
    given = recording if signal is None else with_signal(recording, signal)
    if not 2 <= cells <= _MOST_CELLS:
        raise InputError(f"cells is {cells}; expected 2 to {_MOST_CELLS} along a side")
    if extent_m is not None and not 0.0 < extent_m < np.inf:
        raise InputError(f"extent_m is {extent_m}; expected a finite number above 0 (metres)")
    with single_blas_thread():
        path = _path(given, chosen, center_m)
        middle = path[len(path) // 2]
        offset = to_plane(middle, middle, given.frame)
        extent = _extent(given, path) if extent_m is None else extent_m
        line = (np.arange(cells) - 0.5 * (cells - 1)) * extent / cells
        position = _grid(middle, line, given.frame)
        fixed = chosen.replace(motion="static", process_noise="auto", stages=None, **NO_FORCES)
        terrain, above = given.terrain, ground_height(given.constraints)
        known = np.ones(position.shape[:2], dtype=np.bool_)
        if terrain is not None and above is not None:
            known = terrain.known(position.reshape(-1, 3)).reshape(known.shape)
            ground = on_ground(position.reshape(-1, 3), terrain, above)
            position = ground.reshape(position.shape)
        covariance, reason = _bounds(given, fixed, position, on_row, extent_m=extent, known=known)
    return BoundMap(
        given.frame, middle, line + offset[0], line + offset[1], position, covariance, reason, given
    )


def _path(
    recording: Recording, settings: SmoothSettings, center_m: ArrayLike | None
) -> NDArray[np.float64]:
    """Return the path whose middle is that of the map, shape (n, 3)."""
    if center_m is None:
        smoother, _ = located(recording, settings)
        return smoother.solution.values.path[:, :3]
    center = np.atleast_2d(np.asarray(center_m, dtype=np.float64))
    if center.ndim != 2 or center.shape[1] != 3 or not np.isfinite(center).all():
        raise InputError(f"center_m is {center_m}; expected three finite coordinates (metres)")
    return center


def _extent(recording: Recording, path_m: NDArray[np.float64]) -> float:
    """Return the side of a square about the middle of a path that holds path and sensors."""
    middle, span = path_m[len(path_m) // 2], np.linspace(*recording.time_span_s, 50)
    sensors = [sensor.position_at(span) for sensor in recording.sensors.values()]
    points = to_plane(np.concatenate([path_m, *sensors]), middle, recording.frame)
    reach = float(np.abs(points - to_plane(middle, middle, recording.frame)).max())
    return 2.0 * (reach if reach > 0.0 else 1e3) / _FILLED


def _grid(
    middle_m: NDArray[np.float64], line_m: NDArray[np.float64], frame: Frame
) -> NDArray[np.float64]:
    """Return the positions of the cells, shape (c, c, 3), all as high as the middle."""
    across, along = np.meshgrid(line_m, line_m)
    plane = np.stack([across, along, np.zeros_like(across)], axis=-1)
    if frame == "local":
        return middle_m + plane
    flat = geodetic_from_ecef(middle_m + plane @ enu_axes(middle_m))
    height = float(geodetic_from_ecef(middle_m)[2])
    return ecef_from_geodetic(flat[..., 0], flat[..., 1], height)


def _bounds(
    recording: Recording,
    settings: SmoothSettings,
    position_m: NDArray[np.float64],
    on_row: Callable[[], object] | None,
    *,
    extent_m: float,
    known: NDArray[np.bool_],
) -> tuple[NDArray[np.float64], NDArray[np.str_]]:
    """Return covariances of east and north, shape (c, c, 2, 2), and why cells have none."""
    shape = position_m.shape[:2]
    covariance = np.full((*shape, 2, 2), np.nan)
    reason = np.full(shape, AT_A_SENSOR, dtype=f"<U{max(map(len, REASONS))}")
    smoother: Smoother | None = None
    for row in range(shape[0]):
        for column in range(shape[1]):
            place = position_m[row, column]
            if not known[row, column]:
                reason[row, column] = NO_GROUND
                continue
            away = distances(recording, partial(_stay, place))
            if away.min() >= _AT_SENSOR_SHARE * extent_m:
                if smoother is None:
                    smoother = planned(recording, settings, point_path(place, recording))
                found = _cell(*moved(smoother, place), distance_m=float(np.median(away)))
                covariance[row, column], reason[row, column] = found
        if on_row is not None:
            on_row()
    return covariance, reason


def _stay(position_m: NDArray[np.float64], time_s: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.broadcast_to(position_m, (time_s.size, 3))


def _cell(
    problem: Problem, values: Values, *, distance_m: float
) -> tuple[NDArray[np.float64], str]:
    """Return the bound of east and north at a point, and why it is not observable."""
    nothing = np.full((2, 2), np.nan)
    try:
        marginals = posterior(problem, values)
    except NotPositiveDefiniteError:
        return nothing, _case(problem, values) or SINGULAR
    scale = problem.path_scale[:3]
    level = np.asarray(marginals.knots[0, :3, :3] * scale[:, None] * scale)
    if problem.motion.frame == "ecef":
        axes = enu_axes(values.path[0, :3])
        level = axes @ level @ axes.T
    plane = level[:2, :2]
    if not np.isfinite(plane).all():
        return nothing, _case(problem, values) or SINGULAR
    longest = float(np.sqrt(np.linalg.eigvalsh(plane)[-1]))
    if longest <= UNOBSERVABLE_SHARE * distance_m:
        return plane, ""
    return plane, _case(problem, values) or TOO_WIDE


def _case(problem: Problem, values: Values) -> str:
    """Return which of the named singular cases a place is, or nothing."""
    seen = vantage(problem, values)
    return "" if seen is None else seen.reason
