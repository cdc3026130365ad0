"""The check-up names each planted mistake, and has nothing to say of what is healthy."""

from __future__ import annotations

import dataclasses
import json
from functools import cache

import numpy as np
import pytest
from small_recordings import write_signals, write_small

import geograph as gg
from geograph.checkup import effort, summary
from geograph.checkup.bearings import check_bearings
from geograph.checkup.fits import as_written, taken
from geograph.checkup.pairs import ray_miss
from geograph.cli import main
from geograph.geodesy import ecef_from_geodetic, geodetic_from_ecef
from geograph.scenarios import ground_pass, low_orbit_pass, room
from geograph.scenarios.examples import DATA
from geograph.scenarios.radio_aircraft import multilateration
from geograph.scenarios.radio_indoor import indoor
from geograph.scenarios.radio_mixed import mixed
from geograph.scenarios.radio_orbit import formation
from geograph.scenarios.radio_platforms import platforms
from geograph.scenarios.sound import microphones

FOOT = 0.3048


@cache
def aircraft(stations=4, seed=9):
    """Return a healthy pass over stations whose clocks are right."""
    return ground_pass(
        seed,
        target="aircraft",
        stations=stations,
        clock_offset_s=0.0,
        clock_drift_s_s=0.0,
        disciplined_s=0.0,
    )


def turned(recording, sensor=None, **changes):
    """Return a recording with columns of one sensor's bearings, or of all, changed."""
    table = recording.bearings
    rows = slice(None) if sensor is None else table.sensor == recording.sensor_names.index(sensor)
    columns = {}
    for name, change in changes.items():
        columns[name] = getattr(table, name).copy()
        columns[name][rows] = change(columns[name][rows])
    return dataclasses.replace(recording, bearings=dataclasses.replace(table, **columns))


def moved(recording, sensor=None, *, to):
    """Return a recording with one sensor, or all, at other latitude, longitude and height."""
    sensors = dict(recording.sensors)
    for name in sensors if sensor is None else [sensor]:
        place = to(*geodetic_from_ecef(sensors[name].position_m))
        sensors[name] = dataclasses.replace(sensors[name], position_m=ecef_from_geodetic(*place))
    return dataclasses.replace(recording, sensors=sensors)


BEARINGS = {
    "radians": {"azimuth_rad": np.radians, "elevation_rad": np.radians},
    "zenith-distance": {"elevation_rad": lambda e: np.pi / 2 - e},
    "azimuth-from-south": {"azimuth_rad": lambda a: (a + np.pi) % (2.0 * np.pi)},
    "azimuth-mirrored": {"azimuth_rad": lambda a: -a % (2.0 * np.pi)},
    "azimuth-from-east": {"azimuth_rad": lambda a: (np.pi / 2 - a) % (2.0 * np.pi)},
}
PLACES = {
    "longitude-sign": lambda latitude, longitude, height: (latitude, -longitude, height),
    "latitude-sign": lambda latitude, longitude, height: (-latitude, longitude, height),
    "latitude-longitude-swapped": lambda latitude, longitude, height: (longitude, latitude, height),
}
TIMES = {
    "milliseconds": lambda t: 1000.0 * t,
    "seconds-as-milliseconds": lambda t: t / 1000.0,
    "time-zone": lambda t: t + 3600.0,
    "clock-seconds": lambda t: t + 18.0,
}


def only(found, kind):
    assert [finding.kind for finding in found] == [kind], found
    assert found[0].severity == "problem"
    return found[0]


@pytest.mark.parametrize("kind", BEARINGS)
@pytest.mark.parametrize("stations", [2, 4])
def test_angles_of_one_sensor(kind, stations):
    recording = aircraft(stations)
    name = recording.sensor_names[1]
    finding = only(gg.doctor(turned(recording, name, **BEARINGS[kind])), kind)
    assert finding.sensor == name
    assert finding.file == "bearings"


@pytest.mark.parametrize("kind", ["radians", "zenith-distance", "azimuth-from-south"])
def test_angles_of_all_sensors(kind):
    recording = aircraft()
    finding = only(gg.doctor(turned(recording, **BEARINGS[kind])), kind)
    assert finding.sensor == ", ".join(recording.sensor_names)


def test_mirrored_azimuths_of_all_are_mirrored_places():
    # Both describe the same world in a mirror: no measurement tells them apart.
    found = gg.doctor(turned(aircraft(), **BEARINGS["azimuth-mirrored"]))
    assert len(found) == 1
    assert {found[0].kind} <= {"azimuth-mirrored", "longitude-sign"}
    assert "counted the other way round" in found[0].text
    assert "longitude as" in found[0].text


@pytest.mark.parametrize("kind", PLACES)
@pytest.mark.parametrize("everyone", [False, True])
def test_places(kind, everyone):
    recording = aircraft()
    name = None if everyone else recording.sensor_names[2]
    finding = only(gg.doctor(moved(recording, name, to=PLACES[kind])), kind)
    assert finding.file == "recording.toml"
    if name:
        assert finding.sensor == name


def test_height_in_feet():
    recording = aircraft()
    name = recording.sensor_names[0]
    in_feet = moved(recording, name, to=lambda lat, lon, height: (lat, lon, height / FOOT))
    finding = only(gg.doctor(in_feet), "height-in-feet")
    assert finding.sensor == name


@pytest.mark.parametrize("kind", TIMES)
@pytest.mark.parametrize("stations", [2, 4])
def test_times_of_one_sensor(kind, stations):
    recording = aircraft(stations)
    name = recording.sensor_names[1]
    finding = only(gg.doctor(turned(recording, name, time_s=TIMES[kind])), kind)
    assert name in finding.sensor + finding.text
    if kind == "clock-seconds":
        assert "18 s" in finding.text


@pytest.mark.parametrize(("factor", "severity"), [(1e3, "question"), (1e-3, "problem")])
def test_times_of_all_sensors(factor, severity):
    found = gg.doctor(turned(aircraft(), time_s=lambda t: factor * t))
    assert [(finding.kind, finding.severity) for finding in found] == [("time-unit", severity)]


@pytest.mark.parametrize("factor", [3600.0, 1.0 / 3600.0, 60.0])
def test_sigma_in_another_unit(factor):
    recording = aircraft()
    name = recording.sensor_names[3]
    change = {
        column: lambda s: factor * s for column in ("sigma_azimuth_rad", "sigma_elevation_rad")
    }
    finding = only(gg.doctor(turned(recording, name, **change)), "sigma-unit")
    assert finding.sensor == name
    assert "degrees and " in finding.text


def test_a_sensor_at_another_place_contradicts_the_others():
    recording = aircraft()
    name = recording.sensor_names[3]
    found = gg.doctor(moved(recording, name, to=lambda lat, lon, height: (lat + 0.3, lon, height)))
    assert only(found, "contradiction").sensor == name


def test_a_mistake_in_winchcombe():
    name = "Loughborou_SW"
    recording = moved(gg.read(DATA / "winchcombe"), name, to=PLACES["longitude-sign"])
    finding = only(gg.doctor(recording), "longitude-sign")
    assert finding.sensor == name
    assert "1.213" in finding.text


def test_a_clock_on_gps_time_in_winchcombe():
    name = "GBWL01"
    found = gg.doctor(turned(gg.read(DATA / "winchcombe"), name, time_s=lambda t: t + 18.0))
    finding = only(found, "clock-seconds")
    assert finding.sensor == name
    assert "18 s ahead (GPS time" in finding.text


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "µs"), (1e9, "ns")])
def test_units_of_signals(tmp_path, factor, unit):
    recording = gg.read(write_signals(tmp_path / "signals"))
    differences = recording.time_differences
    differences = dataclasses.replace(
        differences, tdoa_s=factor * differences.tdoa_s, sigma_s=factor * differences.sigma_s,
        sigma_reference_s=factor * differences.sigma_reference_s,
    )  # fmt: skip
    found = gg.doctor(dataclasses.replace(recording, time_differences=differences))
    assert {finding.kind for finding in found} == {"beyond-baseline"}
    assert {finding.sensor for finding in found} <= set("BCDE")
    assert all(f"as {unit} instead of s" in finding.text for finding in found)


def test_arrivals_of_a_clock_seconds_off(tmp_path):
    recording = gg.read(write_signals(tmp_path / "signals", tables=("arrivals",)))
    arrivals = recording.arrivals
    late = arrivals.toa_s + 18.0 * (arrivals.sensor == 2)
    found = gg.doctor(
        dataclasses.replace(recording, arrivals=dataclasses.replace(arrivals, toa_s=late))
    )
    finding = only(found, "beyond-baseline")
    assert finding.sensor == "C"
    assert "set by -18 s" in finding.text


LOCARDS = sorted((DATA / "locards" / "recordings").iterdir())


def test_the_shipped_recordings_are_healthy():
    assert gg.doctor(gg.read(DATA / "winchcombe")) == []
    assert {folder.name: gg.doctor(gg.read(folder)) for folder in LOCARDS} == {
        folder.name: [] for folder in LOCARDS
    }


@pytest.mark.parametrize(
    "scenario",
    [low_orbit_pass, room, mixed, multilateration, indoor, formation, platforms, microphones],
)
def test_simulated_recordings_are_healthy(scenario):
    assert [gg.doctor(scenario(seed)) for seed in range(11, 15)] == [[]] * 4


@pytest.mark.parametrize("seed", [1000, 1014, 1029, 1048])
def test_cameras_level_with_the_object_are_healthy(seed):
    assert gg.doctor(mixed(seed)) == []


@pytest.mark.parametrize("stations", [2, 3, 5])
def test_passes_over_stations_are_healthy(stations):
    for seed in (11, 12, 13):
        assert gg.doctor(aircraft(stations, seed)) == []
    assert gg.doctor(ground_pass(11, stations=stations)) == []


def test_few_measurements(tmp_path):
    alone = gg.read(write_small(tmp_path / "alone", sensors=1))
    assert gg.doctor(alone) == []
    table = alone.bearings
    for count in (0, 1):
        few = {e.name: getattr(table, e.name)[:count] for e in dataclasses.fields(table)}
        recording = dataclasses.replace(alone, bearings=dataclasses.replace(table, **few))
        kinds = [finding.kind for finding in gg.doctor(recording)]
        assert kinds == ([] if count else ["empty"])
        assert summary(recording)["crossing_deg"] is None


def test_a_sensor_alone_in_radians(tmp_path):
    alone = gg.read(write_small(tmp_path / "alone", sensors=1))
    wide = turned(alone, azimuth_rad=lambda a: np.radians(np.linspace(0.1, 6.0, a.size)))
    found = gg.doctor(turned(wide, elevation_rad=np.radians))
    assert ("question", "radians") in [(finding.severity, finding.kind) for finding in found]


def test_the_command(tmp_path, capsys):
    small = write_small(tmp_path / "small")
    assert main(["doctor", str(small)]) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[0] == "small: frame local"
    assert "baselines: 4000 to 5657 m" in out
    assert out.endswith("nothing to object\n")
    table = small / "bearings.csv"
    lines = [line.split(",") for line in table.read_text().splitlines()]
    for line in lines[1:]:
        if line[1] == "B":
            line[2] = str((float(line[2]) + 180.0) % 360.0)
    table.write_text("\n".join(",".join(line) for line in lines) + "\n")
    assert main(["doctor", str(small)]) == 4
    out = capsys.readouterr().out
    assert "problem: B (bearings): with its azimuths turned by 180°" in out
    assert main(["doctor", str(small), "--json"]) == 4
    facts = json.loads(capsys.readouterr().out)
    assert [entry["kind"] for entry in facts["findings"]] == ["azimuth-from-south"]
    assert facts["tables"]["bearings"]["sensors"]["A"]["rows"] == 40
    assert main(["doctor", str(tmp_path / "absent")]) == 2


def test_sensors_that_hand_over_are_healthy():
    recording = aircraft()
    table = recording.bearings
    middle = 0.5 * sum(recording.time_span_s)
    # The first sees the beginning alone, the second the end alone.
    rows = np.flatnonzero(
        ((table.sensor != 0) | (table.time_s < middle - 5.0))
        & ((table.sensor != 1) | (table.time_s > middle + 5.0))
    )
    for sensors in ((0, 1), (0, 1, 2), (0, 1, 2, 3)):
        some = rows[np.isin(table.sensor[rows], sensors)]
        assert gg.doctor(dataclasses.replace(recording, bearings=taken(table, some))) == []


@pytest.mark.parametrize(("seed", "stations"), [(1002, 2), (1007, 4), (1014, 2)])
def test_clocks_seconds_off_within_their_priors_are_healthy(seed, stations):
    assert gg.doctor(ground_pass(seed, stations=stations)) == []


def test_work_is_bounded_and_what_was_not_tried_is_said(monkeypatch):
    rng = np.random.default_rng(4)
    healthy = ground_pass(5, target="aircraft", stations=5)
    wrong = turned(healthy, azimuth_rad=lambda a: rng.uniform(0.0, 2.0 * np.pi, a.size))
    # The path as written alone takes about 700 units.
    monkeypatch.setattr(effort, "_MOST", 1500.0)
    whole = as_written(wrong)
    first = whole.case.effort.spent
    assert 100.0 < first < 1500.0
    check_bearings(whole)
    # A trial that was begun is finished; none is harder than the first fit of all.
    assert 1500.0 <= whole.case.effort.spent < 1500.0 + 2.0 * first
    found = gg.doctor(wrong)
    assert [(entry.kind, entry.severity) for entry in found] == [
        ("contradiction", "problem"),
        ("not-tried", "note"),
    ]
    assert "which sensor contradicts the others, mistakes that all sensors share" in found[1].text


def test_many_sensors_are_thinned():
    recording = ground_pass(5, target="aircraft", stations=40, clock_offset_s=0.0)
    case = as_written(recording).case
    assert np.unique(case.bearings.sensor, return_counts=True)[1].tolist() == [20] * 40
    case = as_written(aircraft()).case
    assert np.unique(case.bearings.sensor, return_counts=True)[1].tolist() == [60] * 4


def test_rays_miss_as_constructed():
    rng = np.random.default_rng(5)
    one, other, target = rng.normal(size=(3, 50, 3))
    sights = [target - one, target - other]
    first, second = (sight / np.linalg.norm(sight, axis=1)[:, None] for sight in sights)
    assert ray_miss(one, first, other, second).max() < 1e-6
    # Rays that point away from where their lines meet only part: half the angle between them.
    apart = 0.5 * np.arccos(np.clip(np.sum(first * second, axis=1), -1.0, 1.0))
    assert (ray_miss(one, -first, other, -second) <= apart + 1e-9).all()
    assert (ray_miss(one, -first, other, -second) > 1e-3).all()
