"""Forces on satellites: against published places, against the simulator's, and by differences."""

import json
from dataclasses import fields, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from differences import assert_derivative
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import geograph as gg
from geograph.constants import (
    ATMOSPHERE_DENSITY_KG_M3,
    ATMOSPHERE_HEIGHT_M,
    ATMOSPHERE_SCALE_M,
    EARTH_ROTATION_RAD_S,
)
from geograph.earth import earth_fixed_from_gcrs
from geograph.errors import InputError
from geograph.factors.forces import Forces, along_orbit, density, drag, height_along_radius
from geograph.factors.gravity import propagate, total_acceleration
from geograph.geodesy import ecef_from_geodetic
from geograph.io.instants import instant_of
from geograph.motion import Density, Motion
from geograph.orbit_arcs import along, lambert
from geograph.path import BallisticPath
from geograph.recording import SmoothSettings
from geograph.scenarios import perturbed_orbits as simulated
from geograph.scenarios.orbits import turned_about_z
from geograph.scenarios.registry import scenario
from geograph.shooting import fall
from geograph.third_bodies import BODIES, ThirdBodies

EPOCH = datetime(2026, 1, 1, tzinfo=UTC)
PROFILE = settings(max_examples=5, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
SPIN = np.array([0.0, 0.0, EARTH_ROTATION_RAD_S])
AUTHORITY = Path(__file__).parent / "authorities" / "moon_and_sun.json"


def forces(**changes):
    names = ("moon", "sun")
    everything = {
        "gm_m3_s2": tuple(BODIES[name] for name in names),
        "bodies_m": ThirdBodies(EPOCH, names),
        "drag_m2_kg": 0.02,
        "drag_sigma_m2_kg": 0.01,
        "acceleration_sigma_m_s2": 1e-4,
    }
    return Forces(**everything | changes)


def random_state(rng, *, height=(200e3, 2e6)):
    """A satellite with unknowns of forces: shape (10,)."""
    up, aside = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
    place = (6.378e6 + rng.uniform(*height)) * up
    velocity = rng.uniform(6e3, 9e3) * aside + rng.uniform(-1e3, 1e3) * up
    return np.concatenate([place, velocity, 1e-4 * rng.normal(size=3), [0.005]])


@pytest.mark.parametrize("row", json.loads(AUTHORITY.read_text())["positions"])
def test_moon_and_sun_are_where_jpl_has_them(row):
    """Directions within 20" (the Moon's series) and distances within 1e-4, from 1973 to 2025."""
    utc = datetime(2000, 1, 1, 12, tzinfo=UTC) + timedelta(days=row["tt_jd"] - 2451545.0)
    tt_less_utc = 64.184 if utc.year >= 1999 else {1973: 44.184, 1992: 58.184}[utc.year]
    tt_less_utc += {2009: 2.0, 2020: 5.0, 2024: 5.0, 2025: 5.0}.get(utc.year, 0.0)
    epoch = utc - timedelta(seconds=tt_less_utc)
    found = ThirdBodies(epoch, ("moon", "sun"))(np.zeros(1))[0]
    turn = earth_fixed_from_gcrs(np.array([instant_of(epoch)]), None, "optical")[0]
    for place, name in zip(found, ("moon", "sun"), strict=True):
        expected = 1e3 * turn @ np.array(row[f"{name}_gcrs_km"])
        distance = np.linalg.norm(expected)
        assert np.linalg.norm(place) == pytest.approx(distance, rel=1e-4)
        off = np.linalg.norm(np.cross(place, expected)) / distance / np.linalg.norm(place)
        # UT1 as UTC is up to 13.5", the Moon's series 10" in longitude.
        assert off < np.radians(25.0 / 3600.0)


def test_places_between_the_nodes_and_beyond_them():
    bodies = ThirdBodies(EPOCH, ("moon", "sun"))
    for time in (np.linspace(0.0, 3000.0, 7), np.array([-40000.0, 90000.0])):
        np.testing.assert_allclose(bodies(time), bodies.exactly(time), rtol=1e-9, atol=10.0)


@pytest.mark.parametrize("axes", ["rtn", "inertial"])
@pytest.mark.parametrize("high", [False, True])
def test_forces_are_those_of_the_simulator(high, axes):
    """Written apart, in axes at rest, with other series for Moon and Sun."""
    rng = np.random.default_rng(3)
    for time in (0.0, 40000.0, 8e6):
        state = random_state(rng, height=(3.57e7, 3.58e7) if high else (3e5, 4e5))
        known = state.copy()
        known[6:9] *= 0.01 if high else 1.0
        own = forces(axes=axes)
        found, *_ = total_acceleration(known[None], np.array([time]), "ecef", 4, own)
        rest, *_ = total_acceleration(known[None, :6], None, "ecef", 4)
        angle = EARTH_ROTATION_RAD_S * time
        place = turned_about_z(known[:3], angle)
        velocity = turned_about_z(known[3:6] + np.cross(SPIN, known[:3]), angle)
        acting = simulated.Forces(
            moon=True, sun=True, drag_m2_kg=0.025, constant_m_s2=tuple(known[6:9]), axes=axes
        )
        both = np.stack([place, velocity])
        total = simulated.acceleration(both, time, EPOCH, acting)
        gravity = simulated.zonal_gravity(place)
        expected = turned_about_z(total - gravity, -angle)
        size = np.linalg.norm(expected)
        # 3 % of the drag between two rows of the table; arc minutes of Moon and Sun.
        assert np.linalg.norm(found[0] - rest[0] - expected) < (0.01 if high else 0.04) * size
        fictitious = -2.0 * np.cross(SPIN, known[3:6]) - np.cross(SPIN, np.cross(SPIN, known[:3]))
        pull = turned_about_z(gravity, -angle) + fictitious
        np.testing.assert_allclose(rest[0], pull, rtol=0.0, atol=1e-9)


@PROFILE
@given(seeds, st.sampled_from(["rtn", "inertial"]))
def test_derivatives_of_the_forces_and_of_the_fall(seed, axes):
    state, own = random_state(np.random.default_rng(seed)), forces(axes=axes)
    time = np.array([1000.0])
    _, *by = total_acceleration(state[None], time, "ecef", 4, own)
    scale = np.concatenate([np.repeat([300.0, 1.0], 3), np.full(3, 1e-5), [1e-3]])

    def fallen(at):
        return propagate(at[None], np.array([37.0]), "ecef", 4, forces=own, start_s=time)[0][0]

    assert_derivative(
        np.concatenate([part[0] for part in by], axis=1),
        lambda at: total_acceleration(at[None], time, "ecef", 4, own)[0][0],
        state, scale, rtol=1e-6, floor=1e-3,
    )  # fmt: skip
    _, jacobian = propagate(state[None], np.array([37.0]), "ecef", 4, forces=own, start_s=time)
    assert_derivative(jacobian[0], fallen, state, scale, rtol=1e-6, floor=1e-3)


def test_parts_of_the_forces():
    rng = np.random.default_rng(5)
    state = random_state(rng)
    place, velocity = state[None, :3], state[None, 3:6]
    vector, axes, _, _ = along_orbit(place, velocity, np.array([[1.0, 2.0, 3.0]]))
    np.testing.assert_allclose(axes[0].T @ axes[0], np.eye(3), atol=1e-14)
    assert vector[0] @ place[0] / np.linalg.norm(place) == pytest.approx(1.0)
    unit, _, _ = drag(place, velocity)
    assert unit[0] @ velocity[0] < 0.0
    for latitude in (0.0, 40.0, 90.0):
        height, _ = height_along_radius(ecef_from_geodetic(latitude, 20.0, 8e5)[None])
        assert height[0] == pytest.approx(8e5, abs=6.0)
    rho, slope = density(np.array(ATMOSPHERE_HEIGHT_M))
    np.testing.assert_allclose(rho, ATMOSPHERE_DENSITY_KG_M3, rtol=1e-12)
    # The table's own scale heights, from row to row.
    middle = 0.5 * (np.array(ATMOSPHERE_HEIGHT_M[9:-1]) + np.array(ATMOSPHERE_HEIGHT_M[10:]))
    rho, slope = density(middle)
    np.testing.assert_allclose(-rho / slope, ATMOSPHERE_SCALE_M[9:-1], rtol=0.12)
    above = density(np.array([1.2e6, -100.0]))[0]
    assert above[0] == pytest.approx(3.019e-15 * np.exp(-200.0 / 268.0))
    assert above[1] == 1.225


def test_a_path_under_forces():
    """Quintic between knots against propagation, and the derivatives of both neighbours."""
    rng = np.random.default_rng(7)
    own, knots = forces(), np.array([100.0, 140.0, 180.0])
    state = np.repeat(random_state(rng)[None], 3, axis=0)
    motion = Motion("orbital", Density.of(1e-3), "ecef", own)
    for k in (0, 1):
        state[k + 1] = motion.predict(state[k][None], np.array([40.0]), knots[k : k + 1])[0][0]
    assert motion.size == 10
    assert motion.cost(state, np.diff(knots), knots[:-1]) < 1e-6
    path = motion.path(knots)
    assert isinstance(path, BallisticPath)
    time = np.array([117.0, 163.0])
    read = motion.read(path, state, time)
    alone, _ = motion.predict(state[:2], time - knots[:2], knots[:2])
    np.testing.assert_allclose(read, alone, rtol=0.0, atol=1e-4)
    outside = motion.read(path, state, np.array([95.0, 190.0]))
    assert np.abs(outside[:, :3]).max() < 1e8
    place = path.locate(time)
    eye = np.broadcast_to(np.eye(3), (2, 3, 3))
    by = path.at_state(state, jacobian=True).chain(place, eye, None)
    scale = np.concatenate([np.repeat([300.0, 1.0], 3), np.full(3, 1e-4), [1e-3]])

    def moved(pair):
        return path.at_state(pair.reshape(3, 10), jacobian=False).position_velocity(place)[0]

    whole = np.zeros((6, 30))
    for row, k in enumerate(place.interval):
        whole[3 * row : 3 * row + 3, 10 * k : 10 * k + 20] = by[row].reshape(3, 20)
    assert_derivative(
        whole,
        lambda x: moved(x).ravel(),
        state.ravel(),
        np.tile(scale, 3),
        rtol=1e-6,
        floor=1e-3,
    )


def test_orbits_through_two_places():
    rng = np.random.default_rng(9)
    state = np.stack([random_state(rng)[:6] for _ in range(20)])
    time = np.array([600.0, 1200.0])
    there = along(state[:, :3], state[:, 3:], time)
    # The fall of two bodies, from the energy and the angular momentum that it keeps.
    found = lambert(state[:, :3], there[:, 1], 1200.0, far=False)
    np.testing.assert_allclose(found, state[:, 3:], rtol=0.0, atol=1e-3)
    back = along(state[:, :3], found, time)
    np.testing.assert_allclose(back, there, rtol=0.0, atol=2.0)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"motion": "ballistic", "moon": True}, "moon needs the motion orbital; given ballistic"),
        ({"drag_m2_kg": -1.0}, "drag_m2_kg is -1.0; expected a finite number above 0"),
        ({"sun": 1}, "sun is 1; expected true or false"),
        ({"acceleration_axes": "body"}, "unknown acceleration_axes 'body'"),
    ],
)
def test_wrong_settings(changes, match):
    with pytest.raises(InputError, match=match):
        SmoothSettings(**{"motion": "orbital"} | changes)


def test_forces_need_the_earth():
    recording = scenario("room").simulate(0)
    with pytest.raises(InputError, match="sun needs the frame ecef"):
        gg.smooth(recording, motion="orbital", sun=True)


def test_an_unknown_acceleration_is_found(tmp_path):
    """A pass over two sites; written, read, smoothed, and carried on as it happens."""
    values = {"bearings": 40, "passes": 1, "duration_s": 900.0, "drag_sigma_m2_kg": 0.01}
    made = scenario("orbit-thrust").simulate(5, values | {"acceleration_sigma_m_s2": 1e-2})
    recording = gg.write(made, tmp_path / "orbit")
    assert recording.settings == made.settings
    track = gg.smooth(recording)
    assert track.state.shape[1] == 6
    found = track.sensor_errors["(recording)"]
    # Of a random acceleration of 1e-2: some components in a single pass.
    assert min(entry.sigma / entry.prior_sigma for entry in found.values()) < 0.1
    inside = (made.truth.time_s > track.time_s[0]) & (made.truth.time_s < track.time_s[-1])
    error = track.at(made.truth.time_s[inside]).position_m - made.truth.position_m[inside]
    covariance = track.at(made.truth.time_s[inside]).position_covariance_m2
    nees = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    # One draw along the path: chi-square with 3 degrees of freedom passes 21 once in 10 000.
    assert np.median(nees) < 21.0
    graph = gg.build(recording)
    assert graph.graph.error(graph.encode(track.values)) == pytest.approx(
        track.problem.cost(track.values), rel=1e-6
    )
    smoother = gg.IncrementalSmoother.of(recording)
    for rows in np.array_split(np.arange(len(recording.bearings)), 8):
        estimate = smoother.update([some(recording.bearings, rows)])
    whole = track.at(estimate.time_s)
    sigma = np.sqrt(np.diagonal(whole.covariance[0]))
    assert np.abs((estimate.state - whole.state[0]) / sigma).max() < 0.02
    for name, entry in estimate.sensor_errors["(recording)"].items():
        assert abs(entry.estimate - found[name].estimate) < 0.02 * found[name].sigma


def some(table, rows):
    columns = {entry.name: getattr(table, entry.name) for entry in fields(table)}
    return replace(
        table, **{name: c[rows] for name, c in columns.items() if isinstance(c, np.ndarray)}
    )


def test_pieces_are_joined_to_what_an_integrator_gives():
    """Moon, Sun, drag and a thrust: two hours, 280 km high, by steps of the eighth order.

    The thrust and the drag take the object tens of kilometres from where it falls freely.
    """
    acting = forces()
    state = np.array([6.66e6, 0.0, 0.0, 0.0, 3115.0, 6850.0, 1e-3, -5e-4, 1e-3, 0.005])

    def rates(now, packed):
        whole = np.concatenate([packed, state[6:]])[None]
        value = total_acceleration(whole, np.array([now]), "ecef", 4, acting)[0][0]
        return np.concatenate([packed[3:], value])

    time = np.array([500.0, 5000.0, 7200.0])
    exact = solve_ivp(
        rates, (0.0, time[-1]), state[:6], method="DOP853", t_eval=time, rtol=1e-11, atol=1e-4
    ).y.T
    found, derivative = fall(state, 0.0, time, acting)
    free, _ = fall(state[:6], 0.0, time)
    assert np.linalg.norm(free[-1, :3] - exact[-1, :3]) > 1e4
    np.testing.assert_allclose(found[:, :3], exact[:, :3], rtol=0.0, atol=0.05)
    for column, step in {0: 10.0, 4: 0.01, 7: 1e-6, 9: 1e-4}.items():
        aside = step * np.eye(state.size)[column]
        ahead, behind = (fall(state + sign * aside, 0.0, time, acting)[0] for sign in (1.0, -1.0))
        slope = (ahead - behind) / (2.0 * step)
        off = np.abs(derivative[:, :, column] - slope).max(axis=0)
        assert (off < 1e-4 * np.abs(slope).max(axis=0)).all()
