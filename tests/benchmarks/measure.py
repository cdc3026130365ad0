"""Measure one contestant on one pass, alone in its process.

``measure.py PASS NAME RESULT CLOCK BUDGET_S``
"""

from __future__ import annotations

import json
import resource
import statistics
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from contestants import CONTESTANTS
from equations import cost
from model import Pass

if TYPE_CHECKING:
    from collections.abc import Callable

# A contestant is run again until this much time is spent, so that the quick ones, which a busy
# machine disturbs most, are measured most often.
BUDGET_S = 3.0
_RUNS = (3, 25)
_ENOUGH_S = 15.0


CLOCKS = {"wall": time.perf_counter, "process": time.process_time}
"""By the second one, a busy machine can at least tell ratios: all is done by one thread."""


@dataclass(frozen=True)
class Measured:
    """Medians over all runs of one contestant on one pass.

    Attributes
    ----------
    set_up_s, solve_s, marginals_s
        Seconds.
    total_s
        Median of solve and marginals together.
    iterations
        Linear systems solved.
    linearise_s, eliminate_s
        Seconds per iteration, where they can be told apart.
    memory_mb
        Peak resident memory over that before the set-up, in 10^6 bytes.
    rmse_m, sigma_m
        Root mean square of the position's error, and what the marginals say it should be.
    cost
        Cost of the model at the estimate.
    runs
        How often it was run.
    """

    set_up_s: float
    solve_s: float
    marginals_s: float
    total_s: float
    iterations: int
    linearise_s: float | None
    eliminate_s: float | None
    memory_mb: float
    rmse_m: float
    sigma_m: float
    cost: float
    runs: int


def _peak_mb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6


def measure(
    data: Pass,
    name: str,
    *,
    clock: str = "wall",
    budget_s: float = BUDGET_S,
    ready: Callable[[], object] = bool,
) -> Measured:
    """Run a contestant often enough for medians; ``ready`` is called before the first solve."""
    now = CLOCKS[clock]
    contestant = CONTESTANTS[name]()
    before = _peak_mb()
    memory = 0.0
    taken: list[tuple[float, float, float]] = []
    begin = now()
    while len(taken) < _RUNS[1]:
        start = now()
        run = contestant.set_up(data)
        set_up = now()
        if not taken:
            ready()
        start_solve = now()
        estimate = run.solve()
        solved = now()
        covariance = run.marginals()
        done = now()
        taken.append((set_up - start, solved - start_solve, done - solved))
        # Later runs would count what the allocator has not given back.
        memory = memory or _peak_mb() - before
        spent = done - begin
        if spent > _ENOUGH_S or (len(taken) >= _RUNS[0] and spent > budget_s):
            break
    stages = run.stages()
    medians = [statistics.median(column) for column in zip(*taken, strict=True)]
    miss = (estimate.path - data.truth)[:, :3]
    return Measured(
        set_up_s=medians[0],
        solve_s=medians[1],
        marginals_s=medians[2],
        total_s=statistics.median(row[1] + row[2] for row in taken),
        iterations=estimate.iterations,
        linearise_s=stages.linearise_s if stages else None,
        eliminate_s=stages.eliminate_s if stages else None,
        memory_mb=memory,
        rmse_m=float(np.sqrt(np.mean(np.sum(miss**2, axis=1)))),
        sigma_m=float(np.sqrt(np.mean(np.trace(covariance[:, :3, :3], axis1=1, axis2=2)))),
        cost=cost(data, estimate.path, estimate.errors),
        runs=len(taken),
    )


def main() -> None:
    """Measure and write the result as JSON; an empty file beside it says that the solve began."""
    pass_file, name, result_file, clock, budget = sys.argv[1:]
    begun = Path(result_file).with_suffix(".begun")
    measured = measure(
        Pass.load(Path(pass_file)),
        name,
        clock=clock,
        budget_s=float(budget),
        ready=begun.touch,
    )
    Path(result_file).write_text(json.dumps(asdict(measured)), encoding="utf-8")


if __name__ == "__main__":
    main()
