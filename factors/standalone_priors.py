"""Factors of what is known: heights, measured positions, priors; see the other standalone ones."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.errors import InputError
from geograph.factors.adapter import vector_factor
from geograph.factors.constraints import altitude
from geograph.factors.kinematics import interpolation_weights
from geograph.factors.noise import vector3
from geograph.factors.terrain import height_above_terrain

if TYPE_CHECKING:
    from collections.abc import Sequence

    import gtsam
    from numpy.typing import ArrayLike, NDArray

    from geograph.factors.scene import Order
    from geograph.factors.terrain import Surface


def altitude_factor(
    key: int,
    altitude_m: float,
    sigma_m: float,
    *,
    order: Order = 1,
    frame: Literal["ecef", "local"] = "ecef",
) -> gtsam.CustomFactor:
    """Return the factor of a known height above the ellipsoid (z in a local frame).

    Parameters
    ----------
    key
        The object's state.
    altitude_m, sigma_m
        Height and its standard deviation, metres.
    order
        Blocks of the state.
    frame
        ``"ecef"`` or ``"local"``.

    Raises
    ------
    InputError
        If a number is not finite or the sigma not positive.
    """
    if not (np.isfinite(altitude_m) and np.isfinite(sigma_m) and sigma_m > 0.0):
        raise InputError(
            f"altitude is {altitude_m} +- {sigma_m} m; expected finite numbers, sigma above 0"
        )

    def function(
        vectors: list[NDArray[np.float64]], jacobian: bool
    ) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
        height, up = altitude(vectors[0][None, :3], frame)
        value = (height - altitude_m) / sigma_m
        if not jacobian:
            return value, []
        matrix = np.zeros((1, 3 * order))
        matrix[0, :3] = up[0] / sigma_m
        return value, [matrix]

    return vector_factor([key], [3 * order], 1, function)


def terrain_factor(
    key: int,
    height_m: float,
    sigma_m: float,
    *,
    surface: Surface,
    order: Order = 1,
    frame: Literal["ecef", "local"] = "ecef",
) -> gtsam.CustomFactor:
    """Return the factor of a known height above the ground.

    Parameters
    ----------
    key
        The object's state.
    height_m, sigma_m
        Height above the ground and its standard deviation, metres.
    surface
        The ground: a :class:`geograph.Terrain`, or anything with its ``elevation``.
    order
        Blocks of the state.
    frame
        ``"ecef"`` or ``"local"``.

    Raises
    ------
    InputError
        If a number is not finite or the sigma not positive.
    """
    if not (np.isfinite(height_m) and np.isfinite(sigma_m) and sigma_m > 0.0):
        raise InputError(
            f"height above terrain is {height_m} +- {sigma_m} m; expected finite numbers, sigma "
            "above 0"
        )

    def function(
        vectors: list[NDArray[np.float64]], jacobian: bool
    ) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
        above, slope = height_above_terrain(vectors[0][None, :3], frame, surface, jacobian=jacobian)
        value = (above - height_m) / sigma_m
        if slope is None:
            return value, []
        matrix = np.zeros((1, 3 * order))
        matrix[0, :3] = slope[0] / sigma_m
        return value, [matrix]

    return vector_factor([key], [3 * order], 1, function)


def position_fix_factor(
    key: int,
    position_m: ArrayLike,
    sigma_m: float | tuple[float, float, float],
    *,
    order: Order = 1,
    next_key: int | None = None,
    step_s: float = 0.0,
    offset_s: float = 0.0,
) -> gtsam.CustomFactor:
    """Return the factor of a measured position, of the object or of a platform that sensors are on.

    Parameters
    ----------
    key
        State at the time of the fix, or at the knot before it.
    position_m
        Shape (3,), metres.
    sigma_m
        Standard deviation of every coordinate; three numbers: of each.
    order
        Blocks of the states.
    next_key, step_s, offset_s
        As of :func:`bearing_factor`.

    Raises
    ------
    InputError
        If a number is not finite, a sigma or step not positive, or a shape wrong.
    """
    fix = vector3(position_m, "position_m")
    sigma = np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), (3,))
    if not (np.isfinite(sigma).all() and (sigma > 0.0).all()):
        raise InputError(f"sigma_m is {sigma_m}; expected finite numbers above 0")
    keys = [key] if next_key is None else [key, next_key]
    weights = np.array([1.0, *np.zeros(order - 1)])
    if next_key is not None:
        if not step_s > 0.0:
            raise InputError(f"step_s is {step_s}; expected above 0 with next_key")
        weights = interpolation_weights(order, np.array([step_s]), np.array([offset_s]))[0]
    size = 3 * order
    matrix = np.kron(weights, np.diag(1.0 / sigma))
    parts = [matrix[:, index * size : (index + 1) * size] for index in range(len(keys))]

    def function(
        vectors: list[NDArray[np.float64]], jacobian: bool
    ) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
        # Less the fix first: ECEF coordinates over a sigma of a metre lose no digits.
        place = weights @ np.concatenate(vectors).reshape(-1, 3)
        return (place - fix) / sigma, parts if jacobian else []

    return vector_factor(keys, [size] * len(keys), 3, function)


def prior_factor(key: int, mean: ArrayLike, sigmas: Sequence[float]) -> gtsam.PriorFactorVector:
    """Return a Gaussian prior of a vector with independent components.

    Parameters
    ----------
    key
        The vector's key.
    mean
        Shape (n,).
    sigmas
        Standard deviations, n of them.

    Raises
    ------
    InputError
        If lengths differ, a mean is not finite or a sigma not positive.
    """
    import gtsam

    center, spread = np.asarray(mean, dtype=np.float64), np.asarray(sigmas, dtype=np.float64)
    if center.ndim != 1 or center.shape != spread.shape or not np.isfinite(center).all():
        raise InputError(
            f"prior has a mean of shape {center.shape} and sigmas of shape {spread.shape}; "
            "expected (n,) and n finite numbers each"
        )
    if not (np.isfinite(spread).all() and (spread > 0.0).all()):
        raise InputError(f"prior has sigmas {spread}; expected finite numbers above 0")
    return gtsam.PriorFactorVector(key, center, gtsam.noiseModel.Diagonal.Sigmas(spread))
