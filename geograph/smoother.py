"""The batch smoother: from a recording to a track.

First guesses, knots, process noise, Levenberg-Marquardt, outliers, and once more where an estimate
moves what a solve holds fixed; then covariances, status and summary.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import minimize_scalar

from geograph.errors import SolveError
from geograph.factors.kinematics import conditional_covariance
from geograph.families import BearingFamily, Values
from geograph.initialise import FirstGuess, PathFit
from geograph.knots import (
    NEGLIGIBLE,
    Resolution,
    automatic_spacing,
    check_memory,
    ignored_share,
    place_knots,
)
from geograph.losses import Loss
from geograph.motion import Density, Motion
from geograph.prepare import Prepared, prepare
from geograph.problem import PathPrior, Problem
from geograph.process_noise import guess_noise, least_noise
from geograph.report import make_track
from geograph.robust import anneal, thresholds
from geograph.solver import Solution, Status, solve
from geograph.states import CLOCK, ELEVATION
from geograph.threads import single_blas_thread

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.recording import Recording, SmoothSettings
    from geograph.track import Track

# The first knot's prior is this many distances wide: data that determine the path do not feel it.
_PRIOR_WIDTH = 100.0
_ROUNDS = 6
_TRIAL_ITERATIONS = 40


@dataclass(eq=False)
class Smoother:
    """One recording's way from first guess to solution; see :func:`smooth`.

    Attributes
    ----------
    prepared
        The recording made ready.
    settings
        As asked for.
    problem, solution
        The latest.
    iterations
        Levenberg-Marquardt iterations so far.
    rejected
        Shape (n,): bearings found to be outliers.
    ignored
        Share of the information that lies between the knots.
    undecided
        Whether outliers show, but not which bearings they are.
    guesses
        First guesses in the order in which they were tried, with the cost that each led to.
    """

    prepared: Prepared
    settings: SmoothSettings
    problem: Problem = field(init=False)
    solution: Solution = field(init=False)
    iterations: int = 0
    rejected: NDArray[np.bool_] = field(init=False)
    guesses: list[tuple[PathFit, float]] = field(default_factory=list)
    ignored: float = 0.0
    undecided: bool = False

    def __post_init__(self) -> None:
        self.rejected = np.zeros(len(self.prepared.bearings), dtype=bool)

    @property
    def robust(self) -> bool:
        """Whether outliers are to be found and rejected."""
        return self.settings.loss in ("auto", "gnc")

    def run(self) -> None:
        """Solve from every first guess, keep the best, and refine it."""
        settings = self.settings
        automatic = settings.process_noise == "auto" and settings.motion != "static"
        loss = Loss("none" if self.robust else settings.loss)
        trial = Loss("cauchy") if self.robust else loss
        fits = self.first_guess().fits()
        best: tuple[Problem, Solution] | None = None
        several = len(fits) > 1
        for fit in fits:
            problem, values = self.start(fit, trial if several or automatic else loss)
            if self.robust and problem.loss == loss and self._suspect(problem, values):
                problem = problem.with_weights(problem.weights, trial)
            limit = _TRIAL_ITERATIONS if several else settings.max_iterations
            solution = self._solve(problem, values, min(limit, settings.max_iterations))
            self.guesses.append((fit, solution.cost))
            if best is None or _better(solution, best[1]):
                best = problem, solution
        assert best is not None
        self.problem, self.solution = best
        if self.solution.status is Status.ITERATION_LIMIT and several:
            self._change(self.problem)
        self.guesses.sort(key=lambda guess: guess[1])
        if automatic:
            self._tune_noise(4.0)
        if self.robust:
            self._reject(trial)
        if automatic:
            self._tune_noise(1.0)
        self._settle()

    def first_guess(self) -> FirstGuess:
        """Return the finder of first guesses."""
        recording = self.prepared.recording
        return FirstGuess(
            self.prepared.bearings,
            recording.constraints,
            self.prepared.sensors,
            self.prepared.geometry,
            recording.propagation_speed_m_s,
            self.settings.motion == "static",
        )

    def _suspect(self, problem: Problem, values: Values) -> bool:
        """Tell whether a first guess shows residuals far outside those of their sensor."""
        square = self._squares(problem, values)
        rows = self._family(problem).row_counts
        return bool((square > thresholds(square, rows, self._sensor)).any())

    @property
    def _sensor(self) -> NDArray[np.int64]:
        return self.prepared.bearings.sensor

    def resolution(self, fit: PathFit) -> Resolution:
        """Return what the measurements resolve at the distances of a fit."""
        bearings = self.prepared.bearings
        clock = fit.clock_s[bearings.sensor]
        poses = self.prepared.geometry.poses(bearings.sensor, bearings.time_s - clock)
        position = fit.state(bearings.time_s - clock, 1)
        distance = np.linalg.norm(position - poses.position_m, axis=1)
        sigma = np.fmin(bearings.sigma_azimuth_rad, bearings.sigma_elevation_rad)
        return Resolution(
            len(bearings),
            self.prepared.span_s,
            float(np.median(sigma * distance)),
            float(np.median(sigma)),
        )

    def start(self, fit: PathFit, loss: Loss) -> tuple[Problem, Values]:
        """Return the problem and the values that a first guess leads to."""
        prepared, settings = self.prepared, self.settings
        order = Motion(settings.motion, Density.of(1.0), prepared.recording.frame).order
        resolution = self.resolution(fit)
        noise = settings.process_noise
        if noise == "auto":
            noise = guess_noise(fit, order, resolution)
        density = Density.of(noise, settings.process_noise_along)
        motion = Motion(settings.motion, density, prepared.recording.frame)
        knots = self._knots(motion, self._emission_times(fit), resolution)
        state = fit.state(knots, order)
        span = prepared.span_s
        rank = np.repeat(np.arange(order, dtype=np.float64), 3)
        powers = span**-rank
        prior = PathPrior(state[0], _PRIOR_WIDTH * max(fit.range_m, resolution.sigma_m) * powers)
        # What the sensors may be off by is the unit of length, a tenth of the pass that of time.
        states = prepared.states
        biases = [s.sigma for s in states.constants if s.channel <= ELEVATION and not s.drift]
        blur = np.hypot(1.0, (np.median(biases) if biases else 0.0) / resolution.sigma_rad)
        scale = np.asarray(resolution.sigma_m * blur * (10.0 / span) ** rank, dtype=np.float64)
        constants = np.zeros(states.size)
        for column, entry in enumerate(states.constants):
            if entry.channel == CLOCK and not entry.drift:
                constants[column] = fit.clock_s[entry.sensor] / entry.sigma
        problem = Problem(
            motion=motion,
            knots_s=knots,
            families=prepared.families(knots),
            states=states,
            walk_scale=prepared.walk_scale,
            prior=prior,
            path_scale=scale,
            loss=loss,
            elimination=settings.elimination,
            shift=None if motion.static else prepared.shift,
        )
        self._resolution = resolution
        values = Values(state, np.zeros((knots.size, states.diffusion.size)), constants)
        problem.refresh(values)
        return problem, values

    def _emission_times(self, fit: PathFit) -> NDArray[np.float64]:
        bearings = self.prepared.bearings
        delay = fit.range_m / self.prepared.recording.propagation_speed_m_s
        return np.asarray(bearings.time_s - fit.clock_s[bearings.sensor] - delay)

    def _knots(
        self, motion: Motion, times_s: NDArray[np.float64], resolution: Resolution
    ) -> NDArray[np.float64]:
        states = self.prepared.states
        if motion.static and not states.diffusion.size:
            return np.array([0.5 * (times_s.min() + times_s.max())])
        spacing = self.settings.spacing_s
        automatic = spacing is None
        if spacing is None:
            spacing = automatic_spacing(motion, states, resolution)
        elif motion.ballistic:
            spacing = min(spacing, motion.longest_step_s)
        unknowns = 2 * (3 * motion.order + states.diffusion.size) + states.size + 1
        count = float(np.ptp(times_s)) / spacing
        if automatic:
            count = min(count, times_s.size)
        check_memory(count, unknowns, spacing)
        return place_knots(times_s, spacing, automatic=automatic)

    def _solve(self, problem: Problem, values: Values, limit: int | None = None) -> Solution:
        """Solve, counting the iterations."""
        solution = solve(problem, values, max_iterations=limit or self.settings.max_iterations)
        self.iterations += solution.iterations
        return solution

    def _change(self, problem: Problem) -> None:
        """Solve a changed problem from the current estimate."""
        self.problem = problem
        self.solution = self._solve(problem, self.solution.values)

    @property
    def bearings(self) -> BearingFamily:
        """The family of the bearings."""
        return self._family(self.problem)

    @staticmethod
    def _family(problem: Problem) -> BearingFamily:
        family = problem.families[0]
        assert isinstance(family, BearingFamily)
        return family

    def distances(self) -> NDArray[np.float64]:
        """Return the distances of the object at every bearing, shape (n,), metres."""
        _, distance, _ = self.bearings.predicted(self.problem.path, self.solution.values)
        return distance

    def _squares(self, problem: Problem, values: Values) -> NDArray[np.float64]:
        """Return squared whitened residuals of the bearings, shape (n,)."""
        return self._family(problem).squares(problem.evaluate(values, jacobian=False)[0])

    def _reject(self, trial: Loss) -> None:
        """Find the outliers, if there are any, and solve without them."""
        rows, sensor = self.bearings.row_counts, self._sensor
        others = self.problem.weights[1:]
        plain = self.problem.with_weights([None, *others], Loss("none"))
        square = self._squares(self.problem, self.solution.values)
        if self.problem.loss != trial:
            if (square <= thresholds(np.zeros_like(square), rows, sensor)).all():
                return
            # From the robust estimate, where outliers stand out and good sensors do not suffer.
            self._change(self.problem.with_weights(self.problem.weights, trial))
            square = self._squares(self.problem, self.solution.values)

        def solved(weight: NDArray[np.float64]) -> NDArray[np.float64]:
            self._change(plain.with_weights([weight, *others]))
            return self._squares(self.problem, self.solution.values)

        start = self.solution
        kept = anneal(solved, square, rows, sensor)
        if rows[kept].sum() < max(0.5 * rows.sum(), 3 * self.problem.motion.order + 1):
            # What would be left is a minority, or says nothing beyond its own fit: which of the
            # bearings are wrong cannot be told from them.
            self.undecided = True
            self.problem, self.solution = plain.with_weights([None, *others], trial), start
            self._change(self.problem)
            return
        self.rejected = ~kept
        weights = [kept.astype(np.float64) if self.rejected.any() else None, *others]
        self._change(plain.with_weights(weights))

    def _tune_noise(self, decades: float) -> None:
        """Set the process noise to the value of greatest marginal likelihood."""
        order = self.problem.motion.order
        least = least_noise(order, self._resolution)
        for _ in range(3):
            centre = self.problem.motion.density.axes[0]
            low = np.log(max(centre * 10.0**-decades, least))
            high = max(np.log(centre * 10.0**decades), low + 1.0)
            best = minimize_scalar(
                self._negative_evidence, bounds=(low, high), method="bounded",
                options={"xatol": 0.05, "maxiter": 30},
            )  # fmt: skip
            noise = float(np.exp(best.x))
            self._change(self.problem.with_motion(self._motion(noise)))
            self._respace()
            if 0.5 < noise / centre < 2.0:
                break
            decades = min(decades, 2.0)

    def _motion(self, noise: float) -> Motion:
        return self.problem.motion.with_density(Density.of(noise))

    def _negative_evidence(self, log_noise: float) -> float:
        """Return the negative log marginal likelihood (Laplace), up to a constant."""
        problem = self.problem.with_motion(self._motion(float(np.exp(log_noise))))
        solution = solve(problem, self.solution.values, max_iterations=20, tolerance=1e-4)
        self.iterations += solution.iterations
        if solution.elimination is None or not np.isfinite(solution.cost):
            return float("inf")
        if solution.status is Status.CONVERGED:
            self.solution = solution
        return solution.cost + solution.elimination.half_log_determinant()

    def _respace(self) -> None:
        """Put the knots where the present estimate and process noise want them."""
        _, _, times = self.bearings.predicted(self.problem.path, self.solution.values)
        knots = self._knots(self.problem.motion, times, self._resolution)
        old = self.problem.knots_s
        if old.size == knots.size and np.abs(old - knots).max() < 0.01 * np.diff(old).min():
            return
        values = self._values_at(knots)
        problem = self.problem
        weights = [problem.weights[0], *(None for _ in problem.families[1:])]
        self.problem = Problem(
            motion=problem.motion,
            knots_s=knots,
            families=self.prepared.families(knots),
            states=problem.states,
            walk_scale=problem.walk_scale,
            prior=replace(problem.prior, mean=values.path[0]),
            path_scale=problem.path_scale,
            loss=problem.loss,
            weights=weights,
            elimination=problem.elimination,
            shift=problem.shift,
        )
        self._refresh(values)
        self.solution = self._solve(self.problem, values)

    def _values_at(self, knots_s: NDArray[np.float64]) -> Values:
        """Return the present estimate read off at other knots."""
        values = self.solution.values
        old = self.problem.knots_s
        state = self.problem.motion.read(self.problem.path, values.path, knots_s)
        walks = np.stack(
            [np.interp(knots_s, old, column) for column in values.walks.T], axis=1
        ) if values.walks.shape[1] else np.zeros((knots_s.size, 0))  # fmt: skip
        return Values(state, walks, values.constants)

    def _refresh(self, values: Values) -> None:
        """Bring geometry-dependent noise and the walks' times up to date."""
        motion = self.problem.motion
        steps = self.problem.steps_s
        self.ignored = 0.0
        if steps.size:
            self.ignored = ignored_share(motion, float(steps.max()), self._resolution)
        if self.settings.spacing_s is not None and self.ignored > NEGLIGIBLE:
            # Knots wider than the noise allows: what lies between them is noise to the bearings.
            _, _, times = self.bearings.predicted(self.problem.path, values)
            place = self.problem.path.locate(times)
            between = conditional_covariance(motion.order, place.step_s, place.offset_s)
            self.bearings.path_noise_m = motion.density.largest * np.sqrt(between[:, 0, 0])
        self.problem.refresh(values)

    def _settle(self) -> None:
        """Solve until what a solve holds fixed agrees with its result."""
        for _ in range(_ROUNDS):
            before = self.solution.values
            if self.solution.elimination is None:
                break
            _, _, times = self.bearings.predicted(self.problem.path, before)
            knots = self.problem.knots_s
            if knots.size > 1:
                slack = 0.05 * float(np.diff(knots).min())
                if times.min() < knots[0] - slack or times.max() > knots[-1] + slack:
                    self._respace()
                    continue
            self._refresh(before)
            cost = self.problem.cost(before)
            if abs(cost - self.solution.cost) <= 1e-6 * max(1.0, cost):
                break
            self.solution = self._solve(self.problem, before)


def first_problem(recording: Recording, settings: SmoothSettings) -> tuple[Problem, Values]:
    """Return the problem and the values that the most promising first guess leads to.

    Parameters
    ----------
    recording, settings
        As in :func:`smooth`.

    Raises
    ------
    InputError
        If the recording has no measurement.
    """
    smoother = Smoother(prepare(recording), settings)
    loss = Loss("none" if smoother.robust else settings.loss)
    problem, values = smoother.start(smoother.first_guess().fits()[0], loss)
    # As it stands: what all clocks have in common is left to their priors.
    return problem.without_shift(), values


def _better(one: Solution, other: Solution) -> bool:
    if not np.isfinite(one.cost):
        return False
    return not np.isfinite(other.cost) or one.cost < other.cost


def smooth(
    recording: Recording,
    settings: SmoothSettings | None = None,
    *,
    raise_on_failure: bool = True,
    **changes: Any,
) -> Track:
    """Estimate the whole path of the object and the errors of every sensor.

    Parameters
    ----------
    recording
        Measurements and sensors.
    settings
        How to smooth; the recording's own settings by default.
    raise_on_failure
        Whether a solve that did not converge raises; otherwise the track says so in its status.
    **changes
        Single settings by name, over those above; see :class:`geograph.SmoothSettings`.

    Returns
    -------
    track
        The path with covariances, sensor errors, residuals and summary.

    Raises
    ------
    InputError
        If the recording has no measurement or a setting is wrong.
    SolveError
        If the solve did not converge or the path is not observable, unless told not to.
    """
    began = time.perf_counter()
    chosen = (settings or recording.settings).replace(**changes)
    with single_blas_thread():
        smoother = Smoother(prepare(recording), chosen)
        smoother.run()
        track = make_track(smoother, seconds=time.perf_counter() - began)
    if raise_on_failure and track.status is not Status.CONVERGED:
        raise SolveError(str(track.summary["message"]), status=str(track.status))
    return track
