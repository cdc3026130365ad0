"""Simulated recordings of arrival times, time and frequency differences, and bearings, together.

As in :mod:`geograph.scenarios.worlds`, the random numbers come from independent streams of one
seed: worlds that differ in their path agree in their errors and their noise.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.constants import EARTH_ROTATION_RAD_S, SPEED_OF_LIGHT_M_S
from geograph.measurements import (
    Arrivals,
    Bearings,
    Constraints,
    FrequencyDifferences,
    TimeDifferences,
    Truth,
)
from geograph.recording import Recording, SmoothSettings
from geograph.scenarios.observation import observe_bearings
from geograph.scenarios.paths import StraightBody
from geograph.scenarios.places import geodetic
from geograph.scenarios.radio_errors import (
    Histories,
    ReceiverErrors,
    draw_histories,
    draw_receiver_errors,
)
from geograph.scenarios.radio_plans import (
    ArrivalPlan,
    BearingPlan,
    Grid,
    Plan,
    Rows,
    SignalPlan,
    TimePlan,
    arrival_table,
    frequency_table,
    time_table,
)
from geograph.scenarios.radio_reception import receive
from geograph.scenarios.sensor_errors import add_sky_noise
from geograph.scenarios.worlds import EPOCH, Streams
from geograph.sensors import Sensor, SensorErrors, Trajectory

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.recording import Frame
    from geograph.scenarios.observation import SeenAxes
    from geograph.scenarios.paths import Body


@dataclass(frozen=True, eq=False, kw_only=True)
class Receiver:
    """A simulated receiver, or any other sensor of a recording.

    Parameters
    ----------
    name
        Its name in the recording.
    body
        Where it really is.
    errors
        Prior standard deviations, from which its errors are drawn.
    axes
        Axes of its bearings.
    table_s
        Times of the rows of the trajectory in the recording, seconds; None: the receiver stands
        still, and its position is recorded. With ``errors.position_noise_m`` every row is wrong by
        that, independently on each axis.
    platform_process_noise
        As of :class:`geograph.sensors.Sensor`.
    """

    name: str
    body: Body
    errors: SensorErrors = field(default_factory=SensorErrors)
    axes: SeenAxes = "xyz"
    table_s: NDArray[np.float64] | None = None
    platform_process_noise: float | None = None

    def sensor(self, rng: np.random.Generator, wrong: ReceiverErrors) -> Sensor:
        """Return the sensor as the recording has it: in the wrong place."""
        position, trajectory = None, None
        if self.table_s is None:
            position = self.body.position_at(0.0) - np.array(wrong.position_m)
        else:
            noise = self.errors.position_noise_m * rng.standard_normal((self.table_s.size, 3))
            there = self.body.position_at(self.table_s)
            trajectory = Trajectory(self.table_s, there - np.array(wrong.position_m) + noise)
        return Sensor(
            name=self.name,
            position_m=position,
            trajectory=trajectory,
            axes=self.axes,
            errors=self.errors,
            platform_process_noise=self.platform_process_noise,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class RadioWorld:
    """A recording with all that a real one hides.

    Parameters
    ----------
    recording
        What a smoother gets, with the truth table.
    path
        The object.
    receivers
        Where the sensors really are, in the order of the recording.
    errors
        The errors of each sensor, by its name.
    propagation_speed_m_s
        The true one.
    rows
        What each table hides, by its name.
    """

    recording: Recording
    path: Body
    receivers: tuple[Receiver, ...]
    errors: dict[str, ReceiverErrors]
    propagation_speed_m_s: float
    rows: dict[str, Rows]


@dataclass(frozen=True, kw_only=True)
class Altitude:
    """Altitudes known beside the measurements, as from a barometer or a map.

    Parameters
    ----------
    sigma_m
        Their standard deviation.
    count
        Number of times, spread evenly over the recording, each with an error of its own; 0: one
        value, ``value_m``, for the whole path.
    value_m
        The value along the whole path, without an error.
    """

    sigma_m: float
    count: int = 0
    value_m: float = 0.0


def make_radio_world(
    *,
    name: str,
    path: Body,
    receivers: Sequence[Receiver],
    plans: Sequence[Plan],
    streams: Streams,
    settings: SmoothSettings,
    truth: Truth,
    frame: Frame = "ecef",
    propagation_speed_m_s: float = SPEED_OF_LIGHT_M_S,
    propagation_sigma_m_s: float = 0.0,
    altitude: Altitude | None = None,
) -> RadioWorld:
    """Let receivers hear an object and return the recording with what it hides.

    Parameters
    ----------
    name
        Name of the recording.
    path
        The object.
    receivers
        The sensors.
    plans
        What is measured; at most one plan for each table.
    streams
        Sources of randomness.
    settings, truth, frame
        As in the recording.
    propagation_speed_m_s, propagation_sigma_m_s
        As in the recording; the true speed is drawn about the first with the second.
    altitude
        Altitudes that the recording has as constraints, or None.

    Raises
    ------
    ValueError
        If two plans are of one table.
    """
    if len({type(plan) for plan in plans}) < len(plans):
        raise ValueError("two plans of one kind; expected at most one for each table")
    errors = [draw_receiver_errors(streams.errors, receiver.errors) for receiver in receivers]
    speed = propagation_speed_m_s + propagation_sigma_m_s * float(streams.errors.standard_normal())
    world = _World(path, tuple(receivers), errors, frame, speed)
    tables, rows = _measure(world, plans, streams)
    recording = Recording(
        name=name,
        frame=frame,
        sensors={
            receiver.name: receiver.sensor(streams.sensors, wrong)
            for receiver, wrong in zip(receivers, errors, strict=True)
        },
        truth=truth,
        epoch=EPOCH if frame == "ecef" else None,
        propagation_speed_m_s=propagation_speed_m_s,
        propagation_sigma_m_s=propagation_sigma_m_s,
        settings=settings,
        **tables,
    )
    if altitude is not None:
        constraints = _altitudes(world, altitude, recording.time_span_s, streams.noise)
        recording = replace(recording, constraints=constraints)
    return RadioWorld(
        recording=recording,
        path=path,
        receivers=world.receivers,
        errors=dict(zip(recording.sensor_names, errors, strict=True)),
        propagation_speed_m_s=speed,
        rows=rows,
    )


@dataclass(frozen=True, eq=False)
class _World:
    """What is true."""

    path: Body
    receivers: tuple[Receiver, ...]
    errors: list[ReceiverErrors]
    frame: Frame
    speed_m_s: float

    @property
    def rotation_rad_s(self) -> float:
        return EARTH_ROTATION_RAD_S if self.frame == "ecef" else 0.0

    def height_m(self, position_m: NDArray[np.float64]) -> float:
        if self.frame == "local":
            return float(position_m[2])
        return geodetic(position_m)[2]


def _measure(
    world: _World, plans: Sequence[Plan], streams: Streams
) -> tuple[dict[str, Any], dict[str, Rows]]:
    """Return the tables of the plans, and what they hide, by their names."""
    received = [
        [
            receive(
                world.path,
                world.receivers[index].body,
                plan.emission_time_s,
                propagation_speed_m_s=world.speed_m_s,
                rotation_rad_s=world.rotation_rad_s,
            )
            for index in plan.receivers
        ]
        if not isinstance(plan, BearingPlan)
        else []
        for plan in plans
    ]
    times = [
        _receptions(plan, [one.delay_s for one in found])
        for plan, found in zip(plans, received, strict=True)
    ]
    who = [
        np.broadcast_to(np.array(plan.receivers), part.shape)
        for plan, part in zip(plans, times, strict=True)
    ]
    # One history for all tables: a receiver has one clock, whatever it measures.
    histories = draw_histories(
        streams.walks,
        world.errors,
        np.concatenate([part.ravel() for part in who]),
        np.concatenate([part.ravel() for part in times]),
    )
    end = np.cumsum([part.size for part in times])
    tables: dict[str, Any] = {}
    rows: dict[str, Rows] = {}
    for plan, found, part, last in zip(plans, received, times, end, strict=True):
        own = histories.part(slice(int(last) - part.size, int(last)), part.shape)
        table: Bearings | Arrivals | TimeDifferences | FrequencyDifferences
        if isinstance(plan, BearingPlan):
            label = "bearings"
            table, hidden = _bearings(world, plan, own, streams.noise)
        else:
            grid = Grid.of(plan.emission_time_s, found, own)
            label, table, hidden = _signals(plan, grid, len(world.receivers), streams)
        tables[label], rows[label] = table, hidden
    return tables, rows


def _receptions(plan: Plan, delays: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return true times of reception, shape (emissions, receivers)."""
    if isinstance(plan, BearingPlan):
        return np.repeat(plan.reception_time_s[:, None], len(plan.receivers), axis=1)
    return plan.emission_time_s[:, None] + np.stack(delays, axis=1)


def _signals(
    plan: SignalPlan, grid: Grid, sensors: int, streams: Streams
) -> tuple[str, Arrivals | TimeDifferences | FrequencyDifferences, Rows]:
    noise = streams.noise
    if isinstance(plan, ArrivalPlan):
        return (
            "arrivals",
            *arrival_table(plan, grid, sensors=sensors, noise=noise, gross=streams.outliers),
        )
    if isinstance(plan, TimePlan):
        return "time_differences", *time_table(plan, grid, sensors=sensors, noise=noise)
    return "frequency_differences", *frequency_table(plan, grid, sensors=sensors, noise=noise)


def _bearings(
    world: _World, plan: BearingPlan, errors: Histories, rng: np.random.Generator
) -> tuple[Bearings, Rows]:
    count = plan.reception_time_s.size
    sensor = np.repeat(np.array(plan.receivers, dtype=np.int64), count)
    time = np.tile(plan.reception_time_s, len(plan.receivers))
    seen = observe_bearings(
        world.path,
        [receiver.body for receiver in world.receivers],
        time,
        sensor,
        axes=[receiver.axes for receiver in world.receivers],
        frame=world.frame,
        propagation_speed_m_s=world.speed_m_s,
    )
    azimuth = seen.azimuth_rad + errors.azimuth_rad.T.ravel()
    elevation = seen.elevation_rad + errors.elevation_rad.T.ravel()
    offset = plan.sigma_rad * rng.standard_normal((time.size, 2))
    for index in plan.receivers:
        rows = sensor == index
        azimuth[rows], elevation[rows] = add_sky_noise(
            azimuth[rows], elevation[rows], offset[rows], axes=world.receivers[index].axes
        )
    tag = time + errors.clock_s.T.ravel()
    order = np.argsort(tag, kind="stable")
    sigma = np.full(time.size, plan.sigma_rad)
    table = Bearings(
        time_s=tag[order],
        sensor=sensor[order],
        azimuth_rad=azimuth[order],
        elevation_rad=elevation[order],
        sigma_azimuth_rad=sigma,
        sigma_elevation_rad=sigma.copy(),
        isotropic=np.full(time.size, True),
        line=np.zeros(time.size, dtype=np.int64),
    )
    outlier = np.zeros(time.size, dtype=bool)
    exact = seen.azimuth_rad[order]
    return table, Rows(seen.emission_time_s[order], time[order], exact, outlier)


def _altitudes(
    world: _World, altitude: Altitude, span_s: tuple[float, float], rng: np.random.Generator
) -> Constraints:
    if altitude.count == 0:
        time, value = np.array([np.nan]), np.array([altitude.value_m])
    else:
        time = np.linspace(*span_s, altitude.count)
        there = world.path.position_at(time)
        value = np.array([world.height_m(place) for place in there])
        value += altitude.sigma_m * rng.standard_normal(altitude.count)
    return Constraints(
        time_s=time,
        kind=tuple("altitude_m" for _ in time),
        value=value,
        sigma=np.full(time.size, altitude.sigma_m),
        line=np.zeros(time.size, dtype=np.int64),
    )


def fixed_receivers(
    places_m: Sequence[NDArray[np.float64]], errors: Sequence[SensorErrors], *, prefix: str = "R"
) -> list[Receiver]:
    """Return receivers that stand still, named by a prefix and a number from 1.

    Parameters
    ----------
    places_m
        True positions, each of shape (3,), metres.
    errors
        Prior standard deviations of each.
    prefix
        Start of the names.
    """
    return [
        Receiver(name=f"{prefix}{index + 1}", body=StraightBody(place), errors=own)
        for index, (place, own) in enumerate(zip(places_m, errors, strict=True))
    ]
