"""Intervals of bearings, linearised by one compiled call each.

What :meth:`geograph.incremental.model.Model.linearise` does with dozens of small arrays, for the
usual update: a few bearings in the last interval. Everything that does not change between updates,
the places and axes of sensors that stand still, the columns of their errors, is laid out once for a
model. What is not usual (other kinds of measurement, correlated errors, signals that leave their
interval) is left to that method, which is the reference for the numbers, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.factors.kinematics import hermite_coefficients, unit_noise_square_root
from geograph.families.bearings import LIGHT_TIME_ROUNDS, ZENITH, light_time_tolerance_s
from geograph.frames import frame_spin_rad_s
from geograph.incremental.chain import Piece
from geograph.kernels import compiled, flat, indices
from geograph.states import CLOCK, ELEVATION, MISALIGNMENT, SPEED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from geograph.frames import SensorGeometry
    from geograph.incremental.chain import Chain
    from geograph.incremental.model import Model
    from geograph.incremental.rows import Columns

# Share of the spacing by which an emission may lie outside of its interval and stay there. The
# newest knot stands at an emission, which the next estimate moves by nanoseconds: the path beyond
# a knot is the same to rounding so near to it.
WITHIN = 1e-5

# As compiled code counts them.
_LOSSES = ("none", "huber", "cauchy", "geman-mcclure")

_COLUMNS = (
    *("time_s", "sensor", "azimuth_rad", "elevation_rad", "sigma_azimuth_rad"),
    *("sigma_elevation_rad", "isotropic", "kept", "delay_s"),
)
_NONE: Columns = {
    name: np.empty(0, dtype={"sensor": np.int64, "isotropic": bool, "kept": bool}.get(name, float))
    for name in _COLUMNS
}


@dataclass(frozen=True, eq=False)
class Seen:
    """Bearings of one interval, evaluated at the estimate.

    Attributes
    ----------
    columns
        The rows.
    residual
        Shape (n, 2): whitened.
    """

    columns: Columns
    residual: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Fixed:
    """What stays the same of sensors and their errors, as compiled code takes it.

    Attributes
    ----------
    sizes, numbers, tables
        The same arguments of every call.
    position, bias, drift, since_s, sigma
        Tables of the places and of the columns of the errors, for times of emission.
    moving
        Where sensors are, if any of them moves; None: their places are in the tables.
    """

    sizes: tuple[int, ...]
    numbers: tuple[float, ...]
    tables: tuple[NDArray[Any], ...]
    position: NDArray[np.float64]
    bias: NDArray[np.int64]
    drift: NDArray[np.int64]
    since_s: NDArray[np.float64]
    sigma: NDArray[np.float64]
    moving: SensorGeometry | None

    @classmethod
    def of(cls, model: Model) -> Fixed | None:
        """Return what belongs to a model; None where its bearings are not the usual ones."""
        if compiled is None or not _usual(model):
            return None
        prepared, order = model.prepared, model.motion.order
        states, sensors = prepared.states, len(prepared.sensors)
        position, axes = np.zeros((sensors, 3)), np.zeros((sensors, 3, 3))
        poses = prepared.geometry.at_rest
        if poses is not None:
            position, axes = flat(poses.position_m), flat(poses.axes)
        # Nothing is reset: the tables have a row for each sensor.
        bias, drift = indices(states.bias_column), indices(states.drift_column)
        since, sigma = flat(states.since_s), flat(states.sigma)
        speed = prepared.recording.propagation_speed_m_s
        return cls(
            sizes=(
                *(order, sensors, states.size, len(states.walks), int(CLOCK in states.channels)),
                *(int(ELEVATION in states.channels), LIGHT_TIME_ROUNDS),
                _LOSSES.index(model.loss.name),
            ),
            numbers=(
                *(speed, frame_spin_rad_s(prepared.geometry.frame)),
                *(light_time_tolerance_s(speed), ZENITH, model.loss.tuning),
            ),
            tables=(
                *map(flat, (hermite_coefficients(order), unit_noise_square_root(order))),
                *(flat(model.path_scale), position, axes),
                *(bias, drift, since, sigma, indices(states.walk_column)),
                *(flat(prepared.walk_scale), flat(states.diffusion)),
            ),
            position=position,
            bias=bias,
            drift=drift,
            since_s=since,
            sigma=sigma,
            moving=prepared.geometry if poses is None else None,
        )

    def received(self, chain: Chain, columns: Columns) -> NDArray[np.float64]:
        """Return when signals were received, shape (n,), by the estimates of the clocks."""
        tag, sensor = columns["time_s"], columns["sensor"]
        bias, drift = self.bias[sensor, CLOCK], self.drift[sensor, CLOCK]
        if max(bias.max(initial=-1), drift.max(initial=-1)) < 0:
            return tag
        value = np.append(chain.constants * self.sigma, 0.0)
        return np.asarray(tag - value[bias] - value[drift] * (tag - self.since_s[sensor, CLOCK]))

    def poses(self, chain: Chain, columns: Columns) -> tuple[NDArray[np.float64] | None, ...]:
        """Return positions, velocities, axes and their rates for rows; nothing without movers."""
        if self.moving is None or not columns["time_s"].size:
            return None, None, None, None
        found = self.moving.poses(columns["sensor"], self.received(chain, columns))
        return found.position_m, found.velocity_m_s, found.axes, flat(found.axes_rate)

    def departures(self, chain: Chain, columns: Columns, speed_m_s: float) -> NDArray[np.float64]:
        """Return times of emission by the newest knot's estimate; fill in the signals' delays."""
        tag = columns["time_s"]
        emitted, delay = np.empty(tag.size), np.empty(tag.size)
        newest, places = chain.path[-1], None
        if self.moving is not None:
            places = self.moving.places(columns["sensor"], self.received(chain, columns))
        compiled.departures(
            *(tag.size, newest.size, self.position.shape[0], self.sigma.size),
            *(chain.knots_s[-1], speed_m_s, tag, columns["sensor"], self.position),
            *(self.bias, self.drift, self.since_s, self.sigma, chain.constants, newest),
            *(places, emitted, delay),
        )
        columns["delay_s"] = delay
        return emitted


def _usual(model: Model) -> bool:
    """Tell whether bearings are not correlated, and on axes without aberration or refraction."""
    prepared, motion = model.prepared, model.motion
    states, channels = prepared.states, prepared.states.channels
    return bool(
        motion.constant
        and all(held.constant for _, held in model.earlier)
        and not motion.static
        and motion.forces is None
        and not (model.whole or model.between or model.noisy or model.correlated)
        and not (states.platforms or states.stretches.any)
        and not channels & {SPEED, MISALIGNMENT}
        and all(walk.channel <= ELEVATION for walk in states.walks)
        and not any(
            sensor.axes == "radec" or sensor.refraction != "none" for sensor in prepared.sensors
        )
    )


def linearise_intervals(model: Model, chain: Chain, touched: Sequence[int]) -> list[Seen] | None:
    """Linearise intervals of a chain at its estimate.

    Parameters
    ----------
    model
        The model.
    chain
        Changed in place.
    touched
        Indices of intervals, growing.

    Returns
    -------
    seen
        Of every interval; None, and the chain as it was, where they are not the usual ones.

    Raises
    ------
    FloatingPointError
        If a prediction or derivative is not finite.
    """
    fixed = model.fixed
    if fixed is None:
        return None
    made = []
    for k in touched:
        found = interval(model, fixed, chain, k)
        if found is None:
            return None
        made.append(found)
    chain.changed(touched[0])
    for k, (piece, _) in zip(touched, made, strict=True):
        chain.pieces[k] = piece
    return [seen for _, seen in made]


def interval(model: Model, fixed: Fixed, chain: Chain, k: int) -> tuple[Piece, Seen] | None:
    """Return an interval linearised; None if it holds other rows than bearings emitted in it."""
    rows = chain.pieces[k].rows
    columns = rows.get("bearings", _NONE)
    if len(rows) > (columns is not _NONE):
        return None
    start, end = chain.knots_s[k], chain.knots_s[k + 1]
    low, high = model.within(chain, k)
    path, chains, size = chain.path, chain.chains, columns["time_s"].size
    d, width, m = chain.knot_size, model.layout.width, chain.size
    block, noise, residual = np.empty((width, width)), np.empty(d), np.empty((size, 2))
    inverse, root = np.empty((d, d)), np.empty((d, d))
    at_path, at_chains, emitted = np.empty((2, m)), np.empty((2, d - m)), np.empty(size)
    done = compiled.live_interval(
        size,
        *fixed.sizes,
        *fixed.numbers,
        *fixed.tables,
        model.density(start),
        *(low, high, start, end),
        *(columns[name] for name in _COLUMNS),
        *fixed.poses(chain, columns),
        *(path[k], chain.reference_path[k], chains[k], chain.reference_chains[k]),
        *(path[k + 1], chain.reference_path[k + 1], chains[k + 1], chain.reference_chains[k + 1]),
        *(chain.constants, chain.reference),
        *(block, inverse, root, noise, at_path, at_chains, emitted, residual),
    )
    if not done:
        return None
    if done < 0:
        raise FloatingPointError("a prediction or a derivative is not finite")
    piece = Piece(rows, block, inverse, root, noise, at_path, at_chains, chain.constants)
    return piece, Seen(columns, residual)
