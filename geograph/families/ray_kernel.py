"""Arrivals and differences in compiled code: what it is given, and what it gives.

Signals, times of emission, residuals and derivatives of one family in one call; the reference is
the NumPy code of :mod:`geograph.families.rays` and of the families beside it. All that a solve does
not change is laid out once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.factors.kinematics import hermite_coefficients
from geograph.families.base import ByPosition
from geograph.kernels import compiled, flat, indices
from geograph.path import BallisticPathState, Place
from geograph.states import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.blocks import Sums
    from geograph.families.base import Values
    from geograph.families.rays import End, World
    from geograph.path import KinematicPathState, Path, PathState

ARRIVALS, TIME_DIFFERENCES, FREQUENCY_DIFFERENCES = range(3)
"""Kinds of families, as the compiled code counts them."""

_HERMITE = {order: flat(hermite_coefficients(order)) for order in (1, 2, 3)}


@dataclass(frozen=True, eq=False)
class Merged:
    """Entries of the constant states of all ends, those of the same row and column as one.

    Attributes
    ----------
    row, column
        Shape (e,).
    target
        Of every end the place of each of its entries among these.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    target: list[NDArray[np.int64]]

    @classmethod
    def of(cls, ends: Sequence[End]) -> Merged:
        """Return the entries of some ends."""
        parts = [end.terms.constants for end in ends]
        if len(parts) == 1:
            only = parts[0]
            return cls(only.row, only.column, [np.arange(only.row.size)])
        row = np.concatenate([part.row for part in parts])
        column = np.concatenate([part.column for part in parts])
        width = int(column.max(initial=0)) + 1
        place, inverse = np.unique(row * width + column, return_inverse=True)
        edges = np.cumsum([part.row.size for part in parts])[:-1]
        return cls(place // width, place % width, np.split(inverse.reshape(-1), edges))


@dataclass(eq=False, slots=True)
class RayKernelResult:
    """What one call found; derivatives are None where none were asked for.

    Attributes
    ----------
    finite
        Whether all times of emission are numbers.
    emitted_s, interval
        Shape (n,): times of emission, and the intervals between knots that they lie in.
    delays_s
        Light times to every end, each shape (n,).
    residual
        Shape (n,), whitened.
    by_common
        Shape (n,): derivative by the time of emission, whitened; of arrivals alone.
    by_position, by_velocity
        Shape (n, 3), whitened; those by velocity of frequency differences alone.
    by_path
        By the knots' states, as of :class:`Evaluation`, whitened.
    by_constants
        Shape (e, 1), whitened.
    by_ends
        By every end's channels of error, each shape (n, CHANNELS), whitened; where asked for.
    """

    finite: bool
    emitted_s: NDArray[np.float64]
    interval: NDArray[np.int64]
    delays_s: list[NDArray[np.float64]]
    residual: NDArray[np.float64]
    by_common: NDArray[np.float64] | None
    by_position: NDArray[np.float64] | None
    by_velocity: NDArray[np.float64] | None
    by_path: NDArray[np.float64] | ByPosition | None
    by_constants: NDArray[np.float64] | None
    by_ends: list[NDArray[np.float64]]


class RayKernel:
    """The compiled evaluation of one family.

    Parameters
    ----------
    kind
        One of :data:`ARRIVALS`, :data:`TIME_DIFFERENCES`, :data:`FREQUENCY_DIFFERENCES`.
    world, ends, merged
        Sensors at the ends of the signals, and the entries of their constant states.
    start
        Shape (g,): first row of each group of the same emission.
    measured, time_s, sigma
        Shape (n,).
    rounds, enough
        Rounds in which times of emission are found, and the change in seconds that ends them.
    carrier_hz, relative
        Shape (n,): of frequency differences, with their carriers over the recording's.
    """

    def __init__(
        self,
        kind: int,
        *,
        world: World,
        ends: Sequence[End],
        merged: Merged,
        start: NDArray[np.int64],
        measured: NDArray[np.float64],
        time_s: NDArray[np.float64],
        sigma: NDArray[np.float64],
        rounds: int,
        enough: float,
        carrier_hz: NDArray[np.float64] | None = None,
        relative: NDArray[np.float64] | None = None,
    ) -> None:
        self._kind = kind
        count = self._count = measured.size
        self._entries = merged.row.size
        self._start = start
        pieces = world.geometry.pieces
        given: list[Any] = [kind, rounds, count, start.size, world.states.size, self._entries]
        given += [pieces.first.size - 1, pieces.edges_s.size]
        given += [world.speed_m_s, world.spin_rad_s, enough]
        given += [indices(np.append(start, count)), pieces.first, pieces.edges_s, pieces.parts]
        given += map(flat, (measured, time_s, sigma, carrier_hz, relative))
        given += map(indices, (merged.row, merged.column))
        for end, target in zip(ends, merged.target, strict=True):
            own = end.terms.constants
            # Entries are sorted by row.
            first = np.searchsorted(own.row, np.arange(count + 1))
            given.append(own.row.size)
            given += map(indices, (end.sensor, first, own.channel, own.column, target))
            given.append(flat(own.basis))
        self._given = given
        self._plan = compiled.radio_plan(*given)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what another process makes anew."""
        return {name: value for name, value in vars(self).items() if name != "_plan"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Lay out the arrays again."""
        vars(self).update(state)
        self._plan = compiled.radio_plan(*self._given)

    def _point(
        self,
        path: Path,
        state: PathState,
        values: Values,
        *,
        white: NDArray[np.float64],
        emitted_s: NDArray[np.float64] | None,
        delays_s: Sequence[NDArray[np.float64] | None],
    ) -> tuple[tuple[Any, ...], NDArray[np.float64], list[NDArray[np.float64]]]:
        """Return what every call is given, and the times of emission and delays among it."""
        delays = [
            np.zeros(self._count) if delay is None else np.array(delay, dtype=np.float64)
            for delay in delays_s
        ]
        known = emitted_s is not None
        emitted = np.array(emitted_s, dtype=np.float64) if known else np.empty(self._count)
        order: int = path.order
        hermite = (_HERMITE[path.order], None)
        if isinstance(state, BallisticPathState):
            order, hermite = 0, (_HERMITE[3], _HERMITE[2])
        point = (
            *(self._plan, path.knots_s.size, order, flat(path.knots_s), flat(state.basis)),
            *(*hermite, known, flat(white), flat(values.constants), emitted, *delays),
        )
        return point, emitted, delays

    def sums(
        self,
        path: Path,
        state: KinematicPathState,
        values: Values,
        *,
        white: NDArray[np.float64],
        emitted_s: NDArray[np.float64] | None,
        delays_s: Sequence[NDArray[np.float64] | None],
        weight: NDArray[np.float64] | None,
        common: tuple[NDArray[np.float64] | None, NDArray[np.float64] | None],
        scale: NDArray[np.float64],
        total: Sums | None,
    ) -> tuple[float, NDArray[np.float64], list[NDArray[np.float64]]]:
        """Add all measurements up at one point, without walks of their own and without a loss.

        Parameters
        ----------
        path, state, values, white, emitted_s, delays_s
            As of :meth:`run`; the path is a kinematic one.
        weight
            Shape (n,): fixed weights, or None for ones.
        common
            Shapes (n,), (g,): derivatives by shared unknowns, and the information of their priors;
            of differences whose rows share anything.
        scale
            Shape (3 order,): scales of the path's components, SI.
        total
            Changed in place, as by :meth:`geograph.blocks.BlockSum.add`; None: the cost alone.

        Returns
        -------
        cost, emitted_s, delays_s
            The sum is left out where the cost is not a number.
        """
        point, emitted, delays = self._point(
            path, state, values, white=white, emitted_s=emitted_s, delays_s=delays_s
        )
        held, information = common
        cost = compiled.radio_sums(
            *point,
            *(flat(weight), flat(held), flat(information), values.walks.shape[1], flat(scale)),
            *((None, None) if total is None else (total.knots, total.others)),
        )
        return cost, emitted, delays

    def run(
        self,
        path: Path,
        state: PathState,
        values: Values,
        *,
        white: NDArray[np.float64],
        emitted_s: NDArray[np.float64] | None,
        delays_s: Sequence[NDArray[np.float64] | None],
        chains: Sequence[NDArray[np.float64] | None],
        jacobian: bool,
        channels: bool = False,
    ) -> RayKernelResult:
        """Evaluate all measurements at one point.

        Parameters
        ----------
        path, state, values
            The path through the knots' states, kinematic or a fall, and the sensors' errors.
        white
            Shape (n,): reciprocals of the sigmas.
        emitted_s, delays_s
            Where times of emission and light times are searched from; None: from the measured
            times, and from zero.
        chains
            Of every end what walks and platforms add to the channels, shape (n, CHANNELS), or None.
        jacobian, channels
            Whether derivatives are asked for, and among them those by every channel of error.
        """
        count, falls = self._count, isinstance(state, BallisticPathState)
        width = 8 if falls else 2 * path.order
        point, emitted, delays = self._point(
            path, state, values, white=white, emitted_s=emitted_s, delays_s=delays_s
        )
        residual, interval = np.empty(count), np.empty(count, dtype=np.int64)
        by_common = np.empty(count) if self._kind == ARRIVALS else None
        by_ends = [np.empty((count, CHANNELS)) for _ in delays] if channels else []
        by_position = by_velocity = by_constants = weights = rates = None
        if jacobian:
            by_position, by_constants = np.empty((count, 3)), np.empty((self._entries, 1))
            weights = np.empty((count, width))
            if self._kind == FREQUENCY_DIFFERENCES:
                by_velocity, rates = np.empty((count, 3)), np.empty((count, width))
        ends: list[Any] = []
        for index, chain in enumerate(chains):
            ends += (chain, by_ends[index] if channels else None)
        finite = compiled.radio(
            *point,
            *ends,
            *(residual, interval, by_common),
            *(by_position, by_velocity, weights, rates, by_constants),
        )
        by_path: NDArray[np.float64] | ByPosition | None = None
        if by_position is not None and weights is not None:
            rows = by_position[:, None, :]
            faster = None if by_velocity is None else by_velocity[:, None, :]
            if falls:
                place = _place(path, emitted, interval, weights, rates)
                by_path = state.chain(place, rows, faster)
            else:
                by_path = ByPosition(weights, rows, self._start, rates, faster)
        return RayKernelResult(
            finite,
            emitted,
            interval,
            delays,
            residual,
            by_common,
            by_position,
            by_velocity,
            by_path,
            by_constants,
            by_ends,
        )


def _place(
    path: Path,
    time_s: NDArray[np.float64],
    interval: NDArray[np.int64],
    position: NDArray[np.float64],
    velocity: NDArray[np.float64] | None,
) -> Place:
    offset = time_s - path.knots_s[interval]
    rates = np.zeros_like(position) if velocity is None else velocity
    return Place(time_s, interval, offset, path.steps_s[interval], position, rates)
