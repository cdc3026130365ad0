"""What is done from time to time: estimates brought up to date, outliers chosen, limits renewed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.incremental.curvature import TOLERANCE, limits
from geograph.incremental.judge import choice
from geograph.incremental.state import State, mark

if TYPE_CHECKING:
    from collections.abc import Callable

    from geograph.incremental.chain import Chain
    from geograph.incremental.model import Measured


# Linearisations that follow one another at most.
_ROUNDS = 8


def check(state: State) -> None:
    """Bring all estimates up to date, and linearise again what moved too far."""
    model, chain = state.running
    assert state.limits is not None
    for _ in range(_ROUNDS):
        chain.solve_all()
        moved = state.limits.moved(chain, 0)
        if not moved:
            break
        model.renew(chain, moved)
        chain.eliminate()
    state.checked = len(chain.knots_s) + chain.gone


def look_over(state: State, *, limits_later: bool = False) -> None:
    """Weigh again what depends on how much there is, choose outliers, and renew the limits.

    Parameters
    ----------
    state
        Changed in place.
    limits_later
        Whether the limits are left to the next update, so that none takes too long.
    """
    model, chain = state.running
    if state.limits is None:
        state.limits = limits(model, chain, state.total_rows)
    if _weights_changed(state):
        _weigh_again(state)
    check(state)
    if state.running[0].loss.name != "none":
        _settle(state)
    if state.robust:
        _choose(state)
    knots = len(chain.knots_s) + chain.gone
    state.reviewed = knots
    state.limits_due = limits_later
    if not limits_later:
        renew_limits(state)


def renew_limits(state: State) -> None:
    """Set how far estimates may move by the newest measurements."""
    model, chain = state.running
    state.limits = limits(model, chain, state.total_rows)
    state.limits_due = False


def _settle(state: State) -> None:
    """Weigh everything by the loss again until the newest estimate stands."""
    model, chain = state.running

    def weigh() -> None:
        model.renew(chain, range(len(chain.pieces)))
        chain.eliminate()
        chain.solve_all()

    until_it_stands(chain, weigh, _ROUNDS)


def until_it_stands(chain: Chain, weigh: Callable[[], None], rounds: int) -> None:
    """Solve again and again, until the newest estimate moves by less than the tolerance.

    Parameters
    ----------
    chain
        Whose estimate it is.
    weigh
        Linearises, with the weights of the estimate so far, and eliminates.
    rounds
        How often at most.
    """
    for _ in range(rounds):
        assert chain.final is not None
        before = chain.final.step
        weigh()
        if chain.final.distance(before) < TOLERANCE:
            return


def _weights_changed(state: State) -> bool:
    """Tell whether measurements weigh by how many there are."""
    model, chain = state.running
    spread = bool(model.whole) and model.whole_s < chain.knots_s[-1] - model.since_s
    return model.correlated or spread


def _weigh_again(state: State) -> None:
    model, chain = state.running
    state.model = model.reaching(chain)
    state.model.renew(chain, range(len(chain.pieces)))
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
        model.renew(chain, sorted(changed))
        chain.eliminate()
        check(state)


def everything(state: State) -> list[Measured]:
    """Return all that is held, evaluated at the estimate."""
    model, chain = state.running
    path = model.motion.path(np.array(chain.knots_s))
    families, values = model.families(state.rows()), chain.values(0, len(chain.knots_s) - 1)
    return model.evaluate_families(families, path, values, 0, jacobian=False)
