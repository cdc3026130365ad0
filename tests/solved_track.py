"""Tracks of simulated recordings of arrivals and differences, solved from the true path.

For tests of what comes after the smoother: it is not the first guess that they are about.
"""

from __future__ import annotations

from functools import cache
from unittest import mock

import numpy as np
from scipy.interpolate import make_interp_spline

import geograph as gg
from geograph import results
from geograph.initialise import PathFit
from geograph.scenarios.moving_sensors import VARIANTS, recordings
from geograph.scenarios.radio_aircraft import multilateration
from geograph.scenarios.radio_orbit import formation
from geograph.scenarios.radio_platforms import platforms
from geograph.scenarios.sound import microphones

RECORDINGS = {
    "far emitter": lambda: next(recordings(VARIANTS["emitter-1-1ns"], [1])),
    "straight platforms": lambda: next(recordings(VARIANTS["emitter-1-straight-1.5m"], [1])),
    "platforms": lambda: platforms(
        1, sigma_hz=1.0, position_noise_m=2.0, position_m=1.0, platform_process_noise=0.1
    ),
    "aircraft": lambda: multilateration(
        4, receivers=5, clock_drift_s_s=1e-9, clock_instability_s_sqrt_s=5e-9
    ),
    "microphones": lambda: microphones(
        2, clock_offset_s=1e-3, position_m=0.05, propagation_sigma_m_s=2.0
    ),
    "flat microphones": lambda: microphones(
        2, heard="pairs", tone_hz=2000.0, frequency_offset_hz=0.3, flat=True
    ),
    "satellites": lambda: formation(
        1, frequency_offset_hz=2.0, frequency_drift_hz_s=0.01, clock_offset_s=1e-7
    ),
}


def solved(recording):
    """Return the track of a recording, found from its true path."""
    truth = recording.truth
    places = np.array([s.position_at(truth.time_s[0]) for s in recording.sensors.values()])
    fit = PathFit(
        spline=make_interp_spline(truth.time_s, truth.position_m, k=3),
        clock_s=np.zeros(len(places)),
        score=0.0,
        range_m=float(np.median(np.linalg.norm(places - truth.position_m[0], axis=1))),
        behind=0.0,
    )
    with mock.patch("geograph.smoother.first_fits", return_value=[fit]):
        return gg.smooth(recording)


@cache
def track(name):
    """Return the track of one of :data:`RECORDINGS`; it is not to be changed."""
    return solved(RECORDINGS[name]())


@cache
def of(name):
    """Return the results of one of :data:`RECORDINGS`; they are not to be changed."""
    return results.from_track(track(name))
