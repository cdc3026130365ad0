"""What is measured of an object's signals, and the tables that this makes.

A plan says when the object emits (or, for bearings, when sensors look), who receives, and how well.
A recording follows from any number of plans.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.measurements import Arrivals, FrequencyDifferences, TimeDifferences

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.scenarios.radio_errors import Histories
    from geograph.scenarios.radio_reception import Received

Sigma = float | tuple[float, ...]
"""Standard deviation of one reception: one for all receivers of a recording, or one for each."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ArrivalPlan:
    """Times of arrival of emissions, in sets.

    Parameters
    ----------
    emission_time_s
        Shape (n,), sorted, seconds.
    receivers
        Indices of those that listen.
    sigma_s
        White noise of an arrival time.
    hearing
        Probability that a receiver hears an emission, each independently.
    fewest
        Sets with fewer arrivals are left out.
    most
        Of larger sets so many arrivals are kept, at random; None: all.
    outliers
        Number of gross errors among all arrivals that are left.
    outlier_s
        Size of a gross error: between half and all of this, early or late.
    """

    emission_time_s: NDArray[np.float64]
    receivers: tuple[int, ...]
    sigma_s: Sigma
    hearing: float = 1.0
    fewest: int = 2
    most: int | None = None
    outliers: int = 0
    outlier_s: float = 1e-5


@dataclass(frozen=True, eq=False, kw_only=True)
class PairPlan:
    """What is measured of the same signals at pairs of receivers.

    Parameters
    ----------
    emission_time_s
        Shape (n,), sorted, seconds.
    pairs
        Indices of (sensor, reference).
    shared
        Whether all differences of one emission against one reference have the noise of the
        reference's own reception in common. Otherwise every difference is measured on its own.
    kept
        Probability that a difference was measured at all.

    Raises
    ------
    ValueError
        If noise is shared and a receiver stands in two pairs other than as their reference: these
        would be correlated in a way that a table cannot say.
    """

    emission_time_s: NDArray[np.float64]
    pairs: tuple[tuple[int, int], ...]
    shared: bool = True
    kept: float = 1.0

    def __post_init__(self) -> None:
        _check_pairs(self.pairs, shared=self.shared)

    @property
    def receivers(self) -> tuple[int, ...]:
        """Indices of all that receive, each once."""
        return tuple(sorted({index for pair in self.pairs for index in pair}))


@dataclass(frozen=True, eq=False, kw_only=True)
class TimePlan(PairPlan):
    """Differences of arrival time between pairs of receivers.

    Parameters
    ----------
    sigma_s
        White noise of one arrival; a difference has the noise of both.
    """

    sigma_s: Sigma


@dataclass(frozen=True, eq=False, kw_only=True)
class FrequencyPlan(PairPlan):
    """Differences of received frequency between pairs of receivers.

    Parameters
    ----------
    carrier_hz
        Frequency that the object emits.
    sigma_hz
        White noise of one received frequency.
    """

    carrier_hz: float
    sigma_hz: Sigma


@dataclass(frozen=True, eq=False, kw_only=True)
class BearingPlan:
    """Bearings by the recording's other kind of sensor.

    Parameters
    ----------
    reception_time_s
        Shape (n,): true times, sorted, seconds; every sensor looks at all of them.
    receivers
        Indices of the sensors.
    sigma_rad
        White noise of azimuth and of elevation, isotropic on the sky.
    """

    reception_time_s: NDArray[np.float64]
    receivers: tuple[int, ...]
    sigma_rad: float


SignalPlan = ArrivalPlan | TimePlan | FrequencyPlan
Plan = SignalPlan | BearingPlan


@dataclass(frozen=True, eq=False)
class Rows:
    """What a table hides: each of shape (n,), by its rows.

    Parameters
    ----------
    emission_time_s
        When the signal left the object, seconds.
    reception_time_s
        When it arrived (at the reference, for a difference), seconds.
    exact
        What receivers without errors would have measured, in the table's unit; for bearings the
        azimuth.
    outlier
        Which rows are gross errors.
    """

    emission_time_s: NDArray[np.float64]
    reception_time_s: NDArray[np.float64]
    exact: NDArray[np.float64]
    outlier: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Grid:
    """All receptions of a plan: arrays of shape (emissions, receivers).

    Parameters
    ----------
    time_s
        Shape (emissions,): times of emission.
    delay_s, shift
        As of :class:`geograph.scenarios.radio_reception.Received`.
    errors
        Those of the receivers then.
    """

    time_s: NDArray[np.float64]
    delay_s: NDArray[np.float64]
    shift: NDArray[np.float64]
    errors: Histories

    @classmethod
    def of(cls, time_s: NDArray[np.float64], received: list[Received], errors: Histories) -> Grid:
        """Return the grid of what each receiver received."""
        return cls(
            time_s,
            np.stack([one.delay_s for one in received], axis=1),
            np.stack([one.shift for one in received], axis=1),
            errors,
        )


def arrival_table(
    plan: ArrivalPlan,
    grid: Grid,
    *,
    sensors: int,
    noise: np.random.Generator,
    gross: np.random.Generator,
) -> tuple[Arrivals, Rows]:
    """Return the arrivals of a plan and what they hide.

    Parameters
    ----------
    plan, grid
        What is received.
    sensors
        Number of sensors of the recording.
    noise, gross
        Sources of randomness of noise and hearing, and of gross errors.

    Raises
    ------
    ValueError
        If there are more gross errors than arrivals.
    """
    shape = grid.delay_s.shape
    sigma = np.broadcast_to(_sigmas(plan.sigma_s, sensors)[list(plan.receivers)], shape)
    error = sigma * noise.standard_normal(shape)
    heard = noise.uniform(size=shape) < plan.hearing
    # A random order among those that heard; the others come last.
    place = np.argsort(np.argsort(noise.uniform(size=shape) + ~heard, axis=1), axis=1)
    heard &= place < (shape[1] if plan.most is None else plan.most)
    heard &= (heard.sum(axis=1) >= plan.fewest)[:, None]
    row, column = np.nonzero(heard)
    if plan.outliers > row.size:
        raise ValueError(f"{plan.outliers} outliers of {row.size} arrivals")
    outlier = np.zeros(row.size, dtype=bool)
    outlier[gross.permutation(row.size)[: plan.outliers]] = True
    size = plan.outlier_s * gross.uniform(0.5, 1.0, row.size) * gross.choice([-1.0, 1.0], row.size)
    emitted = grid.time_s[row]
    exact = emitted + grid.delay_s[heard]
    toa = exact + grid.errors.clock_s[heard] + error[heard] + np.where(outlier, size, 0.0)
    _, emission = np.unique(row, return_inverse=True)
    table = Arrivals(
        emission=emission.astype(np.int64),
        sensor=np.asarray(plan.receivers, dtype=np.int64)[column],
        toa_s=toa,
        sigma_s=sigma[heard],
        line=np.zeros(row.size, dtype=np.int64),
    )
    return table, Rows(emitted, exact, exact, outlier)


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Differences of a plan: each of shape (n,)."""

    time_s: NDArray[np.float64]
    sensor: NDArray[np.int64]
    reference: NDArray[np.int64]
    exact: NDArray[np.float64]
    measured: NDArray[np.float64]
    sigma: NDArray[np.float64]
    sigma_reference: NDArray[np.float64]
    rows: Rows


def _differences(
    plan: TimePlan | FrequencyPlan,
    grid: Grid,
    *,
    value: NDArray[np.float64],
    error: NDArray[np.float64],
    sigma: NDArray[np.float64],
    noise: np.random.Generator,
) -> _Pairs:
    """Subtract receptions, shape (emissions, receivers), with their errors and noise."""
    sensor, reference = np.array(plan.pairs, dtype=np.int64).T
    where = {receiver: column for column, receiver in enumerate(plan.receivers)}
    one = np.array([where[int(index)] for index in sensor])
    other = np.array([where[int(index)] for index in reference])
    count = grid.time_s.size
    own = sigma[list(plan.receivers)] * noise.standard_normal((count, len(plan.receivers)))
    apart = noise.standard_normal((count, sensor.size))
    kept = noise.uniform(size=apart.shape) < plan.kept
    total = np.hypot(sigma[sensor], sigma[reference])
    white = own[:, one] - own[:, other] if plan.shared else total * apart
    exact = value[:, one] - value[:, other]
    measured = exact + error[:, one] - error[:, other] + white
    received = (grid.time_s[:, None] + grid.delay_s)[:, other]
    tag = received + grid.errors.clock_s[:, other]
    row, column = np.nonzero(kept)
    return _Pairs(
        time_s=tag[kept],
        sensor=sensor[column],
        reference=reference[column],
        exact=exact[kept],
        measured=measured[kept],
        sigma=total[column],
        sigma_reference=sigma[reference][column] if plan.shared else np.zeros(row.size),
        rows=Rows(grid.time_s[row], received[kept], exact[kept], np.zeros(row.size, dtype=bool)),
    )


def time_table(
    plan: TimePlan, grid: Grid, *, sensors: int, noise: np.random.Generator
) -> tuple[TimeDifferences, Rows]:
    """Return the time differences of a plan and what they hide; see :func:`arrival_table`."""
    found = _differences(
        plan,
        grid,
        value=grid.delay_s,
        error=grid.errors.clock_s,
        sigma=_sigmas(plan.sigma_s, sensors),
        noise=noise,
    )
    table = TimeDifferences(
        time_s=found.time_s,
        sensor=found.sensor,
        reference=found.reference,
        tdoa_s=found.measured,
        sigma_s=found.sigma,
        sigma_reference_s=found.sigma_reference,
        line=np.zeros(found.time_s.size, dtype=np.int64),
    )
    return table, found.rows


def frequency_table(
    plan: FrequencyPlan, grid: Grid, *, sensors: int, noise: np.random.Generator
) -> tuple[FrequencyDifferences, Rows]:
    """Return the frequency differences of a plan and what they hide; see :func:`arrival_table`."""
    found = _differences(
        plan,
        grid,
        value=plan.carrier_hz * grid.shift,
        error=grid.errors.frequency_hz,
        sigma=_sigmas(plan.sigma_hz, sensors),
        noise=noise,
    )
    table = FrequencyDifferences(
        time_s=found.time_s,
        sensor=found.sensor,
        reference=found.reference,
        fdoa_hz=found.measured,
        carrier_hz=np.full(found.time_s.size, plan.carrier_hz),
        sigma_hz=found.sigma,
        sigma_reference_hz=found.sigma_reference,
        line=np.zeros(found.time_s.size, dtype=np.int64),
    )
    return table, found.rows


def _check_pairs(pairs: tuple[tuple[int, int], ...], *, shared: bool) -> None:
    sensors, references = zip(*pairs, strict=True)
    if shared and (len(set(sensors)) < len(sensors) or set(sensors) & set(references)):
        raise ValueError(
            f"pairs {pairs} share noise beyond that of a reference; expected every sensor in one "
            "pair, and never as a reference, or shared=False"
        )


def _sigmas(sigma: Sigma, sensors: int) -> NDArray[np.float64]:
    return np.broadcast_to(np.asarray(sigma, dtype=np.float64), (sensors,))
