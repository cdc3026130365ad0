"""Sensors: where they are, how their axes lie, and how wrong they may be.

Every error is a state of the graph when its prior 1-sigma is positive, and known to be absent when
it is zero. Errors are signed so that *measured = predicted + error*.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from geograph.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray
    from scipy.interpolate import CubicSpline

    from geograph.attitude import AttitudeSpline

Axes = Literal["enu", "xyz", "body", "radec"]
"""How a sensor's bearings are measured; see docs/conventions.md."""

Refraction = Literal["none", "standard"]


@dataclass(frozen=True, kw_only=True)
class SensorErrors:
    """Prior standard deviations of one sensor's errors, SI units; zero means known.

    Biases, offsets and drifts are constants of the pass; an instability is the diffusion of a
    random walk added to the same error. Drifts are counted from the first measurement of the
    recording.

    Raises
    ------
    InputError
        If a value is negative or not finite.
    """

    azimuth_bias_rad: float = 0.0
    elevation_bias_rad: float = 0.0
    azimuth_drift_rad_s: float = 0.0
    elevation_drift_rad_s: float = 0.0
    azimuth_instability_rad_sqrt_s: float = 0.0
    elevation_instability_rad_sqrt_s: float = 0.0
    misalignment_rad: float = 0.0
    clock_offset_s: float = 0.0
    clock_drift_s_s: float = 0.0
    clock_instability_s_sqrt_s: float = 0.0
    frequency_offset_hz: float = 0.0
    frequency_drift_hz_s: float = 0.0
    position_m: float = 0.0
    position_noise_m: float = 0.0

    def __post_init__(self) -> None:
        for entry in dataclasses.fields(self):
            value = getattr(self, entry.name)
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError(
                    f"prior sigma is {value}; expected a finite number of at least 0 (0: known)",
                    column=entry.name,
                )


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A moving sensor's positions, interpolated by a cubic spline.

    Parameters
    ----------
    time_s
        Shape (n,), strictly increasing, n >= 2, seconds after the recording's epoch.
    position_m
        Shape (n, 3), metres, in the recording's frame.
    attitude_rad
        Shape (n, 3): yaw, pitch and roll in radians, or None.

    Raises
    ------
    InputError
        If shapes differ, a value is not finite, or times do not increase.
    """

    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    attitude_rad: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        time, position = self.time_s, self.position_m
        if time.ndim != 1 or position.shape != (time.size, 3) or time.size < 2:
            raise InputError(
                f"trajectory has times of shape {time.shape} and positions of shape "
                f"{position.shape}; expected (n,) and (n, 3) with n of at least 2"
            )
        if self.attitude_rad is not None and self.attitude_rad.shape != (time.size, 3):
            raise InputError(
                f"trajectory has attitudes of shape {self.attitude_rad.shape}; "
                f"expected ({time.size}, 3): yaw, pitch, roll"
            )
        if self.attitude_rad is not None and not np.isfinite(self.attitude_rad).all():
            raise InputError("trajectory has an attitude that is not finite; remove such rows")
        if not (np.isfinite(time).all() and np.isfinite(position).all()):
            raise InputError("trajectory has a value that is not finite; remove such rows")
        if not (np.diff(time) > 0.0).all():
            raise InputError("trajectory times do not increase strictly; sort them, drop repeats")

    @cached_property
    def _spline(self) -> CubicSpline:
        from scipy.interpolate import CubicSpline

        # A parabola or a line where there are too few points for the not-a-knot condition.
        return CubicSpline(self.time_s, self.position_m, axis=0)

    @cached_property
    def attitude(self) -> AttitudeSpline | None:
        """The attitude between samples, or None where it is not known."""
        if self.attitude_rad is None:
            return None
        from geograph.attitude import AttitudeSpline

        return AttitudeSpline(self.time_s, self.attitude_rad)

    def position_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return positions, shape (..., 3), metres, at times in seconds (any shape)."""
        return np.asarray(self._spline(np.asarray(time_s, dtype=np.float64)))

    def velocity_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return velocities, shape (..., 3), metres per second, at times in seconds."""
        return np.asarray(self._spline(np.asarray(time_s, dtype=np.float64), 1))

    def acceleration_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return accelerations, shape (..., 3), m/s^2, at times in seconds."""
        return np.asarray(self._spline(np.asarray(time_s, dtype=np.float64), 2))

    def motion_at(
        self, time_s: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return positions, velocities and accelerations, each shape (n, 3), in one reading.

        Parameters
        ----------
        time_s
            Shape (n,), seconds.
        """
        edges, parts = self._spline.x, self._spline.c
        piece = np.searchsorted(edges, time_s, side="right") - 1
        piece = np.clip(piece, 0, edges.size - 2)
        offset = (time_s - edges[piece])[:, None]
        third, second, first, zeroth = parts[:, piece]
        position = ((third * offset + second) * offset + first) * offset + zeroth
        velocity = (3.0 * third * offset + 2.0 * second) * offset + first
        return position, velocity, 6.0 * third * offset + 2.0 * second

    def pieces(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return edges (p,) and coefficients (p, 4, 3) of :class:`geograph.frames.SensorPieces`."""
        if self.time_s.size == 2:
            # A line, as the spline would have it.
            rate = np.diff(self.position_m, axis=0) / np.diff(self.time_s)
            none = np.zeros_like(rate)
            return self.time_s[:1], np.stack([none, none, rate, self.position_m[:1]], axis=1)
        return self._spline.x[:-1], np.swapaxes(self._spline.c, 0, 1)


@dataclass(frozen=True, eq=False, kw_only=True)
class Sensor:
    """One sensor of a recording: fixed, or moving along a trajectory.

    Parameters
    ----------
    name
        Its name in the recording's tables.
    position_m
        Shape (3,), metres, in the recording's frame; for a fixed sensor.
    trajectory
        For a moving sensor; exactly one of ``position_m`` and ``trajectory`` is given.
    axes
        Axes of its bearings: ``"enu"`` (azimuth clockwise from north, elevation above the geodetic
        horizon), ``"xyz"`` (on the recording's axes), ``"body"`` (forward, right, down by yaw,
        pitch and roll; needs attitudes) or ``"radec"`` (right ascension and declination against
        the stars, ICRS; needs the frame ``ecef`` and an epoch).
    attitude_rad
        Shape (3,): yaw, pitch and roll of a fixed sensor with body axes; a moving one has them in
        its trajectory.
    unusual_attitude
        Whether attitudes that look wrong (turning too fast, or yaw in another unit than the course)
        are used as they are instead of refused.
    errors
        Prior standard deviations of its errors.
    correlation
        Correlation, 0 to 1, of errors that are not modelled as states; 1 is covariance
        intersection.
    refraction
        ``"standard"`` removes mean astronomical refraction from its elevations.
    platform_process_noise
        None: the trajectory is known but for the errors above. Otherwise the trajectory's points
        are position fixes, each with the independent error ``errors.position_noise_m``, of a
        platform whose path is estimated too: constant velocity, driven by white noise on the
        acceleration of this square root of its spectral density, m/s^1.5 (0: straight and even).
    calibrations_s
        Times by its own clock, increasing, at which its errors of azimuth and elevation begin anew:
        bias, drift and random walk. ``"auto"``: unknown, and to be found.
    clock_resets_s
        The same of its clock's error, known.

    Raises
    ------
    InputError
        If there is not exactly one of position and trajectory, or a value is out of range.
    """

    name: str
    position_m: NDArray[np.float64] | None = None
    trajectory: Trajectory | None = None
    axes: Axes = "enu"
    errors: SensorErrors = field(default_factory=SensorErrors)
    correlation: float = 0.0
    refraction: Refraction = "none"
    platform_process_noise: float | None = None
    calibrations_s: tuple[float, ...] | Literal["auto"] = ()
    clock_resets_s: tuple[float, ...] = ()
    attitude_rad: NDArray[np.float64] | None = None
    unusual_attitude: bool = False

    def __post_init__(self) -> None:
        if (self.position_m is None) == (self.trajectory is None):
            raise InputError(
                f"sensor {self.name!r} needs exactly one of a position and a trajectory"
            )
        if self.position_m is not None and (
            self.position_m.shape != (3,) or not np.isfinite(self.position_m).all()
        ):
            raise InputError(f"sensor {self.name!r}: expected three finite coordinates as position")
        if self.axes not in get_args(Axes):
            raise InputError(
                f"sensor {self.name!r} has axes {self.axes!r}; expected one of "
                + ", ".join(get_args(Axes))
            )
        if not 0.0 <= self.correlation <= 1.0:
            raise InputError(
                f"sensor {self.name!r} has correlation {self.correlation}; expected 0 to 1"
            )
        if self.refraction not in get_args(Refraction):
            raise InputError(
                f"sensor {self.name!r} has refraction {self.refraction!r}; "
                "expected none or standard"
            )
        self._check_attitude()
        self._check_platform()
        self._check_resets()

    def _check_resets(self) -> None:
        errors = self.errors
        pointing = (
            errors.azimuth_bias_rad, errors.azimuth_drift_rad_s,
            errors.azimuth_instability_rad_sqrt_s, errors.elevation_bias_rad,
            errors.elevation_drift_rad_s, errors.elevation_instability_rad_sqrt_s,
        )  # fmt: skip
        clock = errors.clock_offset_s, errors.clock_drift_s_s, errors.clock_instability_s_sqrt_s
        for name, known, what in (
            ("calibrations_s", pointing, "bias, drift or instability of azimuth or elevation"),
            ("clock_resets_s", clock, "clock offset, drift or instability"),
        ):
            times = getattr(self, name)
            if times == "auto" and name == "calibrations_s":
                times = (0.0,)
            elif isinstance(times, str) or not (
                np.isfinite(times).all() and (np.diff(times) > 0.0).all()
            ):
                raise InputError(
                    f"sensor {self.name!r} has {name} {times!r}; expected increasing times in "
                    f"seconds{', or auto' if name == 'calibrations_s' else ''}"
                )
            if times and not max(known) > 0.0:
                raise InputError(
                    f"sensor {self.name!r} has {name} and no error that begins anew; expected a "
                    f"{what} above 0 beside it"
                )

    def _check_attitude(self) -> None:
        if self.errors.misalignment_rad > 0.0 and self.axes != "body":
            raise InputError(
                f"sensor {self.name!r} has a misalignment and axes {self.axes!r}; expected axes "
                "body, which it turns"
            )
        own = self.attitude_rad
        if own is not None and (
            self.position_m is None or own.shape != (3,) or not np.isfinite(own).all()
        ):
            raise InputError(
                f"sensor {self.name!r}: expected three finite angles as attitude, of a fixed "
                "sensor; those of a moving one are in its trajectory"
            )
        if self.axes != "body":
            return
        moving = self.trajectory
        if own is None if moving is None else moving.attitude_rad is None:
            where = "attitude" if moving is None else "attitudes in its trajectory"
            raise InputError(
                f"sensor {self.name!r} has axes body and no {where}; expected yaw, pitch and roll"
            )

    def _check_platform(self) -> None:
        noise = self.platform_process_noise
        if noise is None:
            return
        if not (np.isfinite(noise) and noise >= 0.0):
            raise InputError(
                f"sensor {self.name!r} has platform_process_noise {noise}; expected a finite "
                "number of at least 0"
            )
        if self.trajectory is None or not self.errors.position_noise_m > 0.0:
            raise InputError(
                f"sensor {self.name!r} has a platform_process_noise; expected a trajectory beside "
                "it, whose points are fixes, and position_noise_m above 0, the sigma of each"
            )

    def position_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return positions, shape (..., 3), metres, at times in seconds (any shape)."""
        if self.trajectory is not None:
            return self.trajectory.position_at(time_s)
        return np.broadcast_to(np.asarray(self.position_m), (*np.shape(time_s), 3))

    def velocity_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return velocities, shape (..., 3), metres per second, at times in seconds."""
        if self.trajectory is not None:
            return self.trajectory.velocity_at(time_s)
        return np.zeros((*np.shape(time_s), 3))
