"""What the files of a results folder hold, as frozen dataclasses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from geograph.geodesy import enu_axes, geodetic_from_ecef
from geograph.results.interpolate import Knots

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.measurements import Truth
    from geograph.recording import Frame

ELLIPSOID_PROBABILITY = 0.95
"""Probability of the ellipsoids whose semi-axes the files hold."""

SURPRISING_SIGMAS = 3.0
"""A sensor error further than this many prior sigmas from zero is marked wherever it is shown."""

ErrorKind = Literal["azimuth", "elevation", "clock", "frequency"]


@dataclass(frozen=True, kw_only=True)
class ErrorState:
    """One error of one sensor, as estimated.

    Parameters
    ----------
    sensor, state
        Its names, for example ``"UK000X"`` and ``"clock_offset"``.
    unit
        SI unit of the three numbers.
    estimate, sigma
        Posterior mean and standard deviation.
    prior_sigma
        Standard deviation of its prior, whose mean is zero.
    """

    sensor: str
    state: str
    unit: str
    estimate: float
    sigma: float
    prior_sigma: float

    @property
    def surprising(self) -> bool:
        """Whether the estimate is further from zero than three prior sigmas allow."""
        return abs(self.estimate) > SURPRISING_SIGMAS * self.prior_sigma


@dataclass(frozen=True, eq=False, kw_only=True)
class ErrorCurve:
    """Total error of one sensor over time: bias, drift and random walk together.

    Parameters
    ----------
    sensor, kind, unit
        Its sensor, which error, and the SI unit of the numbers.
    time_s
        Shape (n,), seconds after the epoch.
    estimate, sigma, prior_sigma
        Shape (n,): posterior mean and standard deviation, and the prior's standard deviation.
    """

    sensor: str
    kind: ErrorKind
    unit: str
    time_s: NDArray[np.float64]
    estimate: NDArray[np.float64]
    sigma: NDArray[np.float64]
    prior_sigma: NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorPath:
    """Where a sensor was by the recording; of a platform whose path is estimated, its fixes.

    Parameters
    ----------
    sensor, axes
        Its name and the axes of its bearings.
    time_s
        Shape (n,); one time for a fixed sensor.
    position_m
        Shape (n, 3), metres, in the recording's frame.
    """

    sensor: str
    axes: str
    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]

    @property
    def moving(self) -> bool:
        """Whether there is more than one position."""
        return self.time_s.size > 1


@dataclass(frozen=True, eq=False, kw_only=True)
class PlatformPath:
    """Where a moving sensor was, as estimated from its fixes and from all measurements.

    Parameters
    ----------
    sensor
        Its name.
    time_s
        Shape (k,), seconds after the epoch, at the knots.
    position_m, velocity_m_s
        Shape (k, 3), in the recording's frame.
    position_covariance_m2
        Shape (k, 3, 3).
    """

    sensor: str
    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    velocity_m_s: NDArray[np.float64]
    position_covariance_m2: NDArray[np.float64]

    def knots(self) -> Knots:
        """Return the states at the knots, to be interpolated."""
        return Knots(time_s=self.time_s, position_m=self.position_m, velocity_m_s=self.velocity_m_s)


@dataclass(frozen=True, eq=False, kw_only=True)
class ResidualTable:
    """Residuals of all measurements, a row for each scalar; every column has shape (n,).

    Parameters
    ----------
    time_s
        Time tag, by the sensor's own clock; of a difference, by the reference's.
    sensor, reference
        Names of the sensor and of the one that a difference refers to; empty for what is none.
    emission
        What the recording calls the emission that arrived; empty for what is no arrival.
    kind, unit
        What was measured (``"azimuth"``, ``"elevation"``, ``"toa"``, ``"tdoa"``, ``"fdoa"``), and
        its SI unit.
    measured, predicted, residual, sigma
        In that unit; residual is measured less predicted, angles wrapped to half a turn.
    normalised
        Residual over its standard deviation.
    weight
        Weight that the loss gave it, 0 to 1.
    rejected
        Whether it was rejected as a gross outlier, or the loss weighed it down to nothing.
    line
        Line of the file it came from, or 0.
    """

    time_s: NDArray[np.float64]
    sensor: NDArray[np.str_]
    reference: NDArray[np.str_]
    emission: NDArray[np.str_]
    kind: NDArray[np.str_]
    unit: NDArray[np.str_]
    measured: NDArray[np.float64]
    predicted: NDArray[np.float64]
    residual: NDArray[np.float64]
    sigma: NDArray[np.float64]
    normalised: NDArray[np.float64]
    weight: NDArray[np.float64]
    rejected: NDArray[np.bool_]
    line: NDArray[np.int64]

    def __len__(self) -> int:
        return int(self.time_s.size)

    def of(self, sensor: str, kind: str | None = None) -> ResidualTable:
        """Return the rows of one sensor, and of one kind where that is given."""
        rows = self.sensor == sensor
        if kind is not None:
            rows &= self.kind == kind
        return self.where(rows)

    def where(self, rows: NDArray[np.bool_]) -> ResidualTable:
        """Return some rows, by a mask of shape (n,)."""
        return ResidualTable(**{name: column[rows] for name, column in vars(self).items()})


@dataclass(frozen=True, eq=False, kw_only=True)
class Results:
    """A smoothed path, its covariance, the sensors' errors and the residuals.

    Parameters
    ----------
    name, frame, status
        Of the recording and its solution.
    time_s
        Shape (k,), seconds after the epoch, at the knots.
    position_m, position_covariance_m2
        Shapes (k, 3) and (k, 3, 3), in the recording's frame.
    velocity_m_s, acceleration_m_s2
        Shape (k, 3), or None where the motion model has none.
    sigma_speed_m_s
        Shape (k,): standard deviation of the speed, or None without a velocity.
    semi_axes_m
        Shape (k, 3): descending semi-axes of the 95 % ellipsoids.
    sensors
        Where each sensor was.
    platforms
        Where those were whose path is estimated.
    errors, curves
        Their errors; curves only of those errors that change with time.
    residuals
        Of all measurements.
    truth
        Where the object really was, if the recording knew.
    summary
        What ``summary.json`` holds.
    motion_covariance
        Shape (k, 6, 6): of position and velocity together, SI units; None without a velocity, or
        in results of versions that did not keep it.
    """

    name: str
    frame: Frame
    status: str
    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    position_covariance_m2: NDArray[np.float64]
    velocity_m_s: NDArray[np.float64] | None
    acceleration_m_s2: NDArray[np.float64] | None
    sigma_speed_m_s: NDArray[np.float64] | None
    semi_axes_m: NDArray[np.float64]
    sensors: tuple[SensorPath, ...]
    platforms: tuple[PlatformPath, ...]
    errors: tuple[ErrorState, ...]
    curves: tuple[ErrorCurve, ...]
    residuals: ResidualTable
    truth: Truth | None
    summary: dict[str, Any]
    motion_covariance: NDArray[np.float64] | None = None

    @property
    def speed_m_s(self) -> NDArray[np.float64] | None:
        """Speed relative to the recording's frame, shape (k,), or None without a velocity."""
        return None if self.velocity_m_s is None else np.linalg.norm(self.velocity_m_s, axis=-1)

    @property
    def static(self) -> bool:
        """Whether the object is at rest; there may be knots all the same, for the sensors' sake."""
        return self.time_s.size == 1 or self.summary.get("motion") == "static"

    @property
    def height_held(self) -> bool:
        """Whether the height is given and not estimated: a study in the plane."""
        return bool(self.summary.get("height_held", False))

    def knots(self) -> Knots:
        """Return the states at the knots, to be interpolated."""
        return Knots(
            time_s=self.time_s,
            position_m=self.position_m,
            velocity_m_s=self.velocity_m_s,
            acceleration_m_s2=self.acceleration_m_s2,
        )

    def level_axes(self) -> NDArray[np.float64]:
        """Return rows east, north, up at each knot, shape (k, 3, 3); x, y, z in a local frame."""
        if self.frame == "ecef":
            return enu_axes(self.position_m)
        return np.broadcast_to(np.eye(3), (self.time_s.size, 3, 3))

    def height_of(self, position_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return heights above the ellipsoid, or z in a local frame, shape (n,), of positions."""
        return geodetic_from_ecef(position_m)[:, 2] if self.frame == "ecef" else position_m[:, 2]

    def geodetic(self) -> NDArray[np.float64] | None:
        """Return latitude (deg), longitude (deg), height (m), (k, 3); None in a local frame."""
        return geodetic_from_ecef(self.position_m) if self.frame == "ecef" else None

    def height_m(self) -> NDArray[np.float64]:
        """Return the height above the ellipsoid, or z in a local frame; shape (k,), metres."""
        return self.height_of(self.position_m)

    def level_covariance_m2(self) -> NDArray[np.float64]:
        """Return position covariances in the axes of :meth:`level_axes`, shape (k, 3, 3)."""
        return turned_covariance(self.level_axes(), self.position_covariance_m2)

    def surprising_errors(self) -> tuple[ErrorState, ...]:
        """Return the sensor errors more than three prior sigmas from zero."""
        return tuple(error for error in self.errors if error.surprising)


def turned_covariance(
    axes: NDArray[np.float64], covariance: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return covariances in other axes, whose directions are rows: shape (..., m, m).

    Where the data do not determine a state its covariance may be infinite; turned, it is then
    infinite or not a number, without a warning.
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(axes @ covariance @ np.swapaxes(axes, -1, -2))
