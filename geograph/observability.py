"""What the data do not determine, in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.geodesy import enu_axes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.track import Track

# A position is named weak when its sigma exceeds this share of its distance, and the path is
# unobservable when that of every knot exceeds the larger one.
WEAK_SHARE = 0.05
UNOBSERVABLE_SHARE = 0.3
_TRADE_OFF = 0.5


@dataclass(frozen=True)
class WeakDirections:
    """What is weakly observed.

    Attributes
    ----------
    sentences
        One for each weak direction.
    unobservable
        Whether the path as a whole is not determined.
    """

    sentences: list[str]
    unobservable: bool


def weak_directions(track: Track, distance_m: NDArray[np.float64]) -> WeakDirections:
    """Probe the posterior for directions of the position that the data leave open.

    Parameters
    ----------
    track
        With marginal covariances of knots and sensor states.
    distance_m
        Shape (n,): distances of the object from the sensors.
    """
    covariance = track.position_covariance_m2
    if not np.isfinite(covariance).all():
        return WeakDirections([_singular(track)], True)
    distance = float(np.median(distance_m))
    sigma = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance)[:, -1], 0.0))
    best, worst = int(np.argmin(sigma)), int(np.argmax(sigma))
    unobservable = bool(sigma[best] > UNOBSERVABLE_SHARE * distance)
    sentences = []
    if unobservable or sigma[best] > WEAK_SHARE * distance:
        sentences.append(_sentence(track, best, "everywhere on the path, at best"))
    elif sigma[worst] > WEAK_SHARE * distance:
        weak = sigma > WEAK_SHARE * distance
        share = f"for {100.0 * weak.mean():.0f} % of the path, at worst"
        sentences.append(_sentence(track, worst, share))
    return WeakDirections(sentences, unobservable)


def _singular(track: Track) -> str:
    """Say what is missing where the information could not even be inverted."""
    used = np.unique(track.residuals.sensor)
    sensors = list(track.recording.sensors.values())
    if used.size == 1 and sensors[int(used[0])].trajectory is None:
        name = track.recording.sensor_names[int(used[0])]
        return (
            f"{name} alone, from one place, sees directions only: the distance along its line of "
            "sight is not determined; add a second sensor, or a constraint"
        )
    return "the information of the measurements is singular: some unknowns are not seen at all"


def _sentence(track: Track, knot: int, where: str) -> str:
    """Say which direction is weak at a knot, and which sensor errors trade off with it."""
    values, vectors = np.linalg.eigh(track.position_covariance_m2[knot])
    direction, sigma = vectors[:, -1], float(np.sqrt(values[-1]))
    partners = _partners(track, knot, direction, sigma)
    text = f"the position along {_direction(track, knot, direction)}"
    if partners:
        text += " and " + ", ".join(partners) + " trade off"
    else:
        text += " is weakly determined"
    return f"{text}: 1-sigma {_length(sigma)} {where} (t = {track.time_s[knot]:.6g} s)"


def _partners(track: Track, knot: int, direction: NDArray[np.float64], sigma: float) -> list[str]:
    """Return the sensor states whose correlation with a direction exceeds one half."""
    states = track.problem.states.constants
    if not states:
        return []
    scale = track.problem.path_scale[:3]
    cross = (track.marginals.knot_constants[knot, :3] * scale[:, None]).T @ direction
    spread = np.sqrt(np.diagonal(track.marginals.constants))
    correlation = np.abs(cross) / (spread * sigma)
    names = track.recording.sensor_names
    order = np.argsort(-correlation)[:3]
    return [
        f"the {states[i].name.replace('_', ' ')} of {names[states[i].sensor]}"
        for i in order
        if correlation[i] > _TRADE_OFF
    ]


def _direction(track: Track, knot: int, direction: NDArray[np.float64]) -> str:
    """Name a direction by its largest components: up, east, north, or the axes."""
    if track.frame == "ecef":
        parts = enu_axes(track.position_m[knot]) @ direction
        names = ("east", "north", "up")
    else:
        parts, names = direction, ("x", "y", "z")
    order = np.argsort(-np.abs(parts))
    if abs(parts[order[0]]) > 0.95:
        return names[order[0]]
    lead = np.sign(parts[order[0]])
    text = [
        f"{lead * parts[index]:+.2f} {names[index]}" for index in order if abs(parts[index]) > 0.3
    ]
    return "(" + " ".join(text) + ")"


def _length(metres: float) -> str:
    return f"{metres / 1e3:.3g} km" if metres >= 1e3 else f"{metres:.3g} m"
