"""Every derivative of every measurement family against differences, at random states."""

from dataclasses import replace

import numpy as np
import pytest
from differences import assert_derivative
from hypothesis import Phase, assume, given, settings
from hypothesis import strategies as st
from made_problem import Kind, dense_jacobian, pack, random_problem, unpack

MOTIONS = (
    "static",
    "constant-position",
    "constant-velocity",
    "constant-acceleration",
    "ballistic",
)

kinds = st.builds(
    Kind,
    frame=st.sampled_from(["local", "ecef"]),
    motion=st.sampled_from(MOTIONS),
    speed_m_s=st.sampled_from([np.inf, 299792458.0, 340.0, 150.0]),
    enu=st.booleans(),
    moving=st.booleans(),
    biases=st.booleans(),
    drifts=st.booleans(),
    clocks=st.booleans(),
    positions=st.booleans(),
    walks=st.booleans(),
    clock_walks=st.booleans(),
    form=st.sampled_from(["isotropic", "coordinates", "azimuth", "mixed"]),
    constraints=st.booleans(),
    knots=st.integers(2, 4),
    position_noise=st.booleans(),
    outside=st.booleans(),
    body=st.booleans(),
    radec=st.booleans(),
)


class NotSmoothError(Exception):
    """The point lies too close to one where the residual jumps."""


def made_possible(kind):
    """Sound does not cross 300 km of space, and a walk needs a chain of knots."""
    if kind.frame == "ecef" and kind.speed_m_s < 1e6:
        # 100 km/s and less: the object's own speed is felt as strongly as that of a source of
        # sound, and the Earth turns by milliradians while the signal is under way.
        kind = replace(kind, speed_m_s=300.0 * kind.speed_m_s)
    if kind.motion == "static":
        kind = replace(kind, walks=False, clock_walks=False)
    return kind


def steps_of(problem, values, kind):
    """A thousandth of what bends the residuals: distances, and what moves them by as much."""
    length, duration = kind.length_m, 10.0
    size = values.path.shape[1]
    powers = np.repeat(length * duration ** -np.arange(size // 3, dtype=float), 3)
    constants = np.array([state.sigma for state in problem.states.constants])
    walks = np.asarray(problem.walk_scale)
    return 1e-3 * np.concatenate(
        [
            np.tile(powers, values.path.shape[0]),
            np.tile(np.minimum(1.0, 0.05 / walks), values.path.shape[0]),
            np.minimum(1.0, 0.05 / constants),
        ]
    )  # fmt: skip


def fastest(problem, values):
    """Return the highest speed anywhere on a path."""
    times = np.linspace(problem.knots_s[0] - 5.0, problem.knots_s[-1] + 5.0, 200)
    state = problem.path.at_state(values.path, jacobian=False)
    velocity = state.position_velocity(problem.path.locate(times))[1]
    return np.linalg.norm(velocity, axis=1).max()


def compare(seed, kind):
    problem, values = random_problem(np.random.default_rng(seed), kind)
    # What is faster than its signal arrives from several places at once.
    if fastest(problem, values) > 0.9 * kind.speed_m_s:
        raise NotSmoothError
    point, steps = pack(values), steps_of(problem, values, kind)

    def evaluate(family, vector, jacobian=False):
        moved = unpack(vector, values)
        state = problem.path.at_state(moved.path, jacobian=jacobian)
        return family.evaluate(problem.path, state, moved, jacobian=jacobian)

    for family in problem.families:
        found = evaluate(family, point, jacobian=True)

        def residual(vector, family=family, found=found):
            other = evaluate(family, vector)
            # Nothing is smooth where an emission passes a knot, or an azimuth the zenith.
            jump = np.abs(other.residual - found.residual).max()
            if jump > 10.0 or not np.array_equal(other.interval, found.interval):
                raise NotSmoothError
            return other.residual

        assert_derivative(dense_jacobian(found, values), residual, point, steps, rtol=1e-6)


@settings(max_examples=60, deadline=None, derandomize=True, phases=[Phase.generate])
@given(seed=st.integers(0, 2**32 - 1), kind=kinds)
def test_derivatives_of_random_problems(seed, kind):
    try:
        compare(seed, made_possible(kind))
    except NotSmoothError:
        assume(False)


@pytest.mark.parametrize("moving", [False, True])
def test_derivatives_against_the_stars(moving):
    """Sensors against the stars beside one that is not, their clocks open."""
    kind = Kind(
        frame="ecef", motion="ballistic", speed_m_s=299792458.0, moving=moving, positions=True,
        walks=True, clock_walks=True, form="mixed", radec=True,
    )  # fmt: skip
    for seed in (2, 4):
        compare(seed, kind)


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("frame", ["local", "ecef"])
@pytest.mark.parametrize("speed", [299792458.0, 150.0])
def test_derivatives_with_everything_at_once(motion, frame, speed):
    kind = Kind(
        frame=frame, motion=motion, speed_m_s=speed, moving=True, positions=True, walks=True,
        clock_walks=True, form="mixed", constraints=True, position_noise=True, knots=2,
        body=speed < 1e6,
    )  # fmt: skip
    smooth = 0
    for seed in range(2):
        try:
            compare(seed, made_possible(kind))
            smooth += 1
        except NotSmoothError:
            pass
    assert smooth
