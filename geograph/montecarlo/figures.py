"""What the runs of a study show, as figures ready for JSON.

Errors and bounds are root mean squares over the runs that converged. Values along one path go
together and runs are independent, so that standard errors come from the spread over runs. Nothing
here depends on where or in which order runs were done, but the times, which stand at the end.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.consistency import (
    TAIL,
    counts,
    divergence,
    divergence_bias,
    divergence_error,
    limit,
    mean_band,
)
from geograph.results.write import plain

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from geograph.montecarlo.study import Plan
    from geograph.montecarlo.trial import Run

PROBABILITIES = (0.5, 0.9, 0.95, 0.99)
"""Of the ellipsoids whose coverage is counted."""

ALARM = 0.01
"""Chance of an honest ANEES to be outside its band."""

# Times that hardly a run reaches say nothing of the others.
_FEWEST = 0.5


def study_figures(
    plan: Plan,
    runs: Sequence[Sequence[Run]],
    *,
    about: Mapping[str, Any] | None = None,
    times: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the figures of a study, ready for JSON.

    Parameters
    ----------
    plan
        What was studied.
    runs
        For each point its runs.
    about
        Further facts of the scenario.
    times
        Further times.
    """
    every = [run for point in runs for run in point]
    used = sum(run.cpu_seconds for run in every)
    found = {
        **plan.identity(),
        **(about or {}),
        "runs": plan.runs,
        "points": [
            {"set": chosen, **point_figures(mine)}
            for chosen, mine in zip(plan.points, runs, strict=True)
        ],
        "times": {
            "seconds_per_run": sum(run.seconds for run in every) / max(len(every), 1),
            "cpu_seconds_per_run": used / max(len(every), 1),
            **(times or {}),
        },
    }
    ready: dict[str, Any] = plain(found)
    return ready


def point_figures(runs: Sequence[Run]) -> dict[str, Any]:
    """Return the figures of the runs of one point.

    Parameters
    ----------
    runs
        At least one, in their order.
    """
    good = [run for run in runs if run.converged]
    share = len(good) / len(runs)
    found: dict[str, Any] = {
        "runs": len(runs),
        "converged": len(good),
        "converged_share": share,
        "converged_band_95": wilson(len(good), len(runs)),
        "statuses": dict(sorted(Counter(run.status for run in runs).items())),
        "failures": [
            {"run": run.run, "seed": run.seed, "status": run.status, "message": run.message}
            for run in runs
            if not run.converged
        ],
    }
    return found | (_scores(good) if good else {})


def wilson(count: int, total: int) -> list[float]:
    """Return the 95 % interval of a share (E. B. Wilson, JASA 22, 1927)."""
    z2 = float(limit(0.95, 1))
    middle = (count + 0.5 * z2) / (total + z2)
    half = np.sqrt(z2) / (total + z2) * np.sqrt(count * (total - count) / total + 0.25 * z2)
    return [max(float(middle - half), 0.0), min(float(middle + half), 1.0)]


def _scores(runs: Sequence[Run]) -> dict[str, Any]:
    axes = runs[0].axes
    square, sigma2, bound, nees = (
        _stacked(runs, name) for name in ("square_m2", "sigma2_m2", "bound_m2", "nees")
    )
    # Where the bound is not known, neither counts.
    known = np.isfinite(square) & np.isfinite(bound)
    ours, least = _means(np.where(known, square, np.nan)), _means(np.where(known, bound, np.nan))
    ratio = float(np.sqrt(_mean(ours) / _mean(least)))
    # Every run over its own bound: runs of a wide geometry do not outweigh all others.
    relative = ours / least
    by_run = float(np.sqrt(_mean(relative)))
    each = _means(nees)
    values = nees[~np.isnan(nees)]
    return {
        "axes": axes,
        "rmse_m": float(np.sqrt(_mean(_means(square)))),
        "median_rms_m": float(np.nanmedian(np.sqrt(_means(square)))),
        "sigma_m": float(np.sqrt(_mean(_means(sigma2)))),
        "bound_m": float(np.sqrt(_mean(least))),
        "rmse_over_bound": ratio,
        # Of a root of a mean of squares, to the first order.
        "rmse_over_bound_error": 0.5 * ratio * _error(ours) / max(_mean(ours), 1e-300),
        "rmse_over_bound_by_run": by_run,
        "rmse_over_bound_by_run_error": 0.5 * _error(relative) / max(by_run, 1e-300),
        "anees": _mean(each),
        "anees_error": _error(each),
        "anees_expected": axes,
        "anees_band_99": list(mean_band(len(runs), axes, alarm=ALARM)),
        "divergence": divergence(values, axes),
        "divergence_error": divergence_error(nees, axes) if len(runs) > 1 else None,
        "divergence_of_honest": divergence_bias(len(runs), axes),
        "coverage": [_coverage(nees, probability, axes) for probability in PROBABILITIES],
        "histogram": {"tail": TAIL.tolist(), "count": counts(values, axes).tolist()},
        "over_time": _over_time(runs, square, sigma2, bound, nees),
    }


def _coverage(nees: NDArray[np.float64], probability: float, axes: int) -> dict[str, float]:
    inside = np.where(np.isnan(nees), np.nan, nees <= limit(probability, axes))
    each = _means(inside)
    return {"probability": probability, "share": _mean(each), "error": _error(each)}


def _over_time(
    runs: Sequence[Run],
    square: NDArray[np.float64],
    sigma2: NDArray[np.float64],
    bound: NDArray[np.float64],
    nees: NDArray[np.float64],
) -> dict[str, Any]:
    reached = np.sum(~np.isnan(nees), axis=0)
    kept = reached >= max(_FEWEST * len(runs), 1)
    anees = _down(nees)[kept]
    bands = [mean_band(int(count), runs[0].axes, alarm=ALARM) for count in reached[kept]]
    inside = [low <= value <= high for value, (low, high) in zip(anees, bands, strict=True)]
    return {
        "time_s": _down(_stacked(runs, "time_s"))[kept],
        "runs": reached[kept],
        "rmse_m": np.sqrt(_down(square)[kept]),
        "sigma_m": np.sqrt(_down(sigma2)[kept]),
        "bound_m": np.sqrt(_down(bound)[kept]),
        "anees": anees,
        "anees_band_99": bands,
        "anees_share_in_band": float(np.mean(inside)) if inside else None,
    }


def _stacked(runs: Sequence[Run], name: str) -> NDArray[np.float64]:
    """Return a score of all runs, shape (runs, n); shorter ones are filled up with NaN."""
    rows = [getattr(run, name) for run in runs]
    full = np.full((len(rows), max(row.size for row in rows)), np.nan)
    for index, row in enumerate(rows):
        full[index, : row.size] = row
    return full


def _means(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of each row without its NaN; NaN for a row of nothing else."""
    return _ratio(np.nansum(values, axis=1), np.sum(~np.isnan(values), axis=1))


def _down(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of each column without its NaN."""
    return _ratio(np.nansum(values, axis=0), np.sum(~np.isnan(values), axis=0))


def _ratio(total: NDArray[np.float64], count: NDArray[np.int64]) -> NDArray[np.float64]:
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _mean(values: NDArray[np.float64]) -> float:
    some = values[~np.isnan(values)]
    return float(some.mean()) if some.size else np.nan


def _error(values: NDArray[np.float64]) -> float:
    """Return the standard error of a mean of independent values; NaN of fewer than two."""
    some = values[~np.isnan(values)]
    if some.size < 2 or not np.isfinite(some).all():
        return np.nan
    return float(some.std(ddof=1) / np.sqrt(some.size))
