"""Where an emission came from, in closed form, from the times at which sensors heard it.

**Equation.** With z_i = c t_i, the sensors s_i and the unknown position x and time b / c of the
emission, z_i = |x - s_i| + b. Squared,

    2 s_i . x - 2 z_i b - lambda = |s_i|^2 - z_i^2,    lambda = |x|^2 - b^2,

which is linear in x, b and lambda (S. Bancroft, *An algebraic solution of the GPS equations*, IEEE
TAES 21, 1985). Subtracting one sensor's equation from the others gives spherical intersection and
interpolation (J. O. Smith, J. S. Abel, *Closed-form least-squares source location estimation from
range-difference measurements*, IEEE TASSP 35, 1987), with the range to that sensor in place of b;
estimates of x are the same whichever it is, so that no sensor is special here.

**Weights.** Equation i is wrong by 2 |x - s_i| n_i, n_i the error of z_i: the covariance of the
equations is 4 D N D, D the distances. Because b is free this is the same as the full covariance
H N H^T of all differences.

**Roots.** One combination of the unknowns is always the least certain: entirely unknown with as few
sensors as there are unknowns or where all sensors lie in a plane, else the range of a far emitter.
Along it the relation of lambda to the rest is a quadratic, whose real roots are all returned.

**Second step.** The relation is then imposed in the metric of the first step (Y. T. Chan, K. C. Ho,
*A simple and efficient estimator for hyperbolic location*, IEEE TSP 42, 1994). They solve for the
squares of the coordinates; here the relation is followed by Gauss-Newton steps, which has the same
covariance to first order, the bound, and neither their signs to choose nor their square roots of
noise where the emitter is level with a sensor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.errors import InputError
from geograph.factors.constraints import altitude
from geograph.spherical import check_arrivals, impose, linear_roots, whitening

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

# Rounds of weights, which need the distances, and of the ellipsoid's tangent planes.
_WEIGHT_ROUNDS = 3
_HEIGHT_ROUNDS = 20
_LEAST_RADIUS_M = 1e6

# Roots closer than this, relative to their distance, are one root.
_SAME = 1e-6

# Sigma, in sizes of the array, of what the measurements do not determine.
_WIDEST = 1e6


@dataclass(frozen=True, eq=False)
class Fix:
    """Where, and when, one emission may have left.

    Attributes
    ----------
    position_m
        Shape (d,), metres.
    covariance_m2
        Shape (d, d): by the measurements' sigmas, to first order; bounded where they leave a
        direction open.
    emission_s
        Time of emission, seconds, on the scale of the arrival times.
    cost
        Sum of squared residuals over sigmas; chi-square with N - 1 - unknown coordinates degrees of
        freedom at the true root.
    """

    position_m: NDArray[np.float64]
    covariance_m2: NDArray[np.float64]
    emission_s: float
    cost: float


@dataclass(frozen=True, eq=False)
class Flat:
    """The affine set of positions that are looked at: x = origin + basis y, origin normal to it."""

    origin: NDArray[np.float64]
    basis: NDArray[np.float64]


def intersections(
    sensor_m: ArrayLike,
    toa_s: ArrayLike,
    sigma_s: ArrayLike,
    *,
    speed_m_s: float,
    height_m: float | None = None,
    frame: Literal["ecef", "local"] = "local",
) -> list[Fix]:
    """Return the roots of the weighted linear equations of one emission, the cheapest first.

    Needs one sensor more than unknown coordinates for two roots, two more for one; with fewer, or
    with all sensors on a line, some of the infinitely many answers are returned.

    Parameters
    ----------
    sensor_m
        Shape (N, 2) or (N, 3): sensors when they heard it, metres.
    toa_s
        Shape (N,): times of arrival, seconds.
    sigma_s
        Shape (N,): their standard deviations, seconds; or (N, N): their covariance, seconds
        squared, of which only that of differences matters.
    speed_m_s
        Speed of propagation.
    height_m
        Known height (z in a local frame, above the ellipsoid in ECEF); None: unknown. Only in 3-D.
    frame
        ``"ecef"`` or ``"local"``.

    Raises
    ------
    InputError
        If shapes differ, a value is not finite, or no sigma is positive.
    """
    return _fixes(_Emission(sensor_m, toa_s, sigma_s, speed_m_s), height_m, frame, relation=False)


def chan_ho(
    sensor_m: ArrayLike,
    toa_s: ArrayLike,
    sigma_s: ArrayLike,
    *,
    speed_m_s: float,
    height_m: float | None = None,
    frame: Literal["ecef", "local"] = "local",
) -> list[Fix]:
    """Return the two-step maximum-likelihood fixes of one emission, the cheapest first.

    Each root of :func:`intersections` is carried through the second step. With small noise the
    right one attains the Cramer-Rao bound. For parameters and errors see there.
    """
    return _fixes(_Emission(sensor_m, toa_s, sigma_s, speed_m_s), height_m, frame, relation=True)


class _Emission:
    """One emission in units of its array: relative to the centroid, lengths over the array's size.

    Coordinates of 1e7 m would otherwise be squared beside sigmas of 0.1 m.
    """

    def __init__(
        self, sensor_m: ArrayLike, toa_s: ArrayLike, sigma_s: ArrayLike, speed_m_s: float
    ) -> None:
        sensor, toa = np.asarray(sensor_m, dtype=np.float64), np.asarray(toa_s, dtype=np.float64)
        sigma = np.asarray(sigma_s, dtype=np.float64)
        check_arrivals(sensor, toa, speed_m_s)
        covariance = np.diag(sigma**2) if sigma.ndim == 1 else sigma
        if covariance.shape != (toa.size, toa.size):
            raise InputError(
                f"sigma_s has shape {sigma.shape}; expected ({toa.size},) or {(toa.size, toa.size)}"
            )
        self.centre = sensor.mean(axis=0)
        spread = float(np.sqrt(np.mean(np.sum((sensor - self.centre) ** 2, axis=1))))
        self.speed = speed_m_s
        self.unit = spread if spread > 0.0 else 1.0
        self.sensor = (sensor - self.centre) / self.unit
        self.toa = float(toa.mean())
        self.range = (toa - self.toa) * (speed_m_s / self.unit)
        self.white = whitening(covariance * (speed_m_s / self.unit) ** 2)

    @property
    def dimension(self) -> int:
        """Number of coordinates."""
        return int(self.sensor.shape[1])

    def everywhere(self) -> Flat:
        """Return all positions."""
        return Flat(np.zeros(self.dimension), np.eye(self.dimension))

    def level(self, point: NDArray[np.float64], normal: NDArray[np.float64]) -> Flat:
        """Return the plane through a point (in the array's units) across a direction."""
        _, _, rows = np.linalg.svd(normal[None, :])
        return Flat(normal * float(normal @ point), rows[1:].T)

    def equations(self, flat: Flat) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the linear equations in (y, b, lambda), lambda = |y|^2 - b^2: matrix and value."""
        s, z = self.sensor, self.range
        matrix = np.column_stack([2.0 * s @ flat.basis, -2.0 * z, -np.ones(z.size)])
        value = np.sum((s - flat.origin) ** 2, axis=1) - z**2
        return matrix, value

    def weights(self, position: NDArray[np.float64] | None) -> NDArray[np.float64]:
        """Return what whitens the equations, shape (N, N), for an emitter at a position."""
        if position is None:
            return 0.5 * self.white
        distance = np.linalg.norm(self.sensor - position, axis=1)
        # The square of the error itself is what is left where the emitter is at a sensor.
        floor = 1.0 / np.linalg.norm(self.white, axis=0)
        return np.asarray(0.5 * self.white / np.hypot(distance, floor))

    def fix(self, position: NDArray[np.float64], flat: Flat) -> Fix:
        """Return a position (in the array's units) with its covariance, time and cost."""
        line = position - self.sensor
        distance = np.linalg.norm(line, axis=1)
        unit = line / np.maximum(distance, 1e-300)[:, None]
        delay = self.white @ (self.range - distance)
        ones = self.white.sum(axis=1)
        emission = float(ones @ delay) / float(ones @ ones)
        slope = np.column_stack([self.white @ unit @ flat.basis, ones])
        _, values, rows = np.linalg.svd(slope, full_matrices=True)
        sigma = np.full(rows.shape[0], _WIDEST)
        sigma[: values.size] = 1.0 / np.maximum(values, 1.0 / _WIDEST)
        spread = flat.basis @ (rows.T * sigma)[:-1]
        return Fix(
            self.centre + self.unit * position,
            self.unit**2 * spread @ spread.T,
            self.toa + emission * self.unit / self.speed,
            float(np.sum((delay - emission * ones) ** 2)),
        )


def _fixes(
    emission: _Emission, height_m: float | None, frame: Literal["ecef", "local"], *, relation: bool
) -> list[Fix]:
    if height_m is None:
        flat = emission.everywhere()
        found = [(place, flat) for place in _places(emission, flat, relation=relation)]
    elif emission.dimension != 3:
        raise InputError(f"height_m is {height_m} in a plane; expected None, or sensors in space")
    else:
        found = _places_at_height(emission, height_m, frame, relation=relation)
    fixes = [emission.fix(place, flat) for place, flat in found]
    fixes.sort(key=lambda fix: fix.cost)
    kept: list[Fix] = []
    for fix in fixes:
        size = emission.unit + float(np.linalg.norm(fix.position_m - emission.centre))
        apart = [np.linalg.norm(fix.position_m - other.position_m) for other in kept]
        if all(distance > _SAME * size for distance in apart):
            kept.append(fix)
    return kept


def _places_at_height(
    emission: _Emission, height_m: float, frame: Literal["ecef", "local"], *, relation: bool
) -> list[tuple[NDArray[np.float64], Flat]]:
    """Return the roots at a height, the ellipsoid's tangent planes taken at the roots themselves.

    Each round is a Newton step: exact but for the curvature of the ellipsoid over the last change.
    """

    def plane(at: NDArray[np.float64]) -> Flat:
        point = emission.centre + emission.unit * at
        height, up = altitude(point[None, :], frame)
        foot = point + (height_m - height[0]) * up[0]
        return emission.level((foot - emission.centre) / emission.unit, up[0])

    first = plane(np.zeros(3))
    places = _places(emission, first, relation=relation)
    if frame == "local":
        return [(place, first) for place in places]
    found = []
    for start in places:
        place, flat = start, first
        for _ in range(_HEIGHT_ROUNDS):
            if np.linalg.norm(emission.centre + emission.unit * place) < _LEAST_RADIUS_M:
                break
            flat, before = plane(place), place
            place = _followed(emission, flat, _unknowns_at(emission, flat, place), relation)[1]
            if np.linalg.norm(place - before) < 1e-12 * (1.0 + np.linalg.norm(place)):
                break
        found.append((place, flat))
    return found


def _places(emission: _Emission, flat: Flat, *, relation: bool) -> list[NDArray[np.float64]]:
    """Return the roots in a flat, weights from the distances that they lead to."""
    starts = linear_roots(*emission.equations(flat), emission.weights(None))
    found = [_followed(emission, flat, start, relation) for start in starts]
    anywhere = not any(right for right, _ in found)
    return [point for right, point in found if right or anywhere]


def _followed(
    emission: _Emission, flat: Flat, unknowns: NDArray[np.float64], relation: bool
) -> tuple[bool, NDArray[np.float64]]:
    """Return the root nearest to given unknowns, and whether it is on the right sheet."""
    matrix, value = emission.equations(flat)

    def place(at: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(flat.origin + flat.basis @ at[:-2])

    for _ in range(_WEIGHT_ROUNDS):
        weights = emission.weights(place(unknowns))
        if not np.isfinite(weights).all():
            break
        roots = linear_roots(matrix, value, weights)
        near = [float(np.linalg.norm((root - unknowns)[:-1])) for root in roots]
        unknowns = roots[int(np.argmin(near))]
    if relation:
        unknowns = impose(matrix, value, unknowns, lambda at: emission.weights(place(at)))
    # On the other sheet of the square the ranges are negative.
    right = float(np.mean(emission.range - unknowns[-2])) >= 0.0
    return right, place(unknowns)


def _unknowns_at(
    emission: _Emission, flat: Flat, point: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the unknowns (y, b, lambda) of the point of a flat that is nearest to a point."""
    y = flat.basis.T @ (point - flat.origin)
    distance = np.linalg.norm(flat.origin + flat.basis @ y - emission.sensor, axis=1)
    b = float(np.mean(emission.range - distance))
    return np.concatenate([y, [b, float(y @ y) - b * b]])
