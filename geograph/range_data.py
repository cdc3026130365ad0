"""Arrival times and differences made ready for first guesses, with what they say of a path.

Every set of arrival times of one emission, and all time differences of one time and reference, is a
group of ranges with one unknown in common, the time of emission. Rows of differences are the
arrival at the reference, with the part of the sigma that they share, and that at each sensor with
the rest. What sensors may be off by is added to the sigmas.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.factors.arrival import SensorMotion
from geograph.frames import frame_spin_rad_s
from geograph.measurements import Bearings, FrequencyDifferences

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.frames import SensorGeometry
    from geograph.recording import Frame, Recording

# Least share of a difference's sigma that its reference takes: a sigma of zero has no reciprocal.
_LEAST_SHARE = 0.05

# Bearings select among roots here; what refraction and the axes' own errors add matters less.
_LEAST_BEARING_RAD = 1e-3

# Number of times at which a height that holds along the whole path is asked for.
_HEIGHT_TIMES = 12


@dataclass(frozen=True, eq=False)
class Ranges:
    """Rows of arrivals in groups of one emission each, contiguous and in order.

    Attributes
    ----------
    sensor, group
        Shape (n,), integer.
    delay_s, sigma_s
        Shape (n,): arrival, counted from the group's ``origin_s``, and its sigma.
    motion
        Sensors at their arrivals.
    origin_s
        Shape (g,).
    """

    sensor: NDArray[np.int64]
    group: NDArray[np.int64]
    delay_s: NDArray[np.float64]
    sigma_s: NDArray[np.float64]
    motion: SensorMotion
    origin_s: NDArray[np.float64]

    def __len__(self) -> int:
        return int(self.sensor.size)

    def take(self, rows: NDArray[np.bool_]) -> Ranges:
        """Return some rows; groups of fewer than two say nothing and are left out."""
        count = np.bincount(self.group[rows], minlength=self.origin_s.size)
        kept = count >= 2
        rows = rows & kept[self.group]
        number = np.cumsum(kept) - 1
        return Ranges(
            self.sensor[rows],
            number[self.group[rows]],
            self.delay_s[rows],
            self.sigma_s[rows],
            taken_motion(self.motion, rows),
            self.origin_s[kept],
        )


@dataclass(frozen=True, eq=False)
class Heights:
    """Known heights at times, shape (h,) each, metres; empty: none."""

    time_s: NDArray[np.float64]
    value: NDArray[np.float64]
    sigma: NDArray[np.float64]

    def at(self, time_s: float) -> float | None:
        """Return the height at a time, or None."""
        if not self.value.size:
            return None
        order = np.argsort(self.time_s)
        return float(np.interp(time_s, self.time_s[order], self.value[order]))


@dataclass(frozen=True, eq=False)
class RangeData:
    """All that first guesses look at.

    Attributes
    ----------
    ranges, bearings, differences
        The measurements; the tables may be empty.
    bearing_sigma, difference_sigma
        Shapes (n, 2) and (n,): sigmas with what the sensors may be off by.
    heights
        Known ones.
    geometry
        Poses of the sensors.
    speed_m_s
        Speed of propagation, finite.
    """

    ranges: Ranges
    bearings: Bearings
    differences: FrequencyDifferences
    bearing_sigma: NDArray[np.float64]
    difference_sigma: NDArray[np.float64]
    heights: Heights
    geometry: SensorGeometry
    speed_m_s: float

    @property
    def frame(self) -> Frame:
        """The recording's frame."""
        return self.geometry.frame

    @property
    def spin_rad_s(self) -> float:
        """Angular speed of the frame."""
        return frame_spin_rad_s(self.geometry.frame)

    def __len__(self) -> int:
        return len(self.ranges) + len(self.bearings) + len(self.differences)

    def without(self, sensor: int) -> RangeData:
        """Return what is left without the measurements that a sensor had a part in."""
        table = self.differences
        return self._take(
            self.ranges.sensor != sensor,
            self.bearings.sensor != sensor,
            (table.sensor != sensor) & (table.reference != sensor),
        )

    def thinned(self, rows: int) -> RangeData:
        """Return about so many rows of each kind, whole groups, drawn evenly and reproducibly."""
        # A fixed stride could always meet the same pair of sensors.
        rng = np.random.default_rng(0)
        groups = self.ranges.origin_s.size
        if len(self.ranges) > rows:
            count = max(1, int(groups * rows / len(self.ranges)))
            chosen = np.zeros(groups, dtype=bool)
            chosen[rng.permutation(groups)[:count]] = True
            kept = chosen[self.ranges.group]
        else:
            kept = np.ones(len(self.ranges), dtype=bool)
        parts = []
        for size in (len(self.bearings), len(self.differences)):
            part = np.zeros(size, dtype=bool)
            part[rng.permutation(size)[:rows]] = True
            parts.append(part)
        return self._take(kept, *parts)

    def _take(
        self,
        ranges: NDArray[np.bool_],
        bearings: NDArray[np.bool_],
        differences: NDArray[np.bool_],
    ) -> RangeData:
        return dataclasses.replace(
            self,
            ranges=self.ranges.take(ranges),
            bearings=Bearings(**_columns(self.bearings, bearings)),
            differences=FrequencyDifferences(**_columns(self.differences, differences)),
            bearing_sigma=self.bearing_sigma[bearings],
            difference_sigma=self.difference_sigma[differences],
        )

    def sensor_places(self) -> NDArray[np.float64]:
        """Return where sensors were when they measured, shape (n, 3); one point if none did."""
        tables = [
            (self.bearings.sensor, self.bearings.time_s),
            (self.differences.sensor, self.differences.time_s),
            (self.differences.reference, self.differences.time_s),
        ]
        places = [self.ranges.motion.position_m]
        places += [self.geometry.motion(sensor, time).position_m for sensor, time in tables]
        every = np.concatenate(places)
        return every if every.size else np.zeros((1, 3))

    def times(self) -> NDArray[np.float64]:
        """Return the time tags, shape (n,), one a group; a zero if there are none."""
        every = np.concatenate(
            [self.ranges.origin_s, self.bearings.time_s, self.differences.time_s]
        )
        return every if every.size else np.zeros(1)


def _columns(table: Bearings | FrequencyDifferences, rows: NDArray[np.bool_]) -> dict[str, Any]:
    return {name: column[rows] for name, column in vars(table).items()}


def taken_motion(motion: SensorMotion, rows: NDArray[np.bool_]) -> SensorMotion:
    """Return the motion of some of the sensors.

    Parameters
    ----------
    motion
        Of n.
    rows
        Shape (n,): which.
    """
    return SensorMotion(
        motion.position_m[rows], motion.velocity_m_s[rows], motion.acceleration_m_s2[rows]
    )


def range_data(recording: Recording, geometry: SensorGeometry) -> RangeData:
    """Return a recording's measurements made ready.

    Parameters
    ----------
    recording
        With any of the tables.
    geometry
        Poses of its sensors.
    """
    sensors = list(recording.sensors.values())
    speed = recording.propagation_speed_m_s
    speed = speed if np.isfinite(speed) else SPEED_OF_LIGHT_M_S
    angle = np.array([np.hypot(s.errors.azimuth_bias_rad, s.errors.elevation_bias_rad)
                      for s in sensors])  # fmt: skip
    pitch = np.array([s.errors.frequency_offset_hz for s in sensors])
    bearings = recording.bearings or _no_bearings()
    differences = recording.frequency_differences or _no_differences()
    sky = np.stack([bearings.sigma_azimuth_rad, bearings.sigma_elevation_rad], axis=1)
    extra = np.hypot(angle, _LEAST_BEARING_RAD)[bearings.sensor]
    both = np.hypot(pitch[differences.sensor], pitch[differences.reference])
    return RangeData(
        ranges=_ranges(recording, geometry, speed),
        bearings=bearings,
        differences=differences,
        bearing_sigma=np.hypot(sky, extra[:, None]),
        difference_sigma=np.hypot(differences.sigma_hz, both),
        heights=_heights(recording),
        geometry=geometry,
        speed_m_s=speed,
    )


def _ranges(recording: Recording, geometry: SensorGeometry, speed_m_s: float) -> Ranges:
    errors = [s.errors for s in recording.sensors.values()]
    loose = np.array(
        [
            np.hypot(e.clock_offset_s, np.hypot(e.position_m, e.position_noise_m) / speed_m_s)
            for e in errors
        ]
    )
    sensor, group, delay, sigma, origin = [], [], [], [], []
    table = recording.arrivals
    if table is not None and len(table):
        _, code = np.unique(table.emission, return_inverse=True)
        order = np.lexsort((table.toa_s, code))
        first = np.flatnonzero(np.diff(code[order], prepend=-1))
        start = table.toa_s[order][first]
        sensor.append(table.sensor[order])
        group.append(code[order])
        delay.append(table.toa_s[order] - start[code[order]])
        sigma.append(table.sigma_s[order])
        origin.append(start)
    pairs = recording.time_differences
    if pairs is not None and len(pairs):
        keys = np.stack([pairs.time_s, pairs.reference.astype(np.float64)], axis=1)
        found, code = np.unique(keys, axis=0, return_inverse=True)
        code = code.ravel()
        shared = np.zeros(found.shape[0])
        np.maximum.at(
            shared, code, np.maximum(pairs.sigma_reference_s, _LEAST_SHARE * pairs.sigma_s)
        )
        own = np.sqrt(np.maximum(pairs.sigma_s**2 - shared[code] ** 2, 0.0))
        own = np.maximum(own, _LEAST_SHARE * pairs.sigma_s)
        number = np.concatenate([np.arange(found.shape[0]), code])
        order = np.argsort(number, kind="stable")
        before = sum(part.size for part in origin)
        sensor.append(np.concatenate([found[:, 1].astype(np.int64), pairs.sensor])[order])
        group.append(number[order] + before)
        delay.append(np.concatenate([np.zeros(found.shape[0]), pairs.tdoa_s])[order])
        sigma.append(np.concatenate([shared, own])[order])
        origin.append(found[:, 0])
    if not sensor:
        nothing = np.zeros((0, 3))
        empty, none = np.zeros(0), np.zeros(0, dtype=np.int64)
        return Ranges(none, none, empty, empty, SensorMotion(nothing, nothing, nothing), empty)
    which, number = np.concatenate(sensor), np.concatenate(group)
    after, start = np.concatenate(delay), np.concatenate(origin)
    motion = geometry.motion(which, start[number] + after)
    spread = np.hypot(np.concatenate(sigma), loose[which])
    every = Ranges(which, number, after, spread, motion, start)
    return every.take(np.ones(which.size, dtype=bool))


def _heights(recording: Recording) -> Heights:
    table = recording.constraints
    nothing = np.zeros(0)
    if table is None:
        return Heights(nothing, nothing, nothing)
    # In a local frame z is the height.
    kinds = ("altitude_m", "z_m") if recording.frame == "local" else ("altitude_m",)
    rows = np.array([kind in kinds for kind in table.kind], dtype=bool)
    time, value, sigma = table.time_s[rows], table.value[rows], table.sigma[rows]
    whole = np.isnan(time)
    low, high = recording.time_span_s
    span = np.linspace(low, high, _HEIGHT_TIMES)
    return Heights(
        np.concatenate([time[~whole], np.tile(span, int(whole.sum()))]),
        np.concatenate([value[~whole], np.repeat(value[whole], span.size)]),
        np.concatenate([sigma[~whole], np.repeat(sigma[whole], span.size)]),
    )


def _no_bearings() -> Bearings:
    empty, none = np.zeros(0), np.zeros(0, dtype=np.int64)
    return Bearings(
        time_s=empty,
        sensor=none,
        azimuth_rad=empty,
        elevation_rad=empty,
        sigma_azimuth_rad=empty,
        sigma_elevation_rad=empty,
        isotropic=np.zeros(0, dtype=bool),
        line=none,
    )


def _no_differences() -> FrequencyDifferences:
    empty, none = np.zeros(0), np.zeros(0, dtype=np.int64)
    return FrequencyDifferences(
        time_s=empty,
        sensor=none,
        reference=none,
        fdoa_hz=empty,
        carrier_hz=empty,
        sigma_hz=empty,
        sigma_reference_hz=empty,
        line=none,
    )
