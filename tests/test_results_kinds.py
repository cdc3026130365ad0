"""Results of arrivals and differences: written and read back, and what tables say of them."""

from __future__ import annotations

import csv
import dataclasses

import numpy as np
import pytest
import solved_track
from test_results import edit, same

from geograph import results
from geograph.cli.report import results_text
from geograph.compare import compare, read_path, read_truth
from geograph.geodesy import enu_axes
from geograph.measurements import Truth
from geograph.results import names
from geograph.results.facts import place_text, rounded, static_facts
from geograph.results.write import plain


@pytest.fixture(params=sorted(solved_track.RECORDINGS))
def made(request):
    return solved_track.of(request.param)


def test_what_is_written_is_read_back_to_the_last_bit(tmp_path, made):
    assert made.status == "converged"
    results.save(made, tmp_path / "out", pictures=False)
    read = results.load(tmp_path / "out")
    for field in dataclasses.fields(made):
        if field.name != "summary":
            assert same(getattr(made, field.name), getattr(read, field.name)), field.name
    assert read.summary == plain(made.summary)
    wanted = {True: {names.PLATFORMS}, False: set()}[bool(made.platforms)]
    assert {p.name for p in (tmp_path / "out").iterdir()} & {names.PLATFORMS} == wanted


def test_residuals_name_reference_unit_and_emission(tmp_path):
    results.save(solved_track.of("platforms"), tmp_path / "out", pictures=False)
    with (tmp_path / "out" / names.RESIDUALS).open() as file:
        rows = list(csv.DictReader(file))
    arrivals = [row for row in rows if row["kind"] == "toa"]
    differences = [row for row in rows if row["kind"] == "fdoa"]
    assert len(arrivals) + len(differences) == len(rows)
    assert {(row["reference"], row["unit"]) for row in arrivals} == {("", "s")}
    assert {(row["reference"], row["unit"]) for row in differences} == {("P1", "Hz")}
    assert {row["emission"] for row in differences} == {""}
    # Four platforms hear each of 60 emissions.
    heard = [(row["emission"], row["sensor"]) for row in arrivals]
    assert len(set(heard)) == len(heard) == 240
    assert {emission for emission, _ in heard} == {str(i) for i in range(60)}


def test_results_of_bearings_alone_still_read(tmp_path):
    made = solved_track.of("far emitter")
    results.save(made, tmp_path / "out", pictures=False)
    path = tmp_path / "out" / names.RESIDUALS
    with path.open() as file:
        rows = list(csv.reader(file))
    kept = [i for i, name in enumerate(rows[0]) if name not in ("reference", "emission")]
    path.write_text("\n".join(",".join(row[i] for i in kept) for row in rows) + "\n")
    edit(tmp_path / "out" / names.SUMMARY, '"height_held": true,', "")
    edit(tmp_path / "out" / names.SUMMARY, '"propagation_speed_m_s": 299792458.0,', "")
    read = results.load(tmp_path / "out")
    assert set(read.residuals.reference.tolist()) == {""}
    assert len(read.residuals) == len(made.residuals)
    np.testing.assert_array_equal(read.residuals.residual, made.residuals.residual)
    assert not read.height_held


def test_rejected_arrivals_are_named_with_table_and_emission():
    recording = solved_track.RECORDINGS["aircraft"]()
    arrivals = dataclasses.replace(
        recording.arrivals,
        toa_s=recording.arrivals.toa_s + np.where(np.arange(len(recording.arrivals)) == 7, 1e-4, 0),
        emission_names=tuple(f"squitter {i}" for i in range(recording.arrivals.emission.max() + 1)),
    )
    track = solved_track.solved(
        dataclasses.replace(
            recording, arrivals=arrivals, settings=recording.settings.replace(loss="gnc")
        )
    )
    made = results.from_track(track)
    (entry,) = made.summary["rejected"]
    name = recording.sensor_names[arrivals.sensor[7]]
    assert (entry["table"], entry["sensor"]) == ("arrivals", name)
    assert entry["emission"] == f"squitter {arrivals.emission[7]}"
    (row,) = np.flatnonzero(made.residuals.rejected)
    assert made.residuals.emission[row] == entry["emission"]
    assert made.residuals.sensor[row] == name


def test_platforms_are_where_fixes_and_measurements_put_them():
    track, made = solved_track.track("platforms"), solved_track.of("platforms")
    assert [path.sensor for path in made.platforms] == list(track.recording.sensor_names)
    for place, path in zip(made.sensors, made.platforms, strict=True):
        np.testing.assert_array_equal(path.time_s, track.time_s)
        offset = [
            track.sensor_errors[path.sensor][f"position_{axis}"].estimate for axis in ("x", "y")
        ]
        inside = (place.time_s >= path.time_s[0]) & (place.time_s <= path.time_s[-1])
        estimate, velocity = path.knots().at(place.time_s[inside])
        error = (place.position_m[inside] - estimate)[:, :2] + offset
        # 60 fixes of 2 m on each axis leave a path of a few free numbers: their mean square is
        # within 5 standard errors, sqrt(2 / 120), of that of the noise less what the path took up.
        assert 0.5 * 4.0 < np.mean(error**2) < 1.5 * 4.0
        assert abs(error.mean(axis=0)).max() < 5.0 * 2.0 / np.sqrt(60)
        np.testing.assert_allclose(np.linalg.norm(velocity[:, :2], axis=1), 50.0, rtol=0.05)
        # The constant offset, 1 m and hardly observable, is part of the place's uncertainty.
        sigma = np.sqrt(path.position_covariance_m2[:, [0, 1], [0, 1]])
        assert ((sigma > 0.5) & (sigma < 2.5)).all()


def test_platform_covariance_is_that_of_the_sum_of_path_and_offset():
    track, made = solved_track.track("platforms"), solved_track.of("platforms")
    problem, knot, path = track.problem, 3, made.platforms[1]
    size, first = track.state.shape[1], problem.states.platform_column[1]
    columns = [problem.states.bias_column[1, 3 + axis] for axis in range(3)]
    rows = size + first + np.arange(3)
    # The joint covariance of both, block by block, and the sum of both.
    joint = np.block(
        [
            [
                track.marginals.knots[knot][np.ix_(rows, rows)],
                track.marginals.knot_constants[knot][np.ix_(rows, columns)],
            ],
            [
                track.marginals.knot_constants[knot][np.ix_(rows, columns)].T,
                track.marginals.constants[np.ix_(columns, columns)],
            ],
        ]
    )
    adds = np.hstack(
        [np.diag(problem.walk_scale[first : first + 3]), np.diag(problem.states.sigma[columns])]
    )
    np.testing.assert_allclose(path.position_covariance_m2[knot], adds @ joint @ adds.T, rtol=1e-9)


def test_frequency_errors_that_drift_have_curves():
    made = solved_track.of("satellites")
    (curve,) = made.curves
    assert (curve.sensor, curve.kind, curve.unit) == ("S2", "frequency", "Hz")
    # Offset 2 Hz and drift 0.01 Hz/s over 240 s.
    assert curve.prior_sigma[0] == pytest.approx(2.0)
    assert curve.prior_sigma[-1] == pytest.approx(np.hypot(2.0, 2.4), rel=1e-3)
    states = {error.state: error for error in made.errors}
    drift = states["frequency_drift"]
    assert (curve.estimate[-1] - curve.estimate[0]) == pytest.approx(
        drift.estimate * np.ptp(curve.time_s)
    )
    assert drift.unit == "Hz/s"


def test_a_sensor_that_measured_nothing_has_no_curve():
    recording = solved_track.RECORDINGS["aircraft"]()
    name = recording.sensor_names[1]
    idle = dataclasses.replace(recording.sensors[name], name="idle")
    sensors = {**recording.sensors, "idle": idle}
    track = solved_track.solved(dataclasses.replace(recording, sensors=sensors))
    made = results.from_track(track)
    assert {curve.sensor for curve in made.curves} == set(recording.sensor_names[1:])
    assert "idle" in {place.sensor for place in made.sensors}


def test_text_of_a_far_emitter_tells_ellipse_and_circle(tmp_path):
    made = solved_track.of("far emitter")
    facts = dict(static_facts(made))
    covariance = made.position_covariance_m2[0, :2, :2]
    major = np.sqrt(np.linalg.eigvalsh(covariance)[1])
    assert facts["1-sigma ellipse"].startswith(f"{rounded(major)} x ")
    # The emitter is at (9, 100) km, the sensors about (4, 1): ranges are what is badly known.
    angle = float(facts["its major axis"].split("°")[0])
    assert angle == pytest.approx(np.degrees(np.arctan2(99.25, 5.0)), abs=2.0)
    miss = np.linalg.norm(made.position_m[0, :2] - [9e3, 100e3])
    assert facts["off the truth"] == f"{rounded(miss)} m over ground"
    # In one unit, for comparison.
    sigma = np.sqrt(np.diag(covariance))
    assert facts["1 sigma"] == f"x {rounded(sigma[0])} m, y {rounded(sigma[1])} m"
    text = results_text(made, tmp_path)
    assert "1-sigma ellipse" in text
    assert "sigma x" not in text
    # Half of the probability of a long ellipse lies within 0.6745 major sigmas.
    circle = float(facts["CEP (50 %)"].removesuffix(" m"))
    assert circle == pytest.approx(0.6745 * major, rel=0.02)


def test_facts_on_the_earth_have_latitude_and_azimuth():
    made = solved_track.of("satellites")
    facts = dict(static_facts(made))
    latitude, longitude, _ = made.geodetic()[0]
    assert facts["position"] == place_text(latitude, longitude)
    covariance = enu_axes(made.position_m[0]) @ made.position_covariance_m2[0]
    covariance = (covariance @ enu_axes(made.position_m[0]).T)[:2, :2]
    east, north = np.linalg.eigh(covariance)[1][:, 1]
    azimuth = np.degrees(np.arctan2(east, north)) % 180.0
    assert facts["its major axis"] == f"azimuth {azimuth:.1f}°"
    assert set(facts) >= {"height", "1 sigma", "95 % ellipse"}


def test_facts_of_what_is_not_determined_leave_the_ellipse_out():
    made = solved_track.of("far emitter")
    lost = dataclasses.replace(made, position_covariance_m2=np.full((1, 3, 3), np.inf), truth=None)
    assert set(dict(static_facts(lost))) == {"position", "1 sigma"}


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (1234.5, 3, "1230"),
        (0.0123456, 3, "0.0123"),
        (99.96, 3, "100"),
        (999.6, 3, "1000"),
        (2.5e-7, 3, "0.00000025"),
        (360.4, 2, "360"),
        (0.0, 3, "0"),
        (np.inf, 3, "inf"),
        (2.5e7, 3, "2.5e+07"),
    ],
)
def test_numbers_have_no_powers_of_ten(value, digits, text):
    assert rounded(value, digits) == text


def test_sensor_tables_have_scaled_units_and_fit_the_width(tmp_path):
    text = results_text(solved_track.of("microphones"), tmp_path)
    assert "clock offset (ms)" in text
    assert "position x (mm)" in text
    assert "propagation speed off by " in text
    assert "(recording)" not in text
    pairs = results_text(solved_track.of("satellites"), tmp_path)
    assert "as reference" in pairs
    assert max(map(len, pairs.splitlines())) <= 120
    # Too many errors for one line: a second table, with the sensors' names again.
    assert pairs.count("\nsensor ") == 2
    fixes = results_text(solved_track.of("straight platforms"), tmp_path)
    assert "paths of 4 sensors estimated from their fixes" in fixes


def test_an_object_at_rest_is_compared_at_all_times_however_many_knots(tmp_path):
    made = solved_track.of("straight platforms")
    assert made.time_s.size > 1
    results.save(made, tmp_path / "out", pictures=False)
    truth = Truth(time_s=np.array([-1e6]), position_m=np.array([[9e3, 100e3, 0.0]]))
    lone = tmp_path / "track.csv"
    lone.write_bytes((tmp_path / "out" / names.TRACK).read_bytes())
    miss = np.linalg.norm(made.position_m[0] - truth.position_m[0])
    for path in (made, read_path(tmp_path / "out"), read_path(lone)):
        found = compare(path, truth)
        assert found.outside == 0
        assert found.figures()["position_m"]["rmse"] == pytest.approx(miss)


def test_a_given_height_does_not_count_in_the_nees(tmp_path):
    made = solved_track.of("far emitter")
    found = compare(made, made.truth)
    error = (made.position_m[0] - made.truth.position_m[0])[:2]
    expected = error @ np.linalg.solve(made.position_covariance_m2[0, :2, :2], error)
    np.testing.assert_allclose(found.nees, expected, rtol=1e-6)
    figures = found.figures()["nees"]
    assert figures["expected"] == 2.0
    # Quantiles of chi-square with two degrees of freedom: -2 ln(0.995), -2 ln(0.005).
    assert figures["band_99"] == pytest.approx([0.01002508, 10.596635], rel=1e-6)
    results.save(made, tmp_path / "out", pictures=False)
    read = compare(read_path(tmp_path / "out"), read_truth(tmp_path / "out"))
    assert read.figures() == found.figures()


def test_truth_of_one_row_is_compared_where_the_path_covers_it():
    made = solved_track.of("aircraft")
    time = made.time_s[4:5]
    true = Truth(time_s=time, position_m=made.position_m[4:5] + enu_axes(made.position_m[4])[2])
    found = compare(made, true).figures()
    assert found["points"] == 1
    assert found["components_m"]["up"]["mean"] == pytest.approx(-1.0)
