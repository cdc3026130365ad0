"""Simulated worlds: an object, sensors with errors, and the recording that these make.

The random numbers of a world come from independent streams of one seed (path, sensors, times,
errors, noise, outliers, calibrations), so that two worlds that differ in one of them agree in the
others.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.measurements import Bearings, Truth
from geograph.recording import Recording, SmoothSettings
from geograph.scenarios.observation import observe_bearings
from geograph.scenarios.paths import StraightBody
from geograph.scenarios.sensor_errors import (
    Draw,
    TrueErrors,
    add_sky_noise,
    correlated_normals,
    draw_errors,
    draw_outliers,
    jumped,
    stretch_history,
)
from geograph.scenarios.sensor_truth import SensorTruth
from geograph.sensors import Sensor, SensorErrors, Trajectory

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.recording import Frame
    from geograph.scenarios.accelerometer import AccumulatedBias
    from geograph.scenarios.observation import SeenAxes
    from geograph.scenarios.paths import Body

EPOCH = datetime(2026, 1, 1, tzinfo=UTC)
"""Time zero of every simulated recording on the Earth."""


@dataclass(frozen=True, eq=False)
class Streams:
    """Independent sources of randomness of one world."""

    path: np.random.Generator
    sensors: np.random.Generator
    times: np.random.Generator
    errors: np.random.Generator
    walks: np.random.Generator
    noise: np.random.Generator
    outliers: np.random.Generator
    calibrations: np.random.Generator

    @classmethod
    def from_seed(cls, seed: int) -> Streams:
        """Return the streams of a seed, a whole number of at least 0."""
        return cls(*(np.random.default_rng(part) for part in np.random.SeedSequence(seed).spawn(8)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Station:
    """A simulated sensor.

    Parameters
    ----------
    name
        Its name in the recording.
    body
        Where it is.
    axes
        ``"enu"`` or ``"xyz"``.
    errors
        Prior standard deviations, from which its errors are drawn.
    correlation
        Correlation of its noise from one measurement to all others.
    accumulated
        Pointing errors that add to those which ``errors`` describe.
    calibration_s
        Shape (k,): times at which the errors of pointing begin anew, seconds.
    jump_rad
        By how much they then jump; None: they are drawn again.
    calibrations_known
        Whether the recording has those times, or says that there are some.
    table_step_s
        Step of the trajectory in the recording of a sensor that moves, seconds. At 2 s the cubic
        spline through a low orbit is good to 0.1 mm.
    """

    name: str
    body: Body
    axes: SeenAxes
    errors: SensorErrors = field(default_factory=SensorErrors)
    correlation: float = 0.0
    accumulated: AccumulatedBias | None = None
    calibration_s: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    jump_rad: float | None = None
    calibrations_known: bool = True
    table_step_s: float = 2.0

    def sensor(self, span_s: tuple[float, float]) -> Sensor:
        """Return the sensor as the recording knows it, over a span in seconds."""
        position, trajectory = None, None
        if isinstance(self.body, StraightBody) and self.body.velocity_m_s is None:
            position = self.body.position_m
        else:
            nodes = max(int(np.ceil((span_s[1] - span_s[0]) / self.table_step_s)) + 1, 4)
            time = np.linspace(span_s[0], span_s[1], nodes)
            trajectory = Trajectory(time, np.asarray(self.body.position_at(time)))
        known = tuple(self.calibration_s.tolist())
        return Sensor(
            name=self.name,
            position_m=position,
            trajectory=trajectory,
            axes=self.axes,
            errors=self.errors,
            correlation=self.correlation,
            calibrations_s=known if self.calibrations_known else "auto",
        )

    def drawn(self, rng: np.random.Generator, draw: Draw, start_s: float) -> list[TrueErrors]:
        """Return its errors before the first calibration, and after each, from a start, seconds."""
        stretches = [draw_errors(rng, self.errors, draw=draw)]
        for begun, ended in pairwise([start_s, *self.calibration_s.tolist()]):
            before = stretches[-1]
            if self.jump_rad is not None:
                stretches.append(jumped(rng, before, ended - begun, self.jump_rad))
                continue
            after = draw_errors(rng, self.errors, draw=draw)
            # What is wrong with its clock is no matter of pointing.
            clock = {n: getattr(before, n) for n in vars(before) if n.startswith("clock")}
            stretches.append(replace(after, **clock))
        return stretches


@dataclass(frozen=True, eq=False, kw_only=True)
class World:
    """A recording with all that a real one hides.

    Parameters
    ----------
    recording
        What a smoother gets, with the truth table.
    path
        The object.
    errors
        The errors of each sensor, by its name.
    reception_time_s, emission_time_s
        Shape (n,): true times of the rows of ``recording.bearings``, seconds.
    outlier
        Shape (n,), bool: which rows are gross errors.
    sensor_truth
        The errors of every sensor at its measurements, and its calibrations.
    """

    recording: Recording
    path: Body
    errors: dict[str, TrueErrors]
    reception_time_s: NDArray[np.float64]
    emission_time_s: NDArray[np.float64]
    outlier: NDArray[np.bool_]
    sensor_truth: SensorTruth


def uniform_times(
    rng: np.random.Generator, sensors: int, bearings: int, duration_s: float
) -> list[NDArray[np.float64]]:
    """Return sorted times of every sensor, uniform from 0 to the duration, no two the same."""
    times = rng.uniform(0.0, duration_s, (sensors, bearings))
    if np.unique(times).size != times.size:
        return uniform_times(rng, sensors, bearings, duration_s)
    return list(np.sort(times, axis=1))


def truth_table(
    path: Body, span_s: tuple[float, float], *, step_s: float, velocity: bool = True
) -> Truth:
    """Return the truth over a span at a step, seconds, with or without the velocity."""
    nodes = int(np.ceil((span_s[1] - span_s[0]) / step_s)) + 1
    time = np.linspace(span_s[0], span_s[1], nodes)
    return Truth(
        time_s=time,
        position_m=path.position_at(time),
        velocity_m_s=path.velocity_at(time) if velocity else None,
    )


@dataclass(frozen=True, kw_only=True)
class Noise:
    """White noise and gross errors of the bearings.

    Parameters
    ----------
    sigma_rad
        Standard deviation of each of two components on the sky or, where ``per_coordinate``, of
        azimuth and of elevation.
    per_coordinate
        Whether the noise is added to azimuth and elevation themselves.
    outliers
        Number of gross errors, all of one sensor.
    outlier_rad
        How far off they are; None: anywhere on the sphere.
    """

    sigma_rad: float
    per_coordinate: bool = False
    outliers: int = 0
    outlier_rad: float | None = None


def make_world(
    *,
    name: str,
    path: Body,
    stations: Sequence[Station],
    times_s: Sequence[NDArray[np.float64]],
    noise: Noise,
    streams: Streams,
    settings: SmoothSettings,
    truth: Truth,
    frame: Frame = "ecef",
    propagation_speed_m_s: float = SPEED_OF_LIGHT_M_S,
    draw: Draw = "normal",
) -> World:
    """Let sensors observe an object and return the recording with what it hides.

    Parameters
    ----------
    name
        Name of the recording.
    path
        The object.
    stations
        The sensors; the gross errors are those of the first.
    times_s
        For each sensor its true times of reception, sorted, seconds.
    noise
        Noise and gross errors.
    streams
        Sources of randomness.
    settings, truth, frame, propagation_speed_m_s
        As in the recording.
    draw
        How the errors are drawn, see :func:`geograph.scenarios.sensor_errors.draw_errors`.

    Raises
    ------
    ValueError
        If there are more gross errors than measurements of the first sensor.
    """
    if noise.outliers > times_s[0].size:
        raise ValueError(f"{noise.outliers} outliers of {times_s[0].size} measurements")
    time = np.concatenate(list(times_s))
    sensor = np.repeat(np.arange(len(stations)), [part.size for part in times_s])
    seen = observe_bearings(
        path,
        [station.body for station in stations],
        time,
        sensor,
        axes=[station.axes for station in stations],
        frame=frame,
        propagation_speed_m_s=propagation_speed_m_s,
    )
    azimuth, elevation, tag = seen.azimuth_rad.copy(), seen.elevation_rad.copy(), time.copy()
    errors = {}
    wrongs = np.empty((time.size, 3))
    start = float(time.min())
    for index, station in enumerate(stations):
        rows = sensor == index
        truths = station.drawn(streams.errors, draw, start)
        wrong = stretch_history(
            streams.walks, truths, station.calibration_s - start, time[rows] - start
        )
        errors[station.name] = truths[0]
        tag[rows] += wrong.clock_s
        held = station.accumulated
        more = np.zeros((int(rows.sum()), 2)) if held is None else held.at(time[rows])
        wrongs[rows] = np.stack(
            [wrong.azimuth_rad + more[:, 0], wrong.elevation_rad + more[:, 1], wrong.clock_s],
            axis=1,
        )
        azimuth[rows], elevation[rows] = _measure(
            streams.noise,
            azimuth[rows] + wrong.azimuth_rad + more[:, 0],
            elevation[rows] + wrong.elevation_rad + more[:, 1],
            noise=noise,
            station=station,
        )
    outlier = np.zeros(time.size, dtype=bool)
    outlier[streams.outliers.permutation(times_s[0].size)[: noise.outliers]] = True
    azimuth[outlier], elevation[outlier] = draw_outliers(
        streams.outliers,
        azimuth[outlier],
        elevation[outlier],
        axes=stations[0].axes,
        offset_rad=noise.outlier_rad,
    )
    order = np.argsort(tag, kind="stable")
    sigma = np.full(time.size, noise.sigma_rad)
    recording = Recording(
        name=name,
        frame=frame,
        sensors={station.name: station.sensor(_table_span(tag, station)) for station in stations},
        bearings=Bearings(
            time_s=tag[order],
            sensor=sensor[order],
            azimuth_rad=azimuth[order],
            elevation_rad=elevation[order],
            sigma_azimuth_rad=sigma,
            sigma_elevation_rad=sigma.copy(),
            isotropic=np.full(time.size, not noise.per_coordinate),
            line=np.zeros(time.size, dtype=np.int64),
        ),
        truth=truth,
        epoch=EPOCH if frame == "ecef" else None,
        propagation_speed_m_s=propagation_speed_m_s,
        settings=settings,
    )
    return World(
        recording=recording,
        path=path,
        errors=errors,
        reception_time_s=time[order],
        emission_time_s=seen.emission_time_s[order],
        outlier=outlier[order],
        sensor_truth=SensorTruth(
            names=tuple(station.name for station in stations),
            time_s=tag[order],
            sensor=sensor[order],
            error=wrongs[order],
            calibration_s=tuple(map(_calibrations, stations)),
        ),
    )


def _calibrations(station: Station) -> NDArray[np.float64]:
    if station.accumulated is not None:
        return station.accumulated.calibration_s
    return station.calibration_s


def _measure(
    rng: np.random.Generator,
    azimuth_rad: NDArray[np.float64],
    elevation_rad: NDArray[np.float64],
    *,
    noise: Noise,
    station: Station,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Add the noise; a direction pushed over the pole comes back on its other side."""
    pair = noise.sigma_rad * correlated_normals(rng, azimuth_rad.size, station.correlation)
    if noise.per_coordinate:
        azimuth_rad, elevation_rad = azimuth_rad + pair[:, 0], elevation_rad + pair[:, 1]
        pair = np.zeros_like(pair)
    return add_sky_noise(azimuth_rad, elevation_rad, pair, axes=station.axes)


def _table_span(tag: NDArray[np.float64], station: Station) -> tuple[float, float]:
    """Return the span that a smoother may ask for while it looks for a clock offset."""
    margin = 10.0 + 10.0 * station.errors.clock_offset_s
    return float(tag.min()) - margin, float(tag.max()) + margin
