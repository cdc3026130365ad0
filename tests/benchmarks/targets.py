"""Figures that have to hold."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from contestants import CONTESTANTS
from model import SIZES
from report import OURS, Results, at_minimum, found

if TYPE_CHECKING:
    from collections.abc import Iterator

    from shell import Beside

# What a contestant has to be beaten by, at which size: a name, or the start of several names.
_FILTERS = {"stone-soup": 25, "filterpy": 25}
TIMES = {
    "medium": {"gtsam-per-bearing": 80, "scipy": 8, "pyceres": 8, **_FILTERS},
    "large": {"gtsam-per-bearing": 400, "scipy": 30, "pyceres": 30, **_FILTERS},
}

_TEN_TIMES = (("medium", "large"), ("large", "huge"))


@dataclass(frozen=True)
class Target:
    """A figure that has to hold."""

    text: str
    value: float | None
    limit: float
    at_least: bool
    bound: bool = False
    """Whether the value is only known to be at least that: a contestant was stopped."""

    @property
    def holds(self) -> bool:
        """Whether it was measured and holds."""
        if self.value is None:
            return False
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    def __str__(self) -> str:
        value = "not measured" if self.value is None else f"{self.value:.3g}"
        beyond = "more than " if self.bound else ""
        wanted = "at least" if self.at_least else "at most"
        verdict = "holds" if self.holds else "FAILS"
        return f"{verdict}: {self.text}: {beyond}{value} ({wanted} {self.limit:g})"


def _seconds(results: Results, size: str, name: str) -> tuple[float | None, bool]:
    """Return what a contestant took, and whether it was stopped then."""
    entry = results.get(size, {}).get(name)
    if isinstance(entry, str):
        stopped = re.fullmatch(r"> ([\d.]+) s", entry)
        return (float(stopped[1]), True) if stopped else (None, False)
    # A faster way to another place is no contestant.
    if entry is None or (CONTESTANTS[name].same_cost and not at_minimum(results, size, name)):
        return None, False
    return entry.total_s, False


def _against_others(results: Results) -> Iterator[Target]:
    for size, wanted in TIMES.items():
        ours = found(results, size, OURS)
        for start, limit in wanted.items():
            taken = [
                (*_seconds(results, size, name), name)
                for name in results.get(size, {})
                if name.startswith(start)
            ]
            known = [(s, stopped, name) for s, stopped, name in taken if s is not None]
            seconds, stopped, name = min(known, default=(None, False, start))
            ratio = seconds / ours.total_s if seconds is not None and ours else None
            yield Target(f"{size}: times faster than {name}", ratio, float(limit), True, stopped)


def _fastest(results: Results) -> Iterator[Target]:
    for size in SIZES:
        ours = found(results, size, OURS)
        others = [
            (seconds, stopped, name)
            for name in results.get(size, {})
            if name != OURS
            for seconds, stopped in [_seconds(results, size, name)]
            if seconds is not None
        ]
        if ours and others:
            seconds, stopped, name = min(others)
            yield Target(
                f"{size}: times faster than the next, {name}",
                seconds / ours.total_s,
                1.0,
                True,
                stopped,
            )


def _growth(results: Results) -> Iterator[Target]:
    for less, more in _TEN_TIMES:
        one, ten = found(results, less, OURS), found(results, more, OURS)
        ratio = ten.total_s / one.total_s if one and ten else None
        text = f"times as long for ten times the data ({less} to {more})"
        yield Target(text, ratio, 11.0, False)
    large = found(results, "large", OURS)
    size = SIZES["large"].measurements
    bytes_each = large.memory_mb * 1e6 / size if large else None
    yield Target("large: bytes of memory a bearing", bytes_each, 1000.0, False)


def targets(results: Results, beside: Beside) -> list[Target]:
    """Return all of them."""
    wanted = [*_against_others(results), *_fastest(results), *_growth(results)]
    wanted.append(Target("update, median, ms", beside.update_median_ms, 0.6, False))
    wanted.append(Target("update, 99th percentile, ms", beside.update_99_ms, 5.0, False))
    ratio = None
    if beside.smooth_s is not None and beside.imports_s is not None:
        ratio = beside.smooth_s / beside.imports_s
    wanted.append(Target("times the imports: geograph smooth of Winchcombe", ratio, 2.5, False))
    return wanted
