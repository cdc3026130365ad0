"""The posterior of an emitter that stands still, as a map: for where an ellipse is not the truth.

With few bearings of many degrees the posterior is a wedge, not an ellipse. Here its density is
found cell by cell over ground: the place is held in east and north, and height and sensor errors
are integrated out by Laplace's method at their best values there, exact where they are Gaussian.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from geograph.bound_grid import to_plane
from geograph.errors import InputError
from geograph.families import TerrainFamily
from geograph.geodesy import enu_axes
from geograph.ground import at_altitude, on_ground

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from geograph.families import Values
    from geograph.problem import Problem
    from geograph.recording import Frame
    from geograph.track import Track

_COARSE = 21
_MOST_CELLS = 400
_FIRST_SIGMAS = 4.0
_DOUBLINGS = 6

# Log densities below the greatest at which a cell holds nothing, and where a coarse cell's
# neighbourhood need not be looked at more closely.
_NOTHING = 9.0
_NOT_LOOKED_AT = 25.0

_ROUNDS = 3
_ENOUGH = 1e-2


@dataclass(frozen=True, eq=False)
class LikelihoodMap:
    """Posterior density over ground.

    Attributes
    ----------
    frame
        ``"ecef"`` or ``"local"``.
    center_m
        Shape (3,): the estimate, in the frame.
    east_m, north_m
        Shapes (a,), (b,): columns and rows, counted from the estimate over the tangent plane there;
        x and y themselves in a local frame.
    position_m
        Shape (b, a, 3): of the cells, at their best heights.
    log_density
        Shape (b, a): logarithm of the probability of each cell; they add up to one.
    """

    frame: Frame
    center_m: NDArray[np.float64]
    east_m: NDArray[np.float64]
    north_m: NDArray[np.float64]
    position_m: NDArray[np.float64]
    log_density: NDArray[np.float64]

    def level(self, probability: float = 0.95) -> float:
        """Return the log density of the contour that holds a probability.

        Parameters
        ----------
        probability
            Between 0 and 1: that of the region within, which is the smallest that holds it.

        Raises
        ------
        InputError
            If it is not between 0 and 1.
        """
        if not 0.0 < probability < 1.0:
            raise InputError(f"probability is {probability}; expected between 0 and 1")
        sorted_down = np.sort(self.log_density.ravel())[::-1]
        mass = np.cumsum(np.exp(sorted_down))
        return float(sorted_down[min(int(np.searchsorted(mass, probability)), mass.size - 1)])

    def region(self, probability: float = 0.95) -> NDArray[np.bool_]:
        """Return which cells the contour holds, shape (b, a); see :meth:`level`."""
        return np.asarray(self.log_density >= self.level(probability))

    def area_m2(self, probability: float = 0.95) -> float:
        """Return the area within the contour, square metres; see :meth:`level`."""
        cell = float((self.east_m[1] - self.east_m[0]) * (self.north_m[1] - self.north_m[0]))
        return float(self.region(probability).sum()) * cell

    def contains(self, position_m: ArrayLike, probability: float = 0.95) -> bool:
        """Tell whether the contour holds a position, shape (3,) in the frame; height is ignored."""
        place = np.asarray(position_m, dtype=np.float64)
        east, north = to_plane(place, self.center_m, self.frame)
        column = int(np.argmin(np.abs(self.east_m - east)))
        row = int(np.argmin(np.abs(self.north_m - north)))
        half_east = 0.5 * (self.east_m[1] - self.east_m[0])
        half_north = 0.5 * (self.north_m[1] - self.north_m[0])
        inside = (
            abs(self.east_m[column] - east) <= half_east
            and abs(self.north_m[row] - north) <= half_north
        )
        return bool(inside and self.log_density[row, column] >= self.level(probability))


def likelihood_map(track: Track, *, cells: int = 81) -> LikelihoodMap:
    """Return the posterior of an emitter that stands still, over ground.

    Parameters
    ----------
    track
        Smoothed with the motion ``static``, without random walks.
    cells
        Cells along a side; the extent holds all but a ten thousandth of the density.

    Raises
    ------
    InputError
        If the object moves, or the grid is not one.
    """
    if track.problem.knots_s.size != 1 or track.problem.layout.walks:
        raise InputError(
            "a likelihood map is of an emitter that stands still; expected motion static, and no "
            "random walks or platforms"
        )
    if not 11 <= cells <= _MOST_CELLS:
        raise InputError(f"cells is {cells}; expected 11 to {_MOST_CELLS} along a side")
    density = _Density(track)
    low, high = _extent(track)
    for _ in range(_DOUBLINGS):
        east, north = (np.linspace(low[axis], high[axis], _COARSE) for axis in range(2))
        coarse, _ = density.over(east, north)
        if not np.isfinite(coarse).any():
            raise InputError(
                "the posterior has no density about the estimate; expected an emitter that is "
                "determined, on known ground"
            )
        held = coarse > coarse.max() - _NOTHING
        edge = held[0].any() or held[-1].any() or held[:, 0].any() or held[:, -1].any()
        if not edge:
            break
        middle, half = 0.5 * (low + high), high - low
        low, high = middle - half, middle + half
    rows, columns = np.flatnonzero(held.any(axis=1)), np.flatnonzero(held.any(axis=0))
    box = np.array([[east[columns[0]], north[rows[0]]], [east[columns[-1]], north[rows[-1]]]])
    margin = 1.5 * np.array([east[1] - east[0], north[1] - north[0]])
    fine = [np.linspace(box[0, i] - margin[i], box[1, i] + margin[i], cells) for i in range(2)]
    wanted = _near(coarse > coarse.max() - _NOT_LOOKED_AT, (east, north), (fine[0], fine[1]))
    found, position = density.over(fine[0], fine[1], wanted)
    found -= found.max()
    found -= np.log(np.exp(found).sum())
    return LikelihoodMap(track.frame, track.position_m[0], fine[0], fine[1], position, found)


def _extent(track: Track) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners of a first rectangle about the estimate and all that fits as well."""
    sigma = np.sqrt(np.diagonal(track._level_covariance()[0])[:2])
    points = [track.position_m[0]]
    points += [
        np.array(entry["position_m"])
        for entry in track.summary.get("hypotheses", ())
        if entry["weight"] > 1e-4
    ]
    plane = to_plane(np.stack(points), track.position_m[0], track.frame)
    reach = _FIRST_SIGMAS * float(sigma.max())
    return plane.min(axis=0) - reach, plane.max(axis=0) + reach


def _near(
    held: NDArray[np.bool_],
    coarse: tuple[NDArray[np.float64], NDArray[np.float64]],
    fine: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> NDArray[np.bool_]:
    """Return which cells of a fine grid lie next to cells of a coarse one that hold something."""
    grown = np.pad(held, 1)
    grown = np.logical_or.reduce(
        [grown[1 + i : grown.shape[0] - 1 + i, 1 + j : grown.shape[1] - 1 + j]
         for i in (-1, 0, 1) for j in (-1, 0, 1)]
    )  # fmt: skip
    column, row = (
        np.clip(np.round((b - a[0]) / (a[1] - a[0])).astype(int), 0, a.size - 1)
        for a, b in zip(coarse, fine, strict=True)
    )
    return np.asarray(grown[np.ix_(row, column)])


class _Density:
    """Log density of a place over ground, all else integrated out.

    Parameters
    ----------
    track
        With the problem solved.
    """

    def __init__(self, track: Track) -> None:
        self.problem: Problem = track.problem
        self.values: Values = track.values
        self.frame = track.frame
        self.center = track.position_m[0]
        self.ground = next((f for f in self.problem.families if isinstance(f, TerrainFamily)), None)
        self.above = 0.0 if self.ground is None else float(np.median(self.ground.value))
        self.terrain = None if self.ground is None else track.recording.terrain

    def over(
        self,
        east_m: NDArray[np.float64],
        north_m: NDArray[np.float64],
        wanted: NDArray[np.bool_] | None = None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return log densities, shape (b, a), -inf where there is none, and positions."""
        east, north = np.meshgrid(east_m, north_m)
        shape = east.shape
        if self.frame == "local":
            place = np.stack([east, north, np.full(shape, self.center[2])], axis=-1).reshape(-1, 3)
        else:
            axes = enu_axes(self.center)
            place = self.center + np.stack([east.ravel(), north.ravel()], axis=1) @ axes[:2]
        known = np.ones(place.shape[0], dtype=np.bool_)
        if self.terrain is not None:
            known = self.terrain.known(place)
            place = on_ground(place, self.terrain, self.above)
        elif self.frame == "ecef":
            from geograph.geodesy import geodetic_from_ecef

            height = float(geodetic_from_ecef(self.center)[2])
            place = at_altitude(place, np.full(place.shape[0], height), "ecef")
        if wanted is not None:
            known &= wanted.ravel()
        density = np.full(place.shape[0], -np.inf)
        constants = self.values.constants
        for index in np.flatnonzero(known):
            density[index], place[index], constants = self._at(place[index], constants)
        return density.reshape(shape), place.reshape(*shape, 3)

    def _at(
        self, place: NDArray[np.float64], constants: NDArray[np.float64]
    ) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
        """Return the log density of a column of places, the best of them, and the constants."""
        problem, scale = self.problem, self.problem.path_scale
        up = np.array([0.0, 0.0, 1.0]) if self.frame == "local" else enu_axes(place)[2]
        count = constants.size
        basis = np.zeros((3 + count, 1 + count))
        # Metres upwards, and the sensors' states.
        basis[:3, 0] = up / scale
        basis[3:, 1:] = np.eye(count)
        cost, half_log = np.inf, 0.0
        for _ in range(_ROUNDS):
            values = replace(self.values, path=place[None], constants=constants)
            system = problem.linearise(values)
            block = system.blocks.full()[0]
            information = block[:-1, :-1] + np.diag(
                np.concatenate([system.prior_information, np.ones(count)])
            )
            gradient = block[:-1, -1] + np.concatenate([system.prior_gradient, constants])
            reduced = basis.T @ information @ basis
            try:
                step = -np.linalg.solve(reduced, basis.T @ gradient)
                root = np.linalg.cholesky(reduced)
            except np.linalg.LinAlgError:
                return -np.inf, place, constants
            half_log = float(np.log(np.diagonal(root)).sum())
            decrease = -0.5 * float(step @ (basis.T @ gradient))
            cost = system.cost - decrease
            place = place + step[0] * up
            constants = constants + step[1:]
            if decrease < _ENOUGH:
                break
        return -cost - half_log, place, constants
