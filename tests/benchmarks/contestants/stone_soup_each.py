"""Stone Soup as its manual has it: every bearing an update of its own, at its own time."""

from __future__ import annotations

from datetime import datetime, timedelta
from functools import lru_cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np
from equations import bearing_rows
from model import transition, unit_noise

from contestants.base import Contestant, Estimate, Run
from contestants.filtering import FIRST_GUESS_SIGMA

if TYPE_CHECKING:
    from model import Pass
    from numpy.typing import NDArray


def _models(data: Pass) -> tuple[type[Any], type[Any]]:
    """Return measurement and transition models; states are scaled, and biases are part of them."""
    from stonesoup.base import Property
    from stonesoup.models.base import LinearModel, TimeVariantModel
    from stonesoup.models.measurement.base import MeasurementModel
    from stonesoup.models.transition.base import TransitionModel
    from stonesoup.types.array import CovarianceMatrix, StateVector

    errors = data.error_sigma.size
    width = data.scale.size
    size = width + errors * data.sensor_m.shape[0]

    class Bearing(MeasurementModel):  # type: ignore[misc]
        """Whitened rows of one bearing, of which zero is measured."""

        index: int = Property()

        @property
        def ndim_meas(self) -> int:
            return 2

        def covar(self, **_: object) -> Any:
            return np.eye(2).view(CovarianceMatrix)

        def _rows(self, state: Any, *, derivatives: bool) -> tuple[Any, Any, Any, slice]:
            i = self.index
            flat = np.asarray(state.state_vector, dtype=np.float64).ravel()
            first = width + int(data.sensor[i]) * errors
            own = slice(first, first + errors)
            error = flat[own] * data.error_sigma
            rows = bearing_rows(
                (flat[:3] * data.scale[:3] - data.sensor_m[data.sensor[i]])[None],
                (data.azimuth_rad[i : i + 1], data.elevation_rad[i : i + 1]),
                (error[:2] + error[2:4] * data.time_s[i])[None],
                float(data.sigma_rad),
                jacobian=derivatives,
            )
            return *rows, own

        def function(self, state: Any, noise: bool = False, **_: object) -> Any:
            del noise
            return StateVector(self._rows(state, derivatives=False)[0][0])

        def jacobian(self, state: Any, **_: object) -> Any:
            _, by_place, by_angles, own = self._rows(state, derivatives=True)
            matrix = np.zeros((2, size))
            matrix[:, :3] = by_place[0] * data.scale[:3]
            both = np.concatenate([by_angles[0], by_angles[0] * data.time_s[self.index]], axis=1)
            matrix[:, own] = both * data.error_sigma
            return matrix

        def rvs(self, *_: object, **__: object) -> Any:
            raise NotImplementedError

        def pdf(self, *_: object, **__: object) -> Any:
            raise NotImplementedError

    class Motion(TransitionModel, LinearModel, TimeVariantModel):  # type: ignore[misc]
        """White noise on the jerk; biases stay."""

        @property
        def ndim_state(self) -> int:
            return size

        def matrix(self, time_interval: timedelta, **_: object) -> NDArray[np.float64]:
            return _scaled(time_interval.total_seconds())[0]

        def covar(self, time_interval: timedelta, **_: object) -> Any:
            return _scaled(time_interval.total_seconds())[1].view(CovarianceMatrix)

        def rvs(self, *_: object, **__: object) -> Any:
            raise NotImplementedError

        def pdf(self, *_: object, **__: object) -> Any:
            raise NotImplementedError

    @lru_cache(maxsize=2)
    def _scaled(seconds: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        step = np.array([seconds])
        turn, noise = np.eye(size), np.zeros((size, size))
        turn[:width, :width] = np.kron(transition(step)[0], np.eye(3))
        noise[:width, :width] = np.kron(unit_noise(step)[0], np.eye(3)) * float(data.noise) ** 2
        turn[:width, :width] *= data.scale / data.scale[:, None]
        noise[:width, :width] /= data.scale * data.scale[:, None]
        return turn, noise

    return Bearing, Motion


class _EachRun(Run):
    def __init__(self, data: Pass) -> None:
        from stonesoup.types.detection import Detection
        from stonesoup.types.state import GaussianState

        self._data = data
        bearing, motion = _models(data)
        self._motion = motion()
        self._width = data.scale.size
        count = data.error_sigma.size * data.sensor_m.shape[0]
        size = self._width + count
        begin = datetime(2000, 1, 1)
        self._detections = []
        for index in np.argsort(data.time_s, kind="stable").tolist():
            model = bearing(ndim_state=size, mapping=tuple(range(size)), index=index)
            when = begin + timedelta(seconds=float(data.time_s[index]))
            self._detections.append(
                Detection(np.zeros((2, 1)), timestamp=when, measurement_model=model)
            )
        # The smoother takes a smoothed prediction for what was predicted, so that knots cannot be
        # steps of their own: they are read off the nearest bearing's state, milliseconds away.
        time = np.sort(data.time_s)
        after = np.clip(np.searchsorted(time, data.knots_s), 1, time.size - 1)
        nearer = data.knots_s - time[after - 1] < time[after] - data.knots_s
        self._nearest = after - nearer
        self._apart_s = data.knots_s - time[self._nearest]
        mean = np.concatenate([data.guess[0] / data.scale, np.zeros(count)])
        sigma = np.concatenate([FIRST_GUESS_SIGMA[: self._width] / data.scale, np.ones(count)])
        at = begin + timedelta(seconds=float(data.knots_s[0]))
        self._prior = GaussianState(mean[:, None], np.diag(sigma**2), timestamp=at)

    def solve(self) -> Estimate:
        from stonesoup.predictor.kalman import ExtendedKalmanPredictor
        from stonesoup.smoother.kalman import ExtendedKalmanSmoother
        from stonesoup.types.hypothesis import SingleHypothesis
        from stonesoup.types.track import Track
        from stonesoup.updater.kalman import ExtendedKalmanUpdater

        predictor = ExtendedKalmanPredictor(self._motion)
        updater = ExtendedKalmanUpdater(force_symmetric_covariance=True)
        track, state = Track(), self._prior
        for detection in self._detections:
            prediction = predictor.predict(state, timestamp=detection.timestamp)
            state = updater.update(SingleHypothesis(prediction, detection))
            track.append(state)
        smoothed = ExtendedKalmanSmoother(self._motion).smooth(track)
        self._smoothed = [smoothed[int(k)] for k in self._nearest]
        data, width = self._data, self._width
        states = np.stack([np.asarray(s.state_vector, np.float64).ravel() for s in self._smoothed])
        errors = states[-1, width:].reshape(data.sensor_m.shape[0], -1) * data.error_sigma
        turn = np.kron(transition(self._apart_s), np.eye(3))
        path = np.einsum("kij,kj->ki", turn, states[:, :width] * data.scale)
        return Estimate(path, errors, 1)

    def marginals(self) -> NDArray[np.float64]:
        width, scale = self._width, self._data.scale
        found = np.stack([np.asarray(s.covar, np.float64) for s in self._smoothed])
        found = found[:, :width, :width] * scale[:, None] * scale
        turn = np.kron(transition(self._apart_s), np.eye(3))
        return np.asarray(turn @ found @ np.swapaxes(turn, 1, 2))


class StoneSoupEach(Contestant):
    """Stone Soup, one update a bearing."""

    name = "stone-soup"
    about = "Stone Soup: EKF + RTS smoother, biases in the state, one update a bearing"
    same_cost = False
    bearings_only = True

    @classmethod
    def missing(cls) -> str | None:
        return None if find_spec("stonesoup") else "stonesoup"

    def set_up(self, data: Pass) -> Run:
        return _EachRun(data)
