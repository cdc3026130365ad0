"""What arrivals and differences have in common: sensors at the ends of signals, with their errors.

Every measurement here has one row, and one or two ends. The chains of an end's sensor are read in
the interval of the emission, so that all derivatives of a measurement are by the same two knots.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.factors.arrival import SensorMotion, trace
from geograph.families.base import Evaluation, Report, SensorFamily, Values
from geograph.families.ray_kernel import Merged, RayKernel
from geograph.frames import frame_spin_rad_s
from geograph.kernels import compiled
from geograph.path import BallisticPathState, KinematicPathState
from geograph.states import POSITION, SPEED, VELOCITY, ChainShare, SensorErrorTerms

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.blocks import Sums
    from geograph.common import Common
    from geograph.factors.arrival import Ray
    from geograph.families.ray_kernel import RayKernelResult
    from geograph.frames import SensorGeometry
    from geograph.path import Path, PathState, Place

    _ChainEntries = tuple[
        NDArray[np.int64],
        NDArray[np.int64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
    ]
    from geograph.states import SensorStates

# Times of emission are found anew, with the chains read in another interval, at most so often.
_INTERVAL_ROUNDS = 4

PLACED = (*range(POSITION, POSITION + 3), *range(VELOCITY, VELOCITY + 3), SPEED)
"""Channels of error that every signal feels: where its ends are, and how fast it is."""

_NO_INDEX = np.empty(0, dtype=np.int64)
_NOTHING = np.empty(0)


@dataclass(frozen=True, eq=False)
class World:
    """What the families of a recording share.

    Attributes
    ----------
    geometry
        Poses of the sensors.
    states
        Sensor-error states of the problem.
    chain_scale
        Shape (w,): scales of the chains, SI.
    speed_m_s
        Speed of propagation, finite.
    """

    geometry: SensorGeometry
    states: SensorStates
    chain_scale: NDArray[np.float64]
    speed_m_s: float

    @property
    def spin_rad_s(self) -> float:
        """Angular speed of the frame."""
        return frame_spin_rad_s(self.geometry.frame)


class End:
    """The sensors at one end of n signals.

    Parameters
    ----------
    world
        Sensors and their states.
    sensor
        Shape (n,): index of each signal's sensor.
    time_s
        Shape (n,): time tags, at which drifts are read.
    channels
        Which errors the measurements feel, besides those of :data:`PLACED`.
    """

    def __init__(
        self,
        world: World,
        sensor: NDArray[np.int64],
        time_s: NDArray[np.float64],
        channels: Sequence[int],
    ) -> None:
        self.world = world
        self.sensor = sensor
        self.time_s = time_s
        self.terms = SensorErrorTerms(
            world.states, sensor, time_s, world.chain_scale, (*PLACED, *channels)
        )
        # When walks and platforms are read; brought up to date between solves.
        self.read_s = time_s.copy()
        # Sensors that stand still are looked up once.
        still = not world.geometry.moves(sensor)
        self._still = world.geometry.motion(sensor, time_s) if still else None

    def share(self, path: Path, interval: NDArray[np.int64]) -> ChainShare:
        """Return how the chains are read in given intervals."""
        return self.terms.share(path.knots_s, interval, self.read_s)

    def errors(
        self, path: Path, values: Values, interval: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """Return the errors of all channels, shape (n, CHANNELS), SI units."""
        if not self.terms.chains.row.size:
            return self.terms.errors(values.constants)
        return self.terms.errors(values.constants, values.walks, self.share(path, interval))

    def chain_errors(
        self, path: Path, values: Values, interval: NDArray[np.int64]
    ) -> NDArray[np.float64] | None:
        """Return what the chains add to all channels, shape (n, CHANNELS); None: nothing."""
        if not self.terms.chains.row.size:
            return None
        return self.terms.chain_errors(values.walks, self.share(path, interval))

    def motion(self, received_s: NDArray[np.float64], errors: NDArray[np.float64]) -> SensorMotion:
        """Return where the sensors are at reception, their estimated errors added."""
        found = self._still or self.world.geometry.motion(self.sensor, received_s)
        return SensorMotion(
            found.position_m + errors[:, POSITION : POSITION + 3],
            found.velocity_m_s + errors[:, VELOCITY : VELOCITY + 3],
            found.acceleration_m_s2,
        )

    def rays(
        self,
        position_m: NDArray[np.float64],
        velocity_m_s: NDArray[np.float64],
        emitted_s: NDArray[np.float64],
        errors: NDArray[np.float64],
        light_time_s: NDArray[np.float64] | None,
    ) -> Ray:
        """Return the signals from the object to the sensors; see :func:`trace`."""
        speed = self.world.speed_m_s + (float(errors[0, SPEED]) if errors.shape[0] else 0.0)
        return trace(
            position_m,
            velocity_m_s,
            lambda delay: self.motion(emitted_s + delay, errors),
            speed_m_s=speed,
            spin_rad_s=self.world.spin_rad_s,
            light_time_s=light_time_s,
        )


@dataclass(frozen=True, eq=False)
class Solved:
    """All signals of a family for one point.

    Attributes
    ----------
    emitted_s
        Shape (n,): times of emission.
    place
        Where these lie among the knots.
    rays
        From the object to the sensors of every end.
    errors
        Of the sensors of every end, each shape (n, CHANNELS).
    """

    emitted_s: NDArray[np.float64]
    place: Place
    rays: tuple[Ray, ...]
    errors: tuple[NDArray[np.float64], ...]


class RayFamily(SensorFamily):
    """Measurements of signals that were emitted together and received by sensors.

    Parameters
    ----------
    world
        Sensors and their states.
    ends
        One end, or sensor and reference.
    measured, sigma
        Shape (n,): in the family's unit.
    sigma_common
        Shape (n,): the part of sigma that rows of one group share.
    group
        Shape (n,), growing: rows of the same emission.
    weight
        Shape (n,): weights of the information, for correlated errors.
    position_noise_m
        White position errors of every end's sensors at each measurement, each shape (n,).
    line
        Shape (n,): lines in the file.
    """

    rows = 1
    unit: str
    kind: str
    kernel_kind: int
    """Which of the kinds of :mod:`geograph.families.ray_kernel` it is."""

    def __init__(
        self,
        world: World,
        ends: Sequence[End],
        *,
        measured: NDArray[np.float64],
        sigma: NDArray[np.float64],
        sigma_common: NDArray[np.float64],
        group: NDArray[np.int64],
        weight: NDArray[np.float64],
        position_noise_m: Sequence[NDArray[np.float64]],
        line: NDArray[np.int64],
    ) -> None:
        self.world = world
        self.ends = tuple(ends)
        self.measured = measured
        self.sigma = sigma
        self.sigma_common = sigma_common
        self.group = group
        self.weight = weight
        self.position_noise_m = tuple(position_noise_m)
        self.line = line
        self.time_s = ends[-1].time_s
        self.sensor = ends[0].sensor
        self.reference = ends[1].sensor if len(ends) > 1 else None
        self.start = np.flatnonzero(np.diff(group, prepend=-1))
        self.row_counts = np.ones(measured.size, dtype=np.int64)
        self.row_count = measured.size
        self.path_noise_m = np.zeros(measured.size)
        self.path_noise_m_s = np.zeros(measured.size)
        self._interval: tuple[Path, NDArray[np.int64]] | None = None
        self._emitted: NDArray[np.float64] | None = None
        self._delays: list[NDArray[np.float64] | None] = [None for _ in ends]
        self._merged = Merged.of(self.ends)
        self._chained = any(end.terms.chains.row.size > 0 for end in ends)
        self._kernel: RayKernel | None = None
        self._whiten([np.zeros(measured.size)] * (len(self.ends) + 1))

    def _whiten(self, extra: Sequence[NDArray[np.float64]]) -> None:
        """Set the reciprocals of the sigmas, extra noise of path and ends included.

        Parameters
        ----------
        extra
            Sigma that the path's deviation adds, and the position noise of every end; that of a
            reference is common to its rows.
        """
        shared = self.sigma_common**2
        if len(extra) > 2:
            shared = shared + extra[2] ** 2
        total = self.sigma**2 + sum(part**2 for part in extra)
        root = np.sqrt(self.weight)
        self._white = root / np.sqrt(total - shared)
        self._shared = self._white * np.sqrt(shared)

    def _lay_out(self, *, rounds: int, enough_s: float, **columns: NDArray[np.float64]) -> None:
        """Lay out what compiled code needs, where there is any.

        Parameters
        ----------
        rounds, enough_s
            Rounds in which times of emission are found, and the change that ends them.
        columns
            Of :class:`geograph.families.ray_kernel.RayKernel`, those that a kind has for itself.
        """
        if compiled is None:
            return
        self._kernel = RayKernel(
            self.kernel_kind,
            world=self.world,
            ends=self.ends,
            merged=self._merged,
            start=self.start,
            measured=self.measured,
            time_s=self.time_s,
            sigma=self.sigma,
            rounds=rounds,
            enough=enough_s,
            **columns,
        )

    def _intervals(self, path: Path) -> NDArray[np.int64]:
        """Return the intervals that the emissions were last found in."""
        if self._interval is not None and self._interval[0] is path:
            return self._interval[1]
        return path.locate(self.time_s).interval

    def _kernel_for(self, state: PathState) -> RayKernel | None:
        """Return the compiled evaluation, where there is one for such a path."""
        known = isinstance(state, KinematicPathState | BallisticPathState)
        return self._kernel if compiled is not None and known else None

    def _run(
        self,
        kernel: RayKernel,
        path: Path,
        state: PathState,
        values: Values,
        *,
        white: NDArray[np.float64],
        jacobian: bool,
        channels: bool = False,
    ) -> RayKernelResult:
        """Do what :meth:`solve` does, with residuals and derivatives, in compiled code."""
        interval = self._intervals(path) if self._chained else None
        for _ in range(_INTERVAL_ROUNDS):
            found = kernel.run(
                path,
                state,
                values,
                white=white,
                emitted_s=self._emitted,
                delays_s=self._delays,
                chains=[
                    None if interval is None else end.chain_errors(path, values, interval)
                    for end in self.ends
                ],
                jacobian=jacobian,
                channels=channels,
            )
            self._delays = list(found.delays_s)
            if found.finite:
                self._emitted = found.emitted_s
            if interval is None or np.array_equal(found.interval, interval):
                break
            interval = found.interval
        self._interval = (path, found.interval)
        return found

    def solve(self, path: Path, state: PathState, values: Values) -> Solved:
        """Find the times of emission and all signals."""
        interval = self._intervals(path)
        for _ in range(_INTERVAL_ROUNDS):
            errors = tuple(end.errors(path, values, interval) for end in self.ends)
            emitted = self._emission_times(path, state, errors)
            place = path.locate(emitted)
            settled = not values.walks.size or np.array_equal(place.interval, interval)
            interval = place.interval
            if settled:
                break
        self._interval = (path, interval)
        position, velocity = state.position_velocity(place)
        rays = []
        for index, (end, error) in enumerate(zip(self.ends, errors, strict=True)):
            ray = end.rays(position, velocity, emitted, error, self._delays[index])
            self._delays[index] = ray.light_time_s
            rays.append(ray)
        return Solved(emitted, place, tuple(rays), errors)

    @abstractmethod
    def _emission_times(
        self, path: Path, state: PathState, errors: tuple[NDArray[np.float64], ...]
    ) -> NDArray[np.float64]:
        """Return times of emission, shape (n,), equal within each group."""

    @abstractmethod
    def _predicted_error(self, found: Solved) -> NDArray[np.float64]:
        """Return predicted less measured, shape (n,), the sensors' errors included."""

    @abstractmethod
    def _gradients(
        self, found: Solved, path: Path, state: PathState
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, list[NDArray[np.float64]]]:
        """Return derivatives by position and velocity, (n, 3), and by every end's channels.

        Those by channels have the shape (n, CHANNELS).
        """

    @abstractmethod
    def _by_common(self, found: Solved) -> NDArray[np.float64] | None:
        """Return whitened derivatives by the time of emission, shape (n,), where it is free."""

    @abstractmethod
    def _shared_unknowns(self, by_common: NDArray[np.float64] | None) -> Common | None:
        """Return the unknowns that rows share; ``by_common`` as of :meth:`_by_common`."""

    def evaluate(
        self, path: Path, state: PathState, values: Values, *, jacobian: bool
    ) -> Evaluation:
        """Evaluate all measurements at one point; see :class:`Evaluation`."""
        kernel = self._kernel_for(state)
        if kernel is not None:
            return self._evaluate_compiled(kernel, path, state, values, jacobian=jacobian)
        found = self.solve(path, state, values)
        residual = (self._predicted_error(found) * self._white)[:, None]
        interval = found.place.interval
        empty = np.empty((0, 1))
        by_knots = None
        by_ends: list[NDArray[np.float64]] = []
        if jacobian:
            white = self._white[:, None]
            by_position, by_velocity, by_ends = self._gradients(found, path, state)
            by_ends = [by_end * white for by_end in by_ends]
            by_knots = state.chain(
                found.place,
                (by_position * white)[:, None, :],
                None if by_velocity is None else (by_velocity * white)[:, None, :],
            )
        by_constants = np.zeros(self._merged.row.size)
        for by_end, end, target in zip(by_ends, self.ends, self._merged.target, strict=False):
            entry = end.terms.constants
            by = by_end[entry.row, entry.channel] * entry.basis
            by_constants += np.bincount(target, by, minlength=by_constants.size)
        return Evaluation(
            residual,
            interval,
            by_knots,
            self._merged.row,
            self._merged.column,
            by_constants[:, None] if jacobian else empty,
            *self._chain_entries(path, interval, by_ends),
            self._shared_unknowns(self._by_common(found)),
        )

    def add_to(
        self,
        total: Sums | None,
        path: Path,
        state: PathState,
        values: Values,
        *,
        weight: NDArray[np.float64] | None,
        scale: NDArray[np.float64],
    ) -> float | None:
        """Add all measurements up at once, in compiled code; see :meth:`Family.add_to`."""
        kernel = self._kernel_for(state)
        if kernel is None or self._chained or not isinstance(state, KinematicPathState):
            return None
        cost, emitted, self._delays[:] = kernel.sums(
            path,
            state,
            values,
            white=self._white,
            emitted_s=self._emitted,
            delays_s=self._delays,
            weight=weight,
            common=self._shared_prior(),
            scale=scale,
            total=total,
        )
        if np.isfinite(cost):
            self._emitted = emitted
        return cost

    def _shared_prior(self) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
        """Return derivatives by shared unknowns and what their priors hold, if these are fixed."""
        return None, None

    def _evaluate_compiled(
        self, kernel: RayKernel, path: Path, state: PathState, values: Values, *, jacobian: bool
    ) -> Evaluation:
        """Do what :meth:`evaluate` does, in compiled code."""
        found = self._run(
            kernel,
            path,
            state,
            values,
            white=self._white,
            jacobian=jacobian,
            channels=jacobian and self._chained,
        )
        return Evaluation(
            found.residual[:, None],
            found.interval,
            found.by_path,
            self._merged.row,
            self._merged.column,
            np.empty((0, 1)) if found.by_constants is None else found.by_constants,
            *self._chain_entries(path, found.interval, found.by_ends),
            self._shared_unknowns(found.by_common),
        )

    def _chain_entries(
        self, path: Path, interval: NDArray[np.int64], by_ends: Sequence[NDArray[np.float64]]
    ) -> _ChainEntries:
        """Return rows, columns, weights and derivatives of the chains' entries, of all ends.

        Without ``by_ends`` there are no derivatives.
        """
        if not self._chained:
            return _NO_INDEX, _NO_INDEX, _NOTHING, _NOTHING, _NOTHING[:, None]
        entries = [end.terms.chains for end in self.ends]
        shares = [end.share(path, interval) for end in self.ends]
        by = [
            by_end[entry.row, entry.channel] * entry.basis
            for by_end, entry in zip(by_ends, entries, strict=False)
        ]
        return (
            np.concatenate([entry.row for entry in entries]),
            np.concatenate([entry.column for entry in entries]),
            np.concatenate([share.before for share in shares]),
            np.concatenate([share.after for share in shares]),
            np.concatenate([_NOTHING, *by])[:, None],
        )

    def refresh(self, path: Path, values: Values) -> None:
        """Take position noise and the times at which chains are read from an estimate."""
        state = path.at_state(values.path, jacobian=True)
        kernel = self._kernel_for(state)
        by_position: NDArray[np.float64] | None
        if kernel is None:
            solved = self.solve(path, state, values)
            emitted, delays = solved.emitted_s, [ray.light_time_s for ray in solved.rays]
            by_position, by_velocity, by_ends = self._gradients(solved, path, state)
        else:
            plain = np.ones(len(self))
            found = self._run(
                kernel, path, state, values, white=plain, jacobian=True, channels=True
            )
            emitted, delays = found.emitted_s, found.delays_s
            by_position, by_velocity, by_ends = found.by_position, found.by_velocity, found.by_ends
        assert by_position is not None
        for end, delay in zip(self.ends, delays, strict=True):
            end.read_s = emitted + delay
        between = np.linalg.norm(by_position, axis=1) * self.path_noise_m
        if by_velocity is not None:
            added = np.linalg.norm(by_velocity, axis=1) * self.path_noise_m_s
            between = np.hypot(between, added)
        extra = [between]
        for by_end, noise in zip(by_ends, self.position_noise_m, strict=True):
            length = np.linalg.norm(by_end[:, POSITION : POSITION + 3], axis=1)
            extra.append(length * noise)
        self._whiten(extra)

    def expect_delays(self, delay_s: NDArray[np.float64]) -> None:
        """Start the next evaluation from delays of the signals, shape (n,), seconds."""
        self._delays[-1] = delay_s

    @property
    def emitted_s(self) -> NDArray[np.float64]:
        """Shape (n,): times of emission as the last evaluation found them."""
        return self.time_s if self._emitted is None else self._emitted

    def squares(self, found: Evaluation) -> NDArray[np.float64]:
        """Return squared whitened residuals, shape (n,), as large as if nothing was shared.

        What an unknown of the group takes up makes residuals smaller; weights for correlation make
        errors common, not small.
        """
        left = self._left(found)
        return np.asarray(found.residual[:, 0] ** 2 / (self.weight * left))

    @staticmethod
    def _left(found: Evaluation) -> NDArray[np.float64]:
        """Return the share of each residual's variance that is left, shape (n,)."""
        if found.common is None:
            return np.ones(found.residual.shape[0])
        return np.asarray(np.maximum(1.0 - found.common.leverage(), 1e-6))

    def emissions(
        self, path: Path, values: Values
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return distances from the sensors (m) and times of emission (s), each shape (n,)."""
        found = self.solve(path, path.at_state(values.path, jacobian=False), values)
        return found.rays[0].distance_m, found.emitted_s

    def resolution_m(
        self, distance_m: NDArray[np.float64], speed_m_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return about how well each measurement alone locates the object, shape (n,), metres."""
        del distance_m, speed_m_s
        return self.sigma * self.world.speed_m_s

    def clock_resolution_s(
        self, distance_m: NDArray[np.float64], speed_m_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return how well each measurement resolves its sensor's clock, shape (n,), seconds."""
        del distance_m, speed_m_s
        return self.sigma

    def report(self, path: Path, values: Values, found: Evaluation) -> Report:
        """Return what was measured and predicted; see :class:`Report`."""
        del path, values
        error = found.residual[:, 0] / self._white
        root = np.sqrt(self.weight * self._left(found))
        return Report(
            kinds=(self.kind,),
            units=(self.unit,),
            exists=np.ones((len(self), 1), dtype=bool),
            measured=self.measured[:, None],
            predicted=(self.measured + error)[:, None],
            sigma=np.sqrt(self.weight / self._white**2)[:, None],
            normalised=-found.residual / root[:, None],
        )
