"""Monte Carlo of the time-difference study beside the published tables (Camlica 2009).

``python -m geograph.scenarios.tdoa_study --runs 1000 --seed 0`` prints docs/accuracy.md's tables.
A run of every variant is drawn from its own seed and the variant's name, so rows are independent.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.scenarios.moving_sensors import VARIANTS, MovingSensors, Runs, simulate
from geograph.scenarios.tdoa_bound import bound_m
from geograph.scenarios.tdoa_chan_ho import post_processing
from geograph.scenarios.tdoa_estimators import Estimates, pseudo_recursive
from geograph.scenarios.tdoa_kalman import extended_kalman, range_kalman

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence


@dataclass(frozen=True)
class Published:
    """RMS errors at 120 s in the thesis's tables, metres.

    Attributes
    ----------
    pseudo, recursive, post
        Pseudo-recursive maximum likelihood, recursive Kalman, post-processing.
    """

    pseudo: float
    recursive: float
    post: float


PUBLISHED: dict[str, Published] = {
    "emitter-1-1ns": Published(169, 33, 32),
    "emitter-1-5ns": Published(874, 176, 185),
    "emitter-1-10ns": Published(1703, 359, 483),
    "emitter-2-1ns": Published(202, 46, 43),
    "emitter-2-5ns": Published(1023, 229, 365),
    "emitter-2-10ns": Published(2046, 484, 4654),
    "emitter-1-position-0.1m": Published(247, 49, 47),
    "emitter-1-position-0.75m": Published(1378, 261, 342),
    "emitter-1-position-1.5m": Published(2705, 579, 1099),
    "emitter-2-position-0.1m": Published(300, 61, 66),
    "emitter-2-position-0.75m": Published(1681, 357, 1535),
    "emitter-2-position-1.5m": Published(3316, 853, 17060),
}
"""Camlica (2009), 1000 runs, 60 sets."""

ESTIMATORS: dict[str, Callable[[Runs], Estimates]] = {
    "pseudo": pseudo_recursive,
    "range-kalman": lambda runs: range_kalman(runs, moving=runs.variant.moving),
    "range-kalman-original": lambda runs: range_kalman(
        runs, manoeuvres="original", moving=runs.variant.moving
    ),
    "extended-kalman": lambda runs: extended_kalman(runs, moving=runs.variant.moving),
    "post": lambda runs: post_processing(runs, moving=runs.variant.moving),
}
"""The estimators, by the names of the tables' columns."""

COUNTERPARTS: dict[str, str] = {
    "pseudo": "pseudo",
    "range-kalman": "recursive",
    "post": "post",
}
"""Which published figure an estimator stands beside."""


@dataclass(frozen=True)
class Score:
    """How an estimator did at the last set.

    Attributes
    ----------
    rms_m
        Root mean square of the position error over the runs that did not diverge, metres.
    standard_error_m
        Standard error of that, from the spread of the squares.
    median_m
        Median position error, metres.
    nees
        Mean of e' P^-1 e with the estimator's own covariance P; 2 for an honest one.
    lost
        Runs that diverged.
    """

    rms_m: float
    standard_error_m: float
    median_m: float
    nees: float
    lost: int


def score(runs: Runs, estimates: Estimates) -> Score:
    """Score the estimates after the last set against the truth.

    Parameters
    ----------
    runs
        What was simulated.
    estimates
        Of one estimator, from these runs.

    Raises
    ------
    ValueError
        If every run diverged.
    """
    error = estimates.position_m[:, -1] - runs.variant.emitter_at(runs.time_s[-1])
    kept = np.isfinite(error).all(axis=1)
    if not kept.any():
        raise ValueError(f"all {len(runs)} runs of {runs.variant.name} diverged; nothing to score")
    error, covariance = error[kept], estimates.covariance_m2[kept, -1]
    squares = np.sum(error**2, axis=1)
    rms = float(np.sqrt(squares.mean()))
    return Score(
        rms_m=rms,
        standard_error_m=float(squares.std() / np.sqrt(squares.size) / (2.0 * rms)),
        median_m=float(np.sqrt(np.median(squares))),
        nees=float(np.mean(np.einsum("ra,rab,rb->r", error, np.linalg.inv(covariance), error))),
        lost=int(np.count_nonzero(~kept)),
    )


def study(
    variant: MovingSensors, seeds: Sequence[int], *, names: Iterable[str] = ESTIMATORS
) -> dict[str, Score]:
    """Return the score of each estimator that can work on a variant.

    Parameters
    ----------
    variant
        One of :data:`geograph.scenarios.moving_sensors.VARIANTS`, or another.
    seeds
        One run each.
    names
        Of :data:`ESTIMATORS`. Chan and Ho's fixes, and with them ``"post"``, need four sensors, and
        ``"pseudo"`` has no velocity: they are left out where they cannot work.
    """
    runs = simulate(variant, seeds)
    left_out = set()
    if len(variant.group_m) < 4:
        left_out.add("post")
    if variant.moving:
        left_out.add("pseudo")
    return {name: score(runs, ESTIMATORS[name](runs)) for name in names if name not in left_out}


def _cell(value: Score | None) -> str:
    if value is None:
        return "-"
    lost = f" ({value.lost} lost)" if value.lost else ""
    return f"{value.rms_m:.0f}±{value.standard_error_m:.0f}{lost}"


def published_table(seeds: Sequence[int]) -> str:
    """Return the two published tables with ours beside them, and their ratio, as Markdown."""
    lines = [
        "| variant | bound | "
        + " | ".join(f"{n} | published | ratio" for n in COUNTERPARTS)
        + " |",
        "| --- " * (2 + 3 * len(COUNTERPARTS)) + "|",
    ]
    for name, published in PUBLISHED.items():
        scores = study(VARIANTS[name], seeds, names=COUNTERPARTS)
        cells = [name, f"{bound_m(VARIANTS[name]):.1f}"]
        for ours, theirs in COUNTERPARTS.items():
            value = getattr(published, theirs)
            cells += [_cell(scores[ours]), f"{value:.0f}", f"{scores[ours].rms_m / value:.2f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def variants_table(seeds: Sequence[int]) -> str:
    """Return every estimator on every variant, as Markdown: RMS and, of the filters, NEES."""
    names = list(ESTIMATORS)
    lines = [
        "| variant | bound | " + " | ".join(names) + " | NEES of extended-kalman |",
        "| --- " * (3 + len(names)) + "|",
    ]
    for variant in VARIANTS.values():
        if variant.straight_platforms:
            # The same noise as without the knowledge, of which these estimators make no use.
            continue
        scores = study(variant, seeds)
        cells = [variant.name, f"{bound_m(variant):.1f}"]
        cells += [_cell(scores.get(name)) for name in names]
        cells.append(f"{scores['extended-kalman'].nees:.2f}")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def windows_table(seeds: Sequence[int]) -> str:
    """Return the pseudo-recursive estimator by its number of sets and its weights, as Markdown."""
    windows = (1, 5, 10, 20)
    header = [f"{n} sets" for n in windows] + [f"{n}, correlated" for n in windows]
    lines = ["| variant | " + " | ".join(header) + " |", "| --- " * (1 + len(header)) + "|"]
    for number in (1, 2):
        for nanoseconds in (1, 5, 10):
            variant = VARIANTS[f"emitter-{number}-{nanoseconds}ns"]
            runs = simulate(variant, seeds)
            cells = [
                _cell(score(runs, pseudo_recursive(runs, window=n, correlated=correlated)))
                for correlated in (False, True)
                for n in windows
            ]
            lines.append(f"| {variant.name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


TABLES: dict[str, Callable[[Sequence[int]], str]] = {
    "published": published_table,
    "variants": variants_table,
    "windows": windows_table,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; see ``--help``."""
    parser = argparse.ArgumentParser(
        prog="python -m geograph.scenarios.tdoa_study",
        description="RMS errors in metres at the last set, with standard errors over the runs.",
    )
    parser.add_argument("--runs", type=int, default=1000, help="runs of each variant (1000)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first run (0)")
    parser.add_argument("--table", choices=(*TABLES, "all"), default="all", help="which table")
    options = parser.parse_args(arguments)
    if options.runs < 2 or options.seed < 0:
        parser.error("expected --runs of at least 2 and --seed of at least 0")
    seeds = range(options.seed, options.seed + options.runs)
    chosen = TABLES if options.table == "all" else {options.table: TABLES[options.table]}
    print("\n\n".join(table(seeds) for table in chosen.values()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
