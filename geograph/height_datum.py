"""What the heights of a raster are above: ellipsoid or geoid, and in which unit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.raster import FileRaster
    from geograph.recording import HeightDatum
    from geograph.terrain import Terrain

EGM2008 = "EPSG:3855"
"""The geoid that is meant where a raster does not name one."""


@dataclass
class Adjusted:
    """Heights in another unit, or above the geoid at a known distance from the ellipsoid."""

    unit: float
    undulation_m: float | None

    def __call__(self, height: NDArray[np.float64], row: int, column: int) -> NDArray[np.float64]:
        """Return heights above the ellipsoid, metres, of a window that begins at a pixel."""
        del row, column
        return height * self.unit + (self.undulation_m or 0.0)


@dataclass(eq=False)
class GeoidGrid:
    """Heights above a geoid whose distance from the ellipsoid pyproj has a grid of."""

    unit: float
    geoid: Any
    terrain: Terrain

    def __post_init__(self) -> None:
        self._transformer: Any = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_transformer": None}

    def undulation(
        self, lon_deg: NDArray[np.float64], lat_deg: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return heights of the geoid above the ellipsoid, metres; inf where there is no grid."""
        from pyproj import CRS, Transformer
        from pyproj.crs import CompoundCRS
        from pyproj.exceptions import ProjError

        try:
            if self._transformer is None:
                above = CompoundCRS("WGS 84 + geoid", ["EPSG:4326", self.geoid])
                self._transformer = Transformer.from_crs(
                    above, CRS("EPSG:4979"), always_xy=True, allow_ballpark=False, only_best=True
                )
            found = self._transformer.transform(lon_deg, lat_deg, np.zeros_like(lon_deg))[2]
        except ProjError:
            return np.full_like(lon_deg, np.inf)
        return np.asarray(found)

    def check(self, lon_deg: float, lat_deg: float) -> None:
        """Raise InputError if there is no grid for the raster's middle."""
        if not np.isfinite(self.undulation(np.array([lon_deg]), np.array([lat_deg]))).all():
            raise InputError(
                "has heights above the geoid, and the geoid's grid is not installed; give its "
                "height above the ellipsoid there, geoid_undulation_m = ... (metres), in "
                "recording.toml, or install the grid (projsync --bbox)",
                path=self.terrain.raster.name,
            )

    def __call__(self, height: NDArray[np.float64], row: int, column: int) -> NDArray[np.float64]:
        """Return heights above the ellipsoid, metres, of a window that begins at a pixel."""
        rows, columns = np.mgrid[: height.shape[0], : height.shape[1]].astype(np.float64)
        lon, lat = self.terrain.lon_lat((rows + row).ravel(), (columns + column).ravel())
        return np.asarray(height * self.unit + self.undulation(lon, lat).reshape(height.shape))


def check_local(
    raster: FileRaster, heights: HeightDatum | None, geoid_undulation_m: float | None
) -> None:
    """Raise InputError if a raster cannot be the ground of a local frame."""
    if heights is not None or geoid_undulation_m is not None:
        raise InputError(
            "terrain_heights and geoid_undulation_m are for the frame ecef; in a local frame the "
            "raster's heights are z; remove them",
            path=raster.name,
        )
    crs = raster.dataset.crs
    if crs is not None and crs.is_geographic:
        raise InputError(
            "has coordinates in degrees, and in a local frame they are x and y in metres; expected "
            "a projected raster, or none with a reference system; reproject it",
            path=raster.name,
        )


def reference(raster: FileRaster) -> tuple[Any, Any, float]:
    """Return the horizontal system, the vertical one (None: not stated), and its unit in metres."""
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    given = raster.dataset.crs
    if given is None:
        raise InputError(
            "has no coordinate reference system; expected one in the GeoTIFF, for the frame ecef; "
            "set it (gdal_edit.py -a_srs EPSG:...)",
            path=raster.name,
        )
    try:
        crs = CRS.from_wkt(given.to_wkt())
    except CRSError as error:
        raise InputError(
            f"has a coordinate reference system that is not understood ({str(error)[:80]})",
            path=raster.name,
        ) from None
    unit = 1.0
    if crs.is_compound:
        horizontal, vertical = crs.sub_crs_list[:2]
        unit = float(vertical.axis_info[0].unit_conversion_factor)
        return horizontal, vertical, unit
    if len(crs.axis_info) == 3:
        unit = float(crs.axis_info[2].unit_conversion_factor)
        return crs.to_2d(), "ellipsoid", unit
    if not (crs.is_geographic or crs.is_projected):
        raise InputError(
            f"is in {crs.name}, which has no place on the Earth; expected a geographic or "
            "projected system",
            path=raster.name,
        )
    return crs, None, unit
