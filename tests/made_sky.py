"""Directions against the stars, worked out where the Sun's system rests, with astropy's Earth.

Observer at reception, object at emission, the light between them straight: aberration is not
mentioned, for it is what the Earth's own way in the light time makes. Only the bending of starlight
by the Sun (4 milliarcseconds) is missing.
"""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
from made_pass import LIGHT, STATIONS, ecef, inertial

from geograph.measurements import Bearings, Truth
from geograph.recording import Recording, SmoothSettings
from geograph.sensors import Sensor, SensorErrors

EPOCH = datetime(2024, 3, 20, 19, 4, tzinfo=UTC)


def moments(time_s):
    from astropy.time import Time, TimeDelta

    return Time(EPOCH.replace(tzinfo=None), scale="utc") + TimeDelta(time_s, format="sec")


def gcrs_from_earth_fixed(position_m, time_s):
    """Return ECEF positions, shape (n, 3), on the axes of the GCRS."""
    from astropy import units as u
    from astropy.coordinates import GCRS, ITRS, CartesianRepresentation

    at = moments(time_s)
    frame = ITRS(CartesianRepresentation(*(position_m.T * u.m)), obstime=at)
    return frame.transform_to(GCRS(obstime=at)).cartesian.xyz.to_value("m").T


def earth_fixed_from_gcrs(position_m, time_s):
    from astropy import units as u
    from astropy.coordinates import GCRS, ITRS, CartesianRepresentation

    at = moments(time_s)
    frame = GCRS(CartesianRepresentation(*(position_m.T * u.m)), obstime=at)
    return frame.transform_to(ITRS(obstime=at)).cartesian.xyz.to_value("m").T


def sun_system(time_s):
    """Return where the Earth's centre is in the Sun's system, shape (n, 3), metres."""
    from astropy.coordinates import get_body_barycentric

    return get_body_barycentric("earth", moments(time_s)).xyz.to_value("m").T


def against_stars(place_m, time_s, object_gcrs):
    """Return right ascension and declination, radians, each shape (n,).

    Parameters
    ----------
    place_m
        Shape (n, 3) or (3,): the observer in ECEF, metres.
    time_s
        Shape (n,): times of reception.
    object_gcrs
        Positions of the object on the axes of the GCRS, shape (n, 3), at times.
    """
    observer = gcrs_from_earth_fixed(np.broadcast_to(place_m, (time_s.size, 3)), time_s)
    delay = np.zeros(time_s.size)
    for _ in range(5):
        # The Earth's way in the light time, as a difference over a longer time: positions of the
        # Sun's system in metres have too few digits for a hundredth of a second.
        way = (sun_system(time_s - 60.0) - sun_system(time_s)) * (delay / 60.0)[:, None]
        line = object_gcrs(time_s - delay) + way - observer
        delay = np.linalg.norm(line, axis=1) / LIGHT
    line /= np.linalg.norm(line, axis=1, keepdims=True)
    return np.arctan2(line[:, 1], line[:, 0]) % (2.0 * np.pi), np.arcsin(line[:, 2])


def circle(time_s):
    """Return the satellite of made_pass, its axes those of the GCRS turned to be overhead."""
    angle = _angle()
    x, y, z = np.stack([inertial(time) for time in time_s]).T
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1)


def _angle():
    x, y, _ = gcrs_from_earth_fixed(np.array([[6.4e6, 0.0, 0.0]]), np.zeros(1))[0]
    return np.arctan2(y, x)


def sky_pass(*, sigma_rad=5e-7, noise=0.0, seed=1, errors=None, axes="radec", sensors=None):
    """Return a recording of the satellite of made_pass by its stations, with truth."""
    rng = np.random.default_rng(seed)
    if sensors is None:
        sensors = {
            name: Sensor(name=name, position_m=ecef(*place), axes=axes,
                         errors=errors or SensorErrors())
            for name, place in STATIONS.items()
        }  # fmt: skip
    parts = []
    for index, sensor in enumerate(sensors.values()):
        time = np.arange(0.1 + 0.37 * index, 118.0, 2.0)
        first, second = against_stars(sensor.position_at(time), time, circle)
        second = second + noise * rng.normal(size=time.size)
        first = first + noise * rng.normal(size=time.size) / np.cos(second)
        parts.append((time, np.full(time.size, index), first, second))
    time, sensor, first, second = (np.concatenate(column) for column in zip(*parts, strict=True))
    sigma = np.full(time.size, sigma_rad)
    table = Bearings(
        time_s=time, sensor=sensor, azimuth_rad=first, elevation_rad=second,
        sigma_azimuth_rad=sigma, sigma_elevation_rad=sigma, isotropic=np.ones(time.size, bool),
        line=np.arange(time.size) + 2,
    )  # fmt: skip
    when = np.linspace(0.0, 118.0, 60)
    return Recording(
        name="sky", frame="ecef", sensors=sensors, bearings=table, epoch=EPOCH,
        truth=Truth(time_s=when, position_m=earth_fixed_from_gcrs(circle(when), when)),
        settings=SmoothSettings(motion="ballistic", process_noise=0.5),
    )  # fmt: skip
