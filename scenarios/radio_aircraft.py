"""Wide-area multilateration: the signals of an aircraft, timed by receivers on the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from geograph.recording import SmoothSettings
from geograph.scenarios.paths import SampledBody
from geograph.scenarios.places import displaced, ecef
from geograph.scenarios.radio import Altitude, RadioWorld, fixed_receivers, make_radio_world
from geograph.scenarios.radio_paths import Leg, earth_fixed, flight_of_legs, random_flight
from geograph.scenarios.radio_plans import ArrivalPlan
from geograph.scenarios.worlds import Streams, truth_table
from geograph.sensors import SensorErrors

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.recording import Recording

AircraftPath = Literal["prior", "straight", "turns", "climb"]

_MARGIN_S = 2.0


@dataclass(frozen=True, kw_only=True)
class Multilateration:
    """A kind of flight over receivers on the ground (ECEF).

    Parameters
    ----------
    path
        ``"prior"``: white noise on the jerk; ``"straight"``: level at constant speed; ``"turns"``:
        level with turns of 3 and 1.5 degrees a second; ``"climb"``: straight with changes of climb.
    receivers
        Number of receivers, all around at 20 to 120 km.
    emissions
        Number of emissions, at random times.
    duration_s
        Length of the flight.
    sigma_s
        White noise of an arrival time.
    clock_offset_s, clock_drift_s_s, clock_instability_s_sqrt_s
        Standard deviations of the errors of all clocks but that of the first receiver.
    position_m
        Standard deviation of the error of a receiver's recorded position, per axis.
    hearing, fewest
        Probability that a receiver hears an emission; how many must.
    outliers, outlier_s
        Number of gross errors and their size; the settings' loss is then ``"auto"``.
    altitude_sigma_m
        Standard deviation of the aircraft's reported altitude; None: it reports none.
    process_noise
        Square root of the spectral density of the jerk, m/s^2.5: that of the path ``"prior"``, and
        in the settings of all.

    Raises
    ------
    ValueError
        If the path is unknown.
    """

    path: AircraftPath = "prior"
    receivers: int = 6
    emissions: int = 60
    duration_s: float = 120.0
    sigma_s: float = 50e-9
    clock_offset_s: float = 100e-9
    clock_drift_s_s: float = 0.0
    clock_instability_s_sqrt_s: float = 0.0
    position_m: float = 0.0
    hearing: float = 0.9
    fewest: int = 2
    outliers: int = 0
    outlier_s: float = 1e-5
    altitude_sigma_m: float | None = 20.0
    process_noise: float = 0.1

    def __post_init__(self) -> None:
        if self.path not in get_args(AircraftPath):
            raise ValueError(
                f"path {self.path!r}; expected one of {', '.join(get_args(AircraftPath))}"
            )

    def errors(self, index: int) -> SensorErrors:
        """Return the prior standard deviations of one receiver's errors."""
        loose = 0.0 if index == 0 else 1.0
        return SensorErrors(
            clock_offset_s=loose * self.clock_offset_s,
            clock_drift_s_s=loose * self.clock_drift_s_s,
            clock_instability_s_sqrt_s=loose * self.clock_instability_s_sqrt_s,
            position_m=self.position_m,
        )

    @property
    def legs(self) -> tuple[Leg, ...]:
        """Parts of the flight where it is not random; the last goes on beyond its end."""
        part = self.duration_s / 6.0
        beyond = part + 2.0 * _MARGIN_S
        if self.path == "turns":
            return (
                Leg(duration_s=2.0 * part),
                Leg(duration_s=part, turn_deg_s=3.0),
                Leg(duration_s=part),
                Leg(duration_s=part, turn_deg_s=-1.5),
                Leg(duration_s=beyond),
            )
        if self.path == "climb":
            return (
                Leg(duration_s=2.0 * part),
                Leg(duration_s=2.0 * part, climb_m_s=12.0),
                Leg(duration_s=part, climb_m_s=-8.0),
                Leg(duration_s=beyond),
            )
        return (Leg(duration_s=5.0 * part + beyond),)


def multilateration_world(seed: int, kind: Multilateration | None = None) -> RadioWorld:
    """Simulate one flight; the same seed and kind give the same world, bit for bit.

    Parameters
    ----------
    seed
        A whole number of at least 0.
    kind
        What the flight is like; None: :class:`Multilateration` as it stands.
    """
    kind = Multilateration() if kind is None else kind
    streams = Streams.from_seed(seed)
    latitude, longitude = streams.sensors.uniform(-55.0, 55.0), streams.sensors.uniform(-180, 180)
    path = _path(streams.path, kind, (latitude, longitude))
    receivers = fixed_receivers(
        _places(streams.sensors, kind.receivers, (latitude, longitude)),
        [kind.errors(index) for index in range(kind.receivers)],
    )
    times = np.sort(streams.times.uniform(0.0, kind.duration_s, kind.emissions))
    return make_radio_world(
        name=f"multilateration-{seed}",
        path=path,
        receivers=receivers,
        plans=[
            ArrivalPlan(
                emission_time_s=times,
                receivers=tuple(range(kind.receivers)),
                sigma_s=kind.sigma_s,
                hearing=kind.hearing,
                fewest=kind.fewest,
                outliers=kind.outliers,
                outlier_s=kind.outlier_s,
            )
        ],
        streams=streams,
        settings=SmoothSettings(
            motion="constant-acceleration",
            process_noise=kind.process_noise,
            loss="auto" if kind.outliers else "none",
        ),
        truth=truth_table(path, (-_MARGIN_S, kind.duration_s + _MARGIN_S), step_s=0.2),
        altitude=None
        if kind.altitude_sigma_m is None
        else Altitude(sigma_m=kind.altitude_sigma_m, count=kind.emissions),
    )


def multilateration(seed: int, **options: Any) -> Recording:
    """Return the recording of one flight; see :class:`Multilateration`."""
    return multilateration_world(seed, Multilateration(**options)).recording


def _path(
    rng: np.random.Generator, kind: Multilateration, centre_deg: tuple[float, float]
) -> SampledBody:
    origin = ecef(*centre_deg, rng.uniform(8e3, 12e3))
    heading, speed = rng.uniform(0.0, 360.0), rng.uniform(180.0, 260.0)
    # Through the middle of the receivers half-way, if it flies straight.
    late = -0.5 * kind.duration_s
    legs, state = flight_of_legs(
        kind.legs, start_s=-_MARGIN_S, speed_m_s=speed, heading_deg=heading
    )
    state[:, 0] += late * state[0, 1]
    if kind.path != "prior":
        return SampledBody(legs, earth_fixed(origin, state))
    initial = np.concatenate([earth_fixed(origin, state[:1])[0], np.zeros((1, 3))])
    return random_flight(
        rng,
        initial,
        (-_MARGIN_S, kind.duration_s + _MARGIN_S),
        noise=kind.process_noise,
        tolerance_m=1e-2,
    )


def _places(
    rng: np.random.Generator, count: int, centre_deg: tuple[float, float]
) -> list[NDArray[np.float64]]:
    """Return receivers all around a place: one in each of equal sectors."""
    turn = rng.uniform(0.0, 360.0)
    places = []
    for index in range(count):
        azimuth = turn + (index + rng.uniform(-0.3, 0.3)) * 360.0 / count
        distance = rng.uniform(20e3, 120e3)
        latitude, longitude = displaced(*centre_deg, azimuth_deg=azimuth, distance_m=distance)
        places.append(ecef(latitude, longitude, rng.uniform(0.0, 800.0)))
    return places
