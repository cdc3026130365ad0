"""What ``geograph smooth`` does, for one recording and for several."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from geograph.cli import BAD_INPUT, NOT_CONVERGED, OK, UNEXPECTED
from geograph.errors import InputError, SolveError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path


def settings_from(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings given as flags, checked as far as they can be without a recording."""
    from geograph.recording import NO_FORCES, SmoothSettings

    changes = {name: value for name, value in given.items() if value is not None}
    if "process_noise" in changes:
        changes["process_noise"] = _noise(changes["process_noise"])
    if "stages" in changes:
        changes["stages"] = _stages(changes["stages"])
    # Whether these make sense depends on the rest of the recording's settings.
    with_others = ("process_noise_along", *NO_FORCES)
    alone = {name: value for name, value in changes.items() if name not in with_others}
    try:
        SmoothSettings(**alone)
    except InputError as error:
        raise InputError(error.reason) from None
    return changes


def _noise(text: str) -> float | tuple[float, ...] | str:
    if text == "auto":
        return text
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError(
            f"--process-noise is {text!r}; expected one number, three (x,y,z), or auto"
        ) from None
    return numbers[0] if len(numbers) == 1 else numbers


def _stages(text: str) -> tuple[tuple[float, float], ...] | str | None:
    if text in ("auto", "none"):
        return None if text == "none" else text
    try:
        parts = [part.split(":") for part in text.split(",")]
        return tuple((float(start), float(times)) for start, times in parts)
    except ValueError:
        raise InputError(
            f"--stages is {text!r}; expected auto, none, or FROM_S:TIMES,... (10:3 for three times "
            "the noise from 10 s on)"
        ) from None


@dataclass(frozen=True, kw_only=True)
class Request:
    """What was asked for.

    Parameters
    ----------
    output
        Folder of the results.
    changes
        Settings that differ from the recording's.
    pictures
        Whether to draw them.
    command
        The command line, for the summary.
    """

    output: Path
    changes: Mapping[str, Any]
    pictures: bool
    command: str


def smooth_one(source: Path, request: Request) -> int:
    """Smooth one recording into a folder, print its table, and return the exit status."""
    from geograph import smooth
    from geograph.cli.report import results_text
    from geograph.io import read
    from geograph.results import from_track
    from geograph.results.write import check_target, save

    check_target(request.output)
    with _spinner(f"smoothing {source}"):
        recording = read(source)
        try:
            track = smooth(recording, raise_on_failure=False, **request.changes)
        except SolveError as error:
            print(f"geograph: {recording.name}: {error.status}: {error}", file=sys.stderr)
            return NOT_CONVERGED
        results = from_track(track, command=request.command)
        save(results, request.output, pictures=request.pictures, solved=track)
    print(results_text(results, request.output))
    return OK if results.status == "converged" else NOT_CONVERGED


def smooth_several(
    sources: Sequence[Path],
    request: Request,
    *,
    workers: int | None,
    scheduler: str | None = None,
) -> int:
    """Smooth recordings into a folder each, print a table, and return the exit status."""
    from geograph.batch import smooth_many
    from geograph.cli.report import batch_text

    with progress(len(sources), "smoothing") as advance:
        outcomes = smooth_many(
            sources,
            request.output,
            workers=workers,
            scheduler=scheduler,
            changes=request.changes,
            pictures=request.pictures,
            command=request.command,
            on_done=advance,
        )
    print(batch_text(outcomes, request.output))
    for outcome in outcomes:
        if outcome.kind in ("bad input", "crashed"):
            print(f"geograph: error: {outcome.message}", file=sys.stderr)
        if outcome.details:
            print(outcome.details, file=sys.stderr)
    kinds = {outcome.kind for outcome in outcomes}
    for kind, status in (
        ("crashed", UNEXPECTED),
        ("bad input", BAD_INPUT),
        ("not converged", NOT_CONVERGED),
    ):
        if kind in kinds:
            return status
    return OK


@contextmanager
def _spinner(text: str) -> Iterator[None]:
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console
    from rich.markup import escape

    with Console(stderr=True).status(escape(text)):
        yield


@contextmanager
def progress(total: int, what: str) -> Iterator[Callable[[object], None] | None]:
    """Show a progress bar on a terminal, and nothing in a pipe.

    Parameters
    ----------
    total
        How many steps there are.
    what
        Is done, in a word.

    Yields
    ------
    callable or None
        To be called after each step.
    """
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    columns = (what, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda _: bar.advance(task)
