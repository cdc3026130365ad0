"""Satellites whose orbits are to be determined from angles: passes, nights, eccentric orbits.

The orbit and its forces are those of :mod:`geograph.scenarios.perturbed_orbits`; the recording asks
for the same forces, with the prior sigmas that unknown ones were drawn from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from geograph.constants import EARTH_GM_M3_S2, EARTH_RADIUS_M, EARTH_ROTATION_RAD_S
from geograph.recording import AccelerationAxes, SmoothSettings
from geograph.scenarios.kepler import EllipticOrbit
from geograph.scenarios.observation import observe_bearings
from geograph.scenarios.orbits import CircularOrbit, EarthFixedBody, turned_about_z
from geograph.scenarios.paths import SampledBody
from geograph.scenarios.perturbed_orbits import Forces, sample_orbit
from geograph.scenarios.places import clearance_m, random_ground_station
from geograph.scenarios.worlds import (
    EPOCH,
    Noise,
    Station,
    Streams,
    World,
    make_world,
    truth_table,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.scenarios.observation import SeenAxes
    from geograph.scenarios.paths import Body

Watch = Literal["ground", "satellite"]
_MOST_DRAWS = 3000
_CHECK_S = 20.0
_MARGIN_S = 20.0
_SHORTEST_PASS_S = 120.0
_AIR_M = 100e3


@dataclass(frozen=True, kw_only=True)
class Satellite:
    """A satellite and those who watch it.

    Parameters
    ----------
    perigee_m, eccentricity, inclination_deg
        Limits between which they are drawn; the perigee above the equator's radius.
    anomaly_deg
        Limits of the mean anomaly in the middle of the time.
    watch
        From the ground, at elevations of 10 to 85 degrees, or from a satellite on a circular orbit.
    sites, passes
        How many watch, and in how many passes each sees it at least.
    farthest_m
        How far from the ground track sites are, at most.
    duration_s
        From the first time at which something may be measured to the last.
    bearings
        Of each site, at random times while it sees the satellite.
    sigma_rad
        White noise of each of two components on the sky.
    process_noise
        With which the orbit is drawn and smoothed, m/s^1.5.
    moon, sun, drag_m2_kg, drag_sigma_m2_kg, acceleration_sigma_m_s2, acceleration_axes
        Forces: as the settings of a recording.

    Raises
    ------
    ValueError
        If nobody is known to watch so.
    """

    perigee_m: tuple[float, float] = (500e3, 1000e3)
    eccentricity: tuple[float, float] = (0.0, 0.01)
    inclination_deg: tuple[float, float] = (50.0, 100.0)
    anomaly_deg: tuple[float, float] = (0.0, 360.0)
    watch: Watch = "ground"
    sites: int = 1
    passes: int = 1
    farthest_m: float = 800e3
    duration_s: float = 900.0
    bearings: int = 100
    sigma_rad: float = 5e-6
    process_noise: float = 1e-4
    moon: bool = False
    sun: bool = False
    drag_m2_kg: float | None = None
    drag_sigma_m2_kg: float | None = None
    acceleration_sigma_m_s2: float | None = None
    acceleration_axes: AccelerationAxes = "rtn"

    def __post_init__(self) -> None:
        if self.watch not in get_args(Watch):
            raise ValueError(f"watch {self.watch!r}; expected one of {get_args(Watch)}")

    def settings(self) -> SmoothSettings:
        """Return the settings with which the orbit was drawn."""
        return SmoothSettings(
            motion="orbital",
            process_noise=self.process_noise,
            moon=self.moon,
            sun=self.sun,
            drag_m2_kg=self.drag_m2_kg,
            drag_sigma_m2_kg=self.drag_sigma_m2_kg,
            acceleration_sigma_m_s2=self.acceleration_sigma_m_s2,
            acceleration_axes=self.acceleration_axes,
        )

    def forces(self, rng: np.random.Generator) -> Forces:
        """Draw the forces that act."""
        unknown = (self.acceleration_sigma_m_s2 or 0.0) * rng.standard_normal(3)
        drag = (self.drag_m2_kg or 0.0) + (self.drag_sigma_m2_kg or 0.0) * rng.standard_normal()
        x, y, z = unknown.tolist()
        return Forces(
            moon=self.moon,
            sun=self.sun,
            drag_m2_kg=float(drag),
            constant_m_s2=(x, y, z),
            axes=self.acceleration_axes,
        )


LEO = Satellite()
CASES: dict[str, tuple[str, Satellite]] = {
    "orbit-one-site": ("A low orbit, one pass over one site", LEO),
    "orbit-two-sites": ("A low orbit, one pass over two sites", Satellite(sites=2)),
    "orbit-two-passes": (
        "A low orbit, two passes over one site",
        Satellite(passes=2, duration_s=7500.0, bearings=160),
    ),
    "orbit-geostationary": (
        "A night of a geostationary satellite from one site",
        Satellite(
            perigee_m=(35.75e6, 35.82e6),
            eccentricity=(0.0, 0.0005),
            inclination_deg=(0.1, 5.0),
            farthest_m=6e6,
            duration_s=28800.0,
            bearings=96,
            process_noise=1e-6,
            moon=True,
            sun=True,
        ),
    ),
    "orbit-watched": (
        "A satellite in low orbit, watched from another one",
        Satellite(watch="satellite", duration_s=900.0, bearings=150),
    ),
    "orbit-molniya": (
        "A Molniya orbit around its apogee, four hours from one site",
        Satellite(
            perigee_m=(500e3, 1500e3),
            eccentricity=(0.69, 0.74),
            inclination_deg=(62.0, 65.0),
            anomaly_deg=(150.0, 210.0),
            farthest_m=4e6,
            duration_s=14400.0,
            bearings=150,
            process_noise=1e-5,
            moon=True,
            sun=True,
        ),
    ),
    "orbit-transfer-apogee": (
        "A geostationary transfer orbit around its apogee, three hours from one site",
        Satellite(
            perigee_m=(250e3, 600e3),
            eccentricity=(0.72, 0.735),
            inclination_deg=(5.0, 28.0),
            anomaly_deg=(150.0, 210.0),
            farthest_m=4e6,
            duration_s=10800.0,
            bearings=120,
            process_noise=1e-5,
            moon=True,
            sun=True,
        ),
    ),
    "orbit-transfer-perigee": (
        "A geostationary transfer orbit through its perigee, from one site, with drag",
        Satellite(
            perigee_m=(250e3, 600e3),
            eccentricity=(0.72, 0.735),
            inclination_deg=(5.0, 28.0),
            anomaly_deg=(-1.5, 1.5),
            farthest_m=600e3,
            duration_s=900.0,
            drag_m2_kg=0.02,
        ),
    ),
    "orbit-drag": (
        "A low orbit at 300 to 400 km, two passes over one site, its drag unknown",
        Satellite(
            perigee_m=(300e3, 400e3),
            passes=2,
            duration_s=7500.0,
            bearings=160,
            process_noise=1e-5,
            drag_m2_kg=0.02,
            drag_sigma_m2_kg=0.005,
        ),
    ),
    "orbit-thrust": (
        "A low orbit with an unknown constant acceleration, two passes over two sites",
        Satellite(
            sites=2,
            passes=2,
            duration_s=7500.0,
            bearings=120,
            process_noise=1e-5,
            acceleration_sigma_m_s2=1e-4,
        ),
    ),
}
"""Title and kind of every case."""


def satellite_world(seed: int, kind: Satellite) -> World:
    """Simulate a satellite and those who watch it.

    Parameters
    ----------
    seed
        A whole number of at least 0.
    kind
        What it is like.

    Raises
    ------
    RuntimeError
        If no site or watcher of many sees it.
    """
    streams = Streams.from_seed(seed)
    path = _path(streams.path, kind)
    stations, times = [], []
    for index in range(kind.sites):
        station, seen = _station(streams.sensors, path, kind, index=index)
        stations.append(station)
        times.append(_times(streams.times, seen, kind.bearings))
    margin = 0.5 * _MARGIN_S
    return make_world(
        name=f"satellite-{seed}",
        path=path,
        stations=stations,
        times_s=times,
        noise=Noise(sigma_rad=kind.sigma_rad),
        streams=streams,
        settings=kind.settings(),
        truth=truth_table(path, (-margin, kind.duration_s + margin), step_s=10.0),
    )


def _path(rng: np.random.Generator, kind: Satellite) -> Body:
    oblong = rng.uniform(*kind.eccentricity)
    semi_major = (EARTH_RADIUS_M + rng.uniform(*kind.perigee_m)) / (1.0 - oblong)
    inclination, node = np.radians(rng.uniform(*kind.inclination_deg)), rng.uniform(0.0, 2 * np.pi)
    ascending = np.array([np.cos(node), np.sin(node), 0.0])
    level = np.array([-np.sin(node), np.cos(node), 0.0])
    northward = np.cos(inclination) * level + np.sin(inclination) * np.array([0.0, 0.0, 1.0])
    turn = rng.uniform(0.0, 2 * np.pi)
    first = np.cos(turn) * ascending + np.sin(turn) * northward
    second = np.cos(turn) * northward - np.sin(turn) * ascending
    anomaly = np.radians(rng.uniform(*kind.anomaly_deg))
    orbit = EllipticOrbit(semi_major, oblong, first, second, anomaly)
    # Longer steps where everything goes slowly.
    step = 5.0 if semi_major * (1.0 - oblong) < 1e7 else 30.0
    low, high = -_MARGIN_S, kind.duration_s + _MARGIN_S
    time = np.linspace(low, high, int(np.ceil((high - low) / step)) + 1)
    start = low - 0.5 * kind.duration_s
    initial = np.stack([orbit.position_at(start), orbit.velocity_at(start)])
    state = sample_orbit(
        rng,
        time,
        initial,
        noise=kind.process_noise,
        epoch=EPOCH,
        forces=kind.forces(rng),
    )
    return EarthFixedBody(SampledBody(time, state))


def _station(
    rng: np.random.Generator, path: Body, kind: Satellite, *, index: int
) -> tuple[Station, NDArray[np.float64]]:
    """Return who watches, and the intervals in which it sees, shape (p, 2)."""
    time = np.linspace(0.0, kind.duration_s, int(np.ceil(kind.duration_s / _CHECK_S)) + 1)
    for _ in range(_MOST_DRAWS):
        if kind.watch == "ground":
            body = random_ground_station(rng, path, kind.duration_s, farthest_m=kind.farthest_m)
            sees = _above_horizon(path, body, time)
        else:
            body = _watcher(rng, path, kind.duration_s)
            sees = _past_the_earth(path, body, time)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], sees, [False]]).astype(int)))
        passes = time[np.stack([edges[::2], edges[1::2] - 1], axis=1)]
        passes = passes[passes[:, 1] - passes[:, 0] >= _SHORTEST_PASS_S]
        if len(passes) >= kind.passes:
            name = f"{'S' if kind.watch == 'satellite' else 'G'}{index + 1}"
            axes: SeenAxes = "xyz" if kind.watch == "satellite" else "enu"
            return Station(name=name, body=body, axes=axes), passes
    raise RuntimeError(f"none of {_MOST_DRAWS} watchers sees it in {kind.passes} passes")


def _above_horizon(path: Body, site: Body, time_s: NDArray[np.float64]) -> NDArray[np.bool_]:
    sensor = np.zeros(time_s.size, dtype=np.int64)
    seen = observe_bearings(path, [site], time_s, sensor, axes=["enu"])
    low, high = np.radians([10.0, 85.0])
    return np.asarray((seen.elevation_rad > low) & (seen.elevation_rad < high))


def _watcher(rng: np.random.Generator, path: Body, duration_s: float) -> Body:
    """Draw a circular orbit that is near the satellite in the middle of the time."""
    middle = 0.5 * duration_s
    there = turned_about_z(path.position_at(middle), EARTH_ROTATION_RAD_S * middle)
    offset = rng.standard_normal(3)
    near = there + rng.uniform(300e3, 2000e3) * offset / np.linalg.norm(offset)
    other = rng.standard_normal(3)
    radius, first = float(np.linalg.norm(near)), near / np.linalg.norm(near)
    second = other - (other @ first) * first
    second /= np.linalg.norm(second)
    if not EARTH_RADIUS_M + 400e3 < radius < EARTH_RADIUS_M + 2500e3:
        return _watcher(rng, path, duration_s)
    rate = float(np.sqrt(EARTH_GM_M3_S2 / radius**3))
    return EarthFixedBody(CircularOrbit(radius, first, second, -rate * middle))


def _past_the_earth(path: Body, watcher: Body, time_s: NDArray[np.float64]) -> NDArray[np.bool_]:
    place, target = watcher.position_at(time_s), path.position_at(time_s)
    away = target - place
    distance = np.linalg.norm(away, axis=1)
    pole = np.abs(away[:, 2]) / distance
    clear = clearance_m(place, target) > EARTH_RADIUS_M + _AIR_M
    return np.asarray(clear & (pole < np.sin(np.radians(85.0))) & (distance > 100e3))


def _times(
    rng: np.random.Generator, passes: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """Draw sorted times within passes, uniform over all of them."""
    length = passes[:, 1] - passes[:, 0]
    ends = np.cumsum(length)
    drawn = np.sort(rng.uniform(0.0, ends[-1], count))
    which = np.minimum(np.searchsorted(ends, drawn, side="right"), ends.size - 1)
    return np.asarray(passes[which, 0] + drawn - (ends - length)[which])
