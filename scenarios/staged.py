"""An object on which random forces act, a different one in every stage.

The equation of motion is integrated in axes that do not turn, from one time at which the force
bends to the next, so that no step of the integrator crosses a discontinuity.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.integrate import solve_ivp

from geograph.constants import EARTH_GM_M3_S2, EARTH_RADIUS_M
from geograph.scenarios.orbits import EarthFixedBody, gravity
from geograph.scenarios.paths import SampledBody
from geograph.scenarios.places import random_axes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.scenarios.paths import Body

_TABLE_STEP_S = 0.5
_LOWEST_M = 200e3
_MOST_PATHS = 100


@dataclass(frozen=True, kw_only=True)
class Stages:
    """What forces act on the object, per unit of its mass.

    Parameters
    ----------
    count
        Number of stages; their ends are uniformly random.
    thrust_m_s2
        Greatest constant part of a stage's force; uniform in a ball.
    flutter_m_s2
        Standard deviation, each axis, of a random part that is piecewise linear in time.
    flutter_step_s
        Time between the nodes of that part.
    """

    count: int = 5
    thrust_m_s2: float = 3.0
    flutter_m_s2: float = 0.3
    flutter_step_s: float = 20.0

    def __post_init__(self) -> None:
        if self.count < 1 or not self.flutter_step_s > 0.0:
            raise ValueError(
                f"{self.count} stages, nodes every {self.flutter_step_s} s; expected at least one "
                "stage and a time above 0"
            )

    def draw_thrust(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw the constant force of each stage, shape (count, 3), uniform in the ball."""
        direction = rng.standard_normal((self.count, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        length = rng.uniform(size=(self.count, 1)) ** (1.0 / 3.0)
        return np.asarray(self.thrust_m_s2 * length * direction)

    def jerk_density(self, duration_s: float) -> float:
        """Return the white noise on the jerk that moves the acceleration as much, m/s^2.5.

        A force that is uniform in a ball of radius f has the variance f^2 / 5 on each axis, and the
        difference of two draws twice that; the sum of these squares over all changes of the pass,
        over its length, is the square of what is returned.

        Parameters
        ----------
        duration_s
            Length of the pass, seconds.
        """
        jumps = 2.0 / 5.0 * self.thrust_m_s2**2 * (self.count - 1) / duration_s
        return float(np.sqrt(jumps + 2.0 * self.flutter_m_s2**2 / self.flutter_step_s))


@dataclass(frozen=True, eq=False)
class StagedPath:
    """A staged path with what drove it.

    Parameters
    ----------
    body
        The object in ECEF axes.
    boundary_s
        Shape (count - 1,): when one stage ends and the next begins.
    thrust_m_s2
        Shape (count, 3): constant forces, inertial axes.
    """

    body: Body
    boundary_s: NDArray[np.float64]
    thrust_m_s2: NDArray[np.float64]


def random_staged_path(
    rng: np.random.Generator, stages: Stages, span_s: tuple[float, float]
) -> StagedPath:
    """Draw a path that starts in low orbit, at 500 to 1000 km and circular speed.

    Parameters
    ----------
    rng
        Source of randomness.
    stages
        The forces.
    span_s
        First and last time, seconds.

    Raises
    ------
    RuntimeError
        If none of many paths stays 200 km high.
    """
    for _ in range(_MOST_PATHS):
        first, second = random_axes(rng)
        radius = EARTH_RADIUS_M + rng.uniform(500e3, 1000e3)
        initial = np.stack([radius * first, np.sqrt(EARTH_GM_M3_S2 / radius) * second])
        path = _draw(rng, stages, span_s, initial)
        time = np.linspace(*span_s, 61)
        height = np.linalg.norm(path.body.position_at(time), axis=-1) - EARTH_RADIUS_M
        if height.min() > _LOWEST_M:
            return path
    raise RuntimeError(f"none of {_MOST_PATHS} paths stays up; expected a smaller thrust_m_s2")


def _draw(
    rng: np.random.Generator,
    stages: Stages,
    span_s: tuple[float, float],
    initial: NDArray[np.float64],
) -> StagedPath:
    start, end = span_s
    rows = int(np.ceil((end - start) / _TABLE_STEP_S)) + 1
    time = np.linspace(start, end, rows)
    # Everything that bends does so at rows of the table, where the Hermite polynomials join.
    boundary = np.sort(rng.choice(np.arange(1, rows - 1), stages.count - 1, replace=False))
    every = max(round(stages.flutter_step_s / (time[1] - time[0])), 1)
    node = np.unique(np.concatenate([np.arange(0, rows, every), [rows - 1]]))
    thrust = stages.draw_thrust(rng)
    flutter = stages.flutter_m_s2 * rng.standard_normal((node.size, 3))
    cuts = np.unique(np.concatenate([node, boundary]))
    state = np.empty((rows, 2, 3))
    state[0] = initial
    for low, high in pairwise(cuts):
        push = thrust[np.searchsorted(boundary, low, side="right")]
        ends = [
            push + np.array([np.interp(time[i], time[node], column) for column in flutter.T])
            for i in (low, high)
        ]
        state[low : high + 1] = _integrate(state[low], time[low : high + 1], ends[0], ends[1])
    return StagedPath(EarthFixedBody(SampledBody(time, state)), time[boundary], thrust)


def _integrate(
    initial: NDArray[np.float64],
    time_s: NDArray[np.float64],
    first_m_s2: NDArray[np.float64],
    last_m_s2: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return states, shape (n, 2, 3), under gravity and a force that is linear in time."""
    start, length = time_s[0], time_s[-1] - time_s[0]

    def derivative(time: float, state: NDArray[np.float64]) -> NDArray[np.float64]:
        share = (time - start) / length
        force = (1.0 - share) * first_m_s2 + share * last_m_s2
        return np.concatenate([state[3:], gravity(state[:3], j2=True) + force])

    found = solve_ivp(
        derivative,
        (start, time_s[-1]),
        initial.ravel(),
        method="DOP853",
        t_eval=time_s,
        rtol=1e-11,
        atol=1e-6,
    )
    if not found.success:
        raise RuntimeError(f"a staged path could not be integrated: {found.message}")
    return np.asarray(np.moveaxis(found.y.reshape(2, 3, time_s.size), -1, 0))
