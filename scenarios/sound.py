"""A source of sound that walks through a hall, heard by arrays on the walls.

Sound takes a good part of a second across the hall, in which the source moves much farther than
the bearings are wrong: a smoother that leaves out the light time is found out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.recording import SmoothSettings
from geograph.scenarios.paths import SampledBody, StraightBody, fine_grid, sample_path
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
    from geograph.recording import MotionName, Recording

SPEED_OF_SOUND_M_S = 343.0
"""In dry air at 20 degrees Celsius (ISO 9613-1)."""

_MOTIONS: dict[int, MotionName] = {
    1: "constant-position",
    2: "constant-velocity",
    3: "constant-acceleration",
}
_NOISE: dict[int, tuple[float, float, float]] = {
    1: (0.5, 0.5, 0.1),
    2: (1.0, 1.0, 0.2),
    3: (0.2, 0.2, 0.04),
}
_PLACES = ((0.0, 0.0, 4.0), (80.0, 0.0, 1.0), (80.0, 50.0, 5.0), (0.0, 50.0, 2.0), (40.0, 0.0, 6.0))
_MARGIN_S = 2.0


@dataclass(frozen=True, kw_only=True)
class Room:
    """A kind of walk through a hall of 80 m by 50 m (local frame, axes ``xyz``).

    Parameters
    ----------
    order
        How many times white noise is integrated to make the path: 1, 2 or 3.
    process_noise
        Square root of its spectral density along x, y and z, SI; None: one that suits the order.
    sensors, bearings
        Number of arrays (2 to 5), and of bearings of each.
    sigma_rad
        White noise of azimuth and of elevation.
    bias_rad
        Standard deviation of the bias of azimuth and of elevation.
    clock_offset_s
        Standard deviation of the clock offset of all arrays but the first.
    speed_m_s
        Speed of the source at the start.
    propagation_speed_m_s
        Speed of the signal.
    duration_s
        Length of the walk.

    Raises
    ------
    ValueError
        If the order or the number of arrays is out of range.
    """

    order: int = 2
    process_noise: tuple[float, float, float] | None = None
    sensors: int = 4
    bearings: int = 150
    sigma_rad: float = 5e-3
    bias_rad: float = 5e-3
    clock_offset_s: float = 0.0
    speed_m_s: float = 5.0
    propagation_speed_m_s: float = SPEED_OF_SOUND_M_S
    duration_s: float = 8.0

    def __post_init__(self) -> None:
        if self.order not in _MOTIONS:
            raise ValueError(f"order {self.order}; expected 1, 2 or 3")
        if not 2 <= self.sensors <= len(_PLACES):
            raise ValueError(f"{self.sensors} sensors; expected 2 to {len(_PLACES)}")

    @property
    def noise(self) -> tuple[float, float, float]:
        """Square root of the spectral density of the path's noise along x, y and z, SI."""
        return _NOISE[self.order] if self.process_noise is None else self.process_noise

    def errors(self, index: int) -> SensorErrors:
        """Return the prior standard deviations of one array's errors."""
        return SensorErrors(
            azimuth_bias_rad=self.bias_rad,
            elevation_bias_rad=self.bias_rad,
            clock_offset_s=0.0 if index == 0 else self.clock_offset_s,
        )


def room_world(seed: int, kind: Room | None = None) -> World:
    """Simulate one walk; the same seed and kind give the same world, bit for bit.

    Parameters
    ----------
    seed
        A whole number of at least 0.
    kind
        What the walk is like; None: :class:`Room` as it stands.
    """
    kind = Room() if kind is None else kind
    streams = Streams.from_seed(seed)
    heading = streams.path.uniform(0.0, 2.0 * np.pi)
    initial = np.zeros((kind.order, 3))
    initial[0] = [40.0, 25.0, 1.5]
    if kind.order > 1:
        initial[1] = kind.speed_m_s * np.array([np.cos(heading), np.sin(heading), 0.0])
    margin = _MARGIN_S + 5.0 * kind.clock_offset_s
    grid = fine_grid(
        (-margin, kind.duration_s + margin),
        order=kind.order,
        noise=max(kind.noise),
        # A thousandth of what one bearing sees, or, for a path without velocity, a twentieth.
        tolerance_m=1e-2 if kind.order == 1 else 1e-4,
        longest_step_s=0.05,
    )
    state = sample_path(streams.path, grid, initial, noise=kind.noise)
    path = SampledBody(grid, state)
    stations = [
        Station(
            name=f"M{index + 1}",
            body=StraightBody(np.array(_PLACES[index])),
            axes="xyz",
            errors=kind.errors(index),
        )
        for index in range(kind.sensors)
    ]
    return make_world(
        name=f"room-{seed}",
        path=path,
        stations=stations,
        times_s=uniform_times(streams.times, kind.sensors, kind.bearings, kind.duration_s),
        noise=Noise(sigma_rad=kind.sigma_rad, per_coordinate=True),
        streams=streams,
        settings=SmoothSettings(motion=_MOTIONS[kind.order], process_noise=kind.noise, loss="none"),
        truth=truth_table(
            path,
            (-margin, kind.duration_s + margin),
            step_s=0.02,
            velocity=kind.order > 1,
        ),
        frame="local",
        propagation_speed_m_s=kind.propagation_speed_m_s,
    )


def room(seed: int, **options: Any) -> Recording:
    """Return the recording of one simulated walk; see :func:`room_world` and :class:`Room`."""
    return room_world(seed, Room(**options)).recording
