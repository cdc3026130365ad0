"""Reports of satellite observers in the UK format: 80 columns without separators.

Columns, from one: 1-7 international designation, 8-11 station, 12-17 date YYMMDD, 18-27 UTC, 28-32
its accuracy in seconds Sssss, 34 coordinates, 35-50 angles, 51-54 their accuracy, 55 epoch (*The
Reporting of Satellite Observations*, Radio and Space Research Station, Slough, 1973; the codes 4 to
9 came later).
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

# Sputnik 1 was the first that could be reported.
_FIRST_YEAR = 57


class _Format(NamedTuple):
    kind: AxesKind
    first: str
    second: str
    decimals: int
    sigma_unit_deg: float
    refracted: bool | None


_SECONDS, _MINUTES, _DEGREES = (1, 1.0 / 3600.0), (2, 1.0 / 60.0), (3, 1.0)
_FORMATS = {
    "1": _Format("radec", "HHMMSSss", "DDMMSSs", *_SECONDS, None),
    "2": _Format("radec", "HHMMmmmm", "DDMMmmm", *_MINUTES, None),
    "3": _Format("radec", "HHMMmmmm", "DDddddd", *_DEGREES, None),
    "4": _Format("azel", "DDDMMSSs", "DDMMSSs", *_SECONDS, False),
    "5": _Format("azel", "DDDMMmmm", "DDMMmmm", *_MINUTES, False),
    "6": _Format("azel", "DDDddddd", "DDddddd", *_DEGREES, False),
    "7": _Format("azel", "DDDMMSSs", "DDMMSSs", *_SECONDS, True),
    "8": _Format("azel", "DDDMMmmm", "DDMMmmm", *_MINUTES, True),
    "9": _Format("azel", "DDDddddd", "DDddddd", *_DEGREES, True),
}


def read_uk(
    paths: Path | str | Sequence[Path | str],
    options: ImportOptions | None = None,
    *,
    target: str | None = None,
) -> Recording:
    """Read reports in the UK format as one recording.

    Parameters
    ----------
    paths
        Files.
    options
        What they do not say: stations by their four-digit numbers, priors.
    target
        The object, by its designation (columns 1-7); needed where the files have several.

    Raises
    ------
    InputError
        If a line is not of the format, or the files have several objects and none is named.
    """
    rows = of_one_object(paths, _parse, target, "reports in the UK format")
    return recording_of(rows, ImportOptions() if options is None else options)


def _parse(line: Line) -> tuple[tuple[str, ...], Sighting]:
    station = line.columns(8, 11)
    if not (station.isdecimal() and station.isascii()):
        line.fail(8, 11, f"is {shown(station)}; expected a station of four digits (UK format)")
    code = line.columns(34, 34)
    if code not in _FORMATS:
        line.fail(34, 34, f"is {shown(code)}; expected a coordinate code from 1 to 9")
    form = _FORMATS[code]
    first = line.angle_deg(35, 42, form.first)
    if first >= 360.0:
        line.fail(35, 42, f"is {first:.9g} degrees; expected less than 360")
    sigma = _accuracy(line, 51, 54, form.decimals)
    return (line.columns(1, 7).strip(),), Sighting(
        tai_ns=_instant(line),
        sensor=station,
        first_rad=np.radians(first),
        second_rad=np.radians(line.signed_deg(43, 50, form.second)),
        kind=form.kind,
        equinox=_equinox(line) if form.kind == "radec" else float("nan"),
        sigma_rad=np.radians(sigma * form.sigma_unit_deg),
        sigma_time_s=_accuracy(line, 28, 32, 4),
        refracted=form.refracted,
        place=line.place,
        line=line.number,
    )


def _equinox(line: Line) -> float:
    code = line.columns(55, 55).strip()
    if code not in EQUINOXES:
        line.fail(55, 55, f"is {shown(code)}; expected an epoch code from 0 to 6")
    return EQUINOXES[code]


def _instant(line: Line) -> int:
    date = line.digits(12, 17, "a date YYMMDD")
    text = line.columns(18, 27).rstrip()
    if not (text.isdecimal() and text.isascii()) or len(text) < 6:
        line.fail(18, 27, f"is {shown(text)}; expected a time HHMMSSssss")
    digits = text.ljust(10, "0")
    short = date // 10000
    try:
        start = day_ns(
            short + (1900 if short >= _FIRST_YEAR else 2000), date // 100 % 100, date % 100
        )
        return clock_ns(
            start,
            int(digits[:2]),
            int(digits[2:4]),
            int(digits[4:6]),
            int(digits[6:]) * 100_000,
        )
    except ValueError as error:
        line.fail(12, 27, f"is {shown(line.columns(12, 27).strip())}; {error}")


def _accuracy(line: Line, first: int, last: int, decimals: int) -> float:
    """Return a number with some decimals and no point; NaN where blank or zero."""
    text = line.columns(first, last)
    if not text.strip():
        return float("nan")
    digits = text.rstrip().ljust(last - first + 1, "0").replace(" ", "0")
    if not (digits.isdecimal() and digits.isascii()):
        line.fail(first, last, f"is {shown(text)}; expected digits")
    value = int(digits) / 10.0**decimals
    return value if value > 0.0 else float("nan")
