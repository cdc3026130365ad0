"""Directions and positions between inertial and Earth-fixed axes.

Rotations are those of the IAU (precession-nutation 2006/2000A, Earth rotation angle) through ERFA,
with the Earth orientation that the IERS measured, from the tables that come with astropy; nothing
is downloaded. The origin of what comes out is the Earth's centre, its axes those of the ITRS, with
which WGS 84 agrees to centimetres.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.errors import InputError
from geograph.io.instants import DAY_NS, SECOND_NS, tai_to_utc_ns

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

_JD_1970 = 2440587.5
_TT_LESS_TAI_NS = 32_184_000_000
_ARCSECOND_RAD = np.pi / 648000.0


def erfa_module(place: Path | str, extra: str) -> Any:
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


def _orientation_at(
    utc_ns: NDArray[np.int64], place: Path | str
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return UT1 - UTC (s) and the pole's x and y (rad)."""
    table, julian = _orientation(), _julian(utc_ns)
    difference, status = table.ut1_utc(*julian, return_status=True)
    if (np.atleast_1d(status) < 0).any():
        year = np.datetime64(int(np.atleast_1d(utc_ns)[np.argmax(status < 0)]), "ns")
        raise InputError(
            f"holds a time on {np.datetime_as_string(year, 'D')}, for which the tables of Earth "
            "orientation that came with astropy have no value; expected 1973 to a few months from "
            "now; update astropy-iers-data",
            path=place,
        )
    x, y = table.pm_xy(*julian)
    return difference.to_value("s"), x.to_value("rad"), y.to_value("rad")


def earth_fixed_from_gcrs(
    tai_ns: NDArray[np.int64], place: Path | str, extra: str
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
    utc = np.array([tai_to_utc_ns(int(value)) for value in tai_ns], dtype=np.int64)
    difference, x, y = _orientation_at(utc, place)
    tt = _julian(tai_ns + _TT_LESS_TAI_NS)
    ut1 = _julian(utc + np.round(difference * SECOND_NS).astype(np.int64))
    return np.asarray(erfa.c2t06a(*tt, *ut1, x, y))


def earth_fixed_from_teme(
    tai_ns: NDArray[np.int64], place: Path | str, extra: str
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
    utc = np.array([tai_to_utc_ns(int(value)) for value in tai_ns], dtype=np.int64)
    difference, x, y = _orientation_at(utc, place)
    ut1 = _julian(utc + np.round(difference * SECOND_NS).astype(np.int64))
    angle = erfa.gmst82(*ut1)
    spin = erfa.rz(angle, np.broadcast_to(np.eye(3), (angle.size, 3, 3)).copy())
    return np.asarray(erfa.pom00(x, y, 0.0) @ spin)


def gcrs_from_astrometric(
    direction: NDArray[np.float64], tai_ns: NDArray[np.int64], place: Path | str, extra: str
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
    place: Path | str,
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


def frame_bias(place: Path | str, extra: str) -> NDArray[np.float64]:
    """Return the rotation from the axes of the GCRS to the mean equator and equinox of J2000."""
    bias, _, _ = erfa_module(place, extra).bp06(2451545.0, 0.0)
    return np.asarray(bias)
