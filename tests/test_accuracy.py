"""Efficiency and consistency on simulated passes, against worlds that share no equation.

Every statement about ANEES is a two-sided 99 % chi-square band over the passes (one knot of each,
so that they are independent): a right smoother fails it once in a hundred choices of the seeds, and
the seeds are fixed. The passes of different tests share their sensors' errors and noise, so that
their figures are high or low together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.stats import chi2

import geograph as gg
from geograph.bounds import cramer_rao_bound
from geograph.families import Values
from geograph.scenarios.low_orbit import LowOrbit, low_orbit_world
from geograph.solver import Status

if TYPE_CHECKING:
    from numpy.typing import NDArray

# What these passes run is measured elsewhere, and measuring makes them a fifth longer.
pytestmark = pytest.mark.no_cover
SEEDS = range(200)
SPARSE = ("bearings", 100)
"""Of each sensor. A pass of three times as many takes twice the time and tests the same."""


@dataclass(frozen=True)
class Outcome:
    """What many passes gave: NEES of one knot, squared errors and bounds over the pass.

    ``first`` is the squared error that is efficient to first order, on the same noise: of one step
    of Gauss and Newton from the true path, whose mean square is the bound.
    """

    status: tuple[Status, ...]
    nees: NDArray[np.float64]
    square: NDArray[np.float64]
    first: NDArray[np.float64]
    variance: NDArray[np.float64]
    weak: tuple[bool, ...]

    @property
    def anees(self) -> float:
        return float(self.nees.mean())

    @property
    def ratio(self) -> float:
        """RMSE over the posterior Cramer-Rao bound."""
        return float(np.sqrt(self.square.mean() / self.variance.mean()))

    @property
    def same_noise(self) -> float:
        """The ratio with most of the chance of the draw taken out, as in scenarios/tdoa_graph."""
        return float(np.sqrt(1.0 + np.mean(self.square - self.first) / self.variance.mean()))

    def band(self) -> tuple[float, float]:
        count = self.nees.size
        low, high = chi2.ppf([0.005, 0.995], 3 * count) / count
        return float(low), float(high)


@cache
def outcome(seeds: range, options: tuple[tuple[str, Any], ...], **changes: Any) -> Outcome:
    status, nees, square, first, variance, weak = [], [], [], [], [], []
    for seed in seeds:
        world = low_orbit_world(seed, LowOrbit(**dict(options)))
        track = gg.smooth(world.recording, raise_on_failure=False, **changes)
        truth = world.path.position_at(track.time_s)
        error = track.position_m - truth
        middle = track.time_s.size // 2
        covariance = track.position_covariance_m2[middle]
        nees.append(error[middle] @ np.linalg.solve(covariance, error[middle]))
        square.append(np.mean(np.sum(error**2, axis=1)))
        for column, value in zip(
            (first, variance), _efficient_error(track, world.path), strict=True
        ):
            column.append(value)
        status.append(track.status)
        weak.append(bool(track.summary["weakly_observed"]))
    columns = (np.array(column) for column in (nees, square, first, variance))
    return Outcome(tuple(status), *columns, tuple(weak))


def _efficient_error(track: gg.Track, path: Any) -> tuple[float, float]:
    """Return the mean square of the first-order error, and its bound, at the true path."""
    time = track.time_s
    state = np.concatenate([path.position_at(time), path.velocity_at(time)], axis=1)
    if track.order == 3:
        step = 1e-2
        change = path.velocity_at(time + step) - path.velocity_at(time - step)
        state = np.concatenate([state, change / (2.0 * step)], axis=1)
    problem = track.problem
    truth = Values(state, np.zeros_like(track.values.walks), np.zeros_like(track.values.constants))
    step = problem.linearise(truth).factorise().solve()
    error = (problem.moved(truth, step).path - state)[:, :3]
    bound = cramer_rao_bound(problem, truth).covariance[:, :3, :3]
    square = np.mean(np.sum(error**2, axis=1))
    return float(square), float(np.trace(bound, axis1=1, axis2=2).mean())


def _efficient(result: Outcome) -> None:
    assert set(result.status) == {Status.CONVERGED}
    low, high = result.band()
    assert low < result.anees < high
    # By chance 1.00 and 0.0001 over 200 passes, whatever the path: far beyond any false alarm.
    assert abs(result.same_noise - 1.0) < 2e-3
    # The draw itself scatters by 0.05 to 0.06 over 200 passes: a false alarm of 1 %.
    assert result.ratio < 1.13


def test_paths_from_the_prior_are_smoothed_efficiently() -> None:
    _efficient(outcome(SEEDS, (("path", "prior"), SPARSE)))


def test_free_fall_is_smoothed_efficiently_by_the_ballistic_model() -> None:
    _efficient(outcome(SEEDS, (("path", "j2"), SPARSE)))


def test_disturbed_free_fall_is_smoothed_efficiently() -> None:
    _efficient(outcome(SEEDS, (("path", "prior-ballistic"), SPARSE)))


def test_a_point_mass_orbit_is_smoothed_efficiently_with_noise_that_covers_the_oblateness() -> None:
    _efficient(outcome(SEEDS, (("path", "two-body"), SPARSE)))


@pytest.mark.parametrize("noise", [0.1, "auto"])
def test_an_orbit_under_constant_acceleration_is_never_overconfident(noise: float | str) -> None:
    result = outcome(
        range(25),
        (("path", "two-body"), SPARSE),
        motion="constant-acceleration",
        process_noise=noise,
    )
    assert set(result.status) == {Status.CONVERGED}
    assert result.anees < result.band()[1]
    # Nor is it useless: the error stays within reach of the bound of its own, weaker model.
    assert result.ratio < 1.3


def test_gross_outliers_cost_little() -> None:
    # The same noise with and without: the ratio of 30 pairs scatters by 0.02 or less.
    seeds = range(30)
    clean = outcome(seeds, (("path", "prior"), SPARSE))
    dirty = outcome(seeds, (("path", "prior"), SPARSE, ("outliers", 7)))
    assert set(dirty.status) == {Status.CONVERGED}
    assert np.sqrt(dirty.square.mean() / clean.square.mean()) < 1.10
    low, high = dirty.band()
    assert low < dirty.anees < high


@pytest.mark.parametrize(
    ("options", "least_converged"),
    [
        ((("path", "j2"), ("bias_rad", 40e-3)), 1.0),
        ((("path", "j2"), ("sensors", 2)), 1.0),
        ((("path", "j2"), ("sensors", 2), ("bias_rad", 40e-3)), 0.9),
        # Two sensors, biases of two degrees, and a path that is free to bend: the posterior of two
        # passes in three is a long curved shell, which no ellipsoid describes.
        ((("path", "prior"), ("sensors", 2), ("bias_rad", 40e-3)), 0.2),
    ],
)
def test_where_the_literature_diverges_the_smoother_converges_or_names_why(
    options: tuple[tuple[str, Any], ...], least_converged: float
) -> None:
    result = outcome(range(25), options)
    for status, weak in zip(result.status, result.weak, strict=True):
        assert status is Status.CONVERGED or (status is Status.UNOBSERVABLE and weak)
    converged = np.array([status is Status.CONVERGED for status in result.status])
    assert converged.mean() >= least_converged
    # What is called converged is honest.
    nees = result.nees[converged]
    assert nees.mean() < chi2.ppf(0.995, 3 * nees.size) / nees.size


def test_clocks_seconds_off_are_found() -> None:
    result = outcome(range(25), (("path", "j2"), ("clock_offset_s", 2.0), SPARSE))
    assert set(result.status) == {Status.CONVERGED}
    low, high = result.band()
    assert low < result.anees < high
