"""A recording: sensors, what they measured, and how it should be smoothed.

This module is the data alone. ``geograph.io`` reads and writes it (docs/format.md).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.errors import InputError
from geograph.stages import check_stages

if TYPE_CHECKING:
    from datetime import datetime
    from pathlib import Path

    from geograph.measurements import (
        Arrivals,
        Bearings,
        Constraints,
        FrequencyDifferences,
        Measurements,
        TimeDifferences,
        Truth,
    )
    from geograph.sensors import Sensor
    from geograph.terrain import Terrain

Frame = Literal["ecef", "local"]
HeightDatum = Literal["ellipsoid", "geoid"]
"""What heights of a terrain are above."""
MotionName = Literal[
    "static",
    "constant-position",
    "constant-velocity",
    "constant-acceleration",
    "ballistic",
    "orbital",
]
EliminationName = Literal["structured", "gtsam"]
AccelerationAxes = Literal["rtn", "inertial"]
"""Axes of an unknown acceleration (:data:`geograph.factors.forces.ForceAxes`)."""
NO_FORCES: dict[str, Any] = {
    "moon": False,
    "sun": False,
    "drag_m2_kg": None,
    "drag_sigma_m2_kg": None,
    "acceleration_sigma_m_s2": None,
}
"""Settings of a path on which nothing acts beside gravity."""
LossName = Literal["auto", "none", "huber", "cauchy", "geman-mcclure", "gnc"]


@dataclass(frozen=True, kw_only=True)
class SmoothSettings:
    """How a recording is smoothed; every value has a default that needs no thought.

    Parameters
    ----------
    motion
        Motion model of the path between knots.
    process_noise
        Square root of the spectral density of the white noise that drives the motion, SI: on
        velocity (m/s^0.5) for constant-position, on acceleration (m/s^1.5) for constant-velocity,
        ballistic and orbital, on jerk (m/s^2.5) for constant-acceleration. ``"auto"``: the value of
        greatest marginal likelihood, and a second one along the velocity where the evidence asks
        for it. Three numbers: one for each axis of the frame.
    process_noise_along
        The same along the velocity; ``process_noise`` is then that across it. None: isotropic,
        unless ``process_noise`` is ``"auto"``.
    stages
        Pieces of time in which the noise differs, by the same multiple in all directions. None: it
        does not. ``"auto"``: they are found, and with them how many there are (docs/models.md); a
        ``process_noise`` that is given is then where the search begins.
        Or pairs (from_s, times) in the order of time: from then on the noise is so many times
        ``process_noise``; before the first it is ``process_noise``.
    spacing_s
        Time between knots; None: chosen from the noise (docs/models.md).
    loss
        Loss of each measurement. ``"auto"``, or ``"gnc"``, is plain least squares unless gross
        outliers show, which are then rejected by graduated non-convexity.
    max_iterations
        Limit of Levenberg-Marquardt iterations in one solve.
    moon, sun
        Whether they pull on a satellite (motion ``orbital``, as all that follow).
    drag_m2_kg
        Drag coefficient times area over mass; None: no drag.
    drag_sigma_m2_kg
        Its prior sigma: it is estimated. None: it is known.
    acceleration_sigma_m_s2
        Prior sigma of each component of an unknown constant acceleration, which is estimated.
        None: there is none.
    acceleration_axes
        Along which it is constant: ``"rtn"`` (radial, transverse, normal) or ``"inertial"`` (the
        axes of ECEF at time zero, kept at rest).
    elimination
        Who factorises the linear systems: ``"structured"`` (our own, exact for any process noise),
        or ``"gtsam"`` for GTSAM's general elimination of the same blocks. Not in recordings.

    Raises
    ------
    InputError
        If a name is unknown or a number out of range.
    """

    motion: MotionName = "constant-acceleration"
    process_noise: float | tuple[float, float, float] | Literal["auto"] = "auto"
    process_noise_along: float | None = None
    stages: tuple[tuple[float, float], ...] | Literal["auto"] | None = None
    spacing_s: float | None = None
    loss: LossName = "auto"
    max_iterations: int = 500
    moon: bool = False
    sun: bool = False
    drag_m2_kg: float | None = None
    drag_sigma_m2_kg: float | None = None
    acceleration_sigma_m_s2: float | None = None
    acceleration_axes: AccelerationAxes = "rtn"
    elimination: EliminationName = "structured"

    def __post_init__(self) -> None:
        if self.motion not in get_args(MotionName):
            raise InputError(
                f"unknown motion {self.motion!r}; expected one of "
                + ", ".join(get_args(MotionName)),
                column="motion",
            )
        if self.loss not in get_args(LossName):
            raise InputError(
                f"unknown loss {self.loss!r}; expected one of " + ", ".join(get_args(LossName)),
                column="loss",
            )
        if self.elimination not in get_args(EliminationName):
            raise InputError(
                f"unknown elimination {self.elimination!r}; expected structured or gtsam",
                column="elimination",
            )
        self._check_noise()
        check_stages(self.stages)
        if self.stages is not None and self.stages != "auto":
            pairs = tuple((float(start), float(times)) for start, times in self.stages)
            object.__setattr__(self, "stages", pairs)
        self._check_forces()
        if self.spacing_s is not None and not _positive(self.spacing_s):
            raise InputError(
                f"spacing_s is {self.spacing_s}; expected a finite number above 0 (seconds)",
                column="spacing_s",
            )
        if self.max_iterations < 1:
            raise InputError(
                f"max_iterations is {self.max_iterations}; expected at least 1",
                column="max_iterations",
            )

    def _check_noise(self) -> None:
        noise = self.process_noise
        if isinstance(noise, tuple):
            if len(noise) != 3 or not all(_positive(value) for value in noise):
                raise InputError(
                    f"process_noise is {noise}; expected one or three finite numbers above 0",
                    column="process_noise",
                )
        elif noise != "auto" and not _positive(noise):
            raise InputError(
                f"process_noise is {noise!r}; expected a finite number above 0, or auto",
                column="process_noise",
            )
        along = self.process_noise_along
        if along is None:
            return
        if not _positive(along):
            raise InputError(
                f"process_noise_along is {along}; expected a finite number above 0",
                column="process_noise_along",
            )
        if not isinstance(noise, (int, float)) or self.motion in ("static", "constant-position"):
            raise InputError(
                "process_noise_along needs one number as process_noise (the noise across the "
                "velocity; auto finds both) and a motion that has a velocity",
                column="process_noise_along",
            )

    @property
    def forces(self) -> tuple[str, ...]:
        """Names of the settings that ask for a force beside gravity."""
        return tuple(name for name in NO_FORCES if getattr(self, name) not in (False, None))

    def _check_forces(self) -> None:
        for name in NO_FORCES:
            value = getattr(self, name)
            if name in ("moon", "sun"):
                if not isinstance(value, bool):
                    raise InputError(f"{name} is {value!r}; expected true or false", column=name)
            elif value is not None and not _positive(value):
                raise InputError(
                    f"{name} is {value!r}; expected a finite number above 0", column=name
                )
        if self.acceleration_axes not in get_args(AccelerationAxes):
            raise InputError(
                f"unknown acceleration_axes {self.acceleration_axes!r}; expected rtn or inertial",
                column="acceleration_axes",
            )
        if self.forces and self.motion != "orbital":
            raise InputError(
                f"{self.forces[0]} needs the motion orbital; given {self.motion}",
                column=self.forces[0],
            )

    def replace(self, **changes: Any) -> SmoothSettings:
        """Return a copy with some values changed; see the class for names, values and errors."""
        names = {entry.name for entry in dataclasses.fields(self)}
        for name in changes:
            if name not in names:
                raise InputError(
                    f"unknown setting {name!r}; expected one of " + ", ".join(sorted(names)),
                    column=name,
                )
        if changes.get("process_noise") == "auto":
            # Found along the velocity as well.
            changes = {"process_noise_along": None} | changes
        return dataclasses.replace(self, **changes)


def _positive(value: object) -> bool:
    return (
        isinstance(value, (int, float, np.floating, np.integer))
        and not isinstance(value, bool)
        and bool(np.isfinite(value))
        and bool(value > 0)
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class Recording:
    """Measurements of one object by imperfect sensors.

    Parameters
    ----------
    name
        What the recording is called in messages and results.
    frame
        ``"ecef"`` (WGS 84) or ``"local"`` (fixed Cartesian axes).
    sensors
        By name; their order is that of the sensor indices in the tables.
    bearings, arrivals, time_differences, frequency_differences, constraints, truth
        The tables, each None where the recording has none.
    epoch
        UTC instant of ``time_s = 0``; None only in a local frame.
    propagation_speed_m_s
        Speed of the signal in metres per second; ``inf`` ignores the light time.
    propagation_sigma_m_s
        Prior standard deviation of that speed, which is then estimated; zero: known.
    settings
        The recording's own defaults for the smoother.
    path
        Where it was read from, if it was.
    terrain
        The ground, for heights above it.

    Raises
    ------
    InputError
        If the frame is unknown, the speed is not positive or its sigma negative, or a table names
        a sensor out of range, or a sensor as its own reference; or if heights above terrain are
        given without one, or the terrain is of the other frame.
    """

    name: str
    frame: Frame
    sensors: dict[str, Sensor]
    bearings: Bearings | None = None
    arrivals: Arrivals | None = None
    time_differences: TimeDifferences | None = None
    frequency_differences: FrequencyDifferences | None = None
    constraints: Constraints | None = None
    truth: Truth | None = None
    epoch: datetime | None = None
    propagation_speed_m_s: float = SPEED_OF_LIGHT_M_S
    propagation_sigma_m_s: float = 0.0
    settings: SmoothSettings = field(default_factory=SmoothSettings)
    path: Path | None = None
    terrain: Terrain | None = None

    def __post_init__(self) -> None:
        if self.frame not in get_args(Frame):
            raise InputError(
                f"unknown frame {self.frame!r}; expected ecef or local", column="frame"
            )
        if not self.propagation_speed_m_s > 0.0:
            raise InputError(
                f"propagation_speed_m_s is {self.propagation_speed_m_s}; expected above 0 or inf",
                column="propagation_speed_m_s",
            )
        sigma = self.propagation_sigma_m_s
        if not (np.isfinite(sigma) and sigma >= 0.0):
            raise InputError(
                f"propagation_sigma_m_s is {sigma}; expected a finite number of at least 0",
                column="propagation_sigma_m_s",
            )
        for name, table in self.tables.items():
            self._check_sensors(name, table)
        kinds = () if self.constraints is None else self.constraints.kind
        if "height_above_terrain_m" in kinds and self.terrain is None:
            raise InputError(
                "a constraint is of height_above_terrain_m, and there is no terrain; expected one "
                "(terrain in recording.toml)",
                column="terrain",
            )
        if self.terrain is not None and self.terrain.frame != self.frame:
            raise InputError(
                f"terrain is in the frame {self.terrain.frame} and the recording in {self.frame}; "
                "expected one frame",
                column="terrain",
            )

    def _check_sensors(self, name: str, table: Measurements) -> None:
        for column in ("sensor", "reference"):
            index = getattr(table, column, None)
            if index is None or not len(index):
                continue
            low, high = int(index.min()), int(index.max())
            if low < 0 or high >= len(self.sensors):
                raise InputError(
                    f"{name} have {column} {low} to {high}; "
                    f"expected indices from 0 to {len(self.sensors) - 1}"
                )
            if column == "reference" and (index == table.sensor).any():
                row = int(np.argmax(index == table.sensor))
                raise InputError(
                    f"row {row} of the {name} has sensor {self.sensor_names[index[row]]!r} as its "
                    "own reference; expected two different sensors"
                )

    @property
    def tables(self) -> dict[str, Measurements]:
        """The tables that hold measurements, by their names in the recording format."""
        named: dict[str, Measurements | None] = {
            "bearings": self.bearings,
            "arrivals": self.arrivals,
            "time_differences": self.time_differences,
            "frequency_differences": self.frequency_differences,
        }
        return {name: table for name, table in named.items() if table is not None and len(table)}

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Names of the sensors in the order of their indices."""
        return tuple(self.sensors)

    @property
    def time_span_s(self) -> tuple[float, float]:
        """First and last time tag of the measurements, seconds; raises InputError if none."""
        times = [table.time_s for table in self.tables.values()]
        if not times:
            raise InputError(f"recording {self.name!r} has no measurement", path=self.path)
        return min(float(t.min()) for t in times), max(float(t.max()) for t in times)
