"""What an incremental smoother holds, and how an update changes a copy of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.incremental.estimate import RowName
from geograph.incremental.rows import FIXES, TABLES, choose, join, keys, take, time_column
from geograph.incremental.start import (
    fixes_between,
    held_shift,
    with_rows,
)

if TYPE_CHECKING:
    from collections.abc import Set

    from geograph.incremental.chain import Chain
    from geograph.incremental.curvature import Limits
    from geograph.incremental.model import Model
    from geograph.incremental.rows import Columns, Rows
    from geograph.initialise import PathFit
    from geograph.knots import Resolution
    from geograph.recording import Recording, SmoothSettings
    from geograph.rivals import Attempt


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
    limits, limits_due
        When to linearise again, and whether that is to be found anew.
    attempts, resolution
        Of the last start.
    rivals, guessed
        The paths that fit where there are several, and the measurements there were when first
        guesses were last looked for.
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
    rivals: tuple[PathFit, ...] = ()
    guessed: int = 0
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
    limits_due: bool = False
    rebuilt: int = 0
    reach_s: float | None = None
    duplicates: int = 0
    late: int = 0
    newly_duplicate: Rows = field(default_factory=dict)
    newly_late: Rows = field(default_factory=dict)
    out: dict[int, bool] = field(default_factory=dict)
    names: dict[int, RowName] = field(default_factory=dict)
    dropped: list[Rows] = field(default_factory=list)

    def copy(self, *, share: bool = False) -> State:
        """Return a state that may be changed without changing this one.

        Parameters
        ----------
        share
            Whether its chain is this one's, not to be changed.
        """
        made = object.__new__(State)
        vars(made).update(vars(self))
        if self.chain is not None and not share:
            made.chain = self.chain.copy()
        made.out, made.names = dict(self.out), dict(self.names)
        made.dropped = list(self.dropped)
        return made

    def afresh(self, *, share: bool = False) -> State:
        """Return a copy for a new update; see :meth:`copy`."""
        made = self.copy(share=share)
        made.reach_s, made.dropped = None, []
        made.newly_duplicate, made.newly_late = {}, {}
        return made

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


def note(state: State, kind: str, columns: Columns) -> None:
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
                note(state, kind, take(rows[kind], own))
        if k in changed:
            chain.pieces[k] = replace(piece, rows=rows)
    if kept:
        for ident in idents:
            state.out.pop(ident, None)
            state.names.pop(ident, None)
    return changed


def recount(state: State) -> None:
    """Count the scalar rows that are held."""
    state.total_rows = sum(scalars(kind, c) for kind, c in state.rows().items())


def scalars(kind: str, columns: Columns) -> int:
    """Return how many numbers rows of a kind hold, about."""
    return int(columns["ident"].size) * (2 if kind == "bearings" else 1)


def count_rows(state: State, rows: Rows) -> None:
    """Count rows, for what weighs by their number, and for the clocks' common time."""
    model, chain = state.running
    now = with_rows(model, rows)
    if now.shift is not model.shift:
        chain.hold = held_shift(now, chain.reference)
    state.model = now
    state.total_rows += sum(scalars(kind, columns) for kind, columns in rows.items())


def with_fixes(state: State, rows: Rows) -> Rows:
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


def without_duplicates(known: Set[Any], rows: Rows) -> tuple[Rows, Rows, Set[Any]]:
    """Return rows that are new, those that came before or twice, and the keys of the new ones."""
    every = [key for kind, columns in rows.items() for key in keys(kind, columns)]
    own: set[Any] = set(every)
    added = own - known
    if len(added) == len(every):
        return rows, {}, added
    own = set()
    new = {}
    for kind, columns in rows.items():
        mask = np.ones(columns["ident"].size, dtype=bool)
        for index, key in enumerate(keys(kind, columns)):
            mask[index] = key not in own and key not in known
            own.add(key)
        new[kind] = mask
    return choose(rows, new), choose(rows, {kind: ~mask for kind, mask in new.items()}), added
