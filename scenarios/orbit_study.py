"""Orbits from angles alone: how near the bound, and how honest, case by case.

``python -m geograph.scenarios.orbit_study --runs 40`` prints the table of docs/accuracy.md. Each
row is what ``geograph montecarlo`` gives for the scenario of that name, with the same seeds.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from typing import TYPE_CHECKING, Any

from geograph.montecarlo import Plan, run_study
from geograph.montecarlo.figures import point_figures
from geograph.scenarios.registry import simulate
from geograph.scenarios.satellites import CASES

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

HEADER = (
    "| case | bound m | RMSE m | RMSE / bound | ANEES | 99 % band | in 95 % ellipsoid "
    "| converged |\n"
    "| --- | --- | --- | --- | --- | --- | --- | --- |"
)


def rows(names: Sequence[str], runs: int, seed: int, *, workers: int = 1) -> Iterator[str]:
    """Yield a line of the table for each case, as Markdown.

    Parameters
    ----------
    names
        Of :data:`geograph.scenarios.satellites.CASES`.
    runs, seed
        How many runs, and the seed of the first.
    workers
        Processes.
    """
    for name in names:
        plan = Plan(scenario=name, simulate=partial(simulate, name), runs=runs, seed=seed)
        yield row(name, point_figures(run_study(plan, workers=workers)[0]))


def row(name: str, found: dict[str, Any]) -> str:
    """Return a line of the table, from the figures of a study."""
    ended = f"{found['converged']} of {found['runs']}"
    if not found["converged"]:
        return f"| {name} | - | - | - | - | - | - | {ended} |"
    low, high = found["anees_band_99"]
    (inside,) = (entry for entry in found["coverage"] if entry["probability"] == 0.95)
    cells = [
        name,
        f"{found['bound_m']:.3g}",
        f"{found['rmse_m']:.3g}",
        f"{found['rmse_over_bound']:.3f}±{found['rmse_over_bound_error']:.3f}",
        f"{found['anees']:.2f}",
        f"{low:.2f} to {high:.2f}",
        f"{100 * inside['share']:.1f}±{100 * inside['error']:.1f} %",
        ended,
    ]
    return "| " + " | ".join(cells) + " |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; see ``--help``."""
    parser = argparse.ArgumentParser(
        prog="python -m geograph.scenarios.orbit_study",
        description="Orbits from angles alone: errors over Cramer-Rao bounds, ANEES, coverage.",
    )
    parser.add_argument("cases", nargs="*", metavar="CASE", help="which (all)")
    parser.add_argument("--runs", type=int, default=40, help="runs of each case (40)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first run (0)")
    parser.add_argument("--jobs", type=int, default=1, help="processes (1)")
    options = parser.parse_args(arguments)
    unknown = [name for name in options.cases if name not in CASES]
    if unknown:
        parser.error(f"{unknown[0]!r} is no case; expected one of {', '.join(CASES)}")
    if options.runs < 2 or options.seed < 0 or options.jobs < 1:
        parser.error("expected --runs of at least 2, --seed of at least 0, --jobs of at least 1")
    print(HEADER, flush=True)
    names = options.cases or list(CASES)
    for line in rows(names, options.runs, options.seed, workers=options.jobs):
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
