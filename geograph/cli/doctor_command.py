"""The command ``geograph doctor``."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import Annotated

import typer


def doctor(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="Folder or .zip archive of a recording.")
    ],
    json: Annotated[
        bool, typer.Option("--json", help="Print summary and findings as JSON.")
    ] = False,
) -> None:
    """Look at a recording before solving it: units, signs, places, clocks, sigmas.

    Exit status: 0 nothing to object (or notes only), 4 problems or questions, 2 bad input.
    """
    from geograph.cli.run_doctor import run_doctor

    raise typer.Exit(run_doctor(recording, json=json))
