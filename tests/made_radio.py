"""Random problems of arrivals and differences, built by hand: any motion, frame, sensor, error."""

from dataclasses import dataclass

import numpy as np

from geograph.families import (
    ArrivalFamily,
    FrequencyDifferenceFamily,
    TimeDifferenceFamily,
    Values,
    World,
)
from geograph.frames import SensorGeometry
from geograph.measurements import Arrivals, FrequencyDifferences, TimeDifferences
from geograph.motion import Density, Motion
from geograph.problem import PathPrior, Problem
from geograph.sensors import Sensor, SensorErrors, Trajectory
from geograph.states import SensorStates

CENTRE = {"local": np.array([100.0, -200.0, 30.0]), "ecef": np.array([4.0e6, 9e5, 4.9e6])}
SIGMA_S, SIGMA_HZ = 1e-7, 0.3


@dataclass(frozen=True)
class RadioKind:
    """What a random problem has."""

    frame: str = "local"
    motion: str = "constant-velocity"
    speed_m_s: float = 299792458.0
    moving: bool = True
    clocks: bool = True
    positions: bool = True
    walks: bool = False
    platforms: bool = False
    fast: bool = False
    common: bool = True
    knots: int = 3


def radio_problem(rng, kind):
    """Return a problem of all three families, and values near its truth."""
    slow = kind.speed_m_s < 1e6
    length, speed = (500.0, 20.0) if slow else (2e5, 3e3)
    knots = np.cumsum(np.concatenate([[5.0], rng.uniform(5.0, 9.0, kind.knots - 1)]))
    if kind.motion == "static":
        knots = knots[:1]
    order = Motion(kind.motion, Density.of(1.0), kind.frame).order
    centre = CENTRE[kind.frame] + 0.4 * length * rng.normal(size=3)
    start = np.stack([centre, speed * rng.normal(size=3), 0.01 * speed * rng.normal(size=3)])
    since = (knots - knots[0])[:, None]
    path = np.concatenate(
        [
            start[0] + start[1] * since + start[2] * since**2 / 2,
            start[1] + start[2] * since,
            np.repeat(start[2:], knots.size, axis=0),
        ],
        axis=1,
    )
    if order == 1 and kind.motion == "static":
        path = np.repeat(path[:1], knots.size, axis=0)
    sensors = [
        _sensor(rng, kind, name, length=length, speed=speed, knots=knots) for name in "ABCDE"
    ]
    states = SensorStates(sensors, range(5), 3.0, 1e-3 * kind.speed_m_s * kind.fast)
    scale = states.chain_scale(max(float(np.ptp(knots)), 1.0))
    world = World(SensorGeometry(sensors, kind.frame), states, scale, kind.speed_m_s)
    powers = np.repeat([length / 10, speed / 3, 0.1 * speed][:order], 3)
    problem = Problem(
        motion=Motion(kind.motion, Density.of(10.0), kind.frame),
        knots_s=knots,
        families=_families(rng, kind, world, (start, knots)),
        states=states,
        walk_scale=scale,
        prior=PathPrior(path[0, : 3 * order], 10.0 * powers),
        path_scale=powers,
    )
    return problem, Values(
        path[:, : 3 * order],
        rng.normal(size=(knots.size, states.chains)),
        rng.normal(size=states.size),
    )


def _sensor(rng, kind, name, *, length, speed, knots):
    sigma = length / kind.speed_m_s
    platform = kind.platforms and name in "AB"
    errors = SensorErrors(
        clock_offset_s=1e-3 * sigma * kind.clocks,
        clock_drift_s_s=1e-5 * sigma * kind.clocks,
        clock_instability_s_sqrt_s=1e-4 * sigma * kind.walks,
        frequency_offset_hz=20.0 * kind.clocks,
        frequency_drift_hz_s=0.1 * kind.clocks,
        position_m=1e-3 * length * (kind.positions and name in "BC"),
        position_noise_m=1e-4 * length if kind.positions or platform else 0.0,
    )
    place = CENTRE[kind.frame] + length * rng.normal(size=3)
    if not (kind.moving and name != "E"):
        return Sensor(name=name, position_m=place, axes="xyz", errors=errors)
    count = {"A": 2, "B": 3}.get(name, 12)
    time = np.linspace(knots[0] - 6.0, knots[-1] + 12.0, count)
    time[1:-1] += rng.uniform(-0.3, 0.3, count - 2)
    ways = place + np.outer(time - time.mean(), rng.normal(size=3)) * speed / 3
    return Sensor(
        name=name,
        trajectory=Trajectory(time, ways + rng.normal(size=ways.shape) * speed / 50),
        axes="xyz",
        errors=errors,
        platform_process_noise=0.1 if platform else None,
    )


def _received(rng, kind, world, truth, *, emitted, sensor):
    """Return times of arrival to some microseconds, and to milliseconds of sound."""
    start, knots = truth
    since = (emitted - knots[0])[:, None] * (kind.motion != "static")
    place = start[0] + start[1] * since + start[2] * since**2 / 2
    received = emitted.copy()
    for _ in range(3):
        there = world.geometry.motion(sensor, received).position_m
        received = emitted + np.linalg.norm(place - there, axis=1) / kind.speed_m_s
    return received + 1e-3 * rng.normal(size=emitted.size) * (received - emitted)


def _families(rng, kind, world, truth):
    """Sets of arrivals of two to five sensors, and differences against the first of them.

    One set is long: its sensors hear the emission several times.
    """
    knots = truth[1]
    emitted = np.sort(rng.uniform(knots[0] - 1.0, knots[-1] + 1.0, 7))
    sets = [rng.permutation(5)[: rng.integers(2, 6)] for _ in emitted[1:]]
    sets.append(rng.integers(0, 5, 30))
    emission = np.repeat(np.arange(7), [own.size for own in sets])
    sensor = np.concatenate(sets)
    toa = _received(rng, kind, world, truth, emitted=emitted[emission], sensor=sensor)
    mixed = rng.permutation(toa.size)
    noise = np.array([world.geometry.sensors[s].errors.position_noise_m for s in range(5)])
    arrivals = Arrivals(
        emission=emission[mixed],
        sensor=sensor[mixed],
        toa_s=toa[mixed],
        sigma_s=SIGMA_S * rng.uniform(1.0, 2.0, toa.size),
        line=np.arange(toa.size),
    )
    first = np.concatenate(
        [np.full(own.size, k) for k, own in zip(_starts(sets), sets, strict=True)]
    )
    other = np.flatnonzero(first != np.arange(first.size))
    held = first[other]
    size = other.size
    columns = {
        "time_s": toa[held],
        "sensor": sensor[other],
        "reference": sensor[held],
        "line": np.arange(size),
    }
    part = 0.6 * kind.common
    differences = TimeDifferences(
        tdoa_s=toa[other] - toa[held],
        sigma_s=np.full(size, SIGMA_S),
        sigma_reference_s=np.full(size, part * SIGMA_S),
        **columns,
    )
    rates = FrequencyDifferences(
        fdoa_hz=100.0 * rng.normal(size=size),
        carrier_hz=1e8 * rng.uniform(1.0, 1.1, size),
        sigma_hz=np.full(size, SIGMA_HZ),
        sigma_reference_hz=np.full(size, part * SIGMA_HZ),
        **columns,
    )
    weight = rng.uniform(0.3, 1.0, toa.size)
    both = noise[columns["sensor"]], noise[columns["reference"]]
    return [
        ArrivalFamily(arrivals, world=world, weight=weight, position_noise_m=noise[sensor[mixed]]),
        TimeDifferenceFamily(differences, world=world, weight=weight[:size], position_noise_m=both),
        FrequencyDifferenceFamily(rates, world=world, weight=weight[:size], position_noise_m=both),
    ]


def _starts(sets):
    return np.cumsum([0, *(own.size for own in sets[:-1])])
