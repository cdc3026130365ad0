"""Compiled code of the incremental smoother against the NumPy code that it stands in for."""

import dataclasses

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from made_problem import random_problem
from test_families import kinds, made_possible
from test_incremental import small_pass
from test_kernels import alike, needs_compiled

import geograph as gg
from geograph import motion, sweep
from geograph.families import bearings
from geograph.incremental import chain as chains
from geograph.incremental import curvature, intervals, rows
from geograph.incremental.curvature import Limits
from geograph.incremental.model import Model
from geograph.incremental.room import emission_times
from geograph.incremental.rows import numbered
from geograph.incremental.start import make_chain
from geograph.kernels import compiled
from geograph.losses import Loss
from geograph.prepare import Prepared

MODULES = (bearings, chains, curvature, intervals, motion, rows, sweep)


def in_numpy(work):
    """Return what some work gives without compiled code."""
    with pytest.MonkeyPatch.context() as patch:
        for module in MODULES:
            patch.setattr(module, "compiled", None)
        return work()


def random_chain(seed, kind):
    """A model and a chain of random bearings, some left out."""
    rng = np.random.default_rng(seed)
    problem, values = random_problem(rng, kind)
    (family,) = problem.families
    geometry, table = family.geometry, family.bearings
    recording = gg.Recording(
        name="random",
        frame=kind.frame,
        sensors={sensor.name: sensor for sensor in geometry.sensors},
        propagation_speed_m_s=kind.speed_m_s,
    )
    model = Model(
        prepared=Prepared(
            recording, None, tuple(geometry.sensors), geometry, problem.states,
            problem.walk_scale, None,
        ),
        motion=problem.motion,
        prior=problem.prior,
        path_scale=problem.path_scale,
        loss=Loss(["none", "huber", "cauchy", "geman-mcclure"][seed % 4]),
        shift=None,
        spacing_s=200.0,
        between=False,
        carrier_hz=None,
    )  # fmt: skip
    columns = {name: np.array(column) for name, column in vars(table).items()}
    columns = numbered(columns, 0) | {"kept": rng.random(len(table)) < 0.8}
    made = make_chain(model, problem.knots_s, values, {"bearings": columns})
    # Away from where the linear system is written.
    for name, scale in (("path", problem.path_scale), ("chains", 0.1)):
        held = getattr(made, name)
        held[:] = [state + 0.1 * scale * rng.normal(size=state.size) for state in held]
    made.constants = made.constants + 0.1 * rng.normal(size=made.constants.size)
    return model, made


usual_kinds = st.builds(
    lambda kind, motion: dataclasses.replace(
        made_possible(kind),
        motion=motion,
        # Slow signals over 300 km leave the knots.
        speed_m_s=kind.speed_m_s if kind.frame == "local" else max(kind.speed_m_s, 299792458.0),
        **dict.fromkeys(
            ("along", "constraints", "clock_walks", "position_noise", "outside", "body",
             "radec"), False,
        ),
    ),
    kinds,
    st.sampled_from(["constant-position", "constant-velocity", "constant-acceleration"]),
)  # fmt: skip


@needs_compiled
@settings(max_examples=60, deadline=None, derandomize=True, phases=[Phase.generate])
@given(seed=st.integers(0, 2**32 - 1), kind=usual_kinds)
def test_an_interval_is_that_of_the_families(seed, kind):
    """Blocks, transitions, elimination, estimate and covariance; whatever the sensors' errors."""
    model, held = random_chain(seed, kind)
    assert model.fixed is not None
    every = range(len(held.pieces))
    ours, reference = held.copy(), held.copy()
    seen = model.renew(ours, every)
    if kind.speed_m_s < 1e6 and not isinstance(seen[0], intervals.Seen):
        return  # A slow signal was emitted in another interval: that is left to NumPy.
    assert all(isinstance(part, intervals.Seen) for part in seen)
    # Not in NumPy (tests/test_kernels.py does that), which finds emissions to a microsecond for all
    # rows together. Walks are read there, in either.
    model.linearise(reference, every)
    rtol = 1e-6 if kind.walks else 1e-9
    for piece, other in zip(ours.pieces, reference.pieces, strict=True):
        for kind_, columns in piece.rows.items():
            assert np.array_equal(columns["ident"], other.rows[kind_]["ident"])
        for name in ("block", "inverse", "root", "noise", "path", "chains", "constants"):
            alike(getattr(piece, name), getattr(other, name), name, rtol)

    def solved(chain):
        chain.behind = 0
        chain.eliminate()
        chain.solve(len(chain.knots_s))
        step, path = chain.final.step, np.array(chain.path)
        covariance = chain.final.covariance()
        limits = Limits(*(np.full(n, 0.3) for n in (model.motion.order, chain.chains[0].size)),
                        *(np.full(chain.constants.size, 0.1) for _ in range(2)))  # fmt: skip
        return [*chain.forward, *chain.other, *chain.back, *chain.spread, step, covariance, path,
                # Beside what they are counted from: a sum of two that cancel has its digits.
                np.array([*chain.chains, *chain.reference_chains]), chain.constants,
                limits.moved(chain, 0)]  # fmt: skip

    # The same pieces: what is left is how they are solved.
    reference.pieces = list(ours.pieces)
    for one, other in zip(solved(ours), in_numpy(lambda: solved(reference)), strict=True):
        alike(one, other, "solved", rtol=1e-7)


@needs_compiled
@settings(max_examples=40, deadline=None, derandomize=True, phases=[Phase.generate])
@given(seed=st.integers(0, 2**32 - 1), kind=usual_kinds)
def test_times_of_emission_to_place_knots_by(seed, kind):
    model, held = random_chain(seed, dataclasses.replace(kind, speed_m_s=299792458.0))
    columns = dict(next(iter(held.pieces[-1].rows.values()), held.pieces[0].rows["bearings"]))
    ours = emission_times(model, held, "bearings", columns)
    plain = dataclasses.replace(model)
    vars(plain)["fixed"] = None
    other = dict(columns)
    alike(ours, emission_times(plain, held, "bearings", other), "emitted", rtol=1e-13)
    np.testing.assert_allclose(columns["delay_s"], other["delay_s"], rtol=1e-6, atol=1e-12)


@needs_compiled
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1.0, 0.0, 7.0])
def test_rows_that_cannot_be_used_are_found_alike(value):
    """Whatever number stands in whatever column: refused or not as NumPy says, in its words."""
    table = small_pass(1).bearings
    given_ = [entry.name for entry in dataclasses.fields(table) if entry.name != "isotropic"]

    def said(name, number):
        column = getattr(table, name).astype(np.float64 if name != "sensor" else np.int64)
        column[3] = number
        changed = dataclasses.replace(table, **{name: column})
        try:
            rows.read(changed, sensors=4, first=0, emissions=rows.Emissions())
        except gg.UpdateError as error:
            return str(error)
        return "good"

    for name in given_:
        if name == "sensor" and not np.isfinite(value):
            continue
        assert said(name, value) == in_numpy(lambda name=name: said(name, value)), name


@needs_compiled
def test_a_live_pass_comes_out_the_same():
    """The same pass with the general linearisation: within what the limits allow."""
    recording = small_pass(1, instability_rad_sqrt_s=0.0)

    def last():
        smoother = gg.IncrementalSmoother.of(recording)
        table = recording.bearings
        for part in np.array_split(np.argsort(table.time_s), 40):
            smoother.update(
                gg.Bearings(**{name: column[part] for name, column in vars(table).items()})
            )
        return smoother.estimate

    ours, reference = last(), in_numpy(last)
    root = np.linalg.cholesky(reference.covariance)
    assert np.abs(np.linalg.solve(root, ours.state - reference.state)).max() < 0.02
    scale = np.sqrt(np.outer(*[np.diagonal(reference.covariance)] * 2))
    assert np.abs((ours.covariance - reference.covariance) / scale).max() < 1e-3


@needs_compiled
def test_wrong_arrays_are_refused():
    """What the buffers hold is checked before anything is read or written."""
    one, index = np.ones(1), np.zeros(1, dtype=np.int64)
    with pytest.raises(TypeError, match="an array is missing"):
        compiled.sound_bearings(1, 1, one, None, one, one, one, one)
    with pytest.raises(ValueError, match="argument 3 holds 8 bytes of format d"):
        compiled.sound_bearings(1, 1, one, one, one, one, one, one)
    table = np.zeros(14, dtype=np.int64)
    for sensor, column in ((1, 0), (-1, 0), (0, 1)):
        held = (np.zeros(3), table + column, table, np.zeros(14), one, one, np.zeros(3), None)
        with pytest.raises(IndexError, match="out of range"):
            compiled.departures(
                1, 3, 1, 1, 0.0, 1.0, one, index + sensor, *held, one.copy(), one.copy()
            )
    with pytest.raises(TypeError, match="too many arguments"):
        compiled.live_covariance(1, one, one.copy(), 3)
    with pytest.raises(TypeError, match="an array is missing"):
        compiled.live_finish(1, 1, None, one, one, one, one)
    assert not compiled.live_finish(1, 1, np.array([[-1.0, 0.0]]), one, one, one.copy(), one.copy())
