"""Optical astrometry in the 80 columns of the Minor Planet Center.

Columns, from one: 1-12 object, 15 kind of observation, 16-32 UTC as YYYY MM DD.dddddd, 33-44 right
ascension, 45-56 declination (J2000, against stars of the ICRS), 78-80 observatory. For satellites,
which move by a tenth of a degree in the last digit of that time, B. Gray's Find_Orb has two more
forms in the same columns: KYYMMDD.ddddddddd and KYYMMDD:HHMMSSsss, where K is 20 and J is 19.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from geograph.io.instants import DAY_NS, clock_ns, day_ns, in_system
from geograph.io.messages import shown
from geograph.io.packed import Line, of_one_object
from geograph.io.rows import ImportOptions, Sighting
from geograph.io.sightings import recording_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from geograph.recording import Recording

_REFUSED = {
    "S": "observed from a spacecraft",
    "s": "observed from a spacecraft",
    "R": "measured by radar",
    "r": "measured by radar",
    "V": "observed by a roving observer",
    "v": "observed by a roving observer",
    "X": "replaced by another",
    "x": "replaced by another",
    "O": "an offset from a planet",
}

_HEADS = ("COD", "CON", "OBS", "MEA", "TEL", "NET", "BND", "COM", "NUM", "ACK", "AC2")
"""Words that lines about the observers begin with, before those of the observations."""

_PACKED_DATE = re.compile(r"([JK])(\d\d)(\d\d)(\d\d)(?:\.(\d*)|:(\d\d)(\d\d)(\d\d)(\d*))", re.ASCII)
_EXPECTED_DATE = "expected a date as 2021 02 28.912345, K210228.912345678 or K210228:215346123"


def read_mpc(
    paths: Path | str | Sequence[Path | str],
    options: ImportOptions | None = None,
    *,
    target: str | None = None,
) -> Recording:
    """Read optical astrometry in 80 columns as one recording.

    Parameters
    ----------
    paths
        Files. Lines about the observers (``COD``, ``OBS``, ``TEL`` and so on) are passed over.
    options
        What they do not say: stations by their three-character codes, sigmas (else the scatter),
        priors.
    target
        The object (columns 1-12); needed where the files have several.

    Raises
    ------
    InputError
        If a line is not of the format, was not observed from a fixed place on the ground, or the
        files have several objects and none is named.
    """
    rows = of_one_object(paths, _parse, target, "astrometry in 80 columns")
    return recording_of(rows, ImportOptions() if options is None else options)


def _parse(line: Line) -> tuple[tuple[str, ...], Sighting | None]:
    if line.columns(1, 3) in _HEADS and line.columns(4, 4) == " ":
        return (), None
    if len(line.text) > 80:
        line.fail(81, len(line.text), f"has {len(line.text)} columns; expected 80")
    station = line.columns(78, 80)
    if " " in station or not station.isascii():
        line.fail(78, 80, f"is {shown(station)}; expected an observatory of three characters")
    kind = line.columns(15, 15)
    if kind in _REFUSED:
        line.fail(
            15,
            15,
            f"is {kind!r}, {_REFUSED[kind]}, which is not read; expected directions from fixed "
            "observatories; remove the line",
        )
    ascension = 15.0 * _sexagesimal(line, 33, 44, 24.0)
    sign = line.columns(45, 45)
    if sign not in "+-":
        line.fail(45, 45, f"is {shown(sign)}; expected the sign of a declination")
    declination = _sexagesimal(line, 46, 56, 90.0)
    names = (line.columns(1, 12).strip(), line.columns(1, 5).strip(), line.columns(6, 12).strip())
    return names, Sighting(
        tai_ns=_instant(line),
        sensor=station,
        first_rad=np.radians(ascension),
        second_rad=np.radians(-declination if sign == "-" else declination),
        kind="radec",
        place=line.place,
        line=line.number,
    )


def _sexagesimal(line: Line, first: int, last: int, limit: float) -> float:
    """Return up to three numbers of decreasing unit, the last perhaps with decimals."""
    text = line.columns(first, last)
    words = text.split()
    value, unit = 0.0, 1.0
    try:
        if not words or len(words) > 3 or not text.isascii():
            raise ValueError
        for position, word in enumerate(words):
            whole = word if position < len(words) - 1 else word.replace(".", "", 1)
            # Three digits would be degrees where hours are due.
            if not whole.isdecimal() or len(word.partition(".")[0]) > 2:
                raise ValueError
            number = float(word)
            if position and number >= 60.0:
                raise ValueError
            value += number * unit
            unit /= 60.0
    except ValueError:
        line.fail(first, last, f"is {shown(text.strip())}; expected three numbers, as 12 34 56.78")
    if value > limit:
        line.fail(first, last, f"is {shown(text.strip())}; expected {limit:g} at most")
    return value


def _instant(line: Line) -> int:
    text = line.columns(16, 32).strip()
    words = text.split()
    packed = _PACKED_DATE.fullmatch(text)
    try:
        if packed is not None:
            century, short, month, day, fraction, *clock = packed.groups()
            start = day_ns((1900 if century == "J" else 2000) + int(short), int(month), int(day))
            if clock[0] is not None:
                hour, minute, second = map(int, clock[:3])
                return clock_ns(start, hour, minute, second, int(clock[3][:9].ljust(9, "0")))
        else:
            if len(words) != 3 or not text.isascii():
                raise ValueError(_EXPECTED_DATE)
            year, month, (day, _, fraction) = words[0], words[1], words[2].partition(".")
            if not all(word.isdecimal() for word in (year, month, day, fraction or "0")):
                raise ValueError(_EXPECTED_DATE)
            start = day_ns(int(year), int(month), int(day))
        part = int((fraction or "0")[:14].ljust(14, "0")) * DAY_NS // 10**14
    except ValueError as error:
        line.fail(16, 32, f"is {shown(text)}; {error}")
    return in_system(start + part, "UTC")
