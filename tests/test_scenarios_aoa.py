"""The comparison estimators of the study from the air, the factor graph on it, its tables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from geograph.scenarios import aoa_study
from geograph.scenarios.airborne import SCENARIOS, Airborne, Runs, beyond, draw_noise, simulate
from geograph.scenarios.aoa_bound import efficient_errors, horizontal_m, recursive_bound
from geograph.scenarios.aoa_estimators import LARGEST_RANGE_M, gauss_newton_start, within_reach
from geograph.scenarios.aoa_kalman import extended_kalman
from geograph.scenarios.aoa_model import AngleModel
from geograph.scenarios.aoa_smoothed import log_steps, sequence_weights, smooth_prefixes
from geograph.scenarios.aoa_study import ESTIMATORS, PUBLISHED, main, study


def without_noise(scenario: Airborne) -> Runs:
    runs = simulate(scenario, [0])
    exact = simulate(replace(scenario, sigma_deg=1e-12), [0])
    return replace(runs, azimuth_rad=exact.azimuth_rad, elevation_rad=exact.elevation_rad)


@pytest.mark.parametrize(
    "scenario",
    [SCENARIOS["4-5deg"], SCENARIOS["5-5deg"], beyond()["rolling"]],
    ids=lambda s: s.name,
)
def test_derivatives_of_the_angles(scenario: Airborne) -> None:
    model = AngleModel.of(simulate(scenario, [0]))
    rng = np.random.default_rng(4)
    truth = np.array(scenario.target_m[: model.size])
    state = truth + 100.0 * rng.standard_normal((20, model.size))
    angle, rows = model.linearise(state, 17)
    np.testing.assert_allclose(angle, model.predict(state, 17), atol=1e-12)
    second = model.curvature(state, 17)
    for axis in range(model.size):
        step = 0.1 * np.eye(model.size)[axis]
        (up, rows_up), (down, rows_down) = (
            model.linearise(state + sign * step, 17) for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose((up - down) / 0.2, rows[..., axis], atol=1e-9)
        # The ground's curvature is one across a cell of 50 m: it is coarser than a difference.
        coarse = 2e-8 if model.ground is None else 5e-8
        np.testing.assert_allclose((rows_up - rows_down) / 0.2, second[..., axis], atol=coarse)


@pytest.mark.parametrize("name", ["1-5deg", "3-5deg", "4-5deg", "5-5deg"])
def test_the_truth_comes_back_without_noise(name: str) -> None:
    """To half of the bound: the filters linearise once, where the first steps put the emitter."""
    runs = without_noise(SCENARIOS[name])
    truth = np.array(SCENARIOS[name].target_m)
    bound = horizontal_m(recursive_bound(SCENARIOS[name]))[-1]
    for estimator in ESTIMATORS.values():
        error = estimator(runs).position_m[0, -1] - truth
        assert np.linalg.norm(error[:2]) < 0.5 * bound


def test_starts_are_within_reach() -> None:
    for name in ("1-10deg", "3-10deg"):
        model = AngleModel.of(simulate(SCENARIOS[name], range(200)))
        start = gauss_newton_start(model)
        offset = start.state[:, :2] - np.array(SCENARIOS[name].receivers[0].start_m[:2])
        # The first measurement is 20 m from the start of the flight.
        assert np.linalg.norm(offset, axis=-1).max() < LARGEST_RANGE_M + 25.0
        assert (np.linalg.eigvalsh(start.covariance) > 0.0).all()
    far = np.array([[200.0 + 2.0 * LARGEST_RANGE_M, 220.0, 1000.0]])
    near = within_reach(AngleModel.of(simulate(SCENARIOS["1-5deg"], [0])), far)
    np.testing.assert_allclose(near, [[200.0 + LARGEST_RANGE_M, 220.0, 1000.0]])


@pytest.mark.parametrize(
    ("name", "low", "high"), [("1-5deg", 0.55, 1.2), ("3-10deg", 0.75, 1.3), ("5-5deg", 0.55, 1.0)]
)
def test_estimators_are_near_the_published(name: str, low: float, high: float) -> None:
    """Factors around those of 1000 runs (docs/accuracy.md), which 30 runs scatter about."""
    scores = study(SCENARIOS[name], range(30))
    for estimator, score in scores.items():
        assert low < score.sequence_m / getattr(PUBLISHED[name], estimator) < high


def test_a_filter_is_honest_where_geometry_is_good() -> None:
    """Sum of e' P^-1 e of 60 runs at the last step; false alarm 1e-4, two-sided."""
    scenario = SCENARIOS["5-5deg"]
    estimates = extended_kalman(simulate(scenario, range(60)))
    error = estimates.position_m[:, -1, :2] - np.array(scenario.target_m[:2])
    solved = np.linalg.solve(estimates.covariance_m2[:, -1], error[..., None])[..., 0]
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], error.size)
    assert low < np.sum(error * solved) < high


def test_weights_of_some_steps() -> None:
    steps = log_steps(372, 12)
    assert (steps[0], steps[-1]) == (1, 372)
    weights = sequence_weights(steps, 372)
    assert weights.sum() == pytest.approx(1.0)
    # Exact for what is linear in the logarithm.
    value = 3.0 - 0.4 * np.log(np.arange(1, 373))
    assert value[steps - 1] @ weights == pytest.approx(value.mean())


def test_the_factor_graph_reaches_the_bound() -> None:
    """Crossed paths, 40 runs: NEES at the last step in its chi-square band, false alarm 1e-4."""
    scenario = SCENARIOS["5-5deg"]
    result = smooth_prefixes(scenario, range(40), step=np.array([250]), ground="altitude")
    assert (result.status == "converged").all()
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], 2 * 40)
    assert low < result.nees.sum() < high


def test_the_ellipse_fails_in_the_first_steps() -> None:
    """Angles of 10 degrees from one aircraft: far estimates claim far more than they know.

    The errors of the first step are skewed: the mean of the squared errors is many times the
    squared median, which of a normal distribution is 2 / (2 ln 2) = 1.4.
    """
    result = smooth_prefixes(
        SCENARIOS["3-10deg"], range(60), step=np.array([1]), region=None, ground="altitude"
    )
    squares = result.squared_m2[:, 0]
    assert squares.mean() > 10.0 * np.median(squares)


def test_tables_are_printed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["--table", "bounds"]) == 0
    out = capsys.readouterr().out
    assert "| 1-5deg | 155 | 155 | 2558 | 25.1 | 26.8 |" in out
    monkeypatch.setattr(aoa_study, "PUBLISHED", {"5-10deg": PUBLISHED["5-10deg"]})
    monkeypatch.setattr(aoa_study, "PREFIXES", 3)
    assert main(["--table", "smoothed", "--final", "3", "--sequences", "2"]) == 0
    table = capsys.readouterr().out.strip().splitlines()
    assert table[2].startswith("| 5-10deg | ")
    assert "| 84 | 72.0 |" in table[2]
    assert table[-1].startswith("| 5-10deg | ")


@pytest.mark.parametrize("name", ["1-10deg", "3-5deg", "5-10deg"])
def test_efficient_errors_have_the_bound_as_their_covariance(name: str) -> None:
    """Linear in Gaussian noise: e' C^-1 e is chi-square exactly; false alarm 1e-4, two-sided."""
    scenario = SCENARIOS[name]
    error = efficient_errors(scenario, np.array([draw_noise(scenario, s) for s in range(400)]))
    covariance = recursive_bound(scenario)[-1, :2, :2]
    total = float(np.sum(error * np.linalg.solve(covariance, error.T).T))
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], error.size)
    assert low < total < high


@pytest.mark.parametrize("bad", [["--runs", "1"], ["--seed", "-1"], ["--table", "all-of-them"]])
def test_bad_options_are_refused(bad: list[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(bad)
    assert stopped.value.code == 2
