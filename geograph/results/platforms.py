"""The estimated paths of the sensors that move and whose fixes are noisy, out of a track."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.results.data import PlatformPath
from geograph.states import POSITION

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.platforms import Platform
    from geograph.track import Track

_STATES = 6


def platform_paths(track: Track) -> tuple[PlatformPath, ...]:
    """Return the estimated paths at the knots: where the platforms really were.

    Parameters
    ----------
    track
        As :func:`geograph.smooth` returned it. A constant offset of a sensor's position, where it
        has one, is part of its path.
    """
    return tuple(_path(track, platform) for platform in track.problem.states.platforms)


def _path(track: Track, platform: Platform) -> PlatformPath:
    states = track.problem.states
    first = int(states.platform_column[platform.sensor])
    own = slice(first, first + _STATES)
    scale = track.problem.walk_scale[own]
    state = track.values.walks[:, own] * scale
    offset, by_constants = _offset(track, platform.sensor)
    covariance = _covariance(track, own, scale[:3], by_constants)
    return PlatformPath(
        sensor=track.recording.sensor_names[platform.sensor],
        time_s=track.time_s,
        position_m=platform.line.position_at(track.time_s) + state[:, :3] + offset,
        velocity_m_s=platform.line.velocity_at(track.time_s) + state[:, 3:],
        position_covariance_m2=covariance,
    )


def _offset(track: Track, sensor: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a sensor's constant offset, shape (3,), and its derivative by the constants."""
    states = track.problem.states
    by_constants = np.zeros((3, states.size))
    for axis in range(3):
        column = states.bias_column[sensor, POSITION + axis]
        if column >= 0:
            by_constants[axis, column] = states.sigma[column]
    return by_constants @ track.values.constants, by_constants


def _covariance(
    track: Track,
    own: slice,
    scale: NDArray[np.float64],
    by_constants: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return covariances of position, offset included, shape (k, 3, 3)."""
    marginals, first = track.marginals, track.problem.layout.path + own.start
    rows = slice(first, first + 3)
    covariance = marginals.knots[:, rows, rows] * scale[:, None] * scale
    cross = marginals.knot_constants[:, rows] * scale[:, None] @ by_constants.T
    constant = by_constants @ marginals.constants @ by_constants.T
    total = covariance + cross + np.swapaxes(cross, 1, 2) + constant
    # Symmetric to the last bit, as the six numbers of a file are.
    return np.asarray(0.5 * (total + np.swapaxes(total, 1, 2)))
