"""Many recordings smoothed in one call, each into a folder of its own.

One bad recording does not stop the others, and each folder is written whole or not at all.
"""

from __future__ import annotations

import os
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from geograph.cluster import run_on_cluster
from geograph.errors import InputError, SolveError
from geograph.io import read
from geograph.io.atomic import tidy
from geograph.results import from_track
from geograph.results.write import check_target, save, write_csv
from geograph.workers import Lost, run_isolated

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

SUMMARY_TABLE = "batch.csv"
_FACTS = ("iterations", "chi2", "degrees_of_freedom", "measurements", "knots", "seconds")
_RESERVED = (SUMMARY_TABLE, "summary.json", "recording.toml")


@dataclass(frozen=True, kw_only=True)
class Job:
    """A recording to smooth, and where its results go.

    Parameters
    ----------
    source, folder
        Of the recording and of its results.
    """

    source: Path
    folder: Path


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of one recording.

    Parameters
    ----------
    job
        The recording and its folder.
    kind
        ``"converged"``; ``"not converged"``, with results if there is any estimate;
        ``"bad input"`` or ``"crashed"``, without results.
    status
        The solver's status, or ``"failed"``.
    message
        Why, in one line.
    summary
        What ``summary.json`` holds; empty without results.
    details
        Traceback of a crash.
    """

    job: Job
    kind: Literal["converged", "not converged", "bad input", "crashed"]
    status: str
    message: str
    summary: Mapping[str, Any] = field(default_factory=dict)
    details: str = ""


def plan(sources: Sequence[Path], output: Path) -> list[Job]:
    """Return a job for each recording, with folders that differ even where names do not.

    Parameters
    ----------
    sources
        Folders or archives of recordings.
    output
        The folder that receives one folder for each, by its name, and ``batch.csv``.

    Raises
    ------
    InputError
        If results would replace anything but results.
    """
    for stranger in _RESERVED[1:]:
        if (output / stranger).exists():
            raise InputError(
                f"holds {stranger}, so it is no folder of many results; name another folder",
                path=output,
            )
    taken = {name.casefold() for name in _RESERVED}
    jobs = []
    for source in sources:
        # Absolute, not resolved: a link keeps its own name.
        name = source.absolute().name or "recording"
        name = name.removesuffix(".zip") or name
        unique, count = name, 1
        while unique.casefold() in taken:
            count += 1
            unique = f"{name}-{count}"
        taken.add(unique.casefold())
        jobs.append(Job(source=source, folder=output / unique))
    for job in jobs:
        check_target(job.folder)
    return jobs


def smooth_many(
    sources: Sequence[Path | str],
    output: Path | str,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    changes: Mapping[str, Any] | None = None,
    pictures: bool = True,
    command: str | None = None,
    on_done: Callable[[Outcome], None] | None = None,
) -> list[Outcome]:
    """Smooth recordings in parallel processes, and write their results and ``batch.csv``.

    Parameters
    ----------
    sources
        Folders or archives of recordings.
    output
        Each is written to ``output/<its name>/``; equal names get a number.
    workers
        Processes; None: as many as there are cores for this process.
    scheduler
        Address of a Dask scheduler whose workers are used instead; they must see the same files.
    changes
        Settings that differ from the recordings' own, by the names of
        :class:`geograph.SmoothSettings`.
    pictures
        Whether to draw pictures.
    command
        Command line to be noted in the summaries.
    on_done
        Called in this process with each outcome as it comes.

    Returns
    -------
    list of Outcome
        In the order of ``sources``.

    Raises
    ------
    InputError
        If ``output`` or the scheduler cannot be used; what is wrong with one recording is in its
        outcome.
    """
    target = Path(output)
    jobs = plan([Path(source) for source in sources], target)
    task = partial(smooth_job, changes=dict(changes or {}), pictures=pictures, command=command)
    outcomes: list[Outcome | None] = [None] * len(jobs)
    count = min(workers or usable_cores(), len(jobs))
    if scheduler is None:
        running = run_isolated(task, jobs, workers=count)
    else:
        # Workers have working directories of their own.
        places = [Job(source=job.source.absolute(), folder=job.folder.absolute()) for job in jobs]
        running = run_on_cluster(task, places, scheduler=scheduler)
    # Closed at once when on_done raises, for that ends the processes.
    try:
        with closing(running) as finished:
            for index, result in finished:
                job = jobs[index]
                if isinstance(result, Lost):
                    outcome = _crash(job, result)
                else:
                    outcome = replace(result, job=job)
                outcomes[index] = outcome
                if on_done is not None:
                    on_done(outcome)
    except BaseException:
        # Processes that were ended had no time to remove their drafts.
        for job in jobs:
            tidy(job.folder)
        raise
    done = [outcome for outcome in outcomes if outcome is not None]
    _write_table(done, target)
    return done


def usable_cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def smooth_job(
    job: Job, *, changes: Mapping[str, Any], pictures: bool, command: str | None
) -> Outcome:
    """Read, smooth and write one recording; what is wrong with it is in the outcome."""
    from geograph import smooth

    try:
        recording = read(job.source)
        track = smooth(recording, raise_on_failure=False, **changes)
        results = from_track(track, command=command)
        save(results, job.folder, pictures=pictures, solved=track)
    except InputError as error:
        return Outcome(job=job, kind="bad input", status="failed", message=str(error))
    except OSError as error:
        # A full disk is nobody's mistake in the code: no traceback.
        where = f"{error.filename}: " if error.filename else ""
        message = f"{where}{error.strerror or error}"
        return Outcome(job=job, kind="crashed", status="failed", message=message)
    except SolveError as error:
        status = str(error.status)
        return Outcome(job=job, kind="not converged", status=status, message=str(error))
    return Outcome(
        job=job,
        kind="converged" if results.status == "converged" else "not converged",
        status=results.status,
        message=str(results.summary.get("message", "")),
        summary=results.summary,
    )


def _crash(job: Job, lost: Lost) -> Outcome:
    return Outcome(
        job=job, kind="crashed", status="failed", message=lost.reason, details=lost.details
    )


def _write_table(outcomes: Sequence[Outcome], folder: Path) -> None:
    columns: dict[str, Sequence[Any]] = {
        "name": [outcome.job.folder.name for outcome in outcomes],
        "recording": [str(outcome.job.source) for outcome in outcomes],
        "status": [outcome.status for outcome in outcomes],
        "message": [outcome.message for outcome in outcomes],
    }
    for fact in _FACTS:
        columns[fact] = [outcome.summary.get(fact, "") for outcome in outcomes]
    columns["rejected"] = [
        len(outcome.summary["rejected"]) if "rejected" in outcome.summary else ""
        for outcome in outcomes
    ]
    folder.mkdir(parents=True, exist_ok=True)
    # Under its name only when it is whole.
    draft = folder / f".{SUMMARY_TABLE}.{os.getpid()}"
    try:
        write_csv(draft, columns)
        draft.replace(folder / SUMMARY_TABLE)
    finally:
        draft.unlink(missing_ok=True)
