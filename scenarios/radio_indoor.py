"""Indoor radio: a tag whose short pulses are timed by anchors on the walls of a hall."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.recording import SmoothSettings
from geograph.scenarios.radio import Altitude, RadioWorld, fixed_receivers, make_radio_world
from geograph.scenarios.radio_paths import random_flight
from geograph.scenarios.radio_plans import ArrivalPlan
from geograph.scenarios.worlds import Streams, truth_table
from geograph.sensors import SensorErrors

if TYPE_CHECKING:
    from geograph.recording import Recording

_ANCHORS_M = (
    (0.0, 0.0, 2.8),
    (30.0, 0.0, 0.4),
    (30.0, 15.0, 2.9),
    (0.0, 15.0, 0.3),
    (15.0, 0.0, 5.5),
    (15.0, 15.0, 0.2),
    (0.0, 7.5, 5.8),
    (30.0, 7.5, 5.0),
)
_MARGIN_S = 1.0


@dataclass(frozen=True, kw_only=True)
class Indoor:
    """A kind of walk through a hall of 30 m by 15 m (local frame).

    Parameters
    ----------
    flat
        The tag stays at a known height of 1 m, instead of moving in all directions.
    anchors
        Number of anchors, 3 to 8.
    pulses
        Number of pulses, spread evenly.
    duration_s
        Length of the walk.
    sigma_s
        White noise of an arrival time.
    clock_offset_s, clock_drift_s_s, clock_instability_s_sqrt_s
        Standard deviations of the errors of all clocks but that of the first anchor.
    position_m
        Standard deviation of the error of an anchor's recorded position, per axis.
    hearing
        Probability that an anchor hears a pulse.
    outliers, outlier_s
        Number of gross errors and their size; the settings' loss is then ``"auto"``.
    process_noise
        Square root of the spectral density of the tag's acceleration, m/s^1.5.

    Raises
    ------
    ValueError
        If the number of anchors is out of range.
    """

    flat: bool = False
    anchors: int = 8
    pulses: int = 80
    duration_s: float = 8.0
    sigma_s: float = 0.3e-9
    clock_offset_s: float = 0.5e-9
    clock_drift_s_s: float = 0.0
    clock_instability_s_sqrt_s: float = 0.0
    position_m: float = 0.0
    hearing: float = 1.0
    outliers: int = 0
    outlier_s: float = 2e-8
    process_noise: float = 0.5

    def __post_init__(self) -> None:
        if not 3 <= self.anchors <= len(_ANCHORS_M):
            raise ValueError(f"{self.anchors} anchors; expected 3 to {len(_ANCHORS_M)}")

    def errors(self, index: int) -> SensorErrors:
        """Return the prior standard deviations of one anchor's errors."""
        loose = 0.0 if index == 0 else 1.0
        return SensorErrors(
            clock_offset_s=loose * self.clock_offset_s,
            clock_drift_s_s=loose * self.clock_drift_s_s,
            clock_instability_s_sqrt_s=loose * self.clock_instability_s_sqrt_s,
            position_m=self.position_m,
        )


def indoor_world(seed: int, kind: Indoor | None = None) -> RadioWorld:
    """Simulate one walk; the same seed and kind give the same world, bit for bit.

    Parameters
    ----------
    seed
        A whole number of at least 0.
    kind
        What the walk is like; None: :class:`Indoor` as it stands.
    """
    kind = Indoor() if kind is None else kind
    streams = Streams.from_seed(seed)
    heading = streams.path.uniform(0.0, 2.0 * np.pi)
    velocity = np.array([np.cos(heading), np.sin(heading), 0.0])
    height = 1.0 if kind.flat else streams.path.uniform(1.0, 3.0)
    start = np.array([15.0, 7.5, height]) - (0.5 * kind.duration_s + _MARGIN_S) * velocity
    # The vertical goes with a tenth of the noise, or, on the floor, with none.
    up = 0.0 if kind.flat else 0.1 * kind.process_noise
    span = (-_MARGIN_S, kind.duration_s + _MARGIN_S)
    path = random_flight(
        streams.path,
        np.stack([start, velocity]),
        span,
        noise=(kind.process_noise, kind.process_noise, up),
        tolerance_m=1e-4,
        longest_step_s=0.05,
    )
    return make_radio_world(
        name=f"indoor-{seed}",
        path=path,
        receivers=fixed_receivers(
            [np.array(place) for place in _ANCHORS_M[: kind.anchors]],
            [kind.errors(index) for index in range(kind.anchors)],
            prefix="A",
        ),
        plans=[
            ArrivalPlan(
                emission_time_s=np.linspace(0.0, kind.duration_s, kind.pulses),
                receivers=tuple(range(kind.anchors)),
                sigma_s=kind.sigma_s,
                hearing=kind.hearing,
                outliers=kind.outliers,
                outlier_s=kind.outlier_s,
            )
        ],
        streams=streams,
        settings=SmoothSettings(
            motion="constant-velocity",
            process_noise=(kind.process_noise, kind.process_noise, max(up, 1e-4)),
            loss="auto" if kind.outliers else "none",
        ),
        truth=truth_table(path, span, step_s=0.05),
        frame="local",
        altitude=Altitude(sigma_m=1e-2, value_m=1.0) if kind.flat else None,
    )


def indoor(seed: int, **options: Any) -> Recording:
    """Return the recording of one walk; see :class:`Indoor`."""
    return indoor_world(seed, Indoor(**options)).recording
