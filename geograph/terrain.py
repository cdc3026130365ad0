"""Ground in the frame of a recording: a raster of heights, its coordinates and its datum."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.constants import EARTH_RADIUS_M
from geograph.errors import InputError
from geograph.geodesy import (
    ecef_from_geodetic,
    enu_axes,
    geodetic_from_ecef,
    metres_per_radian,
)
from geograph.height_datum import EGM2008, Adjusted, GeoidGrid, check_local, reference
from geograph.raster import ArrayRaster, FileRaster

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from geograph.raster import Raster, Sample
    from geograph.recording import Frame, HeightDatum

# Half the width of the differences by which a projection is linearised: truncation and rounding of
# its coordinates are then both below 1e-9.
_DIFFERENCE_RAD = 10.0 / EARTH_RADIUS_M


@dataclass(eq=False)
class Terrain:
    """Ground whose height is known on a raster; a :class:`geograph.factors.terrain.Surface`.

    Made by :meth:`from_file` or :meth:`from_array`.

    Attributes
    ----------
    raster
        The heights, above the WGS 84 ellipsoid, or z in a local frame.
    frame
        Frame of the positions asked for.
    pixel_from_crs
        Shape (2, 3): column and row, counted from the first pixel's centre, from (X, Y, 1).
    crs
        Horizontal reference system of X and Y, as pyproj takes it; None in a local frame, where
        they are the frame's x and y.
    heights
        What the raster's own heights are above, or None in a local frame.
    geoid_undulation_m
        Height of the geoid above the ellipsoid that was added to heights above the geoid; None: by
        a grid of pyproj's, or not needed.
    """

    raster: Raster
    frame: Frame
    pixel_from_crs: NDArray[np.float64]
    crs: Any = None
    heights: HeightDatum | None = None
    geoid_undulation_m: float | None = None

    def __post_init__(self) -> None:
        self._forward: Any = None
        # The sensors that were last held against it; see geograph.ground.check_ground.
        self.checked: object = None
        self._geographic = self.crs is not None and bool(self.crs.is_geographic)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_forward": None, "checked": None}

    @classmethod
    def from_array(
        cls, height_m: ArrayLike, *, x0_m: float, y0_m: float, spacing_m: float
    ) -> Terrain:
        """Return ground in a local frame from an array.

        Parameters
        ----------
        height_m
            Shape (rows, columns): z; x grows with the column and y with the row; NaN: not known.
        x0_m, y0_m
            Where the first value lies.
        spacing_m
            Between values, the same in x and y.

        Raises
        ------
        InputError
            If the array is smaller than 4 by 4, or a number is not finite or not positive.
        """
        if not (np.isfinite([x0_m, y0_m]).all() and 0.0 < spacing_m < np.inf):
            raise InputError(
                f"terrain starts at ({x0_m}, {y0_m}) m with a spacing of {spacing_m} m; expected "
                "finite numbers, spacing above 0"
            )
        pixel = np.array(
            [[1.0 / spacing_m, 0.0, -x0_m / spacing_m], [0.0, 1.0 / spacing_m, -y0_m / spacing_m]]
        )
        return cls(ArrayRaster(np.asarray(height_m, dtype=np.float64)), "local", pixel)

    @classmethod
    def from_file(
        cls,
        location: str,
        *,
        frame: Frame,
        heights: HeightDatum | None = None,
        geoid_undulation_m: float | None = None,
        name: str | None = None,
    ) -> Terrain:
        """Return ground from a GeoTIFF, of which nothing is read yet but its header.

        Parameters
        ----------
        location
            What GDAL opens.
        frame
            ``"ecef"``: the raster has a reference system of its own. ``"local"``: its coordinates
            are the frame's x and y, its heights z.
        heights
            In ``ecef``: what its heights are above; None: as its own vertical reference says.
        geoid_undulation_m
            Height of the geoid above the ellipsoid there; None: by a geoid grid of pyproj's.
        name
            What it is called in messages.

        Raises
        ------
        InputError
            If it cannot be opened, is turned so that rows do not lie in it, has no reference system
            in ``ecef`` or one in degrees in ``local``, or its vertical datum is not stated or
            cannot be related to the ellipsoid.
        """
        raster = FileRaster(location, name or location)
        forward = raster.dataset.transform
        matrix = np.array([[forward.a, forward.b, forward.c], [forward.d, forward.e, forward.f]])
        if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:, :2])) == 0.0:
            raise InputError("has no place on the ground; expected a GeoTIFF", path=raster.name)
        turn = np.linalg.inv(matrix[:, :2])
        # Pixel corners to pixel centres.
        pixel = np.column_stack([turn, -turn @ matrix[:, 2] - 0.5])
        if frame == "local":
            check_local(raster, heights, geoid_undulation_m)
            return cls(raster, frame, pixel)
        crs, vertical, unit = reference(raster)
        terrain = cls(raster, frame, pixel, crs, heights, geoid_undulation_m)
        terrain._set_datum(vertical, unit)
        terrain._transform(np.zeros(1), np.zeros(1))
        return terrain

    def _set_datum(self, vertical: Any, unit: float) -> None:
        """Take up the vertical datum: heights are adjusted when a tile is read."""
        raster, own = self.raster, None
        if vertical is not None:
            own = "ellipsoid" if vertical == "ellipsoid" else "geoid"
        if self.heights is None and own is None:
            raise InputError(
                "does not say what its heights are above; expected terrain_heights = "
                '"ellipsoid" or "geoid" (mean sea level) in recording.toml; add it',
                path=raster.name,
            )
        if self.heights is not None and own is not None and own != self.heights:
            raise InputError(
                f"has heights above the {own} by its own reference system, and terrain_heights "
                f"is {self.heights}; remove the key or mend the raster",
                path=raster.name,
            )
        self.heights = self.heights or own  # type: ignore[assignment]
        if self.heights == "ellipsoid":
            if self.geoid_undulation_m is not None:
                raise InputError(
                    f"has heights above the ellipsoid, and geoid_undulation_m is "
                    f"{self.geoid_undulation_m:g}; expected heights above the geoid beside it",
                    path=raster.name,
                )
            if unit != 1.0:
                raster.adjust = Adjusted(unit, None)
        elif self.geoid_undulation_m is not None:
            raster.adjust = Adjusted(unit, self.geoid_undulation_m)
        else:
            geoid = vertical if own == "geoid" else EGM2008
            grid = GeoidGrid(unit, geoid, self)
            grid.check(*self._middle())
            raster.adjust = grid

    def _middle(self) -> tuple[float, float]:
        """Return longitude and latitude of the raster's middle, degrees."""
        rows, columns = self.raster.shape
        lon, lat = self.lon_lat(np.array([0.5 * rows]), np.array([0.5 * columns]))
        return float(lon[0]), float(lat[0])

    def lon_lat(
        self, row: NDArray[np.float64], column: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return WGS 84 longitudes and latitudes, degrees, of places on the raster (frame ecef)."""
        inverse = np.linalg.inv(self.pixel_from_crs[:, :2])
        offset = np.stack([column, row]) - self.pixel_from_crs[:, 2:]
        x, y = inverse @ offset
        lon, lat = self._projection().transform(x, y, direction="INVERSE")
        return np.asarray(lon), np.asarray(lat)

    def _projection(self) -> Any:
        if self._forward is None:
            from pyproj import Transformer
            from pyproj.exceptions import ProjError

            try:
                # Without a known relation pyproj would take other datums for WGS 84.
                self._forward = Transformer.from_crs(
                    "EPSG:4326", self.crs, always_xy=True, allow_ballpark=False
                )
            except ProjError:
                raise InputError(
                    f"is in {self.crs.name}, to which no transformation from WGS 84 is known; "
                    "expected a raster on WGS 84, ETRS89 or another known datum; reproject it "
                    "(gdalwarp -t_srs)",
                    path=self.raster.name,
                ) from None
        return self._forward

    def _transform(
        self, lon_deg: NDArray[np.float64], lat_deg: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return X and Y of geodetic places; not finite where the projection has none."""
        x, y = self._projection().transform(lon_deg, lat_deg)
        x, y = np.asarray(x), np.asarray(y)
        if self._geographic:
            # Rasters may count longitudes from 0 to 360, or past the date line.
            row, column = (0.5 * count for count in self.raster.shape)
            inverse = np.linalg.inv(self.pixel_from_crs[:, :2])
            middle = float((inverse @ (np.array([column, row]) - self.pixel_from_crs[:, 2]))[0])
            x = x - 360.0 * np.round((x - middle) / 360.0)
        return x, y

    def _coordinates(
        self, position_m: NDArray[np.float64], jacobian: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """Return X and Y, shape (n, 2), and their derivatives by position, shape (n, 2, 3)."""
        count = position_m.shape[0]
        if self.frame == "local":
            flat = np.broadcast_to(np.eye(2, 3), (count, 2, 3)) if jacobian else None
            return position_m[:, :2], flat
        geodetic = geodetic_from_ecef(position_m)
        lat, lon = geodetic[:, 0], geodetic[:, 1]
        if not jacobian:
            return np.stack(self._transform(lon, lat), axis=1), None
        step = np.degrees(_DIFFERENCE_RAD)
        x, y = self._transform(
            np.concatenate([lon, lon + step, lon - step, lon, lon]),
            np.concatenate([lat, lat, lat, lat + step, lat - step]),
        )
        both = np.stack([x, y], axis=1).reshape(5, count, 2)
        # By longitude and latitude in radians, which are lengths to the east and north.
        by_angles = (both[1::2] - both[2::2]) / (2.0 * _DIFFERENCE_RAD)
        axes = enu_axes(position_m)
        east_m, north_m = metres_per_radian(np.radians(lat), geodetic[:, 2])
        by_position = (
            by_angles[0][:, :, None] * (axes[:, 0] / east_m[:, None])[:, None, :]
            + by_angles[1][:, :, None] * (axes[:, 1] / north_m[:, None])[:, None, :]
        )
        return both[0], by_position

    def _sample(self, xy: NDArray[np.float64]) -> Sample:
        column, row = self.pixel_from_crs[:, :2] @ xy.T + self.pixel_from_crs[:, 2:]
        return self.raster.sample(row, column)

    def elevation(
        self, position_m: NDArray[np.float64], *, jacobian: bool = False
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """Return heights of the ground at positions, and their gradients.

        Beyond the raster it goes on as at its edge, so that a solver may pass there; see
        :meth:`known`.

        Parameters
        ----------
        position_m
            Shape (n, 3), metres, in the frame.
        jacobian
            Whether gradients by the position, shape (n, 3), are returned too.

        Returns
        -------
        height, gradient
            Heights, shape (n,), metres above the ellipsoid, or z in a local frame.
        """
        xy, by_position = self._coordinates(position_m, jacobian)
        found = self._sample(xy)
        if by_position is None:
            return found.height, None
        by_pixel = np.stack([found.by_column, found.by_row], axis=1) @ self.pixel_from_crs[:, :2]
        return found.height, np.asarray(np.einsum("ni,nij->nj", by_pixel, by_position))

    def known(self, position_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return where the raster has a height, shape (n,), for positions of shape (n, 3)."""
        return self._sample(self._coordinates(position_m, False)[0]).known

    @property
    def spacing_m(self) -> float:
        """Distance between the raster's points, metres; the smaller one of rows and columns."""
        inverse = np.linalg.inv(self.pixel_from_crs[:, :2])
        if self.frame == "local":
            return float(np.linalg.norm(inverse, axis=0).min())
        row, column = (np.full(3, 0.5 * count) for count in self.raster.shape)
        steps = np.eye(3)
        lon, lat = np.radians(self.lon_lat(row + steps[1], column + steps[2]))
        east_m, north_m = metres_per_radian(lat[:1], np.zeros(1))
        away = np.hypot((lon[1:] - lon[0]) * east_m, (lat[1:] - lat[0]) * north_m)
        return float(away.min())

    def _corners(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return x and y (local), or longitudes and latitudes, of the corners, each shape (4,)."""
        rows, columns = self.raster.shape
        row = np.array([-0.5, -0.5, rows - 0.5, rows - 0.5])
        column = np.array([-0.5, columns - 0.5, -0.5, columns - 0.5])
        if self.frame == "ecef":
            return self.lon_lat(row, column)
        inverse = np.linalg.inv(self.pixel_from_crs[:, :2])
        x, y = inverse @ (np.stack([column, row]) - self.pixel_from_crs[:, 2:])
        return x, y

    def corners_m(self) -> NDArray[np.float64]:
        """Return the corners at height zero, shape (4, 3), in the frame."""
        x, y = self._corners()
        if self.frame == "local":
            return np.column_stack([x, y, np.zeros(4)])
        return ecef_from_geodetic(y, x, 0.0)

    def extent_text(self) -> str:
        """Say which ground the raster covers."""
        x, y = self._corners()
        if self.frame == "local":
            return f"x {x.min():.6g} to {x.max():.6g} m, y {y.min():.6g} to {y.max():.6g} m"
        return (
            f"latitude {y.min():.5g} to {y.max():.5g}, longitude {x.min():.5g} to {x.max():.5g} deg"
        )
