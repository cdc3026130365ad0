"""Quantiles against scipy.stats."""

import numpy as np
import pytest
from scipy.stats import chi2

from geograph import chi_square


@pytest.mark.parametrize("freedom", [1, 2, 3, 30, 4000])
def test_quantiles(freedom):
    chance = np.array([1e-12, 1e-3, 0.05, 0.5, 0.95, 0.999])
    np.testing.assert_allclose(
        chi_square.quantile(chance, freedom), chi2.ppf(chance, freedom), rtol=1e-12
    )
    np.testing.assert_allclose(
        chi_square.exceeded(chance, freedom), chi2.isf(chance, freedom), rtol=1e-12
    )
    assert chi_square.median(freedom) == pytest.approx(chi2.median(freedom), rel=1e-13)
