"""What measurements leave open is told, and no first guess falls into it."""

from __future__ import annotations

import dataclasses
from datetime import UTC, datetime

import numpy as np
import pytest

import geograph as gg
from geograph.geodesy import ecef_from_geodetic, enu_axes
from geograph.initialise import FirstGuess
from geograph.measurements import Bearings, Constraints
from geograph.prepare import prepare
from geograph.recording import Recording
from geograph.sensors import Sensor, SensorErrors

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
    """Return where an aircraft that turns about is, shape (n, 3)."""
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


def sure_of_itself(recording, share):
    """Return a recording of bearings whose second sensor states a share of its sigma."""
    sigma = np.where(recording.bearings.sensor == 1, share, 1.0) * SIGMA_RAD
    table = dataclasses.replace(
        recording.bearings, sigma_azimuth_rad=sigma, sigma_elevation_rad=sigma
    )
    return dataclasses.replace(recording, bearings=table)


@pytest.mark.parametrize("seed", [1, 3])
def test_one_sensor_that_is_too_sure_does_not_draw_the_path_onto_itself(seed):
    # All its lines meet there, and those of the others are worth a 600th of them.
    time = np.linspace(0.0, 200.0, 150)
    truth = turning(time)
    recording = sure_of_itself(bearings_of(truth, time, STATIONS[:3], seed=seed), 0.04)
    ready = prepare(recording)
    finder = FirstGuess(ready.bearings, None, ready.sensors, ready.geometry, np.inf, False)
    (fit,) = finder.fits()
    # A bearing tells 80 m across the line of sight.
    assert np.median(np.linalg.norm(fit.spline(time) - truth, axis=1)) < 300.0
    track = gg.smooth(recording)
    assert np.median(np.linalg.norm(track.at(time).position_m - truth, axis=1)) < 300.0


def arrivals_of(seed, *, last_prior_s=20e-6):
    """Return a recording of a curved flight by a nearly flat array, and the path's function.

    The last clock is off by 10 microseconds.
    """
    rng = np.random.default_rng(seed)
    places = np.array(
        [
            [0, 0, 0],
            [2e4, 8e3, 400],
            [-1.7e4, 2e4, 50],
            [2.2e4, -1.6e4, -300],
            [-2.6e4, -1.3e4, 250],
        ]
    ).astype(float)
    phase = rng.uniform(0.0, 6.0, 2)

    def path(time_s):
        bend = 4e3 * np.sin(time_s / 40.0 + phase[0])
        climb = 3500.0 + 300.0 * np.sin(time_s / 50.0 + phase[1])
        return np.stack([150.0 * time_s - 15e3, bend, climb], axis=1)

    clock = np.append(100e-9 * rng.normal(size=4), 1e-5)
    clock[0] = 0.0
    emitted = np.sort(rng.uniform(0.0, 200.0, 60))
    away = np.linalg.norm(path(emitted)[:, None] - places, axis=2)
    # The object moves by 1e-6 of the distance while its signal is under way: no matter here.
    toa = emitted[:, None] + away / 299792458.0 + clock + 50e-9 * rng.normal(size=away.shape)
    heard = rng.random(away.shape) > 0.2
    emission, sensor = np.nonzero(heard)
    table = gg.Arrivals(
        emission=emission,
        sensor=sensor,
        toa_s=toa[heard],
        sigma_s=np.full(emission.size, 50e-9),
        line=np.arange(emission.size) + 2,
    )
    prior = [0.0, 100e-9, 100e-9, 100e-9, last_prior_s]
    sensors = {
        f"S{i}": Sensor(
            name=f"S{i}", position_m=place, axes="xyz", errors=SensorErrors(clock_offset_s=prior[i])
        )
        for i, place in enumerate(places)
    }
    return Recording(name="flat", frame="local", sensors=sensors, arrivals=table), path


def test_an_estimate_is_held_against_its_mirror_image():
    # The first guess is the mirror image behind the array, and the solver stays there: it fits,
    # for each single measurement. With this seed its cost is higher by 6 than that of the truth.
    recording, path = arrivals_of(8)
    track = gg.smooth(recording, process_noise=0.3)
    # The median sigma is 60 m; the mirror image is 7 km off.
    assert np.median(np.linalg.norm(track.position_m - path(track.time_s), axis=1)) < 300.0
    weights = [entry["weight"] for entry in track.summary["hypotheses"]]
    assert len(weights) == 2
    assert weights[0] > 0.9


def test_one_sensor_that_is_too_sure_is_told():
    # The path follows it, so that its own residuals are as stated, and the others' not much wider.
    time = np.linspace(0.0, 200.0, 150)
    recording = bearings_of(turning(time), time, STATIONS[:3], seed=0)
    fits = gg.smooth(recording, process_noise=2.0)
    assert fits.summary["flagged_sensors"] == []
    track = gg.smooth(sure_of_itself(recording, 0.2), process_noise=2.0)
    assert track.summary["sensors"]["S1"]["rms_normalised"] < 2.0
    (flagged,) = track.summary["flagged_sensors"]
    assert flagged.startswith("all sensors: chi-square is")
