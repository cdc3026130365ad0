"""Receivers around an emitter at rest, one of them wrong if asked for."""

from dataclasses import replace

import numpy as np

import geograph as gg
from geograph.scenarios.paths import StraightBody
from geograph.scenarios.radio import RadioWorld, fixed_receivers, make_radio_world
from geograph.scenarios.radio_plans import ArrivalPlan
from geograph.scenarios.worlds import Streams, truth_table
from geograph.sensors import SensorErrors

PLACES = np.array(
    [[0, 0, 0], [4e3, 0, 300], [4e3, 4e3, 50], [0, 4e3, 500], [2e3, -2e3, 0], [-2e3, 2e3, 900],
     [6e3, 2e3, 100]]
)  # fmt: skip


def world(count: int, place_m: list[float]) -> RadioWorld:
    body = StraightBody(np.array(place_m))
    return make_radio_world(
        name="world",
        path=body,
        receivers=fixed_receivers(list(PLACES[:count]), [SensorErrors()] * count),
        plans=[
            ArrivalPlan(
                emission_time_s=np.arange(20.0),
                receivers=tuple(range(count)),
                sigma_s=10e-9,
            )
        ],
        streams=Streams.from_seed(4),
        settings=gg.SmoothSettings(motion="static"),
        truth=truth_table(body, (-1.0, 21.0), step_s=1.0),
        frame="local",
    )


def moved(recording: gg.Recording, index: int, by_m: list[float]) -> gg.Recording:
    """Let a sensor say that it is elsewhere."""
    name = recording.sensor_names[index]
    sensor = recording.sensors[name]
    wrong = replace(sensor, position_m=sensor.position_m + np.array(by_m))
    return replace(recording, sensors=dict(recording.sensors) | {name: wrong})


def late(recording: gg.Recording, index: int, by_s: float) -> gg.Recording:
    table = recording.arrivals
    toa = table.toa_s + by_s * (table.sensor == index)
    return replace(recording, arrivals=replace(table, toa_s=toa))
