"""Process noise found by evidence, one and in stages, against the true one.

``python -m geograph.scenarios.noise_study --runs 200`` prints docs/accuracy.md's tables.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.consistency import nees
from geograph.scenarios.angles_worlds import angles_trial, variant
from geograph.scenarios.fireballs import Fireball, fireball
from geograph.scenarios.low_orbit import low_orbit_pass
from geograph.scenarios.staged import random_staged_path
from geograph.scenarios.staged_noise import StagedFlight, StagedNoise, staged_flight
from geograph.scenarios.worlds import Streams
from geograph.smoother import smooth
from geograph.solver import Status

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

WAYS: dict[str, dict[str, Any]] = {
    "true": {},
    "auto": {"process_noise": "auto", "stages": None},
    "stages": {"process_noise": "auto", "stages": "auto"},
}
"""Settings that are compared, over those of the recordings, which have the true noise."""


def angles(seed: int, name: str, **changes: Any) -> StagedFlight:
    """Return a trial of :mod:`geograph.scenarios.angles_worlds`, with its boundaries."""
    world = variant(name, **changes)
    boundary = np.zeros(0)
    if world.path == "staged":
        # The same stream draws the same path.
        drawn = random_staged_path(Streams.from_seed(seed).path, world.stages, world.span_s)
        boundary = drawn.boundary_s
    return StagedFlight(angles_trial(seed, world).recording, boundary)


def _noise(seed: int, **changes: Any) -> StagedFlight:
    return staged_flight(seed, StagedNoise(**changes))


def _low(seed: int, **changes: Any) -> StagedFlight:
    return StagedFlight(low_orbit_pass(seed, **changes), np.zeros(0))


_CHANGING = (0.3, 10.0, 0.3)

STAGED: dict[str, Callable[[int], StagedFlight]] = {
    "sprang-staged": partial(angles, name="sprang-staged"),
    "levy-staged": partial(angles, name="levy-staged"),
    "bearings, constant velocity": partial(_noise, noise=_CHANGING),
    "bearings, constant acceleration": partial(
        _noise, motion="constant-acceleration", noise=(0.03, 1.0, 0.03)
    ),
    "arrivals, constant velocity": partial(
        _noise, measured="arrivals", events=100, noise=_CHANGING
    ),
    "arrivals, ballistic": partial(
        _noise, motion="ballistic", measured="arrivals", events=100, noise=_CHANGING
    ),
}
"""Worlds whose dynamics change in stages."""

STEADY: dict[str, Callable[[int], StagedFlight]] = {
    "bearings, constant velocity": partial(_noise, noise=(3.0,)),
    "bearings, constant acceleration": partial(
        _noise, motion="constant-acceleration", noise=(0.3,)
    ),
    "arrivals, constant velocity": partial(_noise, measured="arrivals", events=100, noise=(3.0,)),
    "arrivals, ballistic": partial(
        _noise, motion="ballistic", measured="arrivals", events=100, noise=(3.0,)
    ),
    "low orbit, biases and drifts": partial(_low, sensors=3, bearings=60),
}
"""Worlds whose process noise does not change: stages found in them are false."""

_SLOW = partial(_noise, events=600, slow_rad=2e-3)


def _fireball(seed: int, **changes: Any) -> StagedFlight:
    return StagedFlight(fireball(seed, Fireball(**changes)), np.zeros(0))


CORRELATED: dict[str, Callable[[int], StagedFlight]] = {
    "bearings with slow errors, quiet": partial(_SLOW, noise=(0.3,)),
    "bearings with slow errors, lively": partial(_SLOW, noise=(3.0,)),
    "bearings with slow errors, quiet, often": partial(_SLOW, noise=(0.3,), events=2400),
    "bearings with slow errors as large as the noise": partial(
        _SLOW, noise=(0.3,), slow_rad=1e-3, slow_s=10.0
    ),
    "fireball": partial(_fireball, slow=0.0),
    "fireball, slow errors": _fireball,
    "fireball, large slow errors": partial(_fireball, slow=2.0),
}
"""Steady worlds, most of whose sensors have errors that change slowly and are not told."""

TABLES = {"staged": STAGED, "steady": STEADY, "correlated": CORRELATED}


@dataclass(frozen=True, eq=False)
class Outcome:
    """What many runs of one world gave.

    Attributes
    ----------
    square_m2
        By way, shape (runs,): squared position error, mean over the truth's times.
    nees
        By way, shape (runs,): normalised squared position error in the middle of the path.
    stages
        Shape (runs,): how many were found.
    missed_s
        How far each true boundary is from the nearest that was found, over the length of the path;
        infinite where none was.
    failed
        Runs that did not converge in some way; they are not among the others.
    """

    square_m2: Mapping[str, NDArray[np.float64]]
    nees: Mapping[str, NDArray[np.float64]]
    stages: NDArray[np.int64]
    missed_s: NDArray[np.float64]
    failed: int

    def ratio(self, way: str) -> tuple[float, float]:
        """Return the root mean square error over that with the true noise, and standard error.

        Runs differ by orders of magnitude, so that it is the mean of their ratios' logarithms.
        """
        log = 0.5 * np.log(self.square_m2[way] / self.square_m2["true"])
        return float(np.exp(log.mean())), float(np.exp(log.mean()) * log.std() / np.sqrt(log.size))


def run(world: Callable[[int], StagedFlight], seeds: Iterable[int]) -> Outcome:
    """Smooth worlds in all ways.

    Parameters
    ----------
    world
        Gives a flight of a seed.
    seeds
        Of the runs.
    """
    square: dict[str, list[float]] = {way: [] for way in WAYS}
    normalised: dict[str, list[float]] = {way: [] for way in WAYS}
    stages: list[int] = []
    missed: list[float] = []
    failed = 0
    for seed in seeds:
        flight = world(seed)
        recording = flight.recording
        truth = recording.truth
        assert truth is not None
        tracks = {
            way: smooth(recording, raise_on_failure=False, **changes)
            for way, changes in WAYS.items()
        }
        if any(track.status is not Status.CONVERGED for track in tracks.values()):
            failed += 1
            continue
        middle = truth.time_s.size // 2
        for way, track in tracks.items():
            points = track.at(truth.time_s)
            error = points.position_m - truth.position_m
            square[way].append(float(np.mean(np.sum(error**2, axis=1))))
            covariance = points.position_covariance_m2[middle]
            normalised[way].append(float(nees(error[middle][None], covariance[None])[0]))
        found = np.array([entry["from_s"] for entry in tracks["stages"].summary["stages"]])[1:]
        span = recording.time_span_s[1] - recording.time_span_s[0]
        stages.append(found.size + 1)
        off = np.abs(found - flight.boundary_s[:, None]).min(axis=1, initial=np.inf)
        missed += (off / span).tolist()
    return Outcome(
        {way: np.array(values) for way, values in square.items()},
        {way: np.array(values) for way, values in normalised.items()},
        np.array(stages),
        np.array(missed),
        failed,
    )


_HEADER = (
    "| world | runs | RMS m, true noise | auto / true | stages / true | ANEES true | auto | stages "
    "| cut into stages % | boundaries within 5 % of the path |\n"
    "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |"
)


def row(name: str, outcome: Outcome) -> str:
    """Return a line of a table, as Markdown."""
    runs = outcome.stages.size
    ratios = [outcome.ratio(way) for way in ("auto", "stages")]
    near = 100.0 * np.mean(outcome.missed_s < 0.05) if outcome.missed_s.size else np.nan
    cells = [
        name,
        f"{runs}" + (f" and {outcome.failed} not converged" if outcome.failed else ""),
        f"{np.sqrt(np.median(outcome.square_m2['true'])):.3g}",
        *(f"{value:.3f}±{error:.3f}" for value, error in ratios),
        *(f"{outcome.nees[way].mean():.2f}" for way in WAYS),
        f"{100.0 * np.mean(outcome.stages > 1):.1f}",
        f"{near:.0f} %" if np.isfinite(near) else "-",
    ]
    return "| " + " | ".join(cells) + " |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; see ``--help``."""
    parser = argparse.ArgumentParser(
        prog="python -m geograph.scenarios.noise_study",
        description="Process noise found by evidence, one and in stages, against the true one.",
    )
    parser.add_argument("--runs", type=int, default=200, help="runs of each world (200)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first run (0)")
    parser.add_argument("--table", choices=(*TABLES, "all"), default="all", help="which table")
    parser.add_argument("--world", help="only worlds whose name has this in it")
    options = parser.parse_args(arguments)
    if options.runs < 2 or options.seed < 0:
        parser.error("expected --runs of at least 2 and --seed of at least 0")
    seeds = range(options.seed, options.seed + options.runs)
    for name, worlds in TABLES.items():
        if options.table not in ("all", name):
            continue
        print(f"{name}\n\n{_HEADER}", flush=True)
        for label, world in worlds.items():
            if options.world is None or options.world in label:
                print(row(label, run(world, seeds)), flush=True)
        print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
