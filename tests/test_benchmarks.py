"""The benchmark's problems, equations, contestants and verdicts, at a tiny size."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parent / "benchmarks"


@pytest.fixture(scope="module", autouse=True)
def _modules():
    """The benchmark's scripts import each other by name, as scripts do."""
    sys.path.insert(0, str(FOLDER))
    yield
    sys.path.remove(str(FOLDER))


def tiny(kind, seed=2):
    from model import Size
    from simulate import simulate

    sizes = {
        "bearings": Size(4, 12, 12),
        "static": Size(4, 0, 1, 12),
        "mixed": Size(4, 6, 12, 12),
    }
    return simulate(sizes[kind], seed=seed)


def test_a_problem_file_holds_the_problem_and_a_seed_gives_the_same(tmp_path):
    from model import Pass

    made = tiny("mixed")
    path = tmp_path / "pass.npz"
    made.save(path)
    for other in (Pass.load(path), tiny("mixed")):
        for field in dataclasses.fields(made):
            np.testing.assert_array_equal(getattr(other, field.name), getattr(made, field.name))


@pytest.mark.parametrize("kind", ["bearings", "static", "mixed"])
def test_derivatives_that_contestants_share_are_those_of_the_rows(kind):
    from contestants.sparse import SparseProblem

    problem = SparseProblem(tiny(kind))
    rng = np.random.default_rng(3)
    # Near the truth, where a contestant ends, and near the first guess, where it begins.
    off = (problem.data.truth - problem.data.guess) / problem.data.scale
    for path in (off, np.zeros_like(off)):
        unknown = rng.normal(size=problem.size)
        unknown[: problem.path_size] += path.ravel()
        exact = problem.jacobian(unknown).toarray()
        step = 1e-4
        numeric = np.empty_like(exact)
        for column in range(problem.size):
            change = np.zeros(problem.size)
            change[column] = step
            ahead, back = problem.residuals(unknown + change), problem.residuals(unknown - change)
            numeric[:, column] = (ahead - back) / (2 * step)
        # A gigahertz less another, in double precision, is good to 1e-7 Hz.
        np.testing.assert_allclose(
            exact, numeric, rtol=1e-5, atol=5e-3 if kind == "mixed" else 1e-5
        )


@pytest.mark.parametrize("kind", ["bearings", "static", "mixed"])
@pytest.mark.parametrize("name", ["reference", "gtsam-per-bearing", "scipy-gauss-newton"])
def test_contestants_solve_the_same_problem(kind, name):
    from contestants import CONTESTANTS
    from equations import cost

    data = tiny(kind)
    ours, theirs = CONTESTANTS["geograph"]().set_up(data), CONTESTANTS[name]().set_up(data)
    found, other = ours.solve(), theirs.solve()
    least = cost(data, found.path, found.errors)
    assert cost(data, other.path, other.errors) == pytest.approx(least, rel=1e-6)
    # Half the sum of squares of about as many rows as there are measured numbers.
    assert 0.1 * data.measurements < least < 2.0 * data.measurements
    covariance = ours.marginals()
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert (np.abs(found.path - other.path) < 0.02 * sigma).all()
    relative = (theirs.marginals() - covariance) / (sigma[:, :, None] * sigma[:, None, :])
    assert np.abs(relative).max() < 1e-2


def measured(total_s, cost, memory_mb=1.0):
    from measure import Measured

    return Measured(0.1, total_s, 0.0, total_s, 4, None, None, memory_mb, 1.0, 1.0, cost, 3)


def test_verdicts_say_what_was_measured_and_what_was_stopped():
    from shell import Beside
    from targets import targets

    medium = {
        "geograph": measured(0.01, 100.0),
        "gtsam-per-bearing": measured(0.79, 100.0),
        "scipy-gauss-newton": measured(0.01, 100.5),
        "scipy-least-squares": measured(0.5, 100.001),
        "stone-soup": measured(0.3, 900.0),
        "pyceres": "not installed (pyceres)",
    }
    large = {"geograph": measured(0.1, 1000.0, 70.0), "gtsam-per-bearing": "> 50 s"}
    beside = Beside(update_median_ms=0.5, update_99_ms=6.0, smooth_s=1.0, imports_s=0.5)
    said = [str(target) for target in targets({"medium": medium, "large": large}, beside)]
    for line in (
        "FAILS: medium: times faster than gtsam-per-bearing: 79 (at least 80)",
        # The one that is faster is not at the minimum, and is no contestant.
        "holds: medium: times faster than scipy-least-squares: 50 (at least 8)",
        "FAILS: medium: times faster than pyceres: not measured (at least 8)",
        "holds: medium: times faster than stone-soup: 30 (at least 25)",
        "holds: large: times faster than gtsam-per-bearing: more than 500 (at least 400)",
        "holds: times as long for ten times the data (medium to large): 10 (at most 11)",
        "FAILS: large: bytes of memory a bearing: 1.09e+03 (at most 1000)",
        "FAILS: update, 99th percentile, ms: 6 (at most 5)",
        "holds: times the imports: geograph smooth of Winchcombe: 2 (at most 2.5)",
    ):
        assert line in said


def test_figures_are_put_between_the_comments_of_a_page(tmp_path):
    from page import FIGURES, markdown, put
    from picture import draw

    results = {
        "small": {
            "geograph": measured(0.01, 100.0),
            "scipy-gauss-newton": measured(0.05, 110.0),
            "filterpy": measured(0.5, 900.0),
            "pyceres": "not installed (pyceres)",
            "symforce": "> 50 s",
        }
    }
    text = markdown(results, [], {"python": "3"})
    rows = {line.split("|")[1].strip(" *"): line for line in text.splitlines() if "|" in line}
    assert rows["scipy-gauss-newton"].endswith("| 5.0 | 1 | 1.00 | not at the minimum |")
    assert rows["filterpy"].endswith("| filter |")
    assert "not installed (pyceres)" in rows["pyceres"]
    assert "> 50 s" in rows["symforce"]
    assert len({line.count("|") for line in rows.values()} - {5}) == 1
    page = tmp_path / "speed.md"
    page.write_text("Before.\n<!-- figures -->\nold\n<!-- end of figures -->\nAfter.\n")
    put(text, page, FIGURES)
    put(text, page, FIGURES)
    whole = page.read_text()
    assert whole.startswith("Before.\n")
    assert whole.endswith("After.\n")
    assert "old" not in whole
    assert whole.count("not installed") == 1
    draw(results, tmp_path / "speed.png")
    assert (tmp_path / "speed.png").stat().st_size > 5000


def test_a_contestant_is_measured_in_a_process_that_is_stopped_at_the_limit(tmp_path):
    from argparse import Namespace

    from run import measured_alone

    problem, result = tmp_path / "pass.npz", tmp_path / "result.json"
    tiny("bearings").save(problem)
    stopped = Namespace(limit=0.0, clock="wall", budget=0.0)
    assert measured_alone(problem, "geograph", result, stopped) == "set-up > 0 s"
    patient = Namespace(limit=500.0, clock="process", budget=0.0)
    found = measured_alone(problem, "geograph", result, patient)
    assert found.runs == 3
    assert found.iterations > 1
    assert 0.0 < found.solve_s < 10.0
    assert found.rmse_m < 10.0 * found.sigma_m


def test_long_recordings_are_smoothed_by_both_eliminations():
    from scaling import Case, smooth_here

    for elimination in ("structured", "gtsam"):
        found = smooth_here(Case(40, 400, elimination=elimination), "process")
        assert found["status"] == "converged"
        assert found["knots"] == 40
