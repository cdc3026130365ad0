"""From a solved problem to a track: covariances, sensor estimates, residuals, status, summary."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph import chi_square
from geograph.diagnosis import diagnose
from geograph.eliminate import Marginals
from geograph.hypotheses import off_terrain
from geograph.knots import NEGLIGIBLE
from geograph.observability import WeakDirections, weak_directions
from geograph.orbit_forces import force_estimates
from geograph.reset_report import reset_facts
from geograph.robust import thresholds
from geograph.solver import Status
from geograph.track import Residuals, SensorEstimate, Track

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from geograph.families import Evaluation, SensorFamily
    from geograph.problem import Problem
    from geograph.smoother import Smoother

_FLAG_SIGMAS = 3.0
_MISFIT = 1.5
_MISFIT_CHANCE = 1e-4

# The same for all together, of which a share that is too sure pulls the path from the others.
_MISFIT_IN_ALL = 1.3


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
    size = 3 * problem.motion.order
    scale = problem.path_scale[:size]
    covariance = marginals.knots[:, :size, :size] * scale[:, None] * scale
    found = problem.evaluate(values, jacobian=False)
    out = outliers(smoother, found)
    residuals = residual_table(smoother, found, rejected=out)
    errors = sensor_estimates(smoother, marginals)
    track = Track(
        time_s=problem.knots_s,
        state=values.path[:, :size],
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
    weak = weak_directions(track, smoother.emissions()[0])
    lost = _too_few_left(smoother, out)
    others = [rival.sentence(track.frame) for rival in smoother.rivals]
    first = ([] if lost is None else [lost]) + _unknown_ground(smoother)
    culprits = [] if smoother.culprits is None else [smoother.culprits]
    if culprits or others or first:
        sentences = [*culprits, *others, *first, *weak.sentences]
        curved = weak.curved or "".join(others[:1])
        weak = replace(weak, sentences=sentences, unobservable=True, curved=curved)
    status = solution.status
    if weak.unobservable:
        status = Status.UNOBSERVABLE
    summary = _summary(smoother, track, found, out=out, weak=weak, status=status)
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


def _weights(smoother: Smoother, found: Evaluation, index: int) -> NDArray[np.float64]:
    """Return the weight that each measurement of a family ended with, 0 to 1, shape (n,)."""
    square = np.sum(found.residual**2, axis=1)
    _, weight = smoother.problem.loss.value_and_weight(square)
    fixed = smoother.problem.weights[index]
    return weight if fixed is None else weight * fixed


def _resolved(smoother: Smoother) -> Any:
    motion, knots = smoother.problem.motion, smoother.problem.knots_s
    settings = smoother.settings
    changes: dict[str, Any] = {}
    if "auto" in (settings.process_noise, settings.stages) and not motion.static:
        axes = motion.density.axes
        changes["process_noise"] = axes[0] if len(set(axes)) == 1 else axes
        changes["process_noise_along"] = motion.density.along
    stages = smoother.problem.stages
    if settings.stages == "auto":
        changes["stages"] = None if stages is None else stages.pairs()
    if knots.size > 1:
        changes["spacing_s"] = float(np.median(np.diff(knots)))
    return settings.replace(**changes)


def residual_table(
    smoother: Smoother, found: list[Evaluation], *, rejected: NDArray[np.bool_]
) -> Residuals:
    """Return the residuals of all measurements, table by table, in the files' order.

    Parameters
    ----------
    smoother
        For the families, the path and the estimate.
    found
        All families' evaluations at the estimate.
    rejected
        Shape (n,): outliers.
    """
    path, values = smoother.problem.path, smoother.solution.values
    parts: list[list[NDArray[Any]]] = []
    for index, (family, out) in enumerate(
        zip(smoother.families, smoother.split(rejected), strict=True)
    ):
        told = family.report(path, values, found[index])
        reference = np.full(len(family), -1) if family.reference is None else family.reference
        weight = _weights(smoother, found[index], index)
        order = np.argsort(family.line, kind="stable")
        exists = told.exists[order]

        def pick(
            column: NDArray[Any],
            order: NDArray[np.int64] = order,
            exists: NDArray[np.bool_] = exists,
        ) -> NDArray[Any]:
            own = column[order]
            return np.asarray(
                (own if own.ndim == 2 else np.repeat(own[:, None], exists.shape[1], axis=1))[exists]
            )

        shape = told.exists.shape
        parts.append(
            [
                pick(family.time_s),
                pick(family.sensor),
                pick(reference),
                pick(np.broadcast_to(np.array(told.kinds), shape)),
                pick(np.broadcast_to(np.array(told.units), shape)),
                pick(told.measured),
                pick(told.predicted),
                pick(told.measured - told.predicted),
                pick(told.sigma),
                pick(told.normalised),
                pick(weight),
                pick(out),
                pick(family.line),
            ]
        )
    return Residuals(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


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
        owner = problem.states.owner(column, names)
        result.setdefault(owner, {})[state.name] = SensorEstimate(
            state.unit, float(values.constants[column] * state.sigma), sigma * state.sigma,
            state.sigma,
        )  # fmt: skip
    size = values.path.shape[1]
    found = force_estimates(
        problem.motion, values.path[-1], marginals.knots[-1], problem.path_scale
    )
    for owner, entries in found.items():
        result.setdefault(owner, {}).update(entries)
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
    weak: WeakDirections,
    status: Status,
) -> dict[str, Any]:
    problem, solution = smoother.problem, smoother.solution
    families = smoother.families
    square = 0.0
    square += sum(
        float(np.sum(part.residual[~own] ** 2))
        for part, own in zip(found, smoother.split(out), strict=False)
    )
    square += sum(float(np.sum(part.residual**2)) for part in found[len(families) :])
    shared = sum(part.common.cost for part in found if part.common is not None)
    prior = 2.0 * (problem.prior_cost(solution.values) + shared)
    lost = int(sum(f.row_counts[own].sum() for f, own in _zipped(smoother, out)))
    # The first knot's states, those of platforms included, have no prior to speak of.
    free = 3 * problem.motion.order + 6 * len(problem.states.platforms)
    freedom = max(problem.measurement_rows - lost - free, 0)
    noise = problem.motion.density
    told = [*_flagged(track), *_misfits(smoother, track, out), *_correlated(smoother, out)]
    return {
        "name": track.recording.name,
        "status": str(status),
        "message": _message(status, smoother.iterations, weak.sentences),
        "iterations": smoother.iterations,
        "cost": solution.cost,
        "chi2": square + prior,
        "degrees_of_freedom": freedom,
        "measurements": sum(map(len, families))
        + sum(f.row_count for f in problem.families[len(families) :]),
        "rejected": _rejected(smoother, found, out),
        "weakly_observed": weak.sentences,
        "directions": [asdict(direction) for direction in weak.directions],
        "gaussian": {
            "holds": not weak.curved,
            "reason": weak.curved or None,
            "rise_at_one_sigma": weak.curvature,
        },
        "resets": reset_facts(smoother, track),
        "hypotheses": [entry.facts(track.frame) for entry in smoother.hypotheses],
        "flagged_sensors": [
            *(told or _misfit_in_all(smoother, square + prior, freedom)),
            *diagnose(smoother, out),
        ],
        "sensors": _per_sensor(smoother, track, out),
        "motion": problem.motion.name,
        "process_noise": None if problem.motion.static else list(noise.axes),
        "process_noise_along": noise.along,
        "stages": _stages(problem),
        "loss": smoother.settings.loss,
        "knots": int(problem.knots_s.size),
        "spacing_s": track.settings.spacing_s,
        "interpolation": _interpolation(smoother),
        "first_guess": _guesses(smoother),
    }


def _stages(problem: Problem) -> list[dict[str, Any]]:
    """Return the process noise of every stage, if there are several."""
    stages = problem.stages
    if stages is None:
        return []
    low, high = float(problem.knots_s[0]), float(problem.knots_s[-1])
    edges = np.clip(np.concatenate([[low], stages.from_s, [high]]), low, high)
    found = []
    for first, last, times in zip(edges[:-1], edges[1:], stages.times.tolist(), strict=True):
        noise = problem.motion.density.scaled(times)
        if last > first:
            found.append(
                {
                    "from_s": float(first),
                    "to_s": float(last),
                    "process_noise": list(noise.axes),
                    "process_noise_along": noise.along,
                }
            )
    return found


def _unknown_ground(smoother: Smoother) -> list[str]:
    """Say so where the path is held to ground whose height the raster does not have."""
    times = off_terrain(smoother.problem, smoother.solution.values)
    terrain = smoother.prepared.recording.terrain
    if not times.size or terrain is None:
        return []
    return [
        f"at t = {times[0]:.6g} s the object is where {terrain.raster.name} has no height, outside "
        f"of it or in a gap; it covers {terrain.extent_text()}: get a larger or a whole raster"
    ]


def _too_few_left(smoother: Smoother, out: NDArray[np.bool_]) -> str | None:
    """Say so where outliers leave nothing to check the path with, or cannot be told apart."""
    rows = np.concatenate([family.row_counts for family in smoother.families])
    what = _what(smoother)
    if smoother.undecided:
        return (
            f"the {what} contradict each other, and too few agree to tell which are wrong; more "
            f"sensors or more {what} are needed"
        )
    if out.any() and rows[~out].sum() <= 3 * smoother.problem.motion.order:
        return (
            f"{int(out.sum())} of {out.size} {what} do not fit, and the others are too few to "
            "check the path with"
        )
    return None


def _what(smoother: Smoother) -> str:
    """Name what was measured, for sentences."""
    names = {family.name.replace("_", " ") for family in smoother.families}
    return names.pop() if len(names) == 1 else "measurements"


def _zipped(
    smoother: Smoother, column: NDArray[Any]
) -> Iterator[tuple[SensorFamily, NDArray[Any]]]:
    return zip(smoother.families, smoother.split(column), strict=True)


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


def outliers(smoother: Smoother, found: list[Evaluation]) -> NDArray[np.bool_]:
    """Return which measurements do not belong, shape (n,): left out, or far off under a loss.

    Parameters
    ----------
    smoother
        After its run.
    found
        All families' evaluations at the estimate.
    """
    if smoother.problem.loss.name == "none":
        return smoother.rejected
    square = _squares(smoother, found)
    rows = np.concatenate([family.row_counts for family in smoother.families])
    return np.asarray(smoother.rejected | (square > thresholds(square, rows, smoother.group)))


def _squares(smoother: Smoother, found: list[Evaluation]) -> NDArray[np.float64]:
    """Return squared whitened residuals of all measurements, shape (n,)."""
    pairs = zip(smoother.families, found, strict=False)
    return np.concatenate([family.squares(part) for family, part in pairs])


def _rejected(
    smoother: Smoother, found: list[Evaluation], out: NDArray[np.bool_]
) -> list[dict[str, Any]]:
    """Name every rejected measurement, with its residual in sigmas."""
    names = smoother.prepared.recording.sensor_names
    squares = smoother.split(_squares(smoother, found))
    listed = []
    for (family, own), square in zip(_zipped(smoother, out), squares, strict=True):
        for index in np.flatnonzero(own):
            entry = {
                "table": family.name,
                "sensor": names[family.sensor[index]],
                "time_s": float(family.time_s[index]),
                "line": int(family.line[index]),
                "normalised": float(np.sqrt(square[index])),
            }
            if family.reference is not None:
                entry["reference"] = names[family.reference[index]]
            listed.append(entry)
    return listed


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
    return sentences


def _misfits(smoother: Smoother, track: Track, out: NDArray[np.bool_]) -> list[str]:
    """Name every sensor whose residuals are wider than stated, beyond chance and by much."""
    residuals = track.residuals
    sentences = []
    sensor = np.concatenate([family.sensor for family in smoother.families])
    for index, name in enumerate(track.recording.sensor_names):
        kept = residuals.normalised[(residuals.sensor == index) & ~residuals.rejected]
        square = float(np.sum(kept**2))
        if square > max(
            _MISFIT**2 * kept.size, float(chi_square.exceeded(_MISFIT_CHANCE, kept.size))
        ):
            own = (sensor == index) & ~out
            # Where measurements count as so few, it has been allowed for.
            small = _worth(smoother, own) * square > own.sum() * kept.size
            sentences.append(
                f"{name}: residuals are {np.sqrt(square / kept.size):.3g} times their sigmas; its "
                "sigmas, its errors or the motion model do not fit"
                + (", and covariances are too small" if small else "")
            )
    return sentences


def _correlated(smoother: Smoother, out: NDArray[np.bool_]) -> list[str]:
    """Name every sensor whose measurements count as fewer, for their errors are correlated."""
    sentences = []
    sensor = np.concatenate([family.sensor for family in smoother.families])
    for index, name in enumerate(smoother.prepared.recording.sensor_names):
        kept = (sensor == index) & ~out
        count, worth = int(kept.sum()), _worth(smoother, kept)
        if worth < count:
            sentences.append(
                f"{name}: its errors are alike for a while; its {count} measurements count as "
                f"{worth:.3g} independent ones"
            )
    return sentences


def _misfit_in_all(smoother: Smoother, chi2: float, freedom: int) -> list[str]:
    """Say that everything together fits worse than stated, beyond chance and by much.

    A loss keeps outliers, which count in full.
    """
    plain = smoother.settings.loss in ("auto", "gnc", "none")
    wide = freedom > 0 and chi2 > _MISFIT_IN_ALL * freedom
    if not (plain and wide and chi2 > float(chi_square.exceeded(_MISFIT_CHANCE, freedom))):
        return []
    return [
        f"all sensors: chi-square is {chi2 / freedom:.3g} times its degrees of freedom; some sigma "
        "is too small, some error has no prior or the motion model does not fit, and covariances "
        "are too small"
    ]


def _per_sensor(
    smoother: Smoother, track: Track, out: NDArray[np.bool_]
) -> dict[str, dict[str, Any]]:
    residuals = track.residuals
    result = {}
    sensor = np.concatenate([family.sensor for family in smoother.families])
    reference = np.concatenate(
        [
            np.full(len(family), -1) if family.reference is None else family.reference
            for family in smoother.families
        ]
    )
    for index, name in enumerate(track.recording.sensor_names):
        own = residuals.sensor == index
        kept = own & ~residuals.rejected
        measured = sensor == index
        entry: dict[str, Any] = {
            "measurements": int(measured.sum()),
            "rejected": int(out[measured].sum()),
            "as_reference": int((reference == index).sum()),
            "worth": _worth(smoother, measured & ~out),
            "rms_normalised": float(np.sqrt(np.mean(residuals.normalised[kept] ** 2)))
            if kept.any()
            else None,
        }
        for unit in np.unique(residuals.unit[kept]):
            size = np.abs(residuals.residual[kept & (residuals.unit == unit)])
            entry[f"median_residual_{unit.lower()}"] = float(np.median(size))
        result[name] = entry
    return result


def _worth(smoother: Smoother, kept: NDArray[np.bool_]) -> float:
    """Return how many independent measurements some count as."""
    return float(kept.sum() if smoother.worth is None else smoother.worth[kept].sum())


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
        fit, cost = smoother.attempts[index].fit, smoother.attempts[index].solution.cost
        clocks = {names[i]: float(fit.clock_s[i]) for i in np.flatnonzero(fit.clock_s)}
        return {"cost": cost, "clock_offsets_s": clocks, "behind_sensors": fit.behind}

    return {
        "chosen": describe(0),
        "others": [describe(index) for index in range(1, len(smoother.attempts))],
    }
