"""Worlds of satellites, angles only: orbits, forces, accumulating errors, and the recordings."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.stats import chi2

import geograph as gg
from geograph.constants import EARTH_GM_M3_S2, EARTH_RADIUS_M
from geograph.scenarios.accelerometer import Accelerometer, accumulate
from geograph.scenarios.angles_worlds import (
    WORLDS,
    AnglesWorld,
    angles_recording,
    angles_trial,
    variant,
)
from geograph.scenarios.kepler import EllipticOrbit, random_elliptic_satellite
from geograph.scenarios.observation import observe_bearings
from geograph.scenarios.orbits import CircularOrbit, free_fall, gravity
from geograph.scenarios.places import clearance_m, random_axes
from geograph.scenarios.staged import Stages, random_staged_path
from geograph.softened import softened

if TYPE_CHECKING:
    from pathlib import Path

UNIT = Accelerometer(resolution_rad_s2=1e-6, sample_s=0.1, calibration_s=20.0)


@pytest.mark.parametrize("eccentricity", [0.0, 0.3, 0.9])
def test_an_ellipse_is_where_the_integrated_equation_of_motion_goes(eccentricity: float) -> None:
    first, second = random_axes(np.random.default_rng(3))
    orbit = EllipticOrbit(1.2e7 / (1.0 - eccentricity), eccentricity, first, second, -0.7)
    initial = np.stack([orbit.position_at(0.0), orbit.velocity_at(0.0)])
    fall = free_fall(initial, (0.0, 1500.0), j2=False)
    time = np.linspace(0.0, 1500.0, 37)
    np.testing.assert_allclose(orbit.position_at(time), fall.position_at(time), atol=1e-3)
    np.testing.assert_allclose(orbit.velocity_at(time), fall.velocity_at(time), atol=1e-6)
    energy = np.sum(orbit.velocity_at(time) ** 2, axis=-1) / 2.0 - EARTH_GM_M3_S2 / np.linalg.norm(
        orbit.position_at(time), axis=-1
    )
    np.testing.assert_allclose(energy, -EARTH_GM_M3_S2 / (2.0 * orbit.semi_major_m), rtol=1e-12)


def test_an_ellipse_without_eccentricity_is_the_circle() -> None:
    first, second = random_axes(np.random.default_rng(4))
    time = np.linspace(-1e5, 1e5, 23)
    circle = CircularOrbit(8e6, first, second, 0.4)
    ellipse = EllipticOrbit(8e6, 0.0, first, second, 0.4)
    np.testing.assert_allclose(ellipse.position_at(time), circle.position_at(time), atol=1e-3)


def test_random_ellipses_have_their_perigees_where_asked() -> None:
    rng = np.random.default_rng(5)
    for _ in range(10):
        body = random_elliptic_satellite(rng, perigee_m=(1e6, 2e6), eccentricity=(0.1, 0.2))
        height = np.linalg.norm(body.position_at(np.linspace(0.0, 2e4, 2001)), axis=-1)
        nearest, farthest = height.min(), height.max()
        assert 1e6 - 10e3 < nearest - EARTH_RADIUS_M < 2e6 + 10e3
        assert 1.1 / 0.9 - 0.01 < farthest / nearest < 1.2 / 0.8 + 0.01


def test_each_stage_has_its_force_and_no_other() -> None:
    stages = Stages(count=4, thrust_m_s2=3.0, flutter_m_s2=0.0)
    path = random_staged_path(np.random.default_rng(6), stages, (0.0, 300.0))
    edges = np.concatenate([[0.0], path.boundary_s, [300.0]])
    inertial = path.body.inertial  # type: ignore[attr-defined]
    for index, force in enumerate(path.thrust_m_s2):
        time = np.linspace(edges[index] + 0.6, edges[index + 1] - 0.6, 5)
        change = inertial.velocity_at(time + 0.5) - inertial.velocity_at(time - 0.5)
        np.testing.assert_allclose(
            change - gravity(inertial.position_at(time), j2=True), np.tile(force, (5, 1)), atol=2e-5
        )
    assert np.linalg.norm(path.thrust_m_s2, axis=1).max() <= 3.0
    # Neither position nor velocity jumps where a stage ends.
    for time in path.boundary_s:
        gap = inertial.velocity_at(time + 1e-6) - inertial.velocity_at(time - 1e-6)
        assert np.abs(gap).max() < 1e-3


def test_the_settings_noise_moves_the_acceleration_as_much_as_the_forces() -> None:
    """Mean square of the total change of 400 draws, each axis; false alarm below 1e-4."""
    rng, stages, duration = np.random.default_rng(7), Stages(count=6, flutter_m_s2=0.0), 100.0
    square = []
    for _ in range(400):
        force = stages.draw_thrust(rng)
        square.append(np.sum(np.diff(force, axis=0) ** 2) / 3.0)
    expected = stages.jerk_density(duration) ** 2 * duration
    error = np.std(square) / np.sqrt(len(square))
    assert abs(np.mean(square) - expected) < 4.0 * error
    assert error < 0.05 * expected


def test_what_accumulates_grows_as_twice_integrated_noise() -> None:
    """Variance at 10 s over 3000 draws; chi-square, false alarm 1e-4, and 1 % for the sampling."""
    unit = Accelerometer(resolution_rad_s2=1e-6, sample_s=0.1, calibration_s=1e9)
    rng = np.random.default_rng(8)
    draws = np.array(
        [accumulate(rng, unit, (0.0, 11.0)).at(np.array([10.0]))[0] for _ in range(1500)]
    )
    ratio = np.sum(draws**2) / (unit.density**2 * 10.0**3 / 3.0) / draws.size
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], draws.size) / draws.size
    assert low * 0.98 < ratio < high * 1.01


def test_calibrations_reset_and_the_mean_square_is_that_of_the_formula() -> None:
    rng = np.random.default_rng(9)
    mean = []
    for _ in range(1500):
        made = accumulate(rng, UNIT, (0.0, 60.0))
        mean.append(np.mean(made.error_rad[:600] ** 2))
        after = np.searchsorted(made.time_s, made.calibration_s)
        assert (made.error_rad[after[after < made.time_s.size]] == 0.0).all()
    error = np.std(mean) / np.sqrt(len(mean))
    # Four standard errors: a false alarm of 1e-4.
    assert abs(np.mean(mean) - UNIT.rms_rad(60.0) ** 2) < 4.0 * error
    assert error < 0.1 * UNIT.rms_rad(60.0) ** 2


@pytest.mark.parametrize("name", WORLDS)
def test_trials_are_what_their_declaration_says(name: str) -> None:
    world = WORLDS[name]
    trial = angles_trial(2, world)
    recording, bearings = trial.recording, trial.recording.bearings
    assert bearings is not None
    again = angles_trial(2, world).recording.bearings
    assert again is not None
    np.testing.assert_array_equal(bearings.azimuth_rad, again.azimuth_rad)
    assert 2 <= len(trial.errors) <= 8
    satellites = [sensor.split(".")[0] for sensor in recording.sensor_names]
    count = np.bincount([int(satellites[row][1:]) for row in bearings.sensor])[1:]
    assert count.size == len(trial.errors)
    assert ((count >= 200) & (count <= 800)).all()
    assert np.unique(bearings.time_s).size == len(bearings)
    sensors = list(recording.sensors.values())
    seen = observe_bearings(
        trial.path,
        [sensor.trajectory for sensor in sensors],  # type: ignore[misc]
        bearings.time_s,
        bearings.sensor,
        axes=["xyz"] * len(sensors),
    )
    wrong = np.stack(
        [
            np.angle(np.exp(1j * (bearings.azimuth_rad - seen.azimuth_rad))),
            bearings.elevation_rad - seen.elevation_rad,
        ]
    )
    if world.accelerometer is None:
        # No further off than bias, drift, six sigmas of the walk and six of the noise allow.
        limit = world.bias_rad + world.drift_rad_s * world.duration_s
        limit += 6.0 * world.instability_rad_sqrt_s * np.sqrt(world.duration_s)
        assert np.abs(wrong).max() < limit + 6.0 * world.sigma_rad
        assert np.abs(wrong).max() > 0.2 * world.bias_rad
    else:
        rms = np.sqrt(np.mean(wrong**2))
        assert 0.95 * world.sigma_rad < rms < 1.2 * world.total_sigma_rad
    place = np.array(
        [sensors[s].position_at(t) for s, t in zip(bearings.sensor, bearings.time_s, strict=True)]
    )
    assert clearance_m(place, trial.path.position_at(bearings.time_s)).min() > EARTH_RADIUS_M


def test_stretches_between_calibrations_are_sensors_on_the_same_orbit() -> None:
    recording = angles_recording(3, "sprang-simple")
    bearings = recording.bearings
    assert bearings is not None
    sensors = list(recording.sensors.values())
    for satellite in {sensor.name.split(".")[0] for sensor in sensors}:
        parts = [i for i, sensor in enumerate(sensors) if sensor.name.split(".")[0] == satellite]
        spans = sorted(
            (
                bearings.time_s[bearings.sensor == i].min(),
                bearings.time_s[bearings.sensor == i].max(),
            )
            for i in parts
        )
        assert all(before[1] < after[0] for before, after in pairwise(spans))
        assert len({id(sensors[i].trajectory) for i in parts}) == 1
        assert all(sensors[i].errors.azimuth_instability_rad_sqrt_s > 0.0 for i in parts)


def test_a_trial_is_a_recording_that_reads_back(tmp_path: Path) -> None:
    recording = angles_recording(4, "levy-staged", sensors=(2, 2), bearings=(200, 200))
    gg.write(recording, tmp_path / "trial")
    back = gg.read(tmp_path / "trial")
    assert back.settings == recording.settings
    assert recording.bearings is not None
    assert back.bearings is not None
    np.testing.assert_array_equal(back.bearings.azimuth_rad, recording.bearings.azimuth_rad)


def test_options_reach_the_trial() -> None:
    trial = angles_trial(
        5, variant("levy-simple", sensors=(3, 3), busiest=0.85, outliers=7, clock_offset_s=0.05)
    )
    bearings = trial.recording.bearings
    assert bearings is not None
    assert np.mean(bearings.sensor == 0) == pytest.approx(0.85, abs=0.01)
    assert trial.outlier.sum() == 7
    late = bearings.time_s - trial.reception_time_s
    assert 0.0 < np.abs(late).max() < 0.05
    assert trial.recording.settings.loss == "auto"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: variant("levy-simple", sensors=(1, 3)), "1 sensors; expected at least 2"),
        (lambda: variant("levy-simple", bearings=(9, 3)), "bearings from 9 to 3"),
        (lambda: Stages(count=0), "0 stages"),
        (lambda: Accelerometer(resolution_rad_s2=0.0), "expected all above 0"),
    ],
)
def test_what_cannot_be_is_refused(make: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()  # type: ignore[operator]


def test_the_total_sigma_is_that_of_everything() -> None:
    world = AnglesWorld(name="x", source="x", path="simple", sigma_rad=3e-6, bias_rad=4e-6 * 3**0.5)
    assert world.total_sigma_rad == pytest.approx(5e-6)


def test_wide_errors_and_few_directions_of_all_sensors_but_one_lead_to_the_path():
    """98 % of the directions from one sensor: the plain way ends 15 000 km off."""
    trial = angles_trial(300097, variant("levy-simple", busiest=0.98))
    track = gg.smooth(trial.recording)
    truth = trial.recording.truth
    points = track.at(truth.time_s)
    error = points.position_m - truth.position_m
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 500.0
    assert track.summary["flagged_sensors"] == []
    narrow = track.problem
    assert softened(narrow, track.values, 1.0) is None
