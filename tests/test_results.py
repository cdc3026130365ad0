"""Results folders: what is written is read back to the last bit, whole or not at all."""

from __future__ import annotations

import csv
import dataclasses
import json

import numpy as np
import pytest
from made_track import make_track

from geograph import results
from geograph.errors import InputError
from geograph.geodesy import enu_axes, geodetic_from_ecef
from geograph.results import names
from geograph.results.data import ErrorState
from geograph.results.facts import estimate_text
from geograph.results.write import check_target, plain, write_files
from geograph.units import Unit


def same(first, second):
    """Whether two values are equal to the last bit, arrays and dataclasses included."""
    if dataclasses.is_dataclass(first):
        return type(first) is type(second) and all(
            same(getattr(first, f.name), getattr(second, f.name)) for f in dataclasses.fields(first)
        )
    if isinstance(first, np.ndarray):
        numeric = first.dtype.kind == "f"
        return first.shape == second.shape and np.array_equal(first, second, equal_nan=numeric)
    if isinstance(first, tuple):
        return len(first) == len(second) and all(map(same, first, second))
    return first == second


@pytest.mark.parametrize(
    "options",
    [
        {"truth": True},
        {"frame": "local", "order": 2, "drifting": False},
        {"frame": "local", "order": 1, "knots": 1, "outliers": 0},
        {"sensors": 9, "moving": True, "status": "unobservable"},
    ],
    ids=["ecef", "local", "static", "moving"],
)
def test_what_is_written_is_read_back_to_the_last_bit(tmp_path, options):
    made = results.from_track(make_track(**options))
    results.save(made, tmp_path / "out", pictures=False)
    read = results.load(tmp_path / "out")
    for field in dataclasses.fields(made):
        if field.name != "summary":
            assert same(getattr(made, field.name), getattr(read, field.name)), field.name
    assert read.summary == plain(made.summary)


def test_columns_are_those_of_the_format(tmp_path):
    results.save(make_track(), tmp_path / "ecef", pictures=False)
    results.save(make_track(frame="local", order=2), tmp_path / "local", pictures=False)
    head = (tmp_path / "ecef" / names.TRACK).read_text().splitlines()[0]
    assert head == (
        "time_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s,ax_m_s2,ay_m_s2,az_m_s2,"
        "cov_xx_m2,cov_xy_m2,cov_xz_m2,cov_yy_m2,cov_yz_m2,cov_zz_m2,"
        "latitude_deg,longitude_deg,height_m,semi_major_m,semi_middle_m,semi_minor_m,"
        "speed_m_s,sigma_speed_m_s,"
        "cov_x_vx_m2_s,cov_x_vy_m2_s,cov_x_vz_m2_s,cov_y_vx_m2_s,cov_y_vy_m2_s,cov_y_vz_m2_s,"
        "cov_z_vx_m2_s,cov_z_vy_m2_s,cov_z_vz_m2_s,cov_vx_vx_m2_s2,cov_vx_vy_m2_s2,"
        "cov_vx_vz_m2_s2,cov_vy_vy_m2_s2,cov_vy_vz_m2_s2,cov_vz_vz_m2_s2"
    )
    local = (tmp_path / "local" / names.TRACK).read_text().splitlines()[0].split(",")
    assert not {"latitude_deg", "longitude_deg", "height_m", "ax_m_s2"}.intersection(local)
    sensors = (tmp_path / "ecef" / names.SENSORS).read_text().splitlines()[0]
    assert sensors == "sensor,state,unit,estimate,sigma,prior_sigma"


def test_track_table_agrees_with_the_track(tmp_path):
    track = make_track()
    results.save(track, tmp_path / "out", pictures=False)
    with (tmp_path / "out" / names.TRACK).open() as file:
        rows = list(csv.DictReader(file))
    row, knot = rows[7], 7
    place = geodetic_from_ecef(track.position_m[knot])
    columns = ("latitude_deg", "longitude_deg", "height_m")
    assert [float(row[name]) for name in columns] == place.tolist()
    velocity = track.velocity_m_s[knot]
    speed = np.linalg.norm(velocity)
    assert float(row["speed_m_s"]) == speed
    variance = velocity @ track.covariance[knot, 3:6, 3:6] @ velocity / speed**2
    assert float(row["sigma_speed_m_s"]) == pytest.approx(np.sqrt(variance), rel=1e-12)
    # The greatest semi-axis of 95 % is 2.7955 standard deviations: chi-square, 3 degrees, 7.8147.
    greatest = np.sqrt(np.linalg.eigvalsh(track.position_covariance_m2[knot])[-1])
    assert float(row["semi_major_m"]) == pytest.approx(2.795483 * greatest, rel=1e-6)


def test_level_covariance_is_that_of_east_north_up():
    made = results.from_track(make_track(sigma_m=100.0))
    knot = 3
    turn = enu_axes(made.position_m[knot])
    expected = turn @ made.position_covariance_m2[knot] @ turn.T
    np.testing.assert_allclose(made.level_covariance_m2()[knot], expected, rtol=1e-12)
    assert made.level_covariance_m2()[knot][2, 2] > made.level_covariance_m2()[knot][1, 1]


def test_speed_sigma_at_rest_is_finite():
    track = make_track(frame="local", order=2)
    track.velocity_m_s[:] = 0.0
    assert np.isfinite(results.from_track(track).sigma_speed_m_s).all()


def test_error_curves_are_of_what_changes_only_with_a_growing_prior():
    made = results.from_track(make_track(sensors=3))
    assert {(curve.sensor, curve.kind) for curve in made.curves} == {
        (f"CAM{i:02d}", "azimuth") for i in range(3)
    }
    curve = made.curves[0]
    # Bias 2e-4 and drift 1e-5 a second over 8 seconds.
    assert curve.prior_sigma[0] == pytest.approx(2e-4)
    assert curve.prior_sigma[-1] == pytest.approx(np.hypot(2e-4, 8e-5))
    assert results.from_track(make_track(drifting=False)).curves == ()


def test_summary_holds_settings_versions_and_command(tmp_path):
    made = results.from_track(make_track(), command="geograph smooth made -o out")
    results.save(made, tmp_path / "out", pictures=False)
    summary = json.loads((tmp_path / "out" / names.SUMMARY).read_text())
    assert summary["command"] == "geograph smooth made -o out"
    assert summary["settings"]["process_noise"] == 10.0
    assert summary["epoch"] == "2021-02-28T21:54:00+00:00"
    assert set(summary["versions"]) == {"geograph", "gtsam", "numpy", "scipy", "python"}
    # Infinity has no place in JSON.
    assert summary["first_guess"]["costs"] == [1.0, None]


def test_sensor_errors_beyond_three_prior_sigmas_are_known():
    made = results.from_track(make_track())
    assert ("CAM01", "clock_offset") in {(e.sensor, e.state) for e in made.surprising_errors()}
    assert all(abs(e.estimate) > 3 * e.prior_sigma for e in made.surprising_errors())


def test_save_replaces_old_results_whole(tmp_path):
    folder = tmp_path / "out"
    results.save(make_track(truth=True), folder, pictures=False)
    assert (folder / names.TRUTH).exists()
    results.save(make_track(drifting=False), folder, pictures=False)
    assert {path.name for path in folder.iterdir()} == {
        names.TRACK,
        names.SENSORS,
        names.RESIDUALS,
        names.SUMMARY,
        names.PLACES,
    }


def test_failure_while_writing_leaves_the_old_results(tmp_path, monkeypatch):
    folder = tmp_path / "out"
    results.save(make_track(name="old"), folder, pictures=False)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    def fail(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("geograph.results.write.write_json", fail)
    with pytest.raises(KeyboardInterrupt):
        results.save(make_track(name="new"), folder, pictures=False)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert list(tmp_path.iterdir()) == [folder]


def test_folders_with_other_files_are_refused(tmp_path):
    folder = tmp_path / "out"
    results.save(make_track(), folder, pictures=False)
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"out: holds 'notes\.txt'"):
        results.save(make_track(), folder, pictures=False)
    assert (folder / "notes.txt").read_text() == "mine"


def test_folder_below_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a file; expected a folder"):
        check_target(tmp_path / "file" / "out")


@pytest.fixture
def folder(tmp_path):
    write_files(results.from_track(make_track(truth=True)), tmp_path)
    return tmp_path


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_loading_names_file_line_and_column(folder):
    lines = (folder / names.TRACK).read_text().splitlines()
    lines[3] = "soon," + lines[3].split(",", 1)[1]
    (folder / names.TRACK).write_text("\n".join(lines))
    with pytest.raises(
        InputError, match=r"track\.csv:4, column time_s: is 'soon'; expected a number"
    ):
        results.load(folder)


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        (names.TRACK, "x_m", "x", r"track\.csv:1, column x_m: column is missing"),
        (names.TRACK, "\n0.0,", "\n9.0,", r"track\.csv:3, column time_s: .* greater than in"),
        (names.TRACK, "\n0.0,", "\nnan,", r"track\.csv:2, column time_s: is nan; expected a fin"),
        (names.TRACK, "\n0.0,", "\n", r"track\.csv:2: has 38 fields; expected 39"),
        (names.SENSORS, "sigma", "spread", r"sensors\.csv:1, column sigma: column is missing"),
        (names.TRUTH, "\n0.0,", "\ninf,", r"truth\.csv:2, column time_s: is inf"),
        (names.SUMMARY, '"frame": "ecef"', '"frame": "flat"', "column frame: is 'flat'"),
        (names.SUMMARY, '"status"', '"state"', "column status: key is missing"),
        (names.SUMMARY, "{", "", r"summary\.json: is not JSON"),
    ],
)
def test_damaged_results_are_said_in_one_line(folder, name, old, new, message):
    edit(folder / name, old, new)
    with pytest.raises(InputError, match=message) as caught:
        results.load(folder)
    assert "\n" not in str(caught.value)


def test_missing_and_empty_files_are_named(folder, tmp_path):
    with pytest.raises(InputError, match="is no folder"):
        results.load(tmp_path / "none")
    (folder / names.TRACK).write_text((folder / names.TRACK).read_text().splitlines()[0])
    with pytest.raises(InputError, match=r"track\.csv: has no row"):
        results.load(folder)
    (folder / names.TRACK).write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match=r"track\.csv: is not a CSV file"):
        results.load(folder)
    (folder / names.TRACK).unlink()
    with pytest.raises(InputError, match=r"track\.csv: cannot be read"):
        results.load(folder)


@pytest.mark.parametrize(
    ("estimate", "sigma", "text"),
    [
        (1.00002e-3, 5.7e-8, "+1000.02 ± 0.057"),
        (-1.51589e-1, 3.2e-4, "-151590 ± 320"),
        (-3.35e-8, 5e-8, "-0.0335 ± 0.05"),
        (0.0, 1e-6, "+0 ± 1"),
        (1e-6, 0.0, "+1 ± 0"),
    ],
)
def test_an_estimate_has_the_digits_of_its_sigma(estimate, sigma, text):
    error = ErrorState(
        sensor="A",
        state="clock_offset",
        unit="s",
        estimate=estimate,
        sigma=sigma,
        prior_sigma=1.0,
    )
    assert estimate_text(error, Unit("µs", 1e-6)) == text
