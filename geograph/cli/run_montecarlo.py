"""What ``geograph montecarlo`` does."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from geograph.batch import usable_cores
from geograph.cli import NOT_CONVERGED, OK, UNEXPECTED
from geograph.cli.report import table_text
from geograph.cli.run_simulate import given_parameters, split
from geograph.cli.run_smooth import progress
from geograph.errors import InputError
from geograph.io.atomic import replacing_file
from geograph.montecarlo import Plan, run_study, study_figures
from geograph.montecarlo.log import LOG, RunLog, check_folder
from geograph.montecarlo.trial import CRASHED
from geograph.results.write import write_json
from geograph.scenarios.parameters import show
from geograph.scenarios.registry import scenario, simulate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from geograph.scenarios.registry import Scenario

FIGURES = "montecarlo.json"
"""Name of the figures in the folder of a study."""

_MOST_FAILURES, _WIDTH = 8, 120


@dataclass(frozen=True, kw_only=True)
class Request:
    """What was asked for, as the options of the command.

    Parameters
    ----------
    name, runs, seed
        The scenario, the number of runs, and the seed of the first.
    set, sweep
        Each ``NAME=VALUE`` and ``NAME=V1,V2,...``.
    changes
        Settings of the smoother.
    output, json
        Folder and file to write, or None.
    jobs, scheduler
        Processes of this machine, or the address of a Dask scheduler.
    pictures
        Whether to draw them.
    """

    name: str
    runs: int
    seed: int
    set: tuple[str, ...]
    sweep: tuple[str, ...]
    changes: Mapping[str, Any]
    output: Path | None
    json: Path | None
    jobs: int | None
    scheduler: str | None
    pictures: bool


def montecarlo(request: Request) -> int:
    """Run a study, print its table, write what was asked for, and return the exit status.

    Raises
    ------
    InputError
        If anything given is wrong; then nothing is written.
    """
    chosen = scenario(request.name)
    plan = _plan(request, chosen)
    for point in plan.points:
        # What can not be simulated at all is said before anything is written.
        plan.simulate({**plan.parameters, **point}, plan.seed)
    if request.json is not None:
        _check_file(request.json)
    if request.output is not None:
        check_folder(request.output, plan.identity())
    if request.scheduler is not None:
        from geograph.cluster import connected

        with connected(request.scheduler):
            pass
    begun = time.perf_counter()
    workers = request.jobs or usable_cores()
    with ExitStack() as stack:
        log = None
        if request.output is not None:
            log = stack.enter_context(RunLog(request.output, plan.identity()))
        advance = stack.enter_context(progress(plan.runs * len(plan.points), "simulating"))
        runs = run_study(
            plan, log=log, workers=workers, scheduler=request.scheduler, on_done=advance
        )
    figures = study_figures(
        plan,
        runs,
        about={
            "title": chosen.title,
            "source": chosen.source,
            "parameters_all": {**chosen.parameters(), **plan.parameters},
        },
        times={"seconds": time.perf_counter() - begun},
    )
    _write(figures, request)
    print(study_text(figures, request))
    if any(run.status == CRASHED for point in runs for run in point):
        return UNEXPECTED
    return OK if any(point["converged"] for point in figures["points"]) else NOT_CONVERGED


def _plan(request: Request, chosen: Scenario) -> Plan:
    swept: dict[str, list[Any]] = {}
    for text in request.sweep:
        key, values = split(text, "--sweep")
        if key in swept:
            raise InputError(f"--sweep {key} is given twice; expected it once")
        swept[key] = [chosen.parse(key, value) for value in values.split(",")]
    return Plan(
        scenario=chosen.name,
        simulate=partial(simulate, chosen.name),
        runs=request.runs,
        seed=request.seed,
        parameters=given_parameters(chosen, request.set),
        sweep=swept,
        changes=request.changes,
    )


def _check_file(file: Path) -> None:
    if file.is_dir():
        raise InputError("is a folder; expected a file to write; name another", path=file)
    if not file.absolute().parent.is_dir():
        raise InputError("is in a folder that does not exist; make it first", path=file)


def _write(figures: dict[str, Any], request: Request) -> None:
    targets = [request.json] if request.json is not None else []
    if request.output is not None:
        targets.append(request.output / FIGURES)
    for target in targets:
        with replacing_file(target) as draft:
            write_json(draft, figures)
    if request.output is not None and request.pictures:
        from geograph.plot._montecarlo import save_pages

        save_pages(figures, request.output)


def study_text(figures: Mapping[str, Any], request: Request) -> str:
    """Return the table printed after a study."""
    swept = list(figures["sweep"])
    header = [*swept, "converged", "RMSE (m)", "bound (m)", "RMSE/bound", "by run"]
    header += ["ANEES", "KL"]
    rows = [[*header, "in 50 %", "90 %", "95 %", "99 %"]]
    rows += [_row(point, swept) for point in figures["points"]]
    parts = [
        f"{figures['scenario']}: {figures['title']} [{figures['source']}]\n"
        f"{figures['runs']} runs from seed {figures['seed']}"
        + (", each point" if swept else "")
        + _expected(figures["points"]),
        table_text(rows),
        _failures(figures, request),
    ]
    if request.output is not None:
        parts.append(f"written to {request.output} ({FIGURES}, {LOG})")
    return "\n\n".join(part for part in parts if part)


def _expected(points: Sequence[Mapping[str, Any]]) -> str:
    for point in points:
        if "anees_expected" in point:
            low, high = point["anees_band_99"]
            return (
                f"; ANEES: {point['anees_expected']} expected, at one time {low:.2f} to {high:.2f} "
                "in 99 % of studies"
            )
    return ""


def _row(point: Mapping[str, Any], swept: Sequence[str]) -> list[str]:
    row = [_shown(point["set"][key]) for key in swept]
    row.append(f"{point['converged']}/{point['runs']}")
    if not point["converged"]:
        return [*row, *["-"] * 10]
    row += [_number(point["rmse_m"]), _number(point["bound_m"])]
    row += [
        _with_error(point["rmse_over_bound"], point["rmse_over_bound_error"]),
        _with_error(point["rmse_over_bound_by_run"], point["rmse_over_bound_by_run_error"]),
        _with_error(point["anees"], point["anees_error"]),
        _with_error(point["divergence"], point["divergence_error"]),
    ]
    return row + [f"{100 * entry['share']:.1f}" for entry in point["coverage"]]


def _failures(figures: Mapping[str, Any], request: Request) -> str:
    lines = []
    for point in figures["points"]:
        chosen = {**figures["parameters"], **point["set"]}
        words = "".join(f" --set {key}={_shown(value)}" for key, value in chosen.items())
        for failure in point["failures"]:
            what = f"{failure['status']}: {failure['message']}".removesuffix(": ")
            what = what if len(what) <= _WIDTH else f"{what[:_WIDTH]}..."
            lines.append(
                f"  {what} (geograph simulate {request.name} --seed {failure['seed']}{words})"
            )
    if not lines:
        return ""
    more = len(lines) - _MOST_FAILURES
    shown = lines[:_MOST_FAILURES] + ([f"  ... {more} more in the JSON"] if more > 0 else [])
    return "\n".join([f"{len(lines)} runs did not converge:", *shown])


def _shown(value: Any) -> str:
    return show(tuple(value) if isinstance(value, list) else value)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _with_error(value: float | None, error: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3f}" if error is None else f"{value:.3f}±{error:.3f}"
