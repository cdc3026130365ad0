"""Height, side view and speed, with their 95 % bands."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.plot import _style as look
from geograph.plot._plane import length_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from geograph.results import Results

_ELLIPSES = 15


def time_label(results: Results) -> str:
    """Return the label of a time axis: seconds after the epoch, which is named if known."""
    epoch = results.summary.get("epoch")
    return "time (s)" if not epoch else f"time after {str(epoch).replace('+00:00', ' UTC')} (s)"


def draw_height(results: Results, ax: Axes) -> None:
    """Draw the height, or z, against time with its 95 % band."""
    height = results.height_m()
    sigma = np.sqrt(np.maximum(results.level_covariance_m2()[:, 2, 2], 0.0))
    true = None if results.truth is None else _height(results, results.truth.position_m)
    _draw_band(results, ax, height, sigma, true=true)
    unit = length_unit(float(np.abs(height).max())).name
    ax.set_ylabel(f"{_height_name(results)} ({unit})")


def draw_speed(results: Results, ax: Axes) -> None:
    """Draw the speed against time with its 95 % band; a note where the motion has none."""
    speed, sigma = results.speed_m_s, results.sigma_speed_m_s
    if speed is None or sigma is None:
        ax.text(0.5, 0.5, "this motion model has no velocity", ha="center", va="center")
        ax.set_axis_off()
        return
    true = None
    if results.truth is not None and results.truth.velocity_m_s is not None:
        true = np.linalg.norm(results.truth.velocity_m_s, axis=-1)
    _draw_band(results, ax, speed, sigma, true=true)
    frame = "Earth-fixed speed" if results.frame == "ecef" else "speed"
    ax.set_ylabel(f"{frame} ({length_unit(float(speed.max())).name}/s)")


def draw_side_view(results: Results, ax: Axes) -> None:
    """Draw height against the distance along the ground, with 95 % ellipses."""
    levels, axes = results.level_covariance_m2(), results.level_axes()
    steps = np.diff(results.position_m, axis=0)
    level = np.einsum("kij,kj->ki", axes[1:], steps)[:, :2]
    distance = np.concatenate([[0.0], np.cumsum(np.linalg.norm(level, axis=-1))])
    height = results.height_m()
    unit = length_unit(max(float(np.ptp(distance)), float(np.abs(height).max())))
    ax.plot(distance / unit.size, height / unit.size, color=look.PATH, lw=2.0, label="path")
    chosen = look.some(distance.size, _ELLIPSES)
    outline = look.ellipse_outline(_side_covariance(levels, level)[chosen])
    factor = look.magnification(outline, max(float(np.ptp(distance)), float(np.ptp(height))))
    label = "95 % ellipses" + (f", drawn {factor:.0f} times larger" if factor > 1.0 else "")
    for centre, shape in zip(np.stack([distance, height], 1)[chosen], outline, strict=True):
        if np.isfinite(shape).all():
            ring = (centre + factor * shape) / unit.size
            ax.fill(*ring.T, fc=look.BAND, ec=look.PATH, alpha=0.35, lw=0.7, label=label)
            label = "_"
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel(f"distance over ground ({unit.name})")
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
    return np.asarray(rows @ covariance @ np.swapaxes(rows, 1, 2))


def _draw_band(
    results: Results,
    ax: Axes,
    value: NDArray[np.float64],
    sigma: NDArray[np.float64],
    *,
    true: NDArray[np.float64] | None,
) -> None:
    unit = length_unit(float(np.abs(value).max())).size
    time = results.time_s
    if time.size == 1:
        # One knot stands for the whole recording.
        time = np.asarray(results.summary.get("time_span_s", [time[0], time[0]]))
        value, sigma = np.repeat(value, 2), np.repeat(sigma, 2)
    half = look.NORMAL_95 * sigma
    low, high = (value - half) / unit, (value + half) / unit
    ax.fill_between(time, low, high, color=look.BAND, alpha=0.45, lw=0, label="95 % band")
    ax.plot(time, value / unit, color=look.PATH, lw=1.8, label="estimate")
    if true is not None and results.truth is not None:
        ax.plot(results.truth.time_s, true / unit, "--", color=look.TRUTH, lw=1.0, label="truth")
    ax.set_xlabel(time_label(results))
    ax.legend(loc="best")


def _height(results: Results, position_m: NDArray[np.float64]) -> NDArray[np.float64]:
    if results.frame == "local":
        return position_m[:, 2]
    from geograph.geodesy import geodetic_from_ecef

    return geodetic_from_ecef(position_m)[:, 2]


def _height_name(results: Results) -> str:
    return "height above the ellipsoid" if results.frame == "ecef" else "z"
