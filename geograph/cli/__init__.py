"""The command line: ``geograph COMMAND ...``.

Exit status: 0 converged; 1 something unexpected; 2 bad input, said in one line and nothing written;
3 not converged or unobservable (results are written, and marked); 4 ``doctor`` has something to
object; 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

OK, UNEXPECTED, BAD_INPUT, NOT_CONVERGED, FINDINGS = 0, 1, 2, 3, 4
INTERRUPTED, BROKEN_PIPE = 130, 141


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit status.

    Parameters
    ----------
    arguments
        Without the program's name; None: those of this process.
    """
    from geograph.cli.app import app
    from geograph.errors import GeographError

    words = sys.argv[1:] if arguments is None else list(arguments)
    try:
        status = app(args=words, prog_name="geograph", standalone_mode=False, obj=words)
        sys.stdout.flush()
    except GeographError as error:
        return _complain(str(error), BAD_INPUT)
    except KeyboardInterrupt:
        status = INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output has gone; the interpreter must not try to flush it again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = BROKEN_PIPE
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _complain(f"{where}{error.strerror or error}", UNEXPECTED)
    except Exception as error:
        status = _usage_status(error)
        if status is None:
            raise
    return status if isinstance(status, int) else OK


def _usage_status(error: Exception) -> int | None:
    """Return the status of a usage error or an abort, which have no class common to all typers."""
    if hasattr(error, "format_message"):
        message = error.format_message()
        # Without any argument the help was shown already.
        return _complain(f"{message} (see geograph --help)", BAD_INPUT) if message else BAD_INPUT
    return INTERRUPTED if type(error).__name__ == "Abort" else None


def _complain(message: str, status: int) -> int:
    print(f"geograph: error: {' '.join(message.split())}", file=sys.stderr)
    return status
