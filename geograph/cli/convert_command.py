"""The command ``geograph convert``."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import Annotated

import typer

from geograph.cli.names import one_of

FOREIGN_PANEL = "For formats whose files do not say it"


def convert(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="IN... OUT",
            help="Files of one format (.ecsv, .tdm, .iod, .uk, .mpc, or any table with --mapping), "
            "one recording, or one folder of results; then what to write: the folder or .zip of a "
            "recording, the .jsonl file of its measurements as a feed, or of results a file that "
            "ends in .oem, .geojson, .kml, .czml or .parquet.",
        ),
    ],
    *,
    clock_offset: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[SENSOR=]S",
            help="Prior 1-sigma of clocks in seconds, of all sensors or of one; repeatable; "
            "default: 1 for fireball files, else as in the station list.",
        ),
    ] = None,
    bias: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[SENSOR=]DEG",
            help="Prior 1-sigma of azimuth and elevation biases, degrees; default: 0.02 for "
            "fireball files, else as in the station list.",
        ),
    ] = None,
    sigma: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[SENSOR=]DEG",
            help="On-sky sigma of a direction, degrees; default: the file's own, else each "
            "sensor's scatter.",
        ),
    ] = None,
    stations: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Station list, .csv or .toml: where the sensors are.",
            rich_help_panel=FOREIGN_PANEL,
        ),
    ] = None,
    mapping: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Mapping, .toml: which columns of the tables mean what.",
            rich_help_panel=FOREIGN_PANEL,
        ),
    ] = None,
    format_: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="NAME",
            help="Format of the files, where their suffix does not say it: ecsv, tdm, iod, uk, mpc "
            "or mapped.",
            autocompletion=one_of("format"),
            rich_help_panel=FOREIGN_PANEL,
        ),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="The object, where the files have several.",
            rich_help_panel=FOREIGN_PANEL,
        ),
    ] = None,
    ignore: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEYWORD",
            help="Records of a tracking data message to pass over, such as RANGE; repeatable.",
            rich_help_panel=FOREIGN_PANEL,
        ),
    ] = None,
    sigma_s: Annotated[
        float | None,
        typer.Option(
            "--sigma-s",
            metavar="S",
            help="Sigma of time differences, seconds.",
            rich_help_panel=FOREIGN_PANEL,
        ),
    ] = None,
    sigma_hz: Annotated[
        float | None,
        typer.Option(
            "--sigma-hz",
            metavar="HZ",
            help="Sigma of frequency differences.",
            rich_help_panel=FOREIGN_PANEL,
        ),
    ] = None,
    carrier_hz: Annotated[
        float | None,
        typer.Option(
            "--carrier-hz",
            metavar="HZ",
            help="Frequency that the object emits.",
            rich_help_panel=FOREIGN_PANEL,
        ),
    ] = None,
    parquet: Annotated[bool, typer.Option("--parquet", help="Write Parquet tables.")] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace what is there already.")
    ] = False,
) -> None:
    """Convert files of other formats to a recording, or results to files of other formats."""
    from geograph.cli.run_convert import run_convert
    from geograph.io import ForeignOptions

    run_convert(
        paths,
        {"clock_offset_s": clock_offset, "bias_deg": bias, "sigma_deg": sigma},
        tables="parquet" if parquet else "csv",
        foreign=ForeignOptions(
            format=format_,
            stations=stations,
            mapping=mapping,
            target=target,
            ignore=tuple(ignore or ()),
            sigma_s=sigma_s,
            sigma_hz=sigma_hz,
            carrier_hz=carrier_hz,
        ),
        overwrite=overwrite,
    )
    typer.echo(f"wrote {paths[-1]}")
