"""Factors of arrival times, time differences and frequency differences, for anybody's GTSAM graph.

**Signs.** toa = arrival + clock error; tdoa = arrival(sensor) - arrival(reference); fdoa =
received(sensor) - received(reference); measured = predicted + error.

**Time.** All times are counted from that of the object's state ``key``, seconds; the object moves
from there along its Taylor polynomial or, with ``next_key``, along the mean of the Gaussian-process
prior between both states. The light time is solved exactly (:mod:`geograph.factors.arrival`).

**States.** The object's keys hold position, velocity and acceleration as far as the order goes,
(3,), (6,) or (9,), metres and seconds. Clock keys (1,) hold metres, the error in seconds times the
nominal speed of propagation, so that they are of the size of positions; frequency keys (1,) hertz;
keys of a sensor's position metres; the key of the speed of propagation (1,) metres per second above
the nominal one. Several receivers may share a key.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.errors import InputError
from geograph.factors.adapter import vector_factor
from geograph.factors.arrival import arrival_gradient
from geograph.factors.difference import (
    frequency_difference,
    frequency_difference_gradient,
    time_difference,
    time_difference_gradient,
)
from geograph.factors.noise import column, sigmas, whitening
from geograph.factors.scene import Receiver, Scene, SceneGradient

if TYPE_CHECKING:
    from collections.abc import Sequence

    import gtsam
    from numpy.typing import ArrayLike, NDArray

    from geograph.factors.difference import DifferenceGradient
    from geograph.factors.scene import Order

Frame = Literal["ecef", "local"]


def arrivals_factor(
    key: int,
    toa_s: ArrayLike,
    sigma_s: ArrayLike,
    receivers: Sequence[Receiver],
    *,
    emission_key: int | None = None,
    order: Order = 1,
    next_key: int | None = None,
    step_s: float = 0.0,
    speed_m_s: float = SPEED_OF_LIGHT_M_S,
    speed_key: int | None = None,
    frame: Frame = "ecef",
) -> gtsam.CustomFactor:
    """Return the factor of the arrival times of one emission at n receivers.

    Without ``emission_key`` the time of emission is eliminated exactly: the error is that at the
    best time, and its derivatives are projected onto what no time of emission can take up (G. H.
    Golub, V. Pereyra, *Separable nonlinear least squares*, Inverse Problems 19, 2003, with L.
    Kaufman's simplification). It has n rows of rank n - 1, the information of all time differences
    with their full covariance; no receiver is a reference.

    Parameters
    ----------
    key
        The object's state at time zero.
    toa_s
        Shape (n,): times of arrival by the receivers' clocks, seconds after the time of ``key``.
    sigma_s
        One number or shape (n,): standard deviations.
    receivers
        n of them.
    emission_key
        Key of the time of emission, (1,), metres: seconds after the time of ``key``, times
        ``speed_m_s``. It needs a prior or two arrivals, like any other unknown.
    order
        Blocks of the object's state.
    next_key, step_s
        The following state and the time between both, if the object is interpolated.
    speed_m_s
        Nominal speed of propagation.
    speed_key
        Key of what the speed of propagation is above that, (1,), m/s.
    frame
        Frame of all positions: ``"ecef"`` turns while the signal is under way.

    Raises
    ------
    InputError
        If numbers are not finite, a sigma is not positive, lengths differ, or the emission time
        would take up the only arrival.
    """
    scene = Scene(
        key, receivers, order=order, next_key=next_key, step_s=step_s, speed_m_s=speed_m_s,
        speed_key=speed_key, frame=frame,
    )  # fmt: skip
    count = len(scene.receivers)
    least = 1 if emission_key is not None else 2
    measured = column(toa_s, "toa_s", count)
    white = 1.0 / sigmas(sigma_s, "sigma_s", count)
    if count < least:
        raise InputError(
            f"one emission has {count} arrivals; expected at least {least} "
            f"({'with' if emission_key is not None else 'without'} an emission_key)"
        )
    if emission_key is not None:
        scene.add(emission_key, 1)

    def function(
        vectors: list[NDArray[np.float64]], jacobian: bool
    ) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
        point = scene.read(vectors)
        if emission_key is None:
            emitted = scene.best_emission(point, measured, white)
        else:
            emitted = float(scene.vector(vectors, emission_key)[0]) / speed_m_s
        ray = scene.rays(point, emitted)
        # The two large times first: their difference is exact to the digits that they have.
        value = (emitted - measured + ray.light_time_s + point.clock_s) * white
        if not jacobian:
            return value, []
        found = arrival_gradient(ray)
        gradient = SceneGradient(scene, point, ray, emitted, count)
        every = np.arange(count)
        gradient.add_object(found.by_position, found.by_velocity)
        gradient.add_sensor(every, every, found.by_sensor_position, found.by_sensor_velocity)
        gradient.add_clock(every, every, np.ones(count))
        gradient.add_speed(found.by_speed)
        if emission_key is not None:
            gradient.matrix(emission_key)[:, 0] += found.by_emission / speed_m_s
            return value, gradient.whitened(np.diag(white))
        taken = found.by_emission * white
        unit = taken / np.linalg.norm(taken)
        return value, gradient.whitened(np.diag(white) - np.outer(unit, unit * white))

    return vector_factor(scene.keys, scene.sizes, count, function)


def time_difference_factor(
    key: int,
    tdoa_s: float,
    sigma_s: float,
    sensor: Receiver,
    reference: Receiver,
    *,
    time_s: float = 0.0,
    order: Order = 1,
    next_key: int | None = None,
    step_s: float = 0.0,
    speed_m_s: float = SPEED_OF_LIGHT_M_S,
    speed_key: int | None = None,
    frame: Frame = "ecef",
) -> gtsam.CustomFactor:
    """Return the factor of one time difference; see :func:`time_differences_factor`."""
    return time_differences_factor(
        key, [tdoa_s], [sigma_s], [sensor], reference, time_s=time_s, order=order,
        next_key=next_key, step_s=step_s, speed_m_s=speed_m_s, speed_key=speed_key, frame=frame,
    )  # fmt: skip


def time_differences_factor(
    key: int,
    tdoa_s: ArrayLike,
    sigma_s: ArrayLike | None,
    sensors: Sequence[Receiver],
    reference: Receiver,
    *,
    sigma_reference_s: float = 0.0,
    covariance_s2: ArrayLike | None = None,
    time_s: float = 0.0,
    order: Order = 1,
    next_key: int | None = None,
    step_s: float = 0.0,
    speed_m_s: float = SPEED_OF_LIGHT_M_S,
    speed_key: int | None = None,
    frame: Frame = "ecef",
) -> gtsam.CustomFactor:
    """Return the factor of n time differences against one reference, tdoa = sensor - reference.

    Parameters
    ----------
    key
        The object's state at time zero.
    tdoa_s
        Shape (n,), seconds.
    sigma_s
        One number or shape (n,): standard deviations of the differences; None with a covariance.
    sensors, reference
        Receivers, n and one.
    sigma_reference_s
        The part of ``sigma_s`` that the reference's own arrival brought in; its square is the
        covariance of any two differences.
    covariance_s2
        Shape (n, n): covariance of the differences, in place of the sigmas.
    time_s
        Time of arrival at the reference by its clock, seconds after the time of ``key``.
    order, next_key, step_s, speed_m_s, speed_key, frame
        As of :func:`arrivals_factor`.

    Raises
    ------
    InputError
        If numbers are not finite, lengths differ, or the noise has no positive definite covariance.
    """
    scene = Scene(
        key, [*sensors, reference], order=order, next_key=next_key, step_s=step_s,
        speed_m_s=speed_m_s, speed_key=speed_key, frame=frame,
    )  # fmt: skip
    count = len(sensors)
    measured = column(tdoa_s, "tdoa_s", count)
    whiten = whitening(sigma_s, sigma_reference_s, covariance_s2, count, unit="s")

    def function(
        vectors: list[NDArray[np.float64]], jacobian: bool
    ) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
        point = scene.read(vectors)
        emitted = scene.emission_of_arrival(point, count, time_s)
        ray = scene.rays(point, emitted)
        sensor, other = _ends(count)
        one, two = ray.take(sensor), ray.take(other)
        clocks = point.clock_s[:-1] - point.clock_s[-1]
        value = whiten @ (time_difference(one, two) + clocks - measured)
        if not jacobian:
            return value, []
        found = time_difference_gradient(one, two)
        gradient = SceneGradient(scene, point, ray, emitted, count)
        _add_difference(gradient, found, count)
        gradient.add_clock(np.arange(count), sensor, np.ones(count))
        gradient.add_clock(np.arange(count), other, -np.ones(count))
        return value, gradient.whitened(whiten)

    return vector_factor(scene.keys, scene.sizes, count, function)


def frequency_difference_factor(
    key: int,
    fdoa_hz: float,
    sigma_hz: float,
    sensor: Receiver,
    reference: Receiver,
    *,
    carrier_hz: float,
    time_s: float = 0.0,
    order: Order = 2,
    next_key: int | None = None,
    step_s: float = 0.0,
    speed_m_s: float = SPEED_OF_LIGHT_M_S,
    speed_key: int | None = None,
    frame: Frame = "ecef",
) -> gtsam.CustomFactor:
    """Return the factor of one frequency difference; see :func:`frequency_differences_factor`."""
    return frequency_differences_factor(
        key, [fdoa_hz], [sigma_hz], [sensor], reference, carrier_hz=carrier_hz, time_s=time_s,
        order=order, next_key=next_key, step_s=step_s, speed_m_s=speed_m_s, speed_key=speed_key,
        frame=frame,
    )  # fmt: skip


def frequency_differences_factor(
    key: int,
    fdoa_hz: ArrayLike,
    sigma_hz: ArrayLike | None,
    sensors: Sequence[Receiver],
    reference: Receiver,
    *,
    carrier_hz: float,
    sigma_reference_hz: float = 0.0,
    covariance_hz2: ArrayLike | None = None,
    time_s: float = 0.0,
    order: Order = 2,
    next_key: int | None = None,
    step_s: float = 0.0,
    speed_m_s: float = SPEED_OF_LIGHT_M_S,
    speed_key: int | None = None,
    frame: Frame = "ecef",
) -> gtsam.CustomFactor:
    """Return the factor of n differences of received frequency, fdoa = sensor - reference.

    Parameters
    ----------
    key
        The object's state at time zero.
    fdoa_hz
        Shape (n,), hertz.
    sigma_hz
        One number or shape (n,): standard deviations of the differences; None with a covariance.
    sensors, reference
        Receivers, n and one; their frequency keys hold what they read too much, hertz.
    carrier_hz
        Frequency that the object emits, above zero.
    sigma_reference_hz
        The part of ``sigma_hz`` that the reference brought in, as of
        :func:`time_differences_factor`.
    covariance_hz2
        Shape (n, n): covariance of the differences, in place of the sigmas.
    time_s
        Time of arrival at the reference by its clock, seconds after the time of ``key``.
    order, next_key, step_s, speed_m_s, speed_key, frame
        As of :func:`arrivals_factor`. An object of order 1 without ``next_key`` does not move.

    Raises
    ------
    InputError
        If numbers are not finite, lengths differ, the carrier is not positive, or the noise has no
        positive definite covariance.
    """
    if not (np.isfinite(carrier_hz) and carrier_hz > 0.0):
        raise InputError(f"carrier_hz is {carrier_hz}; expected a finite number above 0")
    scene = Scene(
        key, [*sensors, reference], order=order, next_key=next_key, step_s=step_s,
        speed_m_s=speed_m_s, speed_key=speed_key, frame=frame,
    )  # fmt: skip
    count = len(sensors)
    measured = column(fdoa_hz, "fdoa_hz", count)
    whiten = whitening(sigma_hz, sigma_reference_hz, covariance_hz2, count, unit="hz")
    carrier = np.full(count, float(carrier_hz))

    def function(
        vectors: list[NDArray[np.float64]], jacobian: bool
    ) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
        point = scene.read(vectors)
        emitted = scene.emission_of_arrival(point, count, time_s)
        ray = scene.rays(point, emitted)
        sensor, other = _ends(count)
        one, two = ray.take(sensor), ray.take(other)
        offsets = point.frequency_hz[:-1] - point.frequency_hz[-1]
        value = whiten @ (frequency_difference(one, two, carrier) + offsets - measured)
        if not jacobian:
            return value, []
        _, _, acceleration = scene.object_at(point, emitted)
        found = frequency_difference_gradient(one, two, carrier, np.tile(acceleration, (count, 1)))
        gradient = SceneGradient(scene, point, ray, emitted, count)
        _add_difference(gradient, found, count)
        gradient.add_frequency(np.arange(count), sensor, np.ones(count))
        gradient.add_frequency(np.arange(count), other, -np.ones(count))
        return value, gradient.whitened(whiten)

    return vector_factor(scene.keys, scene.sizes, count, function)


def _ends(count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the receivers of n differences: sensors, and the reference behind them."""
    return np.arange(count), np.full(count, count)


def _add_difference(gradient: SceneGradient, found: DifferenceGradient, count: int) -> None:
    """Add what time and frequency differences have in common."""
    sensor, other = _ends(count)
    rows = np.arange(count)
    gradient.add_object(found.by_position, found.by_velocity)
    gradient.add_sensor(rows, sensor, found.by_sensor_position, found.by_sensor_velocity)
    gradient.add_sensor(rows, other, found.by_reference_position, found.by_reference_velocity)
    # A clock that is fast puts the true arrival before its time tag.
    gradient.add_clock(rows, other, -found.by_time)
    gradient.add_speed(found.by_speed)
