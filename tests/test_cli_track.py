"""``geograph track`` with a stand-in engine: exit statuses, signals, kills, full disks."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from small_recordings import write_small
from stand_in_engine import POISON_SIGMA_DEG, StandInEngine
from unmeasured import environment

import geograph as gg
from geograph.cli import main, run_track
from geograph.feed import json_lines

PROCESS = Path(__file__).with_name("feed_process.py")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_small(tmp_path_factory.mktemp("track") / "small")


@pytest.fixture(scope="module")
def lines(recording):
    return list(json_lines(gg.read(recording)))


@pytest.fixture(autouse=True)
def engines(monkeypatch):
    made = []

    def make(recording, _):
        made.append(StandInEngine(recording))
        return made[-1]

    monkeypatch.setattr(run_track, "_engine", make)
    return made


def command(*arguments, seconds=0.0):
    return [sys.executable, str(PROCESS), str(seconds), *map(str, arguments)]


def values(text):
    return [json.loads(line) for line in text.splitlines()]


def wait_for(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_a_recording_is_replayed_and_a_line_written_for_every_update(recording, capsys):
    assert main(["track", str(recording)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    found = values(out)
    assert [value["update"] for value in found] == [*range(1, 41), 40]
    assert [value["time_s"] for value in found[:-1]] == np.arange(0.0, 10.0, 0.25).tolist()
    last = found[-1]
    assert last["final"] is True
    assert last["status"] == "tracking"
    assert list(last)[3:13] == [
        *("time_s", "x_m", "y_m", "z_m", "cov_xx_m2", "cov_xy_m2", "cov_xz_m2", "cov_yy_m2"),
        *("cov_yz_m2", "cov_zz_m2"),
    ]
    assert last["sensors"]["A"] == {"azimuth_bias": [0.0, 1.0]}


def test_rows_are_reported_once_and_the_stream_goes_on(recording, lines, tmp_path, capsys, engines):
    feed = tmp_path / "feed.jsonl"
    bad = lines[5].replace("0.01}", f"{POISON_SIGMA_DEG}}}")
    feed.write_text("".join([*lines[:3], "garbage\n", *lines[3:6], bad, *lines[6:]]))
    out = tmp_path / "out.jsonl"
    assert main(["track", str(feed), "--like", str(recording), "-o", str(out)]) == 0
    said, err = capsys.readouterr()
    assert said == "small: tracking after 1 updates with 120 measurements, 2 left out\n"
    assert err.splitlines() == [
        f"geograph: {feed}:4: 'garbage' is not JSON (Expecting value, character 1); expected one "
        "JSON object a line; this line is left out",
        f"geograph: {feed}:8: ZeroDivisionError: an exception inside a factor; this line is left "
        "out",
    ]
    assert len(engines[0].rows) == 120


def test_what_never_starts_has_status_3(recording, lines, tmp_path, capsys):
    feed = tmp_path / "feed.jsonl"
    feed.write_text(lines[0])
    assert main(["track", str(feed), "--like", str(recording)]) == 3
    out, err = capsys.readouterr()
    assert values(out)[-1]["status"] == "collecting"
    assert "time_s" not in values(out)[-1]
    assert err.endswith("1 measurements, 0 left out: two bearings are needed\n")
    feed.write_text("")
    assert main(["track", str(feed), "--like", str(recording)]) == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "expected a recording, a file or - "),
        (["-"], "JSON lines need --like RECORDING"),
        (["REC", "--like", "REC"], "--like is for JSON lines"),
        (["REC", "--follow"], "--follow is for JSON lines"),
        (["REC", "--rate", "0"], "--rate is 0.0; expected a finite number above 0"),
        (["REC", "--lag", "nan"], "--lag is nan"),
        (["-", "--like", "REC", "--rate", "2"], "--rate is for a recording"),
        (["-", "--like", "REC", "--follow"], "--follow is for a file"),
        (["REC", "--once"], "--once is for --listen"),
        (["--listen", "0.0.0.0:1", "--like", "REC"], "expected a loopback address"),
        (["absent.jsonl", "--like", "REC"], "absent.jsonl: cannot be read"),
        (["REC", "--picture", "x.jpg"], "x.jpg: expected a name that ends in .png"),
        (["REC", "--results", "REC"], "is a recording and is not overwritten"),
        (["REC", "--loss", "x"], "unknown loss 'x'"),
        (["REC", "-o", "REC/bearings.csv"], "holds something else than lines of geograph track"),
        (["REC", "--journal", "REC/bearings.csv"], "is not a journal of geograph"),
    ],
)
def test_bad_arguments_have_status_2_and_one_line(recording, capsys, arguments, message):
    words = [word.replace("REC", str(recording)) for word in arguments]
    assert main(["track", *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert err.startswith("geograph: error: ")
    assert err.count("\n") == 1


def test_a_journal_is_of_one_recording_and_configuration(recording, tmp_path, capsys):
    journal = str(tmp_path / "j")
    assert main(["track", str(recording), "--journal", journal]) == 0
    size = Path(journal).stat().st_size
    assert main(["track", str(recording), "--journal", journal]) == 0
    out, err = capsys.readouterr()
    assert err == f"geograph: {journal}: went on from 40 updates with 120 measurements\n"
    # Where the feed stands, and that it has ended.
    assert [value["update"] for value in values(out)[-2:]] == [40, 40]
    other = write_small(tmp_path / "other", seed=2)
    for words in (
        [str(recording), "--process-noise", "2"],
        [str(recording), "--lag", "3"],
        [str(other)],
        ["-", "--like", str(recording), "--every", "0.25"],
    ):
        assert main(["track", *words, "--journal", journal]) == 2
        assert "belongs to other " in capsys.readouterr().err
    assert Path(journal).stat().st_size == size


def test_a_pipe_that_is_sent_again_or_goes_on_loses_nothing_and_doubles_nothing(
    recording, lines, tmp_path
):
    journal = tmp_path / "j"
    words = command("-", "--like", recording, "--journal", journal, "-o", tmp_path / "out")
    for text in (lines[:50], lines, lines[100:]):
        done = subprocess.run(
            words, input="".join(text), text=True, capture_output=True, check=False
        )
        assert done.returncode == 0, done.stderr
    assert "with 120 measurements" in done.stdout
    assert main(["track", str(recording), "-o", str(tmp_path / "whole")]) == 0
    last, wanted = (values((tmp_path / name).read_text())[-1] for name in ("out", "whole"))
    assert {**last, "update": 0} == {**wanted, "update": 0}


def test_the_picture_is_drawn_and_whole(recording, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MPLBACKEND"):
        monkeypatch.delenv(name, raising=False)
    assert main(["track", str(recording), "--plot"]) == 0
    assert "no display: drawing track.png instead of a window" in capsys.readouterr().err
    assert main(["track", str(recording), "--picture", "p.png", "--picture-every", "1e9"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["p.png", "track.png"]
    assert imread(tmp_path / "p.png").shape[:2] == (650, 1300)


def test_lines_come_over_tcp(recording, lines):
    words = command("--listen", "127.0.0.1:0", "--once", "--like", recording)
    with subprocess.Popen(words, text=True, stdout=-1, stderr=-1) as process:
        port = int(process.stderr.readline().rpartition(":")[2])
        with socket.create_connection(("127.0.0.1", port)) as connection:
            connection.sendall("".join(lines).encode())
        out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, "")
    assert values(out)[-1]["time_s"] == 9.75


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_it_after_the_update_at_hand(recording, lines, tmp_path, number, status):
    feed, out, journal = tmp_path / "feed.jsonl", tmp_path / "out", tmp_path / "j"
    feed.write_text("".join(lines[:30]))
    words = command(feed, "--follow", "--like", recording, "-o", out, "--journal", journal)
    with subprocess.Popen(words, text=True, stdout=-1, stderr=-1, env=environment()) as process:
        wait_for(lambda: out.exists() and out.stat().st_size)
        with feed.open("a") as file:
            file.write("".join(lines[30:]) + lines[0][:20])
        wait_for(lambda: values(out.read_text())[-1]["time_s"] == 9.75)
        process.send_signal(number)
        said, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (status, "")
    assert "with 120 measurements, 0 left out" in said
    assert values(out.read_text())[-1]["final"] is True


def test_a_reader_that_goes_away_ends_it_quietly_with_a_whole_journal(recording, tmp_path):
    journal = tmp_path / "j"
    words = command(recording, "--journal", journal, seconds=0.005)
    with subprocess.Popen(words, stdout=-1, stderr=-1) as process:
        first = [process.stdout.readline() for _ in range(3)]
        process.stdout.close()
        err = process.stderr.read()
        assert process.wait(60) == 141
    assert err == b""
    assert [json.loads(line)["update"] for line in first] == [1, 2, 3]
    done = subprocess.run(
        command(recording, "--journal", journal), text=True, capture_output=True, check=True
    )
    assert "torn" not in done.stderr
    assert "went on from" in done.stderr
    assert values(done.stdout)[-1]["time_s"] == 9.75


def test_a_full_disk_is_said_and_the_command_goes_on_when_there_is_room(recording, tmp_path):
    journal = tmp_path / "j"

    def small():
        resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))

    words = command(recording, "--journal", journal)
    # The limit would hold for what a measurement of coverage writes, too.
    plain = {name: value for name, value in os.environ.items() if "COV" not in name}
    done = subprocess.run(
        words, text=True, capture_output=True, check=False, preexec_fn=small, env=plain
    )
    assert done.returncode == 1
    assert done.stderr.startswith(f"geograph: error: {journal}: File too large; the journal is ")
    assert done.stderr.count("\n") == 1
    content = journal.read_bytes()
    assert content.endswith(b"\n")
    updates = content.count(b"\n") - 1
    assert len(values(done.stdout)) == updates
    again = subprocess.run(words, text=True, capture_output=True, check=True)
    assert f"went on from {updates} updates" in again.stderr
    assert [value["update"] for value in values(again.stdout)] == [*range(updates, 41), 40]


def test_a_clock_that_jumps_back_is_no_trouble(recording, lines, tmp_path, capsys):
    feed = tmp_path / "feed.jsonl"
    feed.write_text("".join([*lines[60:], *lines[:60]]))
    found = []
    for every in (["--every", "1"], []):
        assert main(["track", str(feed), "--like", str(recording), *every]) == 0
        out, err = capsys.readouterr()
        assert err == ""
        found.append(values(out)[-1])
    assert found[0]["x_m"] == found[1]["x_m"]
    assert found[0]["time_s"] == 9.75


@pytest.mark.parametrize("source", ["recording", "file"])
def test_killed_at_any_moment_it_ends_as_if_it_had_not_been(recording, tmp_path, source):
    script = Path(__file__).with_name("feed_kills.py")
    words = [sys.executable, script, recording, tmp_path, "--runs", "5", "--source", source]
    done = subprocess.run(
        [*words, "--engine", "stand-in"], text=True, capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"5 runs, \d+ kills: 5 equal to the last bit\n", done.stdout)
