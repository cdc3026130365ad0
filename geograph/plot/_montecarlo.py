"""Pictures of a Monte Carlo study: a page of figures, and what a sweep shows."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.plot import _style as look
from geograph.units import fitting_unit

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

_LOG_RATIO = 20.0

# What a sweep shows of each point: key, label, what is expected; in its own order.
_CURVES = (
    ("rmse_m", "RMSE", None),
    ("rmse_over_bound", "RMSE over the bound", 1.0),
    ("anees", "ANEES over its expectation", 1.0),
    ("coverage_95", "share in the 95 % ellipsoids", 0.95),
    ("divergence", "divergence of the NEES", None),
    ("converged_share", "share that converged", 1.0),
)


def save_pages(figures: Mapping[str, Any], folder: Path) -> list[Path]:
    """Draw the pages of a study into a folder, and return their paths.

    Parameters
    ----------
    figures
        As :func:`geograph.montecarlo.study_figures` gives them.
    folder
        Where ``montecarlo.png`` is written; with a sweep a page for each point,
        ``montecarlo-1.png`` and so on, and ``sweep.png``.
    """
    from geograph.io.atomic import replacing_file

    points = figures["points"]
    swept = bool(figures["sweep"])
    pages: dict[str, Callable[[], Figure]] = {}
    for index, point in enumerate(points, start=1):
        name = f"montecarlo-{index}.png" if swept else "montecarlo.png"
        pages[name] = partial(page, figures, point)
    if swept:
        pages["sweep.png"] = partial(sweep_page, figures)
    with look.style():
        for name, draw in pages.items():
            with replacing_file(folder / name) as draft:
                draw().savefig(draft, format="png")
    return [folder / name for name in pages]


def page(figures: Mapping[str, Any], point: Mapping[str, Any]) -> Figure:
    """Return the page of one point: error over time, NEES, coverage, convergence."""
    figure = look.new_figure(14.0, 8.0)
    chosen = ", ".join(f"{key} {_text(value)}" for key, value in point["set"].items())
    title = f"{figures['scenario']}{f', {chosen}' if chosen else ''}: {point['runs']} runs from "
    figure.suptitle(f"{title}seed {figures['seed']}", x=0.01, ha="left", fontsize=12)
    axes = figure.subplots(2, 3)
    if point["converged"]:
        _draw_error(point, axes[0, 0])
        _draw_anees(point, axes[0, 1])
        _draw_histogram(point, axes[0, 2])
        _draw_coverage(point, axes[1, 0])
        _draw_facts(point, axes[1, 2])
    else:
        for ax in (*axes[0], axes[1, 0], axes[1, 2]):
            ax.set_axis_off()
        axes[0, 0].text(0.0, 0.5, "no run converged", color=look.ALARM, fontsize=12)
    _draw_statuses(point, axes[1, 1])
    return figure


def _draw_error(point: Mapping[str, Any], ax: Axes) -> None:
    over = point["over_time"]
    lines = {
        "RMSE": (_numbers(over["rmse_m"]), look.PATH, "-"),
        "Cramer-Rao bound": (_numbers(over["bound_m"]), look.BLACK, "--"),
        "estimated sigma": (_numbers(over["sigma_m"]), look.ORANGE, ":"),
    }
    every = np.concatenate([values for values, _, _ in lines.values()])
    unit = fitting_unit("m", every[np.isfinite(every)])
    time = _numbers(over["time_s"])
    for label, (values, colour, style) in lines.items():
        marker = "o" if time.size == 1 else None
        ax.plot(time, values / unit.size, style, color=colour, lw=1.8, marker=marker, label=label)
    finite = every[np.isfinite(every) & (every > 0.0)]
    if finite.size and finite.max() > _LOG_RATIO * finite.min():
        ax.set_yscale("log")
    else:
        ax.set_ylim(bottom=0.0)
    look.label_time(ax, "time (s)")
    ax.set_ylabel(f"position error ({unit.name})")
    ax.set_title("error over time")
    ax.legend(loc="best")


def _draw_anees(point: Mapping[str, Any], ax: Axes) -> None:
    over = point["over_time"]
    time, band = _numbers(over["time_s"]), np.array(over["anees_band_99"]).reshape(-1, 2)
    if time.size == 1:
        ax.errorbar(time, band.mean(axis=1), np.ptp(band, axis=1) / 2.0, color=look.BAND, lw=6)
    else:
        ax.fill_between(
            time, band[:, 0], band[:, 1], color=look.BAND, alpha=0.35, label="99 % band"
        )
    ax.plot(
        time,
        _numbers(over["anees"]),
        "-o" if time.size == 1 else "-",
        color=look.PATH,
        lw=1.8,
        label="ANEES",
    )
    ax.axhline(point["anees_expected"], color=look.BLACK, ls="--", lw=1.0, label="expected")
    ax.set_ylim(bottom=0.0)
    look.label_time(ax, "time (s)")
    ax.set_title("average NEES")
    ax.legend(loc="best")


def _draw_histogram(point: Mapping[str, Any], ax: Axes) -> None:
    tail, count = np.array(point["histogram"]["tail"]), np.array(point["histogram"]["count"])
    share, expected = count / max(int(count.sum()), 1), -np.diff(tail)
    edges = np.arange(tail.size)
    # The bins beyond 95 % are too thin to be seen one by one.
    thick = 19
    mine = np.append(share[:thick], share[thick:].sum())
    honest = np.append(expected[:thick], expected[thick:].sum())
    place = edges[: thick + 1] + 0.5
    ax.bar(place, mine, 0.9, color=look.SKY, label="NEES of the runs")
    ax.step(
        np.append(edges[: thick + 1], thick + 1),
        np.append(honest, honest[-1]),
        where="post",
        color=look.BLACK,
        lw=1.2,
        label="chi-square",
    )
    ticks = [0, 5, 10, 15, 19]
    ax.set_xticks([tick + (0.5 if tick == thick else 0.0) for tick in ticks])
    ax.set_xticklabels(["0", "25 %", "50 %", "75 %", "> 95 %"])
    ax.set_xlabel("quantile of chi-square")
    ax.set_ylabel("share")
    ax.set_title(f"NEES: divergence from chi-square {point['divergence']:.3f}")
    ax.legend(loc="best")


def _draw_coverage(point: Mapping[str, Any], ax: Axes) -> None:
    entries = point["coverage"]
    place = np.arange(len(entries))
    share = np.array([entry["share"] for entry in entries])
    error = _numbers([entry["error"] for entry in entries])
    ax.bar(place, 100 * share, 0.6, color=look.SKY)
    ax.errorbar(place, 100 * share, 200 * error, fmt="none", color=look.BLUE, lw=1.5, capsize=4)
    for index, entry in enumerate(entries):
        stated = 100 * entry["probability"]
        label = "stated" if index == 0 else "_"
        ax.hlines(stated, index - 0.4, index + 0.4, color=look.BLACK, ls="--", label=label)
        ax.annotate(
            f"{100 * entry['share']:.1f}", (index, 3.0), ha="center", color=look.BLACK, fontsize=9
        )
    ax.set_xticks(place, [f"{100 * entry['probability']:g} %" for entry in entries])
    ax.set_ylabel("runs and times inside (%)")
    ax.set_title("coverage of the ellipsoids, with two standard errors")
    ax.legend(loc="upper left")


def _draw_statuses(point: Mapping[str, Any], ax: Axes) -> None:
    names = sorted(point["statuses"], key=lambda name: (name != "converged", name))
    share = [100 * point["statuses"][name] / point["runs"] for name in names]
    place = np.arange(len(names))
    colours = [look.GREEN if name == "converged" else look.ALARM for name in names]
    ax.barh(place, share, 0.5, color=colours)
    for index, name in enumerate(names):
        ax.annotate(
            f" {point['statuses'][name]} of {point['runs']}", (share[index], index), va="center"
        )
    ax.set_yticks(place, [name.replace("_", " ") for name in names])
    ax.set_ylim(len(names) - 0.3, -0.7)
    ax.set_xlim(0.0, 125.0)
    ax.set_xlabel("share of the runs (%)")
    ax.set_title("how the runs ended")


def _draw_facts(point: Mapping[str, Any], ax: Axes) -> None:
    low, high = point["converged_band_95"]
    rows = [
        ("RMSE", _length(point["rmse_m"])),
        ("median of the runs' RMS", _length(point["median_rms_m"])),
        ("Cramer-Rao bound", _length(point["bound_m"])),
        ("RMSE / bound", _pair(point["rmse_over_bound"], point["rmse_over_bound_error"])),
        (
            "  every run over its own",
            _pair(point["rmse_over_bound_by_run"], point["rmse_over_bound_by_run_error"]),
        ),
        ("ANEES", f"{_pair(point['anees'], point['anees_error'])} ({point['anees_expected']})"),
        ("KL divergence", _pair(point["divergence"], point["divergence_error"])),
        ("  of as many honest runs", f"{point['divergence_of_honest']:.3f}"),
        ("converged", f"{100 * low:.1f} to {100 * high:.1f} %"),
    ]
    ax.set_axis_off()
    for index, (name, text) in enumerate(rows):
        height = 0.92 - 0.105 * index
        ax.text(0.02, height, name, transform=ax.transAxes, fontsize=10)
        ax.text(0.62, height, text, transform=ax.transAxes, fontsize=10)


def sweep_page(figures: Mapping[str, Any]) -> Figure:
    """Return what a sweep shows: curves over one parameter, or maps over two."""
    sweep = figures["sweep"]
    names = list(sweep)
    figure = look.new_figure(14.0, 8.0)
    figure.suptitle(
        f"{figures['scenario']}: {' and '.join(names)}, {figures['runs']} runs each from seed "
        f"{figures['seed']}",
        x=0.01,
        ha="left",
        fontsize=12,
    )
    for ax, (key, title, expected) in zip(figure.subplots(2, 3).flat, _CURVES, strict=True):
        values = np.array([_value(point, key) for point in figures["points"]])
        if len(names) == 1:
            _draw_curve(figures, key, values, expected, ax)
        else:
            _draw_map(figure, sweep, values.reshape([len(sweep[name]) for name in names]), ax)
        ax.set_title(f"{title} (m)" if key == "rmse_m" else title)
    return figure


def _draw_curve(
    figures: Mapping[str, Any],
    key: str,
    values: NDArray[np.float64],
    expected: float | None,
    ax: Axes,
) -> None:
    ((name, swept),) = figures["sweep"].items()
    place, labels = _places(swept)
    points = figures["points"]
    error = np.array([_error_of(point, key) for point in points])
    ax.errorbar(place, values, 2.0 * error, color=look.PATH, marker="o", lw=1.6, capsize=3)
    if key == "rmse_m":
        bound = np.array([_value(point, "bound_m") for point in points])
        ax.plot(place, bound, "--", color=look.BLACK, lw=1.4, label="Cramer-Rao bound")
        both = np.concatenate([values, bound])
        finite = both[np.isfinite(both) & (both > 0.0)]
        if finite.size and finite.max() > _LOG_RATIO * finite.min():
            ax.set_yscale("log")
        ax.legend(loc="best")
    if expected is not None:
        ax.axhline(expected, color=look.BLACK, ls="--", lw=1.0)
    if labels is None:
        if place.size <= 12:
            ax.set_xticks(place, [_text(value) for value in swept])
        positive = place[place > 0.0]
        if positive.size == place.size and place.max() > _LOG_RATIO * place.min():
            ax.set_xscale("log")
    else:
        ax.set_xticks(place, labels)
    ax.set_xlabel(name)


def _draw_map(
    figure: Figure, sweep: Mapping[str, Sequence[Any]], values: NDArray[np.float64], ax: Axes
) -> None:
    (first, rows), (second, columns) = sweep.items()
    image = ax.imshow(values, origin="lower", aspect="auto", cmap="viridis")
    ax.grid(visible=False)
    ax.set_xticks(np.arange(len(columns)), [_text(value) for value in columns])
    ax.set_yticks(np.arange(len(rows)), [_text(value) for value in rows])
    ax.set_xlabel(second)
    ax.set_ylabel(first)
    figure.colorbar(image, ax=ax)
    middle = 0.5 * (np.nanmin(values) + np.nanmax(values)) if np.isfinite(values).any() else 0.0
    for (row, column), value in np.ndenumerate(values):
        colour = look.BLACK if value > middle else "white"
        text = f"{value:.3g}" if np.isfinite(value) else "-"
        ax.annotate(text, (column, row), ha="center", va="center", color=colour, fontsize=8)


def _places(swept: Sequence[Any]) -> tuple[NDArray[np.float64], list[str] | None]:
    """Return where the values of a parameter stand, and their labels unless they are numbers."""
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in swept):
        return np.array(swept, dtype=np.float64), None
    return np.arange(float(len(swept))), [_text(value) for value in swept]


def _value(point: Mapping[str, Any], key: str) -> float:
    if key == "coverage_95":
        return _coverage_95(point, "share")
    if key == "anees":
        value = point.get(key)
        return np.nan if value is None else float(value / point["anees_expected"])
    value = point.get(key)
    return np.nan if value is None else float(value)


def _error_of(point: Mapping[str, Any], key: str) -> float:
    if key == "coverage_95":
        return _coverage_95(point, "error")
    if key == "anees":
        value = point.get("anees_error")
        return 0.0 if value is None else float(value / point["anees_expected"])
    if key == "rmse_m":
        ratio, error = point.get("rmse_over_bound"), point.get("rmse_over_bound_error")
        return 0.0 if not ratio or error is None else float(point["rmse_m"] * error / ratio)
    value = point.get(f"{key}_error")
    return 0.0 if value is None else float(value)


def _coverage_95(point: Mapping[str, Any], what: str) -> float:
    for entry in point.get("coverage", ()):
        if entry["probability"] == 0.95:
            return np.nan if entry[what] is None else float(entry[what])
    return np.nan


def _numbers(values: Sequence[float | None]) -> NDArray[np.float64]:
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def _length(value: float | None) -> str:
    if value is None:
        return "-"
    unit = fitting_unit("m", np.array([value]))
    return f"{value / unit.size:.4g} {unit.name}"


def _pair(value: float | None, error: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3f}" if error is None else f"{value:.3f} ± {error:.3f}"


def _text(value: Any) -> str:
    if isinstance(value, list | tuple):
        same = len({repr(part) for part in value}) == 1
        return _text(value[0]) if same else ":".join(map(_text, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
