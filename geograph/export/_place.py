"""Results on the Earth and in time: what all map formats are made from."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING

import numpy as np

from geograph.ellipsoids import ellipsoids
from geograph.errors import InputError
from geograph.geodesy import geodetic_from_ecef
from geograph.io.atomic import replacing_file
from geograph.io.instants import SECOND_NS, from_datetime, utc_text
from geograph.results import Results, as_results
from geograph.results.data import ELLIPSOID_PROBABILITY

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from geograph.track import Track

MOST_ELLIPSES = 200
"""More of them on a map hide each other."""

_CORNERS = 72
_POINTS_OF_A_PATH = 400


@dataclass(frozen=True, eq=False)
class Placed:
    """Results with their instants.

    Attributes
    ----------
    results
        In ECEF.
    tai_ns
        Shape (k,): instants of the knots (:mod:`geograph.io.instants`).
    epoch_tai_ns
        That of the recording.
    """

    results: Results
    tai_ns: NDArray[np.int64]
    epoch_tai_ns: int

    @property
    def rows(self) -> NDArray[np.int64]:
        """Indices of the knots to be shown: of an object at rest, one."""
        return np.arange(1 if self.results.static else self.results.time_s.size)

    def times(self, digits: int = 3) -> list[str]:
        """Return the knots' times as UTC texts with a final Z."""
        return [utc_text(int(value), digits) + "Z" for value in self.tai_ns]

    def drawn(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return times (n,) and positions (n, 3) of the path, dense enough to be drawn as lines."""
        time = self.results.time_s
        if self.rows.size == 1:
            return time[:1], self.results.position_m[:1]
        parts = max(1, int(np.ceil(_POINTS_OF_A_PATH / time.size)))
        steps = np.arange(parts) / parts
        dense = np.append((time[:-1, None] + np.diff(time)[:, None] * steps).ravel(), time[-1])
        return dense, self.results.knots().at(dense)[0]

    def texts(self, time_s: NDArray[np.float64], digits: int = 3) -> list[str]:
        """Return times in seconds as UTC texts with a final Z."""
        tai = self.epoch_tai_ns + np.round(time_s * SECOND_NS).astype(np.int64)
        return [utc_text(int(value), digits) + "Z" for value in tai]

    def ellipse_rows(self) -> NDArray[np.int64]:
        """Return the knots whose ellipses are drawn: those with a finite one, evenly."""
        covariance = self.results.position_covariance_m2.reshape(-1, 9)
        finite = np.asarray(np.isfinite(covariance).all(axis=1))
        rows = self.rows[finite[self.rows]]
        if rows.size <= MOST_ELLIPSES:
            return rows
        return rows[np.round(np.linspace(0, rows.size - 1, MOST_ELLIPSES)).astype(np.int64)]

    def ellipses(self, rows: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the 95 % ellipses over ground of some knots.

        Returns
        -------
        outline
            Shape (n, corners + 1, 3): latitude, longitude (deg) and height (m), anticlockwise seen
            from above, the first point again at the end.
        semi_axes_m
            Shape (n, 2), the longer first.
        """
        level = self.results.level_covariance_m2()[rows][:, :2, :2]
        found = ellipsoids(np.zeros((rows.size, 2)), level, ELLIPSOID_PROBABILITY)
        angle = np.linspace(0.0, 2.0 * np.pi, _CORNERS + 1)
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        # The axes may come left-handed; which way round would then depend on rounding.
        axes = found.axes.copy()
        axes[np.linalg.det(axes) < 0.0, 1] *= -1.0
        offset = np.einsum("ca,na,nab->ncb", circle, found.semi_axes_m, axes)
        plane = self.results.level_axes()[rows][:, :2]
        corners = self.results.position_m[rows][:, None] + np.einsum("ncb,nbj->ncj", offset, plane)
        outline = geodetic_from_ecef(corners)
        outline[..., 2] = self.results.height_m()[rows][:, None]
        return outline, found.semi_axes_m

    def spans(self, rows: NDArray[np.int64]) -> list[tuple[str, str]]:
        """Return when each of some knots is the nearest of them, as UTC texts with a final Z."""
        time = self.results.time_s[rows]
        edges = np.concatenate([time[:1], 0.5 * (time[1:] + time[:-1]), time[-1:]])
        if self.results.static:
            edges = self.results.time_s[[0, -1]]
        texts = self.texts(edges)
        return list(itertools.pairwise(texts))


def placed(track: Track | Results, path: Path) -> Placed:
    """Return results with their instants; InputError if they have no place on the Earth.

    Parameters
    ----------
    track
        A track or its results.
    path
        What is to be written, for messages.
    """
    results = as_results(track)
    if results.frame != "ecef":
        raise InputError(
            f"cannot show {results.name!r}, which is in a local frame and has no place on the "
            "Earth; expected results in ecef; .parquet can hold it",
            path=path,
        )
    bad = ~np.isfinite(results.position_m).all(axis=1)
    if results.velocity_m_s is not None:
        bad |= ~np.isfinite(results.velocity_m_s).all(axis=1)
    if bad.any():
        raise InputError(
            f"cannot hold the path of {results.name!r} at {results.time_s[bad][0]:.9g} s, which is "
            f"no finite place (status {results.status}); expected results of a run that converged",
            path=path,
        )
    epoch = epoch_of(results)
    if epoch is None:
        raise InputError(f"cannot show {results.name!r}, which has no epoch", path=path)
    tai = epoch + np.round(results.time_s * SECOND_NS).astype(np.int64)
    return Placed(results, tai, epoch)


def epoch_of(results: Results) -> int | None:
    """Return the instant of a result's epoch, or None; InputError if it is not a time."""
    text = results.summary.get("epoch")
    if text is None:
        return None
    try:
        moment = datetime.fromisoformat(str(text))
        if moment.tzinfo is None:
            raise ValueError
        return from_datetime(moment)
    except ValueError:
        raise InputError(
            f"summary of {results.name!r} has the epoch {str(text)[:40]!r}; expected a date and "
            "time with zone, from 1972 to 2199"
        ) from None


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    with replacing_file(path) as staging:
        staging.write_text(text, encoding="utf-8", newline="\n")


def rounded(values: Sequence[float] | NDArray[np.float64], digits: int) -> list[float]:
    """Return numbers rounded for a map; eight digits of a degree are a millimetre."""
    return [round(float(value), digits) for value in values]
