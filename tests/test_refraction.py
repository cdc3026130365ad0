"""Mean refraction against tabulated values."""

import json
from pathlib import Path

import numpy as np
import pytest

from geograph.factors.refraction import refraction

TABLE = json.loads((Path(__file__).parent / "authorities" / "refraction.json").read_text())


@pytest.mark.parametrize(("apparent_deg", "arcminutes"), TABLE["rows"])
def test_mean_refraction_table(apparent_deg, arcminutes):
    found = np.degrees(refraction(np.radians([apparent_deg])))[0] * 60.0
    assert found == pytest.approx(arcminutes, abs=TABLE["tolerance_arcminutes"])


def test_the_air_lifts_and_less_so_higher_up():
    elevation = np.radians(np.linspace(0.0, 90.0, 1000))
    lift = refraction(elevation)
    assert (lift >= 0.0).all()
    assert (np.diff(lift) <= 0.0).all()


def test_the_horizon_is_the_end_and_missing_elevations_stay_missing():
    below = refraction(np.radians([-5.0, -0.1, 0.0]))
    assert below[0] == below[1] == below[2]
    assert np.isnan(refraction(np.array([np.nan])))[0]
