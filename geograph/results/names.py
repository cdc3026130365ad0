"""Names of the files and columns of a results folder."""

from __future__ import annotations

TRACK, SENSORS, RESIDUALS, SUMMARY = "track.csv", "sensors.csv", "residuals.csv", "summary.json"
PLACES, CURVES, TRUTH = "sensor_positions.csv", "sensor_errors.csv", "truth.csv"
PLATFORMS = "platforms.csv"
TABLES = frozenset({TRACK, SENSORS, RESIDUALS, SUMMARY, PLACES, CURVES, TRUTH, PLATFORMS})
PICTURES = (
    "overview.png",
    "path.png",
    "height.png",
    "speed.png",
    "residuals.png",
    "sensor_errors.png",
)
"""Pictures of every result; without a velocity none of it, and none of a height that is given."""

LIKELIHOOD_PICTURE = "likelihood.png"
"""Picture of the posterior of an emitter at rest, where it is no ellipse."""

PLATFORM_PICTURE = "platforms.png"
"""Picture of the platforms whose path is estimated, where there are any."""

POSITION = ("x_m", "y_m", "z_m")
VELOCITY = ("vx_m_s", "vy_m_s", "vz_m_s")
ACCELERATION = ("ax_m_s2", "ay_m_s2", "az_m_s2")
COVARIANCE = {
    "cov_xx_m2": (0, 0),
    "cov_xy_m2": (0, 1),
    "cov_xz_m2": (0, 2),
    "cov_yy_m2": (1, 1),
    "cov_yz_m2": (1, 2),
    "cov_zz_m2": (2, 2),
}
_STATE = ("x", "y", "z", "vx", "vy", "vz")
MOTION_COVARIANCE = {
    f"cov_{_STATE[row]}_{_STATE[column]}_{'m2_s' if row < 3 else 'm2_s2'}": (row, column)
    for row in range(6)
    for column in range(max(row, 3), 6)
}
"""Covariances of velocity, with the position and with itself."""

GEODETIC = ("latitude_deg", "longitude_deg", "height_m")
SEMI_AXES = ("semi_major_m", "semi_middle_m", "semi_minor_m")
SPEED = ("speed_m_s", "sigma_speed_m_s")
