"""Results in the formats of other programs, read back by independent readers and validators."""

from __future__ import annotations

import json
import sys
from datetime import UTC, datetime

import numpy as np
import pytest
from made_pass import utc
from made_track import make_track

import geograph as gg
from geograph import export, results
from geograph.errors import InputError
from geograph.export.czml import ellipsoid_poses
from geograph.export.geojson import cut_line, cut_ring
from geograph.geodesy import ecef_from_geodetic, enu_axes


@pytest.fixture(scope="module")
def made():
    return results.from_track(make_track(moving=True))


def at(latitude, longitude, *, sigma_m=(300.0, 100.0, 50.0), knots=5, step_deg=0.1):
    """Return made results that move east from a place, with ellipses of given size."""
    base = results.from_track(make_track(knots=knots, order=2))
    position = ecef_from_geodetic(
        np.full(knots, latitude), longitude + step_deg * np.arange(knots), np.full(knots, 1e4)
    )
    axes = enu_axes(position)
    covariance = np.swapaxes(axes, 1, 2) @ np.diag(np.square(sigma_m)) @ axes
    fields = {name: getattr(base, name) for name in base.__dataclass_fields__}
    fields |= {"position_m": position, "position_covariance_m2": covariance}
    fields |= {"velocity_m_s": np.zeros((knots, 3))}
    return results.Results(**fields)


def test_oem_is_read_back_by_others(made, tmp_path):
    oem = pytest.importorskip("oem")
    path = tmp_path / "a.oem"
    export.write_oem(made, path, object_name="FIREBALL", object_id="2021-000A")
    message = oem.OrbitEphemerisMessage.open(path)
    (segment,) = message.segments
    metadata = {name: segment.metadata[name] for name in ("REF_FRAME", "TIME_SYSTEM", "OBJECT_ID")}
    assert metadata == {"REF_FRAME": "ITRF2000", "TIME_SYSTEM": "UTC", "OBJECT_ID": "2021-000A"}
    start = np.datetime64("2021-02-28T21:54:00", "ns")
    states, covariances = list(segment.states), list(segment.covariances)
    assert len(states) == len(covariances) == made.time_s.size
    for row, (state, covariance) in enumerate(zip(states, covariances, strict=True)):
        seconds = (state.epoch.datetime64.astype("datetime64[ns]") - start).astype(np.int64) / 1e9
        assert seconds == pytest.approx(made.time_s[row], abs=2e-9)
        assert covariance.epoch == state.epoch
        np.testing.assert_allclose(state.position * 1e3, made.position_m[row], rtol=1e-14)
        np.testing.assert_allclose(state.velocity * 1e3, made.velocity_m_s[row], rtol=1e-14)
        np.testing.assert_allclose(
            covariance.matrix * 1e6, made.motion_covariance[row], rtol=1e-12, atol=1e-12
        )


def test_oem_is_read_by_ccsds_ndm(made, tmp_path):
    ndm = pytest.importorskip("ccsds_ndm.ndm_io")
    path = tmp_path / "a.oem"
    export.write_oem(made, path, created=datetime(2024, 1, 2, 3, 4, 5, tzinfo=UTC))
    assert "CREATION_DATE = 2024-01-02T03:04:05\n" in path.read_text()
    message = ndm.NdmIo().from_path(path)
    (segment,) = message.body.segment
    assert segment.metadata.ref_frame == "ITRF2000"
    assert segment.metadata.start_time.startswith("2021-02-28T21:54:00")
    state = segment.data.state_vector[-1]
    assert float(state.x.value) * 1e3 == pytest.approx(made.position_m[-1, 0], rel=1e-14)
    covariance = segment.data.covariance_matrix[-1]
    assert float(covariance.cy_x.value) * 1e6 == pytest.approx(
        made.motion_covariance[-1, 1, 0], rel=1e-12
    )
    assert float(covariance.cz_dot_z_dot.value) * 1e6 == pytest.approx(
        made.motion_covariance[-1, 5, 5], rel=1e-12
    )


def test_oem_is_a_trajectory_again(made, tmp_path):
    from geograph.io.instants import from_datetime
    from geograph.io.oem import read_oem

    export.write_oem(made, tmp_path / "a.oem")
    epoch = from_datetime(datetime(2021, 2, 28, 21, 54, tzinfo=UTC))
    back = read_oem(tmp_path / "a.oem", epoch, (0.0, 8.0))
    np.testing.assert_allclose(back.time_s, made.time_s, atol=2e-9)
    np.testing.assert_allclose(back.position_m, made.position_m, rtol=1e-14)


def test_what_an_ephemeris_cannot_hold(tmp_path):
    path = tmp_path / "a.oem"
    with pytest.raises(InputError, match="cannot hold a path without velocity"):
        export.write_oem(make_track(order=1), path)
    old = results.from_track(make_track(order=2))
    object.__setattr__(old, "motion_covariance", None)
    with pytest.raises(InputError, match=r"needs the covariance of velocity.*smooth.*again"):
        export.write_oem(old, path)
    lost = make_track(order=2)
    lost.covariance[3, 4, 4] = np.inf
    with pytest.raises(InputError, match=r"cannot hold the covariance at 0.615384615 s"):
        export.write_oem(lost, path)
    lost = make_track(order=2)
    lost.position_m[3, 1] = np.nan
    for suffix in (".oem", ".kml", ".czml", ".geojson"):
        with pytest.raises(InputError, match=r"cannot hold the path of .* at 0.615384615 s, which"):
            export.write(lost, tmp_path / f"a{suffix}")
    with pytest.raises(InputError, match=r"with the name 'Météore'; expected plain"):
        export.write_oem(make_track(name="Météore"), path)
    for suffix in (".oem", ".kml", ".czml", ".geojson"):
        with pytest.raises(InputError, match="in a local frame and has no place on the Earth"):
            export.write(make_track(frame="local"), tmp_path / f"a{suffix}")
    with pytest.raises(InputError, match=r"ends in '.doc'; expected one of .oem, .geojson"):
        export.write(make_track(), tmp_path / "a.doc")
    assert not list(tmp_path.iterdir())


def test_an_object_at_rest(tmp_path):
    track = make_track(order=1)
    track.summary["motion"] = "static"
    for suffix in export.SUFFIXES:
        export.write(track, tmp_path / f"a{suffix}")
    oem = pytest.importorskip("oem")
    states = list(oem.OrbitEphemerisMessage.open(tmp_path / "a.oem").segments[0].states)
    assert len(states) == 2
    assert not np.any(states[0].velocity)
    packets = json.loads((tmp_path / "a.czml").read_text())
    assert len(packets[1]["position"]["cartesian"]) == 3
    kinds = [f["properties"]["kind"] for f in json.loads((tmp_path / "a.geojson").read_text())[
        "features"]]  # fmt: skip
    assert kinds[:2] == ["position", "ellipse"]


def geojson(written, tmp_path):
    pydantic = pytest.importorskip("geojson_pydantic")
    export.write_geojson(written, tmp_path / "a.geojson")
    text = (tmp_path / "a.geojson").read_text()
    pydantic.FeatureCollection.model_validate_json(text)
    return json.loads(text)["features"]


def rings_of(feature):
    shape = feature["geometry"]
    polygons = [shape["coordinates"]] if shape["type"] == "Polygon" else shape["coordinates"]
    return [np.array(ring) for polygon in polygons for ring in polygon]


def area(ring):
    """Return the signed area in square degrees: positive anticlockwise."""
    x, y = ring[:, 0], ring[:, 1]
    return 0.5 * float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


def test_geojson(made, tmp_path):
    features = geojson(made, tmp_path)
    path = np.array(features[0]["geometry"]["coordinates"])
    geodetic = made.geodetic()
    np.testing.assert_allclose(path[[0, -1]], geodetic[[0, -1]][:, [1, 0, 2]], atol=1e-3)
    assert len(features[0]["properties"]["times"]) == len(path)
    assert features[0]["properties"]["start"] == "2021-02-28T21:54:00.000Z"
    ellipses = [f for f in features if f["properties"]["kind"] == "ellipse"]
    assert len(ellipses) == made.time_s.size
    sensors = [f["properties"]["name"] for f in features if f["properties"]["kind"] == "sensor"]
    assert sensors == [sensor.sensor for sensor in made.sensors]
    # Each corner is at the 95 % quantile of the horizontal covariance: 5.991 with 2 dimensions.
    row = 7
    ring = rings_of(ellipses[row])[0]
    assert area(ring) > 0.0
    corners = ecef_from_geodetic(ring[:, 1], ring[:, 0], ring[:, 2])
    level = (corners - made.position_m[row]) @ made.level_axes()[row].T
    inverse = np.linalg.inv(made.level_covariance_m2()[row][:2, :2])
    square = np.einsum("ni,ij,nj->n", level[:, :2], inverse, level[:, :2])
    np.testing.assert_allclose(square, 5.991, rtol=2e-3)


def test_geojson_over_the_antimeridian(tmp_path):
    features = geojson(at(10.0, 179.85), tmp_path)
    line = features[0]["geometry"]
    assert line["type"] == "MultiLineString"
    west, east = (np.array(part) for part in line["coordinates"])
    assert (west[0, 0], west[-1, 0], east[0, 0]) == (179.85, 180.0, -180.0)
    assert east[-1, 0] == pytest.approx(-179.75)
    np.testing.assert_allclose(west[-1, 1:], east[0, 1:])
    for feature in geojson(at(10.0, 179.999, step_deg=1e-4), tmp_path):
        for ring in rings_of(feature) if feature["properties"]["kind"] == "ellipse" else []:
            assert np.abs(ring[:, 0]).max() <= 180.0
            assert np.ptp(ring[:, 0]) < 1.0
            assert area(ring) > 0.0
            assert (ring[0] == ring[-1]).all()


def test_a_cut_ring_has_the_area_of_the_whole(tmp_path):
    whole = rings_of(geojson(at(10.0, 100.0), tmp_path)[1])
    cut = rings_of(geojson(at(10.0, 180.001), tmp_path)[1])
    assert (len(whole), len(cut)) == (1, 2)
    assert sum(map(area, cut)) == pytest.approx(area(whole[0]), rel=1e-6)


@pytest.mark.parametrize("latitude", [90.0, -90.0])
def test_a_ring_around_a_pole(tmp_path, latitude):
    turn = np.linspace(0.0, 360.0, 73) - 180.0
    ring = np.stack([np.full(73, 0.99 * latitude), turn, np.zeros(73)], axis=1)
    ring = ring if latitude > 0.0 else ring[::-1]
    (closed,) = cut_ring(ring)
    lonlat = closed[:, [1, 0]]
    assert area(lonlat) == pytest.approx(360.0 * 0.9, rel=1e-9)
    assert np.abs(closed[:, 0]).max() == 90.0
    features = geojson(at(latitude * 0.9999999, 0.0), tmp_path)
    assert all(area(r) > 0.0 for f in features[1:6] for r in rings_of(f))


def test_lines_that_only_touch_the_meridian():
    east = np.array([[0.0, 179.0, 0.0], [0.0, 180.0, 0.0]])
    assert len(cut_line(east)) == 1
    through = np.array([[0.0, 179.0, 0.0], [0.0, 180.0, 0.0], [0.0, -179.0, 0.0]])
    assert [part[:, 1].tolist() for part in cut_line(through)] == [[179, 180], [-180, -179]]
    back = np.array([[0.0, 179.0, 0.0], [0.0, 180.0, 0.0], [1.0, 179.0, 0.0]])
    assert len(cut_line(back)) == 1
    far = np.array([[0.0, 170.0, 0.0], [5.0, -170.0, 0.0], [5.0, 170.0, 0.0]])
    assert [len(part) for part in cut_line(far)] == [2, 3, 2]


def test_kml_against_its_schema(made, tmp_path):
    fastkml = pytest.importorskip("fastkml")
    lxml = pytest.importorskip("lxml.etree")
    from fastkml.validator import get_schema_parser

    export.write_kml(made, tmp_path / "a.kml")
    tree = lxml.parse(tmp_path / "a.kml")
    schema = get_schema_parser()
    assert schema.validate(tree), schema.error_log
    space = {"k": "http://www.opengis.net/kml/2.2", "gx": "http://www.google.com/kml/ext/2.2"}
    names = tree.xpath("//k:Folder/k:name/text()", namespaces=space)
    assert names == ["path", "ground track", "ellipses", "sensors"]
    when = tree.xpath("//gx:Track/k:when/text()", namespaces=space)
    coordinates = tree.xpath("//gx:Track/gx:coord/text()", namespaces=space)
    assert len(when) == len(coordinates) > 40
    assert (when[0], when[-1]) == ("2021-02-28T21:54:00.000Z", "2021-02-28T21:54:08.000Z")
    last = [float(value) for value in coordinates[-1].split()]
    np.testing.assert_allclose(last, made.geodetic()[-1][[1, 0, 2]], atol=1e-3)
    begins = tree.xpath("//k:TimeSpan/k:begin/text()", namespaces=space)
    ends = tree.xpath("//k:TimeSpan/k:end/text()", namespaces=space)
    assert len(begins) == made.time_s.size
    assert begins[1:] == ends[:-1]
    assert fastkml.KML.parse(tmp_path / "a.kml").features
    export.write_kml(at(10.0, 179.999, step_deg=1e-4), tmp_path / "c.kml")
    cut = lxml.parse(tmp_path / "c.kml")
    assert schema.validate(cut), schema.error_log
    # The ellipses and the lines lie on both sides of the 180th meridian, each part on its own.
    texts = cut.xpath("//k:MultiGeometry/*//k:coordinates/text()", namespaces=space)
    assert len(texts) >= 4
    for text in texts:
        assert np.ptp([float(point.split(",")[0]) for point in text.split()]) < 1.0
    strange = make_track(name="A < B & \x07 'C'")
    export.write_kml(strange, tmp_path / "b.kml")
    assert schema.validate(lxml.parse(tmp_path / "b.kml")), schema.error_log


def test_czml_against_its_model(made, tmp_path):
    czml3 = pytest.importorskip("czml3")
    export.write_czml(made, tmp_path / "a.czml")
    packets = json.loads((tmp_path / "a.czml").read_text())
    for packet in packets:
        czml3.Packet.model_validate(packet)
    document, moving, *sensors = packets
    assert document["clock"]["interval"] == "2021-02-28T21:54:00.000Z/2021-02-28T21:54:08.000Z"
    assert [sensor["name"] for sensor in sensors] == [s.sensor for s in made.sensors]
    samples = np.array(moving["position"]["cartesian"]).reshape(-1, 4)
    np.testing.assert_allclose(samples[-1, 1:], made.position_m[-1], atol=1e-3)
    # At every knot the ellipsoid is the covariance again.
    radii = np.array(moving["ellipsoid"]["radii"]["cartesian"]).reshape(-1, 4)
    turns = np.array(moving["orientation"]["unitQuaternion"]).reshape(-1, 5)
    quantile = 7.814727903251179
    for row in (0, 11, 39):
        x, y, z, w = turns[row, 1:]
        matrix = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        found = matrix @ np.diag(radii[row, 1:] ** 2 / quantile) @ matrix.T
        np.testing.assert_allclose(found, made.position_covariance_m2[row], rtol=1e-4, atol=1e-2)


def test_an_ellipsoid_whose_axes_change_places_does_not_tumble():
    angle = np.linspace(0.0, np.pi, 41)
    spread = np.stack([3.0 + np.cos(angle), 3.0 - np.cos(angle), np.full(41, 1.0)], axis=1)
    covariance = np.einsum("ni,ij->nij", spread**2, np.eye(3))
    radii, quaternions = ellipsoid_poses(np.zeros((41, 3)), covariance)
    np.testing.assert_allclose(quaternions, np.tile(quaternions[0], (41, 1)), atol=1e-9)
    assert np.abs(np.diff(radii, axis=0)).max() < 0.5
    np.testing.assert_allclose(radii / np.sqrt(7.814727903251179), spread, rtol=1e-9)


def test_tables(made, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    frame = export.to_pandas(made)
    assert list(frame.columns[:3]) == ["time_s", "time_utc", "x_m"]
    assert frame["time_utc"][0].isoformat() == "2021-02-28T21:54:00+00:00"
    assert frame.attrs["frame"] == "ecef"
    export.write_parquet(made, tmp_path / "a.parquet")
    table = parquet.read_table(tmp_path / "a.parquet")
    assert json.loads(table.schema.metadata[b"geograph"])["status"] == "converged"
    assert table.column_names == list(frame.columns)
    for name in ("x_m", "cov_yz_m2", "cov_z_vx_m2_s"):
        np.testing.assert_array_equal(table[name].to_numpy(), frame[name].to_numpy())
    export.write(make_track(frame="local"), tmp_path / "b.parquet")
    assert "time_utc" not in parquet.read_table(tmp_path / "b.parquet").column_names


def test_xarray(made, monkeypatch):
    pytest.importorskip("xarray")
    dataset = export.to_xarray(made)
    np.testing.assert_array_equal(dataset["position"].sel(axis="y"), made.position_m[:, 1])
    np.testing.assert_array_equal(
        dataset["position_covariance"].sel(axis="x", axis_2="z"),
        made.position_covariance_m2[:, 0, 2],
    )
    assert dataset["velocity"].attrs["units"] == "m s-1"
    assert str(dataset["time_utc"].values[0])[:19] == utc(0.0)[:0] + "2021-02-28T21:54:00"
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(InputError, match=r"pip install 'geograph\[xarray\]'"):
        export.to_xarray(made)


def test_nothing_partial_is_left(made, tmp_path, monkeypatch):
    path = tmp_path / "a.kml"
    path.write_text("old")
    monkeypatch.setattr("geograph.export.kml._sensors", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        export.write_kml(made, path)
    assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.kml"]
    assert gg.InputError is InputError
