"""Small recordings on disk for the tests of the readers."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

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


def valid_files() -> dict[str, str]:
    """Return the files of a recording that has everything, by name."""
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
