"""From a recording to what every solve of it shares: families, sensor states, weights, scales."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from geograph.attitude import check_attitude
from geograph.errors import InputError
from geograph.factors.refraction import refraction
from geograph.families import (
    CONSTRAINT_FAMILIES,
    ArrivalFamily,
    BearingFamily,
    FixFamily,
    FrequencyDifferenceFamily,
    TimeDifferenceFamily,
    World,
)
from geograph.frames import SensorGeometry
from geograph.ground import check_ground
from geograph.measurements import Arrivals, Bearings, FrequencyDifferences, TimeDifferences
from geograph.states import SensorStates
from geograph.time_shift import TimeShift, time_shift

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.families import Family, SensorFamily
    from geograph.measurements import Measurements
    from geograph.recording import Recording
    from geograph.sensors import Sensor


# How far beyond the measurements a constraint may stand: in sigmas of clocks, in spans.
_CLOCK_SIGMAS = 3.0
_SLACK_SHARE = 1e-3


@dataclass(frozen=True, eq=False)
class Prepared:
    """A recording made ready for solving.

    Attributes
    ----------
    recording
        What was given.
    bearings
        Its bearings, free of refraction; None if there are none.
    sensors
        In the order of their indices.
    geometry
        Their poses.
    states
        Sensor-error states of the sensors that measured something.
    walk_scale
        Shape (w,): scales of the chains, SI.
    shift
        A shift in time that only the clocks' priors determine, or None.
    """

    recording: Recording
    bearings: Bearings | None
    sensors: tuple[Sensor, ...]
    geometry: SensorGeometry
    states: SensorStates
    walk_scale: NDArray[np.float64]
    shift: TimeShift | None

    @property
    def span_s(self) -> float:
        """Time from the first to the last measurement; at least a second."""
        return _span(self.recording)

    def with_sensors(self, sensors: tuple[Sensor, ...]) -> Prepared:
        """Return the same with sensors that differ in their resets alone."""
        recording = self.recording
        active = _active(recording)
        states = SensorStates(
            sensors, active, self.states.reference_s, recording.propagation_sigma_m_s
        )
        shift = time_shift(states, sensors, active, recording.constraints)
        return replace(self, sensors=sensors, states=states, shift=shift)

    def sensor_families(self) -> list[SensorFamily]:
        """Return fresh families of all that sensors measured."""
        tables: list[Measurements] = [] if self.bearings is None else [self.bearings]
        named = self.recording.tables
        tables += [table for name, table in named.items() if name != "bearings"]
        return [self.family(table, correlation_weights(table, self.sensors)) for table in tables]

    def family(
        self,
        table: Measurements,
        weight: NDArray[np.float64],
        *,
        median_carrier_hz: float | None = None,
    ) -> SensorFamily:
        """Return the family of a table of measurements.

        Parameters
        ----------
        table
            Bearings free of refraction, or any other.
        weight
            Shape (n,): weights of the information, for correlated errors.
        median_carrier_hz
            That of all frequency differences; None: the table's own.
        """
        noise = self._position_noise(table.sensor)
        if isinstance(table, Bearings):
            return BearingFamily(
                table,
                geometry=self.geometry,
                states=self.states,
                walk_scale=self.walk_scale,
                speed_m_s=self.recording.propagation_speed_m_s,
                weight=weight,
                position_noise_m=noise,
            )
        speed = self.recording.propagation_speed_m_s
        world = World(self.geometry, self.states, self.walk_scale, speed)
        if isinstance(table, Arrivals):
            return ArrivalFamily(table, world=world, weight=weight, position_noise_m=noise)
        both = noise, self._position_noise(table.reference)
        if isinstance(table, TimeDifferences):
            return TimeDifferenceFamily(table, world=world, weight=weight, position_noise_m=both)
        return FrequencyDifferenceFamily(
            table,
            world=world,
            weight=weight,
            position_noise_m=both,
            median_carrier_hz=median_carrier_hz,
        )

    def _position_noise(self, sensor: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return white position errors; a platform's are those of its fixes."""
        return self._position_noise_m[sensor]

    @cached_property
    def _position_noise_m(self) -> NDArray[np.float64]:
        noise = [
            0.0 if sensor.platform_process_noise is not None else sensor.errors.position_noise_m
            for sensor in self.sensors
        ]
        return np.array(noise)

    def fix_times(self) -> NDArray[np.float64]:
        """Return the times of the platforms' fixes that are used, shape (n,)."""
        times = [p.time_s[self._used(p.time_s)] for p in self.states.platforms]
        return np.concatenate([np.empty(0), *times])

    def _used(self, time_s: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return which fixes lie between the first and the last measurement, and one beyond."""
        low, high = self.recording.time_span_s
        first = max(int(np.searchsorted(time_s, low, side="right")) - 1, 0)
        last = min(int(np.searchsorted(time_s, high, side="left")) + 1, time_s.size)
        return np.arange(first, last)

    def families(self, knots_s: NDArray[np.float64]) -> list[Family]:
        """Return fresh families of all measurements, for a path over given knots.

        Those of the sensors come first.
        """
        families: list[Family] = [*self.sensor_families()]
        families += [
            FixFamily(platform, self.states, self.walk_scale, self._used(platform.time_s))
            for platform in self.states.platforms
        ]
        table = self.recording.constraints
        if table is None:
            return families
        for name, family in CONSTRAINT_FAMILIES.items():
            rows = np.array([kind == name for kind in table.kind], dtype=bool)
            if rows.any():
                whole = family(
                    time_s=table.time_s[rows],
                    value=table.value[rows],
                    sigma=table.sigma[rows],
                    line=table.line[rows],
                    frame=self.recording.frame,
                    surface=self.recording.terrain,
                )
                families.append(whole.expanded(knots_s))
        return families


def prepare(recording: Recording) -> Prepared:
    """Make a recording ready for solving.

    Parameters
    ----------
    recording
        What was measured.

    Raises
    ------
    InputError
        If it has no measurement, a sensor with axes that are not supported, an implausible
        attitude or a place below the ground, a constraint at a time
        when nothing was measured yet or any more, or arrivals whose signals take no time.
    """
    tables = recording.tables
    if not tables:
        raise InputError(
            f"recording {recording.name!r} has no measurement; expected at least one bearing, "
            "arrival, time difference or frequency difference",
            path=recording.path,
        )
    if set(tables) != {"bearings"} and not np.isfinite(recording.propagation_speed_m_s):
        raise InputError(
            f"recording {recording.name!r} has {', '.join(n for n in tables if n != 'bearings')} "
            "and propagation_speed_m_s = inf; expected a finite speed for these",
            path=recording.path,
        )
    sensors = tuple(recording.sensors.values())
    for sensor in sensors:
        check_attitude(sensor, recording.frame)
    check_ground(recording)
    table = tables.get("bearings")
    bearings = without_refraction(table, sensors) if isinstance(table, Bearings) else None
    active = _active(recording)
    _check_constraint_times(recording, [sensors[index] for index in active])
    states = SensorStates(
        sensors, active, recording.time_span_s[0], recording.propagation_sigma_m_s
    )
    geometry = SensorGeometry(sensors, recording.frame, epoch=recording.epoch, path=recording.path)
    shift = time_shift(states, sensors, active, recording.constraints)
    scale = states.chain_scale(_span(recording))
    return Prepared(recording, bearings, sensors, geometry, states, scale, shift)


def _active(recording: Recording) -> list[int]:
    """Return the indices of the sensors that measured something."""
    used = [column for table in recording.tables.values() for column in _sensor_columns(table)]
    return [int(index) for index in np.unique(np.concatenate(used))]


def _sensor_columns(table: Measurements) -> list[NDArray[np.int64]]:
    if isinstance(table, (TimeDifferences, FrequencyDifferences)):
        return [table.sensor, table.reference]
    return [table.sensor]


def _check_constraint_times(recording: Recording, sensors: list[Sensor]) -> None:
    """Refuse constraints beyond the path, which they would bend at its end."""
    table = recording.constraints
    if table is None:
        return
    # Time tags may be off by as much as the clocks, and a clock that is wrong has no prior.
    margin = _CLOCK_SIGMAS * max(sensor.errors.clock_offset_s for sensor in sensors)
    first, last = recording.time_span_s
    margin = max(margin, _SLACK_SHARE * (last - first))
    # Empty times, which are NaN, are of the whole path.
    beyond = (table.time_s < first - margin) | (table.time_s > last + margin)
    if beyond.any():
        index = int(np.argmax(beyond))
        raise InputError(
            f"constraints, line {table.line[index]}, column time_s: {table.time_s[index]:.10g}, "
            f"and the measurements are from {first:.10g} to {last:.10g} s; expected a time among "
            "them, or an empty cell for the whole path",
            path=recording.path,
        )


def _span(recording: Recording) -> float:
    first, last = recording.time_span_s
    return last - first if last > first else 1.0


def without_refraction(bearings: Bearings, sensors: tuple[Sensor, ...]) -> Bearings:
    """Return bearings with mean refraction taken off the sensors that ask for it."""
    refracted = [sensor.refraction == "standard" for sensor in sensors]
    if not any(refracted):
        return bearings
    bent = np.array(refracted)[bearings.sensor]
    if not bent.any():
        return bearings
    elevation = bearings.elevation_rad.copy()
    elevation[bent] -= refraction(elevation[bent])
    return replace(bearings, elevation_rad=elevation)


def correlation_weights(table: Measurements, sensors: tuple[Sensor, ...]) -> NDArray[np.float64]:
    """Return weights of the information for errors that are correlated and not modelled.

    n measurements of one sensor whose errors have the correlation rho count as
    n / (1 + (n - 1) rho) independent ones; rho = 1 is covariance intersection with equal weights,
    which add up to one (S. J. Julier, J. K. Uhlmann, *A non-divergent estimation algorithm in the
    presence of unknown correlations*, American Control Conference, 1997).

    Parameters
    ----------
    table
        The measurements.
    sensors
        In the order of their indices.
    """
    count = np.bincount(table.sensor, minlength=len(sensors))
    rho = np.array([sensor.correlation for sensor in sensors])
    return np.asarray((1.0 / (1.0 + (count - 1) * rho))[table.sensor])
