"""Mistakes that people make when they write recordings, each with its repair."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.geodesy import ecef_from_geodetic, geodetic_from_ecef

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from geograph.checkup.fits import Case
    from geograph.sensors import Sensor

_FEET_M = 0.3048
_HOUR_S = 3600.0

# Whole seconds that are tried, and the half hours of time zones.
_MOST_SECONDS = 60
_MOST_HALF_HOURS = 28

KNOWN_SHIFTS = {
    18.0: "GPS time is 18 s ahead of UTC",
    37.0: "TAI is 37 s ahead of UTC",
    19.0: "TAI is 19 s ahead of GPS time",
}


@dataclass(frozen=True, eq=False)
class Correction:
    """One hypothesis of what is wrong.

    Attributes
    ----------
    kind
        A word for programs.
    said
        As it would be right: "with its longitude as -1.2 instead of 1.2".
    remedy
        What to do.
    place
        Whether it changes the site, not the table.
    apply
        From a case and a sensor's index to the corrected case; None where it makes no sense.
    usual
        Whether it is preferred to others that do as well.
    """

    kind: str
    said: Callable[[Case, int], str]
    remedy: str
    place: bool
    apply: Callable[[Case, int], Case | None]
    usual: bool = False


def _angles(
    change: Callable[
        [NDArray[np.float64], NDArray[np.float64]],
        tuple[NDArray[np.float64], NDArray[np.float64]] | None,
    ],
) -> Callable[[Case, int], Case | None]:
    def apply(case: Case, sensor: int) -> Case | None:
        table = case.bearings
        rows = table.sensor == sensor
        changed = change(table.azimuth_rad[rows], table.elevation_rad[rows])
        if changed is None:
            return None
        azimuth, elevation = table.azimuth_rad.copy(), table.elevation_rad.copy()
        azimuth[rows], elevation[rows] = changed
        table = dataclasses.replace(table, azimuth_rad=azimuth, elevation_rad=elevation)
        return dataclasses.replace(case, bearings=table)

    return apply


def small_numbers(azimuth: NDArray[np.float64], elevation: NDArray[np.float64]) -> bool:
    """Tell whether angles, as numbers of degrees, would all do as radians."""
    return bool(
        (np.abs(np.degrees(azimuth)) <= 2.0 * np.pi + 1e-6).all()
        and (np.abs(np.degrees(elevation[np.isfinite(elevation)])) <= 0.5 * np.pi + 1e-6).all()
    )


def _as_radians(
    azimuth: NDArray[np.float64], elevation: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    if not small_numbers(azimuth, elevation):
        return None
    return np.degrees(azimuth), np.degrees(elevation)


def _as_zenith(
    azimuth: NDArray[np.float64], elevation: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    if not np.isfinite(elevation).any():
        return None
    return azimuth, 0.5 * np.pi - elevation


def _site(
    change: Callable[[float, float, float], tuple[float, float, float] | None],
) -> Callable[[Case, int], Case | None]:
    def apply(case: Case, sensor: int) -> Case | None:
        position = case.sensors[sensor].position_m
        if case.recording.frame != "ecef" or position is None:
            return None
        latitude, longitude, height = (float(v) for v in geodetic_from_ecef(position))
        place = change(latitude, longitude, height)
        if place is None or not -90.0 <= place[0] <= 90.0:
            return None
        moved = dataclasses.replace(case.sensors[sensor], position_m=ecef_from_geodetic(*place))
        sensors = (*case.sensors[:sensor], moved, *case.sensors[sensor + 1 :])
        return dataclasses.replace(case, sensors=sensors)

    return apply


def times(
    change: Callable[[NDArray[np.float64]], NDArray[np.float64]], sensor: int, case: Case
) -> Case:
    """Return a case with the times of one sensor changed."""
    table = case.bearings
    time = np.where(table.sensor == sensor, change(table.time_s), table.time_s)
    return dataclasses.replace(case, bearings=dataclasses.replace(table, time_s=time))


def _geodetic(sensor: Sensor) -> tuple[float, float, float]:
    assert sensor.position_m is not None
    latitude, longitude, height = (float(value) for value in geodetic_from_ecef(sensor.position_m))
    return latitude, longitude, height


def _longitude(case: Case, sensor: int) -> str:
    longitude = _geodetic(case.sensors[sensor])[1]
    return f"with its longitude as {-longitude:.6g} instead of {longitude:.6g}"


def _latitude(case: Case, sensor: int) -> str:
    latitude = _geodetic(case.sensors[sensor])[0]
    return f"with its latitude as {-latitude:.6g} instead of {latitude:.6g}"


def _swapped(case: Case, sensor: int) -> str:
    latitude, longitude, _ = _geodetic(case.sensors[sensor])
    return f"with latitude {longitude:.6g} and longitude {latitude:.6g}, the two swapped"


def _feet(case: Case, sensor: int) -> str:
    height = _geodetic(case.sensors[sensor])[2]
    return f"with its height as {_FEET_M * height:.5g} m instead of {height:.5g} m"


def _just(text: str) -> Callable[[Case, int], str]:
    def said(case: Case, sensor: int) -> str:
        del case, sensor
        return text

    return said


CORRECTIONS: Sequence[Correction] = (
    Correction(
        "radians",
        _just("with its angles taken as radians"),
        "convert the angles, or call the columns azimuth_rad and elevation_rad",
        False,
        _angles(_as_radians),
    ),
    Correction(
        "zenith-distance",
        _just("with 90° less its elevations, as if they were zenith distances"),
        "give elevations above the horizon, not zenith distances",
        False,
        _angles(_as_zenith),
    ),
    Correction(
        "azimuth-from-south",
        _just("with its azimuths turned by 180°, as if counted from the south"),
        "count azimuths from north",
        False,
        _angles(lambda azimuth, elevation: (azimuth + np.pi, elevation)),
    ),
    Correction(
        "azimuth-mirrored",
        _just("with its azimuths counted the other way round"),
        "count azimuths clockwise from north (from x towards y in xyz axes)",
        False,
        _angles(lambda azimuth, elevation: (-azimuth, elevation)),
    ),
    Correction(
        "azimuth-from-south-mirrored",
        _just("with its azimuths counted from the south and the other way round"),
        "count azimuths clockwise from north (from x towards y in xyz axes)",
        False,
        _angles(lambda azimuth, elevation: (np.pi - azimuth, elevation)),
    ),
    Correction(
        "azimuth-from-east",
        _just("with its azimuths as 90° less those given, as if counted from east towards north"),
        "count azimuths clockwise from north (from x towards y in xyz axes)",
        False,
        _angles(lambda azimuth, elevation: (0.5 * np.pi - azimuth, elevation)),
    ),
    Correction(
        "longitude-sign",
        _longitude,
        "give longitudes east of Greenwich as positive, west as negative",
        True,
        _site(lambda latitude, longitude, height: (latitude, -longitude, height)),
    ),
    Correction(
        "latitude-sign",
        _latitude,
        "give latitudes north of the equator as positive, south as negative",
        True,
        _site(lambda latitude, longitude, height: (-latitude, longitude, height)),
    ),
    Correction(
        "latitude-longitude-swapped",
        _swapped,
        "write latitude first, then longitude",
        True,
        _site(lambda latitude, longitude, height: (longitude, latitude, height)),
    ),
    Correction(
        "height-in-feet",
        _feet,
        "give heights in metres",
        True,
        _site(lambda latitude, longitude, height: (latitude, longitude, _FEET_M * height)),
    ),
    Correction(
        "milliseconds",
        _just("with its times divided by 1000, as if they were milliseconds"),
        "give times in seconds after the epoch",
        False,
        lambda case, sensor: times(lambda time: time / 1000.0, sensor, case),
    ),
    Correction(
        "seconds-as-milliseconds",
        _just("with its times multiplied by 1000"),
        "give times in seconds after the epoch",
        False,
        lambda case, sensor: times(lambda time: 1000.0 * time, sensor, case),
    ),
)


def shifts() -> list[float]:
    """Return the clock errors that people make, seconds: what to add to the times."""
    seconds = [float(s) for s in range(1, _MOST_SECONDS + 1)]
    hours = [0.5 * _HOUR_S * count for count in range(1, _MOST_HALF_HOURS + 1)]
    return [sign * value for value in (*seconds, *hours) for sign in (1.0, -1.0)]


def shift(seconds: float) -> Correction:
    """Return the correction that adds seconds to the times."""
    ahead = "ahead" if seconds < 0.0 else "behind"
    size = abs(seconds)
    hours = size % (0.5 * _HOUR_S) == 0.0
    text = f"{size / _HOUR_S:g} h" if hours else f"{size:g} s"
    why = " (a time zone?)" if hours else ""
    if size in KNOWN_SHIFTS:
        why = f" ({KNOWN_SHIFTS[size]})"
    return Correction(
        "time-zone" if hours else "clock-seconds",
        _just(f"with its clock {text} {ahead}{why}"),
        "give times in UTC, or give the sensor a clock_offset_s that allows for it",
        False,
        lambda case, sensor: times(lambda time: time + seconds, sensor, case),
        size in KNOWN_SHIFTS,
    )
