"""Ground for tests: smooth hills by formula, and rasters and GeoTIFFs of them."""

import numpy as np
import rasterio
from rasterio.transform import Affine

from geograph.terrain import Terrain


def hills(x, y):
    """Height of rolling hills, metres, at x and y in metres."""
    return 120.0 * np.sin(x / 700.0) * np.cos(y / 900.0) + 60.0 * np.sin((x + 2.0 * y) / 1500.0)


def ridges(x, y, *, apart=1500.0, height=300.0, width=250.0):
    """Height of three ridges across x, metres: at one, two and three times a distance."""
    del y
    return sum(height * k * np.exp(-0.5 * ((x - k * apart) / width) ** 2) for k in (1, 2, 3))


def local_terrain(height, *, low=-2000.0, high=8000.0, spacing=25.0):
    """Return ground in a local frame over a square, from a function of x and y."""
    line = np.arange(low, high + 0.5 * spacing, spacing)
    x, y = np.meshgrid(line, line)
    return Terrain.from_array(height(x, y), x0_m=low, y0_m=low, spacing_m=spacing)


def write_tif(path, height, *, west, north, spacing, crs=None, **profile):
    """Write a raster, rows going south, as a GeoTIFF, and return its path as text."""
    spacing_x, spacing_y = np.broadcast_to(spacing, 2)
    options = {
        "driver": "GTiff", "height": height.shape[0], "width": height.shape[1], "count": 1,
        "dtype": "float32", "crs": crs,
        "transform": Affine(spacing_x, 0.0, west, 0.0, -spacing_y, north),
    }  # fmt: skip
    with rasterio.open(path, "w", **(options | profile)) as dataset:
        dataset.write(height.astype(dataset.dtypes[0]), 1)
    return str(path)
