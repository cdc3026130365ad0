"""When, and how much shifted in frequency, a signal is received: from geometry alone.

Everything happens in axes that do not turn: the object is put where it was at emission, the
receiver where it is at reception, each by the turn of the frame at its own time. The signal is
received when it has covered the distance between these two places; and differentiating that
statement by time tells how much later the next crest of the wave comes in.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.scenarios.orbits import turned_about_z

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.scenarios.paths import Body

_MOST_ITERATIONS = 500


@dataclass(frozen=True, eq=False)
class Received:
    """Error-free receptions.

    Parameters
    ----------
    delay_s
        Shape (n,), seconds: reception less emission.
    shift
        Shape (n,): received over emitted frequency, less one.
    """

    delay_s: NDArray[np.float64]
    shift: NDArray[np.float64]


def receive(
    path: Body,
    receiver: Body,
    emission_time_s: NDArray[np.float64],
    *,
    propagation_speed_m_s: float,
    rotation_rad_s: float,
) -> Received:
    """Solve for the reception of signals by one receiver.

    With P the place of emission at t_e and S(t) the receiver, |P - S(t_r)| = c (t_r - t_e) holds
    at every emission. Its differential is u.(V dt_e - W dt_r) = c (dt_r - dt_e), u being the unit
    vector from S to P and V and W the velocities, all in axes that do not turn; crests that leave
    dt_e apart arrive dt_r apart, so dt_e / dt_r is the ratio of the frequencies.

    Parameters
    ----------
    path, receiver
        Object and receiver, in axes that turn about z at ``rotation_rad_s``.
    emission_time_s
        Shape (n,), seconds.
    propagation_speed_m_s
        Speed of the signal, metres per second, finite.
    rotation_rad_s
        Rate at which the axes turn, rad/s; 0 in a local frame.

    Raises
    ------
    RuntimeError
        If a signal never catches its receiver (one as fast as the signal).
    """
    place, velocity = in_inertial_axes(path, emission_time_s, rotation_rad_s)
    delay = np.zeros_like(emission_time_s)
    change = np.inf
    for _ in range(_MOST_ITERATIONS):
        there, moving = in_inertial_axes(receiver, emission_time_s + delay, rotation_rad_s)
        line = place - there
        distance = np.linalg.norm(line, axis=-1)
        following = distance / propagation_speed_m_s
        before, change = change, float(np.max(np.abs(following - delay), initial=0.0))
        delay = following
        # A contraction, down to where rounding stops it.
        if change <= 1e-15 or (change < 1e-11 and change >= before):
            break
    else:
        raise RuntimeError(f"receptions do not settle (last change {change:.3g} s)")
    # From an emitter in the very place of its receiver no direction is any better than another.
    unit = line / np.where(distance > 0.0, distance, 1.0)[:, None]
    away = np.sum(unit * velocity, axis=-1)
    # The ratio less one, without taking a difference of two numbers near one.
    closing = np.sum(unit * (moving - velocity), axis=-1)
    return Received(delay, closing / (propagation_speed_m_s + away))


def in_inertial_axes(
    body: Body, time_s: NDArray[np.float64], rotation_rad_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return positions and velocities, each shape (n, 3), in axes that do not turn.

    Parameters
    ----------
    body
        In axes that turn about z and coincide with the result's at time zero.
    time_s
        Shape (n,), seconds.
    rotation_rad_s
        Rate at which the axes turn, rad/s.
    """
    angle = rotation_rad_s * time_s
    place = np.asarray(body.position_at(time_s))
    carried = rotation_rad_s * np.stack(
        [-place[..., 1], place[..., 0], np.zeros_like(place[..., 2])], axis=-1
    )
    return (
        turned_about_z(place, angle),
        turned_about_z(body.velocity_at(time_s) + carried, angle),
    )
