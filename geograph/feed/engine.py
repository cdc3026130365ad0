"""What a feed needs of an engine; :class:`geograph.IncrementalSmoother` is one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from geograph.measurements import Constraints, Measurements
    from geograph.recording import Frame
    from geograph.track import SensorEstimate, Track


class Estimate(Protocol):
    """The newest knot; see :class:`geograph.Estimate`."""

    @property
    def time_s(self) -> float | None:
        """Time of the newest knot, seconds; None before there is one."""

    @property
    def state(self) -> NDArray[Any] | None:
        """Shape (3 m,): position, velocity, acceleration as far as the motion has them."""

    @property
    def covariance(self) -> NDArray[Any] | None:
        """Shape (3 m, 3 m)."""

    @property
    def frame(self) -> Frame:
        """Frame of the state."""

    @property
    def status(self) -> str:
        """How far it is."""

    @property
    def message(self) -> str:
        """What is missing, or what happened, in one sentence."""

    @property
    def sensor_errors(self) -> Mapping[str, Mapping[str, SensorEstimate]]:
        """Errors of every sensor, by state."""

    @property
    def used(self) -> int:
        """Measurements that count."""

    @property
    def waiting(self) -> Sequence[object]:
        """Names of those that do not fit and wait for later ones to judge them."""

    @property
    def rejected(self) -> Sequence[object]:
        """Names of those that later ones spoke against."""

    @property
    def late(self) -> Sequence[object]:
        """Names of those of the last update that came after the lag."""

    @property
    def rejected_count(self) -> int:
        """Rejected in all."""

    @property
    def late_count(self) -> int:
        """Late in all."""

    @property
    def duplicate_count(self) -> int:
        """How many came again, in all."""

    @property
    def rebuilt(self) -> int:
        """How often the engine had to make its linear system anew."""


class Engine(Protocol):
    """An incremental smoother, whose updates succeed or leave it as it was."""

    def update(self, measurements: Iterable[Measurements | Constraints]) -> Estimate:
        """Use measurements."""

    @property
    def estimate(self) -> Estimate:
        """The newest estimate, without work."""

    def track(self) -> Track:
        """Return all knots that are held."""

    def finish(self) -> Estimate:
        """Use what still waits."""


def started(estimate: Estimate) -> bool:
    """Whether there is a knot yet."""
    return estimate.time_s is not None and bool(np.isfinite(estimate.time_s))
