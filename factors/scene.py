"""An object and the receivers of its signals, as the keys of one factor see them.

What :mod:`geograph.factors.standalone_radio` needs beside the measurement equations: which key
holds what, where the object is at any time, and where derivatives by physical quantities go in the
matrices by keys.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import factorial
from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.constants import EARTH_ROTATION_RAD_S
from geograph.errors import InputError
from geograph.factors.arrival import SensorMotion, arrival_gradient, trace
from geograph.factors.kinematics import interpolation_weights

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from geograph.factors.arrival import Ray

Order = Literal[1, 2, 3]

# Newton's steps of the time of emission gain as the signal is faster than the object.
_ROUNDS = 100
_TOLERANCE_S = 1e-15


@dataclass(frozen=True, eq=False, kw_only=True)
class Receiver:
    """A receiver of a standalone factor, and the keys of its errors.

    Parameters
    ----------
    position_m
        Shape (3,): its position at time zero, metres, in the factor's frame.
    velocity_m_s, acceleration_m_s2
        Shape (3,): in the frame; the receiver moves by them from time zero.
    clock_key
        Key (1,) of the clock's error, added to its times: metres, which is seconds times the
        nominal speed of propagation.
    frequency_key
        Key (1,) of the error of its received frequencies, hertz.
    position_key
        Key of what is added to its motion, metres: (3,), a constant offset, or as many blocks as
        ``position_order``. A platform whose state is estimated has ``position_m`` zero and its
        state here.
    position_order
        Blocks of that key: offset, its velocity, its acceleration, at time zero.

    Raises
    ------
    InputError
        If a vector is not three finite numbers, or the order is not 1, 2 or 3.
    """

    position_m: ArrayLike
    velocity_m_s: ArrayLike = (0.0, 0.0, 0.0)
    acceleration_m_s2: ArrayLike = (0.0, 0.0, 0.0)
    clock_key: int | None = None
    frequency_key: int | None = None
    position_key: int | None = None
    position_order: Order = 1
    motion: NDArray[np.float64] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        parts = []
        for name in ("position_m", "velocity_m_s", "acceleration_m_s2"):
            given = getattr(self, name)
            vector = np.asarray(given, dtype=np.float64)
            if vector.shape != (3,) or not np.isfinite(vector).all():
                raise InputError(f"{name} is {given!r}; expected three finite numbers")
            parts.append(vector)
        if self.position_order not in (1, 2, 3):
            raise InputError(f"position_order is {self.position_order}; expected 1, 2 or 3")
        object.__setattr__(self, "motion", np.stack(parts))


@dataclass(frozen=True, eq=False)
class ScenePoint:
    """What the keys hold at one point.

    Attributes
    ----------
    blocks
        Shape (w, 3): the object's states, block by block.
    motions
        Shape (n, 3, 3): position, velocity and acceleration of every receiver at time zero, their
        errors added.
    clock_s, frequency_hz
        Shape (n,): errors of the receivers.
    speed_m_s
        Speed of propagation.
    """

    blocks: NDArray[np.float64]
    motions: NDArray[np.float64]
    clock_s: NDArray[np.float64]
    frequency_hz: NDArray[np.float64]
    speed_m_s: float


class Scene:
    """Keys of one factor, and what they mean; arguments as of ``arrivals_factor``.

    Raises
    ------
    InputError
        If an order, a step or the speed of propagation is not usable, or one key is given two
        sizes.
    """

    def __init__(
        self,
        key: int,
        receivers: Sequence[Receiver],
        *,
        order: Order,
        next_key: int | None,
        step_s: float,
        speed_m_s: float,
        speed_key: int | None,
        frame: Literal["ecef", "local"],
    ) -> None:
        if order not in (1, 2, 3):
            raise InputError(f"order is {order}; expected 1, 2 or 3")
        if next_key is not None and not (np.isfinite(step_s) and step_s > 0.0):
            raise InputError(f"step_s is {step_s}; expected above 0 with next_key")
        if not (np.isfinite(speed_m_s) and speed_m_s > 0.0):
            raise InputError(f"speed_m_s is {speed_m_s}; expected a finite number above 0")
        if frame not in ("ecef", "local"):
            raise InputError(f"frame is {frame!r}; expected ecef or local")
        self.order: Order = order
        self.next_key = next_key
        self.step_s = step_s
        self.receivers = tuple(receivers)
        self.speed_m_s = float(speed_m_s)
        self.speed_key = speed_key
        self.spin_rad_s = EARTH_ROTATION_RAD_S if frame == "ecef" else 0.0
        self.keys: list[int] = []
        self.sizes: list[int] = []
        self.object_keys = [key] if next_key is None else [key, next_key]
        for own in self.object_keys:
            self.add(own, 3 * order)
        self._motion = np.stack([receiver.motion for receiver in self.receivers])
        for receiver in self.receivers:
            if receiver.clock_key is not None:
                self.add(receiver.clock_key, 1)
            if receiver.frequency_key is not None:
                self.add(receiver.frequency_key, 1)
            if receiver.position_key is not None:
                self.add(receiver.position_key, 3 * receiver.position_order)
        if speed_key is not None:
            self.add(speed_key, 1)

    def add(self, key: int, size: int) -> None:
        """Take up a key, once."""
        if key not in self.keys:
            self.keys.append(key)
            self.sizes.append(size)
        elif self.sizes[self.keys.index(key)] != size:
            raise InputError(
                f"key {key} holds {self.sizes[self.keys.index(key)]} numbers and is also given "
                f"for {size}; expected another key"
            )

    def vector(self, vectors: list[NDArray[np.float64]], key: int) -> NDArray[np.float64]:
        """Return the value of a key."""
        return vectors[self.keys.index(key)]

    def read(self, vectors: list[NDArray[np.float64]]) -> ScenePoint:
        """Return what the keys hold."""
        for key, size, vector in zip(self.keys, self.sizes, vectors, strict=True):
            if vector.shape != (size,):
                raise InputError(f"key {key} holds {vector.size} numbers; expected {size}")
        count = len(self.receivers)
        blocks = np.concatenate([self.vector(vectors, key) for key in self.object_keys])
        motions = self._motion.copy()
        clock, frequency = np.zeros(count), np.zeros(count)
        for index, receiver in enumerate(self.receivers):
            if receiver.clock_key is not None:
                clock[index] = self.vector(vectors, receiver.clock_key)[0] / self.speed_m_s
            if receiver.frequency_key is not None:
                frequency[index] = self.vector(vectors, receiver.frequency_key)[0]
            if receiver.position_key is not None:
                offset = self.vector(vectors, receiver.position_key).reshape(-1, 3)
                motions[index, : offset.shape[0]] += offset
        speed = self.speed_m_s
        if self.speed_key is not None:
            speed += float(self.vector(vectors, self.speed_key)[0])
        return ScenePoint(blocks.reshape(-1, 3), motions, clock, frequency, speed)

    def weights(self, time_s: float, derivative: int) -> NDArray[np.float64]:
        """Return what the object's blocks add to a derivative of its position, shape (w,)."""
        if self.next_key is not None:
            found = interpolation_weights(
                self.order, np.array([self.step_s]), np.array([time_s]), derivative=derivative
            )
            return np.asarray(found[0])
        return _taylor(self.order, time_s, derivative)

    def object_at(
        self, point: ScenePoint, time_s: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return position, velocity and acceleration, each shape (3,), at a time."""
        position, velocity, acceleration = (
            self.weights(time_s, derivative) @ point.blocks for derivative in range(3)
        )
        return position, velocity, acceleration

    def rays(
        self, point: ScenePoint, emitted_s: float, light_time_s: NDArray[np.float64] | None = None
    ) -> Ray:
        """Return the signals of one emission to all receivers."""
        count = len(self.receivers)
        position, velocity, _ = self.object_at(point, emitted_s)
        motions = point.motions

        def sensor_at(delay_s: NDArray[np.float64]) -> SensorMotion:
            time = (emitted_s + delay_s)[:, None]
            start, rate, change = motions[:, 0], motions[:, 1], motions[:, 2]
            return SensorMotion(
                start + time * rate + 0.5 * time**2 * change, rate + time * change, change
            )

        return trace(
            np.tile(position, (count, 1)),
            np.tile(velocity, (count, 1)),
            sensor_at,
            speed_m_s=point.speed_m_s,
            spin_rad_s=self.spin_rad_s,
            light_time_s=light_time_s,
        )

    def best_emission(
        self, point: ScenePoint, toa_s: NDArray[np.float64], white: NDArray[np.float64]
    ) -> float:
        """Return the time of emission with the least sum of squares of whitened residuals."""
        arrived = toa_s - point.clock_s
        # By the median of what the arrivals ask for, an early guess that no outlier spoils.
        emitted, delay = float(np.median(arrived)), None
        for _ in range(2):
            delay = self.rays(point, emitted, delay).light_time_s
            emitted = float(np.median(arrived - delay))
        for _ in range(_ROUNDS):
            ray = self.rays(point, emitted, delay)
            delay = ray.light_time_s
            slope = arrival_gradient(ray).by_emission * white
            residual = (emitted - arrived + delay) * white
            step = -float(slope @ residual) / float(slope @ slope)
            emitted += step
            if not abs(step) > _TOLERANCE_S + 2.0 * np.finfo(float).eps * abs(emitted):
                break
        return emitted

    def emission_of_arrival(self, point: ScenePoint, index: int, time_s: float) -> float:
        """Return the time of the emission that arrives at a receiver at a time by its clock."""
        received = time_s - float(point.clock_s[index])
        emitted, delay = received, None
        for _ in range(_ROUNDS):
            ray = self.rays(point, emitted, delay)
            delay = ray.light_time_s
            rate = arrival_gradient(ray).by_emission[index]
            step = float((received - emitted - delay[index]) / rate)
            emitted += step
            if not abs(step) > _TOLERANCE_S + 2.0 * np.finfo(float).eps * abs(emitted):
                break
        return emitted


class SceneGradient:
    """Derivatives of the rows of one factor, gathered by key.

    Parameters
    ----------
    scene, point
        The factor's keys, and their values.
    ray
        The signals to all receivers.
    emitted_s
        When they were emitted.
    rows
        Rows of the factor.
    """

    def __init__(
        self, scene: Scene, point: ScenePoint, ray: Ray, emitted_s: float, rows: int
    ) -> None:
        self.scene = scene
        self._point = point
        self._emitted_s = emitted_s
        self._received_s = emitted_s + ray.light_time_s
        self._matrices = {
            key: np.zeros((rows, size)) for key, size in zip(scene.keys, scene.sizes, strict=True)
        }

    def matrix(self, key: int) -> NDArray[np.float64]:
        """Return the derivatives by one key, to be added to."""
        return self._matrices[key]

    def add_object(
        self, by_position: NDArray[np.float64], by_velocity: NDArray[np.float64]
    ) -> None:
        """Add derivatives, shape (rows, 3), by the object's position and velocity at emission."""
        total = np.kron(self.scene.weights(self._emitted_s, 0), by_position)
        total += np.kron(self.scene.weights(self._emitted_s, 1), by_velocity)
        size = 3 * self.scene.order
        for index, key in enumerate(self.scene.object_keys):
            self._matrices[key] += total[:, index * size : (index + 1) * size]

    def add_sensor(
        self,
        rows: NDArray[np.int64],
        receivers: NDArray[np.int64],
        by_position: NDArray[np.float64],
        by_velocity: NDArray[np.float64],
    ) -> None:
        """Add derivatives, shape (k, 3), of rows by positions and velocities of receivers."""
        for row, index, place, rate in zip(rows, receivers, by_position, by_velocity, strict=True):
            receiver = self.scene.receivers[index]
            if receiver.position_key is None:
                continue
            time = float(self._received_s[index])
            order = receiver.position_order
            total = np.kron(_taylor(order, time, 0), place) + np.kron(_taylor(order, time, 1), rate)
            self._matrices[receiver.position_key][row] += total

    def add_clock(
        self, rows: NDArray[np.int64], receivers: NDArray[np.int64], by_s: NDArray[np.float64]
    ) -> None:
        """Add derivatives, shape (k,), of rows by the clocks of receivers, per second."""
        for row, index, value in zip(rows, receivers, by_s, strict=True):
            key = self.scene.receivers[index].clock_key
            if key is not None:
                self._matrices[key][row, 0] += value / self.scene.speed_m_s

    def add_frequency(
        self, rows: NDArray[np.int64], receivers: NDArray[np.int64], by_hz: NDArray[np.float64]
    ) -> None:
        """Add derivatives, shape (k,), of rows by the frequency errors of receivers, per hertz."""
        for row, index, value in zip(rows, receivers, by_hz, strict=True):
            key = self.scene.receivers[index].frequency_key
            if key is not None:
                self._matrices[key][row, 0] += value

    def add_speed(self, by_log_speed: NDArray[np.float64]) -> None:
        """Add derivatives, shape (rows,), by the logarithm of the speed of propagation."""
        if self.scene.speed_key is not None:
            self._matrices[self.scene.speed_key][:, 0] += by_log_speed / self._point.speed_m_s

    def whitened(self, whiten: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Return the derivatives by all keys, in their order, times a matrix from the left."""
        return [whiten @ self._matrices[key] for key in self.scene.keys]


def _taylor(order: int, time_s: float, derivative: int) -> NDArray[np.float64]:
    """Return what blocks at time zero add to a derivative of the position at a time, (order,)."""
    weights = np.zeros(order)
    for block in range(derivative, order):
        power = block - derivative
        weights[block] = time_s**power / factorial(power)
    return weights
