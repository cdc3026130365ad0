"""Sensors against the stars, from reading to the estimate: what was made elsewhere comes back."""

from dataclasses import replace

import feeding
import numpy as np
import pytest
from made_pass import STATIONS, ecef

import geograph as gg
from geograph.errors import InputError
from geograph.sensors import Sensor, SensorErrors, Trajectory

pytest.importorskip("astropy")
from made_sky import EPOCH, circle, earth_fixed_from_gcrs, sky_pass

ARCSEC = np.pi / 648000.0


@pytest.fixture(scope="module")
def exact():
    return sky_pass()


@pytest.fixture(scope="module")
def noisy():
    errors = SensorErrors(azimuth_bias_rad=2e-4, elevation_bias_rad=2e-4, clock_offset_s=0.05)
    return sky_pass(noise=5e-6, sigma_rad=5e-6, errors=errors, seed=3)


def _on_sky(track, sigma_rad):
    """Return the largest residual on the sky, radians."""
    return np.abs(track.residuals.normalised).max() * sigma_rad


def miss(track, recording):
    return track.at(recording.truth.time_s).position_m - recording.truth.position_m


def test_the_axes_are_those_of_astropy():
    """Rotations of IAU 2006 and the Earth's orientation, against astropy's own frames."""
    from geograph.earth import CelestialAxes

    time = np.array([-9e6, -3e4, 0.0, 3333.0, 7.7e6])
    axes, _ = CelestialAxes(EPOCH).at(time)
    for row in range(3):
        # Far away, where the Earth's motion and the bending of light are not asked about.
        given = np.tile(np.eye(3)[row] * 1e7, (time.size, 1))
        expected = earth_fixed_from_gcrs(given, time) / 1e7
        np.testing.assert_allclose(axes[:, row], expected, rtol=0.0, atol=3e-10)


def test_directions_without_noise_give_the_path(exact):
    track = gg.smooth(exact)
    assert track.summary["status"] == "converged"
    # The Sun's bending of starlight (5 mas), which was not made; aberration would leave 20".
    assert _on_sky(track, 5e-7) < 0.02 * ARCSEC
    assert np.linalg.norm(miss(track, exact), axis=1).max() < 0.3
    # What is reported is what was measured, on the axes of the ICRS.
    table = exact.bearings
    measured = track.residuals.measured[track.residuals.kind == "azimuth"]
    np.testing.assert_array_equal(np.sort(measured), np.sort(table.azimuth_rad))


def test_biases_on_the_sky_and_clocks_come_back(noisy):
    rng = np.random.default_rng(8)
    bias, late = 2e-4 * rng.normal(size=(2, 3)), np.array([0.0, 0.06, -0.04])
    table = noisy.bearings
    moved = replace(
        table,
        time_s=table.time_s + late[table.sensor],
        azimuth_rad=table.azimuth_rad + bias[0][table.sensor],
        elevation_rad=table.elevation_rad + bias[1][table.sensor],
    )
    first = noisy.sensors["Alpha"]
    sensors = noisy.sensors | {
        "Alpha": replace(first, errors=replace(first.errors, clock_offset_s=0.0))
    }
    given = replace(noisy, bearings=moved, sensors=sensors)
    track = gg.smooth(given)
    for index, name in enumerate(STATIONS):
        for key, value in (
            ("azimuth_bias", bias[0][index]),
            ("elevation_bias", bias[1][index]),
            ("clock_offset", late[index]),
        ):
            if key == "clock_offset" and index == 0:
                continue
            found = track.sensor_errors[name][key]
            assert abs(found.estimate - value) < 4.0 * found.sigma
            assert found.sigma < 1.01 * found.prior_sigma
    assert track.sensor_errors["Bravo"]["clock_offset"].sigma < 0.03
    # 60 times of three coordinates of one path: 4 sigma is passed once in a thousand such runs.
    error = miss(track, given)
    covariance = track.at(given.truth.time_s).position_covariance_m2
    nees = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    assert nees.max() < 25.0


def test_live_and_bound_agree_with_the_batch(noisy):
    batch = gg.smooth(noisy)
    smoother = feeding.feed(gg.IncrementalSmoother.of(noisy), noisy, every=5)
    sigmas, relative = feeding.differences(smoother.track(), batch)
    assert sigmas < 0.05
    assert relative < 0.05
    found = gg.bound(noisy)
    assert found.sigma_height_m[0] > 0.0
    near = batch.at(found.time_s).position_covariance_m2
    np.testing.assert_allclose(
        np.sqrt(np.trace(found.covariance[:, :3, :3], axis1=1, axis2=2)),
        np.sqrt(np.trace(near, axis1=1, axis2=2)),
        rtol=0.05,
    )


def test_a_telescope_in_orbit():
    """Stars seen from a satellite: its own aberration is theirs, and so drops out."""
    time = np.arange(-20.0, 141.0, 5.0)
    angle = 1.05e-3 * time + 0.2
    u = ecef(45.0, 20.0, 0.0) / np.linalg.norm(ecef(45.0, 20.0, 0.0))
    v = np.cross([0.0, 0.0, 1.0], u) / np.linalg.norm(np.cross([0.0, 0.0, 1.0], u))
    path = 7.6e6 * (np.outer(np.cos(angle), u) + np.outer(np.sin(angle), v))
    sensors = {
        "Watcher": Sensor(name="Watcher", trajectory=Trajectory(time, path), axes="radec"),
        "Ground": Sensor(name="Ground", position_m=ecef(*STATIONS["Bravo"]), axes="radec"),
    }
    made = sky_pass(sensors=sensors)
    track = gg.smooth(made)
    assert _on_sky(track, 5e-7) < 0.02 * ARCSEC
    assert np.linalg.norm(miss(track, made), axis=1).max() < 1.0


def test_written_and_read_back(exact, tmp_path):
    gg.write(exact, tmp_path / "sky")
    found = gg.read(tmp_path / "sky")
    assert found.sensors["Alpha"].axes == "radec"
    np.testing.assert_array_equal(found.bearings.azimuth_rad, exact.bearings.azimuth_rad)
    assert found.epoch == EPOCH


HEADER = """format = 1
frame = "ecef"
epoch = 2024-03-20T19:04:00Z
[sensors.A]
geodetic = [52.1, 4.4, 20.0]
axes = "radec"
"""
ROWS = "time_s,sensor,azimuth_deg,elevation_deg,sigma_deg\n1,A,120.5,30,0.001\n2,A,121,31,0.001\n"
BAD = {
    "local frame": (
        HEADER.replace('"ecef"', '"local"').replace("geodetic = [52.1, 4.4, 20.0]",
                                                    "position_m = [0, 0, 0]"),
        ROWS,
        r"toml:6.*axes radec need the frame ecef.*given local",
    ),
    "refraction": (
        HEADER + 'refraction = "standard"\n', ROWS, r"refraction needs axes enu; given axes radec"
    ),
    "no declination": (
        HEADER, ROWS.replace(",31,", ",,"),
        r"bearings.csv:3, column elevation_deg: empty cell; expected a declination",
    ),
    "no declinations": (
        HEADER, "time_s,sensor,azimuth_deg,sigma_deg\n1,A,120.5,0.001\n",
        r"bearings.csv:2, column elevation_deg: column is missing; expected a declination",
    ),
    "time": (
        HEADER, ROWS.replace("\n2,", "\n2e9,"),
        r"bearings.csv:3, column time_s: 2000000000; after 2024-03-20T19:04:00Z, for which the "
        r"tables of Earth orientation",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", list(BAD))
def test_what_is_wrong_is_said(tmp_path, case):
    header, rows, expected = BAD[case]
    (tmp_path / "recording.toml").write_text(header)
    (tmp_path / "bearings.csv").write_text(rows)
    with pytest.raises(InputError, match=expected) as caught:
        gg.read(tmp_path)
    assert "\n" not in str(caught.value)


def test_a_table_in_python_is_told_of_unknown_times(exact):
    table = replace(exact.bearings, time_s=exact.bearings.time_s + 3e9)
    with pytest.raises(InputError, match=r"holds a time on 2119-.*update astropy-iers-data"):
        gg.smooth(replace(exact, bearings=table, truth=None))


def test_circle_stays_in_view():
    """The made satellite is above all stations, or nothing above would mean much."""
    time = np.array([0.0, 118.0])
    at = earth_fixed_from_gcrs(circle(time), time)
    for place in STATIONS.values():
        station = ecef(*place)
        up = station / np.linalg.norm(station)
        assert ((at - station) @ up > 0.0).all()
