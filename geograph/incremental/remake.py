"""A chain made for the first time, or anew."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from geograph.incremental.model import SpanError
from geograph.incremental.review import check, look_over
from geograph.incremental.room import emission_times
from geograph.incremental.rows import FIXES, TABLES, choose, count, join
from geograph.incremental.start import (
    NotStartedError,
    Started,
    again,
    begin,
    stretched,
)
from geograph.incremental.state import State, count_rows, note, recount, scalars, with_fixes
from geograph.incremental.trial import try_rows
from geograph.knots import automatic_spacing
from geograph.motion import Density

if TYPE_CHECKING:
    from geograph.incremental.rows import Rows
    from geograph.recording import SmoothSettings

# Linearisations that follow one another at most.
_ROUNDS = 8

_log = logging.getLogger("geograph.incremental")

# A start is tried again when so many times the measurements of the last attempt are there.
_PATIENCE = 1.3

# While several paths fit, first guesses are looked for again when there are so many times the
# measurements of last time; they are nearly all of what a start costs.
_FRESH = 4.0


def collect(state: State, rows: Rows) -> None:
    """Take rows before the start, and try to start.

    Parameters
    ----------
    state
        Changed in place.
    rows
        New ones, without duplicates.
    """
    try_rows(state.template, rows)
    state.waiting = join([state.waiting, rows])
    held = count({k: c for k, c in state.waiting.items() if k in TABLES})
    if held < max(2, _PATIENCE * state.tried):
        return
    state.tried = held
    if state.rivals and held < _FRESH * state.guessed and _still_rivals(state):
        return
    state.guessed = held
    try:
        started = begin(state.template, state.settings, state.waiting, state.whole)
    except NotStartedError as error:
        _not_started(state, error)
        return
    _take(state, started)
    state.waiting, state.rivals = {}, ()


def _still_rivals(state: State) -> bool:
    """Tell whether several paths fit still, solved from where they were found last."""
    try:
        begin(state.template, state.settings, state.waiting, state.whole, guesses=state.rivals)
    except NotStartedError as error:
        if error.rivals:
            _not_started(state, error)
            return True
    return False


def _not_started(state: State, error: NotStartedError) -> None:
    state.message, state.rivals = str(error), error.rivals
    _log.debug("not started with %d measurements: %s", state.tried, error)


def _take(state: State, started: Started) -> None:
    """Go on from a start."""
    state.model, state.chain = started.model, started.chain
    engine(state)
    state.attempts, state.resolution = started.attempts, started.resolution
    state.started_with = state.total
    recount(state)
    state.out, state.names = {}, {}
    for kind, columns in state.rows().items():
        if kind in TABLES and not columns["kept"].all():
            note(state, kind, choose({kind: columns}, {kind: ~columns["kept"]})[kind])
    look_over(state)


def engine(state: State) -> None:
    """Give a new chain to iSAM2, if that is to solve it."""
    _, chain = state.running
    if state.isam:
        # Imported here: GTSAM takes half a second.
        from geograph.incremental.isam import Isam

        chain.isam = Isam()
        chain.changed(0)
        chain.eliminate()


def resolve(state: State) -> None:
    """Solve for all that is held once more, like a batch, from the estimate."""
    model, chain = state.running
    if chain.gone:
        model.renew(chain, range(len(chain.pieces)))
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
    engine(state)
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
    rows = {kind: dict(c) for kind, c in with_fixes(state, rows).items()}
    times = [emission_times(model, chain, kind, c) for kind, c in rows.items()]
    every = np.concatenate([*times, chain.knots_s])
    count_rows(state, rows)
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


def change_noise(state: State, settings: SmoothSettings) -> None:
    """Let other process noise drive the path from the newest knot on.

    The oldest interval is let go: what is held is then never again solved for as a batch, whose
    noise is one.

    Parameters
    ----------
    state
        Changed in place.
    settings
        With the new noise, which is a number.
    """
    state.settings = settings
    if state.chain is None:
        return
    model, chain = state.running
    noise = settings.process_noise
    assert noise != "auto"
    before = model.motion
    motion = before.with_density(Density.of(noise, settings.process_noise_along))
    spacing = model.spacing_s
    if settings.spacing_s is None:
        assert state.resolution is not None
        spacing = automatic_spacing(motion, model.prepared.states, state.resolution)
    if len(chain.pieces) > 1:
        if not chain.gone:
            let_go(state, 1)
        held = (entry for entry in model.earlier if entry[0] > chain.knots_s[0])
        earlier = (*held, (chain.knots_s[-1], before))
    else:
        # As short as it is, all of it is taken to be what comes.
        earlier = ()
    state.model = replace(model, motion=motion, spacing_s=spacing, earlier=earlier)
    if not earlier:
        state.model.renew(chain, range(len(chain.pieces)))
        chain.eliminate()


def let_go(state: State, leave: int) -> None:
    """Drop the oldest intervals, as many as are said; what they said stays as a prior."""
    _, chain = state.running
    rows = join([piece.rows for piece in chain.pieces[:leave]])
    state.dropped.append(rows)
    for kind, columns in rows.items():
        if kind in TABLES:
            gone = columns["ident"][~columns["kept"]].tolist()
            state.rejected_before += len(gone)
            for ident in gone:
                state.out.pop(ident, None)
                state.names.pop(ident, None)
        state.total_rows -= scalars(kind, columns)
    chain.drop(leave)


def finished(state: State) -> None:
    """Use what waits, and solve for everything once more."""
    if state.chain is None:
        state.tried = state.guessed = 0
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
