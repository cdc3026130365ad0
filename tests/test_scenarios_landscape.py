"""Synthetic terrain and its rasters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from geograph.scenarios.elevation_model import NODATA, Raster, write_geotiff
from geograph.scenarios.landscape import (
    HILLS,
    MOUNTAINS,
    Landscape,
    Pin,
    Relief,
    make_landscape,
)

if TYPE_CHECKING:
    from pathlib import Path

PINS = [
    Pin(place_m=(3200.0, 3200.0), height_m=154.0, slope=(0.01, -0.02)),
    Pin(place_m=(2200.0, 2200.0), height_m=172.0),
]


def places(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-5e3, 9e3, (2, count))


@pytest.mark.parametrize("relief", [HILLS, MOUNTAINS])
@pytest.mark.parametrize("pins", [[], PINS])
def test_gradient_is_that_of_the_height(relief: Relief, pins: list[Pin]) -> None:
    land = make_landscape(relief, seed=5, pins=pins)
    x, y = places(400)
    step = 0.01
    by_x = (land.height(x + step, y) - land.height(x - step, y)) / (2.0 * step)
    by_y = (land.height(x, y + step) - land.height(x, y - step)) / (2.0 * step)
    np.testing.assert_allclose(land.gradient(x, y), np.stack([by_x, by_y], axis=-1), atol=1e-6)


def test_pins_have_their_heights_and_slopes() -> None:
    land = make_landscape(HILLS, seed=2, pins=PINS)
    place = np.array([pin.place_m for pin in PINS])
    height, slope = land.evaluate(place[:, 0], place[:, 1])
    np.testing.assert_allclose(height, [154.0, 172.0], atol=1e-9)
    np.testing.assert_allclose(slope, [(0.01, -0.02), (0.0, 0.0)], atol=1e-12)
    # Far from the pins the ground is what it would be without them.
    bare = make_landscape(HILLS, seed=2)
    np.testing.assert_allclose(land.height(-3e3, -3e3), bare.height(-3e3, -3e3), atol=1e-9)


def test_a_seed_is_a_land() -> None:
    x, y = places(50)
    first, again, other = (make_landscape(HILLS, seed=seed).height(x, y) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 5.0


def test_mountains_are_mountains() -> None:
    """Relief and steepest slopes over 10 km by 10 km, of several seeds."""
    axis = np.arange(0.0, 10e3, 50.0)
    for seed in range(3):
        low, high = (make_landscape(r, seed=seed).grid(axis, axis) for r in (HILLS, MOUNTAINS))
        assert 40.0 < np.ptp(low) < 200.0
        assert 800.0 < np.ptp(high) < 2500.0
        slope = np.hypot(*np.gradient(high, 50.0))
        assert 0.3 < np.quantile(slope, 0.9) < 1.5


def test_grid_is_the_function_on_a_grid() -> None:
    land = make_landscape(MOUNTAINS, seed=4, pins=PINS)
    raster = Raster(west_m=-1000.0, north_m=4000.0, columns=60, rows=70)
    x, y = np.meshgrid(raster.x_m, raster.y_m)
    np.testing.assert_allclose(land.grid(raster.x_m, raster.y_m), land.height(x, y), atol=1e-9)


def test_raster_covers_and_lies_on_whole_multiples() -> None:
    raster = Raster.around((-120.0, 30.0), (480.0, 260.0), spacing_m=50.0)
    assert (raster.west_m, raster.x_m[-1]) == (-150.0, 500.0)
    assert (raster.y_m[-1], raster.north_m) == (0.0, 300.0)
    seen = np.zeros((raster.rows, raster.columns), dtype=int)
    for window in raster.windows(4):
        seen[window] += 1
    assert (seen == 1).all()


def test_geotiff_holds_the_heights(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    land = make_landscape(HILLS, seed=1)
    raster = Raster(west_m=-200.0, north_m=900.0, columns=75, rows=50, spacing_m=25.0)
    for crs, origin in ((None, (0.0, 0.0)), ("EPSG:32633", (5e5, 6.47e6))):
        path = tmp_path / f"{crs is None}.tif"
        write_geotiff(path, land, raster, crs=crs, origin_m=origin, window=32)
        with rasterio.open(path) as file:
            assert file.nodata == NODATA
            assert (file.crs is None) == (crs is None)
            np.testing.assert_allclose(
                file.read(1), land.grid(raster.x_m, raster.y_m), rtol=1e-6, atol=0.0
            )
            # The centre of the cell in row 3, column 7.
            place = file.transform @ (7.5, 3.5)
            expected = (raster.x_m[7] + origin[0], raster.y_m[3] + origin[1])
            np.testing.assert_allclose(place, expected)


def test_geotiff_is_written_by_window(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No more than a window is ever asked for."""
    pytest.importorskip("rasterio")
    asked: list[int] = []
    whole = Landscape.grid

    def grid(self: Landscape, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        asked.append(x_m.size * y_m.size)
        return whole(self, x_m, y_m)

    monkeypatch.setattr(Landscape, "grid", grid)
    raster = Raster(west_m=0.0, north_m=0.0, columns=300, rows=300)
    write_geotiff(tmp_path / "dem.tif", make_landscape(HILLS, seed=0), raster, window=128)
    assert max(asked) == 128**2
    assert sum(asked) == 300**2


def test_bad_land_is_refused() -> None:
    with pytest.raises(ValueError, match=r"wavelengths from 500\.0 to 100\.0 m"):
        Relief(base_m=0.0, hills_m=1.0, longest_m=100.0, shortest_m=500.0)
    with pytest.raises(ValueError, match="raster of 1 x 5 cells"):
        Raster(west_m=0.0, north_m=0.0, columns=1, rows=5)
