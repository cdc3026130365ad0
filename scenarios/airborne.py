"""Angles from aircraft: the scenarios of Kallin (2021), and harder ones.

T. Kallin, *Airborne angle-only geolocalization*, MSc thesis LiTH-ISY-EX--21/5385--SE, Linkoping
University 2021. One or two receivers fly straight at 200 m/s with known position and attitude, and
measure azimuth and elevation of an emitter on the ground in their body axes, ten times a second,
with a standard deviation of 5 or 10 degrees in each. The height of the ground is known from a grid
of 50 m, or is not known.

What the thesis leaves open (we know it by its figures), and what is done here:

- The directions of flight are drawn, not stated. Crossed: the first receiver flies north, the
  second east. Parallel: both north, side by side.
- Durations: 25.0 s crossed, 37.2 s parallel, the first measurement after 0.1 s. With those the
  bounds are the printed ones; docs/accuracy.md says what else was tried.
- Its elevation model is not at hand: low hills stand in for it, with the printed heights of the
  targets, level ground at the crossed one and a slope of 1 % at the parallel one, rising away from
  the receivers, which the printed bounds ask for.
- Attitude is level, along the path.

Beyond the thesis: mountains, a target that drives along a road, azimuth alone, an aircraft that
rolls.

Axes of the frame: x east, y north, z up, metres; the Earth is flat. Body axes: x forward, y right,
z down, turned from north-east-down by yaw, pitch and roll in this order. Azimuth is counted from
forward to the right, elevation is positive above the plane of forward and right. Everything is
drawn from geometry here; nothing of ``geograph.factors`` is used.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.scenarios.landscape import HILLS, MOUNTAINS, Landscape, Pin, make_landscape

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import ArrayLike, NDArray

Land = Literal["hills", "mountains"]

RATE_HZ = 10.0
SPEED_M_S = 200.0

PARALLEL_TARGET_M = (3200.0, 3200.0, 154.0)
CROSSED_TARGET_M = (2200.0, 2200.0, 172.0)

PARALLEL_STEPS = 372
CROSSED_STEPS = 250

PARALLEL_SLOPE = (0.0072, 0.0072)
"""Slope of the ground at the target of the parallel scenarios."""

_ROAD_SWING_M = 300.0
_ROAD_LENGTH_M = 2500.0


@dataclass(frozen=True, kw_only=True)
class Receiver:
    """One aircraft, in straight and level motion whatever its attitude.

    Parameters
    ----------
    start_m
        Place at time zero.
    heading_deg
        Direction of flight, clockwise from north; the yaw is the same.
    speed_m_s
        Speed.
    roll_deg, roll_period_s
        Amplitude and period of a roll to both sides, and of a third of it in pitch.
    """

    start_m: tuple[float, float, float]
    heading_deg: float
    speed_m_s: float = SPEED_M_S
    roll_deg: float = 0.0
    roll_period_s: float = 8.0

    @property
    def level(self) -> bool:
        """Whether the wings and the nose stay level."""
        return self.roll_deg == 0.0

    def position_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return positions, shape (..., 3), metres."""
        heading = np.radians(self.heading_deg)
        velocity = self.speed_m_s * np.array([np.sin(heading), np.cos(heading), 0.0])
        return np.asarray(np.array(self.start_m) + np.asarray(time_s, float)[..., None] * velocity)

    def attitude_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return yaw, pitch and roll, shape (..., 3), radians."""
        time = np.asarray(time_s, dtype=np.float64)
        swing = 2.0 * np.pi * time / self.roll_period_s
        roll = np.radians(self.roll_deg) * np.sin(swing)
        pitch = np.radians(self.roll_deg) / 3.0 * np.cos(0.7 * swing)
        return np.stack([np.full(time.shape, np.radians(self.heading_deg)), pitch, roll], axis=-1)

    def axes_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return the directions forward, right and up of the body, shape (..., 3, 3), as rows."""
        yaw, pitch, roll = np.moveaxis(self.attitude_at(time_s), -1, 0)
        flat = np.stack([np.sin(yaw), np.cos(yaw), np.zeros_like(yaw)], axis=-1)
        right = np.stack([np.cos(yaw), -np.sin(yaw), np.zeros_like(yaw)], axis=-1)
        up = np.broadcast_to([0.0, 0.0, 1.0], flat.shape)
        forward, upright = _turn(flat, up, pitch)
        # Rolling to the right turns the right wing down and the roof to the right.
        roof, wing = _turn(upright, right, roll)
        return np.stack([forward, wing, roof], axis=-2)


def _turn(
    first: NDArray[np.float64], second: NDArray[np.float64], angle: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Turn a pair of directions, the first towards the second."""
    cosine, sine = np.cos(angle)[..., None], np.sin(angle)[..., None]
    return cosine * first + sine * second, cosine * second - sine * first


@dataclass(frozen=True, kw_only=True)
class Airborne:
    """One scenario.

    Parameters
    ----------
    name
        What it is called; a part of what seeds the noise.
    target_m
        Place of the emitter at time zero; its height is that of the ground.
    receivers
        The aircraft.
    sigma_deg
        Standard deviation of azimuth and of elevation.
    steps
        Number of measurements of each receiver; the first is a tenth of a second after time zero.
    terrain_known
        Whether estimators know the ground.
    land
        What the ground is like.
    road_speed_m_s
        Speed towards the east of an emitter that drives along a winding road; 0: it stands.
    azimuth_only
        Whether elevations are not measured.

    Raises
    ------
    ValueError
        If there is no receiver, or a number is out of range.
    """

    name: str
    target_m: tuple[float, float, float]
    receivers: tuple[Receiver, ...]
    sigma_deg: float = 5.0
    steps: int = CROSSED_STEPS
    terrain_known: bool = True
    land: Land = "hills"
    road_speed_m_s: float = 0.0
    azimuth_only: bool = False

    def __post_init__(self) -> None:
        if not self.receivers:
            raise ValueError("no receiver; expected at least one")
        if not 0.0 < self.sigma_deg < 90.0 or self.steps < 1:
            raise ValueError(
                f"sigma of {self.sigma_deg} degrees and {self.steps} steps; "
                "expected a sigma between 0 and 90 and at least 1 step"
            )

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of an angle, radians."""
        return float(np.radians(self.sigma_deg))

    @property
    def moving(self) -> bool:
        """Whether the emitter moves."""
        return self.road_speed_m_s != 0.0

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Shape (steps,): times of measurement."""
        return np.arange(1, self.steps + 1) / RATE_HZ

    @property
    def terrain(self) -> Landscape:
        """The ground."""
        return land(self.land)

    def emitter_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return positions of the emitter, shape (..., 3), metres."""
        time = np.asarray(time_s, dtype=np.float64)
        place = np.broadcast_to(np.array(self.target_m), (*time.shape, 3)).copy()
        if self.moving:
            east = self.road_speed_m_s * time
            # A road that winds; the emitter's speed to the east is constant.
            place[..., 0] += east
            place[..., 1] += _ROAD_SWING_M * np.sin(2.0 * np.pi * east / _ROAD_LENGTH_M)
            place[..., 2] = self.terrain.height(place[..., 0], place[..., 1])
        return place

    def receivers_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return positions of the receivers, shape (..., receivers, 3), metres."""
        return np.stack([receiver.position_at(time_s) for receiver in self.receivers], axis=-2)

    def axes_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return body directions forward, right, up as rows, shape (..., receivers, 3, 3)."""
        return np.stack([receiver.axes_at(time_s) for receiver in self.receivers], axis=-3)


@cache
def land(name: Land) -> Landscape:
    """Return the ground of the scenarios: one of two, the same at every call."""
    if name == "mountains":
        return make_landscape(MOUNTAINS, seed=3)
    pins = [
        Pin(place_m=(place[0], place[1]), height_m=place[2], slope=slope)
        for place, slope in ((PARALLEL_TARGET_M, PARALLEL_SLOPE), (CROSSED_TARGET_M, (0.0, 0.0)))
    ]
    return make_landscape(HILLS, seed=1, pins=pins)


def _on_ground(name: Land, x_m: float, y_m: float) -> tuple[float, float, float]:
    return x_m, y_m, float(land(name).height(x_m, y_m))


_PARALLEL = tuple(Receiver(start_m=(x, 200.0, 1000.0), heading_deg=0.0) for x in (200.0, 300.0))
_CROSSED = (
    Receiver(start_m=(1100.0, 200.0, 1000.0), heading_deg=0.0),
    Receiver(start_m=(100.0, 2950.0, 1100.0), heading_deg=90.0),
)


def _published() -> Iterator[Airborne]:
    for sigma in (5, 10):
        parallel = Airborne(
            name="",
            target_m=PARALLEL_TARGET_M,
            receivers=_PARALLEL,
            sigma_deg=float(sigma),
            steps=PARALLEL_STEPS,
        )
        crossed = replace(
            parallel, target_m=CROSSED_TARGET_M, receivers=_CROSSED, steps=CROSSED_STEPS
        )
        yield replace(parallel, name=f"1-{sigma}deg", terrain_known=False)
        yield replace(parallel, name=f"2-{sigma}deg")
        yield replace(parallel, name=f"3-{sigma}deg", receivers=_PARALLEL[:1])
        yield replace(crossed, name=f"4-{sigma}deg", terrain_known=False)
        yield replace(crossed, name=f"5-{sigma}deg")


SCENARIOS: dict[str, Airborne] = {scenario.name: scenario for scenario in _published()}
"""The thesis's five scenarios with sigmas of 5 and 10 degrees, ``"1-5deg"`` to ``"5-10deg"``."""


@cache
def beyond() -> dict[str, Airborne]:
    """Return the harder scenarios by name, all with 5 degrees and known ground.

    ``"mountains"``: one receiver at 3 km over ranges. ``"road"``: two receivers and an emitter at
    20 m/s on a winding road. ``"road-mountains"``: the same over ranges. ``"azimuth-only"``: one
    receiver without elevations. ``"rolling"``: one receiver that rolls 30 degrees to either side.
    """
    one = SCENARIOS["3-5deg"]
    two = SCENARIOS["2-5deg"]
    high = tuple(
        replace(receiver, start_m=(*receiver.start_m[:2], 3000.0)) for receiver in two.receivers
    )
    mountain = _on_ground("mountains", *PARALLEL_TARGET_M[:2])
    return {
        scenario.name: scenario
        for scenario in (
            replace(one, name="mountains", land="mountains", target_m=mountain, receivers=high[:1]),
            replace(two, name="road", road_speed_m_s=20.0),
            replace(
                two,
                name="road-mountains",
                land="mountains",
                target_m=mountain,
                receivers=high,
                road_speed_m_s=20.0,
            ),
            replace(one, name="azimuth-only", azimuth_only=True),
            replace(one, name="rolling", receivers=(replace(one.receivers[0], roll_deg=30.0),)),
        )
    }


@dataclass(frozen=True, eq=False)
class Runs:
    """Many independent runs of one scenario.

    Attributes
    ----------
    scenario
        What was simulated.
    receiver_m
        Shape (k, n, 3): places of the receivers, metres.
    axes
        Shape (k, n, 3, 3): their directions forward, right and up, as rows.
    azimuth_rad, elevation_rad
        Shape (runs, k, n): what they measured in body axes; elevations are NaN where they have
        none. Elevations beyond a right angle are left as the noise made them.
    """

    scenario: Airborne
    receiver_m: NDArray[np.float64]
    axes: NDArray[np.float64]
    azimuth_rad: NDArray[np.float64]
    elevation_rad: NDArray[np.float64]

    def __len__(self) -> int:
        return int(self.azimuth_rad.shape[0])


def true_angles(scenario: Airborne) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return azimuths and elevations without noise in body axes, shape (k, n), radians.

    The receiver is where it is on reception, the emitter where it was a light time before.
    """
    time = scenario.time_s[:, None]
    receiver = scenario.receivers_at(scenario.time_s)
    emission = np.broadcast_to(time, receiver.shape[:2])
    # The emitter moves by less than a millimetre in a light time.
    for _ in range(2):
        sight = scenario.emitter_at(emission) - receiver
        emission = time - np.linalg.norm(sight, axis=-1) / SPEED_OF_LIGHT_M_S
    body = np.einsum("knij,knj->kni", scenario.axes_at(scenario.time_s), sight)
    forward, right, up = np.moveaxis(body, -1, 0)
    return np.arctan2(right, forward), np.arctan2(up, np.hypot(forward, right))


def draw_noise(scenario: Airborne, seed: int) -> NDArray[np.float64]:
    """Return one run's errors of azimuth and elevation, shape (2, k, n), radians."""
    sequence = np.random.SeedSequence(seed, spawn_key=(zlib.crc32(scenario.name.encode()),))
    shape = (2, scenario.steps, len(scenario.receivers))
    return scenario.sigma_rad * np.random.default_rng(sequence).standard_normal(shape)


def simulate(scenario: Airborne, seeds: Sequence[int]) -> Runs:
    """Simulate runs, one for each seed; a seed gives the same run as the scenario's recordings.

    Parameters
    ----------
    scenario
        One of :data:`SCENARIOS`, or another.
    seeds
        Whole numbers of at least 0.
    """
    azimuth, elevation = true_angles(scenario)
    noise = np.array([draw_noise(scenario, seed) for seed in seeds])
    elevation = np.full_like(elevation, np.nan) if scenario.azimuth_only else elevation
    return Runs(
        scenario,
        scenario.receivers_at(scenario.time_s),
        scenario.axes_at(scenario.time_s),
        azimuth + noise[:, 0],
        elevation + noise[:, 1],
    )
