"""Readers and writers of recordings; those of other formats are imported when asked for."""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

from geograph.io.convert import ForeignOptions, convert
from geograph.io.ecsv import read_ecsv
from geograph.io.reader import read
from geograph.io.writer import write

if TYPE_CHECKING:
    from geograph.io.iod import read_iod
    from geograph.io.mapped import read_frame, read_mapped
    from geograph.io.mpc import read_mpc
    from geograph.io.rows import ImportOptions
    from geograph.io.stations import read_stations
    from geograph.io.tdm import read_tdm
    from geograph.io.uk import read_uk

__all__ = [
    "ForeignOptions",
    "ImportOptions",
    "convert",
    "read",
    "read_ecsv",
    "read_frame",
    "read_iod",
    "read_mapped",
    "read_mpc",
    "read_stations",
    "read_tdm",
    "read_uk",
    "write",
]

_HOMES = {
    "ImportOptions": "rows",
    "read_frame": "mapped",
    "read_iod": "iod",
    "read_mapped": "mapped",
    "read_mpc": "mpc",
    "read_stations": "stations",
    "read_tdm": "tdm",
    "read_uk": "uk",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    setattr(sys.modules[__name__], name, value)
    return value
