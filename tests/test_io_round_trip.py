"""What is written reads back equal to the last binary digit, or is not written."""

from __future__ import annotations

import dataclasses
import shutil
from datetime import UTC
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recordings import all_files, assert_equal, write_files

import geograph as gg
from geograph.errors import InputError
from geograph.io.table_columns import exact_degrees
from geograph.measurements import (
    Arrivals,
    Bearings,
    Constraints,
    FrequencyDifferences,
    TimeDifferences,
    Truth,
)
from geograph.recording import Recording, SmoothSettings
from geograph.sensors import Sensor, SensorErrors, Trajectory

if TYPE_CHECKING:
    from pathlib import Path

numbers = st.floats(-1e6, 1e6)
times = st.floats(-1e4, 1e4)
sigmas = st.floats(1e-9, 0.1)
names = st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=8)


@st.composite
def trajectories(draw: st.DrawFn) -> Trajectory:
    count = draw(st.integers(2, 4))
    position = np.array([[7e6, 0.0, 0.0]]) + np.array(
        draw(st.lists(st.tuples(numbers, numbers, numbers), min_size=count, max_size=count))
    )
    turned = draw(st.booleans())
    attitude = np.array(draw(st.lists(st.floats(-6, 6), min_size=count * 3, max_size=count * 3)))
    return Trajectory(
        np.linspace(-1e4, 1e4, count), position, attitude.reshape(-1, 3) if turned else None
    )


@st.composite
def sensors(draw: st.DrawFn, name: str) -> Sensor:
    trajectory = draw(st.none() | trajectories())
    position = np.add(draw(st.tuples(numbers, numbers, numbers)), (0.0, 0.0, 7.5e6))
    posed = trajectory is None or trajectory.attitude_rad is not None
    axes = draw(st.sampled_from(["enu", "xyz", *(["body"] if posed else [])]))
    angles = st.floats(-6.28, 6.28)
    errors = {
        entry.name: draw(st.just(0.0) | st.floats(0.0, 10.0, allow_subnormal=False))
        for entry in dataclasses.fields(SensorErrors)
        if entry.name != "misalignment_rad" or axes == "body"
    }
    return Sensor(
        name=name,
        position_m=None if trajectory else position,
        trajectory=trajectory,
        axes=axes,
        attitude_rad=(
            np.array(draw(st.tuples(angles, angles, angles)))
            if axes == "body" and trajectory is None
            else None
        ),
        unusual_attitude=axes == "body",
        errors=SensorErrors(**errors),
        correlation=draw(st.floats(0.0, 1.0)),
        refraction=draw(st.sampled_from(["none", "standard"])) if axes == "enu" else "none",
        platform_process_noise=(
            draw(st.none() | st.floats(0.0, 100.0))
            if trajectory and errors["position_noise_m"] > 0.0
            else None
        ),
    )


@st.composite
def bearings_of(draw: st.DrawFn, sensor_count: int) -> Bearings:
    row = st.tuples(
        st.floats(-1e4, 1e4),
        st.integers(0, sensor_count - 1),
        st.floats(-6.28, 6.28),
        st.just(np.nan) | st.floats(-1.57, 1.57),
        sigmas,
        sigmas,
        st.booleans(),
    )
    columns = [np.array(c) for c in zip(*draw(st.lists(row, min_size=1, max_size=6)), strict=True)]
    alone = np.isnan(columns[3])
    isotropic = columns[6] & ~alone
    return Bearings(
        time_s=columns[0],
        sensor=columns[1],
        azimuth_rad=columns[2],
        elevation_rad=columns[3],
        sigma_azimuth_rad=columns[4],
        sigma_elevation_rad=np.where(isotropic | alone, columns[4], columns[5]),
        isotropic=isotropic,
        line=np.zeros(alone.size, dtype=np.int64),
    )


def arrays(rows: list[tuple[float, ...]]) -> list[np.ndarray]:
    return [np.array(column) for column in zip(*rows, strict=True)]


@st.composite
def arrivals_of(draw: st.DrawFn, sensor_count: int) -> Arrivals:
    labels = tuple(draw(st.lists(names, min_size=1, max_size=3, unique=True)))
    heard = [
        (emission, sensor) for emission in range(len(labels)) for sensor in range(sensor_count)
    ]
    # All sensors hear the first emission; the rows of all are mixed, but for the order in which
    # emissions first appear.
    chosen = heard[:sensor_count] + [pair for pair in heard[sensor_count:] if draw(st.booleans())]
    chosen = [heard[0], *draw(st.permutations(chosen[1:]))]
    emission = np.array([pair[0] for pair in chosen])
    _, first = np.unique(emission, return_index=True)
    found = emission[np.sort(first)].tolist()
    count = len(chosen)
    return Arrivals(
        emission=np.array([found.index(number) for number in emission]),
        sensor=np.array([pair[1] for pair in chosen]),
        toa_s=np.array(draw(st.lists(times, min_size=count, max_size=count))),
        sigma_s=np.array(draw(st.lists(sigmas, min_size=count, max_size=count))),
        emission_names=tuple(labels[number] for number in found),
        line=np.zeros(count, dtype=np.int64),
    )


@st.composite
def pairs_of(
    draw: st.DrawFn, sensor_count: int, kind: type[TimeDifferences] | type[FrequencyDifferences]
) -> TimeDifferences | FrequencyDifferences:
    pair = st.tuples(times, st.integers(0, sensor_count - 1), st.integers(1, sensor_count - 1))
    row = st.tuples(pair, st.floats(-1e3, 1e3), sigmas, st.floats(1e4, 1e12))
    rows = draw(st.lists(row, min_size=1, max_size=6))
    time, sensor, step = arrays([entry[0] for entry in rows])
    _, value, sigma, carrier = (list(column) for column in zip(*rows, strict=True))
    shared = draw(st.just(0.0) | st.floats(0.0, 1.0, exclude_max=True)) * min(sigma)
    columns = {
        "time_s": time,
        "sensor": sensor,
        "reference": (sensor + step) % sensor_count,
        "line": np.zeros(len(rows), dtype=np.int64),
    }
    common = np.full(len(rows), shared)
    if kind is TimeDifferences:
        return kind(
            tdoa_s=np.array(value), sigma_s=np.array(sigma), sigma_reference_s=common, **columns
        )
    return kind(
        fdoa_hz=np.array(value),
        carrier_hz=np.array(carrier),
        sigma_hz=np.array(sigma),
        sigma_reference_hz=common,
        **columns,
    )


@st.composite
def measured(draw: st.DrawFn, sensor_count: int, speed_m_s: float) -> dict[str, object]:
    """Draw any tables that these sensors can have, and at least one."""
    kinds = {"bearings": bearings_of(sensor_count)}
    if sensor_count > 1 and np.isfinite(speed_m_s):
        kinds |= {
            "arrivals": arrivals_of(sensor_count),
            "time_differences": pairs_of(sensor_count, TimeDifferences),
            "frequency_differences": pairs_of(sensor_count, FrequencyDifferences),
        }
    chosen = draw(st.sets(st.sampled_from(sorted(kinds)), min_size=1))
    return {name: draw(kinds[name]) for name in sorted(chosen)}


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    frame = draw(st.sampled_from(["ecef", "local"]))
    used = draw(st.lists(names, min_size=1, max_size=3, unique=True))
    speed = draw(st.sampled_from([299792458.0, 343.0, np.inf]))
    constraints, truth = None, None
    if draw(st.booleans()):
        constraints = Constraints(
            time_s=np.array([np.nan, draw(numbers)]),
            kind=("altitude_m", "speed_m_s"),
            value=np.array([draw(numbers), abs(draw(numbers))]),
            sigma=np.array([draw(sigmas), draw(sigmas)]),
            line=np.zeros(2, dtype=np.int64),
        )
    if draw(st.booleans()):
        truth = Truth(
            time_s=np.array([-1e4, 1e4]),
            position_m=np.array(draw(st.lists(numbers, min_size=6, max_size=6))).reshape(2, 3),
            velocity_m_s=draw(st.none() | st.just(np.ones((2, 3)))),
        )
    return Recording(
        name="pass",
        frame=frame,
        sensors={name: draw(sensors(name)) for name in used},
        **draw(measured(len(used), speed)),
        constraints=constraints,
        truth=truth,
        epoch=draw(st.datetimes(timezones=st.just(UTC))) if frame == "ecef" else None,
        propagation_speed_m_s=speed,
        propagation_sigma_m_s=draw(st.just(0.0) | sigmas) if np.isfinite(speed) else 0.0,
        settings=SmoothSettings(
            motion=draw(st.sampled_from(["static", "ballistic", "constant-velocity"])),
            process_noise=draw(st.just("auto") | sigmas | st.tuples(sigmas, sigmas, sigmas)),
            stages=draw(st.sampled_from([None, "auto", ((-1.5, 2.0), (7.0, 0.25))])),
            spacing_s=draw(st.none() | sigmas),
            loss=draw(st.sampled_from(["auto", "cauchy", "gnc"])),
            max_iterations=draw(st.integers(1, 1000)),
        ),
    )


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(recording=recordings(), tables=st.sampled_from(["csv", "parquet"]))
def test_round_trip(tmp_path: Path, recording: Recording, tables: str) -> None:
    folder = tmp_path / "pass"
    shutil.rmtree(folder, ignore_errors=True)
    written = gg.write(recording, folder, tables=tables)
    assert_equal(recording, written)
    assert_equal(recording, gg.read(folder))


def test_an_empty_table_is_written_as_none(tmp_path: Path) -> None:
    recording = gg.read(write_files(tmp_path / "a", all_files()))
    times = recording.time_differences
    assert times is not None
    none = {name: column[:0] for name, column in vars(times).items()}
    bare = dataclasses.replace(recording, time_differences=TimeDifferences(**none))
    written = gg.write(bare, tmp_path / "b")
    assert not (tmp_path / "b" / "time_differences.csv").exists()
    assert_equal(dataclasses.replace(recording, time_differences=None), written)


@pytest.mark.parametrize("tables", ["csv", "parquet"])
def test_numbers_of_emissions_become_names(tmp_path: Path, tables: str) -> None:
    recording = gg.read(write_files(tmp_path / "a", all_files()))
    arrivals = recording.arrivals
    assert arrivals is not None
    numbered = dataclasses.replace(arrivals, emission=np.array([9, 9, 4, 9, 4]), emission_names=())
    written = gg.write(
        dataclasses.replace(recording, arrivals=numbered), tmp_path / "b", tables=tables
    ).arrivals
    assert written is not None
    assert written.emission_names == ("9", "4")
    np.testing.assert_array_equal(written.emission, [0, 0, 1, 0, 1])
    np.testing.assert_array_equal(written.toa_s, arrivals.toa_s)


@pytest.mark.parametrize(
    ("labels", "expected"),
    [
        (("a", "a"), "two emissions have the same name"),
        (("a", " a"), "an emission is called ' a'; expected printable text"),
        (("a", ""), "an emission is called ''"),
        (("a", "b\nc"), r"an emission is called 'b\nc'"),
    ],
)
def test_names_of_emissions_that_would_not_read_back(
    tmp_path: Path, labels: tuple[str, ...], expected: str
) -> None:
    recording = gg.read(write_files(tmp_path / "a", all_files()))
    assert recording.arrivals is not None
    arrivals = dataclasses.replace(recording.arrivals, emission_names=labels)
    with pytest.raises(InputError) as caught:
        gg.write(dataclasses.replace(recording, arrivals=arrivals), tmp_path / "b")
    assert expected in str(caught.value)
    assert not (tmp_path / "b").exists()


def test_what_would_read_back_otherwise_is_not_written(tmp_path: Path) -> None:
    recording = gg.read(write_files(tmp_path / "a", all_files()))
    times = recording.time_differences
    assert times is not None
    shared = np.array([1e-7, np.nan, 0.0])
    with pytest.raises(InputError, match="sigma_reference_s of TimeDifferences is nan in row 1"):
        dataclasses.replace(times, sigma_reference_s=shared)
    nothing = dataclasses.replace(times, tdoa_s=np.full(3, np.nan))
    with pytest.raises(InputError, match=r"b/time_differences\.csv:2, column tdoa_s: cannot be"):
        gg.write(dataclasses.replace(recording, time_differences=nothing), tmp_path / "b")
    assert not (tmp_path / "b").exists()


@given(st.lists(st.floats(-400.0, 400.0), min_size=1))
def test_degrees_survive_radians(values: list[float]) -> None:
    radians = np.radians(values)
    degrees = exact_degrees(radians)
    assert degrees is not None
    np.testing.assert_array_equal(np.radians(degrees), radians)


@given(st.decimals(-360, 360, places=6))
def test_degrees_keep_their_digits(value: object) -> None:
    angle = float(str(value))
    degrees = exact_degrees(np.radians([angle]))
    assert degrees is not None
    assert degrees[0] == angle
