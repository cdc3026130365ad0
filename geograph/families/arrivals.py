"""Arrival times of emissions whose own times are not known."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from geograph.common import Common
from geograph.factors.arrival import arrival_gradient
from geograph.families.ray_kernel import ARRIVALS
from geograph.families.rays import End, RayFamily, Solved, World
from geograph.states import CHANNELS, CLOCK, POSITION, SPEED

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.measurements import Arrivals
    from geograph.path import Path, PathState

# The object's way during an emission time's error matters to second order only; rounds end when
# the time changes by less than this many of its sigmas.
_ROUNDS = 20
_TOLERANCE = 1e-3

# Least rate at which arrivals follow emissions, in Newton's step; it is zero on the cone of sound.
_LEAST_RATE = 0.05


class ArrivalFamily(RayFamily):
    """All arrival times of a recording, sorted by emission.

    Residuals are evaluated at the median of the times of emission that the arrivals of a set ask
    for, and the best time follows from there (:mod:`geograph.common`): whatever the loss, it is
    then within its sigma, where everything is linear in it.

    Parameters
    ----------
    arrivals
        The table.
    world
        Sensors and their states.
    weight
        Shape (n,): weights of the information, for correlated errors.
    position_noise_m
        Shape (n,): white error of the sensor's position at each arrival.
    """

    name = "arrivals"
    unit = "s"
    kind = "toa"
    kernel_kind = ARRIVALS

    def __init__(
        self,
        arrivals: Arrivals,
        *,
        world: World,
        weight: NDArray[np.float64],
        position_noise_m: NDArray[np.float64],
    ) -> None:
        self.table = arrivals
        self._inputs = (weight, position_noise_m)
        _, code = np.unique(arrivals.emission, return_inverse=True)
        order = np.argsort(code, kind="stable")
        self.order = order
        group = code[order]
        super().__init__(
            world,
            [End(world, arrivals.sensor[order], arrivals.toa_s[order], [CLOCK])],
            measured=arrivals.toa_s[order],
            sigma=arrivals.sigma_s[order],
            sigma_common=np.zeros(order.size),
            group=group,
            weight=weight[order],
            position_noise_m=[position_noise_m[order]],
            line=arrivals.line[order],
        )
        count = np.diff(np.append(self.start, order.size))
        # The time of each emission takes up one of its arrivals.
        self.row_count = int(order.size - self.start.size)
        # Places of a set's arrivals in a table of one row a set, for medians.
        self._column = np.arange(order.size) - self.start[group]
        self._middle = np.stack([(count - 1) // 2, count // 2])
        self._enough_s = _TOLERANCE * float(self.sigma.min(initial=np.inf))
        self._nothing = np.zeros(self.start.size)
        self._lay_out(rounds=_ROUNDS, enough_s=self._enough_s)

    def subset(self, index: NDArray[np.int64]) -> ArrivalFamily:
        """Return the family of some of its arrivals (indices in the family's own order)."""
        original = self.order[index]
        table = self.table
        weight, noise = self._inputs
        part = ArrivalFamily(
            replace(
                table,
                emission=table.emission[original],
                sensor=table.sensor[original],
                toa_s=table.toa_s[original],
                sigma_s=table.sigma_s[original],
                line=table.line[original],
            ),
            world=self.world,
            weight=weight[original],
            position_noise_m=noise[original],
        )
        part.path_noise_m = self.path_noise_m[index]
        part.path_noise_m_s = self.path_noise_m_s[index]
        part._white, part._shared = self._white[index], self._shared[index]
        part.ends[0].read_s = self.ends[0].read_s[index]
        return part

    def _emission_times(
        self, path: Path, state: PathState, errors: tuple[NDArray[np.float64], ...]
    ) -> NDArray[np.float64]:
        end, own = self.ends[0], errors[0]
        arrived = self.measured - own[:, CLOCK]
        if self._emitted is None:
            self._emitted = self._median(arrived)[self.group]
        emitted = self._emitted
        for _ in range(_ROUNDS):
            position, velocity = state.position_velocity(path.locate(emitted))
            ray = end.rays(position, velocity, emitted, own, self._delays[0])
            self._delays[0] = ray.light_time_s
            # Newton's step; the times themselves would drift apart where the object is faster than
            # the signal.
            late = self._median(arrived - ray.light_time_s - emitted)
            rate = self._median(arrival_gradient(ray).by_emission)
            rate = np.copysign(np.maximum(np.abs(rate), _LEAST_RATE), rate)
            before, emitted = emitted, emitted + (late / rate)[self.group]
            if not np.abs(emitted - before).max(initial=0.0) > self._enough_s:
                break
        if np.isfinite(emitted).all():
            self._emitted = emitted
        return emitted

    def _median(self, column: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the medians of the groups, shape (g,)."""
        table = np.full((self.start.size, int(self._column.max(initial=0)) + 1), np.inf)
        table[self.group, self._column] = column
        table.sort(axis=1)
        rows = np.arange(self.start.size)
        return np.asarray(0.5 * (table[rows, self._middle[0]] + table[rows, self._middle[1]]))

    def _predicted_error(self, found: Solved) -> NDArray[np.float64]:
        # The two large times first: their difference is exact to the digits that they have.
        gap = found.emitted_s - self.measured
        # Where a path runs off, so do its times of emission, until they hide what was measured.
        coarse = np.spacing(np.abs(found.emitted_s))
        gap[(coarse > self.sigma) & (coarse > 16.0 * np.spacing(np.abs(self.measured)))] = np.nan
        return np.asarray(gap + found.rays[0].light_time_s + found.errors[0][:, CLOCK])

    def _gradients(
        self, found: Solved, path: Path, state: PathState
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, list[NDArray[np.float64]]]:
        del path, state
        gradient = arrival_gradient(found.rays[0])
        by_channel = np.zeros((len(self), CHANNELS))
        by_channel[:, CLOCK] = 1.0
        by_channel[:, POSITION : POSITION + 3] = gradient.by_sensor_position
        by_channel[:, SPEED] = gradient.by_speed / found.rays[0].speed_m_s
        return gradient.by_position, None, [by_channel]

    def _by_common(self, found: Solved) -> NDArray[np.float64]:
        return np.asarray(arrival_gradient(found.rays[0]).by_emission * self._white)

    def _shared_unknowns(self, by_common: NDArray[np.float64] | None) -> Common:
        assert by_common is not None
        return Common(self.group, self.start, by_common, self._nothing, self._nothing)
