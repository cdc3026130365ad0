"""Closed-form fixes from arrival times, against geometry written here."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from effort import examples
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from geograph.closed_form import chan_ho, intersections
from geograph.closed_form_sets import multi_set
from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.errors import InputError
from geograph.geodesy import ecef_from_geodetic
from geograph.scenarios.moving_sensors import VARIANTS, simulate

SOUND_M_S = 343.0
BOTH = pytest.mark.parametrize("solve", [intersections, chan_ho])


def heard(sensor_m, emitter_m, speed_m_s=SPEED_OF_LIGHT_M_S, emitted_s=0.25):
    return emitted_s + np.linalg.norm(sensor_m - emitter_m, axis=1) / speed_m_s


def nearest(fixes, emitter_m):
    return min(float(np.linalg.norm(fix.position_m - emitter_m)) for fix in fixes)


def bound(sensor_m, emitter_m, covariance_m2):
    """Return the Cramer-Rao bound from all differences to the first sensor."""
    unit = emitter_m - sensor_m
    unit = unit / np.linalg.norm(unit, axis=1)[:, None]
    differences = np.column_stack([-np.ones(len(unit) - 1), np.eye(len(unit) - 1)])
    slope = differences @ unit
    return np.linalg.inv(
        slope.T @ np.linalg.solve(differences @ covariance_m2 @ differences.T, slope)
    )


@BOTH
@pytest.mark.parametrize(("dimension", "sensors"), [(2, 3), (2, 4), (2, 7), (3, 4), (3, 5), (3, 9)])
@pytest.mark.parametrize("speed_m_s", [SPEED_OF_LIGHT_M_S, SOUND_M_S])
def test_exact_times_give_the_exact_place(solve, dimension, sensors, speed_m_s):
    rng = np.random.default_rng([dimension, sensors])
    size = 3e3 if speed_m_s > 1e6 else 20.0
    for _ in range(30):
        sensor = size * rng.normal(size=(sensors, dimension))
        emitter = size * 10.0 ** rng.uniform(-1.0, 1.0) * rng.normal(size=dimension)
        toa = heard(sensor, emitter, speed_m_s)
        fixes = solve(sensor, toa, np.full(sensors, 1e-9), speed_m_s=speed_m_s)
        # Times near 0.25 s are rounded to 6e-17 s; a poor geometry stretches that.
        unit = (emitter - sensor) / np.linalg.norm(emitter - sensor, axis=1)[:, None]
        dilution = 1.0 / np.linalg.svd(unit - unit.mean(axis=0), compute_uv=False)[-1]
        assert nearest(fixes, emitter) < 1e-6 * size / 3e3 + 1e-6 * dilution
        best = min(fixes, key=lambda fix: np.linalg.norm(fix.position_m - emitter))
        assert best.emission_s == pytest.approx(0.25, abs=1e-5 * (1.0 + dilution) / speed_m_s)
        if sensors > dimension + 1:
            np.testing.assert_array_equal(best.position_m, fixes[0].position_m)


def test_three_sensors_in_a_plane_show_both_roots():
    """Two hyperbolas that meet twice: both meetings have the same differences."""
    sensor = np.array([[0.0, 0.0], [1000.0, 0.0], [400.0, 800.0]])
    emitter = np.array([-600.0, -250.0])
    toa = heard(sensor, emitter)
    fixes = chan_ho(sensor, toa, np.full(3, 1e-9), speed_m_s=SPEED_OF_LIGHT_M_S)
    assert len(fixes) == 2
    for fix in fixes:
        delay = toa - heard(sensor, fix.position_m)
        assert np.ptp(delay) * SPEED_OF_LIGHT_M_S < 1e-6
    assert nearest(fixes, emitter) < 1e-5
    assert np.linalg.norm(fixes[0].position_m - fixes[1].position_m) > 100.0


@BOTH
@pytest.mark.parametrize("sensors", [3, 4, 6])
def test_known_height_over_the_ellipsoid(solve, sensors):
    sensor = ecef_from_geodetic(
        [50.0, 50.5, 51.0, 49.8, 52.0, 51.5],
        [8.0, 8.7, 7.5, 9.0, 10.0, 6.5],
        [100.0, 400.0, 200.0, 900.0, 50.0, 300.0],
    )[:sensors]
    emitter = ecef_from_geodetic(52.1, 9.9, 11_000.0)
    fixes = solve(
        sensor,
        heard(sensor, emitter),
        np.full(sensors, 1e-9),
        speed_m_s=SPEED_OF_LIGHT_M_S,
        height_m=11_000.0,
        frame="ecef",
    )
    assert nearest(fixes, emitter) < 1e-3


@BOTH
def test_known_height_in_a_local_frame(solve):
    sensor = np.array([[0.0, 0.0, 0.0], [900.0, 0.0, 30.0], [100.0, 700.0, 10.0]])
    emitter = np.array([2500.0, 1800.0, 450.0])
    fixes = solve(
        sensor,
        heard(sensor, emitter, SOUND_M_S),
        np.full(3, 1e-5),
        speed_m_s=SOUND_M_S,
        height_m=450.0,
    )
    assert nearest(fixes, emitter) < 1e-6
    assert all(fix.position_m[2] == pytest.approx(450.0) for fix in fixes)
    assert all(fix.covariance_m2[2, 2] == pytest.approx(0.0, abs=1e-9) for fix in fixes)


@BOTH
def test_sensors_in_a_plane_show_both_mirror_images(solve):
    rng = np.random.default_rng(3)
    sensor = np.column_stack([500.0 * rng.normal(size=(5, 2)), np.zeros(5)])
    emitter = np.array([300.0, -900.0, 700.0])
    fixes = solve(sensor, heard(sensor, emitter), np.full(5, 1e-9), speed_m_s=SPEED_OF_LIGHT_M_S)
    assert nearest(fixes, emitter) < 1e-5
    assert nearest(fixes, emitter * [1.0, 1.0, -1.0]) < 1e-5


@BOTH
def test_sensors_on_a_line_show_both_sides(solve):
    sensor = np.column_stack([[0.0, 400.0, 1100.0, 1500.0], np.zeros(4)]) @ np.array(
        [[0.8, 0.6], [-0.6, 0.8]]
    )
    emitter = np.array([700.0, -900.0])
    along = np.array([0.8, 0.6])
    mirror = 2.0 * along * (along @ emitter) - emitter
    fixes = solve(sensor, heard(sensor, emitter), np.full(4, 1e-9), speed_m_s=SPEED_OF_LIGHT_M_S)
    assert nearest(fixes, emitter) < 1e-4
    assert nearest(fixes, mirror) < 1e-4


@BOTH
def test_emitter_among_the_sensors_and_at_one(solve):
    sensor = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0], [100.0, 110.0], [50.0, 40.0]])
    for emitter in (np.array([45.0, 55.0]), sensor[4]):
        toa = heard(sensor, emitter, SOUND_M_S)
        fixes = solve(sensor, toa, np.full(5, 1e-5), speed_m_s=SOUND_M_S)
        assert np.linalg.norm(fixes[0].position_m - emitter) < 1e-6


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("shared", [False, True])
def test_two_steps_attain_the_bound(dimension, shared):
    """Errors over the bound's covariance are chi-square: false-alarm rate 1e-6 a case.

    The reported covariance is the bound itself, and residuals are chi-square too.
    """
    rng = np.random.default_rng([17, dimension, shared])
    runs, sensors = 400, dimension + 4
    sensor = 1e3 * rng.normal(size=(sensors, dimension))
    emitter = 2.5e3 * np.ones(dimension) + 300.0 * np.arange(dimension)
    sigma = np.linspace(0.1, 0.4, sensors)
    covariance = np.diag(sigma**2)
    if shared:
        mixing = rng.normal(size=(sensors, sensors))
        covariance = 0.01 * (mixing @ mixing.T + np.eye(sensors))
    root = np.linalg.cholesky(covariance)
    exact = heard(sensor, emitter)
    limit = bound(sensor, emitter, covariance)
    errors, costs = [], []
    for _ in range(runs):
        toa = exact + root @ rng.normal(size=sensors) / SPEED_OF_LIGHT_M_S
        fix = chan_ho(
            sensor, toa, covariance / SPEED_OF_LIGHT_M_S**2, speed_m_s=SPEED_OF_LIGHT_M_S
        )[0]
        errors.append(fix.position_m - emitter)
        costs.append(fix.cost)
    np.testing.assert_allclose(fix.covariance_m2, limit, rtol=0.05, atol=0.02 * limit.max())
    error = np.array(errors)
    total = float(np.einsum("ni,ij,nj->", error, np.linalg.inv(limit), error))
    low, high = chi2.ppf([5e-7, 1.0 - 5e-7], runs * dimension)
    assert low < total < high
    low, high = chi2.ppf([5e-7, 1.0 - 5e-7], runs * (sensors - 1 - dimension))
    assert low < sum(costs) < high


def test_differences_to_one_sensor_are_arrivals_with_their_covariance():
    """Differences have a covariance of zero at the reference: the answer is that of the times."""
    rng = np.random.default_rng(5)
    sensor = 2e3 * rng.normal(size=(6, 3))
    variance = (1e-9 * rng.uniform(1.0, 3.0, size=6)) ** 2
    toa = heard(sensor, np.array([4e3, -3e3, 2e3])) + np.sqrt(variance) * rng.normal(size=6)
    direct = chan_ho(sensor, toa, np.sqrt(variance), speed_m_s=SPEED_OF_LIGHT_M_S)[0]
    for reference in (0, 3):
        change = np.eye(6)
        change[:, reference] -= 1.0
        shared = change @ np.diag(variance) @ change.T
        fix = chan_ho(sensor, change @ toa, shared, speed_m_s=SPEED_OF_LIGHT_M_S)[0]
        np.testing.assert_allclose(fix.position_m, direct.position_m, rtol=0.0, atol=1e-3)
        assert fix.cost == pytest.approx(direct.cost, rel=1e-3)


def sets_of(runs, run):
    emission = np.repeat(np.arange(runs.variant.sets), runs.sensor.shape[1])
    return (
        runs.sensor_m[run].reshape(-1, 2),
        runs.toa_s[run].ravel(),
        np.full(emission.size, runs.variant.sigma_s),
        emission,
    )


@pytest.mark.parametrize("name", ["emitter-1-10ns", "emitter-2-10ns"])
@pytest.mark.parametrize("range_order", [None, 1, 2])
def test_all_sets_together_are_near_the_bound_for_a_far_emitter(name, range_order):
    """METU 2009, 120 s of sets at 10 ns: bounds of 318.7 m and 411.9 m, nearly all of it range.

    False-alarm rate below 1e-4 each: of 30 runs the mean square over the bound's is chi-square
    over 30, and the mean error normal with the bound's sigma over sqrt(30).
    """
    variant = VARIANTS[name]
    runs = simulate(variant, range(30))
    errors = []
    for run in range(len(runs)):
        fix = multi_set(
            *sets_of(runs, run),
            speed_m_s=SPEED_OF_LIGHT_M_S,
            sensor=runs.sensor.ravel(),
            range_order=range_order,
        )[0]
        errors.append(fix.position_m - np.array(variant.emitter_m))
    limit = 318.7 if name.startswith("emitter-1") else 411.9
    error = np.array(errors)
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], len(runs))
    assert low < np.sum(error**2) / limit**2 < high
    assert np.linalg.norm(error.mean(axis=0)) < 4.0 * limit / np.sqrt(len(runs))


@pytest.mark.parametrize(("name", "within_m"), [("emitter-1-1ns", 0.1), ("emitter-2-1ns", 0.1)])
def test_far_emitter_exactly(name, within_m):
    """Without noise what is left is the sensors' way during the light time, 17 mm."""
    variant = VARIANTS[name]
    runs = simulate(variant, [0])
    sensor, _, sigma, emission = sets_of(runs, 0)
    place = np.array(variant.emitter_m)
    toa = 2.0 + 2.0 * emission + np.linalg.norm(sensor - place, axis=1) / SPEED_OF_LIGHT_M_S
    for order in (None, 2):
        fixes = multi_set(
            sensor, toa, sigma, emission, speed_m_s=SPEED_OF_LIGHT_M_S, range_order=order
        )
        assert np.linalg.norm(fixes[0].position_m - place) < within_m


def moving_array(rng, height_m):
    start = np.column_stack([3e3 * rng.normal(size=(4, 2)), np.full(4, height_m)])
    velocity = np.column_stack([30.0 * rng.normal(size=(4, 2)), np.zeros(4)])
    time = np.repeat(2.0 * np.arange(20), 4)
    return np.tile(start, (20, 1)) + time[:, None] * np.tile(velocity, (20, 1)), time


def test_many_sets_in_one_plane_show_both_mirror_images():
    sensor, emitted = moving_array(np.random.default_rng(0), 50.0)
    place = np.array([3e3, 5e3, 350.0])
    toa = emitted + np.linalg.norm(sensor - place, axis=1) / SOUND_M_S
    fixes = multi_set(sensor, toa, np.full(80, 1e-4), emitted, speed_m_s=SOUND_M_S)
    assert nearest(fixes, place) < 1e-4
    assert nearest(fixes, place - [0.0, 0.0, 600.0]) < 1e-4
    known = multi_set(sensor, toa, np.full(80, 1e-4), emitted, speed_m_s=SOUND_M_S, height_m=350.0)
    assert len(known) == 1
    assert nearest(known, place) < 1e-4


def test_even_motion_from_many_sets():
    rng = np.random.default_rng(8)
    sensor, emitted = moving_array(rng, 0.0)
    sensor[:, 2] = np.tile([0.0, 400.0, 900.0, 200.0], 20)
    sensor = np.concatenate([sensor, sensor + np.array([300.0, -700.0, 500.0])])
    emitted = np.concatenate([emitted, emitted])
    velocity = np.array([40.0, -25.0, 3.0])
    place = np.array([6e3, 2e3, 1500.0]) + emitted[:, None] * velocity
    toa = emitted + np.linalg.norm(sensor - place, axis=1) / SPEED_OF_LIGHT_M_S
    fix = multi_set(
        sensor, toa, np.full(160, 1e-9), emitted, speed_m_s=SPEED_OF_LIGHT_M_S, velocity=True
    )[0]
    # The sets' times are those of their first arrivals, a few microseconds apart.
    np.testing.assert_allclose(fix.velocity_m_s, velocity, atol=1e-3)
    np.testing.assert_allclose(
        fix.position_m, [6e3, 2e3, 1500.0] + fix.time_s * velocity, atol=1e-2
    )


@pytest.mark.parametrize("height_m", [200.0, 9000.0])
def test_many_sets_over_the_ellipsoid(height_m):
    rng = np.random.default_rng(2)
    stations = ecef_from_geodetic([47.0, 47.5, 46.8], [8.0, 8.9, 9.4], [500.0, 900.0, 700.0])
    place = ecef_from_geodetic(47.9, 9.9, height_m)
    sensor = np.tile(stations, (10, 1)) + 500.0 * rng.normal(size=(30, 3))
    emission = np.repeat(np.arange(10), 3)
    fixes = multi_set(
        sensor,
        heard(sensor, place) + emission,
        np.full(30, 1e-8),
        emission,
        speed_m_s=SPEED_OF_LIGHT_M_S,
        height_m=height_m,
        frame="ecef",
    )
    assert nearest(fixes, place) < 0.05


coordinates = st.sampled_from([0.0, 1.0, -1.0, 7.0, 1e3, -4e4])
scales = st.sampled_from([1e-3, 1.0, 6e6])


cases = st.tuples(
    st.sampled_from([2, 3]),
    st.integers(1, 6),
    scales,
    st.sampled_from([None, 0.0, 1e4]),
    st.sampled_from(["local", "ecef"]),
)


# Shrinking takes minutes here, and says little more than the case itself.
@given(data=st.data(), case=cases)
@settings(
    max_examples=examples(80, 300),
    deadline=None,
    phases=[Phase.explicit, Phase.reuse, Phase.generate],
)
def test_whatever_the_geometry_there_is_an_answer(data, case):
    """Sensors in one place, on a line, in a plane; times that no place explains; sigmas apart."""
    dimension, sensors, scale, height, frame = case
    place = st.lists(coordinates, min_size=dimension, max_size=dimension)
    sensor = scale * np.array(data.draw(st.lists(place, min_size=sensors, max_size=sensors)))
    toa = np.array(data.draw(st.lists(coordinates, min_size=sensors, max_size=sensors))) * 1e-6
    sigma = np.array(
        data.draw(st.lists(st.sampled_from([1e-9, 1e-6, 1e-3]), min_size=sensors, max_size=sensors))
    )
    height = height if dimension == 3 else None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for solve in (intersections, chan_ho):
            fixes = solve(sensor, toa, sigma, speed_m_s=3e8, height_m=height, frame=frame)
            assert fixes
            for fix in fixes:
                assert np.isfinite(fix.position_m).all()
                assert np.isfinite(fix.covariance_m2).all()
                assert fix.cost >= 0.0
        emission = np.arange(sensors) // 3
        for order in (None, 1, 2):
            many = multi_set(
                sensor,
                toa,
                sigma,
                emission,
                speed_m_s=3e8,
                velocity=bool(sensors % 2),
                range_order=order,
                height_m=height,
                frame=frame,
            )
            assert many
            assert all(np.isfinite(fix.position_m).all() for fix in many)


def test_what_cannot_be_is_refused():
    sensor, toa, sigma = np.zeros((3, 3)), np.zeros(3), np.full(3, 1e-9)
    with pytest.raises(InputError, match=r"sensors have shape \(3, 3\) and arrival times \(2,\)"):
        chan_ho(sensor, toa[:2], sigma, speed_m_s=343.0)
    with pytest.raises(InputError, match="sigma_s has shape"):
        chan_ho(sensor, toa, sigma[:2], speed_m_s=343.0)
    with pytest.raises(InputError, match="not finite and above 0"):
        chan_ho(sensor, toa, np.zeros(3), speed_m_s=343.0)
    with pytest.raises(InputError, match="speed of propagation is inf"):
        chan_ho(sensor, toa, sigma, speed_m_s=np.inf)
    with pytest.raises(InputError, match="is not finite; remove such rows"):
        chan_ho(sensor, toa * np.nan, sigma, speed_m_s=343.0)
    with pytest.raises(InputError, match="in a plane; expected None"):
        chan_ho(sensor[:, :2], toa, sigma, speed_m_s=343.0, height_m=0.0)
    with pytest.raises(InputError, match="in a plane; expected None"):
        multi_set(sensor[:, :2], toa, sigma, [0, 0, 0], speed_m_s=343.0, height_m=0.0)
    with pytest.raises(InputError, match="no arrival time"):
        chan_ho(sensor[:0], toa[:0], sigma[:0], speed_m_s=343.0)
    with pytest.raises(InputError, match="sigmas, emissions and sensors have shapes"):
        multi_set(sensor, toa, sigma, [0, 0], speed_m_s=343.0)
