"""Ours: vectorised linearisation, structured elimination."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from contestants.base import TOLERANCE, Contestant, Estimate, Run, Stages
from contestants.timing import seconds
from geograph.eliminate import Elimination
from geograph.families import BearingFamily, Values
from geograph.frames import SensorGeometry
from geograph.measurements import Bearings
from geograph.motion import Density, Motion
from geograph.problem import PathPrior, Problem
from geograph.sensors import Sensor, SensorErrors
from geograph.solver import Solution, Status, solve
from geograph.states import SensorStates

if TYPE_CHECKING:
    from model import Pass
    from numpy.typing import NDArray


def problem_of(data: Pass) -> tuple[Problem, Values]:
    """Return a pass as a problem of the engine, with its first guess."""
    azimuth_bias, elevation_bias, azimuth_drift, elevation_drift = data.error_sigma.tolist()
    errors = SensorErrors(
        azimuth_bias_rad=azimuth_bias,
        elevation_bias_rad=elevation_bias,
        azimuth_drift_rad_s=azimuth_drift,
        elevation_drift_rad_s=elevation_drift,
    )
    sensors = [
        Sensor(name=f"S{index}", position_m=position, axes="xyz", errors=errors)
        for index, position in enumerate(data.sensor_m)
    ]
    count = data.time_s.size
    sigma = np.full(count, float(data.sigma_rad))
    bearings = Bearings(
        time_s=data.time_s,
        sensor=data.sensor,
        azimuth_rad=data.azimuth_rad,
        elevation_rad=data.elevation_rad,
        sigma_azimuth_rad=sigma,
        sigma_elevation_rad=sigma,
        isotropic=np.ones(count, dtype=bool),
        line=np.arange(count),
    )
    states = SensorStates(sensors, range(len(sensors)), 0.0)
    family = BearingFamily(
        bearings,
        geometry=SensorGeometry(sensors, "local"),
        states=states,
        walk_scale=np.zeros(0),
        speed_m_s=np.inf,
        weight=np.ones(count),
        position_noise_m=np.zeros(count),
    )
    problem = Problem(
        motion=Motion("constant-acceleration", Density.of(float(data.noise)), "local"),
        knots_s=data.knots_s,
        families=[family],
        states=states,
        walk_scale=np.zeros(0),
        prior=PathPrior(data.guess[0], data.prior_sigma),
        path_scale=data.scale,
    )
    return problem, Values(data.guess, np.zeros((data.knots_s.size, 0)), np.zeros(states.size))


def estimate_of(problem: Problem, values: Values, iterations: int) -> Estimate:
    """Return values of the engine as an estimate."""
    errors = np.zeros((len(problem.states.constants) // 4, 4))
    for state, value in zip(problem.states.constants, values.constants, strict=True):
        errors[state.sensor, state.channel + 2 * state.drift] = value * state.sigma
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
    about = "the batch engine: all bearings in one NumPy pass, elimination along the chain"

    def set_up(self, data: Pass) -> Run:
        return _EngineRun(*problem_of(data))
