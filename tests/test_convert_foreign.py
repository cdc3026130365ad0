"""From a tracking data message to an ephemeris and maps, by the commands alone."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest
from made_pass import EPOCH, STATION_CSV, satellite, sightings, tdm

import geograph as gg
from geograph.cli import main
from geograph.export import SUFFIXES
from geograph.results import load

if TYPE_CHECKING:
    from pathlib import Path

SIGMA_DEG = 0.005


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("pass")
    (place / "stations.csv").write_text(STATION_CSV)
    rows = sightings(sigma_deg=SIGMA_DEG, step_s=3.0, seed=3)
    (place / "pass.tdm").write_text(tdm(rows))
    (place / "pass.txt").write_text(tdm(rows))
    inputs = [
        str(place / "pass.tdm"),
        str(place / "rec"),
        "--stations",
        str(place / "stations.csv"),
    ]
    assert main(["convert", *inputs, "--sigma", str(SIGMA_DEG)]) == 0
    smooth = ["smooth", str(place / "rec"), "-o", str(place / "out"), "--no-plots"]
    assert main([*smooth, "--motion", "orbital", "--process-noise", "0.01"]) == 0
    return place


def test_tracking_message_to_ephemeris(folder: Path) -> None:
    oem = pytest.importorskip("oem")
    path = folder / "track.oem"
    assert main(["convert", str(folder / "out"), str(path)]) == 0
    (segment,) = oem.OrbitEphemerisMessage.open(path).segments
    assert segment.metadata["REF_FRAME"] == "ITRF2000"
    assert segment.metadata["TIME_SYSTEM"] == "UTC"
    start = np.datetime64(EPOCH.replace(tzinfo=None), "ns")
    states, covariances = list(segment.states), list(segment.covariances)
    assert len(states) == len(covariances) > 5
    squares = []
    for state, covariance in zip(states, covariances, strict=True):
        time = (state.epoch.datetime64.astype("datetime64[ns]") - start).astype(np.int64) / 1e9
        error = state.position * 1e3 - satellite(time)
        matrix = covariance.matrix[:3, :3] * 1e6
        squares.append(float(error @ np.linalg.solve(matrix, error)))
        assert np.linalg.eigvalsh(covariance.matrix).min() > 0.0
    # Chi-square with 3 degrees of freedom; knots of one pass are nearly one draw: 99.9 % is 16.3.
    assert 0.1 < np.mean(squares) < 16.3
    # The same numbers as in the results.
    track = load(folder / "out")
    np.testing.assert_allclose([s.position * 1e3 for s in states], track.position_m, rtol=1e-14)


def test_every_map(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for suffix in SUFFIXES:
        path = folder / f"map{suffix}"
        assert main(["convert", str(folder / "out"), str(path)]) == 0
        assert path.stat().st_size > 1000
        assert main(["convert", str(folder / "out"), str(path)]) == 2
        assert "is there already; name another" in capsys.readouterr().err
        assert main(["convert", str(folder / "out"), str(path), "--overwrite"]) == 0


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["pass.tdm", "x.kml"], "x.kml: is written from results"),
        (["rec", "x.oem"], "is written from results"),
        (["out", "x"], "x: ends in ''"),
        (["out", "rec", "x.kml"], "is recording, and"),
        (["rec", "x", "--stations", "stations.csv"], "is a recording, which has its own"),
        (["stations.csv", "x"], "stations.csv: ends in '.csv', which says no format"),
        (["pass.tdm", "x", "--format", "tmd"], "unknown format 'tmd'; did you mean tdm?"),
        (["pass.tdm", "x", "--format", "mapped"], "needs a mapping"),
        (["pass.tdm", "x", "--format", "iod"], "column 17-20"),
        (["pass.tdm", "x"], "has no position here; expected a station list"),
        (["none.tdm", "x"], "none.tdm: no such file"),
        (["pass.txt", "x"], "has no position here; expected a station list"),
        (
            ["pass.tdm", "rec"],
            "rec: is a recording and is not overwritten; expected a new or empty "
            "folder; name another, or allow to overwrite",
        ),
        (
            ["--format", "recording", "pass.tdm", "x"],
            "is a file of another format; expected a reco",
        ),
    ],
)
def test_what_cannot_be_converted(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    expected: str,
) -> None:
    monkeypatch.chdir(folder)
    assert main(["convert", *words]) == 2
    message = capsys.readouterr().err
    assert expected in message
    assert message.count("\n") == 1
    assert not (folder / "x").exists()


def test_reports_and_tables_by_the_command(
    tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from test_optical import GOOD

    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.csv").write_text(f"{STATION_CSV}4353,52.1,4.4,20\n")
    (tmp_path / "a.iod").write_text(f"{GOOD}\n{GOOD.replace('1905', '1906')}\n")
    options = ["--stations", "s.csv"]
    assert main(["convert", "a.iod", "iod", *options, "--target", "12345"]) == 0
    recording = gg.read(tmp_path / "iod")
    assert recording.bearings is not None
    assert recording.bearings.time_s.tolist() == [0.0, 60.0]
    (tmp_path / "a.csv").write_text("t,who,az\n2024-03-20T19:05:00,Alpha,10\n")
    (tmp_path / "m.toml").write_text(
        '[columns]\ntime = "t"\nsensor = "who"\nazimuth = { column = "az", unit = "deg" }\n'
    )
    mapping = ["--mapping", "m.toml", "--sigma", "Alpha=0.5", "--clock-offset", "0.1"]
    assert main(["convert", "a.csv", "csv.zip", *options, *mapping]) == 0
    errors = gg.read(tmp_path / "csv.zip").sensors["Alpha"].errors
    assert errors.clock_offset_s == 0.1
    assert (folder / "rec").is_dir()


def test_reading_azimuths_needs_no_extra(folder: Path, tmp_path: Path) -> None:
    code = (
        "import sys; from geograph.cli import main\n"
        f"assert main(['convert', {str(folder / 'pass.tdm')!r}, {str(tmp_path / 'r')!r},"
        f" '--stations', {str(folder / 'stations.csv')!r}, '--sigma', '1']) == 0\n"
        "heavy = {'astropy', 'erfa', 'gtsam', 'matplotlib', 'pandas', 'pyarrow', 'sgp4'}\n"
        "sys.exit(', '.join(heavy & set(sys.modules)) or 0)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
