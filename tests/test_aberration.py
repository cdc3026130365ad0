"""Directions against the stars: derivatives, and ERFA's own way there and back."""

from datetime import UTC, datetime

import numpy as np
import pytest
from differences import assert_derivative
from hypothesis import given, settings
from hypothesis import strategies as st

from geograph.factors.aberration import astrometric_sight

erfa = pytest.importorskip("erfa")
ARCSEC = np.pi / 648000.0
seeds = st.integers(0, 2**32 - 1)


def unit(vector):
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seeds, st.sampled_from([1e-4, 0.3]), st.sampled_from([2e-8, 0.01]))
def test_derivative_by_the_line_of_sight(seed, velocity, bending):
    """At the Earth's speed, and at speeds and bendings at which every term is felt."""
    rng = np.random.default_rng(seed)
    line = unit(rng.normal(size=3)) * 10.0 ** rng.uniform(3, 9)
    moving, sun = velocity * unit(rng.normal(size=(1, 3))), unit(rng.normal(size=(1, 3)))
    # Straight at the Sun the bending is held.
    if unit(line) @ sun[0] < -0.99:
        sun = -sun
    bend = np.array([bending])
    value, jacobian = astrometric_sight(line[None], moving, sun, bend, jacobian=True)
    assert_derivative(
        jacobian[0],
        lambda at: astrometric_sight(at[None], moving, sun, bend)[0][0],
        line,
        1e-3 * np.linalg.norm(line),
        rtol=1e-8,
    )
    np.testing.assert_array_equal(value, astrometric_sight(line[None], moving, sun, bend)[0])


def test_a_direction_alone_decides():
    rng = np.random.default_rng(5)
    line, moving, sun = rng.normal(size=(3, 4, 3))
    moving, sun, bend = 1e-4 * moving, unit(sun), np.full(4, 2e-8)
    near, _ = astrometric_sight(line, moving, sun, bend)
    far, _ = astrometric_sight(4e7 * line, moving, sun, bend)
    np.testing.assert_allclose(unit(near), unit(far), rtol=0.0, atol=1e-15)


def test_light_from_the_front_and_from_the_side():
    """From the front nothing turns; from the side the object is left behind by v / c."""
    moving = np.array([[0.0, 1e-4, 0.0]] * 2)
    still = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    seen, _ = astrometric_sight(still, moving, np.array([[0.0, 0.0, 1.0]] * 2), np.zeros(2))
    np.testing.assert_allclose(unit(seen)[0], still[0], atol=1e-16)
    assert np.arcsin(unit(seen)[1, 1]) == pytest.approx(-np.arcsin(1e-4), abs=1e-15)


def test_against_erfa():
    """ERFA's atciqz goes from the catalogue to the Earth's centre, by iteration back."""
    from geograph.earth import CelestialAxes, gcrs_from_astrometric
    from geograph.io.instants import from_datetime

    epoch = datetime(2023, 11, 2, 3, 4, 5, tzinfo=UTC)
    time = np.linspace(-1e7, 1e7, 400)
    catalogue = unit(np.random.default_rng(7).normal(size=(400, 3)))
    axes = CelestialAxes(epoch)
    axes.cover(time)
    stars = axes.stars(time)
    tai = from_datetime(epoch) + np.round(time * 1e9).astype(np.int64)
    # Further from the Sun than 15 degrees, where telescopes look.
    dark = np.einsum("ni,ni->n", catalogue, stars.sun_to_earth) > -np.cos(np.radians(15.0))
    apparent = gcrs_from_astrometric(catalogue, tai, "x", "optical")
    found, _ = astrometric_sight(
        3e7 * apparent, stars.earth_velocity, stars.sun_to_earth, stars.bending
    )
    error = np.linalg.norm(unit(found) - catalogue, axis=1)[dark]
    assert error.max() < 1e-4 * ARCSEC
    moved = np.linalg.norm(apparent - catalogue, axis=1)
    assert 20.0 * ARCSEC < moved.max() < 21.0 * ARCSEC
