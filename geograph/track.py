"""The result: the path with its uncertainty, every sensor's errors, residuals, a summary."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from geograph.ellipsoids import Ellipsoids, circular_error_probable_m, ellipsoids
from geograph.errors import InputError
from geograph.factors.kinematics import conditional_covariance, interpolation_matrices
from geograph.geodesy import enu_axes, geodetic_from_ecef
from geograph.motion import kron_stack
from geograph.path import BallisticPath
from geograph.states import CHANNEL_NAMES
from geograph.stretches import WalkCuts

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from geograph.eliminate import Marginals
    from geograph.families import Values
    from geograph.likelihood import LikelihoodMap
    from geograph.problem import Problem
    from geograph.recording import Frame, Recording, SmoothSettings
    from geograph.solver import Status


@dataclass(frozen=True)
class SensorEstimate:
    """One estimated error of one sensor.

    Attributes
    ----------
    unit
        ``rad``, ``rad/s``, ``s``, ``s/s``, ``m``, ``Hz``, ``Hz/s`` or ``m/s``.
    estimate, sigma, prior_sigma
        In that unit; measured = predicted + error. ``prior_sigma`` of a walk is what its diffusion
        adds over the pass.
    """

    unit: str
    estimate: float
    sigma: float
    prior_sigma: float


@dataclass(frozen=True, eq=False)
class Residuals:
    """Measured less predicted, a row for every measured coordinate; columns of equal length.

    Attributes
    ----------
    time_s
        Time tag.
    sensor
        Index of the sensor.
    reference
        Index of the sensor that a difference refers to; -1 for what is none.
    kind, unit
        ``azimuth`` or ``elevation`` in ``rad``, ``toa`` or ``tdoa`` in ``s``, ``fdoa`` in ``Hz``.
    measured, predicted, residual, sigma
        In that unit; the prediction includes the sensors' estimated errors, and the estimated time
        of an emission.
    normalised
        The residual over its sigma (for on-sky sigmas: its part of the angle on the sky).
    weight
        Weight that the loss gave to the measurement, 0 to 1.
    rejected
        Whether it was left out as an outlier.
    line
        Line in the file, or 0.
    """

    time_s: NDArray[np.float64]
    sensor: NDArray[np.int64]
    reference: NDArray[np.int64]
    kind: NDArray[np.str_]
    unit: NDArray[np.str_]
    measured: NDArray[np.float64]
    predicted: NDArray[np.float64]
    residual: NDArray[np.float64]
    sigma: NDArray[np.float64]
    normalised: NDArray[np.float64]
    weight: NDArray[np.float64]
    rejected: NDArray[np.bool_]
    line: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class TrackPoints:
    """Estimated states at some times.

    Attributes
    ----------
    time_s
        Shape (n,), seconds after the epoch.
    state
        Shape (n, 3 m): position, velocity, acceleration as far as the motion has them; SI units, in
        the frame.
    covariance
        Shape (n, 3 m, 3 m).
    frame
        ``"ecef"`` or ``"local"``.
    """

    time_s: NDArray[np.float64]
    state: NDArray[np.float64]
    covariance: NDArray[np.float64]
    frame: Frame

    @property
    def order(self) -> int:
        """Number of blocks of the state: 1 position, 2 + velocity, 3 + acceleration."""
        return int(self.state.shape[1]) // 3

    @property
    def position_m(self) -> NDArray[np.float64]:
        """Positions, shape (n, 3), metres."""
        return self.state[:, :3]

    @property
    def velocity_m_s(self) -> NDArray[np.float64] | None:
        """Velocities in the frame, shape (n, 3), or None for a motion without them."""
        return self.state[:, 3:6] if self.order > 1 else None

    @property
    def acceleration_m_s2(self) -> NDArray[np.float64] | None:
        """Accelerations in the frame, shape (n, 3), or None for a motion without them."""
        return self.state[:, 6:9] if self.order > 2 else None

    @property
    def position_covariance_m2(self) -> NDArray[np.float64]:
        """Covariances of the positions, shape (n, 3, 3), square metres."""
        return self.covariance[:, :3, :3]

    def geodetic(self) -> NDArray[np.float64] | None:
        """Return latitude, longitude (deg) and height (m), shape (n, 3); None in a local frame."""
        return geodetic_from_ecef(self.position_m) if self.frame == "ecef" else None

    def enu_covariance_m2(self) -> NDArray[np.float64] | None:
        """Return covariances of east, north, up, shape (n, 3, 3); None in a local frame.

        The square roots of its diagonal are the standard deviations of longitude (as a length),
        latitude (as a length) and height.
        """
        if self.frame != "ecef":
            return None
        axes = enu_axes(self.position_m)
        return np.asarray(axes @ self.position_covariance_m2 @ np.swapaxes(axes, 1, 2))

    def _level_covariance(self) -> NDArray[np.float64]:
        turned = self.enu_covariance_m2()
        return self.position_covariance_m2 if turned is None else turned

    def ellipsoids(self, probability: float = 0.95) -> Ellipsoids:
        """Return confidence ellipsoids of the positions, in the frame's axes.

        Parameters
        ----------
        probability
            Chance that the truth lies inside (chi-square with 3 degrees of freedom).

        Raises
        ------
        InputError
            If the probability is not between 0 and 1.
        """
        return ellipsoids(self.position_m, self.position_covariance_m2, probability)

    def horizontal_ellipses(self, probability: float = 0.95) -> Ellipsoids:
        """Return confidence ellipses over ground: east and north, or x and y in a local frame.

        Parameters
        ----------
        probability
            Chance that the truth lies inside (chi-square with 2 degrees of freedom).

        Raises
        ------
        InputError
            If the probability is not between 0 and 1.
        """
        level = self._level_covariance()[:, :2, :2]
        return ellipsoids(np.zeros((level.shape[0], 2)), level, probability)

    def cep_m(self) -> NDArray[np.float64]:
        """Return circular errors probable over ground, shape (n,), metres."""
        return circular_error_probable_m(self._level_covariance()[:, :2, :2])


@dataclass(frozen=True, eq=False)
class Track(TrackPoints):
    """A smoothed path: states at the knots, and everything that was learnt with them.

    Attributes
    ----------
    recording
        What was smoothed.
    settings
        Settings with every automatic value filled in.
    status
        How the solve ended.
    summary
        What the results folder's ``summary.json`` holds.
    sensor_errors
        By sensor and state: ``track.sensor_errors["S3"]["clock_offset"]``.
    residuals
        Of every measured coordinate.
    problem, values, marginals
        The solved problem, its estimate and (scaled) covariances, for those who want to go on.
    """

    recording: Recording
    settings: SmoothSettings
    status: Status
    summary: dict[str, Any]
    sensor_errors: dict[str, dict[str, SensorEstimate]]
    residuals: Residuals
    problem: Problem
    values: Values
    marginals: Marginals

    def at(self, time_s: ArrayLike) -> TrackPoints:
        """Return states and covariances at any times.

        Between knots it is the posterior of the Gaussian process: the interpolated covariance of
        both neighbours plus the prior's conditional covariance. Outside the knots the nearer one is
        predicted, with process noise.

        Parameters
        ----------
        time_s
            One time or shape (n,), seconds after the epoch.

        Raises
        ------
        InputError
            If a time is not finite.
        """
        time = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
        if not np.isfinite(time).all():
            raise InputError("track.at was given a time that is not finite; expected seconds")
        motion, path = self.problem.motion, self.problem.path
        state = motion.read(path, self.values.path, time)[:, : self.state.shape[1]]
        if self.time_s.size == 1:
            shape = (time.size, *self.covariance.shape[1:])
            return TrackPoints(
                time, state, np.broadcast_to(self.covariance[0], shape).copy(), self.frame
            )
        covariance: NDArray[np.float64] = self._between(
            np.clip(time, self.time_s[0], self.time_s[-1])
        )
        for outside, end in ((time < self.time_s[0], 0), (time > self.time_s[-1], -1)):
            if outside.any():
                covariance[outside] = self._beyond(time[outside] - self.time_s[end], end)
        return TrackPoints(time, state, covariance, self.frame)

    def _between(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        motion, path, values = self.problem.motion, self.problem.path, self.values
        place = path.locate(time_s)
        if isinstance(path, BallisticPath):
            held = path.at_state(values.path, jacobian=True)
            eye = np.broadcast_to(np.eye(3), (time_s.size, 3, 3))
            rows = [held.chain(place, eye, None), held.chain(place, np.zeros_like(eye), eye)]
            matrix = np.concatenate(rows, axis=1).reshape(time_s.size, 6, 2 * path.size)
        else:
            weights = interpolation_matrices(motion.order, place.step_s, place.offset_s)
            matrix = np.asarray(np.kron(weights, np.eye(3)), dtype=np.float64)
        pair = self._pairs()[place.interval]
        covariance = matrix @ pair @ np.swapaxes(matrix, 1, 2)
        if not motion.static:
            before = values.path[place.interval]
            velocity = before[:, 3:6] if motion.order > 1 else None
            root = motion.density.square_root(velocity, time_s.size)
            unit = conditional_covariance(motion.order, place.step_s, place.offset_s)
            times = self.problem.noise_times
            if times is not None:
                root = root * times[place.interval][:, None, None]
            covariance += kron_stack(unit, root @ np.swapaxes(root, 1, 2))
        return np.asarray(covariance)

    def _pairs(self) -> NDArray[np.float64]:
        """Return joint covariances of whole neighbouring knots, shape (K - 1, 2s, 2s), SI units."""
        scale = self.problem.path_scale
        size = scale.size
        cross = self.marginals.neighbours[:, :size, :size] * scale[:, None] * scale
        knots = self._knots()
        top = np.concatenate([knots[:-1], cross], axis=2)
        bottom = np.concatenate([np.swapaxes(cross, 1, 2), knots[1:]], axis=2)
        return np.concatenate([top, bottom], axis=1)

    def _knots(self) -> NDArray[np.float64]:
        """Return the knots' covariances with what is unknown of the forces, shape (K, s, s), SI."""
        scale = self.problem.path_scale
        size = scale.size
        if size == self.state.shape[1]:
            return self.covariance
        return np.asarray(self.marginals.knots[:, :size, :size] * scale[:, None] * scale)

    def _beyond(self, step_s: NDArray[np.float64], end: int) -> NDArray[np.float64]:
        motion = self.problem.motion
        size = self.state.shape[1]
        start = np.broadcast_to(self.values.path[end], (step_s.size, motion.size))
        _, matrix = motion.predict(start, step_s, np.full(step_s.size, self.time_s[end]))
        noise = motion.noise(start, np.abs(step_s))
        times = self.problem.noise_times
        if times is not None:
            noise *= times[end] ** 2
        inner = self._knots()[end]
        # Back in time the noise lies between, and is carried back with the state.
        before, after = (noise, 0.0) if end == 0 else (0.0, noise)
        found = matrix @ (inner + before) @ np.swapaxes(matrix, 1, 2) + after
        return np.asarray(found[:, :size, :size])

    def likelihood_map(self, *, cells: int = 81) -> LikelihoodMap:
        """Return the posterior of an emitter that stands still as a map over ground.

        For where the ellipse is not the truth (``summary["gaussian"]`` says so): its contours hold
        the stated probability whatever their shape.

        Parameters
        ----------
        cells
            Cells along a side.

        Raises
        ------
        InputError
            If the object moves, or the grid is not one.
        """
        from geograph.likelihood import likelihood_map

        return likelihood_map(self, cells=cells)

    def sensor_error_at(
        self,
        sensor: str,
        kind: Literal["azimuth", "elevation", "clock", "frequency"],
        time_s: ArrayLike,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return one error of a sensor over time: bias, drift and random walk together.

        Parameters
        ----------
        sensor
            Name of the sensor.
        kind
            ``"azimuth"``, ``"elevation"`` (rad), ``"clock"`` (s) or ``"frequency"`` (Hz).
        time_s
            Shape (n,), seconds after the epoch.

        Returns
        -------
        estimate, sigma
            Each shape (n,).

        Raises
        ------
        InputError
            If there is no such sensor or error.
        """
        names = self.recording.sensor_names
        if sensor not in names:
            raise InputError(f"no sensor {sensor!r}; expected one of " + ", ".join(names))
        if kind not in ("azimuth", "elevation", "clock", "frequency"):
            raise InputError(f"no error {kind!r}; expected azimuth, elevation, clock or frequency")
        time = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
        states, index, channel = (
            self.problem.states, names.index(sensor), CHANNEL_NAMES.index(kind)
        )  # fmt: skip
        by_constants = np.zeros((time.size, states.size))
        row = states.stretches.row(np.full(time.size, index), time)
        for columns, basis in (
            (states.bias_column, np.ones_like(time)),
            (states.drift_column, time - states.since_s[row, channel]),
        ):
            column = columns[row, channel]
            own = np.flatnonzero(column >= 0)
            by_constants[own, column[own]] = basis[own] * states.sigma[column[own]]
        estimate = by_constants @ self.values.constants
        variance = np.einsum("ni,ij,nj->n", by_constants, self.marginals.constants, by_constants)
        walk = int(states.walk_column[index, channel])
        if walk >= 0 and self.time_s.size > 1:
            scale = float(self.problem.walk_scale[walk])
            added, spread = self._walk(time, walk, by_constants, scale)
            estimate, variance = estimate + added, variance + spread
        return estimate, np.sqrt(np.maximum(variance, 0.0))

    def _walk(
        self,
        time_s: NDArray[np.float64],
        walk: int,
        by_constants: NDArray[np.float64],
        scale: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return a walk's value and what it adds to the variance, each shape (n,)."""
        inside = np.clip(time_s, self.time_s[0], self.time_s[-1])
        place = self.problem.path.locate(inside)
        k = place.interval
        after = place.offset_s / place.step_s
        before = 1.0 - after
        # What the walk may do between the knots, and beyond them.
        free = place.step_s * before * after + np.abs(time_s - inside)
        if self.problem.states.walk_resets_s[walk].size:
            cuts = WalkCuts.of(
                self.problem.states.walk_resets_s, np.full(time_s.size, walk), time_s
            )
            before, after = cuts.weighed(self.time_s, k, before, after)
        column = self.problem.layout.path + walk
        marginals = self.marginals
        value = before * self.values.walks[k, walk] + after * self.values.walks[k + 1, walk]
        own = (
            before**2 * marginals.knots[k, column, column]
            + after**2 * marginals.knots[k + 1, column, column]
            + 2.0 * before * after * marginals.neighbours[k, column, column]
        )
        cross = (
            before[:, None] * marginals.knot_constants[k, column]
            + after[:, None] * marginals.knot_constants[k + 1, column]
        )
        both = np.einsum("ni,ni->n", cross, by_constants)
        wander = self.problem.states.diffusion[walk] ** 2 * free
        return scale * value, scale**2 * own + 2.0 * scale * both + wander
