"""Processes that may die: only the item they were busy with is lost."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time

import pytest

from geograph.workers import Lost, run_isolated


def treat(item):
    what, value = item
    if what == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "exit":
        os._exit(value)
    if what == "raise":
        raise TypeError(f"no use\nfor {value}")
    if what == "sleep":
        time.sleep(value)
    if what == "threads":
        return os.environ["OMP_NUM_THREADS"]
    return value * 2


def test_every_item_has_its_result():
    items = [("double", i) for i in range(7)]
    assert dict(run_isolated(treat, items, workers=2)) == {i: 2 * i for i in range(7)}


@pytest.mark.parametrize("workers", [1, 2])
def test_a_death_costs_one_item(workers):
    items = [("double", 1), ("kill", 0), ("double", 2), ("exit", 7), ("raise", 5), ("double", 3)]
    found = dict(run_isolated(treat, items, workers=workers))
    assert [found[i] for i in (0, 2, 5)] == [2, 4, 6]
    assert found[1] == Lost("its process was ended by SIGKILL, perhaps for lack of memory")
    assert found[3] == Lost("its process ended early (exit status 7)")
    assert found[4].reason == "internal error, TypeError: no use for 5"
    assert "Traceback" in found[4].details


def test_leaving_early_ends_the_processes():
    running = run_isolated(treat, [("double", 1), ("sleep", 60), ("double", 2)], workers=2)
    assert next(running) == (0, 2)
    running.close()
    # The one that sleeps for a minute is not waited for.
    assert multiprocessing.active_children() == []


def test_workers_do_not_multiply_their_threads(monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert list(run_isolated(treat, [("threads", 0)], workers=1)) == [(0, "1")]
    assert "OMP_NUM_THREADS" not in os.environ
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    assert list(run_isolated(treat, [("threads", 0)], workers=1)) == [(0, "3")]


def test_nothing_to_do_is_done_at_once():
    assert list(run_isolated(treat, [], workers=2)) == []
