"""The live picture: drawn of every state, not too often, in a file or a window."""

from __future__ import annotations

import time
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import pyplot as plt
from matplotlib.image import imread
from small_recordings import write_small
from stand_in_engine import StandInEstimate

from geograph.io.reader import read_setup
from geograph.plot import live


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return read_setup(write_small(tmp_path_factory.mktemp("live") / "small"))


def estimate(moment):
    found = SimpleNamespace(estimate=0.1, sigma=0.2, prior_sigma=0.4)
    return StandInEstimate(
        moment,
        np.array([1000.0 + 60.0 * moment, 1500.0, 800.0, 60.0, 0.0, 0.0]),
        np.eye(6) * 4.0,
        "tracking",
        "",
        sensor_errors={"A": {"azimuth_bias": found}},
    )


def test_it_is_drawn_before_and_after_the_start_and_no_more_often_than_asked(
    recording, tmp_path, monkeypatch
):
    now, drawn = [0.0], []
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    picture = live.LivePicture(recording, path=tmp_path / "p.png", every_s=2.0)
    real = picture.draw
    monkeypatch.setattr(picture, "draw", lambda: (drawn.append(now[0]), real()))
    picture.show(StandInEstimate(None, None, None, "collecting", "two bearings are needed"))
    for step in range(1, 6):
        now[0] = float(step)
        picture.show(estimate(now[0]))
    assert drawn == [0.0, 2.0, 4.0]
    assert [path.name for path in tmp_path.iterdir()] == ["p.png"]
    assert imread(tmp_path / "p.png").shape[:2] == (650, 1300)


def test_the_path_is_thinned_out_rather_than_kept_for_ever(recording, tmp_path, monkeypatch):
    monkeypatch.setattr(live, "_MOST_KNOTS", 16)
    picture = live.LivePicture(recording, path=tmp_path / "p.png", every_s=1e9)
    for step in range(200):
        picture.show(estimate(float(step)))
    assert len(picture._time) <= 16
    assert len(picture._time) == len(picture._position) == len(picture._semi_axes)
    assert (picture._time[0], picture._time[-1]) == (0.0, 199.0)


def test_a_window_that_is_closed_stops_nothing(recording, monkeypatch):
    figure = plt.figure()
    monkeypatch.setattr(live, "_open_window", lambda: figure)
    picture = live.LivePicture(recording, every_s=0.0)
    assert picture.path is None
    picture.show(estimate(1.0))
    assert len(figure.axes) == 3
    plt.close(figure)
    picture.draw()
    picture.draw()
    assert picture._window is None


@pytest.mark.parametrize("named", ["", "agg"])
def test_without_a_display_there_is_no_window(monkeypatch, named):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("MPLBACKEND", named)
    with mpl.rc_context():
        plt.switch_backend("agg")
        assert live._open_window() is None
    assert not plt.get_fignums()
