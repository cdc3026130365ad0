"""From the rows of intervals to linear pieces, through the same families as in a batch."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.blocks import BlockSum, ColumnLayout, Sums
from geograph.common import settled
from geograph.families import CONSTRAINT_FAMILIES, FixFamily, SensorFamily
from geograph.incremental.chain import Piece
from geograph.incremental.intervals import WITHIN, Fixed, Seen, linearise_intervals
from geograph.incremental.rows import FIXES, TABLES, join, table_of, take
from geograph.kernels import flat
from geograph.knots import add_path_noise
from geograph.motion import inverse_stack
from geograph.prepare import without_refraction
from geograph.problem import chain_noise

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from geograph.families import Evaluation, Family, Values
    from geograph.incremental.chain import Chain
    from geograph.incremental.rows import Columns, Rows
    from geograph.losses import Loss
    from geograph.motion import Motion
    from geograph.path import Path
    from geograph.prepare import Prepared
    from geograph.problem import PathPrior
    from geograph.time_shift import TimeShift

_ROUNDS = 6

# Share of the spacing by which emissions may lie beyond the knots, as in a batch.
_SLACK = 0.05


class SpanError(ArithmeticError):
    """Signals were emitted beyond the knots: knots must be put anew.

    Parameters
    ----------
    low_s, high_s
        Between which times.
    """

    def __init__(self, low_s: float, high_s: float) -> None:
        self.low_s, self.high_s = low_s, high_s
        super().__init__(f"signals were emitted from {low_s:.10g} to {high_s:.10g} s")


@dataclass(frozen=True, eq=False)
class Measured:
    """One kind of measurement, evaluated at the estimate.

    Attributes
    ----------
    kind, columns
        The rows.
    family, found
        Their family and its evaluation, in the family's order.
    order
        Shape (n,): the row of each of the family's measurements.
    interval
        Shape (n,): the interval of each row.
    """

    kind: str
    columns: Columns
    family: Family
    found: Evaluation
    order: NDArray[np.int64]
    interval: NDArray[np.int64]

    def by_row(self, column: NDArray[Any]) -> NDArray[Any]:
        """Return a column in the family's order in that of the rows."""
        result = np.empty_like(column)
        result[self.order] = column
        return result


@dataclass(frozen=True, eq=False)
class Model:
    """What all linearisations share until the next rebuild.

    Attributes
    ----------
    prepared
        Sensors, their states and geometry.
    motion, prior, path_scale, loss
        As of :class:`geograph.problem.Problem`.
    shift
        Of the sensors that have measured, or None.
    spacing_s
        Longest interval.
    between
        Whether intervals are so long that the path's deviation between knots is added as noise.
    carrier_hz
        Median carrier of frequency differences.
    counts
        Rows of each kind and sensor so far, for correlated errors.
    whole
        Constraints along the whole path, by kind: columns.
    since_s, whole_s
        When the path began, and over how long a time these are spread.
    active, timed
        Sensors that have measured, and whether a constraint stands at a given time.
    earlier
        Motions that held before, each with the time until which it did, in the order of time.
    """

    prepared: Prepared
    motion: Motion
    prior: PathPrior
    path_scale: NDArray[np.float64]
    loss: Loss
    shift: TimeShift | None
    spacing_s: float
    between: bool
    carrier_hz: float | None
    counts: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    whole: Rows = field(default_factory=dict)
    since_s: float = 0.0
    whole_s: float = 1.0
    active: frozenset[int] = frozenset()
    timed: bool = False
    earlier: tuple[tuple[float, Motion], ...] = ()

    @cached_property
    def layout(self) -> ColumnLayout:
        """Columns of the pieces' blocks."""
        states = self.prepared.states
        return ColumnLayout(self.motion.size, states.chains, states.size, chained=True)

    @cached_property
    def refreshed(self) -> bool:
        """Whether families hold anything fixed that depends on the estimate."""
        return self.between or self.noisy or self.prepared.states.chains > 0

    @cached_property
    def noisy(self) -> bool:
        """Whether positions of sensors are uncertain at every measurement anew."""
        return any(
            sensor.errors.position_noise_m > 0.0 and sensor.platform_process_noise is None
            for sensor in self.prepared.sensors
        )

    @cached_property
    def fixed(self) -> Fixed | None:
        """The tables of compiled code, where bearings are the usual ones."""
        return Fixed.of(self)

    @property
    def correlated(self) -> bool:
        """Whether measurements weigh by how many there are."""
        return bool(self._correlation.any())

    @cached_property
    def _correlation(self) -> NDArray[np.float64]:
        return np.array([float(sensor.correlation) for sensor in self.prepared.sensors])

    def correlation_weights(self, kind: str, sensor: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return weights of correlated errors; see :func:`geograph.prepare.correlation_weights`."""
        rho = self._correlation
        if kind not in self.counts or not self.correlated:
            return np.ones(sensor.size)
        count = np.maximum(self.counts[kind], 1)
        return np.asarray((1.0 / (1.0 + (count - 1) * rho))[sensor])

    def family(self, kind: str, columns: Columns) -> Family:
        """Return the family of some rows."""
        prepared = self.prepared
        if kind in TABLES:
            table = table_of(kind, columns)
            if kind == "bearings":
                table = without_refraction(table, prepared.sensors)  # type: ignore[arg-type]
            weight = self.correlation_weights(kind, table.sensor)
            family = prepared.family(table, weight, median_carrier_hz=self.carrier_hz)
            order = getattr(family, "order", None)
            delay = columns["delay_s"]
            family.expect_delays(delay if order is None else delay[order])
            return family
        if kind == FIXES:
            raise KeyError(kind)
        return CONSTRAINT_FAMILIES[kind](
            time_s=columns["time_s"],
            value=columns["value"],
            sigma=columns["sigma"],
            line=columns["line"],
            frame=prepared.recording.frame,
            surface=prepared.recording.terrain,
        )

    def families(self, rows: Rows) -> Iterable[tuple[str, Columns, Family]]:
        """Yield the families of rows; fixes make one for each platform."""
        for kind, columns in rows.items():
            if kind != FIXES:
                yield kind, columns, self.family(kind, columns)
                continue
            for index in np.unique(columns["platform"]):
                part = take(columns, columns["platform"] == index)
                states = self.prepared.states
                platform = states.platforms[int(index)]
                yield (
                    kind,
                    part,
                    FixFamily(platform, states, self.prepared.walk_scale, part["index"]),
                )

    def refresh(self, family: Family, path: Path, values: Values) -> None:
        """Bring what a family holds fixed up to date, as the batch smoother does."""
        if self.between and isinstance(family, SensorFamily):
            _, times = family.emissions(path, values)
            add_path_noise(family, self.motion, path, times)
        family.refresh(path, values)

    def evaluate(
        self, rows: Rows, path: Path, values: Values, first: int, loss: Loss | None = None
    ) -> list[Measured]:
        """Evaluate rows at an estimate, with derivatives.

        Parameters
        ----------
        rows
            Measurements.
        path, values
            Knots around them.
        first
            Index of the first of these in the chain.
        loss
            In place of the model's.
        """
        return self.evaluate_families(list(self.families(rows)), path, values, first, loss=loss)

    def evaluate_families(
        self,
        families: Iterable[tuple[str, Columns, Family]],
        path: Path,
        values: Values,
        first: int,
        *,
        loss: Loss | None = None,
        jacobian: bool = True,
        refresh: bool = True,
    ) -> list[Measured]:
        """Evaluate families made before; see :meth:`evaluate`.

        Without ``refresh``, what they hold fixed is that of the last evaluation.
        """
        state = path.at_state(values.path, jacobian=jacobian)
        result = []
        for kind, columns, family in families:
            if self.refreshed and refresh:
                self.refresh(family, path, values)
            order = getattr(family, "order", None)
            if order is None:
                order = np.arange(len(family))
            found = family.evaluate(path, state, values, jacobian=jacobian)
            kept = columns["kept"][order].astype(np.float64)
            found = settled(found, None if kept.all() else kept, loss or self.loss)
            interval = np.empty_like(found.interval)
            interval[order] = found.interval + first
            result.append(Measured(kind, columns, family, found, order, interval))
        return result

    def renew(self, chain: Chain, touched: Sequence[int]) -> Sequence[Measured | Seen]:
        """Do what :meth:`linearise` does, in the shortest way, for who needs no derivatives."""
        order = sorted(touched)
        if order:
            seen = linearise_intervals(self, chain, order)
            if seen is not None:
                return seen
        return self.linearise(chain, order)

    def linearise(self, chain: Chain, touched: Sequence[int]) -> list[Measured]:
        """Linearise pieces of a chain at its estimate, and put rows where their signals belong.

        Parameters
        ----------
        chain
            Changed in place.
        touched
            Indices of pieces; others that rows move into are linearised too.

        Returns
        -------
        measured
            Of all pieces that were linearised.

        Raises
        ------
        SpanError
            If signals were emitted beyond the knots.
        FloatingPointError
            If a prediction or derivative is not finite.
        """
        order = sorted(touched)
        for _ in range(_ROUNDS):
            low, high = max(order[0] - 1, 0), min(order[-1] + 1, len(chain.pieces) - 1)
            path = self.motion.path(np.array(chain.knots_s[low : high + 2]))
            values = chain.values(low, high + 1)
            rows = join([chain.pieces[k].rows for k in order])
            measured = self.evaluate(rows, path, values, low)
            where = {int(k) for part in measured for k in np.unique(part.interval)}
            if where <= set(order):
                break
            order = sorted(where | set(order))
        self._check_span(chain, measured)
        sums = Sums.zeros(self.layout, high + 1 - low, apart=True)
        for part in measured:
            self._add(sums, part)
        blocks = sums.full()
        if self.whole:
            for k in order:
                blocks[k - low] += self._whole_block(chain, k)
        if not np.isfinite(blocks.sum()):
            raise FloatingPointError("a prediction or a derivative is not finite")
        self._store(chain, order, blocks[[k - low for k in order]], measured)
        return measured

    def within(self, chain: Chain, k: int) -> tuple[float, float]:
        """Return between which times the emissions of an interval's rows may be."""
        low, high = chain.knots_s[k], chain.knots_s[k + 1]
        near, slack = WITHIN * self.spacing_s, _SLACK * self.spacing_s
        if k == 0:
            # What was emitted before the oldest knot of a lag stays with it.
            low -= np.inf if chain.gone else slack
        else:
            low -= near
        return low, high + (slack if k == len(chain.pieces) - 1 else near)

    def _check_span(self, chain: Chain, measured: list[Measured]) -> None:
        slack = _SLACK * self.spacing_s
        families = [part.family for part in measured if isinstance(part.family, SensorFamily)]
        if not families:
            return
        low = min(float(family.emitted_s.min()) for family in families)
        high = max(float(family.emitted_s.max()) for family in families)
        early = low < chain.knots_s[0] - slack and not chain.gone
        if early or high > chain.knots_s[-1] + slack:
            raise SpanError(low, high)

    def _add(self, sums: Sums, part: Measured) -> None:
        square = np.einsum("ij,ij->i", part.found.residual, part.found.residual)
        kept = part.columns["kept"][part.order]
        weight = None if kept.all() else kept.astype(np.float64)
        if self.loss.name != "none":
            slope = self.loss.value_and_weight(square)[1]
            weight = slope if weight is None else weight * slope
        root = None if weight is None else np.sqrt(weight)
        BlockSum(self.layout, self.path_scale).add(sums, part.found, root)

    def reaching(self, chain: Chain) -> Model:
        """Return the model with what holds along the whole path spread as far as a chain goes."""
        return replace(self, whole_s=chain.knots_s[-1] - self.since_s)

    def whole_families(
        self, knots_s: NDArray[np.float64], share: NDArray[np.float64]
    ) -> list[Family]:
        """Return the families of what holds along the whole path, put at some of its knots.

        Parameters
        ----------
        knots_s
            Shape (n,).
        share
            Shape (n,): of the time of the whole path that each knot stands for. All together
            count as one measurement.
        """
        found: list[Family] = []
        for kind, columns in self.whole.items():
            size, times = columns["value"].size, knots_s.size
            found.append(
                CONSTRAINT_FAMILIES[kind](
                    time_s=np.repeat(knots_s, size),
                    value=np.tile(columns["value"], times),
                    sigma=np.tile(columns["sigma"], times) / np.sqrt(np.repeat(share, size)),
                    line=np.tile(columns["line"], times),
                    frame=self.prepared.recording.frame,
                    surface=self.prepared.recording.terrain,
                )
            )
        return found

    def _whole_block(self, chain: Chain, k: int) -> NDArray[np.float64]:
        """Return what holds along the whole path, at both ends of an interval."""
        times = np.array(chain.knots_s[k : k + 2])
        path, values = self.motion.path(times), chain.values(k, k + 1)
        state = path.at_state(values.path, jacobian=True)
        sums = Sums.zeros(self.layout, 1)
        span = max(self.whole_s, chain.knots_s[-1] - self.since_s)
        share = np.full(2, 0.5 * (times[1] - times[0]) / span)
        for family in self.whole_families(times, share):
            found = family.evaluate(path, state, values, jacobian=True)
            BlockSum(self.layout, self.path_scale).add(sums, found, None)
        return np.asarray(sums.full()[0])

    def _store(
        self,
        chain: Chain,
        order: Sequence[int],
        blocks: NDArray[np.float64],
        measured: list[Measured],
    ) -> None:
        """Write the pieces about the chain's reference."""
        chain.changed(order[0])
        inverse, root, noise = self._transitions(chain, order)
        parts = _divided(measured, order)
        lead = chain.constants - chain.reference
        for i, k in enumerate(order):
            block = blocks[i]
            ahead = np.concatenate([chain.offset(k), chain.offset(k + 1), lead])
            if ahead.any():
                moved = block[:-1, :-1] @ ahead
                block[:-1, -1] -= moved
                block[-1, :-1] -= moved
            chain.pieces[k] = Piece(
                parts.get(k, {}),
                *(block, flat(inverse[i]), flat(root[i]), noise[i]),
                np.array([chain.path[k], chain.path[k + 1]]),
                np.array([chain.chains[k], chain.chains[k + 1]]),
                chain.constants,
            )

    @property
    def changed_s(self) -> float:
        """When the process noise was changed last."""
        return self.earlier[-1][0] if self.earlier else -np.inf

    def density(self, start_s: float) -> NDArray[np.float64]:
        """Return the noise's density along the axes in an interval by its start, shape (3,)."""
        for until, motion in self.earlier:
            if start_s < until:
                return np.array(motion.density.axes)
        return self._density

    @cached_property
    def _density(self) -> NDArray[np.float64]:
        return np.array(self.motion.density.axes)

    def _periods(self, starts_s: Sequence[float]) -> Iterator[tuple[int, int, Motion]]:
        """Yield ranges of intervals, by their starts, with the motion that holds in each."""
        first = 0
        for until, motion in (*self.earlier, (np.inf, self.motion)):
            end = int(np.searchsorted(starts_s, until))
            if end > first:
                yield first, end, motion
                first = end

    def _transitions(
        self, chain: Chain, order: Sequence[int]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return inverse transitions, noise roots, and noises at the reference, scaled."""
        low, high = order[0], order[-1]
        knots = np.array(chain.knots_s[low : high + 2])
        steps = np.diff(knots)
        m, d = chain.size, chain.knot_size
        scale, count = self.path_scale, steps.size
        reference = np.array(chain.reference_path[low : high + 2])
        at = np.array(chain.path[low : high + 2])
        parts = []
        for first, end, motion in self._periods(chain.knots_s[low : high + 1]):
            own = slice(first, end + 1)
            starts = np.array(chain.knots_s[low + first : low + end])
            parts.append(
                _of_path(
                    motion,
                    reference[own],
                    at[own],
                    steps[first:end],
                    scale=scale,
                    starts_s=starts,
                )
            )
        inverse, root, noise = (
            parts[0] if len(parts) == 1 else map(np.concatenate, zip(*parts, strict=True))
        )
        if d > m:
            states = self.prepared.states
            by, spread = states.chain_transitions(knots, self.prepared.walk_scale)
            of_path = inverse, root
            inverse, root = np.zeros((count, d, d)), np.zeros((count, d, d))
            inverse[:, :m, :m], root[:, :m, :m] = of_path
            inverse[:, m:, m:], root[:, m:, m:] = np.linalg.inv(by), spread
            chains = np.array(chain.reference_chains[low : high + 2])
            noise = np.concatenate([noise, chain_noise(chains, by, spread)], axis=1)
        pick = [k - low for k in order]
        return inverse[pick], root[pick], noise[pick]


def _of_path(
    motion: Motion,
    reference: NDArray[np.float64],
    at: NDArray[np.float64],
    steps: NDArray[np.float64],
    *,
    scale: NDArray[np.float64],
    starts_s: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return inverse transitions, noise roots, and noises at a reference, of the path, scaled."""
    if motion.constant:
        found = motion.linear(reference, steps, scale, starts_s)
        return found.inverse, found.noise_root, found.residual
    plain = motion.transitions(at, steps, starts_s)
    matrix = plain.transition * scale / scale[:, None]
    root = plain.noise_root / scale[:, None]
    behind = (reference - at) / scale
    gap = behind[1:] - np.matmul(matrix, behind[:-1, :, None])[:, :, 0]
    noise = plain.residual + np.linalg.solve(root, gap[:, :, None])[:, :, 0]
    return inverse_stack(matrix), root, noise


def _divided(measured: list[Measured], order: Sequence[int]) -> dict[int, Rows]:
    """Return rows by the interval that they belong to."""
    if len(order) == 1:
        return {order[0]: join([{part.kind: part.columns} for part in measured] or [{}])}
    result: dict[int, Rows] = {}
    for part in measured:
        sequence = np.argsort(part.interval, kind="stable")
        sorted_columns = take(part.columns, sequence)
        interval = part.interval[sequence]
        edges = np.flatnonzero(np.diff(interval, prepend=-1, append=-1))
        for first, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            own = {name: column[first:end] for name, column in sorted_columns.items()}
            k = int(interval[first])
            result[k] = join([result.get(k, {}), {part.kind: own}])
    return result
