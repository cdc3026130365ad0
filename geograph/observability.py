"""What the data do not determine, in words."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from geograph.eliminate import response
from geograph.geodesy import enu_axes
from geograph.states import MISALIGNMENT
from geograph.vantage import vantage

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.eliminate import LinearSystem
    from geograph.track import Track

# A position is named weak when its sigma exceeds this share of its distance, and the path is
# unobservable when that of every knot exceeds the larger one.
WEAK_SHARE = 0.05
UNOBSERVABLE_SHARE = 0.3
_TRADE_OFF = 0.5

# A misalignment is not determined where its sigma stays above this share of the prior's.
_AS_BEFORE = 0.8
_SINGULAR = "the information of the measurements is singular: some unknowns are not seen at all"

# The planes of azimuth of all sensors hold their verticals, which are parallel or meet near the
# Earth's centre: what they have in common is a vertical, too.
_AZIMUTHS = (
    "azimuths alone do not tell the height; add elevations, or a constraint altitude_m if the "
    "height is known"
)
_BODY_AXES = ("body x (roll)", "body y (pitch)", "body z (yaw)")

# Rise of the cost at one sigma along the weakest direction. A Gaussian posterior has one half; at
# the first value the bend of a curved one adds half as much again, at the second it exceeds the
# sigma across, and the ellipsoid no longer holds the stated probability.
CURVED_RISE = 0.75
NOT_GAUSSIAN_RISE = 1.0
_BEND_SHARE = 0.02


@dataclass(frozen=True)
class WeakDirections:
    """What is weakly observed.

    Attributes
    ----------
    sentences
        One for each weak direction.
    unobservable
        Whether the path as a whole is not determined.
    directions
        The directions in which the position is known best and worst, at the best knot and the
        worst.
    curvature
        Rise of the cost at one sigma along the weakest direction, if it was probed; one half if the
        posterior is Gaussian.
    curved
        Why the posterior is not Gaussian; empty where nothing says so.
    """

    sentences: list[str]
    unobservable: bool
    directions: list[Direction] = field(default_factory=list)
    curvature: float | None = None
    curved: str = ""


@dataclass(frozen=True)
class Direction:
    """An eigenvector of a position's covariance, which is one of its information.

    Attributes
    ----------
    time_s
        When the position is meant.
    vector
        Unit vector in the frame.
    name
        Its largest components in words.
    sigma_m
        Standard deviation along it.
    weak
        Whether that is large against the distance from the sensors.
    """

    time_s: float
    vector: tuple[float, float, float]
    name: str
    sigma_m: float
    weak: bool


def weak_directions(
    track: Track, distance_m: NDArray[np.float64], *, curvature: bool = True
) -> WeakDirections:
    """Probe the posterior for directions of the position that the data leave open.

    Parameters
    ----------
    track
        With marginal covariances of knots and sensor states.
    distance_m
        Shape (n,): distances of the object from the sensors.
    curvature
        Whether to probe for a curved posterior, which needs measurements taken: away from the
        minimum the cost rises on one side for other reasons.
    """
    covariance = track.position_covariance_m2
    cause = _causes(track)
    if not np.isfinite(covariance).all():
        return WeakDirections(cause or [_SINGULAR], True)
    distance = float(np.median(distance_m))
    sigma = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance)[:, -1], 0.0))
    best, worst = int(np.argmin(sigma)), int(np.argmax(sigma))
    unobservable = bool(sigma[best] > UNOBSERVABLE_SHARE * distance)
    sentences = []
    limit = WEAK_SHARE * distance
    if unobservable or sigma[best] > limit:
        sentences += _sentences(track, best, "everywhere on the path, at best", limit)
    elif sigma[worst] > limit:
        share = f"for {100.0 * (sigma > limit).mean():.0f} % of the path, at worst"
        sentences += _sentences(track, worst, share, limit)
    if sentences:
        sentences += cause
    directions = [
        direction
        for knot in dict.fromkeys((best, worst))
        for direction in principal_directions(track, knot, limit)
    ]
    sentences += _unseen_misalignments(track)
    bent = _bent_knots(track, distance) if curvature else []
    rise, curved = None, ""
    if not unobservable and bent:
        rises = cost_rises(track, bent)
        rise = max(rises)
        if rise > CURVED_RISE:
            curved = (
                f"the posterior is curved: at one sigma the cost rises by {rise:.3g} "
                "instead of 0.5, so that the ellipsoids are too small"
            )
            worst_bent = bent[rises.index(rise)]
            sentences.append(f"{_sentence(track, worst_bent, -1, 'there')}; {curved}")
            # An end that is badly seen does not make the whole path unobservable.
            unobservable = rises[0] > NOT_GAUSSIAN_RISE
    elif unobservable:
        curved = "the position is not determined: where it ends is not a matter of linearisation"
    return WeakDirections(sentences, unobservable, directions, rise, curved)


def principal_directions(track: Track, knot: int, limit_m: float) -> list[Direction]:
    """Return the eigenvectors of a knot's position covariance, the weakest first.

    Parameters
    ----------
    track
        With covariances.
    knot
        Index of the knot.
    limit_m
        Sigma above which a direction is weak.
    """
    values, vectors = np.linalg.eigh(track.position_covariance_m2[knot])
    found = []
    for value, vector in zip(values[::-1], vectors.T[::-1], strict=True):
        sigma = float(np.sqrt(max(value, 0.0)))
        x, y, z = vector.tolist()
        name = _direction(track, knot, vector)
        found.append(Direction(float(track.time_s[knot]), (x, y, z), name, sigma, sigma > limit_m))
    return found


def _bent_knots(track: Track, distance_m: float) -> list[int]:
    """Return the knots whose ellipsoids are long enough to feel a curve, the typical one first.

    A move of s along an ellipsoid's longest axis, at a distance r, is off by up to s^2 / (2 r)
    across it, for bearings see along curves. Ground bends more than lines of sight do, and one part
    of a path over it more than another: there the worst knot is returned, too.
    """
    values = np.maximum(np.linalg.eigvalsh(track.position_covariance_m2), 0.0)
    bend = values[:, -1] / (2.0 * distance_m)
    share = bend / np.sqrt(np.maximum(values[:, 0], 1e-300))
    middle = int(np.argsort(share)[share.size // 2])
    if track.recording.terrain is not None:
        longest = int(np.argmax(values[:, -1]))
        return list(dict.fromkeys((middle, longest)))
    return [middle] if share[middle] > _BEND_SHARE else []


def cost_rises(track: Track, knots: list[int]) -> list[float]:
    """Return the rise of the cost at one sigma along the weakest direction of each knot, at most.

    All other unknowns move with it as the covariance says. For a Gaussian posterior it is one half
    on both sides (the likelihood ratio against the Wald statistic; D. M. Bates, D. G. Watts,
    *Nonlinear Regression Analysis and Its Applications*, 1988, chapter 6).

    Parameters
    ----------
    track
        With a problem that can be factorised at its estimate.
    knots
        Indices of the knots.
    """
    system = track.problem.linearise(track.values)
    return [_cost_rise(track, system, knot) for knot in knots]


def _cost_rise(track: Track, system: LinearSystem, knot: int) -> float:
    problem, values = track.problem, track.values
    _, vectors = np.linalg.eigh(track.position_covariance_m2[knot])
    direction = np.zeros(problem.layout.knot)
    direction[:3] = vectors[:, -1] * problem.path_scale[:3]
    move = response(system, knot, direction)
    sigma = float(np.sqrt(direction @ move.knots[knot]))
    costs = [
        problem.cost(
            problem.moved(values, replace(
                move, knots=side * move.knots / sigma, constants=side * move.constants / sigma
            ))
        )
        for side in (-1.0, 1.0)
    ]  # fmt: skip
    return max(costs) - system.cost


def _causes(track: Track) -> list[str]:
    """Say what it is about the sensors that leaves the position open, if that is known."""
    recording = track.recording
    if set(recording.tables) == {"bearings"} and recording.constraints is None:
        used = np.unique(track.residuals.sensor).tolist()
        sensors = [list(recording.sensors.values())[index] for index in used]
        falls = track.problem.motion.ballistic
        if len(used) == 1 and sensors[0].trajectory is None and not falls:
            return [
                f"{sensors[0].name} alone, from one place, sees directions only: the distance "
                "along its line of sight is not determined; add a second sensor, or a constraint"
            ]
        assert recording.bearings is not None
        upright = all(sensor.axes in ("enu", "xyz") for sensor in sensors)
        if upright and np.isnan(recording.bearings.elevation_rad).all():
            return [_AZIMUTHS]
    seen = vantage(track.problem, track.values)
    return [seen.sentence] if seen is not None and seen.sentence else []


def _sentences(track: Track, knot: int, where: str, limit_m: float) -> list[str]:
    """Return a sentence for each weak direction at a knot, the weakest first."""
    values = np.linalg.eigvalsh(track.position_covariance_m2[knot])
    weak = [index for index in (-1, -2, -3) if values[index] > limit_m**2]
    return [_sentence(track, knot, index, where) for index in weak]


def _sentence(track: Track, knot: int, index: int, where: str) -> str:
    """Say which direction is weak at a knot, and which sensor errors trade off with it."""
    values, vectors = np.linalg.eigh(track.position_covariance_m2[knot])
    direction, sigma = vectors[:, index], float(np.sqrt(values[index]))
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
        f"the {states[i].name.replace('_', ' ')} of {track.problem.states.owner(int(i), names)}"
        for i in order
        if correlation[i] > _TRADE_OFF
    ]


def _unseen_misalignments(track: Track) -> list[str]:
    """Name the axes about which a sensor's misalignment is no better known than before."""
    states = track.problem.states
    sentences = []
    for sensor, name in enumerate(track.recording.sensor_names):
        own = [
            column for column in states.of_sensor(sensor)
            if states.constants[column].channel >= MISALIGNMENT
        ]  # fmt: skip
        if not own:
            continue
        # Scaled by the prior, whose covariance is the identity.
        values, vectors = np.linalg.eigh(track.marginals.constants[np.ix_(own, own)])
        for value, axis in zip(values[::-1], vectors.T[::-1], strict=True):
            if value < _AS_BEFORE**2:
                break
            sigma = float(np.degrees(np.sqrt(value) * states.constants[own[0]].sigma))
            sentences.append(
                f"the misalignment of {name} about {_named(axis, _BODY_AXES)} is not determined: "
                f"its 1-sigma stays at {sigma:.3g} deg; more turns, or a surer height of the "
                "object, would tell"
            )
    return sentences


def _direction(track: Track, knot: int, direction: NDArray[np.float64]) -> str:
    """Name a direction by its largest components: up, east, north, or the axes."""
    if track.frame == "ecef":
        parts = enu_axes(track.position_m[knot]) @ direction
        names = ("east", "north", "up")
    else:
        parts, names = direction, ("x", "y", "z")
    return _named(parts, names)


def _named(parts: NDArray[np.float64], names: tuple[str, ...]) -> str:
    """Return the names of a unit vector's largest components."""
    order = np.argsort(-np.abs(parts))
    if abs(parts[order[0]]) > 0.95:
        return str(names[order[0]])
    lead = float(np.sign(parts[order[0]]))
    text = [
        f"{lead * parts[index]:+.2f} {names[index]}" for index in order if abs(parts[index]) > 0.3
    ]
    return "(" + " ".join(text) + ")"


def _length(metres: float) -> str:
    return f"{metres / 1e3:.3g} km" if metres >= 1e3 else f"{metres:.3g} m"
