"""What was really wrong with simulated sensors, as tables beside the recording.

``truth_sensors.csv`` has the errors of every sensor at each of its measurements,
``truth_calibrations.csv`` when these began anew. A recording's reader leaves both alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

ERRORS_FILE = "truth_sensors.csv"
CALIBRATIONS_FILE = "truth_calibrations.csv"


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorTruth:
    """True errors of sensors.

    Parameters
    ----------
    names
        Of the sensors.
    time_s
        Shape (n,): time tags of the measurements, seconds.
    sensor
        Shape (n,): index of the sensor of each.
    error
        Shape (n, 3): azimuth (rad), elevation (rad) and clock (s), without the noise; signed as in
        the recording.
    calibration_s
        For each sensor the times at which its errors of pointing began anew.
    """

    names: tuple[str, ...]
    time_s: NDArray[np.float64]
    sensor: NDArray[np.int64]
    error: NDArray[np.float64]
    calibration_s: tuple[NDArray[np.float64], ...]

    def files(self) -> dict[str, str]:
        """Return the text of the tables by the names of their files."""
        errors = ["time_s,sensor,azimuth_error_deg,elevation_error_deg,clock_error_s"]
        azimuth, elevation, clock = self.error.T
        columns = self.time_s, self.sensor, np.degrees(azimuth), np.degrees(elevation), clock
        errors += [
            f"{time!r},{self.names[sensor]},{azimuth!r},{elevation!r},{clock!r}"
            for time, sensor, azimuth, elevation, clock in zip(
                *(column.tolist() for column in columns), strict=True
            )
        ]
        resets = ["sensor,time_s"]
        resets += [
            f"{name},{time!r}"
            for name, times in zip(self.names, self.calibration_s, strict=True)
            for time in times.tolist()
        ]
        tables = {ERRORS_FILE: errors, CALIBRATIONS_FILE: resets}
        return {name: "\n".join(lines) + "\n" for name, lines in tables.items()}
