"""The study of mixed recordings: few runs of the cases that the documents have 200 of."""

import numpy as np

from geograph.scenarios.mixed_study import VELOCITY, row, run

RUNS = range(10)


def test_frequency_differences_sharpen_the_velocity_and_stay_honest():
    """Two-sided bands of 1 in 10000 each: a right smoother fails once in 5000 choices of seeds."""
    times = run(VELOCITY["emitter 1, 30 m/s, times"], RUNS)
    both = run(VELOCITY["emitter 1, 30 m/s, and 0.05 Hz"], RUNS)
    assert not times.other
    assert not both.other
    for outcome in (times, both):
        low, high = outcome.band(1e-4)
        assert low < outcome.anees < high
    bounds = [np.sqrt(outcome.bound_m2_s2.mean()) for outcome in (times, both)]
    assert bounds[1] < 0.65 * bounds[0]
    assert row("both", both).count("|") == 9
