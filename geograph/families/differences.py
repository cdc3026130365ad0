"""Differences of arrival time and of received frequency, between sensors and references."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.common import Common
from geograph.factors.arrival import arrival_gradient
from geograph.factors.difference import (
    frequency_difference,
    frequency_difference_gradient,
    time_difference,
    time_difference_gradient,
)
from geograph.families.ray_kernel import FREQUENCY_DIFFERENCES, TIME_DIFFERENCES
from geograph.families.rays import End, RayFamily, Solved, World
from geograph.states import CHANNELS, CLOCK, FREQUENCY, POSITION, SPEED, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.factors.difference import DifferenceGradient
    from geograph.measurements import FrequencyDifferences, TimeDifferences
    from geograph.path import Path, PathState

# Newton's steps of the time of emission gain as the signal is faster than the object.
_ROUNDS = 30
_TOLERANCE_S = 1e-13


class _DifferenceFamily(RayFamily):
    """Differences against a reference, sorted by time and reference."""

    table: TimeDifferences | FrequencyDifferences
    felt: tuple[Sequence[int], Sequence[int]]
    """Channels of error of sensor and reference that a difference feels."""

    def __init__(
        self,
        table: TimeDifferences | FrequencyDifferences,
        *,
        world: World,
        measured: NDArray[np.float64],
        sigma: NDArray[np.float64],
        sigma_common: NDArray[np.float64],
        weight: NDArray[np.float64],
        position_noise_m: tuple[NDArray[np.float64], NDArray[np.float64]],
    ) -> None:
        self.table = table
        self._inputs = (weight, position_noise_m)
        pair = np.stack([table.time_s, table.reference.astype(np.float64)], axis=1)
        _, code = np.unique(pair, axis=0, return_inverse=True)
        code = code.reshape(-1)
        order = np.argsort(code, kind="stable")
        self.order = order
        time = table.time_s[order]
        super().__init__(
            world,
            [
                End(world, table.sensor[order], time, self.felt[0]),
                End(world, table.reference[order], time, self.felt[1]),
            ],
            measured=measured[order],
            sigma=sigma[order],
            sigma_common=sigma_common[order],
            group=code[order],
            weight=weight[order],
            position_noise_m=[noise[order] for noise in position_noise_m],
            line=table.line[order],
        )

    def subset(self, index: NDArray[np.int64]) -> _DifferenceFamily:
        """Return the family of some of its differences (indices in the family's own order)."""
        original = self.order[index]
        columns = {name: column[original] for name, column in vars(self.table).items()}
        weight, noise = self._inputs
        part = type(self)(
            type(self.table)(**columns),  # type: ignore[call-arg]
            world=self.world,
            weight=weight[original],
            position_noise_m=(noise[0][original], noise[1][original]),
        )
        part.path_noise_m = self.path_noise_m[index]
        part.path_noise_m_s = self.path_noise_m_s[index]
        part._white, part._shared = self._white[index], self._shared[index]
        for own, whole in zip(part.ends, self.ends, strict=True):
            own.read_s = whole.read_s[index]
        return part

    def _emission_times(
        self, path: Path, state: PathState, errors: tuple[NDArray[np.float64], ...]
    ) -> NDArray[np.float64]:
        end, own = self.ends[1], errors[1]
        received = self.time_s - own[:, CLOCK]
        emitted = received.copy() if self._emitted is None else self._emitted
        for _ in range(_ROUNDS):
            position, velocity = state.position_velocity(path.locate(emitted))
            ray = end.rays(position, velocity, emitted, own, self._delays[1])
            self._delays[1] = ray.light_time_s
            step = (received - emitted - ray.light_time_s) / arrival_gradient(ray).by_emission
            emitted = emitted + step
            floor = _TOLERANCE_S + 4.0 * np.finfo(float).eps * np.abs(emitted).max(initial=0.0)
            if not np.abs(step).max(initial=0.0) > floor:
                break
        # All rows of a group were emitted at the same time, to the last digit.
        emitted = emitted[self.start][self.group]
        if np.isfinite(emitted).all():
            self._emitted = emitted
        return np.asarray(emitted)

    def _by_common(self, found: Solved) -> None:
        """Return nothing: the time of emission follows from the arrival at the reference."""
        del found

    def _shared_unknowns(self, by_common: NDArray[np.float64] | None) -> Common | None:
        del by_common
        shared, information = self._shared_prior()
        if shared is None or information is None:
            return None
        nothing = np.zeros(self.start.size)
        return Common(self.group, self.start, shared, information, nothing)

    def _shared_prior(self) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
        if not self._shared.any():
            return None, None
        # Weights for correlation are of the whole covariance, what rows share included.
        return self._shared, np.minimum.reduceat(self.weight, self.start)

    @staticmethod
    def _channels(gradient: DifferenceGradient, speed_m_s: float) -> list[NDArray[np.float64]]:
        """Return derivatives by the channels of both ends, but for what is added to the values."""
        count = gradient.by_time.size
        sensor, reference = np.zeros((count, CHANNELS)), np.zeros((count, CHANNELS))
        sensor[:, POSITION : POSITION + 3] = gradient.by_sensor_position
        sensor[:, VELOCITY : VELOCITY + 3] = gradient.by_sensor_velocity
        sensor[:, SPEED] = gradient.by_speed / speed_m_s
        reference[:, POSITION : POSITION + 3] = gradient.by_reference_position
        reference[:, VELOCITY : VELOCITY + 3] = gradient.by_reference_velocity
        # A clock that is fast puts the true arrival before its time tag.
        reference[:, CLOCK] = -gradient.by_time
        return [sensor, reference]


class TimeDifferenceFamily(_DifferenceFamily):
    """All time differences of a recording: tdoa = arrival(sensor) - arrival(reference).

    Parameters
    ----------
    table
        The table.
    world
        Sensors and their states.
    weight
        Shape (n,): weights of the information, for correlated errors.
    position_noise_m
        White position errors of sensors and references, each shape (n,).
    """

    name = "time_differences"
    unit = "s"
    kind = "tdoa"
    kernel_kind = TIME_DIFFERENCES
    felt = (CLOCK,), (CLOCK,)

    def __init__(
        self,
        table: TimeDifferences,
        *,
        world: World,
        weight: NDArray[np.float64],
        position_noise_m: tuple[NDArray[np.float64], NDArray[np.float64]],
    ) -> None:
        super().__init__(
            table,
            world=world,
            measured=table.tdoa_s,
            sigma=table.sigma_s,
            sigma_common=table.sigma_reference_s,
            weight=weight,
            position_noise_m=position_noise_m,
        )
        self._lay_out(rounds=_ROUNDS, enough_s=_TOLERANCE_S)

    def _predicted_error(self, found: Solved) -> NDArray[np.float64]:
        clocks = found.errors[0][:, CLOCK] - found.errors[1][:, CLOCK]
        return np.asarray(time_difference(*found.rays) + clocks - self.measured)

    def _gradients(
        self, found: Solved, path: Path, state: PathState
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, list[NDArray[np.float64]]]:
        del path, state
        gradient = time_difference_gradient(*found.rays)
        sensor, reference = self._channels(gradient, found.rays[0].speed_m_s)
        sensor[:, CLOCK] += 1.0
        reference[:, CLOCK] -= 1.0
        return gradient.by_position, None, [sensor, reference]


class FrequencyDifferenceFamily(_DifferenceFamily):
    """All frequency differences of a recording: fdoa = received(sensor) - received(reference).

    A sensor's frequency offset is in hertz at the median carrier of the recording, and in
    proportion at others.

    Parameters
    ----------
    table, world, weight, position_noise_m
        As of :class:`TimeDifferenceFamily`.
    """

    name = "frequency_differences"
    unit = "Hz"
    kind = "fdoa"
    kernel_kind = FREQUENCY_DIFFERENCES
    # The signal is the one that the reference tells the time of.
    felt = (FREQUENCY,), (CLOCK, FREQUENCY)

    def __init__(
        self,
        table: FrequencyDifferences,
        *,
        world: World,
        weight: NDArray[np.float64],
        position_noise_m: tuple[NDArray[np.float64], NDArray[np.float64]],
        median_carrier_hz: float | None = None,
    ) -> None:
        super().__init__(
            table,
            world=world,
            measured=table.fdoa_hz,
            sigma=table.sigma_hz,
            sigma_common=table.sigma_reference_hz,
            weight=weight,
            position_noise_m=position_noise_m,
        )
        self.carrier_hz = table.carrier_hz[self.order]
        self._take_median(median_carrier_hz or float(np.median(table.carrier_hz)))

    def _take_median(self, median_carrier_hz: float) -> None:
        """Let offsets of frequency be those at some carrier."""
        self.median_carrier_hz = median_carrier_hz
        self._relative = self.carrier_hz / median_carrier_hz
        self._lay_out(
            rounds=_ROUNDS,
            enough_s=_TOLERANCE_S,
            carrier_hz=self.carrier_hz,
            relative=self._relative,
        )

    def subset(self, index: NDArray[np.int64]) -> FrequencyDifferenceFamily:
        """Return the family of some of its differences (indices in the family's own order)."""
        part = super().subset(index)
        assert isinstance(part, FrequencyDifferenceFamily)
        part._take_median(self.median_carrier_hz)
        return part

    def resolution_m(
        self, distance_m: NDArray[np.float64], speed_m_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return about how well each measurement alone locates the object, shape (n,), metres.

        A range rate changes by the speed across the line over the distance, for each metre.
        """
        rate = self.velocity_resolution_m_s()
        return np.asarray(rate * distance_m / np.maximum(speed_m_s, 1e-3 * rate + 1e-12))

    def velocity_resolution_m_s(self) -> NDArray[np.float64]:
        """Return how well each difference resolves a velocity, shape (n,), metres per second."""
        return np.asarray(self.sigma / self.carrier_hz * self.world.speed_m_s)

    def clock_resolution_s(
        self, distance_m: NDArray[np.float64], speed_m_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return how well each difference resolves a clock, shape (n,), seconds.

        A frequency follows the clock only as the geometry turns.
        """
        rate = self.velocity_resolution_m_s() * distance_m
        still = np.full(len(self), np.inf)
        moves = speed_m_s**2 > 1e-300 * rate
        return np.asarray(np.divide(rate, speed_m_s**2, out=still, where=moves))

    def _predicted_error(self, found: Solved) -> NDArray[np.float64]:
        offsets = found.errors[0][:, FREQUENCY] - found.errors[1][:, FREQUENCY]
        predicted = frequency_difference(found.rays[0], found.rays[1], self.carrier_hz)
        return np.asarray(predicted + self._relative * offsets - self.measured)

    def _gradients(
        self, found: Solved, path: Path, state: PathState
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, list[NDArray[np.float64]]]:
        sensor_ray, reference_ray = found.rays
        gradient = frequency_difference_gradient(
            sensor_ray, reference_ray, self.carrier_hz, _acceleration(found, path, state)
        )
        sensor, reference = self._channels(gradient, found.rays[0].speed_m_s)
        sensor[:, FREQUENCY] += self._relative
        reference[:, FREQUENCY] -= self._relative
        return gradient.by_position, gradient.by_velocity, [sensor, reference]


def _acceleration(found: Solved, path: Path, state: PathState) -> NDArray[np.float64]:
    """Return the object's acceleration along its path at the emissions, shape (n, 3), m/s^2.

    By differences within the interval between two knots, where every path is smooth.
    """
    if path.knots_s.size < 2:
        return np.zeros((found.emitted_s.size, 3))
    place = found.place
    low = path.knots_s[place.interval]
    step = 1e-4 * place.step_s
    early = np.maximum(found.emitted_s - step, low)
    late = np.minimum(found.emitted_s + step, low + place.step_s)
    # Beyond the knots a path goes straight on.
    inside = late > early
    before = state.position_velocity(path.locate(early))[1]
    after = state.position_velocity(path.locate(late))[1]
    apart = np.where(inside, late - early, 1.0)[:, None]
    return np.where(inside[:, None], (after - before) / apart, 0.0)
