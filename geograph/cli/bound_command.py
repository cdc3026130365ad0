"""The options of ``geograph bound``; what it does is imported when it is run."""

from __future__ import annotations

import shlex
from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import Annotated

import typer

from geograph.cli.options import (  # noqa: TC001 - typer evaluates the annotations
    AccelerationAxes,
    AccelerationSigma,
    Drag,
    DragSigma,
    Elimination,
    Moon,
    Motion,
    Plots,
    ProcessNoise,
    ProcessNoiseAlong,
    Spacing,
    Sun,
)

_SIGNAL = "Signal, in place of the sigmas of arrivals and differences (all three together)"
_MAP = "Map"


def bound(
    context: typer.Context,
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="Folder or .zip of a recording. Only times, sensors and sigmas matter where it "
            "has a truth.csv; otherwise its path is estimated first.",
        ),
    ],
    *,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="Folder for tables and pictures (replaced if it holds a bound).",
        ),
    ] = None,
    motion: Motion = None,
    process_noise: ProcessNoise = None,
    process_noise_along: ProcessNoiseAlong = None,
    moon: Moon = None,
    sun: Sun = None,
    drag_m2_kg: Drag = None,
    drag_sigma_m2_kg: DragSigma = None,
    acceleration_sigma_m_s2: AccelerationSigma = None,
    acceleration_axes: AccelerationAxes = None,
    spacing: Spacing = None,
    elimination: Elimination = None,
    snr_db: Annotated[
        float | None,
        typer.Option(
            metavar="DB",
            help="Ratio of signal to noise power in the band, at every receiver.",
            rich_help_panel=_SIGNAL,
        ),
    ] = None,
    band_hz: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="LOW HIGH",
            help="Lowest and highest frequency of the band.",
            rich_help_panel=_SIGNAL,
        ),
    ] = None,
    integration_s: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="How long each measurement integrates.",
            rich_help_panel=_SIGNAL,
        ),
    ] = None,
    coherent: Annotated[
        bool | None,
        typer.Option(
            "--coherent/--envelope",
            help="Whether the carrier's phase is used; default: where the envelope tells its "
            "cycles apart.",
            rich_help_panel=_SIGNAL,
            show_default=False,
        ),
    ] = None,
    map_: Annotated[
        bool,
        typer.Option(
            "--map",
            help="The bound of an emitter that stands still, over a grid of its positions.",
            rich_help_panel=_MAP,
        ),
    ] = False,
    extent_m: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            help="Side of the map; default: it holds path and sensors.",
            rich_help_panel=_MAP,
        ),
    ] = None,
    cells: Annotated[
        int,
        typer.Option(metavar="N", help="Cells along a side of the map.", rich_help_panel=_MAP),
    ] = 41,
    plots: Plots = True,
) -> None:
    """Show how well any estimator could do: the Cramer-Rao bound of a recording's geometry.

    The bound holds for the sigmas given, with all errors of the sensors and the process noise.

    Written to DIR, if one is given: bound.csv, bound.json and bound.png; with a map also
    bound_map.csv and bound_map.png. Exit status: 0 observable, 3 not observable (what is missing
    is named), 2 bad input (nothing is written).
    """
    from geograph.cli.run_bound import Request, run_bound, signal_from
    from geograph.cli.run_smooth import settings_from
    from geograph.errors import InputError

    if extent_m is not None and not map_:
        raise InputError("--extent-m is the side of a map; give --map too")
    request = Request(
        output=output,
        changes=settings_from(
            {
                "motion": motion,
                "process_noise": process_noise,
                "process_noise_along": process_noise_along,
                "moon": moon,
                "sun": sun,
                "drag_m2_kg": drag_m2_kg,
                "drag_sigma_m2_kg": drag_sigma_m2_kg,
                "acceleration_sigma_m_s2": acceleration_sigma_m_s2,
                "acceleration_axes": acceleration_axes,
                "spacing_s": spacing,
                "elimination": elimination,
            }
        ),
        signal=signal_from(snr_db, band_hz, integration_s, coherent),
        mapped=map_,
        extent_m=extent_m,
        cells=cells,
        pictures=plots,
        command=shlex.join(["geograph", *context.obj]),
    )
    raise typer.Exit(run_bound(recording, request))
