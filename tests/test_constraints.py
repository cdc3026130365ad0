"""Height and speed of the object: values from geodesy, gradients against differences."""

import numpy as np
import pytest
from differences import assert_derivative
from hypothesis import given, settings
from hypothesis import strategies as st

from geograph.factors.constraints import altitude, coordinate, speed
from geograph.geodesy import ecef_from_geodetic

PROFILE = settings(max_examples=60, deadline=None, derandomize=True)


@PROFILE
@given(
    st.one_of(st.floats(-90.0, 90.0), st.sampled_from([-90.0, 90.0, 0.0, 89.999999])),
    st.floats(-180.0, 180.0),
    st.floats(-5e3, 4e7),
)
def test_altitude_in_ecef(latitude, longitude, height):
    position = ecef_from_geodetic(latitude, longitude, height)
    value, gradient = altitude(position[None], "ecef")
    # PROJ does not iterate: heights are good to 1 um at 10 km, 2 mm at 400 km, 0.3 m at 36 000 km.
    assert value[0] == pytest.approx(height, abs=1e-8 + 2e-8 * abs(height), rel=0.0)
    assert_derivative(
        gradient[0][None],
        lambda at: altitude(at[None], "ecef")[0],
        position,
        1e-3 * (6.4e6 + height),
        rtol=1e-7,
    )
    assert np.linalg.norm(gradient[0]) == pytest.approx(1.0, abs=1e-14)


def test_altitude_in_a_local_frame_is_z():
    value, gradient = altitude(np.array([[1.0, 2.0, 3.0], [4.0, 5.0, -6.0]]), "local")
    np.testing.assert_array_equal(value, [3.0, -6.0])
    np.testing.assert_array_equal(gradient, [[0.0, 0.0, 1.0]] * 2)


@PROFILE
@given(st.tuples(*[st.floats(-7e6, 7e6)] * 3), st.sampled_from([0, 1, 2]))
def test_coordinate(position, axis):
    position = np.array(position)
    value, gradient = coordinate(position[None], axis)
    assert value[0] == position[axis]
    assert_derivative(
        gradient[0][None], lambda at: coordinate(at[None], axis)[0], position, 1e3, rtol=1e-9
    )


@PROFILE
@given(st.tuples(*[st.floats(-1e4, 1e4)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-6))
def test_speed(velocity):
    velocity = np.array(velocity)
    value, gradient = speed(velocity[None])
    length = np.sqrt(np.sum(velocity**2))
    assert value[0] == pytest.approx(length, rel=1e-14)
    assert_derivative(
        gradient[0][None], lambda at: speed(at[None])[0], velocity, 1e-3 * length, rtol=1e-9
    )


def test_an_object_at_rest_has_a_speed_and_no_gradient():
    value, gradient = speed(np.zeros((1, 3)))
    assert value[0] == 0.0
    np.testing.assert_array_equal(gradient, np.zeros((1, 3)))
