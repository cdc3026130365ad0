"""JSON lines out: the newest knot after every update, with the names of ``track.csv``."""

from __future__ import annotations

import json
import os
import sys
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from geograph.errors import InputError
from geograph.feed.engine import started
from geograph.geodesy import geodetic_from_ecef
from geograph.results import names
from geograph.results.write import plain

if TYPE_CHECKING:
    from pathlib import Path

    from geograph.feed.engine import Estimate


def estimate_line(estimate: Estimate, *, update: int, final: bool = False) -> str:
    """Return one line, with its end.

    Parameters
    ----------
    estimate
        The newest.
    update
        Which update it is of, from 1.
    final
        Whether the feed has ended and nothing waits any more.
    """
    facts: dict[str, Any] = {"update": update, "status": str(estimate.status)}
    if final:
        facts["final"] = True
    if started(estimate):
        facts |= _knot(estimate)
    facts |= {
        "message": estimate.message,
        "used": estimate.used,
        "waiting": len(estimate.waiting),
        "rejected": estimate.rejected_count,
        "late": estimate.late_count,
        "duplicates": estimate.duplicate_count,
        "rebuilt": estimate.rebuilt,
    }
    facts["sensors"] = {
        sensor: {state: [found.estimate, found.sigma] for state, found in states.items()}
        for sensor, states in estimate.sensor_errors.items()
    }
    return json.dumps(plain(facts), allow_nan=False, ensure_ascii=False) + "\n"


def _knot(estimate: Estimate) -> dict[str, Any]:
    state, covariance = np.asarray(estimate.state), np.asarray(estimate.covariance)
    facts: dict[str, Any] = {"time_s": estimate.time_s}
    columns = (names.POSITION, names.VELOCITY, names.ACCELERATION)
    for index, columns_of in enumerate(columns[: state.size // 3]):
        facts |= dict(zip(columns_of, state[3 * index : 3 * index + 3].tolist(), strict=True))
    facts |= {name: float(covariance[at]) for name, at in names.COVARIANCE.items()}
    if estimate.frame == "ecef":
        facts |= dict(zip(names.GEODETIC, geodetic_from_ecef(state[:3]).tolist(), strict=True))
    return facts


class Output(Protocol):
    """Where lines go."""

    def resume(self, line: str, update: int, *, last: bool) -> None:
        """Take the line of an update that a journal held; ``last``: no more of them follow."""

    def write(self, line: str, update: int, *, final: bool = False) -> None:
        """Take a line."""

    def close(self) -> None:
        """End."""


class PipeOutput:
    """Standard output. Of the updates of a journal the last is shown: where the feed stands."""

    def resume(self, line: str, update: int, *, last: bool) -> None:
        """Write the line if it is the last."""
        if last:
            self.write(line, update)

    def write(self, line: str, update: int, *, final: bool = False) -> None:
        """Write the line at once."""
        del update, final
        sys.stdout.write(line)
        sys.stdout.flush()

    def close(self) -> None:
        """Nothing is open."""


class FileOutput:
    """A file that holds one line for every update, and each line whole.

    A line is written by one call and counts when its end is there: what a killed process left of
    one is cut off by the next.

    Parameters
    ----------
    path
        The file.
    resume
        Updates that a journal holds: lines of the file are kept, and those of the same updates not
        written again. None: the file is begun anew.

    Raises
    ------
    InputError
        If it cannot be written, or holds something else.
    """

    def __init__(self, path: Path, *, resume: int | None) -> None:
        self._path = path
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
            with open(self._descriptor, "rb", closefd=False) as file:
                content = file.read()
        except OSError as error:
            raise InputError(
                f"cannot be written ({error.strerror}); name another file", path=path
            ) from None
        if content and not content.startswith(b'{"update": '):
            os.close(self._descriptor)
            raise InputError(
                "holds something else than lines of geograph track and is not overwritten; name "
                "another file",
                path=path,
            )
        self._end = content.rfind(b"\n") + 1 if resume else 0
        last = json.loads(content[: self._end].splitlines()[-1]) if self._end else {}
        self._update, self._final = int(last.get("update", 0)), bool(last.get("final"))
        if resume is not None and self._update > resume:
            os.close(self._descriptor)
            raise InputError(
                f"has a line of update {self._update}, and the journal {resume} updates; expected "
                "the file that was written with this journal; name another",
                path=path,
            )
        os.ftruncate(self._descriptor, self._end)

    def resume(self, line: str, update: int, *, last: bool) -> None:
        """Write the line if the file does not have it."""
        del last
        self.write(line, update)

    def write(self, line: str, update: int, *, final: bool = False) -> None:
        """Write a line that the file does not have.

        Raises
        ------
        OSError
            If that fails. The file then ends with a whole line.
        """
        if update < self._update or (update == self._update and (self._final or not final)):
            return
        data = memoryview(line.encode())
        try:
            written = 0
            while written < len(data):
                written += os.pwrite(self._descriptor, data[written:], self._end + written)
        except OSError as error:
            os.ftruncate(self._descriptor, self._end)
            reason = f"{error.strerror}; the file ends with a whole line"
            raise OSError(error.errno, reason, str(self._path)) from error
        self._end += len(data)
        self._update, self._final = update, final

    def close(self) -> None:
        """Close the file."""
        os.close(self._descriptor)
