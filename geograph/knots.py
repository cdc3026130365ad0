"""Where the knots are: how close, and whether what lies between them matters.

Between two knots the path deviates from its interpolation by the prior's conditional variance. The
spacing is chosen so that this variance, added up over the information of an interval's
measurements, stays below one percent:

    q^2 c h^(2m-1) (n h / T) / sigma^2 <= 0.01,

with the density q^2, the order m, c the conditional variance in the middle of a unit interval, n
measurements in the time T, and sigma the median of angular sigma times distance. Where frequencies
resolve the velocity, the same holds for its conditional variance, q^2 d h^(2m-3).
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError
from geograph.factors.kinematics import conditional_covariance
from geograph.path import BallisticPath
from geograph.states import CLOCK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.families import SensorFamily
    from geograph.motion import Motion
    from geograph.path import Path
    from geograph.states import SensorStates

NEGLIGIBLE = 0.01
"""Share of the information that interpolation may ignore."""

# Bytes per knot are about this many times the square of its unknowns (blocks, roots, covariances).
_BYTES_PER_SQUARE = 8 * 6
_FEWEST_INTERVALS = 4

CLOSE = 0.1
"""Share of the spacing within which times of emission need no knots of their own."""

# Knots for fewer than four times, at most.
_MOST_OF_FEW = 8


@dataclass(frozen=True)
class Resolution:
    """What the measurements resolve.

    Attributes
    ----------
    count
        Number of measurements.
    span_s
        Time from the first to the last.
    sigma_m
        Typical sigma of one of them, across the line of sight, metres.
    sigma_rad
        Typical angular sigma.
    velocity_rate, clock_rate
        Information about the velocity, 1/((m/s)^2 s), and about the sensors' clocks, 1/s^3, gained
        per second.
    """

    count: int
    span_s: float
    sigma_m: float
    sigma_rad: float
    velocity_rate: float = 0.0
    clock_rate: float = 0.0

    @property
    def rate(self) -> float:
        """Information about the position gained per second, 1/(m^2 s)."""
        return self.count / (self.span_s * self.sigma_m**2)


def ignored_share(motion: Motion, spacing_s: float, resolution: Resolution) -> float:
    """Return the conditional variance of an interval times the information of its measurements."""
    if motion.static:
        return 0.0
    return sum(_ignored_shares(motion, spacing_s, resolution))


def _ignored_shares(motion: Motion, spacing_s: float, resolution: Resolution) -> list[float]:
    """Return the shares of position and velocity; they grow with h^(2m) and h^(2m-2)."""
    unit = conditional_covariance(motion.order, np.array(1.0), np.array(0.5))
    rates = [resolution.rate, resolution.velocity_rate][: motion.order]
    scale = motion.density.largest**2
    return [
        scale * float(unit[i, i]) * spacing_s ** (2 * (motion.order - i)) * rate
        for i, rate in enumerate(rates)
    ]


def automatic_spacing(
    motion: Motion, states: SensorStates, resolution: Resolution, *, ends: bool = True
) -> float:
    """Return the widest spacing at which interpolation is negligible, seconds.

    Parameters
    ----------
    motion, states, resolution
        What moves, and what is measured of it.
    ends
        Whether the measurements are all there will be: then there are some intervals at least.
    """
    spacing = resolution.span_s / _FEWEST_INTERVALS if ends else float("inf")
    shares = [] if motion.static else _ignored_shares(motion, 1.0, resolution)
    for i, share in enumerate(shares):
        if share > 0.0:
            spacing = min(spacing, (NEGLIGIBLE / share) ** (0.5 / (motion.order - i)))
    for walk in states.walks:
        # A walk interpolated linearly misses a Brownian bridge of variance D^2 h / 4.
        angle_rate = resolution.count / (resolution.span_s * resolution.sigma_rad**2)
        rate = resolution.clock_rate if walk.channel == CLOCK else angle_rate
        if rate > 0.0:
            widest = float(np.sqrt(4.0 * NEGLIGIBLE / rate)) / walk.diffusion
            spacing = min(spacing, widest)
    for platform in states.platforms:
        # The platform's own deviation between knots against its fixes.
        inside = np.median(np.diff(platform.time_s)) * platform.sigma_m**2
        share = platform.process_noise**2 * float(
            conditional_covariance(2, np.array(1.0), np.array(0.5))[0, 0]
        )
        if share > 0.0:
            spacing = min(spacing, float((NEGLIGIBLE * inside / share) ** 0.25))
    if motion.ballistic:
        spacing = min(spacing, BallisticPath.LONGEST_STEP_S)
    return spacing


def add_path_noise(
    family: SensorFamily,
    motion: Motion,
    path: Path,
    times_s: NDArray[np.float64],
    noise_times: NDArray[np.float64] | None = None,
) -> None:
    """Make noise to the sensors of what the path does between knots that are wide apart.

    Parameters
    ----------
    family
        Changed in place.
    motion, path
        Of the object.
    times_s
        Shape (n,): of emission.
    noise_times
        Shape (K - 1,): multiples of the motion's noise in every interval, or None.
    """
    place = path.locate(times_s)
    between = conditional_covariance(motion.order, place.step_s, place.offset_s)
    times = 1.0 if noise_times is None else noise_times[place.interval]
    largest = motion.density.largest * times
    family.path_noise_m = largest * np.sqrt(between[:, 0, 0])
    if motion.order > 1:
        family.path_noise_m_s = largest * np.sqrt(between[:, 1, 1])


def place_knots(
    times_s: NDArray[np.float64],
    spacing_s: float,
    *,
    automatic: bool,
    longest_s: float = float("inf"),
) -> NDArray[np.float64]:
    """Return knots, shape (K,), that cover the emission times.

    They are evenly spaced, unless an automatic spacing asks for more knots than there are distinct
    times: then they are at those times, where nothing needs interpolation, or a few where there are
    less than four times.

    Parameters
    ----------
    times_s
        Shape (n,): emission times.
    spacing_s
        Largest time between knots.
    automatic
        Whether the spacing was chosen here rather than by the user.
    longest_s
        Longest interval that may stand between two knots: more are put into gaps.
    """
    low, high = float(times_s.min()), float(times_s.max())
    if not high > low:
        high = low + 1.0
    count = int(np.ceil((high - low) / spacing_s - 1e-9)) + 1
    distinct = np.unique(times_s)
    if automatic and 4 <= distinct.size < count:
        knots = _apart(distinct, CLOSE * spacing_s)
        if knots.size >= 4:
            return _without_gaps(knots, longest_s)
    if automatic and distinct.size < 4:
        # So few times say nothing of what a noise, be it found or given, does between them.
        gaps = int(np.ceil((high - low) / longest_s - 1e-9)) + 1
        count = min(count, max(_MOST_OF_FEW, gaps))
    return np.linspace(low, high, max(count, 2))


def thinned(
    knots_s: NDArray[np.float64], spacing_s: float, longest_s: float
) -> NDArray[np.float64]:
    """Return knots without those that stand too near to the one before.

    Parameters
    ----------
    knots_s
        Shape (K,), growing, at least two; the first and the last are kept.
    spacing_s
        What is near is told by this time between knots.
    longest_s
        Longest interval that may stand between two knots.
    """
    kept = _apart(knots_s, CLOSE * spacing_s)
    return _without_gaps(kept if kept.size > 1 else knots_s[[0, -1]], longest_s)


def _without_gaps(knots_s: NDArray[np.float64], longest_s: float) -> NDArray[np.float64]:
    """Return knots with evenly spaced ones put into the intervals that are too long."""
    parts = np.ceil(np.diff(knots_s) / longest_s - 1e-9).astype(np.int64)
    if not (parts > 1).any():
        return knots_s
    interval = np.repeat(np.arange(parts.size), np.maximum(parts, 1))
    first = np.concatenate([[0], np.cumsum(np.maximum(parts, 1))[:-1]])
    share = (np.arange(interval.size) - first[interval]) / np.maximum(parts, 1)[interval]
    inner = knots_s[interval] + share * np.diff(knots_s)[interval]
    return np.append(inner, knots_s[-1])


def _apart(times_s: NDArray[np.float64], least_s: float) -> NDArray[np.float64]:
    """Return those of growing times that are farther apart, first and last among them.

    Times that are close for the spacing share a knot, which is then as good as at both. Two knots
    that only rounding sets apart would leave an interval in which nothing can be told.
    """
    kept = [float(times_s[0])]
    for time in times_s.tolist():
        if time - kept[-1] > least_s:
            kept.append(time)
    if len(kept) > 1:
        kept[-1] = float(times_s[-1])
    return np.array(kept)


def check_memory(knots: float, unknowns: int, spacing_s: float) -> None:
    """Refuse a number of knots that would not fit into this machine's memory.

    Parameters
    ----------
    knots
        How many.
    unknowns
        Columns of one interval's block.
    spacing_s
        For the message.

    Raises
    ------
    InputError
        If they would take more than half of the physical memory.
    """
    available = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    per_knot = _BYTES_PER_SQUARE * unknowns**2
    if knots * per_knot > 0.5 * available:
        raise InputError(
            f"a spacing of {spacing_s:.3g} s gives {knots:.3g} knots, which need "
            f"{knots * per_knot / 2**30:.3g} GiB of {available / 2**30:.3g} GiB; expected at most "
            f"{0.5 * available / per_knot:.3g} knots: widen spacing_s or split the recording",
            column="spacing_s",
        )
