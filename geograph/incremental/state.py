"""What an incremental smoother holds, and how an update changes a copy of it."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.families import SensorFamily
from geograph.incremental.curvature import Limits, limits
from geograph.incremental.estimate import RowName
from geograph.incremental.judge import choice, innovations, suspects
from geograph.incremental.model import SpanError
from geograph.incremental.room import assign, emission_times, make_room
from geograph.incremental.rows import FIXES, TABLES, choose, count, join, keys, take, time_column
from geograph.incremental.start import (
    NotStartedError,
    Started,
    again,
    begin,
    fixes_between,
    held_shift,
    stretched,
    with_rows,
)
from geograph.robust import plain_limits

if TYPE_CHECKING:
    from collections.abc import Container

    from numpy.typing import NDArray

    from geograph.incremental.chain import Chain
    from geograph.incremental.model import Measured, Model
    from geograph.incremental.rows import Columns, Rows
    from geograph.knots import Resolution
    from geograph.recording import Recording, SmoothSettings
    from geograph.rivals import Attempt

_log = logging.getLogger("geograph.incremental")

# A start is tried again when so many times the measurements of the last attempt are there.
_PATIENCE = 1.3

# Everything is looked over when the number of knots held has grown by this part, and at least so
# many knots later.
_GROWTH = 0.25
_REVIEW_KNOTS = 20

# All estimates are brought up to date when so many of the knots are new.
_CHECK_PART = 0.1

_ROUNDS = 8

# Share of the measurements that do not fit, at which a new first guess is made.
_CONTRADICTED = 0.1

# An update that brings so many knots is solved like a batch.
_MANY_KNOTS = 12


@dataclass(eq=False)
class State:
    """Everything that updates change.

    Attributes
    ----------
    template, settings, lag_s, isam
        Recording without measurements, how it is smoothed, the lag, and whether iSAM2 solves.
    waiting
        Rows that wait for a start.
    whole
        What holds along the whole path.
    model, chain
        From the start on.
    limits
        When to linearise again.
    attempts, resolution
        Of the last start.
    out, names
        Rows that do not count, by their numbers: whether they have been judged, and their names.
    dropped
        What left the lag in this update.
    """

    template: Recording
    settings: SmoothSettings
    lag_s: float | None
    isam: bool = False
    waiting: Rows = field(default_factory=dict)
    whole: Rows = field(default_factory=dict)
    model: Model | None = None
    chain: Chain | None = None
    limits: Limits | None = None
    attempts: list[Attempt] = field(default_factory=list)
    resolution: Resolution | None = None
    tried: int = 0
    message: str = "no measurement yet"
    first_tag_s: float = np.inf
    last_tag_s: float = -np.inf
    total: int = 0
    total_rows: int = 0
    rejected_before: int = 0
    started_with: int = 0
    checked: int = 0
    reviewed: int = 0
    rebuilt: int = 0
    reach_s: float | None = None
    duplicates: int = 0
    late: int = 0
    newly_duplicate: Rows = field(default_factory=dict)
    newly_late: Rows = field(default_factory=dict)
    out: dict[int, bool] = field(default_factory=dict)
    names: dict[int, RowName] = field(default_factory=dict)
    dropped: list[Rows] = field(default_factory=list)

    def copy(self) -> State:
        """Return a state that may be changed without changing this one."""
        return replace(
            self,
            chain=None if self.chain is None else self.chain.copy(),
            out=dict(self.out),
            names=dict(self.names),
            dropped=list(self.dropped),
        )

    def afresh(self) -> State:
        """Return a copy for a new update."""
        return replace(self.copy(), reach_s=None, newly_duplicate={}, newly_late={}, dropped=[])

    @property
    def robust(self) -> bool:
        """Whether outliers are rejected."""
        return self.settings.loss in ("auto", "gnc") and self.running[0].loss.name == "none"

    @property
    def running(self) -> tuple[Model, Chain]:
        """The model and the chain, once there are."""
        assert self.model is not None
        assert self.chain is not None
        return self.model, self.chain

    def rows(self) -> Rows:
        """Return all rows that are held."""
        if self.chain is None:
            return self.waiting
        return join([piece.rows for piece in self.chain.pieces])


def collect(state: State, rows: Rows) -> None:
    """Take rows before the start, and try to start.

    Parameters
    ----------
    state
        Changed in place.
    rows
        New ones, without duplicates.
    """
    state.waiting = join([state.waiting, rows])
    held = count({k: c for k, c in state.waiting.items() if k in TABLES})
    if held < max(2, _PATIENCE * state.tried):
        return
    state.tried = held
    try:
        started = begin(state.template, state.settings, state.waiting, state.whole)
    except NotStartedError as error:
        state.message = str(error)
        _log.debug("not started with %d measurements: %s", held, error)
        return
    _take(state, started)
    state.waiting = {}


def _take(state: State, started: Started) -> None:
    """Go on from a start."""
    state.model, state.chain = started.model, started.chain
    _engine(state)
    state.attempts, state.resolution = started.attempts, started.resolution
    state.started_with = state.total
    recount(state)
    state.out, state.names = {}, {}
    for kind, columns in state.rows().items():
        if kind in TABLES and not columns["kept"].all():
            _note(state, kind, choose({kind: columns}, {kind: ~columns["kept"]})[kind])
    look_over(state)


def _engine(state: State) -> None:
    """Give a new chain to iSAM2, if that is to solve it."""
    _, chain = state.running
    if state.isam:
        # Imported here: GTSAM takes half a second.
        from geograph.incremental.isam import Isam

        chain.isam = Isam()
        chain.changed(0)
        chain.eliminate()


def _note(state: State, kind: str, columns: Columns) -> None:
    """Note rows that do not count."""
    for ident, judged, name in zip(
        columns["ident"].tolist(),
        columns["judged"].tolist(),
        row_names(state.template, kind, columns),
        strict=True,
    ):
        state.out[ident], state.names[ident] = judged, name


def row_names(template: Recording, kind: str, columns: Columns) -> list[RowName]:
    """Return what rows are called."""
    sensors = template.sensor_names
    size = columns["ident"].size
    owner = columns.get("sensor", np.full(size, -1)).tolist()
    time, line = columns[time_column(kind)].tolist(), columns["line"].tolist()
    return [
        RowName(kind, sensors[owner[i]] if owner[i] >= 0 else "", time[i], line[i])
        for i in range(size)
    ]


def mark(state: State, idents: set[int], *, kept: bool, judged: bool) -> set[int]:
    """Set whether rows count; return the pieces that hold them."""
    _, chain = state.running
    changed = set()
    wanted = np.array(sorted(idents), dtype=np.int64)
    for k, piece in enumerate(chain.pieces):
        rows = dict(piece.rows)
        for kind, columns in piece.rows.items():
            own = np.isin(columns["ident"], wanted) if kind in TABLES else None
            if own is None or not own.any():
                continue
            now = columns["kept"].copy(), columns["judged"].copy()
            now[0][own], now[1][own] = kept, judged
            rows[kind] = columns | {"kept": now[0], "judged": now[1]}
            changed.add(k)
            if not kept:
                _note(state, kind, take(rows[kind], own))
        if k in changed:
            chain.pieces[k] = replace(piece, rows=rows)
    if kept:
        for ident in idents:
            state.out.pop(ident, None)
            state.names.pop(ident, None)
    return changed


def recount(state: State) -> None:
    """Count the scalar rows that are held."""
    state.total_rows = sum(_scalars(kind, c) for kind, c in state.rows().items())


def _scalars(kind: str, columns: Columns) -> int:
    return int(columns["ident"].size) * (2 if kind == "bearings" else 1)


def advance(state: State, rows: Rows) -> None:
    """Use new rows.

    Parameters
    ----------
    state
        After its start; changed in place.
    rows
        New ones, without duplicates.

    Raises
    ------
    SpanError
        If signals were emitted before the first knot, or beyond the last.
    NotPositiveDefiniteError, FloatingPointError
        If the linear system does not determine the newest knot.
    """
    model, chain = state.running
    rows = _with_fixes(state, rows)
    rows = {kind: dict(columns) for kind, columns in rows.items()}
    times = {kind: emission_times(model, chain, kind, c) for kind, c in rows.items()}
    rows, times = _without_late(state, rows, times)
    if not rows:
        return
    _count(state, rows)
    if _due(state):
        restart(state, rows)
        state.rebuilt += 1
        return
    every = np.sort(np.concatenate(list(times.values())))
    if state.reach_s is not None:
        every = np.append(every, max(state.reach_s, float(every[-1])))
    before = len(chain.knots_s)
    if every[0] < chain.knots_s[0] and not chain.gone:
        chain.solve_all()
        high = max(float(every[-1]), chain.knots_s[-1])
        respan(state, rows, float(every[0]), high)
        recount(state)
        look_over(state)
        return
    touched = make_room(model, chain, every)
    for k, part in assign(chain, rows, times).items():
        chain.pieces[k] = replace(chain.pieces[k], rows=join([chain.pieces[k].rows, part]))
        touched.add(k)
    new = {int(i) for c in rows.values() for i in c["ident"]}
    _use(state, touched, new)
    fresh = len(chain.knots_s) - before
    if fresh > _MANY_KNOTS and not chain.gone:
        resolve(state)
    _keep_up(state)


def _due(state: State) -> bool:
    """Tell whether the start is to be made again, with twice the measurements.

    The process noise may have to be found, and the first guess may have had several ways.
    """
    model, chain = state.running
    automatic = state.settings.process_noise == "auto" and not model.motion.static
    if chain.gone:
        return False
    # Where a tenth does not fit, it may be the path that is wrong.
    contradicted = state.robust and len(state.out) > max(3.0, _CONTRADICTED * state.total)
    if contradicted and state.total >= _PATIENCE * state.started_with:
        return True
    return (automatic or len(state.attempts) > 1) and state.total >= 2 * state.started_with


def _count(state: State, rows: Rows) -> None:
    """Count rows, for what weighs by their number, and for the clocks' common time."""
    model, chain = state.running
    now = with_rows(model, rows)
    if now.shift is not model.shift:
        chain.hold = held_shift(now, chain.reference)
    state.model = now
    state.total_rows += sum(_scalars(kind, columns) for kind, columns in rows.items())


def _use(state: State, touched: set[int], new: set[int]) -> None:
    """Linearise, judge what is new, eliminate, and linearise again what moved too far."""
    model, chain = state.running
    assert state.limits is not None
    measured = model.linearise(chain, sorted(touched))
    doubtful: set[int] = set()
    if state.robust:
        doubtful = suspects(measured, new, state.total)
        if doubtful:
            touched = touched | mark(state, doubtful, kept=False, judged=False)
            model.linearise(chain, sorted(touched))
    _solve_on(state)
    if doubtful:
        _admit(state, doubtful)


def _solve_on(state: State) -> None:
    """Eliminate what changed; linearise again what moved too far from there."""
    model, chain = state.running
    assert state.limits is not None
    for _ in range(_ROUNDS):
        first = chain.dirty
        chain.eliminate()
        chain.solve(len(chain.knots_s) - first)
        moved = state.limits.moved(chain, first)
        if not moved:
            return
        model.linearise(chain, moved)
    chain.eliminate()


def _admit(state: State, doubtful: set[int]) -> None:
    """Admit rows that do not count, where the uncertainty of all others allows for them."""
    model, chain = state.running
    pieces = mark(state, doubtful, kept=False, judged=False)
    measured = model.linearise(chain, sorted(pieces))
    chain.eliminate()
    found = innovations(model, chain, measured, doubtful)
    limit: dict[int, float] = {}
    for part in measured:
        if isinstance(part.family, SensorFamily):
            own = plain_limits(state.total, part.family.row_counts)
            limit.update(zip(part.columns["ident"][part.order].tolist(), own.tolist(), strict=True))
    good = {ident for ident, square in found.items() if square <= limit[ident]}
    if good:
        changed = mark(state, good, kept=True, judged=False)
        model.linearise(chain, sorted(changed))
        _solve_on(state)


def _keep_up(state: State) -> None:
    """Bring all estimates up to date from time to time, and look everything over; drop the old."""
    _, chain = state.running
    assert state.limits is not None
    knots = len(chain.knots_s) + chain.gone
    held = len(chain.knots_s)
    constants = np.array([chain.pieces[0].constants, chain.pieces[-1].constants])
    far = bool((np.abs(chain.constants - constants) > state.limits.constants).any())
    if far or knots - state.checked > max(4.0, _CHECK_PART * held):
        check(state)
    if knots - state.reviewed > max(_REVIEW_KNOTS, _GROWTH * held):
        look_over(state)
    if state.lag_s is not None:
        _let_go(state)


def _let_go(state: State) -> None:
    """Drop what is older than the lag."""
    _, chain = state.running
    assert state.lag_s is not None
    oldest = chain.knots_s[-1] - state.lag_s
    leave = 0
    while leave < len(chain.pieces) - 1 and chain.knots_s[leave + 1] <= oldest:
        leave += 1
    if not leave or (state.isam and 2 * leave < len(chain.pieces)):
        # iSAM2 is made anew for a new prior: as seldom as once for every knot held.
        return
    rows = join([piece.rows for piece in chain.pieces[:leave]])
    state.dropped.append(rows)
    for kind, columns in rows.items():
        if kind in TABLES:
            gone = columns["ident"][~columns["kept"]].tolist()
            state.rejected_before += len(gone)
            for ident in gone:
                state.out.pop(ident, None)
                state.names.pop(ident, None)
        state.total_rows -= _scalars(kind, columns)
    chain.drop(leave)


def check(state: State) -> None:
    """Bring all estimates up to date, and linearise again what moved too far."""
    model, chain = state.running
    assert state.limits is not None
    for _ in range(_ROUNDS):
        chain.solve_all()
        moved = state.limits.moved(chain, 0)
        if not moved:
            break
        model.linearise(chain, moved)
        chain.eliminate()
    state.checked = len(chain.knots_s) + chain.gone


def look_over(state: State) -> None:
    """Weigh again what depends on how much there is, choose outliers, and renew the limits."""
    model, chain = state.running
    if state.limits is None:
        state.limits = limits(model, chain, state.total_rows)
    if _weights_changed(state):
        _weigh_again(state)
    check(state)
    if state.robust:
        _choose(state)
    knots = len(chain.knots_s) + chain.gone
    state.reviewed = knots
    state.limits = limits(state.running[0], chain, state.total_rows)


def _weights_changed(state: State) -> bool:
    """Tell whether measurements weigh by how many there are."""
    model, chain = state.running
    correlated = any(sensor.correlation for sensor in model.prepared.sensors)
    spread = bool(model.whole) and model.whole_s < chain.knots_s[-1] - model.since_s
    return correlated or spread


def _weigh_again(state: State) -> None:
    model, chain = state.running
    state.model = model.reaching(chain)
    state.model.linearise(chain, range(len(chain.pieces)))
    chain.eliminate()


def _choose(state: State) -> None:
    """Choose what counts as a batch does, until the choice stands."""
    model, chain = state.running
    for _ in range(_ROUNDS):
        measured = everything(state)
        admit, reject = choice(measured)
        for part in measured:
            # What does not count has now been asked about.
            out = part.columns["ident"][~part.columns["kept"] & ~part.columns["judged"]]
            still = set(out.tolist()) - admit
            if still:
                mark(state, still, kept=False, judged=True)
        if not admit and not reject:
            break
        changed = mark(state, admit, kept=True, judged=False) if admit else set()
        if reject:
            changed |= mark(state, reject, kept=False, judged=True)
        model.linearise(chain, sorted(changed))
        chain.eliminate()
        check(state)


def everything(state: State) -> list[Measured]:
    """Return all that is held, evaluated at the estimate."""
    model, chain = state.running
    path = model.motion.path(np.array(chain.knots_s))
    return model.evaluate(state.rows(), path, chain.values(0, len(chain.knots_s) - 1), 0)


def resolve(state: State) -> None:
    """Solve for all that is held once more, like a batch, from the estimate."""
    model, chain = state.running
    if chain.gone:
        model.linearise(chain, range(len(chain.pieces)))
        chain.eliminate()
        check(state)
        return
    chain.solve_all()
    respan(state, {}, chain.knots_s[0], chain.knots_s[-1])


def respan(state: State, rows: Rows, low_s: float, high_s: float) -> None:
    """Solve for all that is held and new rows, over knots that reach far enough.

    Parameters
    ----------
    state
        Nothing was dropped from it yet; changed in place.
    rows
        New ones.
    low_s, high_s
        First and last time of emission.

    Raises
    ------
    SpanError, FloatingPointError, NotPositiveDefiniteError
        If there is no solution from here.
    """
    model, chain = state.running
    held, every = chain, join([state.rows(), rows])
    for attempt in range(_ROUNDS):
        knots, values = stretched(model, held, low_s, high_s)
        try:
            state.chain = again(model, knots, values, every, limit=state.settings.max_iterations)
            break
        except SpanError as error:
            if attempt == _ROUNDS - 1:
                raise
            low_s, high_s = min(low_s, error.low_s), max(high_s, error.high_s)
    assert state.chain is not None
    _engine(state)
    state.model = replace(model, since_s=float(knots[0])).reaching(state.chain)
    state.checked = knots.size


def renew(state: State, rows: Rows) -> None:
    """Solve for everything that is held and new rows once more, from the estimate.

    Raises
    ------
    FloatingPointError
        If old measurements have left already, whose prior is bound to the linear system.
    """
    model, chain = state.running
    if chain.gone:
        raise FloatingPointError("the linear system holds the prior of what left the lag")
    rows = {kind: dict(c) for kind, c in _with_fixes(state, rows).items()}
    times = [emission_times(model, chain, kind, c) for kind, c in rows.items()]
    every = np.concatenate([*times, chain.knots_s])
    _count(state, rows)
    respan(state, rows, float(every.min()), float(every.max()))
    recount(state)
    look_over(state)


def restart(state: State, rows: Rows) -> None:
    """Begin again from a first guess, with all rows that are held and new ones.

    Raises
    ------
    NotStartedError
        If there is none.
    """
    held = {k: c for k, c in join([state.rows(), rows]).items() if k != FIXES}
    _take(state, begin(state.template, state.settings, held, state.whole))


def finished(state: State) -> None:
    """Use what waits, and solve for everything once more."""
    if state.chain is None:
        state.tried = 0
        collect(state, {})
        return
    model, chain = state.running
    automatic = state.settings.process_noise == "auto" and not model.motion.static
    several = len(state.attempts) > 1
    doubtful = state.robust and bool(state.out)
    if not chain.gone and state.total > state.started_with and (automatic or several or doubtful):
        restart(state, {})
        return
    resolve(state)
    look_over(state)
    resolve(state)


def _with_fixes(state: State, rows: Rows) -> Rows:
    """Return rows with the platforms' fixes up to the one after the newest time tag."""
    model, _ = state.running
    tags = [c[time_column(kind)] for kind, c in rows.items() if kind in TABLES]
    if not tags:
        return rows
    newest = max(float(t.max()) for t in tags)
    before, state.last_tag_s = state.last_tag_s, max(state.last_tag_s, newest)
    if not model.prepared.states.platforms or state.last_tag_s == before:
        return rows
    every = fixes_between(model, before, state.last_tag_s)
    held = {
        (int(p), int(i))
        for piece in state.running[1].pieces
        if FIXES in piece.rows
        for p, i in zip(piece.rows[FIXES]["platform"], piece.rows[FIXES]["index"], strict=True)
    }
    mask = np.array(
        [
            (int(p), int(i)) not in held
            for p, i in zip(every[FIXES]["platform"], every[FIXES]["index"], strict=True)
        ]
    )
    return join([rows, choose(every, {FIXES: mask})]) if mask.any() else rows


def _without_late(
    state: State, rows: Rows, times: dict[str, NDArray[np.float64]]
) -> tuple[Rows, dict[str, NDArray[np.float64]]]:
    """Return what is not too old, and name the rest; raise where knots must be put before."""
    _, chain = state.running
    first = chain.knots_s[0]
    early = {kind: time < first for kind, time in times.items()}
    if not chain.gone or not any(mask.any() for mask in early.values()):
        return rows, times
    state.newly_late = {k: c for k, c in choose(rows, early).items() if k != FIXES}
    state.late += count(state.newly_late)
    keep = {kind: ~mask for kind, mask in early.items()}
    rows = choose(rows, keep)
    return rows, {kind: times[kind][keep[kind]] for kind in rows}


def without_duplicates(known: Container[Any], rows: Rows) -> tuple[Rows, Rows]:
    """Return rows that are new, and those that came before or twice."""
    own: set[Any] = set()
    new = {}
    for kind, columns in rows.items():
        mask = np.ones(columns["ident"].size, dtype=bool)
        for index, key in enumerate(keys(kind, columns)):
            mask[index] = key not in own and key not in known
            own.add(key)
        new[kind] = mask
    if all(mask.all() for mask in new.values()):
        return rows, {}
    return choose(rows, new), choose(rows, {kind: ~mask for kind, mask in new.items()})
