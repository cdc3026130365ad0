"""Pictures of arrivals and differences: no nonsense rays, scaled units, scales that suit."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import solved_track
from test_plot import line

from geograph import plot, results
from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.plot import _style as look
from geograph.plot._ground import draw_sensors_alone, sensors_crowded, sight_lines
from geograph.plot._platforms import platform_figure
from geograph.plot._residuals import residual_figure, residual_panels
from geograph.plot._time import draw_horizontal

PICTURES = {
    "far emitter": {"height.png", "speed.png"},
    "straight platforms": {"height.png", "speed.png"},
    "platforms": {"height.png", "speed.png"},
    "aircraft": set(),
    "microphones": set(),
    "flat microphones": {"height.png"},
    "satellites": {"height.png", "speed.png"},
}
"""Which pictures would say nothing."""


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", sorted(PICTURES))
def test_pictures_that_say_something_are_drawn(tmp_path, name):
    made = solved_track.of(name)
    written = plot.save_all(made, tmp_path)
    wanted = set(plot.PICTURES) - PICTURES[name]
    wanted |= {"platforms.png"} if made.platforms else set()
    assert {path.name for path in tmp_path.iterdir()} == wanted == {p.name for p in written}


def labels(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def names_on(ax):
    return [text.get_text() for text in ax.texts]


@pytest.mark.parametrize("name", ["far emitter", "aircraft", "flat microphones"])
def test_sensors_without_bearings_have_no_rays(name):
    made = solved_track.of(name)
    for place in made.sensors:
        start, end, rejected = sight_lines(made, place)
        assert start.shape == end.shape == (0, 3)
        assert rejected.shape == (0,)
    assert not {"bearings", "rejected bearings"} & set(labels(plot.path(made)))


def test_far_emitter_is_a_point_with_an_ellipse_to_a_scale_of_its_own():
    made = solved_track.of("far emitter")
    alone = plot.path(made, sensors=False)
    assert alone.get_xlabel() == "x (m)"
    x, y = line(alone, "position")
    np.testing.assert_allclose([x, y], made.position_m[:1, :2].T)
    assert "95 % ellipse" in labels(alone)
    (ring,) = (patch.get_xy() for patch in alone.patches)
    # Semi-axes of 95 % of a plane: sqrt(-2 ln 0.05) = 2.4477 sigmas.
    major = 2.4477 * np.sqrt(np.linalg.eigvalsh(made.position_covariance_m2[0, :2, :2])[1])
    reach = np.linalg.norm(ring - made.position_m[0, :2], axis=1).max()
    assert reach == pytest.approx(major, rel=1e-3)
    # The truth is one point, not a line of no length.
    assert [len(data) for data in line(alone, "truth")] == [1, 1]
    beside = plot.path(made)
    assert beside.get_xlabel() == "x (km)"
    assert any("drawn" in label for label in labels(beside))
    # Far sensors share a name, and have a panel of their own where each has its.
    assert sensors_crowded(made)
    assert names_on(beside) == ["4 sensors"]
    ax = look.axes_or_new(None)
    draw_sensors_alone(made, ax)
    assert names_on(ax) == ["S1", "S2", "S3", "S4"]
    assert not sensors_crowded(solved_track.of("aircraft"))


def test_ways_of_platforms_are_the_estimated_ones_with_the_fixes():
    made = solved_track.of("straight platforms")
    ax = look.axes_or_new(None)
    draw_sensors_alone(made, ax)
    assert "their fixes" in labels(ax)
    ways = [entry for entry in ax.get_lines() if len(entry.get_xdata()) > 100]
    assert len(ways) == 4
    for way, path in zip(ways, made.platforms, strict=True):
        drawn = np.stack([way.get_xdata(), way.get_ydata()], axis=1) * 1e3
        # Straight, which the fixes are not by metres.
        middle = drawn[len(drawn) // 2]
        np.testing.assert_allclose(middle, 0.5 * (drawn[0] + drawn[-1]), atol=1.0)
        np.testing.assert_allclose(drawn[0], path.position_m[0, :2], atol=1e-6)


@pytest.mark.parametrize(("name", "columns"), [("straight platforms", 2), ("platforms", 2)])
def test_fixes_stand_about_the_estimated_path(name, columns):
    made = solved_track.of(name)
    figure = platform_figure(made)
    assert len(figure.axes) == columns * len(made.platforms)
    for ax, axis in zip(figure.axes, "xyxyxyxy", strict=True):
        assert ax.get_ylabel() == f"{axis} (m)"
    time, error = line(figure.axes[0], "fixes")
    fixes = dict(zip(made.sensors[0].time_s, made.sensors[0].position_m, strict=True))
    estimate, _ = made.platforms[0].knots().at(time)
    np.testing.assert_allclose(error, [fixes[t][0] for t in time] - estimate[:, 0], atol=1e-9)


def test_many_platforms_on_the_earth_have_three_axes_and_a_limit():
    made, places = solved_track.of("aircraft"), []
    paths = []
    for index in range(9):
        place = dataclasses.replace(
            made.sensors[0],
            sensor=f"P{index}",
            time_s=made.time_s,
            position_m=made.position_m + np.array([3.0, 0.0, 0.0]),
        )
        places.append(place)
        paths.append(
            results.PlatformPath(
                sensor=place.sensor,
                time_s=made.time_s,
                position_m=made.position_m,
                velocity_m_s=made.velocity_m_s,
                position_covariance_m2=made.position_covariance_m2,
            )
        )
    many = dataclasses.replace(made, sensors=tuple(places), platforms=tuple(paths))
    figure = platform_figure(many)
    assert len(figure.axes) == 8 * 3
    assert "8 of 9" in figure.get_suptitle()
    assert [ax.get_ylabel().split()[0] for ax in figure.axes[:3]] == ["east", "north", "up"]
    level = [line(ax, "fixes")[1] for ax in figure.axes[:3]]
    # The offset put in has the same length on all axes together, in mm or m.
    scale = 1e-3 if "(mm)" in figure.axes[0].get_ylabel() else 1.0
    np.testing.assert_allclose(scale * np.linalg.norm(level, axis=0), 3.0, rtol=1e-6)


def test_residuals_in_seconds_are_scaled_and_have_metres_beside_them():
    made = solved_track.of("aircraft")
    figure = residual_figure(made)
    left = figure.axes[0]
    assert left.get_title() == f"R1: {len(made.residuals.of('R1'))} arrival times"
    assert left.get_ylabel() == "residual (ns)"
    time, value = line(left, "arrival time")
    rows = made.residuals.of("R1")
    np.testing.assert_allclose(value, rows.residual * 1e9)
    np.testing.assert_array_equal(time, rows.time_s)
    figure.canvas.draw()
    (right,) = (child for child in left.child_axes)
    assert right.get_ylabel() == "as range (m)"
    ratio = SPEED_OF_LIGHT_M_S * 1e-9
    np.testing.assert_allclose(right.get_ylim(), np.multiply(left.get_ylim(), ratio), rtol=1e-9)


def test_residuals_of_frequencies_have_no_metres():
    figure = residual_figure(solved_track.of("satellites"))
    titles = [ax.get_title() for ax in figure.axes if ax.get_title()]
    assert titles == ["S2 - S1: 60 time differences", "S2 - S1: 60 frequency differences"]
    frequency = figure.axes[2]
    assert frequency.get_ylabel() == "residual (mHz)"
    assert not frequency.child_axes
    assert figure.axes[-1].get_xlabel() == "time tag, by the reference's clock (s)"


def test_panels_are_of_one_pair_and_one_unit_each():
    made = solved_track.of("platforms")
    panels = residual_panels(made)
    assert [title for title, _ in panels] == [
        "P1",
        "P2",
        "P2 - P1",
        "P3",
        "P3 - P1",
        "P4",
        "P4 - P1",
    ]
    for title, rows in panels:
        assert set(rows.unit) == {"Hz" if "-" in title else "s"}
    assert sum(len(rows) for _, rows in panels) == len(made.residuals)
    grid = residual_panels(solved_track.of("flat microphones"))
    assert [title for title, _ in grid[:4]] == ["M2 - M1", "M2 - M1", "M3 - M1", "M3 - M1"]
    assert [str(rows.kind[0]) for _, rows in grid[:2]] == ["tdoa", "fdoa"]


def test_too_many_pairs_share_a_panel_for_each_sensor():
    made = solved_track.of("flat microphones")
    count = 48
    rows = made.residuals.where(np.arange(len(made.residuals)) < count)
    names = np.array([f"N{i}" for i in range(count)])
    pairs = dataclasses.replace(rows, sensor=np.repeat(names[:4], 12), reference=names)
    places = tuple(dataclasses.replace(made.sensors[0], sensor=name) for name in names)
    panels = residual_panels(dataclasses.replace(made, residuals=pairs, sensors=places))
    assert [title for title, _ in panels] == [f"N{i} - others" for i in range(4)]
    assert sum(len(rows) for _, rows in panels) == count


def test_the_last_panel_of_every_column_tells_the_time():
    figure = residual_figure(solved_track.of("flat microphones"))
    shown = [ax for ax in figure.axes if ax.axison]
    assert len(shown) == 10
    assert [bool(ax.get_xlabel()) for ax in shown] == [False] * 6 + [True] * 4


def test_clock_and_frequency_curves_have_their_units():
    ax = plot.sensor_error_curves(solved_track.of("aircraft"), kind="clock")
    assert ax.get_ylabel() == "clock error (ns)"
    assert [entry.get_label() for entry in ax.get_lines()] == ["R2", "R3", "R4", "R5"]
    ax = plot.sensor_error_curves(solved_track.of("satellites"), kind="frequency")
    assert ax.get_ylabel() in ("frequency error (Hz)", "frequency error (mHz)")


def test_rows_of_errors_have_no_powers_of_ten_and_no_recording():
    ax = plot.sensor_errors(solved_track.of("microphones"))
    texts = [text.get_text() for text in ax.get_yticklabels()]
    assert any(text.startswith("propagation speed  ") for text in texts)
    assert not [text for text in texts if "e+" in text or "(recording)" in text]


def test_a_given_height_gives_way_to_the_accuracy_over_ground():
    made = solved_track.of("flat microphones")
    assert made.height_held
    assert not solved_track.of("microphones").height_held
    ax = look.axes_or_new(None)
    draw_horizontal(made, ax)
    _, major = line(ax, "major semi-axis")
    expected = np.sqrt(np.linalg.eigvalsh(made.position_covariance_m2[:, :2, :2])[:, 1])
    unit = {"1-sigma ellipse over ground (mm)": 1e-3, "1-sigma ellipse over ground (m)": 1.0}
    np.testing.assert_allclose(major * unit[ax.get_ylabel()], expected)
    overview = plot.overview(made)
    shown = [ax.get_ylabel() for part in overview.subfigs for ax in part.axes]
    assert not any(label.startswith("z (") for label in shown)
    assert any(label.startswith("speed") for label in shown)


def test_overview_of_an_object_at_rest_tells_where_it_is():
    overview = plot.overview(solved_track.of("satellites"))
    texts = [text.get_text() for part in overview.subfigs for ax in part.axes for text in ax.texts]
    assert "CEP (50 %)" in texts
    assert any("° S" in text and "° E" in text for text in texts)
