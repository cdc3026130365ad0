"""Bearings: azimuth and elevation of a line of sight.

**Axes.** A sensor's axes are a rotation whose rows are the direction of azimuth zero, the direction
of azimuth 90 degrees and the direction of elevation 90 degrees: north, east, up for ``enu``; x, y,
z for ``xyz``. In those axes a line of sight (a, b, c) has azimuth atan2(b, a) and elevation
atan2(c, hypot(a, b)).

**Sign.** measured = predicted + error; residuals are predicted - (measured - error).

**Two residuals.** With an on-sky sigma the residual is the logarithmic map of the predicted
direction in the tangent plane of the measured direction, (towards azimuth, towards elevation), well
behaved at the zenith and up to 180 degrees off (the exponential chart of the sphere; see R. Hartley
et al., *Rotation averaging*, IJCV 103, 2013, section 3). With a sigma for each coordinate it is the
difference of the coordinates, azimuth wrapped to half a turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


# Sine of the distance from the zenith within which cosines of elevations are rounded off.
_ZENITH_ROUNDING = 0.02

# Cosine of the elevation below which an azimuth's derivative grows no further.
_LEAST_COSINE = 1e-7

# Sine of the distance from the point opposite the measured direction that counts as opposite.
_OPPOSITE = 1e-7


@dataclass(frozen=True, eq=False)
class BearingResidual:
    """Residuals of n bearings in radians, with derivatives where these were asked for.

    Attributes
    ----------
    value
        Shape (n, 2): towards azimuth, towards elevation.
    by_line_of_sight
        Shape (n, 2, 3), rad/m: by the line of sight in the sensor's axes.
    by_error
        Shape (n, 2, 2): by the errors of azimuth and elevation.
    """

    value: NDArray[np.float64]
    by_line_of_sight: NDArray[np.float64] | None = None
    by_error: NDArray[np.float64] | None = None


def predict_bearing(
    line_of_sight_m: NDArray[np.float64], *, jacobian: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Return azimuth and elevation of lines of sight, radians, shape (n, 2).

    Parameters
    ----------
    line_of_sight_m
        Shape (n, 3): from the sensor to the object, in the sensor's axes (rows as above), metres.
    jacobian
        Whether the derivative by the line of sight, shape (n, 2, 3), rad/m, is returned too; it is
        bounded at the zenith, where azimuth is undefined.
    """
    a, b, c = line_of_sight_m[:, 0], line_of_sight_m[:, 1], line_of_sight_m[:, 2]
    horizontal = np.hypot(a, b)
    value = np.stack([np.arctan2(b, a), np.arctan2(c, horizontal)], axis=1)
    if not jacobian:
        return value, None
    distance2 = a * a + b * b + c * c
    # Below this the azimuth is rounding; its derivative stays finite.
    safe = np.maximum(horizontal, _LEAST_COSINE * np.sqrt(distance2))
    square = safe**2
    with np.errstate(divide="ignore", invalid="ignore"):
        azimuth = np.stack([-b / square, a / square, np.zeros_like(a)], axis=1)
        tilt = c / (safe * distance2)
        elevation = np.stack([-a * tilt, -b * tilt, horizontal / distance2], axis=1)
    return value, np.stack([azimuth, elevation], axis=1)


def coordinate_residual(
    line_of_sight_m: NDArray[np.float64],
    azimuth_rad: NDArray[np.float64],
    elevation_rad: NDArray[np.float64],
    *,
    jacobian: bool = False,
) -> BearingResidual:
    """Return differences of the coordinates, azimuth wrapped to [-pi, pi).

    A NaN elevation (azimuth only) leaves the second residual and its derivatives zero.

    Parameters
    ----------
    line_of_sight_m
        Shape (n, 3), in the sensor's axes, metres.
    azimuth_rad, elevation_rad
        Shape (n,): measured coordinates less their errors.
    jacobian
        Whether derivatives are returned too.
    """
    predicted, by_sight = predict_bearing(line_of_sight_m, jacobian=jacobian)
    azimuth_only = np.isnan(elevation_rad)
    value = np.empty_like(predicted)
    value[:, 0] = np.mod(predicted[:, 0] - azimuth_rad + np.pi, 2.0 * np.pi) - np.pi
    value[:, 1] = np.where(azimuth_only, 0.0, predicted[:, 1] - elevation_rad)
    if by_sight is None:
        return BearingResidual(value)
    by_sight[azimuth_only, 1] = 0.0
    by_error = np.zeros((value.shape[0], 2, 2))
    by_error[:, 0, 0] = 1.0
    by_error[:, 1, 1] = np.where(azimuth_only, 0.0, 1.0)
    return BearingResidual(value, by_sight, by_error)


def tangent_residual(
    line_of_sight_m: NDArray[np.float64],
    azimuth_rad: NDArray[np.float64],
    elevation_rad: NDArray[np.float64],
    *,
    noise_elevation_rad: NDArray[np.float64] | None = None,
    jacobian: bool = False,
) -> BearingResidual:
    """Return the predicted direction in the tangent plane of the measured one.

    With the unit vectors u (measured), e1 (growing azimuth) and e2 (growing elevation), and the
    predicted direction d: r = theta / sin(theta) (e1.d, e2.d), theta the angle between u and d.

    The noise is isotropic where the sensor measured, before its errors are taken off: there, a
    change of azimuth is cos(measured elevation) long. The first component is therefore multiplied
    by cos(measured) / cos(corrected elevation); without that, all
    azimuth residuals would shrink when object and elevation error move together so that the object
    nears the zenith, and the estimate would be drawn there. Both cosines are
    rounded off within about a degree of the zenith, which keeps the ratio regular.

    Parameters
    ----------
    line_of_sight_m
        Shape (n, 3), in the sensor's axes, metres.
    azimuth_rad, elevation_rad
        Shape (n,): measured coordinates less their errors.
    noise_elevation_rad
        Shape (n,): elevations as measured; None: as corrected.
    jacobian
        Whether derivatives are returned too.
    """
    sin_a, cos_a = np.sin(azimuth_rad), np.cos(azimuth_rad)
    sin_e, cos_e = np.sin(elevation_rad), np.cos(elevation_rad)
    x, y, z = line_of_sight_m[:, 0], line_of_sight_m[:, 1], line_of_sight_m[:, 2]
    distance = np.sqrt(x * x + y * y + z * z)
    forward = (x * cos_a + y * sin_a) / distance
    up = z / distance
    s1 = (y * cos_a - x * sin_a) / distance
    s2 = up * cos_e - forward * sin_e
    c = forward * cos_e + up * sin_e
    sine2 = s1 * s1 + s2 * s2
    # Opposite the measured direction the residual is half a turn in any direction: one is chosen,
    # or else the residual would vanish there and hold the object behind the sensor.
    opposite = (sine2 < _OPPOSITE**2) & (c < 0.0)
    if opposite.any():
        s1, s2 = np.where(opposite, _OPPOSITE, s1), np.where(opposite, 0.0, s2)
        sine2 = s1 * s1 + s2 * s2
    stretch, curvature = _log_map(sine2, c)
    value = np.stack([stretch * s1, stretch * s2], axis=1)
    if noise_elevation_rad is None:
        ratio = np.ones_like(c)
    else:
        level2 = cos_e**2 + _ZENITH_ROUNDING**2
        ratio = np.sqrt((np.cos(noise_elevation_rad) ** 2 + _ZENITH_ROUNDING**2) / level2)
    if not jacobian:
        value[:, 0] *= ratio
        return BearingResidual(value)

    # dr = stretch ds + curvature s (c s.ds - sin^2 dc), for ds and dc of each argument in turn.
    def chain(
        ds1: NDArray[np.float64], ds2: NDArray[np.float64], dc: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        common = curvature * (c * (s1 * ds1 + s2 * ds2) - sine2 * dc)
        return stretch * ds1 + s1 * common, stretch * ds2 + s2 * common

    by_sight = np.empty((value.shape[0], 2, 3))
    e1 = (-sin_a, cos_a, np.zeros_like(sin_a))
    e2 = (-sin_e * cos_a, -sin_e * sin_a, cos_e)
    u = (cos_e * cos_a, cos_e * sin_a, sin_e)
    direction = (x / distance, y / distance, up)
    for axis in range(3):
        # A unit vector's derivative is orthogonal to it: subtract the part along the direction.
        d = direction[axis]
        by_sight[:, 0, axis], by_sight[:, 1, axis] = chain(
            (e1[axis] - s1 * d) / distance,
            (e2[axis] - s2 * d) / distance,
            (u[axis] - c * d) / distance,
        )
    by_error = np.empty((value.shape[0], 2, 2))
    azimuth = chain(sin_e * s2 - cos_e * c, -sin_e * s1, cos_e * s1)
    elevation = chain(np.zeros_like(c), -c, s2)
    # An error is subtracted from the measurement.
    by_error[:, 0, 0], by_error[:, 1, 0] = -azimuth[0], -azimuth[1]
    by_error[:, 0, 1], by_error[:, 1, 1] = -elevation[0], -elevation[1]
    if noise_elevation_rad is not None:
        by_error[:, 0, 1] -= value[:, 0] * cos_e * sin_e / level2
        by_sight[:, 0] *= ratio[:, None]
        by_error[:, 0] *= ratio[:, None]
        value[:, 0] *= ratio
    return BearingResidual(value, by_sight, by_error)


def _log_map(
    sine2: NDArray[np.float64], cosine: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return theta / sin(theta) and its derivative by theta over sin(theta), each shape (n,)."""
    # Series below 1e-3 rad, where the closed forms cancel; the next terms are below 1e-17.
    stretch = 1.0 + sine2 / 6.0 + 3.0 * sine2**2 / 40.0
    curvature = 1.0 / 3.0 + sine2 * (2.0 / 15.0)
    large = (sine2 > 1e-6) | (cosine < 0.0)
    if large.any():
        sine = np.sqrt(sine2[large])
        theta = np.arctan2(sine, cosine[large])
        stretch[large] = theta / sine
        curvature[large] = (sine - theta * cosine[large]) / sine**3
    return stretch, curvature
