"""Objects on the ground: first guesses, hypotheses, posteriors as maps, bounds, bad input."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from made_flight import circle, measured, straight
from made_ground import hills, local_terrain, ridges, write_tif
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import geograph as gg
from geograph.cli import main
from geograph.errors import InputError
from geograph.ground import crossings
from geograph.measurements import Bearings, Constraints, Truth
from geograph.plot import likelihood
from geograph.sensors import Sensor, Trajectory
from geograph.vantage import GRAZING, STRAIGHT_BELOW, vantage

HILLS = local_terrain(hills)
RIDGES = local_terrain(ridges)
EMITTER = np.array([2600.0, 2500.0, hills(2600.0, 2500.0) + 2.0])


def on_the_ground(value=2.0, sigma=5.0, time_s=np.nan):
    return Constraints(
        time_s=np.array([time_s]),
        kind=("height_above_terrain_m",),
        value=np.array([value]),
        sigma=np.array([sigma]),
        line=np.array([2]),
    )


def recording(flights, bearings, terrain=HILLS, **settings):
    options = {"motion": "static", "loss": "none"} | settings
    return gg.Recording(
        name="flight",
        frame="local",
        sensors={
            f"A{i}": Sensor(name=f"A{i}", trajectory=flight.trajectory(), axes="body")
            for i, flight in enumerate(flights)
        },
        bearings=bearings,
        constraints=on_the_ground(),
        terrain=terrain,
        settings=gg.SmoothSettings(**options),
    )


def test_rays_meet_a_plane_where_they_should():
    terrain = local_terrain(lambda x, y: 10.0 + 0.1 * x + 0.0 * y, spacing=50.0)
    start = np.array([[0.0, 100.0, 500.0]] * 3)
    direction = np.array([[0.6, 0.0, -0.8], [0.0, 0.6, -0.8], [0.6, 0.0, 0.8]])
    met = crossings(start, direction, terrain, height_m=5.0)
    assert met.ray.tolist() == [0, 1]
    # 500 - 0.8 r = 15 + 0.06 r and 500 - 0.8 r = 15.
    first, second = 485.0 / 0.86, 485.0 / 0.8
    expected = start[:2] + np.array([[first], [second]]) * direction[:2]
    np.testing.assert_allclose(met.position_m, expected, atol=1e-5)


def test_a_ray_over_ridges_has_all_its_crossings():
    start, slope = np.array([[0.0, 0.0, 60.0]]), 0.1429
    direction = np.array([[1.0, 0.0, slope]]) / np.hypot(1.0, slope)
    met = crossings(start, direction, RIDGES)
    x = np.arange(0.0, 8000.0, 0.5)
    above = 60.0 + slope * x > ridges(x, 0.0)
    expected = x[1:][above[1:] != above[:-1]]
    # The raster's splines are within a metre or two of the formula.
    np.testing.assert_allclose(met.position_m[:, 0], expected, atol=3.0)
    assert expected.size == 6


@pytest.mark.parametrize("sigma_deg", [0.5, 5.0, 10.0])
def test_one_aircraft_finds_an_emitter_on_hills(sigma_deg):
    # 8 draws of 20 s: the sum of NEES is chi-square with 24 degrees; false alarms 1e-3.
    total = 0.0
    for seed in range(8):
        flights = [straight([200.0, 200.0, 1000.0], 20.0, 60.0, 20.0, rate=5.0)]
        bearings = measured(flights, EMITTER, np.radians(sigma_deg), np.random.default_rng(seed))
        track = gg.smooth(recording(flights, bearings), raise_on_failure=False)
        # The constraint's own error is 0: its part of the NEES is small, never too large.
        error = track.position_m[0] - EMITTER
        total += error @ np.linalg.solve(track.position_covariance_m2[0], error)
    assert total < chi2.isf(1e-3, 24)
    assert total > chi2.ppf(1e-3, 16) / 2.0


def test_a_moving_object_is_followed_over_hills():
    rng = np.random.default_rng(4)
    flights = [circle([2500.0, 2500.0, 1500.0], 1500.0, 60.0, 120.0, rate=4.0)]
    time = flights[0].time_s
    truth = np.column_stack([2000.0 + 6.0 * time, 2200.0 + 4.0 * time, np.zeros(time.size)])
    truth[:, 2] = hills(truth[:, 0], truth[:, 1]) + 2.0
    bearings = measured(flights, truth, np.radians(1.0), rng)
    given_ = recording(flights, bearings, motion="constant-velocity", process_noise=0.5)
    track = gg.smooth(given_)
    at = np.interp(track.time_s, time, np.arange(time.size)).round().astype(int)
    error = track.position_m - truth[at]
    square = np.einsum(
        "kc,kc->k", error, np.linalg.solve(track.position_covariance_m2, error[:, :, None])[:, :, 0]
    )
    assert np.median(square) < chi2.isf(0.01, 3)
    assert np.linalg.norm(error, axis=1).max() < 60.0
    # Without the ground, height is the worst known; with it, the best.
    sigma = np.sqrt(np.diagonal(track.position_covariance_m2, axis1=1, axis2=2)).mean(axis=0)
    free = gg.smooth(replace(given_, constraints=None, terrain=None))
    loose = np.sqrt(np.diagonal(free.position_covariance_m2, axis1=1, axis2=2)).mean(axis=0)
    assert (sigma < loose).all()


def mast(place, target, sigma_deg, *, count=40, seed=1):
    """A station that looks at a target: xyz axes, one direction, noise on the sky."""
    rng = np.random.default_rng(seed)
    sight = np.subtract(target, place)
    azimuth, elevation = np.arctan2(sight[1], sight[0]), np.arctan2(sight[2], np.hypot(*sight[:2]))
    sigma = np.radians(sigma_deg)
    noise = sigma * rng.normal(size=(2, count))
    bearings = Bearings(
        time_s=np.arange(float(count)),
        sensor=np.zeros(count, dtype=np.int64),
        azimuth_rad=azimuth + noise[0] / np.cos(elevation),
        elevation_rad=elevation + noise[1],
        sigma_azimuth_rad=np.full(count, sigma),
        sigma_elevation_rad=np.full(count, sigma),
        isotropic=np.ones(count, dtype=bool),
        line=np.arange(count) + 2,
    )
    return Sensor(name="M", position_m=np.array(place), axes="xyz"), bearings


def standing(sensor, bearings, terrain, **options):
    return gg.Recording(
        name="mast", frame="local", sensors={sensor.name: sensor}, bearings=bearings,
        constraints=on_the_ground(), terrain=terrain,
        settings=gg.SmoothSettings(motion="static", loss="none"), **options,
    )  # fmt: skip


def test_one_ray_over_ridges_keeps_every_hypothesis_with_its_weight():
    target = np.array([1350.0, 0.0, ridges(1350.0, 0.0) + 2.0])
    track = gg.smooth(
        standing(*mast([0.0, 0.0, 60.0], target, 0.2), RIDGES), raise_on_failure=False
    )
    assert str(track.status) == "unobservable"
    found = track.summary["hypotheses"]
    assert len(found) == 6
    assert sum(entry["weight"] for entry in found) == pytest.approx(1.0)
    places = np.array([entry["position_m"] for entry in found])
    away = np.linalg.norm(places - target, axis=1)
    assert away.min() < 15.0
    np.testing.assert_array_equal(places[0], track.position_m[0])
    # Weights are posterior masses. Integrated along the ray from its own geometry: the density at
    # a crossing is wide where the ground falls away with the ray, and narrow where it faces it.
    grid = np.arange(1000.0, 6000.0, 0.5)
    _, bearings = mast([0.0, 0.0, 60.0], target, 0.2)
    mean = bearings.elevation_rad.mean()
    sigma = np.radians(0.2) / np.sqrt(40.0)
    seen_at = np.arctan2(RIDGES.elevation(np.column_stack([grid, 0 * grid, 0 * grid]))[0] + 2.0
                         - 60.0, grid)  # fmt: skip
    # Across the ray the width grows with the distance.
    density = np.exp(-0.5 * ((seen_at - mean) / np.hypot(sigma, 5.0 / grid)) ** 2)
    density *= grid * sigma / np.hypot(sigma, 5.0 / grid) / sigma
    borders = np.sort(places[:, 0])
    middle = np.concatenate([[0.0], 0.5 * (borders[1:] + borders[:-1]), [1e9]])
    mass = np.array([
        density[(grid > low) & (grid <= high)].sum()
        for low, high in pairwise(middle)
    ])  # fmt: skip
    weights = np.array([entry["weight"] for entry in found])[np.argsort(places[:, 0])]
    np.testing.assert_allclose(weights, mass / mass.sum(), atol=0.06)
    sentences = [s for s in track.summary["weakly_observed"] if "another path fits too" in s]
    assert len(sentences) == 5
    assert "weight 0." in sentences[0]


def in_a_region(recording, place, sigma):
    held = recording.constraints
    both = Constraints(
        time_s=np.append(held.time_s, [np.nan, np.nan]),
        kind=(*held.kind, "x_m", "y_m"),
        value=np.append(held.value, place[:2]),
        sigma=np.append(held.sigma, [sigma, sigma]),
        line=np.append(held.line, [3, 4]),
    )
    return replace(recording, constraints=both)


def test_a_region_chooses_between_the_slopes_that_a_ray_meets():
    target = np.array([1350.0, 0.0, ridges(1350.0, 0.0) + 2.0])
    seen = standing(*mast([0.0, 0.0, 60.0], target, 0.2), RIDGES)
    track = gg.smooth(in_a_region(seen, target + np.array([20.0, 0.0, 0.0]), 30.0))
    assert str(track.status) == "converged"
    # Without it there are six, and none of them is certain. The next slope is 7 sigmas away.
    assert track.summary["hypotheses"][0]["weight"] > 0.999
    error = track.position_m[0] - target
    assert error @ np.linalg.solve(track.position_covariance_m2[0], error) < chi2.isf(1e-4, 3)


def test_a_region_is_a_first_guess_where_no_ray_meets_the_ground():
    # Seen far too high, by five sigmas: above all of the ground.
    target = np.array([1350.0, 0.0, ridges(1350.0, 0.0) + 2.0])
    sensor, bearings = mast([0.0, 0.0, 400.0], target, 3.0, count=1)
    bearings = replace(bearings, elevation_rad=np.full(1, np.radians(10.0)))
    seen = standing(sensor, bearings, RIDGES)
    with pytest.raises(InputError, match="meets the terrain"):
        gg.smooth(seen)
    track = gg.smooth(in_a_region(seen, target, 30.0), raise_on_failure=False)
    assert np.linalg.norm(track.position_m[0, :2] - target[:2]) < 150.0
    height = RIDGES.elevation(track.position_m[:1])[0] + 2.0
    assert track.position_m[0, 2] == pytest.approx(height[0], abs=25.0)


def wedge(seed=1):
    """One second of a flight, bearings of 10 degrees: a posterior that is no ellipse."""
    flights = [straight([200.0, 200.0, 1000.0], 20.0, 60.0, 1.0, rate=10.0)]
    bearings = measured(flights, EMITTER, np.radians(10.0), np.random.default_rng(seed))
    return flights, bearings, gg.smooth(recording(flights, bearings), raise_on_failure=False)


def test_a_wedge_is_flagged_and_its_contour_is_the_true_one():
    flights, bearings, track = wedge()
    told = track.summary["gaussian"]
    assert not told["holds"]
    assert "at one sigma the cost rises by" in told["reason"]
    assert told["rise_at_one_sigma"] > 0.75
    found = track.likelihood_map(cells=25)
    assert np.exp(found.log_density).sum() == pytest.approx(1.0)
    inside = np.isfinite(found.log_density) & (found.log_density > found.log_density.max() - 8.0)
    # The same from geometry: angles between directions measured and directions to each place.
    body = Rotation.from_euler("ZYX", flights[0].attitude_rad)
    measured_body = np.stack([
        np.cos(bearings.elevation_rad) * np.cos(bearings.azimuth_rad),
        np.cos(bearings.elevation_rad) * np.sin(bearings.azimuth_rad),
        -np.sin(bearings.elevation_rad),
    ], axis=1)  # fmt: skip
    ned = body.apply(measured_body)
    direction = np.stack([ned[:, 1], ned[:, 0], -ned[:, 2]], axis=1)
    place = found.position_m[inside]
    sight = place[:, None] - flights[0].position_m
    cosine = np.einsum("pnc,nc->pn", sight, direction) / np.linalg.norm(sight, axis=2)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    height = place[:, 2] - HILLS.elevation(place)[0]
    expected = -0.5 * ((angle / np.radians(10.0)) ** 2).sum(axis=1) - 0.5 * ((height - 2) / 5) ** 2
    gap = found.log_density[inside] - expected
    assert inside.sum() > 60
    assert np.ptp(gap) < 0.1
    assert found.region(0.5).sum() < found.region(0.95).sum() < found.log_density.size
    assert found.area_m2(0.5) < found.area_m2(0.95)
    assert found.contains(track.position_m[0], 0.5)
    figure = likelihood(track, found)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "95 % of the posterior" in labels
    assert "height of the ground" in labels
    assert not found.contains(EMITTER + np.array([50e3, 0.0, 0.0]))
    with pytest.raises(InputError, match="expected between 0 and 1"):
        found.level(1.0)
    with pytest.raises(InputError, match="expected 11 to 400"):
        track.likelihood_map(cells=3)


def test_a_long_flight_is_gaussian_and_its_contour_is_the_ellipse():
    flights = [circle([2500.0, 2500.0, 1200.0], 1000.0, 60.0, 60.0, rate=2.0)]
    bearings = measured(flights, EMITTER, np.radians(2.0), np.random.default_rng(2))
    track = gg.smooth(recording(flights, bearings))
    assert track.summary["gaussian"]["holds"]
    assert track.summary["hypotheses"] == []
    found = track.likelihood_map(cells=25)
    area = (
        np.pi * chi2.ppf(0.95, 2) * np.sqrt(np.linalg.det(track.position_covariance_m2[0, :2, :2]))
    )
    assert found.area_m2(0.95) == pytest.approx(area, rel=0.15)


def test_directions_are_those_of_the_covariance():
    flights, _, track = wedge(2)
    found = track.summary["directions"]
    values, vectors = np.linalg.eigh(track.position_covariance_m2[0])
    assert [entry["sigma_m"] for entry in found] == pytest.approx(np.sqrt(values[::-1]).tolist())
    for entry, vector in zip(found, vectors.T[::-1], strict=True):
        assert abs(np.dot(entry["vector"], vector)) == pytest.approx(1.0)
    assert found[0]["weak"]
    assert not found[-1]["weak"]
    weak = [entry for entry in found if entry["weak"]]
    named = [s for s in track.summary["weakly_observed"] if s.startswith("the position along")]
    assert len(named) >= len(weak)
    del flights


def planned(flights, emitter, *, on_sky=True, terrain=HILLS, sigma_deg=1.0):
    rng = np.random.default_rng(0)
    bearings = measured(flights, emitter, np.radians(sigma_deg), rng, on_sky=on_sky)
    given_ = recording(flights, bearings, terrain)
    truth = Truth(time_s=np.array([0.0]), position_m=np.array([emitter]))
    return replace(given_, truth=truth)


def test_the_bound_on_the_ground_and_its_map():
    flights = [straight([200.0, 200.0, 1000.0], 20.0, 60.0, 20.0, rate=1.0)]
    given_ = planned(flights, EMITTER)
    free = gg.bound(replace(given_, constraints=None, terrain=None))
    held = gg.bound(given_)
    assert held.sigma_horizontal_m[0] < free.sigma_horizontal_m[0]
    assert held.sigma_height_m[0] < 0.5 * free.sigma_height_m[0]
    assert [entry.sigma_m for entry in held.directions] == sorted(
        (entry.sigma_m for entry in held.directions), reverse=True
    )
    over = gg.bound_map(given_, center_m=EMITTER, extent_m=14e3, cells=7)
    ground, _ = HILLS.elevation(over.position_m.reshape(-1, 3))
    height = over.position_m[..., 2].ravel() - ground
    known = (over.reason != "the terrain has no height there").ravel()
    np.testing.assert_allclose(height[known], 2.0, atol=1e-9)
    assert 0 < (~known).sum() < known.size
    # The middle cell is the emitter itself.
    assert over.sigma_horizontal_m[3, 3] == pytest.approx(held.sigma_horizontal_m[0], rel=1e-3)


FLAT = local_terrain(lambda x, y: 0.0 * x + 0.0 * y, spacing=200.0)


def hovering(height):
    """A sensor that hangs in the air, looking from one place."""
    flight = straight([0.0, 0.0, height], 0.0, 0.01, 10.0, pitch_deg=0.0, rate=2.0)
    return [flight]


@pytest.mark.parametrize(
    ("height", "emitter", "on_sky", "reason"),
    [
        (1000.0, [1.0, 1.0, 2.0], False, STRAIGHT_BELOW),
        (30.0, [5000.0, 0.0, 2.0], True, GRAZING),
        (1000.0, [500.0, 800.0, 2.0], False, ""),
        (1000.0, [1.0, 1.0, 2.0], True, ""),
    ],
)
def test_the_two_singular_cases_of_one_receiver_are_named(height, emitter, on_sky, reason):
    given_ = planned(hovering(height), np.array(emitter), on_sky=on_sky, terrain=FLAT)
    found = gg.bound(given_)
    text = " ".join(found.weakly_observed)
    if reason == STRAIGHT_BELOW:
        # Its azimuth's sigma, a degree about nothing, is taken at its word by the bound.
        from geograph.bounds import located

        smoother, _ = located(given_, given_.settings)
        seen_ = vantage(smoother.problem, smoother.solution.values)
        assert seen_.reason == reason
        assert "give the sigmas on the sky" in seen_.sentence
    elif reason:
        assert reason in text
        assert "look from higher above it" in text
    else:
        assert STRAIGHT_BELOW not in text
        assert GRAZING not in text


def test_a_sensor_in_the_ground_is_refused():
    sensor, bearings = mast([0.0, 0.0, -60.0], [1000.0, 0.0, 0.0], 1.0)
    with pytest.raises(InputError, match=r"sensor 'M' is 60 m below the ground of terrain; are"):
        gg.smooth(standing(sensor, bearings, FLAT))


def test_terrain_of_another_place_is_refused():
    sensor, bearings = mast([90e3, 0.0, 500.0], [91e3, 0.0, 0.0], 1.0)
    with pytest.raises(InputError, match=r"no sensor is over the terrain, which covers x -2"):
        gg.smooth(standing(sensor, bearings, FLAT))


def test_bearings_that_never_meet_the_ground_are_refused():
    sensor, bearings = mast([0.0, 0.0, 500.0], [1000.0, 0.0, 900.0], 1.0)
    message = r"none of 40 bearings looked at meets the terrain within x -2.* 2 m above ground; che"
    with pytest.raises(InputError, match=message):
        gg.smooth(standing(sensor, bearings, FLAT))


def test_an_object_beyond_the_raster_is_named():
    # Two stations see it 600 m beyond the edge; some rays meet the ground on the way.
    first, bearings = mast([6500.0, 0.0, 300.0], [8700.0, 0.0, 2.0], 2.0, count=60)
    second, others = mast([6500.0, 1500.0, 300.0], [8700.0, 0.0, 2.0], 2.0, count=60, seed=2)
    both = {
        name: np.concatenate([column, getattr(others, name) + (name == "sensor")])
        for name, column in vars(bearings).items()
    }
    given_ = standing(first, bearings, FLAT)
    given_ = replace(
        given_, sensors={"M": first, "N": replace(second, name="N")},
        bearings=Bearings(**both | {"isotropic": np.ones(120, dtype=bool)}),
    )  # fmt: skip
    track = gg.smooth(given_, raise_on_failure=False)
    assert str(track.status) == "unobservable"
    text = " ".join(track.summary["weakly_observed"])
    assert "the object is where terrain has no height, outside of it or in a gap" in text


def test_constraints_and_terrain_belong_together():
    sensor, bearings = mast([0.0, 0.0, 500.0], [1000.0, 0.0, 0.0], 1.0)
    with pytest.raises(InputError, match="of height_above_terrain_m, and there is no terrain"):
        standing(sensor, bearings, None)
    with pytest.raises(InputError, match="terrain is in the frame local and the recording in ecef"):
        gg.Recording(name="a", frame="ecef", sensors={}, terrain=FLAT)


def test_a_known_height_at_one_time_alone():
    flights = [circle([2500.0, 2500.0, 1500.0], 1500.0, 60.0, 60.0, rate=2.0)]
    bearings = measured(flights, EMITTER, np.radians(2.0), np.random.default_rng(2))
    given_ = replace(recording(flights, bearings), constraints=on_the_ground(time_s=30.0))
    track = gg.smooth(given_)
    error = track.position_m[0] - EMITTER
    square = error @ np.linalg.solve(track.position_covariance_m2[0], error)
    assert square < chi2.isf(1e-3, 3)


def files(tmp_path, **changes):
    """A recording of a flight over hills, written and read back."""
    flights = [straight([200.0, 200.0, 1000.0], 20.0, 60.0, 10.0, rate=2.0)]
    bearings = measured(flights, EMITTER, np.radians(1.0), np.random.default_rng(2))
    return gg.write(recording(flights, bearings, **changes), tmp_path)


@pytest.mark.parametrize("name", ["rec", "rec.zip"])
def test_recordings_with_terrain_are_written_and_read(tmp_path, name):
    written = files(tmp_path / name)
    again = gg.read(tmp_path / name)
    at = np.column_stack([np.linspace(0.0, 5e3, 40)] * 2 + [np.zeros(40)])
    expected, _ = HILLS.elevation(at)
    for one in (written, again):
        np.testing.assert_array_equal(one.terrain.elevation(at)[0], expected)
        assert one.constraints.kind == ("height_above_terrain_m",)
    track = gg.smooth(again)
    assert np.linalg.norm(track.position_m[0] - EMITTER) < 300.0
    # From a file, in a folder or an archive, to another recording.
    third = gg.write(again, tmp_path / "third")
    np.testing.assert_array_equal(third.terrain.elevation(at)[0], expected)


BAD = {
    "no file": (
        "recording.toml",
        "terrain.tif",
        "dem.tif",
        r"toml:\d+, column terrain: 'dem.tif' is",
    ),
    "not a name": (
        "recording.toml",
        "terrain.tif",
        "../a.tif",
        "expected the name of a GeoTIFF in",
    ),
    "another kind": ("recording.toml", "terrain.tif", "a.png", "expected the name of a GeoTIFF in"),
    "heights": (
        "recording.toml",
        'terrain = "terrain.tif"',
        'terrain = "terrain.tif"\nterrain_heights = "geoid"',
        "terrain_heights: terrain_heights is for the frame ecef; in a local frame",
    ),
    "no terrain": (
        "recording.toml",
        'terrain = "terrain.tif"\n',
        "",
        r"constraints.csv:2, column kind: height_above_terrain_m; expected a terrain in recording",
    ),
    "lone key": (
        "recording.toml",
        'terrain = "terrain.tif"',
        "geoid_undulation_m = 3.0",
        "geoid_undulation_m: geoid_undulation_m needs a terrain; name its GeoTIFF or remove it",
    ),
    "wrong unit": (
        "trajectory_A0.csv",
        "yaw_deg",
        "yaw_rad",
        r"trajectory_A0.csv:2, column yaw_rad: 20; expected -6.28319 to 6.28319; is the column",
    ),
    "no attitude": (
        "recording.toml",
        'trajectory = "trajectory_A0.csv"',
        "position_m = [0, 0, 500]",
        r"axes: axes body of a fixed sensor need its attitude; expected attitude_deg = \[yaw",
    ),
    "attitude twice": (
        "recording.toml",
        'trajectory = "trajectory_A0.csv"',
        "position_m = [0, 0, 500]\nattitude_deg = [0, 0, 0]\nattitude_rad = [0, 0, 0]",
        "attitude_rad is there beside attitude_deg; expected one of them",
    ),
    "attitude of the moving": (
        "recording.toml",
        'axes = "body"',
        'axes = "body"\nattitude_deg = [0, 0, 0]',
        "attitude_deg: is for fixed sensors with axes body; a moving one has it in its trajectory",
    ),
    "attitude of others": (
        "recording.toml",
        'axes = "body"',
        'axes = "enu"\nattitude_deg = [0, 0, 0]',
        "is for fixed sensors with axes body; given axes enu; remove it",
    ),
    "switch": (
        "recording.toml",
        'axes = "body"',
        'axes = "body"\nunusual_attitude = 1',
        "unusual_attitude: is 1; expected true or false",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_named(tmp_path, case):
    file, old, new, message = BAD[case]
    files(tmp_path / "rec")
    path = tmp_path / "rec" / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=message) as caught:
        gg.read(tmp_path / "rec")
    assert "\n" not in str(caught.value)


def test_radians_in_a_column_of_degrees_are_questioned(tmp_path):
    written = files(tmp_path / "rec")
    path = tmp_path / "rec" / "trajectory_A0.csv"
    flight = written.sensors["A0"].trajectory
    rows = np.column_stack([flight.time_s, flight.position_m, flight.attitude_rad])
    header = "time_s,x_m,y_m,z_m,yaw_deg,pitch_deg,roll_deg"
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    # A course of 20 degrees, 0.35 radians: as degrees it would be about north.
    with pytest.raises(
        InputError, match=r"trajectory_A0.csv, column yaw: of sensor 'A0': yaw foll"
    ):
        gg.read(tmp_path / "rec")
    header = (tmp_path / "rec" / "recording.toml").read_text()
    told = header.replace('axes = "body"', 'axes = "body"\nunusual_attitude = true')
    (tmp_path / "rec" / "recording.toml").write_text(told)
    assert gg.read(tmp_path / "rec").sensors["A0"].unusual_attitude


def test_a_body_sensor_without_attitudes_in_its_file(tmp_path):
    files(tmp_path / "rec")
    path = tmp_path / "rec" / "trajectory_A0.csv"
    lines = [",".join(line.split(",")[:4]) for line in path.read_text().splitlines()]
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"trajectory_A0.csv:1: has no yaw, pitch and roll, and"):
        gg.read(tmp_path / "rec")


def test_the_plain_graph_has_the_ground_too():
    flights, _, track = wedge(3)
    del flights
    built = gg.build(track.recording)
    at = built.encode(track.values)
    assert built.graph.error(at) == pytest.approx(track.summary["cost"], rel=1e-6)


def test_ecef_over_a_projected_raster(tmp_path):
    # The same hills at 60 N, an aircraft in ECEF with attitudes against its own north, east, down.
    from pyproj import Transformer

    from geograph.geodesy import ecef_from_geodetic, enu_axes
    from geograph.terrain import Terrain

    west, north = 495_000.0, 6_655_000.0
    line = 50.0 * np.arange(240.0)
    x, y = np.meshgrid(west + 25.0 + line, north - 25.0 - line)
    path = write_tif(
        tmp_path / "utm.tif", hills(x - west, y - north), west=west, north=north, spacing=50.0,
        crs="EPSG:32633", dtype="float64",
    )  # fmt: skip
    terrain = Terrain.from_file(path, frame="ecef", heights="ellipsoid")
    utm = Transformer.from_crs("EPSG:32633", "EPSG:4326", always_xy=True)
    lon, lat = utm.transform(west + 6000.0, north - 5000.0)
    emitter = ecef_from_geodetic(lat, lon, hills(6000.0, -5000.0) + 2.0)
    start_lon, start_lat = utm.transform(west + 3000.0, north - 7000.0)
    start = ecef_from_geodetic(start_lat, start_lon, 1200.0)
    time = np.arange(0.0, 31.0, 1.0)
    level = enu_axes(start)
    position = start + np.outer(time, 60.0 * level[1])
    rng = np.random.default_rng(7)
    sigma, columns = np.radians(1.0), []
    attitude = np.tile([0.0, 0.03, 0.02], (time.size, 1))
    for place, angles in zip(position, attitude, strict=True):
        east, north_, up = enu_axes(place) @ (emitter - place)
        forward, right, down = Rotation.from_euler("ZYX", angles).inv().apply([north_, east, -up])
        columns.append([np.arctan2(right, forward), np.arctan2(-down, np.hypot(forward, right))])
    azimuth, elevation = np.array(columns).T
    bearings = Bearings(
        time_s=time, sensor=np.zeros(time.size, dtype=np.int64),
        azimuth_rad=azimuth + sigma * rng.normal(size=time.size) / np.cos(elevation),
        elevation_rad=elevation + sigma * rng.normal(size=time.size),
        sigma_azimuth_rad=np.full(time.size, sigma), sigma_elevation_rad=np.full(time.size, sigma),
        isotropic=np.ones(time.size, dtype=bool), line=np.arange(time.size),
    )  # fmt: skip
    from datetime import UTC, datetime

    flown = Trajectory(time, position, attitude)
    given_ = gg.Recording(
        name="utm", frame="ecef", epoch=datetime(2024, 5, 1, tzinfo=UTC),
        sensors={"A": Sensor(name="A", trajectory=flown, axes="body")},
        bearings=bearings, constraints=on_the_ground(), terrain=terrain,
        settings=gg.SmoothSettings(motion="static", loss="none"),
    )  # fmt: skip
    track = gg.smooth(given_)
    error = track.position_m[0] - emitter
    square = error @ np.linalg.solve(track.position_covariance_m2[0], error)
    assert square < chi2.isf(1e-3, 3)
    found = track.likelihood_map(cells=11)
    assert found.contains(track.position_m[0], 0.5)
    over = gg.bound_map(given_, center_m=track.position_m, extent_m=2e3, cells=2)
    assert over.observable.all()
    written = gg.write(given_, tmp_path / "rec")
    assert written.terrain.heights == "ellipsoid"


def test_the_command_prints_every_place_that_fits(tmp_path, capsys):
    target = np.array([1350.0, 0.0, ridges(1350.0, 0.0) + 2.0])
    gg.write(standing(*mast([0.0, 0.0, 60.0], target, 0.2), RIDGES), tmp_path / "mast")
    command = ["smooth", str(tmp_path / "mast"), "-o", str(tmp_path / "out"), "--no-plots"]
    assert main(command) == 3
    out = capsys.readouterr().out
    assert "6 places fit:" in out
    assert out.count("weight 0.") >= 6
    assert "not Gaussian: another path fits too" in out
    facts = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert len(facts["hypotheses"]) == 6
    assert facts["directions"][0]["sigma_m"] >= facts["directions"][-1]["sigma_m"]


def test_results_have_a_picture_where_there_is_no_ellipse(tmp_path, monkeypatch):
    from geograph.results import save
    from geograph.results import write as writing

    monkeypatch.setattr(writing, "_MAP_CELLS", 11)
    _, _, track = wedge()
    save(track, tmp_path / "out")
    assert (tmp_path / "out" / "likelihood.png").stat().st_size > 10_000
    # Again into the same folder, without pictures: none is left.
    save(track, tmp_path / "out", pictures=False)
    assert not (tmp_path / "out" / "likelihood.png").exists()
