"""Stone Soup: extended Kalman filter and Rauch-Tung-Striebel smoother."""

from __future__ import annotations

from datetime import datetime, timedelta
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from contestants.base import Contestant, Estimate, Run
from contestants.filtering import Filtering

if TYPE_CHECKING:
    from model import Pass
    from numpy.typing import NDArray


def _models(filtering: Filtering) -> tuple[type[Any], type[Any]]:
    """Return measurement and transition models; Stone Soup is imported when it is used."""
    from stonesoup.base import Property
    from stonesoup.models.base import LinearModel, TimeVariantModel
    from stonesoup.models.measurement.base import MeasurementModel
    from stonesoup.models.transition.base import TransitionModel
    from stonesoup.types.array import CovarianceMatrix, StateVector

    class Rows(MeasurementModel):  # type: ignore[misc]
        """Whitened rows of one step, of which zero is measured."""

        step: int = Property()

        @property
        def ndim_meas(self) -> int:
            return filtering.updates[self.step].rows

        def covar(self, **_: object) -> Any:
            return np.eye(self.ndim_meas).view(CovarianceMatrix)

        def function(self, state: Any, noise: bool = False, **_: object) -> Any:
            del noise
            flat = np.asarray(state.state_vector, dtype=np.float64).ravel()
            return StateVector(filtering.rows(self.step, flat, derivatives=False)[0])

        def jacobian(self, state: Any, **_: object) -> Any:
            flat = np.asarray(state.state_vector, dtype=np.float64).ravel()
            return filtering.rows(self.step, flat)[1]

        def rvs(self, *_: object, **__: object) -> Any:
            raise NotImplementedError

        def pdf(self, *_: object, **__: object) -> Any:
            raise NotImplementedError

    class Motion(TransitionModel, LinearModel, TimeVariantModel):  # type: ignore[misc]
        """Transition of deviations from the first guess: linear, and an offset of its own."""

        step: int = Property()

        @property
        def ndim_state(self) -> int:
            return filtering.size

        def matrix(self, **_: object) -> NDArray[np.float64]:
            return filtering.turn

        def function(self, state: Any, noise: bool = False, **_: object) -> Any:
            del noise
            moved = filtering.turn @ state.state_vector
            return moved + StateVector(filtering.offsets[self.step])

        def covar(self, **_: object) -> Any:
            return filtering.noise.view(CovarianceMatrix)

        def rvs(self, *_: object, **__: object) -> Any:
            raise NotImplementedError

        def pdf(self, *_: object, **__: object) -> Any:
            raise NotImplementedError

    return Rows, Motion


class _StoneSoupRun(Run):
    def __init__(self, data: Pass) -> None:
        from stonesoup.types.detection import Detection
        from stonesoup.types.state import GaussianState

        self._filtering = Filtering(data)
        rows, motion = _models(self._filtering)
        begin = datetime(2000, 1, 1)
        size = self._filtering.size
        self._steps = []
        for step, stack in enumerate(self._filtering.updates):
            when = begin + timedelta(seconds=step)
            model = rows(ndim_state=size, mapping=tuple(range(size)), step=step)
            zero = np.zeros((stack.rows, 1))
            detection = Detection(zero, timestamp=when, measurement_model=model)
            self._steps.append((motion(step=step), detection))
        self._prior = GaussianState(
            np.zeros((size, 1)), self._filtering.covariance, timestamp=begin - timedelta(seconds=1)
        )

    def solve(self) -> Estimate:
        from stonesoup.predictor.kalman import ExtendedKalmanPredictor
        from stonesoup.smoother.kalman import ExtendedKalmanSmoother
        from stonesoup.types.hypothesis import SingleHypothesis
        from stonesoup.types.prediction import GaussianStatePrediction
        from stonesoup.types.track import Track
        from stonesoup.updater.kalman import ExtendedKalmanUpdater

        updater = ExtendedKalmanUpdater(force_symmetric_covariance=True)
        track = Track()
        first = self._steps[0][1]
        prediction = GaussianStatePrediction(
            self._prior.state_vector,
            self._prior.covar,
            timestamp=first.timestamp,
            transition_model=self._steps[0][0],
        )
        for step, (motion, detection) in enumerate(self._steps):
            if step:
                predictor = ExtendedKalmanPredictor(motion)
                prediction = predictor.predict(track[-1], timestamp=detection.timestamp)
            track.append(updater.update(SingleHypothesis(prediction, detection)))
        self._smoothed = ExtendedKalmanSmoother(self._steps[0][0]).smooth(track)
        states = [np.asarray(s.state_vector, dtype=np.float64).ravel() for s in self._smoothed]
        return self._filtering.estimate(np.stack(states))

    def marginals(self) -> NDArray[np.float64]:
        covariances = np.stack([np.asarray(s.covar, dtype=np.float64) for s in self._smoothed])
        return self._filtering.covariances(covariances)


class StoneSoup(Contestant):
    """Stone Soup."""

    name = "gathered-stone-soup"
    about = "Stone Soup: EKF + RTS smoother, biases in the state, one update a knot"
    same_cost = False

    @classmethod
    def missing(cls) -> str | None:
        return None if find_spec("stonesoup") else "stonesoup"

    def set_up(self, data: Pass) -> Run:
        return _StoneSoupRun(data)
