"""Measurements as columns: one frozen dataclass a table of the recording format.

Values are in SI units; ``sensor`` columns are indices into the recording's sensors, in their order.
``line`` is the line of the file that a row came from, for messages; zero where there was no file.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from geograph.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

ConstraintKind = Literal["altitude_m", "height_above_terrain_m", "speed_m_s", "x_m", "y_m", "z_m"]
"""Kinds of ``constraints.csv`` that this version understands."""

# What columns hold whose values are not real numbers, and the codes of NumPy's types for it.
_HELD = {
    **dict.fromkeys(("sensor", "reference", "emission"), ("iu", "whole numbers")),
    "isotropic": ("b", "True or False"),
}


@dataclass(frozen=True, eq=False, kw_only=True)
class Bearings:
    """Directions to the object, as sensors measured them.

    Parameters
    ----------
    time_s
        Shape (n,): time tags by the sensor's own clock, at reception.
    sensor
        Shape (n,), integer: index of the sensor.
    azimuth_rad, elevation_rad
        Shape (n,): the measured coordinates in the sensor's axes; NaN elevation: azimuth only.
    sigma_azimuth_rad, sigma_elevation_rad
        Shape (n,): standard deviations. Where ``isotropic``, both hold the on-sky sigma.
    isotropic
        Shape (n,), bool: the noise is isotropic in the tangent plane of the measured direction;
        otherwise the sigmas are those of the coordinates themselves.
    line
        Shape (n,), integer: line in the file, or 0.

    Raises
    ------
    InputError
        If a column is no array of its type, or the lengths differ.
    """

    time_s: NDArray[np.float64]
    sensor: NDArray[np.int64]
    azimuth_rad: NDArray[np.float64]
    elevation_rad: NDArray[np.float64]
    sigma_azimuth_rad: NDArray[np.float64]
    sigma_elevation_rad: NDArray[np.float64]
    isotropic: NDArray[np.bool_]
    line: NDArray[np.int64]

    def __post_init__(self) -> None:
        _check_lengths(self)

    def __len__(self) -> int:
        return int(self.time_s.size)


@dataclass(frozen=True, eq=False, kw_only=True)
class Arrivals:
    """Times at which emissions of the object arrived at sensors.

    Parameters
    ----------
    emission
        Shape (n,), integer: rows with the same number heard the same emission, whose time is not
        known. A sensor that did not hear it has no row.
    sensor
        Shape (n,), integer: index of the sensor.
    toa_s
        Shape (n,): time of arrival by the sensor's own clock, seconds after the epoch.
    sigma_s
        Shape (n,): standard deviation of one arrival time, seconds.
    emission_names
        What the file calls each emission, by its number; empty: the numbers themselves.
    line
        Shape (n,), integer: line in the file, or 0.

    Raises
    ------
    InputError
        If a column is no array of its type, the lengths differ, a sigma is not above zero, or an
        emission has no name where others have one.
    """

    emission: NDArray[np.int64]
    sensor: NDArray[np.int64]
    toa_s: NDArray[np.float64]
    sigma_s: NDArray[np.float64]
    line: NDArray[np.int64]
    emission_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        _check_lengths(self)
        _check_positive(self, "sigma_s")
        if self.emission_names:
            _check_names(self)

    def __len__(self) -> int:
        return int(self.toa_s.size)

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Shape (n,): the arrival times, as the time tags that every table has."""
        return self.toa_s


@dataclass(frozen=True, eq=False, kw_only=True)
class TimeDifferences:
    """Differences of arrival time: tdoa = arrival(sensor) - arrival(reference).

    Parameters
    ----------
    time_s
        Shape (n,): time of arrival at the reference, by the reference's clock.
    sensor, reference
        Shape (n,), integer: indices of the two sensors.
    tdoa_s
        Shape (n,), seconds.
    sigma_s
        Shape (n,): standard deviation of the difference.
    sigma_reference_s
        Shape (n,): the part of it that the reference's own arrival brought in, common to all rows
        of the same time and reference; zero: rows are independent.
    line
        Shape (n,), integer: line in the file, or 0.

    Raises
    ------
    InputError
        If a column is no array of its type, the lengths differ, a sigma is not above zero, or the
        reference's part of it is not below it.
    """

    time_s: NDArray[np.float64]
    sensor: NDArray[np.int64]
    reference: NDArray[np.int64]
    tdoa_s: NDArray[np.float64]
    sigma_s: NDArray[np.float64]
    sigma_reference_s: NDArray[np.float64]
    line: NDArray[np.int64]

    def __post_init__(self) -> None:
        _check_lengths(self)
        _check_positive(self, "sigma_s")
        _check_share(self, "sigma_reference_s", "sigma_s")

    def __len__(self) -> int:
        return int(self.time_s.size)


@dataclass(frozen=True, eq=False, kw_only=True)
class FrequencyDifferences:
    """Differences of received frequency: fdoa = received(sensor) - received(reference).

    Parameters
    ----------
    time_s
        Shape (n,): time of arrival at the reference, by the reference's clock.
    sensor, reference
        Shape (n,), integer: indices of the two sensors.
    fdoa_hz
        Shape (n,), hertz.
    carrier_hz
        Shape (n,): frequency that the object emits, above zero.
    sigma_hz
        Shape (n,): standard deviation of the difference.
    sigma_reference_hz
        Shape (n,): the part of it that the reference brought in, common to all rows of the same
        time and reference; zero: rows are independent.
    line
        Shape (n,), integer: line in the file, or 0.

    Raises
    ------
    InputError
        If a column is no array of its type, the lengths differ, a sigma or a carrier is not above
        zero, or the reference's part of a sigma is not below it.
    """

    time_s: NDArray[np.float64]
    sensor: NDArray[np.int64]
    reference: NDArray[np.int64]
    fdoa_hz: NDArray[np.float64]
    carrier_hz: NDArray[np.float64]
    sigma_hz: NDArray[np.float64]
    sigma_reference_hz: NDArray[np.float64]
    line: NDArray[np.int64]

    def __post_init__(self) -> None:
        _check_lengths(self)
        _check_positive(self, "sigma_hz")
        _check_positive(self, "carrier_hz")
        _check_share(self, "sigma_reference_hz", "sigma_hz")

    def __len__(self) -> int:
        return int(self.time_s.size)


Measurements = Bearings | Arrivals | TimeDifferences | FrequencyDifferences
"""Any table of measurements."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Constraints:
    """What is known of the path itself.

    Parameters
    ----------
    time_s
        Shape (n,); NaN: along the whole path.
    kind
        Shape (n,): ``"altitude_m"`` (height above the ellipsoid, z in a local frame),
        ``"height_above_terrain_m"`` (above the ground of the recording's terrain),
        ``"speed_m_s"``, or ``"x_m"``, ``"y_m"``, ``"z_m"`` (coordinates in its frame).
    value, sigma
        Shape (n,): in the unit of the kind.
    line
        Shape (n,), integer: line in the file, or 0.

    Raises
    ------
    InputError
        If a column is no array of its type, the lengths differ, or a kind is unknown.
    """

    time_s: NDArray[np.float64]
    kind: tuple[ConstraintKind, ...]
    value: NDArray[np.float64]
    sigma: NDArray[np.float64]
    line: NDArray[np.int64]

    def __post_init__(self) -> None:
        _check_lengths(self)
        known = get_args(ConstraintKind)
        for row, kind in enumerate(self.kind):
            if kind not in known:
                raise InputError(
                    f"kind of Constraints is {kind!r} in row {row}; expected one of "
                    f"{', '.join(known)}",
                )

    def __len__(self) -> int:
        return int(self.time_s.size)


@dataclass(frozen=True, eq=False, kw_only=True)
class Truth:
    """Where the object really was, where that is known.

    Parameters
    ----------
    time_s
        Shape (n,), strictly increasing.
    position_m
        Shape (n, 3), metres, in the recording's frame.
    velocity_m_s
        Shape (n, 3), or None.

    Raises
    ------
    InputError
        If a column is no array of its type, or the lengths differ.
    """

    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    velocity_m_s: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        _check_lengths(self)

    def __len__(self) -> int:
        return int(self.time_s.size)


def _check_lengths(table: Measurements | Constraints | Truth) -> None:
    lengths = {}
    for name, column in vars(table).items():
        if name == "emission_names" or (column is None and name == "velocity_m_s"):
            continue
        _check_column(table, name, column)
        lengths[name] = len(column)
    if len(set(lengths.values())) != 1:
        raise InputError(
            f"columns of {type(table).__name__} differ in length ({lengths}); expected one length"
        )


def _check_column(table: Measurements | Constraints | Truth, name: str, column: object) -> None:
    """Refuse what is no array of numbers, as is a list, or no sequence of words for kinds."""
    if name == "kind":
        if not isinstance(column, tuple | list):
            raise InputError(
                f"kind of {type(table).__name__} is {column!r}; expected a tuple of kinds",
            )
        return
    codes, what = _HELD.get(name, ("fiu", "numbers"))
    dimensions = 2 if isinstance(table, Truth) and name != "time_s" else 1
    if isinstance(column, np.ndarray) and column.dtype.kind in codes and column.ndim == dimensions:
        return
    given = type(column).__name__
    if isinstance(column, np.ndarray):
        given = f"an array of {column.dtype} of shape {column.shape}"
    raise InputError(
        f"{name} of {type(table).__name__} is {given}; expected a NumPy array of {what} with "
        f"{'one dimension' if dimensions == 1 else 'shape (n, 3)'}",
    )


def _check_names(table: Arrivals) -> None:
    """Refuse emissions that have no name, where there are names."""
    given: object = table.emission_names
    if not isinstance(given, tuple | list) or not all(isinstance(name, str) for name in given):
        raise InputError(
            f"emission_names of Arrivals is {given!r}; expected a tuple of words, or () for none"
        )
    if len(table) and not 0 <= table.emission.min() <= table.emission.max() < len(given):
        raise InputError(
            f"emissions are numbered {table.emission.min()} to {table.emission.max()} and have "
            f"{len(given)} names; expected a name for each number from 0 on, or () for none",
            column="emission_names",
        )


def _check_positive(table: Measurements, name: str) -> None:
    column = getattr(table, name)
    if not (column > 0.0).all():
        row = int(np.argmin(column > 0.0))
        raise InputError(
            f"{name} of {type(table).__name__} is {column[row]} in row {row}; expected above 0"
        )


def _check_share(table: Measurements, part: str, whole: str) -> None:
    share, total = getattr(table, part), getattr(table, whole)
    good = (share >= 0.0) & (share < total)
    if not good.all():
        row = int(np.argmin(good))
        raise InputError(
            f"{part} of {type(table).__name__} is {share[row]} in row {row}, beside {whole} "
            f"{total[row]}; expected at least 0 and below {whole}, of which it is a part"
        )
