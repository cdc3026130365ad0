"""What ``geograph track`` does: a source, an engine, and what comes of it."""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geograph.cli import BROKEN_PIPE, NOT_CONVERGED, OK
from geograph.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from geograph.feed.engine import Engine, Estimate
    from geograph.feed.journal import Journal
    from geograph.feed.session import Session
    from geograph.feed.sources import Source
    from geograph.plot.live import LivePicture
    from geograph.recording import Recording, SmoothSettings

_UPDATES_OF_A_REPLAY = 200


@dataclass(frozen=True, kw_only=True)
class Picture:
    """The live picture that was asked for.

    Parameters
    ----------
    window
        Whether in a window, where there can be one.
    path
        File to draw.
    every_s
        Seconds from one drawing to the next, at least.
    """

    window: bool = False
    path: Path | None = None
    every_s: float = 2.0


@dataclass(frozen=True, kw_only=True)
class Request:
    """What was asked for; see the options of the command."""

    source: str | None
    like: Path | None = None
    follow: bool = False
    listen: str | None = None
    once: bool = False
    rate: float | None = None
    every_s: float | None = None
    output: Path | None = None
    journal: Path | None = None
    results: Path | None = None
    lag_s: float | None = None
    changes: Mapping[str, Any]
    picture: Picture = Picture()
    command: str = ""


def run_track(request: Request) -> int:
    """Track until the feed ends or a signal comes, and return the exit status.

    Raises
    ------
    InputError
        If arguments, recording, journal or output are wrong.
    OSError
        If the journal or the output cannot be written any more.
    """
    from geograph.feed.intake import Intake
    from geograph.feed.journal import Resumed
    from geograph.feed.session import Known

    _check(request)
    recording, source = _open(request)
    settings = recording.settings.replace(**request.changes)
    every_s = _every(request, recording, settings)
    with ExitStack() as stack:
        journal = _journal(request, recording, settings, every_s, source)
        if journal is not None:
            stack.callback(journal.close)
        session = _session(request, recording, journal, stack)
        picture = _picture(request, recording)
        session.watch = None if picture is None else picture.show
        resumed = Resumed() if journal is None else journal.resumed
        known = Known(resumed, numbered=source.numbered, counts=session.counts)
        intake = Intake(source, every_s=every_s, on_error=session.leave_out, skip=known)
        with _signals(intake.stop) as received:
            if journal is not None:
                _resume(session, journal, request)
            try:
                for batch in intake.batches():
                    session.take(batch)
                estimate = session.finish()
            except BrokenPipeError:
                # Whoever read the lines has gone. Typer would end with 1; the interpreter must not
                # try to flush them again.
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                return BROKEN_PIPE
            if picture is not None:
                picture.draw()
            status = _end(session, estimate, request, recording)
        return 128 + received[0] if received else status


def _check(request: Request) -> None:
    """Raise InputError where options contradict each other or targets cannot be written."""
    for name, value in (
        ("--rate", request.rate),
        ("--every", request.every_s),
        ("--lag", request.lag_s),
    ):
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise InputError(f"{name} is {value}; expected a finite number above 0")
    if (request.source is None) == (request.listen is None):
        raise InputError(
            "expected a recording, a file or - (standard input), or --listen; give one of them"
        )
    if request.once and request.listen is None:
        raise InputError("--once is for --listen; give both")
    if request.picture.path is not None and request.picture.path.suffix.lower() != ".png":
        raise InputError("expected a name that ends in .png", path=request.picture.path)
    if request.results is not None:
        from geograph.results.write import check_target

        check_target(request.results)


def _open(request: Request) -> tuple[Recording, Source]:
    """Return the recording, without measurements unless it is replayed, and the source."""
    from geograph.feed.replay import ReplaySource
    from geograph.feed.sources import FileSource, PipeSource
    from geograph.feed.tcp import TcpSource, parse_address
    from geograph.io.reader import read, read_setup

    name = request.source
    path = None if name in (None, "-") else Path(str(name))
    if path is not None and (path.is_dir() or path.suffix.lower() == ".zip"):
        for option, given in (("--like", request.like is not None), ("--follow", request.follow)):
            if given:
                raise InputError(f"{option} is for JSON lines; expected none beside a recording")
        recording = read(path)
        return recording, ReplaySource(recording, rate=request.rate)
    if request.rate is not None:
        raise InputError("--rate is for a recording that is replayed; leave it out")
    if request.follow and path is None:
        raise InputError("--follow is for a file; leave it out")
    if request.like is None:
        raise InputError(
            "JSON lines need --like RECORDING, whose recording.toml holds the sensors; add it"
        )
    setup = read_setup(request.like)
    if path is not None:
        return setup, FileSource(path, follow=request.follow)
    if request.listen is None:
        return setup, PipeSource()
    source = TcpSource(parse_address(request.listen), once=request.once)
    _say(f"listening on {source.place}")
    return setup, source


def _every(request: Request, recording: Recording, settings: SmoothSettings) -> float | None:
    if request.every_s is not None or request.rate is not None or not recording.tables:
        return request.every_s
    if settings.spacing_s is not None:
        return settings.spacing_s
    start, end = recording.time_span_s
    return (end - start) / _UPDATES_OF_A_REPLAY or 1.0


def _journal(
    request: Request,
    recording: Recording,
    settings: SmoothSettings,
    every_s: float | None,
    source: Source,
) -> Journal | None:
    from geograph.feed.configuration import configuration_digest, rows_digest
    from geograph.feed.journal import Journal
    from geograph.feed.replay import ReplaySource

    if request.journal is None:
        return None
    header = {
        "sensors or settings": configuration_digest(
            recording, settings, lag_s=request.lag_s, every_s=every_s
        ),
        "measurements": rows_digest(source.rows) if isinstance(source, ReplaySource) else "",
        "kinds of source": "numbered" if source.numbered else "stream",
    }
    journal = Journal(request.journal, header)
    if isinstance(source, ReplaySource):
        source.begin_after = journal.resumed.last
    return journal


def _session(
    request: Request, recording: Recording, journal: Journal | None, stack: ExitStack
) -> Session:
    from geograph.feed.assemble import Assembler
    from geograph.feed.output import FileOutput, PipeOutput
    from geograph.feed.session import Session

    updates = None if journal is None else len(journal.resumed.batches)
    output = PipeOutput() if request.output is None else FileOutput(request.output, resume=updates)
    stack.callback(output.close)
    return Session(
        engine=_engine(recording, request),
        assembler=Assembler(
            recording.sensors,
            recording.propagation_speed_m_s,
            terrain=recording.terrain is not None,
            epoch=recording.epoch,
        ),
        output=output,
        report=_say,
        journal=journal,
    )


def _engine(recording: Recording, request: Request) -> Engine:
    import logging

    from geograph.incremental.smoother import IncrementalSmoother

    # What it recovers from by itself is counted in every line, and not told on top of it.
    logging.getLogger("geograph.incremental").addHandler(logging.NullHandler())
    return IncrementalSmoother.of(recording, lag=request.lag_s, **request.changes)


def _picture(request: Request, recording: Recording) -> LivePicture | None:
    wanted = request.picture
    if not wanted.window and wanted.path is None:
        return None
    from geograph.plot.live import LivePicture

    picture = LivePicture(recording, path=wanted.path, every_s=wanted.every_s)
    if wanted.path is None and picture.path is not None:
        _say(f"no display: drawing {picture.path} instead of a window")
    return picture


def _resume(session: Session, journal: Journal, request: Request) -> None:
    resumed = journal.resumed
    if resumed.torn_bytes:
        _say(
            f"{request.journal}: the last record was torn ({resumed.torn_bytes} bytes) and is cut "
            "off; nothing of it had been used"
        )
    if resumed.batches:
        session.resume(resumed)
        _say(
            f"{request.journal}: went on from {session.counts.updates} updates with "
            f"{session.counts.used} measurements"
        )


def _end(session: Session, estimate: Estimate, request: Request, recording: Recording) -> int:
    """Write results and the last picture, say how it went, and return the exit status."""
    from geograph.feed.engine import started

    if request.results is not None and started(estimate):
        from geograph.results import from_track
        from geograph.results.write import save

        results = from_track(session.engine.track(), command=request.command)
        # The engine knows of measurements alone.
        named = replace(
            results,
            name=recording.name,
            truth=recording.truth,
            summary=results.summary | {"name": recording.name},
        )
        save(named, request.results)
    counts = session.counts
    text = (
        f"{recording.name}: {estimate.status} after {counts.updates} updates with {counts.used} "
        f"measurements, {counts.left_out} left out"
    )
    if request.output is not None:
        print(text)
    if started(estimate):
        return OK
    _say(f"{text}: {estimate.message}")
    return NOT_CONVERGED


@contextmanager
def _signals(stop: Callable[[], None]) -> Iterator[list[int]]:
    """Let the first signal to end ask for it, and the second end at once; gives what came."""
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def note(number: int, _: object) -> None:
        received.append(number)
        stop()
        for each, handler in before.items():
            signal.signal(each, handler)

    for number in before:
        signal.signal(number, note)
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _say(message: str) -> None:
    print(f"geograph: {message}", file=sys.stderr, flush=True)
