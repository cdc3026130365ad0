"""From rows to a chain: the first time by the batch smoother, later from an estimate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.interpolate import make_interp_spline

from geograph.errors import InputError
from geograph.families import Values
from geograph.incremental.chain import Chain, Piece
from geograph.incremental.model import Model
from geograph.incremental.rows import CONSTRAINTS, FIXES, TABLES, join, numbered, numbered_table
from geograph.knots import NEGLIGIBLE, automatic_spacing, ignored_share, thinned
from geograph.measurements import Constraints
from geograph.motion import Density, Motion
from geograph.prepare import prepare
from geograph.problem import Problem
from geograph.report import make_track
from geograph.rivals import read_attempt
from geograph.smoother import Smoother
from geograph.solver import Status, solve
from geograph.states import SensorStates
from geograph.sweep import NotPositiveDefiniteError
from geograph.time_shift import time_shift

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.families import Family
    from geograph.incremental.rows import Rows
    from geograph.initialise import PathFit
    from geograph.knots import Resolution
    from geograph.recording import Recording, SmoothSettings
    from geograph.rivals import Attempt
    from geograph.track import Track


# Predicted decrease of the cost that a solve may leave: 0.03 posterior sigmas from the minimum.
_CLOSE_ENOUGH = 5e-4


# Below so many different times nothing is known of how close knots must be.
_FEWEST_TIMES = 4


class NotStartedError(Exception):
    """The measurements so far do not determine a path; the message says what is missing.

    Parameters
    ----------
    message
        What is missing.
    rivals
        The paths that fit, where there are several.
    """

    def __init__(self, message: str, rivals: Sequence[PathFit] = ()) -> None:
        self.rivals = tuple(rivals)
        super().__init__(message)


@dataclass(frozen=True, eq=False)
class Started:
    """A chain that has started.

    Attributes
    ----------
    model, chain
        The model and the chain.
    attempts
        What the first guesses led to, the best first.
    resolution
        What the measurements resolve.
    """

    model: Model
    chain: Chain
    attempts: list[Attempt]
    resolution: Resolution


def recording_of(template: Recording, rows: Rows, whole: Rows) -> Recording:
    """Return a recording of rows, whose lines are their own numbers."""
    tables: dict[str, Any] = {
        kind: numbered_table(kind, rows[kind]) for kind in TABLES if kind in rows
    }
    parts = [(kind, held[kind]) for held in (rows, whole) for kind in CONSTRAINTS if kind in held]
    constraints = None
    if parts:
        columns = {
            name: np.concatenate([part[name] for _, part in parts])
            for name in ("time_s", "value", "sigma")
        }
        constraints = Constraints(
            kind=tuple(kind for kind, part in parts for _ in part["value"]),
            line=np.concatenate([part["ident"] for _, part in parts]),
            **columns,
        )
    return replace(template, constraints=constraints, **tables)


def begin(
    template: Recording,
    settings: SmoothSettings,
    rows: Rows,
    whole: Rows,
    *,
    strict: bool = True,
    guesses: Sequence[PathFit] = (),
) -> Started:
    """Return a chain through measurements, from a first guess.

    Parameters
    ----------
    template
        Recording without measurements.
    settings
        How it is smoothed.
    rows, whole
        The measurements, and what holds along the whole path.
    strict
        Whether a path that the measurements do not determine is refused.
    guesses
        First guesses to start from; empty: they are found.

    Raises
    ------
    NotStartedError
        If the measurements do not determine a path.
    """
    try:
        recording = recording_of(template, rows, whole)
        prepared = prepare(recording)
    except InputError as error:
        raise NotStartedError(error.reason) from error
    _enough(recording, settings)
    smoother = Smoother(prepared, settings, guesses)
    try:
        # Of a few measurements anything may overflow; what comes of it is judged by its status.
        with np.errstate(all="ignore"):
            smoother.run()
            track = make_track(smoother, seconds=0.0)
    except (ArithmeticError, ValueError, IndexError, MemoryError) as error:
        raise NotStartedError(f"no first guess yet ({error})") from error
    status = track.status
    if status is not Status.CONVERGED and (strict or smoother.solution.elimination is None):
        raise NotStartedError(str(track.summary["message"]), _paths(smoother))
    out: list[int] = []
    for family, bad in zip(smoother.families, smoother.split(smoother.rejected), strict=True):
        out += family.line[bad].tolist()
    for kind, columns in rows.items():
        own = np.isin(columns["ident"], out)
        rows = rows | {kind: columns | {"kept": ~own, "judged": own}}
    problem = smoother.problem
    # How long a feed has run says nothing of an object that stands still.
    spacing = settings.spacing_s or automatic_spacing(
        problem.motion, problem.states, smoother.resolution, ends=not problem.motion.static
    )
    model = make_model(template, smoother, rows, whole, spacing_s=spacing)
    values = _mapped(smoother, model)
    knots = problem.knots_s
    if knots.size == 1:
        # An object that stands still: the same state at both ends of what was measured.
        _, times = smoother.emissions()
        knots = np.array([times.min(), max(times.max(), times.min() + 1e-3)])
        values = Values(np.repeat(values.path, 2, axis=0), np.zeros((2, 0)), values.constants)
    fixes = fixes_between(model, *recording.time_span_s)
    try:
        chain = make_chain(model, knots, values, join([rows, fixes]) if fixes else rows)
    except NotPositiveDefiniteError as error:
        raise NotStartedError(_undetermined(track)) from error
    return Started(model, chain, smoother.attempts, smoother.resolution)


def _paths(smoother: Smoother) -> list[PathFit]:
    """Return the estimate and what other first guesses led to, where there are rivals."""
    if not smoother.rivals:
        return []
    problem, attempts = smoother.problem, smoother.attempts
    paths = [smoother.solution.values.path]
    paths += [read_attempt(attempt, problem).path for attempt in attempts[1:]]
    degree = min(3, problem.knots_s.size - 1)
    return [
        replace(attempt.fit, spline=make_interp_spline(problem.knots_s, path[:, :3], k=degree))
        for attempt, path in zip(attempts, paths, strict=True)
        if degree > 0
    ]


def _undetermined(track: Track) -> str:
    """Say what a path leaves open that a batch just determines, and a feed does not."""
    weak = [str(sentence) for sentence in track.summary["weakly_observed"]]
    sigma = float(np.sqrt(np.max(np.linalg.eigvalsh(track.position_covariance_m2)[:, -1])))
    what = "; ".join(weak) or f"the 1-sigma of a position is up to {sigma:.3g} m"
    return (
        f"the measurements so far determine the path to no working precision ({what}); more of "
        "them, another sensor or a constraint on the height would"
    )


def _enough(recording: Recording, settings: SmoothSettings) -> None:
    """Refuse measurements that cannot determine a path, whatever they are."""
    order = Motion(settings.motion, Density.of(1.0), recording.frame).order
    scalars = sum(
        2 * len(table) if name == "bearings" else len(table)
        for name, table in recording.tables.items()
    )
    times = np.unique(np.concatenate([table.time_s for table in recording.tables.values()])).size
    fewest = 1 if settings.motion == "static" else _FEWEST_TIMES
    if scalars < 3 * order or times < fewest:
        raise NotStartedError(
            f"{scalars} measured values at {times} times; a {settings.motion} path needs at least "
            f"{3 * order} at {fewest} times"
        )


def fixes_between(model: Model, low: float, high: float) -> Rows:
    """Return the platforms' fixes from the one before ``low`` to the one after ``high``."""
    parts: list[Rows] = []
    for number, platform in enumerate(model.prepared.states.platforms):
        time = platform.time_s
        first = max(int(np.searchsorted(time, low, side="right")) - 1, 0)
        last = min(int(np.searchsorted(time, high, side="left")) + 1, time.size)
        index = np.arange(first, last)
        columns: dict[str, NDArray[Any]] = {
            "time_s": time[index],
            "platform": np.full(index.size, number),
            "index": index,
            "line": np.zeros(index.size, dtype=np.int64),
        }
        parts.append({FIXES: numbered(columns, 0)})
    return join(parts) if parts else {}


def make_model(
    template: Recording, smoother: Smoother, rows: Rows, whole: Rows, *, spacing_s: float
) -> Model:
    """Return the model of a solved batch, with the states of all sensors that may yet measure."""
    problem, prepared = smoother.problem, smoother.prepared
    sensors = prepared.sensors
    every = list(range(len(sensors)))
    states = SensorStates(
        sensors, every, prepared.states.reference_s, template.propagation_sigma_m_s
    )
    span = prepared.span_s
    table = prepared.recording.frequency_differences
    between = (
        smoother.settings.spacing_s is not None
        and ignored_share(problem.motion, spacing_s, smoother.resolution) > NEGLIGIBLE
    )
    model = Model(
        prepared=replace(
            prepared,
            recording=template,
            bearings=None,
            states=states,
            walk_scale=states.chain_scale(span),
            shift=None,
        ),
        motion=problem.motion,
        prior=problem.prior,
        path_scale=problem.path_scale,
        loss=problem.loss,
        shift=None,
        spacing_s=min(spacing_s, problem.motion.longest_step_s),
        between=between,
        carrier_hz=None if table is None else float(np.median(table.carrier_hz)),
        whole=whole,
        since_s=float(problem.knots_s[0]),
        whole_s=max(float(np.ptp(problem.knots_s)), 1e-3),
    )
    return with_rows(model, rows)


def with_rows(model: Model, rows: Rows) -> Model:
    """Return a model with rows counted, and the clocks' common time of all that measured."""
    prepared, size = model.prepared, len(model.prepared.sensors)
    counts, seen = dict(model.counts), set()
    timed = model.timed
    for kind, columns in rows.items():
        if kind in TABLES:
            if model.correlated:
                added = np.bincount(columns["sensor"], minlength=size)
                counts[kind] = counts[kind] + added if kind in counts else added
            seen.update(columns["sensor"].tolist())
            if "reference" in columns:
                seen.update(columns["reference"].tolist())
        elif kind in CONSTRAINTS:
            timed = timed or bool(np.isfinite(columns["time_s"]).any())
    active = model.active | seen
    if len(active) == len(model.active) and timed == model.timed:
        # The same model, with what it has worked out already, unless it counts.
        return replace(model, counts=counts) if model.correlated else model
    shift = None
    if not model.motion.static and not timed:
        shift = time_shift(prepared.states, prepared.sensors, sorted(active), None)
    return replace(model, counts=counts, active=frozenset(active), timed=timed, shift=shift)


def _mapped(smoother: Smoother, model: Model) -> Values:
    """Return a batch's estimate in the states of all sensors."""
    values, own, every = smoother.solution.values, smoother.problem.states, model.prepared.states
    constants = np.zeros(every.size)
    place = {(s.sensor, s.channel, s.drift, s.stretch): i for i, s in enumerate(every.constants)}
    for i, s in enumerate(own.constants):
        constants[place[s.sensor, s.channel, s.drift, s.stretch]] = values.constants[i]
    chains = np.zeros((values.path.shape[0], every.chains))
    for i, walk in enumerate(own.walks):
        chains[:, every.walk_column[walk.sensor, walk.channel]] = values.walks[:, i]
    for platform in own.platforms:
        a, b = own.platform_column[platform.sensor], every.platform_column[platform.sensor]
        chains[:, b : b + 6] = values.walks[:, a : a + 6]
    return Values(values.path, chains, constants)


def make_chain(model: Model, knots_s: NDArray[np.float64], values: Values, rows: Rows) -> Chain:
    """Return a chain linearised at an estimate.

    Parameters
    ----------
    model
        The model.
    knots_s, values
        Its knots, at least two, and the estimate.
    rows
        All measurements.
    """
    layout = model.layout
    d, m, s = layout.knot, layout.path, layout.constants
    ratio = model.path_scale / model.prior.sigma
    start = model.prepared.states.chain_start_sigma()
    forward = np.zeros((d, d + s + 1))
    np.fill_diagonal(forward, np.concatenate([ratio**2, start**-2.0]))
    behind = (values.path[0] - model.prior.mean) / model.prior.sigma
    forward[:, -1] = np.concatenate([ratio * behind, values.walks[0] / start**2])
    other = np.eye(s + 1)
    other[:-1, -1] = other[-1, :-1] = values.constants
    count = knots_s.size - 1
    chain = Chain(
        scale=np.concatenate([model.path_scale, np.ones(d - m)]),
        size=m,
        knots_s=knots_s.tolist(),
        reference_path=list(values.path),
        reference_chains=list(values.walks),
        reference=values.constants,
        path=list(values.path),
        chains=list(values.walks),
        constants=values.constants,
        pieces=[empty_piece(model) for _ in range(count)],
        forward=[forward],
        other=[other],
        hold=held_shift(model, values.constants),
    )
    chain.pieces[0] = replace(chain.pieces[0], rows=rows)
    model.linearise(chain, range(count))
    chain.eliminate()
    return chain


def held_shift(model: Model, constants: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the row that holds the clocks' common time, as a block about given constants."""
    size = constants.size
    block = np.zeros((size + 1, size + 1))
    if model.shift is not None:
        model.shift.add(block, slice(0, size), constants)
    return block


def empty_piece(model: Model) -> Piece:
    """Return a piece that has yet to be linearised."""
    layout = model.layout
    none = np.empty(0)
    block = np.zeros((layout.width, layout.width))
    return Piece({}, block, none, none, none, none, none, none)


def problem_of(model: Model, knots_s: NDArray[np.float64], rows: Rows) -> Problem:
    """Return the batch problem of rows, over given knots."""
    families: list[Family] = []
    weights: list[NDArray[np.float64] | None] = []
    for _, columns, family in model.families(rows):
        order = getattr(family, "order", None)
        kept = columns["kept"] if order is None else columns["kept"][order]
        families.append(family)
        weights.append(None if kept.all() else kept.astype(np.float64))
    steps = np.diff(knots_s)
    share = 0.5 * (np.append(steps, 0.0) + np.append(0.0, steps)) / steps.sum()
    whole = model.whole_families(knots_s, share)
    return Problem(
        motion=model.motion,
        knots_s=knots_s,
        families=[*families, *whole],
        states=model.prepared.states,
        walk_scale=model.prepared.walk_scale,
        prior=model.prior,
        path_scale=model.path_scale,
        loss=model.loss,
        weights=[*weights, *(None for _ in whole)],
        shift=model.shift,
    )


def again(
    model: Model, knots_s: NDArray[np.float64], values: Values, rows: Rows, *, limit: int
) -> Chain:
    """Return a chain through rows, solved for by Levenberg-Marquardt from an estimate.

    Parameters
    ----------
    model
        The model.
    knots_s, values
        Knots and estimate.
    rows
        All measurements.
    limit
        Of the iterations.

    Raises
    ------
    FloatingPointError
        If it does not converge.
    SpanError
        If signals were emitted beyond the knots.
    """
    problem = problem_of(model, knots_s, rows)
    for _ in range(3):
        for family in problem.families:
            model.refresh(family, problem.path, values)
        solution = solve(problem, values, max_iterations=limit)
        if solution.status is not Status.CONVERGED and not _at_minimum(problem, solution.values):
            raise FloatingPointError(f"a solve for all that is held ended as {solution.status}")
        before, values = values, solution.values
        if not model.refreshed or np.allclose(before.path, values.path, rtol=1e-12, atol=1e-6):
            break
    span = float(np.ptp(knots_s))
    model = replace(model, since_s=float(knots_s[0]), whole_s=span)
    return make_chain(model, knots_s, values, rows)


def _at_minimum(problem: Problem, values: Values) -> bool:
    """Tell whether an estimate is where rounding hides what is left to the minimum."""
    try:
        left = problem.linearise(values).factorise().solve().decrease
    except NotPositiveDefiniteError:
        return False
    return bool(left <= _CLOSE_ENOUGH)


def stretched(
    model: Model, chain: Chain, low_s: float, high_s: float
) -> tuple[NDArray[np.float64], Values]:
    """Return knots that reach from ``low_s`` to ``high_s``, and the estimate carried on to them.

    Without those that are too near to one another, as the newest may be to the one before.
    """
    held = np.array(chain.knots_s)
    values = chain.values(0, held.size - 1)
    if model.motion.static:
        # One place, of which old knots hold older estimates.
        values = replace(values, path=np.repeat(values.path[-1:], held.size, axis=0))
    parts = [held]
    if low_s < held[0]:
        count = max(int(np.ceil((held[0] - low_s) / model.spacing_s)), 1)
        parts.insert(0, np.linspace(low_s, held[0], count + 1)[:-1])
    if high_s > held[-1]:
        count = max(int(np.ceil((high_s - held[-1]) / model.spacing_s)), 1)
        parts.append(np.linspace(held[-1], high_s, count + 1)[1:])
    knots = np.concatenate(parts)
    if not model.motion.static:
        knots = thinned(knots, model.spacing_s, model.motion.longest_step_s)
    path = model.motion.read(model.motion.path(held), values.path, knots)
    chains = [np.interp(knots, held, column) for column in values.walks.T]
    walks = np.stack(chains, axis=1) if chains else np.zeros((knots.size, 0))
    return knots, Values(path, walks, values.constants)
