"""Height, side view and speed, with their 95 % bands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.plot import _style as look
from geograph.plot._plane import length_unit
from geograph.results.data import turned_covariance
from geograph.results.facts import static_facts
from geograph.units import Unit, fitting_unit

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from geograph.results import Results

_ELLIPSES = 15
_FACT_INDENT = 90.0
# A flatter path than this would be a mere line if height had the scale of distance.
_ONE_SCALE_RATIO = 8.0


def time_label(results: Results) -> str:
    """Return the label of a time axis: seconds after the epoch, which is named if known."""
    epoch = results.summary.get("epoch")
    return "time (s)" if not epoch else f"time after {str(epoch).replace('+00:00', ' UTC')} (s)"


@dataclass(frozen=True, eq=False)
class _Series:
    """A quantity along the path, in SI units: fine enough to draw, and where the truth is known."""

    name: str
    unit: str
    time_s: NDArray[np.float64]
    value: NDArray[np.float64]
    sigma: NDArray[np.float64]
    true_time_s: NDArray[np.float64]
    true: NDArray[np.float64]
    error: NDArray[np.float64]


def draw_height(results: Results, ax: Axes) -> None:
    """Draw the height, or z, against time with its 95 % band."""
    _draw_band(results, ax, _height_series(results))


def draw_height_spread(results: Results, ax: Axes) -> None:
    """Draw the 95 % band of the height about zero, with the truth's deviation if known."""
    _draw_spread(results, ax, _height_series(results))


def draw_speed(results: Results, ax: Axes) -> None:
    """Draw the speed against time with its 95 % band; a note where the motion has none."""
    series = _speed_series(results)
    if series is None:
        ax.text(0.5, 0.5, "this motion model has no velocity", ha="center", va="center")
        ax.set_axis_off()
    else:
        _draw_band(results, ax, series)


def draw_speed_spread(results: Results, ax: Axes) -> None:
    """Draw the 95 % band of the speed about zero, with the truth's deviation if known."""
    series = _speed_series(results)
    if series is not None:
        _draw_spread(results, ax, series)


def _height_series(results: Results) -> _Series:
    sigma = np.sqrt(np.maximum(results.level_covariance_m2()[:, 2, 2], 0.0))
    return _series(
        results,
        name=_height_name(results),
        unit="m",
        sigma=sigma,
        of=lambda position, _: results.height_of(position),
        known=results.truth is not None,
    )


def _speed_series(results: Results) -> _Series | None:
    if results.sigma_speed_m_s is None:
        return None
    return _series(
        results,
        name="Earth-fixed speed" if results.frame == "ecef" else "speed",
        unit="m/s",
        sigma=results.sigma_speed_m_s,
        of=lambda _, velocity: np.linalg.norm(velocity, axis=-1),
        known=results.truth is not None and results.truth.velocity_m_s is not None,
    )


def _series(
    results: Results,
    *,
    name: str,
    unit: str,
    sigma: NDArray[np.float64],
    of: Callable[[Any, Any], NDArray[np.float64]],
    known: bool,
) -> _Series:
    """Return a function of position and velocity along the path."""
    knots, time = results.knots(), look.dense(results.time_s)
    if time.size == 1:
        # One knot stands for the whole recording.
        time = np.asarray(results.summary.get("time_span_s", time), dtype=np.float64)
    true_time = true = error = np.empty(0)
    if known and results.truth is not None:
        truth = results.truth
        inside = (truth.time_s >= time[0]) & (truth.time_s <= time[-1])
        true_time = truth.time_s[inside]
        true = of(truth.position_m, truth.velocity_m_s)[inside]
        error = true - of(*knots.at(true_time)) if inside.any() else error
    return _Series(
        name=name,
        unit=unit,
        time_s=time,
        value=of(*knots.at(time)),
        sigma=np.interp(time, results.time_s, sigma),
        true_time_s=true_time,
        true=true,
        error=error,
    )


def draw_horizontal(results: Results, ax: Axes) -> None:
    """Draw the 1-sigma semi-axes over ground against time."""
    flat = results.level_covariance_m2()[:, :2, :2]
    finite = np.isfinite(flat).all(axis=(1, 2))
    sigma = np.full((results.time_s.size, 2), np.nan)
    sigma[finite] = np.sqrt(np.maximum(np.linalg.eigvalsh(flat[finite]), 0.0))
    unit = fitting_unit("m", sigma)
    for column, label, style in ((1, "major semi-axis", "-"), (0, "minor semi-axis", "--")):
        ax.plot(results.time_s, sigma[:, column] / unit.size, style, color=look.PATH, label=label)
    ax.set_ylim(bottom=0.0)
    look.label_time(ax, time_label(results))
    ax.set_ylabel(f"1-sigma ellipse over ground ({unit.name})")
    ax.legend(loc="best")


def draw_facts(results: Results, ax: Axes) -> None:
    """Write down where an object at rest is."""
    ax.set_axis_off()
    ax.set_title("the object at rest")
    for row, (name, text) in enumerate(static_facts(results)):
        for across, words, colour in ((0.0, name, "0.35"), (_FACT_INDENT, text, look.BLACK)):
            ax.annotate(
                words,
                (0.0, 1.0),
                xycoords="axes fraction",
                xytext=(across, -18.0 * (row + 1)),
                textcoords="offset points",
                color=colour,
            )


def draw_side_view(results: Results, ax: Axes) -> None:
    """Draw height against the distance along the ground, with 95 % ellipses."""
    levels, axes = results.level_covariance_m2(), results.level_axes()
    steps = np.diff(results.position_m, axis=0)
    level = np.einsum("kij,kj->ki", axes[1:], steps)[:, :2]
    distance = np.concatenate([[0.0], np.cumsum(np.linalg.norm(level, axis=-1))])
    height = results.height_m()
    unit = length_unit(max(float(np.ptp(distance)), float(np.abs(height).max())))
    style = "-" if distance.size > 1 else "o"
    ax.plot(distance / unit.size, height / unit.size, style, color=look.PATH, lw=2.0, label="path")
    chosen = look.some(distance.size, _ELLIPSES)
    outline = look.ellipse_outline(_side_covariance(levels, level)[chosen])
    factor = look.magnification(outline, max(float(np.ptp(distance)), float(np.ptp(height))))
    label = "95 % ellipses" + (f", drawn {factor:.0f} times larger" if factor > 1.0 else "")
    for centre, shape in zip(np.stack([distance, height], 1)[chosen], outline, strict=True):
        if np.isfinite(shape).all():
            ring = (centre + factor * shape) / unit.size
            ax.fill(*ring.T, fc=look.BAND, ec=look.PATH, alpha=0.35, lw=0.7, label=label)
            label = "_"
    scale = ""
    if float(np.ptp(distance)) < _ONE_SCALE_RATIO * float(np.ptp(height)) or distance.size == 1:
        ax.set_aspect("equal", adjustable="datalim")
    else:
        scale = ", height not to the same scale"
    ax.set_xlabel(f"distance over ground ({unit.name}{scale})")
    ax.set_ylabel(f"{_height_name(results)} ({unit.name})")
    ax.legend(loc="best")


def _side_covariance(
    covariance: NDArray[np.float64], steps: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return covariances in the upright plane of the path, shape (k, 2, 2)."""
    heading = np.concatenate([steps, steps[-1:]]) if len(steps) else np.zeros((1, 2))
    length = np.linalg.norm(heading, axis=-1, keepdims=True)
    heading = np.where(length > 0.0, heading / np.where(length > 0.0, length, 1.0), [1.0, 0.0])
    rows = np.zeros((len(heading), 2, 3))
    rows[:, 0, :2] = heading
    rows[:, 1, 2] = 1.0
    return turned_covariance(rows, covariance)


def _draw_band(results: Results, ax: Axes, series: _Series) -> None:
    unit = _unit(series, np.abs(series.value))
    half = look.NORMAL_95 * series.sigma
    low, high = (series.value - half) / unit.size, (series.value + half) / unit.size
    ax.fill_between(series.time_s, low, high, color=look.BAND, alpha=0.45, lw=0, label="95 % band")
    ax.plot(series.time_s, series.value / unit.size, color=look.PATH, lw=1.8, label="estimate")
    if series.true.size:
        style = "--" if series.true.size > 1 else "o"
        true = series.true / unit.size
        ax.plot(series.true_time_s, true, style, color=look.TRUTH, lw=1.0, label="truth")
    look.label_time(ax, time_label(results))
    ax.set_ylabel(f"{series.name} ({unit.name})")
    ax.legend(loc="best")


def _draw_spread(results: Results, ax: Axes, series: _Series) -> None:
    half = look.NORMAL_95 * series.sigma
    unit = _unit(series, half)
    half = half / unit.size
    ax.fill_between(series.time_s, -half, half, color=look.BAND, alpha=0.45, lw=0)
    ax.axhline(0.0, color=look.PATH, lw=1.2)
    what = "95 % band"
    if series.error.size:
        style = "--" if series.error.size > 1 else "o"
        ax.plot(series.true_time_s, series.error / unit.size, style, color=look.TRUTH, lw=1.0)
        what += ",\ntruth - estimate"
    look.label_time(ax, time_label(results))
    ax.set_ylabel(f"{what} ({unit.name})")


def _unit(series: _Series, size: NDArray[np.float64]) -> Unit:
    finite = size[np.isfinite(size)]
    unit = length_unit(float(finite.max()) if finite.size else 0.0)
    return unit if series.unit == "m" else Unit(f"{unit.name}/s", unit.size)


def _height_name(results: Results) -> str:
    return "height above the ellipsoid" if results.frame == "ecef" else "z"
