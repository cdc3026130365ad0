"""Errors that geograph raises on purpose.

Each message is one line that says what was given, where, what was expected and what to do, and each
error carries the same facts as attributes, so that a program can act on them.
"""

from __future__ import annotations

from pathlib import Path


class GeographError(Exception):
    """Base of all errors raised on purpose by geograph."""


class InputError(GeographError, ValueError):
    """Something given to geograph is wrong.

    Parameters
    ----------
    message
        What was given, what was expected, and what to do, in one line.
    path
        The file it stands in, if it stands in one.
    line
        One-based line of that file (the header of a table is line 1).
    column
        Name of the column or key.
    """

    def __init__(
        self,
        message: str,
        *,
        path: Path | str | None = None,
        line: int | None = None,
        column: str | None = None,
    ) -> None:
        self.reason = " ".join(message.split())
        self.path = None if path is None else Path(path)
        self.line = line
        self.column = column
        where = "" if path is None else str(path)
        if line is not None:
            where += f":{line}" if where else f"line {line}"
        if column is not None:
            where += f", column {column}" if where else f"column {column}"
        super().__init__(f"{where}: {self.reason}" if where else self.reason)


def told(error: BaseException) -> str:
    """Return an exception in one line: its type and message, or what its type means.

    Parameters
    ----------
    error
        Any exception; many that Python raises carry no message.
    """
    name, message = type(error).__name__, " ".join(str(error).split())
    if not message:
        meaning = (type(error).__doc__ or "no reason was given").strip()
        message = meaning.splitlines()[0].rstrip(".")
    return f"{name}: {message}"


class UpdateError(InputError):
    """An update of an incremental smoother could not be made; the smoother is as it was before.

    Parameters
    ----------
    message, path, line, column
        As of :class:`InputError`.
    """


class SolveError(GeographError, RuntimeError):
    """The smoother ended without a usable answer.

    Parameters
    ----------
    message
        Why, in one line.
    status
        The solver's named status (see :class:`geograph.Status`).
    """

    def __init__(self, message: str, *, status: str) -> None:
        self.status = status
        super().__init__(" ".join(message.split()))
