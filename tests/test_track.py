"""The posterior between and beyond knots is that of a problem with a knot there."""

from functools import cache

import numpy as np
import pytest

import geograph as gg
from geograph.constants import EARTH_GM_M3_S2
from geograph.eliminate import Elimination
from geograph.errors import InputError
from geograph.families import Values
from geograph.graph import graph_of, knot_key, sensor_key
from geograph.measurements import Bearings
from geograph.problem import Problem
from geograph.recording import Recording, SmoothSettings
from geograph.scenarios.orbits import free_fall
from geograph.sensors import Sensor, SensorErrors
from geograph.solver import solve

STEP = 4.0
COUNT = 9
SIGMA = 1e-3

MOTIONS = {
    "order 1": ("local", SmoothSettings(motion="constant-position", process_noise=10.0)),
    "order 2": ("local", SmoothSettings(motion="constant-velocity", process_noise=2.0)),
    "order 2, per axis": (
        "local",
        SmoothSettings(motion="constant-velocity", process_noise=(5.0, 1.0, 0.2)),
    ),
    "order 3": ("local", SmoothSettings(motion="constant-acceleration", process_noise=0.5)),
    "order 3, along": (
        "local",
        SmoothSettings(motion="constant-acceleration", process_noise=0.2, process_noise_along=1.0),
    ),
    "order 2, along": (
        "local",
        SmoothSettings(motion="constant-velocity", process_noise=0.2, process_noise_along=2.0),
    ),
    "thrown": ("local", SmoothSettings(motion="ballistic", process_noise=2.0)),
    "orbit": ("ecef", SmoothSettings(motion="orbital", process_noise=1.0)),
}


def world(frame, rng):
    """Return positions of the object at the knots and of three sensors."""
    times = STEP * np.arange(COUNT)
    if frame == "local":
        path = np.array([100.0, -500.0, 900.0]) + np.outer(times, [30.0, 40.0, 5.0])
        path += rng.normal(size=path.shape) * 2.0
        return times, path, rng.normal(size=(3, 3)) * 600.0
    radius = 6.8e6
    speed = np.sqrt(EARTH_GM_M3_S2 / radius)
    start = np.array([[radius, 0.0, 0.0], [0.0, 0.6 * speed, 0.8 * speed]])
    path = free_fall(start, (0.0, times[-1]), j2=True).position_at(times)
    # In axes that turn with the Earth.
    angle = -7.292115e-5 * times
    turned = np.stack(
        [
            np.cos(angle) * path[:, 0] - np.sin(angle) * path[:, 1],
            np.sin(angle) * path[:, 0] + np.cos(angle) * path[:, 1],
            path[:, 2],
        ],
        axis=1,
    )
    return times, turned, np.array([radius, 1e5, 1e5]) + rng.normal(size=(3, 3)) * 3e5


@cache
def smoothed(name):
    """A track whose measurements all stand at knots, so that another knot changes nothing."""
    frame, settings = MOTIONS[name]
    rng = np.random.default_rng(1)
    times, path, places = world(frame, rng)
    errors = SensorErrors(
        azimuth_bias_rad=2e-3,
        elevation_bias_rad=1e-3,
        azimuth_drift_rad_s=1e-4,
        azimuth_instability_rad_sqrt_s=3e-4,
        elevation_instability_rad_sqrt_s=2e-4,
    )
    sensors = {
        f"S{i}": Sensor(
            name=f"S{i}", position_m=place, axes="xyz",
            errors=errors if i else SensorErrors(azimuth_bias_rad=1e-3),
        )
        for i, place in enumerate(places)
    }  # fmt: skip
    sensor = np.repeat(np.arange(3), COUNT)
    line = np.tile(path, (3, 1)) - places[sensor]
    noise = rng.normal(size=(2, sensor.size)) * SIGMA
    size = np.full(sensor.size, SIGMA)
    bearings = Bearings(
        time_s=np.tile(times, 3),
        sensor=sensor,
        azimuth_rad=np.arctan2(line[:, 1], line[:, 0]) + noise[0],
        elevation_rad=np.arctan2(line[:, 2], np.hypot(line[:, 0], line[:, 1])) + noise[1],
        sigma_azimuth_rad=size,
        sigma_elevation_rad=size,
        isotropic=np.zeros(sensor.size, dtype=bool),
        line=np.zeros(sensor.size, dtype=np.int64),
    )
    recording = Recording(
        name=name, frame=frame, sensors=sensors, bearings=bearings,
        propagation_speed_m_s=np.inf, settings=settings.replace(spacing_s=STEP, loss="none"),
    )  # fmt: skip
    track = gg.smooth(recording, raise_on_failure=False)
    np.testing.assert_allclose(track.time_s, times, atol=1e-9)
    return track


def with_knots(track, times):
    """Solve the same problem with more knots; return it with estimate, factorisation, indices."""
    old, values = track.problem, track.values
    knots = np.sort(np.concatenate([old.knots_s, times]))
    problem = Problem(
        motion=old.motion, knots_s=knots, families=old.families, states=old.states,
        walk_scale=old.walk_scale, prior=old.prior, path_scale=old.path_scale,
    )  # fmt: skip
    path = old.motion.read(old.path, values.path, knots)
    walks = np.stack([np.interp(knots, old.knots_s, walk) for walk in values.walks.T], axis=1)
    point = solve(problem, Values(path, walks, values.constants), tolerance=1e-15).values
    for _ in range(5):
        point = problem.moved(point, Elimination(problem.linearise(point)).solve())
    return problem, point, Elimination(problem.linearise(point)), np.searchsorted(knots, times)


# Times between, and after the last knot; one a hundredth of a step from a knot.
TIMES = np.array([1.1, 6.0, 14.7, 16.04, 30.0, 33.0, 40.0])

# The Gaussian process is exactly consistent with more knots where the noise does not depend on the
# state and gravity does not bend it. Otherwise a knot changes the prior. Noise along the velocity
# is drawn along that of the knot before, and turns with it: here up to 0.03 sigma in position and
# 0.06 in the acceleration. Noise in an orbit is spread as if there were no gravity gradient, wrong
# by the order of (n h)^2 / 6 = 3e-6 for 4 s at n = 1.1 mrad/s.
TOLERANCE = {"order 3, along": (4e-2, 8e-2), "order 2, along": (4e-2, 8e-2), "orbit": (5e-6, 5e-6)}


@pytest.mark.parametrize("name", MOTIONS)
def test_posterior_between_and_after_the_knots(name):
    track = smoothed(name)
    problem, point, elimination, index = with_knots(track, TIMES)
    found = track.at(TIMES)
    size = track.state.shape[1]
    scale = problem.path_scale
    expected = elimination.marginals().knots[index, :size, :size] * scale[:, None] * scale
    sigma = np.sqrt(np.einsum("kii->ki", expected))
    spread = sigma[:, :, None] * sigma[:, None, :]
    for rows, tolerance in zip((3, size), TOLERANCE.get(name, (1e-6, 1e-6)), strict=True):
        miss = ((found.state - point.path[index]) / sigma)[:, :rows]
        assert np.abs(miss).max() < tolerance
        miss = ((found.covariance - expected) / spread)[:, :rows, :rows]
        assert np.abs(miss).max() < tolerance
    # A test that could not tell would be of no use: both neighbours alone are another answer.
    nearest = np.abs(track.time_s - TIMES[2]).argmin()
    assert np.abs(track.covariance[nearest] / spread[2] - expected[2] / spread[2]).max() > 1e-3


@pytest.mark.parametrize("name", ["order 1", "order 2", "order 3", "thrown"])
def test_posterior_before_the_first_knot(name):
    """The prediction back in time; the weak prior of the first knot moves with it."""
    track = smoothed(name)
    times = np.array([-5.0, -1.0])
    problem, point, elimination, index = with_knots(track, times)
    found = track.at(times)
    size = track.state.shape[1]
    scale = problem.path_scale
    expected = elimination.marginals().knots[index, :size, :size] * scale[:, None] * scale
    sigma = np.sqrt(np.einsum("kii->ki", expected))
    spread = sigma[:, :, None] * sigma[:, None, :]
    # Walks start at zero at the first knot, which is now another: a small part of the sigmas.
    np.testing.assert_allclose((found.state - point.path[index]) / sigma, 0.0, atol=0.2)
    np.testing.assert_allclose(found.covariance / spread, expected / spread, atol=0.2)


def test_outside_the_knots_it_is_the_prediction():
    track = smoothed("order 2")
    after = track.at(track.time_s[-1] + 7.0)
    expected, phi = track.problem.motion.predict(track.state[-1:], np.array([7.0]))
    np.testing.assert_allclose(after.state, expected, rtol=1e-14)
    noise = track.problem.motion.noise(track.state[-1:], np.array([7.0]))
    np.testing.assert_allclose(
        after.covariance[0], phi[0] @ track.covariance[-1] @ phi[0].T + noise[0], rtol=1e-12
    )
    before = track.at(track.time_s[0] - 7.0)
    expected, phi = track.problem.motion.predict(track.state[:1], np.array([-7.0]))
    np.testing.assert_allclose(before.state, expected, rtol=1e-14)
    noise = track.problem.motion.noise(track.state[:1], np.array([7.0]))
    np.testing.assert_allclose(
        before.covariance[0], phi[0] @ (track.covariance[0] + noise[0]) @ phi[0].T, rtol=1e-12
    )


@pytest.mark.parametrize("name", MOTIONS)
def test_at_the_knots_it_is_the_knots(name):
    track = smoothed(name)
    found = track.at(track.time_s)
    sigma = np.sqrt(np.einsum("kii->ki", track.covariance))
    np.testing.assert_allclose((found.state - track.state) / sigma, 0.0, atol=1e-7)
    spread = sigma[:, :, None] * sigma[:, None, :]
    np.testing.assert_allclose(
        found.covariance / spread, track.covariance / spread, rtol=0.0, atol=1e-7
    )


@pytest.mark.parametrize("name", MOTIONS)
def test_it_is_continuous_and_positive(name):
    track = smoothed(name)
    edges = np.concatenate([track.time_s - 1e-6, track.time_s + 1e-6])
    pair = track.at(edges)
    half = track.time_s.size
    sigma = np.sqrt(np.einsum("kii->ki", track.covariance))
    jump = (pair.state[:half] - pair.state[half:]) / sigma
    assert np.abs(jump).max() < 1e-2
    spread = sigma[:, :, None] * sigma[:, None, :]
    jump = (pair.covariance[:half] - pair.covariance[half:]) / spread
    # The acceleration of a path of order 1 more than the sample has noise of its own: sqrt(2e-6).
    assert np.abs(jump).max() < 1e-2
    found = track.at(np.linspace(-5.0, 40.0, 200))
    assert (np.linalg.eigvalsh(found.position_covariance_m2) > 0.0).all()


@pytest.mark.parametrize("kind", ["azimuth", "elevation"])
def test_sensor_errors_over_time_against_the_graph(kind):
    """Bias, drift and walk together: variance from the joint covariance of GTSAM's own graph."""
    track = smoothed("order 2")
    problem, point, _, index = with_knots(track, TIMES)
    built = graph_of(problem, point)
    linear = built.graph.linearize(built.encode(point))
    information, _ = linear.hessian(built.ordering())
    covariance = np.linalg.inv(information)
    d, s = problem.layout.knot, problem.states.size
    offset = d * problem.knots_s.size
    assert covariance.shape == (offset + s, offset + s)
    assert knot_key(0) != sensor_key(0)
    for sensor in range(3):
        estimate, sigma = track.sensor_error_at(f"S{sensor}", kind, TIMES)
        for n, time in enumerate(TIMES):
            row = np.zeros(offset + s)
            value = 0.0
            for column, state in enumerate(problem.states.constants):
                if state.sensor == sensor and state.name.startswith(kind):
                    basis = state.sigma * (time if state.drift else 1.0)
                    row[offset + column] = basis
                    value += basis * point.constants[column]
            for column, walk in enumerate(problem.states.walks):
                if walk.sensor == sensor and walk.name.startswith(kind):
                    scale = problem.walk_scale[column]
                    row[d * index[n] + problem.layout.path + column] = scale
                    value += scale * point.walks[index[n], column]
            expected = np.sqrt(row @ covariance @ row)
            assert sigma[n] == pytest.approx(expected, rel=1e-6, abs=1e-15)
            assert estimate[n] == pytest.approx(value, rel=1e-6, abs=1e-6 * max(expected, 1e-9))
    assert (track.sensor_error_at("S0", "clock", TIMES)[1] == 0.0).all()


def test_a_static_object_is_the_same_at_all_times():
    frame, _ = MOTIONS["order 2"]
    recording = smoothed("order 2").recording
    still = SmoothSettings(motion="static", loss="none")
    sensors = {
        name: Sensor(name=name, position_m=sensor.position_m, axes="xyz")
        for name, sensor in recording.sensors.items()
    }
    alone = Recording(
        name="still", frame=frame, sensors=sensors, bearings=recording.bearings,
        propagation_speed_m_s=np.inf, settings=still,
    )  # fmt: skip
    track = gg.smooth(alone, raise_on_failure=False)
    assert track.time_s.size == 1
    found = track.at([-100.0, 0.0, 1e6])
    np.testing.assert_array_equal(found.state, np.repeat(track.state, 3, axis=0))
    np.testing.assert_array_equal(found.covariance, np.repeat(track.covariance, 3, axis=0))
    assert found.velocity_m_s is None


def test_shapes_names_and_frames():
    track = smoothed("orbit")
    one = track.at(5.0)
    assert one.state.shape == (1, 6)
    assert one.acceleration_m_s2 is None
    height = one.geodetic()[0, 2]
    assert 3e5 < height < 6e5
    east_north_up = one.enu_covariance_m2()[0]
    assert np.trace(east_north_up) == pytest.approx(np.trace(one.position_covariance_m2[0]))
    local = smoothed("order 3").at(5.0)
    assert local.acceleration_m_s2.shape == (1, 3)
    assert local.geodetic() is None
    assert local.enu_covariance_m2() is None
    flat = local.horizontal_ellipses(0.5)
    axes = np.sqrt(np.linalg.eigvalsh(local.position_covariance_m2[0, :2, :2]))[::-1]
    np.testing.assert_allclose(flat.semi_axes_m[0], axes * np.sqrt(2 * np.log(2)), rtol=1e-9)
    cep = local.cep_m()[0]
    assert axes[1] * 0.67 < cep < axes[0] * 1.18


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda track: track.at(np.nan), "a time that is not finite"),
        (lambda track: track.at([1.0, np.inf]), "a time that is not finite"),
        (lambda track: track.sensor_error_at("S9", "azimuth", 0.0), "no sensor 'S9'; expected.*S0"),
        (lambda track: track.sensor_error_at("S0", "position_x", 0.0), "no error 'position_x'"),
        (lambda track: track.ellipsoids(1.0), "expected between 0 and 1"),
    ],
)
def test_wrong_questions(call, message):
    with pytest.raises(InputError, match=message):
        call(smoothed("order 2"))
