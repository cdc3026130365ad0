"""Paths of aircraft, ships and walkers for the radio worlds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.scenarios.observation import ecef_from_east_north_up
from geograph.scenarios.paths import SampledBody, fine_grid, sample_path

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.scenarios.paths import Noise


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A part of a flight with one rate of turn and one rate of climb.

    Parameters
    ----------
    duration_s
        How long it takes.
    turn_deg_s
        Rate of turn, to the right.
    climb_m_s
        Rate of climb.
    """

    duration_s: float
    turn_deg_s: float = 0.0
    climb_m_s: float = 0.0


def flight_of_legs(
    legs: Sequence[Leg], *, start_s: float, speed_m_s: float, heading_deg: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return times, shape (m,), and states east, north and up, shape (m, 2, 3), of a flight.

    Turns are arcs of circles, exactly; the cubics between the nodes, a tenth of a second apart,
    leave them by less than 1 um for an aircraft.

    Parameters
    ----------
    legs
        In order.
    start_s
        When the first begins, at the origin.
    speed_m_s
        Speed over ground.
    heading_deg
        Heading at the start, from north to east.
    """
    times: list[NDArray[np.float64]] = []
    states: list[NDArray[np.float64]] = []
    begin, place, heading = start_s, np.zeros(3), np.radians(heading_deg)
    for leg in legs:
        nodes = max(int(np.ceil(leg.duration_s / 0.1)), 1)
        elapsed = np.linspace(0.0, leg.duration_s, nodes + 1)
        turn = np.radians(leg.turn_deg_s) * elapsed
        # The chord of the arc, in the direction half-way through the turn.
        chord = speed_m_s * elapsed * np.sinc(turn / (2.0 * np.pi))
        middle, now = heading + turn / 2.0, heading + turn
        climbed = np.full_like(elapsed, leg.climb_m_s)
        position = place + np.stack(
            [chord * np.sin(middle), chord * np.cos(middle), climbed * elapsed], axis=-1
        )
        velocity = np.stack([speed_m_s * np.sin(now), speed_m_s * np.cos(now), climbed], axis=-1)
        state = np.stack([position, velocity], axis=1)
        # A change of climb is spread over the first step of the new leg.
        first = 0 if not states else 1
        states.append(state[first:])
        times.append(begin + elapsed[first:])
        begin += leg.duration_s
        place, heading = position[-1], float(now[-1])
    return np.concatenate(times), np.concatenate(states)


def earth_fixed(
    origin_ecef_m: NDArray[np.float64], state: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return states, shape (m, n, 3), of east, north and up at an origin, in ECEF axes.

    The first row of each state is a position from the origin, the others are vectors.
    """
    axes = np.stack([ecef_from_east_north_up(origin_ecef_m, unit) for unit in np.eye(3)])
    turned = state @ axes
    turned[:, 0] += origin_ecef_m
    return np.asarray(turned)


def random_flight(
    rng: np.random.Generator,
    initial: NDArray[np.float64],
    span_s: tuple[float, float],
    *,
    noise: Noise,
    tolerance_m: float,
    longest_step_s: float = 0.5,
) -> SampledBody:
    """Return a body driven by white noise on the last row of its state.

    Parameters
    ----------
    rng
        Source of randomness.
    initial
        Shape (n, 3): state at the first time.
    span_s
        First and last time, seconds.
    noise
        Square root of the spectral density, SI: one for all axes, or one for each.
    tolerance_m
        How far the path between the nodes may stray from a random one (standard deviation).
    longest_step_s
        Limit of the step between nodes, seconds.
    """
    grid = fine_grid(
        span_s,
        order=initial.shape[0],
        noise=float(np.max(noise)),
        tolerance_m=tolerance_m,
        longest_step_s=longest_step_s,
    )
    return SampledBody(grid, sample_path(rng, grid, initial, noise=noise))
