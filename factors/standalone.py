"""Factors for anybody's GTSAM graph: vectors in SI units, one measurement a factor.

A path's key holds position, velocity and acceleration as far as its order goes, (3,), (6,) or (9,),
in metres and seconds. A sensor's error key holds (azimuth, elevation) in radians; *measured =
predicted + error*.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.errors import InputError
from geograph.factors.adapter import vector_factor
from geograph.factors.attitude import misaligned
from geograph.factors.bearing import coordinate_residual, tangent_residual
from geograph.factors.gravity import propagate
from geograph.factors.kinematics import (
    interpolation_weights,
    noise_square_root,
    spatial_square_root,
    spatial_square_root_derivative,
    transition,
)
from geograph.factors.noise import vector3

if TYPE_CHECKING:
    import gtsam
    from numpy.typing import ArrayLike, NDArray

    from geograph.factors.scene import Order


def bearing_factor(
    key: int,
    azimuth_rad: float,
    elevation_rad: float | None,
    sigma_rad: float | tuple[float, float],
    *,
    sensor_m: ArrayLike,
    axes: ArrayLike | None = None,
    order: Order = 1,
    error_key: int | None = None,
    misalignment_key: int | None = None,
    next_key: int | None = None,
    step_s: float = 0.0,
    offset_s: float = 0.0,
) -> gtsam.CustomFactor:
    """Return the factor of one bearing, without light time.

    Parameters
    ----------
    key
        The object's state at the time of the measurement, or at the knot before it.
    azimuth_rad, elevation_rad
        As measured; elevation None: azimuth only.
    sigma_rad
        One number: isotropic on the sky; two: of azimuth and of elevation.
    sensor_m
        Shape (3,): the sensor's position, metres.
    axes
        Shape (3, 3): rows are the directions of azimuth zero, azimuth 90 degrees and elevation 90
        degrees (default: x, y, z; for ``enu`` in ECEF rows north, east, up; for ``body`` those of
        :func:`geograph.factors.attitude.body_axes`).
    order
        Blocks of the object's state.
    error_key
        Key of the sensor's (azimuth, elevation) errors, if they are states.
    misalignment_key
        Key (3,) of the misalignment of its axes about body x, y, z, radians, if it is a state.
    next_key, step_s, offset_s
        State at the following knot, time between the knots, and time of the measurement after the
        first: the position is then interpolated by the Gaussian-process prior.

    Raises
    ------
    InputError
        If a number is not finite, a sigma not positive, or a shape wrong.
    """
    position, rotation, sigmas, measured = _bearing_numbers(
        azimuth_rad, elevation_rad, sigma_rad, sensor_m, axes
    )
    rows = 1 if elevation_rad is None else 2
    on_sky = rows == 2 and not isinstance(sigma_rad, tuple)
    weights = np.array([1.0, *np.zeros(2 * order - 1)])
    keys, sizes = [key], [3 * order]
    if next_key is not None:
        if not step_s > 0.0:
            raise InputError(f"step_s is {step_s}; expected above 0 with next_key")
        weights = interpolation_weights(order, np.array([step_s]), np.array([offset_s]))[0]
        keys.append(next_key)
        sizes.append(3 * order)
    if error_key is not None:
        keys.append(error_key)
        sizes.append(2)
    states = len(sizes) - (error_key is not None)
    if misalignment_key is not None:
        keys.append(misalignment_key)
        sizes.append(3)

    def function(
        vectors: list[NDArray[np.float64]], jacobian: bool
    ) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
        blocks = np.concatenate(vectors[:states]).reshape(-1, 3)
        target = weights[: blocks.shape[0]] @ blocks
        error = vectors[states] if error_key is not None else np.zeros(2)
        line = (rotation @ (target - position))[None]
        by_line = rotation
        if misalignment_key is not None:
            turned = misaligned(line, vectors[-1][None], jacobian=jacobian)
            line, by_line = turned.line_of_sight_m, turned.by_line_of_sight[0] @ rotation
        angles = (measured - error)[:, None]
        if on_sky:
            found = tangent_residual(
                line, angles[0], angles[1], noise_elevation_rad=measured[1:], jacobian=jacobian
            )
        else:
            found = coordinate_residual(line, angles[0], angles[1], jacobian=jacobian)
        value = (found.value[0] / sigmas)[:rows]
        if not jacobian:
            return value, []
        assert found.by_line_of_sight is not None
        assert found.by_error is not None
        by_sight = (found.by_line_of_sight[0] / sigmas[:, None])[:rows]
        by_position = by_sight @ by_line
        matrices = [
            np.kron(weights[index * order : (index + 1) * order], by_position)
            for index in range(states)
        ]
        if error_key is not None:
            matrices.append((found.by_error[0] / sigmas[:, None])[:rows])
        if misalignment_key is not None:
            assert turned.by_misalignment is not None
            matrices.append(by_sight @ turned.by_misalignment[0])
        return value, matrices

    return vector_factor(keys, sizes, rows, function)


def _bearing_numbers(
    azimuth_rad: float,
    elevation_rad: float | None,
    sigma_rad: float | tuple[float, float],
    sensor_m: ArrayLike,
    axes: ArrayLike | None,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return position, axes, sigmas and bearing (NaN: no elevation) as arrays, checked."""
    position = vector3(sensor_m, "sensor_m")
    rotation = np.eye(3) if axes is None else np.asarray(axes, dtype=np.float64)
    if rotation.shape != (3, 3):
        raise InputError(f"axes have shape {rotation.shape}; expected (3, 3)")
    sigmas = np.array(sigma_rad if isinstance(sigma_rad, tuple) else (sigma_rad, sigma_rad))
    if not (np.isfinite(sigmas).all() and (sigmas > 0.0).all()):
        raise InputError(f"sigma_rad is {sigma_rad}; expected finite numbers above 0")
    measured = np.array([azimuth_rad, np.nan if elevation_rad is None else elevation_rad])
    given = measured[: 1 if elevation_rad is None else 2]
    if not np.isfinite(given).all():
        raise InputError(f"bearing is {given}; expected finite radians")
    return position, rotation, sigmas, measured


def kinematic_factor(
    key: int,
    next_key: int,
    step_s: float,
    process_noise: float | tuple[float, float, float],
    *,
    order: Order = 2,
    process_noise_along: float | None = None,
) -> gtsam.CustomFactor:
    """Return the transition factor of a Gaussian-process prior between two states.

    Parameters
    ----------
    key, next_key
        States at the earlier and the later time.
    step_s
        Time between them, seconds.
    process_noise
        Square root of the spectral density of white noise on velocity (order 1), acceleration (2)
        or jerk (3), SI; three numbers: per axis.
    order
        Blocks of the states.
    process_noise_along
        The same along the velocity of the earlier state; ``process_noise`` is then that across it.

    Raises
    ------
    InputError
        If a number is not positive and finite, or noise along the velocity is asked of order 1.
    """
    axes = np.broadcast_to(np.asarray(process_noise, dtype=np.float64), (3,))
    numbers = [step_s, *axes, 1.0 if process_noise_along is None else process_noise_along]
    if not all(np.isfinite(number) and number > 0.0 for number in numbers):
        raise InputError(
            f"kinematic factor was given step {step_s} s and process noise {process_noise}, "
            f"{process_noise_along} along; expected finite numbers above 0"
        )
    if process_noise_along is not None and (order == 1 or np.ptp(axes) > 0.0):
        raise InputError("noise along the velocity needs order 2 or 3 and one number across it")
    phi = np.kron(transition(order, step_s), np.eye(3))
    unit = np.linalg.inv(noise_square_root(order, step_s))
    size = 3 * order

    def function(
        vectors: list[NDArray[np.float64]], jacobian: bool
    ) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
        first, second = vectors
        miss = unit @ (second - phi @ first).reshape(order, 3)
        inverse = np.diag(1.0 / axes)
        if process_noise_along is not None:
            inverse = spatial_square_root(
                first[None, 3:6], 1.0 / axes[0], 1.0 / process_noise_along
            )[0]
        value = (miss @ inverse.T).ravel()
        if not jacobian:
            return value, []
        whiten = np.kron(unit, inverse)
        by_first = -whiten @ phi
        if process_noise_along is not None:
            by_first[:, 3:6] += spatial_square_root_derivative(
                first[None, 3:6], 1.0 / axes[0], 1.0 / process_noise_along, miss[None]
            ).reshape(size, 3)
        return value, [by_first, whiten]

    return vector_factor([key, next_key], [size, size], size, function)


def ballistic_factor(
    key: int,
    next_key: int,
    step_s: float,
    process_noise: float,
    *,
    frame: Literal["ecef", "local"] = "ecef",
) -> gtsam.CustomFactor:
    """Return the transition factor of free fall with white noise on the acceleration.

    Parameters
    ----------
    key, next_key
        Position and velocity at the earlier and the later time, (6,).
    step_s
        Time between them, seconds.
    process_noise
        Square root of the spectral density of the noise, m/s^1.5.
    frame
        See :mod:`geograph.factors.gravity`.

    Raises
    ------
    InputError
        If a number is not positive and finite.
    """
    if not all(np.isfinite(number) and number > 0.0 for number in (step_s, process_noise)):
        raise InputError(
            f"ballistic factor was given step {step_s} s and process noise {process_noise}; "
            "expected finite numbers above 0"
        )
    whiten = np.kron(np.linalg.inv(noise_square_root(2, step_s)), np.eye(3)) / process_noise

    def function(
        vectors: list[NDArray[np.float64]], jacobian: bool
    ) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
        fall, derivative = propagate(vectors[0][None], np.array([step_s]), frame)
        value = whiten @ (vectors[1] - fall[0])
        return value, [-whiten @ derivative[0], whiten] if jacobian else []

    return vector_factor([key, next_key], [6, 6], 6, function)


def random_walk_factor(
    key: int, next_key: int, step_s: float, instability: float, *, size: int = 2
) -> gtsam.CustomFactor:
    """Return the factor between two values of a sensor's drifting error.

    Parameters
    ----------
    key, next_key
        Errors at the earlier and the later time.
    step_s
        Time between them, seconds.
    instability
        Standard deviation after one second (rad/sqrt(s), s/sqrt(s)).
    size
        Components of the error.

    Raises
    ------
    InputError
        If a number is not positive and finite.
    """
    if not all(np.isfinite(number) and number > 0.0 for number in (step_s, instability)):
        raise InputError(
            f"random walk was given step {step_s} s and instability {instability}; expected "
            "finite numbers above 0"
        )
    whiten = np.eye(size) / (instability * np.sqrt(step_s))

    def function(
        vectors: list[NDArray[np.float64]], jacobian: bool
    ) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
        return whiten @ (vectors[1] - vectors[0]), [-whiten, whiten] if jacobian else []

    return vector_factor([key, next_key], [size, size], size, function)
