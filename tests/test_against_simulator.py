"""Bearings that the independent simulator made, explained by the truth alone.

The simulator and the measurement families share no equation. With the true path and the true errors
of the sensors put in, what remains must be the simulated noise: 1 nrad, a millimetre at 1000 km. A
wrong sign, axis, order of light time and clock, or a term left out is orders of magnitude more.
"""

import numpy as np
import pytest
from scipy.stats import chi2

from geograph.families import BearingFamily, Values
from geograph.motion import Density, Motion
from geograph.prepare import prepare
from geograph.scenarios.ground import GroundPass, ground_world
from geograph.scenarios.low_orbit import LowOrbit, low_orbit_world
from geograph.scenarios.sound import Room, room_world
from geograph.states import CLOCK

SIGMA = 1e-9
# Cubic Hermite pieces of 0.25 s through positions and velocities are good to a nanometre in orbit.
STEP = 0.25

WORLDS = {
    "satellites see a satellite": lambda: low_orbit_world(
        1, LowOrbit(path="two-body", sigma_rad=SIGMA, instability_rad_sqrt_s=0.0, bearings=60)
    ),
    "stations see a satellite, angles drift": lambda: low_orbit_world(
        2,
        LowOrbit(
            path="two-body", platform="ground", sigma_rad=SIGMA, drift_rad_s=1e-5,
            instability_rad_sqrt_s=0.0, bearings=60,
        ),
    ),
    "clocks are wrong and drift": lambda: low_orbit_world(
        3,
        LowOrbit(
            path="two-body", platform="mixed", sigma_rad=SIGMA, drift_rad_s=0.0,
            instability_rad_sqrt_s=0.0, clock_offset_s=2.0, clock_drift_s_s=1e-3, bearings=60,
        ),
    ),
    "noise of the coordinates": lambda: low_orbit_world(
        4,
        LowOrbit(
            path="two-body", platform="ground", sigma_rad=SIGMA, per_coordinate=True,
            instability_rad_sqrt_s=0.0, bearings=60,
        ),
    ),
    "cameras see a fireball": lambda: ground_world(
        5, GroundPass(path="straight", sigma_rad=SIGMA, clock_offset_s=1.0, bearings=60)
    ),
    "arrays hear a walker": lambda: room_world(
        6, Room(order=2, process_noise=(1e-9, 1e-9, 1e-9), sigma_rad=SIGMA, clock_offset_s=0.3)
    ),
}  # fmt: skip


def true_constants(prepared, world):
    """Return the true errors in the library's terms: functions of the time tag, not of the truth.

    With tag = t + a + d (t - t0), the clock's error is a' + d' (tag - tag0) with
    d' = d / (1 + d) and a' = a + d' (tag0 - a - t0).
    """
    states = prepared.states
    tag0, t0 = states.reference_s, float(world.reception_time_s.min())
    values = np.zeros(states.size)
    for column, state in enumerate(states.constants):
        errors = world.errors[prepared.sensors[state.sensor].name]
        if state.channel == CLOCK:
            drift = errors.clock_drift_s_s / (1.0 + errors.clock_drift_s_s)
            offset = errors.clock_offset_s + drift * (tag0 - errors.clock_offset_s - t0)
            value = drift if state.drift else offset
        else:
            angle = ("azimuth", "elevation")[state.channel]
            value = getattr(errors, f"{angle}_drift_rad_s" if state.drift else f"{angle}_bias_rad")
        values[column] = value / state.sigma
    return values


@pytest.mark.parametrize("name", WORLDS)
def test_the_truth_leaves_only_the_noise(name):
    world = WORLDS[name]()
    prepared = prepare(world.recording)
    low, high = world.emission_time_s.min(), world.emission_time_s.max()
    knots = np.linspace(low, high, int((high - low) / STEP) + 2)
    state = np.concatenate([world.path.position_at(knots), world.path.velocity_at(knots)], axis=1)
    path = Motion("constant-velocity", Density.of(1.0), world.recording.frame).path(knots)
    family = prepared.families(knots)[0]
    assert isinstance(family, BearingFamily)
    values = Values(state, np.zeros((knots.size, 0)), true_constants(prepared, world))
    found = family.evaluate(path, path.at_state(state), values, jacobian=False)
    square = float(np.sum(found.residual**2))
    low, high = chi2.interval(1 - 1e-6, found.residual.size)
    assert low < square < high
    # And the times of emission are those that the simulator solved for.
    _, _, emitted = family.predicted(path, values)
    np.testing.assert_allclose(emitted, world.emission_time_s, rtol=0.0, atol=2e-6)
