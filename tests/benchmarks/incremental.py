"""Latency of incremental updates: ``incremental.py [--knots N]``; prints tables, asserts nothing.

One pass of 5 biased sensors on the ground, 1500 bearings, 200 intervals: an update for each
interval. Then a feed of the same kind without end, with a lag of 20 knots.
"""

from __future__ import annotations

import argparse
import dataclasses
import gc
import json
import time
from pathlib import Path

import numpy as np

import geograph as gg
from geograph.scenarios import low_orbit_pass

LAG_KNOTS = 20


def rows(table, chosen):
    return gg.Bearings(
        **{entry.name: getattr(table, entry.name)[chosen] for entry in dataclasses.fields(table)}
    )


def updates(table, edges):
    order = np.argsort(table.time_s)
    ends = np.searchsorted(table.time_s[order], edges[1:-1])
    return [rows(table, part) for part in np.split(order, ends) if part.size]


def latencies(smoother, batches):
    """Return milliseconds of the updates after the start: on the wall, and of this thread alone."""
    wall, own = [], []
    for batch in batches:
        tracking = smoother.estimate.status is gg.Tracking.TRACKING
        # The clock of the thread takes a call of the system: outside of the other's.
        thread = time.thread_time()
        begun = time.perf_counter()
        smoother.update(batch)
        took = time.perf_counter() - begun
        thread = time.thread_time() - thread
        if tracking:
            wall.append(1e3 * took)
            own.append(1e3 * thread)
    return np.array(wall), np.array(own)


def one_pass():
    """Print a table; return the structured engine's figures without a lag, on the wall."""
    recording = low_orbit_pass(
        1, sensors=5, bearings=300, instability_rad_sqrt_s=0.0, platform="ground"
    )
    edges = np.linspace(*recording.time_span_s, 201)
    batches = updates(recording.bearings, edges)
    print("| engine | lag | median ms | 99th percentile ms | of the thread: median | 99th |")
    print("| --- | --- | --- | --- | --- | --- |")
    for engine in ("structured", "isam2"):
        for knots in (None, LAG_KNOTS):
            spacing = float(edges[1] - edges[0])
            smoother = gg.IncrementalSmoother.of(
                recording,
                spacing_s=spacing,
                engine=engine,
                lag=None if knots is None else knots * spacing,
            )
            wall, own = latencies(smoother, batches)
            if engine == "structured" and knots is None:
                found = {"median_ms": float(np.median(wall)), "percentile_99_ms": _p99(wall)}
            figures = [f(part) for part in (wall, own) for f in (np.median, _p99)]
            print(f"| {engine} | {knots or 'none'} | " + " | ".join(f"{x:.2f}" for x in figures)
                  + " |", flush=True)  # fmt: skip
    return found


def _p99(part):
    return float(np.percentile(part, 99))


def resident_mb():
    """Return this process's resident memory in 10^6 bytes; not a number where it is not told."""
    status = Path("/proc/self/status")
    if not status.exists():
        return float("nan")
    (line,) = (line for line in status.read_text().splitlines() if line.startswith("VmRSS:"))
    return 1024 * int(line.split()[1]) / 1e6


def endless(knots):
    """A body on a circle of 2 km, watched by 5 sensors around it: bearings without end."""
    rng = np.random.default_rng(7)
    places = 4000.0 * np.array([[np.cos(a), np.sin(a), 0.0] for a in np.arange(5) * 2 * np.pi / 5])
    errors = gg.SensorErrors(azimuth_bias_rad=1e-3, elevation_bias_rad=1e-3)
    sensors = {
        f"S{i}": gg.Sensor(name=f"S{i}", position_m=place, axes="xyz", errors=errors)
        for i, place in enumerate(places)
    }
    bias = rng.normal(0.0, 1e-3, (5, 2))
    smoother = gg.IncrementalSmoother(
        sensors,
        motion=gg.ConstantAcceleration(1.0),
        frame="local",
        propagation_speed_m_s=np.inf,
        spacing_s=1.0,
        loss="none",
        lag=float(LAG_KNOTS),
    )
    wall, held = [], []
    for knot in range(knots):
        when = knot + rng.uniform(0.0, 1.0, 7)
        when.sort()
        sensor = rng.integers(0, 5, 7)
        angle = 0.02 * when
        at = np.stack([2000 * np.cos(angle), 2000 * np.sin(angle), 1000 + 0 * angle], axis=1)
        line = at - places[sensor]
        noise = rng.normal(0.0, 1e-4, (7, 2))
        elevation = np.arctan2(line[:, 2], np.hypot(line[:, 0], line[:, 1]))
        table = gg.Bearings(
            time_s=when,
            sensor=sensor,
            azimuth_rad=np.arctan2(line[:, 1], line[:, 0]) + bias[sensor, 0]
            + noise[:, 0] / np.cos(elevation),
            elevation_rad=elevation + bias[sensor, 1] + noise[:, 1],
            sigma_azimuth_rad=np.full(7, 1e-4),
            sigma_elevation_rad=np.full(7, 1e-4),
            isotropic=np.ones(7, dtype=bool),
            line=np.arange(7 * knot, 7 * knot + 7),
        )  # fmt: skip
        begun = time.thread_time()
        smoother.update(table)
        wall.append(1e3 * (time.thread_time() - begun))
        if knot % 50 == 0:
            gc.collect()
            held.append((knot, resident_mb()))
    quarter = knots // 4
    first, last = slice(0, quarter), slice(-quarter, None)
    at, held = np.array(held).T
    early, late = held[at < quarter], held[at >= knots - quarter]
    print(f"\n{knots} knots, lag {LAG_KNOTS} knots:\n")
    print("| | first quarter | last quarter |\n| --- | --- | --- |")
    print(
        f"| median ms of the thread | {np.median(wall[first]):.2f} | {np.median(wall[last]):.2f} |"
    )
    print(f"| resident, MB (median) | {np.median(early):.1f} | {np.median(late):.1f} |")
    print(f"| resident, MB (most) | {early.max():.1f} | {late.max():.1f} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--knots", type=int, default=20000)
    parser.add_argument("--pass-only", action="store_true", help="without the feed without end")
    parser.add_argument("--json", type=Path, help="write the structured engine's figures there")
    chosen = parser.parse_args()
    found = one_pass()
    if chosen.json:
        chosen.json.write_text(json.dumps(found) + "\n", encoding="utf-8")
    if not chosen.pass_only:
        endless(chosen.knots)


if __name__ == "__main__":
    main()
