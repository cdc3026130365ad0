"""Results in the formats of other programs, each imported when it is asked for.

``write(track, "track.kml")`` chooses by the suffix; docs/formats.md says what each file holds.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from geograph.export.by_suffix import SUFFIXES, write
    from geograph.export.czml import write_czml
    from geograph.export.geojson import write_geojson
    from geograph.export.kml import write_kml
    from geograph.export.oem import write_oem
    from geograph.export.table import to_pandas, to_xarray, write_parquet

__all__ = [
    "SUFFIXES",
    "to_pandas",
    "to_xarray",
    "write",
    "write_czml",
    "write_geojson",
    "write_kml",
    "write_oem",
    "write_parquet",
]

_HOMES = {
    "SUFFIXES": "by_suffix",
    "to_pandas": "table",
    "to_xarray": "table",
    "write": "by_suffix",
    "write_czml": "czml",
    "write_geojson": "geojson",
    "write_kml": "kml",
    "write_oem": "oem",
    "write_parquet": "table",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    setattr(sys.modules[__name__], name, value)
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
