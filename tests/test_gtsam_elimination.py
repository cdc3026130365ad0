"""GTSAM's elimination of the same blocks, beside the structured one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import geograph as gg
from geograph.eliminate import Elimination
from geograph.gtsam_elimination import GtsamElimination
from geograph.scenarios.ground import ground_pass
from geograph.scenarios.low_orbit import low_orbit_pass

KINDS = {
    "walks": low_orbit_pass(2, bearings=40),
    "ballistic": low_orbit_pass(2, bearings=40, path="j2"),
    "no sensor states": low_orbit_pass(
        2, bearings=40, bias_rad=0.0, drift_rad_s=0.0, instability_rad_sqrt_s=0.0
    ),
    "clocks, along and across": ground_pass(3, bearings=40),
}


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_same_steps_covariances_and_determinant(name: str, damping: float) -> None:
    built = gg.build(KINDS[name])
    system = built.problem.linearise(built.origin)
    ours, theirs = Elimination(system, damping), GtsamElimination(system, damping)
    step, other = ours.solve(), theirs.solve()
    np.testing.assert_allclose(other.knots, step.knots, atol=1e-8 * np.abs(step.knots).max())
    np.testing.assert_allclose(other.constants, step.constants, atol=1e-7)
    assert other.decrease == pytest.approx(step.decrease, rel=1e-9)
    assert theirs.half_log_determinant() == pytest.approx(ours.half_log_determinant(), abs=1e-6)
    one, two = ours.marginals(), theirs.marginals()
    for part in ("knots", "neighbours", "knot_constants", "constants"):
        expected = getattr(one, part)
        scale = np.abs(expected).max(initial=0.0)
        np.testing.assert_allclose(getattr(two, part), expected, atol=1e-7 * scale)


@pytest.mark.parametrize("name", KINDS)
def test_a_track_solved_by_gtsam_is_the_same(name: str) -> None:
    ours = gg.smooth(KINDS[name])
    theirs = gg.smooth(KINDS[name], elimination="gtsam")
    assert theirs.summary["cost"] == pytest.approx(ours.summary["cost"], rel=1e-7)
    sigma = np.sqrt(np.einsum("kii->ki", ours.covariance))
    assert (np.abs(theirs.state - ours.state) < 1e-3 * sigma).all()
    np.testing.assert_allclose(np.sqrt(np.einsum("kii->ki", theirs.covariance)), sigma, rtol=1e-5)


def test_a_static_object_is_one_knot_to_gtsam_too() -> None:
    made = KINDS["no sensor states"]
    ours = gg.smooth(made, motion="static", loss="none", raise_on_failure=False)
    theirs = gg.smooth(
        made, motion="static", loss="none", raise_on_failure=False, elimination="gtsam"
    )
    np.testing.assert_allclose(theirs.position_m, ours.position_m, rtol=1e-9)


def test_what_gtsam_cannot_whiten_is_refused() -> None:
    with pytest.raises(gg.InputError, match="no process noise, which GTSAM cannot whiten"):
        gg.smooth(KINDS["walks"], motion="static", elimination="gtsam")


@pytest.mark.parametrize("value", ["cholmod", 3])
def test_unknown_elimination(value: Any) -> None:
    with pytest.raises(gg.InputError, match="unknown elimination"):
        gg.smooth(KINDS["walks"], elimination=value)
