"""Worlds of the study from the air, its bounds beside the printed ones, its recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import geograph as gg
from geograph.scenarios.airborne import (
    PARALLEL_SLOPE,
    SCENARIOS,
    Airborne,
    Receiver,
    beyond,
    simulate,
    true_angles,
)
from geograph.scenarios.airborne_recordings import Region, recordings
from geograph.scenarios.aoa_bound import (
    angle_rows,
    horizontal_m,
    recursive_bound,
    sequence_bound_m,
)
from geograph.scenarios.aoa_study import PUBLISHED

ROLLING = Receiver(start_m=(0.0, 0.0, 800.0), heading_deg=40.0, roll_deg=30.0)


def test_body_axes_are_yaw_pitch_and_roll() -> None:
    """Against scipy: from north-east-down, about z, then the new y, then the new x."""
    time = np.linspace(0.0, 20.0, 60)
    rotation = Rotation.from_euler("ZYX", ROLLING.attitude_at(time)).as_matrix()
    # Columns are the body's forward, right and down in north, east, down.
    north, east, down = np.moveaxis(rotation, 1, 0)
    body = np.stack([east, north, -down], axis=1)
    expected = np.stack([body[..., 0], body[..., 1], -body[..., 2]], axis=1)
    np.testing.assert_allclose(ROLLING.axes_at(time), expected, atol=1e-12)


def test_angles_of_a_level_aircraft() -> None:
    """The azimuth is the course to the emitter less the heading; the elevation is that of space."""
    scenario = SCENARIOS["5-5deg"]
    azimuth, elevation = true_angles(scenario)
    sight = np.array(scenario.target_m) - scenario.receivers_at(scenario.time_s)
    course = np.arctan2(sight[..., 0], sight[..., 1]) - np.radians([0.0, 90.0])
    np.testing.assert_allclose(np.sin(azimuth - course), 0.0, atol=1e-12)
    np.testing.assert_allclose(
        elevation, np.arcsin(sight[..., 2] / np.linalg.norm(sight, axis=-1)), atol=1e-12
    )


@pytest.mark.parametrize("name", list(PUBLISHED))
def test_bounds_are_the_printed_ones(name: str) -> None:
    """Kallin (2021); printed to a metre."""
    ours = sequence_bound_m(SCENARIOS[name], height_known=True)
    assert round(ours) == PUBLISHED[name].bound


def test_bound_without_the_height() -> None:
    """What the printed bounds of scenarios 1 and 4 leave out."""
    assert sequence_bound_m(SCENARIOS["1-5deg"]) == pytest.approx(2558.0, rel=1e-3)
    assert sequence_bound_m(SCENARIOS["4-5deg"]) == pytest.approx(37.7, abs=0.05)
    # With all angles in, the height hardly matters.
    last = horizontal_m(recursive_bound(SCENARIOS["1-5deg"]))[-1]
    assert last == pytest.approx(26.8, abs=0.05)


@pytest.mark.parametrize("scenario", [SCENARIOS["4-5deg"], beyond()["rolling"]])
def test_rows_of_the_bound_are_derivatives(scenario: Airborne) -> None:
    rows = angle_rows(scenario)
    for axis in range(3):
        step = 0.01 * np.eye(3)[axis]
        up, down = (
            np.stack(
                true_angles(replace(scenario, target_m=tuple(scenario.target_m + sign * step))),
                axis=-1,
            )
            for sign in (1.0, -1.0)
        )
        difference = (up - down + np.pi) % (2.0 * np.pi) - np.pi
        np.testing.assert_allclose(difference / 0.02, rows[..., axis], atol=1e-9)


def test_ground_under_targets() -> None:
    for scenario in [*SCENARIOS.values(), *beyond().values()]:
        height = scenario.terrain.height(*scenario.target_m[:2])
        assert height == pytest.approx(scenario.target_m[2], abs=1e-6)
        receiver = scenario.receivers_at(scenario.time_s)
        clear = receiver[..., 2] - scenario.terrain.height(receiver[..., 0], receiver[..., 1])
        assert clear.min() > 500.0
    slope = SCENARIOS["2-5deg"].terrain.gradient(3200.0, 3200.0)
    np.testing.assert_allclose(slope, PARALLEL_SLOPE)


def test_an_emitter_on_the_road_stays_on_the_ground() -> None:
    scenario = beyond()["road-mountains"]
    path = scenario.emitter_at(scenario.time_s)
    np.testing.assert_allclose(path[:, 2], scenario.terrain.height(path[:, 0], path[:, 1]))
    speed = np.linalg.norm(np.gradient(path, scenario.time_s, axis=0)[:, :2], axis=-1)
    assert 20.0 < speed.min() < speed.max() < 30.0
    with pytest.raises(ValueError, match="road-mountains has a moving emitter"):
        recursive_bound(scenario)


def test_one_azimuth_does_not_tell_a_place() -> None:
    bound = horizontal_m(recursive_bound(beyond()["azimuth-only"]))
    assert np.isinf(bound[0])
    assert 10.0 < bound[-1] < 100.0


def test_noise_is_that_of_the_scenario() -> None:
    scenario = replace(SCENARIOS["2-10deg"], steps=50)
    runs = simulate(scenario, range(50))
    azimuth, elevation = true_angles(scenario)
    for error in (runs.azimuth_rad - azimuth, runs.elevation_rad - elevation):
        # 5000 draws: the false-alarm rate of 5 standard errors is 6e-7.
        assert abs(error.mean()) < 5.0 * scenario.sigma_rad / np.sqrt(error.size)
        assert abs(error.std() / scenario.sigma_rad - 1.0) < 5.0 / np.sqrt(2.0 * error.size)


def test_recordings_hold_the_runs() -> None:
    scenario = SCENARIOS["5-5deg"]
    runs = simulate(scenario, [3, 8])
    some = recordings(scenario, [3, 8], steps=7, ground="altitude")
    for row, recording in enumerate(some):
        bearings = recording.bearings
        assert bearings is not None
        np.testing.assert_array_equal(bearings.azimuth_rad, runs.azimuth_rad[row, :7].ravel())
        np.testing.assert_array_equal(bearings.elevation_rad, runs.elevation_rad[row, :7].ravel())


def test_body_axes_and_turned_angles_give_one_estimate() -> None:
    scenario = SCENARIOS["5-5deg"]
    estimates = []
    for axes in ("body", "enu"):
        (recording,) = recordings(scenario, [0], steps=60, axes=axes, ground="altitude")
        estimates.append(gg.smooth(recording).at(1.0))
    np.testing.assert_allclose(estimates[0].state, estimates[1].state, atol=1e-4)
    np.testing.assert_allclose(estimates[0].covariance, estimates[1].covariance, rtol=1e-5)


def test_a_rolling_aircraft_needs_body_axes() -> None:
    with pytest.raises(ValueError, match="rolling has an aircraft that rolls"):
        next(recordings(beyond()["rolling"], [0], axes="enu"))


def test_a_region_adds_its_information() -> None:
    """The inverse covariances with and without it differ by its inverse variance over ground."""
    scenario = SCENARIOS["5-5deg"]
    region = Region(centre_m=(2200.0, 2200.0), sigma_m=50.0)
    information = []
    for known in (None, region):
        (recording,) = recordings(scenario, [1], region=known, ground="altitude")
        information.append(np.linalg.inv(gg.smooth(recording).at(1.0).covariance[0]))
    added = (information[1] - information[0])[:2, :2]
    np.testing.assert_allclose(added, np.eye(2) / 50.0**2, atol=0.05 / 50.0**2)


def test_bad_scenarios_are_refused() -> None:
    with pytest.raises(ValueError, match="no receiver"):
        replace(SCENARIOS["1-5deg"], receivers=())
    with pytest.raises(ValueError, match="sigma of 120 degrees"):
        replace(SCENARIOS["1-5deg"], sigma_deg=120)


@pytest.mark.parametrize(("name", "holds"), [("road", True), ("road-mountains", False)])
def test_a_path_over_mountains_is_not_called_gaussian(name: str, holds: bool) -> None:
    """Over ranges the end of the path bends with the ground, where its ellipse is too small."""
    for recording in recordings(beyond()[name], range(2)):
        track = gg.smooth(recording, raise_on_failure=False)
        assert track.summary["gaussian"]["holds"] is holds
        assert track.summary["gaussian"]["rise_at_one_sigma"] > 0.5
        assert any("ellipsoids are too small" in s for s in track.summary["weakly_observed"]) == (
            not holds
        )
