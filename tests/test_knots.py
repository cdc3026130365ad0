"""Knots: spacing from the noise, placement, and what memory allows."""

import numpy as np
import pytest

from geograph.errors import InputError
from geograph.knots import (
    NEGLIGIBLE,
    Resolution,
    automatic_spacing,
    check_memory,
    ignored_share,
    place_knots,
)
from geograph.motion import Density, Motion
from geograph.sensors import Sensor, SensorErrors
from geograph.states import SensorStates

RESOLUTION = Resolution(count=300, span_s=100.0, sigma_m=5.0, sigma_rad=1e-4)
NOTHING = SensorStates([], [], 0.0)


def walking(diffusion):
    errors = SensorErrors(azimuth_instability_rad_sqrt_s=diffusion)
    return SensorStates([Sensor(name="A", position_m=np.zeros(3), errors=errors)], [0], 0.0)


@pytest.mark.parametrize(
    ("name", "order", "middle"),
    [("constant-position", 1, 1 / 4), ("constant-velocity", 2, 1 / 192), ("ballistic", 2, 1 / 192),
     ("constant-acceleration", 3, 1 / 20480)],
)  # fmt: skip
def test_ignored_share_by_hand(name, order, middle):
    """q^2 c h^(2m-1) n h / (T sigma^2) with 3 measurements a second of 5 m."""
    motion = Motion(name, Density.of(2.0, None), "local")
    expected = 4.0 * middle * 1.5 ** (2 * order - 1) * (3.0 * 1.5 / 25.0)
    assert ignored_share(motion, 1.5, RESOLUTION) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("name", ["constant-position", "constant-velocity"])
def test_automatic_spacing_is_the_widest_that_may_be_ignored(name):
    motion = Motion(name, Density.of(50.0), "local")
    spacing = automatic_spacing(motion, NOTHING, RESOLUTION)
    assert spacing < 25.0
    assert ignored_share(motion, spacing, RESOLUTION) == pytest.approx(NEGLIGIBLE, rel=1e-9)


def test_quiet_motion_has_four_intervals_and_free_fall_at_most_a_minute():
    quiet = Motion("constant-acceleration", Density.of(1e-12), "local")
    assert automatic_spacing(quiet, NOTHING, RESOLUTION) == pytest.approx(25.0)
    fall = Motion("orbital", Density.of(1e-12), "ecef")
    long = Resolution(count=300, span_s=1e4, sigma_m=5.0, sigma_rad=1e-4)
    assert automatic_spacing(fall, NOTHING, long) == 60.0
    static = Motion("static", Density.of(1.0), "local")
    assert automatic_spacing(static, NOTHING, RESOLUTION) == pytest.approx(25.0)


def test_walks_ask_for_knots_too():
    """A bridge of variance D^2 h / 4 against 3 measurements a second of 1e-4 rad."""
    quiet = Motion("constant-acceleration", Density.of(1e-12), "local")
    spacing = automatic_spacing(quiet, walking(1e-4), RESOLUTION)
    assert 1e-8 * spacing / 4.0 * (3.0 * spacing / 1e-8) == pytest.approx(NEGLIGIBLE)


def test_knots_cover_the_times():
    times = np.random.default_rng(0).uniform(-7.0, 93.0, 500)
    for spacing in (0.3, 1.0, 33.0, 1e6):
        knots = place_knots(times, spacing, automatic=False)
        assert knots[0] == times.min()
        assert knots[-1] == times.max()
        assert np.diff(knots).max() <= spacing * (1 + 1e-9)
        np.testing.assert_allclose(np.diff(knots), np.diff(knots)[0], rtol=1e-9)
        assert knots.size == max(2, int(np.ceil(np.ptp(times) / spacing)) + 1)


def test_never_more_knots_than_times_when_automatic():
    times = np.repeat([0.0, 1.0, 2.0, 3.0, 4.0, 4.0 + 1e-7, 5.0], 3)
    found = place_knots(times, 0.01, automatic=True)
    np.testing.assert_allclose(found, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0], atol=1e-6)
    assert found[-1] == 5.0
    assert place_knots(times, 0.01, automatic=False).size == 501
    assert place_knots(times, 2.5, automatic=True).size == 3


def test_one_instant_still_has_an_interval():
    knots = place_knots(np.full(5, 3.0), 10.0, automatic=True)
    assert knots.size == 2
    assert knots[0] == 3.0


def test_few_times_have_few_knots_however_large_the_noise():
    # A single emission with a noise that nothing holds asked for 48 000.
    assert place_knots(np.array([3.0]), 1e-5, automatic=True).size == 8
    assert place_knots(np.array([0.0, 1.0, 600.0]), 1e-5, automatic=True, longest_s=60.0).size == 11
    assert place_knots(np.array([0.0, 1.0]), 0.1, automatic=False).size == 11


def test_memory():
    check_memory(1000.0, 60, 0.1)
    with pytest.raises(InputError, match=r"1e-06 s gives 1e\+12 knots.*widen spacing_s") as caught:
        check_memory(1e12, 60, 1e-6)
    assert caught.value.column == "spacing_s"


def test_no_two_knots_are_set_apart_by_rounding_alone():
    """Times of emission that differ by nanoseconds from kind to kind, the last one as well."""
    times = np.concatenate([2.0 * np.arange(1.0, 61.0), 2.0 * np.arange(1.0, 61.0) + 7e-10])
    knots = place_knots(times, 0.5, automatic=True)
    assert knots.size == 60
    assert knots[0] == times.min()
    assert knots[-1] == times.max()
    assert np.diff(knots).min() > 1.9


def test_a_dense_burst_has_knots_of_its_own():
    """Each time is close to the next, but not the first to the last."""
    times = np.concatenate([np.linspace(0.0, 4.5, 60), np.arange(10.0, 1000.0, 10.0)])
    knots = place_knots(times, 1.0, automatic=True)
    assert np.diff(knots[knots <= 4.5]).max() < 0.2


def test_gaps_are_filled_where_an_interval_may_not_be_long():
    """Two passes of bearings, half an hour apart: knots at their times, and between them."""
    times = np.concatenate([np.arange(0.0, 50.0, 10.0), 1800.0 + np.arange(0.0, 50.0, 10.0)])
    knots = place_knots(times, 1.0, automatic=True, longest_s=60.0)
    assert np.isin(times, knots).all()
    assert np.diff(knots).max() <= 60.0
    assert np.diff(knots).min() > 9.0
    assert knots.size == times.size + 29
    np.testing.assert_array_equal(place_knots(times, 1.0, automatic=True), times)
