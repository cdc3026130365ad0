"""Time differences from moving sensors: the scenarios of Camlica (2009), every variant.

S. Camlica, *Recursive passive localization methods using time difference of arrival*, MSc thesis,
METU 2009. A study in the plane: four sensors fly at 50 m/s along x and hear, once every 2 s, ten
pulses of an emitter some 100 km away. The mean of the ten arrival times of a sensor is one
measurement, of standard deviation sigma_TOA / sqrt(10).

What the thesis leaves open (we know it by its figures), and what is done here:

- It ignores that the sensors move on while the signal travels. Here an emission leaves at the time
  of its set and arrives after the exact light time, 0.2 to 0.35 ms later; the sensors have moved
  17 mm by then, all alike. The comparison estimators take them where they were at the set.
- Sensor-position noise is drawn anew for every sensor, set and axis; all ten pulses share it.
- Common offsets are along x. Their direction does not matter.
- Sensors that turn back do so at once, at 120 s, and fly for another 120 s.
- The second group takes over after half of the sets.
- Moving emitters start at the static ones' places and move along +x at 30, 60 or 90 m/s.
- With three sensors the fourth is missing.

Everything is drawn from geometry here; nothing of ``geograph.factors`` is used.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.measurements import Arrivals, Constraints, Truth
from geograph.recording import Recording, SmoothSettings
from geograph.sensors import Sensor, SensorErrors, Trajectory

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import ArrayLike, NDArray

Place = tuple[float, float]

EMITTERS_M: tuple[Place, Place] = ((9e3, 100e3), (65e3, 80e3))
"""Places of emitters 1 and 2 of the thesis, metres."""

FIRST_GROUP_M: tuple[Place, ...] = ((1e3, 0.0), (0.0, 3e3), (2e3, 1.5e3), (-1e3, -1.5e3))
"""Sensors at time zero, metres."""

SECOND_GROUP_M: tuple[Place, ...] = ((10e3, 0.0), (8e3, 1e3), (9e3, -0.5e3), (11e3, -1.5e3))
"""Sensors of the second group at time zero, metres, for the change of reference."""

SENSOR_SPEED_M_S = 50.0
ALTITUDE_SIGMA_M = 0.1
"""How closely a recording is held to the plane z = 0."""

_MOVING_NOISE = 1e-3
"""Process noise of a moving emitter's recording, m/s^1.5: 0.8 m of position in 120 s."""


@dataclass(frozen=True, kw_only=True)
class MovingSensors:
    """One variant of the study.

    Parameters
    ----------
    name
        What it is called; a part of what seeds the noise.
    emitter_m, emitter_velocity_m_s
        Place at time zero, and velocity.
    sigma_toa_s
        Standard deviation of the arrival time of one pulse.
    pulses
        Pulses of which each measurement is the mean.
    sets, interval_s
        Number of sets of arrival times, and the time between two; the first is after one interval.
    group_m
        The sensors at time zero.
    second_group_m
        Sensors that hear the second half of the sets in place of the first group; empty: none.
    turn_back_s
        When the sensors turn round; None: they do not.
    position_noise_m
        Error of each coordinate of each sensor at each set, standard deviation.
    straight_platforms
        Whether the recording says that the sensors fly straight and evenly, so that the noisy
        positions are fixes of a straight path.
    common_offset_m
        Constant error of all sensors' x.

    Raises
    ------
    ValueError
        If there are fewer than three sensors, or the groups differ in size.
    """

    name: str
    emitter_m: Place = EMITTERS_M[0]
    emitter_velocity_m_s: Place = (0.0, 0.0)
    sigma_toa_s: float = 1e-9
    pulses: int = 10
    sets: int = 60
    interval_s: float = 2.0
    group_m: tuple[Place, ...] = FIRST_GROUP_M
    second_group_m: tuple[Place, ...] = ()
    turn_back_s: float | None = None
    position_noise_m: float = 0.0
    straight_platforms: bool = False
    common_offset_m: float = 0.0

    def __post_init__(self) -> None:
        if len(self.group_m) < 3:
            raise ValueError(f"{len(self.group_m)} sensors; expected at least 3")
        if self.second_group_m and len(self.second_group_m) != len(self.group_m):
            raise ValueError(
                f"groups of {len(self.group_m)} and {len(self.second_group_m)} sensors; "
                "expected the same number"
            )

    @property
    def sigma_s(self) -> float:
        """Standard deviation of one measured arrival time, seconds."""
        return float(self.sigma_toa_s / np.sqrt(self.pulses))

    @property
    def moving(self) -> bool:
        """Whether the emitter moves."""
        return self.emitter_velocity_m_s != (0.0, 0.0)

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Shape (sets,): times of the sets, at which the emissions leave."""
        return self.interval_s * np.arange(1.0, self.sets + 1.0)

    @property
    def heard_by(self) -> NDArray[np.int64]:
        """Shape (sets, sensors of a group): which sensors hear each set."""
        count = len(self.group_m)
        heard = np.tile(np.arange(count), (self.sets, 1))
        if self.second_group_m:
            heard[self.sets // 2 :] += count
        return heard

    def emitter_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return positions of the emitter, shape (..., 2), metres."""
        time = np.asarray(time_s, dtype=np.float64)[..., None]
        place, velocity = np.array([self.emitter_m, self.emitter_velocity_m_s])
        return np.asarray(place + time * velocity)

    def sensors_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return true positions of all sensors, metres.

        Parameters
        ----------
        time_s
            Shape (..., m) or (..., 1): a time for each of the m sensors of both groups.

        Returns
        -------
        Shape (..., m, 2).
        """
        start = np.array(self.group_m + self.second_group_m)
        time = np.asarray(time_s, dtype=np.float64)
        if self.turn_back_s is not None:
            time = self.turn_back_s - np.abs(time - self.turn_back_s)
        travelled = np.broadcast_to(SENSOR_SPEED_M_S * time, (*time.shape[:-1], len(start)))
        return np.asarray(start + np.stack([travelled, np.zeros_like(travelled)], axis=-1))


def _variants() -> Iterator[MovingSensors]:
    for number, place in enumerate(EMITTERS_M, start=1):
        base = MovingSensors(name=f"emitter-{number}", emitter_m=place)
        for nanoseconds in (1, 5, 10):
            yield replace(base, name=f"{base.name}-{nanoseconds}ns", sigma_toa_s=nanoseconds * 1e-9)
        for noise in (0.1, 0.75, 1.5):
            noisy = replace(base, name=f"{base.name}-position-{noise}m", position_noise_m=noise)
            yield noisy
            yield replace(noisy, name=f"{base.name}-straight-{noise}m", straight_platforms=True)
        for offset in (5, 20, 50):
            yield replace(base, name=f"{base.name}-offset-{offset}m", common_offset_m=float(offset))
        for speed in (30, 60, 90):
            yield replace(
                base,
                name=f"{base.name}-moving-{speed}m_s",
                emitter_velocity_m_s=(float(speed), 0.0),
            )
        yield replace(base, name=f"{base.name}-two-groups", second_group_m=SECOND_GROUP_M)
        yield replace(base, name=f"{base.name}-turn-back", sets=120, turn_back_s=120.0)
        yield replace(base, name=f"{base.name}-three-sensors", group_m=FIRST_GROUP_M[:3])


VARIANTS: dict[str, MovingSensors] = {variant.name: variant for variant in _variants()}
"""Every variant of the thesis, for both emitters, by name."""


@dataclass(frozen=True, eq=False)
class Runs:
    """Many independent runs of one variant.

    Attributes
    ----------
    variant
        What was simulated.
    time_s
        Shape (k,): times of the sets.
    sensor
        Shape (k, n), integer: the sensors that heard each set.
    sensor_m
        Shape (runs, k, n, 2): where those sensors say that they were at the set, metres.
    toa_s
        Shape (runs, k, n): their arrival times, seconds.
    """

    variant: MovingSensors
    time_s: NDArray[np.float64]
    sensor: NDArray[np.int64]
    sensor_m: NDArray[np.float64]
    toa_s: NDArray[np.float64]

    def __len__(self) -> int:
        return int(self.toa_s.shape[0])

    @property
    def sigma_m(self) -> float:
        """Standard deviation of one arrival time as a range, metres."""
        return SPEED_OF_LIGHT_M_S * self.variant.sigma_s


def arrival_times(variant: MovingSensors) -> NDArray[np.float64]:
    """Return error-free arrival times, shape (sets, all sensors), seconds.

    An emission leaves at the time of its set and meets each sensor where that is on arrival.
    """
    emission = variant.time_s[:, None]
    emitter = variant.emitter_at(variant.time_s)[:, None, :]
    arrival = emission
    # Each step is 6e6 times closer than the one before: the sensors' speed over that of light.
    for _ in range(4):
        distance = np.linalg.norm(variant.sensors_at(arrival) - emitter, axis=-1)
        arrival = emission + distance / SPEED_OF_LIGHT_M_S
    return arrival


def _streams(variant: MovingSensors, seed: int) -> list[np.random.Generator]:
    """Return the sources of one run's errors: times, positions, positions after the last set."""
    sequence = np.random.SeedSequence(seed, spawn_key=(zlib.crc32(variant.name.encode()),))
    return [np.random.default_rng(child) for child in sequence.spawn(3)]


def draw(variant: MovingSensors, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return one run's errors: times (sets, all sensors), positions (sets, all sensors, 2).

    Parameters
    ----------
    variant
        One of :data:`VARIANTS`, or another.
    seed
        A whole number of at least 0.
    """
    times, positions, _ = _streams(variant, seed)
    shape = (variant.sets, len(variant.group_m) + len(variant.second_group_m))
    return (
        variant.sigma_s * times.standard_normal(shape),
        variant.position_noise_m * positions.standard_normal((*shape, 2)),
    )


def _reported(variant: MovingSensors, noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where sensors say that they were at each set, shape (..., sets, sensors, 2)."""
    return _said(variant, variant.time_s, noise)


def _said(
    variant: MovingSensors, time_s: NDArray[np.float64], noise: NDArray[np.float64]
) -> NDArray[np.float64]:
    offset = np.array([variant.common_offset_m, 0.0])
    return np.asarray(variant.sensors_at(time_s[:, None]) + offset + noise)


def simulate(variant: MovingSensors, seeds: Sequence[int]) -> Runs:
    """Simulate runs, one for each seed; a seed gives the same run as :func:`recordings`.

    Parameters
    ----------
    variant
        One of :data:`VARIANTS`, or another.
    seeds
        Whole numbers of at least 0.
    """
    errors = [draw(variant, seed) for seed in seeds]
    toa = arrival_times(variant) + np.array([error[0] for error in errors])
    reported = _reported(variant, np.array([error[1] for error in errors]))
    heard = variant.heard_by
    sets = np.arange(variant.sets)[:, None]
    return Runs(variant, variant.time_s, heard, reported[:, sets, heard], toa[:, sets, heard])


def recordings(variant: MovingSensors, seeds: Sequence[int]) -> Iterator[Recording]:
    """Yield a recording for each seed: what the sensors of one run would have written down.

    The frame is local. Each sensor's trajectory holds the positions that it reported at the sets,
    and, but for straight platforms, whose path is estimated from the fixes of the sets alone, one
    interval later: the last set arrives after it was emitted.
    A constraint keeps the path at z = 0. Errors of sensors that the thesis leaves out of its
    models, the common offsets, have no prior here either.

    Parameters
    ----------
    variant
        One of :data:`VARIANTS`, or another.
    seeds
        Whole numbers of at least 0.
    """
    exact = arrival_times(variant)
    heard = variant.heard_by
    emission = np.repeat(np.arange(variant.sets), heard.shape[1])
    for seed in seeds:
        time_error, position_error = draw(variant, seed)
        toa = (exact + time_error)[emission, heard.ravel()]
        yield Recording(
            name=f"{variant.name}-{seed}",
            frame="local",
            sensors=_sensors(variant, *_table(variant, seed, position_error)),
            arrivals=Arrivals(
                emission=emission,
                sensor=heard.ravel(),
                toa_s=toa,
                sigma_s=np.full(toa.size, variant.sigma_s),
                line=np.zeros(toa.size, dtype=np.int64),
            ),
            constraints=Constraints(
                time_s=np.array([np.nan]),
                kind=("altitude_m",),
                value=np.zeros(1),
                sigma=np.full(1, ALTITUDE_SIGMA_M),
                line=np.zeros(1, dtype=np.int64),
            ),
            truth=_truth(variant),
            settings=SmoothSettings(
                motion="constant-velocity" if variant.moving else "static",
                process_noise=_MOVING_NOISE if variant.moving else "auto",
                loss="none",
            ),
        )


def _table(
    variant: MovingSensors, seed: int, position_error: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return times (k,) and reported positions (k, sensors, 2) of the sensors' trajectories."""
    time = variant.time_s
    if not variant.straight_platforms:
        time = np.append(time, time[-1] + variant.interval_s)
        more = _streams(variant, seed)[2].standard_normal((1, *position_error.shape[1:]))
        position_error = np.concatenate([position_error, variant.position_noise_m * more])
    return time, _said(variant, time, position_error)


def _sensors(
    variant: MovingSensors, time_s: NDArray[np.float64], reported_m: NDArray[np.float64]
) -> dict[str, Sensor]:
    position = np.concatenate([reported_m, np.zeros((*reported_m.shape[:-1], 1))], axis=-1)
    errors = SensorErrors(position_noise_m=variant.position_noise_m)
    names = [f"S{index + 1}" for index in range(reported_m.shape[1])]
    return {
        name: Sensor(
            name=name,
            trajectory=Trajectory(time_s, position[:, index]),
            axes="xyz",
            errors=errors,
            platform_process_noise=0.0 if variant.straight_platforms else None,
        )
        for index, name in enumerate(names)
    }


def _truth(variant: MovingSensors) -> Truth:
    # From before the first emission to after the last, whatever moment a smoother reports.
    time = np.arange(0.0, variant.time_s[-1] + 2.0 * variant.interval_s, variant.interval_s)
    position = np.concatenate([variant.emitter_at(time), np.zeros((time.size, 1))], axis=-1)
    velocity = np.broadcast_to([*variant.emitter_velocity_m_s, 0.0], position.shape).copy()
    return Truth(time_s=time, position_m=position, velocity_m_s=velocity)
