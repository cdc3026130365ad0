"""Calibrations at unknown times: how soon and how surely they are found, and what it is worth.

``python -m geograph.scenarios.resets_study --runs 100`` prints docs/accuracy.md's tables. All
recordings are those of the worlds of Levy et al. with calibrations, of which the recording tells
neither when nor how many there were. Jumps are in sigmas: the root of the sum of the squares of
azimuth's and elevation's jump, over the white noise of one angle.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import betaincinv

from geograph.consistency import nees
from geograph.scenarios.angles_worlds import angles_trial, variant
from geograph.smoother import smooth

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from geograph.recording import Recording
    from geograph.scenarios.angles_worlds import AnglesWorld
    from geograph.scenarios.worlds import World
    from geograph.track import Track

JUMPS = (1.0, 2.0, 3.0, 4.0, 6.0, 10.0, 30.0)
"""Sizes of jumps, in sigmas."""

NEAR = 20
"""A reset found further than this many measurements from a true one is a false alarm."""

_NAMES = ("levy-simple", "levy-staged")


@dataclass(frozen=True)
class Found:
    """What became of true resets.

    Attributes
    ----------
    delay
        Of each that was found, by how many measurements of its sensor too early (below 0) or late.
    missed
        How many were not.
    false
        How many were found that are none.
    """

    delay: tuple[int, ...]
    missed: int
    false: int


def compare(
    time_s: NDArray[np.float64], true_s: NDArray[np.float64], found_s: Sequence[float]
) -> Found:
    """Hold one sensor's resets against the true ones, each at most once, the nearest pair first.

    Parameters
    ----------
    time_s
        Shape (n,), increasing: when it measured.
    true_s, found_s
        Times of its resets. True ones between the same two measurements are one, and those before
        the first or after the last measurement none.
    """
    true = np.unique(np.searchsorted(time_s, true_s))
    true = true[(true > 0) & (true < time_s.size)]
    found = np.searchsorted(time_s, np.asarray(found_s, dtype=np.float64))
    gap = (found[None, :] - true[:, None]).astype(np.float64)
    delay = []
    while gap.size and np.nanmin(np.abs(gap), initial=np.inf) <= NEAR:
        i, j = np.unravel_index(int(np.nanargmin(np.abs(gap))), gap.shape)
        delay.append(int(gap[i, j]))
        gap[i, :] = gap[:, j] = np.nan
        if np.isnan(gap).all():
            break
    return Found(tuple(delay), true.size - len(delay), found.size - len(delay))


def found_resets(trial: World, track: Track) -> Found:
    """Return what became of the resets of a trial, of all its sensors together."""
    truth, missed, false = trial.sensor_truth, 0, 0
    delay: list[int] = []
    for index, name in enumerate(truth.names):
        found = [entry["time_s"] for entry in track.summary["resets"] if entry["sensor"] == name]
        time = truth.time_s[truth.sensor == index]
        one = compare(time, truth.calibration_s[index], found)
        delay += one.delay
        missed, false = missed + one.missed, false + one.false
    return Found(tuple(delay), missed, false)


def with_times(trial: World, times: Callable[[NDArray[np.float64]], Any]) -> Recording:
    """Return a trial's recording that says something else of its calibrations.

    Parameters
    ----------
    trial
        With sensors that are calibrated.
    times
        Gives ``calibrations_s`` from the true times.
    """
    recording, truth = trial.recording, trial.sensor_truth
    sensors = {
        name: replace(recording.sensors[name], calibrations_s=times(calibration_s))
        for name, calibration_s in zip(truth.names, truth.calibration_s, strict=True)
    }
    return replace(recording, sensors=sensors)


def known(calibration_s: NDArray[np.float64]) -> tuple[float, ...]:
    """Return the true times themselves."""
    return tuple(calibration_s.tolist())


def _world(name: str, **changes: Any) -> AnglesWorld:
    return variant(f"{name}-calibrated", **changes)


def detection_table(name: str, seeds: range) -> str:
    """Return how surely and how soon jumps of some sizes are found, one of each of 4 sensors.

    Parameters
    ----------
    name
        Of a world of Levy et al.
    seeds
        One trial each.
    """
    lines = [
        "| jump, sigmas | resets | found % | delay, mean of its size | within 2 % | exact % "
        "| false alarms a recording |",
        "| --- " * 7 + "|",
    ]
    for jump in JUMPS:
        world = _world(name, calibrations=(1, 1), sensors=(4, 4), bearings=(200, 200))
        world = replace(world, jump_rad=jump * world.sigma_rad)
        trials = (angles_trial(seed, world) for seed in seeds)
        found = [
            found_resets(trial, smooth(trial.recording, raise_on_failure=False)) for trial in trials
        ]
        delay = np.abs(np.array([gap for one in found for gap in one.delay]))
        missed, false = sum(one.missed for one in found), sum(one.false for one in found)
        cells = [f"{jump:g}", f"{delay.size + missed}"]
        cells.append(f"{100.0 * delay.size / max(delay.size + missed, 1):.1f}")
        shares = [100.0 * float(np.mean(delay <= most)) for most in (2, 0)] if delay.size else []
        cells += [f"{delay.mean():.2f}", *(f"{x:.1f}" for x in shares)] if shares else ["-"] * 3
        lines.append("| " + " | ".join([*cells, f"{false / len(found):.3f}"]) + " |")
    return "\n".join(lines)


def false_alarm_row(name: str, seeds: range) -> str:
    """Return how many recordings without a calibration show one, as a row of Markdown."""
    shown = 0
    for seed in seeds:
        trial = angles_trial(seed, _world(name, calibrations=(0, 0)))
        track = smooth(trial.recording, raise_on_failure=False)
        shown += bool(track.summary["resets"])
    # C. J. Clopper, E. S. Pearson, Biometrika 26, 1934.
    most = 1.0 if shown == len(seeds) else betaincinv(shown + 1, len(seeds) - shown, 0.95)
    return f"| {name} | {len(seeds)} | {shown} | {100 * most:.2f} |"


@dataclass(frozen=True, eq=False)
class _Errors:
    """Squared errors and NEES of some tracks of the same trials, means over the truth's times."""

    square: list[float]
    variance: list[float]
    nees: list[float]
    converged: list[bool]

    def add(self, trial: World, track: Track) -> None:
        truth = trial.recording.truth
        assert truth is not None
        inside = (truth.time_s >= track.time_s[0]) & (truth.time_s <= track.time_s[-1])
        points = track.at(truth.time_s[inside])
        error = points.position_m - truth.position_m[inside]
        self.square.append(float(np.mean(np.sum(error**2, axis=1))))
        trace = np.trace(points.position_covariance_m2, axis1=1, axis2=2)
        self.variance.append(float(np.mean(trace)))
        self.nees.append(float(np.mean(nees(error, points.position_covariance_m2))))
        self.converged.append(str(track.status) == "converged")


def accuracy_table(name: str, seeds: range, **changes: Any) -> str:
    """Return errors with known times, with those that are found, and without any.

    The bound is the covariance with known times. Ratios are medians over trials of the root mean
    square to the bound of the same trial, and roots of the ratio of the means.

    Parameters
    ----------
    name
        Of a world of Levy et al.
    seeds
        One trial each.
    **changes
        Of the world.
    """
    ways: dict[str, Callable[[NDArray[np.float64]], Any]] = {
        "times known": known,
        "found": lambda _: "auto",
        "not handled": lambda _: (),
    }
    errors = {way: _Errors([], [], [], []) for way in ways}
    for seed in seeds:
        trial = angles_trial(seed, _world(name, **changes))
        for way, times in ways.items():
            errors[way].add(trial, smooth(with_times(trial, times), raise_on_failure=False))
    bound = np.array(errors["times known"].variance)
    lines = [
        "| calibrations | converged % | RMSE m | RMSE / bound | median | ANEES |",
        "| --- " * 6 + "|",
    ]
    for way, got in errors.items():
        square = np.array(got.square)
        lines.append(
            f"| {way} | {100 * np.mean(got.converged):.1f} | {np.sqrt(square.mean()):.1f} "
            f"| {np.sqrt(square.mean() / bound.mean()):.3f} "
            f"| {np.median(np.sqrt(square / bound)):.3f} | {np.mean(got.nees):.2f} |"
        )
    return "\n".join(lines)


def _detection(seeds: range, worlds: Sequence[str]) -> Iterator[str]:
    for name in worlds:
        yield f"{name}, {len(seeds)} trials a row:\n\n{detection_table(name, seeds)}"


def _false_alarms(seeds: range, worlds: Sequence[str]) -> Iterator[str]:
    head = "| world | recordings | with a reset | at most, % (95 %) |\n" + "| --- " * 4 + "|"
    yield "\n".join([head, *(false_alarm_row(name, seeds) for name in worlds)])


def _accuracy(seeds: range, worlds: Sequence[str]) -> Iterator[str]:
    for name in worlds:
        for what, changes in (
            ("errors drawn again", {}),
            ("jumps of 10 sigmas", {"jump_rad": 50e-6}),
            ("jumps of 3 sigmas", {"jump_rad": 15e-6}),
        ):
            table = accuracy_table(name, seeds, **changes)
            yield f"{name}, {what}, {len(seeds)} trials:\n\n{table}"


TABLES: dict[str, Callable[[range, Sequence[str]], Iterator[str]]] = {
    "detection": _detection,
    "false-alarms": _false_alarms,
    "accuracy": _accuracy,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; see ``--help``."""
    parser = argparse.ArgumentParser(
        prog="python -m geograph.scenarios.resets_study",
        description="Calibrations at unknown times, in the worlds of Levy et al.",
    )
    parser.add_argument("--runs", type=int, default=100, help="trials of each row (100)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first trial (0)")
    parser.add_argument("--table", choices=(*TABLES, "all"), default="all", help="which")
    parser.add_argument("--worlds", nargs="+", choices=_NAMES, default=_NAMES, help="of which kind")
    options = parser.parse_args(arguments)
    if options.runs < 1 or options.seed < 0:
        parser.error("expected --runs of at least 1 and --seed of at least 0")
    seeds = range(options.seed, options.seed + options.runs)
    chosen = TABLES if options.table == "all" else {options.table: TABLES[options.table]}
    for tables in chosen.values():
        for table in tables(seeds, options.worlds):
            print(f"{table}\n", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
