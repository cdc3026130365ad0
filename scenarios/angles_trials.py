"""Trials of the satellite worlds: the published estimators and the factor graph, side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.consistency import nees
from geograph.scenarios.angles_bias import bmod
from geograph.scenarios.angles_estimators import (
    PathEstimate,
    optimise,
    optimise_path,
    triangulation,
)
from geograph.scenarios.angles_windows import Windows, cut
from geograph.scenarios.angles_worlds import AnglesWorld, angles_trial
from geograph.smoother import smooth
from geograph.threads import single_blas_thread
from geograph.workers import Lost, run_isolated

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

BASELINE = "acceleration, CI, kinematic"
"""Levy et al.'s baseline, which is Sprang's best."""

GRAPH = "factor graph"

ESTIMATORS: dict[str, Callable[[Windows], PathEstimate]] = {
    "triangulation": triangulation,
    "static": lambda windows: optimise(windows, 1),
    "static, CI": lambda windows: optimise(windows, 1, intersection=True),
    "velocity": lambda windows: optimise(windows, 2),
    "velocity, CI": lambda windows: optimise(windows, 2, intersection=True),
    "acceleration": lambda windows: optimise(windows, 3),
    "acceleration, CI": lambda windows: optimise(windows, 3, intersection=True),
    "velocity, kinematic": lambda windows: optimise_path(windows, 2, intersection=False),
    "velocity, CI, kinematic": lambda windows: optimise_path(windows, 2),
    "acceleration, kinematic": lambda windows: optimise_path(windows, 3, intersection=False),
    BASELINE: lambda windows: optimise_path(windows, 3),
    "BMod": bmod,
    "BDNLO": lambda windows: optimise_path(windows, 3, biased=True),
}
"""The published estimators, by name."""

_CHUNK = 10


@dataclass(frozen=True, eq=False)
class Scores:
    """What one estimator made of n trials, at the middles of M windows.

    Attributes
    ----------
    rms_m
        Shape (n,): root mean square of the position error along the path, metres.
    nees
        Shape (n, M), with the covariance of the position.
    nees_kinematic
        Shape (n, M), with the kinematic confidence covariance over half of a window; of the graph
        the same as ``nees``.
    converged
        Shape (n,), bool.
    named
        Shape (n,), bool: whether, not converged, it said that the geometry is not observable.
    """

    rms_m: NDArray[np.float64]
    nees: NDArray[np.float64]
    nees_kinematic: NDArray[np.float64]
    converged: NDArray[np.bool_]
    named: NDArray[np.bool_]

    @classmethod
    def joined(cls, parts: Sequence[Scores]) -> Scores:
        """Return the trials of several, one after another."""
        return cls(
            np.concatenate([part.rms_m for part in parts]),
            np.concatenate([part.nees for part in parts]),
            np.concatenate([part.nees_kinematic for part in parts]),
            np.concatenate([part.converged for part in parts]),
            np.concatenate([part.named for part in parts]),
        )


def run_trial(seed: int, world: AnglesWorld, names: Sequence[str]) -> dict[str, Scores]:
    """Simulate one trial and score some estimators on it.

    Parameters
    ----------
    seed
        A whole number of at least 0.
    world
        What the trial is like.
    names
        Of :data:`ESTIMATORS`, or :data:`GRAPH`.
    """
    trial = angles_trial(seed, world)
    windows = cut(trial.recording, world.windows, world.total_sigma_rad)
    truth = trial.path.position_at(windows.time_s)
    result = {}
    for name in names:
        if name == GRAPH:
            track = smooth(trial.recording, raise_on_failure=False)
            points = track.at(windows.time_s)
            error = points.position_m - truth
            own = nees(error, points.position_covariance_m2)
            status = str(track.status)
            result[name] = _scores(error, own, own, status == "converged", status == "unobservable")
            continue
        with single_blas_thread():
            found = ESTIMATORS[name](windows)
        error = found.position_m - truth
        result[name] = _scores(
            error,
            nees(error, found.position_covariance_m2),
            nees(error, found.kinematic_covariance_m2(windows.half_s)),
            bool(found.converged.all()),
            False,
        )
    return result


def _scores(
    error_m: NDArray[np.float64],
    own: NDArray[np.float64],
    kinematic: NDArray[np.float64],
    converged: bool,
    named: bool,
) -> Scores:
    rms = np.sqrt(np.mean(np.sum(error_m**2, axis=1)))
    good = converged and bool(np.isfinite(rms)) and bool(np.isfinite(own).all())
    return Scores(np.array([rms]), own[None], kinematic[None], np.array([good]), np.array([named]))


@dataclass(frozen=True)
class _Job:
    world: AnglesWorld
    seeds: range
    names: tuple[str, ...]


def _work(job: _Job) -> list[dict[str, Scores]]:
    return [run_trial(seed, job.world, job.names) for seed in job.seeds]


def run_trials(
    world: AnglesWorld, seeds: range, names: Sequence[str], *, workers: int = 1
) -> dict[str, Scores]:
    """Return the scores of every estimator over many trials, in the order of the seeds.

    Parameters
    ----------
    world, names
        As in :func:`run_trial`.
    seeds
        One trial each.
    workers
        Processes; 1: this one.

    Raises
    ------
    RuntimeError
        If a process died or a trial raised.
    """
    parts = [seeds[first : first + _CHUNK] for first in range(0, len(seeds), _CHUNK)]
    jobs = [_Job(world, part, tuple(names)) for part in parts]
    done: dict[int, list[dict[str, Scores]]] = {}
    if workers == 1:
        done = {index: _work(job) for index, job in enumerate(jobs)}
    else:
        for index, found in run_isolated(_work, jobs, workers=workers):
            if isinstance(found, Lost):
                first = parts[index].start
                raise RuntimeError(f"{world.name}, seeds from {first}: {found.reason}")
            done[index] = found
    trials = [trial for index in range(len(jobs)) for trial in done[index]]
    return {name: Scores.joined([trial[name] for trial in trials]) for name in names}
