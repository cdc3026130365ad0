"""Monte Carlo of the study from the air beside the published table (Kallin 2021).

``python -m geograph.scenarios.aoa_study --runs 1000 --seed 0`` prints docs/accuracy.md's tables. A
run of every scenario is drawn from its own seed and the scenario's name, so rows are independent.
Errors are horizontal, in metres.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.scenarios.airborne import (
    RATE_HZ,
    SCENARIOS,
    Airborne,
    Runs,
    beyond,
    draw_noise,
    simulate,
)
from geograph.scenarios.aoa_bound import (
    efficient_errors,
    horizontal_m,
    recursive_bound,
    sequence_bound_m,
)
from geograph.scenarios.aoa_estimators import Estimates, weighted_least_squares
from geograph.scenarios.aoa_kalman import extended_kalman, unscented_kalman

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    from geograph.scenarios.airborne_recordings import KnownGround
    from geograph.scenarios.aoa_smoothed import Smoothed


@dataclass(frozen=True)
class Published:
    """Root mean square errors over the sequence in the thesis's table, metres.

    Attributes
    ----------
    least_squares, extended, unscented
        Of the three estimators.
    bound
        Cramer-Rao.
    """

    least_squares: float
    extended: float
    unscented: float
    bound: float

    @property
    def best(self) -> float:
        """The least error of the three."""
        return min(self.least_squares, self.extended, self.unscented)


PUBLISHED: dict[str, Published] = {
    "1-5deg": Published(950, 756, 925, 155),
    "2-5deg": Published(176, 177, 183, 148),
    "3-5deg": Published(229, 238, 243, 213),
    "4-5deg": Published(46, 110, 71, 36),
    "5-5deg": Published(57, 45, 57, 36),
    "1-10deg": Published(1126, 939, 1105, 310),
    "2-10deg": Published(346, 349, 362, 297),
    "3-10deg": Published(449, 459, 469, 427),
    "4-10deg": Published(102, 153, 132, 72),
    "5-10deg": Published(99, 84, 99, 72),
}
"""Kallin (2021), 1000 runs."""

ESTIMATORS: dict[str, Callable[[Runs], Estimates]] = {
    "least_squares": weighted_least_squares,
    "extended": extended_kalman,
    "unscented": unscented_kalman,
}
"""The comparison estimators, by the names of the published figures."""

PREFIXES = 16
"""About how many prefixes of a run are smoothed."""

_BATCH = 250


@dataclass(frozen=True)
class Score:
    """Root mean squares over runs of the horizontal error, with their standard errors, metres.

    Attributes
    ----------
    sequence_m, sequence_error_m
        Over all steps.
    final_m, final_error_m
        After the last.
    """

    sequence_m: float
    sequence_error_m: float
    final_m: float
    final_error_m: float

    @classmethod
    def of(cls, sequence_m2: NDArray[np.float64], final_m2: NDArray[np.float64]) -> Score:
        """Return the score of each run's mean squared error, and of its last one, shape (runs,)."""
        return cls(*root_mean(sequence_m2), *root_mean(final_m2))


def root_mean(squares: NDArray[np.float64]) -> tuple[float, float]:
    """Return the root of the mean of squares, shape (runs,), and its standard error."""
    root = float(np.sqrt(squares.mean()))
    return root, float(squares.std() / np.sqrt(squares.size) / (2.0 * root))


def study(
    scenario: Airborne, seeds: Sequence[int], *, names: Iterable[str] = ESTIMATORS
) -> dict[str, Score]:
    """Return the score of each estimator on a scenario with a static emitter.

    Parameters
    ----------
    scenario
        One of :data:`geograph.scenarios.airborne.SCENARIOS`, or another.
    seeds
        One run each.
    names
        Of :data:`ESTIMATORS`.
    """
    truth = np.array(scenario.target_m[:2])
    squares: dict[str, list[NDArray[np.float64]]] = {name: [] for name in names}
    for first in range(0, len(seeds), _BATCH):
        runs = simulate(scenario, seeds[first : first + _BATCH])
        for name, parts in squares.items():
            position = ESTIMATORS[name](runs).position_m[..., :2]
            parts.append(np.sum((position - truth) ** 2, axis=-1))
    every = {name: np.concatenate(parts) for name, parts in squares.items()}
    return {name: Score.of(each.mean(axis=1), each[:, -1]) for name, each in every.items()}


def _row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _head(cells: Sequence[str]) -> list[str]:
    return [_row(cells), "| --- " * len(cells) + "|"]


def _number(value: float) -> str:
    return f"{value:.1f}" if value < 100.0 else f"{value:.0f}"


def bounds_table() -> str:
    """Return the bounds beside the printed ones, as Markdown."""
    lines = _head(
        ["scenario", "bound", "printed", "height not known", "last step", "height not known"]
    )
    for name, published in PUBLISHED.items():
        scenario = SCENARIOS[name]
        known, unknown = (
            horizontal_m(recursive_bound(scenario, height_known=known)) for known in (True, False)
        )
        open_height = not scenario.terrain_known
        lines.append(
            _row(
                [
                    name,
                    _number(sequence_bound_m(scenario, height_known=True)),
                    f"{published.bound:.0f}",
                    _number(sequence_bound_m(scenario)) if open_height else "",
                    _number(known[-1]),
                    _number(unknown[-1]) if open_height else "",
                ]
            )
        )
    return "\n".join(lines)


def published_table(seeds: Sequence[int]) -> str:
    """Return the estimators over the sequence beside the printed figures, as Markdown."""
    header = ["scenario"]
    for name in ("least squares", "EKF", "UKF"):
        header += [name, "printed", "ratio"]
    lines = _head(header)
    for name, published in PUBLISHED.items():
        cells = [name]
        for estimator, score in study(SCENARIOS[name], seeds).items():
            printed = getattr(published, estimator)
            cells += [
                f"{score.sequence_m:.0f}±{score.sequence_error_m:.0f}",
                f"{printed:.0f}",
                f"{score.sequence_m / printed:.2f}",
            ]
        lines.append(_row(cells))
        print(lines[-1], file=sys.stderr, flush=True)
    return "\n".join(lines)


def smoothed_tables(
    final: int,
    sequences: int,
    first: int,
    ground: KnownGround,
    rows: Sequence[str] = tuple(PUBLISHED),
) -> str:
    """Return the factor graph's errors, and its consistency over time at 10 degrees, as Markdown.

    Parameters
    ----------
    final, sequences
        Runs of which the whole is smoothed, and runs of which prefixes are.
    first
        Seed of the first run.
    ground
        How recordings know the ground.
    rows
        Names of scenarios.
    """
    from geograph.scenarios.aoa_smoothed import log_steps, smooth_prefixes

    titles = ["scenario", "last step", "bound", "ratio", "ratio, same noise"]
    lines = _head([*titles, "sequence", "best printed", "bound"])
    shown = log_steps(SCENARIOS["1-10deg"].steps, PREFIXES)[:-1:2]
    consistency = _head(["scenario", *(f"{step / RATE_HZ:g} s" for step in shown)])
    for name in rows:
        published, scenario = PUBLISHED[name], SCENARIOS[name]
        step = log_steps(scenario.steps, PREFIXES)
        some = range(first, first + min(sequences, final))
        several = smooth_prefixes(scenario, some, step=step, ground=ground)
        others = range(some.stop, first + final)
        rest = smooth_prefixes(scenario, others, step=step[-1:], ground=ground)
        last = np.concatenate([several.squared_m2[:, -1], rest.squared_m2[:, 0]])
        score = Score.of(several.over_sequence_m2(), last)
        bound = float(horizontal_m(recursive_bound(scenario))[-1])
        cells = [
            name,
            f"{score.final_m:.1f}±{score.final_error_m:.1f}",
            f"{bound:.1f}",
            f"{score.final_m / bound:.3f}±{score.final_error_m / bound:.3f}",
            _same_noise(scenario, range(first, first + final), last, bound),
            f"{score.sequence_m:.0f}±{score.sequence_error_m:.0f}",
            f"{published.best:.0f}",
            _number(sequence_bound_m(scenario)),
        ]
        lines.append(_row(cells))
        print(lines[-1], file=sys.stderr, flush=True)
        if name.endswith("-10deg"):
            consistency.append(_consistency(several, shown))
            print(consistency[-1], file=sys.stderr, flush=True)
    return "\n".join([*lines, "", *consistency])


def _same_noise(
    scenario: Airborne, seeds: Sequence[int], square_m2: NDArray[np.float64], bound_m: float
) -> str:
    """Return the ratio to the bound with the chance of the draw taken out, and its error.

    The mean of squares less those of the first-order errors on the same noise, which the bound is
    the mean square of (a control variate).
    """
    noise = np.array([draw_noise(scenario, seed) for seed in seeds])
    gain = square_m2 - np.sum(efficient_errors(scenario, noise) ** 2, axis=1)
    ratio = np.sqrt(max(1.0 + gain.mean() / bound_m**2, 0.0))
    error = gain.std() / np.sqrt(gain.size) / (2.0 * bound_m**2 * max(ratio, 1e-9))
    return f"{ratio:.3f}±{error:.3f}"


def _consistency(result: Smoothed, shown: NDArray[np.int64]) -> str:
    """Return a row of mean NEES and coverage of the 95 % ellipse, at the steps nearest to some."""
    cells = [result.scenario.name]
    for step in shown:
        column = int(np.argmin(np.abs(np.log(result.step / step))))
        covered = 100.0 * result.covered[:, column].mean()
        cells.append(f"{result.nees[:, column].mean():.1f}, {covered:.0f} %")
    return _row(cells)


def beyond_table(seeds: Sequence[int], ground: KnownGround) -> str:
    """Return the harder scenarios with a static emitter: last errors and the bound, as Markdown."""
    from geograph.scenarios.aoa_smoothed import smooth_prefixes

    lines = _head(["scenario", "factor graph", "bound", "NEES", "within 95 %", "EKF", "UKF"])
    for name, scenario in beyond().items():
        if scenario.moving:
            continue
        last = smooth_prefixes(scenario, seeds, step=np.array([scenario.steps]), ground=ground)
        root, error = root_mean(last.squared_m2[:, 0])
        cells = [name, f"{root:.1f}±{error:.1f}"]
        cells.append(f"{horizontal_m(recursive_bound(scenario))[-1]:.1f}")
        cells += [f"{last.nees.mean():.2f}", f"{100.0 * last.covered.mean():.0f} %"]
        filters = () if scenario.azimuth_only else ("extended", "unscented")
        scores = study(scenario, seeds, names=filters)
        cells += [f"{s.final_m:.1f}±{s.final_error_m:.1f}" for s in scores.values()]
        lines.append(_row(cells + ["-"] * (7 - len(cells))))
        print(lines[-1], file=sys.stderr, flush=True)
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; see ``--help``."""
    parser = argparse.ArgumentParser(
        prog="python -m geograph.scenarios.aoa_study",
        description="Horizontal errors in metres, with standard errors over the runs. Rows go to "
        "the standard error stream as they are done.",
    )
    tables = ("bounds", "published", "smoothed", "beyond")
    parser.add_argument("--runs", type=int, default=1000, help="runs of the estimators (1000)")
    parser.add_argument(
        "--final", type=int, default=160, help="of the factor graph's last step (160)"
    )
    parser.add_argument("--sequences", type=int, default=40, help="of its sequences (40)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first run (0)")
    parser.add_argument("--table", choices=(*tables, "all"), default="all", help="which table")
    parser.add_argument(
        "--rows",
        nargs="+",
        choices=tuple(PUBLISHED),
        default=tuple(PUBLISHED),
        help="of the factor graph's table (all)",
    )
    parser.add_argument(
        "--ground", choices=("terrain", "altitude"), default="terrain", help="how it is known"
    )
    options = parser.parse_args(arguments)
    if min(options.runs, options.final, options.sequences) < 2 or options.seed < 0:
        parser.error("expected at least 2 runs of each and --seed of at least 0")

    def seeds(count: int) -> range:
        return range(options.seed, options.seed + count)

    ground = options.ground
    made: dict[str, Callable[[], str]] = {
        "bounds": bounds_table,
        "published": lambda: published_table(seeds(options.runs)),
        "smoothed": lambda: smoothed_tables(
            options.final, options.sequences, options.seed, ground, options.rows
        ),
        "beyond": lambda: beyond_table(seeds(options.sequences), ground),
    }
    for name in tables if options.table == "all" else (options.table,):
        print(made[name](), end="\n\n", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
