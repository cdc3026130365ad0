"""The Cramer-Rao bound of recordings: published figures, closed forms, plans and estimates."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_recordings import write_small

import geograph as gg
from geograph.bound_grid import AT_A_SENSOR, TOO_WIDE, bound_map
from geograph.bounds import bound
from geograph.errors import InputError
from geograph.geodesy import ecef_from_geodetic
from geograph.scenarios.low_orbit import LowOrbit, low_orbit_world
from geograph.scenarios.moving_sensors import VARIANTS, recordings
from geograph.scenarios.tdoa_bound import bound_m
from geograph.signal import Signal

PUBLISHED = json.loads(
    (Path(__file__).parent / "authorities" / "time_difference_bounds.json").read_text()
)


def study(name):
    return next(iter(recordings(VARIANTS[name], [1])))


def _published():
    for nanoseconds, values in PUBLISHED["sigma_toa_ns"].items():
        for emitter, value in enumerate(values, start=1):
            yield f"emitter-{emitter}-{nanoseconds}ns", value
    for kind, table in (("position", "position_noise_m"), ("straight", "straight_m")):
        for noise, values in PUBLISHED[table].items():
            for emitter, value in enumerate(values, start=1):
                yield f"emitter-{emitter}-{kind}-{noise}m", value


@pytest.mark.parametrize(("name", "value"), list(_published()))
def test_published_bounds_of_time_differences_are_met(name, value):
    found = bound(study(name))
    assert found.evaluated_at == "truth"
    assert found.observable
    assert found.weakly_observed == []
    assert found.sigma_horizontal_m[-1] == pytest.approx(value, rel=PUBLISHED["tolerance"])


@pytest.mark.parametrize("name", list(VARIANTS))
def test_every_variant_meets_the_bound_from_plain_geometry(name):
    # The authority shares no equation: no light time, no turning of the sensors meanwhile.
    assert bound(study(name)).sigma_horizontal_m[-1] == pytest.approx(
        bound_m(VARIANTS[name]), rel=2e-3
    )


def test_frequency_differences_observe_the_velocity_that_times_do_not():
    recording = study("emitter-1-moving-60m_s")
    assert recording.arrivals is not None
    times = bound(recording)
    rows = np.arange(len(recording.arrivals))
    rows = rows[recording.arrivals.sensor[rows] != 0]
    count = rows.size
    table = gg.FrequencyDifferences(
        time_s=recording.arrivals.toa_s[rows],
        sensor=recording.arrivals.sensor[rows],
        reference=np.zeros(count, dtype=np.int64),
        fdoa_hz=np.zeros(count),
        carrier_hz=np.full(count, 10e9),
        sigma_hz=np.full(count, 0.05),
        sigma_reference_hz=np.full(count, 0.035),
        line=np.zeros(count, dtype=np.int64),
    )
    both = bound(replace(recording, frequency_differences=table))
    assert times.sigma_velocity_m_s is not None
    assert both.sigma_velocity_m_s is not None
    assert times.sigma_velocity_m_s.min() > 3.0
    assert both.sigma_velocity_m_s.max() < 0.3 * times.sigma_velocity_m_s.min()
    # Better known velocities want denser knots, so the two are compared at the sparser ones.
    dense = np.interp(times.time_s, both.time_s, both.sigma_horizontal_m)
    assert (dense < times.sigma_horizontal_m).all()


PLACES = np.array([[0.0, 0.0, 0.0], [900.0, 100.0, 20.0], [300.0, 1200.0, -30.0]])
TARGET = np.array([500.0, 400.0, 250.0])
SIGMA_RAD = 1e-3


def bearings(*, azimuth_only=False, per_sensor=4):
    """Return a table of bearings whose measured values are no more than a plan."""
    count = len(PLACES) * per_sensor
    elevation = np.full(count, np.nan if azimuth_only else 0.1)
    return gg.Bearings(
        time_s=np.repeat(np.arange(per_sensor, dtype=float), len(PLACES)),
        sensor=np.tile(np.arange(len(PLACES)), per_sensor),
        azimuth_rad=np.full(count, 0.3),
        elevation_rad=elevation,
        sigma_azimuth_rad=np.full(count, SIGMA_RAD),
        sigma_elevation_rad=np.full(count, SIGMA_RAD),
        isotropic=np.full(count, True),
        line=np.zeros(count, dtype=np.int64),
    )


def static(table=None, *, target=TARGET, errors=(), **changes):
    errors = dict(errors)
    sensors = {
        name: gg.Sensor(
            name=name, position_m=place, axes="xyz", errors=errors.get(name, gg.SensorErrors())
        )
        for name, place in zip("ABC", PLACES, strict=True)
    }
    return gg.Recording(
        name="plan",
        frame="local",
        sensors=sensors,
        bearings=bearings() if table is None else table,
        truth=gg.Truth(time_s=np.zeros(1), position_m=target[None]),
        propagation_speed_m_s=np.inf,
        settings=gg.SmoothSettings(motion="static"),
        **changes,
    )


def _by_hand(target, *, bias=0.0):
    """Return the bound of on-sky bearings, and of A's azimuth bias in the tangent plane."""
    information = np.zeros((4, 4))
    for index, place in enumerate(PLACES):
        line = target - place
        distance = np.linalg.norm(line)
        u = line / distance
        east = np.array([-u[1], u[0], 0.0]) / np.hypot(u[0], u[1])
        for direction in (east, np.cross(u, east)):
            row = np.append(direction / distance, 0.0)
            if index == 0 and direction is east:
                # An azimuth error moves the direction by cos(elevation).
                row[3] = np.hypot(u[0], u[1])
            information += 4.0 * np.outer(row, row) / SIGMA_RAD**2
    information[3, 3] += 1.0 / bias**2 if bias else 1e30
    return np.linalg.inv(information)


def test_a_planned_geometry_needs_no_measured_values():
    found = bound(static())
    assert found.evaluated_at == "truth"
    assert found.covariance[0] == pytest.approx(_by_hand(TARGET)[:3, :3], rel=1e-5)
    assert found.sigma_height_m[0] == pytest.approx(np.sqrt(found.covariance[0, 2, 2]))
    assert found.sigma_horizontal_m[0] == pytest.approx(
        np.sqrt(found.covariance[0, 0, 0] + found.covariance[0, 1, 1])
    )
    assert found.sigma_velocity_m_s is None
    assert found.process_noise_from == "as given"


def test_errors_of_the_sensors_widen_it_and_have_a_bound_of_their_own():
    errors = {"A": gg.SensorErrors(azimuth_bias_rad=2e-3)}
    found = bound(static(errors=errors.items()))
    expected = _by_hand(TARGET, bias=2e-3)
    assert found.covariance[0] == pytest.approx(expected[:3, :3], rel=1e-5)
    entry = found.sensor_bounds["A"]["azimuth_bias"]
    assert entry.sigma == pytest.approx(np.sqrt(expected[3, 3]), rel=1e-5)
    assert (entry.unit, entry.prior_sigma) == ("rad", 2e-3)


def test_measured_values_do_not_matter_at_the_truth():
    recording = static()
    turned = replace(
        recording.bearings,
        azimuth_rad=np.linspace(-3.0, 3.0, 12),
        elevation_rad=np.linspace(-1.5, 1.5, 12),
    )
    other = bound(replace(recording, bearings=turned))
    assert other.covariance == pytest.approx(bound(recording).covariance, rel=1e-9)
    arrivals = study("emitter-1-1ns")
    assert arrivals.arrivals is not None
    # Planned for the times of emission; the signals arrive 0.3 ms later.
    planned = replace(arrivals.arrivals, toa_s=2.0 * (arrivals.arrivals.emission + 1.0))
    other = bound(replace(arrivals, arrivals=planned))
    assert other.covariance == pytest.approx(bound(arrivals).covariance, rel=1e-4)


def test_refraction_is_no_part_of_a_plan():
    recording = static(bearings())
    bent = {
        name: replace(sensor, refraction="standard") for name, sensor in recording.sensors.items()
    }
    found = bound(replace(recording, sensors=bent))
    assert found.covariance == pytest.approx(bound(recording).covariance, rel=1e-9)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return gg.read(write_small(tmp_path_factory.mktemp("bound") / "small"))


@pytest.mark.parametrize("spacing", [None, 2.0])
def test_without_a_truth_it_is_the_covariance_of_the_estimate(small, spacing):
    recording = replace(small, truth=None)
    found, track = bound(recording, spacing_s=spacing), gg.smooth(recording, spacing_s=spacing)
    assert found.evaluated_at == "estimate"
    sigma = np.sqrt(np.diagonal(track.covariance, axis1=1, axis2=2))
    change = (found.covariance - track.covariance) / (sigma[:, :, None] * sigma[:, None, :])
    assert np.abs(change).max() < 1e-6
    assert found.position_m == pytest.approx(track.position_m, abs=1e-6)
    at_truth = bound(small, spacing_s=spacing)
    assert at_truth.evaluated_at == "truth"
    assert at_truth.sigma_horizontal_m == pytest.approx(found.sigma_horizontal_m, rel=0.02)


def test_a_truth_that_covers_only_a_part_is_not_used(small):
    truth = small.truth
    half = gg.Truth(time_s=truth.time_s[:5], position_m=truth.position_m[:5])
    assert bound(replace(small, truth=half)).evaluated_at == "estimate"


def test_automatic_process_noise_says_where_it_is_from(small):
    found = bound(small, process_noise="auto")
    assert found.process_noise_from == "from the changes of the true path"
    assert isinstance(found.settings.process_noise, float)
    found = bound(replace(small, truth=None), process_noise="auto")
    assert found.process_noise_from == "of greatest likelihood"


def test_outliers_of_an_estimate_are_left_out_and_counted(small):
    table = small.bearings
    azimuth = table.azimuth_rad.copy()
    azimuth[30] += 0.3
    spoilt = replace(small, truth=None, bearings=replace(table, azimuth_rad=azimuth))
    assert bound(spoilt, loss="auto").left_out == 1
    assert bound(replace(spoilt, truth=small.truth), loss="auto").left_out == 0


def test_the_time_that_all_clocks_have_in_common_is_in_the_bound(small):
    errors = gg.SensorErrors(clock_offset_s=0.02)
    sensors = {name: replace(sensor, errors=errors) for name, sensor in small.sensors.items()}
    found = bound(replace(small, sensors=sensors))
    for states in found.sensor_bounds.values():
        # Three clocks: their common time is known to prior / sqrt(3), and no better.
        assert states["clock_offset"].sigma > 0.02 / np.sqrt(3.0) * 0.999
    # The object moves at 63.4 m/s along (60, -20, 5).
    along = np.array([60.0, -20.0, 5.0]) / np.linalg.norm([60.0, -20.0, 5.0])
    middle = found.position_covariance_m2[found.time_s.size // 2]
    assert np.sqrt(along @ middle @ along) > 63.4 * 0.02 / np.sqrt(3.0)


def test_a_pass_in_low_orbit_has_a_bound_near_the_covariance_of_its_estimate():
    world = low_orbit_world(1, LowOrbit())
    found, track = bound(world.recording), gg.smooth(world.recording)
    assert found.evaluated_at == "truth"
    ratio = np.trace(found.position_covariance_m2, axis1=1, axis2=2).mean()
    ratio /= np.trace(track.position_covariance_m2, axis1=1, axis2=2).mean()
    assert ratio == pytest.approx(1.0, abs=0.01)
    geodetic = found.geodetic()
    assert geodetic is not None
    assert (geodetic[:, 2] > 100e3).all()


def test_one_sensor_that_stands_still_observes_no_distance():
    recording = static()
    only = np.flatnonzero(recording.bearings.sensor == 0)
    columns = {name: column[only] for name, column in vars(recording.bearings).items()}
    found = bound(replace(recording, bearings=gg.Bearings(**columns)))
    assert not found.observable
    # The direction, and why.
    direction, reason = found.weakly_observed
    assert "weakly determined" in direction
    assert "the distance along its line of sight is not determined" in reason


def test_a_signal_gives_the_sigmas():
    recording = study("emitter-1-1ns")
    signal = Signal(snr_db=10.0, band_hz=(0.0, 5e6), integration_s=1e-5)
    found = bound(recording, signal=signal)
    assert found.recording.arrivals is not None
    sigma = found.recording.arrivals.sigma_s
    assert sigma == pytest.approx(np.full(sigma.size, signal.arrival_sigma_s()))
    ratio = signal.arrival_sigma_s() / VARIANTS["emitter-1-1ns"].sigma_s
    assert found.sigma_horizontal_m[0] == pytest.approx(31.87 * ratio, rel=0.005)


def test_the_circle_holds_half_of_the_errors():
    # A round bound: CEP = sigma sqrt(2 ln 2). Three sensors at 120 degrees around the emitter.
    angle = np.radians([0.0, 120.0, 240.0])
    ring = np.stack([1e3 * np.cos(angle), 1e3 * np.sin(angle), np.zeros(3)], axis=1)
    recording = static(bearings(azimuth_only=True), target=np.zeros(3), constraints=FLAT)
    sensors = {
        name: replace(sensor, position_m=place)
        for (name, sensor), place in zip(recording.sensors.items(), ring, strict=True)
    }
    found = bound(replace(recording, sensors=sensors))
    # Information of each azimuth: 1 / (r sigma)^2 across its line; 12 of them, half in each axis.
    sigma = 1e3 * SIGMA_RAD / np.sqrt(6.0)
    assert found.sigma_axes_m[0, :2] == pytest.approx([sigma, sigma], rel=1e-6)
    assert found.cep_m()[0] == pytest.approx(sigma * np.sqrt(2.0 * np.log(2.0)), rel=1e-6)


FLAT = gg.Constraints(
    time_s=np.array([np.nan]),
    kind=("altitude_m",),
    value=np.zeros(1),
    sigma=np.full(1, 0.1),
    line=np.zeros(1, dtype=np.int64),
)


def test_every_cell_of_a_map_is_the_bound_of_an_emitter_there():
    errors = {"A": gg.SensorErrors(azimuth_bias_rad=2e-3)}
    recording = static(errors=errors.items())
    rows = []
    found = bound_map(recording, extent_m=1500.0, cells=5, on_row=lambda: rows.append(1))
    assert len(rows) == 5
    assert found.center_m == pytest.approx(TARGET)
    assert found.east_m == pytest.approx(500.0 + np.array([-600.0, -300.0, 0.0, 300.0, 600.0]))
    assert found.observable.all()
    for index in ((0, 0), (1, 3), (2, 2), (4, 1)):
        place = found.position_m[index]
        assert place == pytest.approx([found.east_m[index[1]], found.north_m[index[0]], 250.0])
        truth = gg.Truth(time_s=np.zeros(1), position_m=place[None])
        one = bound(replace(recording, truth=truth))
        assert found.covariance_m2[index] == pytest.approx(one.covariance[0, :2, :2], rel=1e-6)
        axes = one.horizontal_ellipses(0.95).semi_axes_m[0]
        assert found.semi_axes_m[index] == pytest.approx(axes, rel=1e-6)


def test_a_map_of_arrivals_meets_the_published_bound_in_its_middle():
    found = bound_map(study("emitter-2-1ns"), cells=3)
    assert found.sigma_horizontal_m[1, 1] == pytest.approx(41.19, rel=0.005)
    # By itself the map holds sensors and emitter.
    for way in found.sensor_plane_m().values():
        assert np.abs(way - found.center_m[:2]).max() < 1.5 * (found.east_m[1] - found.east_m[0])


def test_a_map_says_where_and_why_nothing_is_observed():
    # Two azimuths and a known height: nothing on the line through both sensors.
    table = bearings(azimuth_only=True)
    two = np.flatnonzero(table.sensor != 2)
    columns = {name: column[two] for name, column in vars(table).items()}
    recording = static(gg.Bearings(**columns), target=np.zeros(3), constraints=FLAT)
    sensors = {
        name: replace(sensor, position_m=np.array([x, 0.0, 0.0]))
        for (name, sensor), x in zip(recording.sensors.items(), (-400.0, 400.0, 0.0), strict=True)
    }
    found = bound_map(replace(recording, sensors=sensors), extent_m=1400.0, cells=7)
    assert found.north_m[3] == pytest.approx(0.0)
    assert found.reason[3].tolist() == [
        TOO_WIDE, AT_A_SENSOR, TOO_WIDE, TOO_WIDE, TOO_WIDE, AT_A_SENSOR, TOO_WIDE,
    ]  # fmt: skip
    assert np.isinf(found.sigma_horizontal_m[3]).all()
    assert np.isinf(found.semi_axes_m[3]).all()
    assert found.observable[[0, 1, 5, 6]].all()
    assert np.isfinite(found.sigma_horizontal_m[[0, 1, 5, 6]]).all()


def test_a_map_on_the_earth_keeps_its_height():
    places = ecef_from_geodetic([51.0, 51.4, 51.2], [-1.0, -0.8, -1.5], [50.0, 90.0, 120.0])
    target = ecef_from_geodetic(51.3, -1.1, 9000.0)
    recording = _on_earth(places, target)
    found = bound_map(recording, extent_m=80e3, cells=5)
    geodetic = found.geodetic()
    assert geodetic is not None
    assert geodetic[..., 2] == pytest.approx(np.full((5, 5), 9000.0), abs=1e-3)
    assert found.position_m[2, 2] == pytest.approx(target, abs=1e-3)
    # Rows go north, columns east.
    assert (np.diff(geodetic[..., 0], axis=0) > 0.0).all()
    assert (np.diff(geodetic[..., 1], axis=1) > 0.0).all()
    one = bound(recording)
    assert found.sigma_horizontal_m[2, 2] == pytest.approx(one.sigma_horizontal_m[0], rel=1e-6)


def _on_earth(places, target):
    recording = static()
    return gg.Recording(
        name="earth",
        frame="ecef",
        epoch=low_orbit_world(1, LowOrbit()).recording.epoch,
        sensors={
            name: gg.Sensor(name=name, position_m=place)
            for name, place in zip("ABC", places, strict=True)
        },
        bearings=recording.bearings,
        truth=gg.Truth(time_s=np.zeros(1), position_m=target[None]),
        settings=recording.settings,
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cells": 1}, "cells is 1; expected 2 to 1000 along a side"),
        ({"extent_m": 0.0}, "extent_m is 0.0; expected a finite number above 0"),
        ({"center_m": [1.0, 2.0]}, "expected three finite coordinates"),
        ({"center_m": [1.0, np.nan, 0.0]}, "expected three finite coordinates"),
    ],
)
def test_what_is_not_a_map_is_refused(changes, message):
    with pytest.raises(InputError, match=message):
        bound_map(static(), **changes)


def test_a_recording_without_measurements_has_no_bound():
    with pytest.raises(InputError, match="has no measurement"):
        bound(replace(static(), bearings=None))
