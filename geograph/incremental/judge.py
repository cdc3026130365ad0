"""Which measurements count: gross outliers wait, and are admitted or rejected by what comes later.

A measurement that the estimate does not predict is tried against it: with innovation r, derivatives
J and the covariance P of the unknowns without it, d^2 = r'(1 + J P J')^-1 r. The limits are those
of the batch (:mod:`geograph.robust`), and so is the choice among all that is held, made again as
the pass grows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.blocks import dense_rows
from geograph.common import settled
from geograph.families import SensorFamily
from geograph.incremental.intervals import Seen
from geograph.incremental.rows import TABLES
from geograph.losses import Loss
from geograph.robust import plain_limits, thresholds

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from geograph.incremental.chain import Chain
    from geograph.incremental.model import Measured, Model

_KINDS = tuple(TABLES)


def squares(part: Measured) -> NDArray[np.float64]:
    """Return squared whitened residuals, shape (n,), in the order of the rows.

    What measurements share is found so that one outlier does not move it.
    """
    assert isinstance(part.family, SensorFamily)
    found = part.found
    if found.common is not None:
        kept = part.columns["kept"][part.order].astype(np.float64)
        found = settled(found, kept, Loss("cauchy"))
    return part.by_row(part.family.squares(found))


def suspects(measured: Iterable[Measured | Seen], new: set[int], count: int) -> set[int]:
    """Return the numbers of new rows that the estimate does not predict.

    Parameters
    ----------
    measured
        With the new rows among them, at the prediction.
    new
        Numbers of the new rows.
    count
        Measurements so far.
    """
    found: set[int] = set()
    for part in measured:
        if isinstance(part, Seen):
            square = np.einsum("ij,ij->i", part.residual, part.residual)
            # Most fit, even if they had but one row: that limit is the lowest.
            if not square.size or square.max() <= _least_limit(count):
                continue
            rows = np.where(np.isnan(part.columns["elevation_rad"]), 1, 2)
            limit = plain_limits(count, rows)
        elif isinstance(part.family, SensorFamily):
            square = squares(part)
            limit = part.by_row(plain_limits(count, part.family.row_counts))
        else:
            continue
        far = (square > limit) & part.columns["kept"]
        found |= set(part.columns["ident"][far].tolist()) & new
    return found


def _least_limit(count: int) -> float:
    return float(plain_limits(count, np.ones(1, dtype=np.int64))[0])


def innovations(
    model: Model, chain: Chain, measured: Iterable[Measured], idents: set[int]
) -> dict[int, float]:
    """Return d^2 over its limit for rows that do not count, by their numbers; limits for one row.

    Parameters
    ----------
    model, chain
        After an elimination without these rows.
    measured
        With these rows, at the estimate.
    idents
        Numbers of the rows.
    """
    result: dict[int, float] = {}
    for part in measured:
        ident = part.columns["ident"][part.order]
        chosen = np.flatnonzero(np.isin(ident, list(idents)))
        if not chosen.size or not isinstance(part.family, SensorFamily):
            continue
        rows = dense_rows(part.found, model.layout, model.path_scale)
        residual, rows = part.found.residual, rows[:, :, :-1]
        own = np.ones(ident.size)
        common = part.found.common
        if common is not None:
            # What the rows that count say of the shared unknown moves with the estimate.
            weight = np.ones(ident.size) if common.weight is None else common.weight
            pull = common.sums((weight * common.by_common)[:, None] * rows[:, 0])
            hold = common.sums(weight * common.by_common**2) + common.information
            # Where no row of a group counts, nothing is said of its unknown.
            inverse = np.divide(1.0, hold, out=np.zeros_like(hold), where=hold > 0.0)
            share = (common.by_common * inverse[common.group])[:, None] * pull[common.group]
            rows = rows - share[:, None]
            own = np.maximum(1.0 - common.leverage(), 1e-6)
        interval = part.interval[part.order]
        for index in chosen.tolist():
            cov = pair_covariance(chain, int(interval[index]))
            spread = rows[index] @ cov @ rows[index].T
            size = spread.shape[0]
            exists = np.abs(rows[index]).any(axis=1)
            total = spread + own[index] * np.eye(size)
            r = residual[index]
            square = float(r[exists] @ np.linalg.solve(total[np.ix_(exists, exists)], r[exists]))
            result[int(ident[index])] = square / part.family.weight[index]
    return result


def pair_covariance(chain: Chain, k: int) -> NDArray[np.float64]:
    """Return the covariance of both knots of an interval and the constants, scaled."""
    found = chain.marginals(k)
    cross = found.neighbours[0]
    return np.block(
        [
            [found.knots[0], cross, found.knot_constants[0]],
            [cross.T, found.knots[1], found.knot_constants[1]],
            [found.knot_constants[0].T, found.knot_constants[1].T, found.constants],
        ]
    )


def choice(measured: list[Measured]) -> tuple[set[int], set[int]]:
    """Return which rows should count and do not, and the other way round, as a batch chooses.

    Parameters
    ----------
    measured
        All that is held, at the estimate.
    """
    parts = [part for part in measured if isinstance(part.family, SensorFamily)]
    if not parts:
        return set(), set()
    square, rows, code, ident, kept = [], [], [], [], []
    for part in parts:
        family = part.family
        assert isinstance(family, SensorFamily)
        square.append(part.family.squares(part.found))  # type: ignore[attr-defined]
        rows.append(family.row_counts)
        code.append(family.sensor + 1000000 * _KINDS.index(part.kind))
        ident.append(part.columns["ident"][part.order])
        kept.append(part.columns["kept"][part.order])
    _, group = np.unique(np.concatenate(code), return_inverse=True)
    total, number = np.concatenate(square), np.concatenate(ident)
    good = total <= thresholds(total, np.concatenate(rows), group)
    now = np.concatenate(kept)
    return set(number[good & ~now].tolist()), set(number[~good & now].tolist())
