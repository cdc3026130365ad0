"""Orbits from angles alone: passes from one site, from two, and a night of a geostationary object.

The truth falls in axes at rest, in the potential of test_gravity; nothing of the estimator's.
"""

from datetime import UTC, datetime

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from test_gravity import SPIN, derivative, potential

import geograph as gg
from geograph import falls, shooting
from geograph.factors.gravity import propagate
from geograph.geodesy import ecef_from_geodetic, enu_axes
from geograph.measurements import Bearings
from geograph.recording import Recording, SmoothSettings
from geograph.scenarios.registry import scenario
from geograph.sensors import Sensor

SIGMA = 5e-6
LEO = np.array([5694815.7, 0.0, 3896033.1, -3433.0, 4060.0, 5018.0])
GEO = np.array([4.2164e7, 0.0, 0.0, 0.0, 3.0, 20.0])


def at_rest(start, duration):
    def rates(_, state):
        return np.concatenate(
            [state[3:], -derivative(lambda at: [potential(at, 4)], state[:3], 3e4)[0]]
        )

    state = np.concatenate([start[:3], start[3:] + np.cross(SPIN, start[:3])])
    return solve_ivp(
        rates, (-1.0, duration), state, method="DOP853", rtol=1e-10, atol=1e-3, dense_output=True
    ).sol


def turned(vector, time):
    """Return components on axes that turned with the Earth for a time, shapes (n, 3) and (n,)."""
    angle = SPIN[2] * time
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = vector.T
    return np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=1)


def seen(start, sites, time, noise, *, seed=1):
    """Return a recording of what is more than 10 degrees above the horizon, and the truth."""
    rng, orbit, rows = np.random.default_rng(seed), at_rest(start, time[-1]), []
    for index, site in enumerate(sites):
        place = ecef_from_geodetic(*site)
        delay = np.zeros(time.size)
        for _ in range(4):
            line = turned(orbit(time - delay)[:3].T, time) - place
            delay = np.linalg.norm(line, axis=1) / 299792458.0
        east, north, up = enu_axes(place) @ line.T
        elevation = np.arctan2(up, np.hypot(east, north))
        high = elevation > np.radians(10.0)
        azimuth = np.arctan2(east, north)[high]
        elevation = elevation[high] + SIGMA * rng.normal(size=high.sum())
        azimuth += SIGMA * rng.normal(size=high.sum()) / np.cos(elevation)
        rows.append((time[high], np.full(high.sum(), index), azimuth, elevation))
    when, sensor, azimuth, elevation = (np.concatenate(part) for part in zip(*rows, strict=True))
    sigma = np.full(when.size, SIGMA)
    recording = Recording(
        name="orbit", frame="ecef", epoch=datetime(2024, 3, 20, tzinfo=UTC),
        sensors={f"S{n}": Sensor(name=f"S{n}", position_m=ecef_from_geodetic(*site))
                 for n, site in enumerate(sites)},
        bearings=Bearings(
            time_s=when, sensor=sensor, azimuth_rad=azimuth, elevation_rad=elevation,
            sigma_azimuth_rad=sigma, sigma_elevation_rad=sigma,
            isotropic=np.ones(when.size, bool), line=np.arange(when.size),
        ),
        settings=SmoothSettings(motion="orbital", process_noise=noise),
    )  # fmt: skip
    return recording, turned(orbit(when)[:3].T, when)


CASES = {
    # One pass leaves the orbit poorly known, a second determines it.
    "one pass": (LEO, [(38.0, 2.0, 0.0)], np.arange(0.0, 500.0, 5.0), 1e-4, 100.0),
    "two passes": (LEO, [(38.0, 2.0, 0.0)], np.arange(0.0, 13000.0, 10.0), 1e-4, 50.0),
    "two sites": (
        LEO, [(38.0, 2.0, 0.0), (45.0, 14.0, 0.0)], np.arange(0.0, 7000.0, 10.0), 1e-4, 20.0
    ),
    "geostationary": (GEO, [(45.0, 10.0, 0.0)], np.arange(0.0, 28800.0, 300.0), 1e-4, 500.0),
}  # fmt: skip


@pytest.mark.parametrize("case", list(CASES))
def test_angles_alone_give_the_orbit(case):
    start, sites, time, noise, near = CASES[case]
    recording, truth = seen(start, sites, time, noise)
    track = gg.smooth(recording)
    summary = track.summary
    assert summary["status"] == "converged"
    # Chi-square within 4 standard deviations: once in ten thousand runs. The truth has no process
    # noise, so that it may be lower than degrees of freedom, not by much.
    freedom = summary["degrees_of_freedom"]
    assert abs(summary["chi2"] - freedom) < 4.0 * np.sqrt(2.0 * freedom)
    found = track.at(recording.bearings.time_s)
    error = found.position_m - truth
    assert np.linalg.norm(error, axis=1).max() < near
    nees = np.einsum(
        "ni,ni->n", error, np.linalg.solve(found.position_covariance_m2, error[..., None])[..., 0]
    )
    # One path is one draw: chi-square with 3 degrees of freedom passes 21 once in ten thousand.
    assert np.median(nees) < 21.0


@pytest.mark.parametrize("there", [True, False], ids=["compiled", "numpy"])
def test_the_fit_falls_as_the_motion_does(monkeypatch, there):
    """Pieces and their derivatives against the motion's own, there and back, whatever does it."""
    if not there:
        monkeypatch.setattr(shooting, "compiled", None)
        monkeypatch.setattr(falls, "compiled", None)
    time = np.array([-300.0, 0.0, 77.0, 2000.0])
    states, jacobian = shooting.fall(LEO, 0.0, time)
    for row, step in enumerate(time):
        state, matrix = propagate(LEO[None], np.array([step]), "ecef", 4)
        np.testing.assert_allclose(states[row], state[0], rtol=1e-9, atol=1e-3)
        np.testing.assert_allclose(jacobian[row], matrix[0], rtol=1e-6, atol=1e-6)


def test_a_wrong_orbit_through_the_first_directions_does_not_end_the_search():
    """A circle meets 22 early directions to 1.4 sigmas; the orbit is an eccentric one."""
    made = scenario("orbit-molniya").simulate(5)
    assert gg.smooth(made).summary["status"] == "converged"
