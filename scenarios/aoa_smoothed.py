"""The factor graph on the scenarios of the study from the air, scored against the truth.

``geograph.smooth`` is given the first k steps of a run, for some k spread evenly in their
logarithm: what an observer who smooths again and again would have had at those times. In between,
squared errors are interpolated linearly in log k, so that the mean over the whole sequence is a
weighted sum of those at the steps that were smoothed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

import geograph as gg
from geograph.consistency import nees
from geograph.scenarios.airborne_recordings import KnownGround, Region, recordings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.scenarios.airborne import Airborne

REGION = Region(centre_m=(4e3, 4e3), sigma_m=4e3)
"""Where emitters may be: a land of 8 km by 8 km, its half as one sigma."""

ELLIPSE_95 = 5.991464547107979
"""Quantile of chi-square with 2 degrees of freedom at 0.95."""


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Estimates of a static emitter after some of the steps.

    Attributes
    ----------
    scenario
        What was simulated.
    step
        Shape (s,): after how many steps.
    error_m
        Shape (runs, s, 3).
    covariance_m2
        Shape (runs, s, 3, 3).
    status
        Shape (runs, s): how each solve ended.
    gaussian
        Shape (runs, s): whether the result calls its posterior Gaussian.
    """

    scenario: Airborne
    step: NDArray[np.int64]
    error_m: NDArray[np.float64]
    covariance_m2: NDArray[np.float64]
    status: NDArray[np.str_]
    gaussian: NDArray[np.bool_]

    @property
    def squared_m2(self) -> NDArray[np.float64]:
        """Shape (runs, s): squared horizontal errors."""
        return np.asarray(np.sum(self.error_m[..., :2] ** 2, axis=-1))

    @property
    def nees(self) -> NDArray[np.float64]:
        """Shape (runs, s): e' P^-1 e of the horizontal error; 2 on average for an honest P."""
        error, covariance = self.error_m[..., :2], self.covariance_m2[..., :2, :2]
        found = nees(error.reshape(-1, 2), covariance.reshape(-1, 2, 2))
        return found.reshape(error.shape[:-1])

    @property
    def covered(self) -> NDArray[np.bool_]:
        """Shape (runs, s): whether the truth is in the ellipse of 95 %."""
        return np.asarray(self.nees <= ELLIPSE_95)

    def over_sequence_m2(self) -> NDArray[np.float64]:
        """Return each run's mean squared horizontal error over all steps, shape (runs,)."""
        return np.asarray(self.squared_m2 @ sequence_weights(self.step, self.scenario.steps))


def log_steps(steps: int, count: int) -> NDArray[np.int64]:
    """Return numbers of steps from 1 to all, even in their logarithm as far as whole ones are."""
    return np.unique(np.round(np.geomspace(1, steps, count)).astype(np.int64))


def sequence_weights(step: NDArray[np.int64], steps: int) -> NDArray[np.float64]:
    """Return the weights, shape (s,), by which values at some steps give the mean over all steps.

    Between two of the steps a value is taken as linear in the logarithm of the step.

    Parameters
    ----------
    step
        Shape (s,): growing, from 1 to ``steps``.
    steps
        How many there are.
    """
    every = np.log(np.arange(1, steps + 1))
    unit = np.eye(step.size)
    shares = [np.interp(every, np.log(step), unit[i]) for i in range(step.size)]
    return np.asarray(np.mean(shares, axis=1))


def smooth_prefixes(
    scenario: Airborne,
    seeds: Sequence[int],
    *,
    step: NDArray[np.int64],
    region: Region | None = REGION,
    ground: KnownGround = "terrain",
) -> Smoothed:
    """Smooth the first steps of runs of a static emitter.

    Level aircraft are recorded with their angles turned by the heading, which is the same and
    quicker to prepare than body axes; others in body axes.

    Parameters
    ----------
    scenario
        With a static emitter.
    seeds
        One run each.
    step
        Shape (s,): after how many steps.
    region
        Where the emitter may be; None: anywhere.
    ground
        See :func:`geograph.scenarios.airborne_recordings.recordings`.
    """
    shape = (len(seeds), step.size)
    error = np.full((*shape, 3), np.nan)
    covariance = np.full((*shape, 3, 3), np.nan)
    status = np.full(shape, "", dtype="<U20")
    gaussian = np.ones(shape, dtype=np.bool_)
    level = all(receiver.level for receiver in scenario.receivers)
    truth = np.array(scenario.target_m)
    for column, count in enumerate(step):
        some = recordings(
            scenario,
            seeds,
            steps=int(count),
            axes="enu" if level else "body",
            region=region,
            ground=ground,
        )
        for row, recording in enumerate(some):
            track = gg.smooth(recording, raise_on_failure=False)
            point = track.at(scenario.time_s[:1])
            error[row, column] = point.state[0, :3] - truth
            covariance[row, column] = point.covariance[0, :3, :3]
            status[row, column] = str(track.status)
            gaussian[row, column] = track.summary["gaussian"]["holds"]
    return Smoothed(scenario, step, error, covariance, status, gaussian)
