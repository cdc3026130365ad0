"""Bearings, with every error of the sensors that took them."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from geograph.factors.aberration import astrometric_sight
from geograph.factors.attitude import Turned, misaligned
from geograph.factors.bearing import coordinate_residual, predict_bearing, tangent_residual
from geograph.factors.kinematics import hermite_coefficients
from geograph.factors.light_time import Sight, light_time_correction, sight
from geograph.families.base import ByPosition, Evaluation, Report, SensorFamily, Values
from geograph.frames import frame_spin_rad_s
from geograph.kernels import compiled, flat, indices
from geograph.path import KinematicPathState
from geograph.states import (
    AZIMUTH,
    CHANNELS,
    CLOCK,
    ELEVATION,
    MISALIGNMENT,
    POSITION,
    SPEED,
    VELOCITY,
    ChainShare,
    SensorErrorTerms,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.factors.bearing import BearingResidual
    from geograph.frames import SensorGeometry, SensorPoses
    from geograph.measurements import Bearings
    from geograph.path import Path, PathState, Place
    from geograph.states import SensorStates

# Newton's step of the light time squares its error: after one of a microsecond, what is left of an
# object at 10 km/s is far below a micrometre. Derivatives are taken at the time before that step;
# sound, which gains little in a step, comes as close as light only if asked to.
_LIGHT_TIME_TOLERANCE_S = 1e-6
_SLOW_TOLERANCE_S = 1e-9
_SLOW_M_S = 1e6
LIGHT_TIME_ROUNDS = 20

# Cosine of the elevation below which a measured azimuth is that of the zenith.
ZENITH = 1e-6


def light_time_tolerance_s(speed_m_s: float) -> float:
    """Return how exact light times are found before the last step, seconds, by the speed."""
    return _LIGHT_TIME_TOLERANCE_S if speed_m_s > _SLOW_M_S else _SLOW_TOLERANCE_S


class BearingFamily(SensorFamily):
    """All bearings of a recording.

    Parameters
    ----------
    bearings
        The table, elevations free of refraction.
    geometry
        Poses of the sensors.
    states
        Sensor-error states of the problem.
    walk_scale
        Shape (w,): scales of the walks, SI.
    speed_m_s
        Speed of propagation; inf: no light time.
    weight
        Shape (n,): weights of the information, for correlated errors.
    position_noise_m
        Shape (n,): white error of the sensor's position at each measurement.
    """

    name = "bearings"
    rows = 2

    def __init__(
        self,
        bearings: Bearings,
        *,
        geometry: SensorGeometry,
        states: SensorStates,
        walk_scale: NDArray[np.float64],
        speed_m_s: float,
        weight: NDArray[np.float64],
        position_noise_m: NDArray[np.float64],
    ) -> None:
        self.bearings = bearings
        self.time_s = bearings.time_s
        self.sensor = bearings.sensor
        self.line = bearings.line
        self.geometry = geometry
        self.states = states
        self.speed_m_s = speed_m_s
        self.spin_rad_s = frame_spin_rad_s(geometry.frame)
        self.weight = weight
        self.position_noise_m = position_noise_m
        self.walk_scale = walk_scale
        self.azimuth_only = np.isnan(bearings.elevation_rad)
        self.row_counts = np.where(self.azimuth_only, 1, 2)
        self.row_count = int(self.row_counts.sum())
        self.terms = SensorErrorTerms(states, bearings.sensor, bearings.time_s, walk_scale)
        # An azimuth alone has no tangent plane: its on-sky sigma is that of the coordinate.
        self._tangent = bearings.isotropic & ~self.azimuth_only
        self._uniform = bool(self._tangent.all())
        # Only an elevation error moves the measured elevation off the corrected one.
        self._elevation = np.where(self.azimuth_only, 0.0, bearings.elevation_rad)
        self._noise_elevation = self._elevation if ELEVATION in states.channels else None
        self._clocked = CLOCK in states.channels
        self._fast = SPEED in states.channels
        self._turned = MISALIGNMENT in states.channels
        beyond = bool((self.terms.chains.channel > ELEVATION).any())
        self._walks_elsewhere = beyond or self.terms.cut
        self._stars = geometry.stars(bearings.sensor, bearings.time_s)
        self._light_time = np.zeros(len(bearings))
        self._walk_time = bearings.time_s.copy()
        self._poses: SensorPoses | None = None
        self._place: tuple[Path, Place] | None = None
        self._emitted = self.time_s
        self.path_noise_m = np.zeros(len(bearings))
        self.path_noise_m_s = np.zeros(len(bearings))
        self._white = self._whitening(np.full(len(bearings), np.inf))

    def _whitening(self, distance_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return reciprocals of the sigmas, shape (n, 2), position noise included."""
        azimuth = self.bearings.sigma_azimuth_rad
        elevation = self.bearings.sigma_elevation_rad
        level = np.ones(len(self))
        if not self._uniform:
            level = np.where(self._tangent, 1.0, np.cos(self._elevation))
        if self.position_noise_m.any() or self.path_noise_m.any():
            extra = np.hypot(self.position_noise_m, self.path_noise_m) / distance_m
            # A displacement across the line of sight moves the azimuth by 1 / cos(elevation) more.
            azimuth = np.hypot(azimuth, extra / np.maximum(level, 1e-6))
            elevation = np.hypot(elevation, extra)
        white = np.sqrt(self.weight)[:, None] / np.stack([azimuth, elevation], axis=1)
        if self._uniform:
            return np.asarray(white)
        white[self.azimuth_only, 1] = 0.0
        # At the zenith a coordinate's azimuth says nothing, however small its sigma.
        white[~self._tangent & ~self.azimuth_only & (level < ZENITH), 0] = 0.0
        return np.asarray(white)

    def refresh(self, path: Path, values: Values) -> None:
        """Take distances (for position noise) and times (of the walks) from an estimate."""
        found, place, *_ = self._find(path, path.at_state(values.path, jacobian=False), values)
        self._white = self._whitening(found.distance_m)
        self._walk_time = place.time_s.copy()

    def subset(self, index: NDArray[np.int64]) -> BearingFamily:
        """Return the family of some of its bearings."""
        columns = {name: column[index] for name, column in vars(self.bearings).items()}
        part = BearingFamily(
            type(self.bearings)(**columns),
            geometry=self.geometry,
            states=self.states,
            walk_scale=self.walk_scale,
            speed_m_s=self.speed_m_s,
            weight=self.weight[index],
            position_noise_m=self.position_noise_m[index],
        )
        part._light_time = self._light_time[index]
        part._walk_time = self._walk_time[index]
        part._white = self._white[index]
        part.path_noise_m = self.path_noise_m[index]
        return part

    def _errors(
        self, path: Path, values: Values, interval: NDArray[np.int64] | None
    ) -> NDArray[np.float64]:
        """Return the errors of all channels, shape (n, CHANNELS), chains read in intervals."""
        if interval is None or not self.terms.chains.row.size:
            return self.terms.errors(values.constants)
        return self.terms.errors(values.constants, values.walks, self._share(path, interval))

    def _share(self, path: Path, interval: NDArray[np.int64]) -> ChainShare:
        return self.terms.share(path.knots_s, interval, self._walk_time)

    def _find(
        self, path: Path, state: PathState, values: Values
    ) -> tuple[Sight, Place, SensorPoses, NDArray[np.float64]]:
        """Solve for the light times; return sights, places, poses and errors of all channels."""
        interval = None
        if self.terms.chains.row.size:
            interval = path.locate(self._walk_time).interval
        errors = self._errors(path, values, interval)
        received = self.bearings.time_s - errors[:, CLOCK]
        poses = self._posed(received)
        position = poses.position_m + errors[:, POSITION : POSITION + 3]
        speed, enough = self._speed(float(errors[0, SPEED]) if len(self) else 0.0)
        for _ in range(LIGHT_TIME_ROUNDS):
            place = self._locate(path, received - self._light_time)
            at, velocity = state.position_velocity(place)
            found = sight(at, velocity, position, self._light_time, self.spin_rad_s)
            if np.isinf(self.speed_m_s):
                break
            correction = light_time_correction(found, speed)
            if not np.abs(correction).max(initial=0.0) > enough:
                # What is left is below a microsecond: straight motion meets it.
                found = sight(
                    at - velocity * correction[:, None],
                    velocity,
                    position,
                    self._light_time + correction,
                    self.spin_rad_s,
                )
                break
            self._light_time = np.maximum(self._light_time + correction, 0.0)
        self._emitted = place.time_s
        return found, place, poses, errors

    def _posed(self, received_s: NDArray[np.float64]) -> SensorPoses:
        """Return the sensors' poses at reception, which only their clocks can change."""
        poses = self._poses
        if poses is None or self._clocked:
            poses = self.geometry.poses(self.bearings.sensor, received_s)
            if not self._clocked:
                self._poses = poses
        return poses

    def _indexed(self, received_s: NDArray[np.float64]) -> tuple[SensorPoses, NDArray[np.int64]]:
        """Return poses, and of each bearing which of them: one a sensor where none moves."""
        at_rest = self.geometry.at_rest
        if at_rest is not None:
            return at_rest, indices(self.sensor)
        return self._posed(received_s), np.arange(len(self))

    def _speed(self, error_m_s: float) -> tuple[float, float]:
        """Return the speed of propagation, m/s, and how exact light times are found, seconds."""
        speed = self.speed_m_s + error_m_s
        return speed, light_time_tolerance_s(speed)

    def _locate(self, path: Path, time_s: NDArray[np.float64]) -> Place:
        # Places are most of the work where nothing moves them, so the last ones are kept.
        if self._place is not None and self._place[0] is path:
            place = self._place[1]
            if np.array_equal(place.time_s, time_s):
                return place
        place = path.locate(time_s)
        self._place = (path, place)
        return place

    def _in_true_axes(
        self,
        poses: SensorPoses,
        line_of_sight_m: NDArray[np.float64],
        errors: NDArray[np.float64],
        *,
        jacobian: bool = False,
    ) -> Turned:
        """Return lines of sight along the rows of the sensors' axes, misalignments included."""
        sight_axes = np.matmul(poses.axes, line_of_sight_m[:, :, None])[:, :, 0]
        if not self._turned:
            return Turned(sight_axes, poses.axes, None)
        angles = errors[:, MISALIGNMENT : MISALIGNMENT + 3]
        return misaligned(sight_axes, angles, jacobian=jacobian)

    def _on_the_sky(
        self, sight_axes: NDArray[np.float64], *, jacobian: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """Return lines of sight as measured, and their derivatives in the rows against the stars.

        An aberration goes with the Earth's velocity at the time tag, which a clock does not change.
        """
        if self._stars is None:
            return sight_axes, None
        rows, stars = self._stars
        seen = sight_axes.copy()
        seen[rows], by_sight = astrometric_sight(
            sight_axes[rows],
            stars.earth_velocity,
            stars.sun_to_earth,
            stars.bending,
            jacobian=jacobian,
        )
        return seen, by_sight

    def _residual(
        self, sight_axes: NDArray[np.float64], errors: NDArray[np.float64], jacobian: bool
    ) -> BearingResidual:
        azimuth = self.bearings.azimuth_rad - errors[:, AZIMUTH]
        elevation = self.bearings.elevation_rad - errors[:, ELEVATION]
        if self._uniform:
            return tangent_residual(
                sight_axes,
                azimuth,
                elevation,
                noise_elevation_rad=self._noise_elevation,
                jacobian=jacobian,
            )
        level = np.where(self.azimuth_only, 0.0, elevation)
        result = tangent_residual(
            sight_axes,
            azimuth,
            level,
            noise_elevation_rad=self._noise_elevation,
            jacobian=jacobian,
        )
        other = ~self._tangent
        plain = coordinate_residual(
            sight_axes[other], azimuth[other], elevation[other], jacobian=jacobian
        )
        result.value[other] = plain.value
        if jacobian:
            assert result.by_line_of_sight is not None
            assert result.by_error is not None
            result.by_line_of_sight[other] = plain.by_line_of_sight
            result.by_error[other] = plain.by_error
        return result

    def evaluate(
        self, path: Path, state: PathState, values: Values, *, jacobian: bool
    ) -> Evaluation:
        """Evaluate all bearings at one point; see :class:`Evaluation`."""
        if (
            compiled is not None
            and isinstance(state, KinematicPathState)
            and path.knots_s.size > 1
            and not (self._turned or self._stars is not None or self._walks_elsewhere)
        ):
            return self._compiled(path, state, values, jacobian=jacobian)
        found, place, poses, errors = self._find(path, state, values)
        line = found.line_of_sight_m
        if self.terms.chains.row.size:
            # Read where the derivative is taken, in the interval of the emission.
            errors = self._errors(path, values, place.interval)
        turned = self._in_true_axes(poses, line, errors, jacobian=jacobian)
        seen, by_sky = self._on_the_sky(turned.line_of_sight_m, jacobian=jacobian)
        result = self._residual(seen, errors, jacobian)
        if by_sky is not None and self._stars is not None:
            assert result.by_line_of_sight is not None
            rows = self._stars[0]
            result.by_line_of_sight[rows] = result.by_line_of_sight[rows] @ by_sky
        white = self._white
        residual = result.value * white
        constant, walks = self.terms.constants, self.terms.chains
        share = self._share(path, place.interval)
        by_knots: NDArray[np.float64] | None = None
        by_channel = np.zeros((0, 2, CHANNELS))
        if jacobian:
            by_channel, by_knots = self._derivatives(
                result, found, place, poses, state, errors=errors, turned=turned
            )
        return Evaluation(
            residual,
            place.interval,
            by_knots,
            constant.row,
            constant.column,
            by_channel[constant.row, :, constant.channel] * constant.basis[:, None]
            if jacobian
            else np.zeros((0, 2)),
            walks.row,
            walks.column,
            share.before,
            share.after,
            by_channel[walks.row, :, walks.channel] * walks.basis[:, None]
            if jacobian
            else np.zeros((0, 2)),
        )

    def _compiled(
        self, path: Path, state: KinematicPathState, values: Values, *, jacobian: bool
    ) -> Evaluation:
        """Do what :meth:`evaluate` does, in compiled code.

        That of paths whose weights depend on the time alone, and of random walks of directions.
        """
        count, order = len(self), path.order
        entries, constants = self.terms.constants, values.constants
        received, size = self.bearings.time_s, entries.row.size
        if self._clocked:
            received = received - self.terms.constant_errors(constants, CLOCK)
        faster = 0.0
        if self._fast and count:
            # Of the recording's propagation, and the same for all of its measurements.
            faster = float(self.terms.constant_errors(constants, SPEED)[0])
        (poses, pose), walks = self._indexed(received), self.terms.chains
        before, after = np.empty(walks.row.size), np.empty(walks.row.size)
        by_walks = np.empty((walks.row.size if jacobian else 0, 2))
        residual, interval = np.empty((count, 2)), np.empty(count, dtype=np.int64)
        light_time, emitted = np.array(self._light_time, dtype=np.float64), np.empty(count)
        by_constants = np.empty((size if jacobian else 0, 2))
        by = None
        if jacobian:
            by = ByPosition(np.empty((count, 2 * order)), np.empty((count, 2, 3)))
        compiled.bearings(
            *(count, path.knots_s.size, order, size, constants.size),
            *(walks.row.size, values.walks.shape[1], len(poses.position_m), LIGHT_TIME_ROUNDS),
            *(int(self._clocked), int(self._fast), int(self._noise_elevation is not None)),
            *(self.speed_m_s, self.spin_rad_s),
            self._speed(faster)[1],
            *map(flat, (path.knots_s, state.basis, hermite_coefficients(order), received)),
            pose,
            *map(flat, (poses.position_m, poses.axes, poses.velocity_m_s, poses.axes_rate)),
            *map(flat, (self.bearings.azimuth_rad, self.bearings.elevation_rad)),
            flat(self._measured_turns),
            None if self._uniform else flat(self._tangent),
            *(self._white, light_time, residual, interval, emitted),
            *((by.weights, by.by_position) if by is not None else (None, None)),
            *map(indices, (entries.row, entries.channel, entries.column)),
            *(flat(entries.basis), flat(constants), by_constants),
            *map(indices, (walks.row, walks.channel, walks.column)),
            *map(flat, (walks.basis, self._walk_time, values.walks)),
            *(before, after, by_walks),
        )
        self._light_time, self._emitted = light_time, emitted
        return Evaluation(
            residual,
            interval,
            by,
            entries.row,
            entries.column,
            by_constants,
            walks.row,
            walks.column,
            before,
            after,
            by_walks,
        )

    @cached_property
    def _measured_turns(self) -> NDArray[np.float64]:
        """Shape (n, 4): cosine and sine of the measured azimuth, and of the elevation."""
        azimuth, elevation = self.bearings.azimuth_rad, self._elevation
        turned = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
        return np.stack(turned, axis=1)

    def _derivatives(
        self,
        result: BearingResidual,
        found: Sight,
        place: Place,
        poses: SensorPoses,
        state: PathState,
        *,
        errors: NDArray[np.float64],
        turned: Turned,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return whitened derivatives by the channels (n, 2, CHANNELS) and by the knots' states.

        With the line of sight l = P - S, the aberration matrix E and the frame's turn R during the
        light time: dl = E (R dp + (R v - dS/dt) dt - dS), where dt = -(clock error); turning axes
        add their own derivative (docs/models.md).
        """
        assert result.by_line_of_sight is not None
        assert result.by_error is not None
        white = self._white[:, :, None]
        in_axes = result.by_line_of_sight * white
        by_channel = np.zeros((len(self), 2, CHANNELS))
        if turned.by_misalignment is not None:
            by_channel[:, :, MISALIGNMENT : MISALIGNMENT + 3] = in_axes @ turned.by_misalignment
            in_axes = in_axes @ turned.by_line_of_sight
        by_sight = in_axes @ poses.axes
        if np.isfinite(self.speed_m_s):
            speed = self.speed_m_s + errors[:, SPEED]
            if self._fast:
                # A faster signal was emitted later: by dtau = -distance / (c + u.V) dc / c.
                rate = speed + np.einsum(
                    "ni,ni->n",
                    found.line_of_sight_m / found.distance_m[:, None],
                    found.inertial_velocity_m_s,
                )
                later = (found.distance_m / (rate * speed))[:, None] * found.inertial_velocity_m_s
                by_channel[:, :, SPEED] = np.matmul(by_sight, later[:, :, None])[:, :, 0]
            by_sight = by_sight @ found.aberration(float(speed[0]) if len(self) else np.inf)
        by_channel[:, :, AZIMUTH : ELEVATION + 1] = result.by_error * white
        by_channel[:, :, POSITION : POSITION + 3] = -by_sight
        if self._clocked:
            closing = found.velocity_m_s - poses.velocity_m_s - errors[:, VELOCITY : VELOCITY + 3]
            by_time = np.matmul(by_sight, closing[:, :, None])[:, :, 0]
            if poses.axes_rate is not None:
                moved = np.matmul(poses.axes_rate, found.line_of_sight_m[:, :, None])
                by_time += np.matmul(in_axes, moved)[:, :, 0]
            by_channel[:, :, CLOCK] = -by_time
        by_position = by_sight
        if self.spin_rad_s != 0.0:
            # The transpose of the turn to the axes at reception, applied to rows.
            angle = self.spin_rad_s * found.light_time_s
            sine, cosine = np.sin(angle)[:, None], np.cos(angle)[:, None]
            by_position = by_sight.copy()
            by_position[:, :, 0] = cosine * by_sight[:, :, 0] - sine * by_sight[:, :, 1]
            by_position[:, :, 1] = sine * by_sight[:, :, 0] + cosine * by_sight[:, :, 1]
        return by_channel, state.chain(place, by_position, None)

    def expect_delays(self, delay_s: NDArray[np.float64]) -> None:
        """Start the next evaluation from delays of the signals, shape (n,), seconds."""
        self._light_time = delay_s

    @property
    def emitted_s(self) -> NDArray[np.float64]:
        """Shape (n,): times of emission as the last evaluation found them."""
        return self._emitted

    def squares(self, found: Evaluation) -> NDArray[np.float64]:
        """Return squared whitened residuals, shape (n,), the weights for correlation taken out.

        Such weights make errors common, not small.
        """
        return np.asarray(np.sum(found.residual**2, axis=1) / self.weight)

    def predicted(
        self, path: Path, values: Values
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return what the sensors should have measured, shape (n, 2), rad, distances and times.

        The prediction includes the sensors' estimated errors; azimuths lie within half a turn of
        the measured ones. Distances (n,) are in metres, times (n,) those of emission in seconds.
        """
        state = path.at_state(values.path, jacobian=False)
        found, place, poses, errors = self._find(path, state, values)
        turned = self._in_true_axes(poses, found.line_of_sight_m, errors)
        seen, _ = self._on_the_sky(turned.line_of_sight_m, jacobian=False)
        bearing, _ = predict_bearing(seen)
        bearing += errors[:, [AZIMUTH, ELEVATION]]
        turns = np.round((self.bearings.azimuth_rad - bearing[:, 0]) / (2.0 * np.pi))
        bearing[:, 0] += 2.0 * np.pi * turns
        return bearing, found.distance_m, place.time_s

    def emissions(
        self, path: Path, values: Values
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return distances from the sensors (m) and times of emission (s), each shape (n,)."""
        _, distance, time = self.predicted(path, values)
        return distance, time

    def resolution_m(
        self, distance_m: NDArray[np.float64], speed_m_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return about how well each bearing alone locates the object, shape (n,), metres."""
        del speed_m_s
        table = self.bearings
        return np.asarray(np.fmin(table.sigma_azimuth_rad, table.sigma_elevation_rad) * distance_m)

    def clock_resolution_s(
        self, distance_m: NDArray[np.float64], speed_m_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return how well each bearing resolves its sensor's clock, shape (n,), seconds."""
        with np.errstate(divide="ignore"):
            return np.asarray(self.resolution_m(distance_m, speed_m_s) / speed_m_s)

    def report(self, path: Path, values: Values, found: Evaluation) -> Report:
        """Return what was measured and predicted; see :class:`Report`."""
        table = self.bearings
        predicted, _, _ = self.predicted(path, values)
        exists = np.ones((len(self), 2), dtype=bool)
        exists[self.azimuth_only, 1] = False
        level = np.cos(self._elevation)
        level = np.where(table.isotropic & ~self.azimuth_only, np.maximum(level, 1e-6), 1.0)
        return Report(
            kinds=("azimuth", "elevation"),
            units=("rad", "rad"),
            exists=exists,
            measured=np.stack([table.azimuth_rad, table.elevation_rad], axis=1),
            predicted=predicted,
            sigma=np.stack([table.sigma_azimuth_rad / level, table.sigma_elevation_rad], axis=1),
            # The solver's residual is predicted - measured, whitened with the correlation's weight.
            normalised=-found.residual / np.sqrt(self.weight)[:, None],
        )
