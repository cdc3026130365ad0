"""Kalman filters of the study from the air (Kallin 2021): second-order extended, and unscented.

The emitter stands still, so there is no prediction and no process noise. Both filters begin with
the start of :mod:`geograph.scenarios.aoa_estimators`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.scenarios.aoa_estimators import (
    Estimates,
    Recorder,
    gauss_newton_start,
    within_reach,
)
from geograph.scenarios.aoa_model import AngleModel, wrapped

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.scenarios.airborne import Runs

ALPHA, BETA, KAPPA = 1e-3, 2.0, 0.0
"""Spread, prior knowledge and secondary scaling of the sigma points (Wan and van der Merwe)."""


def extended_kalman(runs: Runs, *, second_order: bool = True) -> Estimates:
    """Filter by the extended Kalman filter with the second-order terms of the angles.

    The expected angle is h(x) + tr(h'' P) / 2, and its covariance gains tr(h'' P h'' P) / 2 (Y.
    Bar-Shalom et al., Estimation with Applications to Tracking and Navigation, 2001, section 10.3).

    Parameters
    ----------
    runs
        What was measured.
    second_order
        Without these terms it is the recursive least squares.
    """
    model = AngleModel.of(runs)
    start = gauss_newton_start(model)
    state, covariance = start.state, start.covariance
    kept = Recorder(model)
    kept.keep(0, state, covariance)
    for k in range(1, runs.azimuth_rad.shape[1]):
        angle, rows = model.linearise(state, k)
        noise: NDArray[np.float64] = model.noise()
        if second_order:
            bent = model.curvature(state, k) @ covariance[:, None]
            angle = angle + 0.5 * np.trace(bent, axis1=-2, axis2=-1)
            noise = noise + 0.5 * np.einsum("rmab,rnba->rmn", bent, bent)
        across = covariance @ np.swapaxes(rows, -1, -2)
        gain = across @ np.linalg.inv(rows @ across + noise)
        residual = wrapped(model.measured(k) - angle)
        state = within_reach(model, state + np.einsum("rnm,rm->rn", gain, residual))
        rest = np.eye(model.size) - gain @ rows
        covariance = rest @ covariance @ np.swapaxes(rest, -1, -2) + gain @ noise @ np.swapaxes(
            gain, -1, -2
        )
        kept.keep(k, state, covariance)
    return kept.estimates


def unscented_kalman(runs: Runs, *, alpha: float = ALPHA) -> Estimates:
    """Filter by the scaled unscented Kalman filter, the angles' noise in its state.

    Azimuths are averaged as differences from that of the middle point, so that they may wrap.

    Parameters
    ----------
    runs
        What was measured.
    alpha
        Spread of the sigma points.
    """
    model = AngleModel.of(runs)
    start = gauss_newton_start(model)
    state, covariance = start.state, start.covariance
    noise = model.noise()
    kept = Recorder(model)
    kept.keep(0, state, covariance)
    size, angles = model.size, len(noise)
    total = size + angles
    spread = alpha**2 * (total + KAPPA)
    weight = np.full(2 * total + 1, 0.5 / spread)
    weight[0] = 1.0 - total / spread
    of_covariance = weight.copy()
    of_covariance[0] += 1.0 - alpha**2 + BETA
    for k in range(1, runs.azimuth_rad.shape[1]):
        offset, noise_offset = _sigma_points(covariance, noise, spread)
        angle = model.predict(state[:, None] + offset, k) + noise_offset
        from_middle = wrapped(angle - angle[:, :1])
        mean = np.einsum("s,rsm->rm", weight, from_middle)
        off = from_middle - mean[:, None]
        innovation = np.einsum("s,rsm,rsn->rmn", of_covariance, off, off)
        cross = np.einsum("s,rsa,rsm->ram", of_covariance, offset, off)
        gain = cross @ np.linalg.inv(innovation)
        residual = wrapped(model.measured(k) - angle[:, 0] - mean)
        state = within_reach(model, state + np.einsum("rnm,rm->rn", gain, residual))
        covariance = covariance - gain @ innovation @ np.swapaxes(gain, -1, -2)
        covariance = 0.5 * (covariance + np.swapaxes(covariance, -1, -2))
        kept.keep(k, state, covariance)
    return kept.estimates


def _sigma_points(
    covariance: NDArray[np.float64], noise: NDArray[np.float64], spread: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return offsets of states, shape (runs, points, n), and of angles, shape (points, m)."""
    runs, size = covariance.shape[:2]
    angles = len(noise)
    root = np.swapaxes(np.linalg.cholesky(spread * covariance), -1, -2)
    offset = np.zeros((runs, 1 + 2 * (size + angles), size))
    offset[:, 1 : 1 + size] = root
    offset[:, 1 + size + angles : 1 + 2 * size + angles] = -root
    noise_root = np.linalg.cholesky(spread * noise).T
    noise_offset = np.zeros((1 + 2 * (size + angles), angles))
    noise_offset[1 + size : 1 + size + angles] = noise_root
    noise_offset[1 + 2 * size + angles :] = -noise_root
    return offset, noise_offset
