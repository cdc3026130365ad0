"""Writing of the ground: a copy of its GeoTIFF, or a new one of an array."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError
from geograph.io.header_text import terrain_name

if TYPE_CHECKING:
    from pathlib import Path

    from geograph.terrain import Terrain


def save_terrain(terrain: Terrain, folder: Path) -> Path:
    """Write the ground of a recording into a folder, and return its file.

    Parameters
    ----------
    terrain
        From a file, which is copied as it is; or an array, which becomes a GeoTIFF of doubles.
    folder
        Exists.

    Raises
    ------
    InputError
        If its file is inside an archive that cannot be read, or rasterio is not installed.
    """
    from geograph.raster import ArrayRaster, FileRaster

    target = folder / terrain_name(terrain)
    raster = terrain.raster
    if isinstance(raster, FileRaster):
        if not raster.location.startswith("/vsizip/"):
            shutil.copyfile(raster.location, target)
            return target
        import rasterio.shutil

        rasterio.shutil.copy(raster.location, str(target), driver="GTiff")
        return target
    assert isinstance(raster, ArrayRaster)
    try:
        import rasterio
    except ImportError:
        raise InputError("terrain needs rasterio; install geograph[terrain]", path=target) from None
    from rasterio.transform import Affine

    inverse = np.linalg.inv(terrain.pixel_from_crs[:, :2])
    # The first pixel's corner, half a pixel before its centre.
    x, y = inverse @ (np.array([-0.5, -0.5]) - terrain.pixel_from_crs[:, 2])
    (a, b), (d, e) = inverse
    rows, columns = raster.shape
    with rasterio.open(
        target, "w", driver="GTiff", height=rows, width=columns, count=1, dtype="float64",
        transform=Affine(a, b, x, d, e, y), nodata=np.nan, tiled=True, compress="deflate",
    ) as dataset:  # fmt: skip
        dataset.write(raster.height_m, 1)
    return target
