"""The plain GTSAM graph of a problem, from the same families and motions as the batch engine.

Keys: ``x0, x1, ...`` for the knots (path, then walks), ``s0, s1, ...`` for the constant states of
each sensor. Values are scaled deviations: path components over ``scale``, walks over theirs, sensor
states over their prior sigmas, so that every unknown is of order one (states in SI units differ by
fourteen orders of magnitude). :class:`GtsamGraph` converts both ways.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import gtsam
import numpy as np

from geograph.common import project, settled
from geograph.errors import InputError
from geograph.factors.adapter import vector_factor
from geograph.families import Values

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from geograph.common import Common
    from geograph.families import Evaluation, Family
    from geograph.path import Path
    from geograph.problem import Problem
    from geograph.recording import Recording, SmoothSettings

Stacking = Literal["interval", "measurement"]


@dataclass(frozen=True, eq=False)
class GtsamGraph:
    """A problem as a GTSAM graph.

    ``graph, values = geograph.build(recording)`` unpacks it.

    Attributes
    ----------
    graph
        ``gtsam.NonlinearFactorGraph``.
    values
        ``gtsam.Values``: the first guess.
    problem
        The problem it came from.
    origin
        Point that the scaled deviations are counted from.
    """

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    problem: Problem
    origin: Values

    def __iter__(self) -> Iterator[Any]:
        return iter((self.graph, self.values))

    def encode(self, values: Values) -> gtsam.Values:
        """Return an estimate as GTSAM values."""
        encoded = gtsam.Values()
        scaled = (values.path - self.origin.path) / self.problem.path_scale
        for k, row in enumerate(np.concatenate([scaled, values.walks], axis=1)):
            encoded.insert(knot_key(k), row)
        for sensor, columns in _columns(self.problem).items():
            encoded.insert(sensor_key(sensor), values.constants[columns])
        return encoded

    def decode(self, encoded: gtsam.Values) -> Values:
        """Return GTSAM values as an estimate in SI units."""
        count, m = self.origin.path.shape
        rows = np.stack([encoded.atVector(knot_key(k)) for k in range(count)])
        constants = np.zeros(self.problem.states.size)
        for sensor, columns in _columns(self.problem).items():
            constants[columns] = encoded.atVector(sensor_key(sensor))
        path = self.origin.path + rows[:, :m] * self.problem.path_scale
        return Values(path, rows[:, m:], constants)

    def ordering(self) -> gtsam.Ordering:
        """Return the ordering in time, sensors last."""
        ordering = gtsam.Ordering()
        for k in range(self.origin.path.shape[0]):
            ordering.push_back(knot_key(k))
        for sensor in _columns(self.problem):
            ordering.push_back(sensor_key(sensor))
        return ordering


def knot_key(index: int) -> int:
    """Return the GTSAM key of a knot."""
    return int(gtsam.symbol("x", index))


def sensor_key(index: int) -> int:
    """Return the GTSAM key of a sensor's constant states."""
    return int(gtsam.symbol("s", index))


def _columns(problem: Problem) -> dict[int, list[int]]:
    sensors = sorted({state.sensor for state in problem.states.constants})
    return {sensor: problem.states.of_sensor(sensor) for sensor in sensors}


def build(
    recording: Recording,
    settings: SmoothSettings | None = None,
    *,
    stacking: Stacking = "interval",
    **changes: Any,
) -> GtsamGraph:
    """Return the plain GTSAM graph of a recording, with its first guess.

    Parameters
    ----------
    recording
        Measurements and sensors.
    settings, **changes
        As in :func:`geograph.smooth`. A loss applies to whole measurements inside the factors;
        ``"auto"`` and ``"gnc"``, which reject measurements after a solve, are plain least squares
        here. A process noise of ``"auto"`` is that of the first guess.
    stacking
        ``"interval"``: one factor for all measurements between two knots; ``"measurement"``: one
        each.

    Returns
    -------
    graph
        Unpacks to ``(graph, values)``; converts estimates to SI units.

    Raises
    ------
    InputError
        If the recording has no measurement, a setting is wrong, or the motion is static with random
        walks (whose path has no noise that GTSAM could whiten).
    """
    from geograph.smoother import first_problem

    problem, values = first_problem(recording, (settings or recording.settings).replace(**changes))
    return graph_of(problem, values, stacking=stacking)


def graph_of(problem: Problem, values: Values, *, stacking: Stacking = "interval") -> GtsamGraph:
    """Return the GTSAM graph of a problem; see :func:`build`.

    Parameters
    ----------
    problem
        Any problem of the batch engine.
    values
        First guess; also the origin of the scaled deviations.
    stacking
        See :func:`build`.
    """
    if problem.motion.static and problem.knots_s.size > 1:
        raise InputError(
            "a static object with random walks has no process noise that GTSAM could whiten; "
            "use constant-position with a small process_noise"
        )
    if any(platform.process_noise == 0.0 for platform in problem.states.platforms):
        raise InputError(
            "a platform_process_noise of 0 leaves no noise that GTSAM could whiten; give it a "
            "small positive value"
        )
    graph = gtsam.NonlinearFactorGraph()
    built = GtsamGraph(graph, gtsam.Values(), problem, values)
    for factor in _prior_factors(problem, values):
        graph.push_back(factor)
    for factor in _transition_factors(problem, values):
        graph.push_back(factor)
    for family, weight in zip(problem.families, problem.weights, strict=True):
        for factor in _measurement_factors(problem, values, family, weight, stacking):
            graph.push_back(factor)
    return GtsamGraph(graph, built.encode(values), problem, values)


def _prior_factors(problem: Problem, origin: Values) -> Iterator[gtsam.NonlinearFactor]:
    start, sigma = problem.start_prior(origin)
    yield gtsam.PriorFactorVector(knot_key(0), start, gtsam.noiseModel.Diagonal.Sigmas(sigma))
    for sensor, columns in _columns(problem).items():
        count = len(columns)
        yield gtsam.PriorFactorVector(
            sensor_key(sensor), np.zeros(count), gtsam.noiseModel.Unit.Create(count)
        )


def _transition_factors(problem: Problem, origin: Values) -> Iterator[gtsam.NonlinearFactor]:
    """Yield one factor for every pair of neighbouring knots: path and walks together."""
    d, m = problem.layout.knot, problem.layout.path
    chain, roots = problem.chains()
    for k, step in enumerate(problem.steps_s):

        def function(
            vectors: list[NDArray[np.float64]],
            jacobian: bool,
            k: int = k,
            step: float = float(step),
            begin: float = float(problem.knots_s[k]),
        ) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
            both = np.stack(vectors)
            path = origin.path[k : k + 2] + both[:, :m] * problem.path_scale
            found = problem.motion.transitions(path, np.array([step]), np.array([begin]))
            times = 1.0 if problem.noise_times is None else problem.noise_times[k]
            whiten = np.linalg.inv(roots[k])
            walk = whiten @ (both[1, m:] - chain[k] @ both[0, m:])
            value = np.concatenate([found.residual[0] / times, walk])
            if not jacobian:
                return value, []
            by_second = np.zeros((d, d))
            by_second[:m, :m] = np.linalg.inv(times * found.noise_root[0]) * problem.path_scale
            by_second[m:, m:] = whiten
            scaled = found.transition[0] * problem.path_scale / problem.path_scale[:, None]
            by_first = np.zeros((d, d))
            by_first[:m, :m] = -by_second[:m, :m] @ scaled
            by_first[m:, m:] = -whiten @ chain[k]
            return value, [by_first, by_second]

        yield vector_factor([knot_key(k), knot_key(k + 1)], [d, d], d, function)


def _measurement_factors(
    problem: Problem,
    origin: Values,
    family: Family,
    weight: NDArray[np.float64] | None,
    stacking: Stacking,
) -> Iterator[gtsam.NonlinearFactor]:
    found = family.evaluate(
        problem.path, problem.path.at_state(origin.path, jacobian=False), origin, jacobian=False
    )
    interval = found.interval
    groups = [np.flatnonzero(interval == k) for k in np.unique(interval)]
    if stacking == "measurement":
        # What shares an unknown stays together.
        tied = np.arange(interval.size) if found.common is None else found.common.group
        groups = [np.flatnonzero(tied == k) for k in np.unique(tied)]
    for group in groups:
        part = None if weight is None else weight[group]
        if part is not None and not part.any():
            continue
        yield _stacked(problem, origin, family.subset(group), part, int(interval[group[0]]))


def _stacked(
    problem: Problem,
    origin: Values,
    family: Family,
    weight: NDArray[np.float64] | None,
    first: int,
) -> gtsam.CustomFactor:
    """Return one factor for all measurements of a family between two knots."""
    chained = problem.layout.chained
    d, m = problem.layout.knot, problem.layout.path
    window = slice(first, first + 2) if chained else slice(0, 1)
    path: Path = problem.motion.path(problem.knots_s[window])
    start = origin.path[window]
    knots = start.shape[0]
    touched = _touched(problem, family, path, Values(start, origin.walks[window], origin.constants))
    columns = {sensor: problem.states.of_sensor(sensor) for sensor in touched}
    keys = [knot_key(first + k) for k in range(knots)] + [sensor_key(s) for s in touched]
    sizes = [d] * knots + [len(entry) for entry in columns.values()]
    rows = family.rows * len(family)

    def function(
        vectors: list[NDArray[np.float64]], jacobian: bool
    ) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
        both = np.stack(vectors[:knots])
        constants = np.zeros(problem.states.size)
        for entry, vector in zip(columns.values(), vectors[knots:], strict=True):
            constants[entry] = vector
        values = Values(start + both[:, :m] * problem.path_scale, both[:, m:], constants)
        state = path.at_state(values.path, jacobian=jacobian)
        found = family.evaluate(path, state, values, jacobian=jacobian)
        found = settled(found, weight, problem.loss)
        square = np.einsum("ij,ij->i", found.residual, found.residual)
        cost, slope = problem.loss.value_and_weight(square)
        if weight is not None:
            cost, slope = weight * cost, weight * slope
        # An error whose square is the loss, and a derivative that gives the loss's own gradient:
        # GTSAM then finds the same minimum. Without a loss both factors are one.
        scale = np.sqrt(np.divide(cost, square, out=slope.copy(), where=square > 0.0))
        error = (found.residual * scale[:, None]).ravel()
        share = np.divide(slope, scale, out=np.zeros_like(slope), where=scale > 0.0)
        common = found.common
        if not jacobian:
            if common is not None:
                _project(error[:, None], common, share)
            return error, []
        dense = _dense_rows(problem, found) * np.repeat(share, family.rows)[:, None]
        if common is not None:
            both_columns = np.column_stack([dense, error])
            _project(both_columns, common, share)
            dense, error = both_columns[:, :-1], both_columns[:, -1]
        parts = [dense[:, k * d : (k + 1) * d] for k in range(knots)]
        offset = knots * d
        parts += [dense[:, [offset + column for column in entry]] for entry in columns.values()]
        return error, parts

    return vector_factor(keys, sizes, rows, function)


def _project(rows: NDArray[np.float64], common: Common, share: NDArray[np.float64]) -> None:
    """Eliminate the unknowns that measurements share from weighted rows, in place."""
    project(rows, common.by_common * share, common.group, common.start, common.information)


def _touched(problem: Problem, family: Family, path: Path, values: Values) -> list[int]:
    state = path.at_state(values.path, jacobian=True)
    found = family.evaluate(path, state, values, jacobian=True)
    columns = np.unique(found.constant_column)
    return sorted({problem.states.constants[column].sensor for column in columns})


def _dense_rows(problem: Problem, found: Evaluation) -> NDArray[np.float64]:
    """Return the rows of one interval's measurements, shape (n r, knots d + s), scaled."""
    assert found.by_knots is not None
    layout = problem.layout
    count, rows = found.residual.shape
    dense = np.zeros((count, rows, layout.width - 1))
    by_knots = found.by_knots * problem.path_scale
    dense[:, :, : layout.path] = by_knots[:, :, 0]
    if layout.chained:
        dense[:, :, layout.knot : layout.knot + layout.path] = by_knots[:, :, 1]
    dense[found.constant_row, :, layout.states + found.constant_column] = found.by_constants
    if found.walk_row.size:
        column = layout.path + found.walk_column
        columns = np.swapaxes(dense, 1, 2)
        before = found.by_walks * found.walk_before[:, None]
        after = found.by_walks * found.walk_after[:, None]
        np.add.at(columns, (found.walk_row, column), before)
        np.add.at(columns, (found.walk_row, column + layout.knot), after)
    return dense.reshape(count * rows, -1)
