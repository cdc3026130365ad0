"""Reports of visual satellite observers in the IOD format (G. D. Lewis, 1998, clarified 2002).

Columns, from one: 1-5 object, 7-15 international designation, 17-20 station, 22 state of the sky,
24-40 UTC, 42-43 its uncertainty, 45 angle format, 46 epoch, 48-61 angles, 63-64 their uncertainty.
An uncertainty of two digits MX is M 10^(X - 8).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geograph.io.instants import clock_ns, day_ns
from geograph.io.messages import shown
from geograph.io.packed import EQUINOXES, Line, of_one_object
from geograph.io.rows import AxesKind, ImportOptions, Sighting
from geograph.io.sightings import recording_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from geograph.recording import Recording

_ARCMINUTE = 1.0 / 60.0


class _Format(NamedTuple):
    kind: AxesKind
    first: str
    second: str
    sigma_unit_deg: float


_FORMATS = {
    "1": _Format("radec", "HHMMSSs", "DDMMSS", _ARCMINUTE / 60.0),
    "2": _Format("radec", "HHMMmmm", "DDMMmm", _ARCMINUTE),
    "3": _Format("radec", "HHMMmmm", "DDdddd", 1.0),
    "4": _Format("azel", "DDDMMSS", "DDMMSS", _ARCMINUTE / 60.0),
    "5": _Format("azel", "DDDMMmm", "DDMMmm", _ARCMINUTE),
    "6": _Format("azel", "DDDdddd", "DDdddd", 1.0),
    "7": _Format("radec", "HHMMSSs", "DDdddd", 1.0),
}


def read_iod(
    paths: Path | str | Sequence[Path | str],
    options: ImportOptions | None = None,
    *,
    target: str | None = None,
) -> Recording:
    """Read reports in the IOD format as one recording.

    Parameters
    ----------
    paths
        Files. Lines without an angle (only a brightness, or that the sky was cloudy) say nothing of
        where the object was and are passed over.
    options
        What they do not say: stations by their four-digit numbers, priors.
    target
        The object, by its catalogue number (columns 1-5) or designation (7-15); needed where the
        files have several.

    Raises
    ------
    InputError
        If a line is not of the format, or the files have several objects and none is named.
    """
    rows = of_one_object(paths, _parse, target, "reports in the IOD format")
    return recording_of(rows, ImportOptions() if options is None else options)


def _parse(line: Line) -> tuple[tuple[str, ...], Sighting | None]:
    names = (line.columns(1, 5).strip(), line.columns(7, 15).strip())
    station = line.columns(17, 20)
    if not (station.isdecimal() and station.isascii()) or line.columns(21, 21) != " ":
        line.fail(17, 20, f"is {shown(station)}; expected a station of four digits (IOD format)")
    if not line.columns(45, 61).strip():
        return names, None
    code = line.columns(45, 45)
    if code not in _FORMATS:
        line.fail(45, 45, f"is {shown(code)}; expected an angle format from 1 to 7")
    form = _FORMATS[code]
    sigma = _uncertainty(line, 63)
    return names, Sighting(
        tai_ns=_instant(line),
        sensor=station,
        first_rad=np.radians(_first(line, form)),
        second_rad=np.radians(line.signed_deg(55, 61, form.second)),
        kind=form.kind,
        equinox=_equinox(line) if form.kind == "radec" else float("nan"),
        sigma_rad=np.radians(sigma * form.sigma_unit_deg),
        sigma_time_s=_uncertainty(line, 42),
        place=line.place,
        line=line.number,
    )


def _first(line: Line, form: _Format) -> float:
    value = line.angle_deg(48, 54, form.first)
    if value >= 360.0:
        line.fail(48, 54, f"is {value:.9g} degrees; expected less than 360")
    return value


def _equinox(line: Line) -> float:
    code = line.columns(46, 46).strip()
    if code not in EQUINOXES:
        line.fail(46, 46, f"is {shown(code)}; expected an epoch code from 0 to 6")
    return EQUINOXES[code]


def _instant(line: Line) -> int:
    date = line.digits(24, 31, "a date YYYYMMDD")
    text = line.columns(32, 40).rstrip()
    if not (text.isdecimal() and text.isascii()) or len(text) < 4:
        line.fail(32, 40, f"is {shown(text)}; expected a time HHMMSSsss")
    digits = text.ljust(9, "0")
    try:
        start = day_ns(date // 10000, date // 100 % 100, date % 100)
        second = int(digits[4:6])
        return clock_ns(
            start, int(digits[:2]), int(digits[2:4]), second, int(digits[6:]) * 1_000_000
        )
    except ValueError as error:
        line.fail(24, 40, f"is {shown(line.columns(24, 40).strip())}; {error}")


def _uncertainty(line: Line, first: int) -> float:
    """Return M 10^(X - 8) of two columns, NaN where they are blank."""
    text = line.columns(first, first + 1)
    if not text.strip():
        return float("nan")
    if not (text.isdecimal() and text.isascii()) or text[0] == "0":
        line.fail(first, first + 1, f"is {shown(text)}; expected two digits MX for M 10^(X - 8)")
    return float(int(text[0]) * 10.0 ** (int(text[1]) - 8))
