"""Where the process noise changes: pieces of time found by their evidence.

Intervals between knots, or a few of them together, are the grain. From one stage for the whole path
on, every stage is asked for the window inside of it whose noise differs most: with the score g and
the Fisher information I of the window's log variance, freed of the rest of the stage (efficient
score), the expected gain of evidence is

    I (r - 1 - ln r),    r = 1 + g / I,

which is exact where I is half the number of squares that were seen. The best window of each stage
is then tried: its levels are set to the greatest evidence, and it stays if that rises by more than

    1/2 quantile of chi-square(1 - a / N; new levels)

with a = 1 % and the N = n (n + 1) / 2 windows among n grains (Bonferroni). Then the ends move to
where the evidence is greatest, and stages that no longer pay are taken out. A window at one end of
its stage is a single change; one inside of it is a burst, which is also what a jump of the highest
derivative looks like.

Sources: shocks from a smoother's own output after P. de Jong, J. Penzer, *Diagnosing shocks in time
series*, JASA 93, 1998; binary segmentation with windows after A. B. Olshen, E. S. Venkatraman, R.
Lucito, M. Wigler, *Circular binary segmentation for the analysis of array-based DNA copy number
data*, Biostatistics 5, 2004.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph import chi_square

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.evidence import Evidence, Scores

FALSE_ALARM = 0.01
"""Chance that a path whose noise does not change is cut into stages."""

_ROUNDS = 12
_SHIFTS = (-8, -4, -2, -1, 1, 2, 4, 8)
# Variances of a stage over that of the whole, at least and at most.
_RANGE = (np.log(1e-6), np.log(1e8))
_SMALL = 1e-2
# Steps towards the best levels: how many, how long, and the gain that is not worth another.
_STEPS = 15
_LONGEST = 3.0
_ENOUGH = 0.02
_LEAST_SHARE = 0.02
_RIDGE = 0.02
# Gain at which a window is tried, and the share of its price at which its ends are moved first.
_PROMISED = 2.0
_NEAR = 0.3
# Evidence that another round must bring.
_PROGRESS = 0.5


@dataclass(frozen=True, eq=False)
class Partition:
    """Stages made of grains.

    Attributes
    ----------
    edges
        Shape (S + 1,): first grain of each stage, and the number of grains.
    logs
        Shape (S,): log of the variance of each stage's noise over that of the motion.
    evidence
        ln p, up to a constant.
    """

    edges: NDArray[np.int64]
    logs: NDArray[np.float64]
    evidence: float

    @property
    def times(self) -> NDArray[np.float64]:
        """Multiples of the noise in every grain, shape (G,)."""
        return np.repeat(np.exp(0.5 * self.logs), np.diff(self.edges))


def threshold(grains: int, levels: int) -> float:
    """Return the rise of evidence from which on new levels of noise are believed.

    Parameters
    ----------
    grains
        Pieces of the path that could have noise of their own.
    levels
        New ones, 1 or 2.
    """
    windows = max(grains * (grains + 1) // 2, 1)
    return 0.5 * float(chi_square.exceeded(FALSE_ALARM / windows, np.array([levels]))[0])


def find_partition(evidence: Evidence, start: Partition | None = None) -> Partition:
    """Return the stages of greatest evidence, as far as each pays for itself.

    Parameters
    ----------
    evidence
        About the present estimate.
    start
        Where to begin; None: one stage.
    """
    count = evidence.grains
    if start is None:
        start = Partition(np.array([0, count]), np.zeros(1), -np.inf)
    best = levelled(evidence, start)
    for _ in range(_ROUNDS):
        scores = evidence.scores(best.times, information=True)
        found = _with_windows(evidence, best, scores)
        if found is None:
            break
        found = _moved(evidence, levelled(evidence, found))
        found = pruned(evidence, levelled(evidence, found))
        if _worth(evidence, found) < _worth(evidence, best) + _PROGRESS:
            break
        best = found
    return best


def _worth(evidence: Evidence, partition: Partition) -> float:
    """Return the evidence less what its changes of noise cost."""
    return partition.evidence - (partition.logs.size - 1) * threshold(evidence.grains, 1)


def levelled(
    evidence: Evidence, partition: Partition, stages: NDArray[np.int64] | None = None
) -> Partition:
    """Return a partition with the levels of greatest evidence.

    Parameters
    ----------
    evidence
        About the present estimate.
    partition
        With the levels to begin from.
    stages
        Those whose levels may change; None: all.
    """
    free = np.arange(partition.logs.size) if stages is None else stages
    edges, logs = partition.edges, partition.logs.copy()
    length = np.diff(edges)

    def at(level: NDArray[np.float64]) -> Scores:
        trial = logs.copy()
        trial[free] = level
        return evidence.scores(np.repeat(np.exp(0.5 * trial), length), information=True)

    level = np.clip(logs[free], *_RANGE)
    present = at(level)
    for _ in range(_STEPS):
        step = _scoring_step(present, edges, free, level)
        if float(np.abs(step[1]).sum()) < _ENOUGH:
            break
        share = 1.0
        while share > _LEAST_SHARE:
            trial = np.clip(level + share * step[0], *_RANGE)
            found = at(trial)
            if found.evidence > present.evidence:
                break
            share *= 0.4
        else:
            break
        level, present = trial, found
    logs[free] = level
    return Partition(edges, logs, present.evidence)


def _scoring_step(
    scores: Scores,
    edges: NDArray[np.int64],
    free: NDArray[np.int64],
    level: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a step of Fisher's scoring in the levels, and the gain it promises for each."""
    assert scores.information is not None
    slope = np.add.reduceat(scores.score, edges[:-1])[free]
    rows = np.add.reduceat(scores.information, edges[:-1], axis=0)
    known = np.add.reduceat(rows, edges[:-1], axis=1)[np.ix_(free, free)]
    # A level at its limit stays there, and what is hardly seen does not run away.
    held = ((level <= _RANGE[0]) & (slope < 0.0)) | ((level >= _RANGE[1]) & (slope > 0.0))
    slope = np.where(held, 0.0, slope)
    step = np.asarray(np.linalg.solve(known + _RIDGE * np.eye(free.size), slope))
    step = step * min(1.0, _LONGEST / max(float(np.abs(step).max()), 1e-300))
    return step, slope * step


def _with_windows(evidence: Evidence, present: Partition, scores: Scores) -> Partition | None:
    """Return the partition with every window cut out that pays; None if there is none."""
    edges, logs = present.edges.tolist(), present.logs.tolist()
    # From the last to the first, so that indices of those before stay what they are.
    for stage in range(present.logs.size - 1, -1, -1):
        cut = _cut(evidence, present, scores, stage)
        if cut is not None:
            parts = cut.logs.size - present.logs.size + 1
            edges[stage + 1 : stage + 1] = cut.edges[stage + 1 : stage + parts].tolist()
            logs[stage : stage + 1] = cut.logs[stage : stage + parts].tolist()
    if len(logs) == present.logs.size:
        return None
    return Partition(np.array(edges, dtype=np.int64), np.array(logs), -np.inf)


def _cut(evidence: Evidence, present: Partition, scores: Scores, stage: int) -> Partition | None:
    """Return the partition with the best window of one stage cut out, if it pays."""
    first, last = present.edges[stage : stage + 2].tolist()
    best, most = None, -np.inf
    for low, high, ratio in _windows(scores, first, last):
        starts = [at for at in (first, low, high) if at < last]
        starts = sorted(set(starts))
        changes = [np.log(ratio) if at == low else 0.0 for at in starts]
        tried = Partition(
            np.insert(present.edges, stage + 1, starts[1:]).astype(np.int64),
            np.concatenate(
                [
                    present.logs[:stage],
                    present.logs[stage] + np.array(changes),
                    present.logs[stage + 1 :],
                ]
            ),
            -np.inf,
        )
        own = stage + np.arange(len(starts))
        tried = levelled(evidence, tried, own)
        limit = threshold(evidence.grains, len(starts) - 1)
        if present.evidence + _NEAR * limit < tried.evidence < present.evidence + limit:
            tried = levelled(evidence, _moved(evidence, tried, own[1:]), own)
        gain = tried.evidence - present.evidence - limit
        if gain > max(most, 0.0):
            best, most = tried, gain
    return best


def _windows(scores: Scores, first: int, last: int) -> list[tuple[int, int, float]]:
    """Return windows of a stage, and the ratios of their variances, that promise most.

    One is the best of those at the stage's beginning, one at its end, and of those inside of it one
    with more and one with less noise: what is promised is a guide, and the evidence decides.
    """
    size = last - first
    if size < 2:
        return []
    assert scores.information is not None
    part = scores.information[first:last, first:last]
    sums = np.zeros((size + 1, size + 1))
    sums[1:, 1:] = part.cumsum(axis=0).cumsum(axis=1)
    slope = np.concatenate([[0.0], np.cumsum(scores.score[first:last])])
    own = np.diagonal(sums)
    inside = own[None, :] - 2.0 * sums + own[:, None]
    across = sums[:, -1][None, :] - sums[:, -1][:, None]
    total = max(float(sums[-1, -1]), 1e-300)
    information = np.maximum(inside - across**2 / total, 0.0)
    score = slope[None, :] - slope[:, None] - across / total * slope[-1]
    ratio = np.maximum(1.0 + score / np.maximum(information, 1e-300), _SMALL)
    gain = information * (ratio - 1.0 - np.log(ratio))
    index = np.arange(size + 1)
    gain[index[:, None] >= index[None, :]] = 0.0
    begins, ends = np.zeros_like(gain, dtype=bool), np.zeros_like(gain, dtype=bool)
    begins[0], ends[:, -1] = True, True
    within = ~begins & ~ends
    found = []
    for group in (begins & ~ends, ends & ~begins, within & (ratio > 1.0), within & (ratio < 1.0)):
        promised = np.where(group, gain, 0.0)
        low, high = np.unravel_index(int(np.argmax(promised)), gain.shape)
        if promised[low, high] > _PROMISED:
            place = first + int(low), first + int(high)
            found.append((*place, float(min(ratio[low, high], 1.0 / _SMALL**3))))
    return found


def _moved(
    evidence: Evidence, partition: Partition, which: NDArray[np.int64] | None = None
) -> Partition:
    """Return the partition with inner edges, or some of them, moved to the greatest evidence."""
    edges = partition.edges.copy()
    times = np.exp(0.5 * partition.logs)
    best = partition.evidence
    for index in np.arange(1, edges.size - 1) if which is None else which:
        for _ in range(_ROUNDS):
            here, tried = int(edges[index]), edges.copy()
            found = []
            for shift in _SHIFTS:
                if edges[index - 1] < here + shift < edges[index + 1]:
                    tried[index] = here + shift
                    found.append((evidence.of(np.repeat(times, np.diff(tried))), here + shift))
            if not found or max(found)[0] <= best:
                break
            best, edges[index] = max(found)
    return Partition(edges, partition.logs, best)


def pruned(evidence: Evidence, partition: Partition) -> Partition:
    """Return the partition without the stages that do not pay."""
    while partition.logs.size > 1:
        tried = []
        for stage in range(partition.logs.size):
            for width in (2, 3):
                if stage + width > partition.logs.size:
                    continue
                merged = _merged(partition, stage, width)
                # With one level in place of several: those of the neighbours stand.
                found = levelled(evidence, merged, np.array([stage]))
                spare = partition.evidence - threshold(evidence.grains, width - 1)
                tried.append((found.evidence - spare, found))
        gain, found = max(tried, key=lambda pair: pair[0])
        if gain < 0.0:
            break
        partition = levelled(evidence, found)
    return partition


def _merged(partition: Partition, stage: int, width: int) -> Partition:
    own = slice(stage, stage + width)
    length = np.diff(partition.edges)[own]
    level = float(np.log(length @ np.exp(partition.logs[own]) / length.sum()))
    logs = np.concatenate([partition.logs[:stage], [level], partition.logs[stage + width :]])
    edges = np.delete(partition.edges, np.arange(stage + 1, stage + width))
    return Partition(edges, logs, -np.inf)
