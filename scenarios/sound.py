"""Sources of sound: one that walks through a hall, heard by arrays, and one among microphones.

Sound takes a good part of a second across the hall, in which the source moves much farther than
the bearings are wrong: a smoother that leaves out the light time is found out. Out of doors, a
drone or a vehicle at a tenth of the speed of sound and microphones that stand or move show every
term of the second order.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from geograph.recording import SmoothSettings
from geograph.scenarios.paths import SampledBody, StraightBody, fine_grid, sample_path
from geograph.scenarios.radio import Altitude, RadioWorld, Receiver, make_radio_world
from geograph.scenarios.radio_paths import random_flight
from geograph.scenarios.radio_plans import ArrivalPlan, FrequencyPlan, Plan, TimePlan
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

    from geograph.recording import MotionName, Recording

SPEED_OF_SOUND_M_S = 343.0
"""In dry air at 20 degrees Celsius (ISO 9613-1)."""

_MOTIONS: dict[int, MotionName] = {
    1: "constant-position",
    2: "constant-velocity",
    3: "constant-acceleration",
}
_NOISE: dict[int, tuple[float, float, float]] = {
    1: (0.5, 0.5, 0.1),
    2: (1.0, 1.0, 0.2),
    3: (0.2, 0.2, 0.04),
}
_PLACES = ((0.0, 0.0, 4.0), (80.0, 0.0, 1.0), (80.0, 50.0, 5.0), (0.0, 50.0, 2.0), (40.0, 0.0, 6.0))
_MARGIN_S = 2.0


@dataclass(frozen=True, kw_only=True)
class Room:
    """A kind of walk through a hall of 80 m by 50 m (local frame, axes ``xyz``).

    Parameters
    ----------
    order
        How many times white noise is integrated to make the path: 1, 2 or 3.
    process_noise
        Square root of its spectral density along x, y and z, SI; None: one that suits the order.
    sensors, bearings
        Number of arrays (2 to 5), and of bearings of each.
    sigma_rad
        White noise of azimuth and of elevation.
    bias_rad
        Standard deviation of the bias of azimuth and of elevation.
    clock_offset_s
        Standard deviation of the clock offset of all arrays but the first.
    speed_m_s
        Speed of the source at the start.
    propagation_speed_m_s
        Speed of the signal.
    duration_s
        Length of the walk.

    Raises
    ------
    ValueError
        If the order or the number of arrays is out of range.
    """

    order: int = 2
    process_noise: tuple[float, float, float] | None = None
    sensors: int = 4
    bearings: int = 150
    sigma_rad: float = 5e-3
    bias_rad: float = 5e-3
    clock_offset_s: float = 0.0
    speed_m_s: float = 5.0
    propagation_speed_m_s: float = SPEED_OF_SOUND_M_S
    duration_s: float = 8.0

    def __post_init__(self) -> None:
        if self.order not in _MOTIONS:
            raise ValueError(f"order {self.order}; expected 1, 2 or 3")
        if not 2 <= self.sensors <= len(_PLACES):
            raise ValueError(f"{self.sensors} sensors; expected 2 to {len(_PLACES)}")

    @property
    def noise(self) -> tuple[float, float, float]:
        """Square root of the spectral density of the path's noise along x, y and z, SI."""
        return _NOISE[self.order] if self.process_noise is None else self.process_noise

    def errors(self, index: int) -> SensorErrors:
        """Return the prior standard deviations of one array's errors."""
        return SensorErrors(
            azimuth_bias_rad=self.bias_rad,
            elevation_bias_rad=self.bias_rad,
            clock_offset_s=0.0 if index == 0 else self.clock_offset_s,
        )


def room_world(seed: int, kind: Room | None = None) -> World:
    """Simulate one walk; the same seed and kind give the same world, bit for bit.

    Parameters
    ----------
    seed
        A whole number of at least 0.
    kind
        What the walk is like; None: :class:`Room` as it stands.
    """
    kind = Room() if kind is None else kind
    streams = Streams.from_seed(seed)
    heading = streams.path.uniform(0.0, 2.0 * np.pi)
    initial = np.zeros((kind.order, 3))
    initial[0] = [40.0, 25.0, 1.5]
    if kind.order > 1:
        initial[1] = kind.speed_m_s * np.array([np.cos(heading), np.sin(heading), 0.0])
    margin = _MARGIN_S + 5.0 * kind.clock_offset_s
    grid = fine_grid(
        (-margin, kind.duration_s + margin),
        order=kind.order,
        noise=max(kind.noise),
        # A thousandth of what one bearing sees, or, for a path without velocity, a twentieth.
        tolerance_m=1e-2 if kind.order == 1 else 1e-4,
        longest_step_s=0.05,
    )
    state = sample_path(streams.path, grid, initial, noise=kind.noise)
    path = SampledBody(grid, state)
    stations = [
        Station(
            name=f"M{index + 1}",
            body=StraightBody(np.array(_PLACES[index])),
            axes="xyz",
            errors=kind.errors(index),
        )
        for index in range(kind.sensors)
    ]
    return make_world(
        name=f"room-{seed}",
        path=path,
        stations=stations,
        times_s=uniform_times(streams.times, kind.sensors, kind.bearings, kind.duration_s),
        noise=Noise(sigma_rad=kind.sigma_rad, per_coordinate=True),
        streams=streams,
        settings=SmoothSettings(motion=_MOTIONS[kind.order], process_noise=kind.noise, loss="none"),
        truth=truth_table(
            path,
            (-margin, kind.duration_s + margin),
            step_s=0.02,
            velocity=kind.order > 1,
        ),
        frame="local",
        propagation_speed_m_s=kind.propagation_speed_m_s,
    )


def room(seed: int, **options: Any) -> Recording:
    """Return the recording of one simulated walk; see :func:`room_world` and :class:`Room`."""
    return room_world(seed, Room(**options)).recording


Heard = Literal["arrivals", "differences", "pairs"]


@dataclass(frozen=True, kw_only=True)
class Microphones:
    """A kind of drive or flight past microphones (local frame).

    Parameters
    ----------
    heard
        ``"arrivals"``: sets of arrival times of claps; ``"differences"``: differences against the
        first microphone, whose noise they share; ``"pairs"``: the same, each with its own noise.
    tone_hz
        Frequency of a tone whose received frequencies are compared as well; None: there is none.
    flat
        A vehicle on the ground, known to be there, instead of a drone.
    microphones
        Number of microphones, all around at 30 to 90 m.
    microphone_m_s
        Speed at which each moves in a direction of its own, along a straight line.
    claps
        Number of sounds, at random times.
    duration_s
        Length of the pass.
    speed_m_s
        Speed of the source at the start.
    process_noise
        Square root of the spectral density of its acceleration, m/s^1.5.
    sigma_s, sigma_hz
        White noise of a time of arrival and of a received frequency.
    clock_offset_s, clock_drift_s_s, frequency_offset_hz
        Standard deviations of the errors of all microphones but the first.
    position_m
        Standard deviation of the error of a recorded position, per axis.
    hearing
        Probability that a microphone hears a sound (of arrivals), or that a difference is measured.
    propagation_sigma_m_s
        Standard deviation of the speed of sound.

    Raises
    ------
    ValueError
        If what is heard is unknown.
    """

    heard: Heard = "arrivals"
    tone_hz: float | None = None
    flat: bool = False
    microphones: int = 6
    microphone_m_s: float = 0.0
    claps: int = 40
    duration_s: float = 8.0
    speed_m_s: float = 30.0
    process_noise: float = 2.0
    sigma_s: float = 2e-4
    sigma_hz: float = 0.1
    clock_offset_s: float = 0.0
    clock_drift_s_s: float = 0.0
    frequency_offset_hz: float = 0.0
    position_m: float = 0.0
    hearing: float = 1.0
    propagation_sigma_m_s: float = 0.0

    def __post_init__(self) -> None:
        if self.heard not in get_args(Heard):
            raise ValueError(f"heard {self.heard!r}; expected one of {', '.join(get_args(Heard))}")

    def errors(self, index: int) -> SensorErrors:
        """Return the prior standard deviations of one microphone's errors."""
        loose = 0.0 if index == 0 else 1.0
        return SensorErrors(
            clock_offset_s=loose * self.clock_offset_s,
            clock_drift_s_s=loose * self.clock_drift_s_s,
            frequency_offset_hz=loose * self.frequency_offset_hz,
            position_m=self.position_m,
        )

    def plans(self, emission_time_s: NDArray[np.float64]) -> list[Plan]:
        """Return what is measured of sounds at given times, shape (n,)."""
        listening = tuple(range(self.microphones))
        pairs = tuple((index, 0) for index in listening[1:])
        shared = self.heard != "pairs"
        plans: list[Plan] = []
        if self.heard == "arrivals":
            plans.append(
                ArrivalPlan(
                    emission_time_s=emission_time_s,
                    receivers=listening,
                    sigma_s=self.sigma_s,
                    hearing=self.hearing,
                )
            )
        else:
            plans.append(
                TimePlan(
                    emission_time_s=emission_time_s,
                    pairs=pairs,
                    sigma_s=self.sigma_s,
                    shared=shared,
                    kept=self.hearing,
                )
            )
        if self.tone_hz is not None:
            plans.append(
                FrequencyPlan(
                    emission_time_s=emission_time_s,
                    pairs=pairs,
                    carrier_hz=self.tone_hz,
                    sigma_hz=self.sigma_hz,
                    shared=shared,
                    kept=self.hearing,
                )
            )
        return plans


def microphones_world(seed: int, kind: Microphones | None = None) -> RadioWorld:
    """Simulate one pass; the same seed and kind give the same world, bit for bit.

    Parameters
    ----------
    seed
        A whole number of at least 0.
    kind
        What the pass is like; None: :class:`Microphones` as it stands.
    """
    kind = Microphones() if kind is None else kind
    streams = Streams.from_seed(seed)
    heading = streams.path.uniform(0.0, 2.0 * np.pi)
    velocity = kind.speed_m_s * np.array([np.cos(heading), np.sin(heading), 0.0])
    height = 0.0 if kind.flat else streams.path.uniform(20.0, 40.0)
    # Half-way over the middle, if it goes straight.
    start = np.array([0.0, 0.0, height]) - (0.5 * kind.duration_s + _MARGIN_S) * velocity
    noise = kind.process_noise * np.array([1.0, 1.0, 0.0 if kind.flat else 0.3])
    span = (-_MARGIN_S, kind.duration_s + _MARGIN_S)
    path = random_flight(
        streams.path,
        np.stack([start, velocity]),
        span,
        noise=(noise[0], noise[1], noise[2]),
        tolerance_m=1e-3,
        longest_step_s=0.05,
    )
    times = np.sort(streams.times.uniform(0.0, kind.duration_s, kind.claps))
    return make_radio_world(
        name=f"microphones-{seed}",
        path=path,
        receivers=_microphones(streams.sensors, kind, span),
        plans=kind.plans(times),
        streams=streams,
        settings=SmoothSettings(
            motion="constant-velocity",
            # A vehicle has next to no noise across its plane, in which a constraint holds it.
            process_noise=(noise[0], noise[1], max(noise[2], 1e-4)),
            loss="none",
        ),
        truth=truth_table(path, span, step_s=0.02),
        frame="local",
        propagation_speed_m_s=SPEED_OF_SOUND_M_S,
        propagation_sigma_m_s=kind.propagation_sigma_m_s,
        altitude=Altitude(sigma_m=1e-2) if kind.flat else None,
    )


def microphones(seed: int, **options: Any) -> Recording:
    """Return the recording of one pass; see :class:`Microphones`."""
    return microphones_world(seed, Microphones(**options)).recording


def _microphones(
    rng: np.random.Generator, kind: Microphones, span_s: tuple[float, float]
) -> list[Receiver]:
    """Return microphones all around: one in each of equal sectors, at 0 to 10 m."""
    turn = rng.uniform(0.0, 2.0 * np.pi)
    found = []
    for index in range(kind.microphones):
        angle = turn + 2.0 * np.pi * (index + rng.uniform(-0.3, 0.3)) / kind.microphones
        distance, height, course = rng.uniform((30.0, 0.0, 0.0), (90.0, 10.0, 2.0 * np.pi))
        place = np.array([distance * np.cos(angle), distance * np.sin(angle), height])
        velocity = kind.microphone_m_s * np.array([np.cos(course), np.sin(course), 0.0])
        moves = kind.microphone_m_s > 0.0
        found.append(
            Receiver(
                name=f"M{index + 1}",
                body=StraightBody(place, velocity if moves else None),
                errors=kind.errors(index),
                table_s=np.linspace(span_s[0], span_s[1] + _MARGIN_S, 15) if moves else None,
            )
        )
    return found
