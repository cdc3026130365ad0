"""From a solved problem to a track: covariances, sensor estimates, residuals, status, summary."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import chi2

from geograph.eliminate import Marginals
from geograph.knots import NEGLIGIBLE
from geograph.observability import WeakDirections, weak_directions
from geograph.robust import thresholds
from geograph.solver import Status
from geograph.track import Residuals, SensorEstimate, Track

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.families import BearingFamily, Evaluation
    from geograph.smoother import Smoother

_FLAG_SIGMAS = 3.0
_MISFIT = 1.5
_MISFIT_CHANCE = 1e-4


def make_track(smoother: Smoother, *, seconds: float) -> Track:
    """Return the track of a finished smoother.

    Parameters
    ----------
    smoother
        After :meth:`Smoother.run`.
    seconds
        What the solve took.
    """
    problem, solution = smoother.problem, smoother.solution
    values = solution.values
    marginals = _marginals(smoother)
    size = values.path.shape[1]
    scale = problem.path_scale
    covariance = marginals.knots[:, :size, :size] * scale[:, None] * scale
    found = problem.evaluate(values, jacobian=False)
    family = smoother.bearings
    weight = _weights(smoother, found[0])
    out = outliers(smoother, found[0])
    residuals = residual_table(family, found[0], smoother, weight=weight, rejected=out)
    errors = sensor_estimates(smoother, marginals)
    track = Track(
        time_s=problem.knots_s,
        state=values.path,
        covariance=covariance,
        frame=smoother.prepared.recording.frame,
        recording=smoother.prepared.recording,
        settings=_resolved(smoother),
        status=solution.status,
        summary={},
        sensor_errors=errors,
        residuals=residuals,
        problem=problem,
        values=values,
        marginals=marginals,
    )
    weak = weak_directions(track, smoother.distances())
    lost = _too_few_left(smoother, out)
    if lost is not None:
        weak = WeakDirections([lost, *weak.sentences], unobservable=True)
    status = solution.status
    if weak.unobservable:
        status = Status.UNOBSERVABLE
    summary = _summary(smoother, track, found, out=out, weak=weak.sentences, status=status)
    summary["seconds"] = seconds
    return replace(track, status=status, summary=summary)


def _marginals(smoother: Smoother) -> Marginals:
    """Return the covariances, not numbers where the problem could not even be factorised."""
    elimination = smoother.solution.elimination
    if elimination is not None:
        problem = smoother.problem
        found = elimination.marginals()
        if problem.shift is None:
            return found
        return problem.shift.widened(found, problem, smoother.solution.values)
    layout = smoother.problem.layout
    count, d, s = smoother.problem.knots_s.size, layout.knot, layout.constants
    return Marginals(
        np.full((count, d, d), np.nan),
        np.full((count - 1, d, d), np.nan),
        np.full((count, d, s), np.nan),
        np.full((s, s), np.nan),
    )


def _weights(smoother: Smoother, found: Evaluation) -> NDArray[np.float64]:
    """Return the weight that each bearing ended with, 0 to 1, shape (n,)."""
    square = np.sum(found.residual**2, axis=1)
    _, weight = smoother.problem.loss.value_and_weight(square)
    fixed = smoother.problem.weights[0]
    return weight if fixed is None else weight * fixed


def _resolved(smoother: Smoother) -> Any:
    motion, knots = smoother.problem.motion, smoother.problem.knots_s
    settings = smoother.settings
    changes: dict[str, Any] = {}
    if settings.process_noise == "auto" and not motion.static:
        changes["process_noise"] = motion.density.axes[0]
    if knots.size > 1:
        changes["spacing_s"] = float(np.median(np.diff(knots)))
    return settings.replace(**changes)


def residual_table(
    family: BearingFamily,
    found: Evaluation,
    smoother: Smoother,
    *,
    weight: NDArray[np.float64],
    rejected: NDArray[np.bool_],
) -> Residuals:
    """Return the residuals of all bearings, elevations behind azimuths, in the file's order.

    Parameters
    ----------
    family
        The bearings.
    found
        Their evaluation at the estimate.
    smoother
        For the path and the estimate.
    weight
        Shape (n,): weights that the loss gave.
    rejected
        Shape (n,): outliers.
    """
    problem = smoother.problem
    table = family.bearings
    predicted, _, _ = family.predicted(problem.path, smoother.solution.values)
    measured = np.stack([table.azimuth_rad, table.elevation_rad], axis=1)
    count = len(table)
    exists = np.ones((count, 2), dtype=bool)
    exists[family.azimuth_only, 1] = False
    level = np.cos(np.nan_to_num(table.elevation_rad))
    level = np.where(table.isotropic & ~family.azimuth_only, np.maximum(level, 1e-6), 1.0)
    sigma = np.stack([table.sigma_azimuth_rad / level, table.sigma_elevation_rad], axis=1)
    # The solver's residual is predicted - measured, whitened with the correlation's weight.
    normalised = -found.residual / np.sqrt(family.weight)[:, None]

    def pick(column: NDArray[Any]) -> NDArray[Any]:
        spread = column if column.ndim == 2 else np.repeat(column[:, None], 2, axis=1)
        return np.asarray(spread[exists])

    kinds = np.broadcast_to(np.array(["azimuth", "elevation"]), (count, 2))
    return Residuals(
        pick(table.time_s),
        pick(table.sensor),
        pick(kinds),
        pick(measured),
        pick(predicted),
        pick(measured - predicted),
        pick(sigma),
        pick(normalised),
        pick(weight),
        pick(rejected),
        pick(table.line),
    )


def sensor_estimates(
    smoother: Smoother, marginals: Marginals
) -> dict[str, dict[str, SensorEstimate]]:
    """Return the estimated errors of every sensor that has any, by name."""
    problem = smoother.problem
    names = smoother.prepared.recording.sensor_names
    values = smoother.solution.values
    result: dict[str, dict[str, SensorEstimate]] = {}
    for column, state in enumerate(problem.states.constants):
        sigma = float(np.sqrt(marginals.constants[column, column]))
        result.setdefault(names[state.sensor], {})[state.name] = SensorEstimate(
            state.unit, float(values.constants[column] * state.sigma), sigma * state.sigma,
            state.sigma,
        )  # fmt: skip
    size = values.path.shape[1]
    for column, walk in enumerate(problem.states.walks):
        scale = float(problem.walk_scale[column])
        at = size + column
        result.setdefault(names[walk.sensor], {})[walk.name] = SensorEstimate(
            walk.unit,
            float(values.walks[-1, column]) * scale,
            float(np.sqrt(marginals.knots[-1, at, at])) * scale,
            scale,
        )
    return result


def _summary(
    smoother: Smoother,
    track: Track,
    found: list[Evaluation],
    *,
    out: NDArray[np.bool_],
    weak: list[str],
    status: Status,
) -> dict[str, Any]:
    problem, solution = smoother.problem, smoother.solution
    square = float(np.sum(found[0].residual[~out] ** 2))
    square += sum(float(np.sum(part.residual**2)) for part in found[1:])
    prior = 2.0 * problem.prior_cost(solution.values)
    lost = int(smoother.bearings.row_counts[out].sum())
    freedom = max(problem.measurement_rows - lost - 3 * problem.motion.order, 0)
    noise = problem.motion.density
    return {
        "name": track.recording.name,
        "status": str(status),
        "message": _message(status, smoother.iterations, weak),
        "iterations": smoother.iterations,
        "cost": solution.cost,
        "chi2": square + prior,
        "degrees_of_freedom": freedom,
        "measurements": len(smoother.bearings) + sum(f.row_count for f in problem.families[1:]),
        "rejected": _rejected(smoother, found[0], out),
        "weakly_observed": weak,
        "flagged_sensors": _flagged(track),
        "sensors": _per_sensor(smoother, track, out),
        "motion": problem.motion.name,
        "process_noise": None if problem.motion.static else list(noise.axes),
        "process_noise_along": noise.along,
        "loss": smoother.settings.loss,
        "knots": int(problem.knots_s.size),
        "spacing_s": track.settings.spacing_s,
        "interpolation": _interpolation(smoother),
        "first_guess": _guesses(smoother),
    }


def _too_few_left(smoother: Smoother, out: NDArray[np.bool_]) -> str | None:
    """Say so where outliers leave nothing to check the path with, or cannot be told apart."""
    rows = smoother.bearings.row_counts
    if smoother.undecided:
        return (
            "the bearings contradict each other, and too few agree to tell which are wrong; more "
            "sensors or more bearings are needed"
        )
    if out.any() and rows[~out].sum() <= 3 * smoother.problem.motion.order:
        return (
            f"{int(out.sum())} of {out.size} bearings do not fit, and the others are too few to "
            "check the path with"
        )
    return None


def _message(status: Status, iterations: int, weak: list[str]) -> str:
    if status is Status.CONVERGED:
        return f"converged in {iterations} iterations"
    if status is Status.UNOBSERVABLE:
        return "the measurements do not determine the path: " + "; ".join(weak)
    if status is Status.ITERATION_LIMIT:
        return (
            f"not converged after {iterations} iterations; raise max_iterations, or give priors "
            "that fit the sensors"
        )
    return "diverged: no step lowers the cost; check units, axes and clocks of the sensors"


def outliers(smoother: Smoother, found: Evaluation) -> NDArray[np.bool_]:
    """Return which bearings do not belong, shape (n,): left out, or far off under a robust loss.

    Parameters
    ----------
    smoother
        After its run.
    found
        Evaluation of the bearings at the estimate.
    """
    if smoother.problem.loss.name == "none":
        return smoother.rejected
    family = smoother.bearings
    square = family.squares(found)
    limit = thresholds(square, family.row_counts, family.bearings.sensor)
    return np.asarray(smoother.rejected | (square > limit))


def _rejected(
    smoother: Smoother, found: Evaluation, out: NDArray[np.bool_]
) -> list[dict[str, Any]]:
    """Name every rejected bearing, with its residual in sigmas."""
    table = smoother.prepared.bearings
    names = smoother.prepared.recording.sensor_names
    square = smoother.bearings.squares(found)
    return [
        {
            "sensor": names[table.sensor[index]],
            "time_s": float(table.time_s[index]),
            "line": int(table.line[index]),
            "normalised": float(np.sqrt(square[index])),
        }
        for index in np.flatnonzero(out)
    ]


def _flagged(track: Track) -> list[str]:
    """Name every sensor error beyond its prior, and every sensor that the path does not fit."""
    sentences = []
    for name, states in track.sensor_errors.items():
        for state, entry in states.items():
            if abs(entry.estimate) > _FLAG_SIGMAS * entry.prior_sigma:
                sentences.append(
                    f"{name}: {state} is {entry.estimate:.4g} +- {entry.sigma:.2g} {entry.unit}, "
                    f"{abs(entry.estimate) / entry.prior_sigma:.1f} times its prior sigma"
                )
    return sentences + _misfits(track)


def _misfits(track: Track) -> list[str]:
    """Name every sensor whose residuals are wider than stated, beyond chance and by much."""
    residuals = track.residuals
    sentences = []
    for index, name in enumerate(track.recording.sensor_names):
        kept = residuals.normalised[(residuals.sensor == index) & ~residuals.rejected]
        square = float(np.sum(kept**2))
        if square > max(_MISFIT**2 * kept.size, float(chi2.isf(_MISFIT_CHANCE, kept.size))):
            sentences.append(
                f"{name}: residuals are {np.sqrt(square / kept.size):.3g} times their sigmas; its "
                "sigmas, its errors or the motion model do not fit, and covariances are too small"
            )
    return sentences


def _per_sensor(
    smoother: Smoother, track: Track, out: NDArray[np.bool_]
) -> dict[str, dict[str, Any]]:
    residuals = track.residuals
    result = {}
    for index, name in enumerate(track.recording.sensor_names):
        own = residuals.sensor == index
        kept = own & ~residuals.rejected
        measured = smoother.prepared.bearings.sensor == index
        result[name] = {
            "measurements": int(measured.sum()),
            "rejected": int(out[measured].sum()),
            "rms_normalised": float(np.sqrt(np.mean(residuals.normalised[kept] ** 2)))
            if kept.any()
            else None,
            "median_residual_rad": float(np.median(np.abs(residuals.residual[kept])))
            if kept.any()
            else None,
        }
    return result


def _interpolation(smoother: Smoother) -> dict[str, Any]:
    small = smoother.ignored <= NEGLIGIBLE * 1.5
    text = "negligible between knots"
    if not small:
        text = (
            "the path may deviate between knots by more than the measurements can ignore; the "
            "deviation is added to their noise: reduce spacing_s for the full accuracy"
        )
    return {"ignored_information": smoother.ignored, "small": small, "message": text}


def _guesses(smoother: Smoother) -> dict[str, Any]:
    """Describe the first guess that was chosen, and what the others led to."""
    names = smoother.prepared.recording.sensor_names

    def describe(index: int) -> dict[str, Any]:
        fit, cost = smoother.guesses[index]
        clocks = {names[i]: float(fit.clock_s[i]) for i in np.flatnonzero(fit.clock_s)}
        return {"cost": cost, "clock_offsets_s": clocks, "behind_sensors": fit.behind}

    return {
        "chosen": describe(0),
        "others": [describe(index) for index in range(1, len(smoother.guesses))],
    }
