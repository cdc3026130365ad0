"""Measure the speed: ``python tests/benchmarks/run.py``; see ``--help``.

Problem files are made first (once; they stay in the output folder), every contestant reads them in
a process of its own, and one table a size says what each took. The exit status is 1 if a target
does not hold.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import subprocess
import sys
import time
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from contestants import CONTESTANTS
from measure import BUDGET_S, CLOCKS, Measured
from model import SIZES
from page import FIGURES, markdown, put
from picture import draw
from report import Results, show
from shell import Beside, measure_beside
from simulate import simulate
from targets import targets

HERE = Path(__file__).parent
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
PACKAGES = ("numpy", "scipy", "gtsam", "stonesoup", "filterpy", "pyceres", "symforce", "gri-kalman")


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--all", action="store_true", help="also what never ends in time")
    parser.add_argument("--sizes", nargs="+", choices=list(SIZES), default=list(SIZES))
    parser.add_argument("--contestants", nargs="+", choices=list(CONTESTANTS))
    parser.add_argument(
        "--limit", type=float, default=200.0, help="seconds of a solve after which it is stopped"
    )
    parser.add_argument(
        "--budget",
        type=float,
        default=BUDGET_S,
        help="seconds for which a contestant is run again",
    )
    parser.add_argument(
        "--clock",
        choices=list(CLOCKS),
        default="wall",
        help="process: time of the processor, for ratios on a busy machine",
    )
    parser.add_argument("--output", type=Path, default=Path("bench-output"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--page", type=Path, help="a page whose figures are replaced")
    parser.add_argument(
        "--no-beside", action="store_true", help="without the incremental engine and the command"
    )
    return parser.parse_args()


def problem_file(folder: Path, size: str, seed: int) -> Path:
    """Return the file of a problem, made if it is not there or was made by other code."""
    code = b"".join((HERE / name).read_bytes() for name in ("model.py", "simulate.py"))
    path = folder / f"{size}-{seed}-{hashlib.sha256(code).hexdigest()[:8]}.npz"
    if not path.exists():
        partial = path.with_suffix(".partial.npz")
        simulate(SIZES[size], seed=seed).save(partial)
        partial.replace(path)
    return path


def measured_alone(
    pass_file: Path, name: str, result_file: Path, options: argparse.Namespace
) -> Measured | str:
    """Measure a contestant in a process of its own; a string says why it has no result."""
    missing = CONTESTANTS[name].missing()
    if missing is not None:
        return f"not installed ({missing})"
    begun = result_file.with_suffix(".begun")
    begun.unlink(missing_ok=True)
    command = [sys.executable, str(HERE / "measure.py"), str(pass_file), name, str(result_file)]
    command += [options.clock, str(options.budget)]
    errors = result_file.with_suffix(".err")
    with errors.open("w", encoding="utf-8") as said:
        started = time.monotonic()
        child = subprocess.Popen(
            command,
            env=os.environ | dict.fromkeys(THREADS, "1"),
            stdout=subprocess.DEVNULL,
            stderr=said,
        )
        solving: float | None = None
        while child.poll() is None:
            now = time.monotonic()
            if solving is None and begun.exists():
                solving = now
            if now - (solving or started) > options.limit:
                child.kill()
                child.wait()
                return f"{'' if solving else 'set-up '}> {options.limit:g} s"
            time.sleep(0.02)
    begun.unlink(missing_ok=True)
    if child.returncode:
        lines = errors.read_text(encoding="utf-8").strip().splitlines()
        return f"failed: {(lines or [f'ended with status {child.returncode}'])[-1]}"
    return Measured(**json.loads(result_file.read_text(encoding="utf-8")))


def surroundings() -> dict[str, str]:
    """Return what the figures depend on."""
    packages = {}
    for name in PACKAGES:
        try:
            packages[name] = version(name)
        except PackageNotFoundError:
            packages[name] = "not installed"
    load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
    return packages | {
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "load before": load,
    }


def measure_all(options: argparse.Namespace) -> Results:
    """Measure every contestant at every size, and print a table a size."""
    results: Results = {}
    for size in options.sizes:
        pass_file = problem_file(options.output, size, options.seed)
        results[size] = {}
        for name in options.contestants or list(CONTESTANTS):
            if size in CONTESTANTS[name].too_slow and not options.all:
                results[size][name] = "left out; run with --all"
                continue
            if SIZES[size].emissions and CONTESTANTS[name].bearings_only:
                results[size][name] = "bearings only"
                continue
            result_file = options.output / f"{size}-{name}.json"
            results[size][name] = measured_alone(pass_file, name, result_file, options)
        show(results, size)
    return results


def main() -> int:
    """Measure, print and save; return the exit status."""
    options = arguments()
    options.output.mkdir(parents=True, exist_ok=True)
    around = surroundings() | {"clock": options.clock}
    print(", ".join(f"{name} {value}" for name, value in around.items()))
    print(
        "Medians; linear algebra on one thread. Memory: peak resident memory (getrusage) over that "
        "before the set-up.\nsigma: the RMSE that the marginals promise. linearise, eliminate: one "
        "iteration, timed by itself at the estimate."
    )
    results = measure_all(options)
    beside = Beside() if options.no_beside else measure_beside(options.output)
    print()
    wanted = targets(results, beside)
    for target in wanted:
        print(target)
    saved = {
        "surroundings": around,
        "seed": options.seed,
        "limit_s": options.limit,
        "clock": options.clock,
        "results": {
            size: {name: e if isinstance(e, str) else asdict(e) for name, e in entries.items()}
            for size, entries in results.items()
        },
        "beside": asdict(beside),
        "targets": [asdict(target) | {"holds": target.holds} for target in wanted],
    }
    table = options.output / "benchmark.json"
    table.write_text(json.dumps(saved, indent=2) + "\n", encoding="utf-8")
    text = markdown(results, wanted, around)
    (options.output / "benchmark.md").write_text(text, encoding="utf-8")
    draw(results, options.output / "benchmark.png")
    print(f"\nwritten: {table}, benchmark.md and benchmark.png beside it")
    if options.page:
        put(text, options.page, FIGURES)
        picture = options.page.parent / "images" / f"{options.page.stem}.png"
        draw(results, picture)
        print(f"replaced: the figures in {options.page}, and {picture}")
    return 0 if all(target.holds for target in wanted) else 1


if __name__ == "__main__":
    sys.exit(main())
