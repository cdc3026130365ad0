"""Streams with faults through ``geograph track``, each compared with its clean stream.

    python tests/feed_faults.py FOLDER [--runs 1000]

A stream is a short pass over three fixed sensors, in JSON lines. Between its lines stand bad ones,
at random: garbage, NaN, unknown sensors, values out of range, and bearings for which the
measurement equation itself raises an exception; and at the start, in some, measurements by one
sensor alone, which determine nothing. Every stream has to end with the estimate of its clean lines,
within 0.02 of a sigma, and to name each bad line once.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import random
import re
import sys
from collections import Counter
from pathlib import Path

import numpy as np
from small_recordings import write_small

import geograph as gg
from geograph.cli import main
from geograph.families import BearingFamily
from geograph.feed import json_lines
from geograph.incremental import intervals

POISON_DEG = 12.3456789
NAMES = ("x_m", "y_m", "z_m")


def raise_for_poison(evaluate, error=RuntimeError):
    """Return an evaluation of bearings that raises for one measured azimuth."""

    def raising(bearings, *arguments, **options):
        if (np.abs(bearings.bearings.azimuth_rad - np.radians(POISON_DEG)) < 1e-9).any():
            raise error("an exception inside a factor")
        return evaluate(bearings, *arguments, **options)

    return raising


def raise_for_poison_of(interval, error=RuntimeError):
    """Return the same of an interval's bearings in compiled code."""

    def raising(model, fixed, chain, k):
        columns = chain.pieces[k].rows.get("bearings")
        if columns is not None:
            poison = np.abs(columns["azimuth_rad"] - np.radians(POISON_DEG)) < 1e-9
            if poison.any():
                raise error("an exception inside a factor")
        return interval(model, fixed, chain, k)

    return raising


def bad_line(rng, line):
    """Return a line that cannot be used, and what kind it is."""
    row = json.loads(line)
    kind = rng.choice(["garbage", "nan", "sensor", "range", "exception"])
    if kind == "garbage":
        return rng.choice([line[: rng.randrange(1, len(line) - 2)], "\x00\x01", "[]", "x"]), kind
    row |= {
        "nan": {rng.choice([name for name in row if name != "sensor"]): float("nan")},
        "sensor": {"sensor": "Z"},
        "range": rng.choice([{"sigma_deg": 0.0}, {"elevation_deg": 91.0}, {"time_s": 1e12}]),
        "exception": {"azimuth_deg": POISON_DEG},
    }[kind]
    return json.dumps(row), kind


def stream(rng, lines):
    """Return clean lines, the lines with faults, and the kinds of the bad ones by number."""
    clean = lines[: rng.randrange(30, 61)]
    kinds = {}
    if rng.random() < 0.3:
        # An indeterminate start: one sensor alone, for half a second to two seconds.
        until = rng.choice([6, 12, 24])
        clean = [line for n, line in enumerate(clean) if n >= until or '"sensor": "A"' in line]
    mixed = []
    for line in clean:
        while rng.random() < 0.1:
            text, kind = bad_line(rng, line)
            mixed.append(text)
            kinds[len(mixed)] = kind
        mixed.append(line.rstrip("\n"))
    return clean, mixed, kinds


def tracked(folder, name, lines, recording, every):
    """Return exit status, last line and what was said of the lines of one stream."""
    feed, out = folder / f"{name}.jsonl", folder / f"{name}.out"
    feed.write_text("".join(line.rstrip("\n") + "\n" for line in lines))
    said = io.StringIO()
    words = [str(feed), "--like", str(recording), "--every", every, "-o", str(out)]
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        status = main(["track", *words])
    numbers = [int(number) for number in re.findall(r"\.jsonl:(\d+)", said.getvalue())]
    return status, json.loads(out.read_text().splitlines()[-1]), numbers


def run(folder, runs, seed):
    folder.mkdir(parents=True, exist_ok=True)
    recording = folder / "small"
    if not recording.exists():
        write_small(recording)
    lines = list(json_lines(gg.read(recording)))
    BearingFamily.evaluate = raise_for_poison(BearingFamily.evaluate)
    intervals.interval = raise_for_poison_of(intervals.interval)
    seen, worst, failed = Counter(), 0.0, []
    for number in range(runs):
        rng = random.Random(seed + number)
        clean, mixed, kinds = stream(rng, lines)
        every = rng.choice(["0.5", "1", "100"])
        wanted_status, wanted, nothing = tracked(folder, "clean", clean, recording, every)
        assert nothing == [], f"stream {number}: the clean lines were complained about"
        status, found, named = tracked(folder, "mixed", mixed, recording, every)
        seen.update(kinds.values())
        facts = [(status, s["status"], s["used"], s.get("time_s")) for s in (found, wanted)]
        if sorted(named) != sorted(kinds) or facts[0] != facts[1] or status != wanted_status:
            failed.append(number)
        elif "x_m" in wanted:
            sigma = [np.sqrt(wanted[f"cov_{axis}{axis}_m2"]) for axis in "xyz"]
            miss = max(abs(found[n] - wanted[n]) / s for n, s in zip(NAMES, sigma, strict=True))
            worst = max(worst, float(miss))
            if miss > 0.02:
                failed.append(number)
    kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(seen.items()))
    print(f"{runs} streams, {sum(seen.values())} bad lines ({kinds})")
    print(f"{runs - len(failed)} as their clean streams, within {worst:.1e} sigma")
    if failed:
        print(f"not so: {', '.join(map(str, failed))}")
    return int(bool(failed))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    sys.exit(run(chosen.folder, chosen.runs, chosen.seed))
