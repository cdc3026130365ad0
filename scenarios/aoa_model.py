"""Angles as a function of the emitter's place for the comparison estimators, with derivatives.

Everything works on many runs at once. With d = R (x - s) = (a, b, c) the sight along forward, right
and up, h = hypot(a, b) and r = |d|,

    azimuth = atan2(b, a),   elevation = atan2(c, h)

On known ground the state is the two horizontal coordinates, x = (p, ground(p)), and derivatives
take the ground's slope and curvature along.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.scenarios.elevation_model import GRID_M

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.scenarios.airborne import Runs
    from geograph.scenarios.landscape import Landscape


def wrapped(angle_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return angles within half a turn of zero."""
    return angle_rad - 2.0 * np.pi * np.round(angle_rad / (2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class AngleModel:
    """The measurements of a scenario's runs.

    Attributes
    ----------
    runs
        What was measured.
    ground
        What is known of the ground; None: the state is the place in space.
    """

    runs: Runs
    ground: Landscape | None

    @classmethod
    def of(cls, runs: Runs) -> AngleModel:
        """Return the model of what the scenario's estimators know."""
        known = runs.scenario.terrain_known
        return cls(runs, runs.scenario.terrain if known else None)

    @property
    def size(self) -> int:
        """Number of unknowns: 2 on known ground, 3 otherwise."""
        return 3 if self.ground is None else 2

    def measured(self, step: int) -> NDArray[np.float64]:
        """Return the angles of one step, shape (runs, m): azimuths, then elevations."""
        azimuth, elevation = self.runs.azimuth_rad[:, step], self.runs.elevation_rad[:, step]
        if self.runs.scenario.azimuth_only:
            return azimuth
        return np.concatenate([azimuth, elevation], axis=1)

    def noise(self) -> NDArray[np.float64]:
        """Return the covariance of one step's angles, shape (m, m)."""
        count = len(self.runs.scenario.receivers)
        count = count if self.runs.scenario.azimuth_only else 2 * count
        return np.asarray(self.runs.scenario.sigma_rad**2 * np.eye(count))

    def place(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions, shape (..., 3), of states, shape (..., size)."""
        if self.ground is None:
            return state
        height = self.ground.height(state[..., 0], state[..., 1])
        return np.concatenate([state, height[..., None]], axis=-1)

    def predict(self, state: NDArray[np.float64], step: int) -> NDArray[np.float64]:
        """Return predicted angles, shape (..., m), of states, shape (..., size)."""
        a, b, c = np.moveaxis(self._sight(self.place(state), step), -1, 0)
        azimuth, elevation = np.arctan2(b, a), np.arctan2(c, np.hypot(a, b))
        if self.runs.scenario.azimuth_only:
            return np.asarray(azimuth)
        return np.concatenate([azimuth, elevation], axis=-1)

    def _sight(self, place: NDArray[np.float64], step: int) -> NDArray[np.float64]:
        offset = place[..., None, :] - self.runs.receiver_m[step]
        return np.asarray(np.einsum("nij,...nj->...ni", self.runs.axes[step], offset))

    def linearise(
        self, state: NDArray[np.float64], step: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return predicted angles, shape (..., m), and derivatives, shape (..., m, size)."""
        tangent: NDArray[np.float64] = np.eye(3)
        place = state
        if self.ground is not None:
            height, slope = self.ground.evaluate(state[..., 0], state[..., 1])
            place = np.concatenate([state, height[..., None]], axis=-1)
            flat = np.broadcast_to(np.eye(2), (*slope.shape[:-1], 2, 2))
            tangent = np.concatenate([flat, slope[..., None, :]], axis=-2)
        angle, rows = self._in_space(place, step)
        return angle, rows @ tangent

    def _in_space(
        self, place: NDArray[np.float64], step: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        a, b, c = np.moveaxis(self._sight(place, step), -1, 0)
        h = np.hypot(a, b)
        square = h**2 + c**2
        azimuth = np.stack([-b / h**2, a / h**2, np.zeros_like(a)], axis=-1)
        elevation = np.stack([-a * c / h, -b * c / h, h], axis=-1) / square[..., None]
        axes = self.runs.axes[step]
        rows = np.einsum("...nj,njk->...nk", azimuth, axes)
        angle = np.arctan2(b, a)
        if not self.runs.scenario.azimuth_only:
            rows = np.concatenate([rows, np.einsum("...nj,njk->...nk", elevation, axes)], axis=-2)
            angle = np.concatenate([angle, np.arctan2(c, h)], axis=-1)
        return angle, rows

    def curvature(self, state: NDArray[np.float64], step: int) -> NDArray[np.float64]:
        """Return second derivatives of the angles, shape (..., m, size, size).

        The ground's own are differences of its slope across one cell of the elevation grid.
        """
        place = self.place(state)
        second = self._curvature_in_space(place, step)
        if self.ground is None:
            return second
        x, y = state[..., 0], state[..., 1]
        slope = self.ground.gradient(x, y)
        flat = np.broadcast_to(np.eye(2), (*slope.shape[:-1], 2, 2))
        tangent = np.concatenate([flat, slope[..., None, :]], axis=-2)[..., None, :, :]
        half = GRID_M / 2.0
        bend = np.stack(
            [
                self.ground.gradient(x + half, y) - self.ground.gradient(x - half, y),
                self.ground.gradient(x, y + half) - self.ground.gradient(x, y - half),
            ],
            axis=-2,
        )
        bend = 0.5 * (bend + np.swapaxes(bend, -1, -2)) / GRID_M
        upward = self._in_space(place, step)[1][..., 2]
        along = np.swapaxes(tangent, -1, -2) @ second @ tangent
        return np.asarray(along + upward[..., None, None] * bend[..., None, :, :])

    def _curvature_in_space(self, place: NDArray[np.float64], step: int) -> NDArray[np.float64]:
        a, b, c = np.moveaxis(self._sight(place, step), -1, 0)
        h = np.hypot(a, b)
        square = h**2 + c**2
        azimuth = np.zeros((*a.shape, 3, 3))
        azimuth[..., 0, 0] = 2.0 * a * b / h**4
        azimuth[..., 0, 1] = azimuth[..., 1, 0] = (b**2 - a**2) / h**4
        azimuth[..., 1, 1] = -azimuth[..., 0, 0]
        # Of the elevation by h and c, then of h by a and b.
        by_h = -c / square
        by_hh, by_hc = 2.0 * h * c / square**2, (c**2 - h**2) / square**2
        elevation = np.zeros_like(azimuth)
        elevation[..., 0, 0] = by_hh * (a / h) ** 2 + by_h * b**2 / h**3
        elevation[..., 1, 1] = by_hh * (b / h) ** 2 + by_h * a**2 / h**3
        elevation[..., 0, 1] = elevation[..., 1, 0] = (by_hh - by_h / h) * a * b / h**2
        elevation[..., 0, 2] = elevation[..., 2, 0] = by_hc * a / h
        elevation[..., 1, 2] = elevation[..., 2, 1] = by_hc * b / h
        elevation[..., 2, 2] = -by_hh
        parts = [azimuth] if self.runs.scenario.azimuth_only else [azimuth, elevation]
        axes = self.runs.axes[step]
        turned = [np.einsum("nji,...njk,nkl->...nil", axes, part, axes) for part in parts]
        return np.concatenate(turned, axis=-3)
