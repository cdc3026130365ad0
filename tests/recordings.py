"""Small recordings on disk for the tests of the readers."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

    from geograph.recording import Recording

HEADER = """\
format = 1
frame = "ecef"
epoch = 2021-02-28T21:54:00Z

[sensors.A]
geodetic = [51.5, -0.4, 78.0]
axes = "enu"
[sensors.A.errors]
azimuth_bias_deg = 0.01
clock_offset_s = 1.0

[sensors."B two"]
trajectory = "b.csv"
axes = "xyz"

[smooth]
motion = "constant-velocity"
process_noise = 10.0
"""

BEARINGS = """\
time_s,sensor,azimuth_deg,elevation_deg,sigma_deg
1.0,A,290.5,21.25,0.01
2.0,B two,-170.0,-5.0,0.02
3.0,A,291.5,20.25,0.01
"""

TRAJECTORY = """\
time_s,x_m,y_m,z_m
0.0,7000000.0,0.0,0.0
5.0,7000000.0,1000.0,0.0
10.0,7000000.0,2000.0,0.0
"""

TRUTH = """\
time_s,x_m,y_m,z_m
0.0,6500000.0,0.0,0.0
4.0,6500000.0,100.0,0.0
"""

CONSTRAINTS = """\
time_s,kind,value,sigma
,altitude_m,30000.0,100.0
2.0,speed_m_s,11000.0,50.0
"""

# Fixed C, and Plane, whose points are fixes, beside the sensors of HEADER; line numbers of HEADER
# stay what they are.
FULL_HEADER = (
    HEADER.replace("\n\n[sensors.A]", "\npropagation_sigma_m_s = 0.5\n[sensors.A]")
    + """
[sensors.C]
geodetic = [51.0, -1.5, 120.0]
[sensors.C.errors]
clock_offset_m = 3.0
frequency_offset_hz = 20.0

[sensors.Plane]
trajectory = "plane.csv"
platform_process_noise = 2.0
errors = { position_noise_m = 15.0 }
"""
)

ARRIVALS = """\
emission,sensor,toa_s,sigma_s
m7,A,1.0001,1e-07
m7,C,1.0002,2e-07
12,A,2.5,1e-07
m7,B two,1.00035,5e-07
12,Plane,2.5003,1e-07
"""

TIME_DIFFERENCES = """\
time_s,sensor,reference,tdoa_s,sigma_s,sigma_reference_s
3.0,A,C,0.00012,1.5e-07,1e-07
3.0,B two,C,-0.00034,2e-07,1e-07
4.0,C,A,-0.0001,1e-07,0.0
"""

FREQUENCY_DIFFERENCES = """\
time_s,sensor,reference,fdoa_hz,carrier_hz,sigma_hz,sigma_reference_hz
3.0,A,C,-120.5,1090000000.0,2.0,0.5
3.0,B two,C,40.25,1090000000.0,2.5,0.5
4.0,Plane,A,7.0,433920000.0,1.0,0.0
"""


def all_files() -> dict[str, str]:
    """Return the files of a recording that has every table and every kind of sensor, by name."""
    return valid_files() | {
        "recording.toml": FULL_HEADER,
        "plane.csv": TRAJECTORY,
        "arrivals.csv": ARRIVALS,
        "time_differences.csv": TIME_DIFFERENCES,
        "frequency_differences.csv": FREQUENCY_DIFFERENCES,
    }


def valid_files() -> dict[str, str]:
    """Return the files of a recording of bearings, by name."""
    return {
        "recording.toml": HEADER,
        "bearings.csv": BEARINGS,
        "b.csv": TRAJECTORY,
        "truth.csv": TRUTH,
        "constraints.csv": CONSTRAINTS,
    }


def write_files(folder: Path, files: dict[str, str] | dict[str, bytes]) -> Path:
    """Write files into a folder, made if absent, and return it."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        data = content if isinstance(content, bytes) else content.encode("utf-8")
        (folder / name).write_bytes(data)
    return folder


def assert_equal(one: Recording, other: Recording) -> None:
    """Assert that all but names of places and lines is the same to the last bit."""

    def compare(first: object, second: object, where: str) -> None:
        assert type(first) is type(second), where
        if isinstance(first, np.ndarray):
            np.testing.assert_array_equal(first, second, err_msg=where)
        elif dataclasses.is_dataclass(first):
            for entry in dataclasses.fields(first):
                if entry.name not in ("line", "path") and where + entry.name != "name":
                    ours, theirs = getattr(first, entry.name), getattr(second, entry.name)
                    compare(ours, theirs, f"{where}{entry.name}.")
        elif isinstance(first, dict):
            assert list(first) == list(second), where
            for key in first:
                compare(first[key], second[key], f"{where}{key}.")
        else:
            assert first == second, where

    compare(one, other, "")
