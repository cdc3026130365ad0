"""What the filters share: measurements gathered at the knots, and a state with all errors.

Filters do not minimise the cost: each measurement is linearised (or sampled) once, where the filter
was. Their state is (position, velocity, acceleration, errors of all sensors) at a knot, in scaled
deviations from the first guess; all measurements within half a second are one update. They begin
with sigmas of how far the first guess is off, not with the wide prior, which would ruin them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from equations import tables
from model import transition, unit_noise

from contestants.base import Estimate
from contestants.stacked import Stack

if TYPE_CHECKING:
    from model import Pass
    from numpy.typing import NDArray

FIRST_GUESS_SIGMA = np.repeat([5e3, 50.0, 1.0], 3)
"""Sigmas of the first guess: m, m/s, m/s^2."""


class Filtering:
    """A pass as a filter sees it.

    Attributes
    ----------
    size
        Of the state.
    updates
        One stack of measurements for each step (a knot; a set of arrivals of what stands still).
    turn, noise
        Shape (size, size): transition and its noise from one step to the next.
    covariance
        Shape (size, size): of the first state, before its measurements.
    offsets
        Shape (steps, size): what a step adds to the state beside the transition, because the first
        guess is not a path of the model.
    """

    def __init__(self, data: Pass) -> None:
        self.data = data
        self._width = data.scale.size
        errors = data.error_sigma.size * data.sensor_m.shape[0]
        self.size = self._width + errors
        self.turn, self.noise = np.eye(self.size), np.zeros((self.size, self.size))
        found = [table.at_nearest_knots() for table in tables(data)]
        off = FIRST_GUESS_SIGMA[: self._width].copy()
        if np.isfinite(data.altitude_sigma_m):
            off[2] = data.altitude_sigma_m
        self.covariance = np.diag(np.concatenate([off / data.scale, np.ones(errors)]) ** 2)
        self._moves = data.knots_s.size > 1
        if not self._moves:
            (table,) = found
            self.updates = [
                Stack(data, (0,), [(table, np.array([k]))], measurements_only=True)
                for k in range(len(table))
            ]
            self.offsets = np.zeros((len(table), self.size))
        else:
            self._move(found)

    def _move(self, found: list) -> None:  # type: ignore[type-arg]
        data, width = self.data, self._width
        steps = np.diff(data.knots_s)
        # Knots are evenly spaced.
        turn = np.kron(transition(steps[:1])[0], np.eye(3))
        noise = np.kron(unit_noise(steps[:1])[0], np.eye(3)) * data.noise**2
        self.turn[:width, :width] = turn * data.scale / data.scale[:, None]
        self.noise[:width, :width] = noise / data.scale[:, None] / data.scale
        self.offsets = np.zeros((data.knots_s.size, self.size))
        self.offsets[1:, :width] = (data.guess[:-1] @ turn.T - data.guess[1:]) / data.scale
        knots = np.arange(data.knots_s.size)
        edges = [np.searchsorted(table.interval, np.append(knots, knots.size)) for table in found]
        self.updates = []
        for k in knots:
            parts = [
                (table, slice(int(edge[k]), int(edge[k + 1])))
                for table, edge in zip(found, edges, strict=True)
                if edge[k + 1] > edge[k]
            ]
            self.updates.append(Stack(data, (int(k),), parts, measurements_only=True))

    def rows(
        self, step: int, state: NDArray[np.float64], *, derivatives: bool = True
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return whitened rows of a step's measurements, and their derivatives by the state."""
        stack, width = self.updates[step], self._width
        errors = state[width:].reshape(self.data.sensor_m.shape[0], -1)
        residual, part = stack.evaluate(
            [state[:width]], errors[stack.sensors], derivatives=derivatives
        )
        if not derivatives:
            return residual, part
        jacobian = np.zeros((residual.size, self.size))
        jacobian[:, :width] = part[:, :width]
        columns = width + np.arange(errors.size).reshape(errors.shape)[stack.sensors].ravel()
        jacobian[:, columns] = part[:, width:]
        return residual, jacobian

    def estimate(self, states: NDArray[np.float64]) -> Estimate:
        """Return smoothed states (steps, size) as an estimate."""
        data, width = self.data, self._width
        kept = states if self._moves else states[-1:]
        errors = kept[0, width:].reshape(data.sensor_m.shape[0], -1) * data.error_sigma
        return Estimate(data.guess + kept[:, :width] * data.scale, errors, 1)

    def covariances(self, scaled: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return SI covariances of the knots from smoothed ones (steps, size, size)."""
        width = self._width
        kept = scaled if self._moves else scaled[-1:]
        scale = self.data.scale
        return np.asarray(kept[:, :width, :width] * scale[:, None] * scale)
