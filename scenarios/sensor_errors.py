"""What is wrong with simulated sensors: biases, drifts, random walks, clocks, noise and outliers.

Signs are those of the recording format: *measured = true + error*, and *time tag = true time of
reception + clock error*. Drifts and walks are counted from the first reception of the recording.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.scenarios.observation import angles_from_direction, direction_from_angles

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.scenarios.observation import SeenAxes
    from geograph.sensors import SensorErrors

Draw = Literal["normal", "uniform"]


@dataclass(frozen=True, kw_only=True)
class TrueErrors:
    """The errors that one simulated sensor has, by the names of ``SensorErrors``; SI units.

    The three instabilities are diffusions, from which the walks are then drawn.
    """

    azimuth_bias_rad: float = 0.0
    elevation_bias_rad: float = 0.0
    azimuth_drift_rad_s: float = 0.0
    elevation_drift_rad_s: float = 0.0
    azimuth_instability_rad_sqrt_s: float = 0.0
    elevation_instability_rad_sqrt_s: float = 0.0
    clock_offset_s: float = 0.0
    clock_drift_s_s: float = 0.0
    clock_instability_s_sqrt_s: float = 0.0


def draw_errors(
    rng: np.random.Generator, prior: SensorErrors, *, draw: Draw = "normal"
) -> TrueErrors:
    """Draw one sensor's errors from their priors.

    Parameters
    ----------
    rng
        Source of randomness. It is asked for the same numbers whatever the priors are, so that
        passes which differ in one prior agree in everything else.
    prior
        Standard deviations.
    draw
        ``"normal"``, with the instabilities as given; or ``"uniform"`` between plus and minus
        sqrt(3) sigma, with the instabilities uniform between zero and sqrt(3) times the given.

    Raises
    ------
    ValueError
        If the prior holds an error that a simulated sensor of bearings does not have.
    """
    known = [entry.name for entry in fields(TrueErrors)]
    for entry in fields(prior):
        if entry.name not in known and getattr(prior, entry.name) > 0.0:
            raise ValueError(f"{entry.name} is not simulated; expected some of {', '.join(known)}")
    values = {}
    for name in known:
        normal = float(rng.standard_normal())
        flat = float(rng.uniform(-1.0, 1.0)) * np.sqrt(3.0)
        sigma = getattr(prior, name)
        if "instability" in name:
            values[name] = sigma if draw == "normal" else abs(flat) * sigma
        else:
            values[name] = (normal if draw == "normal" else flat) * sigma
    return TrueErrors(**values)


def random_walk(
    rng: np.random.Generator, elapsed_s: NDArray[np.float64], diffusion: float
) -> NDArray[np.float64]:
    """Draw a random walk, zero at time zero, at increasing times.

    Parameters
    ----------
    rng
        Source of randomness.
    elapsed_s
        Shape (n,), increasing from at least 0, seconds.
    diffusion
        Square root of the variance gained per second.
    """
    steps = np.diff(elapsed_s, prepend=0.0)
    walk: NDArray[np.float64] = diffusion * np.cumsum(
        np.sqrt(steps) * rng.standard_normal(elapsed_s.size)
    )
    return walk


def slow_errors(
    rng: np.random.Generator, time_s: NDArray[np.float64], correlation_s: float
) -> NDArray[np.float64]:
    """Draw two stationary errors of unit variance that are correlated in time, shape (2, n).

    Ornstein-Uhlenbeck processes: the correlation falls off as exp(-elapsed / correlation_s).

    Parameters
    ----------
    rng
        Source of randomness.
    time_s
        Shape (n,), increasing, seconds.
    correlation_s
        Time after which the correlation is 1/e.
    """
    left = np.exp(-np.diff(time_s, prepend=-np.inf) / correlation_s)
    fresh = np.sqrt(1.0 - left**2) * rng.standard_normal((2, time_s.size))
    found = np.zeros_like(fresh)
    for index in range(time_s.size):
        before = found[:, index - 1] if index else 0.0
        found[:, index] = left[index] * before + fresh[:, index]
    return found


@dataclass(frozen=True, eq=False)
class ErrorHistory:
    """One sensor's errors at its measurements: each of shape (n,), radians and seconds."""

    azimuth_rad: NDArray[np.float64]
    elevation_rad: NDArray[np.float64]
    clock_s: NDArray[np.float64]


def error_history(
    rng: np.random.Generator, errors: TrueErrors, elapsed_s: NDArray[np.float64]
) -> ErrorHistory:
    """Return bias + drift * elapsed + walk of both angles and of the clock.

    Parameters
    ----------
    rng
        Source of randomness of the walks.
    errors
        The sensor's constants.
    elapsed_s
        Shape (n,), increasing: true reception less the first of the recording, seconds.
    """

    def history(bias: float, drift: float, diffusion: float) -> NDArray[np.float64]:
        return bias + drift * elapsed_s + random_walk(rng, elapsed_s, diffusion)

    return ErrorHistory(
        history(
            errors.azimuth_bias_rad,
            errors.azimuth_drift_rad_s,
            errors.azimuth_instability_rad_sqrt_s,
        ),
        history(
            errors.elevation_bias_rad,
            errors.elevation_drift_rad_s,
            errors.elevation_instability_rad_sqrt_s,
        ),
        history(errors.clock_offset_s, errors.clock_drift_s_s, errors.clock_instability_s_sqrt_s),
    )


def stretch_history(
    rng: np.random.Generator,
    stretches: Sequence[TrueErrors],
    calibration_s: NDArray[np.float64],
    elapsed_s: NDArray[np.float64],
) -> ErrorHistory:
    """Return errors that begin anew at calibrations, each counted from its own.

    Parameters
    ----------
    rng
        Source of randomness of the walks.
    stretches
        The constants before the first calibration, and after each.
    calibration_s
        Shape (k,), increasing: when they were, counted as ``elapsed_s``.
    elapsed_s
        Shape (n,), increasing, as in :func:`error_history`.
    """
    begun = np.concatenate([[0.0], calibration_s])
    cuts = np.searchsorted(elapsed_s, calibration_s).tolist()
    parts = [
        error_history(rng, errors, elapsed_s[low:high] - since)
        for errors, since, low, high in zip(
            stretches, begun.tolist(), [0, *cuts], [*cuts, elapsed_s.size], strict=True
        )
    ]
    return ErrorHistory(
        *(np.concatenate(columns) for columns in zip(*map(_columns, parts), strict=True))
    )


def _columns(history: ErrorHistory) -> tuple[NDArray[np.float64], ...]:
    return history.azimuth_rad, history.elevation_rad, history.clock_s


def jumped(
    rng: np.random.Generator, errors: TrueErrors, elapsed_s: float, jump_rad: float
) -> TrueErrors:
    """Return the constants after a jump of given size, in a random direction.

    Parameters
    ----------
    rng
        Source of randomness.
    errors
        Before it.
    elapsed_s
        How long these had lasted; their drifts go on.
    jump_rad
        Root of the sum of the squares of the jumps of azimuth and elevation.
    """
    angle = float(rng.uniform(0.0, 2.0 * np.pi))
    return replace(
        errors,
        azimuth_bias_rad=errors.azimuth_bias_rad
        + errors.azimuth_drift_rad_s * elapsed_s
        + jump_rad * np.cos(angle),
        elevation_bias_rad=errors.elevation_bias_rad
        + errors.elevation_drift_rad_s * elapsed_s
        + jump_rad * np.sin(angle),
    )


def correlated_normals(
    rng: np.random.Generator, count: int, correlation: float
) -> NDArray[np.float64]:
    """Draw pairs of unit normals, shape (count, 2), each correlated over the rows by a constant."""
    common, own = rng.standard_normal(2), rng.standard_normal((count, 2))
    result: NDArray[np.float64] = np.sqrt(correlation) * common + np.sqrt(1.0 - correlation) * own
    return result


def add_sky_noise(
    azimuth_rad: NDArray[np.float64],
    elevation_rad: NDArray[np.float64],
    offset_rad: NDArray[np.float64],
    *,
    axes: SeenAxes,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Move directions along great circles and return their azimuths and elevations.

    Parameters
    ----------
    azimuth_rad, elevation_rad
        Shape (n,).
    offset_rad
        Shape (n, 2): on the sky, towards growing azimuth and towards growing elevation.
    axes
        Axes of the angles.
    """
    start = direction_from_angles(azimuth_rad, elevation_rad, axes=axes)
    level = np.zeros_like(elevation_rad)
    sideways = direction_from_angles(azimuth_rad + np.pi / 2.0, level, axes=axes)
    upwards = direction_from_angles(azimuth_rad, elevation_rad + np.pi / 2.0, axes=axes)
    length = np.hypot(*offset_rad.T)[:, None]
    # sin(length) / length, which is 1 at zero.
    slope = np.sinc(length / np.pi)
    moved = np.cos(length) * start + slope * (
        offset_rad[:, :1] * sideways + offset_rad[:, 1:] * upwards
    )
    return angles_from_direction(moved, axes=axes)


def draw_outliers(
    rng: np.random.Generator,
    azimuth_rad: NDArray[np.float64],
    elevation_rad: NDArray[np.float64],
    *,
    axes: SeenAxes,
    offset_rad: float | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return gross errors in the place of good directions.

    Parameters
    ----------
    rng
        Source of randomness.
    azimuth_rad, elevation_rad
        Shape (n,): the good directions.
    axes
        Axes of the angles.
    offset_rad
        How far off, in a random direction on the sky; None: anywhere on the sphere.
    """
    around = rng.uniform(0.0, 2.0 * np.pi, azimuth_rad.size)
    anywhere = rng.standard_normal((azimuth_rad.size, 3))
    if offset_rad is None:
        return angles_from_direction(anywhere, axes=axes)
    offset = offset_rad * np.stack([np.cos(around), np.sin(around)], axis=-1)
    return add_sky_noise(azimuth_rad, elevation_rad, offset, axes=axes)
