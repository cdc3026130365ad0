"""Rasters of heights: interpolation, tiles, gaps, reference systems, and their derivatives."""

import pickle

import numpy as np
import pytest
import rasterio
from differences import assert_derivative, derivative
from hypothesis import given, settings
from hypothesis import strategies as st
from made_ground import hills, local_terrain, write_tif
from pyproj import Transformer

from geograph.errors import InputError
from geograph.factors.terrain import cubic_convolution, height_above_terrain
from geograph.geodesy import ecef_from_geodetic, geodetic_from_ecef
from geograph.raster import ArrayRaster, FileRaster
from geograph.terrain import Terrain

PROFILE = settings(max_examples=40, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
UTM = "EPSG:32633"
# South of 60 N, 15 E, the middle of UTM zone 33.
WEST, NORTH = 495_000.0, 6_655_000.0


@PROFILE
@given(seeds)
def test_interpolation_derivatives(seed):
    rng = np.random.default_rng(seed)
    patch, place = rng.normal(size=(1, 4, 4)), rng.uniform(-0.5, 1.5, 2)
    _, by_row, by_column = cubic_convolution(patch, place[:1], place[1:])

    def value(at):
        return cubic_convolution(patch, at[:1], at[1:])[0]

    assert_derivative(np.array([by_row[0], by_column[0]]), value, place, [1e-3] * 2, rtol=1e-9)


def test_interpolation_is_exact_for_parabolas_and_smooth_between_cells():
    row, column = np.meshgrid(np.arange(9.0), np.arange(9.0), indexing="ij")
    raster = ArrayRaster(1.0 + row - 2.0 * column + 0.3 * row**2 - 0.2 * row * column + column**2)
    rng = np.random.default_rng(1)
    r, c = rng.uniform(-0.5, 8.5, (2, 200))
    found = raster.sample(r, c)
    np.testing.assert_allclose(
        found.height, 1.0 + r - 2.0 * c + 0.3 * r**2 - 0.2 * r * c + c**2, atol=1e-12
    )
    np.testing.assert_allclose(found.by_row, 1.0 + 0.6 * r - 0.2 * c, atol=1e-12)
    assert found.known.all()
    rough = ArrayRaster(rng.normal(size=(9, 9)))
    at, way = np.arange(1.0, 8.0), rng.uniform(0.0, 8.0, 7)
    low, high = rough.sample(at - 1e-12, way), rough.sample(at + 1e-12, way)
    for name in ("height", "by_row", "by_column"):
        np.testing.assert_allclose(getattr(low, name), getattr(high, name), atol=1e-10)
    whole = rough.sample(at, at)
    np.testing.assert_array_equal(whole.height, np.diag(rough.height_m)[1:8])


def test_beyond_the_edge_it_goes_on_level_and_is_not_known():
    raster = ArrayRaster(np.outer(np.arange(6.0), np.ones(5)) ** 2)
    found = raster.sample(np.array([-3.0, 8.0, 2.0, np.nan]), np.array([2.0, 2.0, 9.0, 0.0]))
    assert not found.known.any()
    edge = raster.sample(np.array([-0.5, 5.5, 2.0]), np.array([2.0, 2.0, 4.5]))
    assert edge.known.all()
    np.testing.assert_array_equal(found.height[:3], edge.height)
    np.testing.assert_array_equal(found.by_row[:2], [0.0, 0.0])
    assert found.by_column[2] == 0.0
    assert np.isfinite(found.height).all()


def test_tiles_of_a_file_are_the_whole_raster(tmp_path):
    rng = np.random.default_rng(2)
    height = np.round(rng.normal(size=(700, 530)) * 100.0)
    height[300:305, 250:260] = -9999.0
    height[600, 20] = 32767.0
    path = write_tif(
        tmp_path / "a.tif", height, west=0, north=700, spacing=1.0, nodata=-9999.0,
        dtype="float32", tiled=True, blockxsize=64, blockysize=64,
    )  # fmt: skip
    raster = FileRaster(path, "a.tif")
    whole = height.copy()
    whole[(whole < -9000) | (whole > 30000)] = np.nan
    r, c = rng.uniform(0.0, [[699.0], [529.0]], (2, 4000))
    # Across the seams of tiles, too.
    r[:500], c[500:1000] = rng.uniform(253.0, 259.0, 500), rng.uniform(509.0, 515.0, 500)
    found = raster.sample(r, c)
    near = np.isnan(whole[np.floor(r).astype(int), np.floor(c).astype(int)])
    for i, j in ((1, 0), (0, 1), (1, 1)):
        near |= np.isnan(whole[np.floor(r).astype(int) + i, np.floor(c).astype(int) + j])
    np.testing.assert_array_equal(found.known, ~near)
    assert 0 < near.sum() < 200
    assert np.isfinite(found.height).all()
    patch_known = np.ones(r.size, dtype=bool)
    padded = np.pad(whole, 2, mode="edge")
    for i in range(-1, 3):
        for j in range(-1, 3):
            patch_known &= np.isfinite(
                padded[np.floor(r).astype(int) + i + 2, np.floor(c).astype(int) + j + 2]
            )
    plain = ArrayRaster(np.nan_to_num(whole)).sample(r, c)
    np.testing.assert_allclose(found.height[patch_known], plain.height[patch_known], atol=1e-10)
    np.testing.assert_allclose(found.by_row[patch_known], plain.by_row[patch_known], atol=1e-10)


def test_few_tiles_are_held_and_pickles_reopen(tmp_path):
    height = np.zeros((300, 20_000), dtype=np.int16)
    height[:] = np.arange(20_000) % 1000
    path = write_tif(
        tmp_path / "a.tif", height, west=0, north=300, spacing=1.0, dtype="int16", tiled=True,
        blockxsize=256, blockysize=256,
    )  # fmt: skip
    raster = FileRaster(path, "a.tif")
    column = np.arange(3.0, 19_990.0, 7.0)
    found = raster.sample(np.full(column.size, 5.0), column)
    np.testing.assert_array_equal(found.height, column % 1000)
    assert len(raster._tiles) == 48
    copy = pickle.loads(pickle.dumps(raster))
    assert not copy._tiles
    assert copy.sample(np.array([5.0]), np.array([1234.0])).height[0] == 234.0


def utm_terrain(tmp_path, **options):
    line = 50.0 * np.arange(240.0)
    x, y = np.meshgrid(WEST + 25.0 + line, NORTH - 25.0 - line)
    path = write_tif(
        tmp_path / "utm.tif", hills(x - WEST, y - NORTH), west=WEST, north=NORTH, spacing=50.0,
        crs=UTM, dtype="float64",
    )  # fmt: skip
    return Terrain.from_file(path, frame="ecef", **({"heights": "ellipsoid"} | options))


def places(rng, count=6):
    """Positions over the raster, heights anything, and where they are on it."""
    x, y = WEST + rng.uniform(1e3, 11e3, count), NORTH - rng.uniform(1e3, 11e3, count)
    lon, lat = Transformer.from_crs(UTM, "EPSG:4326", always_xy=True).transform(x, y)
    return ecef_from_geodetic(np.array(lat), np.array(lon), rng.uniform(-100.0, 5e3, count)), x, y


def test_projected_raster_in_ecef(tmp_path):
    terrain = utm_terrain(tmp_path)
    position, x, y = places(np.random.default_rng(3))
    found, _ = terrain.elevation(position)
    np.testing.assert_allclose(found, hills(x - WEST, y - NORTH), atol=0.02)
    assert terrain.known(position).all()
    assert terrain.spacing_m == pytest.approx(50.0, rel=6e-4)
    above, _ = height_above_terrain(position, "ecef", terrain)
    np.testing.assert_allclose(above, geodetic_from_ecef(position)[:, 2] - found, atol=1e-8)


@PROFILE
@given(seed=seeds, kind=st.sampled_from(["utm", "degrees", "local"]))
def test_derivatives_by_position(tmp_path_factory, seed, kind):
    rng = np.random.default_rng(seed)
    if kind == "local":
        terrain, frame = local_terrain(hills), "local"
        position = np.column_stack([rng.uniform(0.0, 6e3, (1, 2)), rng.normal(size=1) * 500.0])
    else:
        folder, frame = tmp_path_factory.getbasetemp() / f"made_{kind}", "ecef"
        folder.mkdir(exist_ok=True)
        position, _, _ = places(rng, 1)
        if kind == "utm":
            terrain = utm_terrain(folder)
        else:
            height = hills(*np.meshgrid(55.0 * np.arange(400), 55.0 * np.arange(400)))
            path = write_tif(
                folder / "a.tif", height, west=14.85, north=60.1, spacing=(1e-3, 5e-4),
                crs="EPSG:4326", dtype="float64",
            )  # fmt: skip
            terrain = Terrain.from_file(path, frame="ecef", heights="ellipsoid")
    assert terrain.known(position).all()

    def value(at):
        return height_above_terrain(at[None], frame, terrain)[0]

    _, gradient = height_above_terrain(position, frame, terrain, jacobian=True)
    # Third derivatives jump between cells: the steps are short, and rounding is 1e-9 m.
    expected = derivative(value, position[0], [0.05] * 3)
    np.testing.assert_allclose(gradient, expected, atol=5e-6)


def test_longitudes_may_be_counted_otherwise(tmp_path):
    height = np.tile(np.arange(40.0), (20, 1))
    path = write_tif(
        tmp_path / "a.tif", height, west=350.0, north=60.0, spacing=1.0, crs="EPSG:4326"
    )
    terrain = Terrain.from_file(path, frame="ecef", heights="ellipsoid")
    position = ecef_from_geodetic(np.full(3, 50.5), np.array([-5.5, 0.5, 20.5]), 0.0)
    np.testing.assert_allclose(terrain.elevation(position)[0], [4.0, 10.0, 30.0], atol=1e-9)
    assert "longitude 350 to 390" in terrain.extent_text()


def test_turned_rasters_and_rows_going_north(tmp_path):
    height = np.arange(30.0)[:, None] + 100.0 * np.arange(20.0)
    cosine, sine = np.cos(np.radians(30.0)), np.sin(np.radians(30.0))
    transform = rasterio.Affine(10 * cosine, -10 * sine, 1000, 10 * sine, 10 * cosine, 2000)
    path = tmp_path / "a.tif"
    with rasterio.open(
        path, "w", driver="GTiff", height=30, width=20, count=1, dtype="float64",
        transform=transform,
    ) as dataset:  # fmt: skip
        dataset.write(height, 1)
    terrain = Terrain.from_file(str(path), frame="local")
    # The centre of column 7, row 12.
    x = 1000 + 75.0 * cosine - 125.0 * sine
    y = 2000 + 75.0 * sine + 125.0 * cosine
    found, slope = terrain.elevation(np.array([[x, y, 0.0]]), jacobian=True)
    assert found[0] == pytest.approx(712.0)
    along = np.array([cosine, sine, 0.0])
    assert slope[0] @ along == pytest.approx(10.0)
    assert terrain.spacing_m == pytest.approx(10.0)


def test_heights_above_the_geoid(tmp_path):
    position, x, y = places(np.random.default_rng(3))
    terrain = utm_terrain(tmp_path, heights="geoid", geoid_undulation_m=31.5)
    found, _ = terrain.elevation(position)
    np.testing.assert_allclose(found, hills(x - WEST, y - NORTH) + 31.5, atol=0.02)


def test_heights_above_a_geoid_that_a_grid_is_installed_of(tmp_path):
    # A small grid of our own under the name that pyproj looks for.
    from pyproj import datadir

    grid = tmp_path / "grids"
    grid.mkdir()
    line = np.arange(41.0)
    undulation = 20.0 + line[:, None] * 0.1 + line * 0.2
    write_tif(
        grid / "us_nga_egm08_25.tif", undulation, west=9.875, north=65.125, spacing=0.25,
        crs="EPSG:4326",
    )  # fmt: skip
    before = datadir.get_data_dir()
    datadir.set_data_dir(f"{before}{__import__('os').pathsep}{grid}")
    try:
        terrain = utm_terrain(tmp_path, heights="geoid")
        position, x, y = places(np.random.default_rng(3))
        found, _ = terrain.elevation(position)
    finally:
        datadir.set_data_dir(before)
    geodetic = geodetic_from_ecef(position)
    geoid = 20.0 + (65.0 - geodetic[:, 0]) * 0.4 + (geodetic[:, 1] - 10.0) * 0.8
    np.testing.assert_allclose(found, hills(x - WEST, y - NORTH) + geoid, atol=0.02)


def test_feet_and_a_vertical_system_in_the_raster(tmp_path):
    position, x, y = places(np.random.default_rng(3))
    line = 50.0 * np.arange(240.0)
    gx, gy = np.meshgrid(WEST + 25.0 + line, NORTH - 25.0 - line)
    path = write_tif(
        tmp_path / "a.tif", hills(gx - WEST, gy - NORTH) / 0.3048, west=WEST, north=NORTH,
        spacing=50.0, dtype="float64",
        crs="EPSG:32633+8228",
    )  # fmt: skip
    # NAVD88 height in feet: above a geoid, by the raster's own word.
    terrain = Terrain.from_file(path, frame="ecef", geoid_undulation_m=2.0)
    assert terrain.heights == "geoid"
    np.testing.assert_allclose(
        terrain.elevation(position)[0], hills(x - WEST, y - NORTH) + 2.0, atol=0.02
    )
    with pytest.raises(InputError, match="above the geoid by its own reference system, and terr"):
        Terrain.from_file(path, frame="ecef", heights="ellipsoid")


FLAT = np.zeros((8, 8))


@pytest.mark.parametrize(
    ("crs", "options", "message"),
    [
        (None, {"heights": "ellipsoid"}, "no coordinate reference system; expected one in the Geo"),
        (UTM, {}, r'what its heights are above; expected terrain_heights = "ellipsoid" or "geoid"'),
        (UTM, {"heights": "geoid"}, "grid is not installed; give its height above the ellipsoid"),
        (UTM, {"heights": "ellipsoid", "geoid_undulation_m": 3.0}, "and geoid_undulation_m is 3;"),
        ("EPSG:4326", {"frame": "local"}, "has coordinates in degrees, and in a local frame they"),
        (UTM, {"frame": "local", "heights": "ellipsoid"}, "are for the frame ecef; in a local"),
        (
            'PROJCS["mine",GEOGCS["mine",DATUM["nobody knows",SPHEROID["Bessel",6377397.155,'
            '299.1528]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],'
            'PROJECTION["Transverse_Mercator"],PARAMETER["central_meridian",15],'
            'PARAMETER["scale_factor",1],UNIT["metre",1]]',
            {"heights": "ellipsoid"},
            "is in mine, to which no transformation from WGS 84 is known; expected a raster on WGS",
        ),
    ],
)
def test_rasters_that_are_refused(tmp_path, crs, options, message):
    path = write_tif(tmp_path / "a.tif", FLAT, west=WEST, north=NORTH, spacing=10.0, crs=crs)
    with pytest.raises(InputError, match=message) as caught:
        Terrain.from_file(path, **({"frame": "ecef"} | options), name="dem.tif")
    assert str(caught.value).startswith("dem.tif: ")
    assert "\n" not in str(caught.value)


def test_files_that_are_no_rasters(tmp_path):
    path = tmp_path / "a.tif"
    path.write_bytes(b"not a raster")
    with pytest.raises(InputError, match=r"cannot be opened as a raster .*expected a GeoTIFF"):
        FileRaster(str(path), "dem.tif")
    with rasterio.open(
        path, "w", driver="GTiff", height=9, width=9, count=2, dtype="float32",
        transform=rasterio.Affine.scale(2.0),
    ) as dataset:  # fmt: skip
        dataset.write(np.zeros((2, 9, 9), dtype=np.float32))
    with pytest.raises(InputError, match="has 2 bands; expected one, of heights"):
        FileRaster(str(path), "dem.tif")
    with pytest.raises(InputError, match="has 3 rows and 9 columns; expected at least 4"):
        ArrayRaster(np.zeros((3, 9)))
    with pytest.raises(InputError, match="expected rows and columns"):
        ArrayRaster(np.zeros(9))
    with pytest.raises(InputError, match="spacing of 0"):
        Terrain.from_array(FLAT, x0_m=0.0, y0_m=0.0, spacing_m=0.0)


def test_truncated_files_are_named(tmp_path):
    rng = np.random.default_rng(1)
    path = tmp_path / "a.tif"
    write_tif(path, rng.normal(size=(600, 600)), west=0, north=600, spacing=1.0)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match=r"dem\.tif: cannot be"):
        FileRaster(str(path), "dem.tif").sample(np.array([590.0]), np.array([590.0]))
