"""Texts and tables of a page, as plain strings: nothing here knows of markup."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.report_page.scene import clocks, readings, time_span
from geograph.results.facts import estimate_text, length_text, rounded, stage_text
from geograph.states import RECORDING_NAME
from geograph.units import fitting_unit

if TYPE_CHECKING:
    from collections.abc import Sequence

    from geograph.compare import Comparison
    from geograph.report_page.limits import Limits
    from geograph.results import ResidualTable, Results

_TAIL = 0.005


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """A table of texts.

    Parameters
    ----------
    head
        Names of the columns; those that end in ``>`` are of numbers, set to the right.
    rows
        The texts.
    marked
        Which rows are surprising.
    bars
        For each row an estimate and half its 95 % interval in prior sigmas, drawn as a bar in a
        column of its own; empty: no such column.
    left_out
        How many rows more there are.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    marked: frozenset[int] = frozenset()
    bars: Sequence[tuple[float, float]] = field(default=())
    left_out: int = 0


def number(value: Any, digits: int = 4) -> str:
    """Return a number of a summary as a text; ``?`` for what is none."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return "?"
    return rounded(float(value), digits) if isinstance(value, float) else str(value)


def entries(summary: dict[str, Any], key: str) -> list[dict[str, Any]]:
    """Return the tables of a list in a summary, which may be edited by hand: no other things."""
    value = summary.get(key)
    return [entry for entry in value if isinstance(entry, dict)] if isinstance(value, list) else []


def sentences(summary: dict[str, Any], key: str) -> list[str]:
    """Return the sentences of a list in a summary."""
    value = summary.get(key)
    return [str(entry) for entry in value] if isinstance(value, list) else []


def table_of(summary: dict[str, Any], key: str) -> dict[str, Any]:
    """Return a table in a summary; empty if there is none."""
    value = summary.get(key)
    return value if isinstance(value, dict) else {}


def headline(results: Results) -> list[tuple[str, str]]:
    """Return names and texts of what is said first."""
    facts = results.summary
    first, last = time_span(results)
    texts = [
        (
            "fit, chi2 / degrees of freedom",
            f"{number(facts.get('chi2'))} / {number(facts.get('degrees_of_freedom'))}",
        ),
        ("measurements", number(facts.get("measurements"))),
        ("rejected", str(len(entries(facts, "rejected")))),
        ("sensors", str(len(results.sensors))),
        ("time spanned", f"{last - first:.4g} s"),
        ("knots", str(results.time_s.size)),
        ("motion", str(facts.get("motion", "?")).replace("-", " ")),
        ("iterations", number(facts.get("iterations"))),
    ]
    if facts.get("epoch"):
        texts.append(("epoch", str(facts["epoch"]).replace("T", " ").replace("+00:00", " UTC")))
    texts.append(("frame", "Earth-fixed (WGS 84)" if results.frame == "ecef" else "local"))
    return texts


def path_sheet(results: Results) -> Sheet:
    """Return where the object was at the start, the middle and the end of its path."""
    time = results.time_s[sorted({0, results.time_s.size // 2, results.time_s.size - 1})]
    labels = ["start", "middle", "end"] if time.size == 3 else ["start", "end"][: time.size]
    moving = results.velocity_m_s is not None
    rows = [
        [label, clock, where, *([fast] if moving else []), sigma]
        for label, clock, (where, fast, sigma) in zip(
            labels, clocks(results, time), readings(results, time), strict=True
        )
    ]
    return Sheet(
        head=["", "time", "position", *(["speed"] if moving else []), "1 sigma"], rows=rows
    )


def sensor_sheet(results: Results, limits: Limits) -> Sheet:
    """Return how well each sensor fits: its residuals in numbers."""
    from scipy.special import chdtri

    rows: list[list[str]] = []
    marked: set[int] = set()
    sensors = [place.sensor for place in results.sensors]
    facts = table_of(results.summary, "sensors")
    reference = any(_entry(facts, name).get("as_reference") for name in sensors)
    for sensor in sensors[: limits.rows]:
        own = results.residuals.of(sensor)
        used = own.normalised[~own.rejected]
        lost = int(own.rejected.sum())
        row = [sensor, str(len(own)), str(lost)]
        if reference:
            row.append(str(_entry(facts, sensor).get("as_reference", "")))
        if used.size:
            square = float(np.mean(used**2))
            low, high = (chdtri(used.size, tail) / used.size for tail in (1.0 - _TAIL, _TAIL))
            row += [f"{square:.3g}", f"{low:.2f} to {high:.2f}"]
            if square > high:
                marked.add(len(rows))
        else:
            row += ["-", "-"]
        rows.append(row)
    head = ["sensor", "residuals>", "rejected>", *(["as reference>"] if reference else [])]
    return Sheet(
        head=[*head, "mean square of residual / sigma>", "99 % of honest ones>"],
        rows=rows,
        marked=frozenset(marked),
        left_out=max(len(sensors) - limits.rows, 0),
    )


def _entry(facts: dict[str, Any], name: str) -> dict[str, Any]:
    entry = facts.get(name)
    return entry if isinstance(entry, dict) else {}


def outlier_sheet(results: Results, limits: Limits) -> Sheet:
    """Return the rejected measurements by name, the greatest first; of a direction one residual."""
    rows = results.residuals.where(results.residuals.rejected)
    size = np.where(np.isfinite(rows.normalised), np.abs(rows.normalised), np.inf)
    names = (rows.sensor, rows.reference, rows.emission, rows.time_s, rows.line)
    greatest: dict[tuple[Any, ...], int] = {}
    for row in np.argsort(-size, kind="stable").tolist():
        greatest.setdefault(tuple(column[row] for column in names), row)
    order = list(greatest.values())
    shown = [_outlier(rows, row) for row in order[: limits.rows]]
    return Sheet(
        head=["sensor", "what", "time tag (s)>", "line>", "residual>", "in sigmas>"],
        rows=shown,
        left_out=max(len(order) - limits.rows, 0),
    )


_KIND_NAMES = {"toa": "arrival time", "tdoa": "time difference", "fdoa": "frequency difference"}


def _outlier(rows: ResidualTable, row: int) -> list[str]:
    kind = str(rows.kind[row])
    what = _KIND_NAMES.get(kind, kind)
    if rows.emission[row]:
        what += f" of {rows.emission[row]}"
    if rows.reference[row]:
        what += f" to {rows.reference[row]}"
    unit = fitting_unit(str(rows.unit[row]), float(rows.residual[row]))
    return [
        str(rows.sensor[row]),
        what,
        f"{rows.time_s[row]:.9g}",
        str(rows.line[row]) if rows.line[row] else "",
        f"{rows.residual[row] / unit.size:+.4g} {unit.name}",
        f"{rows.normalised[row]:+.3g}",
    ]


def error_sheet(results: Results, limits: Limits) -> Sheet:
    """Return the estimated errors of all sensors, with a bar in prior sigmas for each."""
    rows: list[list[str]] = []
    marked: set[int] = set()
    bars: list[tuple[float, float]] = []
    for error in results.errors[: 3 * limits.rows]:
        unit = fitting_unit(error.unit, error.estimate, error.sigma)
        prior = error.prior_sigma
        known = prior > 0.0 and math.isfinite(prior)
        if error.surprising:
            marked.add(len(rows))
        rows.append(
            [
                "(the recording)" if error.sensor == RECORDING_NAME else error.sensor,
                error.state.replace("_", " "),
                f"{estimate_text(error, unit)} {unit.name}",
                f"{rounded(prior / unit.size)} {unit.name}",
                f"{error.estimate / prior:+.2f}" if known else "?",
            ]
        )
        bars.append(
            (error.estimate / prior, 1.959963984540054 * error.sigma / prior)
            if known
            else (math.nan, math.nan)
        )
    return Sheet(
        head=["sensor", "error", "estimate ± sigma>", "prior sigma>", "in prior sigmas>"],
        rows=rows,
        marked=frozenset(marked),
        bars=bars,
        left_out=max(len(results.errors) - 3 * limits.rows, 0),
    )


def direction_sheet(results: Results) -> Sheet:
    """Return the directions of the position that were looked at, with their sigmas."""
    rows: list[list[str]] = []
    marked: set[int] = set()
    for entry in entries(results.summary, "directions"):
        sigma, time = entry.get("sigma_m"), entry.get("time_s")
        if entry.get("weak"):
            marked.add(len(rows))
        rows.append(
            [
                _seconds(time),
                str(entry.get("name", "")).strip("()"),
                length_text(float(sigma)) if isinstance(sigma, int | float) else "not determined",
                "weak" if entry.get("weak") else "",
            ]
        )
    return Sheet(
        head=["time (s)>", "direction", "1 sigma>", ""], rows=rows, marked=frozenset(marked)
    )


def _seconds(value: object) -> str:
    """Return a time to the microsecond; the first emission's is often a rounding away from 0."""
    return f"{round(float(value), 6) + 0.0:.9g}" if isinstance(value, int | float) else ""


def hypothesis_sheet(results: Results) -> Sheet:
    """Return the places that fit, where there are several."""
    rows = []
    for entry in entries(results.summary, "hypotheses"):
        if "latitude_deg" in entry:
            place = (
                f"{number(entry['latitude_deg'], 8)}° latitude, "
                f"{number(entry.get('longitude_deg'), 8)}° longitude, "
                f"height {number(entry.get('height_m'))} m"
            )
        else:
            where = entry.get("position_m")
            values = where if isinstance(where, list) else []
            place = ", ".join(f"{number(value, 7)} m" for value in values)
        sigma = entry.get("sigma_m")
        rows.append(
            [
                number(entry.get("weight"), 3),
                place,
                _seconds(entry.get("time_s")),
                length_text(float(sigma)) if isinstance(sigma, int | float) else "?",
            ]
        )
    return Sheet(head=["weight>", "position", "time (s)>", "1 sigma at most>"], rows=rows)


def truth_lines(results: Results, found: Comparison | None) -> list[str]:
    """Return how far the path is from the truth, and whether its covariance is honest."""
    if results.truth is None:
        return ["The recording holds no truth, so errors of the path and NEES are not known."]
    if found is None:
        return ["The recording's truth covers none of the path's times."]
    figures = found.figures()
    nees, low_high = figures["nees"], figures["nees"]["band_99"]
    error = figures["position_m"]
    lines = [
        f"Error of the position at {figures['points']} points of the truth: RMSE "
        f"{length_text(error['rmse'])}, median {length_text(error['median'])}, greatest "
        f"{length_text(error['max'])}."
    ]
    if nees["mean"] is None:
        return [*lines, "NEES: none, for the covariance is not positive definite."]
    lines.append(
        f"NEES: mean {nees['mean']:.3g}, expected {nees['expected']:.0f}; 99 % of single draws lie "
        f"in {low_high[0]:.2g} to {low_high[1]:.3g}. Errors along one path go together: a path is "
        f"one draw. {100 * nees['share_within_95']:.0f} % of the points lie in their 95 % "
        "ellipsoid."
    )
    return lines


def settings_sheet(results: Results) -> Sheet:
    """Return the settings in force, and what was made of those left open."""
    facts = results.summary
    rows = [
        [name.replace("_", " "), _plain(value)]
        for name, value in table_of(facts, "settings").items()
        if value is not None and name != "stages"
    ]
    rows += [
        [f"{key.replace('_', ' ')}, as used", _plain(facts[key])]
        for key in ("process_noise", "process_noise_along", "spacing_s", "loss")
        if facts.get(key) is not None
    ]
    rows += [["stage, as used", stage_text(entry)] for entry in facts.get("stages") or ()]
    speed = facts.get("propagation_speed_m_s")
    rows.append(["propagation speed (m/s)", "infinite" if speed is None else number(speed, 9)])
    return Sheet(head=["setting", "value"], rows=rows)


def _plain(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(_plain(entry) for entry in value)
    return rounded(value, 6) if isinstance(value, float) and math.isfinite(value) else str(value)


def versions_sheet(results: Results) -> Sheet:
    """Return the versions of what computed the results."""
    found = table_of(results.summary, "versions")
    return Sheet(head=["program", "version"], rows=[[str(key), str(found[key])] for key in found])
