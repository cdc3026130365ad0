"""The exporter of a file by its suffix."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from geograph.errors import InputError
from geograph.io.messages import shown

if TYPE_CHECKING:
    from geograph.results import Results
    from geograph.track import Track

_WRITERS = {
    ".oem": ("oem", "write_oem"),
    ".geojson": ("geojson", "write_geojson"),
    ".kml": ("kml", "write_kml"),
    ".czml": ("czml", "write_czml"),
    ".parquet": ("table", "write_parquet"),
}
SUFFIXES = tuple(_WRITERS)
"""Suffixes of the files that can be written."""


def write(track: Track | Results, path: Path | str) -> None:
    """Write a track or its results as a file of another program, by the suffix of its name.

    Parameters
    ----------
    track
        As :func:`geograph.smooth` returned it, or :func:`geograph.results.load`.
    path
        Ends in ``.oem``, ``.geojson``, ``.kml``, ``.czml`` or ``.parquet``. An older file is
        replaced; when anything fails it stays.

    Raises
    ------
    InputError
        If the suffix is another, the results have no place on the Earth or in time, or the file
        cannot be written.
    """
    target = Path(path)
    found = _WRITERS.get(target.suffix.lower())
    if found is None:
        raise InputError(
            f"ends in {shown(target.suffix)}; expected one of {', '.join(SUFFIXES)}", path=target
        )
    module, name = found
    getattr(import_module(f"geograph.export.{module}"), name)(track, target)
