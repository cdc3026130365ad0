"""Worlds of arrivals and differences: reproducible, signed as promised, as wrong as they say.

Statistics are two-sided chi-square bands that a right simulator leaves once in a million seeds; the
seeds are fixed.
"""

import dataclasses

import numpy as np
import pytest
from scipy.stats import binom, chi2

from geograph.recording import SmoothSettings
from geograph.scenarios.paths import StraightBody
from geograph.scenarios.places import geodetic
from geograph.scenarios.radio import Receiver, fixed_receivers, make_radio_world
from geograph.scenarios.radio_aircraft import Multilateration, multilateration_world
from geograph.scenarios.radio_degenerate import degenerate_world
from geograph.scenarios.radio_mixed import Mixed, mixed_world
from geograph.scenarios.radio_orbit import Formation, formation_world
from geograph.scenarios.radio_plans import ArrivalPlan, FrequencyPlan, TimePlan
from geograph.scenarios.radio_platforms import Platforms, platforms_world
from geograph.scenarios.sound import Microphones, microphones_world
from geograph.scenarios.worlds import Streams, truth_table
from geograph.sensors import SensorErrors

TAIL = 5e-7


def inside(statistic, count):
    low, high = chi2.ppf([TAIL, 1.0 - TAIL], count)
    assert low < statistic < high


def by_hand(plans, errors, *, noise=0.0):
    """Receivers at x = 0 and x = 600 m hear, at 343 m/s, an object that passes x = 100 m at 0 s."""
    path = StraightBody(np.array([100.0, 0.0, 0.0]), np.array([10.0, 0.0, 0.0]))
    return make_radio_world(
        name="hand",
        path=path,
        receivers=fixed_receivers([np.zeros(3), np.array([600.0, 0.0, 0.0])], errors),
        plans=plans,
        streams=Streams.from_seed(0),
        settings=SmoothSettings(),
        truth=truth_table(path, (-1.0, 20.0), step_s=1.0),
        frame="local",
        propagation_speed_m_s=343.0,
        propagation_sigma_m_s=noise,
    )


TIMES = np.array([0.0, 5.0, 10.0])
NEAR, FAR = (100.0 + 10.0 * TIMES) / 343.0, (500.0 - 10.0 * TIMES) / 343.0
LOOSE = SensorErrors(clock_offset_s=0.5, frequency_offset_hz=3.0, position_m=2.0)


def test_signs_by_hand():
    pairs = ((1, 0),)
    world = by_hand(
        [
            ArrivalPlan(emission_time_s=TIMES, receivers=(0, 1), sigma_s=1e-12),
            TimePlan(emission_time_s=TIMES, pairs=pairs, sigma_s=1e-12),
            FrequencyPlan(emission_time_s=TIMES, pairs=pairs, carrier_hz=1e3, sigma_hz=1e-9),
        ],
        [SensorErrors(clock_offset_s=0.5), LOOSE],
    )
    first, second = world.errors["R1"], world.errors["R2"]
    clock = second.clock_offset_s - first.clock_offset_s
    assert min(abs(first.clock_offset_s), abs(clock), abs(second.frequency_offset_hz)) > 1e-2
    recording = world.recording
    toa = recording.arrivals.toa_s.reshape(3, 2)
    np.testing.assert_allclose(toa[:, 0], TIMES + NEAR + first.clock_offset_s, atol=1e-10)
    np.testing.assert_allclose(toa[:, 1], TIMES + FAR + second.clock_offset_s, atol=1e-10)
    differences = recording.time_differences
    np.testing.assert_allclose(differences.tdoa_s, FAR - NEAR + clock, atol=1e-10)
    np.testing.assert_allclose(differences.time_s, toa[:, 0], atol=1e-10)
    # The object leaves the reference and comes towards the other one.
    shift = 1e3 * (343.0 / (343.0 - 10.0) - 343.0 / (343.0 + 10.0))
    wrong = second.frequency_offset_hz - first.frequency_offset_hz
    fdoa = recording.frequency_differences.fdoa_hz
    np.testing.assert_allclose(fdoa, shift + wrong, atol=1e-6)
    true = recording.sensors["R2"].position_m + second.position_m
    np.testing.assert_allclose(true, [600.0, 0.0, 0.0], atol=1e-12)
    assert np.linalg.norm(second.position_m) > 0.1


def test_drifts_are_counted_from_the_first_reception():
    world = by_hand(
        [ArrivalPlan(emission_time_s=TIMES, receivers=(0, 1), sigma_s=1e-12)],
        [SensorErrors(), SensorErrors(clock_drift_s_s=1e-2)],
    )
    late = (world.recording.arrivals.toa_s - world.rows["arrivals"].exact).reshape(3, 2)
    drift = world.errors["R2"].clock_drift_s_s
    expected = drift * (TIMES + FAR - NEAR[0])
    assert abs(drift) > 1e-4
    np.testing.assert_allclose(late[:, 1], expected, atol=1e-10)
    np.testing.assert_allclose(late[:, 0], 0.0, atol=1e-10)


def test_the_speed_of_the_signal_is_drawn_and_not_told():
    plans = [ArrivalPlan(emission_time_s=TIMES, receivers=(0, 1), sigma_s=1e-12)]
    world = by_hand(plans, [SensorErrors()] * 2, noise=5.0)
    assert abs(world.propagation_speed_m_s - 343.0) > 0.1
    assert world.recording.propagation_speed_m_s == 343.0
    assert world.recording.propagation_sigma_m_s == 5.0
    delay = (world.recording.arrivals.toa_s.reshape(3, 2) - TIMES[:, None]).T
    np.testing.assert_allclose(delay * world.propagation_speed_m_s, [NEAR * 343, FAR * 343])


def test_one_clock_serves_all_tables():
    prior = SensorErrors(clock_instability_s_sqrt_s=1e-2)
    world = by_hand(
        [
            ArrivalPlan(emission_time_s=TIMES, receivers=(0, 1), sigma_s=1e-12),
            TimePlan(emission_time_s=TIMES, pairs=((1, 0),), sigma_s=1e-12),
        ],
        [prior, prior],
    )
    toa = world.recording.arrivals.toa_s.reshape(3, 2)
    differences = world.recording.time_differences
    np.testing.assert_allclose(differences.tdoa_s, toa[:, 1] - toa[:, 0], atol=1e-10)
    np.testing.assert_allclose(differences.time_s, toa[:, 0], atol=1e-10)
    walked = toa - world.rows["arrivals"].exact.reshape(3, 2)
    assert np.abs(np.diff(walked, axis=0)).min() > 1e-5


def test_walks_of_clocks_grow_as_they_should():
    diffusion, total, count = 1e-8, 0.0, 0
    for seed in range(20):
        world = multilateration_world(
            seed,
            Multilateration(
                clock_offset_s=0.0, clock_instability_s_sqrt_s=diffusion, sigma_s=1e-13, hearing=1.0
            ),
        )
        arrivals, rows = world.recording.arrivals, world.rows["arrivals"]
        for index in range(1, 6):
            own = arrivals.sensor == index
            wrong = (arrivals.toa_s - rows.exact)[own]
            step = np.diff(rows.exact[own])
            total += np.sum(np.diff(wrong) ** 2 / (diffusion**2 * step))
            count += step.size
    inside(total, count)


def known_errors(world, label):
    """The drawn constant errors of all rows of a table."""
    table, names = world.recording.tables[label], world.recording.sensor_names
    name = "frequency_offset_hz" if label == "frequency_differences" else "clock_offset_s"
    own = np.array([getattr(world.errors[one], name) for one in names])
    if label == "arrivals":
        return own[table.sensor]
    return own[table.sensor] - own[table.reference]


def test_noise_of_arrivals_is_as_stated():
    sigma = (1e-8, 2e-8, 4e-8, 3e-8, 5e-8, 1e-8)
    kind = dataclasses.replace(Multilateration(emissions=500, duration_s=60.0), sigma_s=sigma)
    world = multilateration_world(7, kind)
    arrivals = world.recording.arrivals
    np.testing.assert_array_equal(arrivals.sigma_s, np.array(sigma)[arrivals.sensor])
    error = arrivals.toa_s - world.rows["arrivals"].exact - known_errors(world, "arrivals")
    inside(np.sum((error / arrivals.sigma_s) ** 2), len(arrivals))
    low, high = binom.ppf([TAIL, 1.0 - TAIL], 3000, 0.9)
    assert low < len(arrivals) < high
    assert np.bincount(arrivals.emission).min() >= 2


@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("label", ["time_differences", "frequency_differences"])
def test_noise_of_differences_has_the_stated_covariance(label, shared):
    kind = Formation(
        satellites=3, measurements=1000, clock_offset_s=1e-6, frequency_offset_hz=5.0, shared=shared
    )
    world = formation_world(8, kind)
    table = world.recording.tables[label]
    measured = table.tdoa_s if label == "time_differences" else table.fdoa_hz
    sigma = table.sigma_s if label == "time_differences" else table.sigma_hz
    common = table.sigma_reference_s if label == "time_differences" else table.sigma_reference_hz
    error = (measured - world.rows[label].exact - known_errors(world, label)).reshape(-1, 2)
    np.testing.assert_allclose(sigma, np.sqrt(2.0) * (1e-7 if "time_d" in label else 0.5))
    np.testing.assert_allclose(common, (sigma / np.sqrt(2.0)) if shared else 0.0)
    # Both differences of one emission: sigma^2 on the diagonal, sigma_reference^2 beside it.
    covariance = np.full((2, 2), common[0] ** 2)
    np.fill_diagonal(covariance, sigma[0] ** 2)
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), error.T)
    inside(np.sum(whitened**2), whitened.size)
    # Nor are they correlated otherwise: the sum of products of unit normals, by its deviation.
    assert abs(whitened[0] @ whitened[1]) < 5.0 * np.sqrt(1000.0)


def test_errors_are_drawn_from_their_priors():
    prior = Formation(
        satellites=3, clock_offset_s=2e-7, clock_drift_s_s=1e-9, frequency_offset_hz=4.0,
        frequency_drift_hz_s=0.1, position_m=20.0, measurements=2,
    )  # fmt: skip
    worlds = [formation_world(seed, prior) for seed in range(150)]
    for name in (
        "clock_offset_s",
        "clock_drift_s_s",
        "frequency_offset_hz",
        "frequency_drift_hz_s",
    ):
        drawn = [getattr(world.errors[s], name) for world in worlds for s in ("S2", "S3")]
        inside(np.sum((np.array(drawn) / getattr(prior, name)) ** 2), 300)
        assert getattr(worlds[0].errors["S1"], name) == 0.0
    places = np.array([world.errors[s].position_m for world in worlds for s in ("S1", "S2", "S3")])
    inside(np.sum((places / 20.0) ** 2), places.size)
    world = worlds[0]
    time = np.linspace(0.0, 200.0, 7)
    for receiver, sensor in zip(world.receivers, world.recording.sensors.values(), strict=True):
        recorded = sensor.position_at(time) + world.errors[receiver.name].position_m
        np.testing.assert_allclose(recorded, receiver.body.position_at(time), atol=1e-3)


def test_fixes_of_platforms_are_noisy_and_their_paths_as_the_prior_says():
    kind = Platforms(position_noise_m=0.75, platform_process_noise=0.5)
    fixes, bends, count = 0.0, 0.0, 0
    for seed in range(4):
        world = platforms_world(seed, kind)
        for receiver, sensor in zip(world.receivers, world.recording.sensors.values(), strict=True):
            assert sensor.platform_process_noise == 0.5
            table = sensor.trajectory
            there = receiver.body.position_at(table.time_s)
            fixes += np.sum((table.position_m - there) ** 2) / 0.75**2
            # The first difference of the velocity has the variance q^2 h.
            change = np.diff(receiver.body.velocity_at(table.time_s), axis=0)
            bends += np.sum(change**2) / (0.5**2 * 2.0)
            count += there.size
    inside(fixes, count)
    inside(bends, count - 3 * 16)


def test_platforms_without_noise_fly_straight():
    world = platforms_world(0, Platforms(platform_process_noise=0.0, position_noise_m=0.1))
    velocity = world.receivers[2].body.velocity_at(np.array([0.0, 50.0]))
    np.testing.assert_array_equal(velocity, [[50.0, 0.0, 0.0]] * 2)
    np.testing.assert_allclose(world.receivers[1].body.position_at(2.0), [100.0, 3000.0, 0.0])
    assert world.rows["arrivals"].emission_time_s[[0, -1]].tolist() == [2.0, 120.0]


def test_altitudes_are_those_of_the_path():
    world = multilateration_world(9, Multilateration(emissions=400, altitude_sigma_m=15.0))
    table = world.recording.constraints
    there = world.path.position_at(table.time_s)
    error = table.value - [geodetic(place)[2] for place in there]
    inside(np.sum((error / 15.0) ** 2), 400)
    start, end = world.recording.time_span_s
    assert start <= table.time_s[0]
    assert table.time_s[-1] <= end
    assert multilateration_world(
        9, Multilateration(altitude_sigma_m=None)
    ).recording.constraints is (None)


def test_gross_errors_are_gross_and_change_nothing_else():
    clean = multilateration_world(10, Multilateration())
    dirty = multilateration_world(10, Multilateration(outliers=12))
    outlier = dirty.rows["arrivals"].outlier
    assert outlier.sum() == 12
    moved = np.abs(dirty.recording.arrivals.toa_s - clean.recording.arrivals.toa_s)
    assert moved[~outlier].max() == 0.0
    assert 5e-6 <= moved[outlier].min() < moved.max() <= 1e-5
    assert dirty.recording.settings.loss == "auto"
    with pytest.raises(ValueError, match="9999 outliers of"):
        multilateration_world(10, Multilateration(outliers=9999))


def test_only_two_arrivals_of_each_set_and_no_pair_is_special():
    counts = np.zeros(25)
    for seed in range(10):
        arrivals = degenerate_world("two-arrivals", seed).recording.arrivals
        assert np.bincount(arrivals.emission).tolist() == [2] * 60
        pair = np.sort(arrivals.sensor.reshape(-1, 2), axis=1)
        counts += np.bincount(5 * pair[:, 0] + pair[:, 1], minlength=25)
    # Ten pairs, all equally likely.
    assert np.count_nonzero(counts) == 10
    inside(np.sum((counts[counts > 0] - 60.0) ** 2 / 60.0), 9)


def test_differences_that_were_not_measured_are_missing():
    table = microphones_world(11, Microphones(heard="differences", hearing=0.5)).recording
    low, high = binom.ppf([TAIL, 1.0 - TAIL], 200, 0.5)
    assert low < len(table.time_differences) < high


def test_bearings_of_a_mixed_recording_are_off_by_what_it_says():
    world = mixed_world(12, Mixed(measurements=300))
    b, rows = world.recording.bearings, world.rows["bearings"]
    wrong = [world.errors[name] for name in ("C1", "C2")]
    clock = np.array([one.clock_offset_s for one in wrong])[b.sensor]
    np.testing.assert_allclose(b.time_s - rows.reception_time_s, clock, atol=1e-12)
    error = (b.azimuth_rad - rows.exact + np.pi) % (2.0 * np.pi) - np.pi
    error -= np.array([one.azimuth_bias_rad for one in wrong])[b.sensor]
    inside(np.sum((error * np.cos(b.elevation_rad) / 3e-3) ** 2), len(b))


def test_kinds_of_a_mixed_site_share_path_and_errors():
    both, alone = mixed_world(13), mixed_world(13, Mixed(kinds=("bearings",)))
    assert set(alone.recording.tables) == {"bearings"}
    assert alone.errors == both.errors
    time = np.linspace(0.0, 60.0, 9)
    np.testing.assert_array_equal(alone.path.position_at(time), both.path.position_at(time))


def test_a_world_refuses_what_it_cannot_make():
    plan = ArrivalPlan(emission_time_s=TIMES, receivers=(0, 1), sigma_s=1.0)
    with pytest.raises(ValueError, match="two plans of one kind"):
        by_hand([plan, plan], [SensorErrors()] * 2)
    with pytest.raises(ValueError, match="misalignment_rad is not simulated"):
        by_hand([plan], [SensorErrors(misalignment_rad=1.0), SensorErrors()])


def test_pairs_on_their_own_may_share_receivers():
    plan = TimePlan(emission_time_s=TIMES, pairs=((1, 0), (2, 1)), sigma_s=1.0, shared=False)
    assert plan.receivers == (0, 1, 2)
    assert Receiver(name="R", body=StraightBody(np.zeros(3))).axes == "xyz"
