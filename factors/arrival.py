"""Arrivals: when, and at which frequency, a sensor receives what an object emits.

**Equation.** A signal emitted at t_e at the position p(t_e) arrives at t_r = t_e + tau, with

    c tau = |P - S(t_r)|,

P the object's position at emission in axes that do not turn while the signal is under way (in ECEF
the Earth-fixed axes at reception, P = Rz(-omega tau) p(t_e); see
:mod:`geograph.factors.light_time`) and S the sensor's position at reception.

**Doppler.** The received frequency is the emitted one times dt_e / dt_r = (c + u.W) / (c + u.V),
with u the unit vector from the sensor to the object, V and W the velocities of object and sensor in
axes that do not turn (A. D. Pierce, *Acoustics*, 1981, section 9-7; exact in a medium at rest. Time
dilation is left out: in a difference between receivers it is below 1e-11 of the carrier.)

**Signs.** toa = t_r + clock error; tdoa = arrival(sensor) - arrival(reference); fdoa =
received(sensor) - received(reference); measured = predicted + error.

**Emission time.** Derivatives by the object's position are at a fixed emission time. For a set of
arrivals of one emission its time is a common unknown, which whoever adds up the residuals
eliminates (:mod:`geograph.common`). For a difference it follows from the time of arrival at the
reference (:mod:`geograph.factors.difference`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.factors.light_time import turn_to_reception

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

# Rounds of the light time's fixed point; each gains the factor of speed over speed of propagation.
_ROUNDS = 50
_TOLERANCE_M = 1e-9


@dataclass(frozen=True, eq=False)
class SensorMotion:
    """Sensors at n times, in the frame.

    Attributes
    ----------
    position_m, velocity_m_s, acceleration_m_s2
        Shape (n, 3).
    """

    position_m: NDArray[np.float64]
    velocity_m_s: NDArray[np.float64]
    acceleration_m_s2: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Ray:
    """n signals from emission to reception, in the frame's axes at reception.

    Attributes
    ----------
    light_time_s
        Shape (n,): tau.
    distance_m
        Shape (n,).
    unit
        Shape (n, 3): u, from the sensor to the object.
    turned_m, velocity_m_s
        Shape (n, 3): the object's position and velocity in the frame, at emission.
    inertial_velocity_m_s, sensor_inertial_velocity_m_s
        Shape (n, 3): V and W.
    sensor
        The sensors at reception.
    speed_m_s
        Speed of propagation c.
    spin_rad_s
        Angular speed of the frame about z.
    """

    light_time_s: NDArray[np.float64]
    distance_m: NDArray[np.float64]
    unit: NDArray[np.float64]
    turned_m: NDArray[np.float64]
    velocity_m_s: NDArray[np.float64]
    inertial_velocity_m_s: NDArray[np.float64]
    sensor_inertial_velocity_m_s: NDArray[np.float64]
    sensor: SensorMotion
    speed_m_s: float
    spin_rad_s: float

    @property
    def sensor_rate(self) -> NDArray[np.float64]:
        """Return c + u.W, shape (n,)."""
        return self.speed_m_s + _dot(self.unit, self.sensor_inertial_velocity_m_s)

    @property
    def object_rate(self) -> NDArray[np.float64]:
        """Return c + u.V, shape (n,)."""
        return self.speed_m_s + _dot(self.unit, self.inertial_velocity_m_s)

    def take(self, index: NDArray[np.int64] | slice) -> Ray:
        """Return some of the rays, in a given order, repeated if so asked.

        Parameters
        ----------
        index
            Shape (k,), integer; or a range of them.
        """

        def picked(holder: object) -> dict[str, Any]:
            return {
                name: value[index] if isinstance(value, np.ndarray) else value
                for name, value in vars(holder).items()
            }

        return Ray(**(picked(self) | {"sensor": SensorMotion(**picked(self.sensor))}))

    def to_emission(self, vector: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return vectors, shape (n, 3), in the frame's axes at emission."""
        return turn_to_reception(vector, -self.light_time_s, self.spin_rad_s)


@dataclass(frozen=True, eq=False)
class Gradient:
    """Derivatives of n scalars of one ray each.

    Attributes
    ----------
    by_position, by_velocity
        Shape (n, 3): by the object's position and velocity at emission, in the frame's axes then.
    by_sensor_position, by_sensor_velocity
        Shape (n, 3): by the sensor's position and velocity at reception, in the axes then.
    by_emission
        Shape (n,): by the time of emission, the object moving along its path and the sensor along
        its own.
    by_speed
        Shape (n,): by the logarithm of the speed of propagation.
    """

    by_position: NDArray[np.float64]
    by_velocity: NDArray[np.float64]
    by_sensor_position: NDArray[np.float64]
    by_sensor_velocity: NDArray[np.float64]
    by_emission: NDArray[np.float64]
    by_speed: NDArray[np.float64]

    def scaled(self, factor: NDArray[np.float64]) -> Gradient:
        """Return the derivatives times factors, shape (n,)."""
        return Gradient(
            **{
                name: value * (factor[:, None] if value.ndim == 2 else factor)
                for name, value in vars(self).items()
            }
        )

    def plus(self, other: Gradient, factor: NDArray[np.float64]) -> Gradient:
        """Return the sum with another one times factors, shape (n,)."""
        scaled = vars(other.scaled(factor))
        return Gradient(**{name: value + scaled[name] for name, value in vars(self).items()})


def trace(
    position_m: NDArray[np.float64],
    velocity_m_s: NDArray[np.float64],
    sensor_at: Callable[[NDArray[np.float64]], SensorMotion],
    *,
    speed_m_s: float,
    spin_rad_s: float,
    light_time_s: NDArray[np.float64] | None = None,
) -> Ray:
    """Return the rays from an object at emission to moving sensors.

    Parameters
    ----------
    position_m, velocity_m_s
        Shape (n, 3): the object at emission, in the frame at emission.
    sensor_at
        Returns the sensors' motion at light times after emission, shape (n,), seconds.
    speed_m_s
        Speed of propagation c, finite.
    spin_rad_s
        Angular speed of the frame about z, radians per second.
    light_time_s
        Shape (n,): where to start from; None: from zero.
    """
    tau = np.zeros(position_m.shape[0])
    if light_time_s is not None:
        # What a path that ran off left behind is no start.
        tau = np.where(np.isfinite(light_time_s), light_time_s, 0.0)
    for _ in range(_ROUNDS):
        sensor = sensor_at(tau)
        turned = turn_to_reception(position_m, tau, spin_rad_s)
        line = turned - sensor.position_m
        distance = np.sqrt(_dot(line, line))
        unit = line / np.maximum(distance, 1e-300)[:, None]
        inertial = sensor.velocity_m_s + _cross_z(spin_rad_s, sensor.position_m)
        # Newton's step of |P(tau) - S(tau)| - c tau = 0, whose derivative is -(c + u.W).
        change = (distance - speed_m_s * tau) / (speed_m_s + _dot(unit, inertial))
        done = np.abs(change).max(initial=0.0) * speed_m_s <= _TOLERANCE_M + 1e-15 * np.abs(
            distance
        ).max(initial=0.0)
        if done:
            break
        tau = np.maximum(tau + change, 0.0)
    velocity = turn_to_reception(velocity_m_s, tau, spin_rad_s)
    return Ray(
        tau,
        distance,
        unit,
        turned,
        velocity,
        velocity + _cross_z(spin_rad_s, turned),
        inertial,
        sensor,
        speed_m_s,
        spin_rad_s,
    )


def arrival_gradient(ray: Ray) -> Gradient:
    """Return derivatives of the times of arrival t_e + tau, in seconds per unit.

    With N = c + u.W and M = c + u.V: by position u / N, by the sensor's -u / N, by emission M / N,
    by ln c -c tau / N.

    Parameters
    ----------
    ray
        From :func:`trace`.
    """
    rate = ray.sensor_rate
    by_sensor = -ray.unit / rate[:, None]
    zero = np.zeros_like(by_sensor)
    return Gradient(
        by_position=ray.to_emission(-by_sensor),
        by_velocity=zero,
        by_sensor_position=by_sensor,
        by_sensor_velocity=zero,
        by_emission=ray.object_rate / rate,
        by_speed=-ray.distance_m / rate,
    )


def doppler(ray: Ray) -> NDArray[np.float64]:
    """Return received over emitted frequency, less one, shape (n,)."""
    relative = ray.sensor_inertial_velocity_m_s - ray.inertial_velocity_m_s
    return np.asarray(_dot(ray.unit, relative) / ray.object_rate)


def doppler_gradient(ray: Ray, acceleration_m_s2: NDArray[np.float64]) -> Gradient:
    """Return derivatives of received over emitted frequency D = (c + u.W) / (c + u.V).

    With dL the change of the line of sight, dV and dW those of the velocities,

        dD = (u.dW - D u.dV + (W - D V).du) / (c + u.V),  du = (I - u u^T) dL / distance,

    where at a fixed time of emission the signal meets the sensor dtau later: dL = dP - dS - (w x P
    + dS/dt) dtau, dV = dV0 - (w x V) dtau, dW = dW0 + dW/dt dtau, with w the turning of the frame.

    Parameters
    ----------
    ray
        From :func:`trace`.
    acceleration_m_s2
        Shape (n, 3): the object's acceleration in the frame, in the axes at emission.
    """
    spin, unit = ray.spin_rad_s, ray.unit
    ratio = doppler(ray) + 1.0
    below = ray.object_rate
    velocity, sensor_velocity = ray.inertial_velocity_m_s, ray.sensor_inertial_velocity_m_s
    pull = sensor_velocity - ratio[:, None] * velocity
    # Row vectors: what a change of the line, of V and of W adds.
    by_line = (pull - unit * _dot(unit, pull)[:, None]) / (ray.distance_m * below)[:, None]
    by_object = -unit * (ratio / below)[:, None]
    by_sensor = unit / below[:, None]
    # A later reception moves all three; so does a later emission.
    frame_turn = _cross_z(spin, ray.turned_m) + ray.sensor.velocity_m_s
    sensor_change = ray.sensor.acceleration_m_s2 + _cross_z(spin, ray.sensor.velocity_m_s)
    by_delay = (
        -_dot(by_line, frame_turn)
        - _dot(by_object, _cross_z(spin, velocity))
        + _dot(by_sensor, sensor_change)
    )
    delay = arrival_gradient(ray)
    # V contains w x P, and W contains w x S: their shares by position.
    by_turned = by_line + by_delay[:, None] * unit / ray.sensor_rate[:, None]
    by_turned = by_turned + _cross_z(-spin, by_object)
    by_place = -by_line + by_delay[:, None] * delay.by_sensor_position
    by_place = by_place + _cross_z(-spin, by_sensor)
    acceleration = turn_to_reception(acceleration_m_s2, ray.light_time_s, spin)
    by_emission = (
        _dot(by_line, ray.velocity_m_s - ray.sensor.velocity_m_s)
        + _dot(by_object, acceleration + _cross_z(spin, ray.velocity_m_s))
        + _dot(by_sensor, sensor_change)
        + by_delay * (delay.by_emission - 1.0)
    )
    by_light_time = by_delay * delay.by_speed
    by_speed = by_light_time + ray.speed_m_s * (1.0 - ratio) / below
    return Gradient(
        by_position=ray.to_emission(by_turned),
        by_velocity=ray.to_emission(by_object),
        by_sensor_position=by_place,
        by_sensor_velocity=by_sensor,
        by_emission=by_emission,
        by_speed=by_speed,
    )


def emission_gradient(reference: Ray) -> Gradient:
    """Return derivatives of the time of emission when that of arrival is held.

    Parameters
    ----------
    reference
        Rays to the sensors whose times of arrival are held; ``by_emission`` of the result is the
        derivative by that time of arrival.
    """
    arrival = arrival_gradient(reference)
    held = arrival.scaled(-1.0 / arrival.by_emission)
    return Gradient(**(vars(held) | {"by_emission": 1.0 / arrival.by_emission}))


def _dot(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.einsum("ni,ni->n", one, other))


def _cross_z(spin_rad_s: float, vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (0, 0, spin) x vector, shape (n, 3)."""
    product = np.zeros_like(vector)
    if spin_rad_s != 0.0:
        product[:, 0] = -spin_rad_s * vector[:, 1]
        product[:, 1] = spin_rad_s * vector[:, 0]
    return product
