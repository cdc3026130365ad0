"""Sensor-error states: which there are, where each stands, and what it adds to a measurement.

An error of a sensor at time t is

    error(t) = bias + drift (t - t0) + walk(t),

with t the time tag and t0 the recording's first one. Bias and drift are constants of the pass and
stand in one vector of all sensors; a walk is a chain with a value at every knot, interpolated
linearly, and stands in the knots' states behind the path. All are scaled: bias and drift by their
prior sigma, a walk by what its diffusion adds over the pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.sensors import Sensor

AZIMUTH: Final = 0
ELEVATION: Final = 1
CLOCK: Final = 2
POSITION: Final = 3
CHANNELS: Final = 6
"""Channels of error: azimuth, elevation (rad), clock (s), position x, y, z (m)."""

CHANNEL_NAMES: Final = (
    "azimuth",
    "elevation",
    "clock",
    "position_x",
    "position_y",
    "position_z",
)
_UNITS: Final = ("rad", "rad", "s", "m", "m", "m")


@dataclass(frozen=True)
class SensorState:
    """One constant error of one sensor.

    Attributes
    ----------
    sensor
        Index of the sensor.
    channel
        Which error it belongs to (see :data:`CHANNEL_NAMES`).
    drift
        Whether it multiplies the time since the first measurement.
    sigma
        Prior standard deviation, SI; also its scale.
    """

    sensor: int
    channel: int
    drift: bool
    sigma: float

    @property
    def name(self) -> str:
        """Name in results: ``azimuth_bias``, ``clock_offset``, ``clock_drift``, ``position_x``."""
        name = CHANNEL_NAMES[self.channel]
        if self.channel >= POSITION:
            return name
        if self.drift:
            return f"{name}_drift"
        return f"{name}_offset" if self.channel == CLOCK else f"{name}_bias"

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
    """

    def __init__(
        self, sensors: Sequence[Sensor], active: Sequence[int], reference_s: float
    ) -> None:
        self.reference_s = reference_s
        self.constants: list[SensorState] = []
        self.walks: list[Walk] = []
        for index in active:
            errors = sensors[index].errors
            table = (
                (AZIMUTH, errors.azimuth_bias_rad, errors.azimuth_drift_rad_s),
                (ELEVATION, errors.elevation_bias_rad, errors.elevation_drift_rad_s),
                (CLOCK, errors.clock_offset_s, errors.clock_drift_s_s),
                *((POSITION + axis, errors.position_m, 0.0) for axis in range(3)),
            )
            for channel, bias, drift in table:
                if bias > 0.0:
                    self.constants.append(SensorState(index, channel, False, bias))
                if drift > 0.0:
                    self.constants.append(SensorState(index, channel, True, drift))
            for channel, diffusion in (
                (AZIMUTH, errors.azimuth_instability_rad_sqrt_s),
                (ELEVATION, errors.elevation_instability_rad_sqrt_s),
                (CLOCK, errors.clock_instability_s_sqrt_s),
            ):
                if diffusion > 0.0:
                    self.walks.append(Walk(index, channel, diffusion))
        count = len(sensors)
        self.sigma = np.array([state.sigma for state in self.constants])
        self.bias_column = np.full((count, CHANNELS), -1, dtype=np.int64)
        self.drift_column = np.full((count, CHANNELS), -1, dtype=np.int64)
        for column, state in enumerate(self.constants):
            target = self.drift_column if state.drift else self.bias_column
            target[state.sensor, state.channel] = column
        self.walk_column = np.full((count, CHANNELS), -1, dtype=np.int64)
        for column, walk in enumerate(self.walks):
            self.walk_column[walk.sensor, walk.channel] = column
        self.diffusion = np.array([walk.diffusion for walk in self.walks])

    @property
    def size(self) -> int:
        """Number of constant states."""
        return len(self.constants)

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
    walk_scale
        Shape (w,): scale of every walk, SI.
    """

    def __init__(
        self,
        states: SensorStates,
        sensor: NDArray[np.int64],
        time_s: NDArray[np.float64],
        walk_scale: NDArray[np.float64],
    ) -> None:
        self.count = sensor.size
        since = time_s - states.reference_s
        constants = []
        for columns, basis in (
            (states.bias_column, np.ones_like(since)),
            (states.drift_column, since),
        ):
            row, channel = np.nonzero(columns[sensor] >= 0)
            column = columns[sensor[row], channel]
            constants.append((row, channel, column, basis[row] * states.sigma[column]))
        self.constants = _Entries(
            *(np.concatenate(parts) for parts in zip(*constants, strict=True))
        )
        row, channel = np.nonzero(states.walk_column[sensor] >= 0)
        column = states.walk_column[sensor[row], channel]
        self.walks = _Entries(row, channel, column, walk_scale[column])

    def errors(
        self,
        constants: NDArray[np.float64],
        walks: NDArray[np.float64] | None,
        interval: NDArray[np.int64] | None,
        fraction: NDArray[np.float64] | None,
    ) -> NDArray[np.float64]:
        """Return the errors of all channels, shape (n, 6), SI units.

        Parameters
        ----------
        constants
            Shape (s,): scaled values of the constant states.
        walks
            Shape (K, w): scaled values of the walks at the knots; None leaves them out.
        interval, fraction
            Shape (n,): place among the knots, as index and fraction of the interval.
        """
        entries = self.constants
        summed = np.bincount(
            entries.row * CHANNELS + entries.channel,
            entries.basis * constants[entries.column],
            minlength=self.count * CHANNELS,
        )
        value = np.asarray(summed, dtype=np.float64).reshape(self.count, CHANNELS)
        if walks is not None and interval is not None and fraction is not None:
            entries = self.walks
            before = walks[interval[entries.row], entries.column]
            after = walks[interval[entries.row] + 1, entries.column]
            walked = before + (after - before) * fraction[entries.row]
            value[entries.row, entries.channel] += walked * entries.basis
        return value
