"""Instants in UTC, TAI, TT and GPS time, against astropy."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geograph.io.instants import (
    as_datetime,
    from_datetime,
    known_system,
    minute_of,
    parse_instant,
    tai_to_utc_ns,
    utc_text,
    utc_to_tai_ns,
)

astropy_time = pytest.importorskip("astropy.time")
SECOND = 10**9


def tai_of(text: str, scale: str) -> float:
    """Return astropy's seconds of TAI since 2000-01-01T00:00:00 TAI."""
    Time = astropy_time.Time
    if scale == "gps":
        moment = Time(text, scale="tai") + 19.0 * astropy_time.TimeDelta(1.0, format="sec")
    else:
        moment = Time(text, scale=scale)
    return float((moment.tai - Time("2000-01-01T00:00:00", scale="tai")).to_value("s"))


@settings(max_examples=60, deadline=None)
@given(
    seconds=st.integers(0, 1_700_000_000),
    milliseconds=st.integers(0, 999),
    scale=st.sampled_from(["utc", "tai", "tt", "gps"]),
)
def test_against_astropy(seconds: int, milliseconds: int, scale: str) -> None:
    text = str(np.datetime64("1972-01-01T00:00:00", "s") + seconds) + f".{milliseconds:03}"
    ours = parse_instant(text, scale.upper()) - parse_instant("2000-01-01T00:00:00", "TAI")  # type: ignore[arg-type]
    assert ours / SECOND == pytest.approx(tai_of(text, scale), abs=2e-7)


def test_leap_seconds_are_those_of_the_iers() -> None:
    erfa = pytest.importorskip("erfa")
    for year, month, tai_utc in erfa.leap_seconds.get():
        if year >= 1972:
            start = np.datetime64(f"{year}-{month:02}-01", "ns").astype(np.int64)
            assert utc_to_tai_ns(int(start)) - start == round(tai_utc * SECOND)
            assert tai_to_utc_ns(utc_to_tai_ns(int(start))) == start


def test_leap_second() -> None:
    before, within, after = (
        parse_instant(text)
        for text in ("2016-12-31T23:59:59", "2016-12-31T23:59:60.5", "2017-01-01T00:00:00")
    )
    assert (within - before, after - before) == (3 * SECOND // 2, 2 * SECOND)
    assert utc_text(within, 1) == "2016-12-31T23:59:60.5"
    assert utc_text(after) == "2017-01-01T00:00:00.000000"


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 4_000_000_000 * SECOND))
def test_texts_and_datetimes_come_back(since: int) -> None:
    instant = parse_instant("1972-01-01T00:00:00") + since
    assert parse_instant(utc_text(instant, 9)) == instant
    whole = instant // 1000 * 1000
    if utc_text(whole)[17:19] != "60":
        assert from_datetime(as_datetime(whole)) == whole
    assert 0 <= instant - minute_of(instant) < 61 * SECOND


def test_forms() -> None:
    plain = parse_instant("2021-02-28T21:54:15.76")
    for text in (
        "2021-059T21:54:15.76Z",
        "2021-02-28 21:54:15.760000000",
        " 2021-02-28T21:54:15.76 ",
    ):
        assert parse_instant(text) == plain
    assert parse_instant("2021-02-28T21:54:15.7600000009") == plain
    assert as_datetime(plain) == datetime(2021, 2, 28, 21, 54, 15, 760000, tzinfo=UTC)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("2021-02-29T00:00:00", "day"),
        ("2021-366T00:00:00", r"day 366 of the year; expected 1 to 365"),
        ("2021-02-28T24:00:00", "time of day 24:00:00"),
        ("2021-02-28T00:60:00", "time of day 00:60:00"),
        ("2021-02-28T23:59:60", "there was no leap second"),
        ("1971-02-28T00:00:00", "year 1971; expected 1972 to 2199"),
        ("28.2.2021", "expected a time such as"),
        ("2021-02-28T21:54:15+02:00", "expected a time such as"),
    ],
)
def test_what_is_no_time(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        parse_instant(text)


def test_other_systems_are_named() -> None:
    assert known_system("GPS") == "GPS"
    with pytest.raises(ValueError, match="time system 'UT1' is not read; expected one of UTC"):
        known_system("UT1")
