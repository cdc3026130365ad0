"""The command ``geograph simulate``; what it does is imported when it is run."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import Annotated

import typer

from geograph.cli.names import scenario_names

Changes = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="A parameter of the scenario; repeatable. Several values are divided by colons (2:8).",
    ),
]


def simulate(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENARIO", help="A name that --list shows.", autocompletion=scenario_names
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="DIR", help="Folder, or .zip, to write."),
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Of the random numbers.")] = 0,
    set_: Changes = None,
    list_: Annotated[
        bool,
        typer.Option("--list", help="List the scenarios, or the parameters of the one named."),
    ] = False,
) -> None:
    """Simulate a scenario: write its recording, with the truth, ready to smooth.

    The same scenario, seed and parameters give the same recording.
    """
    from geograph.cli.run_simulate import listing, simulate_one
    from geograph.errors import InputError

    if list_:
        typer.echo(listing(name))
        return
    if name is None or output is None:
        raise InputError("expected a scenario and -o DIR; the scenarios are shown by --list")
    typer.echo(simulate_one(name, output, seed=seed, changes=set_ or ()))
