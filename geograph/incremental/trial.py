"""Measurements tried once before there is a path: one that cannot be evaluated is known at once.

Until its start the smoother only collects. A measurement whose equation raises would be found at
the start alone, when others have long been accepted, and the newest of these would be blamed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError
from geograph.families import Values
from geograph.incremental.rows import TABLES
from geograph.incremental.start import recording_of
from geograph.motion import Density, Motion
from geograph.prepare import prepare

if TYPE_CHECKING:
    from geograph.incremental.rows import Rows
    from geograph.recording import Recording

# An object somewhere: metres from a sensor, off every axis.
_AWAY_M = (1100.0, 1700.0, 2300.0)


def try_rows(template: Recording, rows: Rows) -> None:
    """Evaluate measurements, with derivatives, for an object that stands near the sensors.

    Parameters
    ----------
    template
        Recording without measurements.
    rows
        New ones; constraints among them are not tried, for they may ask for a place that exists.

    Raises
    ------
    Exception
        What the equation of a measurement raised, whatever it is. Values that are not finite are
        no reason: the object is not where it was measured.
    """
    tables = {kind: columns for kind, columns in rows.items() if kind in TABLES}
    if not tables:
        return
    try:
        prepared = prepare(recording_of(template, tables, {}))
    except InputError:
        # About several rows, or sensors: the start says it, with all that was collected.
        return
    families = prepared.sensor_families()
    times = np.concatenate([family.time_s for family in families])
    knots = np.array([times.min() - 1.0, times.max() + 1.0])
    path = Motion("constant-velocity", Density.of(1.0), template.frame).path(knots)
    states = prepared.states
    first = families[0].sensor[:1]
    at = prepared.geometry.poses(first, families[0].time_s[:1]).position_m[0] + _AWAY_M
    values = Values(
        np.repeat([[*at, 0.0, 0.0, 0.0]], 2, axis=0),
        np.zeros((2, states.chains)),
        np.zeros(states.size),
    )
    with np.errstate(all="ignore"):
        state = path.at_state(values.path, jacobian=True)
        for family in families:
            family.evaluate(path, state, values, jacobian=True)
