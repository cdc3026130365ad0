"""Rows that readers of foreign formats collect, and what such formats do not say."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from geograph.recording import SmoothSettings

if TYPE_CHECKING:
    from pathlib import Path

    from geograph.io.ecsv import PerCamera
    from geograph.io.stations import Stations

AxesKind = Literal["azel", "radec"]


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """What a foreign file does not say.

    Parameters
    ----------
    stations
        Where its sensors are.
    sigma_deg, bias_deg, clock_offset_s
        On-sky sigma of a direction, and prior 1-sigma of both angles' biases and of the clock, for
        all sensors or by sensor; None: the file's own sigma, else the scatter, and the station
        list's priors.
    sigma_s, sigma_hz
        Sigmas of differences of time and of frequency.
    carrier_hz
        Frequency that the object emits.
    settings
        How the recording is to be smoothed.
    name
        Of the recording.
    """

    stations: Stations = field(default_factory=dict)
    sigma_deg: PerCamera | None = None
    bias_deg: PerCamera | None = None
    clock_offset_s: PerCamera | None = None
    sigma_s: float | None = None
    sigma_hz: float | None = None
    carrier_hz: float | None = None
    settings: SmoothSettings = field(default_factory=SmoothSettings)
    name: str = "recording"


@dataclass(frozen=True, kw_only=True)
class Sighting:
    """One direction.

    Attributes
    ----------
    tai_ns
        Its instant (:mod:`geograph.io.instants`).
    sensor
        Name of the sensor as the file has it.
    first_rad, second_rad
        Azimuth and elevation, the latter NaN where only azimuth was measured, or right ascension
        and declination.
    kind
        Which of the two.
    equinox
        Of right ascension and declination, see :func:`geograph.earth.icrs_from_equinox`.
    sigma_rad
        On the sky; NaN: the format has none.
    sigma_time_s
        Of the time tag; NaN: the format has none.
    place, line
        Where it stands.
    refracted
        Whether the elevation still holds refraction; None: the format does not say.
    """

    tai_ns: int
    sensor: str
    first_rad: float
    second_rad: float
    place: Path
    line: int
    kind: AxesKind = "azel"
    equinox: float = float("nan")
    sigma_rad: float = float("nan")
    sigma_time_s: float = float("nan")
    refracted: bool | None = None


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One difference of arrival time, or of received frequency where it has a carrier.

    Attributes
    ----------
    tai_ns
        Instant of reception at the reference.
    sensor, reference
        Names as the file has them; ``value`` is the sensor's less the reference's.
    value
        Seconds, or hertz.
    carrier_hz
        NaN for a difference of time.
    sigma
        In the unit of the value.
    place, line
        Where it stands.
    """

    tai_ns: int
    sensor: str
    reference: str
    value: float
    sigma: float
    place: Path
    line: int
    carrier_hz: float = float("nan")


@dataclass(frozen=True, kw_only=True)
class Reception:
    """One arrival of an emission at a sensor.

    Attributes
    ----------
    tai_ns
        Instant of arrival by the sensor's clock.
    emission
        What the file calls the emission.
    sensor
        Name as the file has it.
    sigma_s
        Standard deviation, seconds.
    place, line
        Where it stands.
    """

    tai_ns: int
    emission: str
    sensor: str
    sigma_s: float
    place: Path
    line: int


Row = Sighting | Difference | Reception
"""Any of the three."""
