"""Comparison with the truth, on errors that were put in."""

from __future__ import annotations

import numpy as np
import pytest
from made_track import make_track

from geograph import results
from geograph.cli.report import comparison_text
from geograph.compare import PathEstimate, compare, read_path, read_truth
from geograph.errors import InputError
from geograph.geodesy import enu_axes
from geograph.measurements import Truth
from geograph.results.interpolate import Knots

KNOT_FIELDS = ("time_s", "position_m", "velocity_m_s", "acceleration_m_s2")


def straight(sigma=2.0, count=11, velocity=(10.0, 0.0, 0.0)):
    time = np.linspace(0.0, 10.0, count)
    position = time[:, None] * np.asarray(velocity)
    return PathEstimate(
        frame="local",
        knots=Knots(time_s=time, position_m=position, velocity_m_s=np.tile(velocity, (count, 1))),
        covariance_m2=np.tile(sigma**2 * np.eye(3), (count, 1, 1)),
    )


def test_known_errors_are_found_along_across_and_above():
    path = straight()
    time = np.array([0.5, 3.25, 9.0])
    # The estimate is 3 m ahead, 4 m to the right (towards -y) and 12 m low.
    offset = np.array([3.0, -4.0, -12.0])
    truth = Truth(time_s=time, position_m=time[:, None] * [10.0, 0.0, 0.0] - offset)
    found = compare(path, truth)
    np.testing.assert_allclose(found.error_m, np.tile(offset, (3, 1)), atol=1e-9)
    np.testing.assert_allclose(found.course_error_m, np.tile([3.0, 4.0, -12.0], (3, 1)), atol=1e-9)
    np.testing.assert_allclose(found.nees, 169.0 / 4.0)
    figures = found.figures()
    assert figures["position_m"] == pytest.approx({"rmse": 13.0, "median": 13.0, "max": 13.0})
    assert figures["components_m"]["z"]["mean"] == pytest.approx(-12.0)
    assert figures["nees"]["share_within_95"] == 0.0
    # Quantiles of chi-square with three degrees of freedom, from tables: 0.0717 and 12.838.
    assert figures["nees"]["band_99"] == pytest.approx([0.07172, 12.8382], rel=1e-4)


def test_a_truth_that_lags_is_shifted_if_asked():
    path = straight()
    time = np.array([0.5, 3.25, 9.0, 9.5])
    truth = Truth(time_s=time, position_m=(time - 0.25)[:, None] * [10.0, 0.0, 0.0] + [0, 2.0, 0])
    plain, shifted = compare(path, truth), compare(path, truth, fit_delay=True)
    assert plain.delay_s is None
    np.testing.assert_allclose(plain.course_error_m[:, 0], 2.5, atol=1e-9)
    assert shifted.delay_s == pytest.approx(0.25, abs=1e-9)
    np.testing.assert_allclose(shifted.error_m, np.tile([0.0, -2.0, 0.0], (4, 1)), atol=1e-9)
    assert "it lags by 0.25 s, which is taken out" in comparison_text(shifted.figures())
    assert "lags" not in comparison_text(plain.figures())
    still = PathEstimate(
        frame="local",
        knots=Knots(time_s=np.zeros(1), position_m=np.zeros((1, 3))),
        covariance_m2=np.eye(3)[None],
    )
    with pytest.raises(InputError, match="the path has no velocity"):
        compare(still, truth, fit_delay=True)


def test_honest_covariance_has_nees_of_three():
    rng = np.random.default_rng(5)
    path = straight(sigma=2.0, count=4001)
    noise = 2.0 * rng.standard_normal(path.knots.position_m.shape)
    found = compare(
        path, Truth(time_s=path.knots.time_s, position_m=path.knots.position_m - noise)
    ).figures()
    # Standard error of the mean of 4001 draws: sqrt(6 / 4001) = 0.039.
    assert found["nees"]["mean"] == pytest.approx(3.0, abs=0.12)
    assert found["nees"]["share_within_95"] == pytest.approx(0.95, abs=0.014)


def test_axes_are_east_north_up_on_the_earth():
    made = results.from_track(make_track())
    up = enu_axes(made.position_m)[:, 2]
    truth = Truth(
        time_s=made.time_s, position_m=made.position_m - 7.0 * up, velocity_m_s=made.velocity_m_s
    )
    found = compare(made, truth)
    assert found.axes == ("east", "north", "up")
    np.testing.assert_allclose(found.error_m, np.tile([0.0, 0.0, 7.0], (40, 1)), atol=1e-6)
    np.testing.assert_allclose(found.speed_error_m_s, 0.0, atol=1e-6)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_positions_between_knots_are_hermite_polynomials(order):
    time = np.linspace(0.0, 4.0, 5)
    # Exact up to the degree 2 n - 1.
    path = np.polynomial.Polynomial(np.arange(1.0, 2 * order + 1))
    states = [np.repeat(path.deriv(i)(time)[:, None], 3, axis=1) for i in range(order)]
    found = Knots(**dict(zip(KNOT_FIELDS, [time, *states], strict=False)))
    between = np.array([0.3, 1.7, 3.9])
    position, velocity = found.at(between)
    np.testing.assert_allclose(position[:, 1], path(between), rtol=1e-12)
    if order > 1:
        np.testing.assert_allclose(velocity[:, 1], path.deriv()(between), rtol=1e-12)


def test_truth_outside_the_path_is_counted_and_left_out():
    truth = Truth(time_s=np.array([-5.0, 2.0, 50.0]), position_m=np.zeros((3, 3)))
    found = compare(straight(), truth)
    assert (found.outside, found.time_s.tolist()) == (2, [2.0])


def test_truth_of_another_time_is_refused():
    truth = Truth(time_s=np.array([100.0, 110.0]), position_m=np.zeros((2, 3)))
    with pytest.raises(InputError, match=r"truth covers 100 to 110 s and the path 0 to 10 s"):
        compare(straight(), truth)


def test_a_resting_object_is_compared_at_all_times():
    made = results.from_track(make_track(frame="local", knots=1, order=1, outliers=0))
    truth = Truth(time_s=np.array([-9.0, 99.0]), position_m=made.position_m + [[3.0, 4.0, 0.0]] * 2)
    found = compare(made, truth)
    assert found.course_error_m is None
    assert found.figures()["position_m"]["rmse"] == pytest.approx(5.0)


def test_covariance_that_is_none_gives_no_nees():
    path = straight(sigma=0.0)
    truth = Truth(time_s=path.knots.time_s, position_m=path.knots.position_m + 1.0)
    assert compare(path, truth).figures()["nees"]["mean"] is None


@pytest.mark.parametrize("frame", ["ecef", "local"])
def test_folder_and_lone_table_give_the_same(tmp_path, frame):
    results.save(make_track(frame=frame, truth=True), tmp_path / "out", pictures=False)
    truth = read_truth(tmp_path / "out")
    assert read_truth(tmp_path / "out" / "truth.csv").time_s.tolist() == truth.time_s.tolist()
    whole = compare(read_path(tmp_path / "out"), truth).figures()
    lone = tmp_path / "track.csv"
    lone.write_bytes((tmp_path / "out" / "track.csv").read_bytes())
    assert compare(read_path(lone), truth).figures() == whole


def test_truth_from_a_recording_that_has_none(tmp_path):
    (tmp_path / "recording.toml").write_text("format = 1\n")
    with pytest.raises(InputError):
        read_truth(tmp_path)


def test_the_folder_of_a_batch_is_not_one_path(tmp_path):
    (tmp_path / "batch.csv").write_text("name,status\n")
    with pytest.raises(InputError, match=r"results of several recordings; expected those of one"):
        read_path(tmp_path)


def test_rounding_of_a_height_that_is_given_is_shown_as_zero():
    track = results.from_track(make_track(frame="local", knots=5, order=2, outliers=0))
    truth = Truth(time_s=track.time_s, position_m=track.position_m + np.array([1.0, 2.0, 3e-29]))
    figures = compare(track, truth).figures()
    figures["components_m"]["z"] = {"rmse": 3e-29, "median": 3e-29, "max": 4e-29, "mean": -3e-29}
    (line,) = [row for row in comparison_text(figures).splitlines() if row.startswith("z (m)")]
    assert line.split()[2:] == ["0", "0", "0", "0"]
