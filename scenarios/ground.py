"""Fireballs and aircraft seen from the ground by stations with wrong clocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from geograph.recording import SmoothSettings
from geograph.scenarios.observation import ecef_from_east_north_up
from geograph.scenarios.paths import SampledBody, StraightBody, fine_grid, sample_path
from geograph.scenarios.places import displaced, ecef
from geograph.scenarios.worlds import (
    Noise,
    Station,
    Streams,
    World,
    make_world,
    truth_table,
    uniform_times,
)
from geograph.sensors import SensorErrors

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.recording import Recording
    from geograph.scenarios.paths import Body

Target = Literal["fireball", "aircraft"]
GroundPath = Literal["straight", "prior"]


@dataclass(frozen=True, kw_only=True)
class _Nominal:
    """What a target does when nothing disturbs it, in metres, seconds and degrees."""

    duration_s: float
    height_m: float
    speed_m_s: float
    descent_deg: tuple[float, float]
    deceleration_m_s2: float
    nearest_m: float
    farthest_m: float
    noise: float
    noise_along: float | None
    truth_step_s: float


_NOMINAL: dict[Target, _Nominal] = {
    "fireball": _Nominal(
        duration_s=5.0,
        height_m=90e3,
        speed_m_s=14e3,
        descent_deg=(20.0, 40.0),
        deceleration_m_s2=200.0,
        nearest_m=30e3,
        farthest_m=120e3,
        noise=5.0,
        noise_along=100.0,
        truth_step_s=0.02,
    ),
    "aircraft": _Nominal(
        duration_s=60.0,
        height_m=10e3,
        speed_m_s=250.0,
        descent_deg=(0.0, 0.0),
        deceleration_m_s2=0.0,
        nearest_m=5e3,
        farthest_m=40e3,
        noise=0.2,
        noise_along=None,
        truth_step_s=0.2,
    ),
}


@dataclass(frozen=True, kw_only=True)
class GroundPass:
    """A kind of pass over stations on the ground (axes ``enu``).

    Parameters
    ----------
    target
        ``"fireball"``: 90 km high, 14 km/s, slowing down, 5 s; ``"aircraft"``: 10 km high, 250 m/s,
        60 s.
    path
        ``"prior"``: white noise on the jerk of the target's start, stronger along the velocity for
        the fireball; ``"straight"``: a straight line at constant speed in ECEF axes.
    stations, bearings
        Number of stations, and of bearings of each.
    sigma_rad
        White noise of each of two components of a bearing on the sky.
    bias_rad, drift_rad_s
        Standard deviations of the errors of azimuth and of elevation.
    clock_offset_s, clock_drift_s_s
        Standard deviations of the errors of all clocks but that of the first station.
    disciplined_s
        Standard deviation of the first station's clock offset.
    outliers
        Number of gross errors of the first station; the settings' loss is then ``"auto"``.

    Raises
    ------
    ValueError
        If the target or the path is unknown.
    """

    target: Target = "fireball"
    path: GroundPath = "prior"
    stations: int = 4
    bearings: int = 100
    sigma_rad: float = 3e-4
    bias_rad: float = 2e-4
    drift_rad_s: float = 0.0
    clock_offset_s: float = 1.0
    clock_drift_s_s: float = 0.0
    disciplined_s: float = 0.0
    outliers: int = 0

    def __post_init__(self) -> None:
        if self.target not in get_args(Target):
            raise ValueError(f"target {self.target!r}; expected one of {get_args(Target)}")
        if self.path not in get_args(GroundPath):
            raise ValueError(f"path {self.path!r}; expected one of {get_args(GroundPath)}")

    def settings(self) -> SmoothSettings:
        """Return the settings with which the path was drawn (for a line, with hardly any noise)."""
        nominal = _NOMINAL[self.target]
        drawn = self.path == "prior"
        return SmoothSettings(
            motion="constant-acceleration" if drawn else "constant-velocity",
            process_noise=nominal.noise if drawn else 0.1,
            process_noise_along=nominal.noise_along if drawn else None,
            loss="auto" if self.outliers else "none",
        )

    def errors(self, index: int) -> SensorErrors:
        """Return the prior standard deviations of one station's errors."""
        first = index == 0
        return SensorErrors(
            azimuth_bias_rad=self.bias_rad,
            elevation_bias_rad=self.bias_rad,
            azimuth_drift_rad_s=self.drift_rad_s,
            elevation_drift_rad_s=self.drift_rad_s,
            clock_offset_s=self.disciplined_s if first else self.clock_offset_s,
            clock_drift_s_s=0.0 if first else self.clock_drift_s_s,
        )


def ground_world(seed: int, kind: GroundPass | None = None) -> World:
    """Simulate one pass over the ground; the same seed and kind give the same world.

    Parameters
    ----------
    seed
        A whole number of at least 0.
    kind
        What the pass is like; None: :class:`GroundPass` as it stands.
    """
    kind = GroundPass() if kind is None else kind
    nominal = _NOMINAL[kind.target]
    streams = Streams.from_seed(seed)
    margin = 0.5 + 5.0 * max(kind.clock_offset_s, kind.disciplined_s)
    start = _random_start(streams.path, nominal)
    path = _ground_path(streams.path, start, kind, margin_s=margin)
    middle = start.latitude_longitude_deg(nominal.duration_s / 2.0)
    stations = []
    # Around the middle of the ground track, so that the lines of sight cross well.
    turn = streams.sensors.uniform(0.0, 360.0)
    for index in range(kind.stations):
        latitude, longitude = displaced(
            *middle,
            azimuth_deg=turn
            + 360.0 / kind.stations * (index + streams.sensors.uniform(-0.25, 0.25)),
            distance_m=streams.sensors.uniform(nominal.nearest_m, nominal.farthest_m),
        )
        place = ecef(latitude, longitude, streams.sensors.uniform(0.0, 1000.0))
        stations.append(
            Station(
                name=f"G{index + 1}",
                body=StraightBody(place),
                axes="enu",
                errors=kind.errors(index),
            )
        )
    return make_world(
        name=f"{kind.target}-{kind.path}-{seed}",
        path=path,
        stations=stations,
        times_s=uniform_times(streams.times, kind.stations, kind.bearings, nominal.duration_s),
        noise=Noise(sigma_rad=kind.sigma_rad, outliers=kind.outliers),
        streams=streams,
        settings=kind.settings(),
        truth=truth_table(
            path, (-margin + 0.1, nominal.duration_s + margin), step_s=nominal.truth_step_s
        ),
    )


def ground_pass(seed: int, **options: Any) -> Recording:
    """Return the recording of one simulated pass; see :func:`ground_world`, :class:`GroundPass`."""
    return ground_world(seed, GroundPass(**options)).recording


@dataclass(frozen=True, eq=False)
class _Start:
    """State of a target at time zero, ECEF, and where its ground track starts and leads."""

    state: NDArray[np.float64]
    latitude_deg: float
    longitude_deg: float
    heading_deg: float
    ground_speed_m_s: float

    def latitude_longitude_deg(self, time_s: float) -> tuple[float, float]:
        return displaced(
            self.latitude_deg,
            self.longitude_deg,
            azimuth_deg=self.heading_deg,
            distance_m=self.ground_speed_m_s * time_s,
        )


def _random_start(rng: np.random.Generator, nominal: _Nominal) -> _Start:
    latitude, longitude = rng.uniform(-60.0, 60.0), rng.uniform(-180.0, 180.0)
    heading, descent = rng.uniform(0.0, 360.0), rng.uniform(*nominal.descent_deg)
    place = ecef(latitude, longitude, nominal.height_m)
    level, down = np.cos(np.radians(descent)), np.sin(np.radians(descent))
    direction = ecef_from_east_north_up(
        place,
        np.array([level * np.sin(np.radians(heading)), level * np.cos(np.radians(heading)), -down]),
    )
    state = np.stack([place, nominal.speed_m_s * direction, -nominal.deceleration_m_s2 * direction])
    return _Start(state, latitude, longitude, heading, nominal.speed_m_s * level)


def _ground_path(
    rng: np.random.Generator, start: _Start, kind: GroundPass, *, margin_s: float
) -> Body:
    position, velocity, acceleration = start.state
    if kind.path == "straight":
        return StraightBody(position, velocity)
    nominal = _NOMINAL[kind.target]
    first, last = -margin_s, nominal.duration_s + margin_s
    grid = fine_grid(
        (first, last),
        order=3,
        noise=max(nominal.noise, nominal.noise_along or 0.0),
        longest_step_s=0.05,
    )
    initial = np.stack(
        [
            position + first * velocity + 0.5 * first**2 * acceleration,
            velocity + first * acceleration,
            acceleration,
        ]
    )
    state = sample_path(rng, grid, initial, noise=nominal.noise, along=nominal.noise_along)
    return SampledBody(grid, state)
