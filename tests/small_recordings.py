"""Small recordings on disk, for end-to-end tests of the commands."""

from __future__ import annotations

import numpy as np

LOCAL = """format = 1
frame = "local"
propagation_speed_m_s = inf

[sensors.A]
position_m = [0.0, 0.0, 0.0]
axes = "xyz"
[sensors.A.errors]
azimuth_bias_deg = 0.05

[sensors.B]
position_m = [4000.0, 0.0, 0.0]
axes = "xyz"

[sensors.C]
position_m = [0.0, 4000.0, 50.0]
axes = "xyz"

[smooth]
motion = "constant-velocity"
process_noise = 1.0
loss = "none"
"""
PLACES = np.array([[0.0, 0.0, 0.0], [4000.0, 0.0, 0.0], [0.0, 4000.0, 50.0]])


def write_small(folder, *, seed=1, sigma_deg=0.01, sensors=3, truth=True):
    """Write a pass of an object at constant velocity over three fixed sensors; return the folder.

    Azimuth is atan2(dy, dx) and elevation atan2(dz, hypot(dx, dy)), with the given noise.
    """
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True)
    (folder / "recording.toml").write_text(LOCAL)
    rows = ["time_s,sensor,azimuth_deg,elevation_deg,sigma_deg"]
    start, velocity = np.array([1000.0, 1500.0, 800.0]), np.array([60.0, -20.0, 5.0])
    for time in np.arange(0.0, 10.0, 0.25):
        for name, place in list(zip("ABC", PLACES, strict=True))[:sensors]:
            x, y, z = start + velocity * time - place
            elevation = np.degrees(np.arctan2(z, np.hypot(x, y))) + sigma_deg * rng.normal()
            azimuth = np.degrees(np.arctan2(y, x))
            azimuth += sigma_deg * rng.normal() / np.cos(np.radians(elevation))
            rows.append(f"{time},{name},{azimuth:.9f},{elevation:.9f},{sigma_deg}")
    (folder / "bearings.csv").write_text("\n".join(rows) + "\n")
    if truth:
        known = [f"{t},{','.join(str(v) for v in start + velocity * t)}" for t in range(10)]
        (folder / "truth.csv").write_text("time_s,x_m,y_m,z_m\n" + "\n".join(known) + "\n")
    return folder
