"""Whatever is thrown into an update: the smoother is what it was, and goes on."""

from __future__ import annotations

import dataclasses
import logging

import feeding
import numpy as np
import pytest
from feed_faults import POISON_DEG, raise_for_poison, raise_for_poison_of
from test_incremental import small_pass

import geograph as gg
from geograph.families import BearingFamily
from geograph.incremental import intervals
from geograph.incremental.rows import TABLES, Emissions, read
from geograph.incremental.trial import try_rows
from geograph.prepare import prepare
from geograph.scenarios.radio_mixed import mixed


@pytest.fixture
def halfway():
    recording = small_pass(1)
    held = list(feeding.parts(recording, every=12))
    smoother = gg.IncrementalSmoother.of(recording)
    for part in held[:6]:
        smoother.update(part)
    return recording, smoother, held[6:]


def picture(smoother):
    """Everything that a smoother holds, as numbers."""
    state, estimate = smoother._state, smoother.estimate
    chain = state.chain
    return [
        np.array(chain.knots_s),
        np.array(chain.path),
        chain.constants,
        *[piece.block for piece in chain.pieces],
        *chain.forward,
        chain.final.root,
        estimate.state,
        estimate.covariance,
        np.array([state.total, state.total_rows, estimate.used, len(smoother._known)]),
    ]


def same(one, other):
    assert len(one) == len(other)
    for left, right in zip(one, other, strict=True):
        np.testing.assert_array_equal(left, right)


@pytest.mark.parametrize("what", ["raises", "nan", "memory"])
def test_a_fault_inside_a_family_changes_nothing(halfway, monkeypatch, what):
    recording, smoother, rest = halfway
    before = picture(smoother)
    real = BearingFamily.evaluate

    def broken(self, *arguments, **options):
        if what == "raises":
            raise ZeroDivisionError("inside a factor")
        if what == "memory":
            raise MemoryError
        found = real(self, *arguments, **options)
        return dataclasses.replace(found, residual=np.full_like(found.residual, np.nan))

    interval = intervals.interval

    def broken_interval(model, tables, chain, k):
        if what != "nan":
            broken(None)
        bad = chain.copy()
        bad.path[k] = np.full_like(bad.path[k], np.nan)
        return interval(model, tables, bad, k)

    with monkeypatch.context() as patch:
        patch.setattr(BearingFamily, "evaluate", broken)
        patch.setattr(intervals, "interval", broken_interval)
        with pytest.raises(gg.UpdateError):
            smoother.update(rest[0])
    same(picture(smoother), before)
    # It goes on as if nothing had been.
    for part in rest:
        smoother.update(part)
    sigmas, relative = feeding.differences(smoother.track(), gg.smooth(recording))
    assert sigmas < 0.1
    assert relative < 0.02


def test_a_fault_that_passes_is_recovered_from_and_logged(halfway, monkeypatch, caplog):
    recording, smoother, rest = halfway
    calls = []

    def once(real):
        def raising(*arguments, **options):
            calls.append(0)
            if len(calls) == 1:
                raise FloatingPointError("once")
            return real(*arguments, **options)

        return raising

    with monkeypatch.context() as patch, caplog.at_level(logging.WARNING, "geograph.incremental"):
        patch.setattr(BearingFamily, "evaluate", once(BearingFamily.evaluate))
        patch.setattr(intervals, "interval", once(intervals.interval))
        estimate = smoother.update(rest[0])
    assert estimate.rebuilt == 1
    assert "made anew (FloatingPointError: once)" in caplog.text
    for part in rest[1:]:
        smoother.update(part)
    assert feeding.differences(smoother.track(), gg.smooth(recording))[0] < 0.1


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("azimuth_rad", np.nan, "line 7, column azimuth_rad: bearings: azimuth_rad is nan"),
        ("time_s", np.inf, "time_s is inf; expected a finite number"),
        ("sigma_azimuth_rad", -1.0, "sigma_azimuth_rad is -1.0; expected a finite number above 0"),
        ("sensor", 99, "sensor is 99; expected an index from 0 to 3"),
    ],
)
def test_a_bad_row_is_named_and_nothing_of_its_update_is_used(halfway, column, value, message):
    _, smoother, rest = halfway
    before = picture(smoother)
    table = rest[0][0]
    changed = getattr(table, column).copy()
    changed[1] = value
    line = np.arange(table.line.size) + 6
    with pytest.raises(gg.UpdateError, match=message):
        smoother.update(dataclasses.replace(table, **{column: changed, "line": line}))
    same(picture(smoother), before)
    smoother.update(table)


def test_no_table_is_refused(halfway):
    _, smoother, _ = halfway
    with pytest.raises(gg.UpdateError, match="expected tables"):
        smoother.update([3])
    same(picture(smoother), picture(smoother))


def test_wrong_settings_are_refused():
    sensors = small_pass(1).sensors
    with pytest.raises(gg.InputError, match="lag is -1"):
        gg.IncrementalSmoother(sensors, lag=-1.0)
    with pytest.raises(gg.InputError, match="unknown engine 'x'"):
        gg.IncrementalSmoother(sensors, engine="x")
    with pytest.raises(gg.InputError, match="no process noise"):
        gg.IncrementalSmoother(sensors, motion="static", engine="isam2")
    with pytest.raises(gg.InputError, match="unknown setting"):
        gg.IncrementalSmoother(sensors, pace=1)


def test_motion_by_name_and_names_of_rows():
    recording = small_pass(1)
    settings = recording.settings
    smoother = gg.IncrementalSmoother(
        recording.sensors,
        motion=gg.ConstantAcceleration(0.1),
        spacing_s=settings.spacing_s,
        loss="none",
    )
    feeding.feed(smoother, recording, every=40)
    assert feeding.differences(smoother.track(), gg.smooth(recording))[0] < 0.1
    name = gg.RowName("bearings", "S1", 2.5, 7)
    assert str(name) == "bearings of S1 at 2.5 s, line 7"


@pytest.mark.parametrize("error", [RuntimeError, ZeroDivisionError])
@pytest.mark.parametrize("places", [(0,), (7,), (2, 3, 11)])
def test_what_raises_before_the_start_is_refused_by_itself(monkeypatch, error, places):
    """Rows come one by one; those that raise are refused at once, and the rest starts alone."""
    recording = small_pass(1)
    rows = list(feeding.parts(recording, every=1))
    raising = raise_for_poison(BearingFamily.evaluate, error)
    poison = np.radians([POISON_DEG])
    monkeypatch.setattr(BearingFamily, "evaluate", raising)
    monkeypatch.setattr(intervals, "interval", raise_for_poison_of(intervals.interval, error))
    clean, faulty = (gg.IncrementalSmoother.of(recording) for _ in range(2))
    for k, row in enumerate(rows[:60]):
        clean.update(row)
        if k in places:
            bad = [dataclasses.replace(t, azimuth_rad=poison) for t in row]
            with pytest.raises(gg.UpdateError, match="inside a factor"):
                faulty.update(bad)
        faulty.update(row)
    assert faulty.estimate.status is gg.Tracking.TRACKING
    same(picture(faulty), picture(clean))


def test_every_kind_is_tried_without_a_path(monkeypatch):
    """Rows of each kind pass alone, and do not where their evaluation raises."""
    recording = mixed(1)
    arrivals = gg.Arrivals(
        emission=np.zeros(3, dtype=np.int64),
        sensor=np.arange(3),
        toa_s=np.array([5.0, 5.00001, 5.00002]),
        sigma_s=np.full(3, 1e-7),
        line=np.arange(3),
    )
    template = dataclasses.replace(recording, **dict.fromkeys(recording.tables))
    tables = {**recording.tables, "arrivals": arrivals}
    assert set(tables) == set(TABLES)
    for kind, table in tables.items():
        rows = read(table, sensors=len(recording.sensors), first=0, emissions=Emissions())
        try_rows(template, rows)
        only = dataclasses.replace(template, **{kind: table})
        (family,) = prepare(only).sensor_families()

        def broken(*_arguments, **_options):
            raise RuntimeError("inside a factor")

        with monkeypatch.context() as patch:
            patch.setattr(type(family), "evaluate", broken)
            with pytest.raises(RuntimeError, match="inside a factor"):
                try_rows(template, rows)
