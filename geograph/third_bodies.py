"""Where Moon and Sun are in Earth-fixed axes, for the forces on a satellite.

The Moon is that of J. Meeus, *Astronomical Algorithms*, 2nd ed., 1998 (as ERFA's ``moon98``: 10" in
longitude, 30 km in distance), the Sun is ERFA's ``epv00``. Both are turned into ECEF by precession,
nutation and the Earth rotation angle. UT1 is taken to be UTC and the pole not to move: up to a
second of time is 1e-4 of the pull's direction.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.constants import MOON_GM_M3_S2, SUN_GM_M3_S2
from geograph.earth import _AU_M, _TT_LESS_TAI_NS, _julian, erfa_module
from geograph.io.instants import SECOND_NS, instant_of, tai_to_utc_all_ns

if TYPE_CHECKING:
    from datetime import datetime
    from pathlib import Path

    from numpy.typing import NDArray

BODIES = {"moon": MOON_GM_M3_S2, "sun": SUN_GM_M3_S2}
"""Gravitational parameters of the bodies known, by name."""

# The Earth turns by 2.5 degrees between two nodes: a quintic is good to 1e-10 of the distance.
_NODE_S = 600.0
_MARGIN_NODES = 36


class ThirdBodies:
    """Places of Moon and Sun at any times of a recording.

    Parameters
    ----------
    epoch
        Instant of time zero.
    names
        ``"moon"``, ``"sun"``, or both.
    place
        For messages: the file that asks.

    Raises
    ------
    InputError
        If astropy is missing, or the epoch is before UTC.
    """

    def __init__(
        self, epoch: datetime, names: tuple[str, ...], place: Path | str | None = None
    ) -> None:
        self._erfa = erfa_module(place, "optical")
        self._epoch_tai_ns = instant_of(epoch, place)
        self.names = names
        self._range = (0, 0)
        self._spline: Any = None

    def __call__(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return places, shape (n, B, 3), ECEF metres, at times, shape (n,), after the epoch."""
        low = int(np.floor(time_s.min() / _NODE_S))
        high = int(np.ceil(time_s.max() / _NODE_S))
        first, last = self._range
        if self._spline is None or low < first or high > last:
            if self._spline is not None:
                low, high = min(low, first), max(high, last)
            self._make(low - _MARGIN_NODES, high + _MARGIN_NODES)
        return np.asarray(self._spline(time_s / _NODE_S)).reshape(-1, len(self.names), 3)

    def _make(self, first: int, last: int) -> None:
        from scipy.interpolate import make_interp_spline

        number = np.arange(first, last + 1, dtype=np.float64)
        places = self.exactly(number * _NODE_S)
        self._spline = make_interp_spline(number, places.reshape(number.size, -1), k=5)
        self._range = first, last

    def exactly(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return places as :meth:`__call__` does, without a table between."""
        tai = self._epoch_tai_ns + np.round(time_s * SECOND_NS).astype(np.int64)
        tt, utc = _julian(tai + _TT_LESS_TAI_NS), _julian(tai_to_utc_all_ns(tai))
        turn = self._erfa.c2t06a(*tt, *utc, 0.0, 0.0)
        found = []
        for name in self.names:
            if name == "moon":
                place = self._erfa.moon98(*tt)["p"]
            else:
                place = -self._erfa.epv00(*tt)[0]["p"]
            found.append(np.einsum("nij,nj->ni", turn, _AU_M * place))
        return np.stack(found, axis=1)
