"""How time and memory grow: ``scaling.py [--day] [--passes]``; prints tables.

From recordings to tracks with all covariances (``geograph.smooth``), each in a process of its own:
against the bearings between the same knots, against the knots that the same bearings have, against
the length of a pass, against the sensors; with ``--passes``, many passes on all cores; with
``--day``, a day with 100 000 knots, by both eliminations. The last columns are time and memory over
those of the row before, divided by the growth of what grew: 1 is linear, less is better.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from long_pass import long_pass
from measure import CLOCKS
from page import SCALING, put
from run import THREADS

import geograph as gg

SPACING_S = 0.864


@dataclass(frozen=True)
class Case:
    """One recording, and how it is smoothed."""

    knots: int
    bearings: int
    sensors: int = 5
    elimination: str = "structured"


AXES: dict[str, tuple[str, list[Case]]] = {
    "bearings": (
        "bearings, 1000 knots",
        [Case(1000, 4_000), Case(1000, 40_000), Case(1000, 400_000)],
    ),
    "knots": (
        "knots, 40 000 bearings",
        [Case(200, 40_000), Case(2_000, 40_000), Case(20_000, 40_000)],
    ),
    "length": (
        "length of the pass, 32 bearings a knot",
        [Case(200, 6_400), Case(2_000, 64_000), Case(20_000, 640_000)],
    ),
    "sensors": (
        "sensors, 2000 knots, 64 000 bearings",
        [Case(2_000, 64_000, sensors) for sensors in (4, 8, 16, 32)],
    ),
}

DAY = [Case(100_000, 400_000, elimination=elimination) for elimination in ("structured", "gtsam")]

DAY_TITLE = "a day"

PASSES = (10, 100, 1000)
PASSES_S = 45.0
"""What the last of them may take, seconds."""

Row = dict[str, Any]

_HEADER = (
    "knots", "bearings", "sensors", "elimination", "s", "iterations", "MB", "bytes a bearing",
    "time grows", "memory grows",
)  # fmt: skip


def smooth_here(case: Case, clock: str) -> Row:
    """Smooth a case in this process."""
    now = CLOCKS[clock]
    span = SPACING_S * (case.knots - 1)
    recording = long_pass(span, case.bearings, sensors=case.sensors)
    # What is imported at the first use is not counted.
    gg.smooth(long_pass(10.0, 200), spacing_s=SPACING_S, elimination=case.elimination)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begun = now()
    track = gg.smooth(
        recording, spacing_s=SPACING_S, elimination=case.elimination, raise_on_failure=False
    )
    taken = now() - begun
    unit = 1 if sys.platform == "darwin" else 1024
    peak = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * unit
    return {
        "seconds": taken,
        "memory_mb": peak / 1e6,
        "status": str(track.status),
        "iterations": track.summary["iterations"],
        "knots": len(track.time_s),
    }


def smooth_alone(case: Case, clock: str, output: Path) -> Row | str:
    """Smooth a case in a process of its own; a string says why there is no result."""
    result = output / "scaling-case.json"
    result.unlink(missing_ok=True)
    command = [sys.executable, __file__, "--clock", clock, "--case", str(result)]
    command += [str(value) for value in vars(case).values()]
    done = subprocess.run(
        command,
        env=os.environ | dict.fromkeys(THREADS, "1"),
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    if done.returncode:
        said = done.stderr.strip().splitlines()
        # A signal, a stack that overflows say, leaves a negative number and no word.
        return f"ended with status {done.returncode}: {said[-1] if said else 'nothing said'}"
    return dict(json.loads(result.read_text(encoding="utf-8")))


def table(title: str, cases: list[Case], clock: str, output: Path) -> tuple[list[str], list[Row]]:
    """Measure and print one table; return its lines and its figures."""
    lines: list[str] = []
    _say(lines, f"\n**{title}**\n")
    _say(lines, f"| {' | '.join(_HEADER)} |")
    _say(lines, "|" + " --- |" * len(_HEADER))
    rows: list[Row] = []
    for case in cases:
        found = smooth_alone(case, clock, output)
        cells = [str(case.knots), str(case.bearings), str(case.sensors), case.elimination]
        if isinstance(found, str):
            cells += [found, *[""] * 5]
            rows.append(vars(case) | {"failed": found})
        else:
            status = "" if found["status"] == "converged" else f" ({found['status']})"
            cells += [
                f"{found['seconds']:.2f}{status}",
                str(found["iterations"]),
                f"{found['memory_mb']:.0f}",
                f"{1e6 * found['memory_mb'] / case.bearings:.0f}",
            ]
            cells += _growth(case, found, rows[-1] if rows and title != DAY_TITLE else None)
            rows.append(vars(case) | found)
        _say(lines, f"| {' | '.join(cells)} |")
    return lines, rows


def _growth(case: Case, found: Row, last: Row | None) -> list[str]:
    """Return how time and memory grew since the row before, over how the case did."""
    if last is None or "failed" in last:
        return ["", ""]
    factor = max(getattr(case, part) / last[part] for part in ("knots", "bearings", "sensors"))
    return [f"{found[part] / last[part] / factor:.2f}" for part in ("seconds", "memory_mb")]


def _say(lines: list[str], line: str) -> None:
    print(line, flush=True)
    lines.append(line)


def passes(output: Path) -> tuple[list[str], list[Row]]:
    """Time Monte Carlo passes of 1500 bearings on all cores; print a table, and return it."""
    lines: list[str] = []
    _say(lines, "\n**passes of 1500 bearings, on all cores**\n")
    _say(lines, "| passes | s | ms each |\n| --- | --- | --- |")
    rows: list[Row] = []
    command = [sys.executable, "-m", "geograph", "montecarlo", "low-orbit", "--no-plots"]
    command += ["--set", "sensors=5", "--set", "bearings=300"]
    for count in PASSES:
        begun = time.perf_counter()
        subprocess.run(
            [*command, "--runs", str(count), "--json", str(output / "passes.json")],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        taken = time.perf_counter() - begun
        _say(lines, f"| {count} | {taken:.1f} | {1e3 * taken / count:.0f} |")
        rows.append({"passes": count, "seconds": taken})
    print(
        f"\n{'holds' if taken <= PASSES_S else 'FAILS'}: {PASSES[-1]} passes, s: {taken:.1f} "
        f"(at most {PASSES_S:g})"
    )
    return lines, rows


def main() -> None:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--axes", nargs="*", choices=list(AXES), default=list(AXES))
    parser.add_argument("--day", action="store_true", help="also a day with 100 000 knots")
    parser.add_argument("--passes", action="store_true", help="also many passes on all cores")
    parser.add_argument("--clock", choices=list(CLOCKS), default="wall")
    parser.add_argument("--output", type=Path, default=Path("bench-output"))
    parser.add_argument("--page", type=Path, help="a page whose tables are replaced")
    parser.add_argument("--case", nargs=5, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.case:
        result, knots, bearings, sensors, elimination = options.case
        case = Case(int(knots), int(bearings), int(sensors), elimination)
        found = smooth_here(case, options.clock)
        Path(result).write_text(json.dumps(found), encoding="utf-8")
        return
    options.output.mkdir(parents=True, exist_ok=True)
    parts = {name: table(*AXES[name], options.clock, options.output) for name in options.axes or ()}
    if options.day:
        parts["day"] = table(DAY_TITLE, DAY, options.clock, options.output)
    if options.passes:
        parts["passes"] = passes(options.output)
    path = options.output / "scaling.json"
    saved = {name: rows for name, (_, rows) in parts.items()}
    path.write_text(json.dumps(saved, indent=2) + "\n", encoding="utf-8")
    print(f"\nwritten: {path}")
    if options.page:
        put("\n".join(line for lines, _ in parts.values() for line in lines), options.page, SCALING)


if __name__ == "__main__":
    main()
