"""Measure the speed: ``python tests/benchmarks/run.py``; see ``--help``.

Problem files are made first, every contestant reads them in a process of its own, and one table a
size says what each took. The exit status is 1 if a target does not hold.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from contestants import CONTESTANTS
from measure import Measured
from model import SIZES
from report import Results, draw, show, targets
from simulate import simulate

HERE = Path(__file__).parent
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--all", action="store_true", help="also what takes minutes")
    parser.add_argument("--sizes", nargs="+", choices=list(SIZES), default=list(SIZES))
    parser.add_argument("--contestants", nargs="+", choices=list(CONTESTANTS))
    parser.add_argument("--output", type=Path, default=Path("bench-output"))
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


def measured_alone(pass_file: Path, name: str, result_file: Path) -> Measured | str:
    """Measure a contestant in a process of its own; a string says why it has no result."""
    missing = CONTESTANTS[name].missing()
    if missing is not None:
        return f"needs {missing}"
    command = [sys.executable, str(HERE / "measure.py"), str(pass_file), name, str(result_file)]
    ended = subprocess.run(
        command,
        env=os.environ | dict.fromkeys(THREADS, "1"),
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    if ended.returncode:
        lines = ended.stderr.strip().splitlines() or [f"ended with status {ended.returncode}"]
        return f"failed: {lines[-1]}"
    return Measured(**json.loads(result_file.read_text(encoding="utf-8")))


def surroundings() -> dict[str, str]:
    """Return what the figures depend on."""
    packages = {}
    for name in ("numpy", "scipy", "gtsam"):
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


def main() -> int:
    """Measure, print and save; return the exit status."""
    options = arguments()
    options.output.mkdir(parents=True, exist_ok=True)
    around = surroundings()
    print(", ".join(f"{name} {value}" for name, value in around.items()))
    print(
        "Medians; linear algebra on one thread. Memory: peak resident memory (getrusage) over that "
        "before the set-up.\nsigma: the RMSE that the marginals promise. linearise, eliminate: one "
        "iteration, timed by itself at the estimate."
    )
    results: Results = {}
    names = options.contestants or list(CONTESTANTS)
    for size in options.sizes:
        pass_file = options.output / f"{size}.npz"
        simulate(SIZES[size], seed=options.seed).save(pass_file)
        results[size] = {}
        for name in names:
            if size in CONTESTANTS[name].too_slow and not options.all:
                results[size][name] = "left out; run with --all"
                continue
            result_file = options.output / f"{size}-{name}.json"
            results[size][name] = measured_alone(pass_file, name, result_file)
        show(results, size)
    print()
    wanted = targets(results)
    for target in wanted:
        print(target)
    saved = {
        "surroundings": around,
        "seed": options.seed,
        "results": {
            size: {name: e if isinstance(e, str) else asdict(e) for name, e in entries.items()}
            for size, entries in results.items()
        },
        "targets": [asdict(target) | {"holds": target.holds} for target in wanted],
    }
    table = options.output / "benchmark.json"
    table.write_text(json.dumps(saved, indent=2) + "\n", encoding="utf-8")
    draw(results, options.output / "benchmark.png")
    print(f"\nwritten: {table} and {options.output / 'benchmark.png'}")
    return 0 if all(target.holds for target in wanted) else 1


if __name__ == "__main__":
    sys.exit(main())
