"""Whole worlds: reproducible, as promised, and consistent with what they say they hide."""

import numpy as np
import pytest
from scipy.stats import chi2

from geograph.constants import EARTH_RADIUS_M, EARTH_ROTATION_RAD_S, SPEED_OF_LIGHT_M_S
from geograph.scenarios import (
    GroundPass,
    LowOrbit,
    Room,
    ground_pass,
    ground_world,
    low_orbit_pass,
    low_orbit_world,
    observe_bearings,
    room,
    room_world,
)
from geograph.scenarios.orbits import turned_about_z
from geograph.scenarios.places import clearance_m

PATHS = ["prior", "prior-ballistic", "two-body", "j2"]
PLATFORMS = ["satellite", "ground", "mixed"]


def columns(recording):
    b, truth = recording.bearings, recording.truth
    found = [
        *(b.time_s, b.sensor, b.azimuth_rad, b.elevation_rad, b.sigma_azimuth_rad, b.isotropic),
        *(truth.time_s, truth.position_m),
    ]
    for sensor in recording.sensors.values():
        if sensor.trajectory is None:
            found.append(sensor.position_m)
        else:
            found += [sensor.trajectory.time_s, sensor.trajectory.position_m]
    return found


def observed_by_the_recording(world):
    """Error-free bearings of the true path from the sensors as the recording has them."""
    recording = world.recording
    return observe_bearings(
        world.path,
        list(recording.sensors.values()),
        world.reception_time_s,
        recording.bearings.sensor,
        axes=[sensor.axes for sensor in recording.sensors.values()],
        frame=recording.frame,
        propagation_speed_m_s=recording.propagation_speed_m_s,
    )


def wrapped(angle):
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


@pytest.mark.parametrize(
    "make", [low_orbit_pass, ground_pass, room], ids=["low_orbit", "ground", "room"]
)
def test_a_seed_gives_one_recording_bit_for_bit(make):
    first, again, other = columns(make(3)), columns(make(3)), columns(make(4))
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, two)
    assert not np.array_equal(first[2], other[2])


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("platform", PLATFORMS)
def test_low_orbit_pass_is_as_promised(path, platform):
    world = low_orbit_world(7, LowOrbit(path=path, platform=platform, bearings=40))
    recording = world.recording
    b = recording.bearings
    assert len(b) == 200
    assert np.bincount(b.sensor).tolist() == [40] * 5
    assert (np.diff(b.time_s) > 0.0).all()
    assert b.isotropic.all()
    assert not world.outlier.any()
    np.testing.assert_array_equal(b.time_s, world.reception_time_s)
    axes = {"satellite": "xxxxx", "ground": "eeeee", "mixed": "xexex"}[platform]
    assert "".join(s.axes[0] for s in recording.sensors.values()) == axes
    assert recording.settings.motion == (
        "constant-acceleration" if path == "prior" else "ballistic"
    )
    assert recording.settings.loss == "none"
    for sensor in recording.sensors.values():
        assert sensor.errors.azimuth_bias_rad == sensor.errors.elevation_bias_rad == 500e-6
        assert sensor.errors.elevation_drift_rad_s == 0.1e-6
        assert sensor.errors.azimuth_instability_rad_sqrt_s == 0.1e-6


@pytest.mark.parametrize("seed", range(4))
def test_lines_of_sight_are_free(seed):
    world = low_orbit_world(seed, LowOrbit(platform="mixed"))
    time = np.linspace(0.0, 200.0, 1001)
    target = world.path.position_at(time)
    for sensor in world.recording.sensors.values():
        if sensor.axes == "xyz":
            clear = clearance_m(sensor.position_at(time), target)
            assert clear.min() > EARTH_RADIUS_M + 99e3
        else:
            rows = world.recording.bearings.elevation_rad[
                world.recording.bearings.sensor == world.recording.sensor_names.index(sensor.name)
            ]
            assert np.degrees(rows.min()) > 9.5


def test_clearance_of_lines_by_hand():
    first = np.array([[1.0, 2.0, 0.0], [1.0, 2.0, 0.0], [3.0, 4.0, 0.0]])
    second = np.array([[1.0, -2.0, 0.0], [1.0, 1.0, 0.0], [6.0, 8.0, 0.0]])
    np.testing.assert_allclose(clearance_m(first, second), [1.0, np.sqrt(2.0), 5.0])


@pytest.mark.parametrize("path", PATHS)
def test_truth_is_the_path_with_its_velocity(path):
    world = low_orbit_world(5, LowOrbit(path=path))
    truth = world.recording.truth
    np.testing.assert_array_equal(truth.position_m, world.path.position_at(truth.time_s))
    inside = truth.time_s[1:-1]
    slope = (world.path.position_at(inside + 0.01) - world.path.position_at(inside - 0.01)) / 0.02
    # White noise on the acceleration leaves a central difference off by a few centimetres a second.
    np.testing.assert_allclose(truth.velocity_m_s[1:-1], slope, atol=0.05)
    start, end = world.recording.time_span_s
    assert truth.time_s[0] < start
    assert truth.time_s[-1] > end


@pytest.mark.parametrize("path", PATHS)
def test_objects_are_in_low_orbit(path):
    truth = low_orbit_pass(6, path=path).truth
    height = np.linalg.norm(truth.position_m, axis=-1) - EARTH_RADIUS_M
    assert 200e3 < height.min() < height.max() < 1500e3
    speed = np.linalg.norm(truth.velocity_m_s, axis=-1)
    assert 6.3e3 < speed.min() < speed.max() < 8.5e3


@pytest.mark.parametrize("platform", ["satellite", "mixed"])
@pytest.mark.parametrize("clock", [0.0, 5.0])
def test_splines_of_sensor_tables_are_good_to_a_tenth_of_a_millimetre(platform, clock):
    world = low_orbit_world(2, LowOrbit(platform=platform, clock_offset_s=clock))
    for sensor in world.recording.sensors.values():
        if sensor.trajectory is None:
            continue
        table = sensor.trajectory
        assert table.time_s[0] <= world.recording.time_span_s[0] - 10.0 * clock
        # A circular orbit in inertial axes, through three points of the table itself.
        inertial = turned_about_z(table.position_m, EARTH_ROTATION_RAD_S * table.time_s)
        normal = np.cross(inertial[0], inertial[-1])
        normal /= np.linalg.norm(normal)
        first = inertial[0] / np.linalg.norm(inertial[0])
        second = np.cross(normal, first)
        phase = np.unwrap(np.arctan2(inertial @ second, inertial @ first))
        rate = (phase[-1] - phase[0]) / (table.time_s[-1] - table.time_s[0])
        asked = np.random.default_rng(0).uniform(table.time_s[0], table.time_s[-1], 2000)
        turn = (rate * (asked - table.time_s[0]))[:, None]
        radius = np.linalg.norm(inertial[0])
        orbit = radius * (np.cos(turn) * first + np.sin(turn) * second)
        miss = sensor.position_at(asked) - turned_about_z(orbit, -EARTH_ROTATION_RAD_S * asked)
        assert np.abs(miss).max() < 1e-4


@pytest.mark.parametrize("platform", PLATFORMS)
@pytest.mark.parametrize("draw", ["normal", "uniform"])
def test_bearings_are_off_by_what_the_world_says(platform, draw):
    sigma = 50e-6
    world = low_orbit_world(11, LowOrbit(platform=platform, draw=draw, instability_rad_sqrt_s=0.0))
    seen, b = observed_by_the_recording(world), world.recording.bearings
    elapsed = world.reception_time_s - world.reception_time_s.min()
    statistic = 0.0
    for index, name in enumerate(world.recording.sensor_names):
        rows, wrong = b.sensor == index, world.errors[name]
        assert wrong.azimuth_bias_rad != 0.0
        azimuth = wrapped(b.azimuth_rad - seen.azimuth_rad)[rows]
        elevation = (b.elevation_rad - seen.elevation_rad)[rows]
        azimuth -= wrong.azimuth_bias_rad + wrong.azimuth_drift_rad_s * elapsed[rows]
        elevation -= wrong.elevation_bias_rad + wrong.elevation_drift_rad_s * elapsed[rows]
        level = np.cos(b.elevation_rad[rows])
        statistic += np.sum((azimuth * level / sigma) ** 2 + (elevation / sigma) ** 2)
    low, high = chi2.ppf([5e-7, 1.0 - 5e-7], 2 * len(b))
    assert low < statistic < high


def test_per_coordinate_noise():
    world = low_orbit_world(
        12,
        LowOrbit(
            per_coordinate=True,
            bias_rad=0.0,
            drift_rad_s=0.0,
            instability_rad_sqrt_s=0.0,
            sigma_rad=1e-4,
        ),
    )
    seen, b = observed_by_the_recording(world), world.recording.bearings
    assert not b.isotropic.any()
    for error in (wrapped(b.azimuth_rad - seen.azimuth_rad), b.elevation_rad - seen.elevation_rad):
        low, high = chi2.ppf([5e-7, 1.0 - 5e-7], len(b))
        assert low < np.sum((error / 1e-4) ** 2) < high


def test_walks_make_errors_that_grow():
    quiet = low_orbit_world(13, LowOrbit(instability_rad_sqrt_s=0.0))
    walking = low_orbit_world(13, LowOrbit(instability_rad_sqrt_s=1e-5))
    difference = walking.recording.bearings.elevation_rad - quiet.recording.bearings.elevation_rad
    time = quiet.reception_time_s
    assert np.std(difference[time < 10.0]) < 1e-5 * np.sqrt(10.0)
    assert 3e-5 < np.std(difference[time > 150.0]) < 1e-3


def test_clock_errors_shift_time_tags_alone():
    kind = LowOrbit(clock_offset_s=2.0, clock_drift_s_s=1e-3, bearings=50)
    world = low_orbit_world(14, kind)
    tag, true = world.recording.bearings.time_s, world.reception_time_s
    assert (np.diff(tag) >= 0.0).all()
    for index, name in enumerate(world.recording.sensor_names):
        rows, wrong = world.recording.bearings.sensor == index, world.errors[name]
        expected = wrong.clock_offset_s + wrong.clock_drift_s_s * (true - true.min())
        assert abs(wrong.clock_offset_s) > 1e-3
        np.testing.assert_allclose((tag - true)[rows], expected[rows], atol=1e-12)
    assert world.recording.truth.time_s[0] < tag.min()
    assert world.recording.truth.time_s[-1] > tag.max()
    without = low_orbit_world(14, LowOrbit(clock_offset_s=0.0, bearings=50))
    np.testing.assert_array_equal(np.sort(true), np.sort(without.reception_time_s))


@pytest.mark.parametrize("offset", [None, np.radians(5.0)])
def test_outliers_are_those_of_one_sensor_and_change_nothing_else(offset):
    clean = low_orbit_world(15, LowOrbit())
    dirty = low_orbit_world(15, LowOrbit(outliers=20, outlier_rad=offset))
    assert dirty.outlier.sum() == 20
    assert set(dirty.recording.bearings.sensor[dirty.outlier]) == {0}
    assert dirty.recording.settings.loss == "auto"
    one, two = clean.recording.bearings, dirty.recording.bearings
    np.testing.assert_array_equal(one.azimuth_rad[~dirty.outlier], two.azimuth_rad[~dirty.outlier])
    assert (one.elevation_rad[dirty.outlier] != two.elevation_rad[dirty.outlier]).all()


def test_emission_times_belong_to_the_light_time():
    world = low_orbit_world(16, LowOrbit(bearings=20))
    delay = world.reception_time_s - world.emission_time_s
    assert (delay > 100e3 / SPEED_OF_LIGHT_M_S).all()
    assert (delay < 9e6 / SPEED_OF_LIGHT_M_S).all()


def test_large_biases_and_two_sensors():
    world = low_orbit_world(17, LowOrbit(bias_rad=40e-3, sensors=2))
    assert len(world.recording.sensors) == 2
    assert max(abs(e.azimuth_bias_rad) for e in world.errors.values()) > 5e-3
    assert (np.abs(world.recording.bearings.elevation_rad) <= np.pi / 2).all()


def test_uniform_limits_become_sigmas():
    world = low_orbit_world(18, LowOrbit(draw="uniform"))
    for sensor in world.recording.sensors.values():
        assert sensor.errors.azimuth_bias_rad == pytest.approx(500e-6 / np.sqrt(3.0))
        assert abs(world.errors[sensor.name].azimuth_bias_rad) < 500e-6


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        (LowOrbit, {"path": "lunar"}, "path 'lunar'; expected one of"),
        (LowOrbit, {"platform": "ship"}, "platform 'ship'; expected one of"),
        (GroundPass, {"target": "duck"}, "target 'duck'; expected one of"),
        (GroundPass, {"path": "bent"}, "path 'bent'; expected one of"),
        (Room, {"order": 4}, "order 4; expected 1, 2 or 3"),
        (Room, {"sensors": 1}, "1 sensors; expected 2 to 5"),
    ],
)
def test_unknown_options_are_refused(kind, options, message):
    with pytest.raises(ValueError, match=message):
        kind(**options)


def test_more_outliers_than_bearings_are_refused():
    with pytest.raises(ValueError, match="30 outliers of 20 measurements"):
        low_orbit_pass(0, bearings=20, outliers=30)


@pytest.mark.parametrize("target", ["fireball", "aircraft"])
@pytest.mark.parametrize("path", ["straight", "prior"])
@pytest.mark.parametrize("stations", [3, 5])
def test_ground_pass(target, path, stations):
    world = ground_world(20, GroundPass(target=target, path=path, stations=stations))
    recording = world.recording
    b, seen = recording.bearings, observed_by_the_recording(world)
    assert np.degrees(b.elevation_rad.min()) > 5.0
    names = recording.sensor_names
    assert recording.sensors[names[0]].errors.clock_offset_s == 0.0
    assert recording.sensors[names[1]].errors.clock_offset_s == 1.0
    assert world.errors[names[0]].clock_offset_s == 0.0
    statistic = 0.0
    for index, name in enumerate(names):
        rows, wrong = b.sensor == index, world.errors[name]
        shift = (b.time_s - world.reception_time_s)[rows]
        np.testing.assert_allclose(shift, wrong.clock_offset_s, atol=1e-12)
        level = np.cos(b.elevation_rad[rows])
        azimuth = wrapped(b.azimuth_rad - seen.azimuth_rad)[rows] - wrong.azimuth_bias_rad
        elevation = (b.elevation_rad - seen.elevation_rad)[rows] - wrong.elevation_bias_rad
        statistic += np.sum((azimuth * level / 3e-4) ** 2 + (elevation / 3e-4) ** 2)
    low, high = chi2.ppf([5e-7, 1.0 - 5e-7], 2 * len(b))
    assert low < statistic < high
    speed = np.linalg.norm(recording.truth.velocity_m_s, axis=-1)
    assert speed.min() > (5e3 if target == "fireball" else 50.0)


def test_a_straight_pass_is_straight():
    truth = ground_pass(21, path="straight").truth
    assert np.ptp(truth.velocity_m_s, axis=0).max() == 0.0
    assert np.linalg.norm(truth.velocity_m_s[0]) == pytest.approx(14e3, rel=1e-9)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_room_has_light_times_that_matter(order):
    world = room_world(22, Room(order=order))
    recording = world.recording
    assert recording.frame == "local"
    assert recording.epoch is None
    assert (recording.truth.velocity_m_s is None) == (order == 1)
    delay = world.reception_time_s - world.emission_time_s
    assert delay.max() > 0.1
    # The equation of the light time, in a frame that does not turn.
    b = recording.bearings
    places = np.stack([s.position_m for s in recording.sensors.values()])[b.sensor]
    distance = np.linalg.norm(world.path.position_at(world.emission_time_s) - places, axis=-1)
    np.testing.assert_allclose(distance, 343.0 * delay, rtol=1e-9)
    if order == 2:
        still = observe_bearings(
            world.path,
            list(recording.sensors.values()),
            world.reception_time_s,
            b.sensor,
            axes=["xyz"] * 4,
            frame="local",
            propagation_speed_m_s=np.inf,
        )
        seen = observed_by_the_recording(world)
        moved = wrapped(still.azimuth_rad - seen.azimuth_rad)
        assert np.abs(moved).max() > 3.0 * b.sigma_azimuth_rad[0]
