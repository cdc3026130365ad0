"""Directions and positions between inertial and Earth-fixed axes: the one place where they turn.

Rotations are those of the IAU (precession-nutation 2006/2000A, Earth rotation angle) through ERFA,
with the Earth orientation that the IERS measured, from the tables that come with astropy; nothing
is downloaded. The origin of what comes out is the Earth's centre, its axes those of the ITRS, with
which WGS 84 agrees to centimetres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.errors import InputError
from geograph.io.instants import (
    DAY_NS,
    SECOND_NS,
    instant_of,
    tai_to_utc_all_ns,
    tai_to_utc_ns,
    utc_to_tai_ns,
)

if TYPE_CHECKING:
    from datetime import datetime
    from pathlib import Path

    from numpy.typing import NDArray

_JD_1970 = 2440587.5
_MJD_1970 = 40587.0
_JD_2000 = 2451545.0
# The Earth rotation angle in turns, at noon of 2000-01-01 UT1 and what it gains on a turn a day.
_ERA_2000 = 0.7790572732640
_ERA_EXCESS = 0.00273781191135448
_TT_LESS_TAI_NS = 32_184_000_000
_DAY_S = 86400.0
_AU_M = 149_597_870_700.0
"""Astronomical unit (IAU 2012, resolution B2)."""

_SUN_BENDING = 1.97412574336e-8
"""2 G M / c^2 of the Sun over the astronomical unit (IAU 2009 system of constants, as in ERFA)."""

# What turns or moves slowly is worked out four times a day. Cubic splines between are good to
# 1e-12; the daily values of the pole and of UT1 are interpolated linearly, as astropy does.
_NODE_NS = DAY_NS // 4
_MARGIN_NODES = 2


def erfa_module(place: Path | str | None, extra: str) -> Any:
    """Return the module erfa; InputError that names an extra if it is not installed."""
    try:
        import erfa
    except ImportError:
        raise InputError(
            f"needs astropy, which is not installed; run pip install 'geograph[{extra}]'",
            path=place,
        ) from None
    return erfa


@cache
def _orientation() -> Any:
    """Return the table of measured and predicted Earth orientation that astropy ships."""
    import astropy_iers_data
    from astropy.utils import iers

    # Opened by name, so that no setting of astropy makes it look for a newer one on the net.
    return iers.IERS_A.open(astropy_iers_data.IERS_A_FILE)


def _julian(count_ns: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    days, rest = np.divmod(count_ns, DAY_NS)
    return _JD_1970 + days, rest / DAY_NS


UNKNOWN_ORIENTATION = (
    "for which the tables of Earth orientation that came with astropy have no value; expected 1973 "
    "to a few months from now; update astropy-iers-data"
)


def _orientation_at(
    utc_ns: NDArray[np.int64], place: Path | str | None, extra: str
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return UT1 - UTC (s) and the pole's x and y (rad)."""
    erfa_module(place, extra)
    table, julian = _orientation(), _julian(utc_ns)
    difference, status = table.ut1_utc(*julian, return_status=True)
    if (np.atleast_1d(status) < 0).any():
        year = np.datetime64(int(np.atleast_1d(utc_ns)[np.argmax(status < 0)]), "ns")
        raise InputError(
            f"holds a time on {np.datetime_as_string(year, 'D')}, {UNKNOWN_ORIENTATION}",
            path=place,
        )
    x, y = table.pm_xy(*julian)
    return difference.to_value("s"), x.to_value("rad"), y.to_value("rad")


def orientation_known(
    epoch: datetime, time_s: NDArray[np.float64], place: Path | str | None = None
) -> NDArray[np.bool_]:
    """Return whether the Earth's orientation is known at times, shape (n,), after an epoch.

    Raises
    ------
    InputError
        If astropy is missing.
    """
    erfa_module(place, "optical")
    tai = instant_of(epoch, place) + np.round(time_s * SECOND_NS).astype(np.int64)
    _, status = _orientation().ut1_utc(*_julian(tai_to_utc_all_ns(tai)), return_status=True)
    return np.asarray(np.atleast_1d(status) >= 0)


def earth_fixed_from_gcrs(
    tai_ns: NDArray[np.int64], place: Path | str | None, extra: str
) -> NDArray[np.float64]:
    """Return rotations from the axes of the GCRS to those of the ITRS, shape (n, 3, 3).

    Parameters
    ----------
    tai_ns
        Shape (n,): instants.
    place, extra
        For messages: the file that asks, and the extra that installs what is needed.

    Raises
    ------
    InputError
        If astropy is missing, or the Earth's orientation at a time is not known.
    """
    erfa = erfa_module(place, extra)
    utc = tai_to_utc_all_ns(tai_ns)
    difference, x, y = _orientation_at(utc, place, extra)
    tt = _julian(tai_ns + _TT_LESS_TAI_NS)
    ut1 = _julian(utc + np.round(difference * SECOND_NS).astype(np.int64))
    return np.asarray(erfa.c2t06a(*tt, *ut1, x, y))


def earth_fixed_from_teme(
    tai_ns: NDArray[np.int64], place: Path | str | None, extra: str
) -> NDArray[np.float64]:
    """Return rotations from the true equator, mean equinox axes of SGP4 to the ITRS, (n, 3, 3).

    Rotation by the Greenwich mean sidereal time of 1982 about the pole of date, and polar motion
    (Vallado et al., *Revisiting Spacetrack Report #3*, AIAA 2006-6753, appendix C).

    Parameters
    ----------
    tai_ns, place, extra
        As in :func:`earth_fixed_from_gcrs`.

    Raises
    ------
    InputError
        As there.
    """
    erfa = erfa_module(place, extra)
    utc = tai_to_utc_all_ns(tai_ns)
    difference, x, y = _orientation_at(utc, place, extra)
    ut1 = _julian(utc + np.round(difference * SECOND_NS).astype(np.int64))
    angle = erfa.gmst82(*ut1)
    spin = erfa.rz(angle, np.broadcast_to(np.eye(3), (angle.size, 3, 3)).copy())
    return np.asarray(erfa.pom00(x, y, 0.0) @ spin)


def gcrs_from_astrometric(
    direction: NDArray[np.float64], tai_ns: NDArray[np.int64], place: Path | str | None, extra: str
) -> NDArray[np.float64]:
    """Return Earth-centred directions of what was measured against stars, shape (n, 3).

    A direction measured against the stars of the same field shares their aberration, and their
    catalogue places are free of it: reduced, it is the direction from the observer at reception to
    the object at emission in axes that rest with the Sun's system. In axes that move with the
    Earth, in which paths are estimated, the object at emission is displaced by the Earth's own way
    in the light time, an angle of v / c whatever the distance: the annual aberration, up to 20.5".
    It is put back here, with the bending of the stars' light by the Sun (ERFA's ``atciqz`` for an
    observer at the Earth's centre). That by the observer's own motion about the centre, the diurnal
    aberration, is not: the smoother takes sensors at reception and the object at emission in axes
    that do not turn, so that what was measured against stars is what it predicts.

    Parameters
    ----------
    direction
        Shape (n, 3): unit vectors in the axes of the ICRS.
    tai_ns, place, extra
        As in :func:`earth_fixed_from_gcrs`.
    """
    erfa = erfa_module(place, extra)
    # TT in place of TDB: 1.7 ms at most, in which the Earth's velocity changes by nothing.
    context = erfa.apcg13(*_julian(tai_ns + _TT_LESS_TAI_NS))
    right_ascension, declination = erfa.c2s(direction)
    return np.asarray(erfa.s2c(*erfa.atciqz(right_ascension, declination, context)))


def icrs_from_equinox(
    direction: NDArray[np.float64],
    equinox: NDArray[np.float64],
    tai_ns: NDArray[np.int64],
    place: Path | str | None,
    extra: str,
) -> NDArray[np.float64]:
    """Return unit vectors on the axes of the ICRS of those on other equators and equinoxes.

    Parameters
    ----------
    direction
        Shape (n, 3).
    equinox
        Shape (n,): year of the equinox. Before 1984 it is a Besselian year of the FK4 (with its
        terms of elliptic aberration), later a Julian year of the FK5; NaN: already the ICRS;
        infinite: mean equator and equinox of date.
    tai_ns, place, extra
        As in :func:`earth_fixed_from_gcrs`.
    """
    erfa_module(place, extra)
    from astropy.coordinates import FK4, FK5, ICRS, CartesianRepresentation, SkyCoord
    from astropy.time import Time

    result = direction.copy()
    moment = Time(*_julian(tai_ns), format="jd", scale="tai")
    for year in np.unique(equinox[~np.isnan(equinox)]):
        rows = equinox == year
        given = CartesianRepresentation(direction[rows].T)
        if year < 1984.0:
            frame = FK4(equinox=Time(year, format="byear"), obstime=moment[rows])
        else:
            of_date = moment[rows] if np.isinf(year) else Time(year, format="jyear")
            frame = FK5(equinox=of_date)
        result[rows] = SkyCoord(given, frame=frame).transform_to(ICRS()).cartesian.xyz.value.T
    return result


def frame_bias(place: Path | str | None, extra: str) -> NDArray[np.float64]:
    """Return the rotation from the axes of the GCRS to the mean equator and equinox of J2000."""
    bias, _, _ = erfa_module(place, extra).bp06(2451545.0, 0.0)
    return np.asarray(bias)


@dataclass(frozen=True, eq=False)
class _Nodes:
    """What turns or moves slowly, at instants a quarter of a day apart.

    ``count`` is the number of the first one and that after the last one; the splines are functions
    of these numbers.
    """

    count: tuple[int, int]
    ut1_less_tai_s: NDArray[np.float64]
    pole: Any
    sky: Any
    velocity: Any
    sun: Any


@dataclass(frozen=True, eq=False)
class Stars:
    """What directions against the stars need beside a rotation, at n times.

    Attributes
    ----------
    earth_velocity
        Shape (n, 3): barycentric velocity of the Earth over that of light, on the axes of the ICRS.
    sun_to_earth
        Shape (n, 3): unit vectors, on the same axes.
    bending
        Shape (n,): 2 G M / (c^2 R) of the Sun.
    """

    earth_velocity: NDArray[np.float64]
    sun_to_earth: NDArray[np.float64]
    bending: NDArray[np.float64]


class CelestialAxes:
    """The axes of the ICRS in ECEF, and the Earth's own motion, at any times of a recording.

    Parameters
    ----------
    epoch
        Instant of time zero.
    place, extra
        For messages: the file that asks, and the extra that installs what is needed.
    """

    def __init__(
        self, epoch: datetime, place: Path | str | None = None, extra: str = "optical"
    ) -> None:
        self.place, self.extra = place, extra
        self._epoch_tai_ns = instant_of(epoch, place)
        # Nodes lie on midnights of UTC, at which the IERS gives its values.
        utc = tai_to_utc_ns(self._epoch_tai_ns)
        self._first_tai_ns = utc_to_tai_ns(utc // DAY_NS * DAY_NS)
        self._offset_s = (self._epoch_tai_ns - self._first_tai_ns) / SECOND_NS
        self._nodes: _Nodes | None = None

    def cover(self, time_s: NDArray[np.float64]) -> None:
        """Make ready for times, shape (n,), seconds.

        Raises
        ------
        InputError
            If astropy is missing, or the Earth's orientation at a time is not known.
        """
        if not time_s.size:
            return
        number = (self._offset_s + np.array([time_s.min(), time_s.max()])) * SECOND_NS / _NODE_NS
        low, high = int(np.floor(number[0])), int(np.ceil(number[1])) + 1
        if self._nodes is not None:
            first, last = self._nodes.count
            if first + _MARGIN_NODES <= low and high <= last - _MARGIN_NODES:
                return
            low, high = min(low, first + _MARGIN_NODES), max(high, last - _MARGIN_NODES)
        # Times themselves are looked up first, so that a message names one of them.
        ends = self._epoch_tai_ns + np.round(
            np.array([time_s.min(), time_s.max()]) * SECOND_NS
        ).astype(np.int64)
        _orientation_at(tai_to_utc_all_ns(ends), self.place, self.extra)
        self._nodes = self._made(low - _MARGIN_NODES, high + _MARGIN_NODES)

    def _made(self, first: int, last: int) -> _Nodes:
        from scipy.interpolate import CubicSpline, make_interp_spline

        erfa = erfa_module(self.place, self.extra)
        number = np.arange(first, last)
        tai = self._first_tai_ns + number * _NODE_NS
        utc = tai_to_utc_all_ns(tai)
        # Nodes beyond the table, of which none of the times asks, have its last value.
        mjd = _orientation()["MJD"].to_value("d")[[0, -1]]
        known = ((mjd - _MJD_1970) * DAY_NS).astype(np.int64) + np.array([1, -1]) * SECOND_NS
        difference, x, y = _orientation_at(np.clip(utc, *known), self.place, self.extra)
        tt = _julian(tai + _TT_LESS_TAI_NS)
        heliocentric, barycentric = erfa.epv00(*tt)
        return _Nodes(
            (first, last),
            difference + (utc - tai) / SECOND_NS,
            make_interp_spline(number, erfa.pom00(x, y, erfa.sp00(*tt)), k=1),
            CubicSpline(number, erfa.c2i06a(*tt)),
            CubicSpline(number, barycentric["v"] * (_AU_M / _DAY_S / SPEED_OF_LIGHT_M_S)),
            CubicSpline(number, heliocentric["p"]),
        )

    def _number(self, time_s: NDArray[np.float64]) -> tuple[_Nodes, NDArray[np.float64]]:
        """Return the nodes, and the times in units of theirs, held within them."""
        if self._nodes is None:
            self.cover(time_s)
        nodes = self._nodes
        assert nodes is not None
        first, last = nodes.count
        number = (self._offset_s + time_s) * (SECOND_NS / _NODE_NS)
        # A clock that is being searched for may ask far beyond the measurements.
        return nodes, np.clip(number, first, last - 1)

    def at(self, time_s: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the axes of the ICRS as rows in ECEF, and their rate, each shape (n, 3, 3).

        Parameters
        ----------
        time_s
            Shape (n,), seconds after the epoch.
        """
        nodes, number = self._number(time_s)
        ut1 = np.interp(number, np.arange(*nodes.count), nodes.ut1_less_tai_s)
        # The angle is worked out from whole days and the rest, in UT1 (N. Capitaine et al.,
        # *Definition of the Celestial Ephemeris origin and of UT1 in the International Celestial
        # Reference Frame*, A&A 355, 2000).
        whole, part = divmod(self._first_tai_ns, DAY_NS)
        days = whole + (_JD_1970 - _JD_2000)
        rest = (part / SECOND_NS + self._offset_s + time_s + ut1) / _DAY_S
        turns = _ERA_2000 + _ERA_EXCESS * (days + rest) + days % 1.0 + rest
        angle = 2.0 * np.pi * (turns % 1.0)
        sine, cosine, zero = np.sin(angle), np.cos(angle), np.zeros_like(angle)
        spin = np.stack([cosine, sine, zero, -sine, cosine, zero, zero, zero, zero + 1.0], axis=1)
        slope = np.stack([-sine, cosine, zero, -cosine, -sine, zero, zero, zero, zero], axis=1)
        rate = 2.0 * np.pi * (1.0 + _ERA_EXCESS) / _DAY_S
        pole, sky = nodes.pole(number), nodes.sky(number)
        turned = pole @ spin.reshape(-1, 3, 3) @ sky
        turning = rate * (pole @ slope.reshape(-1, 3, 3) @ sky)
        return np.swapaxes(turned, 1, 2), np.swapaxes(turning, 1, 2)

    def stars(self, time_s: NDArray[np.float64]) -> Stars:
        """Return what directions against the stars need at times, shape (n,), seconds."""
        nodes, number = self._number(time_s)
        sun = nodes.sun(number)
        distance = np.linalg.norm(sun, axis=1)
        return Stars(nodes.velocity(number), sun / distance[:, None], _SUN_BENDING / distance)
