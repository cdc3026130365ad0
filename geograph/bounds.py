"""The Cramer-Rao bound: how well any estimator could do, before anything is measured.

The posterior bound of a problem at a point is the inverse of its information there, measurements
and priors together, with all nuisance states (H. L. Van Trees, *Detection, Estimation, and
Modulation Theory*, part I, 1968, section 2.4.3). Evaluated at the truth of many simulated passes
and averaged, it bounds the mean squared error of every estimator.

:func:`bound` gives it for a recording, whose measured values may be planned ones: only times,
sensors and sigmas enter where the path is known (its truth table). Without a truth the path is
estimated first, and the bound is that of the estimate.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from geograph.errors import SolveError
from geograph.losses import Loss
from geograph.observability import weak_directions
from geograph.planned import covers, distances, factorised, planned, stand_at, truth_path
from geograph.prepare import prepare
from geograph.report import _marginals as marginals_of
from geograph.report import _resolved as resolved_settings
from geograph.report import sensor_estimates
from geograph.signal import Signal, with_signal
from geograph.smoother import Smoother
from geograph.solver import Status
from geograph.threads import single_blas_thread
from geograph.track import Residuals, Track, TrackPoints

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.eliminate import Marginals
    from geograph.families import Values
    from geograph.observability import Direction
    from geograph.problem import Problem
    from geograph.recording import Recording, SmoothSettings

_NOISE_FROM = {
    "truth": "from the changes of the true path",
    "estimate": "of greatest likelihood",
}


@dataclass(frozen=True, eq=False)
class Bound:
    """Cramer-Rao bound of all unknowns.

    Attributes
    ----------
    time_s
        Shape (K,): times of the knots.
    covariance
        Shape (K, 3m, 3m): of the knots' states, SI units.
    constants
        Shape (s, s): of the constant sensor states, SI units, in the order of the problem's states.
    """

    time_s: NDArray[np.float64]
    covariance: NDArray[np.float64]
    constants: NDArray[np.float64]


def cramer_rao_bound(problem: Problem, values: Values) -> Bound:
    """Return the posterior Cramer-Rao bound of a problem at a point.

    Parameters
    ----------
    problem
        Measurements (their values do not matter to the bound of bearings near the point), sensors,
        motion, priors.
    values
        The point, for instance the simulated truth.

    Raises
    ------
    NotPositiveDefiniteError
        If the information is singular.
    """
    found = posterior(problem, values)
    size, sigma = 3 * problem.motion.order, problem.states.sigma
    scale = problem.path_scale[:size]
    return Bound(
        problem.knots_s,
        found.knots[:, :size, :size] * scale[:, None] * scale,
        found.constants * sigma[:, None] * sigma,
    )


def posterior(problem: Problem, values: Values) -> Marginals:
    """Return the scaled bounds of all unknowns; see :func:`cramer_rao_bound`.

    Parameters
    ----------
    problem, values
        The point. Where the time that all clocks have in common is held, its variance is added.

    Raises
    ------
    NotPositiveDefiniteError
        If the information is singular.
    """
    found = problem.linearise(values).factorise().marginals()
    return found if problem.shift is None else problem.shift.widened(found, problem, values)


@dataclass(frozen=True)
class SensorBound:
    """The bound of one error of one sensor.

    Attributes
    ----------
    unit
        ``rad``, ``rad/s``, ``s``, ``s/s``, ``m``, ...
    sigma
        Least posterior standard deviation, in that unit.
    prior_sigma
        Standard deviation of its prior.
    """

    unit: str
    sigma: float
    prior_sigma: float


@dataclass(frozen=True, eq=False)
class PathBound(TrackPoints):
    """The Cramer-Rao bound of a recording, at the knots of its path.

    ``state`` is the path at which it was evaluated, ``covariance`` the bound. Ellipsoids, circular
    errors and geodetic coordinates are those of :class:`geograph.TrackPoints`.

    Attributes
    ----------
    recording
        Whose geometry it is, with the sigmas used.
    settings
        Settings with every automatic value filled in.
    evaluated_at
        ``"truth"`` or ``"estimate"``.
    process_noise_from
        Where the process noise comes from, in words.
    sensor_bounds
        By sensor and state: ``bound.sensor_bounds["S3"]["clock_offset"]``.
    weakly_observed
        A sentence for each direction that the geometry hardly determines, or leaves open.
    directions
        Eigenvectors of the information of the position with their sigmas, at the best knot and the
        worst, each the weakest first.
    observable
        Whether the path as a whole is determined.
    left_out
        Measurements that the estimate rejected as outliers; none at the truth.
    """

    recording: Recording
    settings: SmoothSettings
    evaluated_at: Literal["truth", "estimate"]
    process_noise_from: str
    sensor_bounds: dict[str, dict[str, SensorBound]]
    weakly_observed: list[str]
    observable: bool
    left_out: int
    directions: list[Direction] = field(default_factory=list)

    @property
    def sigma_axes_m(self) -> NDArray[np.float64]:
        """Sigmas of east, north and up, or of x, y and z in a local frame, shape (K, 3), metres."""
        return np.sqrt(np.diagonal(self._level_covariance(), axis1=1, axis2=2))

    @property
    def sigma_horizontal_m(self) -> NDArray[np.float64]:
        """Root mean square of the horizontal distance, shape (K,), metres."""
        return np.asarray(np.hypot(*self.sigma_axes_m[:, :2].T))

    @property
    def sigma_height_m(self) -> NDArray[np.float64]:
        """Sigmas of the height above the ellipsoid, or of z, shape (K,), metres."""
        return self.sigma_axes_m[:, 2]

    @property
    def sigma_velocity_m_s(self) -> NDArray[np.float64] | None:
        """Root mean square of the error of the velocity, shape (K,), or None without one."""
        if self.order < 2:
            return None
        return np.asarray(np.sqrt(np.trace(self.covariance[:, 3:6, 3:6], axis1=1, axis2=2)))


def bound(
    recording: Recording,
    settings: SmoothSettings | None = None,
    *,
    signal: Signal | None = None,
    **changes: Any,
) -> PathBound:
    """Return the Cramer-Rao bound of a recording's geometry, along its path.

    Parameters
    ----------
    recording
        Sensors, times and sigmas of the measurements. Where it has a truth table over their span
        the bound is evaluated there and measured values do not matter; otherwise at the estimate.
    settings
        Motion and process noise; the recording's own by default. A process noise of ``"auto"`` is
        the truth's own, from the changes of its highest derivative, or that of the estimate.
    signal
        Gives the sigmas of arrivals and differences in place of the tables' own.
    **changes
        Single settings by name, over those above; see :class:`geograph.SmoothSettings`.

    Raises
    ------
    InputError
        If the recording has no measurement, or a setting is wrong.
    SolveError
        If there is no truth, and no estimate either.
    """
    chosen = (settings or recording.settings).replace(**changes)
    given = recording if signal is None else with_signal(recording, signal)
    with single_blas_thread():
        return _path_bound(*located(given, chosen))


def located(
    recording: Recording, settings: SmoothSettings
) -> tuple[Smoother, Literal["truth", "estimate"]]:
    """Return a smoother that stands where the bound is to be evaluated, and what is there.

    Parameters
    ----------
    recording, settings
        As in :func:`bound`.

    Raises
    ------
    InputError, SolveError
        As in :func:`bound`.
    """
    truth, static = recording.truth, settings.motion == "static"
    if truth is not None and covers(truth, recording, static=static):
        fit = truth_path(truth, recording, static=static)
        return planned(recording, settings, fit), "truth"
    smoother = Smoother(prepare(recording), settings)
    smoother.run()
    if smoother.solution.status is Status.DIVERGED:
        raise SolveError(
            f"{recording.name!r} has no truth table over its measurements, and its path cannot be "
            "estimated; give a truth.csv with the path to evaluate the bound at",
            status=str(Status.DIVERGED),
        )
    problem = smoother.problem.with_weights(smoother.problem.weights, Loss("none"))
    stand_at(smoother, problem, smoother.solution.values)
    return smoother, "estimate"


def _path_bound(smoother: Smoother, at: Literal["truth", "estimate"]) -> PathBound:
    factorised(smoother)
    problem, path = smoother.problem, smoother.solution.values.path
    track = _as_track(smoother)
    away = distances(
        track.recording, lambda time_s: problem.motion.read(problem.path, path, time_s)[:, :3]
    )
    weak = weak_directions(track, away, curvature=at == "estimate")
    automatic = smoother.settings.process_noise == "auto" and not problem.motion.static
    return PathBound(
        time_s=track.time_s,
        state=track.state,
        covariance=track.covariance,
        frame=track.frame,
        recording=track.recording,
        settings=track.settings,
        evaluated_at=at,
        process_noise_from=_NOISE_FROM[at] if automatic else "as given",
        sensor_bounds={
            name: {
                state: SensorBound(entry.unit, entry.sigma, entry.prior_sigma)
                for state, entry in states.items()
            }
            for name, states in track.sensor_errors.items()
        },
        weakly_observed=weak.sentences,
        observable=not weak.unobservable,
        left_out=int(np.sum(smoother.rejected)),
        directions=weak.directions,
    )


def _as_track(smoother: Smoother) -> Track:
    """Return the point where a smoother stands as a track without residuals."""
    problem, values = smoother.problem, smoother.solution.values
    recording = smoother.prepared.recording
    marginals = marginals_of(smoother)
    size = 3 * problem.motion.order
    scale = problem.path_scale[:size]
    return Track(
        time_s=problem.knots_s,
        state=values.path[:, :size],
        covariance=marginals.knots[:, :size, :size] * scale[:, None] * scale,
        frame=recording.frame,
        recording=recording,
        settings=resolved_settings(smoother),
        status=smoother.solution.status,
        summary={},
        sensor_errors=sensor_estimates(smoother, marginals),
        residuals=_measured_by(recording),
        problem=problem,
        values=values,
        marginals=marginals,
    )


def _measured_by(recording: Recording) -> Residuals:
    """Return residuals that tell which sensors measured, which the weak directions ask, alone."""
    used = np.concatenate([table.sensor for table in recording.tables.values()])
    columns: dict[str, Any] = {entry.name: np.empty(0) for entry in fields(Residuals)}
    return Residuals(**columns | {"sensor": used})
