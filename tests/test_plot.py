"""Pictures: drawn for every shape of result, and of the numbers that they claim to show."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest
from made_track import make_track
from matplotlib.image import imread

from geograph import plot, results
from geograph.plot import _style as look
from geograph.plot._ground import sight_lines
from geograph.plot._plane import length_unit, plane_of
from geograph.units import fitting_unit


def test_names_are_drawn_as_they_are(tmp_path):
    with look.style():
        figure = look.new_figure(3.0, 3.0)
        text = figure.text(0.5, 0.5, "cost: $3 and 5$, 日本")
        figure.savefig(tmp_path / "names.png")
    assert not text.get_parse_math()


@pytest.mark.parametrize(("start", "offset"), [(0.0, ""), (16.0, ""), (1e9, "+1e9")])
def test_times_show_their_common_digits_once(start, offset):
    with look.style():
        figure = look.new_figure(3.0, 3.0)
        ax = figure.subplots()
        ax.plot([start, start + 20.0], [0.0, 1.0])
        look.label_time(ax, "time (s)")
        figure.canvas.draw()
    assert ax.xaxis.get_offset_text().get_text() == offset


@pytest.mark.parametrize(
    "options",
    [
        {"truth": True},
        {"frame": "local", "knots": 1, "order": 1, "outliers": 0, "truth": True},
        {"sensors": 30, "knots": 20000, "status": "unobservable"},
        {"frame": "local", "order": 2, "drifting": False, "moving": True},
        {"knots": 2, "sensors": 1},
    ],
    ids=["ecef", "static", "large", "local", "tiny"],
)
def test_all_pictures_are_drawn(tmp_path, options):
    track = make_track(**options)
    written = plot.save_all(track, tmp_path)
    # At rest there is no course of a height, nor a speed.
    lost = {"speed.png", "height.png"} if track.velocity_m_s is None else set()
    wanted = set(plot.PICTURES) - lost
    assert {path.name for path in tmp_path.iterdir()} == wanted
    assert {path.name for path in written} == wanted
    for path in written:
        assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
        assert path.stat().st_size > 8000


def test_pictures_of_states_that_are_not_determined(tmp_path):
    track = make_track(status="unobservable")
    track.covariance[3:6] = np.inf
    track.covariance[8] = np.nan
    assert len(plot.save_all(results.from_track(track), tmp_path)) == len(plot.PICTURES)


def test_pictures_from_files_are_those_from_the_track(tmp_path):
    track = make_track(truth=True)
    results.save(track, tmp_path / "out")
    again = tmp_path / "again"
    again.mkdir()
    plot.save_all(results.load(tmp_path / "out"), again)
    for name in plot.PICTURES:
        first, second = (imread(folder / name) for folder in (tmp_path / "out", again))
        assert first.shape == second.shape
        # The layout engine may place axes differently by less than a pixel.
        assert np.abs(first - second).mean() < 0.02, name


def line(ax, label):
    (found,) = (entry for entry in ax.get_lines() if entry.get_label() == label)
    return np.asarray(found.get_xdata()), np.asarray(found.get_ydata())


def test_path_is_drawn_in_kilometres_east_and_north_to_one_scale():
    track = make_track()
    ax = plot.path(track)
    east, north = line(ax, "path")
    made = results.from_track(track)
    middle = made.position_m[made.time_s.size // 2]
    level = (made.position_m - middle) @ made.level_axes()[made.time_s.size // 2].T / 1000.0
    # Thirteen points a knot, so that the line is smooth.
    np.testing.assert_allclose(east[::13], level[:, 0], atol=1e-6)
    np.testing.assert_allclose(north[::13], level[:, 1], atol=1e-6)
    assert ax.get_xlabel().endswith("(km)")
    assert "° N" in ax.get_ylabel()
    assert ax.get_aspect() == 1.0


def test_height_and_speed_bands_are_of_95_percent():
    track = make_track(sigma_m=500.0)
    made = results.from_track(track)
    for ax, value, sigma in (
        (plot.height(track), made.height_m(), np.sqrt(made.level_covariance_m2()[:, 2, 2])),
        (plot.speed(track), made.speed_m_s, made.sigma_speed_m_s),
    ):
        (band,) = ax.collections
        vertices = band.get_paths()[0].vertices
        assert vertices[:, 1].max() == pytest.approx(
            ((value + 1.96 * sigma) / 1000).max(), rel=1e-4
        )
        assert vertices[:, 1].min() == pytest.approx(
            ((value - 1.96 * sigma) / 1000).min(), rel=1e-4
        )
        assert "(km" in ax.get_ylabel()


def test_rejected_measurements_are_crossed_out_and_stay_on_the_picture():
    track = make_track(outliers=3)
    ax = plot.residuals(track)
    time, value = line(ax, "rejected")
    assert time.size == 6
    low, high = ax.get_ylim()
    assert ((value >= low) & (value <= high)).all()


def test_sensor_errors_beyond_three_sigmas_are_in_the_alarm_colour():
    ax = plot.sensor_errors(make_track())
    labels = [text.get_text() for text in ax.get_yticklabels()]
    assert labels[0].startswith("CAM01 clock offset  +3.6 ± 0.02 s")
    colours = [bar.lines[0].get_color() for bar in ax.containers]
    assert colours[0] == look.ALARM
    assert set(colours[1:]) == {look.BLUE}


def test_sensors_without_errors_are_said_to_be_perfect(tmp_path):
    track = make_track(drifting=False)
    track.sensor_errors.clear()
    assert len(plot.save_all(track, tmp_path)) == len(plot.PICTURES)
    (note,) = plot.sensor_errors(track).texts
    assert note.get_text() == "no errors of sensors are estimated"


def test_error_curves_have_a_line_for_each_sensor():
    ax = plot.sensor_error_curves(make_track(sensors=4), kind="azimuth")
    assert [entry.get_label() for entry in ax.get_lines()] == [f"CAM{i:02d}" for i in range(4)]


def test_headline_names_recording_and_status():
    bad = plot.overview(make_track(name="pass 7", status="unobservable"))
    assert bad.get_suptitle().startswith("pass 7, UNOBSERVABLE")
    assert plot.overview(make_track()).get_suptitle().startswith("made, converged")


@pytest.mark.parametrize("frame", ["ecef", "local"])
def test_sight_lines_have_the_measured_direction_and_meet_the_path(frame):
    made = results.from_track(make_track(frame=frame, outliers=2, knots=400))
    for place in made.sensors:
        start, end, rejected = sight_lines(made, place)
        np.testing.assert_allclose(start, np.broadcast_to(place.position_m, start.shape))
        time = made.residuals.of(place.sensor, "azimuth").time_s
        target = np.stack([np.interp(time, made.time_s, c) for c in made.position_m.T], axis=-1)
        miss = np.linalg.norm(end - target, axis=-1)
        distance = np.linalg.norm(target - start, axis=-1)
        # 3e-4 rad of noise, but 400 sigma = 0.12 rad in azimuth where rejected.
        assert (miss[~rejected] < 2e-3 * distance[~rejected]).all()
        assert (miss[rejected] > 0.05 * distance[rejected]).all()


def test_sight_lines_without_elevation_end_at_the_path():
    made = results.from_track(make_track(outliers=0))
    rows = made.residuals.of("CAM00", "azimuth")
    only = results.Results(**(vars(made) | {"residuals": rows}))
    start, end, _ = sight_lines(only, made.sensors[0])
    assert start.shape == end.shape == (len(rows), 3)


def test_ellipse_has_five_percent_of_a_normal_distribution_outside():
    covariance = np.array([[4.0, 1.5], [1.5, 2.0]])
    outline = look.ellipse_outline(covariance[None])[0]
    squared = np.einsum("ni,ij,nj->n", outline, np.linalg.inv(covariance), outline)
    np.testing.assert_allclose(squared, -2.0 * math.log(0.05), rtol=1e-12)


@pytest.mark.parametrize(("radius", "factor"), [(100.0, 1.0), (5.0, 5.0), (0.001, 20000.0)])
def test_small_ellipses_are_enlarged_by_round_factors(radius, factor):
    angle = np.linspace(0, 2 * np.pi, 61)
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)[None]
    assert look.magnification(ring, 1000.0) == pytest.approx(factor)


@pytest.mark.parametrize(
    ("unit", "value", "name"),
    [
        ("rad", 5e-6, "µrad"),
        ("rad", 1e-4, "arcsec"),
        ("rad", 6e-4, "arcmin"),
        ("rad", 0.1, "deg"),
        ("s", 3.6, "s"),
        ("s", 0.01, "ms"),
        ("m", 20.0, "m"),
        ("furlong", 1.0, "furlong"),
        ("rad", math.nan, "deg"),
    ],
)
def test_units_suit_the_values(unit, value, name):
    assert fitting_unit(unit, value).name == name


def test_plane_of_a_local_frame_is_its_own():
    made = results.from_track(make_track(frame="local"))
    np.testing.assert_array_equal(plane_of(made).project(made.position_m), made.position_m[:, :2])
    assert length_unit(300.0).name == "m"


def test_matplotlib_is_not_loaded_before_a_picture_is_drawn():
    code = (
        "import sys, geograph, geograph.results, geograph.plot, geograph.cli.app;"
        "assert 'matplotlib' not in sys.modules"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
