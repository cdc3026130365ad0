"""From a recording to what every solve of it shares: families, sensor states, weights, scales."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError
from geograph.factors.refraction import refraction
from geograph.families import AltitudeFamily, BearingFamily, Family, SpeedFamily
from geograph.frames import SensorGeometry
from geograph.states import SensorStates
from geograph.time_shift import TimeShift, time_shift

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.measurements import Bearings
    from geograph.recording import Recording
    from geograph.sensors import Sensor


_CLOCK_SIGMAS = 3.0


@dataclass(frozen=True, eq=False)
class Prepared:
    """A recording made ready for solving.

    Attributes
    ----------
    recording
        What was given.
    bearings
        Its bearings, free of refraction.
    sensors
        In the order of their indices.
    geometry
        Their poses.
    states
        Sensor-error states of the sensors that measured something.
    walk_scale
        Shape (w,): what each walk's diffusion adds over the pass, SI.
    shift
        A shift in time that only the clocks' priors determine, or None.
    """

    recording: Recording
    bearings: Bearings
    sensors: tuple[Sensor, ...]
    geometry: SensorGeometry
    states: SensorStates
    walk_scale: NDArray[np.float64]
    shift: TimeShift | None

    @property
    def span_s(self) -> float:
        """Time from the first to the last measurement; at least a second."""
        return _span(self.bearings)

    def families(self, knots_s: NDArray[np.float64]) -> list[Family]:
        """Return fresh families of all measurements, for a path over given knots."""
        families: list[Family] = [
            BearingFamily(
                self.bearings,
                geometry=self.geometry,
                states=self.states,
                walk_scale=self.walk_scale,
                speed_m_s=self.recording.propagation_speed_m_s,
                weight=correlation_weights(self.bearings, self.sensors),
                position_noise_m=np.array(
                    [sensor.errors.position_noise_m for sensor in self.sensors]
                )[self.bearings.sensor],
            )
        ]
        table = self.recording.constraints
        if table is None:
            return families
        for family in (AltitudeFamily, SpeedFamily):
            rows = np.array([kind == family.name for kind in table.kind], dtype=bool)
            if rows.any():
                whole = family(
                    time_s=table.time_s[rows],
                    value=table.value[rows],
                    sigma=table.sigma[rows],
                    line=table.line[rows],
                    frame=self.recording.frame,
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
        If it has no bearing, a sensor with axes that are not supported, or a constraint at a time
        when nothing was measured yet or any more.
    """
    table = recording.bearings
    if table is None or not len(table):
        raise InputError(
            f"recording {recording.name!r} has no measurement; expected at least one bearing",
            path=recording.path,
        )
    sensors = tuple(recording.sensors.values())
    bearings = without_refraction(table, sensors)
    active = [int(index) for index in np.unique(bearings.sensor)]
    _check_constraint_times(recording, [sensors[index] for index in active])
    states = SensorStates(sensors, active, float(bearings.time_s.min()))
    walk_scale = states.diffusion * np.sqrt(_span(bearings))
    geometry = SensorGeometry(sensors, recording.frame)
    shift = time_shift(states, sensors, active, recording.constraints)
    return Prepared(recording, bearings, sensors, geometry, states, walk_scale, shift)


def _check_constraint_times(recording: Recording, sensors: list[Sensor]) -> None:
    """Refuse constraints beyond the path, which they would bend at its end."""
    table, bearings = recording.constraints, recording.bearings
    if table is None or bearings is None:
        return
    # Time tags may be off by as much as the clocks.
    margin = _CLOCK_SIGMAS * max(sensor.errors.clock_offset_s for sensor in sensors)
    first, last = float(bearings.time_s.min()), float(bearings.time_s.max())
    # Empty times, which are NaN, are of the whole path.
    beyond = (table.time_s < first - margin) | (table.time_s > last + margin)
    if beyond.any():
        index = int(np.argmax(beyond))
        raise InputError(
            f"constraints, line {table.line[index]}, column time_s: {table.time_s[index]:.10g}, "
            f"and the bearings are from {first:.10g} to {last:.10g} s; expected a time among them, "
            "or an empty cell for the whole path",
            path=recording.path,
        )


def _span(bearings: Bearings) -> float:
    span = float(np.ptp(bearings.time_s))
    return span if span > 0.0 else 1.0


def without_refraction(bearings: Bearings, sensors: tuple[Sensor, ...]) -> Bearings:
    """Return bearings with mean refraction taken off the sensors that ask for it."""
    bent = np.array([sensor.refraction == "standard" for sensor in sensors])[bearings.sensor]
    if not bent.any():
        return bearings
    elevation = bearings.elevation_rad.copy()
    elevation[bent] -= refraction(elevation[bent])
    return replace(bearings, elevation_rad=elevation)


def correlation_weights(bearings: Bearings, sensors: tuple[Sensor, ...]) -> NDArray[np.float64]:
    """Return weights of the information for errors that are correlated and not modelled.

    n measurements of one sensor whose errors have the correlation rho count as
    n / (1 + (n - 1) rho) independent ones; rho = 1 is covariance intersection with equal weights,
    which add up to one (S. J. Julier, J. K. Uhlmann, *A non-divergent estimation algorithm in the
    presence of unknown correlations*, American Control Conference, 1997).

    Parameters
    ----------
    bearings
        The table.
    sensors
        In the order of their indices.
    """
    count = np.bincount(bearings.sensor, minlength=len(sensors))
    rho = np.array([sensor.correlation for sensor in sensors])
    return np.asarray((1.0 / (1.0 + (count - 1) * rho))[bearings.sensor])
