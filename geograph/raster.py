"""Height rasters of any size: read by window, a few tiles held at a time.

A raster is a grid of heights with places between its points interpolated by
:func:`geograph.factors.terrain.cubic_convolution`. Rows and columns are counted from the centre of
the first pixel. Files are read through rasterio (the extra ``terrain``), in tiles of which the last
ones used are kept; the memory does not grow with the raster.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import OrderedDict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.errors import InputError
from geograph.factors.terrain import cubic_convolution

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

_TILE = 256
_TILES_KEPT = 48

# Megabytes that GDAL may keep of what it has decoded; its own default is a share of all memory.
_GDAL_CACHE_MB = 32

# No ground on Earth is deeper or higher; such values mark what is not known.
_LOWEST_M, _HIGHEST_M = -12_000.0, 10_000.0

_FEWEST = 4


@dataclass(frozen=True, eq=False)
class Sample:
    """Heights at n places of a raster.

    Attributes
    ----------
    height
        Shape (n,), metres; beyond the raster that of its edge, where nothing is known that of the
        nearest known point of the tile.
    by_row, by_column
        Shape (n,): derivatives, metres per pixel; zero across the edge beyond it.
    known
        Shape (n,): whether the raster has a height there.
    """

    height: NDArray[np.float64]
    by_row: NDArray[np.float64]
    by_column: NDArray[np.float64]
    known: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _Tile:
    height: NDArray[np.float64]
    known: NDArray[np.bool_] | None


class Raster(ABC):
    """A grid of heights.

    Parameters
    ----------
    shape
        Rows and columns, at least 4 of each.
    name
        What it is called in messages.
    adjust
        Called with a tile's heights, first row and first column; returns heights above the
        ellipsoid. None: they are.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        name: str,
        adjust: Callable[[NDArray[np.float64], int, int], NDArray[np.float64]] | None = None,
    ) -> None:
        if min(shape) < _FEWEST:
            raise InputError(
                f"has {shape[0]} rows and {shape[1]} columns; expected at least {_FEWEST} of each",
                path=name,
            )
        self.shape = shape
        self.name = name
        self.adjust = adjust
        self._tiles: OrderedDict[tuple[int, int], _Tile] = OrderedDict()

    @abstractmethod
    def _window(self, rows: slice, columns: slice) -> NDArray[np.float64]:
        """Return a window of the grid, metres, NaN where nothing is known."""

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_tiles": OrderedDict()}

    def sample(self, row: NDArray[np.float64], column: NDArray[np.float64]) -> Sample:
        """Return heights at places, each shape (n,), counted from the first pixel's centre."""
        patch, known = np.empty((row.size, 4, 4)), np.ones(row.size, dtype=np.bool_)
        at, inside = [], np.ones(row.size, dtype=np.bool_)
        for place, count in zip((row, column), self.shape, strict=True):
            # Pixels are areas: the outer half of the outer ones belongs to the raster.
            held = np.clip(np.nan_to_num(place), -0.5, count - 0.5)
            inside &= held == place
            first = np.clip(np.floor(held).astype(np.int64), 0, count - 2)
            at.append((first, held - first, held == place))
        (r, tr, row_in), (c, tc, column_in) = at
        tile = (r // _TILE) * (self.shape[1] // _TILE + 1) + c // _TILE
        for code in np.unique(tile):
            own = np.flatnonzero(tile == code)
            i, j = int(r[own[0]]) // _TILE, int(c[own[0]]) // _TILE
            held_tile = self._tile(i, j)
            local_r, local_c = r[own] - i * _TILE, c[own] - j * _TILE
            span = np.arange(4)
            rows = local_r[:, None, None] + span[:, None]
            columns = local_c[:, None, None] + span
            patch[own] = held_tile.height[rows, columns]
            if held_tile.known is not None:
                near = held_tile.known[rows, columns][:, 1:3, 1:3]
                known[own] = near.all(axis=(1, 2))
        height, by_row, by_column = cubic_convolution(patch, tr, tc)
        return Sample(height, by_row * row_in, by_column * column_in, known & inside)

    def _tile(self, i: int, j: int) -> _Tile:
        found = self._tiles.get((i, j))
        if found is not None:
            self._tiles.move_to_end((i, j))
            return found
        found = self._read_tile(i, j)
        self._tiles[i, j] = found
        if len(self._tiles) > _TILES_KEPT:
            self._tiles.popitem(last=False)
        return found

    def _read_tile(self, i: int, j: int) -> _Tile:
        """Return a tile with one pixel more before it and two behind it."""
        spans, pads = [], []
        for index, count in zip((i, j), self.shape, strict=True):
            low, high = index * _TILE - 1, min((index + 1) * _TILE, count - 1) + 2
            spans.append(slice(max(low, 0), min(high, count)))
            pads.append((max(-low, 0), max(high - count, 0)))
        height = self._window(*spans)
        height = np.where((height > _LOWEST_M) & (height < _HIGHEST_M), height, np.nan)
        known: NDArray[np.bool_] | None = np.isfinite(height)
        assert known is not None
        if known.all():
            known = None
        else:
            height = _filled(height, known)
        if self.adjust is not None:
            height = self.adjust(height, spans[0].start, spans[1].start)
        for axis in range(2):
            height = _extended(height, pads[axis], axis)
        if known is not None:
            known = np.pad(known, pads, mode="edge")
        return _Tile(np.ascontiguousarray(height), known)


def _filled(height: NDArray[np.float64], known: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return heights with gaps filled from the nearest known point, so that solvers pass them."""
    if not known.any():
        return np.zeros_like(height)
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(height[tuple(nearest)])


def _extended(height: NDArray[np.float64], pad: tuple[int, int], axis: int) -> NDArray[np.float64]:
    """Return heights with a point added beyond an edge: c[-1] = 3 c[0] - 3 c[1] + c[2] (Keys)."""
    moved = np.moveaxis(height, axis, 0)
    parts = [moved]
    if pad[0]:
        parts.insert(0, (3.0 * moved[0] - 3.0 * moved[1] + moved[2])[None])
    if pad[1]:
        parts.append((3.0 * moved[-1] - 3.0 * moved[-2] + moved[-3])[None])
    return np.moveaxis(np.concatenate(parts), 0, axis)


class ArrayRaster(Raster):
    """A grid that is in memory.

    Parameters
    ----------
    height_m
        Shape (rows, columns), NaN where nothing is known.
    """

    def __init__(self, height_m: NDArray[np.float64]) -> None:
        if height_m.ndim != 2:
            raise InputError(f"heights have shape {height_m.shape}; expected rows and columns")
        super().__init__((height_m.shape[0], height_m.shape[1]), "terrain")
        self.height_m = np.asarray(height_m, dtype=np.float64)

    def _window(self, rows: slice, columns: slice) -> NDArray[np.float64]:
        return self.height_m[rows, columns]


class FileRaster(Raster):
    """A grid in a file that rasterio opens.

    Parameters
    ----------
    location
        What GDAL opens: a path, or one inside an archive.
    name
        What it is called in messages.

    Raises
    ------
    InputError
        If rasterio is not installed, or the file cannot be opened or read.
    """

    def __init__(self, location: str, name: str) -> None:
        self.location = location
        self.name = name
        self._dataset: Any = None
        dataset = self.dataset
        if dataset.count != 1:
            raise InputError(f"has {dataset.count} bands; expected one, of heights", path=name)
        super().__init__((dataset.height, dataset.width), name)

    def __getstate__(self) -> dict[str, Any]:
        return super().__getstate__() | {"_dataset": None}

    @property
    def dataset(self) -> Any:
        """The open dataset; opened anew in another process."""
        if self._dataset is None:
            try:
                import rasterio
            except ImportError:
                raise InputError(
                    "terrain needs rasterio; install geograph[terrain]", path=self.name
                ) from None
            try:
                with rasterio.Env(GDAL_CACHEMAX=_GDAL_CACHE_MB):
                    self._dataset = rasterio.open(self.location, sharing=False)
            except rasterio.errors.RasterioError as error:
                raise InputError(
                    f"cannot be opened as a raster ({_short(error)}); expected a GeoTIFF of "
                    "heights",
                    path=self.name,
                ) from None
        return self._dataset

    def _window(self, rows: slice, columns: slice) -> NDArray[np.float64]:
        import rasterio
        from rasterio.windows import Window

        dataset = self.dataset
        window = Window.from_slices(rows, columns)
        try:
            with rasterio.Env(GDAL_CACHEMAX=_GDAL_CACHE_MB):
                found = dataset.read(1, window=window, masked=True)
        except (rasterio.errors.RasterioError, OSError) as error:
            raise InputError(
                f"cannot be read ({_short(error)}); expected a whole GeoTIFF", path=self.name
            ) from None
        height = np.ma.filled(found.astype(np.float64), np.nan)
        return np.asarray(height * dataset.scales[0] + dataset.offsets[0])


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:120]
