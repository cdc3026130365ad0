"""What all measurement families have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.blocks import Sums
    from geograph.common import Common
    from geograph.path import Path, PathState


@dataclass(frozen=True, eq=False)
class Values:
    """One point in the space of all unknowns.

    Attributes
    ----------
    path
        Shape (K, 3 order): states of the knots, SI units, in the recording's frame.
    walks
        Shape (K, w): chains at the knots, random walks and platforms, scaled (see
        :mod:`geograph.states`).
    constants
        Shape (s,): constant sensor states over their prior sigmas.
    """

    path: NDArray[np.float64]
    walks: NDArray[np.float64]
    constants: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ByPosition:
    """Derivatives by both neighbours' states, of measurements of a position, or of a velocity too.

    Attributes
    ----------
    weights
        Shape (n, 2 order): of the blocks of the knot before and of the one after.
    by_position
        Shape (n, r, 3), SI.
    start
        Shape (g,): first measurements of groups of the same emission, which have the same weights;
        None: each has its own.
    rates, by_velocity
        The same for the velocity, or None.
    """

    weights: NDArray[np.float64]
    by_position: NDArray[np.float64]
    start: NDArray[np.int64] | None = None
    rates: NDArray[np.float64] | None = None
    by_velocity: NDArray[np.float64] | None = None

    def expanded(self) -> NDArray[np.float64]:
        """Return the derivatives themselves, shape (n, r, 2, 3 order)."""
        count, rows, _ = self.by_position.shape
        product = self.weights[:, None, :, None] * self.by_position[:, :, None, :]
        if self.rates is not None and self.by_velocity is not None:
            product += self.rates[:, None, :, None] * self.by_velocity[:, :, None, :]
        return product.reshape(count, rows, 2, -1)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Whitened residuals of n measurements of r rows, and their derivatives.

    Attributes
    ----------
    residual
        Shape (n, r); rows that a measurement does not have are zero.
    interval
        Shape (n,), integer: the knot before each measurement.
    by_path
        Derivatives by the knots' states, SI: shape (n, r, 2, 3 order), or their factors; None where
        no derivatives were asked for.
    constant_row, constant_column, by_constants
        Shapes (e,), (e,), (e, r): entries of the derivative by constant states (scaled).
    walk_row, walk_column, walk_before, walk_after, by_walks
        Shapes (f,), four times, and (f, r): entries of the derivative by the chains' values
        (scaled), with the weights of the knot before and of the one after.
    common
        Unknowns that a few measurements share, or None.
    """

    residual: NDArray[np.float64]
    interval: NDArray[np.int64]
    by_path: NDArray[np.float64] | ByPosition | None
    constant_row: NDArray[np.int64]
    constant_column: NDArray[np.int64]
    by_constants: NDArray[np.float64]
    walk_row: NDArray[np.int64]
    walk_column: NDArray[np.int64]
    walk_before: NDArray[np.float64]
    walk_after: NDArray[np.float64]
    by_walks: NDArray[np.float64]
    common: Common | None = None

    @cached_property
    def by_knots(self) -> NDArray[np.float64] | None:
        """Shape (n, r, 2, 3 order), SI: derivatives by the knots' states, if there are any."""
        return self.by_path.expanded() if isinstance(self.by_path, ByPosition) else self.by_path

    def settled(self, residual: NDArray[np.float64], common: Common) -> Evaluation:
        """Return the same with other residuals, of shared unknowns that are elsewhere."""
        return Evaluation(
            residual,
            self.interval,
            self.by_path,
            self.constant_row,
            self.constant_column,
            self.by_constants,
            self.walk_row,
            self.walk_column,
            self.walk_before,
            self.walk_after,
            self.by_walks,
            common,
        )


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
        np.empty(0), np.empty(0), none,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Report:
    """What n measurements of r rows were, and what the estimate makes of them.

    Attributes
    ----------
    kinds, units
        Of each row, r of them: what was measured, in which SI unit.
    exists
        Shape (n, r): which rows there are.
    measured, predicted, sigma
        Shape (n, r), in those units; the prediction includes the sensors' estimated errors.
    normalised
        Shape (n, r): residual (measured less predicted) over its sigma.
    """

    kinds: tuple[str, ...]
    units: tuple[str, ...]
    exists: NDArray[np.bool_]
    measured: NDArray[np.float64]
    predicted: NDArray[np.float64]
    sigma: NDArray[np.float64]
    normalised: NDArray[np.float64]


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
    """Scalar measurements in all (rows that exist, less the unknowns that rows share)."""

    def __len__(self) -> int:
        return int(self.time_s.size)

    @abstractmethod
    def evaluate(
        self, path: Path, state: PathState, values: Values, *, jacobian: bool
    ) -> Evaluation:
        """Evaluate all measurements at one point."""

    def add_to(
        self,
        total: Sums | None,
        path: Path,
        state: PathState,
        values: Values,
        *,
        weight: NDArray[np.float64] | None,
        scale: NDArray[np.float64],
    ) -> float | None:
        """Add all measurements up at once, without a loss; return their cost.

        None, which is what families do that know no such way: they were not.

        Parameters
        ----------
        total
            Sums of products that are added to, as by :meth:`geograph.blocks.BlockSum.add`; None:
            the cost is all that is asked for.
        path, state, values
            The point.
        weight
            Shape (n,): fixed weights, or None.
        scale
            Shape (size,): scales of the path's components, SI.
        """
        del total, path, state, values, weight, scale
        return None

    @abstractmethod
    def subset(self, index: NDArray[np.int64]) -> Family:
        """Return the family of some of its measurements."""

    def refresh(self, path: Path, values: Values) -> None:  # noqa: B027 - most hold nothing fixed
        """Bring what is held fixed during a solve up to date with an estimate.

        Noise that depends on the geometry, and the times at which walks are read, are constants of
        one solve; the smoother calls this between solves until they no longer change.
        """


class SensorFamily(Family):
    """One kind of measurement that sensors took; its outliers are found and rejected."""

    sensor: NDArray[np.int64]
    """Shape (n,): index of the sensor."""

    reference: NDArray[np.int64] | None = None
    """Shape (n,): index of the sensor that it is a difference to, if it is one."""

    row_counts: NDArray[np.int64]
    """Shape (n,): rows of each measurement."""

    weight: NDArray[np.float64]
    """Shape (n,): weights of the information, for correlated errors."""

    path_noise_m: NDArray[np.float64]
    path_noise_m_s: NDArray[np.float64]
    """Shape (n,): what position and velocity may deviate by between knots; for :meth:`refresh`."""

    @abstractmethod
    def expect_delays(self, delay_s: NDArray[np.float64]) -> None:
        """Start the next evaluation from delays of the signals, shape (n,), seconds."""

    @property
    @abstractmethod
    def emitted_s(self) -> NDArray[np.float64]:
        """Shape (n,): times of emission as the last evaluation found them."""

    @abstractmethod
    def squares(self, found: Evaluation) -> NDArray[np.float64]:
        """Return squared whitened residuals, shape (n,), the weights for correlation taken out."""

    @abstractmethod
    def emissions(
        self, path: Path, values: Values
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return distances from the sensors (m) and times of emission (s), each shape (n,)."""

    @abstractmethod
    def resolution_m(
        self, distance_m: NDArray[np.float64], speed_m_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return about how well each measurement alone locates the object, shape (n,), metres.

        Parameters
        ----------
        distance_m
            Shape (n,): from the sensor.
        speed_m_s
            Shape (n,): of the object against the sensor.
        """

    def velocity_resolution_m_s(self) -> NDArray[np.float64] | None:
        """Return how well each measurement resolves a velocity, shape (n,); None: not at all."""
        return None

    @abstractmethod
    def clock_resolution_s(
        self, distance_m: NDArray[np.float64], speed_m_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return how well each measurement resolves its sensor's clock, shape (n,), seconds.

        Parameters
        ----------
        distance_m, speed_m_s
            As of :meth:`resolution_m`.
        """

    @abstractmethod
    def report(self, path: Path, values: Values, found: Evaluation) -> Report:
        """Return what was measured and predicted, at an estimate and its evaluation."""
