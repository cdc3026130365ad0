"""The page: markup around texts, tables and the descriptions of pictures.

Whatever comes from a recording passes through :mod:`geograph.report_page.markup` on its way.
"""

from __future__ import annotations

import base64
import hashlib
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from geograph.report_page import charts, facts
from geograph.report_page.limits import limits_for
from geograph.report_page.markup import (
    escaped,
    left_out_note,
    script_data,
    section,
    sentence_list,
    table,
)
from geograph.report_page.residual_charts import residual_charts
from geograph.report_page.scene import scene
from geograph.results.facts import static_facts

if TYPE_CHECKING:
    from collections.abc import Sequence

    from geograph.report_page.limits import Limits
    from geograph.results import Results


def page(results: Sequence[Results], *, command: str | None = None) -> str:
    """Return the page of one result or of several, as HTML.

    Parameters
    ----------
    results
        At least one.
    command
        The command line that makes the page, to stand in it.
    """
    limits = limits_for(len(results))
    title = results[0].name if len(results) == 1 else f"{len(results)} recordings"
    body = [_overview(results)] if len(results) > 1 else []
    body += [_article(one, limits, command, hidden=bool(i)) for i, one in enumerate(results)]
    script = _asset("js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = (
        f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'; "
        "img-src data:"
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="geograph {escaped(_own_version())}">
<link rel="icon" href="data:,">
<title>{escaped(title)} - geograph</title>
<style>{_asset("css")}</style>
</head>
<body>
<main>
<noscript><section class="alarm">The pictures need JavaScript, which is off; the tables do not.
</section></noscript>
{"".join(body)}
<footer>Written by geograph {escaped(_own_version())}. The page loads nothing: it works without a
network. Bands, ellipses and ellipsoids hold 95 %.</footer>
</main>
<script>{script}</script>
</body>
</html>
"""


def _own_version() -> str:
    from geograph import __version__

    return __version__


def _asset(suffix: str) -> str:
    """Return the page's own files of a kind, in the order of their names."""
    folder = files("geograph.report_page") / "assets"
    names = sorted(entry.name for entry in folder.iterdir() if entry.name.endswith(f".{suffix}"))
    text = "".join((folder / name).read_text(encoding="utf-8") for name in names)
    return f'(() => {{\n"use strict";\n{text}}})();\n' if suffix == "js" else text


def _article(results: Results, limits: Limits, command: str | None, *, hidden: bool) -> str:
    """Return all of one result."""
    own_charts, shown = _Charts(), scene(results, limits)
    sections = [
        _where(results, len(shown["frames"]["time"])),
        _course(results, limits, own_charts),
        _errors(results, limits, own_charts),
        _residuals(results, limits, own_charts),
        _consistency(results, limits, own_charts),
        _observability(results),
        _made(results, limits, own_charts, command),
    ]
    data = script_data({"scene": shown, "charts": own_charts.made})
    return (
        f"<article{' hidden' if hidden else ''}>\n{_head(results)}\n"
        f"{''.join(sections)}\n"
        f'<script type="application/json">{data}</script>\n</article>\n'
    )


class _Charts:
    """Charts of one result, each of which gets a place in the page."""

    def __init__(self) -> None:
        self.made: list[dict[str, Any]] = []
        self.drawn_residuals = 0

    def places(self, found: list[dict[str, Any]]) -> str:
        first = len(self.made)
        self.made += found
        places = "".join(
            f'<figure data-chart="{first + index}"></figure>' for index in range(len(found))
        )
        return f'<div class="charts">{places}</div>' if found else ""


def _head(results: Results) -> str:
    good = results.status == "converged"
    word = escaped(results.status.replace("_", " "))
    status = f'<span class="status{"" if good else " bad"}">{word}</span>'
    message = results.summary.get("message")
    said = f"<p>{escaped(message)}</p>" if message and not good else ""
    flags = facts.sentences(results.summary, "flagged_sensors")
    weak = facts.sentences(results.summary, "weakly_observed")
    notes = [
        f"{len(flags)} {_count('remark', flags)} on sensors" if flags else "",
        f"{len(weak)} {_count('thing', weak)} weakly observed" if weak else "",
    ]
    note = "; ".join(part for part in notes if part)
    pairs = "".join(
        f"<div><dt>{escaped(name)}</dt><dd>{escaped(text)}</dd></div>"
        for name, text in facts.headline(results)
    )
    warned = f'<p class="alarm">{escaped(note)}: see Observability.</p>' if note else ""
    return (
        f"<header><section><h1>{escaped(results.name)} {status}</h1>{said}{warned}"
        f'<dl class="facts">{pairs}</dl></section></header>'
    )


def _count(word: str, things: Sequence[object]) -> str:
    return word if len(things) == 1 else f"{word}s"


def _where(results: Results, frames: int) -> str:
    whole = "true" if results.static else "false"
    views = _view("space", "In space", all_shown=whole) + _view(
        "map", "Map" if results.frame == "ecef" else "Plan", all_shown="true"
    )
    hidden = " hidden" if frames < 2 else ""
    slider = (
        f'<div class="slider"{hidden}><button type="button" data-part="play">Play</button>'
        f'<input type="range" min="0" max="{frames - 1}" step="1" value="0" data-part="time" '
        'aria-label="time"></div>'
    )
    reading = (
        '<p class="reading"><span class="clock" data-part="clock"></span> '
        '<span data-part="reading"></span></p>'
    )
    places = (
        _static_table(results) if results.static else table(facts.path_sheet(results), wide=True)
    )
    return section("Where it was", slider, reading, f'<div class="pair">{views}</div>', places)


def _view(part: str, title: str, *, all_shown: str) -> str:
    buttons = "".join(
        f'<button type="button" data-view="{part}" data-all="{value}" '
        f'aria-pressed="{"true" if value == all_shown else "false"}">{name}</button>'
        for value, name in (("true", "with sensors"), ("false", "object alone"))
    )
    zoom = "".join(
        f'<button type="button" data-zoom="{factor}" aria-label="{name}">{sign}</button>'
        for factor, name, sign in ((1.3, "nearer", "+"), (0.769, "farther", "\u2212"))
    )
    hint = (
        '<p class="note screen">Drag, or use the arrow keys, to turn.</p>'
        if part == "space"
        else ""
    )
    return (
        f'<figure><div class="tools"><h3>{title}</h3>{buttons}{zoom if part == "space" else ""}'
        f'</div><div data-part="{part}" data-all="{all_shown}"></div>{hint}</figure>'
    )


def _static_table(results: Results) -> str:
    rows = [list(pair) for pair in static_facts(results)]
    return table(facts.Sheet(head=["the object at rest", ""], rows=rows))


def _course(results: Results, limits: Limits, made: _Charts) -> str:
    found = charts.height_and_speed(results, limits)
    return section("Height and speed", made.places(found)) if found else ""


def _errors(results: Results, limits: Limits, made: _Charts) -> str:
    if not results.errors:
        said = "<p>No errors of sensors are estimated: all are taken as known.</p>"
        return section("Sensor errors", said)
    note = (
        '<p class="note">Measured = predicted + error. Bars: estimate with its 95 % interval in '
        "units of the prior's sigma; grey: the prior, one sigma; ticks: three. Coloured rows: more "
        "than three prior sigmas from zero.</p>"
    )
    found = charts.error_curves(results, limits)
    more = left_out_note(len(results.curves) - len(found), "errors over time", "sensor_errors.csv")
    over_time = (
        f"<h3>Over time: bias, drift and random walk together</h3>{made.places(found)}{more}"
        if found
        else '<p class="note">None of them changes with time.</p>'
    )
    found_errors = table(facts.error_sheet(results, limits), "sensors.csv")
    return section("Sensor errors", note, found_errors, over_time)


def _residuals(results: Results, limits: Limits, made: _Charts) -> str:
    found, made.drawn_residuals, left = residual_charts(results, limits)
    note = (
        '<p class="note">Measured less predicted, over its sigma. Crosses: rejected, the greatest '
        "named by its line in the recording's table (or its time). What lies beyond the edge is "
        "drawn at it.</p>"
    )
    outliers = facts.outlier_sheet(results, limits)
    named = (
        f"<h3>Rejected measurements</h3>{table(outliers, 'residuals.csv')}"
        if outliers.rows
        else "<p>No measurement was rejected.</p>"
    )
    return section(
        "Residuals of each sensor",
        note,
        made.places(found),
        left_out_note(left, "panels", "residuals.csv"),
        named,
    )


def _consistency(results: Results, limits: Limits, made: _Charts) -> str:
    found = charts.comparison_of(results)
    lines = "".join(f"<p>{escaped(line)}</p>" for line in facts.truth_lines(results, found))
    shown = [] if found is None else charts.consistency(found, results, limits)
    note = (
        '<p class="note">Squares of residuals over their sigmas, after the fit and without what '
        "was rejected, should be 1 on average; the share that the fit itself takes makes them "
        "smaller. Coloured: larger than 99 % of honest sensors of as many residuals.</p>"
    )
    return section(
        "Is it consistent?",
        lines,
        made.places([*shown, *charts.innovation_chart(results)]),
        "<h3>Each sensor</h3>",
        note,
        table(facts.sensor_sheet(results, limits), "summary.json"),
    )


def _observability(results: Results) -> str:
    summary = results.summary
    weak = facts.sentences(summary, "weakly_observed")
    parts = [
        sentence_list(weak)
        if weak
        else "<p>The measurements determine everything that was asked.</p>"
    ]
    flagged = facts.sentences(summary, "flagged_sensors")
    if flagged:
        parts.append(f"<h3>Sensors that are not what they claim</h3>{sentence_list(flagged)}")
    directions = facts.direction_sheet(results)
    if directions.rows:
        parts.append(f"<h3>Directions of the position</h3>{table(directions)}")
    curved = facts.table_of(summary, "gaussian").get("reason")
    if curved:
        parts.append(f"<p>Not Gaussian: {escaped(curved)}.</p>")
    hypotheses = facts.hypothesis_sheet(results)
    if hypotheses.rows:
        parts.append(f"<h3>Places that fit</h3>{table(hypotheses)}")
    between = facts.table_of(summary, "interpolation").get("message")
    if between:
        parts.append(f'<p class="note">Motion between knots: {escaped(between)}.</p>')
    return section("Observability", *parts)


def _made(results: Results, limits: Limits, made: _Charts, command: str | None) -> str:
    commands = [
        str(results.summary.get("command") or "(from Python)"),
        *([command] if command else []),
    ]
    shown = "".join(f"<pre>{escaped(one)}</pre>" for one in commands)
    sheets = (
        f'<div class="pair"><div>{table(facts.settings_sheet(results))}</div>'
        f"<div>{table(facts.versions_sheet(results))}</div></div>"
    )
    return section("How it was made", shown, sheets, _thinned(results, limits, made))


def _thinned(results: Results, limits: Limits, made: _Charts) -> str:
    """Tell what is not drawn whole."""
    said = []
    knots, count = results.time_s.size, len(results.residuals)
    if knots > limits.line:
        said.append(f"about {limits.line} of {knots} knots")
    if made.drawn_residuals < count:
        said.append(f"{made.drawn_residuals} of {count} residuals")
    if len(results.sensors) > limits.sensors:
        said.append(f"{limits.sensors} of {len(results.sensors)} sensors on the map")
    if results.truth is not None and results.truth.time_s.size > limits.line:
        said.append(f"about {limits.line} of {results.truth.time_s.size} points of the truth")
    if not said:
        return ""
    return (
        f'<p class="note">To stay small the page draws {escaped(", ".join(said))}; its figures '
        "count all, and the results' own files hold all.</p>"
    )


def _overview(results: Sequence[Results]) -> str:
    """Return the table of all results, and what chooses the one that is shown."""
    options = "".join(
        f'<option value="{index}">{escaped(one.name)}</option>' for index, one in enumerate(results)
    )
    rows = []
    for index, one in enumerate(results):
        good = one.status == "converged"
        cells = [
            one.status.replace("_", " "),
            f"{facts.number(one.summary.get('chi2'))} / "
            f"{facts.number(one.summary.get('degrees_of_freedom'))}",
            facts.number(one.summary.get("measurements")),
            str(len(facts.entries(one.summary, "rejected"))),
        ]
        rows.append(
            f"<tr{'' if good else ' class=surprising'}><td><button type=button "
            f'data-result="{index}">{escaped(one.name)}</button></td>'
            + "".join(f"<td>{escaped(cell)}</td>" for cell in cells)
            + "</tr>"
        )
    count = sum(one.status == "converged" for one in results)
    return section(
        f"{len(results)} recordings, {count} converged",
        '<div class="scroll"><table><thead><tr><th>recording</th><th>status</th>'
        "<th>chi2 / degrees of freedom</th><th>measurements</th><th>rejected</th></tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table></div>",
        '<p class="screen"><label>Shown below: '
        f'<select id="chooser">{options}</select></label></p>',
    )
