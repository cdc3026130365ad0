"""Satellites, angles only: the published tables beside ours, and the factor graph on the same.

``python -m geograph.scenarios.angles_study --runs 200`` prints docs/accuracy.md's tables. Every
estimator, the factor graph included, gets the same recordings; the graph gets no first guess and no
setting that is not in the recording. Figures have their standard error over the trials.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.consistency import AXES, divergence_bias
from geograph.scenarios.accelerometer import Accelerometer
from geograph.scenarios.angles_scores import Figure, honesty, improvement
from geograph.scenarios.angles_trials import BASELINE, ESTIMATORS, GRAPH, Scores, run_trials
from geograph.scenarios.angles_worlds import WORLDS, variant

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from geograph.scenarios.angles_worlds import AnglesWorld


@dataclass(frozen=True, kw_only=True)
class Published:
    """What a paper printed of one estimator in one world; None: nothing.

    Attributes
    ----------
    anees
        Mean of the NEES.
    converged, improved, gain
        Shares of the trials that converged and that were better than the baseline, and by how
        much on average.
    divergence, divergence_kinematic
        Kullback-Leibler divergence of the NEES from chi-square, with the covariance of the position
        and with the kinematic one.
    """

    anees: float | None = None
    converged: float | None = None
    improved: float | None = None
    gain: float | None = None
    divergence: float | None = None
    divergence_kinematic: float | None = None


_NOTHING = Published()

_ASTRAY = 10.0

PUBLISHED: dict[str, dict[str, Published]] = {
    "sprang-simple": {"static": Published(anees=8.59), "velocity": Published(anees=3.10)},
    "sprang-staged": {
        "static": Published(anees=33.2),
        "velocity": Published(anees=9.0),
        "velocity, CI": Published(anees=1.83),
    },
    "levy-simple": {
        BASELINE: Published(divergence=3.02, divergence_kinematic=1.84),
        "BMod": Published(
            converged=0.986,
            improved=0.95,
            gain=0.208,
            divergence=3.16,
            divergence_kinematic=2.85,
        ),
        "BDNLO": Published(
            converged=0.975,
            improved=0.937,
            gain=0.683,
            divergence=3.98,
            divergence_kinematic=8.40,
        ),
    },
    "levy-staged": {
        BASELINE: Published(divergence=3.77, divergence_kinematic=3.19),
        "BMod": Published(
            converged=0.982,
            improved=0.863,
            gain=0.109,
            divergence=2.62,
            divergence_kinematic=0.59,
        ),
        "BDNLO": Published(
            converged=0.923,
            improved=0.697,
            gain=0.229,
            divergence=20.7,
            divergence_kinematic=0.97,
        ),
    },
}
"""Sprang (2015) and Levy et al., by world and estimator."""

_LEVY_NAMES = (BASELINE, "BMod", "BDNLO", GRAPH)
_SPRANG_NAMES = (*(name for name in ESTIMATORS if name not in ("BMod", "BDNLO")), GRAPH)

LIMITS: dict[str, dict[str, Any]] = {
    "as it stands": {},
    "two sensors": {"sensors": (2, 2)},
    "few measurements": {"bearings": (100, 100)},
    "biases to 40 mrad": {"bias_rad": 40e-3},
    "drifts to 0.2 mrad/s": {"drift_rad_s": 0.2e-3},
    "85 % from one sensor": {"busiest": 0.85},
    "white noise 20 urad": {"sigma_rad": 20e-6},
    "white noise 50 urad": {"sigma_rad": 50e-6},
    "20 outliers": {"outliers": 20},
}
"""What BDNLO is said to diverge on, and noise, as changes of a world of Levy et al."""

CHOICES: dict[str, dict[str, dict[str, Any]]] = {
    "sprang": {
        "resolution 1.2 urad/s2": {},
        "resolution 4 urad/s2": {"accelerometer": Accelerometer(resolution_rad_s2=4e-6)},
    },
    "levy": {
        "white noise 5 urad": {},
        "white noise 20 urad": LIMITS["white noise 20 urad"],
    },
}
"""The two values that were chosen after the graph's coverage was seen, and what they replaced."""

TIME_TAGS_S = (0.0, 1e-3, 10e-3, 50e-3)
"""Sprang's sweep of the error of time tags: limits of a uniform constant of each sensor."""


def _beside(ours: str, theirs: float | None, digits: int = 2) -> str:
    return ours if theirs is None else f"{ours} ({theirs:.{digits}f})"


def _percent(figure: Figure, theirs: float | None = None) -> str:
    text = f"{100 * figure.value:.1f}±{100 * figure.error:.1f}"
    return text if theirs is None else f"{text} ({100 * theirs:.1f})"


def _row(name: str, mine: Scores, baseline: Scores, published: Published) -> str:
    """Return one estimator's scores as a row of Markdown, published figures in brackets.

    What settled ten times as far from the truth as the baseline has diverged, too.
    """
    good = mine.converged & ~(mine.rms_m > _ASTRAY * baseline.rms_m)
    count = good.size
    share = float(good.mean())
    converged = Figure(share, float(np.sqrt(share * (1.0 - share) / max(count - 1, 1))))
    cells = [name, _percent(converged, published.converged)]
    if not good.any():
        return "| " + " | ".join([*cells, *["-"] * 8]) + " |"
    both = good & baseline.converged
    cells.append(f"{np.median(mine.rms_m[good]):.0f}")
    if name == BASELINE or not both.any():
        cells += ["-", "-", "-"]
    else:
        gain = improvement(mine.rms_m[both], baseline.rms_m[both])
        cells += [_percent(gain.share, published.improved), _percent(gain.mean, published.gain)]
        cells.append(f"{100 * gain.median:.1f}")
    own, kinematic = honesty(mine.nees[good]), honesty(mine.nees_kinematic[good])
    cells.append(_beside(own.anees.text(), published.anees))
    cells.append(_beside(own.divergence.text(3), published.divergence))
    cells.append(
        "-"
        if name == GRAPH
        else _beside(kinematic.divergence.text(3), published.divergence_kinematic)
    )
    cells.append(_percent(own.coverage))
    return "| " + " | ".join(cells) + " |"


_HEADER = (
    "| estimator | converged % | RMS m, median | better % | by %, mean | median | ANEES | KL | "
    "KL, kinematic | in 95 % ellipsoid, % |\n" + "| --- " * 10 + "|"
)


def world_table(
    world: AnglesWorld,
    seeds: range,
    names: Sequence[str],
    *,
    workers: int = 1,
    published: dict[str, Published] | None = None,
) -> str:
    """Return the scores of all estimators in one world, as Markdown.

    Parameters
    ----------
    world
        What the trials are like.
    seeds
        One trial each.
    names
        Of :data:`geograph.scenarios.angles_trials.ESTIMATORS`, and ``GRAPH``; the baseline is among
        them.
    workers
        Processes.
    published
        What was printed of some of them.
    """
    found = run_trials(world, seeds, names, workers=workers)
    printed = published or {}
    lines = [
        _HEADER,
        *(_row(n, found[n], found[BASELINE], printed.get(n, _NOTHING)) for n in names),
    ]
    graph = found.get(GRAPH)
    if graph is not None and not graph.converged.all():
        named = int(graph.named.sum())
        other = int((~graph.converged & ~graph.named).sum())
        lines.append(f"\nThe graph named {named} as unobservable; {other} ended otherwise.")
    return "\n".join(lines)


def published_tables(
    seeds: range, workers: int, worlds: Sequence[str] = tuple(WORLDS)
) -> Iterator[str]:
    """Yield a table for each published world."""
    low, high = divergence_bias(len(seeds) * 40), divergence_bias(len(seeds))
    yield (
        f"{len(seeds)} trials; degrees of freedom {AXES}; the divergence of as many draws from "
        f"chi-square itself is {low:.4f} (all independent) to {high:.4f} (one value a trial)."
    )
    for name in worlds:
        world = WORLDS[name]
        names = _SPRANG_NAMES if name.startswith("sprang") else _LEVY_NAMES
        table = world_table(world, seeds, names, workers=workers, published=PUBLISHED[name])
        yield f"{name} ({world.source}):\n\n{table}"


def graph_tables(
    seeds: range, workers: int, worlds: Sequence[str] = tuple(WORLDS)
) -> Iterator[str]:
    """Yield a table of the baseline and the graph alone for each world, which is quicker."""
    for name in worlds:
        table = world_table(WORLDS[name], seeds, (BASELINE, GRAPH), workers=workers)
        yield f"{name}, {len(seeds)} trials:\n\n{table}"


def _variant_tables(
    name: str,
    variants: Mapping[str, dict[str, Any]],
    estimators: Sequence[str],
    seeds: range,
    workers: int,
) -> Iterator[str]:
    """Yield a table for each variant of a world, by what is other in it."""
    for what, changes in variants.items():
        table = world_table(variant(name, **changes), seeds, estimators, workers=workers)
        yield f"{name}, {what}:\n\n{table}"


def limits_tables(
    seeds: range, workers: int, worlds: Sequence[str] = tuple(WORLDS)
) -> Iterator[str]:
    """Yield tables of what BDNLO is said to diverge on."""
    names = (BASELINE, "BDNLO", GRAPH)
    for name in [name for name in worlds if name.startswith("levy")]:
        yield from _variant_tables(name, LIMITS, names, seeds, workers)


def choices_tables(
    seeds: range, workers: int, worlds: Sequence[str] = tuple(WORLDS)
) -> Iterator[str]:
    """Yield tables of the baseline and the graph with the chosen and the replaced values."""
    trials = f"{len(seeds)} trials from seed {seeds.start}"
    for name in worlds:
        study = CHOICES[name.partition("-")[0]]
        variants = {f"{what}, {trials}": changes for what, changes in study.items()}
        yield from _variant_tables(name, variants, (BASELINE, GRAPH), seeds, workers)


def time_tag_tables(
    seeds: range, workers: int, worlds: Sequence[str] = tuple(WORLDS)
) -> Iterator[str]:
    """Yield tables of the sweep of time-tag errors."""
    names = ("velocity, CI", BASELINE, GRAPH)
    variants = {f"time tags to {1e3 * s:g} ms": {"clock_offset_s": s} for s in TIME_TAGS_S}
    for name in [name for name in worlds if name.startswith("sprang")]:
        yield from _variant_tables(name, variants, names, seeds, workers)


TABLES: dict[str, Callable[[range, int, Sequence[str]], Iterator[str]]] = {
    "published": published_tables,
    "graph": graph_tables,
    "limits": limits_tables,
    "choices": choices_tables,
    "time-tags": time_tag_tables,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; see ``--help``."""
    parser = argparse.ArgumentParser(
        prog="python -m geograph.scenarios.angles_study",
        description="Satellites, angles only: published estimators and the factor graph. "
        "Published figures are in brackets.",
    )
    parser.add_argument("--runs", type=int, default=200, help="trials of each world (200)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first trial (0)")
    parser.add_argument("--jobs", type=int, default=1, help="processes (1)")
    parser.add_argument("--table", choices=(*TABLES, "all"), default="published", help="which")
    parser.add_argument("--worlds", nargs="+", choices=tuple(WORLDS), default=tuple(WORLDS))
    options = parser.parse_args(arguments)
    if options.runs < 2 or options.seed < 0 or options.jobs < 1:
        parser.error("expected --runs of at least 2, --seed of at least 0, --jobs of at least 1")
    seeds = range(options.seed, options.seed + options.runs)
    chosen = TABLES if options.table == "all" else {options.table: TABLES[options.table]}
    for tables in chosen.values():
        for table in tables(seeds, options.jobs, options.worlds):
            print(f"{table}\n", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
