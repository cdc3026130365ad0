"""Resets at unknown times: found one after another, placed again, and kept where they pay.

The sensors whose ``calibrations_s`` are ``"auto"`` are scanned for jumps of their errors
(:mod:`geograph.reset_scan`). The most significant ones become resets, everything is solved again,
and so on until none is significant. Then each is taken out in turn, and put back where it is most
significant without it, or left out. A jump is significant where chance would show one as great in
less than :data:`FALSE_ALARM` of all recordings without any, wherever and in whichever sensor
(Bonferroni's bound over all of them). It also has to raise the evidence (Laplace's approximation),
in which the prior of the errors counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from geograph import chi_square
from geograph.families import BearingFamily, Values
from geograph.problem import Problem
from geograph.reset_scan import LEAST, Jump, Scanner
from geograph.solver import Solution, Status
from geograph.states import AZIMUTH, ELEVATION

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.prepare import Prepared
    from geograph.reset_scan import SensorRows
    from geograph.smoother import Smoother
    from geograph.states import SensorStates

FALSE_ALARM = 0.005
"""Chance that a recording without resets shows one."""

_POINTING = (AZIMUTH, ELEVATION)
_ROUNDS = 100
_PASSES = 3

# Sensors whose jumps are as significant as this share of the greatest become resets together; a
# jump of one sensor leaks into the others where the geometry is poor.
_TOGETHER = 0.5

# Under a loss a jump weighs down the very measurements that tell it. There the scan proposes what
# reaches this share of its limit, and the fall of the cost, as an exact likelihood ratio, decides.
_PROPOSED = 0.3
_PROPOSALS = 3

# Neighbouring resets with at most so many measurements between them may be one.
_CLOSE = 4 * LEAST

Resets = dict[int, tuple[float, ...]]
"""Times of the resets found, by the sensor's index."""


@dataclass(frozen=True, eq=False)
class _Snapshot:
    """What a search may come back to."""

    resets: Resets
    prepared: Prepared
    problem: Problem
    solution: Solution

    @classmethod
    def of(cls, smoother: Smoother) -> _Snapshot:
        return cls(smoother.resets, smoother.prepared, smoother.problem, smoother.solution)

    def restore(self, smoother: Smoother) -> None:
        smoother.resets, smoother.prepared = self.resets, self.prepared
        smoother.problem, smoother.solution = self.problem, self.solution

    @property
    def evidence(self) -> float:
        """Log marginal likelihood, up to a constant that resets do not change."""
        elimination = self.solution.elimination
        if elimination is None or self.solution.status is not Status.CONVERGED:
            return -np.inf
        return -self.solution.cost - elimination.half_log_determinant()


@dataclass(frozen=True)
class _Proposal:
    """A jump of one sensor: the resets that it needs, T and its limit."""

    sensor: int
    time_s: tuple[float, ...]
    statistic: float
    limit: float


def searched(prepared: Prepared) -> list[int]:
    """Return the sensors whose resets are to be found, in the order of their indices."""
    sensors = prepared.recording.sensors.values()
    heard = set() if prepared.bearings is None else set(prepared.bearings.sensor.tolist())
    return [
        index
        for index, sensor in enumerate(sensors)
        if sensor.calibrations_s == "auto" and index in heard
    ]


def find_resets(smoother: Smoother) -> bool:
    """Find the resets of a solved problem, and solve with them; return whether they changed.

    Parameters
    ----------
    smoother
        Solved; with other resets afterwards, if there are any.
    """
    sensors = searched(smoother.prepared)
    if not sensors or smoother.solution.elimination is None:
        return False
    before = smoother.resets
    search = _Search(smoother, sensors)
    for _ in range(_ROUNDS):
        if not search.add():
            break
    for _ in range(_PASSES):
        if not search.place_again():
            break
    return smoother.resets != before


class _Search:
    """The steps of a search.

    Parameters
    ----------
    smoother
        As in :func:`find_resets`.
    sensors
        Those whose resets are searched.
    """

    def __init__(self, smoother: Smoother, sensors: list[int]) -> None:
        self.smoother = smoother
        self.sensors = sensors
        (self.family,) = (
            index
            for index, family in enumerate(smoother.problem.families)
            if isinstance(family, BearingFamily)
        )

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Shape (n,): time tags of all bearings."""
        return self.smoother.problem.families[self.family].time_s

    def scanner(self) -> Scanner:
        """Return the scanner of the present solution."""
        smoother = self.smoother
        # Without a loss there are no outliers, and one measurement alone may be after a jump.
        least = 1 if smoother.settings.loss == "none" else LEAST
        return Scanner(smoother.problem, smoother.solution, self.family, _POINTING, least=least)

    def limits(self, rows: SensorRows) -> tuple[float, float]:
        """Return the limits of T for jumps to the end of a stretch, and for others."""
        count, freedom = rows.measurement.size, rows.information.shape[1]
        chance = FALSE_ALARM / 2.0 / len(self.sensors)
        return (
            float(chi_square.exceeded(chance / count, freedom)),
            float(chi_square.exceeded(2.0 * chance / count**2, freedom)),
        )

    def stretches(self, sensor: int, rows: SensorRows) -> list[tuple[int, int]]:
        """Return where the stretches of a sensor's measurements begin and end."""
        resets = np.array(self.smoother.resets.get(sensor, ()))
        cuts = np.searchsorted(self.time_s[rows.measurement], resets).tolist()
        edges = [0, *cuts, rows.measurement.size]
        return list(pairwise(edges))

    def between(self, rows: SensorRows, at: int) -> float:
        """Return the time half way between a measurement and the one before."""
        time = self.time_s[rows.measurement]
        return float(0.5 * (time[at - 1] + time[at]))

    @property
    def proposed(self) -> float:
        """Share of its limit at which a jump is worth a trial."""
        return 1.0 if self.smoother.problem.loss.name == "none" else _PROPOSED

    def add(self) -> bool:
        """Make the most significant jumps resets; return whether there were any that pay."""
        scanner = self.scanner()
        found: list[_Proposal] = []
        for sensor in self.sensors:
            rows = scanner.rows_of(sensor)
            if rows is not None:
                found += self._jumps(scanner, sensor, rows)
        found.sort(key=lambda one: -one.statistic)
        sure = [one for one in found if one.statistic > one.limit]
        together = [one for one in sure if one.statistic >= _TOGETHER * sure[0].statistic]
        if len(together) > 1 and self._pays(together):
            return True
        if sure:
            return self._pays(sure[:1])
        return any(self._pays([one], fall=0.5 * one.limit) for one in found[:_PROPOSALS])

    def _pays(self, chosen: list[_Proposal], *, fall: float = -np.inf) -> bool:
        """Solve with more resets, and keep them if evidence and cost say so."""
        before = _Snapshot.of(self.smoother)
        resets = dict(before.resets)
        for one in chosen:
            resets[one.sensor] = tuple(sorted({*resets.get(one.sensor, ()), *one.time_s}))
        change(self.smoother, resets)
        now = _Snapshot.of(self.smoother)
        fell = before.solution.cost - now.solution.cost
        if now.evidence > before.evidence and fell > fall:
            return True
        before.restore(self.smoother)
        return False

    def _jumps(self, scanner: Scanner, sensor: int, rows: SensorRows) -> list[_Proposal]:
        """Return the best jump of each stretch of a sensor."""
        steps, boxes = (self.proposed * limit for limit in self.limits(rows))
        found = []
        for low, high in self.stretches(sensor, rows):
            jump = scanner.best(rows.part(low, high), steps=steps, boxes=boxes)
            if jump is not None:
                times = [self.between(rows, low + at) for at in _edges(jump, high - low)]
                limit = jump.limit / self.proposed
                found.append(_Proposal(sensor, tuple(times), jump.statistic, limit))
        return found

    def place_again(self) -> bool:
        """Take each reset out in turn, and put it where it fits best; return whether any moved."""
        moved = False
        for sensor in self.sensors:
            for times in self._close(sensor):
                moved |= self._place(sensor, times)
            for time in self.smoother.resets.get(sensor, ()):
                if time in self.smoother.resets[sensor]:
                    moved |= self._place(sensor, (time,))
        return moved

    def _close(self, sensor: int) -> list[tuple[float, ...]]:
        """Return pairs of resets so close that one between them may do as well.

        Such are left where a jump was placed wrongly while others were not known yet.
        """
        problem = self.smoother.problem
        own = np.sort(self.time_s[problem.families[self.family].sensor == sensor])  # type: ignore[attr-defined]
        pairs = list(pairwise(self.smoother.resets.get(sensor, ())))
        return [pair for pair in pairs if np.diff(np.searchsorted(own, pair))[0] <= _CLOSE]

    def _place(self, sensor: int, times: tuple[float, ...]) -> bool:
        """Put one reset in the place of some neighbouring ones, or none; return whether it pays."""
        before = _Snapshot.of(self.smoother)
        others = tuple(t for t in before.resets[sensor] if t not in times)
        change(self.smoother, before.resets | {sensor: others})
        without = _Snapshot.of(self.smoother)
        better = self._best_place(sensor, times[0])
        if better is None:
            # Not significant; a pair may have been an error that came and went again.
            least = before.evidence if len(times) > 1 else -np.inf
            if without.evidence > least:
                return True
            before.restore(self.smoother)
            return False
        if (better,) == times:
            before.restore(self.smoother)
            return False
        change(self.smoother, before.resets | {sensor: tuple(sorted((*others, better)))})
        now = _Snapshot.of(self.smoother)
        best = max((before, without, now), key=lambda one: one.evidence)
        best.restore(self.smoother)
        return best is not before

    def _best_place(self, sensor: int, time_s: float) -> float | None:
        """Return where in a stretch one more reset fits best; None: nowhere."""
        if self.smoother.solution.elimination is None:
            return None
        scanner = self.scanner()
        rows = scanner.rows_of(sensor)
        if rows is None:
            return None
        at = int(np.searchsorted(self.time_s[rows.measurement], time_s))
        low, high = next(
            (low, high) for low, high in self.stretches(sensor, rows) if low <= at <= high
        )
        part = rows.part(low, high)
        # Everywhere in the stretch, and then exactly.
        limit = self.proposed * self.limits(rows)[0]
        jump = scanner.best(part, steps=limit)
        if jump is None:
            return None
        place = scanner.exact(part, jump.first, limit)
        return self.between(rows, low + (jump.first if place is None else place[0]))


def _edges(jump: Jump, count: int) -> list[int]:
    return [at for at in (jump.first, jump.end) if 0 < at < count]


def change(smoother: Smoother, resets: Resets) -> None:
    """Solve with other resets, from the present estimate.

    Parameters
    ----------
    smoother
        Solved.
    resets
        Of the sensors that are searched.
    """
    prepared, problem, old = smoother.prepared, smoother.problem, smoother.solution.values
    sensors = tuple(
        replace(sensor, calibrations_s=resets[index]) if index in resets else sensor
        for index, sensor in enumerate(prepared.sensors)
    )
    fresh = prepared.with_sensors(sensors)
    values = Values(old.path, old.walks, carried(problem.states, fresh.states, old.constants))
    count = len(smoother.families)
    smoother.resets, smoother.prepared = resets, fresh
    smoother.problem = Problem(
        motion=problem.motion,
        knots_s=problem.knots_s,
        families=fresh.families(problem.knots_s),
        states=fresh.states,
        walk_scale=problem.walk_scale,
        prior=problem.prior,
        path_scale=problem.path_scale,
        loss=problem.loss,
        weights=[*problem.weights[:count], *(None for _ in problem.families[count:])],
        elimination=problem.elimination,
        shift=None if problem.shift is None else fresh.shift,
    )
    smoother.bring_up_to_date(values)
    smoother.solution = smoother.solved(values)


def carried(
    old: SensorStates, new: SensorStates, constants: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return constant states for other resets: of every stretch what its beginning was in.

    Parameters
    ----------
    old, new
        States of the same sensors.
    constants
        Shape (s,): scaled values of the old ones.
    """
    place = {(s.sensor, s.channel, s.drift, s.stretch): i for i, s in enumerate(old.constants)}
    result = np.zeros(new.size)
    for column, state in enumerate(new.constants):
        stretch = 0
        if state.stretch:
            begun = new.stretches.of(state.sensor, state.channel)[state.stretch - 1]
            resets = old.stretches.of(state.sensor, state.channel)
            stretch = int(np.searchsorted(resets, begun, side="right"))
        result[column] = constants[place[state.sensor, state.channel, state.drift, stretch]]
    return result
