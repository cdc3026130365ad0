"""Angles of a recording cut into windows, and what a window's kinematic state predicts of them.

Shared by the published estimators of Sprang (2015) and Levy et al.: the measurements in the order
of their time tags, in windows of equal number; each window's state is position, velocity and
acceleration at the middle of the window, in Earth-fixed axes, and the object moves by them along a
parabola within it. Light time and the turn of the Earth during it are included.

Nothing of ``geograph.factors`` is used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from geograph.constants import EARTH_ROTATION_RAD_S, SPEED_OF_LIGHT_M_S
from geograph.scenarios.observation import direction_from_angles
from geograph.scenarios.orbits import turned_about_z

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.recording import Recording

_LIGHT_TIME_STEPS = 4


@dataclass(frozen=True, eq=False)
class Windows:
    """Measurements of M windows of n each.

    Parameters
    ----------
    time_s
        Shape (M,): times of the states, half-way between the first and last tag of each window.
    tag_s
        Shape (M, n): time tags.
    sensor
        Shape (M, n), integer: which sensor measured.
    place_m
        Shape (M, n, 3): where it was, ECEF.
    angles_rad
        Shape (M, n, 2): azimuth and elevation on the axes of the frame.
    sigma_rad
        Shape (M, n): standard deviation of each of them, with all that is wrong with the sensor.
    """

    time_s: NDArray[np.float64]
    tag_s: NDArray[np.float64]
    sensor: NDArray[np.int64]
    place_m: NDArray[np.float64]
    angles_rad: NDArray[np.float64]
    sigma_rad: NDArray[np.float64]

    @property
    def count(self) -> int:
        """M, the number of windows."""
        return int(self.time_s.size)

    @property
    def size(self) -> int:
        """n, the number of measurements of each."""
        return int(self.tag_s.shape[1])

    @property
    def half_s(self) -> float:
        """Half of the mean length of a window, seconds."""
        return float(np.mean(self.tag_s[:, -1] - self.tag_s[:, 0])) / 2.0

    def corrected(self, error_rad: NDArray[np.float64]) -> Windows:
        """Return the windows with errors, shape (M, n, 2), radians, taken off the angles."""
        return replace(self, angles_rad=self.angles_rad - error_rad)


def cut(recording: Recording, count: int, sigma_rad: float) -> Windows:
    """Cut a recording's bearings into windows.

    Parameters
    ----------
    recording
        With bearings of sensors whose axes are ``"xyz"``.
    count
        Number of windows. Measurements that are left over by the division are spread between the
        windows and not used.
    sigma_rad
        Standard deviation of a measured angle.

    Raises
    ------
    ValueError
        If the recording has no bearings on the axes of its frame, or too few of them.
    """
    bearings = recording.bearings
    sensors = list(recording.sensors.values())
    if bearings is None or any(sensor.axes != "xyz" for sensor in sensors):
        raise ValueError(f"recording {recording.name!r}: expected bearings on the axes xyz alone")
    size = len(bearings) // count
    if size < 5:
        raise ValueError(
            f"recording {recording.name!r} has {len(bearings)} bearings for {count} windows; "
            "expected at least 5 in each, so that a window has more angles than unknowns"
        )
    place = np.empty((len(bearings), 3))
    for index, sensor in enumerate(sensors):
        rows = bearings.sensor == index
        place[rows] = sensor.position_at(bearings.time_s[rows])
    order = np.argsort(bearings.time_s, kind="stable")
    first = np.arange(count) * len(bearings) // count
    chosen = order[first[:, None] + np.arange(size)]
    tag = bearings.time_s[chosen]
    angles = np.stack([bearings.azimuth_rad, bearings.elevation_rad], axis=-1)[chosen]
    return Windows(
        time_s=(tag[:, 0] + tag[:, -1]) / 2.0,
        tag_s=tag,
        sensor=bearings.sensor[chosen],
        place_m=place[chosen],
        angles_rad=angles,
        sigma_rad=np.full(tag.shape, sigma_rad),
    )


def powers(windows: Windows, order: int, delay_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1, dt, dt^2 / 2 up to the order, shape (M, n, order), at the times of emission."""
    elapsed = windows.tag_s - delay_s - windows.time_s[:, None]
    return np.stack([np.ones_like(elapsed), elapsed, elapsed**2 / 2.0][:order], axis=-1)


@dataclass(frozen=True, eq=False)
class Predicted:
    """What states predict.

    Parameters
    ----------
    residual_rad
        Shape (M, n, 2): measured less predicted; azimuth within half a turn.
    jacobian
        Shape (M, n, 2, 3 order): derivative of the predicted angles by the state of the window.
    range_m
        Shape (M, n): distances.
    """

    residual_rad: NDArray[np.float64]
    jacobian: NDArray[np.float64]
    range_m: NDArray[np.float64]


def predict(windows: Windows, state: NDArray[np.float64]) -> Predicted:
    """Predict angles from the windows' states.

    Parameters
    ----------
    windows
        The measurements.
    state
        Shape (M, 3 order): position, velocity, acceleration as far as the order goes; SI, ECEF.
    """
    order = state.shape[1] // 3
    blocks = state.reshape(-1, order, 3)
    delay = np.zeros_like(windows.tag_s)
    for _ in range(_LIGHT_TIME_STEPS):
        basis = powers(windows, order, delay)
        place = turned_about_z(basis @ blocks, -EARTH_ROTATION_RAD_S * delay)
        sight = place - windows.place_m
        distance = np.linalg.norm(sight, axis=-1)
        turn = EARTH_ROTATION_RAD_S * delay
        delay = distance / SPEED_OF_LIGHT_M_S
    x, y, z = np.moveaxis(sight, -1, 0)
    level = np.hypot(x, y)
    angles = np.stack([np.arctan2(y, x), np.arctan2(z, level)], axis=-1)
    residual = windows.angles_rad - angles
    residual[..., 0] = np.remainder(residual[..., 0] + np.pi, 2.0 * np.pi) - np.pi
    azimuth = np.stack([-y, x, np.zeros_like(x)], axis=-1) / level[..., None] ** 2
    elevation = np.stack([-x * z, -y * z, level**2], axis=-1) / (level * distance**2)[..., None]
    # By the position before the turn, which is that of the state.
    rows = turned_about_z(np.stack([azimuth, elevation], axis=-2), turn[..., None])
    jacobian = rows[..., None, :] * basis[:, :, None, :, None]
    return Predicted(residual, jacobian.reshape(*residual.shape, 3 * order), distance)


def triangulate(windows: Windows, *, passes: int = 3) -> tuple[NDArray[np.float64], ...]:
    """Return the weighted least-squares points of all windows' lines of sight.

    Each point minimises the squared distances from the lines over (sigma range)^2, which are found
    anew in every pass. The Earth's turn during the light time is ignored, and so is the motion.

    Parameters
    ----------
    windows
        The measurements.
    passes
        How often ranges are brought up to date.

    Returns
    -------
    position_m
        Shape (M, 3), ECEF.
    covariance_m2
        Shape (M, 3, 3): the inverse of the normal matrices.
    """
    angles = windows.angles_rad
    direction = direction_from_angles(angles[..., 0], angles[..., 1], axes="xyz")
    across = np.eye(3) - direction[..., :, None] * direction[..., None, :]
    distance = np.full(windows.tag_s.shape, 1e6)
    for _ in range(passes):
        weight = (windows.sigma_rad * distance)[..., None, None] ** -2.0
        normal = np.sum(weight * across, axis=1)
        right = np.sum(weight * across @ windows.place_m[..., None], axis=1)
        position = np.linalg.solve(normal, right)[..., 0]
        distance = np.linalg.norm(position[:, None] - windows.place_m, axis=-1)
    return position, np.linalg.inv(normal)
