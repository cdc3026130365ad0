"""Tables: Parquet files, pandas frames and xarray datasets of a path."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.errors import InputError
from geograph.export._place import epoch_of
from geograph.io.atomic import replacing_file
from geograph.io.instants import SECOND_NS, tai_to_utc_ns
from geograph.io.parquet_table import import_parquet
from geograph.results import as_results
from geograph.results.write import json_text, track_columns

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

    from geograph.results import Results
    from geograph.track import Track


def _utc(results: Results) -> NDArray[np.datetime64] | None:
    """Return UTC times of the knots, shape (k,), nanoseconds; None without an epoch."""
    epoch = epoch_of(results)
    if epoch is None:
        return None
    tai = epoch + np.round(results.time_s * SECOND_NS).astype(np.int64)
    counts = np.array([tai_to_utc_ns(int(value)) for value in tai], dtype=np.int64)
    return counts.astype("datetime64[ns]")


def _facts(results: Results) -> dict[str, Any]:
    epoch = results.summary.get("epoch")
    facts = {"name": results.name, "frame": results.frame, "status": results.status}
    return facts if epoch is None else facts | {"epoch": str(epoch)}


def to_pandas(track: Track | Results) -> pd.DataFrame:
    """Return a path as a pandas frame.

    Parameters
    ----------
    track
        A track or its results.

    Returns
    -------
    pandas.DataFrame
        A row for each knot, with the columns of ``track.csv`` (docs/results.md), and ``time_utc``
        where there is an epoch. Name, frame, status and epoch are in its ``attrs``.
    """
    import pandas as pd

    results = as_results(track)
    frame = pd.DataFrame(track_columns(results))
    utc = _utc(results)
    if utc is not None:
        frame.insert(1, "time_utc", pd.DatetimeIndex(utc, tz="UTC"))
    frame.attrs.update(_facts(results))
    return frame


def to_xarray(track: Track | Results) -> Any:
    """Return a path as an xarray dataset (needs the extra ``xarray``).

    Parameters
    ----------
    track
        A track or its results.

    Returns
    -------
    xarray.Dataset
        Over ``time_s``: ``position`` and, where there are any, ``velocity`` and ``acceleration``
        over ``axis`` (x, y, z); ``position_covariance`` over ``axis`` and ``axis_2``; in ECEF
        ``latitude``, ``longitude`` and ``height``; the coordinate ``time_utc`` where there is an
        epoch. Units are in the attributes ``units``.

    Raises
    ------
    InputError
        If xarray is not installed.
    """
    try:
        import xarray as xr
    except ImportError:
        raise InputError("xarray is not installed; run pip install 'geograph[xarray]'") from None
    results = as_results(track)
    along = ("time_s", "axis")
    variables: dict[str, Any] = {
        "position": (along, results.position_m, {"units": "m"}),
        "position_covariance": (
            (*along, "axis_2"),
            results.position_covariance_m2,
            {"units": "m2"},
        ),
    }
    for name, values, units in (
        ("velocity", results.velocity_m_s, "m s-1"),
        ("acceleration", results.acceleration_m_s2, "m s-2"),
    ):
        if values is not None:
            variables[name] = (along, values, {"units": units})
    geodetic = results.geodetic()
    if geodetic is not None:
        for column, (name, units) in enumerate(
            (("latitude", "degrees_north"), ("longitude", "degrees_east"), ("height", "m"))
        ):
            variables[name] = ("time_s", geodetic[:, column], {"units": units})
    axes = ["x", "y", "z"]
    coordinates: dict[str, Any] = {
        "time_s": ("time_s", results.time_s, {"units": "s"}),
        "axis": axes,
        "axis_2": axes,
    }
    utc = _utc(results)
    if utc is not None:
        coordinates["time_utc"] = ("time_s", utc)
    return xr.Dataset(variables, coordinates, _facts(results))


def write_parquet(track: Track | Results, path: Path | str) -> None:
    """Write a path as a Parquet file (needs the extra ``parquet``).

    Parameters
    ----------
    track
        A track or its results; local frames too.
    path
        The file; an older one is replaced. Its columns are those of :func:`to_pandas`, its
        metadata's key ``geograph`` is JSON with name, frame, status and epoch.

    Raises
    ------
    InputError
        If pyarrow is not installed, or the file cannot be written.
    """
    target = Path(path)
    arrow, parquet = import_parquet(target)
    results = as_results(track)
    columns: dict[str, Any] = {
        name: np.asarray(values) for name, values in track_columns(results).items()
    }
    names = list(columns)
    utc = _utc(results)
    if utc is not None:
        columns["time_utc"] = arrow.array(utc, type=arrow.timestamp("ns", tz="UTC"))
        names.insert(1, "time_utc")
    table = arrow.table({name: columns[name] for name in names})
    facts = json_text(_facts(results)).encode()
    table = table.replace_schema_metadata({b"geograph": facts})
    with replacing_file(target) as staging:
        parquet.write_table(table, staging)
