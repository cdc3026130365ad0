"""Monte Carlo of the smoother on mixed recordings, beside their Cramer-Rao bounds.

``python -m geograph.scenarios.mixed_study --runs 300 --seed 0`` prints docs/accuracy.md's tables:
what frequency differences add to the study's moving emitters, what bearings, time and frequency
differences reach together, and every error of a sensor or of the medium by itself.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.bounds import cramer_rao_bound
from geograph.consistency import mean_band, nees
from geograph.families import Values
from geograph.scenarios.radio_aircraft import Multilateration, multilateration_world
from geograph.scenarios.radio_indoor import Indoor, indoor_world
from geograph.scenarios.radio_mixed import Mixed, mixed_world
from geograph.scenarios.radio_orbit import Formation, formation_world
from geograph.scenarios.radio_platforms import Platforms, platforms_world
from geograph.scenarios.sound import Microphones, microphones_world
from geograph.smoother import smooth
from geograph.solver import Status

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from geograph.scenarios.paths import Body
    from geograph.scenarios.radio import RadioWorld
    from geograph.track import Track


@dataclass(frozen=True)
class Case:
    """A kind of world.

    Parameters
    ----------
    world
        Gives a world for a seed.
    flat
        Whether its object is held in a plane: only x and y are scored.
    """

    world: Callable[[int], RadioWorld]
    flat: bool = False


@dataclass(frozen=True, eq=False)
class Outcome:
    """What many worlds of one kind gave; each of shape (runs,), over those that converged.

    Attributes
    ----------
    square_m2, bound_m2
        Squared position error and its bound, means over the knots of a run.
    square_m2_s2, bound_m2_s2
        The same of the velocity; zero where there is none.
    nees
        Normalised squared position error in the middle of a run.
    axes
        Number of axes that are scored, 2 or 3.
    other
        Runs that did not converge, by their status.
    """

    square_m2: NDArray[np.float64]
    bound_m2: NDArray[np.float64]
    square_m2_s2: NDArray[np.float64]
    bound_m2_s2: NDArray[np.float64]
    nees: NDArray[np.float64]
    axes: int
    other: Mapping[str, int]

    @property
    def ratio(self) -> float:
        """Root mean square position error over its bound."""
        return float(np.sqrt(self.square_m2.mean() / self.bound_m2.mean()))

    @property
    def velocity_ratio(self) -> float:
        """Root mean square velocity error over its bound; NaN without a velocity."""
        bound = self.bound_m2_s2.mean()
        return float(np.sqrt(self.square_m2_s2.mean() / bound)) if bound > 0.0 else np.nan

    @property
    def standard_error(self) -> float:
        """Standard error of the position's ratio, from the spread of the squares."""
        spread = self.square_m2.std() / self.square_m2.mean() / np.sqrt(self.nees.size)
        return float(0.5 * self.ratio * spread)

    @property
    def anees(self) -> float:
        """Mean of the normalised squared errors over the number of axes; 1 for honest sigmas."""
        return float(self.nees.mean() / self.axes)

    def band(self, alarm: float = 0.01) -> tuple[float, float]:
        """Return where :attr:`anees` is but for a given rate of false alarms."""
        low, high = mean_band(self.nees.size, self.axes, alarm=alarm)
        return low / self.axes, high / self.axes


def run(case: Case, seeds: Iterable[int]) -> Outcome:
    """Smooth one world for each seed and score it against its truth and its bound.

    Parameters
    ----------
    case
        What is simulated.
    seeds
        Whole numbers of at least 0.

    Raises
    ------
    ValueError
        If no run converged.
    """
    rows: list[tuple[float, ...]] = []
    other: dict[str, int] = {}
    for seed in seeds:
        world = case.world(seed)
        track = smooth(world.recording, raise_on_failure=False)
        if track.status is Status.CONVERGED:
            rows.append(_score(track, world, flat=case.flat))
        else:
            other[str(track.status)] = other.get(str(track.status), 0) + 1
    if not rows:
        raise ValueError(f"no run converged: {other}; nothing to score")
    square, bound, fast, fast_bound, nees = np.array(rows).T
    axes = 2 if case.flat else 3
    return Outcome(square, bound, fast, fast_bound, nees, axes, other)


def _score(track: Track, world: RadioWorld, *, flat: bool) -> tuple[float, ...]:
    """Return the first five columns of :class:`Outcome` of one run."""
    truth = true_state(track, world.path)
    bound = cramer_rao_bound(
        track.problem, Values(truth, track.values.walks, track.values.constants)
    ).covariance
    error = track.state - truth
    axes = 2 if flat else 3
    place = slice(0, axes)
    middle = track.time_s.size // 2
    covariance = track.covariance[middle, place, place]
    speed = slice(3, 3 + axes)
    return (
        float(np.sum(error[:, place] ** 2, axis=1).mean()),
        float(np.trace(bound[:, place, place], axis1=1, axis2=2).mean()),
        float(np.sum(error[:, speed] ** 2, axis=1).mean()),
        float(np.trace(bound[:, speed, speed], axis1=1, axis2=2).mean()),
        float(nees(error[middle : middle + 1, place], covariance[None])[0]),
    )


def true_state(track: Track, path: Body) -> NDArray[np.float64]:
    """Return a path's states at a track's knots, shape (K, 3m), SI units."""
    time = track.time_s
    columns = [path.position_at(time)]
    if track.order > 1:
        columns.append(path.velocity_at(time))
    if track.order > 2:
        step = 1e-2
        change = path.velocity_at(time + step) - path.velocity_at(time - step)
        columns.append(change / (2.0 * step))
    return np.concatenate(columns, axis=1)


def _platforms(seed: int, **options: Any) -> RadioWorld:
    return platforms_world(seed, Platforms(**options))


def _mixed(seed: int, **options: Any) -> RadioWorld:
    return mixed_world(seed, Mixed(**options))


def _microphones(seed: int, **options: Any) -> RadioWorld:
    return microphones_world(seed, Microphones(**options))


def _aircraft(seed: int, **options: Any) -> RadioWorld:
    return multilateration_world(seed, Multilateration(**options))


def _indoor(seed: int, **options: Any) -> RadioWorld:
    return indoor_world(seed, Indoor(**options))


def _formation(seed: int, **options: Any) -> RadioWorld:
    return formation_world(seed, Formation(**options))


_EMITTERS_M = {1: (9e3, 100e3), 2: (65e3, 80e3)}
_FLIGHT: dict[str, Any] = {"process_noise": 0.01, "carrier_hz": 10e9}

VELOCITY: dict[str, Case] = {
    f"emitter {number}, {speed} m/s, {'times' if sigma is None else f'and {sigma:g} Hz'}": Case(
        partial(
            _platforms, emitter_m=place, emitter_m_s=(float(speed), 0.0), sigma_hz=sigma, **_FLIGHT
        ),
        flat=True,
    )
    for number, place in _EMITTERS_M.items()
    for speed in (30, 60)
    for sigma in (None, 0.05)
}
"""The study's moving emitters with and without frequency differences."""

_KINDS: dict[str, tuple[str, ...]] = {
    "bearings": ("bearings",),
    "all three": ("bearings", "time", "frequency"),
}

MIXED: dict[str, Case] = {
    f"{target}: {name}": Case(partial(_mixed, target=target, kinds=kinds))
    for target in ("drone", "ship")
    for name, kinds in _KINDS.items()
} | {
    "platforms, clocks and frequencies wrong": Case(
        partial(
            _platforms, emitter_m_s=(60.0, 0.0), sigma_hz=0.05, clock_offset_s=1e-9,
            frequency_offset_hz=0.5, **_FLIGHT,
        ),
        flat=True,
    ),
    "formation over a ship, all wrong": Case(
        partial(
            _formation, emitter="ship", satellites=3, clock_offset_s=100e-9,
            frequency_offset_hz=1.0,
        )
    ),
}  # fmt: skip
"""Bearings, time and frequency differences, alone and together, with errors of every sensor."""

ERRORS: dict[str, Case] = {
    "aircraft: clock offsets": Case(_aircraft),
    "aircraft: offsets, drifts": Case(partial(_aircraft, clock_drift_s_s=5e-9)),
    "aircraft: offsets, drifts, walks": Case(
        partial(_aircraft, clock_drift_s_s=2e-9, clock_instability_s_sqrt_s=20e-9)
    ),
    "aircraft: positions off by 30 m": Case(partial(_aircraft, position_m=30.0)),
    "indoor: offsets, drifts, walks": Case(
        partial(_indoor, clock_drift_s_s=0.2e-9, clock_instability_s_sqrt_s=0.2e-9)
    ),
    "indoor: positions off by 0.1 m": Case(partial(_indoor, position_m=0.1)),
    "platforms: positions off by 20 m": Case(partial(_platforms, position_m=20.0), flat=True),
    "platforms: white position noise 0.75 m": Case(
        partial(_platforms, position_noise_m=0.75), flat=True
    ),
    "platforms: straight, fixes 0.75 m": Case(
        partial(_platforms, position_noise_m=0.75, platform_process_noise=0.0), flat=True
    ),
    "platforms: paths estimated, fixes 0.75 m": Case(
        partial(_platforms, position_noise_m=0.75, platform_process_noise=0.05), flat=True
    ),
    "microphones: clocks off and drifting": Case(
        partial(_microphones, clock_offset_s=5e-3, clock_drift_s_s=5e-4)
    ),
    "microphones: clocks off by seconds": Case(
        partial(_microphones, clock_offset_s=2.0, clock_drift_s_s=1e-3)
    ),
    "microphones: positions off by 0.3 m": Case(partial(_microphones, position_m=0.3)),
    "microphones: speed of sound": Case(partial(_microphones, propagation_sigma_m_s=5.0)),
    "microphones: all, and a tone": Case(
        partial(
            _microphones, propagation_sigma_m_s=5.0, clock_offset_s=5e-3, position_m=0.3,
            tone_hz=1000.0, frequency_offset_hz=0.5,
        )
    ),
}  # fmt: skip
"""Errors of the sensors and of the medium, by themselves."""

TABLES: dict[str, dict[str, Case]] = {"velocity": VELOCITY, "mixed": MIXED, "errors": ERRORS}

_HEADER = (
    "| case | bound m | ratio | bound m/s | ratio | ANEES | 99 % band | not converged |\n"
    "| --- | --- | --- | --- | --- | --- | --- | --- |"
)


def row(name: str, outcome: Outcome) -> str:
    """Return a line of a table, as Markdown."""
    low, high = outcome.band()
    velocity = np.sqrt(outcome.bound_m2_s2.mean())
    cells = [
        name,
        f"{np.sqrt(outcome.bound_m2.mean()):.3g}",
        f"{outcome.ratio:.3f}±{outcome.standard_error:.3f}",
        f"{velocity:.3g}" if velocity else "-",
        f"{outcome.velocity_ratio:.3f}" if velocity else "-",
        f"{outcome.anees:.3f}",
        f"{low:.3f} to {high:.3f}",
        ", ".join(f"{count} {status}" for status, count in outcome.other.items()) or "0",
    ]
    return "| " + " | ".join(cells) + " |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; see ``--help``."""
    parser = argparse.ArgumentParser(
        prog="python -m geograph.scenarios.mixed_study",
        description="Root mean square errors over Cramer-Rao bounds, and ANEES per axis.",
    )
    parser.add_argument("--runs", type=int, default=300, help="runs of each case (300)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first run (0)")
    parser.add_argument("--table", choices=(*TABLES, "all"), default="all", help="which table")
    options = parser.parse_args(arguments)
    if options.runs < 2 or options.seed < 0:
        parser.error("expected --runs of at least 2 and --seed of at least 0")
    seeds = range(options.seed, options.seed + options.runs)
    for name, cases in TABLES.items():
        if options.table not in ("all", name):
            continue
        print(_HEADER, flush=True)
        for label, case in cases.items():
            print(row(label, run(case, seeds)), flush=True)
        print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
