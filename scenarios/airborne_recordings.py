"""Recordings of the study from the air: what ``geograph.smooth`` is given.

The frame is local. A receiver's trajectory holds its place and attitude ten times a second. Known
ground is a raster beside the recording, sampled every 50 m from the ground on which the emitter
stands, and a constraint that holds the path to it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.measurements import Bearings, Constraints, Truth
from geograph.recording import Recording, SmoothSettings
from geograph.scenarios.airborne import draw_noise, true_angles
from geograph.sensors import Sensor, Trajectory

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from geograph.scenarios.airborne import Airborne

RecordedAxes = Literal["body", "enu"]

_ROAD_NOISE = 1.0
"""Process noise of an emitter on the road, m/s^1.5: it turns by 2 to 3 m/s^2 at most."""


def recordings(
    scenario: Airborne, seeds: Sequence[int], *, steps: int | None = None, axes: RecordedAxes
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
            sensors=_sensors(scenario, axes),
            bearings=_bearings(scenario, (azimuth + noise[0])[:used], (elevation + noise[1])[:used]),
            constraints=_ground(scenario),
            truth=_truth(scenario),
            settings=SmoothSettings(
                motion="constant-velocity" if scenario.moving else "static",
                process_noise=_ROAD_NOISE if scenario.moving else "auto",
                loss="none",
            ),
        )


def _bearings(
    scenario: Airborne, azimuth: NDArray[np.float64], elevation: NDArray[np.float64]
) -> Bearings:
    steps, count = azimuth.shape
    rows = steps * count
    sigma = np.full(rows, scenario.sigma_rad)
    return Bearings(
        time_s=np.repeat(scenario.time_s[:steps], count),
        sensor=np.tile(np.arange(count), steps),
        azimuth_rad=azimuth.ravel(),
        elevation_rad=elevation.ravel(),
        sigma_azimuth_rad=sigma,
        sigma_elevation_rad=np.full(rows, np.nan) if scenario.azimuth_only else sigma,
        isotropic=np.zeros(rows, dtype=np.bool_),
        line=np.zeros(rows, dtype=np.int64),
    )


def _sensors(scenario: Airborne, axes: RecordedAxes) -> dict[str, Sensor]:
    # From before the first measurement to after the last.
    time = np.arange(scenario.steps + 2) * float(scenario.time_s[0])
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


def _ground(scenario: Airborne) -> Constraints | None:
    if not scenario.terrain_known:
        return None
    return Constraints(
        time_s=np.array([np.nan]),
        kind=("altitude_m",),
        value=np.array([scenario.target_m[2]]),
        sigma=np.full(1, 1.0),
        line=np.zeros(1, dtype=np.int64),
    )


def _truth(scenario: Airborne) -> Truth:
    time = np.arange(scenario.steps + 2) * float(scenario.time_s[0])
    return Truth(time_s=time, position_m=scenario.emitter_at(time), velocity_m_s=None)
