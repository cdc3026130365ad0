"""Levenberg-Marquardt: every way it can end."""

from dataclasses import dataclass

import numpy as np
import pytest

from geograph.blocks import Sums
from geograph.eliminate import LinearSystem
from geograph.families import Values
from geograph.solver import Status, solve


@dataclass
class Curve:
    """Residuals of a few scalars, with one knot and constant states of no use."""

    residual: object
    jacobian: object
    linearised: int = 0

    def cost(self, values):
        with np.errstate(all="ignore"):
            return 0.5 * float(np.sum(self.residual(values.path[0]) ** 2))

    def linearise(self, values):
        self.linearised += 1
        with np.errstate(all="ignore"):
            rows = np.column_stack([self.jacobian(values.path[0]), self.residual(values.path[0])])
            block = Sums.of((rows.T @ rows)[None], rows.shape[1] - 1)
        size = values.path.shape[1]
        return LinearSystem(
            block, np.zeros((0, size, size)), np.zeros((0, size, size)), np.zeros((0, size)),
            np.zeros(size), np.zeros(size), np.zeros(0), self.cost(values),
        )  # fmt: skip

    def moved(self, values, step):
        return Values(values.path + step.knots, values.walks, values.constants)


def start(*numbers):
    return Values(np.array([numbers], dtype=float), np.zeros((1, 0)), np.zeros(0))


def test_a_linear_problem_takes_one_step_and_one_that_confirms():
    design = np.array([[1.0, 2.0], [3.0, -1.0], [0.5, 0.2]])
    right = np.array([1.0, 2.0, 3.0])
    problem = Curve(lambda x: design @ x - right, lambda _: design)
    found = solve(problem, start(100.0, -50.0))
    assert found.status is Status.CONVERGED
    assert found.iterations == 2
    expected = np.linalg.lstsq(design, right, rcond=None)[0]
    np.testing.assert_allclose(found.values.path[0], expected, atol=1e-12)
    covariance = found.elimination.marginals().knots[0]
    np.testing.assert_allclose(covariance, np.linalg.inv(design.T @ design), rtol=1e-12)


def rosenbrock():
    """The valley of H. Rosenbrock (1960): Gauss-Newton steps leave it, damping brings them back."""
    return Curve(
        lambda x: np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]),
        lambda x: np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]]),
    )


def test_a_bent_valley_needs_damping():
    found = solve(rosenbrock(), start(-1.2, 1.0))
    assert found.status is Status.CONVERGED
    np.testing.assert_allclose(found.values.path[0], [1.0, 1.0], atol=1e-6)
    assert found.cost < 1e-12
    assert 2 < found.iterations < 60


def test_every_accepted_step_lowers_the_cost():
    """With a limit of n iterations the cost falls with n."""
    costs = [solve(rosenbrock(), start(-1.2, 1.0), max_iterations=n).cost for n in range(1, 20)]
    assert (np.diff(costs) <= 0.0).all()
    assert costs[0] <= 0.5 * (4.4**2 + 2.2**2)


def test_the_limit_of_iterations():
    found = solve(rosenbrock(), start(-1.2, 1.0), max_iterations=3)
    assert found.status is Status.ITERATION_LIMIT
    assert found.iterations == 3
    assert found.elimination is not None
    assert found.cost == rosenbrock().cost(found.values)


def test_a_first_guess_without_a_cost():
    problem = Curve(np.log, lambda x: np.diag(1.0 / x))
    found = solve(problem, start(-1.0))
    assert found.status is Status.DIVERGED
    assert found.iterations == 0
    assert found.elimination is None
    assert np.isnan(found.cost)


def test_a_step_into_the_forbidden_is_damped():
    """From 3, Gauss-Newton on log(x) steps to 3 - 3 log 3 < 0, where there is no cost."""
    problem = Curve(np.log, lambda x: np.diag(1.0 / x))
    found = solve(problem, start(3.0))
    assert found.status is Status.CONVERGED
    assert found.values.path[0, 0] == pytest.approx(1.0, abs=1e-6)


def test_derivatives_that_point_uphill():
    """With the wrong sign no step lowers the cost, however short."""
    problem = Curve(lambda x: x - 5.0, lambda _: -np.eye(1))
    found = solve(problem, start(1.0))
    assert found.status is Status.DIVERGED
    np.testing.assert_array_equal(found.values.path, [[1.0]])
    assert found.cost == problem.cost(start(1.0))


def test_what_nothing_determines_is_left_where_it_was():
    """A singular system is damped as little as makes it solvable; it has no covariance."""
    problem = Curve(lambda x: np.array([x[0] - 2.0, 0.0]), lambda _: np.diag([1.0, 0.0]))
    found = solve(problem, start(10.0, 7.0))
    assert found.status is Status.CONVERGED
    np.testing.assert_allclose(found.values.path[0], [2.0, 7.0], atol=1e-6)
    assert found.elimination is None


def test_derivatives_that_are_not_numbers():
    problem = Curve(lambda x: x, lambda _: np.full((1, 1), np.nan))
    found = solve(problem, start(1.0))
    assert found.status is Status.DIVERGED
    assert found.elimination is None


def test_at_the_minimum_already():
    problem = Curve(lambda x: x - 5.0, lambda _: np.eye(1))
    found = solve(problem, start(5.0))
    assert found.status is Status.CONVERGED
    assert found.iterations == 1
    assert found.cost == 0.0


def slow():
    """A minimum at 0 with large residuals: Gauss-Newton gets closer by one half at every step.

    J. E. Dennis, R. B. Schnabel, Numerical Methods for Unconstrained Optimization (1983), ch. 10.
    """
    return Curve(
        lambda x: np.array([x[0] + 1.0, 0.5 * x[0] ** 2 + x[0] - 1.0]),
        lambda x: np.array([[1.0], [x[0] + 1.0]]),
    )


def test_the_tolerance_is_the_predicted_decrease():
    """Near 0 that is about x^2 / 4 of a cost of 1; the last step halves x once more."""
    for tolerance, x in ((1e-2, 0.2), (1e-6, 2e-3), (1e-10, 2e-5)):
        found = solve(slow(), start(0.5), tolerance=tolerance)
        assert found.status is Status.CONVERGED
        assert x / 8.0 < abs(found.values.path[0, 0]) < x
