"""Kill ``geograph track`` with signal 9 at random moments, resume it, compare with a whole run.

    python tests/feed_kills.py RECORDING FOLDER [--runs 100] [--source file] [--engine stand-in]

Every run is killed one to three times. It then has to end with the output of a run that was never
killed, byte for byte or within 1e-9 of each number's sigma, and its journal has to hold every
measurement once. Processes are forked from one that has imported everything, so that a run takes no
longer than its work.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import signal
import sys
import time
from pathlib import Path

from stand_in_engine import StandInEngine

import geograph as gg
from geograph.cli import main, run_track
from geograph.feed import json_lines
from geograph.feed.journal import _value

PAUSE_S = 0.001


class SlowEngine(StandInEngine):
    """Takes a moment for every update, in which it can be killed."""

    def update(self, measurements):
        time.sleep(PAUSE_S)
        return super().update(measurements)


def begin(words):
    """Fork a process that runs the command, and return its number."""
    child = os.fork()
    if child:
        return child
    null = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1):
        os.dup2(null, stream)
    os.dup2(os.open(f"{words[-1]}.log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
    status = 70
    try:
        status = main(["track", *words])
    finally:
        os._exit(status)


def wait(child):
    """Wait for a process to end, and return its exit status."""
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status)


def killed_once(words, moment):
    """Run the command and kill it at a moment; return whether it had not ended before."""
    child = begin(words)
    time.sleep(moment)
    os.kill(child, signal.SIGKILL)
    return wait(child) == -signal.SIGKILL


def journalled(path):
    """Return the numbers of the rows in a journal."""
    records = [_value(line) for line in path.read_bytes().splitlines(keepends=True)]
    assert all(records), "a record is not whole"
    return [row[0] for record in records[1:] for row in record["rows"]]


def greatest_difference(one, other):
    """Return the greatest relative difference of two lines' numbers."""
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        return max((greatest_difference(one[key], other[key]) for key in one), default=0.0)
    if isinstance(one, list):
        return max(map(greatest_difference, one, other), default=0.0)
    if isinstance(one, float):
        return abs(one - other) / max(abs(one), abs(other), 1e-300) if one != other else 0.0
    return 0.0 if one == other else math.inf


def run(arguments):
    rng = random.Random(arguments.seed)
    recording = gg.read(arguments.recording)
    whole, out, journal = (arguments.folder / name for name in ("whole", "out", "journal"))
    words = [str(arguments.recording)]
    wanted = list(range(1, 1 + sum(1 for _ in json_lines(recording))))
    if arguments.source == "file":
        feed = arguments.folder / "feed.jsonl"
        lines = list(json_lines(recording))
        feed.write_text("".join([*lines[:7], "garbage\n", *lines[7:]]))
        words = [str(feed), "--like", str(arguments.recording), "--every", str(arguments.every)]
        wanted = [number for number in range(1, len(lines) + 2) if number != 8]
    began = time.monotonic()
    assert wait(begin([*words, "-o", str(whole), "--journal", str(journal)])) == 0
    took = time.monotonic() - began
    kills, equal, worst = 0, 0, 0.0
    for _ in range(arguments.runs):
        for path in (out, journal):
            path.unlink(missing_ok=True)
        command = [*words, "-o", str(out), "--journal", str(journal)]
        before = kills
        while kills == before:
            # Begun again if it was done before it could be killed.
            out.unlink(missing_ok=True)
            journal.unlink(missing_ok=True)
            kills += sum(
                killed_once(command, rng.uniform(0.0, took)) for _ in range(rng.randrange(1, 4))
            )
        status = wait(begin(command))
        assert status == 0, f"status {status}: {Path(f'{journal}.log').read_text()}"
        numbers = journalled(journal)
        assert numbers == wanted, f"{len(numbers)} rows in the journal, expected {len(wanted)}"
        ours, theirs = out.read_bytes(), whole.read_bytes()
        equal += ours == theirs
        pairs = zip(ours.splitlines(), theirs.splitlines(), strict=True)
        worst = max(worst, *(greatest_difference(*map(json.loads, pair)) for pair in pairs))
        assert worst <= 1e-9, f"the resumed result differs by {worst:.1e}"
    rest = "" if equal == arguments.runs else f", the others to {worst:.1e}"
    print(f"{arguments.runs} runs, {kills} kills: {equal} equal to the last bit{rest}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--source", choices=["recording", "file"], default="recording")
    parser.add_argument("--every", type=float, default=0.25)
    parser.add_argument("--engine", choices=["stand-in", "real"], default="real")
    chosen = parser.parse_args()
    if chosen.engine == "stand-in":
        run_track._engine = lambda recording, _: SlowEngine(recording)
    sys.exit(run(chosen))
