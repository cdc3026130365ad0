"""Time and frequency differences of arrival between two sensors.

**Signs.** tdoa = arrival(sensor) - arrival(reference); fdoa = received(sensor) -
received(reference).

**Time.** Both are of the signal that arrived at the reference at a given time; its time of emission
follows from the light time to the reference, and with it everything at the sensor. So a change of
position moves the time of emission too, which matters where the signal is slow: for a function f of
both rays at a fixed time of emission,

    df = (df at fixed t_e) + (df/dt_e) dt_e,

with dt_e from :func:`geograph.factors.arrival.emission_gradient` of the reference's ray.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.factors.arrival import (
    Gradient,
    Ray,
    arrival_gradient,
    doppler,
    doppler_gradient,
    emission_gradient,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class DifferenceGradient:
    """Derivatives of n differences.

    Attributes
    ----------
    by_position, by_velocity
        Shape (n, 3): by the object's position and velocity at emission, in the frame's axes then.
    by_sensor_position, by_sensor_velocity, by_reference_position, by_reference_velocity
        Shape (n, 3): by those of both sensors, each in the axes at its own reception.
    by_time
        Shape (n,): by the time of arrival at the reference.
    by_speed
        Shape (n,): by the logarithm of the speed of propagation.
    """

    by_position: NDArray[np.float64]
    by_velocity: NDArray[np.float64]
    by_sensor_position: NDArray[np.float64]
    by_sensor_velocity: NDArray[np.float64]
    by_reference_position: NDArray[np.float64]
    by_reference_velocity: NDArray[np.float64]
    by_time: NDArray[np.float64]
    by_speed: NDArray[np.float64]


def time_difference(sensor: Ray, reference: Ray) -> NDArray[np.float64]:
    """Return times of arrival at sensors less those at references, shape (n,), seconds.

    Parameters
    ----------
    sensor, reference
        Rays of the same emissions (:func:`geograph.factors.arrival.trace`).
    """
    return sensor.light_time_s - reference.light_time_s


def time_difference_gradient(sensor: Ray, reference: Ray) -> DifferenceGradient:
    """Return the derivatives of :func:`time_difference`, seconds per unit."""
    one = arrival_gradient(sensor)
    zero = np.zeros_like(one.by_position)
    nothing = np.zeros_like(one.by_speed)
    # The time of arrival at the reference is held: its own change is that of by_time.
    still = Gradient(zero, zero, zero, zero, nothing, nothing)
    return _difference(one, still, reference, held=-1.0)


def frequency_difference(
    sensor: Ray, reference: Ray, carrier_hz: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return frequencies received by sensors less those by references, shape (n,), hertz.

    Parameters
    ----------
    sensor, reference
        Rays of the same emissions.
    carrier_hz
        Shape (n,): frequencies emitted.
    """
    return np.asarray(carrier_hz * (doppler(sensor) - doppler(reference)))


def frequency_difference_gradient(
    sensor: Ray,
    reference: Ray,
    carrier_hz: NDArray[np.float64],
    acceleration_m_s2: NDArray[np.float64],
) -> DifferenceGradient:
    """Return the derivatives of :func:`frequency_difference`, hertz per unit.

    Parameters
    ----------
    sensor, reference, carrier_hz
        As there.
    acceleration_m_s2
        Shape (n, 3): the object's acceleration in the frame at emission.
    """
    one = doppler_gradient(sensor, acceleration_m_s2).scaled(carrier_hz)
    other = doppler_gradient(reference, acceleration_m_s2).scaled(-carrier_hz)
    return _difference(one, other, reference, held=0.0)


def _difference(
    one: Gradient, other: Gradient, reference: Ray, *, held: float
) -> DifferenceGradient:
    """Join derivatives of both rays at a fixed emission with those by the time of emission."""
    emission = emission_gradient(reference)
    rate = one.by_emission + other.by_emission
    return DifferenceGradient(
        by_position=one.by_position + other.by_position + rate[:, None] * emission.by_position,
        by_velocity=one.by_velocity + other.by_velocity,
        by_sensor_position=one.by_sensor_position,
        by_sensor_velocity=one.by_sensor_velocity,
        by_reference_position=other.by_sensor_position
        + rate[:, None] * emission.by_sensor_position,
        by_reference_velocity=other.by_sensor_velocity,
        by_time=rate * emission.by_emission + held,
        by_speed=one.by_speed + other.by_speed + rate * emission.by_speed,
    )
