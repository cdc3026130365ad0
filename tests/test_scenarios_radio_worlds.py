"""Worlds of arrivals and differences: reproducible, and where they say they are.

A chi-square band is one that a right simulator leaves once in a million seeds; the seeds are fixed.
"""

import numpy as np
import pytest
from scipy.stats import chi2

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.scenarios.places import geodetic
from geograph.scenarios.radio_aircraft import Multilateration, multilateration_world
from geograph.scenarios.radio_degenerate import DEGENERATE, degenerate_world, other_root
from geograph.scenarios.radio_indoor import Indoor, indoor_world
from geograph.scenarios.radio_mixed import Mixed, mixed_world
from geograph.scenarios.radio_orbit import Formation, formation_world
from geograph.scenarios.radio_paths import Leg, earth_fixed, flight_of_legs
from geograph.scenarios.radio_plans import FrequencyPlan, TimePlan
from geograph.scenarios.radio_platforms import Platforms, platforms_world
from geograph.scenarios.sound import SPEED_OF_SOUND_M_S, Microphones, microphones_world

TAIL = 5e-7

WORLDS = {
    "aircraft": lambda s: multilateration_world(s, Multilateration(outliers=5)),
    "formation": formation_world,
    "ship": lambda s: formation_world(s, Formation(satellites=3, emitter="ship")),
    "platforms": lambda s: platforms_world(
        s, Platforms(emitter_m_s=(50.0, 20.0), sigma_hz=1.0, platform_process_noise=0.1,
                     position_noise_m=0.5)
    ),
    "mixed": mixed_world,
    "indoor": lambda s: indoor_world(s, Indoor(flat=True)),
    "microphones": lambda s: microphones_world(s, Microphones(propagation_sigma_m_s=2.0)),
    "two arrivals": lambda s: degenerate_world("two-arrivals", s),
}  # fmt: skip


def inside(statistic, count):
    low, high = chi2.ppf([TAIL, 1.0 - TAIL], count)
    assert low < statistic < high


def arrays(recording):
    found = []
    for table in [*recording.tables.values(), recording.constraints, recording.truth]:
        columns = {} if table is None else vars(table)
        found += [column for column in columns.values() if isinstance(column, np.ndarray)]
    for sensor in recording.sensors.values():
        found.append(sensor.position_m if sensor.trajectory is None else sensor.position_at(1.0))
    return found


@pytest.mark.parametrize("name", WORLDS)
def test_a_seed_gives_one_recording_bit_for_bit(name):
    first, again, other = (arrays(WORLDS[name](seed).recording) for seed in (3, 3, 4))
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, two)
    assert any(
        one.shape != two.shape or not np.array_equal(one, two)
        for one, two in zip(first, other, strict=True)
    )


@pytest.mark.parametrize("name", WORLDS)
def test_the_truth_covers_the_recording(name):
    world = WORLDS[name](5)
    truth, (start, end) = world.recording.truth, world.recording.time_span_s
    emitted = np.concatenate([rows.emission_time_s for rows in world.rows.values()])
    assert truth.time_s[0] < min(start, emitted.min())
    assert truth.time_s[-1] > max(end, emitted.max())
    np.testing.assert_array_equal(truth.position_m, world.path.position_at(truth.time_s))
    for sensor in world.recording.sensors.values():
        if sensor.trajectory is not None:
            assert sensor.trajectory.time_s[0] < start
            assert sensor.trajectory.time_s[-1] > end


def test_flights_of_legs_are_arcs_and_lines():
    legs = (Leg(duration_s=30.0), Leg(duration_s=30.0, turn_deg_s=3.0), Leg(duration_s=9.95))
    time, state = flight_of_legs(legs, start_s=-2.0, speed_m_s=200.0, heading_deg=90.0)
    assert time[0] == -2.0
    assert time[-1] == pytest.approx(67.95)
    assert (np.diff(time) > 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(state[:, 1], axis=1), 200.0)
    # Eastwards for 6 km, then a right turn about a centre to the south, to the south.
    radius = 200.0 / np.radians(3.0)
    at = np.searchsorted(time, 28.0 + 15.0 - 1e-9)
    half = np.array([np.sin(np.pi / 4), np.cos(np.pi / 4) - 1.0, 0.0])
    np.testing.assert_allclose(state[at, 0], [6e3, 0.0, 0.0] + radius * half, atol=1e-6)
    end = [6e3 + radius, -radius - 200.0 * 9.95, 0.0]
    np.testing.assert_allclose(state[-1, 0], end, atol=1e-6)
    climb = flight_of_legs(
        (Leg(duration_s=10.0, climb_m_s=5.0),), start_s=0.0, speed_m_s=100.0, heading_deg=0.0
    )
    np.testing.assert_allclose(climb[1][-1], [[0.0, 1e3, 50.0], [0.0, 100.0, 5.0]], atol=1e-9)


def test_states_are_turned_with_their_axes():
    origin = np.array([6378137.0, 0.0, 0.0])
    state = np.array([[[1.0, 2.0, 3.0], [10.0, 20.0, 30.0]]])
    np.testing.assert_allclose(
        earth_fixed(origin, state)[0], [[6378140.0, 1.0, 2.0], [30.0, 10.0, 20.0]], atol=1e-6
    )


@pytest.mark.parametrize("path", ["prior", "straight", "turns", "climb"])
def test_aircraft_fly_among_their_receivers(path):
    world = multilateration_world(14, Multilateration(path=path, receivers=8))
    truth = world.recording.truth
    speed = np.linalg.norm(truth.velocity_m_s, axis=1)
    assert 150.0 < speed.min() <= speed.max() < 300.0
    height = np.array([geodetic(place)[2] for place in truth.position_m])
    assert 5e3 < height.min() < height.max() < 15e3
    rows = world.rows["arrivals"]
    distance = SPEED_OF_LIGHT_M_S * (rows.exact - rows.emission_time_s)
    assert 5e3 < distance.min() < distance.max() < 160e3


@pytest.mark.parametrize("seed", range(5))
def test_satellites_see_the_emitter_throughout(seed):
    world = formation_world(seed, Formation(satellites=3))
    time = np.linspace(0.0, 240.0, 25)
    place = world.path.position_at(0.0)
    up = place / np.linalg.norm(place)
    for receiver in world.receivers:
        line = receiver.body.position_at(time) - place
        elevation = np.arcsin(line @ up / np.linalg.norm(line, axis=1))
        assert np.degrees(elevation).min() > 5.0


def test_sound_is_slow_enough_to_matter():
    world = microphones_world(15, Microphones(flat=True, microphone_m_s=10.0))
    rows = world.rows["arrivals"]
    delay = rows.exact - rows.emission_time_s
    assert delay.max() > 0.2
    speed = np.linalg.norm(world.recording.truth.velocity_m_s, axis=1)
    assert speed.max() / SPEED_OF_SOUND_M_S > 0.08
    assert np.abs(world.recording.truth.position_m[:, 2]).max() == 0.0


@pytest.mark.parametrize("case", DEGENERATE)
def test_degenerate_worlds_are_heard(case):
    world = degenerate_world(case)
    arrivals, rows = world.recording.arrivals, world.rows["arrivals"]
    places = np.stack([s.position_m for s in world.recording.sensors.values()])[arrivals.sensor]
    distance = np.linalg.norm(places - world.path.position_at(0.0), axis=1)
    np.testing.assert_allclose(rows.exact - rows.emission_time_s, distance / SPEED_OF_LIGHT_M_S,
                               atol=1e-14)  # fmt: skip
    inside(np.sum(((arrivals.toa_s - rows.exact) / 10e-9) ** 2), len(arrivals))


def test_the_hyperbolas_of_three_receivers_meet_twice():
    world = degenerate_world("three-flat")
    places = np.stack([s.position_m[:2] for s in world.recording.sensors.values()])
    one, other = world.path.position_at(0.0)[:2], np.array(other_root())
    assert np.linalg.norm(one - other) > 500.0
    differences = [np.diff(np.linalg.norm(place - places, axis=1)) for place in (one, other)]
    np.testing.assert_allclose(*differences, atol=1e-6)
    with pytest.raises(RuntimeError, match="no other root near"):
        other_root((0.0, -5e3))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Multilateration(path="bent"), "path 'bent'; expected one of prior"),
        (lambda: Formation(emitter="whale"), "emitter 'whale'; expected one of static"),
        (lambda: Formation(satellites=4), "4 satellites; expected 2 or 3"),
        (lambda: Mixed(target="duck"), "target 'duck'; expected one of drone"),
        (lambda: Indoor(anchors=9), "9 anchors; expected 3 to 8"),
        (lambda: Microphones(heard="echoes"), "heard 'echoes'; expected one of arrivals"),
        (lambda: degenerate_world("none"), "case 'none'; expected one of two-receivers"),
        (
            lambda: TimePlan(emission_time_s=np.arange(3.0), pairs=((1, 0), (2, 1)), sigma_s=1.0),
            "share noise beyond that of a reference",
        ),
        (
            lambda: FrequencyPlan(
                emission_time_s=np.arange(3.0), pairs=((1, 0), (1, 2)), carrier_hz=1.0, sigma_hz=1.0
            ),
            "share noise beyond that of a reference",
        ),
    ],
)
def test_what_is_not_simulated_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
