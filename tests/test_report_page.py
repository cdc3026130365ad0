"""The page of results: what it holds, and how it behaves in a browser."""

from __future__ import annotations

import dataclasses
import json
import re
import tempfile
from html.parser import HTMLParser
from pathlib import Path

import browser
import numpy as np
import pytest
import solved_track
from made_track import make_track
from small_recordings import write_small

import geograph as gg
from geograph import results
from geograph.cli import main
from geograph.ellipsoids import ellipsoids
from geograph.report_page import facts, read_results, write_report
from geograph.report_page.graticule import graticule
from geograph.report_page.limits import Limits, limits_for, short, thinned
from geograph.report_page.page import page
from geograph.report_page.residual_charts import residual_charts
from geograph.report_page.scene import clocks, scene
from geograph.results import as_results

VICIOUS = """<b>"&'</script><script>document.title='taken'</script>"""
KINDS = {
    "ecef": {"truth": True, "moving": True},
    "static": {"frame": "local", "knots": 1, "order": 1, "outliers": 0, "truth": True},
    "large": {"sensors": 30, "knots": 20000, "status": "unobservable", "truth": True},
    "local": {"frame": "local", "order": 2, "drifting": False, "moving": True},
    "tiny": {"knots": 2, "sensors": 1},
}


class Markup(HTMLParser):
    """Checks that tags are closed in their order, and collects what a page holds."""

    EMPTY = ("meta", "link", "input")

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.data, self.words = [], [], [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        kind = self.tags[-1] if self.tags else ("", {})
        if self.open[-1:] == ["script"] and kind[1].get("type") == "application/json":
            self.data.append(json.loads(data))
        elif self.open and self.open[-1] not in ("script", "style"):
            self.words.append(data)


def renamed(made, name):
    """Return results whose recording, first sensor and texts have another name."""
    first = made.sensors[0].sensor

    def new(entry):
        return dataclasses.replace(entry, sensor=name) if entry.sensor == first else entry

    residuals = dataclasses.replace(
        made.residuals,
        sensor=np.where(made.residuals.sensor == first, name, made.residuals.sensor),
        emission=np.full(len(made.residuals), name),
    )
    return dataclasses.replace(
        made,
        name=name,
        sensors=tuple(map(new, made.sensors)),
        errors=tuple(map(new, made.errors)),
        curves=tuple(map(new, made.curves)),
        residuals=residuals,
        summary={
            **made.summary,
            "message": name,
            "command": name,
            "weakly_observed": [name],
            "flagged_sensors": [name],
            "versions": {name: name},
            "settings": {"motion": name},
            "motion": name,
            "hypotheses": [{"position_m": [name], "weight": name, "time_s": 1.0, "sigma_m": 2.0}],
            "directions": [{"time_s": 1.0, "name": name, "sigma_m": 3.0, "weak": True}],
            "gaussian": {"reason": name},
            "interpolation": {"message": name},
        },
    )


@pytest.mark.parametrize("kind", KINDS)
def test_page_of_every_shape_is_sound_and_small(kind):
    text = page([as_results(make_track(**KINDS[kind]))], command="geograph report a -o b")
    found = Markup(text)
    assert len(text) < 1_500_000
    (data,) = found.data
    places = [int(a["data-chart"]) for _, a in found.tags if "data-chart" in a]
    assert places == list(range(len(data["charts"])))
    for chart in data["charts"]:
        assert chart["layers"]
        for layer in chart["layers"]:
            if "x" in layer:
                assert {len(layer[k]) for k in ("x", "y", "low", "high") if k in layer} == {
                    len(layer["x"])
                }
    frames = data["scene"]["frames"]
    assert len({len(frames[k]) for k in ("time", "clock", "text")} | {len(frames["xyz"][0])}) == 1
    assert "geograph report a -o b" in found.words


@pytest.mark.parametrize("kind", sorted(solved_track.RECORDINGS))
def test_page_of_every_kind_of_measurement(kind):
    made = solved_track.of(kind)
    found = Markup(page([made]))
    titles = {chart["title"] for chart in found.data[0]["charts"]}
    assert any(place.sensor in " ".join(titles) for place in made.sensors)
    assert "NEES" in titles


def test_nothing_is_loaded_and_only_the_own_script_may_run():
    found = Markup(page([as_results(make_track())]))
    for tag, attributes in found.tags:
        assert not {"src", "action", "onclick", "onload"} & set(attributes), tag
        assert attributes.get("href", "data:,") == "data:,"
    policies = [a["content"] for _, a in found.tags if "http-equiv" in a]
    assert len(policies) == 1
    assert policies[0].startswith("default-src 'none'")
    assert "script-src 'sha256-" in policies[0]


@pytest.mark.parametrize("local", [False, True])
def test_what_comes_from_a_recording_is_text_and_never_markup(local):
    made = as_results(make_track(frame="local" if local else "ecef", truth=True))
    plain_tags = [tag for tag, _ in Markup(page([made, made], command="x")).tags]
    vicious = renamed(made, VICIOUS)
    text = page([vicious, vicious], command=VICIOUS)
    found = Markup(text)
    assert VICIOUS not in text
    assert "document.title='taken'</script>" not in text
    assert sum(VICIOUS in words for words in found.words) > 10
    assert found.data[0]["scene"]["sensors"][0]["name"] == VICIOUS
    # No more scripts, no tag that is not there without the name.
    assert {tag for tag, _ in found.tags} == set(plain_tags)
    assert [t for t, _ in found.tags].count("script") == plain_tags.count("script")


def test_summary_of_any_shape_gives_a_page():
    made = as_results(make_track())
    summary = dict.fromkeys(made.summary, 7) | {"epoch": None}
    for other in (summary, {}):
        Markup(page([dataclasses.replace(made, summary=other)]))
    still = as_results(make_track(frame="local", knots=1, order=1))
    for span in (7, [0.0], ["a", "b"]):
        Markup(page([dataclasses.replace(still, summary={"time_span_s": span})]))


def test_bearings_without_elevation_and_sensors_without_errors_have_a_page():
    made = as_results(make_track())
    level = made.residuals.where(made.residuals.kind == "azimuth")
    found = Markup(page([dataclasses.replace(made, residuals=level, errors=(), curves=())]))
    shown = {layer.get("label") for chart in found.data[0]["charts"] for layer in chart["layers"]}
    assert "azimuth" in shown
    assert "elevation" not in shown
    assert any("No errors of sensors are estimated" in words for words in found.words)
    none = made.residuals.where(np.zeros(len(made.residuals), dtype=bool))
    Markup(page([dataclasses.replace(made, residuals=none)]))


def test_covariance_that_is_not_finite_is_not_drawn():
    made = as_results(make_track(truth=True))
    covariance = made.position_covariance_m2.copy()
    covariance[3:6] = np.inf
    found = Markup(page([dataclasses.replace(made, position_covariance_m2=covariance)]))
    entries = np.array(found.data[0]["scene"]["frames"]["covariance"], dtype=float)
    lost = np.isnan(entries)
    assert 0 < lost[0].sum() < entries.shape[1]
    assert (lost == lost[0]).all()


def test_scene_has_the_path_where_it_is():
    made = as_results(make_track(frame="local"))
    shown = scene(made, Limits())
    frames = shown["frames"]
    np.testing.assert_allclose(
        np.array(frames["xyz"])[:, [0, -1]].T, made.position_m[[0, -1]], atol=0.01
    )
    drawn = np.array(shown["ellipsoids"]["covariance"])[:, 0]
    size = ellipsoids(made.position_m, made.position_covariance_m2, 0.95).semi_axes_m[0]
    turned = np.array([drawn[[0, 1, 2]], drawn[[1, 3, 4]], drawn[[2, 4, 5]]])
    # RADIUS_SPACE of the page's script.
    script = (Path(gg.__file__).parent / "report_page/assets/1-draw.js").read_text()
    radius = float(re.search(r"RADIUS_SPACE = ([0-9.]+)", script)[1])
    np.testing.assert_allclose(
        np.sort(radius * np.sqrt(np.linalg.eigvalsh(turned)))[::-1], size, rtol=1e-6
    )


def test_graticule_lies_around_what_is_shown_across_the_date_line():
    from geograph.geodesy import ecef_from_geodetic, geodetic_from_ecef

    around = ecef_from_geodetic(np.array([10.0, 12.0]), np.array([179.5, -179.0]), np.zeros(2))
    lines = graticule(around)
    assert len(lines) < 20
    assert "180°" in {name for name, _ in lines}
    for _, points in lines:
        np.testing.assert_allclose(geodetic_from_ecef(points)[:, 2], 0.0, atol=1e-3)


def test_residuals_are_thinned_but_not_the_rejected():
    made = as_results(make_track(sensors=30, outliers=20))
    charts, drawn, left = residual_charts(made, Limits(residuals=2500, panels=25))
    assert (drawn, left) == (25 * 100, 5)
    shown = {chart["title"] for chart in charts}
    lost = made.residuals.where(made.residuals.rejected)
    crossed = sum(
        len(layer["x"])
        for chart in charts
        for layer in chart["layers"]
        if layer.get("marker") == "x"
    )
    assert crossed == sum(sensor in shown for sensor in lost.sensor.tolist())
    text = page([as_results(make_track(sensors=30, knots=20000, outliers=20))])
    assert "To stay small the page draws about 1000 of 20000 knots" in text


def test_outliers_are_named_once_the_greatest_first():
    made = as_results(make_track(outliers=5))
    sheet = facts.outlier_sheet(made, Limits())
    assert len(sheet.rows) == 5
    lines = {str(entry["line"]) for entry in made.summary["rejected"]}
    assert {row[3] for row in sheet.rows} == lines
    size = [abs(float(row[5])) for row in sheet.rows]
    assert size == sorted(size, reverse=True)
    assert facts.outlier_sheet(made, Limits(rows=2)).left_out == 3


def test_times_that_rounding_made_negative_are_zero():
    made = as_results(make_track(frame="local"))
    assert clocks(made, np.array([-4e-10, 1.5])) == ["0.000 s", "1.500 s"]
    made.summary["directions"] = [{"time_s": -4e-10, "name": "x", "sigma_m": 1.0}]
    assert facts.direction_sheet(made).rows[0][0] == "0"


def test_pages_of_many_share_one_size():
    made = as_results(make_track(sensors=8, knots=2000))
    alone, many = len(page([made])), len(page([made] * 30))
    assert many < 30 * alone / 2
    assert limits_for(1) == Limits()


def test_short_numbers_and_thinned_lines_keep_what_counts():
    assert short(np.array([np.inf, 12345678.0]), 5) == [None, 12346000.0]
    values = np.sin(np.linspace(0.0, 40.0, 20001))
    values[7000] = np.nan
    rows = thinned(values, 500)
    assert rows.size <= 502
    assert {0, 20000} <= set(rows.tolist())
    assert np.nanmax(values[rows]) == np.nanmax(values)


def test_command_writes_a_page_once_and_says_what_is_wrong(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    results.save(make_track(truth=True), "out", pictures=False)
    assert main(["report", "out", "-o", "page.html"]) == 0
    assert capsys.readouterr().out == "wrote page.html\n"
    text = Path("page.html").read_text(encoding="utf-8")
    assert "geograph report out -o page.html" in text
    Path("page.html").write_text("mine")
    assert main(["report", "out", "-o", "page.html"]) == 2
    assert "page.html: is there already; give --overwrite" in capsys.readouterr().err
    assert Path("page.html").read_text() == "mine"
    assert main(["report", "out", "-o", "page.html", "--overwrite"]) == 0
    assert Path("page.html").read_text(encoding="utf-8") == text.replace(
        "page.html<", "page.html --overwrite<"
    )
    capsys.readouterr()
    Path("out/track.csv").write_text("time_s\n1\n")
    for folder in ("out", "nowhere"):
        assert main(["report", folder, "-o", "new.html"]) == 2
        error = capsys.readouterr().err
        assert error.startswith("geograph: error: " + folder)
        assert error.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "page.html"]


def test_folder_of_several_gives_one_page_of_all(tmp_path, capsys):
    for name in ("first", "second"):
        write_small(tmp_path / name, seed=len(name))
    sources = [str(tmp_path / name) for name in ("first", "second")]
    assert main(["smooth", *sources, "-o", str(tmp_path / "out"), "--jobs", "1", "--no-plots"]) == 0
    assert [one.name for one in read_results(tmp_path / "out")] == ["first", "second"]
    assert main(["report", str(tmp_path / "out"), "-o", str(tmp_path / "all.html")]) == 0
    found = Markup((tmp_path / "all.html").read_text(encoding="utf-8"))
    articles = [attributes for tag, attributes in found.tags if tag == "article"]
    assert [("hidden" in attributes) for attributes in articles] == [False, True]
    capsys.readouterr()


def test_too_many_or_none_are_refused(tmp_path):
    made = as_results(make_track(knots=2, sensors=1))
    for several in ([], [made] * 61):
        with pytest.raises(gg.InputError, match="expected 1 to 60"):
            write_report(several, tmp_path / "page.html")
    (tmp_path / "batch.csv").write_text("recording\n")
    with pytest.raises(gg.InputError, match="holds no results"):
        read_results(tmp_path)
    assert not (tmp_path / "page.html").exists()


# In a browser. Skipped where the machine has none, and only there.
needs_browser = pytest.mark.skipif(browser.found() is None, reason="no Chromium on this machine")


@pytest.fixture(scope="module")
def window():
    with tempfile.TemporaryDirectory() as folder, browser.page(folder) as shown:
        yield shown


def clean(window):
    """Check that the page complained of nothing and asked the network for nothing."""
    assert not window.complaints, window.complaints
    assert all(url.startswith(("file:", "data:", "about:")) for url in window.requests)


STATE = """(() => { const article = document.querySelector('article:not([hidden])');
const object = article.querySelector('svg.map .object');
return { frame: article.dataset.frame, x: Number(object.dataset.x), y: Number(object.dataset.y),
  clock: article.querySelector('[data-part=clock]').textContent,
  picture: article.querySelector('canvas').toDataURL(),
  wide: document.documentElement.scrollWidth,
  charts: article.querySelectorAll('svg.chart').length,
  places: article.querySelectorAll('[data-chart]').length }; })()"""
MOVE = """(() => { const slider = document.querySelector('[data-part=time]');
slider.value = slider.max; slider.dispatchEvent(new Event('input', { bubbles: true })); })()"""


@needs_browser
@pytest.mark.parametrize("width", [1400, 390])
def test_slider_moves_the_object_and_nothing_complains(window, tmp_path, width):
    made = as_results(make_track(frame="local", truth=True, moving=True))
    write_report(made, tmp_path / "page.html")
    window.open(tmp_path / "page.html", width=width, touch=width < 500)
    before = window.evaluate(STATE)
    assert before["wide"] == width
    assert before["charts"] == before["places"] > 5
    np.testing.assert_allclose([before["x"], before["y"]], made.position_m[0, :2], atol=0.01)
    window.evaluate(MOVE)
    after = window.evaluate(STATE)
    np.testing.assert_allclose([after["x"], after["y"]], made.position_m[-1, :2], atol=0.01)
    assert after["picture"] != before["picture"]
    assert (before["clock"], after["clock"]) == ("0.000 s", "8.000 s")
    clean(window)


@needs_browser
def test_view_turns_and_buttons_choose_what_is_shown(window, tmp_path):
    write_report(make_track(), tmp_path / "page.html")
    window.open(tmp_path / "page.html", width=1400)
    before = window.evaluate(STATE)["picture"]
    box = window.evaluate(
        "(() => { const b = document.querySelector('canvas').getBoundingClientRect();"
        " return [b.x + b.width / 2, b.y + b.height / 2]; })()"
    )
    window.drag(box, [box[0] + 90, box[1] + 20])
    turned = window.evaluate(STATE)["picture"]
    assert turned != before
    window.evaluate("document.querySelector('button[data-view=space][data-all=true]').click()")
    assert window.evaluate(STATE)["picture"] != turned
    clean(window)


@needs_browser
@pytest.mark.parametrize("kind", KINDS)
def test_every_shape_is_drawn_without_complaint(window, tmp_path, kind):
    made = renamed(as_results(make_track(**KINDS[kind])), VICIOUS)
    write_report([made, made], tmp_path / "page.html", command=VICIOUS)
    window.open(tmp_path / "page.html", width=800)
    state = window.evaluate(STATE)
    assert state["charts"] == state["places"] > 0
    window.evaluate("document.querySelector('button[data-result=\"1\"]').click()")
    window.settle()
    assert window.evaluate(STATE)["charts"] == state["places"]
    assert window.evaluate("document.title") == "2 recordings - geograph"
    assert window.evaluate("[...document.querySelectorAll('article')].map((a) => a.hidden)") == [
        True,
        False,
    ]
    clean(window)


@needs_browser
def test_page_prints(window, tmp_path):
    write_report(make_track(truth=True), tmp_path / "page.html")
    window.open(tmp_path / "page.html", width=1400)
    printed = window.pdf()
    assert printed.startswith(b"%PDF")
    window.call("Emulation.setEmulatedMedia", media="print")
    shown = "getComputedStyle(document.querySelector('.slider')).display"
    assert window.evaluate(shown) == "none"
    window.call("Emulation.setEmulatedMedia", media="")
    clean(window)
