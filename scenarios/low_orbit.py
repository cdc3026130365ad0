"""Passes in low orbit, seen by imperfect satellites or from the ground.

The world of Levy et al., *Non linear optimization applied to angle-of-arrival satellite based
geo-localization for biased and time-drifting sensors* (ISPRS): sensors with a bias, a drift and a
random walk in both angles, non-coincident uniformly random measurement times, line of sight
throughout. Azimuth and elevation of a satellite are on the axes of the recording.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from geograph.constants import EARTH_GM_M3_S2, EARTH_RADIUS_M
from geograph.recording import SmoothSettings
from geograph.scenarios.orbits import (
    EarthFixedBody,
    free_fall,
    sample_perturbed_fall,
)
from geograph.scenarios.paths import SampledBody, fine_grid, sample_path
from geograph.scenarios.places import (
    draw_seeing,
    random_axes,
    random_ground_station,
    random_satellite,
)
from geograph.scenarios.worlds import (
    Noise,
    Station,
    Streams,
    World,
    make_world,
    truth_table,
    uniform_times,
)
from geograph.sensors import SensorErrors

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.recording import Recording
    from geograph.scenarios.observation import SeenAxes
    from geograph.scenarios.paths import Body
    from geograph.scenarios.sensor_errors import Draw

PathKind = Literal["prior", "prior-ballistic", "two-body", "j2"]
Platform = Literal["satellite", "ground", "mixed"]

_DEFAULT_NOISE: dict[PathKind, float] = {
    "prior": 0.1,
    "prior-ballistic": 0.1,
    "two-body": 0.1,
    "j2": 1e-3,
}
_LOWEST_M = 200e3
_MOST_PATHS = 100
_TRUTH_STEP_S = 0.5


@dataclass(frozen=True, kw_only=True)
class LowOrbit:
    """A kind of pass in low orbit.

    Parameters
    ----------
    path
        How the object moves, see :func:`random_low_path`. The settings are those of the prior that
        the path comes from: constant acceleration for ``"prior"``, ballistic for the others. The
        ballistic model knows the Earth's oblateness, so that its default noise for ``"two-body"``
        is that which covers its absence (0.01 m/s^2 for 200 s).
    platform
        Where the sensors are: on satellites (axes ``xyz``), on the ground (``enu``), or in turn.
    sensors, bearings
        Number of sensors, and of bearings of each.
    sigma_rad
        White noise of a bearing: of each of two components on the sky.
    bias_rad, drift_rad_s, instability_rad_sqrt_s
        Standard deviations of the errors of azimuth and of elevation; with ``draw="uniform"`` the
        limits between which they are drawn (their prior is then the limit / sqrt(3)).
    clock_offset_s, clock_drift_s_s
        The same of the clocks that write the time tags.
    duration_s
        Length of the pass.
    process_noise, process_noise_along
        Square root of the spectral density of the noise that the path is drawn with and that the
        settings name; None: one that suits the path.
    draw
        How the sensors' errors are drawn.
    correlation
        Correlation of the noise of one sensor.
    per_coordinate
        Whether the noise is that of azimuth and elevation instead of isotropic on the sky.
    outliers
        Number of gross errors of the first sensor; the settings' loss is then ``"auto"``.
    outlier_rad
        How far off they are; None: anywhere on the sphere.

    Raises
    ------
    ValueError
        If the path or the platform is unknown.
    """

    path: PathKind = "prior"
    platform: Platform = "satellite"
    sensors: int = 5
    bearings: int = 300
    sigma_rad: float = 50e-6
    bias_rad: float = 500e-6
    drift_rad_s: float = 0.1e-6
    instability_rad_sqrt_s: float = 0.1e-6
    clock_offset_s: float = 0.0
    clock_drift_s_s: float = 0.0
    duration_s: float = 200.0
    process_noise: float | None = None
    process_noise_along: float | None = None
    draw: Draw = "normal"
    correlation: float = 0.0
    per_coordinate: bool = False
    outliers: int = 0
    outlier_rad: float | None = None

    def __post_init__(self) -> None:
        if self.path not in get_args(PathKind):
            raise ValueError(f"path {self.path!r}; expected one of {get_args(PathKind)}")
        if self.platform not in get_args(Platform):
            raise ValueError(f"platform {self.platform!r}; expected one of {get_args(Platform)}")

    @property
    def noise(self) -> float:
        """Square root of the spectral density of the path's noise, SI."""
        return _DEFAULT_NOISE[self.path] if self.process_noise is None else self.process_noise

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time at which the path is known."""
        margin = 2.0 + 5.0 * self.clock_offset_s
        return -margin, self.duration_s + margin

    def settings(self) -> SmoothSettings:
        """Return the settings with which the path was drawn."""
        return SmoothSettings(
            motion="constant-acceleration" if self.path == "prior" else "ballistic",
            process_noise=self.noise,
            process_noise_along=self.process_noise_along,
            loss="auto" if self.outliers else "none",
        )

    def errors(self) -> SensorErrors:
        """Return the prior standard deviations of each sensor's errors."""
        scale = 1.0 if self.draw == "normal" else 1.0 / np.sqrt(3.0)
        return SensorErrors(
            azimuth_bias_rad=scale * self.bias_rad,
            elevation_bias_rad=scale * self.bias_rad,
            azimuth_drift_rad_s=scale * self.drift_rad_s,
            elevation_drift_rad_s=scale * self.drift_rad_s,
            azimuth_instability_rad_sqrt_s=scale * self.instability_rad_sqrt_s,
            elevation_instability_rad_sqrt_s=scale * self.instability_rad_sqrt_s,
            clock_offset_s=scale * self.clock_offset_s,
            clock_drift_s_s=scale * self.clock_drift_s_s,
        )


def low_orbit_world(seed: int, kind: LowOrbit | None = None) -> World:
    """Simulate one pass; the same seed and kind give the same world, bit for bit.

    Parameters
    ----------
    seed
        A whole number of at least 0. The path depends on the seed, the length of the pass and the
        path's own options alone, so that worlds that differ in the sensors share it.
    kind
        What the pass is like; None: :class:`LowOrbit` as it stands.

    Raises
    ------
    RuntimeError
        If no path stays up or no sensor sees it.
    """
    kind = LowOrbit() if kind is None else kind
    streams = Streams.from_seed(seed)
    path = random_low_path(streams.path, kind)
    stations = [_station(streams.sensors, path, kind, index=index) for index in range(kind.sensors)]
    truth_margin = kind.span_s[0] + 1.0
    return make_world(
        name=f"low-orbit-{kind.path}-{seed}",
        path=path,
        stations=stations,
        times_s=uniform_times(streams.times, kind.sensors, kind.bearings, kind.duration_s),
        noise=Noise(
            sigma_rad=kind.sigma_rad,
            per_coordinate=kind.per_coordinate,
            outliers=kind.outliers,
            outlier_rad=kind.outlier_rad,
        ),
        streams=streams,
        settings=kind.settings(),
        truth=truth_table(
            path, (truth_margin, kind.duration_s - truth_margin), step_s=_TRUTH_STEP_S
        ),
        draw=kind.draw,
    )


def low_orbit_pass(seed: int, **options: Any) -> Recording:
    """Return the recording of one simulated pass.

    Parameters
    ----------
    seed
        As in :func:`low_orbit_world`.
    **options
        As in :class:`LowOrbit`.
    """
    return low_orbit_world(seed, LowOrbit(**options)).recording


def random_low_path(rng: np.random.Generator, kind: LowOrbit) -> Body:
    """Draw the path of an object in low orbit, in ECEF axes.

    It starts 500 to 1000 km high in any plane, at up to 1 % from circular speed. ``"two-body"`` and
    ``"j2"`` then fall freely; ``"prior-ballistic"`` falls around an oblate Earth under white noise
    on the acceleration; ``"prior"`` has the acceleration of free fall at its start, relative to
    the turning Earth, and nothing but white noise on the jerk from then on: an object that thrusts.

    Raises
    ------
    RuntimeError
        If none of many paths stays 200 km high.
    """
    for _ in range(_MOST_PATHS):
        first, second = random_axes(rng)
        radius = EARTH_RADIUS_M + rng.uniform(500e3, 1000e3)
        speed = np.sqrt(EARTH_GM_M3_S2 / radius) * (1.0 + rng.uniform(-0.01, 0.01))
        path = _disturbed(rng, np.stack([radius * first, speed * second]), kind)
        time = np.linspace(*kind.span_s, 41)
        if np.linalg.norm(path.position_at(time), axis=-1).min() > EARTH_RADIUS_M + _LOWEST_M:
            return path
    raise RuntimeError(f"none of {_MOST_PATHS} paths stays up; expected a lower process_noise")


def _disturbed(rng: np.random.Generator, initial: NDArray[np.float64], kind: LowOrbit) -> Body:
    """Return the path that a kind of pass makes of an inertial state at its first time."""
    start, end = kind.span_s
    if kind.path in ("two-body", "j2"):
        return EarthFixedBody(free_fall(initial, (start, end), j2=kind.path == "j2"))
    grid = fine_grid(
        (start, end),
        order=3 if kind.path == "prior" else 2,
        noise=max(kind.noise, kind.process_noise_along or 0.0),
    )
    if kind.path == "prior-ballistic":
        state = sample_perturbed_fall(
            rng, grid, initial, noise=kind.noise, along=kind.process_noise_along
        )
        return EarthFixedBody(SampledBody(grid, state))
    nominal = EarthFixedBody(free_fall(initial, (start, start + 2.0), j2=True, step_s=0.5))
    velocity = nominal.velocity_at(np.array([start, start + 1.0, start + 2.0]))
    # One-sided difference of the second order: an acceleration to about 1e-5 m/s^2, which is all
    # that a nominal start has to be.
    acceleration = -1.5 * velocity[0] + 2.0 * velocity[1] - 0.5 * velocity[2]
    state = np.stack([nominal.position_at(start), velocity[0], acceleration])
    return SampledBody(
        grid,
        sample_path(rng, grid, state, noise=kind.noise, along=kind.process_noise_along),
    )


def _station(rng: np.random.Generator, path: Body, kind: LowOrbit, *, index: int) -> Station:
    ground = kind.platform == "ground" or (kind.platform == "mixed" and index % 2 == 1)
    axes: SeenAxes = "enu" if ground else "xyz"

    def draw() -> Body:
        if ground:
            return random_ground_station(rng, path, kind.duration_s, farthest_m=800e3)
        return random_satellite(rng)

    return Station(
        name=f"{'G' if ground else 'S'}{index + 1}",
        body=draw_seeing(draw, path, kind.duration_s, axes=axes),
        axes=axes,
        errors=kind.errors(),
        correlation=kind.correlation,
    )
