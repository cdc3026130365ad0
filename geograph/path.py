"""Paths between knots: where the object is at any time, as a function of the knots' states.

A path evaluates position and velocity at many times in one vectorised pass, and turns derivatives
by position and velocity into derivatives by the two neighbouring knots' states. Measurements know
nothing else of the motion.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.factors.gravity import propagate, total_acceleration
from geograph.factors.kinematics import interpolation_weights
from geograph.falls import propagated

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.factors.forces import Forces
    from geograph.factors.gravity import Degree

Order = Literal[1, 2, 3]


@dataclass(frozen=True, eq=False)
class Place:
    """Where times lie among the knots, with the weights of both neighbours.

    Attributes
    ----------
    time_s
        Shape (n,).
    interval
        Shape (n,), integer: index of the knot before each time (clipped to the first and last
        interval).
    offset_s, step_s
        Shape (n,): time since that knot and length of the interval.
    position_weights, velocity_weights
        Shape (n, w): of the path's basis (see :class:`Path`).
    """

    time_s: NDArray[np.float64]
    interval: NDArray[np.int64]
    offset_s: NDArray[np.float64]
    step_s: NDArray[np.float64]
    position_weights: NDArray[np.float64]
    velocity_weights: NDArray[np.float64]


class Path(ABC):
    """A path over knots at given times.

    Parameters
    ----------
    knots_s
        Shape (K,): strictly increasing; one knot for a static object.
    order
        Blocks of three in a knot's state: position, velocity, acceleration.
    """

    def __init__(self, knots_s: NDArray[np.float64], order: Order) -> None:
        self.knots_s = knots_s
        self.order: Order = order
        self.size = 3 * order
        self.steps_s = np.diff(knots_s) if knots_s.size > 1 else np.ones(1)

    def locate(self, time_s: NDArray[np.float64]) -> Place:
        """Return the place of times, shape (n,), among the knots."""
        last = max(self.knots_s.size - 2, 0)
        interval = self.knots_s.searchsorted(time_s, side="right") - 1
        interval = np.minimum(np.maximum(interval, 0), last)
        offset = time_s - self.knots_s[interval]
        step = self.steps_s[interval]
        position, velocity = self._weights(step, offset)
        return Place(time_s, interval, offset, step, position, velocity)

    @abstractmethod
    def _weights(
        self, step_s: NDArray[np.float64], offset_s: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return weights of the basis for position and velocity, each shape (n, w)."""

    @abstractmethod
    def at_state(self, state: NDArray[np.float64], *, jacobian: bool) -> PathState:
        """Return the path through given knots' states, shape (K, size)."""


class PathState(ABC):
    """A path with its knots' states filled in."""

    _basis: NDArray[np.float64]
    """Shape (intervals, w, 3): what the weights of a place multiply."""

    def position_velocity(self, place: Place) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return position and velocity, each shape (n, 3)."""
        basis = self._basis[place.interval]
        position = np.matmul(place.position_weights[:, None, :], basis)[:, 0]
        velocity = np.matmul(place.velocity_weights[:, None, :], basis)[:, 0]
        return position, velocity

    def position(self, place: Place) -> NDArray[np.float64]:
        """Return the position alone, shape (n, 3)."""
        basis = self._basis[place.interval]
        return np.asarray(np.matmul(place.position_weights[:, None, :], basis)[:, 0])

    @property
    def basis(self) -> NDArray[np.float64]:
        """Shape (intervals, w, 3): what the weights of a place multiply."""
        return self._basis

    @abstractmethod
    def chain(
        self,
        place: Place,
        by_position: NDArray[np.float64],
        by_velocity: NDArray[np.float64] | None,
    ) -> NDArray[np.float64]:
        """Return derivatives by both neighbours' states, shape (n, r, 2, 3 order).

        Parameters
        ----------
        place
            Where the n times lie.
        by_position, by_velocity
            Shape (n, r, 3): derivatives by position and velocity at those times.
        """


class KinematicPath(Path):
    """A path whose prior mean is a Taylor polynomial: Hermite interpolation between knots.

    The basis is the 2m blocks of both neighbours. With one knot the object does not move.
    """

    def _weights(
        self, step_s: NDArray[np.float64], offset_s: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        if self.knots_s.size == 1:
            constant = np.zeros((offset_s.size, 2))
            constant[:, 0] = 1.0
            return constant, np.zeros((offset_s.size, 2))
        position = interpolation_weights(self.order, step_s, offset_s)
        velocity = interpolation_weights(self.order, step_s, offset_s, derivative=1)
        return position, velocity

    def at_state(self, state: NDArray[np.float64], *, jacobian: bool = False) -> KinematicPathState:
        """Return the path through given knots' states, shape (K, 3 order)."""
        del jacobian
        return KinematicPathState(self, state)


class KinematicPathState(PathState):
    """See :class:`KinematicPath`."""

    def __init__(self, path: KinematicPath, state: NDArray[np.float64]) -> None:
        self._order = path.order
        if state.shape[0] == 1:
            self._basis = np.zeros((1, 2 * path.order, 3))
            self._basis[0, : path.order] = state.reshape(-1, 3)
            return
        following = state[1:]
        both = np.concatenate([state[: following.shape[0]], following], axis=1)
        self._basis = both.reshape(following.shape[0], 2 * path.order, 3)

    def chain(
        self,
        place: Place,
        by_position: NDArray[np.float64],
        by_velocity: NDArray[np.float64] | None,
    ) -> NDArray[np.float64]:
        """Return derivatives by both neighbours; see :meth:`PathState.chain`."""
        count, rows, _ = by_position.shape
        result = place.position_weights[:, None, :, None] * by_position[:, :, None, :]
        if by_velocity is not None:
            result += place.velocity_weights[:, None, :, None] * by_velocity[:, :, None, :]
        return result.reshape(count, rows, 2, 3 * self._order)


_RECENT_FALLS = 2
_Key = tuple[bytes, bytes, bytes, str, int, "Forces | None"]
_falls: dict[_Key, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}


def fall(
    state: NDArray[np.float64],
    step_s: NDArray[np.float64],
    frame: Literal["ecef", "local"],
    degree: Degree,
    *,
    forces: Forces | None = None,
    start_s: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return :func:`geograph.factors.gravity.propagate` of the same, read-only.

    The last two are kept: a step of the solver asks for the same falls for its cost, its
    measurements and its transitions, each time, and they are most of its work.
    """
    if forces is None:
        start_s = None
    start = b"" if start_s is None else start_s.tobytes()
    key = (state.tobytes(), step_s.tobytes(), start, frame, int(degree), forces)
    found = _falls.get(key)
    if found is None:
        if forces is None:
            found = propagated(state, step_s, frame, degree)
        else:
            found = propagate(state, step_s, frame, degree, forces=forces, start_s=start_s)
        for part in found:
            part.setflags(write=False)
        while len(_falls) >= _RECENT_FALLS:
            _falls.pop(next(iter(_falls)), None)
        _falls[key] = found
    return found


class BallisticPath(Path):
    """Free fall between knots, with white noise on the acceleration.

    Inside an interval the path is the fall from its first knot plus the share of the miss at the
    second knot that the noise's Gaussian process gives (cubic Hermite). The fall itself is the
    quintic Hermite polynomial through position, velocity and acceleration at both of its ends,
    which is good to 0.02 mm over 60 s in the lowest circular orbit.

    Parameters
    ----------
    knots_s
        Shape (K,): strictly increasing, K >= 2.
    frame
        ``"ecef"`` or ``"local"``; see :mod:`geograph.factors.gravity`.
    degree
        Highest zonal harmonic of gravity.
    forces
        What acts beside gravity; its unknowns stand behind the velocity in the knots' states.
    """

    LONGEST_STEP_S = 60.0
    """Longest interval over which the quintic polynomial stays below a tenth of a millimetre."""

    def __init__(
        self,
        knots_s: NDArray[np.float64],
        frame: Literal["ecef", "local"],
        degree: Degree = 2,
        forces: Forces | None = None,
    ) -> None:
        super().__init__(knots_s, 2)
        self.degree: Degree = degree
        self.frame: Literal["ecef", "local"] = frame
        self.forces = forces
        self.size = 6 + (0 if forces is None else len(forces.names))

    def _weights(
        self, step_s: NDArray[np.float64], offset_s: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        def both(derivative: int) -> NDArray[np.float64]:
            fall = interpolation_weights(3, step_s, offset_s, derivative=derivative)
            miss = interpolation_weights(2, step_s, offset_s, derivative=derivative)[:, 2:]
            # The miss is (second state) - (end of the fall): six blocks of the fall, then x[k+1].
            fall[:, 3:5] -= miss
            return np.concatenate([fall, miss], axis=1)

        return both(0), both(1)

    def at_state(self, state: NDArray[np.float64], *, jacobian: bool = False) -> BallisticPathState:
        """Return the path through given knots' states, shape (K, size)."""
        return BallisticPathState(self, state, jacobian=jacobian)


class BallisticPathState(PathState):
    """See :class:`BallisticPath`; ``fall`` and ``fall_jacobian`` end at the following knot."""

    def __init__(self, path: BallisticPath, state: NDArray[np.float64], *, jacobian: bool) -> None:
        first, second = state[:-1], state[1:]
        count, size = first.shape
        model = path.frame, path.degree, path.forces
        times = path.knots_s[:-1], path.knots_s[1:]
        self.fall, self.fall_jacobian = fall(
            first, path.steps_s, path.frame, path.degree, forces=path.forces, start_s=times[0]
        )
        start, *start_by = total_acceleration(first, times[0], *model)
        end, *end_by = total_acceleration(self.fall, times[1], *model)
        blocks = [first[:, :6], start, self.fall[:, :6], end, second[:, :6]]
        self._basis = np.concatenate(blocks, axis=1).reshape(count, 8, 3)
        self._size = size
        if jacobian:
            derivative = np.empty((count, 6, 3, size))
            derivative[:, :2] = np.eye(6, size).reshape(2, 3, size)
            derivative[:, 2] = np.concatenate(start_by, axis=2)
            derivative[:, 3:5] = self.fall_jacobian[:, :6].reshape(count, 2, 3, size)
            derivative[:, 5] = np.concatenate(end_by, axis=2) @ self.fall_jacobian
            self._derivative = derivative.reshape(count, 6, 3 * size)

    def chain(
        self,
        place: Place,
        by_position: NDArray[np.float64],
        by_velocity: NDArray[np.float64] | None,
    ) -> NDArray[np.float64]:
        """Return derivatives by both neighbours; see :meth:`PathState.chain`."""
        count, rows, _ = by_position.shape
        derivative, size = self._derivative[place.interval], self._size
        result = np.zeros((count, rows, 2, size))

        def accumulate(weights: NDArray[np.float64], by: NDArray[np.float64]) -> None:
            by_first = np.matmul(weights[:, None, :6], derivative).reshape(count, 3, size)
            result[:, :, 0] += by @ by_first
            two = weights[:, None, 6:, None] * by[:, :, None, :]
            result[:, :, 1, :6] += two.reshape(count, rows, 6)

        accumulate(place.position_weights, by_position)
        if by_velocity is not None:
            accumulate(place.velocity_weights, by_velocity)
        return result
