"""What measurements leave open is told, and no first guess falls into it."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

import geograph as gg
from geograph.geodesy import ecef_from_geodetic, enu_axes
from geograph.initialise import FirstGuess
from geograph.measurements import Bearings, Constraints
from geograph.prepare import prepare
from geograph.recording import Recording
from geograph.sensors import Sensor

STATIONS = np.array(
    [
        [47.18, 8.02, 450.0],
        [46.95, 8.25, 700.0],
        [46.82, 7.95, 520.0],
        [47.02, 7.72, 610.0],
    ]
)
ORIGIN = ecef_from_geodetic(47.0, 8.0, 0.0)
AXES = enu_axes(ORIGIN)
HEIGHT_M = 4000.0
SIGMA_RAD = np.radians(0.2)


def turning(time_s):
    """Return where an aircraft is that flies straight, turns about, and flies back, shape (n, 3)."""
    heading = np.cumsum(np.where((time_s > 70.0) & (time_s < 130.0), np.radians(3.0), 0.0))
    step = np.gradient(time_s)
    heading *= step
    east = np.cumsum(150.0 * np.sin(heading + 1.0) * step) - 8000.0
    north = np.cumsum(150.0 * np.cos(heading + 1.0) * step) - 6000.0
    # The ground falls away below the plane of the origin.
    up = HEIGHT_M - (east**2 + north**2) / 12.74e6
    return ORIGIN + np.stack([east, north, up], axis=1) @ AXES


def bearings_of(position_m, time_s, stations, *, seed, elevations=True):
    """Return a recording of every station's bearings of an object."""
    rng = np.random.default_rng(seed)
    count = len(stations)
    sensor = np.tile(np.arange(count), time_s.size // count + 1)[: time_s.size]
    places = np.stack([ecef_from_geodetic(*place) for place in stations])
    own = np.stack([enu_axes(place) for place in places])
    east, north, up = np.einsum("nij,nj->ni", own[sensor], position_m - places[sensor]).T
    angles = [np.arctan2(east, north), np.arctan2(up, np.hypot(east, north))]
    azimuth, elevation = (angle + SIGMA_RAD * rng.normal(size=time_s.size) for angle in angles)
    nothing = np.full(time_s.size, np.nan)
    sigma = np.full(time_s.size, SIGMA_RAD)
    table = Bearings(
        time_s=time_s,
        sensor=sensor,
        azimuth_rad=azimuth,
        elevation_rad=elevation if elevations else nothing,
        sigma_azimuth_rad=sigma,
        sigma_elevation_rad=sigma if elevations else nothing,
        isotropic=np.zeros(time_s.size, dtype=bool),
        line=np.arange(time_s.size) + 2,
    )
    sensors = {
        f"S{index}": Sensor(name=f"S{index}", position_m=place, axes="enu")
        for index, place in enumerate(places)
    }
    return Recording(
        name="open",
        frame="ecef",
        epoch=datetime(2024, 5, 1, tzinfo=UTC),
        sensors=sensors,
        bearings=table,
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_path_at_a_known_height_does_not_leave_it(seed):
    # Lines miss a path by angles, which vanish far away: in the middle of the Earth, which all
    # planes of azimuth hold, and between the times at which the height was put.
    time = np.linspace(0.0, 200.0, 240)
    truth = turning(time)
    recording = bearings_of(truth, time, STATIONS, seed=seed, elevations=False)
    height = Constraints(
        time_s=np.array([np.nan]),
        kind=("altitude_m",),
        value=np.array([HEIGHT_M]),
        sigma=np.array([200.0]),
        line=np.array([2]),
    )
    ready = prepare(recording)
    finder = FirstGuess(ready.bearings, height, ready.sensors, ready.geometry, np.inf, False)
    none = np.zeros(len(STATIONS))
    for path in (finder.best_fit(none).spline, finder.fit(finder.lines(none), 3, 32).spline):
        # A bearing tells 80 m across the line of sight.
        assert np.linalg.norm(path(time) - truth, axis=1).max() < 1000.0


def test_azimuths_alone_say_that_the_height_is_missing():
    time = np.linspace(0.0, 60.0, 40)
    recording = bearings_of(turning(time), time, STATIONS, seed=0, elevations=False)
    track = gg.smooth(recording, motion="static", loss="none", raise_on_failure=False)
    assert track.status is gg.Status.UNOBSERVABLE
    assert "add elevations, or a constraint altitude_m" in track.summary["message"]


@pytest.mark.parametrize("motion", ["static", "constant-velocity"])
def test_one_place_does_not_put_the_object_on_itself(motion):
    # The lines of one place meet there. Where nothing tells a distance, none must look known.
    time = np.linspace(0.0, 100.0, 60)
    place = ORIGIN + np.array([8e3, 9e3, 1200.0]) @ AXES
    moved = np.linspace(0.0, 2e3, 60)[:, None] * AXES[0] * (motion != "static")
    recording = bearings_of(place + moved, time, STATIONS[:1], seed=1)
    track = gg.smooth(recording, motion=motion, process_noise=1e-3, raise_on_failure=False)
    assert track.status is gg.Status.UNOBSERVABLE
    assert "S0 alone, from one place, sees directions only" in track.summary["message"]
    away = np.linalg.norm(track.position_m - ecef_from_geodetic(*STATIONS[0]), axis=1)
    longest = np.sqrt(np.linalg.eigvalsh(track.position_covariance_m2)[:, -1])
    assert (longest > 0.3 * away).all()
    assert (away > 1e3).all()
