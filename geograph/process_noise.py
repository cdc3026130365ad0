"""Process noise where none is given: a first guess, and how little is nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from geograph.initialise import PathFit
    from geograph.knots import Resolution


def guess_noise(fit: PathFit, order: int, resolution: Resolution) -> float:
    """Return a process noise from how much a fit's highest derivative changes over the pass.

    A random walk of density q^2 has the variance q^2 T after the time T.

    Parameters
    ----------
    fit
        A path through the measurements.
    order
        Blocks of the motion's state; the noise drives the last one.
    resolution
        What the measurements resolve.

    Returns
    -------
    noise
        Square root of the spectral density, SI; at least :func:`least_noise`.
    """
    low, high = float(fit.spline.t[0]), float(fit.spline.t[-1])
    state = fit.state(np.linspace(low, high, 41), order)[:, -3:]
    change = float(np.sqrt(np.mean(np.var(state, axis=0))))
    return max(change / float(np.sqrt(resolution.span_s)), least_noise(order, resolution))


def least_noise(order: int, resolution: Resolution) -> float:
    """Return a process noise too small to matter: it adds a hundredth of a sigma over the pass.

    Parameters
    ----------
    order
        Blocks of the motion's state.
    resolution
        What the measurements resolve.
    """
    best = resolution.sigma_m / np.sqrt(resolution.count)
    return float(1e-2 * best / resolution.span_s ** (order - 0.5))
