"""Recordings of aircraft from LocaRDS: messages that five receivers timed by GPS heard.

The original files (``scenarios/data/locards/original``) hold ADS-B messages, each with the position
that the aircraft reported in it and the times at which five receivers heard it. A recording here is
the track of one aircraft: all its messages in one set, if there are at least five. The numbers of
aircraft are valid within a set alone.

What sigmas and priors rest on:

- **Noise.** Receivers 147 and 632 stand 12 m apart. The difference of their arrival times, less the
  geometry, scatters by 13.7 m (1.48 MAD of 328 messages): 9.7 m each. The residuals against the
  reported positions scatter by 21 m; the rest of that is the reports' own error.
- **Receivers.** With a delay for each receiver the residuals of all messages agree best with delays
  from -15 to +80 m, most within 20 m of each other.
- **Heights.** ``geoAltitude`` is the altitude to take. The height that fits the 604 messages
  outside Portugal best, beside a delay for each receiver, is 12 m below it and 122 m below
  ``baroAltitude``, both to 5 m (1-sigma). So receivers' heights and ``geoAltitude`` are counted
  from nearly the same surface; whether that is the ellipsoid or the sea level 47 m above it moves
  no horizontal position by more than a metre or two.

- **Motion.** Constant velocity with an acceleration noise of 3 m/s^1.5. Most aircraft fly straight
  and fit with 1 as well; one turns onto its approach, and 2, 3 and 5 give all tracks together a
  chi-square of 1.1, 0.7 and 0.5 a degree of freedom. Positions differ by a metre or two. Knots are
  2 s apart, between which such a path deviates by 0.6 m.
- **Loss.** Three of the 1300 arrival times are more than 3 sigma off. Cauchy gives these a weight
  of 0.3 to 0.4.

The reported position is a poor truth along the flight: aircraft report where they were a moment
before. By the smoothed tracks the delay is 0.2 s in the median, 46 m, and differs from aircraft to
aircraft, from none to 1.2 s. It is not taken out of the recordings. No estimate can be nearer to
the reports than the aircraft itself was: the median horizontal distance is 56 m, 15 m of it across
the flight, and 22 m when each aircraft's delay, one number, is taken out.

Two messages of the same aircraft with the same arrival times are one message that was stored twice.
"""

from __future__ import annotations

import csv
import json
from collections import defaultdict
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.errors import InputError
from geograph.geodesy import ecef_from_geodetic
from geograph.io import write
from geograph.io.atomic import replacing_file
from geograph.io.source import HEADER_NAME
from geograph.measurements import Arrivals, Constraints, Truth
from geograph.recording import Recording, SmoothSettings
from geograph.sensors import Sensor, SensorErrors

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from geograph.measurements import ConstraintKind

DATA = Path(__file__).parent / "data" / "locards"
"""The shipped recordings and their original files."""

SETS = ("set_1", "set_2")
LEAST_MESSAGES = 5

PROPAGATION_SPEED_M_S = SPEED_OF_LIGHT_M_S / 1.0003
"""Of radio in air near the ground."""

SIGMA_S = 3.3e-8
"""Of one arrival time: 10 m, the scatter between the two receivers that stand side by side."""

CLOCK_OFFSET_S = 1e-7
"""Prior 1-sigma of a receiver's delay: 30 m."""

ALTITUDE_SIGMA_M = 15.0
"""Of the reported altitude, which comes in steps of 7.6 m, and of its datum."""

SETTINGS = SmoothSettings(
    motion="constant-velocity", process_noise=3.0, spacing_s=2.0, loss="cauchy"
)

EPOCH = datetime(2020, 1, 1, tzinfo=UTC)
"""Taken for the time zero of each set, of which the true date is not known."""

NOTICE = """\
# Licence

The messages are from LocaRDS, filtered by the demonstrations of MPyC to those that five receivers
timed by GPS heard, and are licensed under the Creative Commons Attribution-ShareAlike 4.0
International licence, https://creativecommons.org/licenses/by-sa/4.0/, as are the recordings made
of them. There is no warranty.

M. Schäfer, M. Strohmeier, M. Leonardi, V. Lenders: *LocaRDS: A Localization Reference Data Set*,
Sensors 2021, 21(16), 5516, https://doi.org/10.3390/s21165516; data at
https://zenodo.org/record/4739276.

Changed here: tracks of at least five messages of one aircraft, repeated messages once, arrival
times from the start of the track in seconds, sigmas and priors added.
"""
"""Written beside every recording, so that it stays with the data."""

_NANOSECONDS = 10**9


@dataclass(frozen=True, kw_only=True)
class Message:
    """One ADS-B message and when its receivers heard it.

    Parameters
    ----------
    name
        Its number in the original file.
    aircraft
        Number of the aircraft, valid within one set.
    geodetic
        Latitude (deg), longitude (deg) and geometric altitude (m), as the aircraft reported them.
    receivers
        Serial numbers.
    arrival_ns
        Time of arrival at each receiver, whole nanoseconds after the set's time zero.
    """

    name: str
    aircraft: int
    geodetic: tuple[float, float, float]
    receivers: tuple[int, ...]
    arrival_ns: tuple[int, ...]


def read_messages(path: Path) -> list[Message]:
    """Return the messages of a set, in the order of the file.

    Parameters
    ----------
    path
        ``set_1.csv`` or ``set_2.csv``.

    Raises
    ------
    InputError
        If the file is missing or a row is damaged.
    """
    messages = []
    for line, row in _rows(path):
        try:
            heard = json.loads(row["measurements"])
            message = Message(
                name=row["id"],
                aircraft=int(row["aircraft"]),
                geodetic=(
                    float(row["latitude"]),
                    float(row["longitude"]),
                    float(row["geoAltitude"]),
                ),
                receivers=tuple(int(serial) for serial, _, _ in heard),
                arrival_ns=tuple(int(time) for _, time, _ in heard),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"is no message ({error}); expected a row of LocaRDS as published",
                path=path,
                line=line,
            ) from None
        messages.append(message)
    return messages


def read_receivers(path: Path) -> dict[int, tuple[float, float, float]]:
    """Return latitude (deg), longitude (deg) and height (m) of each receiver by serial number.

    Parameters
    ----------
    path
        ``sensors.csv``.

    Raises
    ------
    InputError
        If the file is missing or a row is damaged.
    """
    receivers = {}
    for line, row in _rows(path):
        try:
            place = float(row["latitude"]), float(row["longitude"]), float(row["height"])
            receivers[int(row["serial"])] = place
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"is no receiver ({error}); expected a row of LocaRDS as published",
                path=path,
                line=line,
            ) from None
    return receivers


def tracks(messages: Sequence[Message], *, least: int = LEAST_MESSAGES) -> dict[int, list[Message]]:
    """Return the messages of each aircraft that has enough of them, in the order of time.

    A message that is there twice, with the same arrival times, is returned once. An aircraft that
    was silent for long keeps one track.

    Parameters
    ----------
    messages
        Of one set.
    least
        Least number of messages of a track, repeated ones not counted.
    """
    heard: dict[int, dict[frozenset[tuple[int, int]], Message]] = defaultdict(dict)
    for message in messages:
        arrivals = frozenset(zip(message.receivers, message.arrival_ns, strict=True))
        heard[message.aircraft].setdefault(arrivals, message)
    return {
        aircraft: sorted(unique.values(), key=lambda message: min(message.arrival_ns))
        for aircraft, unique in sorted(heard.items())
        if len(unique) >= least
    }


def track_recording(
    messages: Sequence[Message],
    receivers: Mapping[int, tuple[float, float, float]],
    *,
    name: str = "track",
) -> Recording:
    """Return the recording of one track.

    Its time zero is the last whole second, of the set's own time, before the first arrival: seconds
    are then exact to the nanosecond. Altitudes stand at the first arrival of their message, which
    is at most a millisecond after its emission. The reported positions are the truth, at the
    times of emission that they imply: the median over the receivers of the arrival time less the
    light time.

    Parameters
    ----------
    messages
        Of one aircraft, in the order of time.
    receivers
        As :func:`read_receivers` returns them.
    name
        Of the recording.

    Raises
    ------
    InputError
        If a receiver is unknown.
    """
    serials = sorted({serial for message in messages for serial in message.receivers})
    unknown = [serial for serial in serials if serial not in receivers]
    if unknown:
        raise InputError(f"receiver {unknown[0]} is not in the table of receivers")
    start_s = min(messages[0].arrival_ns) // _NANOSECONDS
    places = {serial: ecef_from_geodetic(*receivers[serial]) for serial in serials}
    errors = SensorErrors(clock_offset_s=CLOCK_OFFSET_S)
    first = np.array([_seconds(min(message.arrival_ns), start_s) for message in messages])
    altitude = np.array([message.geodetic[2] for message in messages])
    altitude_kind: ConstraintKind = "altitude_m"
    return Recording(
        name=name,
        frame="ecef",
        epoch=EPOCH + timedelta(seconds=start_s),
        propagation_speed_m_s=PROPAGATION_SPEED_M_S,
        sensors={
            f"R{serial}": Sensor(name=f"R{serial}", position_m=places[serial], errors=errors)
            for serial in serials
        },
        arrivals=_arrivals(messages, serials, start_s),
        constraints=Constraints(
            time_s=first,
            kind=(altitude_kind,) * len(messages),
            value=altitude,
            sigma=np.full(altitude.shape, ALTITUDE_SIGMA_M),
            line=np.zeros(altitude.shape, dtype=np.int64),
        ),
        truth=_truth(messages, places, start_s),
        settings=SETTINGS,
    )


def make_locards(folder: Path | str, *, originals: Path | None = None) -> list[Path]:
    """Make the recordings of all tracks of both sets, each in a folder named by set and aircraft.

    Parameters
    ----------
    folder
        Where the folders are made; recordings there of the same names are replaced.
    originals
        Folder of the original files; by default the shipped ones.

    Returns
    -------
    list of Path
        The recordings' folders, in the order of sets and aircraft.

    Raises
    ------
    InputError
        If a file is missing or damaged, or a folder holds something else.
    """
    source = DATA / "original" if originals is None else originals
    receivers = read_receivers(source / "sensors.csv")
    made = []
    for name in SETS:
        for aircraft, messages in tracks(read_messages(source / f"{name}.csv")).items():
            target = Path(folder) / f"{name}-{aircraft}"
            recording = track_recording(messages, receivers, name=target.name)
            write(recording, target, overwrite=True)
            _add_notice(
                target, f"Aircraft {aircraft} of {name} of LocaRDS, {len(messages)} messages"
            )
            made.append(target)
    return made


def _rows(path: Path) -> list[tuple[int, dict[str, str]]]:
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            return [(reader.line_num, row) for row in reader]
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"cannot be read ({error}); expected a file of LocaRDS", path=path
        ) from None


def _seconds(time_ns: int, start_s: int) -> float:
    # One rounding, of the exact quotient: what is written has nine decimals.
    return (time_ns - start_s * _NANOSECONDS) / _NANOSECONDS


def _arrivals(messages: Sequence[Message], serials: Sequence[int], start_s: int) -> Arrivals:
    rows = [
        (number, serials.index(serial), _seconds(time, start_s))
        for number, message in enumerate(messages)
        for serial, time in zip(message.receivers, message.arrival_ns, strict=True)
    ]
    emission, sensor, toa = zip(*rows, strict=True)
    return Arrivals(
        emission=np.array(emission, dtype=np.int64),
        sensor=np.array(sensor, dtype=np.int64),
        toa_s=np.array(toa),
        sigma_s=np.full(len(rows), SIGMA_S),
        line=np.zeros(len(rows), dtype=np.int64),
        emission_names=tuple(message.name for message in messages),
    )


def _truth(
    messages: Sequence[Message], places: Mapping[int, NDArray[np.float64]], start_s: int
) -> Truth:
    position = ecef_from_geodetic(*np.array([message.geodetic for message in messages]).T)
    times = []
    for message, reported in zip(messages, position, strict=True):
        place = np.array([places[serial] for serial in message.receivers])
        arrival = np.array([_seconds(time, start_s) for time in message.arrival_ns])
        # The Earth's turn during the light time, 0.2 m, is nothing beside the reports' own error.
        distance = np.linalg.norm(reported - place, axis=1)
        times.append(float(np.median(arrival - distance / PROPAGATION_SPEED_M_S)))
    return Truth(time_s=np.array(times), position_m=position)


def _add_notice(folder: Path, title: str) -> None:
    header = folder / HEADER_NAME
    text = header.read_text(encoding="utf-8")
    comment = (
        f"# {title}\n"
        "# CC BY-SA 4.0; licence and citation are in LICENSE.md.\n"
        "# The date is not known: 2020-01-01 stands for it. The set began at 00:00:00.\n"
    )
    with replacing_file(header) as staging:
        staging.write_text(comment + text, encoding="utf-8")
    with replacing_file(folder / "LICENSE.md") as staging:
        staging.write_text(NOTICE, encoding="utf-8")
