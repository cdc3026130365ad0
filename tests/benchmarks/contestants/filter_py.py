"""filterpy: unscented Kalman filter and Rauch-Tung-Striebel smoother."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from contestants.base import Contestant, Estimate, Run
from contestants.filtering import Filtering

if TYPE_CHECKING:
    from model import Pass
    from numpy.typing import NDArray


class _FilterPyRun(Run):
    def __init__(self, data: Pass) -> None:
        from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

        self._filtering = filtering = Filtering(data)
        self._step = 0
        size = filtering.size

        def move(state: NDArray[np.float64], _: float) -> NDArray[np.float64]:
            return np.asarray(filtering.turn @ state + filtering.offsets[self._step])

        def measure(state: NDArray[np.float64], step: int) -> NDArray[np.float64]:
            return filtering.rows(step, state, derivatives=False)[0]

        points = MerweScaledSigmaPoints(size, alpha=0.1, beta=2.0, kappa=0.0)
        self._filter = UnscentedKalmanFilter(
            dim_x=size, dim_z=1, dt=1.0, hx=measure, fx=move, points=points
        )
        self._filter.P = filtering.covariance.copy()
        self._filter.Q = filtering.noise + 1e-15 * np.eye(size)
        self._points = points

    def solve(self) -> Estimate:
        own, filtering = self._filter, self._filtering
        means, covariances = [], []
        for step, stack in enumerate(filtering.updates):
            self._step = step
            if step:
                own.predict()
            else:
                own.sigmas_f = self._points.sigma_points(own.x, own.P)
            own.update(np.zeros(stack.rows), R=np.eye(stack.rows), step=step)
            own.P = 0.5 * (own.P + own.P.T)
            means.append(own.x.copy())
            covariances.append(own.P.copy())
        states, self._covariances = self._smooth(np.array(means), np.array(covariances))
        return filtering.estimate(states)

    def _smooth(
        self, means: NDArray[np.float64], covariances: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        # Its smoother asks for the transition of one step after the other, from the last.
        own = self._filter
        steps = iter(range(len(means) - 1, 0, -1))
        count = 2 * self._filtering.size + 1
        asked = 0
        move = own.fx

        def backwards(state: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
            nonlocal asked
            if asked % count == 0:
                self._step = next(steps)
            asked += 1
            return np.asarray(move(state, dt))

        own.fx = backwards
        states, smoothed, _ = own.rts_smoother(means, covariances)
        own.fx = move
        return states, smoothed

    def marginals(self) -> NDArray[np.float64]:
        return self._filtering.covariances(self._covariances)


class FilterPy(Contestant):
    """filterpy."""

    name = "filterpy"
    about = "filterpy: UKF + RTS smoother, biases in the state, one update a knot"
    same_cost = False

    @classmethod
    def missing(cls) -> str | None:
        return None if find_spec("filterpy") else "filterpy"

    def set_up(self, data: Pass) -> Run:
        return _FilterPyRun(data)
