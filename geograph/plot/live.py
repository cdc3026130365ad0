"""The live picture: path, newest ellipse, uncertainty and sensor errors while they are estimated.

It is drawn between updates. A drawing takes far longer than an update, so it is left out until the
time since the last one is ten times what that took: tracking keeps nine tenths of the machine.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.ellipsoids import ellipsoids
from geograph.feed.engine import started
from geograph.plot import _style as look
from geograph.plot._plane import Plane, extent, length_unit, plane_at
from geograph.results.data import ELLIPSOID_PROBABILITY
from geograph.units import fitting_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from geograph.feed.engine import Estimate
    from geograph.recording import Recording

_SHARE = 0.1
_MOST_KNOTS = 4000
_DEFAULT_FILE = "track.png"


class LivePicture:
    """A window, or a file that is replaced as a whole, with what is known so far.

    Parameters
    ----------
    recording
        Its sensors and frame.
    path
        File to draw; None: a window, or ``track.png`` where there can be none.
    every_s
        Seconds from one drawing to the next, at least.

    Attributes
    ----------
    path
        File that is drawn, or None for a window.
    """

    def __init__(
        self, recording: Recording, *, path: Path | None = None, every_s: float = 2.0
    ) -> None:
        self._recording = recording
        self._every_s = every_s
        self._next = -np.inf
        self._time: list[float] = []
        self._position: list[NDArray[np.float64]] = []
        self._semi_axes: list[NDArray[np.float64]] = []
        self._newest: Estimate | None = None
        self._window = None if path is not None else _open_window()
        self.path = path if path is not None or self._window else Path(_DEFAULT_FILE)

    def show(self, estimate: Estimate) -> None:
        """Take an estimate, and draw if it is time."""
        self._newest = estimate
        if started(estimate):
            self._remember(estimate)
        if time.monotonic() >= self._next:
            self.draw()

    def draw(self) -> None:
        """Draw what is known."""
        if self._newest is None:
            return
        began = time.monotonic()
        with look.style():
            if self._window is not None:
                self._draw_window(self._window)
            elif self.path is not None:
                figure = look.new_figure(13.0, 6.5)
                self._draw(figure)
                draft = self.path.with_name(f".{self.path.name}.draft")
                figure.savefig(draft, format="png", dpi=100)
                draft.replace(self.path)
        took = time.monotonic() - began
        self._next = time.monotonic() + max(self._every_s, took * (1.0 - _SHARE) / _SHARE)

    def _remember(self, estimate: Estimate) -> None:
        assert estimate.time_s is not None
        position = np.asarray(estimate.state)[:3]
        covariance = np.asarray(estimate.covariance)[None, :3, :3]
        axes = ellipsoids(position[None], covariance, ELLIPSOID_PROBABILITY)
        if len(self._time) >= _MOST_KNOTS:
            # Every second one is as good a picture.
            del self._time[1::2], self._position[1::2], self._semi_axes[1::2]
        self._time.append(float(estimate.time_s))
        self._position.append(position)
        self._semi_axes.append(axes.semi_axes_m[0])

    def _draw_window(self, figure: Figure) -> None:
        from matplotlib import pyplot as plt

        if not plt.fignum_exists(figure.number):
            # Closed by the user; tracking goes on.
            self._window = None
            return
        figure.clear()
        self._draw(figure)
        figure.canvas.draw_idle()
        figure.canvas.flush_events()

    def _draw(self, figure: Figure) -> None:
        estimate = self._newest
        assert estimate is not None
        colour = look.BLACK if self._time else look.ALARM
        moment = f", {self._time[-1]:.6g} s" if self._time else ""
        figure.suptitle(
            f"{self._recording.name}: {estimate.status}{moment}",
            x=0.01,
            ha="left",
            fontsize=12,
            color=colour,
        )
        left, right = figure.subfigures(1, 2, squeeze=False, width_ratios=[1.2, 1.0])[0]
        self._draw_path(left.subplots())
        spread, errors = right.subplots(2, 1)
        self._draw_spread(spread)
        _draw_errors(errors, estimate)

    def _places(self) -> dict[str, NDArray[np.float64]]:
        moment = self._time[-1] if self._time else 0.0
        return {
            name: np.asarray(sensor.position_at(moment))
            for name, sensor in self._recording.sensors.items()
        }

    def _draw_path(self, ax: Axes) -> None:
        places = self._places()
        points = np.array(self._position) if self._position else np.array(list(places.values()))
        plane = plane_at(points[len(points) // 2], self._recording.frame)
        flat = plane.project(points)
        sensors = {name: plane.project(place) for name, place in places.items()}
        whole = extent(np.concatenate([flat, np.array(list(sensors.values()))]))
        unit = length_unit(whole)
        for index, (name, place) in enumerate(sensors.items()):
            style = look.sensor_look(index)
            ax.plot(*(place / unit.size), ls="none", mec="black", mew=0.6, **style)
            if len(sensors) <= 12:
                ax.annotate(
                    name,
                    tuple(place / unit.size),
                    xytext=(5, 5),
                    textcoords="offset points",
                    fontsize=8,
                )
        if self._position:
            ax.plot(*flat.T / unit.size, color=look.PATH, lw=1.5, label="newest positions")
            ax.plot(*flat[-1] / unit.size, "o", ms=5, color=look.PATH)
            self._draw_ellipse(ax, plane, flat[-1], whole=whole, unit=unit.size)
            ax.legend(loc="upper left", bbox_to_anchor=(0.0, -0.1), ncols=2)
        ax.set_xlabel(f"{plane.across} ({unit.name})")
        ax.set_ylabel(f"{plane.along} ({unit.name})")
        ax.set_aspect("equal", adjustable="datalim")
        ax.margins(0.1)

    def _draw_ellipse(
        self, ax: Axes, plane: Plane, centre: NDArray[np.float64], *, whole: float, unit: float
    ) -> None:
        assert self._newest is not None
        covariance = np.asarray(self._newest.covariance)[None, :3, :3]
        outline = look.ellipse_outline(plane.covariance(covariance))
        factor = look.magnification(outline, whole)
        label = "95 % ellipse" + (f", drawn {factor:.0f} times larger" if factor > 1.0 else "")
        ax.plot(*(centre + factor * outline[0]).T / unit, color=look.ALARM, lw=1.2, label=label)

    def _draw_spread(self, ax: Axes) -> None:
        ax.set_title("semi-axes of the newest 95 % ellipsoid")
        look.label_time(ax, "time (s)")
        if not self._semi_axes:
            return
        axes = np.array(self._semi_axes)
        unit = fitting_unit("m", axes[-1])
        for name, column, colour in zip(
            ("major", "middle", "minor"), axes.T, (look.PATH, look.GREEN, look.ORANGE), strict=True
        ):
            ax.plot(self._time, column / unit.size, color=colour, label=name)
        ax.set_yscale("log")
        # Plain numbers: the style draws no formulas.
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter("")
        ax.set_ylabel(f"({unit.name})")
        ax.legend(loc="upper right", ncols=3)


def _draw_errors(ax: Axes, estimate: Estimate) -> None:
    """Draw the sensors' errors over their prior sigmas, with 95 % bars."""
    ax.set_title("sensor errors over prior sigmas, 95 %")
    rows = [
        (f"{sensor} {state.replace('_', ' ')}", found)
        for sensor, states in estimate.sensor_errors.items()
        for state, found in states.items()
        if found.prior_sigma > 0.0
    ]
    if not rows:
        ax.set_axis_off()
        ax.text(0.5, 0.5, "none are estimated", ha="center", transform=ax.transAxes)
        return
    # Those that are known best first; more than a page can name are left out.
    rows = sorted(rows, key=lambda row: row[1].sigma / row[1].prior_sigma)[:20]
    place: Any = np.arange(len(rows))[::-1]
    centre = [found.estimate / found.prior_sigma for _, found in rows]
    bars = [look.NORMAL_95 * found.sigma / found.prior_sigma for _, found in rows]
    ax.axvspan(-look.NORMAL_95, look.NORMAL_95, color=look.PRIOR, alpha=0.5, lw=0)
    ax.errorbar(centre, place, xerr=bars, fmt="o", ms=4, color=look.PATH, capsize=2)
    ax.set_yticks(place, [name for name, _ in rows])


def _open_window() -> Figure | None:
    """Return the figure of a new window, or None where there can be none."""
    named = os.environ.get("MPLBACKEND", "")
    display = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    if sys.platform == "linux" and not display and not named:
        return None
    from matplotlib import pyplot as plt

    try:
        figure = plt.figure(figsize=(13.0, 6.5), layout="constrained")
    except (ImportError, RuntimeError):
        # A backend that is named, or the display, cannot be had.
        return None
    if getattr(figure.canvas, "required_interactive_framework", None) is None:
        plt.close(figure)
        return None
    plt.ion()
    figure.show()
    return figure
