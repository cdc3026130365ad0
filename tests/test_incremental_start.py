"""Starts of a feed that fail: what is said, and what goes on."""

from __future__ import annotations

import dataclasses
import logging
from itertools import pairwise

import feeding
import numpy as np
import pytest
from test_incremental import small_pass
from test_range_starts import ARRAY, straight, world

import geograph as gg
import geograph.smoother as smoother_module
from geograph.errors import told
from geograph.incremental import remake, start
from geograph.incremental.start import NotStartedError
from geograph.sweep import NotPositiveDefiniteError


def test_a_start_that_is_not_determined_waits_for_more(monkeypatch):
    """The batch factorises it, the chain by another order of elimination does not: rounding."""
    recording = small_pass(1)
    real, calls = start.make_chain, []

    def once(*arguments):
        calls.append(0)
        if len(calls) == 1:
            raise NotPositiveDefiniteError
        return real(*arguments)

    monkeypatch.setattr(start, "make_chain", once)
    smoother = gg.IncrementalSmoother.of(recording)
    first, *rest = list(feeding.parts(recording, every=12))
    estimate = smoother.update(first)
    assert estimate.status is gg.Tracking.COLLECTING
    assert "determine the path to no working precision (" in estimate.message
    assert "another sensor or a constraint on the height" in estimate.message
    for part in rest:
        estimate = smoother.update(part)
    assert estimate.status is gg.Tracking.TRACKING
    assert estimate.used == len(recording.bearings)


def test_a_start_that_cannot_be_made_again_loses_nothing(monkeypatch, caplog):
    recording = small_pass(1)
    smoother = gg.IncrementalSmoother.of(recording, process_noise="auto")
    cut = list(feeding.parts(recording, every=4))
    for part in cut[:4]:
        smoother.update(part)
    assert smoother.estimate.status is gg.Tracking.TRACKING
    calls = []

    def none(*_):
        calls.append(0)
        raise NotStartedError("there are two paths")

    with monkeypatch.context() as patch, caplog.at_level(logging.INFO, "geograph.incremental"):
        patch.setattr(remake, "begin", none)
        for part in cut[4:]:
            smoother.update(part)
    assert 1 <= len(calls) <= 4
    assert "the start is not made again (there are two paths)" in caplog.text
    estimate = smoother.finish()
    assert estimate.used == len(recording.bearings)
    sigmas, relative = feeding.differences(
        smoother.track(), gg.smooth(recording, process_noise="auto")
    )
    assert sigmas < 0.1
    assert relative < 0.05


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (NotPositiveDefiniteError(), "does not determine all unknowns"),
        (MemoryError(), "MemoryError: Out of memory"),
        (ValueError("two\nlines"), "ValueError: two lines"),
        (type("Bare", (Exception,), {"__doc__": None})(), "Bare: no reason was given"),
    ],
)
def test_no_reason_is_empty(monkeypatch, error, message):
    assert message in told(error)
    recording = small_pass(1)
    smoother = feeding.feed(gg.IncrementalSmoother.of(recording), recording, every=60)

    def broken(*_):
        raise error

    monkeypatch.setattr("geograph.incremental.smoother.finished", broken)
    with pytest.raises(gg.UpdateError, match=r"^finish failed \(") as caught:
        smoother.finish()
    assert message in str(caught.value)
    assert np.isfinite(smoother.estimate.state).all()


def test_two_mirror_images_wait_cheaply_for_a_height(monkeypatch):
    """Five receivers in a plane: the path below it fits as well, until a height is known."""
    flat = ARRAY[:5] * [1.0, 1.0, 0.0]
    recording = world(flat, straight, sigma=5e-8)
    recording = dataclasses.replace(
        recording, settings=gg.SmoothSettings(motion="constant-velocity", process_noise=1.0)
    )
    looked = []
    real = smoother_module.first_fits

    def counted(prepared, **how):
        looked.append(len(prepared.recording.arrivals))
        return real(prepared, **how)

    monkeypatch.setattr(smoother_module, "first_fits", counted)
    smoother = gg.IncrementalSmoother.of(recording)
    every = list(feeding.parts(recording, every=5))
    for part in every[:32]:
        estimate = smoother.update(part)
    assert estimate.status is gg.Tracking.COLLECTING
    assert "another path fits too" in estimate.message
    # First guesses are nearly all of what a try costs: four times the measurements each time.
    assert all(after >= 4 * before for before, after in pairwise(looked))
    assert 2 <= len(looked) <= 4
    tries = len(looked)
    height = gg.Constraints(
        time_s=np.array([np.nan]),
        kind=("altitude_m",),
        value=np.array([2000.0]),
        sigma=np.array([500.0]),
        line=np.array([1]),
    )
    estimate = smoother.update(height)
    assert estimate.status is gg.Tracking.TRACKING
    assert len(looked) == tries + 1
    for part in every[32:]:
        estimate = smoother.update(part)
    assert estimate.used == len(recording.arrivals)
    smoother.finish()
    whole = dataclasses.replace(recording, constraints=height)
    sigmas, relative = feeding.differences(smoother.track(), gg.smooth(whole))
    assert sigmas < 0.1
    assert relative < 0.02
