"""Random problems of the batch engine, built by hand: any motion, frame, sensor and error."""

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from geograph.families import AltitudeFamily, BearingFamily, SpeedFamily, Values
from geograph.frames import SensorGeometry
from geograph.geodesy import ecef_from_geodetic, enu_axes
from geograph.measurements import Bearings
from geograph.motion import Density, Motion
from geograph.problem import PathPrior, Problem
from geograph.sensors import Sensor, SensorErrors, Trajectory
from geograph.states import SensorStates


@dataclass(frozen=True)
class Kind:
    """What a random problem has; lengths follow from the frame."""

    frame: str = "local"
    motion: str = "constant-velocity"
    along: bool = False
    per_axis: bool = False
    speed_m_s: float = np.inf
    enu: bool = True
    moving: bool = False
    biases: bool = True
    drifts: bool = True
    clocks: bool = True
    positions: bool = False
    walks: bool = False
    clock_walks: bool = False
    form: str = "isotropic"
    constraints: bool = False
    knots: int = 3
    position_noise: bool = False
    outside: bool = False
    body: bool = False
    radec: bool = False

    @property
    def length_m(self):
        """Distance of the object."""
        return 3e5 if self.frame == "ecef" else 300.0

    @property
    def object_m_s(self):
        return 7e3 if self.frame == "ecef" else 20.0


def random_problem(rng, kind, *, bearings=9, sensors=3):
    """Return a problem, with values anywhere near (residuals are large), and its sensors."""
    length, speed = kind.length_m, kind.object_m_s
    if kind.frame == "ecef":
        centre = ecef_from_geodetic(rng.uniform(-80, 80), rng.uniform(-180, 180), 0.0)
        up = enu_axes(centre)[2]
    else:
        centre, up = rng.normal(size=3) * 100.0, np.array([0.0, 0.0, 1.0])
    step = 10.0
    knots = np.cumsum(np.concatenate([[5.0], rng.uniform(0.7, 1.3, kind.knots - 1) * step]))
    if kind.motion == "static":
        knots = knots[:1]
    size = Motion(kind.motion, Density.of(1.0), kind.frame).order
    powers = np.repeat([length / 10, speed / 3, 0.1 * speed / step][:size], 3)
    path = rng.normal(size=(knots.size, 3 * size)) * powers
    path[:, :3] += centre + length * up
    if size > 1:
        path[:, 3:6] += rng.normal(size=3) * speed
    world = [
        _sensor(rng, kind, f"S{i}", centre + rng.normal(size=3) * length / 2, knots)
        for i in range(sensors)
    ]
    states = SensorStates(world, range(sensors), 3.0)
    scale = states.diffusion * np.sqrt(np.ptp(knots)) if knots.size > 1 else states.diffusion
    table = _table(rng, kind, knots, sensors, bearings)
    geometry = SensorGeometry(world, kind.frame, epoch=datetime(2024, 3, 20, tzinfo=UTC))
    family = BearingFamily(
        table,
        geometry=geometry,
        states=states,
        walk_scale=scale,
        speed_m_s=kind.speed_m_s,
        weight=rng.uniform(0.3, 1.0, bearings),
        position_noise_m=np.full(bearings, 1e-4 * length if kind.position_noise else 0.0),
    )
    families = [family]
    if kind.constraints:
        times = rng.uniform(knots[0], knots[-1], 3) if knots.size > 1 else np.full(3, knots[0])
        common = {"time_s": times, "line": np.zeros(3, dtype=np.int64), "frame": kind.frame}
        families.append(
            AltitudeFamily(
                value=rng.normal(size=3) * length, sigma=np.full(3, length / 10), **common
            )
        )
        if size > 1:
            families.append(
                SpeedFamily(value=np.full(3, speed), sigma=np.full(3, speed / 10), **common)
            )
    noise = (speed / 10) / step ** (size - 0.5) * 10.0
    density = Density.of((noise, 2 * noise, noise / 2) if kind.per_axis else noise)
    if kind.along:
        density = Density.of(noise, 5.0 * noise)
    problem = Problem(
        motion=Motion(kind.motion, density, kind.frame),
        knots_s=knots,
        families=families,
        states=states,
        walk_scale=scale,
        prior=PathPrior(path[0] + rng.normal(size=3 * size) * powers, 10.0 * powers),
        path_scale=powers / 100,
    )
    values = Values(
        path,
        rng.normal(size=(knots.size, states.diffusion.size)),
        rng.normal(size=states.size),
    )
    problem.refresh(values)
    return problem, values


def _sensor(rng, kind, name, position, knots):
    errors = SensorErrors(
        azimuth_bias_rad=0.02 * kind.biases,
        elevation_bias_rad=0.03 * kind.biases,
        azimuth_drift_rad_s=0.001 * kind.drifts,
        elevation_drift_rad_s=0.002 * kind.drifts,
        azimuth_instability_rad_sqrt_s=0.003 * kind.walks,
        elevation_instability_rad_sqrt_s=0.002 * kind.walks,
        clock_offset_s=0.02 * kind.clocks,
        clock_drift_s_s=1e-4 * (kind.clocks and kind.drifts),
        clock_instability_s_sqrt_s=0.002 * kind.clock_walks,
        position_m=0.01 * kind.length_m * kind.positions,
        misalignment_rad=0.05 * kind.body,
    )
    axes = "body" if kind.body else "enu" if kind.enu else "xyz"
    # The sky has a place in ECEF alone; other sensors stand beside those that measure against it.
    if kind.radec and kind.frame == "ecef" and not kind.body and name != "S1":
        axes = "radec"
    if not kind.moving:
        own = {"attitude_rad": rng.uniform(-np.pi, np.pi, 3)} if kind.body else {}
        return Sensor(name=name, position_m=position, axes=axes, errors=errors, **own)
    times = np.linspace(knots[0] - 40.0, knots[-1] + 40.0, 9)
    motion = position + np.outer(times - times.mean(), rng.normal(size=3)) * kind.object_m_s / 2
    bend = rng.normal(size=(9, 3)) * kind.object_m_s
    attitude = None
    if kind.body:
        # Through straight up and straight down, where yaw and roll are one.
        pitch = rng.choice([-1.0, 1.0]) * np.pi / 2 + 1e-3 * rng.normal(size=9)
        attitude = np.stack([0.3 * np.arange(9.0), pitch, rng.normal(size=9) * 0.2], axis=1)
    trajectory = Trajectory(times, motion + bend, attitude)
    return Sensor(name=name, trajectory=trajectory, axes=axes, errors=errors)


def _table(rng, kind, knots, sensors, bearings):
    if knots.size > 1:
        interval = rng.integers(0, knots.size - 1, bearings)
        share = rng.uniform(0.2, 0.8, bearings)
        time = knots[interval] + share * np.diff(knots)[interval]
        if kind.outside:
            time[0], time[1] = knots[0] - 1.5, knots[-1] + 1.7
    else:
        time = rng.uniform(0.0, 10.0, bearings)
    if np.isfinite(kind.speed_m_s):
        time = time + kind.length_m / kind.speed_m_s
    elevation = rng.uniform(-1.2, 1.2, bearings)
    isotropic = np.full(bearings, kind.form == "isotropic")
    if kind.form == "mixed":
        isotropic = rng.random(bearings) < 0.5
    if kind.form in ("azimuth", "mixed"):
        elevation[rng.random(bearings) < (1.0 if kind.form == "azimuth" else 0.3)] = np.nan
    sigma = rng.uniform(0.005, 0.02, (2, bearings))
    sigma[1] = np.where(isotropic, sigma[0], sigma[1])
    return Bearings(
        time_s=time,
        sensor=np.concatenate(
            [np.arange(sensors), rng.integers(0, sensors, bearings - sensors)]
        ).astype(np.int64),
        azimuth_rad=rng.uniform(-np.pi, np.pi, bearings),
        elevation_rad=elevation,
        sigma_azimuth_rad=sigma[0],
        sigma_elevation_rad=sigma[1],
        isotropic=isotropic,
        line=np.zeros(bearings, dtype=np.int64),
    )


def pack(values):
    """Return all unknowns as one vector."""
    return np.concatenate([values.path.ravel(), values.walks.ravel(), values.constants])


def unpack(vector, like):
    """Return the point that a vector describes."""
    a, b = like.path.size, like.walks.size
    return Values(
        vector[:a].reshape(like.path.shape),
        vector[a : a + b].reshape(like.walks.shape),
        vector[a + b :],
    )


def dense_jacobian(found, values):
    """Return the derivative of all residuals by all unknowns, from a family's evaluation."""
    count, rows = found.residual.shape
    knots, size = values.path.shape
    by_path = np.zeros((count, rows, knots, size))
    by_walks = np.zeros((count, rows, *values.walks.shape))
    by_constants = np.zeros((count, rows, values.constants.size))
    for n in range(count):
        k = found.interval[n]
        by_path[n, :, k] = found.by_knots[n, :, 0]
        if knots > 1:
            by_path[n, :, k + 1] = found.by_knots[n, :, 1]
    for n, column, value in zip(
        found.constant_row, found.constant_column, found.by_constants, strict=True
    ):
        by_constants[n, :, column] += value
    for n, column, before, after, value in zip(
        found.walk_row,
        found.walk_column,
        found.walk_before,
        found.walk_after,
        found.by_walks,
        strict=True,
    ):
        k = found.interval[n]
        by_walks[n, :, k, column] += before * value
        by_walks[n, :, k + 1, column] += after * value
    parts = [part.reshape(count * rows, -1) for part in (by_path, by_walks, by_constants)]
    return np.concatenate(parts, axis=1)
