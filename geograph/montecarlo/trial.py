"""One run: a recording is simulated, smoothed, and scored against its truth and its bound.

Scores are those at up to 61 rows of the truth table, spread evenly, as far as the track reaches;
an object at rest has one. The bound is the posterior Cramer-Rao bound of the run's own problem at
the true path (with the measurements that the run kept), read between the knots as the covariance of
a track is.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.bounds import posterior
from geograph.consistency import nees
from geograph.eliminate import NotPositiveDefiniteError
from geograph.errors import InputError, SolveError
from geograph.families import Values
from geograph.losses import Loss
from geograph.planned import truth_path
from geograph.results.extract import height_held
from geograph.smoother import smooth
from geograph.solver import Status
from geograph.threads import single_blas_thread

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from geograph.measurements import Truth
    from geograph.recording import Recording
    from geograph.track import Track

POINTS = 61
"""Most times at which a run is scored."""

FAILED, CRASHED = "failed", "crashed"
"""Status of a run that could not be simulated or smoothed at all; and of one that ended in an error
that nobody expected, or with its process."""


SCORES = ("time_s", "square_m2", "sigma2_m2", "bound_m2", "nees")
"""Names of the scores of a run."""


@dataclass(frozen=True)
class Task:
    """Which run is wanted.

    Parameters
    ----------
    point, run
        Its place in the study: which parameters, and which run of these.
    values
        Parameters of the scenario that differ from their defaults.
    seed
        Of its random numbers.
    """

    point: int
    run: int
    values: tuple[tuple[str, Any], ...]
    seed: int


@dataclass(frozen=True, eq=False)
class Run:
    """What came of one run; scores of shape (n,) are empty unless it converged.

    Attributes
    ----------
    point, run, seed
        As in :class:`Task`.
    status
        The solver's, ``"failed"`` or ``"crashed"``.
    message
        Why it did not converge, in one line.
    iterations, measurements
        Of the solve.
    axes
        How many coordinates are scored: 3, or 2 where the height was given.
    seconds, cpu_seconds
        How long simulation, smoothing and scores took.
    time_s
        Times of the scores; NaN scores where the track does not reach.
    square_m2, sigma2_m2, bound_m2
        Squared error of the position, the trace of its covariance, and that of the bound.
    nees
        Normalised squared error.
    """

    point: int
    run: int
    seed: int
    status: str
    message: str
    iterations: int
    measurements: int
    axes: int
    seconds: float
    cpu_seconds: float
    time_s: NDArray[np.float64]
    square_m2: NDArray[np.float64]
    sigma2_m2: NDArray[np.float64]
    bound_m2: NDArray[np.float64]
    nees: NDArray[np.float64]

    @classmethod
    def without_scores(cls, task: Task, status: str, message: str = "") -> Run:
        """Return a run that came to nothing."""
        none = np.empty(0)
        return cls(
            point=task.point,
            run=task.run,
            seed=task.seed,
            status=status,
            message=message,
            iterations=0,
            measurements=0,
            axes=3,
            seconds=0.0,
            cpu_seconds=0.0,
            **dict.fromkeys(SCORES, none),
        )

    @property
    def converged(self) -> bool:
        """Whether the solve converged, so that there are scores."""
        return self.status == Status.CONVERGED


def run_trial(
    task: Task,
    *,
    simulate: Callable[[Mapping[str, Any], int], Recording],
    changes: Mapping[str, Any],
) -> Run:
    """Simulate, smooth and score one run.

    Parameters
    ----------
    task
        Which.
    simulate
        Gives the recording, with its truth, of parameters and a seed.
    changes
        Settings that differ from the recording's own.
    """
    wall, cpu = time.perf_counter(), time.process_time()
    with single_blas_thread():
        found = _outcome(task, simulate, changes)
    return replace(found, seconds=time.perf_counter() - wall, cpu_seconds=time.process_time() - cpu)


def _outcome(
    task: Task,
    simulate: Callable[[Mapping[str, Any], int], Recording],
    changes: Mapping[str, Any],
) -> Run:
    run = Run.without_scores(task, FAILED)
    try:
        recording = simulate(dict(task.values), task.seed)
        track = smooth(recording, raise_on_failure=False, **changes)
    except SolveError as error:
        return replace(run, status=error.status, message=str(error))
    except InputError as error:
        return replace(run, message=str(error))
    run = replace(
        run,
        status=str(track.status),
        iterations=int(track.summary["iterations"]),
        measurements=int(track.summary["measurements"]),
    )
    if not run.converged:
        reasons = [track.summary.get("message"), *(track.summary.get("weakly_observed") or ())]
        return replace(run, message=str(next(filter(None, reasons), "")))
    if recording.truth is None:
        return replace(run, status=FAILED, message="the recording has no truth to be scored by")
    return _scored(run, track, recording.truth)


def _scored(run: Run, track: Track, truth: Truth) -> Run:
    axes = 2 if height_held(track.recording) else 3
    rows = np.unique(np.linspace(0, len(truth) - 1, POINTS).round().astype(np.int64))
    if track.problem.motion.static:
        rows = rows[rows.size // 2 :][:1]
        inside = np.ones(1, dtype=bool)
    else:
        low, high = track.time_s[0], track.time_s[-1]
        inside = (truth.time_s[rows] >= low) & (truth.time_s[rows] <= high)
    times = truth.time_s[rows]
    points = track.at(times[inside])
    error = (points.position_m - truth.position_m[rows[inside]])[:, :axes]
    covariance = points.position_covariance_m2[:, :axes, :axes]
    bound = bound_track(track, truth).at(times[inside]).position_covariance_m2[:, :axes, :axes]

    def spread(values: NDArray[np.float64]) -> NDArray[np.float64]:
        full = np.full(rows.size, np.nan)
        full[inside] = values
        return full

    return replace(
        run,
        axes=axes,
        time_s=times,
        square_m2=spread(np.sum(error**2, axis=1)),
        sigma2_m2=spread(np.trace(covariance, axis1=1, axis2=2)),
        bound_m2=spread(np.trace(bound, axis1=1, axis2=2)),
        nees=spread(nees(error, covariance)),
    )


def bound_track(track: Track, truth: Truth) -> Track:
    """Return the true path with the Cramer-Rao bound in place of the covariances.

    Parameters
    ----------
    track
        Whose problem it is: its measurements with their weights, its knots and its priors.
    truth
        The path.

    Returns
    -------
    Track
        With NaN for the bound where the information is singular.
    """
    problem = track.problem.with_weights(track.problem.weights, Loss("none"))
    path = truth_path(truth, track.recording, static=problem.motion.static)
    state = path.state(track.time_s, track.order)
    size = state.shape[1]
    # What is unknown of the forces is not in a truth table.
    whole = np.concatenate([state, track.values.path[:, size:]], axis=1)
    values = Values(whole, track.values.walks, track.values.constants)
    scale = problem.path_scale[:size]
    try:
        found = posterior(problem, values)
        covariance = found.knots[:, :size, :size] * scale[:, None] * scale
    except NotPositiveDefiniteError:
        found, covariance = track.marginals, np.full_like(track.covariance, np.nan)
    return replace(
        track, state=state, covariance=covariance, problem=problem, values=values, marginals=found
    )
