"""Geometries from which an object can not be located, or not in one place only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.recording import SmoothSettings
from geograph.scenarios.paths import StraightBody
from geograph.scenarios.radio import Altitude, RadioWorld, fixed_receivers, make_radio_world
from geograph.scenarios.radio_plans import ArrivalPlan
from geograph.scenarios.worlds import Streams, truth_table
from geograph.sensors import SensorErrors

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.recording import Recording

Degenerate = Literal[
    "two-receivers",
    "two-arrivals",
    "collinear",
    "collinear-flat",
    "three-flat",
    "among",
    "at-a-receiver",
    "one-set",
]


@dataclass(frozen=True, eq=False)
class _Case:
    """Receivers and an emitter that stands, in metres."""

    receivers_m: tuple[tuple[float, float, float], ...]
    emitter_m: tuple[float, float, float]
    flat: bool = False
    most: int | None = None
    emissions: int = 20


_SQUARE = ((0.0, 0.0, 0.0), (4e3, 0.0, 300.0), (4e3, 4e3, 50.0), (0.0, 4e3, 500.0), (2e3, -2e3, 0))
_CASES: dict[Degenerate, _Case] = {
    # Two receivers, whatever they hear, know one hyperboloid.
    "two-receivers": _Case(_SQUARE[:2], (1e3, 7e3, 900.0)),
    # Every emission is heard by two of five, never the same for long: enough together.
    "two-arrivals": _Case(_SQUARE, (1e3, 7e3, 900.0), most=2, emissions=60),
    # In space all places on a circle about the line are as good; in a plane two.
    "collinear": _Case(tuple((x, 0.0, 0.0) for x in (0.0, 1e3, 3e3, 4e3)), (1e3, 5e3, 800.0)),
    "collinear-flat": _Case(
        tuple((x, 0.0, 0.0) for x in (0.0, 1e3, 3e3, 4e3)), (1e3, 5e3, 0.0), flat=True
    ),
    # Two branches of hyperbolas that meet twice: see other_root.
    "three-flat": _Case(
        ((0.0, 0.0, 0.0), (4e3, 0.0, 0.0), (0.0, 4e3, 0.0)), (-500.0, -600.0, 0.0), flat=True
    ),
    "among": _Case(_SQUARE, (2e3, 1.5e3, 100.0)),
    "at-a-receiver": _Case(_SQUARE, (4e3, 4e3, 50.0)),
    "one-set": _Case(_SQUARE, (1e3, 2.5e3, 900.0), emissions=1),
}

DEGENERATE: tuple[Degenerate, ...] = tuple(_CASES)
"""The names of all cases."""


def degenerate_world(case: Degenerate, seed: int = 0, *, sigma_s: float = 10e-9) -> RadioWorld:
    """Simulate an emitter that stands, in a local frame, heard in a degenerate geometry.

    Parameters
    ----------
    case
        One of :data:`DEGENERATE`. Two receivers for all; two arrivals per set; all receivers on a
        line, in space and in a plane; three receivers in a plane, whose hyperbolas meet twice; an
        emitter among the receivers, and one in the very place of a receiver; a single set.
    seed
        A whole number of at least 0.
    sigma_s
        White noise of an arrival time.

    Raises
    ------
    ValueError
        If the case is unknown.
    """
    if case not in _CASES:
        raise ValueError(f"case {case!r}; expected one of {', '.join(DEGENERATE)}")
    own = _CASES[case]
    streams = Streams.from_seed(seed)
    path = StraightBody(np.array(own.emitter_m))
    count = len(own.receivers_m)
    return make_radio_world(
        name=f"{case}-{seed}",
        path=path,
        receivers=fixed_receivers(
            [np.array(place, dtype=np.float64) for place in own.receivers_m],
            [SensorErrors()] * count,
        ),
        plans=[
            ArrivalPlan(
                emission_time_s=np.arange(float(own.emissions)),
                receivers=tuple(range(count)),
                sigma_s=sigma_s,
                most=own.most,
            )
        ],
        streams=streams,
        settings=SmoothSettings(motion="static", loss="none"),
        truth=truth_table(path, (-1.0, own.emissions + 1.0), step_s=1.0),
        frame="local",
        altitude=Altitude(sigma_m=0.1) if own.flat else None,
    )


def degenerate(case: Degenerate, seed: int = 0) -> Recording:
    """Return the recording of a degenerate geometry; see :func:`degenerate_world`."""
    return degenerate_world(case, seed).recording


def other_root(near_m: tuple[float, float] = (1e3, 1e3)) -> tuple[float, float]:
    """Return where else the hyperbolas of ``"three-flat"`` meet, x and y in metres.

    Parameters
    ----------
    near_m
        Where to start looking.

    Raises
    ------
    RuntimeError
        If there is nothing there but the emitter itself.
    """
    from scipy.optimize import fsolve

    case = _CASES["three-flat"]
    places, emitter = np.array(case.receivers_m)[:, :2], np.array(case.emitter_m[:2])
    measured = np.diff(np.linalg.norm(emitter - places, axis=1))

    def miss(place: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.diff(np.linalg.norm(place - places, axis=1)) - measured)

    found, _, success, _ = fsolve(miss, near_m, full_output=True)
    if success != 1 or np.linalg.norm(found - emitter) < 1.0:
        raise RuntimeError(f"no other root near {near_m}")
    return float(found[0]), float(found[1])
