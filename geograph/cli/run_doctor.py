"""What ``geograph doctor`` prints."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from geograph.checkup import check
from geograph.cli import FINDINGS, OK
from geograph.io import read
from geograph.results.write import json_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from geograph.checkup import Finding


def run_doctor(path: Path, *, json: bool) -> int:
    """Print the summary of a recording and what is wrong with it; return the exit status.

    Raises
    ------
    InputError
        If the recording cannot be read.
    """
    recording = read(path)
    found, facts = check(recording)
    if json:
        print(json_text({**facts, "findings": [finding.facts() for finding in found]}))
    else:
        print(summary_text(facts))
        print(findings_text(found))
    return OK if all(finding.severity == "note" for finding in found) else FINDINGS


def summary_text(facts: Mapping[str, Any]) -> str:
    """Return the summary as lines of text."""
    lines = [f"{facts['name']}: frame {facts['frame']}"]
    for name, table in facts["tables"].items():
        lines.append(f"{name}: {table['rows']} rows, {table['span_s']:.6g} s")
        width = max(len(sensor) for sensor in table["sensors"])
        for sensor, own in table["sensors"].items():
            rate = "" if own["rate_hz"] is None else f", {own['rate_hz']:.3g} per second"
            lines.append(
                f"  {sensor.ljust(width)}  {own['rows']:6d} rows, "
                f"{own['first_s']:.3f} to {own['last_s']:.3f} s{rate}"
            )
    if facts["baselines_m"] is not None:
        low, high = facts["baselines_m"]
        lines.append(f"baselines: {low:.4g} to {high:.4g} m")
    if facts["crossing_deg"] is not None:
        low, middle, high = facts["crossing_deg"]
        lines.append(f"rays cross at {low:.3g} to {high:.3g} deg, median {middle:.3g}")
    return "\n".join(lines)


def findings_text(found: Sequence[Finding]) -> str:
    """Return the findings as lines of text."""
    if not found:
        return "nothing to object"
    lines = []
    for finding in found:
        whose = f"{finding.sensor} " if finding.sensor else ""
        lines.append(f"{finding.severity}: {whose}({finding.file}): {finding.text}")
        lines.append(f"  -> {finding.remedy}")
    return "\n".join(lines)
