"""Light time and directions against closed forms, a scalar solver and cases made by hand."""

import numpy as np
import pytest
from scipy.optimize import brentq

from geograph.constants import EARTH_RADIUS_M, EARTH_ROTATION_RAD_S, SPEED_OF_LIGHT_M_S
from geograph.geodesy import enu_axes
from geograph.scenarios.observation import (
    angles_from_direction,
    direction_from_angles,
    east_north_up,
    ecef_from_east_north_up,
    light_time,
    observe_bearings,
)
from geograph.scenarios.orbits import CircularOrbit, EarthFixedBody, turned_about_z
from geograph.scenarios.paths import StraightBody
from geograph.scenarios.places import ecef

ORBIT = EarthFixedBody(CircularOrbit(7.1e6, np.array([0.0, 0.6, 0.8]), np.array([1.0, 0, 0]), 0.3))


@pytest.mark.parametrize("speed", [343.0, 60.0, SPEED_OF_LIGHT_M_S])
def test_light_time_of_a_straight_flight_solves_the_quadratic(speed):
    start, velocity = np.array([120.0, -40.0, 30.0]), np.array([-30.0, 15.0, 5.0])
    times = np.linspace(-3.0, 9.0, 25)
    sensors = np.random.default_rng(0).uniform(-50.0, 50.0, (25, 3))
    delay, sight = light_time(
        StraightBody(start, velocity), sensors, times, propagation_speed_m_s=speed, rotation_rad_s=0
    )
    # |d - v tau| = c tau with d the line of sight to where the object is at reception.
    d = start + times[:, None] * velocity - sensors
    a, b, c = speed**2 - velocity @ velocity, d @ velocity, np.sum(d**2, axis=-1)
    expected = (-b + np.sqrt(b**2 + a * c)) / a
    np.testing.assert_allclose(delay, expected, rtol=1e-13)
    np.testing.assert_allclose(sight, d - expected[:, None] * velocity, rtol=1e-9, atol=1e-9)


def test_light_time_on_the_turning_earth_equals_a_scalar_solution():
    times = np.array([0.0, 77.0, 3600.0, 40_000.0])
    sensors = np.tile(ecef(48.0, 11.0, 500.0), (4, 1))
    delay, sight = light_time(ORBIT, sensors, times)
    for t, tau, sensor, line in zip(times, delay, sensors, sight, strict=True):
        place = turned_about_z(sensor, EARTH_ROTATION_RAD_S * t)

        def miss(x, t=t, place=place):
            return (
                np.linalg.norm(ORBIT.inertial.position_at(t - x) - place) - SPEED_OF_LIGHT_M_S * x
            )

        expected = brentq(miss, 0.0, 1.0, xtol=1e-16, rtol=1e-14)
        assert tau == pytest.approx(expected, rel=1e-12)
        inertial = ORBIT.inertial.position_at(t - expected) - place
        np.testing.assert_allclose(
            turned_about_z(line, EARTH_ROTATION_RAD_S * t), inertial, rtol=0, atol=1e-5
        )


def test_range_shows_the_sagnac_term():
    # Ashby, Living Reviews in Relativity 6, 2003, section 2: a signal to a receiver at r_r from a
    # source at r_s, both fixed to the Earth, goes farther than their distance by
    # omega (x_s y_r - y_s x_r) / c, to the first order in omega; the second is below 1 mm.
    source = np.array([4.2e7 * np.cos(1.0), 4.2e7 * np.sin(1.0), 0.0])
    receiver = ecef(10.0, 20.0, 0.0)
    delay, _ = light_time(StraightBody(source), receiver[None], np.array([5000.0]))
    excess = delay[0] * SPEED_OF_LIGHT_M_S - np.linalg.norm(source - receiver)
    turn = source[0] * receiver[1] - source[1] * receiver[0]
    expected = EARTH_ROTATION_RAD_S * turn / SPEED_OF_LIGHT_M_S
    assert abs(expected) > 20.0
    assert excess == pytest.approx(expected, abs=1e-3)


def test_without_light_time_objects_are_seen_where_they_are():
    seen = observe_bearings(
        StraightBody(np.array([10.0, 10.0, 0.0]), np.array([1e3, 0.0, 0.0])),
        [StraightBody(np.zeros(3))],
        np.array([0.0, 1.0]),
        np.zeros(2, dtype=np.int64),
        axes=["xyz"],
        frame="local",
        propagation_speed_m_s=np.inf,
    )
    np.testing.assert_allclose(seen.emission_time_s, [0.0, 1.0])
    np.testing.assert_allclose(seen.azimuth_rad, [np.pi / 4, np.arctan2(10.0, 1010.0)])


def test_a_faster_object_than_its_signal_is_refused():
    with pytest.raises(RuntimeError, match="light times do not settle"):
        light_time(
            StraightBody(np.array([9.0, 0, 0]), np.array([-400.0, 0, 0])),
            np.zeros((1, 3)),
            np.array([1.0]),
            propagation_speed_m_s=343.0,
            rotation_rad_s=0.0,
        )


@pytest.mark.parametrize(
    ("direction", "azimuth_deg", "elevation_deg"),
    [
        ((0.0, 1.0, 0.0), 0.0, 0.0),
        ((0.0, 1.0, 1.0), 0.0, 45.0),
        ((1.0, 0.0, 0.0), 90.0, 0.0),
        ((0.0, -1.0, -1.0), 180.0, -45.0),
        ((-1.0, -1.0, 0.0), 225.0, 0.0),
        ((-1.0, 0.0, np.sqrt(3.0)), 270.0, 60.0),
    ],
)
@pytest.mark.parametrize("place", [(0.0, 0.0), (52.0, -1.5), (-33.0, 151.0)])
def test_azimuth_and_elevation_by_hand(direction, azimuth_deg, elevation_deg, place):
    lat, lon = np.radians(place)
    east, north, up = direction
    # The ellipsoid's normal makes the angle of the geodetic latitude with the equator.
    normal = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    eastwards = np.array([-np.sin(lon), np.cos(lon), 0.0])
    northwards = np.cross(normal, eastwards)
    sensor = ecef(*place, 100.0)
    target = sensor + 1e5 * (east * eastwards + north * northwards + up * normal)
    seen = observe_bearings(
        StraightBody(target),
        [StraightBody(sensor)],
        np.zeros(1),
        np.zeros(1, dtype=np.int64),
        axes=["enu"],
        propagation_speed_m_s=np.inf,
    )
    turn = np.degrees(seen.azimuth_rad[0]) - azimuth_deg
    assert (turn + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-9)
    assert np.degrees(seen.elevation_rad[0]) == pytest.approx(elevation_deg, abs=1e-9)


def test_ecef_of_places_on_the_axes():
    np.testing.assert_allclose(ecef(0.0, 90.0, 10.0), [0, EARTH_RADIUS_M + 10, 0], atol=1e-8)
    # Polar radius of WGS 84 (NIMA TR8350.2, table 3.3).
    np.testing.assert_allclose(ecef(90.0, 0.0, 0.0), [0, 0, 6_356_752.3142], atol=1e-4)


def test_topocentric_axes_of_moving_sensors_agree_with_the_library():
    times = np.linspace(0.0, 4000.0, 7)
    place = ORBIT.position_at(times)
    line = np.random.default_rng(3).normal(0.0, 1e6, (7, 3))
    expected = np.einsum("nij,nj->ni", enu_axes(place), line)
    np.testing.assert_allclose(east_north_up(place, line), expected, atol=1e-5)
    back = ecef_from_east_north_up(place[0], expected[0] / 1e6)
    np.testing.assert_allclose(back, line[0] / 1e6, atol=1e-9)


@pytest.mark.parametrize("axes", ["enu", "xyz"])
def test_angles_and_directions_are_inverse(axes):
    direction = np.random.default_rng(4).standard_normal((40, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    azimuth, elevation = angles_from_direction(3.0 * direction, axes=axes)
    np.testing.assert_allclose(
        direction_from_angles(azimuth, elevation, axes=axes), direction, atol=1e-15
    )


def test_azimuth_of_xyz_axes_goes_from_x_to_y():
    azimuth, elevation = angles_from_direction(np.array([[0.0, 2.0, 2.0]]), axes="xyz")
    np.testing.assert_allclose([azimuth[0], elevation[0]], [np.pi / 2, np.pi / 4])
