"""Commands and their options; what they do is imported when they are run, so that help is quick."""

from __future__ import annotations

import shlex
from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import Annotated, Any

import typer

from geograph.cli.bound_command import bound
from geograph.cli.convert_command import convert
from geograph.cli.doctor_command import doctor
from geograph.cli.montecarlo_command import montecarlo
from geograph.cli.names import example_names
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
from geograph.cli.report_command import report
from geograph.cli.simulate_command import simulate
from geograph.cli.track_command import track

app = typer.Typer(
    name="geograph",
    help="Smoothing for passive geolocation: the path, its covariance, and every sensor's errors.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        from geograph.cli.names import versions_text

        typer.echo(versions_text())
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_show_version, is_eager=True, help="Show versions and exit."
        ),
    ] = False,
) -> None:
    del version


@app.command()
def smooth(
    context: typer.Context,
    recordings: Annotated[
        list[Path],
        typer.Argument(metavar="RECORDING...", help="Folders or .zip archives of recordings."),
    ],
    *,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="Folder for the results (replaced if it has some).",
        ),
    ],
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
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    plots: Plots = True,
) -> None:
    """Smooth recordings: path, sensor errors, residuals, pictures.

    One recording is written to DIR, several to DIR/<name>/ each, with their summaries in
    DIR/batch.csv; so is one with --scheduler, whose workers must see the same files. Exit status:
    0 converged, 3 not converged (results are written, marked), 2 bad input (nothing is written).
    """
    from geograph.cli import run_smooth

    given: dict[str, Any] = {
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
    request = run_smooth.Request(
        output=output,
        changes=run_smooth.settings_from(given),
        pictures=plots,
        command=shlex.join(["geograph", *context.obj]),
    )
    if len(recordings) == 1 and scheduler is None:
        raise typer.Exit(run_smooth.smooth_one(recordings[0], request))
    raise typer.Exit(
        run_smooth.smooth_several(recordings, request, workers=jobs, scheduler=scheduler)
    )


@app.command()
def example(
    name: Annotated[
        str | None,
        typer.Argument(
            help="winchcombe or locards; --list says what they are.", autocompletion=example_names
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="DIR", help="Folder to write.")
    ] = None,
    list_: Annotated[bool, typer.Option("--list", help="List the shipped recordings.")] = False,
) -> None:
    """Write a shipped real recording, or a set of them, ready to smooth."""
    from geograph import examples
    from geograph.errors import InputError

    if list_:
        for known, title in examples.titles().items():
            typer.echo(f"{known:<16}{title}")
        return
    if name is None or output is None:
        raise InputError("expected a name and -o DIR; the names are shown by --list")
    written = examples.write_example(name, output)
    if written == [output]:
        typer.echo(f"wrote {output}; smooth it with: geograph smooth {output} -o RESULTS")
    else:
        typer.echo(
            f"wrote {len(written)} recordings into {output}; smooth them with: "
            f"geograph smooth {output}/* -o RESULTS"
        )


@app.command()
def plot(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Results of geograph smooth.")],
) -> None:
    """Draw the pictures of a results folder again, from its files."""
    from geograph.plot import save_all
    from geograph.results import load

    for path in save_all(load(folder), folder):
        typer.echo(path)


@app.command()
def compare(
    track: Annotated[Path, typer.Argument(help="A results folder, or its track.csv.")],
    truth: Annotated[
        Path, typer.Argument(help="A truth table, or a recording or results folder that has one.")
    ],
    delay: Annotated[
        bool,
        typer.Option(
            "--delay",
            help="Fit one time by which the truth lags, as an aircraft's own reports do, and take "
            "it out.",
        ),
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print figures as JSON.")] = False,
) -> None:
    """Compare a smoothed path with the truth: errors, and whether the covariance is honest."""
    from geograph.cli.report import comparison_text
    from geograph.compare import compare as compare_paths
    from geograph.compare import read_path, read_truth
    from geograph.results.write import json_text

    found = compare_paths(read_path(track), read_truth(truth), fit_delay=delay)
    figures = found.figures()
    typer.echo(json_text(figures) if json else comparison_text(figures))


app.command()(bound)
app.command()(track)
app.command()(simulate)
app.command()(montecarlo)
app.command()(convert)
app.command()(doctor)
app.command()(report)
