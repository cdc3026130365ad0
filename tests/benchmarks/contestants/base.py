"""What a contestant has to do."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    import numpy as np
    from model import Pass
    from numpy.typing import NDArray

TOLERANCE = 1e-9
"""Relative decrease of the cost at which every contestant ends."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """What a contestant found, SI units.

    Attributes
    ----------
    path
        Shape (K, 9).
    errors
        Shape (S, 4): of the sensors.
    iterations
        Linear systems solved.
    """

    path: NDArray[np.float64]
    errors: NDArray[np.float64]
    iterations: int


@dataclass(frozen=True)
class Stages:
    """Seconds that one iteration takes, at the estimate."""

    linearise_s: float
    eliminate_s: float


class Run(ABC):
    """One solve of one pass, set up and ready; each method is called once, in this order."""

    @abstractmethod
    def solve(self) -> Estimate:
        """Solve from the first guess."""

    @abstractmethod
    def marginals(self) -> NDArray[np.float64]:
        """Return the marginal covariances of all knots, SI units, shape (K, 9, 9)."""

    def stages(self) -> Stages | None:
        """Return how long the parts of an iteration take, or None where they are not parted."""
        return None


class Contestant(ABC):
    """A way to smooth a pass."""

    name: ClassVar[str]
    """On the command line and in the table."""

    about: ClassVar[str]
    """In one line."""

    too_slow: ClassVar[frozenset[str]] = frozenset({"huge"})
    """Sizes that are left out unless all are asked for."""

    same_cost: ClassVar[bool] = True
    """Whether it minimises the cost of the model (a filter, say, does not)."""

    bearings_only: ClassVar[bool] = False
    """Whether it can do nothing with arrivals and frequency differences."""

    @classmethod
    def missing(cls) -> str | None:
        """Return what has to be installed for it, or None."""
        return None

    @abstractmethod
    def set_up(self, data: Pass) -> Run:
        """Turn a pass into whatever is solved."""
