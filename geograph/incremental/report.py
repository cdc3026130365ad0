"""From a state to what is told of it: the newest estimate, and the whole track."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from geograph.eliminate import Factorisation
from geograph.incremental.estimate import SensorErrorsLater
from geograph.incremental.rows import FIXES, TABLES, numbered_table
from geograph.incremental.start import problem_of, recording_of
from geograph.measurements import Bearings
from geograph.orbit_forces import force_estimates
from geograph.prepare import without_refraction
from geograph.report import make_track
from geograph.smoother import Smoother
from geograph.solver import Solution, Status
from geograph.states import NO_SENSOR, RECORDING_NAME
from geograph.time_shift import rates
from geograph.track import SensorEstimate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.eliminate import LinearSystem
    from geograph.incremental.chain import Chain, Final
    from geograph.incremental.model import Model
    from geograph.incremental.rows import Rows
    from geograph.incremental.state import State
    from geograph.problem import Problem
    from geograph.sweep import Marginals
    from geograph.track import Track


def newest_covariance(state: State) -> NDArray[np.float64]:
    """Return the covariance of the newest knot's path, shape (3 order, 3 order), SI.

    Parameters
    ----------
    state
        After its start.
    """
    model, chain = state.running
    assert chain.final is not None
    m, scale = 3 * model.motion.order, model.path_scale
    path = chain.final.covariance()[:m, :m] * np.outer(scale[:m], scale[:m])
    if model.shift is not None:
        at = chain.path[-1][None], np.array(chain.knots_s[-1:])
        rate = model.shift.sigma_s * rates(model.motion, *at)[0, :m]
        path = path + np.outer(rate, rate)
    return np.asarray(path)


def newest_errors(state: State) -> SensorErrorsLater:
    """Return the sensors' errors, worked out when they are asked for.

    Parameters
    ----------
    state
        After its start; nothing of its chain is held but the newest estimates.
    """
    model, chain = state.running
    assert chain.final is not None
    at = chain.path[-1], chain.chains[-1], chain.constants
    return SensorErrorsLater(partial(_errors, model, state.template.sensor_names, chain.final, at))


def _errors(
    model: Model,
    names: tuple[str, ...],
    final: Final,
    at: tuple[NDArray[np.float64], ...],
) -> dict[str, dict[str, SensorEstimate]]:
    path, chains, constants = at
    states, m = model.prepared.states, path.size
    covariance = final.covariance()
    variance = np.diagonal(covariance)
    constant = variance[m + chains.size :]
    if model.shift is not None:
        constant = constant + (model.shift.sigma_s * model.shift.by_shift) ** 2
    sigma, estimates = np.sqrt(constant).tolist(), constants.tolist()
    errors = force_estimates(model.motion, path, covariance, model.path_scale)
    for column, entry in enumerate(states.constants):
        if entry.sensor in model.active or entry.sensor == NO_SENSOR:
            name = RECORDING_NAME if entry.sensor == NO_SENSOR else names[entry.sensor]
            errors.setdefault(name, {})[entry.name] = SensorEstimate(
                entry.unit, estimates[column] * entry.sigma, sigma[column] * entry.sigma,
                entry.sigma,
            )  # fmt: skip
    for column, walk in enumerate(states.walks):
        if walk.sensor in model.active:
            size = float(model.prepared.walk_scale[column])
            errors.setdefault(names[walk.sensor], {})[walk.name] = SensorEstimate(
                walk.unit,
                float(chains[column]) * size,
                float(np.sqrt(variance[m + column])) * size,
                size,
            )
    return errors


class HeldFactorisation(Factorisation):
    """The factorisation that a chain holds, for those who ask for its covariances."""

    def __init__(self, system: LinearSystem, damping: float = 0.0) -> None:
        self.system, self.damping = system, damping
        self.chain: Chain

    @classmethod
    def of(cls, problem: Problem, chain: Chain) -> HeldFactorisation:
        """Return that of a chain."""
        held = cls(problem.linearise(chain.values(0, len(chain.knots_s) - 1)))
        held.chain = chain
        return held

    @property
    def turned_back(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Not held in one piece."""
        raise TypeError("a held factorisation gives covariances alone; expected no way back")

    def _decrease(self, knots: NDArray[np.float64], constants: NDArray[np.float64]) -> float:
        del knots, constants
        raise TypeError("a held factorisation gives covariances alone; expected no step to solve")

    def half_log_determinant(self) -> float:
        """Return half the log determinant of the information."""
        return self.system.factorise().half_log_determinant()

    def marginals(self) -> Marginals:
        """Return all marginal covariances."""
        return self.chain.marginals()


def held_track(state: State) -> Track:
    """Return the track of all that is held, its estimates up to date.

    Its rows are those that are held; after some have left the lag, costs and chi-square are of the
    rest alone.
    """
    model, chain = state.running
    held = {kind: c for kind, c in state.rows().items() if kind != FIXES}
    recording = recording_of(state.template, held, state.whole)
    prepared = replace(
        model.prepared,
        recording=recording,
        bearings=_bearings(model, held),
    )
    smoother = Smoother(prepared, state.settings)
    values = chain.values(0, len(chain.knots_s) - 1)
    problem = problem_of(model, np.array(chain.knots_s), state.rows())
    families = prepared.families(problem.knots_s)
    weights: list[NDArray[np.float64] | None] = []
    rejected: list[NDArray[np.bool_]] = []
    for family in families:
        if family.name not in TABLES:
            weights.append(None)
            continue
        columns = held[family.name]
        kept = columns["kept"][np.argsort(columns["ident"])][
            np.searchsorted(np.sort(columns["ident"]), family.line)
        ]
        rejected.append(~kept)
        weights.append(None if kept.all() else kept.astype(np.float64))
    problem = problem.changed(families=families, weights=weights)
    for family in problem.families:
        model.refresh(family, problem.path, values)
    smoother.problem = problem
    smoother.solution = Solution(
        values,
        Status.CONVERGED,
        problem.cost(values),
        0,
        HeldFactorisation.of(problem, chain),
    )
    smoother.rejected = np.concatenate(rejected) if rejected else np.zeros(0, dtype=bool)
    smoother.attempts = state.attempts
    assert state.resolution is not None
    smoother.resolution = state.resolution
    return make_track(smoother, seconds=0.0)


def _bearings(model: Model, held: Rows) -> Bearings | None:
    """Return the bearings that are held, free of refraction."""
    if "bearings" not in held:
        return None
    table = numbered_table("bearings", held["bearings"])
    assert isinstance(table, Bearings)
    return without_refraction(table, model.prepared.sensors)
