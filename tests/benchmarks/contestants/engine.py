"""Ours: vectorised linearisation, structured elimination."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from contestants.base import TOLERANCE, Contestant, Estimate, Run, Stages
from contestants.timing import seconds
from geograph.eliminate import Elimination
from geograph.families import (
    CONSTRAINT_FAMILIES,
    ArrivalFamily,
    BearingFamily,
    FrequencyDifferenceFamily,
    Values,
    World,
)
from geograph.frames import SensorGeometry
from geograph.measurements import Arrivals, Bearings, FrequencyDifferences
from geograph.motion import Density, Motion
from geograph.problem import PathPrior, Problem
from geograph.sensors import Sensor, SensorErrors, Trajectory
from geograph.solver import Solution, Status, solve
from geograph.states import AZIMUTH, CLOCK, ELEVATION, FREQUENCY, SensorStates

if TYPE_CHECKING:
    from collections.abc import Iterator

    from model import Pass
    from numpy.typing import NDArray

    from geograph.families import Family


def problem_of(data: Pass) -> tuple[Problem, Values]:
    """Return a pass as a problem of the engine, with its first guess."""
    names = ("azimuth_bias_rad", "elevation_bias_rad", "azimuth_drift_rad_s")
    names += ("elevation_drift_rad_s", "clock_offset_s", "frequency_offset_hz")
    errors = SensorErrors(**dict(zip(names, data.error_sigma.tolist(), strict=False)))
    sensors = [
        Sensor(name=f"S{index}", position_m=place, axes="xyz", errors=errors)
        if not speed.any()
        else Sensor(name=f"S{index}", trajectory=_straight(data, place, speed), errors=errors)
        for index, (place, speed) in enumerate(zip(data.sensor_m, data.sensor_m_s, strict=True))
    ]
    states = SensorStates(sensors, range(len(sensors)), 0.0)
    motion = "static" if data.knots_s.size == 1 else "constant-acceleration"
    problem = Problem(
        motion=Motion(motion, Density.of(float(data.noise)), "local"),
        knots_s=data.knots_s,
        families=list(_families(data, sensors, states)),
        states=states,
        walk_scale=np.zeros(0),
        prior=PathPrior(data.guess[0], data.prior_sigma),
        path_scale=data.scale,
    )
    return problem, Values(data.guess, np.zeros((data.knots_s.size, 0)), np.zeros(states.size))


def _straight(data: Pass, place: NDArray[np.float64], speed: NDArray[np.float64]) -> Trajectory:
    time = np.array([data.emitted_s.min() - 1.0, data.emitted_s.max() + 1.0])
    return Trajectory(time_s=time, position_m=place + time[:, None] * speed)


def _families(data: Pass, sensors: list[Sensor], states: SensorStates) -> Iterator[Family]:
    geometry = SensorGeometry(sensors, "local")
    if data.time_s.size:
        yield BearingFamily(
            _bearings(data),
            geometry=geometry,
            states=states,
            walk_scale=np.zeros(0),
            speed_m_s=np.inf,
            weight=np.ones(data.time_s.size),
            position_noise_m=np.zeros(data.time_s.size),
        )
    world = World(geometry, states, np.zeros(0), float(data.speed_m_s))
    sets, count = data.toa_s.shape
    if sets:
        arrivals = Arrivals(
            emission=np.repeat(np.arange(sets), count),
            sensor=np.tile(np.arange(count), sets),
            toa_s=data.toa_s.ravel(),
            sigma_s=np.full(data.toa_s.size, float(data.toa_sigma_s)),
            line=np.arange(data.toa_s.size),
        )
        none = np.zeros(data.toa_s.size)
        yield ArrivalFamily(arrivals, world=world, weight=none + 1.0, position_noise_m=none)
    size = data.fdoa_hz.size
    if size:
        differences = FrequencyDifferences(
            time_s=np.repeat(data.fdoa_time_s, count - 1),
            sensor=np.tile(np.arange(1, count), sets),
            reference=np.zeros(size, dtype=np.int64),
            fdoa_hz=data.fdoa_hz.ravel(),
            carrier_hz=np.full(size, float(data.carrier_hz)),
            sigma_hz=np.full(size, float(data.fdoa_sigma_hz)),
            sigma_reference_hz=np.zeros(size),
            line=np.arange(size),
        )
        both = np.zeros(size), np.zeros(size)
        yield FrequencyDifferenceFamily(
            differences, world=world, weight=np.ones(size), position_noise_m=both
        )
    if np.isfinite(data.altitude_sigma_m):
        constraint = CONSTRAINT_FAMILIES["altitude_m"](
            time_s=np.array([np.nan]),
            value=np.zeros(1),
            sigma=np.array([float(data.altitude_sigma_m)]),
            line=np.zeros(1, dtype=np.int64),
            frame="local",
            surface=None,
        )
        yield constraint.expanded(data.knots_s)


def _bearings(data: Pass) -> Bearings:
    count = data.time_s.size
    sigma = np.full(count, float(data.sigma_rad))
    return Bearings(
        time_s=data.time_s,
        sensor=data.sensor,
        azimuth_rad=data.azimuth_rad,
        elevation_rad=data.elevation_rad,
        sigma_azimuth_rad=sigma,
        sigma_elevation_rad=sigma,
        isotropic=np.ones(count, dtype=bool),
        line=np.arange(count),
    )


def estimate_of(problem: Problem, values: Values, iterations: int) -> Estimate:
    """Return values of the engine as an estimate."""
    states = problem.states
    count = 1 + max((state.sensor for state in states.constants), default=-1)
    columns = {
        (AZIMUTH, False): 0,
        (ELEVATION, False): 1,
        (AZIMUTH, True): 2,
        (ELEVATION, True): 3,
        (CLOCK, False): 4,
        (FREQUENCY, False): 5,
    }
    errors = np.zeros((count, len(states.constants) // max(count, 1)))
    for state, value in zip(states.constants, values.constants, strict=True):
        errors[state.sensor, columns[state.channel, state.drift]] = value * state.sigma
    return Estimate(values.path, errors, iterations)


class _EngineRun(Run):
    def __init__(self, problem: Problem, values: Values) -> None:
        self._problem = problem
        self._values = values
        self._solution: Solution

    def solve(self) -> Estimate:
        self._solution = solve(self._problem, self._values, tolerance=TOLERANCE)
        if self._solution.status is not Status.CONVERGED:
            raise RuntimeError(f"ended as {self._solution.status}")
        return estimate_of(self._problem, self._solution.values, self._solution.iterations)

    def marginals(self) -> NDArray[np.float64]:
        assert self._solution.elimination is not None
        scale = self._problem.scale
        return self._solution.elimination.marginals().knots * scale[:, None] * scale

    def stages(self) -> Stages:
        values = self._solution.values
        system = self._problem.linearise(values)
        return Stages(
            seconds(lambda: self._problem.linearise(values)),
            seconds(lambda: Elimination(system).solve()),
        )


class Engine(Contestant):
    """geograph's batch engine."""

    name = "geograph"
    about = "the batch engine: all measurements in one pass, elimination along the chain"
    too_slow = frozenset()

    def set_up(self, data: Pass) -> Run:
        return _EngineRun(*problem_of(data))
