"""The study of satellites, angles only: the factor graph beside the published estimators."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.stats import chi2

from geograph.scenarios.angles_study import (
    LIMITS,
    PUBLISHED,
    TIME_TAGS_S,
    main,
    world_table,
)
from geograph.scenarios.angles_trials import BASELINE, ESTIMATORS, GRAPH, run_trial, run_trials
from geograph.scenarios.angles_worlds import WORLDS, variant


@pytest.mark.parametrize("name", ["levy-simple", "levy-staged"])
def test_the_graph_beats_the_baseline_and_is_honest(name: str) -> None:
    """One NEES of each trial; two-sided chi-square band with a false alarm of 1 %, fixed seeds."""
    found = run_trials(WORLDS[name], range(16), (BASELINE, GRAPH))
    graph, baseline = found[GRAPH], found[BASELINE]
    assert graph.converged.all()
    assert (graph.rms_m < baseline.rms_m).all()
    assert np.mean(1.0 - graph.rms_m / baseline.rms_m) > (0.75 if name == "levy-simple" else 0.5)
    low, high = chi2.ppf([0.005, 0.995], 3 * 16)
    assert low < graph.nees[:, 20].sum() < high


def test_published_estimators_behave_as_published() -> None:
    """Sprang: static over-confident, velocity at 3, intersection far below, kinematics best."""
    names = ("static", "velocity", "velocity, CI", "acceleration, CI", BASELINE)
    found = run_trials(WORLDS["sprang-simple"], range(6), names)
    anees = {name: scores.nees.mean() for name, scores in found.items()}
    assert anees["static"] > 6.0
    assert 2.7 < anees["velocity"] < 3.7
    assert anees["velocity, CI"] < 1.0
    rms = {name: np.median(scores.rms_m) for name, scores in found.items()}
    assert min(rms, key=rms.__getitem__) == BASELINE


def test_bdnlo_removes_biases_that_the_baseline_keeps() -> None:
    found = run_trials(variant("levy-simple", sensors=(6, 6)), range(3), (BASELINE, "BDNLO"))
    good = found["BDNLO"].converged
    assert good.any()
    assert (found["BDNLO"].rms_m[good] < 0.5 * found[BASELINE].rms_m[good]).all()


@pytest.mark.parametrize("what", ["biases to 40 mrad", "85 % from one sensor", "20 outliers"])
def test_beyond_the_published_limits_the_graph_converges_or_names_why(what: str) -> None:
    world = variant("levy-simple", **LIMITS[what])
    for seed in range(2):
        graph = run_trial(seed, world, (GRAPH,))[GRAPH]
        assert graph.converged.all() or graph.named.all()


def test_late_time_tags_are_estimated() -> None:
    world = variant("sprang-simple", clock_offset_s=TIME_TAGS_S[-1], sensors=(4, 4))
    found = run_trials(world, range(2), (BASELINE, GRAPH))
    assert found[GRAPH].converged.all()
    assert (found[GRAPH].rms_m < found[BASELINE].rms_m).all()


def test_trials_spread_over_processes_are_the_same() -> None:
    world = variant("levy-simple", sensors=(2, 2), bearings=(200, 200))
    alone = run_trials(world, range(12), (BASELINE,))[BASELINE]
    spread = run_trials(world, range(12), (BASELINE,), workers=2)[BASELINE]
    np.testing.assert_array_equal(alone.rms_m, spread.rms_m)
    np.testing.assert_array_equal(alone.nees, spread.nees)


def test_names_of_published_figures_are_those_of_estimators() -> None:
    assert set(PUBLISHED) == set(WORLDS)
    assert {name for table in PUBLISHED.values() for name in table} <= set(ESTIMATORS)


def test_a_table_says_what_did_not_converge() -> None:
    world = variant("levy-simple", sensors=(2, 2), bearings=(200, 200), bias_rad=0.3)
    table = world_table(world, range(2), (BASELINE, "BDNLO", GRAPH))
    rows = [line for line in table.splitlines() if line.startswith("|")]
    assert len(rows) == 5
    assert len({line.count("|") for line in rows}) == 1


def test_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--runs", "2", "--worlds", "levy-simple"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("2 trials; degrees of freedom 3;")
    assert re.search(r"\| BDNLO \| [\d.]+±[\d.]+ \(97\.5\) \|", text)
    assert re.search(r"\| factor graph \| 100\.0±0\.0 \|", text)
    for wrong, expected in (
        (["--runs", "1"], "expected --runs of at least 2"),
        (["--worlds", "nowhere"], "invalid choice: 'nowhere'"),
    ):
        with pytest.raises(SystemExit) as caught:
            main(wrong)
        assert caught.value.code == 2
        assert expected in capsys.readouterr().err
