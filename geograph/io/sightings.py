"""From the rows of a foreign file to a recording: what readers of such formats share.

A reader collects rows, and :func:`recording_of` does the rest: the epoch, the sensors from the
station list, sigmas where the format has none, right ascension and declination turned into azimuth
and elevation.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph import earth
from geograph.errors import InputError
from geograph.geodesy import enu_axes
from geograph.io.ecsv import option_value
from geograph.io.instants import SECOND_NS, as_datetime, minute_of
from geograph.io.messages import shown
from geograph.io.rows import Difference, ImportOptions, Reception, Row, Sighting
from geograph.io.scatter import smooth_scatter_rad
from geograph.io.stations import matched, missing, resolve
from geograph.measurements import Arrivals, Bearings, FrequencyDifferences, TimeDifferences
from geograph.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.sensors import Sensor


def recording_of(
    rows: Sequence[Row], options: ImportOptions, *, extra: str = "optical"
) -> Recording:
    """Return a recording of what was read, in ECEF.

    Its epoch is the UTC minute of the first measurement; its sensors are those that measured, in
    the order in which they first did.

    Parameters
    ----------
    rows
        At least one.
    options
        What the file does not say.
    extra
        The extra to be named where astropy is missing.

    Raises
    ------
    InputError
        If a sensor is in no station list, a sigma is missing, or the Earth's orientation is not
        known.
    """
    epoch = minute_of(min(row.tai_ns for row in rows))
    sightings = [row for row in rows if isinstance(row, Sighting)]
    differences = [row for row in rows if isinstance(row, Difference)]
    receptions = [row for row in rows if isinstance(row, Reception)]
    sensors, index = _sensors(rows, sightings, options, epoch)
    times = [row for row in differences if np.isnan(row.carrier_hz)]
    frequencies = [row for row in differences if not np.isnan(row.carrier_hz)]
    return Recording(
        name=options.name,
        frame="ecef",
        sensors=sensors,
        bearings=(
            _bearings(sightings, options, sensors, index, epoch=epoch, extra=extra)
            if sightings
            else None
        ),
        arrivals=_arrivals(receptions, index, epoch) if receptions else None,
        time_differences=_time_differences(times, index, epoch) if times else None,
        frequency_differences=(
            _frequency_differences(frequencies, index, epoch) if frequencies else None
        ),
        epoch=as_datetime(epoch),
        settings=options.settings,
    )


def _seconds(rows: Sequence[Row], epoch: int) -> NDArray[np.float64]:
    return np.array([row.tai_ns - epoch for row in rows], dtype=np.int64) / SECOND_NS


def _sensors(
    rows: Sequence[Row], sightings: Sequence[Sighting], options: ImportOptions, epoch: int
) -> tuple[dict[str, Sensor], dict[str, int]]:
    """Return the sensors by their names in the station list, and indices by those in the file."""
    known: dict[str, str] = {}
    spans: dict[str, list[int]] = {}
    for row in rows:
        pair = (row.reference, row.sensor) if isinstance(row, Difference) else (row.sensor,)
        for name in pair:
            if name not in known:
                station = matched(name, options.stations)
                if station is None:
                    raise InputError(missing(name, options.stations), path=row.place, line=row.line)
                known[name] = station
            spans.setdefault(known[name], []).append(row.tai_ns)
    names = list(spans)
    sensors = {}
    for name, times in spans.items():
        span = ((min(times) - epoch) / SECOND_NS, (max(times) - epoch) / SECOND_NS)
        sensor = resolve(options.stations[name], name, epoch, span)
        mine = [row.sigma_time_s for row in sightings if known[row.sensor] == name]
        sensors[name] = _with_priors(sensor, names, options, mine)
    _check_axes(sensors, sightings, known)
    for name, refraction in _refraction(sightings, known).items():
        sensors[name] = dataclasses.replace(sensors[name], refraction=refraction)
    return sensors, {name: names.index(station) for name, station in known.items()}


def _check_axes(
    sensors: dict[str, Sensor], sightings: Sequence[Sighting], known: dict[str, str]
) -> None:
    for row in sightings:
        axes = sensors[known[row.sensor]].axes
        if axes != "enu":
            raise InputError(
                f"is a direction from {shown(row.sensor)}, which has axes {axes} in the station "
                "list; expected enu, the axes of azimuth and elevation in this format",
                path=row.place,
                line=row.line,
            )


def _with_priors(
    sensor: Sensor, names: list[str], options: ImportOptions, sigma_time_s: list[float]
) -> Sensor:
    """Return a sensor with priors as given, and with its clock's from the time tags' sigmas.

    Time tags of one observer in one pass are off together more than apart: a reaction, a clock that
    was not set.
    """
    changes: dict[str, float] = {}
    bias = option_value(options.bias_deg, sensor.name, names, "bias_deg")
    if bias is not None:
        changes |= dict.fromkeys(
            ("azimuth_bias_rad", "elevation_bias_rad"), float(np.radians(bias))
        )
    clock = option_value(options.clock_offset_s, sensor.name, names, "clock_offset_s")
    if clock is None and sensor.errors.clock_offset_s == 0.0:
        known = [sigma for sigma in sigma_time_s if not np.isnan(sigma)]
        clock = float(np.median(known)) if known else None
    if clock is not None:
        changes["clock_offset_s"] = clock
    return dataclasses.replace(sensor, errors=dataclasses.replace(sensor.errors, **changes))


def _refraction(
    sightings: Sequence[Sighting], known: dict[str, str]
) -> dict[str, Literal["none", "standard"]]:
    """Return the refraction of sensors of which the format says it; InputError where both."""
    said: dict[str, tuple[bool, Sighting]] = {}
    for row in sightings:
        if row.refracted is None:
            continue
        before, first = said.setdefault(known[row.sensor], (row.refracted, row))
        if before != row.refracted:
            raise InputError(
                f"is {'not ' if row.refracted else ''}corrected for refraction unlike that in line "
                f"{first.line}, of the same sensor {shown(row.sensor)}; expected one kind from "
                "each sensor; convert them apart, under two names",
                path=row.place,
                line=row.line,
            )
    return {name: "standard" if value else "none" for name, (value, _) in said.items()}


def _bearings(
    rows: Sequence[Sighting],
    options: ImportOptions,
    sensors: dict[str, Sensor],
    index: dict[str, int],
    *,
    epoch: int,
    extra: str,
) -> Bearings:
    time = _seconds(rows, epoch)
    sensor = np.array([index[row.sensor] for row in rows], dtype=np.int64)
    first = np.array([row.first_rad for row in rows])
    second = np.array([row.second_rad for row in rows])
    celestial = np.array([row.kind == "radec" for row in rows])
    if celestial.any():
        chosen = [row for row in rows if row.kind == "radec"]
        first[celestial], second[celestial] = _azimuth_elevation(
            chosen, time[celestial], sensor[celestial], list(sensors.values()), extra
        )
    sigma = np.array([row.sigma_rad for row in rows])
    for number, name in enumerate(sensors):
        mine = sensor == number
        if mine.any():
            where = next(row for row in rows if index[row.sensor] == number)
            given = option_value(options.sigma_deg, name, list(sensors), "sigma_deg")
            if given is not None:
                sigma[mine] = np.radians(given)
            bare = mine & np.isnan(sigma)
            if bare.any():
                sigma[bare] = _scatter(where, name, time[bare], first[bare], second[bare])
    return Bearings(
        time_s=time,
        sensor=sensor,
        azimuth_rad=first,
        elevation_rad=second,
        sigma_azimuth_rad=sigma,
        sigma_elevation_rad=sigma.copy(),
        isotropic=np.ones(time.size, dtype=bool),
        line=np.array([row.line for row in rows], dtype=np.int64),
    )


def _scatter(
    where: Sighting,
    name: str,
    time_s: NDArray[np.float64],
    azimuth_rad: NDArray[np.float64],
    elevation_rad: NDArray[np.float64],
) -> float:
    """Return the scatter of directions for which the file has no sigma."""
    scatter = None
    if np.isfinite(elevation_rad).all():
        scatter = smooth_scatter_rad(time_s, azimuth_rad, elevation_rad)
    if scatter is None:
        raise InputError(
            f"sensor {shown(name)} has {time_s.size} directions without a sigma, from which "
            "their scatter cannot be told (it takes both angles at eight different times, and "
            "noise); give sigma_deg",
            path=where.place,
            line=where.line,
        )
    # More digits than a scatter has would suggest that they mean something.
    return float(np.radians(float(f"{np.degrees(scatter):.3g}")))


def _azimuth_elevation(
    rows: Sequence[Sighting],
    time_s: NDArray[np.float64],
    sensor: NDArray[np.int64],
    sensors: list[Sensor],
    extra: str,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return azimuths and elevations of directions measured against stars."""
    place = rows[0].place
    tai = np.array([row.tai_ns for row in rows], dtype=np.int64)
    ascension = np.array([row.first_rad for row in rows])
    declination = np.array([row.second_rad for row in rows])
    direction = np.stack(
        [
            np.cos(declination) * np.cos(ascension),
            np.cos(declination) * np.sin(ascension),
            np.sin(declination),
        ],
        axis=1,
    )
    equinox = np.array([row.equinox for row in rows])
    direction = earth.icrs_from_equinox(direction, equinox, tai, place, extra)
    direction = earth.gcrs_from_astrometric(direction, tai, place, extra)
    turn = earth.earth_fixed_from_gcrs(tai, place, extra)
    position = np.empty((len(rows), 3))
    for number in np.unique(sensor):
        mine = sensor == number
        position[mine] = sensors[number].position_at(time_s[mine])
    level = np.einsum("nij,njk,nk->ni", enu_axes(position), turn, direction)
    azimuth = np.mod(np.arctan2(level[:, 0], level[:, 1]), 2.0 * np.pi)
    return azimuth, np.arctan2(level[:, 2], np.hypot(level[:, 0], level[:, 1]))


def _arrivals(rows: Sequence[Reception], index: dict[str, int], epoch: int) -> Arrivals:
    names = list(dict.fromkeys(row.emission for row in rows))
    number = {name: position for position, name in enumerate(names)}
    return Arrivals(
        emission=np.array([number[row.emission] for row in rows], dtype=np.int64),
        sensor=np.array([index[row.sensor] for row in rows], dtype=np.int64),
        toa_s=_seconds(rows, epoch),
        sigma_s=np.array([row.sigma_s for row in rows]),
        emission_names=tuple(names),
        line=np.array([row.line for row in rows], dtype=np.int64),
    )


def _time_differences(
    rows: Sequence[Difference], index: dict[str, int], epoch: int
) -> TimeDifferences:
    return TimeDifferences(
        time_s=_seconds(rows, epoch),
        sensor=np.array([index[row.sensor] for row in rows], dtype=np.int64),
        reference=np.array([index[row.reference] for row in rows], dtype=np.int64),
        tdoa_s=np.array([row.value for row in rows]),
        sigma_s=np.array([row.sigma for row in rows]),
        sigma_reference_s=np.zeros(len(rows)),
        line=np.array([row.line for row in rows], dtype=np.int64),
    )


def _frequency_differences(
    rows: Sequence[Difference], index: dict[str, int], epoch: int
) -> FrequencyDifferences:
    return FrequencyDifferences(
        time_s=_seconds(rows, epoch),
        sensor=np.array([index[row.sensor] for row in rows], dtype=np.int64),
        reference=np.array([index[row.reference] for row in rows], dtype=np.int64),
        fdoa_hz=np.array([row.value for row in rows]),
        carrier_hz=np.array([row.carrier_hz for row in rows]),
        sigma_hz=np.array([row.sigma for row in rows]),
        sigma_reference_hz=np.zeros(len(rows)),
        line=np.array([row.line for row in rows], dtype=np.int64),
    )
