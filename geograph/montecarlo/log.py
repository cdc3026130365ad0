"""The finished runs of a study in a folder, from which the study goes on.

``runs.jsonl``: the first line says what is studied, every other one is a finished run. Lines are
appended whole, one write each; what a crash left of a line is cut off when the study goes on.
"""

from __future__ import annotations

import dataclasses
import fcntl
import json
import os
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.errors import InputError
from geograph.montecarlo.trial import SCORES, Run
from geograph.results.write import plain

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path
    from types import TracebackType

LOG = "runs.jsonl"
"""Name of the log in the folder of a study."""


class RunLog:
    """The log of a study's folder, held for one study at a time.

    Parameters
    ----------
    folder
        Made if absent.
    identity
        What is studied, ready for JSON: a log of anything else is refused.

    Raises
    ------
    InputError
        If the folder holds other files but no log, the log is of another study or damaged, or
        another process has it.
    """

    def __init__(self, folder: Path, identity: Mapping[str, Any]) -> None:
        check_folder(folder, identity)
        self.path = folder / LOG
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        except OSError as error:
            raise InputError(f"cannot be written ({error.strerror})", path=folder) from None
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._descriptor)
            raise InputError(
                "is in use by another study; wait for it, or name another folder", path=self.path
            ) from None
        whole = sum(len(line) for line in _whole_lines(self.path))
        os.ftruncate(self._descriptor, whole)
        if not whole:
            self._write(dict(identity))

    def runs(self) -> Iterator[Run]:
        """Yield the finished runs."""
        for number, line in enumerate(_whole_lines(self.path), start=1):
            if number > 1:
                yield _run(line, self.path, number)

    def append(self, run: Run) -> None:
        """Keep a finished run."""
        self._write(plain(dataclasses.asdict(run)))

    def _write(self, value: Mapping[str, Any]) -> None:
        line = json.dumps(value, allow_nan=False, separators=(",", ":")).encode() + b"\n"
        if os.write(self._descriptor, line) != len(line):
            raise OSError(28, "No space left on device", str(self.path))

    def __enter__(self) -> RunLog:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        os.fsync(self._descriptor)
        os.close(self._descriptor)


def check_folder(folder: Path, identity: Mapping[str, Any]) -> None:
    """Raise InputError if a study can neither begin nor go on in a folder; write nothing.

    Parameters
    ----------
    folder
        The folder, which need not exist.
    identity
        What is studied.
    """
    above = next(parent for parent in folder.absolute().parents if parent.exists())
    if not above.is_dir() or (folder.exists() and not folder.is_dir()):
        raise InputError("is no folder, nor can be made one; name another", path=folder)
    if not folder.exists():
        return
    log = folder / LOG
    if not log.exists():
        others = sorted(entry.name for entry in folder.iterdir())
        if others:
            raise InputError(
                f"holds other files ({others[0]!r}) but no {LOG}; expected a new or empty folder, "
                "or that of a study to go on with",
                path=folder,
            )
        return
    header = next(_whole_lines(log), None)
    if header is None:
        return
    try:
        found = json.loads(header)
    except ValueError:
        found = None
    if not isinstance(found, dict):
        raise InputError("is not the log of a study; name another folder", path=log, line=1)
    for key, value in identity.items():
        if found.get(key) != value:
            raise InputError(
                f"holds runs with {key} {_short(found.get(key))}; asked for {_short(value)}; "
                "repeat the command that began it, or name another folder",
                path=folder,
            )


def _whole_lines(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        for line in file:
            if line.endswith(b"\n"):
                yield line


def _run(line: bytes, path: Path, number: int) -> Run:
    try:
        found = json.loads(line)
        for name in SCORES:
            values = [np.nan if value is None else value for value in found[name]]
            found[name] = np.array(values, dtype=np.float64)
        return Run(**found)
    except (ValueError, TypeError, KeyError):
        raise InputError(
            "is damaged; remove the line, and its run is done again", path=path, line=number
        ) from None


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
