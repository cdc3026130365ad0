"""Tables that the commands print: aligned text, the same on a terminal and in a pipe."""

from __future__ import annotations

import sys
from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.results.facts import (
    estimate_text,
    length_text,
    rounded,
    stage_text,
    static_facts,
)
from geograph.states import RECORDING_NAME
from geograph.units import fitting_unit

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from geograph.batch import Outcome
    from geograph.results import ErrorState, Results
    from geograph.units import Unit

_MOST_SENSORS, _MOST_ROWS, _MOST_NOTES = 20, 30, 8
_WIDTH = 120
_ROUNDING_M = 1e-9


def results_text(results: Results, folder: Path) -> str:
    """Return the table printed after one recording was smoothed."""
    facts = results.summary
    parts = [
        _headline(results),
        _static_text(results) if results.static else table_text(_path_rows(results)),
        *map(table_text, _sensor_tables(results)),
        _notes(results),
        f"written to {folder}",
    ]
    if facts.get("message") and results.status != "converged":
        parts.insert(1, str(facts["message"]))
    return "\n\n".join(part for part in parts if part)


def _headline(results: Results) -> str:
    facts = results.summary
    status = results.status.replace("_", " ")
    colour = "32" if results.status == "converged" else "31"
    start, end = facts.get("time_span_s", (results.time_s[0], results.time_s[-1]))
    words = [
        f"{_paint(status, colour)} in {facts.get('iterations', '?')} iterations",
        f"chi2/dof {_number(facts.get('chi2'))}/{facts.get('degrees_of_freedom', '?')}",
        f"{facts.get('measurements', '?')} measurements over {end - start:.4g} s",
        f"{len(facts.get('rejected') or ())} rejected",
        f"{results.time_s.size} knot" + ("s" if results.time_s.size > 1 else ""),
        f"{_number(facts.get('seconds'))} s",
    ]
    return f"{results.name}: " + ", ".join(words)


def _paint(text: str, colour: str) -> str:
    return f"\x1b[{colour}m{text}\x1b[0m" if sys.stdout.isatty() else text


def _number(value: Any) -> str:
    return "?" if value is None else f"{value:.4g}"


def _static_text(results: Results) -> str:
    facts = static_facts(results)
    width = max(len(name) for name, _ in facts)
    return "\n".join(f"{name.ljust(width)}  {text}" for name, text in facts)


def _path_rows(results: Results) -> list[list[str]]:
    geodetic = results.geodetic()
    where = ["x (m)", "y (m)", "z (m)"]
    sigmas = ["sigma x", "y", "z (m)"]
    if geodetic is not None:
        where, sigmas = ["latitude", "longitude", "height (m)"], ["sigma east", "north", "up (m)"]
    speed, sigma_speed = results.speed_m_s, results.sigma_speed_m_s
    rows = [["", "time (s)", *where, *sigmas]]
    if speed is not None:
        rows[0] += ["speed (m/s)", "sigma (m/s)"]
    covariance = results.level_covariance_m2()
    count = results.time_s.size
    chosen = {"start": 0, "middle": count // 2, "end": count - 1} if count > 2 else {"": 0}
    if count == 2:
        chosen = {"start": 0, "end": 1}
    for label, knot in chosen.items():
        if geodetic is None:
            # Where a constraint holds the height, rounding leaves either sign of zero.
            place = [f"{round(float(value), 2) + 0.0:.2f}" for value in results.position_m[knot]]
        else:
            latitude, longitude, height = geodetic[knot]
            place = [f"{latitude:.6f}", f"{longitude:.6f}", f"{height:.1f}"]
        spread = [rounded(value) for value in np.sqrt(np.diag(covariance[knot]))]
        # Light takes microseconds: no minus zero.
        time = round(float(results.time_s[knot]), 3) + 0.0
        row = [label, f"{time:.3f}", *place, *spread]
        if speed is not None and sigma_speed is not None:
            row += [f"{speed[knot]:.1f}", rounded(sigma_speed[knot], 2)]
        rows.append(row)
    return rows


def _sensor_tables(results: Results) -> list[list[list[str]]]:
    """Return the sensors' measurements and errors, in as many tables as fit a terminal's width."""
    shown = [place.sensor for place in results.sensors[:_MOST_SENSORS]]
    first, columns = _measured_columns(results, shown), _error_columns(results, shown)
    tables, names = [], ["sensor", *shown]
    current = [names, *first]
    for column in columns:
        if sum(max(map(len, own)) + 2 for own in [*current, column]) > _WIDTH:
            tables.append(current)
            current = [names]
        current.append(column)
    return [[list(row) for row in zip(*table, strict=True)] for table in [*tables, current]]


def _measured_columns(results: Results, shown: list[str]) -> list[list[str]]:
    facts = [results.summary.get("sensors", {}).get(sensor, {}) for sensor in shown]
    lost = Counter(entry["sensor"] for entry in results.summary["rejected"])
    columns = [["measured", *(str(entry.get("measurements", "")) for entry in facts)]]
    if any(entry.get("as_reference") for entry in facts):
        columns.append(["as reference", *(str(entry.get("as_reference", "")) for entry in facts)])
    columns.append(["rejected", *(str(lost[sensor]) for sensor in shown)])
    values = [_rms(results, sensor) for sensor in shown]
    columns.append(["rms/sigma", *("-" if v is None else _number(v) for v in values)])
    return columns


def _error_columns(results: Results, shown: list[str]) -> list[list[str]]:
    """Return a column for each error that any of the sensors shown has, in a unit that suits it."""
    columns = []
    for state in dict.fromkeys(error.state for error in results.errors):
        errors = {error.sensor: error for error in results.errors if error.state == state}
        if not errors.keys() & set(shown):
            continue
        unit = _unit_of(list(errors.values()))
        cells = [_estimate(errors[name], unit) if name in errors else "-" for name in shown]
        columns.append([f"{state.replace('_', ' ')} ({unit.name})", *cells])
    return columns


def _unit_of(errors: list[ErrorState]) -> Unit:
    return fitting_unit(errors[0].unit, [[error.estimate, error.sigma] for error in errors])


def _rms(results: Results, sensor: str) -> float | None:
    rows = results.residuals.of(sensor)
    used = rows.normalised[~rows.rejected]
    return float(np.sqrt(np.mean(used**2))) if used.size else None


def _estimate(error: ErrorState, unit: Unit) -> str:
    mark = " !" if error.surprising else "  "
    return estimate_text(error, unit) + mark


def _notes(results: Results) -> str:
    notes = []
    for error in results.errors:
        if error.sensor == RECORDING_NAME:
            unit = _unit_of([error])
            what = error.state.replace("_", " ")
            notes.append(f"{what} off by {_estimate(error, unit).rstrip(' !')} {unit.name}")
    notes += _fixes_note(results)
    if results.surprising_errors():
        notes.append("! further than 3 prior sigmas from zero")
    if len(results.sensors) > _MOST_SENSORS:
        notes.append(f"... {len(results.sensors) - _MOST_SENSORS} more sensors in sensors.csv")
    notes += _stages(results)
    notes += _hypotheses(results)
    curved = (results.summary.get("gaussian") or {}).get("reason")
    if curved and results.static:
        notes.append(
            f"not Gaussian: {curved}; contours: likelihood.png, or likelihood_map() of the track"
        )
    for key in ("flagged_sensors", "weakly_observed"):
        sentences = [str(sentence) for sentence in results.summary.get(key) or ()]
        notes += sentences[:_MOST_NOTES]
        if len(sentences) > _MOST_NOTES:
            notes.append(f"... {len(sentences) - _MOST_NOTES} more in summary.json ({key})")
    return "\n".join(notes)


def _stages(results: Results) -> list[str]:
    """List the stages of the process noise, where there are several."""
    found = results.summary.get("stages") or []
    lines = [stage_text(entry) for entry in found[:_MOST_NOTES]]
    if len(found) > _MOST_NOTES:
        lines.append(f"... {len(found) - _MOST_NOTES} more in summary.json (stages)")
    return lines


def _hypotheses(results: Results) -> list[str]:
    """List the places that fit, with their weights, where there are several."""
    found = results.summary.get("hypotheses") or []
    lines = []
    for entry in found[:_MOST_NOTES]:
        if "latitude_deg" in entry:
            place = (
                f"{entry['latitude_deg']:.6f} deg, {entry['longitude_deg']:.6f} deg, "
                f"{entry['height_m']:.1f} m"
            )
        else:
            place = "({:.1f}, {:.1f}, {:.1f}) m".format(*entry["position_m"])
        lines.append(
            f"weight {entry['weight']:.3f}: {place} at t = {entry['time_s']:.6g} s, 1-sigma "
            f"{length_text(entry['sigma_m'])} at most"
        )
    return [f"{len(found)} places fit:", *lines] if lines else []


def _fixes_note(results: Results) -> list[str]:
    """Tell how well the platforms are known, in the middle of the recording."""
    if not results.platforms:
        return []
    count = len(results.platforms)
    sigma = [
        float(np.sqrt(np.trace(path.position_covariance_m2[path.time_s.size // 2])))
        for path in results.platforms
    ]
    return [
        f"paths of {count} sensors estimated from their fixes, to {length_text(min(sigma))} "
        f"(best) and {length_text(max(sigma))} (worst) at mid-time; see platforms.csv"
    ]


def batch_text(outcomes: Sequence[Outcome], folder: Path) -> str:
    """Return the table printed after several recordings: what went wrong first, then the rest."""
    rows = [["recording", "status", "iterations", "chi2/dof", "rejected", "seconds", ""]]
    order = sorted(outcomes, key=lambda outcome: outcome.kind == "converged")
    for outcome in order[:_MOST_ROWS]:
        facts = outcome.summary
        fit = f"{_number(facts['chi2'])}/{facts['degrees_of_freedom']}" if facts else ""
        rows.append(
            [
                outcome.job.folder.name,
                outcome.status,
                str(facts.get("iterations", "")),
                fit,
                str(len(facts["rejected"])) if "rejected" in facts else "",
                _number(facts["seconds"]) if "seconds" in facts else "",
                "" if outcome.kind == "converged" else outcome.message,
            ]
        )
    good = sum(outcome.kind == "converged" for outcome in outcomes)
    text = table_text(rows)
    if len(order) > _MOST_ROWS:
        text += f"\n... {len(order) - _MOST_ROWS} more in batch.csv"
    return f"{text}\n\n{good} of {len(outcomes)} converged; written to {folder}"


def comparison_text(figures: dict[str, Any]) -> str:
    """Return the table that ``geograph compare`` prints."""
    rows = [["error", "RMSE", "median", "greatest", "mean"]]
    rows.append(["position (m)", *_three(figures["position_m"]), ""])
    for name, values in figures["components_m"].items():
        rows.append([f"{name} (m)", *_three(values), _error(values["mean"], "+")])
    if figures["speed_m_s"] is not None:
        values = figures["speed_m_s"]
        rows.append(["speed (m/s)", *_three(values), _error(values["mean"], "+")])
    nees = figures["nees"]
    low, high = nees["band_99"]
    lines = [
        f"{figures['points']} points of the truth"
        + (f", and {figures['outside']} outside the path" if figures["outside"] else "")
        + (
            f"; it lags by {figures['delay_s']:.3g} s, which is taken out"
            if figures["delay_s"] is not None
            else ""
        ),
        "",
        table_text(rows),
        "",
    ]
    if nees["mean"] is None:
        lines.append("NEES: none, for the covariance is not positive definite")
    else:
        lines.append(
            f"NEES: mean {nees['mean']:.3g} (expected {nees['expected']:.0f}; 99 % of single draws "
            f"lie in {low:.2g} to {high:.3g}), {100 * nees['share_within_95']:.0f} % of points in "
            "their 95 % ellipsoid"
        )
    return "\n".join(lines)


def _three(values: dict[str, float]) -> list[str]:
    return [_error(values[key]) for key in ("rmse", "median", "max")]


def _error(value: float, sign: str = "") -> str:
    """Return an error in metres; below a nanometre there is nothing but rounding."""
    return f"{value:{sign}.4g}" if abs(value) >= _ROUNDING_M else "0"


def table_text(rows: list[list[str]]) -> str:
    """Return aligned columns: the first and any last one of remarks to the left."""
    if len(rows) < 2:
        return ""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [
            cell.ljust(width) if i == 0 or (rows[0][i] == "" and i > 0) else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)
