"""GRI's tracker (gri-kalman): extended Kalman filter of one motion model, and its RTS smoother.

Its motion models have no place for errors of sensors: a measurement's sigma includes the prior
sigma of what its sensor may be off by. gri-convolve combines ellipsoids of single fixes, of which
bearings give none; its tracker is this one.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from equations import BearingTable, Table, tables

from contestants.base import Contestant, Estimate, Run
from contestants.filtering import FIRST_GUESS_SIGMA

if TYPE_CHECKING:
    from model import Pass
    from numpy.typing import NDArray

# It thinks in an Earth-fixed frame, and cannot be at the middle of the Earth.
_ORIGIN_M = np.array([6.4e6, 0.0, 0.0])


class _Bearings:
    """All bearings of a knot, as it asks for observables: zero is measured of whitened rows."""

    def __init__(self, table: Table, index: slice) -> None:
        self._table, self._index = table, index
        self._count = index.stop - index.start
        data = table.data
        span = float(data.knots_s[-1] - data.knots_s[0])
        bias, drift = float(data.error_sigma[0]), float(data.error_sigma[2]) * span
        self.value = np.zeros(2 * self._count)
        unknown = (bias**2 + drift**2) / float(data.sigma_rad) ** 2
        self.noise_covariance = (1.0 + unknown) * np.eye(2 * self._count)
        self._errors = np.zeros((data.sensor_m.shape[0], data.error_sigma.size))

    def _rows(self, state: NDArray[np.float64], *, jacobian: bool) -> Any:
        blocks = state.reshape(3, 3).copy()
        blocks[0] -= _ORIGIN_M
        each = np.broadcast_to(blocks, (self._count, 3, 3))
        return self._table.at(each, self._errors, self._index, jacobian=jacobian)

    def predicted(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the rows."""
        return np.asarray(self._rows(state, jacobian=False).residual.ravel())

    def jacobian(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return their derivatives by the state."""
        return np.asarray(self._rows(state, jacobian=True).by_knots.reshape(-1, 9))


class _GriRun(Run):
    def __init__(self, data: Pass) -> None:
        from gri_kalman import IMM, ConstantAcceleration

        self._data = data
        self._model = ConstantAcceleration(float(data.noise))
        self._tracker = IMM([self._model])
        (table,) = (t.at_nearest_knots() for t in tables(data) if isinstance(t, BearingTable))
        edges = np.searchsorted(table.interval, np.arange(data.knots_s.size + 1))
        self._observations = [
            _Bearings(table, slice(int(first), int(last))) for first, last in pairwise(edges)
        ]

    def solve(self) -> Estimate:
        from gri_kalman import rts_smooth

        data = self._data
        spread = np.eye(6)
        spread[:3] *= FIRST_GUESS_SIGMA[0] ** 2
        spread[3:] *= FIRST_GUESS_SIGMA[3] ** 2
        self._tracker.initialize(
            data.guess[0, :3] + _ORIGIN_M,
            spread[:3, :3],
            float(data.knots_s[0]),
            velocity_xyz=data.guess[0, 3:6],
            pos_vel_cov_xyz=spread,
        )
        for time, observation in zip(data.knots_s.tolist(), self._observations, strict=True):
            self._tracker.update_observable(observation, time)
        nodes = self._tracker.filtered_track()
        # The state before the first measurement stands first.
        self._smoothed = rts_smooth(self._model, nodes[-data.knots_s.size :])
        path = np.stack([state for _, state, _ in self._smoothed])
        path[:, :3] -= _ORIGIN_M
        return Estimate(path, np.zeros_like(data.true_errors), 1)

    def marginals(self) -> NDArray[np.float64]:
        return np.stack([covariance for _, _, covariance in self._smoothed])


class Gri(Contestant):
    """GRI's tracker."""

    name = "gri-kalman"
    about = "GRI's IMM tracker with one model (EKF) and its RTS smoother, without biases"
    same_cost = False
    too_slow = frozenset({"huge"})
    bearings_only = True

    @classmethod
    def missing(cls) -> str | None:
        if sys.version_info < (3, 12):
            return "gri-kalman needs Python 3.12 or newer"
        return None if find_spec("gri_kalman") else "gri-kalman"

    def set_up(self, data: Pass) -> Run:
        return _GriRun(data)
