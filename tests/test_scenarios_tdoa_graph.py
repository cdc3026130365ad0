"""The factor graph on the time-difference study: at the bound, run by run on the same noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from geograph.scenarios.moving_sensors import VARIANTS, draw
from geograph.scenarios.tdoa_bound import bound_covariance, efficient_errors
from geograph.scenarios.tdoa_graph import GraphRuns, graph_runs, graph_score, main, scores

EVERY_KIND = [
    "emitter-1-5ns",
    "emitter-2-position-0.75m",
    "emitter-1-straight-1.5m",
    "emitter-2-moving-60m_s",
    "emitter-1-two-groups",
]


@pytest.mark.parametrize("name", EVERY_KIND)
def test_efficient_errors_have_the_bound_as_their_covariance(name: str) -> None:
    """Linear in Gaussian noise: e' C^-1 e is chi-square exactly; false alarm 1e-4, two-sided."""
    variant = VARIANTS[name]
    times, places = zip(*(draw(variant, seed) for seed in range(2000)), strict=True)
    error = efficient_errors(variant, np.array(times), np.array(places))
    covariance = bound_covariance(variant)[:2, :2]
    total = float(np.sum(error * np.linalg.solve(covariance, error.T).T))
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], error.size)
    assert low < total < high


@pytest.mark.parametrize("name", [*EVERY_KIND, "emitter-2-10ns"])
def test_the_graph_is_at_the_bound(name: str) -> None:
    """Against the first-order error of the same noise twenty runs tell 1 %.

    The NEES band is that of a false alarm of 1 %; the seeds are fixed.
    """
    variant, seeds = VARIANTS[name], range(20)
    found = graph_score(variant, seeds, graph_runs(variant, seeds))
    assert found.converged == found.runs == 20
    assert found.ratio_error < 0.01
    assert found.ratio == pytest.approx(1.0, abs=0.03)
    assert found.band[0] < found.anees < found.band[1]


def test_a_worse_estimator_is_told_from_the_bound() -> None:
    variant, seeds = VARIANTS["emitter-1-1ns"], range(400)
    times, places = zip(*(draw(variant, seed) for seed in seeds), strict=True)
    first = efficient_errors(variant, np.array(times), np.array(places))
    rng = np.random.default_rng(5)
    worse = first + 8.0 * rng.standard_normal(first.shape)
    nees = np.sum(worse * np.linalg.solve(bound_covariance(variant), worse.T).T, axis=1)
    found = graph_score(variant, seeds, GraphRuns(worse, nees, ("converged",) * 400))
    expected = np.sqrt(1.0 + 2 * 64.0 / found.bound_m**2)
    assert found.ratio == pytest.approx(expected, abs=4.0 * found.ratio_error)
    assert found.ratio - 4.0 * found.ratio_error > 1.03
    assert found.anees > found.band[1]


def test_runs_spread_over_processes_are_the_same() -> None:
    name, seeds = "emitter-1-two-groups", range(3)
    ((_, spread),) = scores([name], seeds, workers=2)
    assert spread == graph_score(VARIANTS[name], seeds, graph_runs(VARIANTS[name], seeds))


def test_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--runs", "2", "emitter-1-two-groups"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[2].startswith("| emitter-1-two-groups | 9.47 |")
    assert lines[2].endswith("| 2 of 2 |")
    for wrong, expected in (
        (["nowhere"], "'nowhere' is no variant; expected one of emitter-1-1ns"),
        (["--runs", "1"], "expected --runs of at least 2"),
    ):
        with pytest.raises(SystemExit) as caught:
            main(wrong)
        assert caught.value.code == 2
        assert expected in capsys.readouterr().err
