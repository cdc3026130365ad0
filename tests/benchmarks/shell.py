"""What is measured beside the contestants: the incremental engine, and the command from a shell."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

HERE = Path(__file__).parent
_IMPORTS = "import gtsam, numpy, scipy, pandas"
_REPEATS = 7


@dataclass(frozen=True)
class Beside:
    """None: not measured.

    Attributes
    ----------
    update_median_ms, update_99_ms
        An update of the incremental engine, of its thread.
    smooth_s, imports_s
        Medians, from the shell: ``geograph smooth`` of the Winchcombe fireball to written results
        without pictures, and an interpreter that imports what it stands on.
    """

    update_median_ms: float | None = None
    update_99_ms: float | None = None
    smooth_s: float | None = None
    imports_s: float | None = None


def _seconds(command: list[str]) -> float:
    begun = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return time.perf_counter() - begun


def measure_beside(folder: Path) -> Beside:
    """Measure all of it."""
    latencies = folder / "incremental.json"
    subprocess.run(
        [sys.executable, str(HERE / "incremental.py"), "--pass-only", "--json", str(latencies)],
        check=True,
        stdout=subprocess.DEVNULL,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )
    update = json.loads(latencies.read_text(encoding="utf-8"))
    smooth, imports = [], []
    with TemporaryDirectory() as scratch:
        recording, results = f"{scratch}/winchcombe", f"{scratch}/results"
        geograph = [sys.executable, "-m", "geograph"]
        _seconds([*geograph, "example", "winchcombe", "-o", recording])
        for repeat in range(_REPEATS):
            # One after the other, so that a busy moment disturbs both alike.
            written = f"{results}-{repeat}"
            smooth.append(_seconds([*geograph, "smooth", recording, "-o", written, "--no-plots"]))
            imports.append(_seconds([sys.executable, "-c", _IMPORTS]))
    return Beside(
        update_median_ms=update["median_ms"],
        update_99_ms=update["percentile_99_ms"],
        smooth_s=statistics.median(smooth),
        imports_s=statistics.median(imports),
    )
