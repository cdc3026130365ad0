"""The batch smoother: from a recording to a track.

First guesses, knots, process noise, Levenberg-Marquardt, outliers, and once more where an estimate
moves what a solve holds fixed; then covariances, status and summary.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph import chi_square
from geograph.culprits import other_culprits
from geograph.errors import SolveError
from geograph.families import SensorFamily, Values
from geograph.knots import NEGLIGIBLE, add_path_noise, ignored_share
from geograph.losses import Loss
from geograph.orbit_forces import forces_of
from geograph.prepare import Prepared, prepare
from geograph.problem import Problem
from geograph.range_retries import further_fits, mirror_image
from geograph.report import make_track
from geograph.resets import Resets, find_resets, searched
from geograph.rivals import Attempt, Rival, find_rivals, read_attempt
from geograph.robust import anneal, thresholds
from geograph.softened import NARROW, softened, width
from geograph.solver import Solution, Status, solve
from geograph.starts import choose_knots, first_fits, prior_width, start
from geograph.threads import single_blas_thread
from geograph.tuning import solved_evidence, tune, tune_noise
from geograph.wrong_sensor import leave_out_wrong_sensor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.hypotheses import Hypothesis
    from geograph.initialise import PathFit
    from geograph.knots import Resolution
    from geograph.recording import Recording, SmoothSettings
    from geograph.track import Track

_ROUNDS = 6
_TRIAL_ITERATIONS = 40
_PATIENCE = 100

# Further first guesses are tried where the median square is above that of normal errors by this.
_MISFIT = 2.0

# Sigmas from its middle at which the weak prior of the first knot is felt: it is a hundred
# distances wide, so that the first guess's distances were wrong.
_FELT = 1.0

# As many first guesses are tried another way where none led to a fit.
_SOFTENED = 3

# An estimate whose signals were emitted so many times the recording's length away has run off.
_RUN_OFF = 1e6


@dataclass(eq=False)
class Smoother:
    """One recording's way from first guess to solution; see :func:`smooth`.

    Attributes
    ----------
    prepared
        The recording made ready.
    settings
        As asked for.
    guesses
        First guesses to start from; empty: they are found.
    problem, solution
        The latest.
    resolution
        What the measurements resolve.
    iterations
        Levenberg-Marquardt iterations so far.
    rejected
        Shape (n,): measurements found to be outliers, of all families one after another.
    worth
        Shape (n,): how many independent ones each measurement counts as, at most one, where errors
        of sensors were found to be correlated; None: there are none such.
    ignored
        Share of the information that lies between the knots.
    undecided
        Whether outliers show, but not which measurements they are.
    rows
        Shape (n,): scalars of each measurement.
    attempts
        What the first guesses led to, the best first.
    rivals
        Other paths that fit as well.
    culprits
        A sentence where another sensor than the one left out could be the wrong one.
    resets
        Times of the resets that were found, by the sensor's index.
    hypotheses
        All minima that were found, with their weights, the estimate first; empty if it is alone.
    """

    prepared: Prepared
    settings: SmoothSettings
    guesses: Sequence[PathFit] = ()
    problem: Problem = field(init=False)
    solution: Solution = field(init=False)
    resolution: Resolution = field(init=False)
    iterations: int = 0
    rejected: NDArray[np.bool_] = field(init=False)
    attempts: list[Attempt] = field(default_factory=list)
    rivals: list[Rival] = field(default_factory=list)
    hypotheses: list[Hypothesis] = field(default_factory=list)
    resets: Resets = field(default_factory=dict)
    ignored: float = 0.0
    undecided: bool = False
    worth: NDArray[np.float64] | None = None
    culprits: str | None = None

    def __post_init__(self) -> None:
        families = self.prepared.sensor_families()
        self.rejected = np.zeros(sum(len(family) for family in families), dtype=np.bool_)
        self.rows = np.concatenate([family.row_counts for family in families])
        # Outliers are judged among those of the same sensor and kind.
        sensors = len(self.prepared.sensors)
        kinds = [family.sensor + i * sensors for i, family in enumerate(families)]
        _, code = np.unique(np.concatenate(kinds), return_inverse=True)
        self.group: NDArray[np.int64] = code.astype(np.int64)

    @property
    def robust(self) -> bool:
        """Whether outliers are to be found and rejected."""
        return self.settings.loss in ("auto", "gnc")

    @property
    def automatic(self) -> bool:
        """Whether the process noise is to be found."""
        return self.settings.process_noise == "auto" and self.settings.motion != "static"

    def run(self) -> None:
        """Solve from every first guess, keep the best, and refine it."""
        settings = self.settings
        automatic = self.automatic
        loss = Loss("none" if self.robust else settings.loss)
        trial = Loss("cauchy") if self.robust else loss
        fits = list(self.guesses) or self._first_fits()
        several = len(fits) > 1
        for fit in fits:
            problem, values = self.start(fit, trial if several or automatic else loss)
            if self.robust and problem.loss == loss and self._suspect(problem, values):
                problem = problem.with_weights(problem.weights, trial)
            # Where errors of angles are wide, another way is tried before this one's end.
            wide = width(self.prepared, self.resolution) > NARROW
            patience = min(_PATIENCE, settings.max_iterations) if wide else settings.max_iterations
            self._attempt(fit, problem, values, _TRIAL_ITERATIONS if several else patience)
        best = self.attempts[0]
        for fit in further_fits(self.prepared, best, misfit=self._misfit(best)):
            self._attempt(fit, *self.start(fit, best.problem.loss), _TRIAL_ITERATIONS)
            several, best = True, self.attempts[0]
        for fit in fits[:_SOFTENED]:
            self._soften(fit, best)
            best = self.attempts[0]
        self.problem, self.solution, self.resolution = best.problem, best.solution, best.resolution
        short = several or patience < settings.max_iterations
        if self.solution.status is Status.ITERATION_LIMIT and short:
            self.change(self.problem)
        if automatic:
            tune_noise(self, 4.0)
        if self._find_resets(trial) and automatic:
            # A path that had to follow the jumps need not any more.
            tune_noise(self, 4.0)
        if self.robust:
            self._reject(trial)
        tune(self)
        if find_resets(self) and self.robust:
            self._reject(trial)
        self._settle()
        if leave_out_wrong_sensor(self):
            tune(self)
            self._settle()
        self._compare()
        self.culprits = other_culprits(self)

    def _first_fits(self) -> list[PathFit]:
        settings = self.settings
        return first_fits(
            self.prepared,
            static=settings.motion == "static",
            orbital=settings.motion == "orbital",
            forces=forces_of(self.prepared.recording, settings),
        )

    def _find_resets(self, trial: Loss) -> bool:
        """Find resets before outliers, which the measurements after one would be taken for."""
        if not searched(self.prepared):
            return False
        if self.robust and self.problem.loss != trial:
            square = self.squares(self.problem, self.solution.values)
            if (square > thresholds(np.zeros_like(square), self.rows, self.group)).any():
                self.change(self.problem.with_weights(self.problem.weights, trial))
        return find_resets(self)

    def _attempt(self, fit: PathFit, problem: Problem, values: Values, limit: int | None) -> None:
        """Solve from a first guess; attempts stay in order of their costs."""
        most = self.settings.max_iterations
        solution = self._solve(problem, values, min(limit or most, most))
        self.attempts.append(Attempt(fit, problem, solution, self.resolution))
        self.attempts.sort(key=_likely if self.automatic else _rank)

    def _soften(self, fit: PathFit, best: Attempt) -> None:
        """Try a first guess once more, another way, where the best attempt does not fit."""
        # Resets that are yet to be found do not fit either.
        misfit = self._misfit(best) and not searched(self.prepared)
        lost = best.solution.status is not Status.CONVERGED or misfit
        if self.prepared.bearings is None or not lost:
            return
        problem, values = self.start(fit, best.problem.loss)
        found = softened(problem, values, width(self.prepared, best.resolution))
        if found is not None:
            self.iterations += found[1]
            self._attempt(fit, problem, found[0], None)

    def _misfit(self, attempt: Attempt) -> bool:
        """Tell whether most measurements are well beyond their sigmas from an attempt's path."""
        square = self.squares(attempt.problem, attempt.solution.values)
        typical = float(np.median(square / self.rows))
        return not typical < _MISFIT * float(chi_square.median(1))

    def adopt(self, problem: Problem, solution: Solution, rejected: NDArray[np.bool_]) -> None:
        """Take over another solution, with other measurements left out, and refine it."""
        self.problem, self.solution, self.rejected = problem, solution, rejected
        self.iterations += solution.iterations
        # They were compared with an estimate that is no more.
        self.rivals, self.hypotheses = [], []
        self._settle()

    def _compare(self) -> None:
        """Hold the estimate against what other first guesses led to, and its mirror image."""
        if self.solution.status is not Status.CONVERGED:
            return
        starts = [read_attempt(attempt, self.problem) for attempt in self.attempts[1:]]
        image = mirror_image(self.prepared, self.problem, self.solution.values)
        starts += [] if image is None else [image]
        best, self.rivals, self.hypotheses = find_rivals(self.problem, self.solution, starts)
        if best is not self.solution:
            self.iterations += best.iterations
            self.solution = best
            self._settle()

    def _suspect(self, problem: Problem, values: Values) -> bool:
        """Tell whether a first guess shows residuals far outside those of their sensor."""
        square = self.squares(problem, values)
        return bool((square > thresholds(square, self.rows, self.group)).any())

    def start(self, fit: PathFit, loss: Loss) -> tuple[Problem, Values]:
        """Return the problem and the values that a first guess leads to."""
        problem, values, self.resolution = start(self.prepared, self.settings, fit, loss)
        return problem, values

    def solved(self, values: Values) -> Solution:
        """Return the solution of the present problem from a first guess."""
        return self._solve(self.problem, values)

    def _solve(self, problem: Problem, values: Values, limit: int | None = None) -> Solution:
        """Solve, counting the iterations."""
        solution = solve(problem, values, max_iterations=limit or self.settings.max_iterations)
        self.iterations += solution.iterations
        return solution

    def change(self, problem: Problem) -> None:
        """Solve a changed problem from the current estimate."""
        self.problem = problem
        self.solution = self._solve(problem, self.solution.values)

    @property
    def families(self) -> list[SensorFamily]:
        """What sensors measured; these are the problem's first families."""
        return sensor_families(self.problem)

    def emissions(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return distances (m) and times of emission (s) of all measurements, each shape (n,)."""
        path, values = self.problem.path, self.solution.values
        found = [family.emissions(path, values) for family in self.families]
        distance, time = (np.concatenate(columns) for columns in zip(*found, strict=True))
        return distance, time

    def split(self, column: NDArray[Any]) -> list[NDArray[Any]]:
        """Return a column over all measurements by family."""
        ends = np.cumsum([len(family) for family in self.families])[:-1]
        return np.split(column, ends)

    @staticmethod
    def squares(problem: Problem, values: Values) -> NDArray[np.float64]:
        """Return squared whitened residuals of all measurements, shape (n,)."""
        found = problem.evaluate(values, jacobian=False)
        families = sensor_families(problem)
        return np.concatenate(
            [family.squares(part) for family, part in zip(families, found, strict=False)]
        )

    def weights(self, column: NDArray[np.float64] | None) -> list[NDArray[np.float64] | None]:
        """Return weights for every family: those given for the sensors', none for the others.

        What the measurements are worth comes on top of them.
        """
        others = [None] * (len(self.problem.families) - len(self.families))
        if self.worth is not None:
            column = self.worth if column is None else self.worth * column
        if column is None:
            return [None] * len(self.problem.families)
        return [*self.split(column), *others]

    def _reject(self, trial: Loss) -> None:
        """Find the outliers, if there are any, and solve without them."""
        rows, group = self.rows, self.group
        plain = self.problem.with_weights(self.weights(None), Loss("none"))
        square = self.squares(self.problem, self.solution.values)
        if self.problem.loss != trial:
            if (square <= thresholds(np.zeros_like(square), rows, group)).all():
                return
            # From the robust estimate, where outliers stand out and good sensors do not suffer.
            self.change(self.problem.with_weights(self.problem.weights, trial))
            square = self.squares(self.problem, self.solution.values)

        def solved(weight: NDArray[np.float64]) -> NDArray[np.float64]:
            self.change(plain.with_weights(self.weights(weight)))
            return self.squares(self.problem, self.solution.values)

        before = self.solution
        kept = anneal(solved, square, rows, group)
        least = max(0.5 * rows.sum(), 3 * self.problem.motion.order + 1)
        if not kept.all() and rows[kept].sum() < least:
            # What would be left is a minority, or says nothing beyond its own fit: which of the
            # measurements are wrong cannot be told from them.
            self.undecided = True
            self.problem, self.solution = plain.with_weights(self.weights(None), trial), before
            self.change(self.problem)
            return
        self.rejected = ~kept
        weight = kept.astype(np.float64) if self.rejected.any() else None
        self.change(plain.with_weights(self.weights(weight)))

    def respace(self) -> None:
        """Put the knots where the present estimate and process noise want them."""
        _, times = self.emissions()
        knots = choose_knots(
            self.prepared,
            self.settings,
            self.problem.motion,
            times_s=times,
            resolved=self.resolution,
            stages=self.problem.stages,
        )
        old = self.problem.knots_s
        if old.size == knots.size and np.abs(old - knots).max() < 0.01 * np.diff(old).min():
            return
        values = self._values_at(knots)
        problem = self.problem
        count = len(self.families)
        weights = [*problem.weights[:count], *(None for _ in problem.families[count:])]
        self.problem = Problem(
            motion=problem.motion,
            knots_s=knots,
            families=self.prepared.families(knots),
            states=problem.states,
            walk_scale=problem.walk_scale,
            prior=problem.prior.centred(values.path[0], 3 * problem.motion.order),
            path_scale=problem.path_scale,
            loss=problem.loss,
            weights=weights,
            elimination=problem.elimination,
            shift=problem.shift,
            stages=problem.stages,
        )
        self.bring_up_to_date(values)
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

    def bring_up_to_date(self, values: Values) -> None:
        """Bring geometry-dependent noise and the walks' times up to date."""
        motion = self.problem.motion
        steps = self.problem.steps_s
        self.ignored = 0.0
        if steps.size:
            self.ignored = self._ignored_share(steps)
        if self.settings.spacing_s is not None and self.ignored > NEGLIGIBLE:
            # Knots wider than the noise allows: what lies between them is noise to the sensors.
            for family in self.families:
                _, times = family.emissions(self.problem.path, values)
                times_of = self.problem.noise_times
                add_path_noise(family, motion, self.problem.path, times, times_of)
        self.problem.refresh(values)

    def _ignored_share(self, steps_s: NDArray[np.float64]) -> float:
        """Return the share of the information that lies between the knots, where it is largest."""
        motion, times = self.problem.motion, self.problem.noise_times
        if times is None:
            return ignored_share(motion, float(steps_s.max()), self.resolution)
        return max(
            ignored_share(
                motion.scaled(value), float(steps_s[times == value].max()), self.resolution
            )
            for value in np.unique(times).tolist()
        )

    def _loosen(self) -> None:
        """Put the weak prior of the first knot about the estimate where it is felt.

        Its width follows the first guess's distances, and these may have been far too short.
        """
        problem, state = self.problem, self.solution.values.path[0]
        order, prior = problem.motion.order, problem.prior
        size = 3 * order
        if not np.abs((state - prior.mean) / prior.sigma)[:size].max() > _FELT:
            return
        reach = float(np.median(self.emissions()[0]))
        width = prior_width(reach, self.prepared.span_s, order)
        self.problem = problem.changed(prior=prior.as_wide_as(width).centred(state, size))

    def _settle(self) -> None:
        """Solve until what a solve holds fixed agrees with its result."""
        for _ in range(_ROUNDS):
            before = self.solution.values
            if self.solution.elimination is None:
                break
            _, times = self.emissions()
            knots = self.problem.knots_s
            far = _RUN_OFF * max(self.prepared.span_s, 1.0)
            if not np.abs(times - knots.mean()).max() < far:
                self.solution = replace(self.solution, status=Status.DIVERGED, elimination=None)
                break
            if knots.size > 1:
                slack = 0.05 * float(np.diff(knots).min())
                if times.min() < knots[0] - slack or times.max() > knots[-1] + slack:
                    self.respace()
                    continue
            self.bring_up_to_date(before)
            self._loosen()
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
    fits = first_fits(
        smoother.prepared,
        static=settings.motion == "static",
        orbital=settings.motion == "orbital",
        forces=forces_of(recording, settings),
    )
    problem, values = smoother.start(fits[0], loss)
    # As it stands: what all clocks have in common is left to their priors.
    return problem.without_shift(), values


def sensor_families(problem: Problem) -> list[SensorFamily]:
    """Return the families of a problem that sensors measured; they stand before all others."""
    return [family for family in problem.families if isinstance(family, SensorFamily)]


def _rank(attempt: Attempt) -> float:
    cost = attempt.solution.cost
    return cost if np.isfinite(cost) else float("inf")


def _likely(attempt: Attempt) -> tuple[float, float]:
    """Return what ranks attempts whose process noises are guesses, which differ.

    The least cost alone would choose the guess of the largest noise.
    """
    # The first knot's density in SI units, for the attempts' scales differ.
    unit = float(np.log(attempt.problem.path_scale).sum())
    return -solved_evidence(attempt.solution) - unit, _rank(attempt)


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
