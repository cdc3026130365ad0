"""Units that people read: values are SI inside and are divided by a unit's size at the edge."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np


class Unit(NamedTuple):
    """A unit to show values in: divide SI values by ``size``."""

    name: str
    size: float


_ARCSECOND = math.pi / 648000.0
_UNITS: dict[str, tuple[Unit, ...]] = {
    "rad": (
        Unit("µrad", 1e-6),
        Unit("arcsec", _ARCSECOND),
        Unit("arcmin", 60.0 * _ARCSECOND),
        Unit("deg", 3600.0 * _ARCSECOND),
    ),
    "rad/s": (
        Unit("µrad/s", 1e-6),
        Unit("arcsec/s", _ARCSECOND),
        Unit("arcmin/s", 60.0 * _ARCSECOND),
        Unit("deg/s", 3600.0 * _ARCSECOND),
    ),
    "s": (Unit("ps", 1e-12), Unit("ns", 1e-9), Unit("µs", 1e-6), Unit("ms", 1e-3), Unit("s", 1.0)),
    "s/s": (Unit("ppb", 1e-9), Unit("ppm", 1e-6), Unit("s/s", 1.0)),
    "m": (Unit("mm", 1e-3), Unit("m", 1.0), Unit("km", 1e3)),
    "m/s": (Unit("mm/s", 1e-3), Unit("m/s", 1.0), Unit("km/s", 1e3)),
    "Hz": (
        Unit("mHz", 1e-3),
        Unit("Hz", 1.0),
        Unit("kHz", 1e3),
        Unit("MHz", 1e6),
        Unit("GHz", 1e9),
    ),
    "Hz/s": (Unit("mHz/s", 1e-3), Unit("Hz/s", 1.0), Unit("kHz/s", 1e3)),
}


def fitting_unit(si_unit: str, *values: Any) -> Unit:
    """Return the greatest unit in which the greatest of the finite values is at least two."""
    units = _UNITS.get(si_unit, (Unit(si_unit, 1.0),))
    flat = np.concatenate([np.ravel(np.asarray(value, dtype=np.float64)) for value in values])
    flat = np.abs(flat[np.isfinite(flat)])
    largest = float(flat.max()) if flat.size else 0.0
    if largest == 0.0:
        return units[-1]
    fitting = [unit for unit in units if largest >= 2.0 * unit.size]
    return fitting[-1] if fitting else units[0]
