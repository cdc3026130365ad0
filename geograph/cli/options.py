"""Options that several commands have."""

from __future__ import annotations

from typing import Annotated

import typer

from geograph.cli.names import one_of

SETTINGS_PANEL = "Settings that override the recording's own"

Motion = Annotated[
    str | None,
    typer.Option(
        help="static, constant-position, constant-velocity, constant-acceleration, ballistic "
        "or orbital.",
        autocompletion=one_of("motion"),
        rich_help_panel=SETTINGS_PANEL,
    ),
]
ProcessNoise = Annotated[
    str | None,
    typer.Option(
        metavar="NOISE",
        help="Square root of the spectral density of the motion's noise, SI; one number, three "
        "(x,y,z), or auto.",
        rich_help_panel=SETTINGS_PANEL,
    ),
]
ProcessNoiseAlong = Annotated[
    float | None,
    typer.Option(
        metavar="NOISE",
        help="The same along the velocity; --process-noise is then that across it.",
        rich_help_panel=SETTINGS_PANEL,
    ),
]
StagesOption = Annotated[
    str | None,
    typer.Option(
        "--stages",
        metavar="STAGES",
        help="Pieces of time in which the noise differs: auto finds them; none; or "
        "FROM_S:TIMES,... how many times the noise from then on.",
        rich_help_panel=SETTINGS_PANEL,
    ),
]
Spacing = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", help="Time between knots.", rich_help_panel=SETTINGS_PANEL),
]
Loss = Annotated[
    str | None,
    typer.Option(
        help="auto, none, huber, cauchy, geman-mcclure or gnc.",
        autocompletion=one_of("loss"),
        rich_help_panel=SETTINGS_PANEL,
    ),
]
MaxIterations = Annotated[
    int | None,
    typer.Option(
        metavar="N", help="Limit of iterations of one solve.", rich_help_panel=SETTINGS_PANEL
    ),
]
Elimination = Annotated[
    str | None,
    typer.Option(
        help="Who factorises the linear systems: structured (our own) or gtsam.",
        autocompletion=one_of("elimination"),
        rich_help_panel=SETTINGS_PANEL,
    ),
]
Moon = Annotated[
    bool | None,
    typer.Option(
        "--moon/--no-moon",
        help="Pull of the Moon (motion orbital).",
        rich_help_panel=SETTINGS_PANEL,
    ),
]
Sun = Annotated[
    bool | None,
    typer.Option(
        "--sun/--no-sun", help="Pull of the Sun (motion orbital).", rich_help_panel=SETTINGS_PANEL
    ),
]
Drag = Annotated[
    float | None,
    typer.Option(
        metavar="M2_KG",
        help="Drag: coefficient times area over mass, m2/kg (motion orbital).",
        rich_help_panel=SETTINGS_PANEL,
    ),
]
DragSigma = Annotated[
    float | None,
    typer.Option(
        metavar="M2_KG",
        help="Prior sigma of --drag-m2-kg, which is then estimated.",
        rich_help_panel=SETTINGS_PANEL,
    ),
]
AccelerationSigma = Annotated[
    float | None,
    typer.Option(
        metavar="M_S2",
        help="Prior sigma of an unknown constant acceleration, which is estimated (motion "
        "orbital).",
        rich_help_panel=SETTINGS_PANEL,
    ),
]
AccelerationAxes = Annotated[
    str | None,
    typer.Option(
        metavar="AXES",
        help="Along which it is constant: rtn (radial, transverse, normal) or inertial.",
        rich_help_panel=SETTINGS_PANEL,
    ),
]
Plots = Annotated[bool, typer.Option("--plots/--no-plots", help="Draw pictures.")]
Jobs = Annotated[
    int | None,
    typer.Option(metavar="N", min=1, help="Processes; default: one for each core."),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Use the workers of this Dask scheduler instead, tcp://host:port.",
    ),
]
