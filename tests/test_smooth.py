"""The batch smoother on small recordings with a known answer, and on those that have none."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.stats import chi2

import geograph as gg
from geograph.prepare import prepare
from geograph.scenarios.ground import ground_pass
from geograph.scenarios.low_orbit import low_orbit_pass
from geograph.scenarios.sound import room

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

SITES = np.array([[0.0, 0.0, 0.0], [1000.0, 0.0, 0.0], [0.0, 1000.0, 0.0]])
TARGET = np.array([1000.0, 2000.0, 300.0])


def recording(
    path: Callable[[float], Any],
    times: Sequence[float],
    *,
    sites: Sequence[int] = (0, 1),
    errors: Sequence[dict[str, float]] = ({}, {}, {}),
    azimuth_only: bool = False,
    sigma: float = 1e-3,
    constraints: gg.Constraints | None = None,
    **settings: Any,
) -> gg.Recording:
    """Return bearings of a path, taken by the sites in turn, in a local frame."""
    rng = np.random.default_rng(5)
    sensors = {
        f"S{i}": gg.Sensor(
            name=f"S{i}", position_m=SITES[i], axes="xyz", errors=gg.SensorErrors(**errors[i])
        )
        for i in sites
    }
    sensor = np.arange(len(times)) % len(sites)
    line = np.array([path(t) for t in times]) - SITES[np.array(sites)[sensor]]
    azimuth = np.arctan2(line[:, 1], line[:, 0]) + sigma * rng.normal(size=len(times))
    elevation = np.arctan2(line[:, 2], np.hypot(line[:, 0], line[:, 1]))
    elevation += sigma * rng.normal(size=len(times))
    count = len(times)
    table = gg.Bearings(
        time_s=np.asarray(times, dtype=float),
        sensor=sensor,
        azimuth_rad=azimuth,
        elevation_rad=np.full(count, np.nan) if azimuth_only else elevation,
        sigma_azimuth_rad=np.full(count, sigma),
        sigma_elevation_rad=np.full(count, sigma),
        isotropic=np.full(count, not azimuth_only),
        line=np.arange(count) + 2,
    )
    return gg.Recording(
        name="made",
        frame="local",
        sensors=sensors,
        bearings=table,
        constraints=constraints,
        propagation_speed_m_s=np.inf,
        settings=gg.SmoothSettings(**settings),
    )


def still(t: float) -> Any:
    del t
    return TARGET


def straight(t: float) -> Any:
    return TARGET + t * np.array([5.0, 0.0, 0.0])


def known_height(sigma: float) -> gg.Constraints:
    return gg.Constraints(
        time_s=np.array([np.nan]),
        kind=("altitude_m",),
        value=np.array([300.0]),
        sigma=np.array([sigma]),
        line=np.array([2]),
    )


def region(time_s: float = np.nan) -> gg.Constraints:
    """Return where the target is in plan, 5 m and 7 m off by a sigma of 10 m each."""
    return gg.Constraints(
        time_s=np.full(2, time_s),
        kind=("x_m", "y_m"),
        value=TARGET[:2] + np.array([5.0, -7.0]),
        sigma=np.full(2, 10.0),
        line=np.arange(2) + 2,
    )


def within(track: gg.Track, truth: Any, *, sigmas: float = 4.5) -> None:
    """Assert that every knot lies inside the ellipsoid of the given radius."""
    error = track.position_m - truth
    nees = np.einsum("ki,kij,kj->k", error, np.linalg.inv(track.position_covariance_m2), error)
    assert nees.max() < sigmas**2


def test_static_object_is_one_knot() -> None:
    track = gg.smooth(recording(still, range(60), motion="static"))
    assert track.time_s.size == 1
    within(track, TARGET)
    # 120 scalar measurements of 1 mrad at 2 km: the spread agrees with the covariance.
    assert abs(track.summary["chi2"] - track.summary["degrees_of_freedom"]) < 4.0 * np.sqrt(2 * 117)
    later = track.at([1e3])
    np.testing.assert_array_equal(later.position_m[0], track.position_m[0])


@pytest.mark.parametrize("time_s", [np.nan, 3.0])
def test_a_region_alone_resolves_the_range_of_a_single_sensor(time_s: float) -> None:
    seen = recording(still, range(10), sites=(0,), constraints=region(time_s), motion="static")
    track = gg.smooth(seen)
    assert str(track.status) == "converged"
    within(track, TARGET)
    # Along the line in plan both constraints are one of 10 m; across it bearings are far better.
    sight = TARGET - SITES[0]
    plan = sight[:2] / np.linalg.norm(sight[:2])
    along = plan @ track.position_covariance_m2[0, :2, :2] @ plan
    assert np.sqrt(along) == pytest.approx(10.0, rel=1e-3)


def test_a_region_adds_its_information_to_the_estimate_and_the_bound() -> None:
    for given in (gg.smooth, gg.bound):
        information = []
        for known in (None, region()):
            seen = recording(still, range(40), sigma=5e-3, constraints=known, motion="static")
            truth = gg.Truth(time_s=np.zeros(1), position_m=TARGET[None])
            found = given(replace(seen, truth=truth))
            information.append(np.linalg.inv(found.position_covariance_m2[0]))
        added = information[1] - information[0]
        # The bearings' own changes a little with the estimate.
        slack = 1e-3 if given is gg.smooth else 1e-6
        np.testing.assert_allclose(added, np.diag([0.01, 0.01, 0.0]), atol=slack)


def test_static_object_seen_by_a_walking_sensor() -> None:
    errors = ({"azimuth_bias_rad": 1e-3, "azimuth_instability_rad_sqrt_s": 1e-4}, {}, {})
    track = gg.smooth(recording(still, range(60), errors=errors, motion="static", sites=(0, 1, 2)))
    assert track.time_s.size > 1
    np.testing.assert_allclose(track.position_m, track.position_m[:1].repeat(len(track.time_s), 0))
    within(track, TARGET)
    _, sigma = track.sensor_error_at("S0", "azimuth", [0.0, 59.0])
    assert (sigma > 0.0).all()


@pytest.mark.parametrize("motion", ["constant-position", "constant-velocity"])
@pytest.mark.parametrize("noise", [None, "auto"])
def test_straight_path(motion: str, noise: str | None) -> None:
    value = noise or (5.0 if motion == "constant-position" else 0.05)
    made = recording(straight, np.linspace(0, 60, 120), motion=motion, process_noise=value)
    track = gg.smooth(made)
    within(track, [straight(t) for t in track.time_s])


def test_ballistic_path_in_a_local_frame() -> None:
    def thrown(t: float) -> Any:
        return TARGET + np.array([50.0 * t, 0.0, 40.0 * t - 0.5 * 9.80665 * t**2])

    made = recording(thrown, np.linspace(0, 6, 120), motion="ballistic", process_noise=0.01)
    track = gg.smooth(made)
    within(track, [thrown(t) for t in track.time_s])


def test_azimuths_alone_need_a_height() -> None:
    made = recording(straight, range(60), azimuth_only=True, motion="constant-velocity",
                     process_noise=0.05)  # fmt: skip
    track = gg.smooth(made, raise_on_failure=False)
    assert track.status is gg.Status.UNOBSERVABLE
    assert "along z" in track.summary["weakly_observed"][0]
    with pytest.raises(gg.SolveError, match=r"do not determine the path.*along z") as caught:
        gg.smooth(made)
    assert caught.value.status == "unobservable"


def test_azimuths_with_a_height_are_enough() -> None:
    made = recording(straight, range(60), azimuth_only=True, motion="constant-velocity",
                     process_noise=0.05, constraints=known_height(2.0))  # fmt: skip
    track = gg.smooth(made)
    within(track, [straight(t) for t in track.time_s])
    # The whole-path height counts once: its sigma is not beaten by having many knots.
    mean = np.sqrt(track.position_covariance_m2[:, 2, 2].min())
    assert mean > 1.0


def test_one_fixed_sensor_is_named_unobservable() -> None:
    made = recording(straight, range(60), sites=(0,), motion="constant-velocity",
                     process_noise=0.05)  # fmt: skip
    track = gg.smooth(made, raise_on_failure=False)
    assert track.status is gg.Status.UNOBSERVABLE
    assert "S0" in track.summary["message"] or "along" in track.summary["message"]


def test_object_on_the_baseline_is_named_unobservable() -> None:
    def beyond(t: float) -> Any:
        del t
        return np.array([3000.0, 0.0, 0.0])

    track = gg.smooth(recording(beyond, range(40), motion="static"), raise_on_failure=False)
    assert track.status is gg.Status.UNOBSERVABLE
    assert "along x" in track.summary["weakly_observed"][0]
    # The object is in front of both sensors, not between them.
    assert track.position_m[0, 0] > 1000.0


def test_single_bearing() -> None:
    track = gg.smooth(recording(still, [0.0], sites=(0,)), raise_on_failure=False)
    assert track.status is gg.Status.UNOBSERVABLE


def test_object_at_the_zenith_of_a_sensor() -> None:
    def overhead(t: float) -> Any:
        del t
        return np.array([1000.0, 1e-6, 500.0])

    track = gg.smooth(recording(overhead, range(60), sites=(0, 1, 2), motion="static"))
    within(track, overhead(0.0))


def test_an_azimuth_measured_at_the_very_zenith_says_nothing() -> None:
    def overhead(t: float) -> Any:
        del t
        return np.array([1000.0, 0.0, 500.0])

    made = recording(overhead, range(60), sites=(0, 1, 2), sigma=1e-3, motion="static")
    assert made.bearings is not None
    above = made.bearings.sensor == 1
    made.bearings.elevation_rad[above] = np.pi / 2
    made.bearings.isotropic[:] = False
    track = gg.smooth(made, loss="none")
    within(track, overhead(0.0))


def test_few_bearings_that_contradict_each_other_are_not_decided_by_a_minority() -> None:
    made = recording(still, [0.0, 0.0, 0.0], sites=(0, 1, 2), motion="static")
    assert made.bearings is not None
    made.bearings.azimuth_rad[0] += 0.5
    for loss in ("auto", "gnc", "cauchy", "huber"):
        track = gg.smooth(made, loss=loss, raise_on_failure=False)
        wrong = np.linalg.norm(track.position_m[0] - TARGET) > 50.0
        # Three lines, one of them wrong: whatever is answered is not called converged.
        assert track.status is gg.Status.UNOBSERVABLE or not wrong


def test_wide_knots_are_said_and_added_to_the_noise() -> None:
    def winding(t: float) -> Any:
        return straight(t) + np.array([0.0, 10.0 * np.sin(t / 4.0), 0.0])

    made = recording(winding, np.linspace(0, 60, 400), motion="constant-velocity",
                     process_noise=2.0)  # fmt: skip
    fine = gg.smooth(made)
    wide = gg.smooth(made, spacing_s=20.0)
    assert fine.summary["interpolation"]["small"]
    assert not wide.summary["interpolation"]["small"]
    assert "reduce spacing_s" in wide.summary["interpolation"]["message"]
    within(fine, [winding(t) for t in fine.time_s])
    within(wide, [winding(t) for t in wide.time_s])


def test_too_many_knots_are_refused() -> None:
    with pytest.raises(
        gg.InputError, match=r"a spacing of 1e-09 s gives .* knots, which need .* GiB"
    ):
        gg.smooth(recording(straight, range(60), spacing_s=1e-9, process_noise=1.0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"motion": "warp"}, "unknown motion 'warp'; expected one of static"),
        ({"loss": "l3"}, "unknown loss 'l3'; expected one of auto"),
        ({"process_noise": -1.0}, "process_noise is -1.0; expected"),
        ({"spacing_s": 0.0}, "spacing_s is 0.0; expected"),
        ({"colour": 1}, "unknown setting 'colour'"),
        ({"process_noise": "auto", "process_noise_along": 1.0}, "needs one number"),
    ],
)
def test_bad_settings(change: dict[str, Any], message: str) -> None:
    with pytest.raises(gg.InputError, match=message):
        gg.smooth(recording(straight, range(10)), **change)


def test_a_recording_without_bearings_is_refused() -> None:
    made = recording(straight, range(10))
    empty = gg.Recording(name="none", frame="local", sensors=made.sensors)
    with pytest.raises(gg.InputError, match="'none' has no measurement"):
        gg.smooth(empty)


@pytest.mark.parametrize("loss", ["none", "huber", "cauchy", "geman-mcclure", "gnc", "auto"])
def test_losses_agree_on_clean_data(loss: str) -> None:
    made = recording(straight, np.linspace(0, 60, 120), motion="constant-velocity",
                     process_noise=0.05)  # fmt: skip
    plain = gg.smooth(made, loss="none")
    track = gg.smooth(made, loss=loss)
    sigma = np.sqrt(np.trace(plain.position_covariance_m2, axis1=1, axis2=2))
    shift = np.linalg.norm(track.position_m - plain.position_m, axis=1)
    # Robust losses weigh good measurements unequally: a part of the sigma, no more.
    assert (shift < 0.6 * sigma).all()
    if loss in ("gnc", "auto"):
        np.testing.assert_allclose(track.position_m, plain.position_m, atol=1e-3 * sigma.min())
        assert track.summary["rejected"] == []


@pytest.mark.parametrize("loss", ["cauchy", "geman-mcclure", "gnc", "auto"])
def test_outliers_are_named(loss: str) -> None:
    made = recording(straight, np.linspace(0, 60, 120), motion="constant-velocity",
                     process_noise=0.05)  # fmt: skip
    assert made.bearings is not None
    bad = [10, 45, 46, 80]
    made.bearings.azimuth_rad[bad] += [0.3, -0.1, 2.0, 0.02]
    track = gg.smooth(made, loss=loss)
    assert [entry["line"] for entry in track.summary["rejected"]] == [index + 2 for index in bad]
    assert track.summary["rejected"][0]["sensor"] == "S0"
    within(track, [straight(t) for t in track.time_s])


def test_a_biased_sensor_is_flagged() -> None:
    errors = ({"azimuth_bias_rad": 1e-3}, {}, {})
    made = recording(straight, np.linspace(0, 60, 180), sites=(0, 1, 2), errors=errors,
                     motion="constant-velocity", process_noise=0.05)  # fmt: skip
    assert made.bearings is not None
    made.bearings.azimuth_rad[made.bearings.sensor == 0] += 0.01
    track = gg.smooth(made)
    assert track.summary["flagged_sensors"][0].startswith("S0: azimuth_bias is 0.0")
    entry = track.sensor_errors["S0"]["azimuth_bias"]
    # The prior pulls a ten-sigma bias back by a little.
    assert abs(entry.estimate - 0.01) < 5.0 * entry.sigma + 5e-4


def test_sensors_that_do_not_fit_are_flagged() -> None:
    times = np.linspace(0, 60, 180)
    fits = recording(straight, times, motion="constant-velocity", process_noise=0.05)
    assert gg.smooth(fits).summary["flagged_sensors"] == []
    flagged = gg.smooth(fits, motion="static").summary["flagged_sensors"]
    assert [sentence.split(":")[0] for sentence in flagged] == list(fits.sensors)
    assert all("times their sigmas" in sentence for sentence in flagged)


@pytest.mark.parametrize("time", [-1.0, 60.5, 500.0])
def test_constraints_beyond_the_path_are_refused(time: float) -> None:
    made = recording(straight, np.linspace(0, 60, 60))
    table = gg.Constraints(
        time_s=np.array([np.nan, 30.0, time]), kind=("altitude_m",) * 3, value=np.full(3, 1e3),
        sigma=np.full(3, 1e3), line=np.arange(2, 5),
    )  # fmt: skip
    with pytest.raises(gg.InputError, match=f"line 4, column time_s: {time:g}, and the measure"):
        gg.smooth(gg.Recording(**{**vars(made), "constraints": table}))
    clocks = {
        name: gg.Sensor(name=name, position_m=sensor.position_m, axes="xyz",
                        errors=gg.SensorErrors(clock_offset_s=200.0))
        for name, sensor in made.sensors.items()
    }  # fmt: skip
    prepare(gg.Recording(**{**vars(made), "constraints": table, "sensors": clocks}))


def test_correlation_one_counts_a_sensor_once() -> None:
    made = recording(still, range(60), motion="static")
    alone = gg.smooth(made)
    sensors = {
        name: gg.Sensor(name=name, position_m=s.position_m, axes="xyz", correlation=1.0)
        for name, s in made.sensors.items()
    }
    tied = gg.Recording(
        name="tied", frame="local", sensors=sensors, bearings=made.bearings,
        propagation_speed_m_s=np.inf, settings=made.settings,
    )  # fmt: skip
    together = gg.smooth(tied)
    # Thirty measurements of each sensor: the covariance is thirty times as large.
    np.testing.assert_allclose(together.covariance, 30.0 * alone.covariance, rtol=1e-6)
    np.testing.assert_allclose(together.position_m, alone.position_m, rtol=1e-9)


def test_order_of_rows_does_not_matter() -> None:
    made = low_orbit_pass(3, bearings=60)
    assert made.bearings is not None
    order = np.random.default_rng(1).permutation(len(made.bearings))
    shuffled = gg.Bearings(**{key: value[order] for key, value in vars(made.bearings).items()})
    other = gg.Recording(**{**vars(made), "bearings": shuffled})
    one, two = gg.smooth(made), gg.smooth(other)
    sigma = np.sqrt(one.position_covariance_m2[:, 0, 0]).min()
    np.testing.assert_allclose(two.position_m, one.position_m, atol=1e-4 * sigma)


def test_many_bearings_are_thinned_for_the_first_guess_alone() -> None:
    made = low_orbit_pass(1, path="j2", bearings=1500)
    assert made.bearings is not None
    assert len(made.bearings) > 6000
    track = gg.smooth(made)
    assert track.summary["measurements"] == len(made.bearings)
    assert made.truth is not None
    middle = len(made.truth) // 2
    points = track.at(made.truth.time_s[middle])
    error = points.position_m[0] - made.truth.position_m[middle]
    nees = error @ np.linalg.solve(points.position_covariance_m2[0], error)
    assert nees < chi2.ppf(0.9999, 3)


def test_sound_in_a_room_is_consistent() -> None:
    nees = []
    for seed in range(30):
        made = room(seed)
        track = gg.smooth(made)
        assert made.truth is not None
        inside = (made.truth.time_s >= track.time_s[0]) & (made.truth.time_s <= track.time_s[-1])
        points = track.at(made.truth.time_s[inside])
        middle = inside.sum() // 2
        error = points.position_m[middle] - made.truth.position_m[inside][middle]
        nees.append(error @ np.linalg.solve(points.position_covariance_m2[middle], error))
    low, high = chi2.ppf([0.005, 0.995], 3 * len(nees)) / len(nees)
    assert low < np.mean(nees) < high


def test_fireballs_with_clocks_a_second_off_are_consistent() -> None:
    nees = []
    for seed in range(12):
        made = ground_pass(seed)
        track = gg.smooth(made)
        assert made.truth is not None
        middle = len(made.truth) // 2
        points = track.at(made.truth.time_s[middle])
        error = points.position_m[0] - made.truth.position_m[middle]
        nees.append(error @ np.linalg.solve(points.position_covariance_m2[0], error))
    low, high = chi2.ppf([0.005, 0.995], 3 * len(nees)) / len(nees)
    assert low < np.mean(nees) < high
