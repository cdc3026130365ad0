"""What ``geograph bound`` does: the bound along a path and as a map, as tables and files."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.cli import NOT_CONVERGED, OK
from geograph.cli.report import table_text
from geograph.cli.run_smooth import _spinner
from geograph.errors import InputError, SolveError
from geograph.results.facts import length_text, rounded
from geograph.units import fitting_unit

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from geograph.bound_grid import BoundMap
    from geograph.bounds import PathBound
    from geograph.signal import Signal

_MOST_KNOTS, _MOST_SENSORS, _MOST_NOTES = 12, 20, 8

Rows = list[list[str]]


@dataclass(frozen=True, kw_only=True)
class Request:
    """What was asked for.

    Parameters
    ----------
    output
        Folder of the results, or None.
    changes
        Settings that differ from the recording's.
    signal
        What gives the sigmas, or None.
    mapped
        Whether to draw a map.
    extent_m, cells
        Of the map; no extent: automatic.
    pictures
        Whether to draw them.
    command
        The command line, for the summary.
    """

    output: Path | None
    changes: Mapping[str, Any]
    signal: Signal | None
    mapped: bool
    extent_m: float | None
    cells: int
    pictures: bool
    command: str


def signal_from(
    snr_db: float | None,
    band_hz: tuple[float, float] | None,
    integration_s: float | None,
    coherent: bool | None,
) -> Signal | None:
    """Return the signal given as flags, or None where there is none of them.

    Raises
    ------
    InputError
        If some are given and others missing, or one is out of range.
    """
    from geograph.signal import Signal

    given = {"--snr-db": snr_db, "--band-hz": band_hz, "--integration-s": integration_s}
    missing = [flag for flag, value in given.items() if value is None]
    if len(missing) == len(given) and coherent is None:
        return None
    if snr_db is None or band_hz is None or integration_s is None:
        raise InputError(f"{', '.join(missing)} missing; expected {', '.join(given)} together")
    return Signal(snr_db=snr_db, band_hz=band_hz, integration_s=integration_s, coherent=coherent)


def run_bound(source: Path, request: Request) -> int:
    """Find the bound of one recording, print it, write it if asked to, and return the status."""
    from geograph.bound_grid import bound_map
    from geograph.bounds import bound
    from geograph.io import read
    from geograph.results.bound import check_bound_target, save_bound

    if request.output is not None:
        check_bound_target(request.output)
    recording = read(source)
    try:
        with _spinner(f"bound of {recording.name}"):
            found = bound(recording, signal=request.signal, **request.changes)
        over = None
        if request.mapped:
            with _progress(recording.name) as advance:
                over = bound_map(
                    recording,
                    center_m=found.position_m,
                    extent_m=request.extent_m,
                    cells=request.cells,
                    signal=request.signal,
                    on_row=advance,
                    **request.changes,
                )
    except SolveError as error:
        print(f"geograph: {recording.name}: {error.status}: {error}", file=sys.stderr)
        return NOT_CONVERGED
    if request.output is not None:
        save_bound(
            found,
            request.output,
            over=over,
            signal=request.signal,
            pictures=request.pictures,
            command=request.command,
        )
    _print(found, over, request)
    return OK if found.observable else NOT_CONVERGED


def _print(found: PathBound, over: BoundMap | None, request: Request) -> None:
    parts: list[str | Rows] = [_headline(found), _sigmas(found, request.signal)]
    parts += [_knot_rows(found), _summary_rows(found), _direction_rows(found)]
    parts += [_sensor_rows(found), _notes(found)]
    if over is not None:
        parts.append(_map_text(over))
    if request.output is not None:
        parts.append(f"written to {request.output}")
    parts = [part for part in parts if part]
    if sys.stdout.isatty():
        _print_rich(parts)
    else:
        print("\n\n".join(p if isinstance(p, str) else table_text(p) for p in parts))


def _print_rich(parts: list[str | Rows]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(highlight=False)
    for index, part in enumerate(parts):
        if index:
            console.print()
        if isinstance(part, str):
            console.print(Text(part))
            continue
        table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
        for column, name in enumerate(part[0]):
            table.add_column(Text(name), justify="left" if column == 0 else "right")
        for row in part[1:]:
            table.add_row(*map(Text, row))
        console.print(table)


def _headline(found: PathBound) -> str:
    at = "the true path" if found.evaluated_at == "truth" else "the estimated path (no truth given)"
    words = [f"{found.recording.name}: Cramer-Rao bound at {at}", found.settings.motion]
    if found.settings.motion != "static":
        noise = found.settings.process_noise
        text = ",".join(f"{value:.4g}" for value in np.atleast_1d(np.asarray(noise, dtype=float)))
        along = found.settings.process_noise_along
        text += "" if along is None else f" across and {along:.4g} along the velocity"
        words.append(f"process noise {text} ({found.process_noise_from})")
    words.append(f"{found.time_s.size} knot" + ("s" if found.time_s.size > 1 else ""))
    if found.left_out:
        words.append(f"{found.left_out} outliers left out")
    if not found.observable:
        words.append("NOT OBSERVABLE")
    return ", ".join(words)


def _sigmas(found: PathBound, signal: Signal | None) -> str:
    """Say how many measurements there are and what sigmas were used, and where these are from."""
    from geograph.results.bound import used_sigmas

    lines = []
    for name, columns in used_sigmas(found.recording).items():
        texts = []
        for column, facts in columns.items():
            axis = column.removesuffix("_rad").removeprefix("sigma_") if name == "bearings" else ""
            # On-sky sigmas are one for both coordinates.
            same = all(facts == other for other in columns.values())
            texts.append("sigma " + ("" if same else f"{axis} ") + _range(facts))
        count = len(found.recording.tables[name])
        lines.append(f"{count} {name.replace('_', ' ')}, {', '.join(dict.fromkeys(texts))}")
    if signal is not None:
        lines.append(_signal_text(signal))
    return "\n".join(lines)


def _range(facts: dict[str, Any]) -> str:
    """Return the least and the greatest of sigmas, in a unit that fits, or the one that all are."""
    unit = fitting_unit(facts["unit"], facts["greatest"])
    low, high = facts["least"] / unit.size, facts["greatest"] / unit.size
    return (f"{low:.4g}" if high - low <= 1e-9 * high else f"{low:.4g} to {high:.4g}") + (
        f" {unit.name}"
    )


def _signal_text(signal: Signal) -> str:
    low, high = signal.band_hz
    text = (
        f"sigmas of arrivals and differences from {signal.snr_db:g} dB in {low:g} to {high:g} Hz "
        f"over {signal.integration_s:g} s, "
    )
    text += "with" if signal.uses_phase else "without"
    text += " the phase of the carrier"
    if not signal.reachable:
        text += "; after integration the signal is too weak for any estimator to reach them"
    return text


def _knot_rows(found: PathBound) -> Rows:
    from geograph.results.bound import axis_names

    count = found.time_s.size
    chosen = np.unique(np.linspace(0, count - 1, min(count, _MOST_KNOTS)).round().astype(int))
    geodetic = found.geodetic()
    where = found.position_m if geodetic is None else geodetic
    header = ["x (m)", "y (m)", "z (m)"]
    if geodetic is not None:
        header = ["latitude", "longitude", "height (m)"]
    header = ["time (s)", *header, *(f"sigma {name} (m)" for name in axis_names(found))]
    header += ["horizontal (m)", "CEP (m)", "95 % semi-axes (m)"]
    velocity = found.sigma_velocity_m_s
    rows = [header if velocity is None else [*header, "velocity (m/s)"]]
    axes, cep = found.ellipsoids().semi_axes_m, found.cep_m()
    for knot in chosen:
        place = [f"{value:.1f}" for value in where[knot]]
        if geodetic is not None:
            place[:2] = [f"{value:.6f}" for value in where[knot, :2]]
        # Light takes microseconds: no minus zero.
        row = [f"{round(float(found.time_s[knot]), 3) + 0.0:.3f}", *place]
        row += [_figure(value) for value in found.sigma_axes_m[knot]]
        row += [_figure(found.sigma_horizontal_m[knot]), _figure(cep[knot])]
        row.append(" x ".join(_figure(value) for value in axes[knot]))
        rows.append(row if velocity is None else [*row, _figure(velocity[knot])])
    return rows


def _figure(value: float) -> str:
    return rounded(value, 4) if np.isfinite(value) else "open"


def _summary_rows(found: PathBound) -> Rows:
    from geograph.results.bound import extremes

    if found.time_s.size == 1:
        return []
    columns = {
        "horizontal (m)": found.sigma_horizontal_m,
        "height (m)": found.sigma_height_m,
        "CEP (m)": found.cep_m(),
    }
    if found.sigma_velocity_m_s is not None:
        columns["velocity (m/s)"] = found.sigma_velocity_m_s
    rows = [["", "best", "median", "worst"]]
    for name, values in columns.items():
        rows.append([name, *(_figure(float(value or 0.0)) for value in extremes(values).values())])
    return rows


def _direction_rows(found: PathBound) -> Rows:
    """Return the eigenvectors of the position's information, best knot first."""
    rows = [["direction", "time (s)", "sigma (m)"]]
    for entry in found.directions:
        mark = " weak" if entry.weak else ""
        time = f"{round(entry.time_s, 3) + 0.0:.3f}"
        rows.append([entry.name, time, _figure(entry.sigma_m) + mark])
    return rows if len(rows) > 1 else []


def _sensor_rows(found: PathBound) -> Rows:
    rows = [["sensor", "error", "bound", "prior", "bound/prior"]]
    names = list(found.sensor_bounds)
    for name in names[:_MOST_SENSORS]:
        for state, entry in found.sensor_bounds[name].items():
            unit = fitting_unit(entry.unit, entry.sigma)
            sigma, prior = (_figure(v / unit.size) for v in (entry.sigma, entry.prior_sigma))
            share = entry.sigma / entry.prior_sigma
            label = f"{state.replace('_', ' ')} ({unit.name})"
            rows.append([name, label, sigma, prior, f"{share:.2g}" if share >= 0.0 else "open"])
    if len(names) > _MOST_SENSORS:
        rows.append([f"... {len(names) - _MOST_SENSORS} more", "", "", "", ""])
    return rows if len(rows) > 1 else []


def _notes(found: PathBound) -> str:
    lines = found.weakly_observed[:_MOST_NOTES]
    if not found.observable:
        lines = ["the geometry does not determine the path: " + "; ".join(lines)]
    return "\n".join(lines)


def _map_text(over: BoundMap) -> str:
    from geograph.results.bound import map_facts

    facts = map_facts(over)
    spread = facts["sigma_horizontal_m"]
    text = (
        f"map for an emitter that stands still: {facts['cells']} x {facts['cells']} cells over "
        f"{length_text(facts['extent_m'])}"
    )
    if spread["best"] is not None:
        text += (
            f"; horizontal bound {spread['best']:.4g} m at best, {spread['median']:.4g} m in the "
            f"middle, {spread['worst']:.4g} m at worst"
        )
    for reason, count in facts["not_observable"].items():
        text += f"\nnot observable in {count} of {over.reason.size} cells: {reason}"
    return text


@contextmanager
def _progress(name: str) -> Iterator[Callable[[], object] | None]:
    """Show on a terminal that a map is being made, and nothing in a pipe."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.markup import escape

    rows = 0
    with Console(stderr=True).status(escape(f"map of {name}")) as status:

        def advance() -> None:
            nonlocal rows
            rows += 1
            status.update(escape(f"map of {name}: {rows} rows"))

        yield advance
