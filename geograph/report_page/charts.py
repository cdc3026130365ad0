"""Charts against time, as descriptions that the page's script draws.

A chart is a dict: ``title``, ``note``, ``x`` and ``y`` (labels of the axes), ``x_range`` and
``y_range`` (None: what the layers need), and ``layers``, drawn in their order. A layer has a
``kind`` (``band`` with ``x, low, high``; ``line`` and ``points`` with ``x, y``; ``level`` with
``y``), a ``colour``, and where it has a name for the legend a ``label``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.errors import InputError
from geograph.plot import _style as look
from geograph.plot._plane import length_unit
from geograph.report_page.limits import short, short_time, thinned
from geograph.results.interpolate import columns_at
from geograph.units import fitting_unit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.compare import Comparison
    from geograph.report_page.limits import Limits
    from geograph.results import ErrorCurve, Results

BAND, PRIOR, GREY = "#9fd2f2", "#e3e3e3", "#767676"


def chart(title: str, x: str, y: str, layers: list[dict[str, Any]], **more: Any) -> dict[str, Any]:
    """Return a chart whose layers are all those that there are."""
    return {"title": title, "x": x, "y": y, "layers": layers, **more}


def line(
    x: NDArray[np.float64], y: NDArray[np.float64], colour: str, label: str = "", **more: Any
) -> dict[str, Any]:
    """Return a line."""
    return {
        "kind": "line",
        "x": short_time(x),
        "y": short(y),
        "colour": colour,
        "label": label,
    } | more


def band(
    x: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64], **more: Any
) -> dict[str, Any]:
    """Return a filled band between two lines."""
    return {"kind": "band", "x": short_time(x), "low": short(low), "high": short(high)} | more


def level(y: float, **more: Any) -> dict[str, Any]:
    """Return a dashed line across the chart."""
    return {"kind": "level", "y": y, "colour": GREY, "label": ""} | more


def time_label(results: Results) -> str:
    """Return the label of a time axis, which is narrow on a phone: the head names the epoch."""
    return "time after the epoch (s)" if results.summary.get("epoch") else "time (s)"


def height_and_speed(results: Results, limits: Limits) -> list[dict[str, Any]]:
    """Return charts of height and speed, with their 95 % bands, where these say something."""
    charts = []
    if not (results.static or results.height_held):
        sigma = np.sqrt(np.maximum(results.level_covariance_m2()[:, 2, 2], 0.0))
        earth = results.frame == "ecef"
        name, of = ("Height", "above the ellipsoid") if earth else ("z", "")
        truth = results.truth
        true = None if truth is None else (truth.time_s, results.height_of(truth.position_m))
        charts.append(_course(results, limits, (name, of), results.height_m(), sigma, true=true))
    speed, sigma_speed = results.speed_m_s, results.sigma_speed_m_s
    if speed is not None and sigma_speed is not None and not results.static:
        of = "Earth-fixed" if results.frame == "ecef" else ""
        truth, true = results.truth, None
        if truth is not None and truth.velocity_m_s is not None:
            true = (truth.time_s, np.linalg.norm(truth.velocity_m_s, axis=-1))
        charts.append(
            _course(results, limits, ("Speed", of), speed, sigma_speed, true=true, per="/s")
        )
    return charts


def _course(
    results: Results,
    limits: Limits,
    names: tuple[str, str],
    value: NDArray[np.float64],
    sigma: NDArray[np.float64],
    *,
    true: tuple[NDArray[np.float64], NDArray[np.float64]] | None,
    per: str = "",
) -> dict[str, Any]:
    """Return a chart of a quantity at the knots, by its names; ``true`` has times and values."""
    rows = thinned(value, limits.line)
    time, value, half = results.time_s[rows], value[rows], look.NORMAL_95 * sigma[rows]
    finite = value[np.isfinite(value)]
    unit = length_unit(float(np.abs(finite).max()) if finite.size else 0.0)
    layers = [
        band(
            time,
            (value - half) / unit.size,
            (value + half) / unit.size,
            colour=BAND,
            label="95 % band",
        ),
        line(time, value / unit.size, look.PATH, "estimate", width=2),
    ]
    if true is not None:
        inside = (true[0] >= time[0]) & (true[0] <= time[-1])
        known, values = true[0][inside], true[1][inside]
        if known.size:
            kept = thinned(values, limits.line)
            layers.append(
                line(known[kept], values[kept] / unit.size, look.TRUTH, "truth", dash=True)
            )
    label = f"{names[1]} ({unit.name}{per})".strip()
    return chart(names[0], time_label(results), label, layers)


def error_curves(results: Results, limits: Limits) -> list[dict[str, Any]]:
    """Return a chart for each error that changes with time: its 95 % band, and the prior's."""
    return [_curve(results, curve, limits) for curve in results.curves[: limits.panels]]


def _curve(results: Results, curve: ErrorCurve, limits: Limits) -> dict[str, Any]:
    rows = thinned(curve.estimate, limits.line)
    time, estimate = curve.time_s[rows], curve.estimate[rows]
    half, prior = look.NORMAL_95 * curve.sigma[rows], look.NORMAL_95 * curve.prior_sigma[rows]
    unit = fitting_unit(curve.unit, estimate, half)
    # The prior is drawn as far as it is of the order of the estimate: else it hides it.
    low, high = estimate - half, estimate + half
    ends = np.concatenate([low, high])
    ends = ends[np.isfinite(ends)]
    reach = 1.6 * float(np.abs(ends).max()) / unit.size if ends.size else 0.0
    wide = bool(ends.size and np.nanmin(prior) / unit.size > reach)
    layers = [
        band(
            time,
            -prior / unit.size,
            prior / unit.size,
            colour=PRIOR,
            label="prior, 95 %" + (" (wider than the chart)" if wide else ""),
        ),
        level(0.0),
        band(time, low / unit.size, high / unit.size, colour=BAND, label="estimate, 95 %"),
        line(time, estimate / unit.size, look.PATH, "estimate", width=2),
    ]
    return chart(
        f"{curve.sensor}: {curve.kind}",
        time_label(results),
        f"error ({unit.name})",
        layers,
        y_range=[-reach, reach] if reach > 0.0 else None,
    )


def consistency(found: Comparison, results: Results, limits: Limits) -> list[dict[str, Any]]:
    """Return the charts of a path held against the truth: errors with their bands, and NEES."""
    from scipy.special import chdtri

    charts = []
    rows = thinned(np.linalg.norm(found.error_m, axis=-1), limits.line)
    time = found.time_s[rows]
    if not results.static:
        covariance = columns_at(time, results.time_s, results.level_covariance_m2())
        for axis in range(found.dimensions):
            half = look.NORMAL_95 * np.sqrt(np.maximum(covariance[:, axis, axis], 0.0))
            unit = fitting_unit("m", found.error_m[rows, axis], half)
            layers = [
                band(time, -half / unit.size, half / unit.size, colour=BAND, label="95 % band"),
                level(0.0),
                line(
                    time,
                    found.error_m[rows, axis] / unit.size,
                    look.BLACK,
                    "estimate less truth",
                ),
            ]
            name = found.axes[axis]
            charts.append(chart(f"Error {name}", time_label(results), f"({unit.name})", layers))
    nees = found.nees[rows]
    upper = float(chdtri(found.dimensions, 0.05))
    layers = [
        level(upper, label="95 % of honest draws lie below", colour=look.ALARM),
        level(float(found.dimensions), label="expected mean"),
        line(time, nees, look.PATH, "NEES")
        if time.size > 1
        else {
            "kind": "points",
            "x": short_time(time),
            "y": short(nees),
            "colour": look.PATH,
            "marker": "o",
            "label": "NEES",
        },
    ]
    charts.append(chart("NEES", time_label(results), "", layers, y_low=0.0))
    return charts


def comparison_of(results: Results) -> Comparison | None:
    """Return the path held against the truth; None where that is not known at its times."""
    from geograph.compare import compare

    if results.truth is None:
        return None
    try:
        return compare(results, results.truth)
    except InputError:
        # The truth covers other times.
        return None


_WINDOWS, _LEAST_IN_WINDOW = 40, 20


def innovation_chart(results: Results) -> list[dict[str, Any]]:
    """Return a chart of the mean square of normalised residuals in windows of time; none if few."""
    from scipy.special import chdtri

    rows = results.residuals.where(~results.residuals.rejected)
    count = min(_WINDOWS, len(rows) // _LEAST_IN_WINDOW)
    if count < 2:
        return []
    order = np.argsort(rows.time_s, kind="stable")
    # Windows of as many residuals each: one band holds for all.
    parts = np.array_split(order, count)
    time = np.array([rows.time_s[part].mean() for part in parts])
    square = np.array([np.mean(rows.normalised[part] ** 2) for part in parts])
    each = len(rows) // count
    low, high = (float(chdtri(each, tail)) / each for tail in (0.995, 0.005))
    layers = [
        {
            "kind": "levels",
            "low": low,
            "high": high,
            "colour": "#eaf4fb",
            "label": "99 % of honest windows",
        },
        level(1.0, label="expected"),
        line(time, square, look.PATH, "mean square", width=1.6),
    ]
    if float(square.max()) <= 0.0:
        return []
    return [
        chart(
            "Normalised residuals squared (NIS)",
            "time tag (s)",
            "mean square",
            layers,
            note=f"mean of each {each} in a row, without the rejected",
            y_low=0.0,
        )
    ]
