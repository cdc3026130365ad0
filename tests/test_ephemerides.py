"""Sensors of a recording whose trajectory is an ephemeris: orbit messages, elements, tracks."""

from __future__ import annotations

import zipfile
from typing import TYPE_CHECKING

import numpy as np
import pytest
from made_pass import satellite
from test_stations import START, earth_fixed_states, gpx, oem, tle

import geograph as gg
from geograph.errors import InputError
from geograph.io.reader import read_setup
from geograph.io.tle import read_tle

if TYPE_CHECKING:
    from pathlib import Path

HEADER = """format = 1
frame = "ecef"
epoch = 2024-03-20T19:04:00Z
[sensors.Watcher]
trajectory = "{}"
"""
BEARINGS = (
    "time_s,sensor,azimuth_deg,elevation_deg,sigma_deg\n"
    "10,Watcher,120.5,30,0.001\n70.5,Watcher,121,31,0.001\n"
)


def recording(folder: Path, name: str, content: str, bearings: str = BEARINGS) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "recording.toml").write_text(HEADER.format(name))
    (folder / "bearings.csv").write_text(bearings)
    (folder / name).write_text(content)
    return folder


def test_an_orbit_message_in_a_folder_and_in_an_archive(tmp_path: Path) -> None:
    folder = recording(tmp_path / "rec", "watcher.oem", oem("ITRF2000", earth_fixed_states()))
    time = np.array([10.0, 33.3, 70.5])
    expected = np.array([satellite(value) for value in time])
    with zipfile.ZipFile(tmp_path / "rec.zip", "w") as archive:
        for file in folder.iterdir():
            archive.write(file, f"rec/{file.name}")
    for place in (folder, tmp_path / "rec.zip"):
        watcher = gg.read(place).sensors["Watcher"]
        np.testing.assert_allclose(watcher.position_at(time), expected, rtol=0.0, atol=5e-3)
    # Written, it is a table of the recording.
    gg.write(gg.read(folder), tmp_path / "again")
    again = gg.read(tmp_path / "again").sensors["Watcher"]
    np.testing.assert_array_equal(
        again.position_at(time), gg.read(folder).sensors["Watcher"].position_at(time)
    )


def test_elements_span_the_measurements_or_two_days_of_a_feed(tmp_path: Path) -> None:
    pytest.importorskip("sgp4")
    pytest.importorskip("astropy")
    folder = recording(tmp_path / "rec", "watcher.tle", tle())
    found = gg.read(folder).sensors["Watcher"].trajectory
    assert found is not None
    assert found.time_s[0] == pytest.approx(-50.0)
    assert found.time_s[-1] == pytest.approx(130.5)
    expected = read_tle(folder / "watcher.tle", START, (-50.0, 130.5))
    np.testing.assert_array_equal(found.position_m, expected.position_m)
    live = read_setup(folder).sensors["Watcher"].trajectory
    assert live is not None
    assert live.time_s[-1] == pytest.approx(2 * 86400.0)
    time = np.linspace(0.0, 100.0, 9)
    np.testing.assert_allclose(live.position_at(time), found.position_at(time), atol=2e-3)


def test_a_track_of_a_receiver(tmp_path: Path) -> None:
    folder = recording(tmp_path / "rec", "van.gpx", gpx(8))
    latitude, longitude, height = gg.geodesy.geodetic_from_ecef(
        gg.read(folder).sensors["Watcher"].position_at(59.5)
    )
    assert latitude == pytest.approx(52.003, abs=1e-7)
    assert longitude == pytest.approx(10.5, abs=1e-7)
    assert height == pytest.approx(33.0, abs=1e-2)


@pytest.mark.parametrize(
    ("header", "bearings", "expected"),
    [
        (("watcher.oem", "watcher.ome"), ("", ""),
         r"toml:5.*'watcher.ome'; expected the name of a .csv or .parquet file, or of an eph"),
        (('"ecef"', '"local"'), ("", ""), r"toml:5.*the name of a .csv or .parquet file in"),
        (("2024-03", "1969-03"), ("", ""), r"toml, column epoch: is in year 1969; expected 1972"),
        (("", ""), ("70.5", "7000"), r"bearings.csv:3, column time_s: 7000; outside the tra"),
        (("Watcher]", 'Watcher]\naxes = "body"'), ("", ""),
         r"watcher.oem:1: has no yaw, pitch and roll"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said(
    tmp_path: Path, header: tuple[str, str], bearings: tuple[str, str], expected: str
) -> None:
    states = oem("ITRF2000", earth_fixed_states())
    folder = recording(tmp_path / "rec", "watcher.oem", states, BEARINGS.replace(*bearings))
    place = folder / "recording.toml"
    place.write_text(place.read_text().replace(*header))
    with pytest.raises(InputError, match=expected) as caught:
        gg.read(folder)
    assert "\n" not in str(caught.value)
