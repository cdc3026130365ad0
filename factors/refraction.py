"""Mean refraction of the atmosphere, for objects above it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def refraction(apparent_elevation_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return by how much the air lifts an object at an apparent elevation, radians.

    R = cot(h + 7.31 / (h + 4.4)) arcminutes with h in degrees, for 1010 hPa and 10 degrees C
    (G. G. Bennett, *The calculation of astronomical refraction in marine navigation*, Journal of
    Navigation 35, 1982); within 0.1 arcminute above the horizon. Below it the value at the horizon
    is kept, and none is applied to missing elevations (NaN).

    Parameters
    ----------
    apparent_elevation_rad
        Measured elevations, any shape.
    """
    elevation = np.degrees(np.clip(apparent_elevation_rad, 0.0, np.pi / 2))
    argument = np.radians(elevation + 7.31 / (elevation + 4.4))
    # The formula crosses zero just below the zenith.
    return np.asarray(np.radians(np.maximum(1.0 / np.tan(argument), 0.0) / 60.0))
