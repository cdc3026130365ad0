"""The options of ``geograph track``; what it does is imported when it is run."""

from __future__ import annotations

import shlex
from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import Annotated

import typer

from geograph.cli.options import (  # noqa: TC001 - typer evaluates the annotations
    Loss,
    Motion,
    ProcessNoise,
    ProcessNoiseAlong,
    Spacing,
    StagesOption,
)

_FEED, _PICTURE = "The feed", "Live picture"


def track(
    context: typer.Context,
    source: Annotated[
        str | None,
        typer.Argument(
            metavar="RECORDING|FILE|-",
            help="A recording, which is replayed; a file of JSON lines; or - for JSON lines from "
            "standard input. Absent with --listen.",
        ),
    ] = None,
    *,
    like: Annotated[
        Path | None,
        typer.Option(
            metavar="RECORDING",
            help="Whose recording.toml and trajectories hold the sensors and settings of JSON "
            "lines; its tables are not read.",
            rich_help_panel=_FEED,
        ),
    ] = None,
    follow: Annotated[
        bool,
        typer.Option("--follow", help="Wait for more at the end of FILE.", rich_help_panel=_FEED),
    ] = False,
    listen: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS:PORT",
            help="JSON lines from TCP connections to a loopback address; port 0: a free one.",
            rich_help_panel=_FEED,
        ),
    ] = None,
    once: Annotated[
        bool,
        typer.Option(
            "--once",
            help="With --listen: end when all connections are closed.",
            rich_help_panel=_FEED,
        ),
    ] = False,
    rate: Annotated[
        float | None,
        typer.Option(
            metavar="X",
            help="Replay a recording in X times real time; default: as fast as it goes.",
            rich_help_panel=_FEED,
        ),
    ] = None,
    every: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Seconds of the feed's time in one update. Default: what waits; for a recording "
            "without --rate the spacing of knots that it gives, or a 200th of it.",
            rich_help_panel=_FEED,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="File for the JSON lines; default: stdout."
        ),
    ] = None,
    journal: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write measurements there before they are used; given again after the process "
            "was killed, the command goes on from them.",
        ),
    ] = None,
    results: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="At the end write results there, pictures too, as geograph smooth does.",
        ),
    ] = None,
    lag: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Forget what is longer ago, so that it can run for ever; default: keep the pass.",
        ),
    ] = None,
    motion: Motion = None,
    process_noise: ProcessNoise = None,
    process_noise_along: ProcessNoiseAlong = None,
    stages: StagesOption = None,
    spacing: Spacing = None,
    loss: Loss = None,
    plot: Annotated[
        bool,
        typer.Option(
            "--plot",
            help="Show a window; on a machine without a display draw track.png instead.",
            rich_help_panel=_PICTURE,
        ),
    ] = False,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.png",
            help="Draw this file instead of a window, each time whole.",
            rich_help_panel=_PICTURE,
        ),
    ] = None,
    picture_every: Annotated[
        float,
        typer.Option(
            metavar="SECONDS",
            min=0.0,
            help="Draw no more often than that.",
            rich_help_panel=_PICTURE,
        ),
    ] = 2.0,
) -> None:
    """Track an object while its measurements come in.

    Each line in is one measurement, a JSON object with the names of a table's columns; each line
    out is the newest estimate, with the names of track.csv, the status and the sensors' errors. A
    line that cannot be used is named once on stderr and left out.

    Exit status: 0 tracked, 3 not started or not observable, 2 bad arguments or recording, 130 or
    143 stopped by a signal (after the update at hand).
    """
    from geograph.cli.run_smooth import settings_from
    from geograph.cli.run_track import Picture, Request, run_track

    request = Request(
        source=source,
        like=like,
        follow=follow,
        listen=listen,
        once=once,
        rate=rate,
        every_s=every,
        output=output,
        journal=journal,
        results=results,
        lag_s=lag,
        changes=settings_from(
            {
                "motion": motion,
                "process_noise": process_noise,
                "process_noise_along": process_noise_along,
                "stages": stages,
                "spacing_s": spacing,
                "loss": loss,
            }
        ),
        picture=Picture(window=plot and picture is None, path=picture, every_s=picture_every),
        command=shlex.join(["geograph", *context.obj]),
    )
    raise typer.Exit(run_track(request))
