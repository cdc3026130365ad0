"""Body axes: attitude, its interpolation, misalignment, and worlds made from geometry alone."""

from dataclasses import replace

import numpy as np
import pytest
from differences import assert_derivative, derivative
from hypothesis import given, settings
from hypothesis import strategies as st
from made_flight import circle, measured, seen, straight
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import geograph as gg
from geograph.errors import InputError
from geograph.factors.attitude import body_axes, misaligned, ned_from_body
from geograph.frames import SensorGeometry
from geograph.geodesy import ecef_from_geodetic
from geograph.measurements import Constraints
from geograph.sensors import Sensor, SensorErrors, Trajectory

PROFILE = settings(max_examples=60, deadline=None, derandomize=True)
angle = st.floats(-np.pi, np.pi)
pitches = st.floats(-np.pi / 2, np.pi / 2) | st.sampled_from([np.pi / 2, -np.pi / 2])
seeds = st.integers(0, 2**32 - 1)
SIGMA = np.radians(0.5)
EMITTER = np.array([1800.0, 2600.0, 0.0])


@PROFILE
@given(st.tuples(angle, pitches, angle))
def test_attitude_is_the_aerospace_sequence(attitude):
    expected = Rotation.from_euler("ZYX", attitude).as_matrix()
    np.testing.assert_allclose(ned_from_body(attitude), expected, atol=1e-15)


def test_rows_of_body_axes_are_forward_right_and_up():
    level = body_axes(ned_from_body([0.0, 0.0, 0.0]), np.eye(3))
    np.testing.assert_array_equal(level, np.eye(3))
    # North, east, up as the frame. Heading east: forward is east, right is south.
    east = body_axes(ned_from_body([np.pi / 2, 0.0, 0.0]), np.eye(3))
    np.testing.assert_allclose(east, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-15)
    # Nose straight up: forward is up, "above" is behind.
    climb = body_axes(ned_from_body([0.0, np.pi / 2, 0.0]), np.eye(3))
    np.testing.assert_allclose(climb, [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], atol=1e-15)
    # Right wing down: the right points down.
    banked = body_axes(ned_from_body([0.0, 0.0, np.pi / 2]), np.eye(3))
    np.testing.assert_allclose(banked, [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-15)


@PROFILE
@given(seeds, st.sampled_from([0.0, 1e-9, 1e-3, 0.0099, 0.0101, 0.3, 2.0]), st.booleans())
def test_misalignment_derivatives(seed, size, nadir):
    rng = np.random.default_rng(seed)
    line = np.array([0.0, 0.0, -700.0]) + rng.normal(size=3) * (1e-6 if nadir else 300.0)
    angles = rng.normal(size=3)
    angles *= size / np.linalg.norm(angles)
    found = misaligned(line[None], angles[None], jacobian=True)

    def value(at):
        return misaligned(at[None, :3], at[None, 3:]).line_of_sight_m

    both = np.concatenate([found.by_line_of_sight[0], found.by_misalignment[0]], axis=1)
    point = np.concatenate([line, angles])
    assert_derivative(both, value, point, [1.0] * 3 + [1e-3] * 3, rtol=1e-9)
    # The true axes are the recorded ones turned, in scipy's words.
    turned = Rotation.from_rotvec(angles).inv().apply(line * [1, 1, -1]) * [1, 1, -1]
    np.testing.assert_allclose(found.line_of_sight_m[0], turned, atol=1e-9)


def pose(frame, place, attitude_deg, **options):
    sensor = Sensor(
        name="A", position_m=place, axes="body", attitude_rad=np.radians(attitude_deg), **options
    )
    return SensorGeometry([sensor], frame).poses(np.array([0]), np.array([0.0])).axes[0]


def test_fixed_sensors_in_both_frames():
    np.testing.assert_allclose(
        pose("local", np.zeros(3), [90.0, 0.0, 0.0]), [[1, 0, 0], [0, -1, 0], [0, 0, 1]], atol=1e-15
    )
    place = ecef_from_geodetic(45.0, 0.0, 0.0)
    north = pose("ecef", place, [0.0, 0.0, 0.0])
    np.testing.assert_allclose(north[0], [-(0.5**0.5), 0.0, 0.5**0.5], atol=1e-15)
    np.testing.assert_allclose(north[1], [0.0, 1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(north[2], [0.5**0.5, 0.0, 0.5**0.5], atol=1e-15)


def turning(frame, seed):
    """A sensor that turns in every way, through straight up, while it moves."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, 20.0, 81)
    motion = np.outer(time, [150.0, 80.0, 5.0]) + 30.0 * np.sin(time[:, None] * [0.2, 0.3, 0.4])
    base = ecef_from_geodetic(60.0, 20.0, 1000.0) if frame == "ecef" else np.zeros(3)
    attitude = np.stack([0.2 * time, 0.1 * time, 0.5 * np.sin(rng.uniform(0.3, 0.6) * time)], 1)
    sensor = Sensor(name="A", trajectory=Trajectory(time, base + motion, attitude), axes="body")
    return SensorGeometry([sensor], frame), attitude, time


@pytest.mark.parametrize("frame", ["local", "ecef"])
def test_axes_follow_the_samples_and_their_rate_is_their_derivative(frame):
    geometry, attitude, time = turning(frame, 1)
    index = np.zeros(time.size, dtype=np.int64)
    found = geometry.poses(index, time)
    level = geometry._enu(found.position_m)
    np.testing.assert_allclose(found.axes, body_axes(ned_from_body(attitude), level), atol=1e-12)
    # Pitch runs through 90 degrees at 15.7 s: nothing happens there.
    at = np.array([1.3, 7.77, 15.70, 15.71, 19.0])
    own = np.zeros(5, dtype=np.int64)

    def axes(shift):
        return geometry.poses(own, at + shift[0]).axes

    rate = geometry.poses(own, at).axes_rate
    np.testing.assert_allclose(rate.ravel(), derivative(axes, [0.0], [0.01])[:, 0], atol=1e-8)
    np.testing.assert_allclose(
        axes([0.0]) @ np.swapaxes(axes([0.0]), 1, 2), np.tile(np.eye(3), (5, 1, 1)), atol=1e-14
    )


def test_attitude_between_samples_wraps_and_is_accurate():
    # Yaw through 360 degrees, one sample a second, against what it was between them.
    time = np.arange(0.0, 61.0)

    def true(t):
        return np.stack(
            [np.radians(350.0) + 0.05 * t, 0.1 * np.sin(0.3 * t), 0.2 * np.cos(0.2 * t)], 1
        )

    wrapped = np.mod(true(time), 2.0 * np.pi)
    path = Trajectory(time, np.outer(time, [1.0, 0.0, 0.0]), wrapped)
    geometry = SensorGeometry([Sensor(name="A", trajectory=path, axes="body")], "local")
    at = np.linspace(5.0, 55.0, 333)
    axes = geometry.poses(np.zeros(at.size, dtype=np.int64), at).axes
    level = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    expected = body_axes(ned_from_body(true(at)), level)
    assert np.abs(axes - expected).max() < 2e-5


def recording(flights, bearings, *, misalignment_deg=0.0, height=None, **settings_):
    errors = SensorErrors(misalignment_rad=np.radians(misalignment_deg))
    sensors = {
        f"A{index}": Sensor(
            name=f"A{index}", trajectory=flight.trajectory(), axes="body", errors=errors
        )
        for index, flight in enumerate(flights)
    }
    known = None
    if height is not None:
        known = Constraints(
            time_s=np.array([np.nan]),
            kind=("altitude_m",),
            value=np.array([height]),
            sigma=np.array([1.0]),
            line=np.array([2]),
        )
    return gg.Recording(
        name="flight", frame="local", sensors=sensors, bearings=bearings, constraints=known,
        settings=gg.SmoothSettings(motion="static", loss="none", **settings_),
    )  # fmt: skip


def test_an_emitter_is_found_in_body_axes_with_honest_covariance():
    # 30 draws: NEES adds up to chi-square with 90 degrees; false alarms once in 1000.
    rng = np.random.default_rng(20)
    flights = [straight([0.0, 0.0, 1000.0], 20.0, 60.0, 30.0, rate=2.0)]
    total = 0.0
    for _ in range(30):
        track = gg.smooth(recording(flights, measured(flights, EMITTER, SIGMA, rng)))
        error = track.position_m[0] - EMITTER
        total += error @ np.linalg.solve(track.position_covariance_m2[0], error)
    assert chi2.ppf(0.0005, 90) < total < chi2.ppf(0.9995, 90)


@pytest.mark.parametrize("on_sky", [True, False])
def test_an_emitter_straight_below_is_found(on_sky):
    # The aircraft flies over it: bearings pass the nadir of the body axes. Noise of coordinates
    # would fold at the nadir itself, and passes it by a few sigmas.
    rng = np.random.default_rng(3)
    emitter = np.array([0.0 if on_sky else 60.0, 1000.0, 0.0])
    flights = [straight([0.0, 0.0, 800.0], 0.0, 50.0, 40.0, pitch_deg=0.0, rate=5.0)]
    assert np.degrees(seen(flights[0], emitter)[1].min()) < (-89.9 if on_sky else -85.0)
    bearings = measured(flights, emitter, np.radians(1.0), rng, on_sky=on_sky)
    track = gg.smooth(recording(flights, bearings))
    error = track.position_m[0] - emitter
    square = error @ np.linalg.solve(track.position_covariance_m2[0], error)
    assert square < chi2.isf(1e-3, 3)
    assert track.summary["iterations"] < 30


MISALIGNED = np.radians([2.0, -1.5, 1.0])


def test_misalignment_of_two_degrees_is_found_in_a_turn():
    rng = np.random.default_rng(5)
    flights = [circle([1000.0, 1500.0, 900.0], 900.0, 60.0, 120.0, rate=3.0)]
    bearings = measured(flights, EMITTER, 0.6 * SIGMA, rng, misalignment_rad=MISALIGNED)
    track = gg.smooth(recording(flights, bearings, misalignment_deg=3.0, height=0.0))
    errors = track.sensor_errors["A0"]
    for axis, truth in zip("xyz", MISALIGNED, strict=True):
        entry = errors[f"misalignment_{axis}"]
        assert entry.unit == "rad"
        assert entry.sigma < 0.1 * entry.prior_sigma
        assert abs(entry.estimate - truth) < 3.9 * entry.sigma
    assert not [s for s in track.summary["weakly_observed"] if "misalignment" in s]
    error = track.position_m[0] - EMITTER
    square = error @ np.linalg.solve(track.position_covariance_m2[0], error)
    assert square < chi2.isf(1e-3, 3)
    # Taken as aligned, the emitter would be tens of sigmas away.
    blind = gg.smooth(recording(flights, bearings, height=0.0))
    error = blind.position_m[0] - EMITTER
    assert error @ np.linalg.solve(blind.position_covariance_m2[0], error) > 100.0
    assert "misalignment" in " ".join(blind.summary["flagged_sensors"])


def test_misalignment_about_a_straight_flight_is_named():
    # Turning everything about the line of flight changes no bearing: the emitter's height, and the
    # misalignment about the axis forward, cannot be told apart.
    rng = np.random.default_rng(6)
    flights = [straight([0.0, 0.0, 1000.0], 30.0, 60.0, 60.0, pitch_deg=0.0, rate=3.0)]
    bearings = measured(flights, EMITTER, SIGMA, rng, misalignment_rad=MISALIGNED)
    track = gg.smooth(recording(flights, bearings, misalignment_deg=3.0), raise_on_failure=False)
    named = [s for s in track.summary["weakly_observed"] if "misalignment of A0" in s]
    assert len(named) == 1
    assert "about body x (roll) is not determined: its 1-sigma stays at" in named[0]
    entry = track.sensor_errors["A0"]["misalignment_x"]
    assert entry.sigma > 0.8 * entry.prior_sigma
    error = track.position_m[0] - EMITTER
    square = error @ np.linalg.solve(track.position_covariance_m2[0], error)
    assert square < chi2.isf(1e-3, 3)


def wrong_unit(flight, factor):
    return replace(flight, attitude_rad=flight.attitude_rad * factor)


@pytest.mark.parametrize(
    ("flight", "message"),
    [
        (
            wrong_unit(straight([0, 0, 900.0], 70.0, 50.0, 10.0), np.pi / 180.0),
            r"'A0': yaw follows the course over ground as radians and not as the unit of its",
        ),
        (
            wrong_unit(straight([0, 0, 900.0], 70.0, 50.0, 10.0), 180.0 / np.pi),
            r"yaw follows the course over ground as degrees and not",
        ),
        (
            wrong_unit(circle([0, 0, 900.0], 500.0, 50.0, 60.0), 180.0 / np.pi),
            r"mixed up\? mend the column's unit, or set unusual_attitude = true",
        ),
        (
            replace(
                straight([0, 0, 900.0], 70.0, 50.0, 10.0),
                attitude_rad=np.outer(np.arange(101), [1.0, 0.0, 0.0]),
            ),
            r"the attitude turns at \d+.* deg/s all the time",
        ),
        (
            replace(
                straight([0, 0, 900.0], 70.0, 50.0, 100.0, rate=0.1),
                attitude_rad=np.outer(np.arange(11), [2.0, 0.0, 0.0]),
            ),
            r"the attitude turns by 114.6 deg from one row to the next, too far",
        ),
    ],
)
def test_implausible_attitudes_are_questioned(flight, message):
    rng = np.random.default_rng(0)
    given_ = recording([flight], measured([flight], EMITTER, SIGMA, rng))
    with pytest.raises(InputError, match=message):
        gg.smooth(given_)
    sensor = replace(given_.sensors["A0"], unusual_attitude=True)
    told = replace(given_, sensors={"A0": sensor})
    assert gg.smooth(told, raise_on_failure=False).status


@pytest.mark.parametrize("course", [0.0, 90.0, 200.0])
def test_ordinary_attitudes_are_not_questioned(course):
    from geograph.attitude import attitude_question

    assert attitude_question(straight([0, 0, 9e2], course, 50.0, 9.0).trajectory(), "local") is None
    assert attitude_question(circle([0, 0, 9e2], 300.0, 50.0, 60.0).trajectory(), "local") is None


def test_bad_sensors_are_refused():
    path = Trajectory(np.array([0.0, 1.0]), np.zeros((2, 3)))
    with pytest.raises(InputError, match="axes body and no attitudes in its trajectory; expected"):
        Sensor(name="A", trajectory=path, axes="body")
    with pytest.raises(InputError, match="axes body and no attitude; expected yaw, pitch and roll"):
        Sensor(name="A", position_m=np.zeros(3), axes="body")
    with pytest.raises(InputError, match="has a misalignment and axes 'enu'"):
        Sensor(name="A", position_m=np.zeros(3), errors=SensorErrors(misalignment_rad=0.1))
    with pytest.raises(InputError, match="three finite angles as attitude"):
        Sensor(name="A", position_m=np.zeros(3), axes="body", attitude_rad=np.array([0, 1, np.nan]))
    with pytest.raises(InputError, match="attitude that is not finite"):
        Trajectory(np.array([0.0, 1.0]), np.zeros((2, 3)), np.full((2, 3), np.inf))


def test_misalignment_about_a_known_axis_in_the_plain_graph():
    rng = np.random.default_rng(5)
    flights = [circle([1000.0, 1500.0, 900.0], 900.0, 60.0, 60.0, rate=1.0)]
    bearings = measured(flights, EMITTER, SIGMA, rng, misalignment_rad=MISALIGNED)
    given_ = recording(flights, bearings, misalignment_deg=3.0, height=0.0)
    track = gg.smooth(given_)
    built = gg.build(given_)
    at = built.encode(track.values)
    gradient = built.graph.linearize(at).gradientAtZero()
    assert max(np.abs(gradient.at(key)).max() for key in at.keys()) < 1e-3  # noqa: SIM118
    assert built.graph.error(at) == pytest.approx(track.summary["cost"], rel=1e-6)
