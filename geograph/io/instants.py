"""Instants of other formats: calendar texts in UTC, TAI, TT and GPS time, as TAI nanoseconds.

An instant is an integer, nanoseconds of TAI since 1970-01-01T00:00:00 TAI. Differences of instants
are elapsed SI seconds, over leap seconds too, and it is these that ``time_s`` counts.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Literal, cast, get_args

import numpy as np

from geograph.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

TimeSystem = Literal["UTC", "TAI", "TT", "GPS"]

SECOND_NS = 1_000_000_000
MINUTE_NS = 60 * SECOND_NS
DAY_NS = 86400 * SECOND_NS
FIRST_YEAR, LAST_YEAR = 1972, 2199

# Days that began with one second more between TAI and UTC; it was 10 s before the first of them
# (IERS Bulletin C; none has been announced since). tests/test_instants.py holds them against the
# table that astropy ships.
_LEAP_DAYS = (
    *("1972-07-01", "1973-01-01", "1974-01-01", "1975-01-01", "1976-01-01", "1977-01-01"),
    *("1978-01-01", "1979-01-01", "1980-01-01", "1981-07-01", "1982-07-01", "1983-07-01"),
    *("1985-07-01", "1988-01-01", "1990-01-01", "1991-01-01", "1992-07-01", "1993-07-01"),
    *("1994-07-01", "1996-01-01", "1997-07-01", "1999-01-01", "2006-01-01", "2009-01-01"),
    *("2012-07-01", "2015-07-01", "2017-01-01"),
)
_LEAPS_UTC_NS = np.array(_LEAP_DAYS, dtype="datetime64[ns]").astype(np.int64)
_OFFSET_1972_S = 10
_LEAPS_TAI_NS = _LEAPS_UTC_NS + (_OFFSET_1972_S + 1 + np.arange(len(_LEAP_DAYS))) * SECOND_NS

# TAI less the system, nanoseconds (TT: IAU 1991; GPS time: IS-GPS-200).
_TAI_LESS_NS = {"TAI": 0, "TT": -32_184_000_000, "GPS": 19 * SECOND_NS}

_TEXT = re.compile(
    r"(\d{4})-(?:(\d\d)-(\d\d)|(\d{3}))[T ](\d\d):(\d\d)(?::(\d\d)(?:\.(\d*))?)?(Z|\+00:00)?",
    re.ASCII,
)
EXPECTED = "a time such as 2021-02-28T21:54:15.760 or 2021-059T21:54:15.760"


def utc_to_tai_ns(utc_ns: int) -> int:
    """Return the instant of a UTC calendar count: days since 1970 of 86400 s each, nanoseconds."""
    leaps = int(np.searchsorted(_LEAPS_UTC_NS, utc_ns, side="right"))
    return utc_ns + (_OFFSET_1972_S + leaps) * SECOND_NS


def tai_to_utc_ns(tai_ns: int) -> int:
    """Return the UTC calendar count of an instant; a leap second counts as the one after it."""
    leaps = int(np.searchsorted(_LEAPS_TAI_NS, tai_ns, side="right"))
    return tai_ns - (_OFFSET_1972_S + leaps) * SECOND_NS


def tai_to_utc_all_ns(tai_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the UTC calendar counts of instants; see :func:`tai_to_utc_ns`."""
    leaps = np.searchsorted(_LEAPS_TAI_NS, tai_ns, side="right")
    return np.asarray(tai_ns - (_OFFSET_1972_S + leaps) * SECOND_NS)


def in_system(count_ns: int, system: TimeSystem) -> int:
    """Return the instant of a calendar count in some system."""
    return utc_to_tai_ns(count_ns) if system == "UTC" else count_ns + _TAI_LESS_NS[system]


def parse_instant(text: str, system: TimeSystem = "UTC") -> int:
    """Return the instant that a calendar text means.

    Parameters
    ----------
    text
        Such as ``2021-02-28T21:54:15.76``, or with the day of the year, ``2021-059T21:54:15.76``; a
        final ``Z`` is allowed. Digits beyond nanoseconds are dropped.
    system
        ``"UTC"``, ``"TAI"``, ``"TT"`` or ``"GPS"``.

    Raises
    ------
    ValueError
        With the reason, if it is none.
    """
    found = _TEXT.fullmatch(text.strip())
    if found is None:
        raise ValueError(f"expected {EXPECTED}")
    year, month, day, ordinal, hour, minute, second, fraction, zone = found.groups()
    if zone is not None and system not in ("UTC",) and zone != "Z":
        raise ValueError(f"a zone in a time of system {system}; expected {EXPECTED}")
    count = day_ns(int(year), int(month or 1), int(day or ordinal), ordinal=ordinal is not None)
    nanoseconds = int((fraction or "0")[:9].ljust(9, "0"))
    return clock_ns(count, int(hour), int(minute), int(second or 0), nanoseconds, system=system)


def day_ns(year: int, month: int, day: int, *, ordinal: bool = False) -> int:
    """Return the calendar count at the start of a day; ``ordinal``: the day of the year.

    Raises
    ------
    ValueError
        If there is no such day, or the year is out of range.
    """
    if not FIRST_YEAR <= year <= LAST_YEAR:
        raise ValueError(f"year {year}; expected {FIRST_YEAR} to {LAST_YEAR}")
    first = datetime(year, 1 if ordinal else month, 1 if ordinal else day, tzinfo=UTC)
    days = first.toordinal() - datetime(1970, 1, 1, tzinfo=UTC).toordinal()
    if ordinal:
        length = datetime(year, 12, 31, tzinfo=UTC).timetuple().tm_yday
        if not 1 <= day <= length:
            raise ValueError(f"day {day} of the year; expected 1 to {length}")
        days += day - 1
    return days * DAY_NS


def clock_ns(
    start_ns: int,
    hour: int,
    minute: int,
    second: int,
    nanosecond: int,
    *,
    system: TimeSystem = "UTC",
) -> int:
    """Return the instant of a time of day; second 60 only where UTC had one.

    Raises
    ------
    ValueError
        If there is no such time.
    """
    if hour > 23 or minute > 59 or second > 60:
        raise ValueError(f"time of day {hour:02}:{minute:02}:{second:02}; expected {EXPECTED}")
    base = start_ns + (hour * 60 + minute) * MINUTE_NS
    if second == 60 and not (system == "UTC" and base + MINUTE_NS in _LEAPS_UTC_NS):
        raise ValueError("second 60, and there was no leap second then")
    # The offset is that at the start of the minute: within the leap second it is still the old one.
    return in_system(base, system) + second * SECOND_NS + nanosecond


def known_system(name: str) -> TimeSystem:
    """Return a time system by its name in CCSDS messages.

    Raises
    ------
    ValueError
        With the reason, for others.
    """
    if name in get_args(TimeSystem):
        return cast("TimeSystem", name)
    raise ValueError(
        f"time system {name[:40]!r} is not read; expected one of {', '.join(get_args(TimeSystem))}"
    )


def minute_of(tai_ns: int) -> int:
    """Return the instant at which the UTC minute of an instant began."""
    return utc_to_tai_ns(tai_to_utc_ns(tai_ns) // MINUTE_NS * MINUTE_NS)


def as_datetime(tai_ns: int) -> datetime:
    """Return an instant of whole microseconds as a UTC datetime."""
    utc = tai_to_utc_ns(tai_ns)
    whole = datetime.fromtimestamp(utc // SECOND_NS, tz=UTC)
    return whole.replace(microsecond=utc % SECOND_NS // 1000)


def from_datetime(moment: datetime) -> int:
    """Return the instant of a datetime that has a zone."""
    utc = moment.astimezone(UTC)
    days = day_ns(utc.year, utc.month, utc.day)
    return clock_ns(days, utc.hour, utc.minute, utc.second, utc.microsecond * 1000)


def instant_of(epoch: datetime, place: Path | str | None = None) -> int:
    """Return the instant of a recording's epoch; InputError where UTC did not exist yet.

    Parameters
    ----------
    epoch
        With a zone.
    place
        The file it stands in, for messages.
    """
    try:
        return from_datetime(epoch)
    except ValueError as error:
        raise InputError(f"is in {error}", path=place, column="epoch") from None


def utc_text(tai_ns: int, digits: int = 6) -> str:
    """Return an instant as a UTC text without a zone, rounded to some digits of a second.

    >>> utc_text(parse_instant("2016-12-31T23:59:60.25"), 3)
    '2016-12-31T23:59:60.250'
    """
    unit = 10 ** (9 - digits)
    rounded = (tai_ns + unit // 2) // unit * unit
    utc = tai_to_utc_ns(rounded)
    leap = int(
        np.searchsorted(_LEAPS_TAI_NS, rounded + SECOND_NS, side="right")
        - np.searchsorted(_LEAPS_TAI_NS, rounded, side="right")
    )
    second, rest = divmod(utc, SECOND_NS)
    # Within a leap second the count has run on into the first second of the next day.
    shown = datetime.fromtimestamp(second - leap, tz=UTC).strftime("%Y-%m-%dT%H:%M:%S")
    if leap:
        shown = shown[:-2] + "60"
    fraction = f".{rest:09d}"[: digits + 1] if digits else ""
    return shown + fraction
