"""Elevation models of synthetic land: its heights on a grid, as a raster or a GeoTIFF."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from geograph.scenarios.landscape import Landscape

GRID_M = 50.0
"""Spacing of the elevation grid of Kallin (2021), metres."""

NODATA = -32768.0
"""Value of raster cells without a height."""


@dataclass(frozen=True, kw_only=True)
class Raster:
    """Where a raster's cells lie: a height at the centre of each.

    Parameters
    ----------
    west_m, north_m
        x of the first column's centres, y of the first row's centres.
    columns, rows
        Number of cells; rows run from north to south.
    spacing_m
        Distance between two centres.
    """

    west_m: float
    north_m: float
    columns: int
    rows: int
    spacing_m: float = GRID_M

    def __post_init__(self) -> None:
        if self.columns < 2 or self.rows < 2 or not self.spacing_m > 0.0:
            raise ValueError(
                f"raster of {self.columns} x {self.rows} cells, {self.spacing_m} m apart; "
                "expected at least 2 x 2, and a spacing above 0"
            )

    @classmethod
    def around(
        cls,
        low_m: tuple[float, float],
        high_m: tuple[float, float],
        *,
        spacing_m: float = GRID_M,
    ) -> Raster:
        """Return the smallest raster, on whole multiples of the spacing, whose centres cover."""
        west, south = (int(np.floor(value / spacing_m)) for value in low_m)
        east, north = (int(np.ceil(value / spacing_m)) for value in high_m)
        return cls(
            west_m=west * spacing_m,
            north_m=north * spacing_m,
            columns=east - west + 1,
            rows=north - south + 1,
            spacing_m=spacing_m,
        )

    @property
    def x_m(self) -> NDArray[np.float64]:
        """Shape (columns,): x of the centres."""
        return self.west_m + self.spacing_m * np.arange(self.columns, dtype=np.float64)

    @property
    def y_m(self) -> NDArray[np.float64]:
        """Shape (rows,): y of the centres, falling."""
        return self.north_m - self.spacing_m * np.arange(self.rows, dtype=np.float64)

    def windows(self, size: int) -> Iterator[tuple[slice, slice]]:
        """Yield rows and columns of square windows that cover the raster."""
        for row in range(0, self.rows, size):
            for column in range(0, self.columns, size):
                yield (
                    slice(row, min(row + size, self.rows)),
                    slice(column, min(column + size, self.columns)),
                )


def write_geotiff(
    path: Path,
    terrain: Landscape,
    raster: Raster,
    *,
    crs: str | None = None,
    origin_m: tuple[float, float] = (0.0, 0.0),
    window: int = 512,
) -> None:
    """Write a raster of heights as a tiled GeoTIFF of float32, window by window.

    Needs rasterio, the extra ``terrain``. Memory does not grow with the raster.

    Parameters
    ----------
    path
        The file.
    terrain
        The ground.
    raster
        Which cells.
    crs
        Coordinate reference system, as rasterio understands it; None: the axes of a local frame.
    origin_m
        Added to x and y in the file: easting and northing of the terrain's origin.
    window
        Cells on a side of what is written at once; a multiple of 16.
    """
    import warnings

    import rasterio
    from rasterio.errors import NotGeoreferencedWarning
    from rasterio.transform import Affine
    from rasterio.windows import Window

    step = raster.spacing_m
    corner = (raster.west_m + origin_m[0] - step / 2.0, raster.north_m + origin_m[1] + step / 2.0)
    with warnings.catch_warnings():
        # Without a crs, which is what a local frame has, some versions warn.
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(
            path,
            "w",
            driver="GTiff",
            width=raster.columns,
            height=raster.rows,
            count=1,
            dtype="float32",
            crs=crs,
            transform=Affine(step, 0.0, corner[0], 0.0, -step, corner[1]),
            nodata=NODATA,
            tiled=True,
            blockxsize=window,
            blockysize=window,
            compress="deflate",
            predictor=3,
            BIGTIFF="IF_SAFER",
        ) as file:
            for rows, columns in raster.windows(window):
                heights = terrain.grid(raster.x_m[columns], raster.y_m[rows])
                file.write(
                    heights.astype(np.float32),
                    1,
                    window=Window.from_slices(rows, columns),
                )
