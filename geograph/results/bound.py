"""The files of a Cramer-Rao bound: tables, summary and pictures, written whole or not at all."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.io.atomic import check_replaceable, replacing_folder
from geograph.results import names
from geograph.results.data import ELLIPSOID_PROBABILITY
from geograph.results.extract import versions
from geograph.results.write import write_csv, write_json

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from geograph.bound_grid import BoundMap
    from geograph.bounds import PathBound
    from geograph.recording import Recording
    from geograph.signal import Signal

TABLE, SUMMARY, MAP_TABLE = "bound.csv", "bound.json", "bound_map.csv"
PICTURE, MAP_PICTURE = "bound.png", "bound_map.png"
FILES = (TABLE, SUMMARY, MAP_TABLE, PICTURE, MAP_PICTURE)
"""Files of a folder of a bound that a new run replaces; all others stay."""

_SIGMA_COLUMNS = {
    "bearings": {"sigma_azimuth_rad": "rad", "sigma_elevation_rad": "rad"},
    "arrivals": {"sigma_s": "s"},
    "time_differences": {"sigma_s": "s"},
    "frequency_differences": {"sigma_hz": "Hz"},
}


def check_bound_target(folder: Path) -> None:
    """Raise InputError if a bound cannot be written to a folder; called before long work."""
    check_replaceable(folder, markers=(SUMMARY,))


def save_bound(
    bound: PathBound,
    folder: Path,
    *,
    over: BoundMap | None = None,
    signal: Signal | None = None,
    pictures: bool = True,
    command: str | None = None,
) -> None:
    """Write a bound into a folder, which holds the old one whole or the new one whole.

    Parameters
    ----------
    bound
        Along the path.
    folder
        Made if absent, replaced if it holds a bound.
    over
        The bound as a map, or None.
    signal
        What gave the sigmas, for the summary.
    pictures
        Whether to draw the pictures too.
    command
        Command line to be noted in the summary.

    Raises
    ------
    InputError
        If the folder holds anything but a bound.
    """
    check_bound_target(folder)
    with replacing_folder(folder, markers=(SUMMARY,), own=FILES) as fresh:
        write_csv(fresh / TABLE, bound_columns(bound))
        facts = bound_facts(bound, over=over, signal=signal)
        write_json(fresh / SUMMARY, facts | {"versions": versions(), "command": command})
        if over is not None:
            write_csv(fresh / MAP_TABLE, map_columns(over))
        if pictures:
            from geograph.plot._bound import save_pictures

            save_pictures(bound, over, fresh / PICTURE, fresh / MAP_PICTURE)


def axis_names(bound: PathBound | BoundMap) -> tuple[str, str, str]:
    """Return what the axes of the sigmas are called."""
    return ("east", "north", "up") if bound.frame == "ecef" else ("x", "y", "z")


def bound_columns(bound: PathBound) -> dict[str, Sequence[Any]]:
    """Return the columns of the table of a bound, a row for each knot."""
    columns: dict[str, Sequence[Any]] = {"time_s": bound.time_s.tolist()}

    def add(header: Sequence[str], values: Any) -> None:
        for index, name in enumerate(header):
            columns[name] = values[:, index].tolist()

    add(names.POSITION, bound.position_m)
    geodetic = bound.geodetic()
    if geodetic is not None:
        add(names.GEODETIC, geodetic)
    add([f"sigma_{name}_m" for name in axis_names(bound)], bound.sigma_axes_m)
    columns["sigma_horizontal_m"] = bound.sigma_horizontal_m.tolist()
    columns["sigma_height_m"] = bound.sigma_height_m.tolist()
    columns["cep_m"] = bound.cep_m().tolist()
    ellipses = bound.horizontal_ellipses(ELLIPSOID_PROBABILITY)
    add(("horizontal_major_m", "horizontal_minor_m"), ellipses.semi_axes_m)
    add(names.SEMI_AXES, bound.ellipsoids(ELLIPSOID_PROBABILITY).semi_axes_m)
    velocity = bound.sigma_velocity_m_s
    if velocity is not None:
        columns["sigma_velocity_m_s"] = velocity.tolist()
    for name, (row, column) in names.COVARIANCE.items():
        columns[name] = bound.position_covariance_m2[:, row, column].tolist()
    return columns


def map_columns(over: BoundMap) -> dict[str, Sequence[Any]]:
    """Return the columns of the table of a map, a row for each cell."""
    across, along, _ = axis_names(over)
    east, north = np.meshgrid(over.east_m, over.north_m)
    columns: dict[str, Sequence[Any]] = {
        f"{across}_m": east.ravel().tolist(),
        f"{along}_m": north.ravel().tolist(),
    }
    geodetic = over.geodetic()
    if geodetic is None:
        columns["z_m"] = over.position_m[..., 2].ravel().tolist()
    else:
        for index, name in enumerate(names.GEODETIC):
            columns[name] = geodetic[..., index].ravel().tolist()
    columns["sigma_horizontal_m"] = over.sigma_horizontal_m.ravel().tolist()
    for index, name in enumerate(("horizontal_major_m", "horizontal_minor_m")):
        columns[name] = over.semi_axes_m[..., index].ravel().tolist()
    columns["not_observable_because"] = over.reason.ravel().tolist()
    return columns


def used_sigmas(recording: Recording) -> dict[str, dict[str, dict[str, Any]]]:
    """Return unit, least, median and greatest of the sigmas of every table, by its columns."""
    result: dict[str, dict[str, dict[str, Any]]] = {}
    for name, table in recording.tables.items():
        for column, unit in _SIGMA_COLUMNS[name].items():
            values = getattr(table, column)
            values = values[np.isfinite(values)]
            if values.size:
                result.setdefault(name, {})[column] = {
                    "unit": unit,
                    "least": float(values.min()),
                    "median": float(np.median(values)),
                    "greatest": float(values.max()),
                }
    return result


def bound_facts(
    bound: PathBound, *, over: BoundMap | None = None, signal: Signal | None = None
) -> dict[str, Any]:
    """Return the summary of a bound, in the types of JSON.

    Parameters
    ----------
    bound
        Along the path.
    over
        As a map, or None.
    signal
        What gave the sigmas, or None.
    """
    recording = bound.recording
    facts: dict[str, Any] = {
        "name": recording.name,
        "frame": bound.frame,
        "epoch": None if recording.epoch is None else recording.epoch.isoformat(),
        "observable": bound.observable,
        "weakly_observed": bound.weakly_observed,
        "directions": [dataclasses.asdict(direction) for direction in bound.directions],
        "evaluated_at": bound.evaluated_at,
        "left_out": bound.left_out,
        "process_noise_from": bound.process_noise_from,
        "settings": dataclasses.asdict(bound.settings),
        "knots": int(bound.time_s.size),
        "measurements": {name: len(table) for name, table in recording.tables.items()},
        "sigmas": used_sigmas(recording),
        "signal": None if signal is None else signal_facts(signal),
        "sigma_horizontal_m": extremes(bound.sigma_horizontal_m),
        "sigma_height_m": extremes(bound.sigma_height_m),
        "cep_m": extremes(bound.cep_m()),
        "sensors": {
            name: {state: dataclasses.asdict(entry) for state, entry in states.items()}
            for name, states in bound.sensor_bounds.items()
        },
        "ellipsoid_probability": ELLIPSOID_PROBABILITY,
    }
    velocity = bound.sigma_velocity_m_s
    if velocity is not None:
        facts["sigma_velocity_m_s"] = extremes(velocity)
    if over is not None:
        facts["map"] = map_facts(over)
    return facts


def map_facts(over: BoundMap) -> dict[str, Any]:
    """Return the summary of a map: its size, extremes, and how much of it is not observable."""
    reasons, counts = np.unique(over.reason[~over.observable], return_counts=True)
    return {
        "center_m": over.center_m.tolist(),
        "cells": int(over.east_m.size),
        "extent_m": float(np.ptp(over.east_m)) * over.east_m.size / (over.east_m.size - 1),
        "sigma_horizontal_m": extremes(over.sigma_horizontal_m[over.observable]),
        "not_observable": dict(zip(reasons.tolist(), counts.tolist(), strict=True)),
    }


def signal_facts(signal: Signal) -> dict[str, Any]:
    """Return a signal and the sigmas that follow from it."""
    return dataclasses.asdict(signal) | {
        "uses_phase": signal.uses_phase,
        "reachable": signal.reachable,
        "arrival_sigma_s": signal.arrival_sigma_s(),
        "time_difference_sigma_s": signal.time_difference_sigma_s(),
        "frequency_difference_sigma_hz": signal.frequency_difference_sigma_hz(),
    }


def extremes(values: Any) -> dict[str, float | None]:
    """Return best, median and worst of values along a path; None where there is none."""
    values = np.asarray(values, dtype=np.float64).ravel()
    if not values.size:
        return {"best": None, "median": None, "worst": None}
    # What is not determined is worse than everything that is.
    values = np.where(np.isnan(values), np.inf, values)
    return {
        "best": float(values.min()),
        "median": float(np.median(values)),
        "worst": float(values.max()),
    }
