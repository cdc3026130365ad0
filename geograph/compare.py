"""A smoothed path against the truth: errors, and whether the covariance is honest.

The truth is taken as it is, at its own times; the path is interpolated to them: its mean as in
:mod:`geograph.results.interpolate`, its covariance linearly between the knots.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.consistency import limit, nees
from geograph.errors import InputError
from geograph.geodesy import enu_axes
from geograph.measurements import Truth
from geograph.results import as_results
from geograph.results.interpolate import Knots, columns_at
from geograph.results.names import GEODETIC, POSITION, SUMMARY, TRACK, TRUTH, VELOCITY
from geograph.results.read import Table, load, load_track, load_truth

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.recording import Frame
    from geograph.results import Results
    from geograph.track import Track

EXPECTED_NEES = 3.0
"""Mean of a chi-square with three degrees of freedom: of the NEES of an honest position. In the
plane, where the height is given, it is two."""

# Rounds of fitting the delay: the path is nearly straight within it.
_DELAY_ROUNDS = 3

# Knots of an object at rest differ by rounding alone.
_AT_REST_M = 1e-6


@dataclass(frozen=True, eq=False, kw_only=True)
class PathEstimate:
    """A path with covariance: what of a track takes part in a comparison.

    Parameters
    ----------
    frame
        Of the recording.
    knots
        States at the knots.
    covariance_m2
        Of their positions, shape (k, 3, 3).
    height_held
        Whether the height was given, so that it says nothing of the estimate.
    """

    frame: Frame
    knots: Knots
    covariance_m2: NDArray[np.float64]
    height_held: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison:
    """Errors of a path, estimate less truth, at the times of the truth that it covers.

    Parameters
    ----------
    time_s
        Shape (n,).
    outside
        How many times of the truth lie before or after the path.
    error_m
        Shape (n, 3), by ``axes``.
    axes
        Names of the axes: east, north, up; or x, y, z in a local frame.
    course_error_m
        Shape (n, 3): along the velocity, across it to the right (level), and at right angles to
        both (upwards); None without a velocity.
    nees
        Shape (n,): normalised estimation error squared, e' P^-1 e; NaN where P is not positive.
    speed_error_m_s
        Shape (n,), or None where either has no velocity.
    dimensions
        How many coordinates the NEES counts: 3, or 2 where the height was given.
    delay_s
        By how much the truth lags, where that was fitted and taken out; None: it was not.
    """

    time_s: NDArray[np.float64]
    outside: int
    error_m: NDArray[np.float64]
    axes: tuple[str, str, str]
    course_error_m: NDArray[np.float64] | None
    nees: NDArray[np.float64]
    speed_error_m_s: NDArray[np.float64] | None
    dimensions: int = 3
    delay_s: float | None = None

    def figures(self) -> dict[str, Any]:
        """Return the errors in figures, ready for JSON."""
        distance = np.linalg.norm(self.error_m, axis=-1)
        components = dict(zip(self.axes, self.error_m.T, strict=True))
        if self.course_error_m is not None:
            names = ("along", "across", "above")
            components |= dict(zip(names, self.course_error_m.T, strict=True))
        nees = self.nees[np.isfinite(self.nees)]
        return {
            "points": int(self.time_s.size),
            "outside": self.outside,
            "delay_s": self.delay_s,
            "position_m": _figures(distance),
            "components_m": {
                name: _figures(np.abs(error)) | {"mean": float(error.mean())}
                for name, error in components.items()
            },
            "speed_m_s": None
            if self.speed_error_m_s is None
            else _figures(np.abs(self.speed_error_m_s))
            | {"mean": float(self.speed_error_m_s.mean())},
            "nees": {
                "mean": float(nees.mean()) if nees.size else None,
                "expected": EXPECTED_NEES * self.dimensions / 3,
                # Errors along one path go together, so a path counts as a single draw.
                "band_99": limit([0.005, 0.995], self.dimensions).tolist(),
                "share_within_95": float((nees <= limit(0.95, self.dimensions)).mean())
                if nees.size
                else None,
            },
        }


def compare(
    track: Track | Results | PathEstimate, truth: Truth, *, fit_delay: bool = False
) -> Comparison:
    """Return the errors of a path at the times of the truth.

    Parameters
    ----------
    track
        A track, its results, or a path alone.
    truth
        In the same frame, its times after the same epoch.
    fit_delay
        Whether the truth may lag by one time, as positions do that an aircraft reports of itself:
        the median of the errors along the path over the speed. It is taken out of the errors.

    Raises
    ------
    InputError
        If no time of the truth lies within the path, or a delay is asked for of an object at rest.
    """
    path = track if isinstance(track, PathEstimate) else _path_of(as_results(track))
    if not fit_delay:
        return _compared(path, truth)
    delay = 0.0
    for _ in range(_DELAY_ROUNDS):
        found = _compared(path, dataclasses.replace(truth, time_s=truth.time_s - delay))
        if found.course_error_m is None:
            raise InputError("the path has no velocity; a delay is that of a moving object's truth")
        _, velocity = path.knots.at(found.time_s)
        assert velocity is not None
        speed = np.linalg.norm(velocity, axis=-1)
        moving = speed > 0.0
        if moving.any():
            delay += float(np.median(found.course_error_m[moving, 0] / speed[moving]))
    found = _compared(path, dataclasses.replace(truth, time_s=truth.time_s - delay))
    return dataclasses.replace(found, delay_s=delay)


def _compared(path: PathEstimate, truth: Truth) -> Comparison:
    knots = path.knots
    first, last = knots.time_s[0], knots.time_s[-1]
    # One knot is an object at rest, which holds for all times.
    covered = (truth.time_s >= first) & (truth.time_s <= last) | (knots.time_s.size == 1)
    if not covered.any():
        low, high = truth.time_s.min(), truth.time_s.max()
        raise InputError(
            f"truth covers {low:.9g} to {high:.9g} s and the path {first:.9g} to {last:.9g} s; "
            "expected times that overlap; is it of another recording or epoch?"
        )
    time = truth.time_s[covered]
    position, velocity = knots.at(time)
    error = position - truth.position_m[covered]
    level = (
        enu_axes(position)
        if path.frame == "ecef"
        else np.broadcast_to(np.eye(3), (len(time), 3, 3))
    )
    # The frame is local where the height is given.
    dimensions = 2 if path.height_held else 3
    speed_error = None
    if truth.velocity_m_s is not None and velocity is not None:
        true_speed = np.linalg.norm(truth.velocity_m_s[covered], axis=-1)
        speed_error = np.linalg.norm(velocity, axis=-1) - true_speed
    return Comparison(
        time_s=time,
        outside=int((~covered).sum()),
        error_m=np.einsum("nij,nj->ni", level, error),
        axes=("east", "north", "up") if path.frame == "ecef" else ("x", "y", "z"),
        course_error_m=None if velocity is None else _course(error, velocity, level[:, 2]),
        nees=nees(
            error[:, :dimensions],
            columns_at(time, knots.time_s, path.covariance_m2)[:, :dimensions, :dimensions],
            undefined=np.nan,
        ),
        speed_error_m_s=speed_error,
        dimensions=dimensions,
    )


def read_path(source: Path | str) -> PathEstimate:
    """Read a path to compare: a results folder, or its ``track.csv`` alone.

    Raises
    ------
    InputError
        If it is neither.
    """
    from geograph.batch import SUMMARY_TABLE

    source = Path(source)
    if source.is_dir() and (source / SUMMARY).exists():
        return _path_of(load(source))
    if source.is_dir() and (source / SUMMARY_TABLE).exists():
        raise InputError(
            f"holds the results of several recordings; expected those of one, {source}/NAME",
            path=source,
        )
    file = source / TRACK if source.is_dir() else source
    fields = load_track(file)
    geodetic = GEODETIC[0] in Table(file, ())
    return _settled(
        PathEstimate(
            frame="ecef" if geodetic else "local",
            knots=Knots(**{entry.name: fields[entry.name] for entry in dataclasses.fields(Knots)}),
            covariance_m2=fields["position_covariance_m2"],
        )
    )


def read_truth(source: Path | str) -> Truth:
    """Read the truth: a truth table, or a recording or results folder that has one.

    Raises
    ------
    InputError
        If there is none.
    """
    source = Path(source)
    if source.is_file() and source.suffix == ".parquet":
        return _parquet_truth(source)
    if source.is_file() and source.suffix != ".zip":
        return load_truth(source)
    if (source / SUMMARY).exists() and (source / TRUTH).exists():
        return load_truth(source / TRUTH)
    from geograph.io import read

    truth = read(source).truth
    if truth is None:
        raise InputError(f"has no truth table; expected a recording with {TRUTH}", path=source)
    return truth


def _parquet_truth(file: Path) -> Truth:
    from geograph.io.reader import TRUTH_COLUMNS
    from geograph.io.source import FolderSource
    from geograph.io.tables import read_table

    columns = read_table(FolderSource(file.parent), file.name, TRUTH_COLUMNS).numbers
    velocity = [columns[name] for name in VELOCITY if name in columns]
    return Truth(
        time_s=columns["time_s"],
        position_m=np.stack([columns[name] for name in POSITION], axis=-1),
        velocity_m_s=np.stack(velocity, axis=-1) if len(velocity) == len(VELOCITY) else None,
    )


def _figures(size: NDArray[np.float64]) -> dict[str, float]:
    return {
        "rmse": float(np.sqrt(np.mean(size**2))),
        "median": float(np.median(size)),
        "max": float(size.max()),
    }


def _path_of(results: Results) -> PathEstimate:
    return _settled(
        PathEstimate(
            frame=results.frame,
            knots=results.knots(),
            covariance_m2=results.position_covariance_m2,
            height_held=results.height_held,
        )
    )


def _settled(path: PathEstimate) -> PathEstimate:
    """Return an object at rest as one knot, however many its sensors' errors needed."""
    knots = path.knots
    if knots.velocity_m_s is not None or np.ptp(knots.position_m, axis=0).max() > _AT_REST_M:
        return path
    return dataclasses.replace(
        path,
        knots=Knots(time_s=knots.time_s[:1], position_m=knots.position_m[:1]),
        covariance_m2=path.covariance_m2[:1],
    )


def _course(
    error: NDArray[np.float64], velocity: NDArray[np.float64], up: NDArray[np.float64]
) -> NDArray[np.float64]:
    along = _unit(velocity)
    across = _unit(np.cross(along, up))
    above = np.cross(across, along)
    axes = np.stack([along, across, above], axis=1)
    return np.asarray(np.einsum("nij,nj->ni", axes, error))


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.asarray(vector / np.where(length > 0.0, length, 1.0))
