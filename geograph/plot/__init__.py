"""Pictures of a smoothed path.

Each function takes a track, or the results read back from a folder, and draws on the axes given or
on those of a new figure; :func:`save_all` writes the pictures of a results folder.

    >>> import geograph.plot
    >>> "path.png" in geograph.plot.PICTURES
    True
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from geograph.plot import _style as look
from geograph.plot._ground import draw_path, draw_sensors_alone, sensors_crowded
from geograph.plot._platforms import platform_figure
from geograph.plot._residuals import draw_normalised, residual_figure
from geograph.plot._sensors import draw_curves, draw_errors_in_sigmas, error_figure
from geograph.plot._time import (
    draw_facts,
    draw_height,
    draw_height_spread,
    draw_horizontal,
    draw_side_view,
    draw_speed,
    draw_speed_spread,
)
from geograph.results import as_results
from geograph.results.names import PICTURES, PLATFORM_PICTURE

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from geograph.likelihood import LikelihoodMap
    from geograph.results import Results
    from geograph.track import Track

__all__ = [
    "PICTURES",
    "height",
    "likelihood",
    "overview",
    "path",
    "residuals",
    "save_all",
    "sensor_error_curves",
    "sensor_errors",
    "side_view",
    "speed",
]


def likelihood(track: Track, over: LikelihoodMap | None = None) -> Figure:
    """Return a figure of an emitter's posterior over ground, with its contours and the ellipse.

    Parameters
    ----------
    track
        Of an emitter that stands still.
    over
        Its :meth:`geograph.Track.likelihood_map`; None: made here.

    Raises
    ------
    InputError
        If the object moves.
    """
    from geograph.plot._likelihood import likelihood_figure

    return likelihood_figure(track, over)


def path(track: Track | Results, ax: Axes | None = None, *, sensors: bool = True) -> Axes:
    """Draw the path over ground with its 95 % ellipses.

    Parameters
    ----------
    track
        A track or its results.
    ax
        Axes to draw on; None: those of a new figure.
    sensors
        Whether to draw the sensors and some of their bearings, as measured.

    Returns
    -------
    Axes
        East and north of the path's middle on the tangent plane, or x and y of a local frame.
    """
    ax = look.axes_or_new(ax, 7.0, 6.0)
    draw_path(as_results(track), ax, sensors=sensors)
    return ax


def height(track: Track | Results, ax: Axes | None = None) -> Axes:
    """Draw the height above the ellipsoid (z in a local frame) against time, with a 95 % band."""
    ax = look.axes_or_new(ax)
    draw_height(as_results(track), ax)
    return ax


def side_view(track: Track | Results, ax: Axes | None = None) -> Axes:
    """Draw the height against the distance over ground, with 95 % ellipses, to one scale."""
    ax = look.axes_or_new(ax)
    draw_side_view(as_results(track), ax)
    return ax


def speed(track: Track | Results, ax: Axes | None = None) -> Axes:
    """Draw the speed in the recording's frame against time, with a 95 % band."""
    ax = look.axes_or_new(ax)
    draw_speed(as_results(track), ax)
    return ax


def residuals(track: Track | Results, ax: Axes | None = None) -> Axes:
    """Draw residuals over their sigmas against time; what was rejected is crossed out."""
    ax = look.axes_or_new(ax)
    draw_normalised(as_results(track), ax)
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return ax


def sensor_errors(track: Track | Results, ax: Axes | None = None) -> Axes:
    """Draw estimated sensor errors over their prior sigmas, with 95 % bars."""
    ax = look.axes_or_new(ax)
    draw_errors_in_sigmas(as_results(track), ax)
    return ax


def sensor_error_curves(
    track: Track | Results,
    ax: Axes | None = None,
    *,
    kind: Literal["azimuth", "elevation", "clock", "frequency"] = "azimuth",
) -> Axes:
    """Draw one kind of sensor error against time, for the sensors where it drifts or walks."""
    ax = look.axes_or_new(ax)
    draw_curves(as_results(track), ax, kind)
    return ax


def overview(track: Track | Results) -> Figure:
    """Return one page that shows path, height, speed, residuals and sensor errors."""
    results = as_results(track)
    figure = look.new_figure(16.0, 9.5)
    look.headline(figure, results, _verdict(results))
    # Columns of their own: the labels of one must not set the margins of another.
    parts = figure.subfigures(1, 3, squeeze=False, width_ratios=[1.2, 0.9, 1.1])
    left, middle, right = parts[0]
    where, close = left.subplots(2, 1, height_ratios=[2.2, 1.0])
    draw_path(results, where, sensors=True)
    draw_path(results, close, sensors=False, legend=False)
    close.set_title("the position alone" if results.static else "the path alone")
    panels = _middle_panels(results)
    for draw, ax in zip(panels, middle.subplots(len(panels), 1, squeeze=False)[:, 0], strict=True):
        draw(results, ax)
        if draw is draw_sensors_alone:
            ax.set_title("the sensors alone")
    over, under = right.subplots(2, 1, height_ratios=[1.0, 1.8])
    draw_normalised(results, over)
    draw_errors_in_sigmas(results, under)
    return figure


def _middle_panels(results: Results) -> list[Callable[[Results, Axes], None]]:
    """Return what stands in the middle of the overview: only what says something."""
    if results.static:
        return [draw_facts, draw_sensors_alone] if sensors_crowded(results) else [draw_facts]
    height = draw_horizontal if results.height_held else draw_height
    return [height] if results.velocity_m_s is None else [height, draw_speed]


def save_all(track: Track | Results, folder: Path) -> tuple[Path, ...]:
    """Draw all pictures of a track into an existing folder, and return their paths.

    Parameters
    ----------
    track
        A track or its results.
    folder
        Where to write; see :data:`PICTURES` for the names. Without a velocity there is no
        ``speed.png``; where the object is at rest, or its height given, no ``height.png``; and
        with platforms whose path is estimated there is a ``platforms.png``.
    """
    results = as_results(track)
    makers: dict[str, Callable[[Results], Figure]] = {
        "overview.png": overview,
        "path.png": _path_figure,
        "residuals.png": residual_figure,
        "sensor_errors.png": error_figure,
    }
    if not (results.static or results.height_held):
        makers["height.png"] = _height_figure
    if results.platforms:
        makers[PLATFORM_PICTURE] = platform_figure
    if results.velocity_m_s is not None:
        makers["speed.png"] = _speed_figure
    written = []
    with look.style():
        for name, make in makers.items():
            target = folder / name
            # Under its name only when it is whole.
            draft = folder / f".{name}.draft"
            make(results).savefig(draft, format="png")
            draft.replace(target)
            written.append(target)
    return tuple(written)


def _path_figure(results: Results) -> Figure:
    crowded = sensors_crowded(results)
    figure = look.new_figure(17.0 if crowded else 13.0, 6.5)
    what = "position" if results.static else "path"
    look.headline(figure, results, f"{what} over ground")
    left, right, *more = figure.subplots(1, 3 if crowded else 2)
    draw_path(results, left, sensors=True)
    bearings = (results.residuals.kind == "azimuth").any()
    left.set_title("with sensors and some of their bearings" if bearings else "with the sensors")
    draw_path(results, right, sensors=False)
    right.set_title(f"the {what} alone")
    for ax in more:
        draw_sensors_alone(results, ax)
        ax.set_title("the sensors alone")
    return figure


def _height_figure(results: Results) -> Figure:
    figure = look.new_figure(13.0, 6.0)
    look.headline(figure, results, "height")
    left, right = figure.subfigures(1, 2, squeeze=False)[0]
    value, spread = left.subplots(2, 1, sharex=True, height_ratios=[2.5, 1.0])
    draw_height(results, value)
    draw_height_spread(results, spread)
    value.set_xlabel("")
    ax = right.subplots()
    draw_side_view(results, ax)
    ax.set_title("from the side")
    return figure


def _speed_figure(results: Results) -> Figure:
    figure = look.new_figure(8.0, 6.0)
    look.headline(figure, results, "speed")
    value, spread = figure.subplots(2, 1, sharex=True, height_ratios=[2.5, 1.0])
    draw_speed(results, value)
    draw_speed_spread(results, spread)
    value.set_xlabel("")
    return figure


def _verdict(results: Results) -> str:
    facts = results.summary
    chi2, degrees = facts.get("chi2"), facts.get("degrees_of_freedom")
    fit = f", chi2/dof {chi2:.1f}/{degrees}" if chi2 is not None and degrees else ""
    lost = len(facts.get("rejected") or ())
    rejected = f", {lost} rejected" if lost else ""
    return f"{facts.get('measurements', 0)} measurements{rejected}{fit}"
