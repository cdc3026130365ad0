"""One update of a chain."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np

from geograph.families import SensorFamily
from geograph.incremental.judge import innovations, suspects
from geograph.incremental.remake import let_go, resolve, respan, restart
from geograph.incremental.review import check, look_over, renew_limits, until_it_stands
from geograph.incremental.room import assign, emission_times, make_room
from geograph.incremental.rows import FIXES, choose, count, join
from geograph.incremental.start import NotStartedError
from geograph.incremental.state import State, count_rows, mark, recount, with_fixes
from geograph.robust import plain_limits
from geograph.states import CLOCK, NO_SENSOR

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.incremental.rows import Rows

_log = logging.getLogger("geograph.incremental")

# Everything is looked over at the soonest so many knots later.
_REVIEW_KNOTS = 20

# Linearisations that follow one another at most.
_ROUNDS = 8

# Weighings by a loss that follow one another at most.
_WEIGHINGS = 30

# A start is tried again when so many times the measurements of the last attempt are there.
_PATIENCE = 1.3

# Everything is looked over when the number of knots held has grown by this part, and at least so
# many knots later.
_GROWTH = 0.25

# All estimates are brought up to date when so many of the knots are new.
_CHECK_PART = 0.1

# Share of the measurements that do not fit, at which a new first guess is made.
_CONTRADICTED = 0.1

# A lag is stretched by this while sensors are not known well enough to let intervals go.
_STRETCH = 5.0
# Sigmas that a clock may be off.
_SIGMAS = 3.0

# An update that brings so many knots is solved like a batch.
_MANY_KNOTS = 12


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
    rows = with_fixes(state, rows)
    rows = {kind: dict(columns) for kind, columns in rows.items()}
    times = {kind: emission_times(model, chain, kind, c) for kind, c in rows.items()}
    rows, times = _without_late(state, rows, times)
    if not rows:
        return
    count_rows(state, rows)
    if _due(state) and _begun_again(state, rows):
        return
    every = sorted(time for own in times.values() for time in own.tolist())
    if state.reach_s is not None:
        every.append(max(state.reach_s, every[-1]))
    before = len(chain.knots_s)
    if every[0] < chain.knots_s[0] and not chain.gone:
        chain.solve_all()
        respan(state, rows, every[0], max(every[-1], chain.knots_s[-1]))
        recount(state)
        look_over(state)
        return
    touched = make_room(model, chain, every)
    for k, part in assign(chain, rows, times).items():
        held = chain.pieces[k]
        chain.pieces[k] = held.holding(join([held.rows, part]) if held.rows else part)
        touched.add(k)
    new = {i for c in rows.values() for i in c["ident"].tolist()}
    _use(state, touched, new)
    fresh = len(chain.knots_s) - before
    if fresh > _MANY_KNOTS and not chain.gone:
        resolve(state)
    keep_up(state)


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
    # Of a burst of signals, nothing is known of how often there will be some: of a moving object,
    # the path does not begin before that is known.
    paced = model.motion.static and model.layout.walks > 0 and state.settings.spacing_s is None
    again = automatic or paced or len(state.attempts) > 1
    return again and state.total >= 2 * state.started_with


def _begun_again(state: State, rows: Rows) -> bool:
    """Make the start again; tell whether there was one, and go on with what is held if not."""
    try:
        restart(state, rows)
    except NotStartedError as error:
        _log.warning("the start is not made again (%s)", error)
        state.started_with = state.total
        return False
    state.rebuilt += 1
    return True


def _use(state: State, touched: set[int], new: set[int]) -> None:
    """Linearise, judge what is new, eliminate, and linearise again what moved too far."""
    model, chain = state.running
    assert state.limits is not None
    measured = model.renew(chain, sorted(touched))
    doubtful: set[int] = set()
    if state.robust:
        doubtful = suspects(measured, new, state.total)
        if doubtful:
            touched = touched | mark(state, doubtful, kept=False, judged=False)
            model.renew(chain, sorted(touched))
    _solve_on(state)
    if model.loss.name != "none":
        _weigh_on(state, sorted(touched))
    if doubtful:
        _admit(state, doubtful)


def _weigh_on(state: State, touched: list[int]) -> None:
    """Weigh what is new again until the estimate stands: after a gap it was predicted far off."""
    model, chain = state.running

    def weigh() -> None:
        model.renew(chain, touched)
        _solve_on(state)

    until_it_stands(chain, weigh, _WEIGHINGS)


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
        model.renew(chain, moved)
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
        model.renew(chain, sorted(changed))
        _solve_on(state)


def keep_up(state: State) -> None:
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
        look_over(state, limits_later=True)
    elif state.limits_due:
        renew_limits(state)
    if state.lag_s is not None:
        _let_go(state)


def _let_go(state: State) -> None:
    """Drop what is older than the lag."""
    _, chain = state.running
    assert state.lag_s is not None
    oldest = chain.knots_s[-1] - state.lag_s * (_STRETCH if _unsure(state) else 1.0)
    leave = 0
    while leave < len(chain.pieces) - 1 and chain.knots_s[leave + 1] <= oldest:
        leave += 1
    if not leave or (state.isam and 2 * leave < len(chain.pieces)):
        # iSAM2 is made anew for a new prior: as seldom as once for every knot held.
        return
    let_go(state, leave)


def _unsure(state: State) -> bool:
    """Tell whether a sensor's error is known too badly for what it bears on to be let go.

    That of a silent sensor counts if it may speak of what is older than the lag.
    """
    model, _ = state.running
    assert state.limits is not None
    assert state.lag_s is not None
    unsure = state.limits.unsure()
    return any(
        column.sensor in model.active
        or column.sensor == NO_SENSOR
        or (column.channel == CLOCK and not column.drift and column.sigma > state.lag_s / _SIGMAS)
        for column, open_ in zip(model.prepared.states.constants, unsure.tolist(), strict=True)
        if open_
    )


def _without_late(
    state: State, rows: Rows, times: dict[str, NDArray[np.float64]]
) -> tuple[Rows, dict[str, NDArray[np.float64]]]:
    """Return what is not too old, and name the rest; raise where knots must be put before."""
    _, chain = state.running
    if not chain.gone:
        return rows, times
    first = chain.knots_s[0]
    early = {kind: time < first for kind, time in times.items()}
    if not any(mask.any() for mask in early.values()):
        return rows, times
    state.newly_late = {k: c for k, c in choose(rows, early).items() if k != FIXES}
    state.late += count(state.newly_late)
    keep = {kind: ~mask for kind, mask in early.items()}
    rows = choose(rows, keep)
    return rows, {kind: times[kind][keep[kind]] for kind in rows}
