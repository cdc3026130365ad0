"""The published estimators of satellites, angles only: one window, and the path as a whole.

R. Sprang (2015): triangulation; static, velocity and acceleration + velocity non-linear
optimisation (Gauss-Newton) of each window; with covariance intersection, where the weights of a
window sum to one, Sigma^-1 = J^T (W Sigma_z^-1) J with W = 1 / n; and with the kinematic model over
the whole path, where the transition between the states of neighbouring windows is appended to the
Jacobian. Initial velocities and accelerations are finite differences of triangulated positions.

Levy et al. take the last of these as the baseline, and in BDNLO append bias and drift of both
angles of every sensor to its state, without a prior (``biased=True`` here).

What the papers leave open for us: windows do not overlap, so that no measurement counts twice; the
variances of the transitions, which are said to be large, are in :class:`Kinematic`; there is no
damping; an optimisation that does not settle in thirty steps has diverged.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from geograph.scenarios.angles_windows import Windows, predict, triangulate

if TYPE_CHECKING:
    from numpy.typing import NDArray

_STEPS = 30
_SETTLED = 1e-6
_FARTHEST_M = 1e9


@dataclass(frozen=True, eq=False)
class PathEstimate:
    """States of all windows.

    Parameters
    ----------
    time_s
        Shape (M,), seconds.
    state
        Shape (M, 3 order), SI, ECEF.
    covariance
        Shape (M, 3 order, 3 order), by the estimator itself.
    converged
        Shape (M,), bool: whether each window's optimisation settled.
    constants
        Shape (4 sensors,) with ``biased``: biases of azimuth of all sensors, then of elevation,
        then the drifts in the same order; rad and rad/s. Else empty.
    """

    time_s: NDArray[np.float64]
    state: NDArray[np.float64]
    covariance: NDArray[np.float64]
    converged: NDArray[np.bool_]
    constants: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    @property
    def position_m(self) -> NDArray[np.float64]:
        """Positions, shape (M, 3), metres, ECEF."""
        return self.state[:, :3]

    @property
    def position_covariance_m2(self) -> NDArray[np.float64]:
        """Covariances of the positions, shape (M, 3, 3)."""
        return self.covariance[:, :3, :3]

    def kinematic_covariance_m2(self, reach_s: float) -> NDArray[np.float64]:
        """Return Levy et al.'s kinematic confidence covariance, shape (M, 3, 3).

        That of the position, plus t^2 that of the velocity, plus (t^2 / 2)^2 that of the
        acceleration.

        Parameters
        ----------
        reach_s
            t, seconds.
        """
        total = self.covariance[:, :3, :3].copy()
        if self.state.shape[1] > 3:
            total += reach_s**2 * self.covariance[:, 3:6, 3:6]
        if self.state.shape[1] > 6:
            total += (reach_s**2 / 2.0) ** 2 * self.covariance[:, 6:, 6:]
        return total


@dataclass(frozen=True, kw_only=True)
class Kinematic:
    """How far a state may be from the transition of the one before, standard deviations.

    Parameters
    ----------
    position_m, velocity_m_s, acceleration_m_s2
        Of each axis.
    """

    position_m: float = 1e3
    velocity_m_s: float = 100.0
    acceleration_m_s2: float = 10.0

    def sigma(self, order: int) -> NDArray[np.float64]:
        """Return the standard deviations of a state, shape (3 order,)."""
        values = [self.position_m, self.velocity_m_s, self.acceleration_m_s2]
        return np.repeat(values[:order], 3)


def triangulation(windows: Windows) -> PathEstimate:
    """Return the triangulated positions with their covariances."""
    position, covariance = triangulate(windows)
    settled = np.asarray(np.isfinite(position).all(axis=1))
    return PathEstimate(windows.time_s, position, covariance, settled)


def first_states(windows: Windows, order: int) -> NDArray[np.float64]:
    """Return triangulated positions and their finite differences, shape (M, 3 order)."""
    blocks = [triangulate(windows)[0]]
    while len(blocks) < order:
        blocks.append(np.gradient(blocks[-1], windows.time_s, axis=0))
    return np.concatenate(blocks, axis=1)


def optimise(windows: Windows, order: int, *, intersection: bool = False) -> PathEstimate:
    """Optimise the state of each window by itself.

    Parameters
    ----------
    windows
        The measurements.
    order
        1: static, 2: with velocity, 3: with velocity and acceleration.
    intersection
        Whether the weights of a window sum to one. With equal weights that widens the covariance
        and leaves the estimate as it is.
    """
    scale = _scale(windows, order)
    state = first_states(windows, order)
    settled = np.zeros(windows.count, dtype=bool)
    normal = np.broadcast_to(np.eye(3 * order), (windows.count, 3 * order, 3 * order)).copy()
    for _ in range(_STEPS):
        normal, gradient = _window_blocks(windows, state, scale, intersection=intersection)
        step, good = _solved(normal, gradient)
        settled = good & (np.einsum("mi,mi->m", step, gradient) < _SETTLED)
        state = state + np.where(good[:, None], step, 0.0) * scale
        # A window that has gone astray stays where it is, out of the others' way.
        state = np.where(np.abs(state) < _FARTHEST_M, state, 0.0)
        if settled.all():
            break
    covariance = scale[:, None] * _inverse(normal) * scale
    return PathEstimate(windows.time_s, state, covariance, settled)


def optimise_path(
    windows: Windows,
    order: int,
    *,
    kinematic: Kinematic | None = None,
    intersection: bool = True,
    biased: bool = False,
    start: NDArray[np.float64] | None = None,
) -> PathEstimate:
    """Optimise the states of all windows together, with the kinematic model between them.

    Parameters
    ----------
    windows
        The measurements.
    order
        2 or 3.
    kinematic
        Standard deviations of the transitions; None: the usual ones.
    intersection
        Whether the weights of a window sum to one.
    biased
        Whether bias and drift of every sensor are unknowns, too (BDNLO).
    start
        Shape (M, 3 order): where to start; None: from the triangulated positions.
    """
    count, size = windows.count, 3 * order
    scale = _scale(windows, order)
    model = (kinematic or Kinematic()).sigma(order)
    step_s = np.diff(windows.time_s)
    transition = np.kron(_transition(order, step_s), np.eye(3)) * scale / scale[:, None]
    weight = (scale / model) ** 2
    errors = _error_columns(windows) if biased else np.zeros((count, windows.size, 2, 0))
    sensors = errors.shape[-1] // 4
    unit = np.repeat([1e-4, 1e-4 / max(float(np.ptp(windows.tag_s)), 1.0)], 2 * sensors)
    state = first_states(windows, order) if start is None else start.copy()
    constants = np.zeros(4 * sensors)
    total, settled = count * size, False
    normal = np.eye(total + constants.size)
    for _ in range(_STEPS):
        normal, gradient = _whole_system(
            windows, state, scale, errors * unit, constants / unit, intersection=intersection
        )
        _add_transitions(normal, gradient, state / scale, transition, weight)
        step, good = _solved(normal[None], gradient[None])
        if not good[0]:
            break
        settled = bool(step[0] @ gradient < _SETTLED * count)
        state = state + step[0, :total].reshape(count, size) * scale
        constants = constants + step[0, total:] * unit
        if settled or not np.abs(state).max() < _FARTHEST_M:
            break
    inverse = _inverse(normal[None])[0][:total, :total].reshape(count, size, count, size)
    own = inverse[np.arange(count), :, np.arange(count)]
    return PathEstimate(
        windows.time_s,
        state,
        scale[:, None] * own * scale,
        np.full(count, settled),
        constants,
    )


def _scale(windows: Windows, order: int) -> NDArray[np.float64]:
    """Return units in which position, velocity and acceleration matter alike within a window."""
    half = max(windows.half_s, 1e-3)
    return np.repeat(1e3 * half ** -np.arange(order, dtype=np.float64), 3)


def _transition(order: int, step_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the transitions of one axis by steps in seconds, shape (M - 1, order, order)."""
    matrix = np.broadcast_to(np.eye(order), (step_s.size, order, order)).copy()
    for row in range(order - 1):
        matrix[:, row, row + 1] = step_s
    if order > 2:
        matrix[:, 0, 2] = step_s**2 / 2.0
    return matrix


def _weights(windows: Windows, *, intersection: bool) -> NDArray[np.float64]:
    """Return the square roots of the weights of the angles, shape (M, n, 1)."""
    share = 1.0 / windows.size if intersection else 1.0
    return np.asarray(np.sqrt(share) / windows.sigma_rad[..., None])


def _window_blocks(
    windows: Windows,
    state: NDArray[np.float64],
    scale: NDArray[np.float64],
    *,
    intersection: bool,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return normal matrices, shape (M, d, d), and right sides, (M, d), in scaled states."""
    found = predict(windows, state)
    root = _weights(windows, intersection=intersection)
    rows = (found.jacobian * scale * root[..., None]).reshape(windows.count, -1, scale.size)
    right = (found.residual_rad * root).reshape(windows.count, -1, 1)
    across = np.swapaxes(rows, 1, 2)
    return across @ rows, (across @ right)[..., 0]


def _error_columns(windows: Windows) -> NDArray[np.float64]:
    """Return derivatives of the angles by biases and drifts, shape (M, n, 2, 4 sensors)."""
    sensors = int(windows.sensor.max()) + 1
    mine = (windows.sensor[..., None] == np.arange(sensors)).astype(np.float64)
    none = np.zeros_like(mine)
    elapsed = (windows.tag_s - windows.tag_s.min())[..., None]
    azimuth = np.concatenate([mine, none, elapsed * mine, none], axis=-1)
    elevation = np.concatenate([none, mine, none, elapsed * mine], axis=-1)
    return np.stack([azimuth, elevation], axis=-2)


def fitted_errors(windows: Windows, constants: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the errors, shape (M, n, 2), radians, that biases and drifts make of each angle."""
    return _error_columns(windows) @ constants


def _whole_system(
    windows: Windows,
    state: NDArray[np.float64],
    scale: NDArray[np.float64],
    errors: NDArray[np.float64],
    constants: NDArray[np.float64],
    *,
    intersection: bool,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the normal matrix of all states and constants, and the right side."""
    count, size = state.shape
    found = predict(windows, state)
    root = _weights(windows, intersection=intersection)
    path = (found.jacobian * scale * root[..., None]).reshape(count, -1, size)
    wrong = (errors * root[..., None]).reshape(count, 2 * windows.size, errors.shape[-1])
    right = ((found.residual_rad - errors @ constants) * root).reshape(count, -1, 1)
    total = count * size
    normal = np.zeros((total + constants.size, total + constants.size))
    gradient = np.zeros(total + constants.size)
    across = np.swapaxes(path, 1, 2)
    blocks = normal[:total, :total].reshape(count, size, count, size)
    blocks[np.arange(count), :, np.arange(count)] = across @ path
    gradient[:total] = (across @ right).ravel()
    if constants.size:
        normal[:total, total:] = (across @ wrong).reshape(total, -1)
        normal[total:, :total] = normal[:total, total:].T
        flat = wrong.reshape(-1, constants.size)
        normal[total:, total:] = flat.T @ flat
        gradient[total:] = flat.T @ right.ravel()
    return normal, gradient


def _add_transitions(
    normal: NDArray[np.float64],
    gradient: NDArray[np.float64],
    state: NDArray[np.float64],
    transition: NDArray[np.float64],
    weight: NDArray[np.float64],
) -> None:
    """Add the rows x[k+1] - F x[k] = 0, in scaled states, to a system in place."""
    count, size = state.shape
    miss = weight * (state[1:] - (transition @ state[:-1, :, None])[..., 0])
    back = np.swapaxes(transition, 1, 2)
    blocks = normal[: count * size, : count * size].reshape(count, size, count, size)
    now, then = np.arange(count - 1), np.arange(1, count)
    blocks[now, :, now] += back @ (weight[:, None] * transition)
    blocks[then, :, then] += np.diag(weight)
    blocks[now, :, then] -= back * weight
    blocks[then, :, now] -= weight[:, None] * transition
    right = gradient[: count * size].reshape(count, size)
    right[:-1] += (back @ miss[..., None])[..., 0]
    right[1:] -= miss


def _solved(
    normal: NDArray[np.float64], right: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Solve stacked systems; tell which have a finite solution that goes downhill."""
    try:
        step = np.linalg.solve(normal, right[..., None])[..., 0]
    except np.linalg.LinAlgError:
        step = (_inverse(normal) @ right[..., None])[..., 0]
    good = np.isfinite(step).all(axis=-1) & (np.einsum("mi,mi->m", step, right) >= 0.0)
    return np.where(good[:, None], step, 0.0), good


def _inverse(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return inverses of stacked matrices; not numbers where one is singular."""
    try:
        return np.asarray(np.linalg.inv(matrices))
    except np.linalg.LinAlgError:
        if len(matrices) == 1:
            return np.full_like(matrices, np.nan)
        return np.concatenate([_inverse(matrix[None]) for matrix in matrices])
