"""Recordings that say almost nothing: a status and a reason, no warning, nothing invented."""

from dataclasses import replace

import numpy as np
import pytest
from made_receivers import PLACES, late, world

import geograph as gg
from geograph.errors import InputError
from geograph.measurements import Constraints
from geograph.recording import Recording
from geograph.sensors import Sensor
from geograph.solver import Status


def of_few(**tables: object) -> Recording:
    sensors = {
        f"S{index}": Sensor(name=f"S{index}", position_m=place.astype(float), axes="xyz")
        for index, place in enumerate(PLACES[:4])
    }
    return Recording(
        name="few",
        frame="local",
        sensors=sensors,
        settings=gg.SmoothSettings(motion="static"),
        **tables,  # type: ignore[arg-type]
    )


def shifts(hertz: float, count: int) -> gg.FrequencyDifferences:
    zero = np.zeros(count, dtype=np.int64)
    return gg.FrequencyDifferences(
        time_s=np.arange(count, dtype=float),
        sensor=zero + 1,
        reference=zero,
        fdoa_hz=np.full(count, hertz),
        carrier_hz=np.full(count, 1e9),
        sigma_hz=np.ones(count),
        sigma_reference_hz=np.zeros(count),
        line=zero,
    )


@pytest.mark.parametrize("count", [1, 5])
def test_frequencies_at_things_at_rest_say_nothing(count: int) -> None:
    recording = of_few(frequency_differences=shifts(0.3, count))
    track = gg.smooth(recording, raise_on_failure=False)
    assert track.status is Status.UNOBSERVABLE
    assert not track.summary["rejected"]
    assert any("weakly determined" in said for said in track.summary["weakly_observed"])


def test_two_arrivals_alone_do_not_contradict_each_other() -> None:
    arrivals = gg.Arrivals(
        emission=np.zeros(2, dtype=np.int64),
        sensor=np.arange(2),
        toa_s=np.array([0.0, 3e-6]),
        sigma_s=np.full(2, 1e-8),
        line=np.arange(2),
    )
    track = gg.smooth(of_few(arrivals=arrivals), raise_on_failure=False)
    assert track.status is Status.UNOBSERVABLE
    assert not any("contradict" in said for said in track.summary["weakly_observed"])


def with_altitude(recording: Recording, time_s: float) -> Recording:
    altitude = Constraints(
        time_s=np.array([time_s]),
        kind=("altitude_m",),
        value=np.array([900.0]),
        sigma=np.array([10.0]),
        line=np.array([2]),
    )
    return replace(recording, constraints=altitude)


def test_a_clock_that_is_wrong_does_not_make_a_constraint_one_of_another_time() -> None:
    """It is the clock that is to be named; a constraint a good way off is still refused."""
    recording = late(world(6, [1e3, 2.5e3, 900.0]).recording, 0, 1e-3)
    assert recording.arrivals is not None
    first = float(recording.arrivals.toa_s.min())
    track = gg.smooth(with_altitude(recording, first - 5e-4), raise_on_failure=False)
    assert track.summary["flagged_sensors"][0].startswith(f"{recording.sensor_names[0]}:")
    with pytest.raises(InputError, match="expected a time among them"):
        gg.smooth(with_altitude(recording, first - 1.0))
