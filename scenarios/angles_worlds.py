"""Satellites, angles only: the worlds of Sprang (2015) and of Levy et al., in one place.

- R. Sprang, *Non-linear optimization applied to angle-of-arrival satellite-based geolocation with
  correlated measurements*, AFIT 2015: white noise and a bias that accumulates in an inertial unit
  until a random calibration resets it.
- Levy et al., *Non linear optimization applied to angle-of-arrival satellite based geo-localization
  for biased and time-drifting sensors*, ISPRS: bias, drift and instability of both angles,
  E(0) = B, E(i+1) = E(i) + N(D dt, (DI sqrt(dt))^2), with B uniform to 500 urad, D to 0.1 urad/s
  and DI to 0.1 urad/sqrt(s), drawn for each sensor and trial; 2 to 8 sensors, 200 to 800
  measurements of each.

In both, sensors on random circular and elliptic orbits see the object past the Earth throughout, at
uniformly random times of which no two coincide, and measure azimuth and elevation on the axes of
the Earth-fixed frame. The object is in low orbit (the simple path), or driven by random forces in
stages (the complicated one). We know both studies by their figures: heights of the orbits, length
of a pass, white noise, forces and the resolution of the accelerometer are our choices, stated here.
Two of them were changed after the graph's coverage had been seen: the resolution from 4 to
1.2 urad/s^2, and the white noise of Levy et al.'s worlds from 20 to 5 urad.
:data:`geograph.scenarios.angles_study.CHOICES` has both values, and docs/accuracy.md both figures.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from geograph.recording import SmoothSettings
from geograph.scenarios.accelerometer import Accelerometer, accumulate
from geograph.scenarios.kepler import random_elliptic_satellite
from geograph.scenarios.low_orbit import LowOrbit, random_low_path
from geograph.scenarios.places import draw_seeing
from geograph.scenarios.staged import Stages, random_staged_path
from geograph.scenarios.worlds import Noise, Station, Streams, World, make_world, truth_table
from geograph.sensors import SensorErrors

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.recording import Recording
    from geograph.scenarios.paths import Body
    from geograph.sensors import Sensor

PathKind = Literal["simple", "staged"]

_FREE_FALL_M = 1.0
"""What the process noise of the simple path's settings adds to its end: nothing that matters."""

_TRUTH_STEP_S = 2.0


@dataclass(frozen=True, kw_only=True)
class AnglesWorld:
    """A kind of trial.

    Parameters
    ----------
    name, source
        What it is called, and where it comes from.
    path
        ``"simple"``: free fall about the oblate Earth; ``"staged"``: random forces on top.
    stages
        The forces of the staged path.
    sensors, bearings
        Least and greatest number of sensors, and of measurements of each; uniformly random.
    busiest
        Share of all measurements that the first sensor makes; None: as it comes.
    duration_s
        Length of a pass.
    sigma_rad
        White noise of azimuth and of elevation.
    bias_rad, drift_rad_s, instability_rad_sqrt_s
        Limits between which the constants of each sensor and angle are uniform.
    accelerometer
        The unit that points each sensor; None: pointing is perfect but for the above.
    calibrations
        Least and greatest number of calibrations of each sensor in a pass, at random times: the
        bias, drift and random walk of both angles begin anew.
    jump_rad
        By how much the angles jump at a calibration, in a random direction; None: they are drawn
        again.
    calibrations_known
        Whether the recording tells when calibrations were, those of the accelerometer included.
    clock_offset_s
        Limit of the constant error of each sensor's time tags.
    outliers
        Gross errors of the first sensor, anywhere on the sphere.
    perigee_m, eccentricity
        Least and greatest of the sensors' orbits.
    windows
        Number of windows into which the published estimators cut the measurements.

    Raises
    ------
    ValueError
        If a range is empty or a trial has no pair of sensors.
    """

    name: str
    source: str
    path: PathKind
    stages: Stages = field(default_factory=Stages)
    sensors: tuple[int, int] = (2, 8)
    bearings: tuple[int, int] = (200, 800)
    busiest: float | None = None
    duration_s: float = 600.0
    sigma_rad: float = 5e-6
    bias_rad: float = 0.0
    drift_rad_s: float = 0.0
    instability_rad_sqrt_s: float = 0.0
    accelerometer: Accelerometer | None = None
    calibrations: tuple[int, int] = (0, 0)
    jump_rad: float | None = None
    calibrations_known: bool = True
    clock_offset_s: float = 0.0
    outliers: int = 0
    perigee_m: tuple[float, float] = (1000e3, 4000e3)
    eccentricity: tuple[float, float] = (0.0, 0.3)
    windows: int = 40

    def __post_init__(self) -> None:
        for what in ("sensors", "bearings", "calibrations", "perigee_m", "eccentricity"):
            low, high = getattr(self, what)
            if low > high:
                raise ValueError(f"{what} from {low} to {high}; expected the lower limit first")
        if self.sensors[0] < 2:
            raise ValueError(f"{self.sensors[0]} sensors; expected at least 2")

    def errors(self) -> SensorErrors:
        """Return the prior standard deviations: those of the uniform draws.

        What accumulates between known calibrations is told in :func:`between_calibrations`.
        """
        third = 1.0 / np.sqrt(3.0)
        walk = third * self.instability_rad_sqrt_s
        if self.accelerometer is not None and not self.calibrations_known:
            walk = float(np.hypot(walk, self._walk_of_unknown_age(self.accelerometer)))
        return SensorErrors(
            azimuth_bias_rad=third * self.bias_rad,
            elevation_bias_rad=third * self.bias_rad,
            azimuth_drift_rad_s=third * self.drift_rad_s,
            elevation_drift_rad_s=third * self.drift_rad_s,
            azimuth_instability_rad_sqrt_s=walk,
            elevation_instability_rad_sqrt_s=walk,
            clock_offset_s=third * self.clock_offset_s,
        )

    def _walk_of_unknown_age(self, unit: Accelerometer) -> float:
        """Return the diffusion of a random walk with the mean square of what accumulates."""
        mean, time = unit.calibration_s, np.linspace(0.0, self.duration_s, 2001)
        age = float(np.mean(mean * -np.expm1(-time / mean)))
        return unit.rms_rad(self.duration_s) / float(np.sqrt(age))

    @property
    def total_sigma_rad(self) -> float:
        """Standard deviation of one measured angle with everything that is wrong with it.

        What the published estimators, which have no states for the errors, take for the noise.
        """
        squares = [self.sigma_rad**2, self.bias_rad**2 / 3.0]
        squares.append((self.drift_rad_s * self.duration_s) ** 2 / 9.0)
        squares.append(self.instability_rad_sqrt_s**2 / 3.0 * self.duration_s / 2.0)
        if self.accelerometer is not None:
            squares.append(self.accelerometer.rms_rad(self.duration_s) ** 2)
        return float(np.sqrt(sum(squares)))

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time at which the path is known."""
        margin = 2.0 + 5.0 * self.clock_offset_s
        return -margin, self.duration_s + margin

    def settings(self) -> SmoothSettings:
        """Return how the recording asks to be smoothed."""
        loss: Literal["auto", "none"] = "auto" if self.outliers else "none"
        if self.path == "simple":
            noise = _FREE_FALL_M * float(np.sqrt(3.0 / self.duration_s**3))
            return SmoothSettings(motion="ballistic", process_noise=noise, loss=loss)
        noise = self.stages.jerk_density(self.duration_s)
        return SmoothSettings(motion="constant-acceleration", process_noise=noise, loss=loss)


_SPRANG = "Sprang (AFIT 2015)"
_LEVY = "Levy et al. (ISPRS)"
_SPRANG_ERRORS: dict[str, Any] = {
    "duration_s": 60.0,
    "sigma_rad": 100e-6,
    "accelerometer": Accelerometer(resolution_rad_s2=1.2e-6),
    "windows": 80,
}
_RECALIBRATED = "after Levy et al. (ISPRS), with calibrations"
_LEVY_ERRORS: dict[str, Any] = {
    "sigma_rad": 5e-6,
    "bias_rad": 500e-6,
    "drift_rad_s": 0.1e-6,
    "instability_rad_sqrt_s": 0.1e-6,
}
_HARD = Stages(count=4, thrust_m_s2=30.0, flutter_m_s2=3.0, flutter_step_s=5.0)

WORLDS: dict[str, AnglesWorld] = {
    world.name: world
    for world in (
        AnglesWorld(name="sprang-simple", source=_SPRANG, path="simple", **_SPRANG_ERRORS),
        AnglesWorld(
            name="sprang-staged", source=_SPRANG, path="staged", stages=_HARD, **_SPRANG_ERRORS
        ),
        AnglesWorld(name="levy-simple", source=_LEVY, path="simple", **_LEVY_ERRORS),
        AnglesWorld(name="levy-staged", source=_LEVY, path="staged", **_LEVY_ERRORS),
    )
}
"""The published worlds, by name."""

CALIBRATED: dict[str, AnglesWorld] = {
    world.name: world
    for world in (
        replace(
            WORLDS[f"levy-{path}"],
            name=f"levy-{path}-calibrated",
            source=_RECALIBRATED,
            calibrations=(0, 3),
            calibrations_known=False,
        )
        for path in ("simple", "staged")
    )
}
"""Those of Levy et al. with calibrations at random times that the recording does not tell."""


def variant(name: str, **changes: Any) -> AnglesWorld:
    """Return one of the worlds with other parameters.

    Parameters
    ----------
    name
        Of :data:`WORLDS` or :data:`CALIBRATED`.
    **changes
        Fields of :class:`AnglesWorld`.
    """
    return replace((WORLDS | CALIBRATED)[name], **changes)


def angles_trial(seed: int, world: AnglesWorld) -> World:
    """Simulate one trial; the same seed and world give the same trial, bit for bit.

    Parameters
    ----------
    seed
        A whole number of at least 0.
    world
        What the trial is like.

    Raises
    ------
    RuntimeError
        If no path stays up or no sensor sees it.
    """
    streams = Streams.from_seed(seed)
    path = _path(streams.path, world)
    count = int(streams.sensors.integers(world.sensors[0], world.sensors[1], endpoint=True))
    margin = world.span_s[0] + 1.0
    stations = [_station(streams, path, world, index=index) for index in range(count)]
    made = make_world(
        name=f"{world.name}-{seed}",
        path=path,
        stations=stations,
        times_s=_times(streams.times, world, count),
        noise=Noise(sigma_rad=world.sigma_rad, per_coordinate=True, outliers=world.outliers),
        streams=streams,
        settings=world.settings(),
        truth=truth_table(path, (margin, world.duration_s - margin), step_s=_TRUTH_STEP_S),
        draw="uniform",
    )
    if world.accelerometer is None or not world.calibrations_known:
        return made
    calibrations = [
        np.empty(0) if station.accumulated is None else station.accumulated.calibration_s
        for station in stations
    ]
    known = between_calibrations(made.recording, calibrations, world.accelerometer)
    return replace(made, recording=known)


def between_calibrations(
    recording: Recording, calibration_s: Sequence[NDArray[np.float64]], unit: Accelerometer
) -> Recording:
    """Return a recording that knows when its sensors were calibrated.

    Each stretch between two calibrations becomes a sensor of its own, on the same orbit. What it
    accumulated stands as a constant with the mean square over the stretch, q^2 L^3 / 12 for a
    stretch of the length L, as the prior of both of its biases.

    Parameters
    ----------
    recording
        With sensors ``S1``, ...; those of the result are ``S1.1``, ``S1.2``, ...
    calibration_s
        For each sensor the times of its calibrations, seconds.
    unit
        What pointed them.
    """
    bearings = recording.bearings
    if bearings is None:
        raise ValueError(f"recording {recording.name!r} has no bearings")
    first, last = recording.time_span_s
    sensors: dict[str, Sensor] = {}
    index = np.empty_like(bearings.sensor)
    for old, (sensor, times) in enumerate(
        zip(recording.sensors.values(), calibration_s, strict=True)
    ):
        edges = np.concatenate([[first], times[(times > first) & (times < last)], [last]])
        rows = np.flatnonzero(bearings.sensor == old)
        stretch = np.clip(np.searchsorted(edges, bearings.time_s[rows], side="right") - 1, 0, None)
        stretch = np.minimum(stretch, edges.size - 2)
        for number in np.unique(stretch):
            length = float(edges[number + 1] - edges[number])
            walk = unit.density * float(np.sqrt(length**2 / 6.0))
            name = f"{sensor.name}.{number + 1}"
            index[rows[stretch == number]] = len(sensors)
            sensors[name] = replace(
                sensor,
                name=name,
                errors=replace(
                    sensor.errors,
                    azimuth_instability_rad_sqrt_s=walk,
                    elevation_instability_rad_sqrt_s=walk,
                ),
            )
    return replace(recording, sensors=sensors, bearings=replace(bearings, sensor=index))


def angles_recording(seed: int, name: str, **changes: Any) -> Recording:
    """Return the recording of one trial of a published world, with other parameters if wanted."""
    return angles_trial(seed, variant(name, **changes)).recording


def _path(rng: np.random.Generator, world: AnglesWorld) -> Body:
    if world.path == "staged":
        return random_staged_path(rng, world.stages, world.span_s).body
    kind = LowOrbit(path="j2", duration_s=world.duration_s, clock_offset_s=world.clock_offset_s)
    return random_low_path(rng, kind)


def _station(streams: Streams, path: Body, world: AnglesWorld, *, index: int) -> Station:
    rng = streams.sensors

    def draw() -> Body:
        return random_elliptic_satellite(
            rng, perigee_m=world.perigee_m, eccentricity=world.eccentricity
        )

    unit = world.accelerometer
    times = np.empty(0)
    if world.calibrations[1] > 0:
        count = int(streams.calibrations.integers(*world.calibrations, endpoint=True))
        times = np.sort(streams.calibrations.uniform(0.0, world.duration_s, count))
    return Station(
        name=f"S{index + 1}",
        body=draw_seeing(draw, path, world.duration_s, axes="xyz"),
        axes="xyz",
        errors=world.errors(),
        accumulated=None if unit is None else accumulate(streams.walks, unit, world.span_s),
        calibration_s=times,
        jump_rad=world.jump_rad,
        # Those of an accelerometer are stretches of their own where they are known.
        calibrations_known=world.calibrations_known,
    )


def _times(rng: np.random.Generator, world: AnglesWorld, sensors: int) -> list[NDArray[np.float64]]:
    """Return sorted times of every sensor, uniform over the pass."""
    low, high = world.bearings
    counts = rng.integers(low, high, sensors, endpoint=True)
    if world.busiest is not None:
        total = int(counts.sum())
        rest = max(int((1.0 - world.busiest) * total / (sensors - 1)), 1)
        counts = np.array([total - rest * (sensors - 1), *[rest] * (sensors - 1)])
    return [np.sort(rng.uniform(0.0, world.duration_s, int(count))) for count in counts]
