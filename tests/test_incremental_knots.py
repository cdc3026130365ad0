"""Knots of a feed whose measurements come in pairs, a moment apart."""

from __future__ import annotations

import feeding
import numpy as np
import pytest

import geograph as gg
from geograph.knots import CLOSE, thinned


def pairs():
    """Two cameras, one half a millisecond after the other, and an object that accelerates.

    Coordinates are those of a place on Earth: rounding leaves a nanometre of them. In half a
    millisecond the noise of this motion moves the object by less.
    """
    rng = np.random.default_rng(3)
    times = np.sort(np.concatenate([np.arange(40.0), np.arange(40.0) + 5e-4]))
    sensor = np.arange(times.size) % 2
    places = np.array([[4.3e6, 5.9e5, 4.65e6], [4.3e6, 6.1e5, 4.65e6]])
    way = times[:, None] * [0.0, 150.0, 30.0] + 0.5 * times[:, None] ** 2 * [1.0, 0.0, -2.0]
    start = np.array([4.32e6, 6.0e5, 4.65e6])
    x, y, z = (start + way - places[sensor]).T
    sigma = np.full(times.size, 1e-4)
    elevation = np.arctan2(z, np.hypot(x, y))
    return gg.Recording(
        name="pairs",
        frame="ecef",
        sensors={
            name: gg.Sensor(name=name, position_m=place, axes="xyz")
            for name, place in zip("AB", places, strict=True)
        },
        bearings=gg.Bearings(
            time_s=times,
            sensor=sensor,
            azimuth_rad=np.arctan2(y, x) + sigma * rng.normal(size=x.size) / np.cos(elevation),
            elevation_rad=elevation + sigma * rng.normal(size=x.size),
            sigma_azimuth_rad=sigma,
            sigma_elevation_rad=sigma,
            isotropic=np.ones(x.size, dtype=bool),
            line=np.arange(x.size) + 2,
        ),
        propagation_speed_m_s=np.inf,
        settings=gg.SmoothSettings(motion="constant-acceleration", process_noise=0.2),
    )


@pytest.mark.parametrize("engine", ["structured", "isam2"])
def test_pairs_a_moment_apart_end_as_the_batch(engine):
    """The last pair, too, of which the second would be a knot of its own."""
    recording = pairs()
    spacing = 0.9
    batch = gg.smooth(recording, spacing_s=spacing)
    smoother = gg.IncrementalSmoother.of(recording, spacing_s=spacing, engine=engine)
    for row in range(len(recording.bearings)):
        smoother.update(feeding.take(recording.bearings, [row]))
    sigmas, relative = feeding.differences(smoother.track(), batch)
    assert sigmas < 0.1
    assert relative < 0.02
    assert feeding.newest_sigmas(smoother.estimate, batch) < 0.1
    assert smoother.estimate.time_s == recording.bearings.time_s[-1]
    estimate = smoother.finish()
    assert estimate.used == len(recording.bearings)
    assert estimate.rebuilt == 0
    track = smoother.track()
    assert np.diff(track.time_s).min() > CLOSE * spacing
    assert track.time_s[-1] == recording.bearings.time_s[-1]
    sigmas, relative = feeding.differences(track, batch)
    assert sigmas < 0.001
    assert relative < 0.001


def test_all_at_once_or_row_by_row_no_closed_interval_is_short():
    recording = pairs()
    smoother = gg.IncrementalSmoother.of(recording, spacing_s=0.9)
    first, rest = np.arange(20), np.arange(20, 79)
    smoother.update(feeding.take(recording.bearings, first))
    smoother.update(feeding.take(recording.bearings, rest[:30]))
    for row in rest[30:]:
        smoother.update(feeding.take(recording.bearings, [row]))
    steps = np.diff(smoother.track().time_s)
    assert steps[:-1].min() > CLOSE * 0.9


def test_thinned_knots_keep_both_ends_and_fill_gaps():
    knots = np.array([0.0, 0.05, 1.0, 2.0, 2.05])
    np.testing.assert_array_equal(thinned(knots, 1.0, 5.0), [0.0, 1.0, 2.05])
    np.testing.assert_array_equal(thinned(knots, 30.0, 60.0), [0.0, 2.05])
    assert np.diff(thinned(knots, 1.0, 1.0)).max() <= 1.0
