"""The shipped LocaRDS recordings are what their original files say, and are smoothed."""

from __future__ import annotations

import csv
import json
import re
from collections import Counter, defaultdict
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.optimize import least_squares

import geograph as gg
from geograph.errors import InputError
from geograph.geodesy import ecef_from_geodetic, enu_axes, geodetic_from_ecef
from geograph.scenarios.locards import (
    DATA,
    EPOCH,
    LEAST_MESSAGES,
    PROPAGATION_SPEED_M_S,
    SETS,
    make_locards,
    read_messages,
    read_receivers,
    track_recording,
    tracks,
)

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from geograph.recording import Recording

# What the smoother of all 34 runs is measured elsewhere, and measuring makes it a fifth longer.
UNMEASURED = pytest.mark.no_cover
NAMES = sorted(path.name for path in (DATA / "recordings").iterdir())


@cache
def shipped() -> dict[str, Recording]:
    return {name: gg.read(DATA / "recordings" / name) for name in NAMES}


@cache
def originals(name: str) -> list[dict[str, Any]]:
    with (DATA / "original" / f"{name}.csv").open(newline="") as file:
        return [
            {**row, "measurements": json.loads(row["measurements"])} for row in csv.DictReader(file)
        ]


def test_made_from_the_originals(tmp_path: Path) -> None:
    made = make_locards(tmp_path)
    assert sorted(path.name for path in made) == NAMES
    for path in made:
        for file in sorted((DATA / "recordings" / path.name).iterdir()):
            assert (path / file.name).read_bytes() == file.read_bytes(), file


def test_every_aircraft_with_five_messages_has_its_recording() -> None:
    expected = {}
    for name in SETS:
        # Messages that are there twice have the same arrival times.
        unique = {(row["aircraft"], str(sorted(row["measurements"]))) for row in originals(name)}
        counts = Counter(aircraft for aircraft, _ in unique)
        expected |= {f"{name}-{aircraft}": n for aircraft, n in counts.items() if n >= 5}
    assert {name: len(recording.truth or ()) for name, recording in shipped().items()} == expected
    assert len(expected) == 34
    assert sum(expected.values()) == 260


def test_arrival_times_are_exact_to_the_nanosecond() -> None:
    for name, recording in shipped().items():
        heard = {
            (row["id"], f"R{serial}"): time
            for row in originals(name.rsplit("-", 1)[0])
            for serial, time, _ in row["measurements"]
        }
        table = recording.arrivals
        assert table is not None
        assert recording.epoch is not None
        start_ns = round((recording.epoch - EPOCH).total_seconds()) * 10**9
        assert Counter(table.emission.tolist()) == dict.fromkeys(range(len(table) // 5), 5)
        for emission, sensor, toa in zip(table.emission, table.sensor, table.toa_s, strict=True):
            key = table.emission_names[emission], recording.sensor_names[sensor]
            assert round(toa * 1e9) + start_ns == heard[key]


def test_sensors_are_the_receivers() -> None:
    places = read_receivers(DATA / "original" / "sensors.csv")
    for recording in shipped().values():
        for name, sensor in recording.sensors.items():
            expected = ecef_from_geodetic(*places[int(name.removeprefix("R"))])
            np.testing.assert_allclose(sensor.position_m, expected, atol=1e-6)
            assert sensor.errors.clock_offset_s == pytest.approx(1e-7)


def test_truth_and_altitudes_are_what_was_reported() -> None:
    for name, recording in shipped().items():
        rows = {row["id"]: row for row in originals(name.rsplit("-", 1)[0])}
        assert recording.arrivals is not None
        assert recording.truth is not None
        assert recording.constraints is not None
        reported = [rows[emission] for emission in recording.arrivals.emission_names]
        wanted = [
            [float(row[key]) for key in ("latitude", "longitude", "geoAltitude")]
            for row in reported
        ]
        geodetic = geodetic_from_ecef(recording.truth.position_m)
        np.testing.assert_allclose(geodetic, wanted, atol=1e-6)
        np.testing.assert_allclose(recording.constraints.value, np.array(wanted)[:, 2], rtol=1e-12)
        assert (np.diff(recording.truth.time_s) > 0.0).all()
        # Emissions are before their first arrivals, by the light time to a receiver within 500 km.
        before = recording.constraints.time_s - recording.truth.time_s
        assert before.min() > 0.0
        assert before.max() < 500e3 / PROPAGATION_SPEED_M_S


def test_every_recording_says_whose_the_data_are() -> None:
    for name in NAMES:
        text = (DATA / "recordings" / name / "LICENSE.md").read_text()
        assert "Creative Commons Attribution-ShareAlike 4.0" in text
        assert "Sensors 2021, 21(16), 5516" in text
        assert text == (DATA / "LICENSE.md").read_text()
        header = (DATA / "recordings" / name / "recording.toml").read_text()
        assert re.match(r"# Aircraft \d+ of set_[12] of LocaRDS, \d+ messages\n# CC BY-SA", header)


def single_fix(recording: Recording, emission: int) -> float:
    """Return the horizontal error of the plain least-squares fix of one message, metres."""
    table, truth = recording.arrivals, recording.truth
    assert table is not None
    assert truth is not None
    rows = table.emission == emission
    place = np.array([recording.sensors[n].position_m for n in recording.sensor_names])
    place = place[table.sensor[rows]]
    range_m = (table.toa_s[rows] - table.toa_s[rows][0]) * PROPAGATION_SPEED_M_S
    height = geodetic_from_ecef(truth.position_m[emission])[2]

    def residual(degrees: Any) -> Any:
        position = ecef_from_geodetic(*np.moveaxis(degrees, -1, 0), height)
        excess = range_m - np.linalg.norm(position[..., None, :] - place, axis=-1)
        return excess - excess.mean(axis=-1, keepdims=True)

    # From the best of a grid around the receivers: there may be a second root, of greater cost.
    steps = np.arange(-4.0, 4.1, 0.25)
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    grid += geodetic_from_ecef(place)[:, :2].mean(axis=0)
    start = grid[np.argmin((residual(grid) ** 2).sum(axis=-1))]
    best = least_squares(residual, start, method="lm", diff_step=1e-7)
    error = ecef_from_geodetic(*best.x, height) - truth.position_m[emission]
    return float(np.linalg.norm((enu_axes(truth.position_m[emission]) @ error)[:2]))


@UNMEASURED
def test_single_messages_give_the_known_accuracy() -> None:
    """The data hold what they should: fixes with the altitude given are known to 54 m."""
    errors = [
        single_fix(recording, emission)
        for recording in shipped().values()
        for emission in range(len(recording.truth or ()))
    ]
    assert len(errors) == 260
    assert 50.0 < np.median(errors) < 60.0
    assert np.percentile(errors, 90.0) < 170.0


def test_a_message_stored_twice_counts_once() -> None:
    messages = read_messages(DATA / "original" / "set_1.csv")
    track = tracks(messages)[1830]
    assert len(track) == 26
    assert sum(message.aircraft == 1830 for message in messages) == 28
    assert [message.aircraft for message in tracks(track[:5] + track[:1])[1830]] == [1830] * 5
    assert not tracks(track[: LEAST_MESSAGES - 1] + track[:1])


def test_damaged_originals_are_named(tmp_path: Path) -> None:
    text = (DATA / "original" / "set_1.csv").read_text().splitlines()
    damaged = tmp_path / "set_1.csv"
    damaged.write_text("\n".join([*text[:3], text[3].replace("[[", "[")]))
    with pytest.raises(InputError, match=r"set_1\.csv:4: is no message"):
        read_messages(damaged)
    with pytest.raises(InputError, match=r"none\.csv: cannot be read"):
        read_messages(tmp_path / "none.csv")
    (tmp_path / "sensors.csv").write_text("serial,latitude,longitude,height\n1,47,x,3\n")
    with pytest.raises(InputError, match=r"sensors\.csv:2: is no receiver"):
        read_receivers(tmp_path / "sensors.csv")
    messages = next(iter(tracks(read_messages(DATA / "original" / "set_1.csv")).values()))
    with pytest.raises(InputError, match=r"receiver \d+ is not in the table"):
        track_recording(messages, {})


@dataclass(frozen=True)
class Comparison:
    """Estimates at the times of emission less what the aircraft reported, horizontally, metres."""

    track: NDArray[np.int64]
    along: NDArray[np.float64]
    across: NDArray[np.float64]
    across_sigma: NDArray[np.float64]
    speed: NDArray[np.float64]

    def without_delays(self) -> NDArray[np.float64]:
        """Return the distances with one reporting delay of each aircraft taken out."""
        along = self.along.copy()
        for track in np.unique(self.track):
            rows = self.track == track
            along[rows] -= self.speed[rows] * np.median(along[rows] / self.speed[rows])
        return np.hypot(along, self.across)


@cache
def smoothed() -> dict[str, gg.Track]:
    return {name: gg.smooth(recording) for name, recording in shipped().items()}


@cache
def compared() -> Comparison:
    parts = []
    for number, track in enumerate(smoothed().values()):
        truth = track.recording.truth
        assert truth is not None
        estimate = track.at(truth.time_s)
        axes = enu_axes(truth.position_m)[:, :2]
        error = np.einsum("nij,nj->ni", axes, estimate.position_m - truth.position_m)
        velocity = np.einsum("nij,nj->ni", axes, estimate.velocity_m_s)
        covariance = axes @ estimate.position_covariance_m2 @ np.swapaxes(axes, 1, 2)
        speed = np.hypot(*velocity.T)
        ahead = velocity / speed[:, None]
        left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
        parts.append(
            (
                np.full(speed.size, number),
                (error * ahead).sum(axis=1),
                (error * left).sum(axis=1),
                np.sqrt(np.einsum("ni,nij,nj->n", left, covariance, left)),
                speed,
            )
        )
    return Comparison(*(np.concatenate(column) for column in zip(*parts, strict=True)))


@UNMEASURED
def test_every_track_converges() -> None:
    assert {name: track.status for name, track in smoothed().items()} == dict.fromkeys(
        NAMES, "converged"
    )
    # One aircraft was silent for 1170 s of its 1385: nothing tells where it was in between.
    weak = {name: track.summary["weakly_observed"] for name, track in smoothed().items()}
    said = weak.pop("set_2-605")
    assert len(said) == 3
    for sentence in said:
        assert re.match(r"the position along .* is weakly determined: .* of the path", sentence)
    assert not any(weak.values())


@UNMEASURED
def test_positions_agree_with_the_reports() -> None:
    """Across the flight as they are, along it but for the delay with which aircraft report.

    The raw distance, 56 m in the median and 149 m for 90 %, is the reports' own: their delay.
    """
    result = compared()
    assert result.along.size == 260
    raw = np.hypot(result.along, result.across)
    assert np.percentile(raw, 50.0) < 60.0
    assert np.percentile(raw, 90.0) < 155.0
    for distance in (np.abs(result.across), result.without_delays()):
        assert np.percentile(distance, 50.0) <= 35.0
        assert np.percentile(distance, 90.0) <= 120.0


@UNMEASURED
def test_reports_lag() -> None:
    """The distance along the flight is a delay: the estimates are ahead, and not to one side."""
    result = compared()
    delay = np.median(result.along / result.speed)
    assert 0.15 < delay < 0.25
    assert abs(np.median(result.across)) < 10.0


@UNMEASURED
def test_sigmas_tell_the_distance_across() -> None:
    result = compared()
    inside = np.abs(result.across) < result.across_sigma
    # The rows of a track share its receivers' delays, so that 260 rows count as little more than
    # the 34 tracks: their share of 0.683 has a standard deviation of 0.08. False alarm: 1 %.
    assert 0.683 - 0.21 < inside.mean() < 0.683 + 0.21


@UNMEASURED
def test_receivers_delays_are_estimated_with_sigmas() -> None:
    found = defaultdict(list)
    for track in smoothed().values():
        for name, states in track.sensor_errors.items():
            entry = states["clock_offset"]
            assert entry.unit == "s"
            assert 0.0 < entry.sigma < entry.prior_sigma == pytest.approx(1e-7)
            found[name].append((entry.estimate, entry.sigma))
    assert len(found) == 22
    away = []
    for pairs in found.values():
        estimate, sigma = np.array(pairs).T
        pooled = np.average(estimate, weights=sigma**-2)
        away.extend(np.abs(estimate - pooled) / sigma)
    # A receiver has the same delay in every track: expected are no more than chance allows.
    # False alarm of one of 268 normal errors beyond 4 sigma: 2 %.
    assert len(away) == sum(len(recording.sensors) for recording in shipped().values())
    assert max(away) < 4.0


@UNMEASURED
def test_delays_are_those_that_the_reported_positions_tell() -> None:
    """Receivers heard in many tracks: pooled delays against those by the reported positions.

    The latter are the medians of the arrival times' residuals at the reported positions, all
    messages of both sets, each message less its own median.
    """
    places = {
        serial: ecef_from_geodetic(*place)
        for serial, place in read_receivers(DATA / "original" / "sensors.csv").items()
    }
    residuals = defaultdict(list)
    for message in [m for n in SETS for m in read_messages(DATA / "original" / f"{n}.csv")]:
        place = np.array([places[serial] for serial in message.receivers])
        distance = np.linalg.norm(ecef_from_geodetic(*message.geodetic) - place, axis=1)
        arrival = np.array([time - message.arrival_ns[0] for time in message.arrival_ns]) * 1e-9
        late = arrival - distance / PROPAGATION_SPEED_M_S
        for serial, value in zip(message.receivers, late - np.median(late), strict=True):
            residuals[f"R{serial}"].append(value)
    told, pooled = [], []
    for name, values in residuals.items():
        pairs = [
            (
                track.sensor_errors[name]["clock_offset"].estimate,
                track.sensor_errors[name]["clock_offset"].sigma,
            )
            for track in smoothed().values()
            if name in track.sensor_errors
        ]
        if len(pairs) >= 7:
            estimate, sigma = np.array(pairs).T
            pooled.append(np.average(estimate, weights=sigma**-2))
            told.append(np.median(values))
    assert len(told) == 17
    assert np.corrcoef(told, pooled)[0, 1] > 0.6
