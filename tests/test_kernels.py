"""Compiled code against the NumPy code that it stands in for: the same numbers to rounding."""

import os
import pickle
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from made_problem import random_problem
from made_radio import RadioKind, radio_problem
from test_families import kinds, made_possible

import geograph as gg
from geograph import blocks, common, falls, motion, sweep
from geograph.families import bearings, rays
from geograph.kernels import compiled, flat
from geograph.losses import Loss
from geograph.motion import Density, Motion
from geograph.scenarios import low_orbit_pass

MODULES = (blocks, common, falls, motion, sweep, bearings, rays)

needs_compiled = pytest.mark.skipif(compiled is None, reason="nothing was compiled here")


@pytest.mark.skipif(
    os.environ.get("GEOGRAPH_KERNELS") == "numpy" or shutil.which("cc") is None,
    reason="needs a compiler",
)
def test_it_was_compiled():
    assert compiled is not None


def in_numpy(work):
    """Return what some work gives without compiled code."""
    with pytest.MonkeyPatch.context() as patch:
        for module in MODULES:
            patch.setattr(module, "compiled", None)
        return work()


def alike(ours, reference, name, rtol=1e-9):
    """Compare to the largest entry: of what nearly cancels, rounding is all that is left."""
    scale = np.abs(reference).max(initial=0.0) if np.size(reference) else 1.0
    np.testing.assert_allclose(ours, reference, rtol=rtol, atol=rtol * scale, err_msg=name)


@needs_compiled
@settings(max_examples=150, deadline=None, derandomize=True, phases=[Phase.generate])
@given(seed=st.integers(0, 2**32 - 1), kind=kinds, weighted=st.booleans())
def test_families_and_their_blocks(seed, kind, weighted):
    kind = made_possible(kind)
    problem, values = random_problem(np.random.default_rng(seed), kind)

    def work():
        found = problem.evaluate(values, jacobian=True)
        plain = problem.evaluate(values, jacobian=False)
        total = blocks.Sums.zeros(
            problem.layout, max(problem.knots_s.size - 1, 1), apart=bool(seed % 2)
        )
        for part in found:
            root = np.linspace(0.5, 1.5, part.residual.shape[0]) if weighted else None
            blocks.BlockSum(problem.layout, problem.path_scale).add(total, part, root)
        return found, plain, total.full()

    # A light time is found from the last one: both start from the same.
    held = [getattr(family, "_light_time", None) for family in problem.families]
    held = [None if part is None else part.copy() for part in held]
    ours = work()
    for family, before in zip(problem.families, held, strict=True):
        if before is not None:
            family._light_time = before
    reference = in_numpy(work)
    for found, other in zip(ours[0] + ours[1], reference[0] + reference[1], strict=True):
        assert np.array_equal(found.interval, other.interval)
        for name in ("residual", "by_knots", "by_constants", "by_walks"):
            one, two = getattr(found, name), getattr(other, name)
            assert (one is None) == (two is None)
            if one is not None:
                # Each row against its own size: azimuths and elevations weigh differently.
                # Light times are found to a microsecond, by one measurement or by all together.
                alike(one, two, name, rtol=1e-7)
    alike(ours[2], reference[2], "blocks", rtol=1e-7)


radio_kinds = st.builds(
    RadioKind,
    frame=st.sampled_from(["local", "ecef"]),
    motion=st.sampled_from(
        ["static", "constant-position", "constant-velocity", "constant-acceleration", "ballistic"]
    ),
    speed_m_s=st.sampled_from([299792458.0, 340.0]),
    moving=st.booleans(),
    clocks=st.booleans(),
    positions=st.booleans(),
    walks=st.booleans(),
    platforms=st.booleans(),
    fast=st.booleans(),
    common=st.booleans(),
    knots=st.integers(2, 4),
)


def possible_radio(kind):
    """Sound does not cross space; walks and platforms need a chain of knots, and trajectories.

    Where nothing moves at all, differences of frequency are rounding.
    """
    if kind.frame == "ecef" or kind.motion == "ballistic":
        kind = replace(kind, speed_m_s=299792458.0)
    if kind.motion == "static":
        kind = replace(kind, walks=False, platforms=False, moving=True)
    return replace(kind, platforms=kind.platforms and kind.moving)


@needs_compiled
@settings(max_examples=40, deadline=None, derandomize=True, phases=[Phase.generate])
@given(
    seed=st.integers(0, 2**32 - 1), kind=radio_kinds, loss=st.sampled_from(["none", "cauchy"]),
    weighted=st.booleans(),
)  # fmt: skip
def test_arrivals_and_differences(seed, kind, loss, weighted):
    kind = possible_radio(kind)

    def work():
        problem, values = radio_problem(np.random.default_rng(seed), kind)
        weights = [
            np.linspace(0.0, 1.5, len(family)) if weighted else None for family in problem.families
        ]
        problem = problem.with_weights(weights, Loss(loss))
        problem.refresh(values)
        plain = problem.evaluate(values, jacobian=False)
        found = problem.evaluate(values, jacobian=True)
        system = problem.linearise(values)
        kept = [
            (family._white, *(end.read_s for end in family.ends), family.emitted_s, *heard)
            for family, heard in (
                (family, family.emissions(problem.path, values)) for family in problem.families
            )
        ]
        return found, plain, system, kept

    ours, reference = work(), in_numpy(work)
    for found, other in zip(ours[0] + ours[1], reference[0] + reference[1], strict=True):
        for name in ("interval", "constant_row", "constant_column", "walk_row", "walk_column"):
            assert np.array_equal(getattr(found, name), getattr(other, name)), name
        for name in ("residual", "by_knots", "by_constants", "by_walks", "walk_before"):
            one, two = getattr(found, name), getattr(other, name)
            assert (one is None) == (two is None)
            if one is not None:
                alike(one, two, name, rtol=1e-7)
        assert (found.common is None) == (other.common is None)
        if found.common is not None:
            alike(found.common.value, other.common.value, "shared", rtol=1e-7)
            alike(found.common.leverage(), other.common.leverage(), "leverage", rtol=1e-6)
    for part, other in zip(ours[3], reference[3], strict=True):
        for one, two in zip(part, other, strict=True):
            alike(one, two, "noise and times")
    for name in ("knots", "others"):
        alike(getattr(ours[2].blocks, name), getattr(reference[2].blocks, name), name, rtol=1e-7)
    assert ours[2].cost == pytest.approx(reference[2].cost, rel=1e-8)


def random_system(rng, count, d, s):
    """Return a chain that is determined, with transitions of many zeros and noises of any size."""
    rows = rng.normal(size=(count, 2 * d + s + 3, 2 * d + s + 1))
    products = np.swapaxes(rows, 1, 2) @ rows
    inverse = np.eye(d) + np.triu(rng.normal(size=(count, d, d)), 1) * (rng.random((d, d)) < 0.3)
    root = np.tril(rng.normal(size=(count, d, d))) * rng.choice([1.0, 1e-3, 0.0], (count, 1, 1))
    knot = np.concatenate([np.eye(d), rng.normal(size=(d, s + 1))], axis=1)
    return knot, {
        "blocks": blocks.Sums.of(products, 2 * d),
        "inverse_transition": inverse,
        "noise_root": root,
        "noise_residual": rng.normal(size=(count, d)),
    }


@needs_compiled
@pytest.mark.parametrize(
    ("count", "d", "s"), [(1, 9, 4), (7, 6, 0), (30, 13, 20), (5, 3, 1), (40, 9, 32), (2, 27, 40)]
)
def test_sweep_back_substitution_and_marginals(count, d, s):
    rng = np.random.default_rng(count)
    knot, system = random_system(rng, count, d, s)
    last, constants = rng.normal(size=d), rng.normal(size=s)

    def work():
        found = sweep.sweep(knot, **system)
        root = np.linalg.cholesky(np.eye(d + s) + np.ones((d + s, d + s)))
        return (
            found,
            sweep.sweep(knot, **system, damping=0.3, ends=True, noise=True),
            sweep.substitute(found.back, last, constants),
            sweep.chain_marginals(found.back, found.spread, root),
        )

    def ends():
        found = sweep.Ends(knot, **system, damping=0.3)
        steps = found.substitute(last, constants)
        both = found.turned_back
        # By another way, once these are there.
        alike(found.substitute(last, constants), steps, "substitute")
        return (found.knot, found.share, found.half_log, found.square, steps, *both)

    for found, other in zip(ends(), in_numpy(ends), strict=True):
        alike(found, other, "ends")
    ours, reference = work(), in_numpy(work)
    alike(ours[2], reference[2], "substitute")
    for found, other in zip(ours[:2] + ours[3:], reference[:2] + reference[3:], strict=True):
        for name in vars(found):
            alike(getattr(found, name), getattr(other, name), name)


@needs_compiled
def test_what_is_not_determined_is_refused_alike():
    knot, system = random_system(np.random.default_rng(1), 3, 4, 2)
    system["blocks"].knots[1] = -100.0 * np.eye(8, 11)

    def work():
        with pytest.raises(sweep.NotPositiveDefiniteError):
            sweep.sweep(knot, **system)

    work()
    in_numpy(work)


@needs_compiled
@pytest.mark.parametrize(
    "name", ["constant-position", "constant-velocity", "constant-acceleration"]
)
def test_transitions(name):
    rng = np.random.default_rng(3)
    made = Motion(name, Density((0.3, 2.0, 10.0)), "local")
    size = 3 * made.order
    state, steps = rng.normal(size=(6, size)), rng.uniform(1e-3, 30.0, 5)
    scale = rng.uniform(0.1, 1e3, size)

    def work():
        found = made.linear(state, steps, scale)
        return {**vars(found), "alone": made.residual(state, steps)}

    ours, reference = work(), in_numpy(work)
    for part, other in reference.items():
        alike(ours[part], other, part)
    plain = made.transitions(state, steps)
    np.testing.assert_allclose(
        ours["inverse"] @ (plain.transition * scale / scale[:, None]),
        np.broadcast_to(np.eye(size), (5, size, size)),
        atol=1e-9 * np.abs(ours["inverse"]).max(),
    )


@needs_compiled
@pytest.mark.parametrize("degree", [2, 4])
def test_falls(degree):
    """Orbits of all heights and inclinations, forwards and back, and one straight up."""
    rng = np.random.default_rng(degree)
    direction = rng.normal(size=(40, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    position = rng.uniform(6.5e6, 4.3e7, (40, 1)) * direction
    state = np.concatenate([position, rng.normal(0.0, 4e3, (40, 3))], axis=1)
    state[0] = 0.0, 0.0, 6.6e6, 0.0, 0.0, 3e3
    steps = rng.uniform(-60.0, 60.0, 40)
    ours = falls.propagated(state, steps, "ecef", degree)
    for found, other in zip(ours, in_numpy(lambda: falls.propagated(state, steps, "ecef", degree)),
                            strict=True):  # fmt: skip
        alike(found, other, "fall", rtol=1e-13)
    with pytest.raises(ValueError, match="the degree 2 or 4"):
        compiled.fall(0, 1, 3, *[np.empty(0)] * 5)


@needs_compiled
@pytest.mark.parametrize("loss", ["none", "cauchy"])
def test_a_pass_comes_out_the_same(loss):
    """Cost, estimate and covariance of a whole pass, compiled or not, to 1e-6."""
    recording = low_orbit_pass(3, sensors=4, bearings=40)
    work = lambda: gg.smooth(recording, loss=loss)  # noqa: E731
    ours, reference = work(), in_numpy(work)
    assert ours.summary["cost"] == pytest.approx(reference.summary["cost"], rel=1e-8)
    root = np.linalg.cholesky(reference.position_covariance_m2)
    gap = (ours.position_m - reference.position_m)[:, :, None]
    assert np.abs(np.linalg.solve(root, gap)).max() < 1e-5
    scale = np.abs(reference.covariance).max(axis=0)
    assert (np.abs(ours.covariance - reference.covariance) / scale).max() < 1e-6


@needs_compiled
def test_wrong_arrays_are_refused():
    """What the buffers hold is checked before anything is read or written."""
    with pytest.raises(TypeError, match="too few arguments"):
        compiled.sweep(1, 2)
    knot, system = random_system(np.random.default_rng(1), 2, 3, 1)
    sums, *rest = system.values()
    given_ = [knot, *map(flat, (sums.knots, sums.others)), *rest, *(np.empty(1) for _ in range(7))]
    with pytest.raises(ValueError, match=r"argument 12 holds 8 bytes of format d; expected 30"):
        compiled.sweep(2, 3, 2, 0, 0, 0.0, *given_)
    with pytest.raises(ValueError, match="argument 6"):
        compiled.sweep(2, 3, 2, 0, 0, 0.0, knot.astype(np.float32), *given_[1:])
    with pytest.raises((ValueError, BufferError)):
        compiled.sweep(2, 3, 2, 0, 0, 0.0, np.asfortranarray(knot), *given_[1:])
    none, one = np.empty(0), np.ones(1)
    held = [none, none, none, one.copy(), none, one.copy(), none, none]
    compiled.marginals(0, 1, 0, *held)
    with pytest.raises(TypeError, match="an array is missing"):
        compiled.marginals(0, 1, 0, None, *held[1:])
    with pytest.raises(TypeError, match="too many arguments"):
        compiled.marginals(0, 1, 0, *held, 3)
    with pytest.raises(ValueError, match="at least 0"):
        compiled.marginals(-1, 1, 1, *[None] * 8)
    with pytest.raises(ValueError, match="1 to 3 blocks"):
        compiled.kinematics(1, 4, *[None] * 8)
    total, last, scale, one = np.zeros((1, 6, 7)), np.zeros((1, 1, 1)), np.ones(3), np.ones((1, 1))
    index = np.zeros(0, dtype=np.int64)

    def add(held, order, interval):
        compiled.add_blocks(
            1, held, 3, 0, 0, 1, 1, 1, order, 0, 0, total, last, one, np.array([interval]),
            np.ones((1, 1, 2, 3)), None, scale, index, index, none, index, index, none, none, none,
            None,
        )  # fmt: skip

    for interval in (1, -1):
        with pytest.raises(IndexError, match="out of range"):
            add(1, 0, interval)
    for held, order in ((2, 0), (1, 2)):
        with pytest.raises(ValueError, match="expected sums of one interval or of each"):
            add(held, order, 0)
    assert not total.any()
    assert not last.any()


def test_without_compiled_code_everything_works():
    """The environment variable turns it off, as where there is no compiler."""
    code = (
        "import geograph as gg; from geograph.kernels import compiled; assert compiled is None;"
        "from geograph.scenarios import low_orbit_pass;"
        "print(gg.smooth(low_orbit_pass(1, sensors=3, bearings=20)).status)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"GEOGRAPH_KERNELS": "numpy"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout.strip()) == (0, "converged"), done.stderr


def test_an_old_build_is_not_used(monkeypatch):
    from geograph import kernels

    if compiled is not None:
        monkeypatch.setattr(compiled, "CLOCK", 99)
    assert kernels._load() is None


@needs_compiled
def test_a_plan_goes_to_another_process_and_back():
    problem, values = radio_problem(np.random.default_rng(2), RadioKind())
    copied = pickle.loads(pickle.dumps(problem))
    assert copied.linearise(values).cost == problem.linearise(values).cost


@needs_compiled
def test_wrong_plans_and_groups_are_refused():
    problem, values = radio_problem(np.random.default_rng(2), RadioKind())
    plan = problem.families[0]._kernel._given
    place = next(k for k, part in enumerate(plan) if isinstance(part, np.ndarray))
    for what, changed in ((plan[place] + 1, "out of range"), (plan[place][:-1], "argument 11")):
        with pytest.raises((IndexError, ValueError), match=changed):
            compiled.radio_plan(*plan[:place], what, *plan[place + 1 :])
    with pytest.raises(ValueError, match="kind 0, 1 or 2"):
        compiled.radio_plan(3, *plan[1:])
    with pytest.raises(TypeError, match="an array is missing"):
        compiled.radio_plan(*plan[:place], None, *plan[place + 1 :])
    for call in (compiled.radio, compiled.radio_sums):
        with pytest.raises(ValueError, match="PyCapsule"):
            call("no plan")
        with pytest.raises(TypeError, match="too few arguments"):
            call(problem.families[0]._kernel._plan)
    one = np.ones(1)
    with pytest.raises(IndexError, match="empty or out of range"):
        compiled.settle(1, 1, np.ones(1, dtype=np.int64), one, one, None, one, one, one, one)
    # Rows of one group in different intervals were not emitted together.
    found = problem.evaluate(values, jacobian=True)[0]
    apart = replace(found, interval=np.arange(found.interval.size) % 2)
    total = blocks.Sums.zeros(problem.layout, 2)
    with pytest.raises(IndexError, match="a group, interval"):
        blocks.BlockSum(problem.layout, problem.path_scale).add(total, apart, None)
    assert not total.knots.any()
