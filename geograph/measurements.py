"""Measurements as columns: one frozen dataclass a table of the recording format.

Values are in SI units; ``sensor`` columns are indices into the recording's sensors, in their order.
``line`` is the line of the file that a row came from, for messages; zero where there was no file.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

ConstraintKind = Literal["altitude_m", "speed_m_s"]
"""Kinds of ``constraints.csv`` that this version understands."""


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
        If the columns' lengths differ.
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
class Constraints:
    """What is known of the path itself.

    Parameters
    ----------
    time_s
        Shape (n,); NaN: along the whole path.
    kind
        Shape (n,): ``"altitude_m"`` (height above the ellipsoid, z in a local frame) or
        ``"speed_m_s"``.
    value, sigma
        Shape (n,): in the unit of the kind.
    line
        Shape (n,), integer: line in the file, or 0.

    Raises
    ------
    InputError
        If the columns' lengths differ.
    """

    time_s: NDArray[np.float64]
    kind: tuple[ConstraintKind, ...]
    value: NDArray[np.float64]
    sigma: NDArray[np.float64]
    line: NDArray[np.int64]

    def __post_init__(self) -> None:
        _check_lengths(self)

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
        If the columns' lengths differ.
    """

    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    velocity_m_s: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        _check_lengths(self)

    def __len__(self) -> int:
        return int(self.time_s.size)


def _check_lengths(table: Bearings | Constraints | Truth) -> None:
    lengths = {name: len(column) for name, column in vars(table).items() if column is not None}
    if len(set(lengths.values())) != 1:
        raise InputError(
            f"columns of {type(table).__name__} differ in length ({lengths}); expected one length"
        )
    if isinstance(table.time_s, np.ndarray) and table.time_s.ndim != 1:
        raise InputError(f"time_s has shape {table.time_s.shape}; expected one dimension")
