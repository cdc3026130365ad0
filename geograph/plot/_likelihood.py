"""The picture of a posterior over ground that is no ellipse."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.bound_grid import to_plane
from geograph.plot import _style as look
from geograph.plot._bound import _label_plane, draw_ground
from geograph.plot._plane import length_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from geograph.likelihood import LikelihoodMap
    from geograph.track import Track


def likelihood_figure(track: Track, over: LikelihoodMap | None = None) -> Figure:
    """Return a figure of an emitter's posterior: 50 and 95 % contours, and the 95 % ellipse.

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
    over = over or track.likelihood_map()
    figure = look.new_figure(8.0, 7.0)
    figure.suptitle(f"{track.recording.name}: where the emitter is", x=0.01, ha="left", fontsize=12)
    ax = figure.subplots()
    unit = length_unit(max(float(np.ptp(over.east_m)), 1e-9))
    east, north = over.east_m / unit.size, over.north_m / unit.size
    terrain = track.recording.terrain
    if terrain is not None:
        draw_ground(ax, over.position_m, over.frame, east, north)
    density = np.maximum(over.log_density, over.level(0.95) - 20.0)
    for probability, shade in ((0.95, 0.25), (0.5, 0.55)):
        level = over.level(probability)
        top = max(float(density.max()), level) + 1.0
        ax.contourf(east, north, density, levels=[level, top], colors=["C0"], alpha=shade)
        ax.fill(
            [], [], color="C0", alpha=shade, label=f"{100 * probability:.0f} % of the posterior"
        )
    ellipse = track.horizontal_ellipses(0.95)
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    circle = np.stack([np.cos(angle), np.sin(angle)]) * ellipse.semi_axes_m[0][:, None]
    center = to_plane(track.position_m[0], over.center_m, over.frame)
    line = (center[:, None] + ellipse.axes[0].T @ circle) / unit.size
    ax.plot(*line, color="C3", linewidth=1.2, label="95 % ellipse of the covariance")
    ax.plot(*(center / unit.size), "+", color="C3", markersize=9, label="estimate")
    truth = track.recording.truth
    if truth is not None and len(truth):
        place = to_plane(truth.position_m.mean(axis=0), over.center_m, over.frame) / unit.size
        ax.plot(*place, "*", color="black", markersize=9, label="truth")
    _label_plane(ax, over.center_m, over.frame, unit.name)
    ax.set_aspect("equal", adjustable="box")
    rows, columns = np.nonzero(over.region(0.95))
    box = np.array(
        [
            [min(east[columns].min(), line[0].min()), max(east[columns].max(), line[0].max())],
            [min(north[rows].min(), line[1].min()), max(north[rows].max(), line[1].max())],
        ]
    )
    margin = 0.15 * float(np.ptp(box, axis=1).max())
    ax.set_xlim(box[0, 0] - margin, box[0, 1] + margin)
    ax.set_ylim(box[1, 0] - margin, box[1, 1] + margin)
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower left", ncols=3)
    return figure
