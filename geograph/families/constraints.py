"""What is known of the path itself: height above ellipsoid or ground, coordinates, speed."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from geograph.factors.constraints import altitude, coordinate, speed
from geograph.factors.terrain import height_above_terrain
from geograph.families.base import Evaluation, Family, Values, path_only_evaluation

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.factors.terrain import Surface
    from geograph.path import Path, PathState, Place
    from geograph.recording import Frame


class _ConstraintFamily(Family):
    """Scalar functions of position and velocity at given times, or along the whole path.

    Parameters
    ----------
    time_s
        Shape (n,); NaN: the whole path. The object is then held to the value at every knot, each
        weighted so that all knots together count as one measurement: one error of the stated sigma
        common to the whole path.
    value, sigma
        Shape (n,), in the unit of the constraint.
    line
        Shape (n,): lines in the file.
    frame
        The recording's frame.
    surface
        The ground, for heights above it.
    """

    rows = 1

    def __init__(
        self,
        *,
        time_s: NDArray[np.float64],
        value: NDArray[np.float64],
        sigma: NDArray[np.float64],
        line: NDArray[np.int64],
        frame: Frame,
        surface: Surface | None = None,
    ) -> None:
        self.time_s = time_s
        self.value = value
        self.sigma = sigma
        self.line = line
        self.frame: Frame = frame
        self.surface = surface
        self.row_count = int(time_s.size)
        self._place: tuple[Path, Place] | None = None

    def _located(self, path: Path) -> Place:
        """Return where the constraints lie among the knots, found once for a path."""
        if self._place is None or self._place[0] is not path:
            self._place = path, path.locate(self.time_s)
        return self._place[1]

    def expanded(self, knots_s: NDArray[np.float64]) -> _ConstraintFamily:
        """Return the family with whole-path rows put at every knot."""
        whole = np.isnan(self.time_s)
        if not whole.any():
            return self
        count = knots_s.size
        timed = ~whole

        def spread(column: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.concatenate([column[timed], np.repeat(column[whole], count)])

        expanded = type(self)(
            time_s=np.concatenate([self.time_s[timed], np.tile(knots_s, int(whole.sum()))]),
            value=spread(self.value),
            sigma=np.concatenate(
                [self.sigma[timed], np.repeat(self.sigma[whole], count) * np.sqrt(count)]
            ),
            line=np.concatenate([self.line[timed], np.repeat(self.line[whole], count)]),
            frame=self.frame,
            surface=self.surface,
        )
        expanded.row_count = self.row_count
        return expanded

    def subset(self, index: NDArray[np.int64]) -> _ConstraintFamily:
        return type(self)(
            time_s=self.time_s[index],
            value=self.value[index],
            sigma=self.sigma[index],
            line=self.line[index],
            frame=self.frame,
            surface=self.surface,
        )


class _PlaceFamily(_ConstraintFamily):
    """What is known of a function of the position."""

    @abstractmethod
    def _function(
        self, position_m: NDArray[np.float64], *, jacobian: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """Return the function, shape (n,), and its gradients, shape (n, 3), where wanted."""

    def evaluate(
        self, path: Path, state: PathState, values: Values, *, jacobian: bool
    ) -> Evaluation:
        """Evaluate all constraints at one point."""
        del values
        place = self._located(path)
        position = state.position(place)
        predicted, gradient = self._function(position, jacobian=jacobian)
        residual = ((predicted - self.value) / self.sigma)[:, None]
        if not jacobian or gradient is None:
            return path_only_evaluation(residual, place.interval, None)
        rows = (gradient / self.sigma[:, None])[:, None, :]
        return path_only_evaluation(residual, place.interval, state.chain(place, rows, None))


class AltitudeFamily(_PlaceFamily):
    """Height above the WGS 84 ellipsoid, or z in a local frame, metres."""

    name = "altitude_m"

    def _function(
        self, position_m: NDArray[np.float64], *, jacobian: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        del jacobian
        return altitude(position_m, self.frame)


class CoordinateFamily(_PlaceFamily):
    """A coordinate in the recording's frame, metres."""

    axis: ClassVar[Literal[0, 1, 2]]

    def _function(
        self, position_m: NDArray[np.float64], *, jacobian: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        del jacobian
        return coordinate(position_m, self.axis)


class XFamily(CoordinateFamily):
    """x in the recording's frame, metres."""

    name = "x_m"
    axis = 0


class YFamily(CoordinateFamily):
    """y in the recording's frame, metres."""

    name = "y_m"
    axis = 1


class ZFamily(CoordinateFamily):
    """z in the recording's frame, metres."""

    name = "z_m"
    axis = 2


class TerrainFamily(_PlaceFamily):
    """Height above the ground, metres."""

    name = "height_above_terrain_m"

    def _function(
        self, position_m: NDArray[np.float64], *, jacobian: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        assert self.surface is not None
        return height_above_terrain(position_m, self.frame, self.surface, jacobian=jacobian)


class SpeedFamily(_ConstraintFamily):
    """Speed in the recording's frame, metres per second."""

    name = "speed_m_s"

    def evaluate(
        self, path: Path, state: PathState, values: Values, *, jacobian: bool
    ) -> Evaluation:
        """Evaluate all constraints at one point."""
        del values
        place = self._located(path)
        _, velocity = state.position_velocity(place)
        predicted, gradient = speed(velocity)
        residual = ((predicted - self.value) / self.sigma)[:, None]
        if not jacobian:
            return path_only_evaluation(residual, place.interval, None)
        rows = (gradient / self.sigma[:, None])[:, None, :]
        chained = state.chain(place, np.zeros_like(rows), rows)
        return path_only_evaluation(residual, place.interval, chained)


CONSTRAINT_FAMILIES = {
    family.name: family
    for family in (AltitudeFamily, SpeedFamily, TerrainFamily, XFamily, YFamily, ZFamily)
}
"""Families by the kind of constraint in their table."""
