"""Many recordings in one call: each for itself."""

from __future__ import annotations

import csv
import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from small_recordings import write_small
from unmeasured import environment

from geograph import batch
from geograph.errors import InputError


def names(jobs):
    return [job.folder.name for job in jobs]


def test_folders_differ_where_names_do_not(tmp_path):
    sources = [Path(p) for p in ("a/x", "b/x", "x-2", "c/X.zip", "batch.csv", "y.zip")]
    assert names(batch.plan(sources, tmp_path)) == ["x", "x-2", "x-2-2", "X-3", "batch.csv-2", "y"]


def test_a_folder_of_one_result_is_no_folder_of_many(tmp_path):
    (tmp_path / "summary.json").write_text("{}")
    with pytest.raises(InputError, match=r"holds summary\.json, so it is no folder of many"):
        batch.plan([Path("a"), Path("b")], tmp_path)


def test_nothing_is_begun_if_a_target_holds_something_else(tmp_path):
    write_small(tmp_path / "rec" / "one")
    with pytest.raises(InputError, match="is a recording and is not overwritten"):
        batch.smooth_many([tmp_path / "rec" / "one", tmp_path / "none"], tmp_path / "rec")


@pytest.fixture(scope="module")
def smoothed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("batch")
    good = [write_small(folder / f"pass{i}", seed=i) for i in range(3)]
    bad = write_small(folder / "bad")
    table = bad / "bearings.csv"
    table.write_text(table.read_text().replace("\n0.0,A", "\n0.0,Z", 1))
    sources = [good[0], bad, good[1], folder / "absent", good[2]]
    seen = []
    outcomes = batch.smooth_many(
        sources,
        folder / "out",
        workers=2,
        changes={"process_noise": 0.5},
        pictures=False,
        command="geograph smooth ...",
        on_done=seen.append,
    )
    return folder, outcomes, seen


def test_outcomes_come_in_the_order_of_the_recordings(smoothed):
    _, outcomes, seen = smoothed
    kinds = ["converged", "bad input", "converged", "bad input", "converged"]
    assert [outcome.kind for outcome in outcomes] == kinds
    assert sorted(o.job.folder.name for o in seen) == ["absent", "bad", "pass0", "pass1", "pass2"]
    assert "bearings.csv:2, column sensor" in outcomes[1].message


def test_results_of_the_good_ones_are_there_and_of_the_bad_ones_not(smoothed):
    folder, _, _ = smoothed
    present = {path.name for path in (folder / "out").iterdir()}
    assert present == {"batch.csv", "pass0", "pass1", "pass2"}
    for i in range(3):
        summary = json.loads((folder / "out" / f"pass{i}" / "summary.json").read_text())
        assert summary["status"] == "converged"
        assert summary["settings"]["process_noise"] in (0.5, [0.5] * 3)
        assert summary["command"] == "geograph smooth ..."


def test_the_table_has_a_row_for_each(smoothed):
    folder, outcomes, _ = smoothed
    with (folder / "out" / "batch.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == ["pass0", "bad", "pass1", "absent", "pass2"]
    statuses = ["converged", "failed", "converged", "failed", "converged"]
    assert [row["status"] for row in rows] == statuses
    assert [row["measurements"] for row in rows] == ["120", "", "120", "", "120"]
    assert float(rows[0]["chi2"]) == outcomes[0].summary["chi2"]
    assert rows[1]["message"] == outcomes[1].message


def test_again_into_the_same_folder_replaces_the_results(smoothed):
    folder, _, _ = smoothed
    before = (folder / "out" / "pass0" / "track.csv").read_bytes()
    (again,) = batch.smooth_many([folder / "pass0"], folder / "out", pictures=False)
    assert again.kind == "converged"
    assert (folder / "out" / "pass0" / "track.csv").read_bytes() != before


def test_one_recording_alone_and_in_a_batch_give_the_same(smoothed, tmp_path):
    folder, _, _ = smoothed
    job = batch.Job(source=folder / "pass1", folder=tmp_path / "one")
    batch.smooth_job(job, changes={"process_noise": 0.5}, pictures=False, command=None)
    for name in ("track.csv", "sensors.csv", "residuals.csv"):
        assert (tmp_path / "one" / name).read_bytes() == (
            folder / "out" / "pass1" / name
        ).read_bytes()


def test_interrupting_a_batch_is_quiet_and_leaves_no_half_results(tmp_path):
    sources = [write_small(tmp_path / f"pass{i}", seed=i) for i in range(12)]
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "geograph",
            "smooth",
            *map(str, sources),
            "-o",
            "out",
            "--jobs",
            "2",
        ],
        env=environment(),
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 60.0
    while not list(tmp_path.glob("out/pass*/summary.json")) and time.monotonic() < deadline:
        time.sleep(0.02)
    # To the whole group, as a terminal does.
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (130, "", "")
    done = [path for path in (tmp_path / "out").iterdir() if not path.name.startswith(".")]
    assert 0 < len(done) < len(sources)
    assert len(done) == len(list((tmp_path / "out").iterdir()))
    for folder in done:
        assert len(list(folder.iterdir())) == 13 - (not (folder / "sensor_errors.csv").exists())


def test_a_full_disk_is_no_crash_of_ours(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device", "out/pass")

    monkeypatch.setattr(batch, "save", full)
    job = batch.Job(source=write_small(tmp_path / "pass"), folder=tmp_path / "out")
    outcome = batch.smooth_job(job, changes={}, pictures=False, command=None)
    assert (outcome.kind, outcome.details) == ("crashed", "")
    assert outcome.message == "out/pass: No space left on device"


def test_killed_batch_leaves_whole_results_only(tmp_path):
    sources = [write_small(tmp_path / f"pass{i}", seed=i) for i in range(6)]
    command = [sys.executable, "-m", "geograph", "smooth", *map(str, sources), "-o", "out"]
    process = subprocess.Popen(
        [*command, "--jobs", "2"], cwd=tmp_path, start_new_session=True, stderr=subprocess.PIPE
    )
    deadline = time.monotonic() + 60.0
    while not list(tmp_path.glob("out/pass*/summary.json")) and time.monotonic() < deadline:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate(timeout=60)
    assert not (tmp_path / "out" / "batch.csv").exists()
    from geograph.results import load

    done = [path for path in (tmp_path / "out").iterdir() if not path.name.startswith(".")]
    assert done
    for folder in done:
        assert load(folder).status == "converged"
        assert (folder / "overview.png").exists()
