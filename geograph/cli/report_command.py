"""The command ``geograph report``."""

from __future__ import annotations

import shlex
from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import Annotated

import typer


def report(
    context: typer.Context,
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="Results of geograph smooth, of one recording or of several."
        ),
    ],
    *,
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="FILE", help="The page to write, FILE.html."),
    ],
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace what is there already.")
    ] = False,
) -> None:
    """Write one page of results that opens without a network: pictures, tables, a slider in time.

    Of several recordings the page shows one at a time.
    """
    from geograph.errors import InputError

    if output.exists() and not overwrite:
        raise InputError("is there already; give --overwrite, or name another", path=output)
    from geograph.report_page import read_results, write_report

    command = shlex.join(["geograph", *context.obj])
    write_report(read_results(folder), output, command=command)
    typer.echo(f"wrote {output}")
