"""Height, side view and speed, with their 95 % bands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.plot import _style as look
from geograph.plot._plane import length_unit
from geograph.results.data import turned_covariance
from geograph.units import Unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from geograph.results import Results

_ELLIPSES = 15


def time_label(results: Results) -> str:
    """Return the label of a time axis: seconds after the epoch, which is named if known."""
    epoch = results.summary.get("epoch")
    return "time (s)" if not epoch else f"time after {str(epoch).replace('+00:00', ' UTC')} (s)"


@dataclass(frozen=True, eq=False)
class _Series:
    """A quantity along the path: SI values, standard deviations, and truth at its own times."""

    name: str
    unit: str
    value: NDArray[np.float64]
    sigma: NDArray[np.float64]
    true: NDArray[np.float64] | None


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
    return _Series(
        name=_height_name(results),
        unit="m",
        value=results.height_m(),
        sigma=np.sqrt(np.maximum(results.level_covariance_m2()[:, 2, 2], 0.0)),
        true=None if results.truth is None else _height(results, results.truth.position_m),
    )


def _speed_series(results: Results) -> _Series | None:
    speed, sigma = results.speed_m_s, results.sigma_speed_m_s
    if speed is None or sigma is None:
        return None
    truth = results.truth
    velocity = None if truth is None else truth.velocity_m_s
    return _Series(
        name="Earth-fixed speed" if results.frame == "ecef" else "speed",
        unit="m/s",
        value=speed,
        sigma=sigma,
        true=None if velocity is None else np.linalg.norm(velocity, axis=-1),
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
    return turned_covariance(rows, covariance)


def _drawn_time(results: Results, *values: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Return times and values; one knot stands for the whole recording."""
    time = results.time_s
    if time.size > 1:
        return time, *values
    span = results.summary.get("time_span_s", [time[0], time[0]])
    return np.asarray(span), *(np.repeat(value, 2) for value in values)


def _draw_band(results: Results, ax: Axes, series: _Series) -> None:
    unit = _unit(series, np.abs(series.value))
    time, value, sigma = _drawn_time(results, series.value, series.sigma)
    half = look.NORMAL_95 * sigma
    low, high = (value - half) / unit.size, (value + half) / unit.size
    ax.fill_between(time, low, high, color=look.BAND, alpha=0.45, lw=0, label="95 % band")
    ax.plot(time, value / unit.size, color=look.PATH, lw=1.8, label="estimate")
    if series.true is not None and results.truth is not None:
        true = series.true / unit.size
        ax.plot(results.truth.time_s, true, "--", color=look.TRUTH, lw=1.0, label="truth")
    ax.set_xlabel(time_label(results))
    ax.set_ylabel(f"{series.name} ({unit.name})")
    ax.legend(loc="best")


def _draw_spread(results: Results, ax: Axes, series: _Series) -> None:
    time, sigma = _drawn_time(results, series.sigma)
    half = look.NORMAL_95 * sigma
    unit = _unit(series, half)
    half = half / unit.size
    ax.fill_between(time, -half, half, color=look.BAND, alpha=0.45, lw=0, label="95 % band")
    ax.axhline(0.0, color=look.PATH, lw=1.2)
    if series.true is not None and results.truth is not None:
        known = results.truth.time_s
        off = series.true - np.interp(known, results.time_s, series.value)
        inside = (known >= results.time_s[0]) & (known <= results.time_s[-1])
        style = "--" if known.size > 1 else "o"
        ax.plot(known[inside], off[inside] / unit.size, style, color=look.TRUTH, lw=1.0)
    ax.set_xlabel(time_label(results))
    ax.set_ylabel(f"95 % band ({unit.name})")


def _unit(series: _Series, size: NDArray[np.float64]) -> Unit:
    finite = size[np.isfinite(size)]
    unit = length_unit(float(finite.max()) if finite.size else 0.0)
    return unit if series.unit == "m" else Unit(f"{unit.name}/s", unit.size)


def _height(results: Results, position_m: NDArray[np.float64]) -> NDArray[np.float64]:
    if results.frame == "local":
        return position_m[:, 2]
    from geograph.geodesy import geodetic_from_ecef

    return geodetic_from_ecef(position_m)[:, 2]


def _height_name(results: Results) -> str:
    return "height above the ellipsoid" if results.frame == "ecef" else "z"
