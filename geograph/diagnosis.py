"""What is wrong with a sensor that does not fit: its clock, its place, its axes, its oscillator.

A sensor most of whose measurements were rejected, or whose residuals are far wider than stated, is
put back with one of its errors left open, and the whole problem is solved again from the estimate.
An error that makes its measurements fit is named with its size.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from geograph import chi_square
from geograph.families import Values
from geograph.losses import Loss
from geograph.prepare import prepare
from geograph.problem import Problem
from geograph.solver import Status, solve

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.smoother import Smoother
    from geograph.solver import Solution
    from geograph.states import SensorStates

# A sensor is examined where this share of its measurements was rejected, or where they are wider
# than stated by this factor.
_REJECTED_SHARE = 0.5
_WIDE = 3.0
_FEWEST = 3

# An error explains a sensor where its residuals are then this wide at most, and explains it no
# better than another one where their costs differ by less than this.
_EXPLAINED = 1.5
_EQUAL = 3.0

# Where nothing was rejected, a sensor is examined whose error is this many prior sigmas large, and
# named where its being wrong lowers the cost by this much.
_STRAIN = 3.0
_STRAIN_GAIN = 8.0
_ITERATIONS = 60


@dataclass(frozen=True)
class _Error:
    """One error that could be behind it: its fields in the sensor's errors, and its states."""

    label: str
    fields: tuple[str, ...]
    states: tuple[str, ...]
    tables: tuple[str, ...]


_RANGES = ("arrivals", "time_differences")
_EVERY = ("bearings", *_RANGES, "frequency_differences")
_ERRORS = (
    _Error("clock offset", ("clock_offset_s",), ("clock_offset",), ("bearings", *_RANGES)),
    _Error("position error", ("position_m",), ("position_x", "position_y", "position_z"), _EVERY),
    _Error(
        "angular bias",
        ("azimuth_bias_rad", "elevation_bias_rad"),
        ("azimuth_bias", "elevation_bias"),
        ("bearings",),
    ),
    _Error(
        "misalignment",
        ("misalignment_rad",),
        ("misalignment_x", "misalignment_y", "misalignment_z"),
        ("bearings",),
    ),
    _Error(
        "frequency offset",
        ("frequency_offset_hz",),
        ("frequency_offset",),
        ("frequency_differences",),
    ),
)


@dataclass(frozen=True, eq=False)
class _Explanation:
    """One error of one sensor that makes its measurements fit."""

    sensor: int
    gain: float
    text: str


def diagnose(smoother: Smoother, rejected: NDArray[np.bool_]) -> list[str]:
    """Return a sentence for every sensor that one error of its own explains.

    Parameters
    ----------
    smoother
        After its run.
    rejected
        Shape (n,): measurements found to be outliers.
    """
    if smoother.solution.status is not Status.CONVERGED:
        return []
    misfits = _misfits(smoother, rejected)
    sentences = []
    for index in misfits:
        found = _explanations(smoother, rejected, index)
        if found:
            sentences.append(_sentence(smoother, _complaint(smoother, rejected, index), found))
        elif rejected[_of_sensor(smoother, index)].all():
            name = smoother.prepared.recording.sensor_names[index]
            what = _complaint(smoother, rejected, index)
            sentences.append(f"{name}: {what}, and no single error of it explains them")
    if not misfits:
        # One sensor's error may have been spread over the states of all.
        found = [
            entry
            for index in _strained(smoother)
            for entry in _explanations(smoother, rejected, index)
            if entry.gain > _STRAIN_GAIN
        ]
        if found:
            sentences.append(_sentence(smoother, "sensor errors are beyond their priors", found))
    return sentences


def _complaint(smoother: Smoother, rejected: NDArray[np.bool_], index: int) -> str:
    own = _of_sensor(smoother, index)
    if rejected[own].any():
        return f"{int(rejected[own].sum())} of {int(own.sum())} measurements do not fit"
    return "residuals are far wider than stated"


def _sentence(smoother: Smoother, what: str, found: list[_Explanation]) -> str:
    """Name the explanations that are about as good as the best one."""
    names = smoother.prepared.recording.sensor_names
    found = sorted(found, key=lambda entry: -entry.gain)
    likely = [entry for entry in found if entry.gain > found[0].gain - _EQUAL]
    first = likely[0].sensor
    texts = [
        entry.text if entry.sensor == first else f"one of {names[entry.sensor]}: {entry.text}"
        for entry in likely
    ]
    return (
        f"{names[first]}: {what}; {', or '.join(texts)} would explain it: mend it, or allow for it "
        "in the sensor's errors"
    )


def _explanations(
    smoother: Smoother, rejected: NDArray[np.bool_], index: int
) -> list[_Explanation]:
    base = _reopened(smoother, rejected, index, None)
    if base is None:
        return []
    found = []
    for error in _ERRORS:
        explanation = _explain(smoother, rejected, index, error=error, before=base[1].cost)
        if explanation is not None:
            found.append(explanation)
    return found


def _strained(smoother: Smoother) -> list[int]:
    """Return the sensors with a constant error beyond what its prior allows."""
    states, values = smoother.problem.states, smoother.solution.values
    far = np.abs(values.constants) > _STRAIN
    sensors = {states.constants[column].sensor for column in np.flatnonzero(far)}
    return sorted(index for index in sensors if index >= 0)


def _of_sensor(smoother: Smoother, index: int) -> NDArray[np.bool_]:
    """Return which measurements a sensor had part in, shape (n,)."""
    parts = [
        (family.sensor == index)
        | (False if family.reference is None else family.reference == index)
        for family in smoother.families
    ]
    return np.concatenate(parts)


def _misfits(smoother: Smoother, rejected: NDArray[np.bool_]) -> list[int]:
    """Return the sensors that were mostly rejected, or are far wider than stated."""
    square = smoother.squares(smoother.problem, smoother.solution.values)
    found = []
    for index in range(len(smoother.prepared.sensors)):
        own = _of_sensor(smoother, index)
        if int(own.sum()) < _FEWEST:
            continue
        lost = float(rejected[own].mean())
        wide = float(np.median(square[own])) / float(chi_square.median(1))
        if lost >= _REJECTED_SHARE or wide > _WIDE**2:
            found.append((-max(lost, wide / (1.0 + wide)), index))
    # In differences a good sensor suffers from its partner: the worst ones alone are examined.
    found.sort()
    return [index for score, index in found if score <= 0.9 * found[0][0]]


def _reopened(
    smoother: Smoother, rejected: NDArray[np.bool_], index: int, error: _Error | None
) -> tuple[Problem, Solution] | None:
    """Solve with all measurements of one sensor, and one of its errors open."""
    recording = smoother.prepared.recording
    sensor = smoother.prepared.sensors[index]
    opened = sensor.errors
    if error is not None:
        wide = {name: _open_sigma(smoother, index, name) for name in error.fields}
        opened = replace(
            opened, **{name: max(value, getattr(opened, name)) for name, value in wide.items()}
        )
    sensors = dict(recording.sensors)
    sensors[sensor.name] = replace(sensor, errors=opened)
    prepared = prepare(replace(recording, sensors=sensors))
    old = smoother.problem
    kept = ~rejected | _of_sensor(smoother, index)
    problem = Problem(
        motion=old.motion,
        knots_s=old.knots_s,
        families=prepared.families(old.knots_s),
        states=prepared.states,
        walk_scale=prepared.walk_scale,
        prior=old.prior,
        path_scale=old.path_scale,
        loss=Loss("cauchy"),
        weights=smoother.weights(kept.astype(np.float64)),
        elimination=old.elimination,
        shift=None if old.motion.static else prepared.shift,
    )
    before = smoother.solution.values
    constants = _carried(old.states, prepared.states, before.constants)
    values = Values(before.path, before.walks, constants)
    problem.refresh(values)
    solution = solve(problem, values, max_iterations=_ITERATIONS)
    if solution.status is not Status.CONVERGED or solution.elimination is None:
        return None
    return problem, solution


def _explain(
    smoother: Smoother,
    rejected: NDArray[np.bool_],
    index: int,
    *,
    error: _Error,
    before: float,
) -> _Explanation | None:
    """Return one error of one sensor as an explanation; None if its measurements do not fit."""
    sensor = smoother.prepared.sensors[index]
    names = {family.name for family in smoother.families if _has(family, index)}
    fixes = sensor.platform_process_noise is not None and error.label == "position error"
    fixes |= sensor.axes != "body" and error.label == "misalignment"
    if fixes or not names & set(error.tables):
        return None
    reopened = _reopened(smoother, rejected, index, error)
    if reopened is None:
        return None
    problem, solution = reopened
    own = _of_sensor(smoother, index)
    # A bearing's square has two degrees of freedom.
    share = smoother.squares(problem, solution.values)[own] / chi_square.median(smoother.rows[own])
    if float(np.sqrt(np.median(share))) > _EXPLAINED:
        return None
    assert solution.elimination is not None
    spread = np.sqrt(np.diagonal(solution.elimination.marginals().constants))
    parts, told = [], []
    for column, state in enumerate(problem.states.constants):
        if state.sensor == index and state.stretch == 0 and state.name in error.states:
            told.append(abs(solution.values.constants[column]) > spread[column])
            value = solution.values.constants[column] * state.sigma
            axis = state.name.rpartition("_")[2] if len(error.states) > 2 else state.name
            prefix = f"{axis.split('_')[0]} " if len(error.states) > 1 else ""
            parts.append(f"{prefix}{value:.6g} +- {spread[column] * state.sigma:.2g} {state.unit}")
    text = f"a {error.label} of {', '.join(parts)}"
    if len(told) > 1 and not any(told):
        # One range, say, is explained by places on a whole surface: none of them is told.
        text = f"a {error.label}, of which no component is determined,"
    return _Explanation(index, before - solution.cost, text)


def _has(family: object, index: int) -> bool:
    sensor, reference = getattr(family, "sensor", None), getattr(family, "reference", None)
    return any(
        column is not None and bool((column == index).any()) for column in (sensor, reference)
    )


def _open_sigma(smoother: Smoother, index: int, name: str) -> float:
    """Return a prior sigma that allows for whatever the residuals of a sensor ask for."""
    path, values = smoother.problem.path, smoother.solution.values
    found = smoother.problem.evaluate(values, jacobian=False)
    speed = smoother.prepared.recording.propagation_speed_m_s
    largest = 0.0
    for family, part in zip(smoother.families, found, strict=False):
        if not _has(family, index):
            continue
        told = family.report(path, values, part)
        rows = family.sensor == index
        if family.reference is not None:
            rows |= family.reference == index
        off = np.abs(np.nan_to_num(told.measured - told.predicted))[rows]
        size = float(np.median(off.max(axis=1)))
        distance = float(np.median(family.emissions(path, values)[0][rows]))
        scale = {
            ("rad", "s"): 1.0 / max(_turning(smoother, index), 1e-12),
            ("rad", "m"): distance,
            ("s", "m"): speed if np.isfinite(speed) else 1.0,
            ("Hz", "m"): distance,
        }.get((told.units[0], name.rpartition("_")[2]), 1.0)
        largest = max(largest, size * scale)
    return 30.0 * largest + 1e-12


def _turning(smoother: Smoother, index: int) -> float:
    """Return how fast the line of sight of a sensor turns on average, rad/s."""
    state = smoother.problem.path.at_state(smoother.solution.values.path, jacobian=False)
    time = np.linspace(*smoother.prepared.recording.time_span_s, 20)
    position, velocity = state.position_velocity(smoother.problem.path.locate(time))
    sensor = smoother.prepared.geometry.motion(np.full(time.size, index), time)
    distance = np.linalg.norm(position - sensor.position_m, axis=1)
    speed = np.linalg.norm(velocity - sensor.velocity_m_s, axis=1)
    return float(np.median(speed / np.maximum(distance, 1e-9)))


def _carried(
    old: SensorStates, new: SensorStates, constants: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return constant states of one set of states in another, zero where they are new."""
    known = {
        (state.sensor, state.name): value * state.sigma
        for state, value in zip(old.constants, constants, strict=True)
    }
    return np.array(
        [known.get((state.sensor, state.name), 0.0) / state.sigma for state in new.constants]
    )
