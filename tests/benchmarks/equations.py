"""Rows of the cost and their derivatives, vectorised NumPy: what a user of an optimizer writes.

All rows are whitened, and the cost is half their sum of squares:

- a bearing's residual: the logarithmic map of the predicted direction in the tangent plane of the
  measured one, freed from the sensor's errors, its first component times the ratio of the cosines
  of the measured and the freed elevation (rounded off at the zenith), because the noise is
  isotropic where the sensor measured; between knots, the position is the mean of the prior given
  both neighbours;
- an arrival time, predicted less measured, less the mean over its emission, whose time is unknown;
- a received frequency less the first sensor's, predicted less measured;
- the height of each knot, where it is known;
- the whitened noise between knots, the first knot's deviation from the first guess over wide
  sigmas, and the sensors' errors over their prior sigmas.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from model import CLOCK, FREQUENCY, Pass, path_weights, transition, unit_noise_root

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Index = NDArray[np.int64] | slice

ZENITH_ROUNDING = 0.02
"""Sine of the distance from the zenith within which cosines of elevations are rounded off."""

_NOTHING = np.empty((0, 0, 0))


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of n measurements, r each, in SI units.

    Attributes
    ----------
    residual
        Shape (n, r), whitened.
    by_knots
        Shape (n, r, 2 D), by the states of the knot before and of the one after; (n, r, D) where
        there is one knot; empty where no derivatives were asked for.
    by_errors
        Shape (n, r, e), by the errors in the table's columns.
    """

    residual: NDArray[np.float64]
    by_knots: NDArray[np.float64]
    by_errors: NDArray[np.float64]


class Table:
    """Measurements of one kind, whose place along the path is found once.

    Attributes
    ----------
    interval
        Shape (n,): the knot before each measurement.
    column
        Shape (n, e): which of the (S E) errors each measurement feels.
    rows
        Rows of each measurement.
    """

    interval: NDArray[np.int64]
    column: NDArray[np.int64]
    rows: int

    def __init__(self, data: Pass, time_s: NDArray[np.float64]) -> None:
        self.data = data
        self._time_s = time_s
        self.interval, self._place, self._speed = path_weights(data.knots_s, time_s)

    def at_nearest_knots(self) -> Table:
        """Return the table with each place predicted from the nearest knot's state alone.

        For filters, whose states stand at the knots; noise within half a second is left out.
        """
        found = copy(self)
        knots = self.data.knots_s
        if knots.size > 1:
            later = self._time_s - knots[self.interval] > knots[self.interval + 1] - self._time_s
            found.interval = self.interval + later
            turn = transition(self._time_s - knots[found.interval])
            found._place, found._speed = turn[:, 0], turn[:, 1]
        return found

    def __len__(self) -> int:
        return int(self.interval.size)

    def evaluate(
        self, path: NDArray[np.float64], errors: NDArray[np.float64], *, jacobian: bool = True
    ) -> Rows:
        """Return the rows of all measurements; path (K, D), errors (S, E)."""
        knots = self._place.shape[1] // (path.shape[1] // 3)
        blocks = path.reshape(path.shape[0], -1, 3)
        both = [blocks[self.interval + which] for which in range(knots)]
        return self.at(np.concatenate(both, axis=1), errors, slice(None), jacobian=jacobian)

    def at(
        self,
        blocks: NDArray[np.float64],
        errors: NDArray[np.float64],
        index: Index,
        *,
        jacobian: bool = True,
    ) -> Rows:
        """Return the rows of some measurements; blocks (n, 2 order, 3) are their knots' states."""
        raise NotImplementedError

    def _by_knots(
        self,
        by_place: NDArray[np.float64],
        by_speed: NDArray[np.float64] | None,
        index: Index,
    ) -> NDArray[np.float64]:
        both = by_place[:, :, None, :] * self._place[index][:, None, :, None]
        if by_speed is not None:
            both += by_speed[:, :, None, :] * self._speed[index][:, None, :, None]
        return both.reshape(*both.shape[:2], -1)


class BearingTable(Table):
    """Bearings; errors: azimuth, elevation, and their drifts."""

    rows = 2

    def __init__(self, data: Pass) -> None:
        super().__init__(data, data.time_s)
        self.column = data.sensor[:, None] * data.error_sigma.size + np.arange(4)

    def at(
        self,
        blocks: NDArray[np.float64],
        errors: NDArray[np.float64],
        index: Index,
        *,
        jacobian: bool = True,
    ) -> Rows:
        """Return the rows; see :class:`Table`."""
        data = self.data
        sensor, time = data.sensor[index], data.time_s[index]
        place = np.einsum("nj,njc->nc", self._place[index], blocks)
        own = errors[sensor]
        residual, by_place, by_angles = bearing_rows(
            place - data.sensor_m[sensor],
            (data.azimuth_rad[index], data.elevation_rad[index]),
            own[:, :2] + own[:, 2:4] * time[:, None],
            float(data.sigma_rad),
            jacobian=jacobian,
        )
        if not jacobian:
            return Rows(residual, by_place, by_angles)
        by_errors = np.concatenate([by_angles, by_angles * time[:, None, None]], axis=2)
        return Rows(residual, self._by_knots(by_place, None, index), by_errors)


def bearing_rows(
    line_m: NDArray[np.float64],
    measured_rad: tuple[NDArray[np.float64], NDArray[np.float64]],
    error_rad: NDArray[np.float64],
    sigma_rad: float,
    *,
    jacobian: bool = True,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return residuals (n, 2), and derivatives by the line (n, 2, 3) and by the errors (n, 2, 2).

    Parameters
    ----------
    line_m
        Shape (n, 3): from the sensor to the object.
    measured_rad
        Azimuth and elevation, each shape (n,).
    error_rad
        Shape (n, 2): the sensor's, in both.
    sigma_rad
        On the sky.
    """
    azimuth, elevation = measured_rad[0] - error_rad[:, 0], measured_rad[1] - error_rad[:, 1]
    sa, ca, se, ce = np.sin(azimuth), np.cos(azimuth), np.sin(elevation), np.cos(elevation)
    axes = np.array([[-sa, ca, 0.0 * sa], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]])
    across, up, along = np.einsum("rcn,nc->rn", axes, line_m)
    sine2 = across**2 + up**2
    sine, length2 = np.sqrt(sine2), sine2 + along**2
    theta = np.arctan2(sine, along)
    near = sine < 1e-4 * along
    safe = np.where(near, 1.0, sine)
    inside = np.where(near, along, 1.0)
    small = sine2 / inside**2
    stretch = np.where(near, (1.0 - small / 3.0) / inside, theta / safe) / sigma_rad
    level2 = ce**2 + ZENITH_ROUNDING**2
    ratio = np.sqrt((np.cos(measured_rad[1]) ** 2 + ZENITH_ROUNDING**2) / level2)
    residual = np.stack([stretch * across * ratio, stretch * up], axis=1)
    if not jacobian:
        return residual, _NOTHING, _NOTHING
    bend = np.where(
        near,
        (-2.0 / 3.0 + 0.8 * small) / inside**3,
        (along * sine / length2 - theta) / safe**3,
    )
    bend /= sigma_rad
    back = -1.0 / (length2 * sigma_rad)
    # By (across, up, along): the stretch's own derivative is (bend across, bend up, back).
    by_parts = np.empty((2, 3, across.size))
    for row, part in enumerate((across, up)):
        by_parts[row] = part * bend * across, part * bend * up, part * back
        by_parts[row, row] += stretch
    by_parts[0] *= ratio
    by_line = np.einsum("rpn,pcn->nrc", by_parts, axes)
    turned = np.array([se * up - ce * along, -se * across, ce * across])
    tipped = np.array([0.0 * up, -along, up])
    by_errors = -np.einsum("rpn,qpn->nrq", by_parts, np.stack([turned, tipped]))
    by_errors[:, 0, 1] -= residual[:, 0] * ce * se / level2
    return residual, by_line, by_errors


class ArrivalTable(Table):
    """Sets of arrival times, one of every sensor; errors: their clocks, where they err."""

    def __init__(self, data: Pass) -> None:
        super().__init__(data, data.emitted_s)
        self.rows = data.sensor_m.shape[0]
        errors = data.error_sigma.size
        own = np.arange(self.rows) * errors + CLOCK if errors > CLOCK else np.empty(0, np.int64)
        self.column = np.tile(own, (len(self), 1))
        self._at = data.sensor_m + data.sensor_m_s * data.toa_s[:, :, None]

    def at(
        self,
        blocks: NDArray[np.float64],
        errors: NDArray[np.float64],
        index: Index,
        *,
        jacobian: bool = True,
    ) -> Rows:
        """Return the rows; see :class:`Table`."""
        data = self.data
        place = np.einsum("nj,njc->nc", self._place[index], blocks)
        line = place[:, None] - self._at[index]
        distance = np.sqrt(np.einsum("nsc,nsc->ns", line, line))
        late = data.emitted_s[index][:, None] - data.toa_s[index] + distance / data.speed_m_s
        if self.column.shape[1]:
            late += errors[:, CLOCK]
        late -= late.mean(axis=1, keepdims=True)
        residual = late / data.toa_sigma_s
        if not jacobian:
            return Rows(residual, _NOTHING, _NOTHING)
        by_place = line / (distance * data.speed_m_s)[:, :, None]
        by_errors = np.empty((late.shape[0], self.rows, 0))
        if self.column.shape[1]:
            share = (np.eye(self.rows) - 1.0 / self.rows) / data.toa_sigma_s
            by_errors = np.broadcast_to(share, (late.shape[0], *share.shape))
        by_place -= by_place.mean(axis=1, keepdims=True)
        by_knots = self._by_knots(by_place / data.toa_sigma_s, None, index)
        return Rows(residual, by_knots, by_errors)


class DifferenceTable(Table):
    """Frequencies less the first sensor's; errors: the oscillators of all sensors."""

    def __init__(self, data: Pass) -> None:
        super().__init__(data, data.emitted_s)
        self.rows = data.sensor_m.shape[0] - 1
        own = np.arange(self.rows + 1) * data.error_sigma.size + FREQUENCY
        self.column = np.tile(own, (len(self), 1))

    def at(
        self,
        blocks: NDArray[np.float64],
        errors: NDArray[np.float64],
        index: Index,
        *,
        jacobian: bool = True,
    ) -> Rows:
        """Return the rows; see :class:`Table`."""
        data = self.data
        place = np.einsum("nj,njc->nc", self._place[index], blocks)
        speed = np.einsum("nj,njc->nc", self._speed[index], blocks)
        line = place[:, None] - data.sensor_m
        distance = np.sqrt(np.einsum("nsc,nsc->ns", line, line))[:, :, None]
        unit = line / distance
        rate = np.einsum("nsc,nc->ns", unit, speed)
        slowed = 1.0 + rate / data.speed_m_s
        # Signals are emitted at the carrier and received at carrier / slowed.
        received = data.carrier_hz / slowed + errors[:, FREQUENCY]
        white = 1.0 / data.fdoa_sigma_hz
        residual = (received[:, 1:] - received[:, :1] - data.fdoa_hz[index]) * white
        if not jacobian:
            return Rows(residual, _NOTHING, _NOTHING)
        lean = -data.carrier_hz / (data.speed_m_s * slowed**2)
        by_speed = lean[:, :, None] * unit
        by_place = lean[:, :, None] * (speed[:, None] - rate[:, :, None] * unit) / distance
        by_place = (by_place[:, 1:] - by_place[:, :1]) * white
        by_speed = (by_speed[:, 1:] - by_speed[:, :1]) * white
        share = np.concatenate([-np.ones((self.rows, 1)), np.eye(self.rows)], axis=1) * white
        by_errors = np.broadcast_to(share, (residual.shape[0], *share.shape))
        return Rows(residual, self._by_knots(by_place, by_speed, index), by_errors)


def tables(data: Pass) -> list[Table]:
    """Return the tables that a pass has."""
    found: list[Table] = []
    if data.time_s.size:
        found.append(BearingTable(data))
    if data.emitted_s.size:
        found.append(ArrivalTable(data))
    if data.fdoa_hz.size:
        found.append(DifferenceTable(data))
    return found


def kinematics(data: Pass) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return derivatives of the whitened noise w = A x[k] + B x[k + 1], each (K - 1, D, D)."""
    if data.knots_s.size == 1:
        return np.empty((0, 3, 3)), np.empty((0, 3, 3))
    steps = np.diff(data.knots_s)
    whiten = np.linalg.inv(unit_noise_root(steps)) / data.noise
    # Three axes alike: each entry of one axis is a diagonal block.
    eye = np.eye(3)

    def spread(one: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.einsum("kij,ab->kiajb", one, eye).reshape(-1, 9, 9)

    return spread(-whiten @ transition(steps)), spread(whiten)


def cost(data: Pass, path: NDArray[np.float64], errors: NDArray[np.float64]) -> float:
    """Return the cost of an estimate: path (K, D), errors (S, E)."""
    total = sum(
        float(np.sum(table.evaluate(path, errors, jacobian=False).residual ** 2))
        for table in tables(data)
    )
    before, after = kinematics(data)
    noise = np.einsum("kij,kj->ki", before, path[:-1]) + np.einsum("kij,kj->ki", after, path[1:])
    total += float(np.sum(noise**2))
    total += float(np.sum(((path[0] - data.guess[0]) / data.prior_sigma) ** 2))
    total += float(np.sum((errors / data.error_sigma) ** 2))
    total += float(np.sum((path[:, 2] / data.altitude_sigma_m) ** 2))
    return 0.5 * total
