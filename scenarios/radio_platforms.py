"""Moving platforms that hear a far emitter in a plane, after R4's geometry.

Four platforms a few kilometres apart fly along x at 50 m/s for two minutes (S. Camlica, *Recursive
passive localization methods using time difference of arrival*, METU 2009, section 4); here the
emitter may move as well, frequencies may be measured, and the platforms' positions may be wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.recording import SmoothSettings
from geograph.scenarios.paths import SampledBody, StraightBody, fine_grid, sample_path
from geograph.scenarios.radio import Altitude, RadioWorld, Receiver, make_radio_world
from geograph.scenarios.radio_paths import random_flight
from geograph.scenarios.radio_plans import ArrivalPlan, FrequencyPlan, Plan
from geograph.scenarios.worlds import Streams, truth_table
from geograph.sensors import SensorErrors

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.recording import Recording
    from geograph.scenarios.paths import Body

_STARTS_KM = ((1.0, 0.0), (0.0, 3.0), (2.0, 1.5), (-1.0, -1.5))
_SPEED_M_S = 50.0
_MARGIN_S = 4.0


@dataclass(frozen=True, kw_only=True)
class Platforms:
    """A kind of flight of four platforms (local frame, everything in the plane z = 0).

    Parameters
    ----------
    emitter_m
        Where the emitter is at the start, x and y.
    emitter_m_s
        Its velocity at the start, x and y; None: it stands.
    process_noise
        Square root of the spectral density of a moving emitter's acceleration along x and along y,
        m/s^1.5.
    scans
        Number of emissions, ``step_s`` apart, the first after one step.
    step_s
        Time between emissions, seconds.
    sigma_s
        White noise of an arrival time.
    sigma_hz
        White noise of a received frequency; None: frequencies are not measured.
    carrier_hz
        Frequency of the emitter.
    clock_offset_s, frequency_offset_hz
        Standard deviations of the errors of all platforms but the first.
    position_m
        Standard deviation of the constant error of a platform's recorded positions.
    position_noise_m
        Standard deviation of the error of every position, independent from scan to scan.
    platform_process_noise
        Square root of the spectral density of the platforms' acceleration, m/s^1.5, where their
        paths are to be estimated (0: they fly straight); None: they fly straight, and a smoother is
        not told.
    altitude_sigma_m
        Of the constraint that holds the path in the plane.
    """

    emitter_m: tuple[float, float] = (9e3, 100e3)
    emitter_m_s: tuple[float, float] | None = None
    process_noise: float = 0.1
    scans: int = 60
    step_s: float = 2.0
    sigma_s: float = 1e-9 / np.sqrt(10.0)
    sigma_hz: float | None = None
    carrier_hz: float = 1e9
    clock_offset_s: float = 0.0
    frequency_offset_hz: float = 0.0
    position_m: float = 0.0
    position_noise_m: float = 0.0
    platform_process_noise: float | None = None
    altitude_sigma_m: float = 0.1

    @property
    def emission_time_s(self) -> NDArray[np.float64]:
        """Shape (scans,), seconds."""
        return self.step_s * np.arange(1.0, self.scans + 1.0)

    def errors(self, index: int) -> SensorErrors:
        """Return the prior standard deviations of one platform's errors."""
        loose = 0.0 if index == 0 else 1.0
        return SensorErrors(
            clock_offset_s=loose * self.clock_offset_s,
            frequency_offset_hz=loose * self.frequency_offset_hz,
            position_m=self.position_m,
            position_noise_m=self.position_noise_m,
        )

    def plans(self) -> list[Plan]:
        """Return what is measured."""
        listening = tuple(range(len(_STARTS_KM)))
        plans: list[Plan] = [
            ArrivalPlan(
                emission_time_s=self.emission_time_s, receivers=listening, sigma_s=self.sigma_s
            )
        ]
        if self.sigma_hz is not None:
            plans.append(
                FrequencyPlan(
                    emission_time_s=self.emission_time_s,
                    pairs=tuple((index, 0) for index in listening[1:]),
                    carrier_hz=self.carrier_hz,
                    sigma_hz=self.sigma_hz,
                )
            )
        return plans


def platforms_world(seed: int, kind: Platforms | None = None) -> RadioWorld:
    """Simulate one flight; the same seed and kind give the same world, bit for bit.

    Parameters
    ----------
    seed
        A whole number of at least 0.
    kind
        What the flight is like; None: :class:`Platforms` as it stands.
    """
    kind = Platforms() if kind is None else kind
    streams = Streams.from_seed(seed)
    span = (-_MARGIN_S, float(kind.emission_time_s[-1]) + _MARGIN_S)
    path = _emitter(streams.path, kind, span)
    # A row at every scan, where the noise of each is its own, and some before and after.
    table = kind.step_s * np.arange(-1.0, kind.scans + 3.0)
    receivers = [
        Receiver(
            name=f"P{index + 1}",
            body=_platform(streams.sensors, kind, index, (table[0], table[-1])),
            errors=kind.errors(index),
            table_s=table,
            platform_process_noise=kind.platform_process_noise,
        )
        for index in range(len(_STARTS_KM))
    ]
    level = 1e-6
    return make_radio_world(
        name=f"platforms-{seed}",
        path=path,
        receivers=receivers,
        plans=kind.plans(),
        streams=streams,
        settings=SmoothSettings(motion="static", loss="none")
        if kind.emitter_m_s is None
        else SmoothSettings(
            motion="constant-velocity",
            process_noise=(kind.process_noise, kind.process_noise, level),
            loss="none",
        ),
        truth=truth_table(path, span, step_s=0.5),
        frame="local",
        altitude=Altitude(sigma_m=kind.altitude_sigma_m),
    )


def platforms(seed: int, **options: Any) -> Recording:
    """Return the recording of one flight; see :class:`Platforms`."""
    return platforms_world(seed, Platforms(**options)).recording


def _emitter(rng: np.random.Generator, kind: Platforms, span_s: tuple[float, float]) -> Body:
    place = np.array([*kind.emitter_m, 0.0])
    if kind.emitter_m_s is None:
        return StraightBody(place)
    return random_flight(
        rng,
        np.stack([place, [*kind.emitter_m_s, 0.0]]),
        span_s,
        noise=(kind.process_noise, kind.process_noise, 0.0),
        tolerance_m=1e-3,
    )


def _platform(
    rng: np.random.Generator, kind: Platforms, index: int, span_s: tuple[float, float]
) -> Body:
    x, y = (1e3 * value for value in _STARTS_KM[index])
    velocity = np.array([_SPEED_M_S, 0.0, 0.0])
    noise = kind.platform_process_noise
    if not noise:
        return StraightBody(np.array([x, y, 0.0]), velocity)
    grid = fine_grid(span_s, order=2, noise=noise, tolerance_m=1e-4)
    start = np.array([x + _SPEED_M_S * span_s[0], y, 0.0])
    # A platform is free in space, as its smoother takes it to be.
    return SampledBody(grid, sample_path(rng, grid, np.stack([start, velocity]), noise=noise))
