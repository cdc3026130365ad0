"""Sensor-error states: which there are, where each stands, and what it adds to a measurement.

An error of a sensor at time t is

    error(t) = bias + drift (t - t0) + walk(t),

with t the time tag and t0 the recording's first one. Bias and drift are constants of the pass and
stand in one vector of all sensors; a walk is a chain with a value at every knot, interpolated
linearly, and stands in the knots' states behind the path. At a reset, as a calibration is one, an
error begins anew: with a bias and a drift of its own, counted from there, and a walk from zero
(:mod:`geograph.stretches`). All are scaled: bias and drift by their
prior sigma, a walk by what its diffusion adds over the pass. (So a clock, which is in seconds here,
is of order one for the solver, as it would be in metres.)

A platform whose path is estimated adds position and velocity at every knot, counted from the line
that fits its fixes best, behind the walks (:mod:`geograph.platforms`). Walks and platforms together
are called chains.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from geograph.factors.kinematics import interpolation_weights, noise_square_root, transition
from geograph.platforms import Platform, platforms_of
from geograph.stretches import Stretches, WalkCuts, clock_resets_s, pointing_resets_s

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.sensors import Sensor

AZIMUTH: Final = 0
ELEVATION: Final = 1
CLOCK: Final = 2
POSITION: Final = 3
VELOCITY: Final = 6
FREQUENCY: Final = 9
SPEED: Final = 10
MISALIGNMENT: Final = 11
CHANNELS: Final = 14
"""Channels of error: azimuth, elevation (rad), clock (s), position x, y, z (m), velocity x, y, z
(m/s, of a platform alone), received frequency (Hz), speed of propagation (m/s, common to all),
misalignment about body x, y, z (rad)."""

CHANNEL_NAMES: Final = (
    "azimuth",
    "elevation",
    "clock",
    "position_x",
    "position_y",
    "position_z",
    "velocity_x",
    "velocity_y",
    "velocity_z",
    "frequency",
    "propagation_speed",
    "misalignment_x",
    "misalignment_y",
    "misalignment_z",
)
_UNITS: Final = (
    *("rad", "rad", "s", "m", "m", "m", "m/s", "m/s", "m/s", "Hz", "m/s", "rad", "rad", "rad"),
)

NO_SENSOR: Final = -1
"""Index in place of a sensor's for what belongs to the recording as a whole."""

RECORDING_NAME: Final = "(recording)"
"""Name in place of a sensor's for what belongs to the recording as a whole."""

# A walk starts at zero; this fraction of its scale is small against anything it can become, and
# large enough to keep the system well conditioned.
_WALK_START_SIGMA = 1e-3

# A reset leaves this much of a walk, for a transition that leaves nothing has no inverse.
_WALK_LEFT = 1e-3

# The first knot's prior of a platform is this many of its scales wide: its fixes do not feel it.
_PLATFORM_START_SIGMA = 1e4


@dataclass(frozen=True)
class SensorState:
    """One constant error of one sensor.

    Attributes
    ----------
    sensor
        Index of the sensor, or :data:`NO_SENSOR`.
    channel
        Which error it belongs to (see :data:`CHANNEL_NAMES`).
    drift
        Whether it multiplies the time since the first measurement.
    sigma
        Prior standard deviation, SI; also its scale.
    stretch
        How many resets of the error were before.
    """

    sensor: int
    channel: int
    drift: bool
    sigma: float
    stretch: int = 0

    @property
    def name(self) -> str:
        """Name in results: ``azimuth_bias``, ``clock_offset``, ``clock_drift``, ``position_x``.

        After the first reset ``azimuth_bias_2``, after the second ``azimuth_bias_3``.
        """
        return self.kind if self.stretch == 0 else f"{self.kind}_{self.stretch + 1}"

    @property
    def kind(self) -> str:
        """Name whatever the stretch: ``azimuth_bias``."""
        name = CHANNEL_NAMES[self.channel]
        if self.drift:
            return f"{name}_drift"
        if self.channel <= ELEVATION:
            return f"{name}_bias"
        return f"{name}_offset" if self.channel in (CLOCK, FREQUENCY) else name

    @property
    def unit(self) -> str:
        """Unit in results."""
        unit = _UNITS[self.channel]
        if not self.drift:
            return unit
        return "s/s" if unit == "s" else f"{unit}/s"


@dataclass(frozen=True)
class Walk:
    """The random walk of one error of one sensor.

    Attributes
    ----------
    sensor, channel
        As in :class:`SensorState`.
    diffusion
        Standard deviation after one second, SI per square root of a second.
    """

    sensor: int
    channel: int
    diffusion: float

    @property
    def name(self) -> str:
        """Name in results: the walk at the end of the pass."""
        return f"{CHANNEL_NAMES[self.channel]}_walk"

    @property
    def unit(self) -> str:
        """Unit in results."""
        return _UNITS[self.channel]


class SensorStates:
    """All sensor-error states of a problem.

    Parameters
    ----------
    sensors
        In the order of their indices.
    active
        Indices of the sensors that have measurements; the others have no states.
    reference_s
        Time t0 that drifts are counted from, seconds.
    propagation_sigma_m_s
        Prior sigma of the speed of propagation; zero: known.
    """

    def __init__(
        self,
        sensors: Sequence[Sensor],
        active: Sequence[int],
        reference_s: float,
        propagation_sigma_m_s: float = 0.0,
    ) -> None:
        self.reference_s = reference_s
        self.stretches = Stretches(
            [
                dict.fromkeys((AZIMUTH, ELEVATION), pointing_resets_s(sensor))
                | {CLOCK: clock_resets_s(sensor)}
                for sensor in sensors
            ]
        )
        self.constants: list[SensorState] = []
        self.walks: list[Walk] = []
        for index in active:
            errors = sensors[index].errors
            table = (
                (AZIMUTH, errors.azimuth_bias_rad, errors.azimuth_drift_rad_s),
                (ELEVATION, errors.elevation_bias_rad, errors.elevation_drift_rad_s),
                (CLOCK, errors.clock_offset_s, errors.clock_drift_s_s),
                *((POSITION + axis, errors.position_m, 0.0) for axis in range(3)),
                (FREQUENCY, errors.frequency_offset_hz, errors.frequency_drift_hz_s),
                *((MISALIGNMENT + axis, errors.misalignment_rad, 0.0) for axis in range(3)),
            )
            for channel, bias, drift in table:
                for stretch in range(self.stretches.of(index, channel).size + 1):
                    if bias > 0.0:
                        self.constants.append(SensorState(index, channel, False, bias, stretch))
                    if drift > 0.0:
                        self.constants.append(SensorState(index, channel, True, drift, stretch))
            for channel, diffusion in (
                (AZIMUTH, errors.azimuth_instability_rad_sqrt_s),
                (ELEVATION, errors.elevation_instability_rad_sqrt_s),
                (CLOCK, errors.clock_instability_s_sqrt_s),
            ):
                if diffusion > 0.0:
                    self.walks.append(Walk(index, channel, diffusion))
        if propagation_sigma_m_s > 0.0:
            self.constants.append(SensorState(NO_SENSOR, SPEED, False, propagation_sigma_m_s))
        self.platforms: list[Platform] = platforms_of(sensors, active)
        count = len(sensors)
        self.sigma = np.array([state.sigma for state in self.constants])
        self._tabulate()
        self.walk_column = np.full((count, CHANNELS), -1, dtype=np.int64)
        for column, walk in enumerate(self.walks):
            self.walk_column[walk.sensor, walk.channel] = column
        self.walk_resets_s = [self.stretches.of(walk.sensor, walk.channel) for walk in self.walks]
        self.platform_column = np.full(count, -1, dtype=np.int64)
        for index, platform in enumerate(self.platforms):
            self.platform_column[platform.sensor] = len(self.walks) + 6 * index
        self.diffusion = np.array([walk.diffusion for walk in self.walks])
        self.channels = frozenset(
            [*(state.channel for state in self.constants), *(walk.channel for walk in self.walks)]
        )
        """Channels of error that have a bias, a drift or a walk."""

    def _tabulate(self) -> None:
        """Make tables of the constants' columns: a row for each sensor, and for each stretch."""
        shape = self.stretches.rows, CHANNELS
        self.bias_column = np.full(shape, -1, dtype=np.int64)
        self.drift_column = np.full(shape, -1, dtype=np.int64)
        self.since_s = np.full(shape, self.reference_s)
        for column, state in enumerate(self.constants):
            target = self.drift_column if state.drift else self.bias_column
            if state.sensor == NO_SENSOR:
                target[:, state.channel] = column
                continue
            own = self.stretches.rows_of(state.sensor, state.channel, state.stretch)
            target[own, state.channel] = column
            if state.stretch:
                resets = self.stretches.of(state.sensor, state.channel)
                self.since_s[own, state.channel] = resets[state.stretch - 1]

    @property
    def size(self) -> int:
        """Number of constant states."""
        return len(self.constants)

    @property
    def chains(self) -> int:
        """Number of components that walks and platforms have at every knot."""
        return len(self.walks) + 6 * len(self.platforms)

    def chain_scale(self, span_s: float) -> NDArray[np.float64]:
        """Return the scales of the chains' components for a pass of given length, shape (w,), SI.

        Those of a walk are what its diffusion adds over the pass; those of a platform the sigma of
        a fix, and that over the pass.
        """
        parts = [self.diffusion * np.sqrt(span_s)]
        for platform in self.platforms:
            parts += [np.full(3, platform.sigma_m), np.full(3, platform.sigma_m / span_s)]
        return np.concatenate(parts)

    def chain_start_sigma(self) -> NDArray[np.float64]:
        """Return the prior sigmas of the chains at the first knot, shape (w,), scaled."""
        return np.concatenate(
            [
                np.full(len(self.walks), _WALK_START_SIGMA),
                np.full(6 * len(self.platforms), _PLATFORM_START_SIGMA),
            ]
        )

    def chain_transitions(
        self, knots_s: NDArray[np.float64], scale: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the chains' transitions and noise roots, each shape (K - 1, w, w), scaled.

        Parameters
        ----------
        knots_s
            Shape (K,): times of the knots.
        scale
            Shape (w,): from :meth:`chain_scale`.
        """
        steps_s = np.diff(knots_s)
        count, size = steps_s.size, self.chains
        matrix = np.broadcast_to(np.eye(size), (count, size, size)).copy()
        root = np.zeros((count, size, size))
        walk = np.arange(len(self.walks))
        root[:, walk, walk] = self.diffusion * np.sqrt(steps_s)[:, None]
        for column, resets in enumerate(self.walk_resets_s):
            before = np.searchsorted(resets, knots_s, side="right")
            cut = np.flatnonzero(np.diff(before))
            matrix[cut, column, column] = _WALK_LEFT
            since = knots_s[cut + 1] - resets[before[cut + 1] - 1]
            own = self.diffusion[column] * np.sqrt(since)
            root[cut, column, column] = np.hypot(_WALK_START_SIGMA * scale[column], own)
        for index, platform in enumerate(self.platforms):
            first = len(self.walks) + 6 * index
            own = slice(first, first + 6)
            matrix[:, own, own] = np.kron(transition(2, steps_s), np.eye(3))
            root[:, own, own] = platform.process_noise * np.kron(
                noise_square_root(2, steps_s), np.eye(3)
            )
        return matrix * scale / scale[:, None], root / scale[:, None]

    def owner(self, index: int, names: Sequence[str]) -> str:
        """Return the name of the sensor that a constant state belongs to, for results."""
        sensor = self.constants[index].sensor
        return RECORDING_NAME if sensor == NO_SENSOR else names[sensor]

    def of_sensor(self, index: int) -> list[int]:
        """Return the columns of one sensor's constant states."""
        return [column for column, state in enumerate(self.constants) if state.sensor == index]


@dataclass(frozen=True, eq=False)
class _Entries:
    """Which measurement feels which state: parallel columns."""

    row: NDArray[np.int64]
    channel: NDArray[np.int64]
    column: NDArray[np.int64]
    basis: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ChainShare:
    """How the chains' values at two knots add up in each of their entries.

    Attributes
    ----------
    interval
        Shape (n,): the knot before each measurement.
    before, after
        Shape (f,): weights of the knot before and the one after.
    """

    interval: NDArray[np.int64]
    before: NDArray[np.float64]
    after: NDArray[np.float64]


_NO_INDEX: Final = np.empty(0, dtype=np.int64)
_NONE: Final = _Entries(_NO_INDEX, _NO_INDEX, _NO_INDEX, np.empty(0))


class SensorErrorTerms:
    """What the states add to the errors of a fixed set of measurements.

    Parameters
    ----------
    states
        All states of the problem.
    sensor
        Shape (n,), integer: each measurement's sensor.
    time_s
        Shape (n,): its time tag.
    chain_scale
        Shape (w,): scale of every component of the chains, SI.
    channels
        Which errors the measurements feel, besides a platform's; None: any.
    """

    def __init__(
        self,
        states: SensorStates,
        sensor: NDArray[np.int64],
        time_s: NDArray[np.float64],
        chain_scale: NDArray[np.float64],
        channels: Sequence[int] | None = None,
    ) -> None:
        self.count = sensor.size
        felt = np.full(CHANNELS, channels is None)
        if channels is not None:
            felt[list(channels)] = True
        constants: list[tuple[NDArray[Any], ...]] = []
        stretch = states.stretches.row(sensor, time_s)
        for columns in (states.bias_column, states.drift_column):
            if not (columns >= 0).any():
                continue
            row, channel = np.nonzero((columns[stretch] >= 0) & felt)
            column = columns[stretch[row], channel]
            basis = np.ones(row.size)
            if columns is states.drift_column:
                basis = time_s[row] - states.since_s[stretch[row], channel]
            constants.append((row, channel, column, basis * states.sigma[column]))
        self.constants = _by_row(_joined(constants)) if constants else _NONE
        if not states.chains:
            self.chains, self._walks, self._term, self._cuts = _NONE, 0, _NONE.row, None
            return
        row, channel = np.nonzero((states.walk_column[sensor] >= 0) & felt)
        column = states.walk_column[sensor[row], channel]
        parts: list[tuple[NDArray[Any], ...]] = [(row, channel, column, chain_scale[column])]
        self._walks = row.size
        self._cuts = (
            WalkCuts.of(states.walk_resets_s, column, time_s[row]) if states.stretches.any else None
        )
        # Of a platform's cubic between two knots: which weight, and which derivative.
        terms = []
        row = np.flatnonzero(states.platform_column[sensor] >= 0)
        first = states.platform_column[sensor[row]]
        for derivative, start in ((0, POSITION), (1, VELOCITY)):
            for block in range(2):
                for axis in range(3):
                    column = first + 3 * block + axis
                    channel = np.full(row.size, start + axis)
                    parts.append((row, channel, column, chain_scale[column]))
                    terms.append(np.full(row.size, 2 * derivative + block))
        self.chains = _joined(parts)
        self._term = np.concatenate(terms) if row.size else np.empty(0, dtype=np.int64)

    @property
    def cut(self) -> bool:
        """Whether random walks begin anew between knots somewhere."""
        return self._cuts is not None

    def share(
        self,
        knots_s: NDArray[np.float64],
        interval: NDArray[np.int64],
        time_s: NDArray[np.float64],
    ) -> ChainShare:
        """Return the weights of both knots in the chains' entries.

        Parameters
        ----------
        knots_s
            Shape (K,), K > 1 where there are chains.
        interval
            Shape (n,): in which the chains are read.
        time_s
            Shape (n,): the time at which they are read.
        """
        row = self.chains.row
        if not row.size:
            none = np.empty(0)
            return ChainShare(interval, none, none)
        at = interval[row]
        step, offset = knots_s[at + 1] - knots_s[at], time_s[row] - knots_s[at]
        # Beyond the interval a walk is what it was at the nearer knot: the mean of its prior there.
        after = np.clip(offset / step, 0.0, 1.0)
        before = 1.0 - after
        if self._cuts is not None:
            own = slice(None, self._walks)
            before[own], after[own] = self._cuts.weighed(knots_s, at[own], before[own], after[own])
        if self._term.size:
            own = slice(self._walks, None)
            weights = np.stack(
                [
                    interpolation_weights(2, step[own], offset[own], derivative=derivative)
                    for derivative in range(2)
                ],
                axis=1,
            ).reshape(-1, 2, 2, 2)
            # Axes: entry, derivative, knot, block.
            entry = np.arange(self._term.size)
            derivative, block = self._term // 2, self._term % 2
            before[own] = weights[entry, derivative, 0, block]
            after[own] = weights[entry, derivative, 1, block]
        return ChainShare(interval, before, after)

    def constant_errors(self, constants: NDArray[np.float64], channel: int) -> NDArray[np.float64]:
        """Return what the constant states add to one channel, shape (n,), SI units.

        Parameters
        ----------
        constants
            Shape (s,): scaled values of the constant states.
        channel
            Which one.
        """
        entries = self.constants
        own = np.flatnonzero(entries.channel == channel)
        value = entries.basis[own] * constants[entries.column[own]]
        return np.asarray(np.bincount(entries.row[own], value, minlength=self.count))

    def errors(
        self,
        constants: NDArray[np.float64],
        chains: NDArray[np.float64] | None = None,
        share: ChainShare | None = None,
    ) -> NDArray[np.float64]:
        """Return the errors of all channels, shape (n, CHANNELS), SI units.

        Parameters
        ----------
        constants
            Shape (s,): scaled values of the constant states.
        chains
            Shape (K, w): scaled values of the chains at the knots; None leaves them out.
        share
            Weights of both knots, from :meth:`share`.
        """
        entries = self.constants
        summed = np.bincount(
            entries.row * CHANNELS + entries.channel,
            entries.basis * constants[entries.column],
            minlength=self.count * CHANNELS,
        )
        value = np.asarray(summed, dtype=np.float64).reshape(self.count, CHANNELS)
        if chains is not None and share is not None and self.chains.row.size:
            value += self.chain_errors(chains, share)
        return value

    def chain_errors(self, chains: NDArray[np.float64], share: ChainShare) -> NDArray[np.float64]:
        """Return what the chains add to all channels, shape (n, CHANNELS), SI units.

        Parameters
        ----------
        chains, share
            As of :meth:`errors`.
        """
        entries = self.chains
        at = share.interval[entries.row]
        read = (
            share.before * chains[at, entries.column] + share.after * chains[at + 1, entries.column]
        )
        place = entries.row * CHANNELS + entries.channel
        summed = np.bincount(place, read * entries.basis, minlength=self.count * CHANNELS)
        return np.asarray(summed, dtype=np.float64).reshape(self.count, CHANNELS)


def _by_row(entries: _Entries) -> _Entries:
    """Return entries in the order of the measurements, as they are read."""
    order = np.argsort(entries.row, kind="stable")
    return _Entries(*(column[order] for column in vars(entries).values()))


def _joined(parts: Sequence[tuple[NDArray[Any], ...]]) -> _Entries:
    return _Entries(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
