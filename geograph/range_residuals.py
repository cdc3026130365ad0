"""What arrival times, differences and bearings say of a path, for first guesses.

Residuals are those of :mod:`geograph.factors.arrival`, :mod:`geograph.factors.difference` and
:mod:`geograph.factors.bearing`. The path is read at times of emission that are taken from the
evaluation before; that of a group of ranges is also its unknown, eliminated with the robust weights
of its rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from geograph.factors.arrival import SensorMotion, arrival_gradient, doppler_gradient, trace
from geograph.factors.bearing import coordinate_residual, tangent_residual
from geograph.factors.difference import frequency_difference
from geograph.lines import robust_scale

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from geograph.factors.arrival import Ray
    from geograph.range_data import RangeData

    State = Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]

# Rounds of weights in the search for a group's time of emission.
_ROUNDS = 3

# The scale of residuals never falls below this: exact data would else have none.
LEAST_SCALE = 1e-3


@dataclass(frozen=True, eq=False)
class Residuals:
    """Whitened residuals of a path, measured less predicted for ranges.

    Attributes
    ----------
    value
        Shape (n,): ranges, bearings (azimuths, elevations), frequency differences.
    by_position, by_velocity
        Shape (n, 3): derivatives, groups' times of emission not yet taken off.
    slope
        Shape (n,): derivative by the group's time of emission, zero where there is none.
    event
        Shape (n,): number of the emission that each row belongs to.
    emitted_s
        Shape (events,): times of emission.
    distance_m
        Shape (events,): distance from a sensor.
    """

    value: NDArray[np.float64]
    by_position: NDArray[np.float64]
    by_velocity: NDArray[np.float64]
    slope: NDArray[np.float64]
    event: NDArray[np.int64]
    emitted_s: NDArray[np.float64]
    distance_m: NDArray[np.float64]


class Evaluator:
    """Evaluates paths on given data.

    Parameters
    ----------
    data
        The measurements.
    """

    def __init__(self, data: RangeData) -> None:
        self.data = data
        ranges, bearings, differences = data.ranges, data.bearings, data.differences
        groups, lines, pairs = ranges.origin_s.size, len(bearings), len(differences)
        self.groups = groups
        self.events = groups + lines + pairs
        self._line_event = groups + np.arange(lines)
        self._pair_event = groups + lines + np.arange(pairs)
        geometry = data.geometry
        poses = geometry.poses(bearings.sensor, bearings.time_s)
        self._axes = poses.axes
        motions = [
            ranges.motion,
            geometry.motion(bearings.sensor, bearings.time_s),
            geometry.motion(differences.sensor, differences.time_s),
            geometry.motion(differences.reference, differences.time_s),
        ]
        self._motion = SensorMotion(
            np.concatenate([m.position_m for m in motions]),
            np.concatenate([m.velocity_m_s for m in motions]),
            np.concatenate([m.acceleration_m_s2 for m in motions]),
        )
        self._ray_event = np.concatenate(
            [ranges.group, self._line_event, self._pair_event, self._pair_event]
        )
        self.start_s = data.times()[: self.events]
        ends = np.cumsum([0, len(ranges), lines, pairs, pairs]).tolist()
        self._parts = [slice(*part) for part in pairwise(ends)]

    def __call__(
        self, state: State, emitted_s: NDArray[np.float64], *, jacobian: bool = False
    ) -> Residuals:
        """Return the residuals of a path.

        Parameters
        ----------
        state
            Returns position and velocity, shapes (n, 3), at times.
        emitted_s
            Shape (events,): times of emission so far.
        jacobian
            Whether derivatives are wanted; they are empty otherwise.
        """
        data = self.data
        position, velocity = state(emitted_s)
        event = self._ray_event
        ray = trace(
            position[event],
            velocity[event],
            lambda _: self._motion,
            speed_m_s=data.speed_m_s,
            spin_rad_s=data.spin_rad_s,
        )
        parts = self._parts
        first, slope, emitted = self._range_rows(ray.take(parts[0]), jacobian=jacobian)
        lines, pair = ray.take(parts[1]), (ray.take(parts[2]), ray.take(parts[3]))
        second = self._bearing_rows(lines, jacobian=jacobian)
        third = self._pair_rows(*pair, jacobian=jacobian)
        table = data.bearings
        times = [
            emitted,
            table.time_s - lines.light_time_s,
            data.differences.time_s - pair[1].light_time_s,
        ]
        distance = np.zeros(self.events)
        distance[event] = ray.distance_m
        value, by_position, by_velocity = (
            np.concatenate(column) for column in zip(first, second, third, strict=True)
        )
        return Residuals(
            value,
            by_position,
            by_velocity,
            np.concatenate([slope, np.zeros(value.size - slope.size)]),
            np.concatenate(
                [data.ranges.group, self._line_event, self._line_event, self._pair_event]
            ),
            np.concatenate(times),
            distance,
        )

    def _range_rows(
        self, ray: Ray, *, jacobian: bool
    ) -> tuple[
        tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
        NDArray[np.float64],
        NDArray[np.float64],
    ]:
        ranges = self.data.ranges
        white = 1.0 / ranges.sigma_s
        asked = ranges.delay_s - ray.light_time_s
        after = emission_times(asked, white, ranges.group, self.groups)
        value = (asked - after[ranges.group]) * white
        by_position = np.zeros((0 if not jacobian else value.size, 3))
        if jacobian:
            by_position = -arrival_gradient(ray).by_position * white[:, None]
        rows = (value, by_position, np.zeros_like(by_position))
        return rows, white, ranges.origin_s + after

    def _bearing_rows(
        self, ray: Ray, *, jacobian: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        table = self.data.bearings
        if not len(table):
            return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3))
        inside = np.einsum("nij,nj->ni", self._axes, ray.turned_m - ray.sensor.position_m)
        residual = np.zeros((len(table), 2))
        slope = np.zeros((len(table), 2, 3))
        sky = table.isotropic & np.isfinite(table.elevation_rad)
        for rows, equation in ((sky, tangent_residual), (~sky, coordinate_residual)):
            if rows.any():
                found = equation(
                    inside[rows], table.azimuth_rad[rows], table.elevation_rad[rows], jacobian=True
                )
                assert found.by_line_of_sight is not None
                residual[rows], slope[rows] = found.value, found.by_line_of_sight
        # An azimuth alone has no second sigma.
        sigma = np.where(np.isfinite(self.data.bearing_sigma), self.data.bearing_sigma, np.inf)
        value = residual / sigma
        if not jacobian:
            return value.T.ravel(), np.zeros((0, 3)), np.zeros((0, 3))
        in_frame = np.einsum("nki,nij->nkj", slope, self._axes) / sigma[:, :, None]
        by_position = in_frame.transpose(1, 0, 2).reshape(-1, 3)
        return value.T.ravel(), by_position, np.zeros_like(by_position)

    def _pair_rows(
        self, sensor: Ray, reference: Ray, *, jacobian: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        table, sigma = self.data.differences, self.data.difference_sigma
        if not sigma.size:
            return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3))
        value = (frequency_difference(sensor, reference, table.carrier_hz) - table.fdoa_hz) / sigma
        if not jacobian:
            return value, np.zeros((0, 3)), np.zeros((0, 3))
        still = np.zeros((len(table), 3))
        white = table.carrier_hz / sigma
        one = doppler_gradient(sensor, still).scaled(white)
        both = one.plus(doppler_gradient(reference, still), -white)
        return value, both.by_position, both.by_velocity


def emission_times(
    asked_s: NDArray[np.float64],
    white: NDArray[np.float64],
    group: NDArray[np.int64],
    groups: int,
) -> NDArray[np.float64]:
    """Return the time of emission of every group that its rows ask for, robustly, shape (g,).

    From the weighted median on, the mean with Cauchy weights on the scale of what is left.

    Parameters
    ----------
    asked_s
        Shape (n,): arrival less light time of each row.
    white
        Shape (n,): reciprocal sigmas.
    group
        Shape (n,), growing.
    groups
        Their number; each has rows.
    """
    if not asked_s.size:
        return np.zeros(groups)
    middle = group_medians(asked_s, white, group, groups)
    # The first rows of the groups; sums over them are differences of one running sum.
    start = np.searchsorted(group, np.arange(groups))
    for _ in range(_ROUNDS):
        left = (asked_s - middle[group]) * white
        scale = max(robust_scale(left), LEAST_SCALE)
        weight = white**2 / (1.0 + (left / (3.0 * scale)) ** 2)
        total = np.add.reduceat(weight, start)
        middle = middle + np.add.reduceat(weight * (asked_s - middle[group]), start) / total
    return np.asarray(middle)


def group_medians(
    value: NDArray[np.float64],
    weight: NDArray[np.float64],
    group: NDArray[np.int64],
    groups: int,
) -> NDArray[np.float64]:
    """Return weighted medians of groups, shape (g,).

    Parameters
    ----------
    value, weight
        Shape (n,), weights above 0.
    group
        Shape (n,), growing.
    groups
        Their number; each has rows.
    """
    order = np.lexsort((value, group))
    running = np.cumsum(weight[order])
    start = np.searchsorted(group, np.arange(groups))
    end = np.append(start[1:], value.size) - 1
    before = running[start] - weight[order][start]
    half = before + 0.5 * (running[end] - before)
    row = np.clip(np.searchsorted(running, half), start, end)
    return np.asarray(value[order][row])
