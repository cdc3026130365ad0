"""Fireballs seen by cameras whose lines of sight are off in a way that changes slowly.

What finds the process noise can be judged here where measurements are worse than white: every
camera has, beside its white noise, an error of both angles with a correlation in time (what is left
of a lens's distortion and of a plate's reduction as the object moves across the picture). Its
recording says nothing of it. Paths are drawn from the smoother's own prior, so that their noise is
known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.measurements import Bearings, Truth
from geograph.recording import Recording, SmoothSettings
from geograph.scenarios.paths import sample_path
from geograph.scenarios.sensor_errors import slow_errors
from geograph.scenarios.worlds import Streams
from geograph.sensors import Sensor, SensorErrors

if TYPE_CHECKING:
    from numpy.typing import NDArray

_SPEED_M_S = 14e3
_FIRST_CLOCK_S = 0.01


@dataclass(frozen=True, kw_only=True)
class Fireball:
    """A kind of fireball and of cameras.

    Parameters
    ----------
    cameras
        How many there are, 60 to 180 km from the middle of the path, all around it.
    across, along
        Square root of the spectral density of the noise on the acceleration, m/s^2.5.
    slow
        Standard deviation of the slow error of both angles, in sigmas of the white noise.
    slow_s
        Time after which the slow error's correlation is 1/e.
    sigma_deg
        White noise of a camera: between these, its logarithm uniform.
    frames_s
        Frames a second.
    duration_s
        How long the object shines. The first two cameras see all of it, the others about half.
    bias_deg, clock_s
        Prior sigmas of constant errors. The first camera's clock is known to 10 ms.
    """

    cameras: int = 5
    across: float = 3.0
    along: float = 300.0
    slow: float = 1.0
    slow_s: float = 1.0
    sigma_deg: tuple[float, float] = (0.01, 0.1)
    frames_s: float = 25.0
    duration_s: float = 8.0
    bias_deg: float = 0.02
    clock_s: float = 0.5


def fireball(seed: int, kind: Fireball | None = None) -> Recording:
    """Simulate a fireball; the same seed and kind give the same recording, bit for bit.

    Parameters
    ----------
    seed
        A whole number of at least 0.
    kind
        What it is like; None: :class:`Fireball` as it stands.
    """
    kind = Fireball() if kind is None else kind
    streams = Streams.from_seed(seed)
    places, seen = _cameras(streams.sensors, kind)
    frames = [np.arange(low, high, 1.0 / kind.frames_s) for low, high in seen]
    truth = np.linspace(0.0, kind.duration_s, 81)
    every = np.unique(np.concatenate([truth, *frames]))
    path = _path(streams.path, kind, every)
    known = path[np.searchsorted(every, truth)]
    clock = np.array([_FIRST_CLOCK_S, *[kind.clock_s] * (kind.cameras - 1)])
    bias = np.radians(kind.bias_deg)
    return Recording(
        name=f"fireball-{seed}",
        frame="local",
        sensors={
            f"C{index + 1}": Sensor(
                name=f"C{index + 1}",
                position_m=place,
                axes="xyz",
                errors=SensorErrors(
                    azimuth_bias_rad=bias,
                    elevation_bias_rad=bias,
                    clock_offset_s=float(clock[index]),
                ),
            )
            for index, place in enumerate(places)
        },
        bearings=_bearings(
            streams,
            kind,
            frames,
            positions_m=[path[np.searchsorted(every, time), 0] for time in frames],
            places_m=places,
            late_s=clock * streams.errors.standard_normal(kind.cameras),
        ),
        truth=Truth(time_s=truth, position_m=known[:, 0], velocity_m_s=known[:, 1]),
        propagation_speed_m_s=float("inf"),
        settings=SmoothSettings(
            motion="constant-acceleration",
            process_noise=kind.across,
            process_noise_along=kind.along,
            loss="cauchy",
        ),
    )


def _cameras(
    rng: np.random.Generator, kind: Fireball
) -> tuple[NDArray[np.float64], list[tuple[float, float]]]:
    """Return places, shape (cameras, 3), and from when until when each sees the object."""
    count = kind.cameras
    turn = rng.uniform(0.0, 1.0) + (np.arange(count) + rng.uniform(-0.3, 0.3, count)) / count
    reach = rng.uniform(60e3, 180e3, count)
    angle = 2.0 * np.pi * turn
    places = np.stack([reach * np.cos(angle), reach * np.sin(angle), np.zeros(count)], axis=1)
    low = rng.uniform(0.0, 0.5, count) * kind.duration_s
    high = low + rng.uniform(0.4, 0.5, count) * kind.duration_s
    low[:2], high[:2] = 0.0, kind.duration_s
    return places, list(zip(low.tolist(), high.tolist(), strict=True))


def _path(
    rng: np.random.Generator, kind: Fireball, time_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return states at given times, shape (n, 3, 3): down from 90 km, through 60 km half way."""
    angle = rng.uniform(-np.pi, np.pi)
    forward = np.array([0.8 * np.cos(angle), 0.8 * np.sin(angle), -0.6])
    start = np.array([0.0, 0.0, 60e3]) - 50e3 * forward
    state = np.stack([start, _SPEED_M_S * forward, np.zeros(3)])
    return sample_path(rng, time_s, state, noise=kind.across, along=kind.along)


def _bearings(
    streams: Streams,
    kind: Fireball,
    frames_s: list[NDArray[np.float64]],
    *,
    positions_m: list[NDArray[np.float64]],
    places_m: NDArray[np.float64],
    late_s: NDArray[np.float64],
) -> Bearings:
    """Return what the cameras measure, at their times by their own clocks."""
    low, high = np.log(np.radians(kind.sigma_deg)).tolist()
    sigma = np.exp(streams.sensors.uniform(low, high, kind.cameras))
    columns = []
    for index, (time, position) in enumerate(zip(frames_s, positions_m, strict=True)):
        away = position - places_m[index]
        level = np.hypot(away[:, 0], away[:, 1])
        error = streams.noise.standard_normal((2, time.size))
        error += kind.slow * slow_errors(streams.walks, time, kind.slow_s)
        error *= sigma[index]
        # On the sky, an azimuth's error is shorter by the cosine of the elevation.
        error[0] *= np.hypot(level, away[:, 2]) / level
        error += np.radians(kind.bias_deg) * streams.errors.standard_normal((2, 1))
        columns.append(
            (
                time + late_s[index],
                np.full(time.size, index),
                np.arctan2(away[:, 1], away[:, 0]) + error[0],
                np.arctan2(away[:, 2], level) + error[1],
            )
        )
    time, sensor, azimuth, elevation = map(np.concatenate, zip(*columns, strict=True))
    return Bearings(
        time_s=time,
        sensor=sensor,
        azimuth_rad=azimuth,
        elevation_rad=elevation,
        sigma_azimuth_rad=sigma[sensor],
        sigma_elevation_rad=sigma[sensor],
        isotropic=np.ones(time.size, dtype=bool),
        line=np.zeros(time.size, dtype=np.int64),
    )
