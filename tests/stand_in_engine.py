"""A stand-in for the incremental smoother: cheap, exact, and a function of its rows alone.

It locates an object at rest from bearings, by least squares over lines of sight, and takes other
measurements without using them. Rows in any order and in any batches give the same to the last bit,
so that a feed can be judged by what it gave to its engine. An update succeeds or changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from geograph.errors import InputError
from geograph.measurements import Bearings

POISON_SIGMA_DEG = 13.0
"""A bearing of this sigma makes the engine raise in the middle of its work."""


@dataclass(frozen=True)
class StandInEstimate:
    time_s: float | None
    state: Any
    covariance: Any
    status: str
    message: str
    frame: str = "local"
    sensor_errors: dict[str, Any] = field(default_factory=dict)
    used: int = 0
    waiting: tuple[Any, ...] = ()
    rejected: tuple[Any, ...] = ()
    late: tuple[Any, ...] = ()
    rejected_count: int = 0
    late_count: int = 0
    duplicate_count: int = 0
    rebuilt: int = 0


class StandInEngine:
    def __init__(self, recording):
        self._sensors = list(recording.sensors.values())
        self._errors = {
            name: {"azimuth_bias": SimpleNamespace(estimate=0.0, sigma=1.0, prior_sigma=2.0)}
            for name in recording.sensors
        }
        self.rows = []
        self.updates = 0
        self.estimate = self._estimate()

    def update(self, measurements):
        before = list(self.rows)
        try:
            for table in measurements:
                self._take(table)
            self.estimate = self._estimate()
        except BaseException:
            self.rows = before
            raise
        self.updates += 1
        return self.estimate

    def finish(self):
        return self.estimate

    def _take(self, table):
        if not isinstance(table, Bearings):
            self.rows += [(float(t), type(table).__name__) for t in table.time_s]
            return
        columns = (table.time_s, table.sensor, table.azimuth_rad, table.elevation_rad)
        for *row, sigma in zip(*columns, table.sigma_azimuth_rad, strict=True):
            if abs(np.degrees(sigma) - POISON_SIGMA_DEG) < 1e-9:
                raise ZeroDivisionError("an exception inside a factor")
            if row[3] > np.radians(89.0):
                raise InputError("the direction is straight up, which is not determined")
            self.rows.append(tuple(float(value) for value in (*row, sigma)))

    def _estimate(self):
        bearings = sorted(row for row in self.rows if len(row) == 5)
        if len(bearings) < 2:
            return StandInEstimate(None, None, None, "collecting", "two bearings are needed")
        information, vector = np.zeros((3, 3)), np.zeros(3)
        for time, sensor, azimuth, elevation, sigma in bearings:
            flat = np.cos(elevation)
            line = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
            across = (np.eye(3) - np.outer(line, line)) / (1000.0 * sigma) ** 2
            information += across
            vector += across @ self._sensors[int(sensor)].position_at(time)
        covariance = np.linalg.inv(information)
        return StandInEstimate(
            bearings[-1][0],
            covariance @ vector,
            covariance,
            "tracking",
            "",
            used=len(self.rows),
            sensor_errors=self._errors,
        )
