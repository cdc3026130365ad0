"""Bearings: derivatives anywhere, and the equations against definitions from geometry."""

import numpy as np
import pytest
from differences import assert_derivative
from hypothesis import given, settings
from hypothesis import strategies as st

from geograph.factors.bearing import coordinate_residual, predict_bearing, tangent_residual

angles = st.floats(-np.pi, np.pi)
elevations = st.floats(-np.pi / 2, np.pi / 2)
distances = st.floats(1.0, 1e8)
PROFILE = settings(max_examples=100, deadline=None, derandomize=True)


def direction(azimuth, elevation):
    return np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )


def turned_away(azimuth, elevation, angle, towards):
    """Return the direction an angle away from (azimuth, elevation), towards a position angle."""
    u = direction(azimuth, elevation)
    e1 = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    e2 = np.cross(u, e1)
    return np.cos(angle) * u + np.sin(angle) * (np.cos(towards) * e1 + np.sin(towards) * e2)


def single(function, line, azimuth, elevation, *, jacobian=False):
    return function(
        np.asarray(line)[None], np.array([azimuth]), np.array([elevation]), jacobian=jacobian
    )


def check(function, line, azimuth, elevation, *, step=1e-3, rtol=1e-9, rows=2):
    """Compare both derivatives of a residual; steps are in radians as the sensor sees them."""
    found = single(function, line, azimuth, elevation, jacobian=True)
    distance = np.linalg.norm(line)
    assert_derivative(
        found.by_line_of_sight[0, :rows],
        lambda at: single(function, at, azimuth, elevation).value[0, :rows],
        line,
        step * distance,
        rtol=rtol,
    )
    # Residuals are those of measured less error.
    assert_derivative(
        found.by_error[0, :rows],
        lambda error: single(function, line, azimuth - error[0], elevation - error[1]).value[
            0, :rows
        ],
        np.zeros(2),
        step,
        rtol=rtol,
    )


@PROFILE
@given(angles, elevations, st.floats(0.0, 2.9), angles, distances)
def test_tangent_residual_is_the_angle_and_its_direction(azimuth, elevation, angle, towards, far):
    line = far * turned_away(azimuth, elevation, angle, towards)
    value = single(tangent_residual, line, azimuth, elevation).value[0]
    expected = angle * np.array([np.cos(towards), np.sin(towards)])
    np.testing.assert_allclose(value, expected, rtol=0.0, atol=1e-13 / np.sin(max(angle, 0.3)) ** 2)


@PROFILE
@given(angles, elevations, st.floats(0.0, 3.0), angles, distances)
def test_tangent_derivatives_at_any_angle(azimuth, elevation, angle, towards, far):
    # Opposite the measured direction (3.14 rad) derivatives grow as 1 / (pi - angle).
    line = far * turned_away(azimuth, elevation, angle, towards)
    check(tangent_residual, line, azimuth, elevation, step=1e-3 * min(1.0, np.pi - angle))


@PROFILE
@given(angles, st.floats(-5e-3, 5e-3), angles, distances)
def test_tangent_derivatives_where_series_and_closed_form_meet(azimuth, angle, towards, far):
    line = far * turned_away(azimuth, 0.3, angle, towards)
    check(tangent_residual, line, azimuth, 0.3)


@PROFILE
@given(angles, st.floats(1e-9, 1e-2), st.floats(0.0, 0.5), angles, st.sampled_from([-1.0, 1.0]))
def test_tangent_derivatives_at_the_zenith(azimuth, below, angle, towards, side):
    elevation = side * (np.pi / 2 - below)
    line = 1e5 * turned_away(azimuth, elevation, angle, towards)
    check(tangent_residual, line, azimuth, elevation)


@PROFILE
@given(angles, elevations, st.floats(2e-3, 0.1), angles)
def test_tangent_derivatives_almost_opposite(azimuth, elevation, short, towards):
    line = 1e5 * turned_away(azimuth, elevation, np.pi - short, towards)
    # The residual keeps its length of pi and turns by 1 / short as fast as the direction.
    check(tangent_residual, line, azimuth, elevation, step=2e-3 * short, rtol=1e-7)


@pytest.mark.parametrize("short", [0.0, 1e-15, 1e-12, 1e-9, 1e-7, 1e-6, 1e-4, 1e-3, 1e-2])
def test_tangent_residual_opposite_is_half_a_turn(short):
    for towards in np.linspace(-3.0, 3.0, 7):
        line = 20.0 * turned_away(0.4, 0.7, np.pi - short, towards)
        value = single(tangent_residual, line, 0.4, 0.7).value
        assert np.linalg.norm(value) == pytest.approx(np.pi - short, abs=2e-7)


def test_tangent_residual_opposite_is_finite():
    exact = -direction(0.4, 0.2)
    found = single(tangent_residual, exact, 0.4, 0.2, jacobian=True)
    assert np.isfinite(found.by_line_of_sight).all()
    for angle in (np.pi, np.pi - 1e-12, np.pi - 1e-6):
        found = single(tangent_residual, turned_away(0.4, 0.2, angle, 1.0), 0.4, 0.2, jacobian=True)
        for part in (found.value, found.by_line_of_sight, found.by_error):
            assert np.isfinite(part).all()


@PROFILE
@given(angles, st.floats(-1.55, 1.55), angles, st.floats(-1.5, 1.5), distances)
def test_coordinate_derivatives_anywhere(azimuth, elevation, measured, other, far):
    line = far * direction(azimuth, elevation)
    value = single(coordinate_residual, line, measured, other).value[0]
    if abs(abs(value[0]) - np.pi) < 0.1:
        measured += 0.5
    # Azimuth turns faster the closer the zenith.
    check(coordinate_residual, line, measured, other, step=1e-3 * np.cos(elevation), rtol=1e-8)


@PROFILE
@given(angles, st.floats(-1.55, 1.55), angles, distances)
def test_azimuth_only(azimuth, elevation, measured, far):
    line = far * direction(azimuth, elevation)
    found = single(coordinate_residual, line, measured, np.nan, jacobian=True)
    assert found.value[0, 1] == 0.0
    assert not found.by_line_of_sight[0, 1].any()
    assert not found.by_error[0, 1].any()
    if abs(abs(found.value[0, 0]) - np.pi) > 0.1:
        check(
            coordinate_residual, line, measured, np.nan, step=1e-3 * np.cos(elevation), rtol=1e-8,
            rows=1,
        )  # fmt: skip


@PROFILE
@given(angles, st.floats(-1.57, 1.57), distances)
def test_prediction_and_its_derivative(azimuth, elevation, far):
    line = far * direction(azimuth, elevation)
    value, jacobian = predict_bearing(line[None], jacobian=True)
    np.testing.assert_allclose(direction(*value[0]), line / far, rtol=0.0, atol=1e-15)
    if abs(azimuth) < np.pi - 0.01:
        assert_derivative(
            jacobian[0],
            lambda at: predict_bearing(at[None])[0][0],
            line,
            1e-3 * far * np.cos(elevation),
            rtol=1e-8,
        )


@PROFILE
@given(angles, st.floats(-1.5, 1.5), angles)
def test_azimuth_residuals_are_wrapped_to_half_a_turn(azimuth, elevation, measured):
    value = single(coordinate_residual, direction(azimuth, elevation), measured, elevation).value
    assert -np.pi <= value[0, 0] < np.pi
    turns = (value[0, 0] - (azimuth - measured)) / (2.0 * np.pi)
    assert abs(turns - round(turns)) < 1e-14


def test_both_residuals_agree_for_small_differences():
    """On the sky an azimuth difference shrinks with the cosine of the elevation."""
    line, azimuth, elevation = direction(1.0 + 1e-6, 0.7 - 2e-6), 1.0, 0.7
    on_sky = single(tangent_residual, line, azimuth, elevation).value[0]
    plain = single(coordinate_residual, line, azimuth, elevation).value[0]
    np.testing.assert_allclose(plain, [1e-6, -2e-6], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(on_sky, [1e-6 * np.cos(0.7), -2e-6], rtol=0.0, atol=1e-11)


@pytest.mark.parametrize(
    ("line", "azimuth_deg", "elevation_deg"),
    [
        ((1.0, 0.0, 0.0), 0.0, 0.0),
        ((0.0, 2.0, 0.0), 90.0, 0.0),
        ((-3.0, 0.0, 3.0), 180.0, 45.0),
        ((0.0, -1.0, -1.0), -90.0, -45.0),
        ((0.0, 0.0, 5.0), 0.0, 90.0),
    ],
)
def test_prediction_by_hand(line, azimuth_deg, elevation_deg):
    value, _ = predict_bearing(np.array([line]))
    np.testing.assert_allclose(np.degrees(value[0]), [azimuth_deg, elevation_deg], atol=1e-13)


@pytest.mark.parametrize("elevation_deg", [-60.0, 20.0, 75.0])
def test_noise_alone_does_not_pull_at_an_elevation_error(elevation_deg: float) -> None:
    rng = np.random.default_rng(11)
    count, sigma = 200_000, 1e-3
    elevation = np.radians(elevation_deg)
    sight = np.broadcast_to([np.cos(elevation), 0.0, np.sin(elevation)], (count, 3))
    azimuth = sigma * rng.normal(size=count) / np.cos(elevation)
    measured = elevation + sigma * rng.normal(size=count)
    found = tangent_residual(sight, azimuth, measured, noise_elevation_rad=measured, jacobian=True)
    assert found.by_error is not None
    # The object sinks as the sensor's error rises, so that the elevation still fits: the azimuths'
    # share of the cost's slope. Without the ratio of the cosines its mean is tan(elevation); the
    # rounding at the zenith leaves z^2 / cos^2 of that.
    sinking = np.array([np.sin(elevation), 0.0, -np.cos(elevation)])
    assert found.by_line_of_sight is not None
    change = found.by_error[:, 0, 1] + found.by_line_of_sight[:, 0] @ sinking
    slope = found.value[:, 0] * change / sigma**2
    pull = np.tan(elevation)
    allowed = (0.01 + 0.02**2 / np.cos(elevation) ** 2) * abs(pull)
    assert abs(slope.mean()) < allowed + 4.0 * slope.std() / np.sqrt(count)
    plain = tangent_residual(sight, azimuth, measured, jacobian=True)
    assert plain.by_error is not None
    assert plain.by_line_of_sight is not None
    change = plain.by_error[:, 0, 1] + plain.by_line_of_sight[:, 0] @ sinking
    before = plain.value[:, 0] * change / sigma**2
    assert before.mean() == pytest.approx(pull, rel=0.02)
