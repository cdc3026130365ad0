"""The forces that a recording's settings name, and what was found out about them."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError
from geograph.factors.forces import Forces
from geograph.states import RECORDING_NAME
from geograph.track import SensorEstimate

if TYPE_CHECKING:
    from datetime import datetime
    from pathlib import Path

    from numpy.typing import NDArray

    from geograph.motion import Motion
    from geograph.recording import Recording, SmoothSettings
    from geograph.third_bodies import ThirdBodies


def forces_of(recording: Recording, settings: SmoothSettings) -> Forces | None:
    """Return the forces beside gravity that settings ask for; None: there are none.

    Parameters
    ----------
    recording
        For its frame and epoch.
    settings
        With the forces.

    Raises
    ------
    InputError
        If the frame is not ECEF, or astropy, which knows where Moon and Sun are, is missing.
    """
    asked = settings.forces
    if not asked:
        return None
    if recording.frame != "ecef":
        raise InputError(
            f"{asked[0]} needs the frame ecef, which knows the Earth; given {recording.frame}",
            path=recording.path,
        )
    names = tuple(name for name in ("moon", "sun") if getattr(settings, name))
    return _made(recording.epoch, recording.path, names, settings)


@lru_cache(maxsize=8)
def _made(
    epoch: datetime | None, place: Path | None, names: tuple[str, ...], settings: SmoothSettings
) -> Forces:
    bodies: ThirdBodies | None = None
    masses: tuple[float, ...] = ()
    if names and epoch is not None:
        from geograph.third_bodies import BODIES, ThirdBodies

        bodies = ThirdBodies(epoch, names, place)
        masses = tuple(BODIES[name] for name in names)
    elif names:
        raise InputError(f"{names[0]} needs an epoch; expected one in the recording", path=place)
    return Forces(
        gm_m3_s2=masses,
        bodies_m=bodies,
        drag_m2_kg=settings.drag_m2_kg or 0.0,
        drag_sigma_m2_kg=settings.drag_sigma_m2_kg or 0.0,
        acceleration_sigma_m_s2=settings.acceleration_sigma_m_s2 or 0.0,
        axes=settings.acceleration_axes,
    )


def force_estimates(
    motion: Motion,
    state: NDArray[np.float64],
    covariance: NDArray[np.float64],
    scale: NDArray[np.float64],
) -> dict[str, dict[str, SensorEstimate]]:
    """Return what is known of the forces' unknowns, as errors of the recording as a whole.

    Parameters
    ----------
    motion
        With the forces.
    state
        Shape (size,): of the last knot, SI.
    covariance
        Shape (d, d), d at least the size: of the same, scaled.
    scale
        Shape (size,).
    """
    forces = motion.forces
    if forces is None or not forces.names:
        return {}
    first = 3 * motion.order
    sigma = np.sqrt(np.diagonal(covariance))[first : motion.size] * scale[first:]
    rows = zip(
        forces.names, forces.units, state[first:].tolist(), sigma.tolist(), forces.sigma.tolist(),
        strict=True,
    )  # fmt: skip
    return {RECORDING_NAME: {name: SensorEstimate(*values) for name, *values in rows}}
