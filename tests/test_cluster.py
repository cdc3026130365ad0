"""Work on a Dask cluster of real processes on the loopback device, of which one is killed."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from small_recordings import write_small
from unmeasured import environment

pytest.importorskip("distributed")

import dask

from geograph.cli import main
from geograph.cluster import ATTEMPTS, run_on_cluster
from geograph.errors import InputError
from geograph.workers import Lost

DASK = [sys.executable, "-m", "dask"]


@dataclass
class Cluster:
    """A scheduler and its workers, each a process of its own."""

    folder: Path
    address: str = ""
    processes: list[subprocess.Popen] = field(default_factory=list)
    more: dict[str, str] = field(default_factory=dict)

    def start(self, *arguments):
        # What a killed process measured would be lost.
        variables = environment() | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        variables["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parent)])
        process = subprocess.Popen(
            [*DASK, *map(str, arguments)],
            cwd=self.folder,
            env=variables | self.more,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self.processes.append(process)
        return process

    def worker(self):
        return self.start("worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard")


@contextlib.contextmanager
def cluster(folder, workers, **more):
    made = Cluster(folder, more=more)
    file = folder / "scheduler.json"
    made.start(
        "scheduler", "--host", "127.0.0.1", "--port", 0, "--no-dashboard", "--scheduler-file", file
    )
    deadline = time.monotonic() + 60.0
    try:
        while not made.address and time.monotonic() < deadline:
            with contextlib.suppress(OSError, ValueError):
                made.address = json.loads(file.read_text())["address"]
            time.sleep(0.05)
        for _ in range(workers):
            made.worker()
        yield made
    finally:
        for process in reversed(made.processes):
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    with cluster(tmp_path_factory.mktemp("two"), 2) as made:
        yield made


def treat(item):
    what, value = item
    if what == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "raise":
        raise TypeError(f"no use for {value}")
    return 2 * value


def figures_of(file):
    found = json.loads(file.read_text())
    found.pop("times")
    return json.dumps(found)


def test_results_and_errors_come_back(two):
    items = [("double", index) for index in range(100)] + [("raise", 5)]
    found = dict(run_on_cluster(treat, items, scheduler=two.address))
    assert [found[index] for index in range(100)] == [2 * index for index in range(100)]
    assert found[100].reason == "internal error, TypeError: no use for 5"


def test_smoothing_on_workers_gives_the_same_files(two, tmp_path):
    sources = [str(write_small(tmp_path / f"pass{i}", seed=i)) for i in range(3)]
    for target, more in (("here", ["--jobs", "1"]), ("there", ["--scheduler", two.address])):
        arguments = ["smooth", *sources, "-o", str(tmp_path / target), "--no-plots", *more]
        assert main(arguments) == 0
    for index in range(3):
        for name in ("track.csv", "sensors.csv", "residuals.csv"):
            here = (tmp_path / "here" / f"pass{index}" / name).read_bytes()
            assert here == (tmp_path / "there" / f"pass{index}" / name).read_bytes()
    assert (tmp_path / "there" / "batch.csv").exists()


def test_a_worker_killed_in_the_middle_loses_nothing(tmp_path):
    arguments = ["montecarlo", "room", "--set", "bearings=40", "--runs", "24", "--no-plots"]
    assert main([*arguments, "--json", str(tmp_path / "here.json"), "--jobs", "1"]) == 0
    with cluster(tmp_path, 2) as made:
        command = [sys.executable, "-m", "geograph", *arguments, "--scheduler", made.address]
        study = subprocess.Popen(
            [*command, "-o", str(tmp_path / "there")],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        log = tmp_path / "there" / "runs.jsonl"
        deadline = time.monotonic() + 60.0
        while time.monotonic() < deadline:
            if log.exists() and log.read_bytes().count(b"\n") > 4:
                break
            time.sleep(0.01)
        made.processes[-1].kill()
        killed_at = log.read_bytes().count(b"\n")
        out, err = study.communicate(timeout=120)
    assert study.returncode == 0, err
    assert killed_at < 25
    assert err == ""
    assert "24/24" in out
    assert log.read_bytes().count(b"\n") == 25
    assert figures_of(tmp_path / "there" / "montecarlo.json") == figures_of(tmp_path / "here.json")


def test_no_workers_and_items_that_kill_are_said(tmp_path, monkeypatch):
    # A second death is the last here: each worker takes seconds to start.
    assert dask.config.get("distributed.scheduler.allowed-failures") == ATTEMPTS - 1
    monkeypatch.setattr("geograph.cluster.ATTEMPTS", 2)
    monkeypatch.setattr("geograph.cluster.WORKERS_S", 1.0)
    with cluster(tmp_path, 0, DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="1") as made:
        with pytest.raises(InputError, match="has no workers; start some with: dask worker"):
            list(run_on_cluster(treat, [("double", 1)], scheduler=made.address))
        monkeypatch.setattr("geograph.cluster.WORKERS_S", 60.0)
        for _ in range(3):
            made.worker()
        # Two workers die with it; the third does the rest.
        found = dict(run_on_cluster(treat, [("kill", 0), ("double", 4)], scheduler=made.address))
    assert isinstance(found[0], Lost)
    assert found[0].died
    assert found[0].reason.startswith("2 workers died with it")
    assert found[1] == 8
