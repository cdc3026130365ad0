"""Flights whose process noise changes in known stages, in a room without errors but white noise.

What finds stages can be judged here: paths are drawn from the smoother's own prior, with another
density in every stage, so that the noise of each and the times in between are known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from geograph.measurements import Arrivals, Bearings, Truth
from geograph.recording import Recording, SmoothSettings
from geograph.scenarios.paths import sample_path
from geograph.scenarios.sensor_errors import slow_errors
from geograph.sensors import Sensor

if TYPE_CHECKING:
    from numpy.typing import NDArray

Motion = Literal["constant-velocity", "constant-acceleration", "ballistic"]
Measured = Literal["bearings", "arrivals"]

_FALL_M_S2 = 9.80665
_ORDERS: dict[Motion, int] = {
    "constant-velocity": 2,
    "constant-acceleration": 3,
    "ballistic": 2,
}


@dataclass(frozen=True, kw_only=True)
class StagedNoise:
    """A kind of flight.

    Parameters
    ----------
    motion
        Whose noise drives the object.
    measured
        ``"bearings"``: azimuth and elevation by four sensors in turn; ``"arrivals"``: signals that
        five sensors hear.
    noise
        Square root of the spectral density in each stage, SI.
    events
        Bearings, or signals.
    duration_s
        Length of the flight. Stages end at random times, none shorter than half of its even share.
    size_m
        Half of the side of the square at whose corners the sensors stand.
    sigma_rad, sigma_m
        White noise of a bearing, on the sky, and of an arrival time, as a length.
    slow_rad, slow_s
        Standard deviation of another error of the bearings, on the sky, each sensor's own and not
        told in the recording, and the time after which its correlation is 1/e.

    Raises
    ------
    ValueError
        If the motion or what is measured is unknown.
    """

    motion: Motion = "constant-velocity"
    measured: Measured = "bearings"
    noise: tuple[float, ...] = (0.3, 10.0, 0.3)
    events: int = 300
    duration_s: float = 120.0
    size_m: float = 2000.0
    sigma_rad: float = 1e-3
    sigma_m: float = 3.0
    slow_rad: float = 0.0
    slow_s: float = 5.0

    def __post_init__(self) -> None:
        if self.motion not in get_args(Motion) or self.measured not in get_args(Measured):
            raise ValueError(
                f"motion {self.motion!r}, measured {self.measured!r}; expected one of "
                f"{get_args(Motion)}, and of {get_args(Measured)}"
            )


@dataclass(frozen=True, eq=False)
class StagedFlight:
    """A recording, and when its stages really began.

    Attributes
    ----------
    recording
        Its settings have the true noise of every stage.
    boundary_s
        Shape (stages - 1,).
    """

    recording: Recording
    boundary_s: NDArray[np.float64]


def staged_flight(seed: int, kind: StagedNoise | None = None) -> StagedFlight:
    """Simulate a flight; the same seed and kind give the same one, bit for bit.

    Parameters
    ----------
    seed
        A whole number of at least 0.
    kind
        What it is like; None: :class:`StagedNoise` as it stands.
    """
    kind = StagedNoise() if kind is None else kind
    rng = np.random.default_rng(seed)
    boundary = _boundaries(rng, len(kind.noise), kind.duration_s)
    time = np.sort(rng.uniform(0.0, kind.duration_s, kind.events))
    truth = np.linspace(0.0, kind.duration_s, 121)
    every = np.unique(np.concatenate([time, truth, boundary]))
    path = _path(rng, kind, every, boundary)
    position = path[np.searchsorted(every, time), 0]
    known = path[np.searchsorted(every, truth)]
    names, places = _places(kind)
    bearings = arrivals = None
    if kind.measured == "bearings":
        bearings = _bearings(rng, kind, time, position, places)
    else:
        arrivals = _arrivals(rng, kind, time, position, places)
    settings = SmoothSettings(
        motion=kind.motion,
        process_noise=kind.noise[0],
        stages=tuple(
            (float(start), value / kind.noise[0])
            for start, value in zip(boundary, kind.noise[1:], strict=True)
        )
        or None,
        loss="none",
    )
    recording = Recording(
        name=f"staged-noise-{seed}",
        frame="local",
        sensors={
            name: Sensor(name=name, position_m=place, axes="xyz")
            for name, place in zip(names, places, strict=True)
        },
        bearings=bearings,
        arrivals=arrivals,
        truth=Truth(time_s=truth, position_m=known[:, 0], velocity_m_s=known[:, 1]),
        propagation_speed_m_s=float("inf") if arrivals is None else 299792458.0,
        settings=settings,
    )
    return StagedFlight(recording, boundary)


def _boundaries(rng: np.random.Generator, stages: int, duration_s: float) -> NDArray[np.float64]:
    shares = 0.5 + 0.5 * stages * rng.dirichlet(np.ones(stages))
    return np.asarray(duration_s * np.cumsum(shares)[:-1] / stages)


def _path(
    rng: np.random.Generator,
    kind: StagedNoise,
    time_s: NDArray[np.float64],
    boundary_s: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return states at given times, shape (n, m, 3), drawn stage after stage."""
    order = _ORDERS[kind.motion]
    state = np.zeros((order, 3))
    state[0] = rng.uniform(-0.5, 0.5, 3) * kind.size_m + [0.0, 0.0, 1.5 * kind.size_m]
    state[1, :2] = rng.normal(size=2) * kind.size_m / kind.duration_s
    found = np.empty((time_s.size, order, 3))
    edges = np.searchsorted(time_s, [0.0, *boundary_s, kind.duration_s])
    for first, last, noise in zip(edges[:-1], edges[1:], kind.noise, strict=True):
        own = slice(first, last + 1)
        found[own] = sample_path(rng, time_s[own], state, noise=noise)
        state = found[last]
    if kind.motion == "ballistic":
        found[:, 0, 2] -= 0.5 * _FALL_M_S2 * time_s**2
        found[:, 1, 2] -= _FALL_M_S2 * time_s
        # Thrown so high that it comes back to where it was.
        found[:, 0, 2] += 0.5 * _FALL_M_S2 * kind.duration_s * time_s
        found[:, 1, 2] += 0.5 * _FALL_M_S2 * kind.duration_s
    return found


def _places(kind: StagedNoise) -> tuple[list[str], NDArray[np.float64]]:
    corners = [(x, y, 0.0) for x in (-1.0, 1.0) for y in (-1.0, 1.0)]
    # The fifth is not in their plane, from which arrival times alone could not tell up from down.
    places = kind.size_m * np.array([*corners, (0.2, -0.1, 0.8)])
    count = 4 if kind.measured == "bearings" else 5
    return [f"S{i + 1}" for i in range(count)], places[:count]


def _bearings(
    rng: np.random.Generator,
    kind: StagedNoise,
    time_s: NDArray[np.float64],
    position_m: NDArray[np.float64],
    places_m: NDArray[np.float64],
) -> Bearings:
    count = time_s.size
    sensor = np.arange(count) % len(places_m)
    away = position_m - places_m[sensor]
    level = np.hypot(away[:, 0], away[:, 1])
    azimuth, elevation = np.arctan2(away[:, 1], away[:, 0]), np.arctan2(away[:, 2], level)
    error = kind.sigma_rad * rng.standard_normal((2, count))
    for index in range(len(places_m) if kind.slow_rad else 0):
        own = sensor == index
        error[:, own] += kind.slow_rad * slow_errors(rng, time_s[own], kind.slow_s)
    return Bearings(
        time_s=time_s,
        sensor=sensor,
        azimuth_rad=azimuth + error[0] / np.cos(elevation),
        elevation_rad=elevation + error[1],
        sigma_azimuth_rad=np.full(count, kind.sigma_rad),
        sigma_elevation_rad=np.full(count, kind.sigma_rad),
        isotropic=np.ones(count, dtype=bool),
        line=np.zeros(count, dtype=np.int64),
    )


def _arrivals(
    rng: np.random.Generator,
    kind: StagedNoise,
    time_s: NDArray[np.float64],
    position_m: NDArray[np.float64],
    places_m: NDArray[np.float64],
) -> Arrivals:
    sensors = len(places_m)
    way = np.linalg.norm(position_m[:, None] - places_m, axis=2)
    way += kind.sigma_m * rng.standard_normal(way.shape)
    arrival = time_s[:, None] + way / 299792458.0
    return Arrivals(
        emission=np.repeat(np.arange(time_s.size), sensors),
        sensor=np.tile(np.arange(sensors), time_s.size),
        toa_s=arrival.ravel(),
        sigma_s=np.full(arrival.size, kind.sigma_m / 299792458.0),
        line=np.zeros(arrival.size, dtype=np.int64),
    )
