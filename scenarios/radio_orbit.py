"""Satellites that receive an emitter on the ground: time and frequency differences."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from geograph.constants import EARTH_RADIUS_M, EARTH_ROTATION_RAD_S
from geograph.recording import SmoothSettings
from geograph.scenarios.orbits import CircularOrbit, EarthFixedBody, turned_about_z
from geograph.scenarios.paths import StraightBody
from geograph.scenarios.places import ecef
from geograph.scenarios.radio import Altitude, RadioWorld, Receiver, make_radio_world
from geograph.scenarios.radio_paths import earth_fixed, random_flight
from geograph.scenarios.radio_plans import FrequencyPlan, Plan, TimePlan
from geograph.scenarios.worlds import Streams, truth_table
from geograph.sensors import SensorErrors

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.recording import Recording
    from geograph.scenarios.paths import Body

GroundEmitter = Literal["static", "ship"]

_MARGIN_S = 2.0
_TABLE_STEP_S = 2.0


@dataclass(frozen=True, kw_only=True)
class Formation:
    """A kind of pass of satellites over an emitter (ECEF).

    Parameters
    ----------
    satellites
        2, one behind the other, or 3, the third beside them.
    emitter
        ``"static"``, or ``"ship"``: 10 m/s, white noise on the acceleration.
    measurements
        Number of times, spread evenly over the pass, at which all differences are taken.
    duration_s
        Length of the pass, half of it before the emitter is abeam.
    carrier_hz
        Frequency of the emitter.
    sigma_s, sigma_hz
        White noise of a time of arrival and of a received frequency; None: no such differences.
    clock_offset_s, clock_drift_s_s, frequency_offset_hz, frequency_drift_hz_s
        Standard deviations of the errors of all satellites but the first.
    position_m
        Standard deviation of the error of a satellite's recorded orbit, per axis.
    shared
        Whether differences share the noise of the first satellite.
    altitude_sigma_m
        Standard deviation of the known altitude of the emitter; None: it is not known.
    process_noise
        Square root of the spectral density of a ship's acceleration, m/s^1.5.

    Raises
    ------
    ValueError
        If the emitter is unknown or the number of satellites out of range.
    """

    satellites: int = 2
    emitter: GroundEmitter = "static"
    measurements: int = 60
    duration_s: float = 240.0
    carrier_hz: float = 1e9
    sigma_s: float | None = 100e-9
    sigma_hz: float | None = 0.5
    clock_offset_s: float = 0.0
    clock_drift_s_s: float = 0.0
    frequency_offset_hz: float = 0.0
    frequency_drift_hz_s: float = 0.0
    position_m: float = 0.0
    shared: bool = True
    altitude_sigma_m: float | None = 10.0
    process_noise: float = 0.02

    def __post_init__(self) -> None:
        if self.emitter not in get_args(GroundEmitter):
            raise ValueError(
                f"emitter {self.emitter!r}; expected one of {', '.join(get_args(GroundEmitter))}"
            )
        if self.satellites not in (2, 3):
            raise ValueError(f"{self.satellites} satellites; expected 2 or 3")

    def errors(self, index: int) -> SensorErrors:
        """Return the prior standard deviations of one satellite's errors."""
        loose = 0.0 if index == 0 else 1.0
        return SensorErrors(
            clock_offset_s=loose * self.clock_offset_s,
            clock_drift_s_s=loose * self.clock_drift_s_s,
            frequency_offset_hz=loose * self.frequency_offset_hz,
            frequency_drift_hz_s=loose * self.frequency_drift_hz_s,
            position_m=self.position_m,
        )

    def plans(self) -> list[Plan]:
        """Return what is measured."""
        time = np.linspace(0.0, self.duration_s, self.measurements)
        pairs = tuple((index, 0) for index in range(1, self.satellites))
        plans: list[Plan] = []
        if self.sigma_s is not None:
            plans.append(
                TimePlan(
                    emission_time_s=time, pairs=pairs, sigma_s=self.sigma_s, shared=self.shared
                )
            )
        if self.sigma_hz is not None:
            plans.append(
                FrequencyPlan(
                    emission_time_s=time,
                    pairs=pairs,
                    carrier_hz=self.carrier_hz,
                    sigma_hz=self.sigma_hz,
                    shared=self.shared,
                )
            )
        return plans


def formation_world(seed: int, kind: Formation | None = None) -> RadioWorld:
    """Simulate one pass; the same seed and kind give the same world, bit for bit.

    Parameters
    ----------
    seed
        A whole number of at least 0.
    kind
        What the pass is like; None: :class:`Formation` as it stands.
    """
    kind = Formation() if kind is None else kind
    streams = Streams.from_seed(seed)
    place = ecef(
        streams.sensors.uniform(-60.0, 60.0),
        streams.sensors.uniform(-180.0, 180.0),
        streams.sensors.uniform(0.0, 1000.0),
    )
    span = (-_MARGIN_S, kind.duration_s + _MARGIN_S)
    path = _emitter(streams.path, kind, place, span)
    rows = int(np.ceil((span[1] - span[0] + 8.0) / _TABLE_STEP_S)) + 1
    table = np.linspace(span[0] - 4.0, span[1] + 4.0, rows)
    receivers = [
        Receiver(name=f"S{index + 1}", body=body, errors=kind.errors(index), table_s=table)
        for index, body in enumerate(_satellites(streams.sensors, kind, place))
    ]
    static = kind.emitter == "static"
    altitude = None
    if kind.altitude_sigma_m is not None:
        count = 1 if static else kind.measurements
        altitude = Altitude(sigma_m=kind.altitude_sigma_m, count=count)
    return make_radio_world(
        name=f"formation-{seed}",
        path=path,
        receivers=receivers,
        plans=kind.plans(),
        streams=streams,
        settings=SmoothSettings(motion="static", loss="none")
        if static
        else SmoothSettings(
            motion="constant-velocity", process_noise=kind.process_noise, loss="none"
        ),
        truth=truth_table(path, span, step_s=1.0),
        altitude=altitude,
    )


def formation(seed: int, **options: Any) -> Recording:
    """Return the recording of one pass; see :class:`Formation`."""
    return formation_world(seed, Formation(**options)).recording


def _emitter(
    rng: np.random.Generator,
    kind: Formation,
    place_m: NDArray[np.float64],
    span_s: tuple[float, float],
) -> Body:
    heading = rng.uniform(0.0, 2.0 * np.pi)
    if kind.emitter == "static":
        return StraightBody(place_m)
    level = np.zeros((2, 3))
    level[1] = 10.0 * np.array([np.sin(heading), np.cos(heading), 0.0])
    initial = earth_fixed(place_m, level[None])[0]
    return random_flight(rng, initial, span_s, noise=kind.process_noise, tolerance_m=1e-3)


def _satellites(
    rng: np.random.Generator, kind: Formation, place_ecef_m: NDArray[np.float64]
) -> list[EarthFixedBody]:
    """Return satellites in circular orbits that pass beside a place half-way through."""
    half = 0.5 * kind.duration_s
    up = turned_about_z(place_ecef_m, EARTH_ROTATION_RAD_S * half)
    up /= np.linalg.norm(up)
    along = np.cross(up, rng.standard_normal(3))
    along /= np.linalg.norm(along)
    radius = EARTH_RADIUS_M + rng.uniform(500e3, 800e3)
    beside = rng.choice([-1.0, 1.0]) * rng.uniform(200e3, 800e3) / EARTH_RADIUS_M
    # Behind, and to the side, of the first, as angles at the centre of the Earth.
    behind = np.array([0.0, 1.0, rng.uniform(-0.5, 1.5)]) * rng.uniform(80e3, 250e3) / radius
    aside = np.array([0.0, 0.0, rng.choice([-1.0, 1.0])]) * rng.uniform(80e3, 200e3) / radius
    bodies = []
    for back, side in zip(behind[: kind.satellites], aside[: kind.satellites], strict=True):
        angle = beside + side
        orbit = CircularOrbit(
            radius, np.cos(angle) * up + np.sin(angle) * np.cross(along, up), along, phase_rad=0.0
        )
        rate = orbit.velocity_at(0.0) @ along / radius
        phase = float(-rate * half - back)
        bodies.append(
            EarthFixedBody(CircularOrbit(radius, orbit.first, orbit.second, phase_rad=phase))
        )
    return bodies
