"""The factor graph on the time-difference study, run by run against the bound.

``python -m geograph.scenarios.tdoa_graph --runs 1000`` prints docs/accuracy.md's tables of the
graph. Each run is smoothed as the recording that its sensors would have written: no first guess, no
setting that is not in the recording.

A thousand runs tell a root mean square to 2 %. How far an estimator is from the bound can be told
much better, because the error that an efficient estimator would have made on the same noise is
known to first order, and its mean square is the bound: rms^2 = bound^2 + mean(e^2 - e_first^2) is
the same figure with most of the chance of the draw taken out (a control variate: J. M. Hammersley,
D. C. Handscomb, *Monte Carlo Methods*, 1964, section 5.5).
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.consistency import mean_band, nees
from geograph.scenarios.moving_sensors import VARIANTS, MovingSensors, draw, recordings
from geograph.scenarios.tdoa_bound import bound_m, efficient_errors
from geograph.smoother import smooth
from geograph.workers import Lost, run_isolated

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

_CHUNK = 25
_FALSE_ALARM = 0.01


@dataclass(frozen=True, eq=False)
class GraphRuns:
    """What the graph made of many runs.

    Attributes
    ----------
    error_m
        Shape (runs, 2): place of the emitter at the last set, less the truth, metres.
    nees
        Shape (runs,): e' P^-1 e with the posterior covariance P in the plane.
    status
        How each run ended.
    """

    error_m: NDArray[np.float64]
    nees: NDArray[np.float64]
    status: tuple[str, ...]


@dataclass(frozen=True)
class GraphScore:
    """How the graph did.

    Attributes
    ----------
    bound_m
        Cramer-Rao bound, metres.
    rms_m, standard_error_m
        Root mean square error, and the standard error that the number of runs leaves.
    ratio, ratio_error
        RMS over the bound with the chance of the draw taken out, and its standard error.
    anees, band
        Mean of the NEES, 2 expected, and the band that holds it in 99 % of studies.
    converged
        Runs that converged.
    runs
        Runs in all.
    """

    bound_m: float
    rms_m: float
    standard_error_m: float
    ratio: float
    ratio_error: float
    anees: float
    band: tuple[float, float]
    converged: int
    runs: int


def graph_runs(variant: MovingSensors, seeds: Sequence[int]) -> GraphRuns:
    """Smooth one recording for each seed.

    Parameters
    ----------
    variant
        One of :data:`geograph.scenarios.moving_sensors.VARIANTS`, or another.
    seeds
        Whole numbers of at least 0.
    """
    last = variant.time_s[-1]
    truth = variant.emitter_at(last)
    error, normalised, status = [], [], []
    for recording in recordings(variant, seeds):
        track = smooth(recording, raise_on_failure=False)
        state = track.at(last)
        off = state.position_m[0, :2] - truth
        error.append(off)
        normalised.append(float(nees(off[None], state.covariance[:, :2, :2])[0]))
        status.append(str(track.status))
    return GraphRuns(np.array(error), np.array(normalised), tuple(status))


def graph_score(variant: MovingSensors, seeds: Sequence[int], runs: GraphRuns) -> GraphScore:
    """Score the graph's runs of a variant.

    Parameters
    ----------
    variant, seeds
        What was simulated.
    runs
        What the graph made of it.
    """
    times, places = zip(*(draw(variant, seed) for seed in seeds), strict=True)
    first = efficient_errors(variant, np.array(times), np.array(places))
    square = np.sum(runs.error_m**2, axis=1)
    gain = square - np.sum(first**2, axis=1)
    least = bound_m(variant)
    rms = float(np.sqrt(square.mean()))
    excess = float(np.sqrt(max(least**2 + gain.mean(), 0.0)))
    count = square.size
    return GraphScore(
        bound_m=least,
        rms_m=rms,
        standard_error_m=float(square.std() / np.sqrt(count) / (2.0 * rms)),
        ratio=excess / least,
        ratio_error=float(gain.std() / np.sqrt(count) / (2.0 * least * max(excess, 1e-300))),
        anees=float(runs.nees.mean()),
        band=mean_band(count, 2, alarm=_FALSE_ALARM),
        converged=runs.status.count("converged"),
        runs=count,
    )


@dataclass(frozen=True)
class _Job:
    name: str
    seeds: range


def _work(job: _Job) -> GraphRuns:
    return graph_runs(VARIANTS[job.name], job.seeds)


def scores(
    names: Iterable[str], seeds: range, *, workers: int = 1
) -> Iterable[tuple[str, GraphScore]]:
    """Yield the score of every variant, from runs spread over processes.

    Parameters
    ----------
    names
        Of :data:`geograph.scenarios.moving_sensors.VARIANTS`.
    seeds
        One run each.
    workers
        Processes.

    Raises
    ------
    RuntimeError
        If a process died or a run raised.
    """
    for name in names:
        parts = [seeds[first : first + _CHUNK] for first in range(0, len(seeds), _CHUNK)]
        done: dict[int, GraphRuns] = {}
        for index, found in run_isolated(
            _work, [_Job(name, part) for part in parts], workers=workers
        ):
            if isinstance(found, Lost):
                raise RuntimeError(f"{name}, seeds from {parts[index].start}: {found.reason}")
            done[index] = found
        ordered = [done[index] for index in range(len(parts))]
        runs = GraphRuns(
            np.concatenate([part.error_m for part in ordered]),
            np.concatenate([part.nees for part in ordered]),
            tuple(status for part in ordered for status in part.status),
        )
        yield name, graph_score(VARIANTS[name], seeds, runs)


def row(name: str, score: GraphScore) -> str:
    """Return a score as a row of Markdown."""
    low, high = score.band
    return (
        f"| {name} | {score.bound_m:.2f} | {score.rms_m:.2f}±{score.standard_error_m:.2f} | "
        f"{score.ratio:.4f}±{score.ratio_error:.4f} | {score.anees:.3f} | "
        f"{low:.3f} to {high:.3f} | {score.converged} of {score.runs} |"
    )


HEADER = (
    "| variant | bound | RMS | RMS / bound, same noise | ANEES | 99 % band | converged |\n"
    "| --- | --- | --- | --- | --- | --- | --- |"
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; see ``--help``."""
    parser = argparse.ArgumentParser(
        prog="python -m geograph.scenarios.tdoa_graph",
        description="The factor graph on the time-difference study: errors in metres, last set.",
    )
    parser.add_argument("variants", nargs="*", metavar="VARIANT", help="which (all)")
    parser.add_argument("--runs", type=int, default=1000, help="runs of each variant (1000)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first run (0)")
    parser.add_argument("--jobs", type=int, default=1, help="processes (1)")
    options = parser.parse_args(arguments)
    unknown = [name for name in options.variants if name not in VARIANTS]
    if unknown:
        parser.error(f"{unknown[0]!r} is no variant; expected one of {', '.join(VARIANTS)}")
    if options.runs < 2 or options.seed < 0 or options.jobs < 1:
        parser.error("expected --runs of at least 2, --seed of at least 0, --jobs of at least 1")
    seeds = range(options.seed, options.seed + options.runs)
    print(HEADER)
    for name, score in scores(options.variants or VARIANTS, seeds, workers=options.jobs):
        print(row(name, score), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
