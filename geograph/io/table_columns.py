"""What the tables of a recording hold when written, so that every number reads back equal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError
from geograph.io.arrival_table import valid_label
from geograph.io.messages import shown

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from geograph.measurements import Arrivals, Bearings, FrequencyDifferences, TimeDifferences
    from geograph.recording import Recording
    from geograph.sensors import Trajectory

Columns = dict[str, "NDArray[np.float64] | Sequence[str]"]
"""Columns of one table by name: numbers, NaN for an empty cell, or texts."""


def table_columns(recording: Recording, target: Path) -> dict[str, Columns]:
    """Return the columns of every table of a recording but the trajectories, by table.

    Tables without a row are left out.

    Parameters
    ----------
    recording
        What they hold.
    target
        The recording to be written, for messages.

    Raises
    ------
    InputError
        If emissions have numbers without a name or names that cannot stand in a table.
    """
    names = recording.sensor_names
    columns: dict[str, Columns] = {}
    if recording.bearings is not None and len(recording.bearings):
        columns["bearings"] = _bearing_columns(recording.bearings, names)
    if recording.arrivals is not None and len(recording.arrivals):
        columns["arrivals"] = _arrival_columns(recording.arrivals, names, target)
    times, frequencies = recording.time_differences, recording.frequency_differences
    if times is not None and len(times):
        columns["time_differences"] = {
            **_pair_columns(times, names),
            "tdoa_s": times.tdoa_s,
            "sigma_s": times.sigma_s,
            **_shared_column("sigma_reference_s", times.sigma_reference_s),
        }
    if frequencies is not None and len(frequencies):
        columns["frequency_differences"] = {
            **_pair_columns(frequencies, names),
            "fdoa_hz": frequencies.fdoa_hz,
            "carrier_hz": frequencies.carrier_hz,
            "sigma_hz": frequencies.sigma_hz,
            **_shared_column("sigma_reference_hz", frequencies.sigma_reference_hz),
        }
    if recording.constraints is not None:
        columns["constraints"] = {
            "time_s": recording.constraints.time_s,
            "kind": recording.constraints.kind,
            "value": recording.constraints.value,
            "sigma": recording.constraints.sigma,
        }
    if recording.truth is not None:
        columns["truth"] = _path_columns(recording.truth.time_s, recording.truth.position_m)
        velocity = recording.truth.velocity_m_s
        if velocity is not None:
            for index, name in enumerate(("vx_m_s", "vy_m_s", "vz_m_s")):
                columns["truth"][name] = velocity[:, index]
    return columns


def trajectory_columns(trajectory: Trajectory) -> Columns:
    """Return the columns of the positions, and attitudes if known, of a moving sensor."""
    columns = _path_columns(trajectory.time_s, trajectory.position_m)
    if trajectory.attitude_rad is not None:
        for index, angle in enumerate(("yaw", "pitch", "roll")):
            columns.update(_angle_column(angle, trajectory.attitude_rad[:, index]))
    return columns


def _path_columns(time_s: NDArray[np.float64], position_m: NDArray[np.float64]) -> Columns:
    x, y, z = position_m.T
    return {"time_s": time_s, "x_m": x, "y_m": y, "z_m": z}


def _arrival_columns(arrivals: Arrivals, names: tuple[str, ...], target: Path) -> Columns:
    numbers, labels = np.unique(arrivals.emission), arrivals.emission_names
    if labels:
        used = [labels[number] for number in numbers]
        for label in used:
            if not valid_label(label):
                raise InputError(
                    f"an emission is called {shown(label)}; expected printable text with no blanks "
                    "around it",
                    path=target,
                    column="emission",
                )
        if len(set(used)) < len(used):
            raise InputError(
                "two emissions have the same name; expected different ones",
                path=target,
                column="emission",
            )
    label_of = {number: labels[number] if labels else str(number) for number in numbers.tolist()}
    return {
        "emission": [label_of[number] for number in arrivals.emission.tolist()],
        "sensor": [names[index] for index in arrivals.sensor],
        "toa_s": arrivals.toa_s,
        "sigma_s": arrivals.sigma_s,
    }


def _pair_columns(table: TimeDifferences | FrequencyDifferences, names: tuple[str, ...]) -> Columns:
    return {
        "time_s": table.time_s,
        "sensor": [names[index] for index in table.sensor],
        "reference": [names[index] for index in table.reference],
    }


def _shared_column(name: str, sigma: NDArray[np.float64]) -> Columns:
    return {name: sigma} if sigma.any() else {}


def _bearing_columns(bearings: Bearings, names: tuple[str, ...]) -> Columns:
    columns: Columns = {
        "time_s": bearings.time_s,
        "sensor": [names[index] for index in bearings.sensor],
    }
    columns.update(_angle_column("azimuth", bearings.azimuth_rad))
    azimuth_only = np.isnan(bearings.elevation_rad)
    if not azimuth_only.all():
        columns.update(_angle_column("elevation", bearings.elevation_rad))
    sky = bearings.isotropic | azimuth_only
    if sky.any():
        columns.update(_angle_column("sigma", np.where(sky, bearings.sigma_azimuth_rad, np.nan)))
    if not sky.all():
        for name, sigma in (
            ("sigma_azimuth", bearings.sigma_azimuth_rad),
            ("sigma_elevation", bearings.sigma_elevation_rad),
        ):
            columns.update(_angle_column(name, np.where(sky, np.nan, sigma)))
    return columns


def _angle_column(name: str, angle_rad: NDArray[np.float64]) -> Columns:
    degrees = exact_degrees(angle_rad)
    return {f"{name}_rad": angle_rad} if degrees is None else {f"{name}_deg": degrees}


def exact_degrees(angle_rad: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the degrees that convert to exactly these radians, or None if some have none.

    Conversion from degrees skips some numbers and repeats others, so angles that came from degrees
    always have an answer, and the one of fewest digits is preferred; others may have none.

    Parameters
    ----------
    angle_rad
        Any shape, radians; NaN stays NaN.
    """
    nearest = np.degrees(angle_rad)
    candidates = [
        *(np.round(nearest, digits) for digits in (6, 9, 12, 13, 14, 15)),
        nearest,
        np.nextafter(nearest, np.inf),
        np.nextafter(nearest, -np.inf),
    ]
    degrees = np.full_like(nearest, np.nan)
    found = np.isnan(angle_rad)
    for candidate in candidates:
        fits = ~found & (np.radians(candidate) == angle_rad)
        degrees[fits] = candidate[fits]
        found |= fits
    return degrees if found.all() else None
