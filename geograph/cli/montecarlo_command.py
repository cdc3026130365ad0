"""The command ``geograph montecarlo``; what it does is imported when it is run."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import Annotated

import typer

from geograph.cli.names import scenario_names
from geograph.cli.options import (  # noqa: TC001 - typer evaluates the annotations
    AccelerationAxes,
    AccelerationSigma,
    Drag,
    DragSigma,
    Elimination,
    Jobs,
    Loss,
    MaxIterations,
    Moon,
    Motion,
    Plots,
    ProcessNoise,
    ProcessNoiseAlong,
    Scheduler,
    Spacing,
    StagesOption,
    Sun,
)
from geograph.cli.simulate_command import Changes  # noqa: TC001 - typer evaluates the annotations


def montecarlo(
    name: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO",
            help="A name that geograph simulate --list shows.",
            autocompletion=scenario_names,
        ),
    ],
    *,
    runs: Annotated[
        int, typer.Option(metavar="N", min=1, help="Runs, of each point of a sweep.")
    ] = 100,
    seed: Annotated[
        int, typer.Option(metavar="N", min=0, help="Of the first run; run i has seed N + i.")
    ] = 0,
    set_: Changes = None,
    sweep: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=V1,V2,...",
            help="Values of a parameter, each a point of its own; twice for every pair.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="Folder for log, figures and pictures. Finished runs are kept there: the same "
            "command goes on where it ended.",
        ),
    ] = None,
    json: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the figures there too.")
    ] = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    motion: Motion = None,
    process_noise: ProcessNoise = None,
    process_noise_along: ProcessNoiseAlong = None,
    stages: StagesOption = None,
    moon: Moon = None,
    sun: Sun = None,
    drag_m2_kg: Drag = None,
    drag_sigma_m2_kg: DragSigma = None,
    acceleration_sigma_m_s2: AccelerationSigma = None,
    acceleration_axes: AccelerationAxes = None,
    spacing: Spacing = None,
    loss: Loss = None,
    max_iterations: MaxIterations = None,
    elimination: Elimination = None,
    plots: Plots = True,
) -> None:
    """Smooth a scenario many times: how far from the bound, and how honest the covariance.

    Exit status: 0; 1 a run ended in an unexpected error; 3 no run converged; 2 bad input (nothing
    is written).
    """
    from geograph.cli import run_montecarlo
    from geograph.cli.run_smooth import settings_from

    request = run_montecarlo.Request(
        name=name,
        runs=runs,
        seed=seed,
        set=tuple(set_ or ()),
        sweep=tuple(sweep or ()),
        changes=settings_from(
            {
                "motion": motion,
                "process_noise": process_noise,
                "process_noise_along": process_noise_along,
                "stages": stages,
                "moon": moon,
                "sun": sun,
                "drag_m2_kg": drag_m2_kg,
                "drag_sigma_m2_kg": drag_sigma_m2_kg,
                "acceleration_sigma_m_s2": acceleration_sigma_m_s2,
                "acceleration_axes": acceleration_axes,
                "spacing_s": spacing,
                "loss": loss,
                "max_iterations": max_iterations,
                "elimination": elimination,
            }
        ),
        output=output,
        json=json,
        jobs=jobs,
        scheduler=scheduler,
        pictures=plots,
    )
    raise typer.Exit(run_montecarlo.montecarlo(request))
