"""The ground in ``recording.toml``, and names of files that it gives (docs/format.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast, get_args

from geograph.io.messages import shown
from geograph.recording import HeightDatum

if TYPE_CHECKING:
    from geograph.io.document import Document, KeyPath
    from geograph.recording import Frame


@dataclass(frozen=True, eq=False, kw_only=True)
class TerrainEntry:
    """The ground as the header has it: its file, and what its heights are above."""

    file: str
    heights: HeightDatum | None
    geoid_undulation_m: float | None


def read_terrain_entry(
    document: Document, root: dict[str, Any], frame: Frame
) -> TerrainEntry | None:
    """Return what a header says of the ground; raises InputError if it is wrong."""
    keys = [key for key in ("terrain_heights", "geoid_undulation_m") if key in root]
    if "terrain" not in root:
        if keys:
            document.fail((keys[0],), f"{keys[0]} needs a terrain; name its GeoTIFF or remove it")
        return None
    if keys and frame == "local":
        document.fail(
            (keys[0],),
            f"{keys[0]} is for the frame ecef; in a local frame the raster's heights are z; remove "
            "it",
        )
    file = file_name(document, ("terrain",), root["terrain"], (".tif", ".tiff"), "GeoTIFF")
    heights = root.get("terrain_heights")
    if heights is not None:
        heights = document.choice(("terrain_heights",), heights, get_args(HeightDatum))
    undulation = root.get("geoid_undulation_m")
    if undulation is not None:
        # The geoid is nowhere further from the ellipsoid.
        undulation = document.number(("geoid_undulation_m",), undulation, low=-120.0, high=120.0)
        if heights == "ellipsoid":
            document.fail(
                ("geoid_undulation_m",),
                "geoid_undulation_m is of heights above the geoid, and terrain_heights is "
                "ellipsoid; remove one of them",
            )
    return TerrainEntry(
        file=file, heights=cast("HeightDatum | None", heights), geoid_undulation_m=undulation
    )


def file_name(
    document: Document, path: KeyPath, value: object, suffixes: tuple[str, ...], what: str
) -> str:
    """Return the name of a file in the recording; raises InputError if it is none."""
    name = document.text_of(path, value)
    parts = name.split("/")
    plain_path = all(part and part != ".." for part in parts) and "\\" not in name
    if not plain_path or not name.isprintable() or not name.endswith(suffixes):
        document.fail(path, f"is {shown(name)}; expected the name of a {what} in the recording")
    return name
