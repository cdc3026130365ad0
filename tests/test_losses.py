"""Losses: shapes, weights as derivatives, efficiency."""

import numpy as np
import pytest
from differences import derivative
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm

from geograph.errors import InputError
from geograph.losses import Loss

NAMES = ("none", "huber", "cauchy", "geman-mcclure")


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.sampled_from(NAMES), st.floats(1e-6, 1e6))
def test_the_weight_is_the_derivative_of_the_loss(name, square):
    if name == "huber" and abs(square - 1.345**2) < 0.01:
        square = 3.0
    loss = Loss(name)
    _, weight = loss.value_and_weight(np.array([square]))
    slope = derivative(lambda s: loss.value_and_weight(s)[0], [square], [1e-3 * square])
    assert weight[0] == pytest.approx(slope[0, 0], rel=1e-7, abs=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_small_residuals_are_least_squares_and_large_ones_count_less(name):
    square = np.concatenate([[0.0], np.logspace(-12, 12, 500)])
    value, weight = Loss(name).value_and_weight(square)
    assert value[0] == 0.0
    assert weight[0] == 1.0
    assert value[1] == pytest.approx(square[1], rel=1e-9)
    assert (np.diff(value) >= 0.0).all()
    assert (np.diff(weight) <= 0.0).all()
    assert (value <= square * (1 + 1e-12)).all()
    if name != "none":
        assert value[-1] < 1e-3 * square[-1]


@pytest.mark.parametrize("name", ["huber", "cauchy"])
def test_tuning_constants_give_95_percent_efficiency(name):
    """Efficiency of a location estimate on Gaussian data: (E psi')^2 / E psi^2 (Huber, ch. 4)."""

    def influence(r):
        return r * Loss(name).value_and_weight(np.array(r * r))[1]

    breaks = [-1.345, 1.345]
    square = quad(lambda r: influence(r) ** 2 * norm.pdf(r), -9, 9, points=breaks)[0]
    # E psi' = E r psi for the standard normal distribution (Stein).
    slope = quad(lambda r: r * influence(r) * norm.pdf(r), -9, 9, points=breaks)[0]
    assert slope**2 / square == pytest.approx(0.95, abs=1e-3)


def test_an_unknown_loss():
    with pytest.raises(InputError, match="unknown loss 'tukey'; expected none, huber"):
        Loss("tukey")
