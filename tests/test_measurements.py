"""Tables given through the Python interface: what is no table is told in one line."""

from __future__ import annotations

import re

import numpy as np
import pytest

import geograph as gg

SIZE = 4
WHOLE, TIMES = np.zeros(SIZE, dtype=np.int64), np.arange(4.0)
SMALL = np.full(SIZE, 1e-6)
PAIRS = {"time_s": TIMES, "sensor": WHOLE + 1, "reference": WHOLE, "line": WHOLE}
GOOD = {
    gg.Bearings: {
        **{"time_s": TIMES, "sensor": WHOLE, "azimuth_rad": TIMES, "elevation_rad": TIMES},
        **{"sigma_azimuth_rad": SMALL, "sigma_elevation_rad": SMALL},
        **{"isotropic": np.ones(SIZE, dtype=bool), "line": WHOLE},
    },
    gg.Arrivals: {
        **{"emission": np.array([0, 0, 1, 1]), "sensor": WHOLE, "toa_s": TIMES},
        **{"sigma_s": SMALL, "line": WHOLE},
    },
    gg.TimeDifferences: PAIRS
    | {"tdoa_s": SMALL, "sigma_s": SMALL, "sigma_reference_s": 0.0 * SMALL},
    gg.FrequencyDifferences: PAIRS
    | {"fdoa_hz": TIMES, "carrier_hz": 1.0 + TIMES, "sigma_hz": 1.0 + TIMES}
    | {"sigma_reference_hz": 0.0 * TIMES},
    gg.Constraints: {
        **{"time_s": TIMES, "kind": ("altitude_m",) * SIZE, "value": TIMES, "sigma": SMALL},
        "line": WHOLE,
    },
}


@pytest.mark.parametrize("table", GOOD)
def test_every_column_is_an_array_of_its_type(table):
    good = GOOD[table]
    assert len(table(**good)) == SIZE
    for name, column in good.items():
        if name == "kind":
            continue
        wrong = [column.tolist(), None, column.astype(str), column[:, None]]
        if column.dtype.kind != "f" and name != "line":
            wrong.append(column.astype(np.float64))
        for value in wrong:
            expected = rf"^{name} of {table.__name__} is .*; expected a NumPy array of "
            with pytest.raises(gg.InputError, match=expected) as caught:
                table(**good | {name: value})
            assert "\n" not in str(caught.value)
        with pytest.raises(gg.InputError, match=f"^columns of {table.__name__} differ in length"):
            table(**good | {name: column[:3]})


@pytest.mark.parametrize(
    ("numbers", "names", "message"),
    [
        ([0, 0, 1, 1], ("a",), "emissions are numbered 0 to 1 and have 1 names; exp"),
        ([-1, 0, 1, 1], ("a", "b"), "emissions are numbered -1 to 1 and have 2 names"),
        ([0, 0, 1, 1], "ab", "emission_names of Arrivals is 'ab'; expected a tuple of words"),
        ([0, 0, 1, 1], (7, 8), "emission_names of Arrivals is (7, 8); expected a tuple of words"),
    ],
)
def test_every_emission_has_a_name_or_none_has(numbers, names, message):
    good = GOOD[gg.Arrivals] | {"emission": np.array(numbers)}
    with pytest.raises(gg.InputError, match=re.escape(message)):
        gg.Arrivals(**good, emission_names=names)
    assert len(gg.Arrivals(**good)) == SIZE


def test_kinds_of_constraints_are_known():
    """An unknown one was left out of a live feed without a word."""
    with pytest.raises(gg.InputError, match=r"is 'altitude' in row 1; expected one of altitude_m"):
        gg.Constraints(**GOOD[gg.Constraints] | {"kind": ("altitude_m", "altitude") * 2})
    with pytest.raises(gg.InputError, match="is 'abcd'; expected a tuple of kinds"):
        gg.Constraints(**GOOD[gg.Constraints] | {"kind": "abcd"})


def test_a_truth_has_three_columns():
    with pytest.raises(gg.InputError, match=r"position_m of Truth is an array .*shape \(n, 3\)"):
        gg.Truth(time_s=TIMES, position_m=TIMES)


def test_a_feed_refuses_a_sensor_as_its_own_reference():
    sensors = {n: gg.Sensor(name=n, position_m=np.zeros(3) + i) for i, n in enumerate("AB")}
    smoother = gg.IncrementalSmoother(sensors, motion="static", frame="local")
    for table in (gg.TimeDifferences, gg.FrequencyDifferences):
        own = GOOD[table] | {"reference": np.array([0, 0, 1, 0]), "line": WHOLE + 5}
        with pytest.raises(gg.UpdateError, match=r"^line 5, column reference: .* are both 1; exp"):
            smoother.update(table(**own))
