"""Where the knots are: how close, and whether what lies between them matters.

Between two knots the path deviates from its interpolation by the prior's conditional variance. The
spacing is chosen so that this variance, added up over the information of an interval's
measurements, stays below one percent:

    q^2 c h^(2m-1) (n h / T) / sigma^2 <= 0.01,

with the density q^2, the order m, c the conditional variance in the middle of a unit interval, n
measurements in the time T, and sigma the median of angular sigma times distance.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError
from geograph.factors.kinematics import conditional_covariance
from geograph.path import BallisticPath

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.motion import Motion
    from geograph.states import SensorStates

NEGLIGIBLE = 0.01
"""Share of the information that interpolation may ignore."""

# Bytes per knot are about this many times the square of its unknowns (blocks, roots, covariances).
_BYTES_PER_SQUARE = 8 * 6
_FEWEST_INTERVALS = 4


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
    """

    count: int
    span_s: float
    sigma_m: float
    sigma_rad: float

    @property
    def rate(self) -> float:
        """Information about the position gained per second, 1/(m^2 s)."""
        return self.count / (self.span_s * self.sigma_m**2)


def ignored_share(motion: Motion, spacing_s: float, resolution: Resolution) -> float:
    """Return the conditional variance of an interval times the information of its measurements."""
    if motion.static:
        return 0.0
    unit = float(conditional_covariance(motion.order, np.array(1.0), np.array(0.5))[0, 0])
    variance = motion.density.largest**2 * unit * spacing_s ** (2 * motion.order - 1)
    return variance * resolution.rate * spacing_s


def automatic_spacing(motion: Motion, states: SensorStates, resolution: Resolution) -> float:
    """Return the widest spacing at which interpolation is negligible, seconds."""
    spacing = resolution.span_s / _FEWEST_INTERVALS
    share = ignored_share(motion, 1.0, resolution)
    if share > 0.0:
        spacing = min(spacing, (NEGLIGIBLE / share) ** (1.0 / (2 * motion.order)))
    if states.diffusion.size:
        # A walk interpolated linearly misses a Brownian bridge of variance D^2 h / 4.
        largest = float(states.diffusion.max())
        rate = resolution.count / (resolution.span_s * resolution.sigma_rad**2)
        spacing = min(spacing, float(np.sqrt(4.0 * NEGLIGIBLE / (largest**2 * rate))))
    if motion.ballistic:
        spacing = min(spacing, BallisticPath.LONGEST_STEP_S)
    return spacing


def place_knots(
    times_s: NDArray[np.float64], spacing_s: float, *, automatic: bool
) -> NDArray[np.float64]:
    """Return knots, shape (K,), that cover the emission times.

    They are evenly spaced, unless an automatic spacing asks for more knots than there are distinct
    times: then they are at those times, where nothing needs interpolation.

    Parameters
    ----------
    times_s
        Shape (n,): emission times.
    spacing_s
        Largest time between knots.
    automatic
        Whether the spacing was chosen here rather than by the user.
    """
    low, high = float(times_s.min()), float(times_s.max())
    if not high > low:
        high = low + 1.0
    count = int(np.ceil((high - low) / spacing_s - 1e-9)) + 1
    distinct = np.unique(times_s)
    if automatic and 4 <= distinct.size < count:
        gaps = np.diff(distinct)
        # Times closer than a thousandth of the typical gap share a knot.
        keep = np.concatenate([[True], gaps > 1e-3 * np.median(gaps)])
        keep[-1] = True
        if keep.sum() >= 4:
            return np.asarray(distinct[keep])
    return np.linspace(low, high, max(count, 2))


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
