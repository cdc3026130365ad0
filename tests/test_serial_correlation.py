"""Slow errors of sensors are found in what is left of their measurements, and not in white ones."""

import numpy as np
import pytest
from scipy.stats import chi2

import geograph as gg
from geograph.scenarios.fireballs import Fireball, fireball
from geograph.scenarios.sensor_errors import slow_errors
from geograph.scenarios.staged_noise import StagedNoise, staged_flight
from geograph.serial_correlation import inflations, long_run_variance, shrunk

SLOW = StagedNoise(noise=(0.3,), events=600, slow_rad=2e-3)


def inflation_of(*series, weight=1.0):
    """Return the inflations of sensors whose scores are given, each shape (n, 2)."""
    score = np.concatenate(series)
    group = np.repeat(np.arange(len(series)), [len(one) for one in series])
    time = np.concatenate([np.arange(len(one), dtype=float) for one in series])
    # Any order will do.
    mixed = np.random.default_rng(0).permutation(group.size)
    information = np.full(group.size, weight)
    return inflations(weight * score[mixed], information, time[mixed], group[mixed])


def test_white_errors_count_in_full_whatever_their_sigma():
    """The chance of a false alarm is 0.1 % for each of 400 recordings: 3 or more in 1 of 120."""
    rng = np.random.default_rng(1)
    made = [[s * rng.standard_normal((200, 2)) for s in (0.5, 1.0, 3.0)] for _ in range(400)]
    assert sum((inflation_of(*one) > 1.0).any() for one in made) < 3


def test_slow_errors_count_as_few():
    """White and slow errors of unit variance: 1 + (1 + a) / (1 - a), a the correlation of two."""
    rng = np.random.default_rng(2)
    time = np.arange(20000.0)
    left = np.exp(-1.0 / 8.0)
    expected = 1.0 + (1.0 + left) / (1.0 - left)
    series = rng.standard_normal((time.size, 2)) + slow_errors(rng, time, 8.0).T
    found, lags = long_run_variance(series)
    assert found / 2.0 == pytest.approx(expected, rel=0.1)
    assert 24 < lags < 200
    white = rng.standard_normal((400, 2))
    short = inflation_of(series[:2000], white, np.zeros((20, 2)))
    assert short[0] == pytest.approx(expected, rel=0.4)
    assert short[1] < 1.5
    # A loss that halves all weights halves the scores and the information.
    halved = inflation_of(series[:2000], white, weight=0.5)
    np.testing.assert_allclose(halved, np.maximum(0.5 * inflation_of(series[:2000], white), 1.0))


def test_errors_that_alternate_count_in_full_and_spoil_no_others():
    # Neighbours that cancel: the sum over all lags is estimated as less than nothing.
    rng = np.random.default_rng(4)
    alternating = np.tile([[1.0], [-1.0]], (100, 2)) + 0.1 * rng.standard_normal((200, 2))
    time = np.arange(400.0)
    slow = rng.standard_normal((400, 2)) + 2.0 * slow_errors(rng, time, 8.0).T
    assert long_run_variance(alternating)[0] > 0.0
    found = inflation_of(alternating, slow)
    assert found[0] == 1.0
    assert found[1] > 5.0


def test_estimates_are_drawn_to_their_mean_as_far_as_their_errors_explain_them():
    rng = np.random.default_rng(3)
    true = rng.normal(2.0, 1.0, 4000)
    variance = rng.uniform(0.2, 3.0, true.size)
    value = true + np.sqrt(variance) * rng.standard_normal(true.size)
    share = 1.0 / (1.0 + variance)
    best = 2.0 + share * (value - 2.0)
    assert np.sqrt(np.mean((shrunk(value, variance) - best) ** 2)) < 0.05
    alike = shrunk(np.array([1.0, 1.2, 0.8, 5.0]), np.array([1.0, 1.0, 1.0, np.inf]))
    np.testing.assert_allclose(alike, 1.0)
    np.testing.assert_array_equal(shrunk(np.array([3.0]), np.array([np.inf])), [3.0])


def test_slow_errors_are_not_taken_for_motion():
    flight = staged_flight(3, SLOW)
    true = gg.smooth(flight.recording)
    track = gg.smooth(flight.recording, process_noise="auto")
    # With white errors alone in mind, the evidence asks for 1.7.
    assert track.settings.process_noise < 0.6
    truth = flight.recording.truth

    def errors(one):
        return one.at(truth.time_s).position_m - truth.position_m

    assert np.sum(errors(track) ** 2) < 1.05**2 * np.sum(errors(true) ** 2)

    def mean_square(one):
        covariance = one.at(truth.time_s).position_covariance_m2
        solved = np.linalg.solve(covariance, errors(one)[:, :, None])[:, :, 0]
        return np.mean(np.sum(errors(one) * solved, axis=1))

    # Errors are within what is said of them, up to what is left in their correlation; 3 is honest.
    assert mean_square(track) < 12.0 < 0.2 * mean_square(true)
    for name, entry in track.summary["sensors"].items():
        assert entry["worth"] < 0.1 * entry["measurements"]
        counted = [text for text in track.summary["flagged_sensors"] if "count as" in text]
        assert any(text.startswith(f"{name}: its errors are alike for a while") for text in counted)
    assert not any("too small" in text for text in track.summary["flagged_sensors"])
    # Only where the noise is found.
    assert all(e["worth"] == e["measurements"] for e in true.summary["sensors"].values())
    assert any("too small" in text for text in true.summary["flagged_sensors"])


def test_fireballs_are_what_their_recordings_say_but_for_slow_errors():
    """The band is left with a chance of 0.2 % (chi-square of 3 passes of 3 components)."""

    def square(slow):
        total = 0.0
        for seed in range(3):
            recording = fireball(seed, Fireball(slow=slow, frames_s=10.0))
            truth = recording.truth
            middle = gg.smooth(recording).at(truth.time_s[40:41])
            error = middle.position_m[0] - truth.position_m[40]
            total += error @ np.linalg.solve(middle.position_covariance_m2[0], error)
        return total

    assert chi2.ppf(0.001, 9) < square(0.0) < chi2.isf(0.001, 9)
    assert square(2.0) > chi2.isf(0.001, 9)
    made = [fireball(0, Fireball(slow=slow)).bearings.azimuth_rad for slow in (2.0, 2.0, 0.0)]
    np.testing.assert_array_equal(made[0], made[1])
    assert not np.array_equal(made[0], made[2])
