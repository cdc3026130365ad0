"""What all pictures share: colours, units, ellipses, figures without a window."""

from __future__ import annotations

import math
import warnings
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from geograph.results import Results

# Okabe and Ito, "Color universal design" (2008): told apart by every kind of colour vision.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, VERMILION, PURPLE = "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
PATH, BAND, ALARM, TRUTH, PRIOR = BLUE, SKY, VERMILION, BLACK, "#D9D9D9"
_SENSOR_COLOURS = (ORANGE, GREEN, PURPLE, SKY, "#7A5C00", "#7F7F7F", BLUE, "#004D40")
_SENSOR_MARKERS = ("o", "^", "s", "D", "v", "P", "X")

NORMAL_95 = 1.959963984540054
"""Half-width of the central 95 % of a normal distribution, in standard deviations."""

RADIUS_95_PLANE = math.sqrt(-2.0 * math.log(0.05))
"""Radius of the 95 % ellipse of a plane normal distribution, in standard deviations."""

_STYLE: Any = {
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 10,
    "figure.dpi": 100,
    "font.size": 9,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.6,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "savefig.dpi": 150,
    # Names are the user's own: a dollar in one is a dollar.
    "text.parse_math": False,
}


@contextmanager
def style() -> Iterator[None]:
    """Give a context in which figures have geograph's style, to be drawn in it."""
    import matplotlib as mpl

    with mpl.rc_context(_STYLE), warnings.catch_warnings():
        # Names in scripts that the font lacks are drawn as boxes; the tables have them whole.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        yield


def label_time(ax: Axes, label: str) -> None:
    """Label a time axis; times that share their first digits show these once, beside it."""
    ax.set_xlabel(label)
    ax.ticklabel_format(axis="x", useOffset=True)


def new_figure(width: float, height: float) -> Figure:
    """Return a figure, in inches, that belongs to no window and needs no display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def axes_or_new(ax: Axes | None, width: float = 7.0, height: float = 5.0) -> Axes:
    """Return the axes given, or those of a new figure."""
    return new_figure(width, height).add_subplot() if ax is None else ax


def headline(figure: Figure, results: Results, what: str) -> None:
    """Put name and status over a figure, in the alarm colour unless the solution converged."""
    good = results.status == "converged"
    status = results.status.replace("_", " ")
    figure.suptitle(
        f"{results.name}, {status if good else status.upper()}: {what}",
        x=0.01,
        ha="left",
        fontsize=12,
        color=BLACK if good else ALARM,
    )


def sensor_look(index: int) -> dict[str, Any]:
    """Return colour and marker of a sensor: distinct pairs for the first 56."""
    return {
        "color": _SENSOR_COLOURS[index % len(_SENSOR_COLOURS)],
        "marker": _SENSOR_MARKERS[(index + index // len(_SENSOR_COLOURS)) % len(_SENSOR_MARKERS)],
    }


def some(count: int, most: int) -> NDArray[np.int64]:
    """Return at most ``most`` indices spread evenly over ``count``, both ends among them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


def dense(time_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return times between knots too, as many as a smooth line needs, knots among them."""
    if not 1 < time_s.size < 500:
        return time_s
    parts = math.ceil(500 / time_s.size)
    share = np.arange(parts) / parts
    return np.append((time_s[:-1, None] + np.diff(time_s)[:, None] * share).ravel(), time_s[-1])


def ellipse_outline(covariance: NDArray[np.float64], points: int = 61) -> NDArray[np.float64]:
    """Return outlines of 95 % ellipses about zero, shape (n, points, 2).

    Parameters
    ----------
    covariance
        Shape (n, 2, 2); those that are not finite give outlines of NaN.
    points
        How many points an outline has.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, points)
    circle = RADIUS_95_PLANE * np.stack([np.cos(angle), np.sin(angle)])
    outline = np.full((len(covariance), points, 2), np.nan)
    finite = np.isfinite(covariance).all(axis=(1, 2))
    values, vectors = np.linalg.eigh(covariance[finite])
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    outline[finite] = np.swapaxes(root @ circle, 1, 2)
    return outline


def magnification(outline: NDArray[np.float64], extent: float) -> float:
    """Return by which of 1, 2, 5, 10, ... to enlarge ellipses to be seen on a picture.

    Parameters
    ----------
    outline
        Of the ellipses, shape (n, points, 2).
    extent
        Of the picture, in the same unit.
    """
    size = np.linalg.norm(outline, axis=-1).max(axis=1, initial=0.0)
    size = size[np.isfinite(size)]
    middle = float(np.median(size)) if size.size else 0.0
    if middle == 0.0 or extent == 0.0 or middle >= 0.01 * extent:
        return 1.0
    wanted = 0.03 * extent / middle
    decade = 10.0 ** math.floor(math.log10(wanted))
    return max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= wanted * (1 + 1e-12))
