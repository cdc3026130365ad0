"""What all measurement families have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.path import Path, PathState


@dataclass(frozen=True, eq=False)
class Values:
    """One point in the space of all unknowns.

    Attributes
    ----------
    path
        Shape (K, 3 order): states of the knots, SI units, in the recording's frame.
    walks
        Shape (K, w): random walks at the knots, scaled (see :mod:`geograph.states`).
    constants
        Shape (s,): constant sensor states over their prior sigmas.
    """

    path: NDArray[np.float64]
    walks: NDArray[np.float64]
    constants: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Whitened residuals of n measurements of r rows, and their derivatives.

    Attributes
    ----------
    residual
        Shape (n, r); rows that a measurement does not have are zero.
    interval
        Shape (n,), integer: the knot before each measurement.
    by_knots
        Shape (n, r, 2, 3 order), SI, or None where no derivatives were asked for.
    constant_row, constant_column, by_constants
        Shapes (e,), (e,), (e, r): entries of the derivative by constant states (scaled).
    walk_row, walk_column, walk_fraction, by_walks
        Shapes (f,), (f,), (f,), (f, r): entries of the derivative by the walks' values (scaled);
        the knot before has the share 1 - fraction of it, the knot after the share fraction.
    """

    residual: NDArray[np.float64]
    interval: NDArray[np.int64]
    by_knots: NDArray[np.float64] | None
    constant_row: NDArray[np.int64]
    constant_column: NDArray[np.int64]
    by_constants: NDArray[np.float64]
    walk_row: NDArray[np.int64]
    walk_column: NDArray[np.int64]
    walk_fraction: NDArray[np.float64]
    by_walks: NDArray[np.float64]


_NO_INDEX = np.empty(0, dtype=np.int64)


def path_only_evaluation(
    residual: NDArray[np.float64],
    interval: NDArray[np.int64],
    by_knots: NDArray[np.float64] | None,
) -> Evaluation:
    """Return the evaluation of measurements that no sensor state touches."""
    none = np.empty((0, residual.shape[1]))
    return Evaluation(
        residual, interval, by_knots, _NO_INDEX, _NO_INDEX, none, _NO_INDEX, _NO_INDEX,
        np.empty(0), none,
    )  # fmt: skip


class Family(ABC):
    """One kind of measurement: keys, prediction with derivatives, noise."""

    name: str
    """Name of the table that the measurements come from."""

    rows: int
    """Residual rows of one measurement."""

    time_s: NDArray[np.float64]
    """Shape (n,): nominal times, seconds."""

    line: NDArray[np.int64]
    """Shape (n,): lines in the file."""

    row_count: int
    """Scalar measurements in all (rows that exist)."""

    def __len__(self) -> int:
        return int(self.time_s.size)

    @abstractmethod
    def evaluate(
        self, path: Path, state: PathState, values: Values, *, jacobian: bool
    ) -> Evaluation:
        """Evaluate all measurements at one point."""

    @abstractmethod
    def subset(self, index: NDArray[np.int64]) -> Family:
        """Return the family of some of its measurements."""

    def refresh(self, path: Path, values: Values) -> None:  # noqa: B027 - most hold nothing fixed
        """Bring what is held fixed during a solve up to date with an estimate.

        Noise that depends on the geometry, and the times at which walks are read, are constants of
        one solve; the smoother calls this between solves until they no longer change.
        """
