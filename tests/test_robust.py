"""Outliers: thresholds keep their false-alarm rate, annealing finds what does not belong."""

import numpy as np
import pytest
from scipy.stats import binom, chi2

from geograph.robust import FALSE_ALARM, anneal, sensor_scales, thresholds


def draw(rng, rows):
    """Squared whitened residuals of good measurements."""
    return rng.chisquare(rows)


@pytest.mark.parametrize("count", [5, 60, 1000])
def test_a_clean_recording_loses_a_measurement_once_in_a_hundred(count):
    """10 000 recordings; the test itself fails by chance once in a million.

    Sensors with many measurements have their own scale, never below one, which makes rejections
    rarer; with fewer than ten it is one, and the rate is that which is promised.
    """
    rng = np.random.default_rng(count)
    trials = 10_000 if count < 1000 else 2_000
    rows = rng.integers(1, 3, count)
    group = np.arange(count) % (4 if count > 5 else 1)
    losses = 0
    for _ in range(trials):
        square = draw(rng, rows)
        losses += bool((square > thresholds(square, rows, group)).any())
    low, high = binom.interval(1 - 2e-6, trials, FALSE_ALARM)
    assert losses <= high
    if count == 5:
        assert losses >= low


def test_thresholds_are_quantiles_on_each_sensors_scale():
    rng = np.random.default_rng(0)
    rows = np.full(4000, 2)
    group = np.repeat([0, 1, 2, 3], 1000)
    square = draw(rng, rows) * np.repeat([1.0, 9.0, 0.25, 1.0], 1000)
    square[3000:3450] = 1e6
    scales = sensor_scales(square, rows, group)
    # A sensor's median has a standard error of 4 %; 45 % outliers move it to another quantile.
    assert scales[0] == pytest.approx(1.0, abs=0.2)
    assert scales[1] == pytest.approx(9.0, rel=0.2)
    assert scales[2] == 1.0
    assert 1.0 < scales[3] < 6.0
    limit = thresholds(square, rows, group)
    np.testing.assert_allclose(limit, chi2.isf(FALSE_ALARM / 4000, 2) * scales[group])


def test_few_measurements_have_no_scale_of_their_own():
    scales = sensor_scales(np.full(9, 50.0), np.full(9, 2), np.zeros(9, dtype=int))
    np.testing.assert_array_equal(scales, [1.0])


class Line:
    """A straight line fitted to points of unit sigma: a problem with a weighted solution."""

    def __init__(self, rng, count, outliers):
        self.design = np.stack([np.ones(count), np.linspace(-1.0, 1.0, count)], axis=1)
        self.truth = np.array([3.0, 40.0])
        self.value = self.design @ self.truth + rng.normal(size=count)
        # All to one side, so that a plain fit is pulled away.
        self.bad = np.zeros(count, dtype=bool)
        self.bad[rng.choice(count, outliers, replace=False)] = True
        self.value[self.bad] += rng.uniform(15.0, 200.0, outliers)
        self.solves = 0

    def solve(self, weight):
        self.solves += 1
        root = np.sqrt(weight)
        self.fit = np.linalg.lstsq(self.design * root[:, None], self.value * root, rcond=None)[0]
        return (self.value - self.design @ self.fit) ** 2

    def anneal(self):
        # Least absolute deviations by reweighting: a robust estimate to start from.
        square = self.solve(np.ones(self.value.size))
        for _ in range(30):
            square = self.solve(1.0 / np.sqrt(1.0 + square))
        count = self.value.size
        return anneal(self.solve, square, np.ones(count, dtype=int), np.zeros(count, dtype=int))


@pytest.mark.parametrize("outliers", [0, 1, 10, 35])
def test_annealing_names_the_outliers(outliers):
    for seed in range(20):
        line = Line(np.random.default_rng([outliers, seed]), 100, outliers)
        kept = line.anneal()
        np.testing.assert_array_equal(kept, ~line.bad)
        # What was solved last is the solution that belongs to the choice.
        if outliers:
            np.testing.assert_allclose(line.fit, line.truth, atol=1.0)


def test_annealing_of_clean_data_solves_nothing():
    square = np.random.default_rng(0).chisquare(2, 50)
    kept = anneal(_never, square, np.full(50, 2), np.zeros(50, dtype=int))
    assert kept.all()


def _never(_):
    raise AssertionError("clean data need no solve")


def test_annealing_of_nothing():
    empty = np.empty(0)
    assert anneal(_never, empty, empty.astype(int), empty.astype(int)).shape == (0,)
