"""Recordings of the study from the air: what ``geograph.smooth`` is given.

The frame is local. A receiver's trajectory holds its place and attitude ten times a second. Known
ground is a raster beside the recording, sampled every 50 m from the ground on which the emitter
stands, and a constraint that holds the path to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.measurements import Bearings, Constraints, Truth
from geograph.recording import Recording, SmoothSettings
from geograph.scenarios.airborne import draw_noise, true_angles
from geograph.scenarios.elevation_model import Raster
from geograph.sensors import Sensor, Trajectory

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from geograph.scenarios.airborne import Airborne
    from geograph.scenarios.landscape import Landscape
    from geograph.terrain import Terrain

RecordedAxes = Literal["body", "enu"]

_WATCHER_M = 1e6

KnownGround = Literal["terrain", "altitude"]

GROUND_SIGMA_M = 1.0
"""How closely a path is held to known ground."""

RASTER = Raster.around((-4e3, -4e3), (14e3, 14e3))
"""Cells of the elevation model of every recording."""


@dataclass(frozen=True, kw_only=True)
class Region:
    """Where the emitter may be at all: a wide normal distribution over ground.

    A recording holds it as what it amounts to: one bearing straight down from a sensor a thousand
    kilometres above the centre, whose sigma on the sky is that of the region seen from there.

    Parameters
    ----------
    centre_m
        x and y, metres.
    sigma_m
        Standard deviation of each.
    """

    centre_m: tuple[float, float]
    sigma_m: float


_ROAD_NOISE = 1.0
"""Process noise of an emitter on the road, m/s^1.5: it turns by 2 to 3 m/s^2 at most."""


def recordings(
    scenario: Airborne,
    seeds: Sequence[int],
    *,
    steps: int | None = None,
    axes: RecordedAxes = "body",
    region: Region | None = None,
    ground: KnownGround = "terrain",
) -> Iterator[Recording]:
    """Yield a recording for each seed, of the same run as ``simulate`` gives.

    Parameters
    ----------
    scenario
        One of :data:`geograph.scenarios.airborne.SCENARIOS`, or another.
    seeds
        Whole numbers of at least 0.
    steps
        Only the first so many steps; None: all.
    axes
        ``"body"``: angles in body axes, with the attitude in the trajectory. ``"enu"``: the same
        angles with the heading added to the azimuth; for level aircraft alone.
    region
        Where the emitter may be at all; None: anywhere.
    ground
        How the recording of a scenario with known ground knows it: ``"terrain"``, or as the
        ``"altitude"`` of a static emitter.

    Raises
    ------
    ValueError
        If an aircraft that is not level should be recorded in ``"enu"``.
    """
    if axes == "enu" and not all(receiver.level for receiver in scenario.receivers):
        raise ValueError(f"scenario {scenario.name} has an aircraft that rolls; expected body axes")
    azimuth, elevation = true_angles(scenario)
    if axes == "enu":
        azimuth = azimuth + np.radians([receiver.heading_deg for receiver in scenario.receivers])
    if scenario.azimuth_only:
        elevation = np.full_like(elevation, np.nan)
    used = scenario.steps if steps is None else min(steps, scenario.steps)
    for seed in seeds:
        noise = draw_noise(scenario, seed)
        yield Recording(
            name=f"{scenario.name}-{seed}",
            frame="local",
            sensors=_sensors(scenario, axes) | ({} if region is None else _watcher(region)),
            bearings=_bearings(
                scenario, (azimuth + noise[0])[:used], (elevation + noise[1])[:used], region
            ),
            constraints=_held(scenario, ground),
            terrain=_terrain(scenario.terrain)
            if scenario.terrain_known and ground == "terrain"
            else None,
            truth=_truth(scenario),
            settings=SmoothSettings(
                motion="constant-velocity" if scenario.moving else "static",
                process_noise=_ROAD_NOISE if scenario.moving else "auto",
                loss="none",
            ),
        )


def _bearings(
    scenario: Airborne,
    azimuth: NDArray[np.float64],
    elevation: NDArray[np.float64],
    region: Region | None,
) -> Bearings:
    steps, count = azimuth.shape
    rows = steps * count
    sigma = np.full(rows, scenario.sigma_rad)
    columns = {
        "time_s": np.repeat(scenario.time_s[:steps], count),
        "sensor": np.tile(np.arange(count), steps),
        "azimuth_rad": azimuth.ravel(),
        "elevation_rad": elevation.ravel(),
        "sigma_azimuth_rad": sigma,
        "sigma_elevation_rad": np.full(rows, np.nan) if scenario.azimuth_only else sigma,
        "isotropic": np.zeros(rows, dtype=np.bool_),
        "line": np.zeros(rows, dtype=np.int64),
    }
    if region is not None:
        wide = region.sigma_m / _WATCHER_M
        last = (scenario.time_s[0], count, 0.0, -np.pi / 2.0, wide, wide, True, 0)
        columns = {
            name: np.append(column, np.array(value, dtype=column.dtype))
            for (name, column), value in zip(columns.items(), last, strict=True)
        }
    return Bearings(**columns)


def _watcher(region: Region) -> dict[str, Sensor]:
    place = np.array([*region.centre_m, _WATCHER_M])
    return {"region": Sensor(name="region", position_m=place, axes="xyz")}


def _sensors(scenario: Airborne, axes: RecordedAxes) -> dict[str, Sensor]:
    # From before the first measurement to after the last.
    time = float(scenario.time_s[0]) * np.arange(scenario.steps + 2, dtype=np.float64)
    return {
        f"R{index}": Sensor(
            name=f"R{index}",
            trajectory=Trajectory(
                time,
                receiver.position_at(time),
                receiver.attitude_at(time) if axes == "body" else None,
            ),
            axes=axes,
        )
        for index, receiver in enumerate(scenario.receivers, start=1)
    }


def _held(scenario: Airborne, ground: KnownGround) -> Constraints | None:
    """Return what holds the path to the ground, where it is known."""
    if not scenario.terrain_known:
        return None
    return Constraints(
        time_s=np.array([np.nan]),
        kind=("height_above_terrain_m" if ground == "terrain" else "altitude_m",),
        value=np.array([0.0 if ground == "terrain" else scenario.target_m[2]]),
        sigma=np.full(1, GROUND_SIGMA_M),
        line=np.zeros(1, dtype=np.int64),
    )


@cache
def _terrain(land: Landscape) -> Terrain:
    from geograph.terrain import Terrain

    raster = RASTER
    heights = land.grid(raster.x_m, raster.y_m)[::-1]
    return Terrain.from_array(
        heights, x0_m=raster.west_m, y0_m=float(raster.y_m[-1]), spacing_m=raster.spacing_m
    )


def _truth(scenario: Airborne) -> Truth:
    time = float(scenario.time_s[0]) * np.arange(scenario.steps + 2, dtype=np.float64)
    return Truth(time_s=time, position_m=scenario.emitter_at(time), velocity_m_s=None)
