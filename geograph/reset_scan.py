"""Where a sensor's error jumps: the generalised likelihood ratio of a jump, everywhere at once.

At the estimate let r be the whitened residuals of a sensor's measurements, in the order of time, D
their derivatives by an error of it, J those by all unknowns, and P the posterior covariance. If all
is as the model says, the residuals have the covariance I - J P J': what the estimate has taken up
is gone from them. An error that is d more in the measurements i to j - 1, and as modelled in the
others, changes twice the log likelihood, at its best d, by

    T(i, j) = g' (S + L)^-1 g,    g = sum over [i, j) of D'r,
    S = sum over [i, j) x [i, j) of D' (I - J P J') D,

L the information that the prior of the error has of d, and T is at most a chi-square variable where
there is no jump (A. S. Willsky, H. L. Jones, *A generalized likelihood ratio approach to the
detection and estimation of jumps in linear systems*, IEEE TAC 21, 1976; the covariance here is that
of the smoother, so that both sides of a jump speak). All T of a sensor come from one matrix of
covariances between its measurements, which is found in one pass back along the chain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.blocks import dense_rows

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.blocks import ColumnLayout
    from geograph.eliminate import Factorisation, Marginals
    from geograph.families import BearingFamily, Evaluation
    from geograph.problem import Problem
    from geograph.solver import Solution

LEAST = 3
"""Fewest measurements on either side of a jump where there may be outliers: nothing tells fewer
from these."""

# Groups of measurements whose covariances are held at once.
_MOST_GROUPS = 512


@dataclass(frozen=True, eq=False)
class SensorRows:
    """What one sensor measured in one stretch, in the order of time.

    Attributes
    ----------
    measurement
        Shape (n,): which measurements of the family.
    interval
        Shape (n,): the knot before each, not falling.
    rows
        Shape (n, c, width): D' (J, r), with the columns of :mod:`geograph.blocks`.
    information
        Shape (n, c, c): D'D.
    prior
        Shape (c,): L, of a jump.
    scatter
        By how much the variance of its residuals exceeds what was stated, at least 1.
    """

    measurement: NDArray[np.int64]
    interval: NDArray[np.int64]
    rows: NDArray[np.float64]
    information: NDArray[np.float64]
    prior: NDArray[np.float64]
    scatter: float

    def part(self, low: int, high: int) -> SensorRows:
        """Return the measurements from ``low`` to before ``high``."""
        own = slice(low, high)
        return SensorRows(
            self.measurement[own], self.interval[own], self.rows[own], self.information[own],
            self.prior, self.scatter,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Jump:
    """The most significant jump of a stretch.

    Attributes
    ----------
    first, end
        It lasts from this measurement of the stretch to before that one.
    statistic
        T, less what the residuals' own scatter explains.
    limit
        What it was held against.
    """

    first: int
    end: int
    statistic: float
    limit: float


class Scanner:
    """Tells jumps at one solution.

    Parameters
    ----------
    problem, solution
        Solved.
    family
        Index of the family among the problem's.
    channels
        Errors that jump together.
    least
        Fewest measurements on either side of a jump.
    """

    def __init__(
        self,
        problem: Problem,
        solution: Solution,
        family: int,
        channels: tuple[int, ...],
        *,
        least: int = LEAST,
    ) -> None:
        self.least = least
        assert solution.elimination is not None
        self.elimination = solution.elimination
        self.marginals = self.elimination.marginals()
        self.layout = problem.layout
        self._states = problem.states
        self._family: BearingFamily = problem.families[family]  # type: ignore[assignment]
        self._span = max(float(np.ptp(self._family.time_s)), 1e-9)
        found = problem.evaluate(solution.values, jacobian=True)[family]
        weight = problem.weights[family]
        root = np.ones(len(self._family)) if weight is None else np.sqrt(weight)
        _, slope = problem.loss.value_and_weight(np.sum(found.residual**2, axis=1))
        self._root = root * np.sqrt(slope)
        self._dense = dense_rows(found, problem.layout, problem.path_scale)
        self._dense *= self._root[:, None, None]
        self._interval = found.interval
        self._by_error = self._derivatives(found, channels) * self._root[:, None, None]
        self._channels = channels

    def _derivatives(self, found: Evaluation, channels: tuple[int, ...]) -> NDArray[np.float64]:
        """Return derivatives of the residuals by the errors, shape (n, r, c), zero without one."""
        terms = self._family.terms
        result = np.zeros((*found.residual.shape, len(channels)))
        for entries, by in (
            (terms.constants, found.by_constants),
            (terms.chains, found.by_walks),
        ):
            for place, channel in enumerate(channels):
                own = np.flatnonzero((entries.channel == channel) & (entries.basis != 0.0))
                result[entries.row[own], :, place] = by[own] / entries.basis[own, None]
        return result

    def rows_of(self, sensor: int) -> SensorRows | None:
        """Return what a sensor measured; None: nothing that could tell a jump."""
        family = self._family
        own = np.flatnonzero((family.sensor == sensor) & (self._root > 0.0))
        own = own[np.lexsort((family.time_s[own], self._interval[own]))]
        by_error = self._by_error[own]
        felt = [place for place in range(len(self._channels)) if by_error[:, :, place].any()]
        if own.size < 2 * self.least or not felt:
            return None
        by_error, dense = by_error[:, :, felt], self._dense[own]
        return SensorRows(
            own,
            self._interval[own],
            np.einsum("nrc,nrw->ncw", by_error, dense),
            np.einsum("nrc,nrd->ncd", by_error, by_error),
            np.array([self._prior(sensor, self._channels[place]) for place in felt]),
            _scatter(dense[:, :, -1]),
        )

    def _prior(self, sensor: int, channel: int) -> float:
        """Return the information that the priors have of a jump."""
        states = self._states
        variance = 0.0
        for state in states.constants:
            if (state.sensor, state.channel) == (sensor, channel):
                size = state.sigma * (self._span if state.drift else 1.0)
                variance = max(variance, 2.0 * size**2)
        walk = int(states.walk_column[sensor, channel])
        if walk >= 0:
            variance += states.diffusion[walk] ** 2 * self._span
        return 1.0 / variance

    def best(
        self, stretch: SensorRows, *, steps: float, boxes: float = np.inf, near: int | None = None
    ) -> Jump | None:
        """Return the jump that exceeds its limit by most; None if none does.

        Parameters
        ----------
        stretch
            Between two resets.
        steps
            Limit of T for a jump that lasts to the end of the stretch.
        boxes
            Limit of T for one that ends before.
        near
            Look at steps near this measurement alone, and at each of them.
        """
        count = stretch.measurement.size
        if count < 2 * self.least:
            return None
        starts = _groups(stretch.interval, near)
        edges = np.append(starts, count)
        g = np.add.reduceat(stretch.rows, starts, axis=0)
        information = np.add.reduceat(stretch.information, starts, axis=0)
        size = g.shape[1]
        covariance = -rows_covariance(
            g[:, :, :-1], stretch.interval[starts], self.layout, self.elimination, self.marginals
        ).reshape(starts.size, size, starts.size, size)
        own = np.arange(starts.size)
        covariance[own, :, own, :] += information
        table = np.zeros((starts.size + 1, starts.size + 1, size, size))
        table[1:, 1:] = np.moveaxis(covariance, 2, 1).cumsum(axis=0).cumsum(axis=1)
        score = np.concatenate([np.zeros((1, size)), np.cumsum(g[:, :, -1], axis=0)])
        last = starts.size
        first = np.flatnonzero((edges >= self.least) & (edges <= count - self.least))
        chosen: list[tuple[float, Jump]] = []
        for pairs, limit in (
            ((first, np.full(first.size, last)), steps),
            (_boxes(edges, near, self.least), boxes),
        ):
            if not np.isfinite(limit) or not pairs[0].size:
                continue
            value = _statistics(table, score, pairs, stretch.prior) / stretch.scatter
            best = int(np.argmax(value))
            if value[best] > limit:
                i, j = int(edges[pairs[0][best]]), int(edges[pairs[1][best]])
                found = Jump(i, j, float(value[best]), limit)
                chosen.append((found.statistic - limit, found))
        return max(chosen, key=lambda one: one[0])[1] if chosen else None

    def exact(self, stretch: SensorRows, at: int, limit: float) -> tuple[int, float] | None:
        """Return where near a measurement a step is most significant, and its T; None: nowhere."""
        found = self.best(stretch, steps=limit, near=at)
        return None if found is None else (found.first, found.statistic)


def _scatter(residual: NDArray[np.float64]) -> float:
    """Return the variance of residuals, at least 1, from differences, which hardly feel a jump."""
    step = np.diff(residual, axis=0)
    step = step[(residual[1:] != 0.0) & (residual[:-1] != 0.0)]
    # The median of the square of a normal variable is 0.4549 of its variance.
    return max(1.0, float(np.median(step**2)) / (2.0 * 0.4549)) if step.size > 20 else 1.0


def _groups(interval: NDArray[np.int64], near: int | None) -> NDArray[np.int64]:
    """Return the first measurement of each group; a group lies between two knots."""
    count = interval.size
    size = max(1, -(-count // _MOST_GROUPS))
    cut = np.arange(count) % size == 0
    if near is not None:
        cut[max(near - 2 * size - LEAST, 0) : near + 2 * size + LEAST + 1] = True
    return np.flatnonzero(cut | (np.diff(interval, prepend=-1) != 0))


def _boxes(
    edges: NDArray[np.int64], near: int | None, least: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return groups at which jumps begin and end that end before the stretch does."""
    if near is not None:
        none = np.empty(0, dtype=np.int64)
        return none, none
    first, end = np.triu_indices(edges.size, 1)
    enough = (edges[end] - edges[first] >= least) & (edges[first] >= least)
    enough &= edges[end] <= edges[-1] - least
    return first[enough], end[enough]


def _statistics(
    table: NDArray[np.float64],
    score: NDArray[np.float64],
    pairs: tuple[NDArray[np.int64], NDArray[np.int64]],
    prior: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return T of jumps over groups, from cumulative sums, shape (m,)."""
    first, end = pairs
    own = table[end, end] - table[first, end] - table[end, first] + table[first, first]
    own = 0.5 * (own + np.swapaxes(own, 1, 2)) + np.diag(prior)
    g = score[end] - score[first]
    if g.shape[1] == 1:
        return np.asarray(g[:, 0] ** 2 / own[:, 0, 0])
    (a, b), (_, c) = np.moveaxis(own, 0, 2)
    x, y = g.T
    return np.asarray((c * x**2 - 2.0 * b * x * y + a * y**2) / (a * c - b**2))


def rows_covariance(
    rows: NDArray[np.float64],
    interval: NDArray[np.int64],
    layout: ColumnLayout,
    elimination: Factorisation,
    marginals: Marginals,
) -> NDArray[np.float64]:
    """Return the posterior covariance of linear functions of the unknowns, shape (n c, n c).

    With x[k] = back (x[k+1], constants) + noise that nothing later feels, the covariance of x[k]
    with all functions of later knots follows from that of x[k+1].

    Parameters
    ----------
    rows
        Shape (n, c, 2d + s): by the knots before and after and the constants, scaled.
    interval
        Shape (n,): the knot before, not falling.
    layout
        Columns of the rows.
    elimination, marginals
        Of the solved system.
    """
    count, channels, width = rows.shape
    d, s = layout.knot, layout.constants
    flat = rows.reshape(count * channels, width)
    first, rest = flat[:, :d], flat[:, layout.states :]
    if not layout.chained:
        joint = np.block(
            [
                [marginals.knots[0], marginals.knot_constants[0]],
                [marginals.knot_constants[0].T, marginals.constants],
            ]
        )
        return np.asarray(flat @ joint @ flat.T)
    second, at = flat[:, d : 2 * d], np.repeat(interval, channels)
    cross, knots = marginals.knot_constants, marginals.knots
    with_constants = rest @ marginals.constants
    with_constants += np.einsum("nd,nds->ns", first, cross[at])
    with_constants += np.einsum("nd,nds->ns", second, cross[at + 1])
    result = np.zeros((flat.shape[0], flat.shape[0]))
    # Covariance of the present knot with all functions from here on.
    ahead = np.zeros((d, flat.shape[0]))
    bounds = np.searchsorted(at, np.arange(at[0], at[-1] + 2))
    for k in range(int(at[-1]), int(at[0]) - 1, -1):
        low, high = bounds[k - at[0]], bounds[k - at[0] + 1]
        back = elimination.back[k]
        later = ahead[:, high:]
        now = back[:, :d] @ later + back[:, d : d + s] @ with_constants[high:].T
        if high > low:
            own = slice(low, high)
            a, b, e = first[own], second[own], rest[own]
            this = knots[k] @ a.T + marginals.neighbours[k] @ b.T + cross[k] @ e.T
            following = marginals.neighbours[k].T @ a.T + knots[k + 1] @ b.T + cross[k + 1] @ e.T
            result[own, high:] = a @ now + b @ later + e @ with_constants[high:].T
            result[high:, own] = result[own, high:].T
            result[own, own] = a @ this + b @ following + e @ with_constants[own].T
            ahead[:, own] = this
        ahead[:, high:] = now
    return result
