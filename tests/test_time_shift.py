"""Clocks that have only their priors in common."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

import geograph as gg
from geograph.prepare import prepare
from geograph.scenarios.ground import ground_pass
from geograph.scenarios.low_orbit import low_orbit_pass
from geograph.time_shift import centred


def loose(seed: int, **options: Any) -> gg.Recording:
    """Return a fireball whose clocks all have a prior of 0.5 s, and are off by as much."""
    made = ground_pass(seed, clock_offset_s=0.5, disciplined_s=0.5, **options)
    assert made.bearings is not None
    return made


def test_applies_where_nothing_but_priors_ties_path_to_time() -> None:
    assert prepare(loose(0)).shift is not None
    # A sensor that moves, a clock that is known, a height at a given time: each ties it.
    assert prepare(low_orbit_pass(0, clock_offset_s=1.0)).shift is None
    assert prepare(ground_pass(0, clock_offset_s=1.0, disciplined_s=0.0)).shift is None
    made = loose(0)
    height = gg.Constraints(
        time_s=np.array([2.0]),
        kind=("altitude_m",),
        value=np.array([8e4]),
        sigma=np.array([1e3]),
        line=np.array([2]),
    )
    assert prepare(dataclasses.replace(made, constraints=height)).shift is None
    whole = dataclasses.replace(height, time_s=np.array([np.nan]))
    assert prepare(dataclasses.replace(made, constraints=whole)).shift is not None


def test_centred_offsets_have_the_least_prior_cost() -> None:
    offsets, priors = np.array([0.3, -1.0, 2.0]), np.array([0.01, 1.0, 5.0])
    shifted = centred(offsets, priors)
    assert np.sum(shifted / priors**2) == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(np.diff(shifted), np.diff(offsets))


def test_no_clock_is_surer_than_what_all_have_in_common() -> None:
    track = gg.smooth(loose(1), raise_on_failure=False)
    sigmas = [errors["clock_offset"].sigma for errors in track.sensor_errors.values()]
    common = 0.5 / np.sqrt(len(sigmas))
    assert min(sigmas) >= common * (1.0 - 1e-6)
    total = sum(errors["clock_offset"].estimate for errors in track.sensor_errors.values())
    assert abs(total) < 1e-3
    # Along the path the position is as uncertain as the time.
    assert track.velocity_m_s is not None
    middle = track.time_s.size // 2
    velocity = track.velocity_m_s[middle]
    speed = float(np.linalg.norm(velocity))
    along = velocity / speed
    sigma = np.sqrt(along @ track.position_covariance_m2[middle] @ along)
    assert sigma == pytest.approx(common * speed, rel=0.02)
    # Between knots, too.
    time = 0.5 * (track.time_s[middle] + track.time_s[middle + 1])
    between = np.sqrt(along @ track.at(time).position_covariance_m2[0] @ along)
    assert between == pytest.approx(common * speed, rel=0.02)


def test_knowing_one_clock_gives_the_same_path_but_for_the_shift() -> None:
    made = loose(2)
    free = gg.smooth(made, raise_on_failure=False)
    name = made.sensor_names[0]
    sensors = dict(made.sensors)
    shift = free.sensor_errors[name]["clock_offset"].estimate
    sensors[name] = dataclasses.replace(
        sensors[name], errors=dataclasses.replace(sensors[name].errors, clock_offset_s=1e-5)
    )
    tied = gg.smooth(dataclasses.replace(made, sensors=sensors))
    there = tied.at(free.time_s + shift)
    offset = np.linalg.norm(there.position_m - free.position_m, axis=1)
    sigma = np.sqrt(np.trace(tied.position_covariance_m2, axis1=1, axis2=2)).min()
    assert offset[2:-2].max() < 0.2 * sigma


def test_loose_clocks_are_consistent() -> None:
    nees, clocks = [], []
    for seed in range(12):
        made = loose(seed)
        track = gg.smooth(made, raise_on_failure=False)
        assert made.truth is not None
        middle = len(made.truth) // 2
        points = track.at(made.truth.time_s[middle])
        error = points.position_m[0] - made.truth.position_m[middle]
        nees.append(error @ np.linalg.solve(points.position_covariance_m2[0], error))
        clocks.append(track.summary["iterations"])
    # Along the path the Gaussian of a shift in time is exact for a straight path: chi-square.
    low, high = chi2.ppf([0.005, 0.995], 3 * len(nees)) / len(nees)
    assert low < np.mean(nees) < high
    # And the valley costs no hundreds of steps.
    assert np.median(clocks) < 200
