"""Results folders: written whole or not at all.

Numbers are written with all their digits, so that what is read equals what was written.
"""

from __future__ import annotations

import csv
import enum
import json
import math
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.errors import InputError
from geograph.io.atomic import check_replaceable, replacing_folder
from geograph.results import names
from geograph.results.extract import as_results
from geograph.track import Track

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.measurements import Truth
    from geograph.results.data import ErrorCurve, PlatformPath, Results

_MAP_CELLS = 61


def check_target(folder: Path) -> None:
    """Raise InputError if writing results to a folder would fail, or lose other files.

    Called before long work is begun. A folder of results to which something else was added is not
    replaced either, for that would be lost.
    """
    above = next(parent for parent in folder.absolute().parents if parent.exists())
    if not above.is_dir():
        raise InputError(f"{above} is a file; expected a folder to write into", path=folder)
    check_replaceable(folder)
    present = sorted(entry.name for entry in folder.iterdir()) if folder.exists() else []
    own = {*names.TABLES, *names.PICTURES, names.PLATFORM_PICTURE, names.LIKELIHOOD_PICTURE}
    strangers = [name for name in present if name not in own]
    if strangers:
        raise InputError(
            f"holds {strangers[0]!r}, which results of one recording do not have and which would "
            "be lost; move it, or name another folder",
            path=folder,
        )


def save(
    track: Track | Results,
    folder: Path | str,
    *,
    pictures: bool = True,
    solved: Track | None = None,
) -> None:
    """Write results into a folder, which holds the old ones whole or the new ones whole.

    Parameters
    ----------
    track
        A track or its results.
    folder
        Made if absent, replaced if it holds results.
    pictures
        Whether to draw the pictures too.
    solved
        The track that the results are of, if they are given: the posterior of an emitter at rest is
        drawn from it, where it is no ellipse.

    Raises
    ------
    InputError
        If the folder holds anything but results.
    """
    results, target = as_results(track), Path(folder)
    solved = track if isinstance(track, Track) else solved
    check_target(target)
    with replacing_folder(target) as fresh:
        write_files(results, fresh)
        if pictures:
            from geograph import plot

            plot.save_all(results, fresh)
            if solved is not None and _no_ellipse(solved):
                figure = plot.likelihood(solved, solved.likelihood_map(cells=_MAP_CELLS))
                figure.savefig(fresh / names.LIKELIHOOD_PICTURE)


def _no_ellipse(track: Track) -> bool:
    """Tell whether an emitter at rest has a posterior that its covariance does not describe."""
    return bool(
        track.time_s.size == 1
        and not track.problem.layout.walks
        and not track.summary["gaussian"]["holds"]
        # What is not determined at all has no contour on any map.
        and (track.summary["gaussian"]["rise_at_one_sigma"] or track.summary["hypotheses"])
    )


def write_files(results: Results, folder: Path) -> None:
    """Write the tables and the summary of results into an existing folder."""
    write_csv(folder / names.TRACK, track_columns(results))
    fields = ("sensor", "state", "unit", "estimate", "sigma", "prior_sigma")
    write_csv(folder / names.SENSORS, {f: [getattr(e, f) for e in results.errors] for f in fields})
    residuals = {name: column.tolist() for name, column in vars(results.residuals).items()}
    residuals["rejected"] = [str(value).lower() for value in residuals["rejected"]]
    write_csv(folder / names.RESIDUALS, residuals)
    write_csv(folder / names.PLACES, _place_columns(results))
    if results.platforms:
        write_csv(folder / names.PLATFORMS, _platform_columns(results.platforms))
    if results.curves:
        write_csv(folder / names.CURVES, _curve_columns(results.curves))
    if results.truth is not None:
        write_csv(folder / names.TRUTH, _truth_columns(results.truth))
    write_json(folder / names.SUMMARY, results.summary)


def write_csv(path: Path, columns: dict[str, Sequence[Any]]) -> None:
    """Write columns of equal length; floats with as many digits as it takes to read them back."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))


def write_json(path: Path, value: Any) -> None:
    """Write strict JSON."""
    path.write_text(json_text(value) + "\n", encoding="utf-8")


def json_text(value: Any) -> str:
    """Return strict JSON: what is not finite becomes null."""
    return json.dumps(plain(value), indent=2, allow_nan=False, ensure_ascii=False)


def plain(value: Any) -> Any:
    """Return a value in the types of JSON; numbers that are not finite become None."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, enum.Enum):
        value = value.value
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path | datetime) else value


def _spread(header: Sequence[str], values: NDArray[np.float64]) -> dict[str, Sequence[Any]]:
    return {name: values[:, i].tolist() for i, name in enumerate(header)}


def track_columns(results: Results) -> dict[str, Sequence[Any]]:
    """Return the columns of ``track.csv``, by name and in their order."""
    columns: dict[str, Sequence[Any]] = {"time_s": results.time_s.tolist()}
    columns |= _spread(names.POSITION, results.position_m)
    if results.velocity_m_s is not None:
        columns |= _spread(names.VELOCITY, results.velocity_m_s)
    if results.acceleration_m_s2 is not None:
        columns |= _spread(names.ACCELERATION, results.acceleration_m_s2)
    columns |= _covariance_columns(results.position_covariance_m2)
    geodetic = results.geodetic()
    if geodetic is not None:
        columns |= _spread(names.GEODETIC, geodetic)
    columns |= _spread(names.SEMI_AXES, results.semi_axes_m)
    speed, sigma = results.speed_m_s, results.sigma_speed_m_s
    if speed is not None and sigma is not None:
        columns |= dict(zip(names.SPEED, (speed.tolist(), sigma.tolist()), strict=True))
    if results.motion_covariance is not None:
        columns |= {
            name: results.motion_covariance[:, row, column].tolist()
            for name, (row, column) in names.MOTION_COVARIANCE.items()
        }
    return columns


def _covariance_columns(covariance: NDArray[np.float64]) -> dict[str, Sequence[Any]]:
    return {
        name: covariance[:, row, column].tolist()
        for name, (row, column) in names.COVARIANCE.items()
    }


def _platform_columns(platforms: Sequence[PlatformPath]) -> dict[str, Sequence[Any]]:
    def joined(name: str) -> NDArray[np.float64]:
        return np.concatenate([getattr(platform, name) for platform in platforms])

    repeats = [platform.time_s.size for platform in platforms]
    return {
        "sensor": np.repeat([platform.sensor for platform in platforms], repeats).tolist(),
        "time_s": joined("time_s").tolist(),
        **_spread(names.POSITION, joined("position_m")),
        **_spread(names.VELOCITY, joined("velocity_m_s")),
        **_covariance_columns(joined("position_covariance_m2")),
    }


def _place_columns(results: Results) -> dict[str, Sequence[Any]]:
    repeats = [place.time_s.size for place in results.sensors]
    return {
        "sensor": np.repeat([place.sensor for place in results.sensors], repeats).tolist(),
        "axes": np.repeat([place.axes for place in results.sensors], repeats).tolist(),
        "time_s": np.concatenate([place.time_s for place in results.sensors]).tolist(),
        **_spread(names.POSITION, np.concatenate([place.position_m for place in results.sensors])),
    }


def _curve_columns(curves: Sequence[ErrorCurve]) -> dict[str, Sequence[Any]]:
    repeats = [curve.time_s.size for curve in curves]
    columns: dict[str, Sequence[Any]] = {
        name: np.repeat([getattr(curve, name) for curve in curves], repeats).tolist()
        for name in ("sensor", "kind", "unit")
    }
    for name in ("time_s", "estimate", "sigma", "prior_sigma"):
        columns[name] = np.concatenate([getattr(curve, name) for curve in curves]).tolist()
    return columns


def _truth_columns(truth: Truth) -> dict[str, Sequence[Any]]:
    columns: dict[str, Sequence[Any]] = {"time_s": truth.time_s.tolist()}
    columns |= _spread(names.POSITION, truth.position_m)
    if truth.velocity_m_s is not None:
        columns |= _spread(names.VELOCITY, truth.velocity_m_s)
    return columns
