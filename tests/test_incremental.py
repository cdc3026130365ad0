"""The incremental smoother against the batch: the same answer, whatever the order of arrival."""

from __future__ import annotations

import dataclasses
import pickle
from dataclasses import replace

import feeding
import numpy as np
import pytest

import geograph as gg
from geograph import motion
from geograph.examples import write_example
from geograph.incremental.curvature import TOLERANCE, limits
from geograph.incremental.review import everything
from geograph.incremental.rows import join
from geograph.incremental.start import problem_of
from geograph.motion import Density, Motion
from geograph.scenarios import low_orbit_pass
from geograph.scenarios.radio_mixed import mixed
from geograph.scenarios.radio_orbit import formation
from geograph.scenarios.radio_platforms import platforms
from geograph.solver import solve

# The goals of the incremental smoother: posterior sigmas, and relative error of a covariance.
NEAR, ALIKE, NEWEST = 0.1, 0.02, 0.2


def small_pass(seed, **options):
    """A pass of 30 bearings from each of 4 sensors, with 31 knots, or about."""
    options = {"platform": "ground" if seed % 2 else "satellite"} | options
    recording = low_orbit_pass(seed, sensors=4, bearings=30, **options)
    first, last = recording.time_span_s
    settings = recording.settings.replace(spacing_s=(last - first) / 30)
    table = recording.bearings
    table = dataclasses.replace(table, line=np.arange(len(table)) + 2)
    return dataclasses.replace(recording, settings=settings, bearings=table)


@pytest.mark.parametrize("walk", [0.0, 1e-7])
def test_passes_equal_the_batch(walk):
    """50 passes in all: every knot, before anything is solved as a batch would."""
    for seed in range(25):
        recording = small_pass(seed, instability_rad_sqrt_s=walk)
        batch = gg.smooth(recording)
        smoother = feeding.feed(gg.IncrementalSmoother.of(recording), recording, every=12)
        assert smoother.estimate.status is gg.Tracking.TRACKING
        sigmas, relative = feeding.differences(smoother.track(), batch)
        assert sigmas < NEAR
        assert relative < ALIKE
        assert feeding.newest_sigmas(smoother.estimate, batch) < NEAR


@pytest.mark.parametrize("loss", ["cauchy", "auto"])
def test_winchcombe_equals_the_batch(tmp_path, loss):
    (folder,) = write_example("winchcombe", tmp_path / "winchcombe")
    recording = gg.read(folder)
    batch = gg.smooth(recording, loss=loss)
    smoother = gg.IncrementalSmoother.of(recording, loss=loss)
    feeding.feed(smoother, recording, every=200)
    estimate = smoother.finish()
    sigmas, relative = feeding.differences(smoother.track(), batch)
    assert sigmas < NEAR
    assert relative < ALIKE
    if loss == "auto":
        assert {name.line for name in estimate.rejected} == {
            entry["line"] for entry in batch.summary["rejected"]
        }


@pytest.mark.parametrize("number", [3, 26])
def test_a_locards_track_equals_the_batch(tmp_path, number):
    """With a loss; before the newest message of the second nothing was heard for minutes."""
    recording = gg.read(write_example("locards", tmp_path / "locards")[number])
    batch = gg.smooth(recording)
    smoother = feeding.feed(gg.IncrementalSmoother.of(recording), recording, every=1)
    assert feeding.newest_sigmas(smoother.estimate, batch) < NEAR
    sigmas, relative = feeding.differences(smoother.track(), batch)
    assert sigmas < NEAR
    assert relative < ALIKE


def test_mixed_kinds_equal_the_batch():
    recording = mixed(1)
    recording = dataclasses.replace(recording, settings=recording.settings.replace(spacing_s=5.0))
    batch = gg.smooth(recording)
    smoother = feeding.feed(gg.IncrementalSmoother.of(recording), recording, every=30)
    smoother.finish()
    sigmas, relative = feeding.differences(smoother.track(), batch)
    assert sigmas < NEAR
    assert relative < ALIKE


@pytest.mark.parametrize("seed", range(3))
def test_a_lag_keeps_the_newest_knot(seed):
    recording = small_pass(seed)
    batch = gg.smooth(recording)
    lag = 20 * recording.settings.spacing_s
    smoother = gg.IncrementalSmoother.of(recording, lag=lag)
    feeding.feed(smoother, recording, every=4)
    estimate = smoother.estimate
    assert feeding.newest_sigmas(estimate, batch) < NEWEST
    assert estimate.knots < 45
    assert estimate.used == len(recording.bearings)
    reference = batch.at(estimate.time_s).covariance[0]
    np.testing.assert_allclose(estimate.covariance, reference, rtol=0.05, atol=1e-6)


def test_a_lag_waits_for_clocks(tmp_path):
    """Cameras whose clocks are seconds off: nothing is let go before these are known."""
    recording = gg.read(write_example("winchcombe", tmp_path / "winchcombe")[0])
    batch = gg.smooth(recording)
    lag = 20 * recording.settings.spacing_s
    smoother = gg.IncrementalSmoother.of(recording, lag=lag)
    feeding.feed(smoother, recording, every=60)
    assert feeding.newest_sigmas(smoother.estimate, batch) < NEWEST
    assert smoother.estimate.late_count == 0


def test_a_lag_is_no_longer_than_said_where_sensors_are_known():
    recording = small_pass(1)
    lag = 5 * recording.settings.spacing_s
    smoother = gg.IncrementalSmoother.of(recording, lag=lag)
    feeding.feed(smoother, recording, every=4)
    chain = smoother._state.chain
    assert not smoother._state.limits.unsure().any()
    assert chain.knots_s[-1] - chain.knots_s[1] <= lag


@pytest.mark.parametrize("lag", [None, 20.0])
def test_random_order_and_duplicates_change_nothing(lag):
    recording = small_pass(1)
    table, spacing = recording.bearings, recording.settings.spacing_s
    batch = gg.smooth(recording)
    rng = np.random.default_rng(5)
    order = np.argsort(table.time_s + rng.uniform(0.0, 4 * spacing, len(table)))
    # Every seventh comes again, a little later.
    again = order[::7]
    place = np.concatenate([np.arange(order.size), 7 * np.arange(again.size) + 10])
    order = np.concatenate([order, again])[np.argsort(place, kind="stable")]
    smoother = gg.IncrementalSmoother.of(recording, lag=None if lag is None else lag * spacing)
    named = []
    for low in range(0, order.size, 5):
        estimate = smoother.update(feeding.take(table, order[low : low + 5]))
        named += [name.line for name in estimate.duplicates]
    assert estimate.used == len(table)
    assert estimate.duplicate_count == again.size
    assert sorted(named) == sorted(table.line[again].tolist())
    assert feeding.newest_sigmas(estimate, batch) < (NEAR if lag is None else NEWEST)


def test_errors_of_sensors_are_those_of_their_update_whenever_they_are_read():
    recording = small_pass(1)
    smoother = gg.IncrementalSmoother.of(recording)
    held = [smoother.update(part) for part in feeding.parts(recording, every=12)][-3:]
    again = [pickle.loads(pickle.dumps(estimate)) for estimate in held]
    for late, other in zip(held, again, strict=True):
        assert late.sensor_errors == other.sensor_errors
        assert repr(late.sensor_errors) == repr(other.sensor_errors)
        assert len(late.sensor_errors) == len(recording.sensors)
    values = [estimate.sensor_errors["G1"]["azimuth_bias"].sigma for estimate in held]
    assert values[0] > values[1] > values[2] > 0.0


def test_an_azimuth_alone_that_comes_again_is_named():
    table = small_pass(1).bearings
    table = replace(table, elevation_rad=np.full(len(table), np.nan))
    smoother = gg.IncrementalSmoother.of(small_pass(1))
    smoother.update(feeding.take(table, np.arange(4)))
    estimate = smoother.update(feeding.take(table, np.arange(2, 6)))
    assert [name.line for name in estimate.duplicates] == table.line[2:4].tolist()


def test_silent_and_late_sensors_and_a_gap():
    recording = small_pass(2)
    table = recording.bearings
    first, last = recording.time_span_s
    share = (table.time_s - first) / (last - first)
    silent = (table.sensor == 0) & (share > 0.3) & (share < 0.63)
    appears = (table.sensor == 1) & (share < 0.5)
    gap = (share > 0.7) & (share < 0.85)
    rows = np.flatnonzero(~(silent | appears | gap))
    recording = dataclasses.replace(recording, bearings=feeding.take(table, rows))
    batch = gg.smooth(recording)
    smoother = feeding.feed(gg.IncrementalSmoother.of(recording), recording, every=5)
    sigmas, relative = feeding.differences(smoother.track(), batch)
    assert sigmas < NEAR
    assert relative < ALIKE


@pytest.mark.parametrize("lag", [None, 20.0])
def test_isam2_gives_the_same(lag):
    recording = small_pass(1)
    batch = gg.smooth(recording)
    lag = None if lag is None else lag * recording.settings.spacing_s
    found = [
        feeding.feed(
            gg.IncrementalSmoother.of(recording, lag=lag, engine=engine), recording, every=5
        )
        for engine in ("isam2", "structured")
    ]
    ours, other = (smoother.estimate for smoother in found)
    assert feeding.newest_sigmas(ours, batch) < (NEAR if lag is None else NEWEST)
    np.testing.assert_allclose(ours.covariance, other.covariance, rtol=ALIKE, atol=1e-6)
    if lag is None:
        sigmas, relative = feeding.differences(found[0].track(), batch)
        assert sigmas < NEAR
        assert relative < ALIKE


def test_too_late_is_named_and_not_used():
    recording = small_pass(1)
    table = recording.bearings
    order = np.argsort(table.time_s)
    late = order[10]
    smoother = gg.IncrementalSmoother.of(recording, lag=5 * recording.settings.spacing_s)
    for low in range(0, order.size, 10):
        chosen = order[low : low + 10]
        smoother.update(feeding.take(table, chosen[chosen != late]))
    before = smoother.estimate
    estimate = smoother.update(feeding.take(table, [late]))
    assert [name.line for name in estimate.late] == [table.line[late]]
    assert estimate.late_count == 1
    assert estimate.used == before.used
    np.testing.assert_array_equal(estimate.state, before.state)


def test_outliers_wait_and_are_named_as_by_the_batch():
    recording = small_pass(3, outliers=5)
    recording = dataclasses.replace(recording, settings=recording.settings.replace(loss="auto"))
    batch = gg.smooth(recording)
    assert batch.summary["rejected"]
    smoother = feeding.feed(gg.IncrementalSmoother.of(recording), recording, every=4)
    estimate = smoother.finish()
    assert not estimate.waiting
    assert {name.line for name in estimate.rejected} == {
        entry["line"] for entry in batch.summary["rejected"]
    }
    assert feeding.differences(smoother.track(), batch)[0] < NEAR


def test_limits_bound_what_is_not_linear():
    """Moved by its limit, no residual leaves its linear part by more than is allowed."""
    recording = small_pass(1)
    smoother = feeding.feed(gg.IncrementalSmoother.of(recording), recording, every=12)
    state = smoother._state
    model, chain = state.running
    found = limits(model, chain, state.total_rows)
    allowed = TOLERANCE / np.sqrt(state.total_rows)
    rows = chain.pieces[-1].rows
    path = model.motion.path(np.array(chain.knots_s[-2:]))
    values = chain.values(len(chain.knots_s) - 2, len(chain.knots_s) - 1)
    first = len(chain.pieces) - 1

    def residual(at):
        return model.evaluate(rows, path, at, first)[0].found.residual

    for axis in range(3):
        by = np.zeros(chain.size)
        by[axis] = found.path[0] * model.path_scale[axis]
        ahead, back = (dataclasses.replace(values, path=values.path + s * by) for s in (1, -1))
        second = residual(ahead) + residual(back) - 2.0 * residual(values)
        assert 0.5 * np.abs(second).max() < 3.0 * allowed


def test_starting_says_what_is_missing():
    recording = small_pass(1)
    smoother = gg.IncrementalSmoother.of(recording)
    assert smoother.estimate.status is gg.Tracking.COLLECTING
    # One station alone; a bearing of each of two others would do.
    own = np.flatnonzero(recording.bearings.sensor == 0)
    estimate = smoother.update(feeding.take(recording.bearings, own[:2]))
    assert "needs at least 9 at 4 times" in estimate.message
    estimate = smoother.update(feeding.take(recording.bearings, own[2:]))
    assert estimate.status is gg.Tracking.COLLECTING
    assert "do not determine the path" in estimate.message
    assert estimate.time_s is None
    with pytest.raises(gg.UpdateError, match="there is no track yet"):
        smoother.track()


def test_what_holds_along_the_whole_path():
    recording = small_pass(1)
    table = gg.Constraints(
        time_s=np.array([np.nan]),
        kind=("speed_m_s",),
        value=np.array([7600.0]),
        sigma=np.array([30.0]),
        line=np.array([2]),
    )
    recording = dataclasses.replace(recording, constraints=table)
    batch = gg.smooth(recording)
    smoother = feeding.feed(gg.IncrementalSmoother.of(recording), recording, every=12)
    sigmas, relative = feeding.differences(smoother.track(), batch)
    assert sigmas < NEAR
    assert relative < ALIKE


class Stacked(Density):
    """The noise of each of a problem's intervals: a reference without the smoother's own code."""

    def square_root(self, velocity_m_s, count):
        del velocity_m_s
        assert count == self.each.size
        return self.each[:, None, None] * np.eye(3)

    def inverse_square_root(self, velocity_m_s, count):
        return np.linalg.inv(self.square_root(velocity_m_s, count))


def test_process_noise_changes_from_the_newest_knot_on(monkeypatch):
    """Equal to a batch solved over the same knots, whose noise is the one, then the other."""
    recording = small_pass(4)
    noise = recording.settings.process_noise
    pieces = list(feeding.parts(recording, every=4))
    smoother = gg.IncrementalSmoother.of(recording)
    for part in pieces[:18]:
        smoother.update(part)
    before, begun = smoother.estimate, smoother._state.chain
    oldest, first = begun.pieces[0].rows, begun.knots_s[0]
    smoother.change_process_noise(100.0 * noise)
    np.testing.assert_array_equal(smoother.estimate.state, before.state)
    for part in pieces[18:]:
        smoother.update(part)
    after = smoother.estimate
    model, chain = smoother._state.running
    knots = np.array([first, *chain.knots_s])
    assert before.time_s in knots

    monkeypatch.setattr(motion, "compiled", None)
    density = Stacked((noise,) * 3)
    object.__setattr__(density, "each", np.where(knots[:-1] < before.time_s, noise, 100 * noise))
    reference = replace(model, motion=Motion("constant-acceleration", density, "ecef"))
    problem = problem_of(reference, knots, join([oldest, *(p.rows for p in chain.pieces)]))
    held = chain.values(0, len(chain.knots_s) - 1)
    start = replace(
        held,
        path=held.path[[0, *range(len(held.path))]],
        walks=held.walks[[0, *range(len(held.path))]],
    )
    start.path[0, :3] -= (knots[1] - knots[0]) * start.path[0, 3:6]
    solution = solve(problem, start, max_iterations=100)
    found = solution.elimination.marginals().knots[-1][:9, :9] * np.outer(
        model.path_scale, model.path_scale
    )
    gap = after.state - solution.values.path[-1]
    assert np.sqrt(gap @ np.linalg.solve(found, gap)) < NEAR
    np.testing.assert_allclose(after.covariance, found, rtol=ALIKE, atol=ALIKE * 1e-3)


def test_process_noise_changes_before_the_start_and_wrong_ones_are_refused():
    recording = small_pass(4)
    noise = recording.settings.process_noise
    smoother = gg.IncrementalSmoother.of(recording)
    smoother.change_process_noise(10.0 * noise)
    feeding.feed(smoother, recording, every=10)
    batch = gg.smooth(recording, process_noise=10.0 * noise)
    assert feeding.differences(smoother.track(), batch)[0] < NEAR
    with pytest.raises(gg.InputError, match="auto"):
        smoother.change_process_noise("auto")
    with pytest.raises(gg.InputError, match="process_noise"):
        smoother.change_process_noise(-1.0)
    still = gg.IncrementalSmoother.of(standing())
    with pytest.raises(gg.InputError, match="stands still"):
        still.change_process_noise(1.0)


def test_everything_is_evaluated_once():
    recording = small_pass(1)
    smoother = feeding.feed(gg.IncrementalSmoother.of(recording), recording, every=12)
    held = np.concatenate([part.columns["line"] for part in everything(smoother._state)])
    assert sorted(held.tolist()) == sorted(recording.bearings.line.tolist())


def standing(walk=0.0):
    """150 bearings of 1 mrad by two sensors of an object that stands still."""
    rng = np.random.default_rng(1)
    places = np.array([[0.0, 0.0, 0.0], [5000.0, 0.0, 0.0]])
    errors = gg.SensorErrors(azimuth_bias_rad=2e-3, azimuth_instability_rad_sqrt_s=walk)
    sensors = {
        f"S{i}": gg.Sensor(name=f"S{i}", position_m=place, axes="xyz", errors=errors)
        for i, place in enumerate(places)
    }
    size, sigma = 150, 1e-3
    sensor = np.arange(size) % 2
    way = np.array([2000.0, 6000.0, 1500.0]) - places[sensor]
    elevation = np.arctan2(way[:, 2], np.hypot(way[:, 0], way[:, 1]))
    azimuth = np.arctan2(way[:, 1], way[:, 0])
    table = gg.Bearings(
        time_s=np.arange(size) * 1.0,
        sensor=sensor,
        azimuth_rad=azimuth + sigma * rng.normal(size=size) / np.cos(elevation),
        elevation_rad=elevation + sigma * rng.normal(size=size),
        sigma_azimuth_rad=np.full(size, sigma),
        sigma_elevation_rad=np.full(size, sigma),
        isotropic=np.ones(size, dtype=bool),
        line=np.arange(size),
    )
    return gg.Recording(
        name="standing",
        frame="local",
        sensors=sensors,
        bearings=table,
        settings=gg.SmoothSettings(motion="static", loss="none"),
        propagation_speed_m_s=np.inf,
    )


@pytest.mark.parametrize(
    "make",
    [standing, lambda: standing(1e-5), lambda: platforms(3), lambda: formation(1)],
    ids=["bearings", "walks", "bursts of signals", "from orbit"],
)
@pytest.mark.parametrize("lag", [None, 40.0])
def test_what_stands_still_equals_the_batch_row_by_row(make, lag):
    recording = make()
    batch = gg.smooth(recording)
    smoother = feeding.feed(gg.IncrementalSmoother.of(recording, lag=lag), recording, every=1)
    estimate = smoother.estimate
    assert feeding.newest_sigmas(estimate, batch) < (NEAR if lag is None else NEWEST)
    # Knots are for what changes, not for every row.
    assert estimate.knots < 20
    if lag is None:
        sigmas, relative = feeding.differences(smoother.track(), batch)
        assert sigmas < NEAR
        assert relative < ALIKE


def test_names_of_emissions_leave_with_the_lag(tmp_path):
    """Names do not pile up; those that are held are still known, and numbers are not used again."""
    recording = gg.read(write_example("locards", tmp_path / "locards")[3])
    span = np.ptp(recording.arrivals.toa_s)
    smoother = gg.IncrementalSmoother.of(recording, lag=0.2 * span)
    feeding.feed(smoother, recording, every=1)
    held = smoother._state.rows()["arrivals"]["emission"]
    everything = len(recording.arrivals.emission_names)
    assert np.unique(held).size == len(smoother._emissions) < 0.7 * everything
    assert held.max() == everything - 1
    # The newest arrival again is still a duplicate, by its name.
    table = recording.arrivals
    newest = feeding.take(table, [int(np.argmax(table.toa_s))])
    assert smoother.update(newest).duplicate_count == 1
