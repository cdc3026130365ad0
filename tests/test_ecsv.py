"""Fireball files of the GFE standard."""

from __future__ import annotations

import re
import sys
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import geograph as gg
from geograph.cli import main
from geograph.errors import InputError
from geograph.io import convert, read_ecsv
from geograph.io.scatter import FLOOR_RAD, angular_scatter_rad
from geograph.scenarios.examples import DATA

if TYPE_CHECKING:
    from pathlib import Path

    from geograph.recording import Recording

pytest.importorskip("astropy")
ORIGINALS = DATA / "winchcombe" / "original"
ARCMIN = np.radians(1.0 / 60.0)

HEAD = """\
# %ECSV 0.9
# ---
# datatype:
# - {name: datetime, datatype: string}
# - {name: azimuth, datatype: float64}
# - {name: altitude, datatype: float64}
# delimiter: ','
# meta: !!omap
# - {obs_latitude: 52.5}
# - {obs_longitude: -1.45}
# - {obs_elevation: 80.0}
# - {location: Town}
# - {telescope: ''}
# - {camera_id: X1}
# schema: astropy-2.0
datetime,azimuth,altitude
"""
ROWS = "".join(
    f"2021-02-28T21:54:{15 + i}.5,{230 + i}.25,{30 + (i * i % 5)}.5\n" for i in range(12)
)


def write(path: Path, text: str = HEAD + ROWS) -> Path:
    path.write_text(text)
    return path


def rows_of(recording: Recording, name: str) -> np.ndarray:
    assert recording.bearings is not None
    return np.flatnonzero(recording.bearings.sensor == recording.sensor_names.index(name))


@pytest.fixture(scope="module")
def winchcombe() -> Recording:
    return read_ecsv(ORIGINALS)


def test_cameras_and_places(winchcombe: Recording) -> None:
    assert winchcombe.sensor_names == ("AMS100", "GBWL01", "Loughborou_SW", "DFNEXT065", "UK000X")
    assert winchcombe.epoch == datetime(2021, 2, 28, 21, 54, tzinfo=UTC)
    assert winchcombe.frame == "ecef"
    counts = [rows_of(winchcombe, name).size for name in winchcombe.sensor_names]
    assert counts == [196, 152, 313, 84, 55]
    # obs_latitude 51.48611, obs_longitude -3.17787, obs_elevation 33.0 in the file of GBWL01.
    position = winchcombe.sensors["GBWL01"].position_m
    assert position is not None
    geodetic = gg.geodesy.geodetic_from_ecef(position)
    np.testing.assert_allclose(geodetic, [51.48611, -3.17787, 33.0], atol=1e-6)


@pytest.mark.parametrize(
    ("camera", "row", "expected"),
    [
        # First and last rows of the files: datetime, azimuth, altitude.
        ("AMS100", 0, (15.760, 236.40321679387387, 32.894466620123865)),
        ("GBWL01", 0, (16.789, 13.739854633205734, 62.030915582589394)),
        ("GBWL01", -1, (23.801, 55.03874284900355, 17.847209533756278)),
        ("Loughborou_SW", 0, (16.600, 232.6043471, 27.7306448)),
        ("DFNEXT065", -1, (23.200, 302.01594242826985, 11.506584440603774)),
        ("UK000X", 0, (25.715, 350.59167568637565, 39.827845430167976)),
        ("UK000X", -1, (27.876, 4.761259420028504, 31.121050492398286)),
    ],
)
def test_values_read_by_hand(
    winchcombe: Recording,
    camera: str,
    row: int,
    expected: tuple[float, float, float],
) -> None:
    time_s, azimuth_deg, altitude_deg = expected
    index = rows_of(winchcombe, camera)[row]
    bearings = winchcombe.bearings
    assert bearings is not None
    assert bearings.time_s[index] == time_s
    assert np.degrees(bearings.azimuth_rad[index]) == pytest.approx(azimuth_deg, rel=1e-14)
    assert np.degrees(bearings.elevation_rad[index]) == pytest.approx(altitude_deg, rel=1e-14)


def test_scatter_of_the_cameras(winchcombe: Recording) -> None:
    bearings = winchcombe.bearings
    assert bearings is not None
    sigma = {
        name: bearings.sigma_azimuth_rad[rows_of(winchcombe, name)] / ARCMIN
        for name in winchcombe.sensor_names
    }
    assert all(np.ptp(values) == 0.0 for values in sigma.values())
    # Sub-arcminute for the still camera of 36 megapixels, arcminutes for video.
    assert 0.3 < sigma["DFNEXT065"][0] < 0.9
    assert 0.9 < sigma["UK000X"][0] < 2.0
    assert 1.6 < sigma["GBWL01"][0] < 5.0
    assert 6.0 < sigma["Loughborou_SW"][0] < 10.0
    assert 5.0 < sigma["AMS100"][0] < 12.0


def test_priors(winchcombe: Recording) -> None:
    for name, sensor in winchcombe.sensors.items():
        bias = np.degrees(sensor.errors.azimuth_bias_rad)
        assert sensor.errors.clock_offset_s == 1.0
        assert bias == np.degrees(sensor.errors.elevation_bias_rad)
        assert bias == pytest.approx(0.02), name


def smooth_pass(
    rng: np.random.Generator, sigma_rad: float, count: int = 200, step_s: float = 0.04
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return noisy directions of a pass that goes by within 20 degrees of the zenith."""
    time = np.arange(count) * step_s
    span = time[-1]
    position = np.stack([120e3 * (time / span - 0.5), np.full(count, 12e3), 40e3 - 3e3 * time], 1)
    direction = position / np.linalg.norm(position, axis=1)[:, None]
    direction += rng.normal(0.0, sigma_rad, (count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    east, north, up = direction.T
    return time, np.arctan2(east, north), np.arcsin(up)


@pytest.mark.parametrize("sigma_arcmin", [0.3, 3.0, 10.0])
def test_scatter_finds_white_noise(sigma_arcmin: float) -> None:
    rng = np.random.default_rng(7)
    found = [angular_scatter_rad(*smooth_pass(rng, sigma_arcmin * ARCMIN)) for _ in range(12)]
    # A median of 200 absolute values has a relative error of 0.08; of twelve times two, 0.017.
    assert np.mean(np.array(found, dtype=float)) == pytest.approx(sigma_arcmin * ARCMIN, rel=0.06)


def test_scatter_covers_what_wanders() -> None:
    time, azimuth, elevation = smooth_pass(np.random.default_rng(8), ARCMIN)
    clean = angular_scatter_rad(time, azimuth, elevation)
    # Three seconds in which the reduction is 20' off in height.
    spoilt = elevation + 20.0 * ARCMIN * ((time > 2.0) & (time < 5.0))
    found = angular_scatter_rad(time, azimuth, spoilt)
    assert clean is not None
    assert found is not None
    assert 4.0 * ARCMIN < found < 12.0 * ARCMIN


def test_scatter_of_repeated_points_is_not_agreement() -> None:
    time, azimuth, elevation = smooth_pass(np.random.default_rng(9), 3.0 * ARCMIN)
    repeated = np.sort(np.concatenate([time, time + 0.01]))
    found = angular_scatter_rad(repeated, np.repeat(azimuth, 2), np.repeat(elevation, 2))
    assert found == pytest.approx(angular_scatter_rad(time, azimuth, elevation), rel=1e-9)


def test_scatter_of_points_at_equal_times() -> None:
    rng = np.random.default_rng(10)
    time, *first = smooth_pass(rng, 2.0 * ARCMIN)
    _, *second = smooth_pass(rng, 2.0 * ARCMIN)
    azimuth, elevation = (np.stack(pair, 1).ravel() for pair in zip(first, second, strict=True))
    found = angular_scatter_rad(np.repeat(time, 2), azimuth, elevation)
    assert found == pytest.approx(2.0 * ARCMIN, rel=0.2)


def test_scatter_has_a_floor_and_needs_points() -> None:
    time, azimuth, elevation = smooth_pass(np.random.default_rng(0), 0.0)
    assert angular_scatter_rad(time, azimuth, elevation) == FLOOR_RAD
    assert angular_scatter_rad(time[:7], azimuth[:7], elevation[:7]) is None
    # One direction throughout is one point.
    assert angular_scatter_rad(time, np.zeros(200), np.zeros(200)) is None


@settings(max_examples=25, deadline=None)
@given(turn=st.floats(-np.pi, np.pi), shift=st.floats(0.0, 1e6), seed=st.integers(0, 100))
def test_scatter_knows_no_north_and_no_epoch(turn: float, shift: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time, azimuth, elevation = smooth_pass(rng, ARCMIN, count=60)
    order = rng.permutation(60)
    found = angular_scatter_rad((time + shift)[order], (azimuth + turn)[order], elevation[order])
    # Times of a week ago have lost digits, no more.
    assert found == pytest.approx(angular_scatter_rad(time, azimuth, elevation), rel=1e-3)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("name: azimuth", "name: azimuth, unit: deg"),
        lambda text: text.replace("name: azimuth", "name: azimuth, unit: deg2"),
        lambda text: text.replace("name: azimuth", "name: azimuth, unit: furlongs"),
        lambda text: re.sub(r"(:\d\d\.5)", r"\1Z", text),
        lambda text: re.sub(r"(:\d\d\.5)", r"\1+00:00", text),
        lambda text: re.sub(r"(:\d\d\.5)", r"\g<1>00000000000", text),
        lambda text: text.replace("28T21", "28 21"),
    ],
    ids=["crlf", "deg", "deg2", "odd unit", "Z", "+00:00", "digits", "space"],
)
def test_variants(tmp_path: Path, change: object) -> None:
    plain = read_ecsv(write(tmp_path / "a.ecsv")).bearings
    assert callable(change)
    variant = read_ecsv(write(tmp_path / "b.ecsv", change(HEAD + ROWS))).bearings
    assert plain is not None
    assert variant is not None
    np.testing.assert_array_equal(plain.time_s, variant.time_s)
    np.testing.assert_array_equal(plain.azimuth_rad, variant.azimuth_rad)


def test_radians_are_radians(tmp_path: Path) -> None:
    text = (HEAD + ROWS).replace("name: altitude", "name: altitude, unit: rad")
    text = re.sub(r",3\d\.5\n", ",0.5\n", text)
    bearings = read_ecsv(write(tmp_path / "a.ecsv", text), sigma_deg=0.1).bearings
    assert bearings is not None
    np.testing.assert_allclose(bearings.elevation_rad, 0.5)


def test_names(tmp_path: Path) -> None:
    text = HEAD + ROWS
    files = [
        write(tmp_path / "1.ecsv", text),
        write(tmp_path / "2.ecsv", text),
        write(tmp_path / "3.ecsv", text.replace("camera_id: X1", "camera_id: ''")),
        write(
            tmp_path / "4.ecsv", text.replace("telescope: ''", "telescope: T").replace("X1", "''")
        ),
        write(tmp_path / "5.ecsv", text.replace("X1", "''").replace("Town", "''")),
    ]
    assert read_ecsv(files).sensor_names == ("X1", "X1_2", "Town", "T", "5")


def test_epoch_is_a_minute_and_no_time_is_negative(tmp_path: Path) -> None:
    early = HEAD + ROWS.replace("21:54:", "21:53:")
    recording = read_ecsv([write(tmp_path / "a.ecsv"), write(tmp_path / "b.ecsv", early)])
    assert recording.epoch == datetime(2021, 2, 28, 21, 53, tzinfo=UTC)
    assert recording.bearings is not None
    assert recording.bearings.time_s[[0, 12]].tolist() == [75.5, 15.5]


def test_options(tmp_path: Path) -> None:
    write(tmp_path / "a.ecsv")
    write(tmp_path / "b.ecsv", HEAD.replace("X1", "X2") + ROWS)
    recording = read_ecsv(
        tmp_path,
        clock_offset_s={"X2": 5.0},
        bias_deg=0.03,
        sigma_deg={"X1": 0.2},
        geoid_height_m=50.0,
    )
    first, second = recording.sensors.values()
    assert (first.errors.clock_offset_s, second.errors.clock_offset_s) == (1.0, 5.0)
    assert np.degrees(second.errors.azimuth_bias_rad) == pytest.approx(0.03)
    assert recording.bearings is not None
    assert np.degrees(recording.bearings.sigma_azimuth_rad[0]) == pytest.approx(0.2)
    assert first.position_m is not None
    height = gg.geodesy.geodetic_from_ecef(first.position_m)[2]
    assert height == pytest.approx(130.0, abs=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("54:17.5", "54:77.5", r"a.ecsv:19, column datetime: is '2021.*'; expected a UTC time"),
        ("54:17.5", "54:17.5+02:00", r"a.ecsv:19, column datetime: .*expected a UTC time"),
        (",30.5", ",95.5", r"a.ecsv:17, column altitude: is 95.5; expected -90 to 90 degrees"),
        ("231.25,", "nan,", r"a.ecsv:18, column azimuth: is nan; expected"),
        ("231.25,", ",", r"a.ecsv:18, column azimuth: empty cell; expected"),
        ("231.25,", "west,", r"a.ecsv: is not valid ECSV"),
        ("name: azimuth", "name: azimut", r"a.ecsv: is not valid ECSV"),
        ("obs_latitude: 52.5", "latitude: 52.5", r"column obs_latitude: obs_latitude is missing"),
        ("obs_latitude: 52.5", "obs_latitude: north", r"column obs_latitude: is 'north'; expected"),
        (
            "obs_latitude: 52.5",
            "obs_latitude: 152.5",
            r"is 152.5; expected a number from -90",
        ),
        (ROWS, "", r"a.ecsv: has no rows"),
        (
            ROWS.partition("\n")[2],
            "",
            r"a.ecsv: camera 'X1' has 1 points, too few .* give sigma_deg",
        ),
    ],
)
def test_bad_files(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert old in HEAD + ROWS
    path = write(tmp_path / "a.ecsv", (HEAD + ROWS).replace(old, new))
    with pytest.raises(InputError, match=expected) as caught:
        read_ecsv(path)
    assert "\n" not in str(caught.value)


def test_missing_column(tmp_path: Path) -> None:
    text = (HEAD + ROWS).replace("altitude", "elevation")
    with pytest.raises(InputError, match="column altitude: no column altitude"):
        read_ecsv(write(tmp_path / "a.ecsv", text))


def test_one_camera_differs_from_all_others(tmp_path: Path) -> None:
    files = [
        write(tmp_path / "a.ecsv"),
        write(tmp_path / "b.ecsv", HEAD.replace("X1", "X2") + ROWS),
    ]
    inputs = [*map(str, files), str(tmp_path / "out")]
    options = ["--clock-offset", "0.1", "--clock-offset", "X2=5", "--sigma", "0.01"]
    assert main(["convert", *inputs, *options]) == 0
    made = gg.read(tmp_path / "out")
    errors = {name: sensor.errors for name, sensor in made.sensors.items()}
    assert {name: found.clock_offset_s for name, found in errors.items()} == {"X1": 0.1, "X2": 5.0}


def test_bad_options(tmp_path: Path) -> None:
    path = write(tmp_path / "a.ecsv")
    with pytest.raises(InputError, match="clock_offset_s names 'x1'; did you mean X1"):
        read_ecsv(path, clock_offset_s={"x1": 1.0})
    with pytest.raises(InputError, match="sigma_deg is 0; expected a number of at least"):
        read_ecsv(path, sigma_deg=0)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"no \.ecsv file in it"):
        read_ecsv(tmp_path / "empty")
    with pytest.raises(InputError, match="no such file"):
        read_ecsv(tmp_path / "none.ecsv")


def test_without_astropy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "astropy.io", None)
    with pytest.raises(InputError, match=re.escape("pip install 'geograph[ecsv]'")):
        read_ecsv(write(tmp_path / "a.ecsv"))


def test_convert(tmp_path: Path) -> None:
    write(tmp_path / "a.ecsv")
    recording = convert([tmp_path / "a.ecsv"], tmp_path / "fireball")
    assert recording.name == "fireball"
    assert recording.bearings is not None
    assert len(recording.bearings) == 12
    with pytest.raises(InputError, match="not overwritten"):
        convert([tmp_path / "a.ecsv"], tmp_path / "fireball")
