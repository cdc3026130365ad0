"""The search for a process noise does not end where there is no path."""

import dataclasses

import numpy as np
import pytest
from test_left_open import STATIONS, arrivals_of, bearings_of, turning

import geograph as gg
from geograph import tuning
from geograph.losses import Loss
from geograph.prepare import prepare
from geograph.smoother import Smoother
from geograph.solver import Status
from geograph.starts import first_fits


@pytest.fixture
def smoother():
    """Solved with its first noise, which is a tenth of that of greatest evidence."""
    time = np.linspace(0.0, 200.0, 150)
    recording = bearings_of(turning(time), time, STATIONS[:3], seed=0)
    found = Smoother(prepare(recording), recording.settings)
    (fit,) = first_fits(found.prepared, static=False)
    found.problem, values = found.start(fit, Loss("none"))
    found.solution = found.solved(values)
    assert found.solution.status is Status.CONVERGED
    return found


def lost_above(solver, limit):
    """Return a solver that leads nowhere where the noise is above a limit."""

    def solve(problem, *rest, **more):
        found = solver(problem, *rest, **more)
        if problem.motion.density.axes[0] <= limit:
            return found
        return dataclasses.replace(found, status=Status.DIVERGED, cost=np.inf, elimination=None)

    return solve


@pytest.mark.parametrize("times", [3.0, 0.5])
def test_noise_without_evidence_is_not_chosen(smoother, monkeypatch, times):
    # Warnings of scipy, which takes differences of evidences, are errors here. With half the
    # present noise as limit, all that the search looks at first is beyond it.
    limit = times * smoother.problem.motion.density.axes[0]
    monkeypatch.setattr(tuning, "solve", lost_above(tuning.solve, limit))
    tuning.tune_noise(smoother, 4.0)
    assert smoother.problem.motion.density.axes[0] <= 1.01 * limit
    assert smoother.solution.status is Status.CONVERGED


def test_a_noise_at_which_the_solve_diverges_is_left_again(smoother, monkeypatch):
    # As where the evidence is that of a rougher solve than the one that follows.
    before, limit = smoother.solution, 1.2 * smoother.problem.motion.density.axes[0]
    monkeypatch.setattr("geograph.smoother.solve", lost_above(tuning.solve, limit))
    tuning.tune_noise(smoother, 4.0)
    assert smoother.problem.motion.density.axes[0] <= limit
    assert smoother.solution is before


def test_one_signal_says_nothing_of_noise_and_warns_of_nothing():
    # No noise has an evidence where an instant is all there is.
    recording, _ = arrivals_of(8)
    table = recording.arrivals
    whole = np.argmax(np.bincount(table.emission) == len(recording.sensors))
    own = table.emission == whole
    alone = gg.Arrivals(
        emission=np.zeros(own.sum(), dtype=np.int64),
        sensor=table.sensor[own],
        toa_s=table.toa_s[own],
        sigma_s=table.sigma_s[own],
        line=table.line[own],
    )
    sensors = {
        name: dataclasses.replace(sensor, errors=gg.SensorErrors())
        for name, sensor in recording.sensors.items()
    }
    recording = dataclasses.replace(recording, sensors=sensors, arrivals=alone)
    track = gg.smooth(recording, raise_on_failure=False)
    assert track.status is Status.UNOBSERVABLE
