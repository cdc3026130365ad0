"""What most write first: one Python factor a bearing, under GTSAM's Levenberg-Marquardt optimizer.

Given every advantage: scaled states, plain float arithmetic in the factor, all that does not change
computed beforehand, native linear factors for the kinematics, the ordering that suits the chain,
and the marginals that do not copy all values at every call. GTSAM's Gauss-Newton, QR, sequential
elimination and other first dampings take as long within a tenth. Arrivals and differences are a
factor an emission, in NumPy.
"""

from __future__ import annotations

from math import atan2, cos, sin, sqrt
from typing import TYPE_CHECKING

import gtsam
import numpy as np
from equations import ZENITH_ROUNDING, BearingTable, tables
from model import Pass, path_weights, transition, unit_noise_root

from contestants.base import TOLERANCE, Contestant, Estimate, Run, Stages
from contestants.stacked import Stack
from contestants.timing import seconds

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Jacobians = list[NDArray[np.float64]] | None

_KNOT, _SENSOR = "x", "s"

# Cholesky, the default and a little faster, calls chains that are longer, or have fewer bearings a
# knot, indeterminate that are not; the damping that is then raised takes dozens of iterations, or
# ends far from the minimum.
_LONG, _FEW = 1000, 16


def _derivatives(
    direction: tuple[float, float, float, float],
    turn: tuple[float, float, float, float],
    place: tuple[float, float, float],
    factors: tuple[float, float, float, float],
) -> tuple[NDArray[np.float64], float, float, float, float]:
    """Return the whitened residual's derivatives by position (2, 3), azimuth and elevation errors.

    Parameters
    ----------
    direction
        Predicted unit vector, and one over the distance.
    turn
        Sines and cosines of the measured azimuth and elevation.
    place
        Parts of the direction along the tangent plane's axes, and along the measured direction.
    factors
        theta / sin(theta), its derivative by theta over sin(theta), one over sigma, and what the
        first row's derivatives by position are multiplied by.
    """
    x, y, z, inverse = direction
    sa, ca, se, ce = turn
    s1, s2, c = place
    stretch, bend, white, ratio = factors
    sine2 = s1 * s1 + s2 * s2
    # d(stretch s) = stretch ds + bend s (c s.ds - sin^2 dc), for each argument in turn.
    by = inverse * white
    stretch_w, bend_c, bend_s = stretch * by, bend * c * by, bend * sine2 * by
    rows = []
    for e1, e2, u, d in (
        (-sa, -se * ca, ce * ca, x),
        (ca, -se * sa, ce * sa, y),
        (0.0, ce, se, z),
    ):
        g1, g2 = e1 - s1 * d, e2 - s2 * d
        common = bend_c * (s1 * g1 + s2 * g2) - bend_s * (u - c * d)
        rows.append((stretch_w * g1 + s1 * common, stretch_w * g2 + s2 * common))
    (a1, a2), (b1, b2), (c1, c2) = rows
    by_position = np.array(((a1 * ratio, b1 * ratio, c1 * ratio), (a2, b2, c2)))
    g1, g2 = se * s2 - ce * c, -se * s1
    common = bend * (c * (s1 * g1 + s2 * g2) - sine2 * ce * s1)
    az1, az2 = -white * (stretch * g1 + s1 * common), -white * (stretch * g2 + s2 * common)
    common = -bend * s2 * (c * c + sine2)
    el1, el2 = -white * s1 * common, -white * (s2 * common - stretch * c)
    return by_position, az1, az2, el1, el2


def _bearing_factor(
    data: Pass, index: int, before: int, weights: NDArray[np.float64]
) -> gtsam.CustomFactor:
    """Return the factor of one bearing; unknowns are scaled deviations from the first guess."""
    sensor, time = int(data.sensor[index]), float(data.time_s[index])
    keys = [
        gtsam.symbol(_KNOT, before),
        gtsam.symbol(_KNOT, before + 1),
        gtsam.symbol(_SENSOR, sensor),
    ]
    # Position from the two knots' deviations: p = start + chain @ (x[k], x[k+1]).
    chain = np.kron(weights, np.eye(3)) * np.tile(data.scale, 2)
    blocks = data.guess[before : before + 2].reshape(6, 3)
    start_x, start_y, start_z = (weights @ blocks - data.sensor_m[sensor]).tolist()
    first, second = np.ascontiguousarray(chain[:, :9]), np.ascontiguousarray(chain[:, 9:])
    first_f, second_f = np.asfortranarray(first), np.asfortranarray(second)
    azimuth, elevation = float(data.azimuth_rad[index]), float(data.elevation_rad[index])
    bias_az, bias_el, drift_az, drift_el, *others = data.error_sigma.tolist()
    unfelt = np.zeros((2, len(others)))
    drift_az, drift_el = drift_az * time, drift_el * time
    white = 1.0 / float(data.sigma_rad)
    measured2 = cos(elevation) ** 2 + ZENITH_ROUNDING**2
    key_first, key_second, key_sensor = keys

    def error(
        this: gtsam.CustomFactor, values: gtsam.Values, jacobians: Jacobians
    ) -> NDArray[np.float64]:
        del this
        dx, dy, dz = (
            first @ values.atVector(key_first) + second @ values.atVector(key_second)
        ).tolist()
        b_az, b_el, d_az, d_el = values.atVector(key_sensor).tolist()[:4]
        az = azimuth - b_az * bias_az - d_az * drift_az
        el = elevation - b_el * bias_el - d_el * drift_el
        x, y, z = start_x + dx, start_y + dy, start_z + dz
        sa, ca, se, ce = sin(az), cos(az), sin(el), cos(el)
        inverse = 1.0 / sqrt(x * x + y * y + z * z)
        x, y, z = x * inverse, y * inverse, z * inverse
        forward = x * ca + y * sa
        s1 = y * ca - x * sa
        s2 = z * ce - forward * se
        c = forward * ce + z * se
        sine2 = s1 * s1 + s2 * s2
        if sine2 > 1e-6:
            sine = sqrt(sine2)
            theta = atan2(sine, c)
            stretch = theta / sine
            bend = (sine - theta * c) / (sine * sine2)
        else:
            stretch = 1.0 + sine2 / 6.0
            bend = 1.0 / 3.0
        level2 = ce * ce + ZENITH_ROUNDING**2
        ratio = sqrt(measured2 / level2)
        scaled = stretch * white
        if jacobians is not None:
            by_position, az1, az2, el1, el2 = _derivatives(
                (x, y, z, inverse), (sa, ca, se, ce), (s1, s2, c), (stretch, bend, white, ratio)
            )
            # The first row is multiplied by the ratio, which feels the elevation's error.
            el1 = (el1 - scaled * s1 * ce * se / level2) * ratio
            az1 *= ratio
            jacobians[0] = by_position @ first_f
            jacobians[1] = by_position @ second_f
            by_sensor = np.array(
                (
                    (az1 * bias_az, el1 * bias_el, az1 * drift_az, el1 * drift_el),
                    (az2 * bias_az, el2 * bias_el, az2 * drift_az, el2 * drift_el),
                )
            )
            jacobians[2] = np.hstack((by_sensor, unfelt)) if others else by_sensor
        return np.array((scaled * s1 * ratio, scaled * s2))

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(2), keys, error)


def _stacked_factor(stack: Stack) -> gtsam.CustomFactor:
    """Return the factor of one set of arrivals, or of the differences of one emission."""
    keys = [gtsam.symbol(_KNOT, k) for k in stack.knots]
    sensors = [gtsam.symbol(_SENSOR, s) for s in stack.sensors] if stack.errors else []

    def error(
        this: gtsam.CustomFactor, values: gtsam.Values, jacobians: Jacobians
    ) -> NDArray[np.float64]:
        del this
        residual, jacobian = stack.evaluate(
            [values.atVector(key) for key in keys],
            [values.atVector(key) for key in sensors],
            derivatives=jacobians is not None,
        )
        if jacobians is not None:
            ends = [stack.width] * len(keys) + [stack.errors] * len(sensors)
            parts = np.split(jacobian, np.cumsum(ends)[:-1], axis=1)
            for index, part in enumerate(parts):
                jacobians[index] = np.asfortranarray(part)
        return residual

    unit = gtsam.noiseModel.Unit.Create(stack.rows)
    return gtsam.CustomFactor(unit, [*keys, *sensors], error)


def _other_factors(data: Pass) -> Iterator[gtsam.CustomFactor]:
    for table in tables(data):
        if isinstance(table, BearingTable):
            continue
        for index, before in enumerate(table.interval.tolist()):
            knots = (before, before + 1) if data.knots_s.size > 1 else (before,)
            part = [(table, np.array([index]))]
            yield _stacked_factor(Stack(data, knots, part, measurements_only=True))


def _kinematic_factors(data: Pass) -> list[gtsam.LinearContainerFactor]:
    """Return native factors w[k] = L^-1 (x[k+1] - F x[k]) of scaled deviations."""
    if data.knots_s.size == 1:
        return []
    steps = np.diff(data.knots_s)
    whiten = np.linalg.inv(unit_noise_root(steps)) / data.noise
    turn = transition(steps)
    zeros = np.zeros(9)
    unit = gtsam.noiseModel.Unit.Create(9)
    factors = []
    for k in range(steps.size):
        by_second = np.kron(whiten[k], np.eye(3))
        by_first = -by_second @ np.kron(turn[k], np.eye(3))
        offset = by_first @ data.guess[k] + by_second @ data.guess[k + 1]
        first, second = gtsam.symbol(_KNOT, k), gtsam.symbol(_KNOT, k + 1)
        point = gtsam.Values()
        point.insert(first, zeros)
        point.insert(second, zeros)
        linear = gtsam.JacobianFactor(
            first, by_first * data.scale, second, by_second * data.scale, -offset, unit
        )
        factors.append(gtsam.LinearContainerFactor(linear, point))
    return factors


def _prior(
    key: int, mean: NDArray[np.float64], sigma: NDArray[np.float64]
) -> gtsam.PriorFactorVector:
    return gtsam.PriorFactorVector(key, mean, gtsam.noiseModel.Diagonal.Sigmas(sigma))


class _PerBearingRun(Run):
    def __init__(self, data: Pass) -> None:
        self._data = data
        knots, sensors = data.knots_s.size, data.sensor_m.shape[0]
        graph, values, ordering = (
            gtsam.NonlinearFactorGraph(),
            gtsam.Values(),
            gtsam.Ordering(),
        )
        self._knots = [gtsam.symbol(_KNOT, k) for k in range(knots)]
        self._by_qr = knots > _LONG or data.measurements < _FEW * knots
        width, errors = data.scale.size, data.error_sigma.size
        self._sensors = [gtsam.symbol(_SENSOR, s) for s in range(sensors)] if errors else []
        sigma = data.prior_sigma / data.scale
        graph.push_back(_prior(self._knots[0], np.zeros(width), sigma))
        if np.isfinite(data.altitude_sigma_m):
            sigma = np.array([1e8, 1e8, float(data.altitude_sigma_m)]) / data.scale
            mean = np.array([0.0, 0.0, -data.guess[0, 2]]) / data.scale
            graph.push_back(_prior(self._knots[0], mean, sigma))
        for key in self._knots:
            values.insert(key, np.zeros(width))
            ordering.push_back(key)
        for key in self._sensors:
            values.insert(key, np.zeros(errors))
            ordering.push_back(key)
            graph.push_back(_prior(key, np.zeros(errors), np.ones(errors)))
        for factor in [*_kinematic_factors(data), *_other_factors(data)]:
            graph.push_back(factor)
        interval, weights, _ = path_weights(data.knots_s, data.time_s)
        for index in range(data.time_s.size):
            graph.push_back(_bearing_factor(data, index, int(interval[index]), weights[index]))
        self._graph, self._values, self._ordering = graph, values, ordering

    def solve(self) -> Estimate:
        params = gtsam.LevenbergMarquardtParams()
        params.setRelativeErrorTol(TOLERANCE)
        params.setAbsoluteErrorTol(0.0)
        params.setOrdering(self._ordering)
        if self._by_qr:
            params.setLinearSolverType("MULTIFRONTAL_QR")
        optimizer = gtsam.LevenbergMarquardtOptimizer(self._graph, self._values, params)
        self._values = optimizer.optimize()
        data = self._data
        path = np.stack([self._values.atVector(key) for key in self._knots])
        errors = np.zeros((data.sensor_m.shape[0], data.error_sigma.size))
        if self._sensors:
            scaled = np.stack([self._values.atVector(key) for key in self._sensors])
            errors[:] = scaled * data.error_sigma
        return Estimate(data.guess + path * data.scale, errors, optimizer.iterations())

    def marginals(self) -> NDArray[np.float64]:
        # gtsam.Marginals copies the values at every call and uses Cholesky, which throws here.
        linear = self._graph.linearize(self._values)
        tree = linear.eliminateMultifrontal(self._ordering, gtsam.EliminateQR)
        scaled = np.stack([tree.marginalCovariance(key) for key in self._knots])
        return np.asarray(scaled * self._data.scale[:, None] * self._data.scale)

    def stages(self) -> Stages:
        linear = self._graph.linearize(self._values)
        arguments = (self._ordering, gtsam.EliminateQR) if self._by_qr else (self._ordering,)
        return Stages(
            seconds(lambda: self._graph.linearize(self._values), repeats=1),
            seconds(lambda: linear.optimize(*arguments), repeats=1),
        )


class PerBearing(Contestant):
    """One Python factor a bearing."""

    name = "gtsam-per-bearing"
    about = "a lean Python factor a bearing, GTSAM's own Levenberg-Marquardt optimizer"

    def set_up(self, data: Pass) -> Run:
        return _PerBearingRun(data)
