"""The comparison estimators of the time-difference study, and its published tables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.scenarios.moving_sensors import VARIANTS, MovingSensors, Runs, arrival_times, simulate
from geograph.scenarios.tdoa_bound import bound_covariance, bound_m
from geograph.scenarios.tdoa_chan_ho import chan_ho, post_processing, two_intersections
from geograph.scenarios.tdoa_estimators import (
    differences,
    predicted_differences,
    pseudo_recursive,
    weighted_start,
)
from geograph.scenarios.tdoa_kalman import extended_kalman, range_kalman
from geograph.scenarios.tdoa_study import (
    COUNTERPARTS,
    ESTIMATORS,
    PUBLISHED,
    main,
    score,
    study,
)

# Fusions of Chan-Ho fixes that a few very wrong runs dominate: another thousand runs give a figure
# up to a third away (docs/accuracy.md), and the table's own draw cannot be met.
HEAVY_TAILED = {"emitter-2-position-0.75m", "emitter-2-position-1.5m"}


def without_noise(variant: MovingSensors, *, light_time: bool = True) -> Runs:
    """One run without noise; without the sensors' motion during the light time, if asked."""
    runs = simulate(replace(variant, position_noise_m=0.0), [0])
    toa = arrival_times(variant)
    if not light_time:
        places = variant.sensors_at(variant.time_s[:, None])
        sight = variant.emitter_at(variant.time_s)[:, None] - places
        toa = variant.time_s[:, None] + np.linalg.norm(sight, axis=-1) / SPEED_OF_LIGHT_M_S
    return replace(runs, toa_s=toa[np.arange(variant.sets)[:, None], variant.heard_by][None])


def honest(error: np.ndarray, covariance: np.ndarray) -> bool:
    """Whether the sum of e' P^-1 e is in its chi-square band, false alarm 1e-4, two-sided."""
    total = float(np.sum(error * np.linalg.solve(covariance, error[..., None])[..., 0]))
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], error.size)
    return bool(low < total < high)


@pytest.mark.parametrize("name", [n for n in VARIANTS if n.endswith(("-1ns", "groups", "sensors"))])
def test_the_truth_comes_back_without_noise(name: str) -> None:
    """Times of 120 s have a last bit of 4 micrometres, which far emitters magnify 17000 times."""
    variant = VARIANTS[name]
    runs = without_noise(variant, light_time=False)
    emitter = variant.emitter_at(runs.time_s)
    exact = {"pseudo", "range-kalman", "extended-kalman"}
    if len(variant.group_m) > 3:
        exact.add("post")
        np.testing.assert_allclose(chan_ho(runs).position_m[0], emitter, atol=1.0)
    for estimator in exact:
        error = ESTIMATORS[estimator](runs).position_m[0, -1] - emitter[-1]
        assert np.linalg.norm(error) < 0.5
    # The sensors' motion during the light time, which all of them ignore, is not felt either.
    late = extended_kalman(without_noise(variant)).position_m[0, -1] - emitter[-1]
    assert np.linalg.norm(late) < 0.2


@pytest.mark.parametrize("moving", [False, True])
def test_start_from_four_sets_is_honest(moving: bool) -> None:
    """At a tenth of the noise, where the linear equations hold; false alarm 1e-4."""
    base = VARIANTS["emitter-1-moving-30m_s" if moving else "emitter-1-1ns"]
    variant = replace(base, sigma_toa_s=1e-10)
    runs = simulate(variant, range(1000))
    start = weighted_start(runs, moving=moving)
    error = start.state[:, :2] - variant.emitter_at(runs.time_s[3])
    covariance = start.covariance[:, :2, :2]
    if not moving:
        assert honest(error, covariance)
        return
    # The prior of the velocity is not what it was drawn from: only that it is not far too sure.
    nees = np.mean(error * np.linalg.solve(covariance, error[..., None])[..., 0]) * 2.0
    assert nees < 2.5


def test_start_from_one_set_is_the_first_step_of_chan_ho() -> None:
    """Three equations, three unknowns: the solution meets them whatever the weights."""
    runs = simulate(VARIANTS["emitter-2-1ns"], range(20))
    start = weighted_start(runs, first=7, sets=1)
    pairs = differences(runs, sets=slice(7, 8))
    origin, r = pairs.reference_m[:, 0], start.state[:, 2]
    sensor = pairs.sensor_m[:, 0] - origin[:, None]
    ranges = r[:, None] + pairs.range_m[:, 0]
    relative = start.state[:, :2] - origin
    squares = np.sum((relative[:, None] - sensor) ** 2, axis=-1)
    squares -= np.sum(relative**2, axis=-1)[:, None]
    np.testing.assert_allclose(squares, ranges**2 - r[:, None] ** 2, rtol=1e-6)


def test_chan_ho_reaches_the_bound_of_one_set() -> None:
    """At a tenth of the noise the fix is efficient; false alarms 1e-4 each."""
    variant = replace(VARIANTS["emitter-2-1ns"], sigma_toa_s=1e-10, sets=4)
    runs = simulate(variant, range(500))
    for reference in range(4):
        fixes = chan_ho(runs, reference=reference)
        error = fixes.position_m - variant.emitter_at(runs.time_s)
        assert honest(error, fixes.covariance_m2)
        of_last = bound_covariance(replace(variant, sets=1, interval_s=8.0))
        assert honest(error[:, -1], np.broadcast_to(of_last, (500, 2, 2)))


def test_chan_ho_takes_the_side_of_the_first_step() -> None:
    """An emitter on any side of the sensors, and one abreast of the reference."""
    for place in ((40e3, 40e3), (-40e3, 40e3), (-40e3, -40e3), (40e3, -40e3), (1.1e3, 40e3)):
        variant = MovingSensors(name="side", emitter_m=place, sets=2)
        fixes = chan_ho(without_noise(variant, light_time=False))
        np.testing.assert_allclose(fixes.position_m[0], np.tile(place, (2, 1)), atol=1.0)


def test_two_intersections_are_both_on_the_hyperbolas() -> None:
    variant = VARIANTS["emitter-2-three-sensors"]
    runs = without_noise(variant, light_time=False)
    points = two_intersections(runs)
    assert np.isfinite(points).all()
    pairs = differences(runs)
    for root in range(2):
        predicted, _ = predicted_differences(points[:, :, root], pairs.sensor_m, pairs.reference_m)
        np.testing.assert_allclose(predicted, pairs.range_m, atol=1e-4)
    emitter = np.array(variant.emitter_m)
    np.testing.assert_allclose(points[0, :, 1], np.tile(emitter, (60, 1)), atol=1.0)
    # The other root is kilometres away, and moves as the sensors do: that tells the two apart.
    away = np.linalg.norm(points[0, :, 0] - emitter, axis=-1)
    assert away.min() > 50e3
    assert np.linalg.norm(points[0, -1, 0] - points[0, 0, 0]) > 5e3


def test_emitter_one_has_a_single_intersection() -> None:
    points = two_intersections(without_noise(VARIANTS["emitter-1-three-sensors"], light_time=False))
    assert np.isnan(points).any(axis=-1).sum(axis=-1).tolist() == [[1] * 60]


def test_derivatives_of_range_differences() -> None:
    rng = np.random.default_rng(3)
    position, sensor, reference = rng.normal(size=(5, 2)), rng.normal(size=(5, 3, 2)), np.zeros(2)
    _, jacobian = predicted_differences(position, sensor, np.tile(reference, (5, 1)))
    for axis in range(2):
        step = 1e-6 * np.eye(2)[axis]
        up, _ = predicted_differences(position + step, sensor, np.tile(reference, (5, 1)))
        down, _ = predicted_differences(position - step, sensor, np.tile(reference, (5, 1)))
        np.testing.assert_allclose((up - down) / 2e-6, jacobian[..., axis], atol=1e-8)


def test_windowed_likelihood_does_not_depend_on_the_reference() -> None:
    """Once its weights are the inverse of the differences' covariance."""
    runs = simulate(VARIANTS["emitter-1-1ns"], range(20))
    first, third = (
        pseudo_recursive(runs, reference=reference, correlated=True, steps=6).position_m[:, -1]
        for reference in (0, 2)
    )
    np.testing.assert_allclose(first, third, atol=1e-2)


@pytest.mark.parametrize(
    "name", [n for n in VARIANTS if n.endswith(("-1ns", "m_s", "groups", "back"))]
)
def test_extended_filter_is_at_the_bound_and_honest(name: str) -> None:
    """1000 runs at 1 ns; false alarm 1e-4 for each."""
    variant = VARIANTS[name]
    runs = simulate(variant, range(1000))
    estimates = extended_kalman(runs, moving=variant.moving)
    error = estimates.position_m[:, -1] - variant.emitter_at(runs.time_s[-1])
    assert honest(error, estimates.covariance_m2[:, -1])
    assert honest(error, np.broadcast_to(bound_covariance(variant)[:2, :2], (1000, 2, 2)))


@pytest.mark.parametrize("number", [1, 2])
def test_only_the_manoeuvre_proof_filter_survives_a_turn(number: int) -> None:
    variant = VARIANTS[f"emitter-{number}-turn-back"]
    scores = study(variant, range(200), names=["range-kalman", "range-kalman-original"])
    assert scores["range-kalman"].rms_m < 1.3 * bound_m(variant)
    assert scores["range-kalman-original"].rms_m > 20.0 * bound_m(variant)


def test_change_of_reference_keeps_what_was_learnt() -> None:
    """The range filter, from one group to another, beats both halves on their own."""
    variant = VARIANTS["emitter-2-two-groups"]
    runs = simulate(variant, range(300))
    both = score(runs, range_kalman(runs)).rms_m
    halves = [
        Runs(
            variant,
            runs.time_s[half],
            runs.sensor[half],
            runs.sensor_m[:, half],
            runs.toa_s[:, half],
        )
        for half in (slice(0, 30), slice(30, 60))
    ]
    alone = [score(half, range_kalman(half)).rms_m for half in halves]
    assert both < 0.5 * min(alone)
    assert both < 1.15 * bound_m(variant)


def test_common_offset_shifts_the_estimate_and_no_more() -> None:
    runs = simulate(VARIANTS["emitter-1-1ns"], range(5))
    shifted = replace(runs, sensor_m=runs.sensor_m + np.array([50.0, 0.0]))
    for name, estimator in ESTIMATORS.items():
        change = estimator(shifted).position_m[:, -1] - estimator(runs).position_m[:, -1]
        np.testing.assert_allclose(change, np.tile([50.0, 0.0], (5, 1)), atol=1e-2, err_msg=name)


@pytest.mark.parametrize("name", list(PUBLISHED))
def test_published_figures_are_reproduced(name: str) -> None:
    """1000 runs, whose own standard error is 2 to 3 %, within 15 % of what is printed."""
    scores = study(VARIANTS[name], range(1000), names=COUNTERPARTS)
    for ours, theirs in COUNTERPARTS.items():
        assert scores[ours].lost == 0
        if ours == "post" and name in HEAVY_TAILED:
            # Above both its own median and the bound many times: biased, as the thesis found.
            assert scores[ours].rms_m > 3.0 * bound_m(VARIANTS[name])
            continue
        assert scores[ours].rms_m == pytest.approx(getattr(PUBLISHED[name], theirs), rel=0.15)


def test_moving_emitters_are_followed_by_fusion_of_fixes() -> None:
    variant = VARIANTS["emitter-1-moving-60m_s"]
    runs = simulate(variant, range(300))
    assert score(runs, post_processing(runs, moving=True)).rms_m < 1.25 * bound_m(variant)


def test_runs_that_diverge_are_counted_not_averaged() -> None:
    variant = replace(VARIANTS["emitter-2-10ns"], sigma_toa_s=3e-8)
    runs = simulate(variant, range(100))
    single = score(runs, pseudo_recursive(runs, window=1))
    assert 0 < single.lost < 100
    assert np.isfinite(single.rms_m)
    lost = pseudo_recursive(runs)
    lost.position_m[:] = np.nan
    with pytest.raises(ValueError, match="all 100 runs of emitter-2-10ns diverged"):
        score(runs, lost)


def test_wrong_sensors_are_refused() -> None:
    three = simulate(VARIANTS["emitter-2-three-sensors"], [0])
    with pytest.raises(ValueError, match="3 sensors; Chan and Ho's first step needs at least 4"):
        chan_ho(three)
    four = simulate(VARIANTS["emitter-2-1ns"], [0])
    with pytest.raises(ValueError, match="4 sensors; two intersections are those of 3"):
        two_intersections(four)
    with pytest.raises(ValueError, match="reference 4; expected a column from 0 to 3"):
        differences(four, reference=4)


def test_study_prints_its_tables(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--runs", "5", "--seed", "7"]) == 0
    printed = capsys.readouterr().out
    for name, variant in VARIANTS.items():
        assert (f"| {name} |" in printed) == (not variant.straight_platforms)
    published, variants, windows = printed.split("\n\n")
    assert published.count("\n") == 1 + len(PUBLISHED)
    assert "| 17060 |" in published
    assert "| emitter-1-three-sensors | 45.4 |" in variants
    assert windows.strip().count("\n") == 7
    with pytest.raises(SystemExit):
        main(["--runs", "1"])
