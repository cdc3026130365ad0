"""Knots for what arrives: where signals were emitted, and knots where there are none yet."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from geograph.factors.kinematics import transition
from geograph.incremental.rows import CONSTRAINTS, FIXES, choose, join, take, time_column
from geograph.incremental.start import empty_piece
from geograph.knots import CLOSE
from geograph.states import CLOCK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.incremental.chain import Chain
    from geograph.incremental.model import Model
    from geograph.incremental.rows import Columns, Rows

# Below this speed of a signal the object's way during its travel counts.
_SLOW_M_S = 1e5
_ROUNDS = 3

# What was received so many spacings before the newest knot is looked for along the path.
_OLD = 8.0

_REACH = 8

# Rows in an interval of an object that stands still.
_FULL = 64


def emission_times(model: Model, chain: Chain, kind: str, columns: Columns) -> NDArray[np.float64]:
    """Return about when signals were emitted, shape (n,), good enough to place knots."""
    tag = np.asarray(columns[time_column(kind)], dtype=np.float64)
    if kind in CONSTRAINTS or kind == FIXES:
        return tag
    prepared = model.prepared
    speed = prepared.recording.propagation_speed_m_s
    old_s = chain.knots_s[-1] - _OLD * model.spacing_s
    if kind == "bearings" and model.fixed is not None and speed >= _SLOW_M_S:
        emitted = model.fixed.departures(chain, columns, speed)
        if emitted.min() >= old_s:
            return emitted
    states = prepared.states
    heard = columns.get("reference", columns["sensor"])
    received = tag
    constants = np.append(chain.constants * states.sigma, 0.0)
    row = states.stretches.row(heard, tag)
    bias, drift = states.bias_column[row, CLOCK], states.drift_column[row, CLOCK]
    if (bias >= 0).any() or (drift >= 0).any():
        received = tag - constants[bias] - constants[drift] * (tag - states.since_s[row, CLOCK])
    walk = states.walk_column[heard, CLOCK]
    if (walk >= 0).any():
        value = np.append(chain.chains[-1][: len(states.walks)] * prepared.walk_scale[
            : len(states.walks)], 0.0)  # fmt: skip
        received = received - value[walk]
    if not np.isfinite(speed):
        return received
    place = prepared.geometry.motion(heard, received).position_m
    last = chain.path[-1]
    at = last[:3]
    if last.size > 3:
        at = at + (received - chain.knots_s[-1])[:, None] * last[3:6]
    emitted = received - np.linalg.norm(at - place, axis=1) / speed
    if speed < _SLOW_M_S or received.min() < old_s:
        path, values = model.motion.path(np.array(chain.knots_s)), np.array(chain.path)
        for _ in range(_ROUNDS):
            at = model.motion.read(path, values, emitted)[:, :3]
            emitted = received - np.linalg.norm(at - place, axis=1) / speed
    columns["delay_s"] = received - emitted
    return np.asarray(emitted)


def make_room(model: Model, chain: Chain, times_s: list[float]) -> set[int]:
    """Put knots where signals were emitted and there are none; return the pieces that changed.

    The last knot is moved to the newest emission until its interval has the spacing; then it stays
    and a new one follows. One that stands too near to the knot before does not stay, and the
    interval becomes longer. An interval that is longer, over a gap, is divided where something
    arrives in it after all.

    Parameters
    ----------
    model, chain
        The chain is changed in place.
    times_s
        Times of emission, growing.
    """
    spacing = model.spacing_s
    changed: set[float] = set()
    last = chain.knots_s[-1]
    for time in times_s[: bisect_left(times_s, last)]:
        k = bisect_right(chain.knots_s, time) - 1
        if k < 0:
            continue
        before, after = chain.knots_s[k], chain.knots_s[k + 1]
        near = min(time - before, after - time)
        if after - before > spacing * (1.0 + 1e-9) and near > CLOSE * spacing:
            _divide(model, chain, k, time)
            changed |= {before, time}
    beyond = times_s[bisect_right(times_s, last) :]
    if beyond:
        changed |= _extend(model, chain, beyond)
    return {bisect_left(chain.knots_s, time) for time in changed}


def _extend(model: Model, chain: Chain, times: list[float]) -> set[float]:
    """Move the last knot and append others, until the last time is reached."""
    changed: set[float] = set()
    closed = _full(model, chain) or chain.knots_s[-1] <= model.changed_s
    first = 0
    if not closed:
        base, last = chain.knots_s[-2:]
        end = _end(model, times, 0, base=base, last=last)
        if end > last:
            _move_last(model, chain, end)
            changed.add(base)
            first = bisect_right(times, end)
    while first < len(times):
        base = chain.knots_s[-1]
        end = _end(model, times, first, base=base, last=base)
        _append(model, chain, end)
        changed.add(base)
        first = bisect_right(times, end)
    return changed


def _end(model: Model, times: list[float], first: int, *, base: float, last: float) -> float:
    """Return where an interval is to end, of which the last time is known so far.

    At the last of the times, from ``first`` on, that lie within the spacing of its base. If that is
    too near to the base to stay when others follow, at the next one: over so short a time the
    motion's noise may be less than what rounding leaves of coordinates.
    """
    end = first
    while end < len(times) and times[end] - base <= model.spacing_s:
        end += 1
    last = times[end - 1] if end > first else last
    if end == len(times) or last - base > CLOSE * model.spacing_s:
        return last
    return min(times[end], base + model.motion.longest_step_s)


def _full(model: Model, chain: Chain) -> bool:
    """Tell whether the last interval holds as much as one should of an object that stands still.

    Such an object needs no knots; but an update costs what the last interval holds.
    """
    rows = chain.pieces[-1].rows.values()
    return model.motion.static and sum(columns["ident"].size for columns in rows) >= _FULL


def _predicted(
    model: Model, chain: Chain, time_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the estimate of the newest knot carried on to a later time."""
    step, motion = time_s - chain.knots_s[-1], model.motion
    if motion.ballistic:
        since = np.array(chain.knots_s[-1:])
        path = motion.carried(chain.path[-1][None], np.array([step]), since)[0]
    else:
        path = (transition(motion.order, step) @ chain.path[-1].reshape(-1, 3)).ravel()
    states = model.prepared.states
    if not states.platforms:
        return path, chain.chains[-1]
    knots = np.array([chain.knots_s[-1], time_s])
    matrix, _ = states.chain_transitions(knots, model.prepared.walk_scale)
    return path, matrix[0] @ chain.chains[-1]


def _reference(model: Model, chain: Chain, path: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where the linear system of a new knot is written: at its estimate.

    Nothing drives an object that stands still, and there is no noise to take up a difference
    between the references of two knots: all have the same.
    """
    return chain.reference_path[0] if model.motion.static else path


def _move_last(model: Model, chain: Chain, time_s: float) -> None:
    path, chains = _predicted(model, chain, time_s)
    chain.knots_s[-1] = time_s
    chain.path[-1], chain.reference_path[-1] = path, _reference(model, chain, path)
    chain.chains[-1] = chain.reference_chains[-1] = chains


def _append(model: Model, chain: Chain, time_s: float) -> None:
    path, chains = _predicted(model, chain, time_s)
    chain.knots_s.append(time_s)
    chain.path.append(path)
    chain.reference_path.append(_reference(model, chain, path))
    chain.chains.append(chains)
    chain.reference_chains.append(chains)
    chain.pieces.append(empty_piece(model))


def _divide(model: Model, chain: Chain, k: int, time_s: float) -> None:
    """Put a knot into interval k."""
    pair = np.array(chain.knots_s[k : k + 2])
    values = chain.values(k, k + 1)
    path = model.motion.read(model.motion.path(pair), values.path, np.array([time_s]))[0]
    share = (time_s - pair[0]) / (pair[1] - pair[0])
    chains = (1.0 - share) * values.walks[0] + share * values.walks[1]
    chain.knots_s.insert(k + 1, time_s)
    for held, value in (
        (chain.path, path),
        (chain.reference_path, _reference(model, chain, path)),
        (chain.chains, chains),
        (chain.reference_chains, chains),
    ):
        held.insert(k + 1, value)
    chain.pieces.insert(k + 1, empty_piece(model))


def assign(chain: Chain, rows: Rows, times: dict[str, NDArray[np.float64]]) -> dict[int, Rows]:
    """Return rows by the interval that they go into.

    Arrivals of an emission that is held go where it is, so that their unknown time is one.
    """
    result: dict[int, Rows] = {}
    last = len(chain.pieces) - 1
    for kind, columns in rows.items():
        found = [bisect_right(chain.knots_s, time) - 1 for time in times[kind].tolist()]
        held = [min(max(k, 0), last) for k in found]
        if kind != "arrivals" and all(a <= b for a, b in pairwise(held)):
            # In the order of time, as they mostly come: parts are slices.
            ends = [i for i in range(1, len(held)) if held[i] != held[i - 1]]
            for first, end in pairwise([0, *ends, len(held)]):
                part = {kind: take(columns, slice(first, end)) if ends else columns}
                before = result.get(held[first])
                result[held[first]] = part if before is None else join([before, part])
            continue
        at = np.array(held)
        if kind == "arrivals":
            _with_siblings(chain, columns, at)
        for k in np.unique(at).tolist():
            part = choose({kind: columns}, {kind: at == k})
            result[k] = join([result.get(k, {}), part])
    return result


def _with_siblings(chain: Chain, columns: Columns, at: NDArray[np.int64]) -> None:
    emission = columns["emission"]
    low, high = max(int(at.min()) - _REACH, 0), min(int(at.max()) + _REACH, len(chain.pieces) - 1)
    for k in range(low, high + 1):
        held = chain.pieces[k].rows.get("arrivals")
        if held is not None:
            at[np.isin(emission, held["emission"])] = k
    # New ones of one emission stay together.
    for number in np.unique(emission).tolist():
        own = emission == number
        at[own] = at[own].min()
