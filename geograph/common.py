"""Unknowns that a few measurements share and nothing else feels, eliminated exactly.

The arrivals of one emission share its time; time differences against one reference share the noise
of its arrival. With whitened residuals r and their derivatives a by such an unknown n, weights w,
and the information q that its prior holds, the cost is that of the best n,

    min over n of  sum w (r + a n)^2 + q n^2,   n = -(a'W r) / (a'W a + q),

and the derivatives J of the residuals by everything else count only as far as n cannot take them
up: J'W J - J'W a a'W J / (a'W a + q). That is the Schur complement of n, the same as the full
covariance of all differences (D. Torrieri, *Statistical theory of passive location systems*, IEEE
TAES 20, 1984, section IV), with no sensor in a special place. Rows are replaced so that products of
rows give that complement (:func:`project`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from geograph.kernels import compiled, flat, indices

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.families.base import Evaluation
    from geograph.losses import Loss

_ROUNDS = 100
_TOLERANCE = 1e-10


@dataclass(frozen=True, eq=False)
class Common:
    """The shared unknowns of measurements with one row each.

    Attributes
    ----------
    group
        Shape (n,), integer, growing: which unknown each measurement feels.
    start
        Shape (g,): first measurement of each group; groups are contiguous.
    by_common
        Shape (n,): derivative of each whitened residual by its unknown.
    information
        Shape (g,): q, the inverse variance of the unknown's prior, whose mean is zero.
    value
        Shape (g,): where the unknowns are (zero before :func:`settled`).
    weight
        Shape (n,): with which weights they were found there; None: ones.
    """

    group: NDArray[np.int64]
    start: NDArray[np.int64]
    by_common: NDArray[np.float64]
    information: NDArray[np.float64]
    value: NDArray[np.float64]
    weight: NDArray[np.float64] | None = None

    @property
    def cost(self) -> float:
        """What the priors of the unknowns add to the cost."""
        return 0.5 * float(self.information @ self.value**2)

    def sums(self, column: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return sums over the groups, shape (g, ...), of a column, shape (n, ...)."""
        return np.asarray(np.add.reduceat(column, self.start, axis=0))

    def leverage(self) -> NDArray[np.float64]:
        """Return the share of each residual's variance that its unknown takes up, shape (n,).

        Below zero where a measurement has less weight than the others of its group: it is then
        held against an unknown that has an error of its own.
        """
        square = self.by_common**2
        weight = np.ones_like(square) if self.weight is None else self.weight
        hold = self.sums(weight * square) + self.information
        spread = self.sums(weight**2 * square) + self.information
        # Where every measurement of a group is left out, nothing was taken up.
        inverse = np.divide(1.0, hold, out=np.zeros_like(hold), where=hold > 0.0)
        share = 2.0 * weight * inverse[self.group] - (spread * inverse**2)[self.group]
        return np.asarray(square * share)


def settled(found: Evaluation, weight: NDArray[np.float64] | None, loss: Loss) -> Evaluation:
    """Return an evaluation with its shared unknowns at their best.

    Parameters
    ----------
    found
        As the family evaluated it.
    weight
        Shape (n,): fixed weights, or None.
    loss
        Of each measurement; its weights are found together with the unknowns.
    """
    common = found.common
    if common is None or not found.residual.size:
        return found
    if compiled is not None and loss.name == "none":
        return _settled_compiled(found, common, weight)
    residual = found.residual[:, 0]
    slope = np.asarray(common.by_common)
    fixed = np.ones_like(residual) if weight is None else weight
    value = common.value
    factor = fixed
    for _ in range(_ROUNDS):
        if loss.name != "none":
            now = residual + slope * (value - common.value)[common.group]
            factor = fixed * loss.value_and_weight(now**2)[1]
        pull = common.sums(factor * slope * (residual - slope * common.value[common.group]))
        hold = common.sums(factor * slope**2) + common.information
        before = value
        # Where every measurement of a group is left out, nothing moves its unknown.
        value = np.divide(-pull, hold, out=before.copy(), where=hold > 0.0)
        moved = np.abs(value - before) * np.sqrt(hold)
        if loss.name == "none" or not moved.max(initial=0.0) > _TOLERANCE:
            break
    changed = residual + slope * (value - common.value)[common.group]
    common = replace(common, value=value, weight=factor)
    return found.settled(changed[:, None], common)


def _settled_compiled(
    found: Evaluation, common: Common, weight: NDArray[np.float64] | None
) -> Evaluation:
    """Do what :func:`settled` does, without a loss, in compiled code."""
    count, groups = common.group.size, common.start.size
    value, changed = np.empty(groups), np.empty((count, 1))
    compiled.settle(
        *(count, groups, indices(common.start), flat(found.residual), flat(common.by_common)),
        *map(flat, (weight, common.information, common.value)),
        *(value, changed),
    )
    held = Common(common.group, common.start, common.by_common, common.information, value, weight)
    return found.settled(changed, held)


def project(
    rows: NDArray[np.float64],
    by_common: NDArray[np.float64],
    group: NDArray[np.int64],
    start: NDArray[np.int64],
    information: NDArray[np.float64],
) -> None:
    """Take up what shared unknowns can of weighted rows, in place.

    The rows M become (I - b a a') M with (I - b a a')^2 = I - a a' / (a'a + q); the residuals, the
    last column, become (I - b a a')^-1 r, so that the gradient M'r stays what it is: that of the
    unknown at its best.

    Parameters
    ----------
    rows
        Shape (n, width): derivatives, and residuals as the last column, all weighted.
    by_common
        Shape (n,): a, weighted alike.
    group, start, information
        As in :class:`Common`, for these rows.
    """
    square = np.add.reduceat(by_common**2, start)
    total = square + information
    # Where every measurement of a group is left out, and it has no prior, nothing is taken up.
    held = np.divide(information, total, out=np.ones_like(total), where=total > 0.0)
    root = np.sqrt(held)
    share = np.divide(1.0 / (1.0 + root), total, out=np.zeros_like(total), where=total > 0.0)
    # With no prior the residuals are orthogonal to a already.
    back = np.divide(-share, root, out=np.zeros_like(total), where=information > 0.0)
    taken = np.add.reduceat(by_common[:, None] * rows, start, axis=0)
    taken[:, :-1] *= share[:, None]
    taken[:, -1] *= back
    rows -= by_common[:, None] * taken[group]
