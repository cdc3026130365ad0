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


SIGNALS = """format = 1
frame = "local"
propagation_speed_m_s = {speed}

[sensors.A]
position_m = [0.0, 0.0, 0.0]

[sensors.B]
position_m = [4000.0, 0.0, 300.0]

[sensors.C]
position_m = [0.0, 4000.0, 50.0]

[sensors.D]
position_m = [4000.0, 4000.0, 900.0]

[sensors.E]
position_m = [2000.0, 1800.0, -400.0]

[smooth]
motion = "constant-velocity"
process_noise = 1.0
loss = "none"
"""
SIGNAL_PLACES = np.array(
    [
        [0.0, 0.0, 0.0],
        [4000.0, 0.0, 300.0],
        [0.0, 4000.0, 50.0],
        [4000.0, 4000.0, 900.0],
        [2000.0, 1800.0, -400.0],
    ]
)


def write_signals(
    folder,
    *,
    tables=("arrivals", "time_differences", "frequency_differences"),
    seed=1,
    speed_m_s=299792458.0,
    sigma_m=1.0,
    sigma_m_s=0.1,
    carrier_hz=1e9,
    errors="",
    truth=True,
):
    """Write a pass of a signalling object at constant velocity over five fixed sensors.

    It emits four times a second, at t_e; a sensor at s receives it at t_e + |p(t_e) - s| / c and at
    the frequency f c / (c + v.u), u the direction from the sensor to the object. Every time and
    frequency that a sensor measures has its own noise, so that differences share that of the
    reference, A. Noise is given in metres and metres per second, and is that over ``speed_m_s``.

    Parameters
    ----------
    folder
        Made here.
    tables
        Which tables to write.
    errors
        More of the header: tables of sensors' errors.

    Returns
    -------
    pathlib.Path
        The folder.
    """
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True)
    (folder / "recording.toml").write_text(SIGNALS.format(speed=speed_m_s) + errors)
    start, velocity = np.array([1000.0, 1500.0, 800.0]), np.array([60.0, -20.0, 5.0])
    sigma_s, sigma_hz = sigma_m / speed_m_s, sigma_m_s / speed_m_s * carrier_hz
    rows = {
        "arrivals": ["emission,sensor,toa_s,sigma_s"],
        "time_differences": ["time_s,sensor,reference,tdoa_s,sigma_s,sigma_reference_s"],
        "frequency_differences": [
            "time_s,sensor,reference,fdoa_hz,carrier_hz,sigma_hz,sigma_reference_hz"
        ],
    }
    for number, time in enumerate(np.arange(0.0, 10.0, 0.25)):
        away = start + velocity * time - SIGNAL_PLACES
        distance = np.linalg.norm(away, axis=1)
        exact = time + distance / speed_m_s
        closing = away @ velocity / distance
        # Noise of the arrivals and of the differences is drawn apart: tables are independent.
        toa, other = exact + sigma_s * rng.normal(size=(2, 5))
        shift = -carrier_hz * closing / (speed_m_s + closing) + sigma_hz * rng.normal(size=5)
        tag = repr(float(exact[0]))
        for index, name in enumerate("ABCDE"):
            rows["arrivals"].append(f"{number},{name},{float(toa[index])!r},{sigma_s!r}")
            if index:
                tdoa, fdoa = float(other[index] - other[0]), float(shift[index] - shift[0])
                rows["time_differences"].append(
                    f"{tag},{name},A,{tdoa!r},{2**0.5 * sigma_s!r},{sigma_s!r}"
                )
                rows["frequency_differences"].append(
                    f"{tag},{name},A,{fdoa!r},{carrier_hz!r},{2**0.5 * sigma_hz!r},{sigma_hz!r}"
                )
    for table in tables:
        (folder / f"{table}.csv").write_text("\n".join(rows[table]) + "\n")
    if truth:
        known = [f"{t},{','.join(str(v) for v in start + velocity * t)}" for t in range(10)]
        (folder / "truth.csv").write_text("time_s,x_m,y_m,z_m\n" + "\n".join(known) + "\n")
    return folder
