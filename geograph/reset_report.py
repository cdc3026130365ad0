"""What the summary says of resets: when, by how much the errors jumped, and how sure that is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.resets import searched
from geograph.states import AZIMUTH, CHANNEL_NAMES, CLOCK, ELEVATION
from geograph.stretches import WalkCuts

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.smoother import Smoother
    from geograph.track import Track


def reset_facts(smoother: Smoother, track: Track) -> list[dict[str, Any]]:
    """Return every reset of the sensors that measured something, in the order of time.

    Parameters
    ----------
    smoother
        After its run.
    track
        Its estimate and covariances.
    """
    prepared, states = smoother.prepared, smoother.problem.states
    found = set(searched(prepared))
    families = smoother.families
    facts = []
    for index, name in enumerate(prepared.recording.sensor_names):
        times = np.concatenate([f.time_s[f.sensor == index] for f in families])
        if not times.size:
            continue
        for channels, what in (((AZIMUTH, ELEVATION), "pointing"), ((CLOCK,), "clock")):
            for time in states.stretches.of(index, channels[0]).tolist():
                if not times.min() < time <= times.max():
                    continue
                entry: dict[str, Any] = {
                    "sensor": name,
                    "error": what,
                    "time_s": time,
                    "between_s": [
                        float(times[times < time].max()),
                        float(times[times >= time].min()),
                    ],
                    "found": what == "pointing" and index in found,
                }
                for channel in channels:
                    entry |= _jump(track, index, channel, time)
                facts.append(entry)
    return sorted(facts, key=lambda entry: float(entry["time_s"]))


def _jump(track: Track, sensor: int, channel: int, time_s: float) -> dict[str, float]:
    """Return by how much an error jumped, and the sigma of that."""
    states, values, marginals = track.problem.states, track.values, track.marginals
    row = states.stretches.row(
        np.full(2, sensor), np.array([np.nextafter(time_s, -np.inf), time_s])
    )
    by_constants = np.zeros(states.size)
    for sign, own in zip((-1.0, 1.0), row.tolist(), strict=True):
        for columns, basis in (
            (states.bias_column, 1.0),
            (states.drift_column, time_s - states.since_s[own, channel]),
        ):
            column = int(columns[own, channel])
            if column >= 0:
                by_constants[column] += sign * basis * states.sigma[column]
    jump = float(by_constants @ values.constants)
    variance = float(by_constants @ marginals.constants @ by_constants)
    walk = int(states.walk_column[sensor, channel])
    if walk >= 0 and track.time_s.size > 1:
        added, spread = _walk_jump(track, walk, time_s, by_constants)
        jump, variance = jump + added, variance + spread
    sigma = float(np.sqrt(max(variance, 0.0)))
    if channel == CLOCK:
        return {"clock_jump_s": jump, "clock_jump_sigma_s": sigma}
    name = CHANNEL_NAMES[channel]
    return {
        f"{name}_jump_deg": float(np.degrees(jump)),
        f"{name}_jump_sigma_deg": float(np.degrees(sigma)),
    }


def _walk_jump(
    track: Track, walk: int, time_s: float, by_constants: NDArray[np.float64]
) -> tuple[float, float]:
    """Return a walk's value after a reset less that before, and what it adds to the variance."""
    problem, marginals = track.problem, track.marginals
    scale, column = float(problem.walk_scale[walk]), track.state.shape[1] + walk
    inside = np.clip(np.full(2, time_s), track.time_s[0], track.time_s[-1])
    place = problem.path.locate(inside)
    k = int(place.interval[0])
    share = place.offset_s / place.step_s
    tags = np.array([np.nextafter(time_s, -np.inf), time_s])
    cuts = WalkCuts.of(problem.states.walk_resets_s, np.full(2, walk), tags)
    before, after = cuts.weighed(track.time_s, place.interval, 1.0 - share, share)
    weight = np.array([before[1] - before[0], after[1] - after[0]])
    own = np.array(
        [
            [marginals.knots[k, column, column], marginals.neighbours[k, column, column]],
            [marginals.neighbours[k, column, column], marginals.knots[k + 1, column, column]],
        ]
    )
    cross = weight @ marginals.knot_constants[k : k + 2, column] @ by_constants
    value = float(weight @ track.values.walks[k : k + 2, walk])
    return scale * value, scale**2 * float(weight @ own @ weight) + 2.0 * scale * float(cross)
