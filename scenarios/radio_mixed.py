"""A drone or a ship: bearings of some sensors, time and frequency differences of others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from geograph.recording import SmoothSettings
from geograph.scenarios.paths import StraightBody
from geograph.scenarios.places import ecef
from geograph.scenarios.radio import RadioWorld, Receiver, make_radio_world
from geograph.scenarios.radio_paths import earth_fixed, random_flight
from geograph.scenarios.radio_plans import BearingPlan, FrequencyPlan, Plan, TimePlan
from geograph.scenarios.worlds import Streams, truth_table
from geograph.sensors import SensorErrors

if TYPE_CHECKING:
    from collections.abc import Collection

    from numpy.typing import NDArray

    from geograph.recording import Recording

MixedTarget = Literal["drone", "ship"]
Kind = Literal["bearings", "time", "frequency"]

_MARGIN_S = 2.0


@dataclass(frozen=True, kw_only=True)
class _Nominal:
    """A target and the site that suits it, in metres and seconds."""

    height_m: float
    speed_m_s: float
    process_noise: float
    nearest_m: float
    farthest_m: float


_NOMINAL: dict[MixedTarget, _Nominal] = {
    "drone": _Nominal(
        height_m=150.0, speed_m_s=15.0, process_noise=0.5, nearest_m=500.0, farthest_m=3e3
    ),
    "ship": _Nominal(
        height_m=10.0, speed_m_s=8.0, process_noise=0.05, nearest_m=5e3, farthest_m=20e3
    ),
}


@dataclass(frozen=True, kw_only=True)
class Mixed:
    """A kind of site (ECEF) with two cameras and four receivers.

    Parameters
    ----------
    target
        ``"drone"`` over the site, or ``"ship"`` off the coast.
    kinds
        What is measured: any of ``"bearings"``, ``"time"`` and ``"frequency"``. Two worlds of one
        seed that differ only in this have the same path and the same sensors with the same errors,
        but not the same noise.
    measurements
        Number of times of each kind, independent of one another.
    duration_s
        Length of the recording.
    sigma_rad
        White noise of a bearing.
    bias_rad
        Standard deviation of a camera's bias of azimuth and of elevation.
    camera_clock_s
        Standard deviation of the offset of the cameras' clocks.
    sigma_s, sigma_hz
        White noise of a time of arrival and of a received frequency.
    clock_offset_s, frequency_offset_hz
        Standard deviations of the errors of all receivers but the first.
    carrier_hz
        Frequency of the object's signal.

    Raises
    ------
    ValueError
        If the target is unknown.
    """

    target: MixedTarget = "drone"
    kinds: Collection[Kind] = ("bearings", "time", "frequency")
    measurements: int = 40
    duration_s: float = 60.0
    sigma_rad: float = 3e-3
    bias_rad: float = 1e-3
    camera_clock_s: float = 0.02
    sigma_s: float = 30e-9
    sigma_hz: float = 2.0
    clock_offset_s: float = 30e-9
    frequency_offset_hz: float = 5.0
    carrier_hz: float = 2.4e9

    def __post_init__(self) -> None:
        if self.target not in get_args(MixedTarget):
            raise ValueError(
                f"target {self.target!r}; expected one of {', '.join(get_args(MixedTarget))}"
            )

    def plans(self, times_s: NDArray[np.float64]) -> list[Plan]:
        """Return what is measured at times of each kind, shape (3, n)."""
        pairs = ((3, 2), (4, 2), (5, 2))
        plans: dict[Kind, Plan] = {
            "bearings": BearingPlan(
                reception_time_s=times_s[0], receivers=(0, 1), sigma_rad=self.sigma_rad
            ),
            "time": TimePlan(emission_time_s=times_s[1], pairs=pairs, sigma_s=self.sigma_s),
            "frequency": FrequencyPlan(
                emission_time_s=times_s[2],
                pairs=pairs,
                carrier_hz=self.carrier_hz,
                sigma_hz=self.sigma_hz,
            ),
        }
        return [plan for kind, plan in plans.items() if kind in self.kinds]


def mixed_world(seed: int, kind: Mixed | None = None) -> RadioWorld:
    """Simulate one recording; the same seed and kind give the same world, bit for bit.

    Parameters
    ----------
    seed
        A whole number of at least 0.
    kind
        What the site is like; None: :class:`Mixed` as it stands.
    """
    kind = Mixed() if kind is None else kind
    nominal = _NOMINAL[kind.target]
    streams = Streams.from_seed(seed)
    origin = ecef(streams.sensors.uniform(-60.0, 60.0), streams.sensors.uniform(-180.0, 180.0), 0.0)
    heading = streams.path.uniform(0.0, 2.0 * np.pi)
    course = nominal.speed_m_s * np.array([np.sin(heading), np.cos(heading), 0.0])
    level = np.stack([np.array([0.0, 0.0, nominal.height_m]), course])
    level[0] -= (0.5 * kind.duration_s + _MARGIN_S) * course
    span = (-_MARGIN_S, kind.duration_s + _MARGIN_S)
    path = random_flight(
        streams.path,
        earth_fixed(origin, level[None])[0],
        span,
        noise=nominal.process_noise,
        tolerance_m=1e-3,
        longest_step_s=0.2,
    )
    times = np.sort(streams.times.uniform(0.0, kind.duration_s, (3, kind.measurements)), axis=1)
    return make_radio_world(
        name=f"mixed-{seed}",
        path=path,
        receivers=_sensors(streams.sensors, kind, nominal, origin),
        plans=kind.plans(times),
        streams=streams,
        settings=SmoothSettings(
            motion="constant-velocity", process_noise=nominal.process_noise, loss="none"
        ),
        truth=truth_table(path, span, step_s=0.1),
    )


def mixed(seed: int, **options: Any) -> Recording:
    """Return the recording of one site; see :class:`Mixed`."""
    return mixed_world(seed, Mixed(**options)).recording


def _sensors(
    rng: np.random.Generator, kind: Mixed, nominal: _Nominal, origin_m: NDArray[np.float64]
) -> list[Receiver]:
    """Return two cameras and four receivers, all around at heights of 0 to 100 m."""
    camera = SensorErrors(
        azimuth_bias_rad=kind.bias_rad,
        elevation_bias_rad=kind.bias_rad,
        clock_offset_s=kind.camera_clock_s,
    )
    receiver = SensorErrors(
        clock_offset_s=kind.clock_offset_s, frequency_offset_hz=kind.frequency_offset_hz
    )
    errors = [camera, camera, SensorErrors(), receiver, receiver, receiver]
    names = ["C1", "C2", "R1", "R2", "R3", "R4"]
    turns = rng.uniform(0.0, 2.0 * np.pi, 2)
    found = []
    for index, (name, own) in enumerate(zip(names, errors, strict=True)):
        # Cameras see the object from two sides that are not opposite; receivers from four.
        share = 0.3 * index if index < 2 else (index - 2) / 4.0
        angle = turns[min(index // 2, 1)] + 2.0 * np.pi * (share + rng.uniform(-0.05, 0.05))
        distance = rng.uniform(nominal.nearest_m, nominal.farthest_m)
        level = np.array([distance * np.sin(angle), distance * np.cos(angle), rng.uniform(0, 100)])
        place = earth_fixed(origin_m, level[None, None])[0, 0]
        found.append(Receiver(name=name, body=StraightBody(place), errors=own, axes="enu"))
    return found
