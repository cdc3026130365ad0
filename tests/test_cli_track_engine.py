"""``geograph track`` with the incremental smoother itself: from lines to results."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from small_recordings import write_small

import geograph as gg
from geograph.cli import main
from geograph.feed import json_lines
from geograph.incremental.smoother import IncrementalSmoother
from geograph.results import load


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_small(tmp_path_factory.mktemp("engine") / "small")


@pytest.fixture(scope="module")
def lines(recording):
    return list(json_lines(gg.read(recording)))


def last_line(words, path):
    assert main(["track", *map(str, words), "-o", str(path)]) == 0
    return json.loads(path.read_text().splitlines()[-1])


def position(line):
    return np.array([line[name] for name in ("x_m", "y_m", "z_m")])


def covariance(line):
    names = (("xx", "xy", "xz"), ("xy", "yy", "yz"), ("xz", "yz", "zz"))
    return np.array([[line[f"cov_{name}_m2"] for name in row] for row in names])


def test_the_last_line_and_the_results_are_those_of_the_batch(recording, tmp_path):
    found = last_line([recording, "--results", tmp_path / "results"], tmp_path / "out")
    track = gg.smooth(gg.read(recording))
    batch = track.at([found["time_s"]])
    miss = position(found) - batch.position_m[0]
    assert np.sqrt(miss @ np.linalg.solve(batch.position_covariance_m2[0], miss)) < 0.1
    np.testing.assert_allclose(
        np.diag(covariance(found)), np.diag(batch.position_covariance_m2[0]), rtol=0.02
    )
    results = load(tmp_path / "results")
    assert len(results.residuals) == 240
    assert (results.name, results.summary["name"]) == ("small", "small")
    assert results.truth is not None
    np.testing.assert_allclose(results.position_m[-1], position(found), atol=1e-3)


def test_a_stream_with_faults_ends_as_the_clean_one(
    recording, lines, tmp_path, capsys, monkeypatch
):
    real = IncrementalSmoother._update

    def failing(self, measurements):
        if any(88 in table.line for table in measurements):
            raise ZeroDivisionError("an exception inside a factor")
        return real(self, measurements)

    monkeypatch.setattr(IncrementalSmoother, "_update", failing)
    bad = {
        5: "garbage\n",
        20: lines[20].replace('"A"', '"Z"').replace('"B"', '"Z"').replace('"C"', '"Z"'),
        50: lines[50].replace("0.01}", "NaN}"),
        # The engine raises for the line that this becomes.
        84: lines[84].replace("0.01}", "0.02}"),
    }
    mixed = []
    for index, line in enumerate(lines):
        mixed += [*([bad[index]] if index in bad else []), line]
    assert mixed.index(bad[84]) + 1 == 88
    files = {"clean": lines, "mixed": mixed}
    ends = {}
    for name, content in files.items():
        feed = tmp_path / f"{name}.jsonl"
        feed.write_text("".join(content))
        if name == "clean":
            # It has another line 88, which is good.
            monkeypatch.setattr(IncrementalSmoother, "_update", real)
        else:
            monkeypatch.setattr(IncrementalSmoother, "_update", failing)
        words = [feed, "--like", recording, "--every", "1"]
        ends[name] = last_line(words, tmp_path / f"{name}.out")
    numbers = [text.split(":")[2].split(",")[0] for text in capsys.readouterr().err.splitlines()]
    assert sorted(map(int, numbers)) == [6, 22, 53, 88]
    assert ends["mixed"]["used"] == ends["clean"]["used"] == 120
    sigma = np.sqrt(np.diag(covariance(ends["clean"])))
    assert np.abs((position(ends["mixed"]) - position(ends["clean"])) / sigma).max() < 1e-3


def test_killed_and_resumed_it_ends_as_if_it_had_not_been(recording, tmp_path):
    script = Path(__file__).with_name("feed_kills.py")
    words = [sys.executable, script, recording, tmp_path, "--runs", "2", "--source", "file"]
    done = subprocess.run([*words, "--every", "1"], text=True, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("2 runs, ")


def test_one_bearing_alone_tracks_nothing_and_says_what_is_missing(
    recording, lines, tmp_path, capsys
):
    feed = tmp_path / "feed.jsonl"
    feed.write_text(lines[0])
    assert main(["track", str(feed), "--like", str(recording)]) == 3
    out, err = capsys.readouterr()
    assert json.loads(out.splitlines()[-1])["status"] == "collecting"
    assert err.startswith("geograph: small: collecting after 1 updates with 1 measurements")


def test_the_motion_is_taken_by_its_name(recording, tmp_path):
    """The recording's own is constant-velocity; another has other components."""
    words = [recording, "--motion", "constant-acceleration", "--process-noise", "0.5"]
    found = last_line(words, tmp_path / "out")
    assert found["status"] == "tracking"
    assert np.isfinite([found[name] for name in ("vx_m_s", "ax_m_s2")]).all()
