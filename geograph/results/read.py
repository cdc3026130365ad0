"""Results folders read back, from their files alone."""

from __future__ import annotations

import csv
import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, get_args

import numpy as np

from geograph.errors import InputError
from geograph.measurements import Truth
from geograph.recording import Frame
from geograph.results import names
from geograph.results.data import (
    ErrorCurve,
    ErrorKind,
    ErrorState,
    PlatformPath,
    ResidualTable,
    Results,
    SensorPath,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray


class Table:
    """A CSV file of results, as columns of text that know where they stand.

    Parameters
    ----------
    path
        The file.
    required
        Names of columns that must be there.

    Raises
    ------
    InputError
        If the file cannot be read, a column is missing, or a row has another number of fields.
    """

    def __init__(self, path: Path, required: Iterable[str]) -> None:
        self.path = path
        try:
            with path.open(newline="", encoding="utf-8") as file:
                rows = list(csv.reader(file))
        except OSError as error:
            raise InputError(f"cannot be read ({error.strerror})", path=path) from None
        except (UnicodeDecodeError, csv.Error) as error:
            raise InputError(f"is not a CSV file ({error})", path=path) from None
        self.header = rows[0] if rows else []
        for name in required:
            if name not in self.header:
                raise InputError(
                    "column is missing; expected a file as geograph smooth writes it",
                    path=path,
                    line=1,
                    column=name,
                )
        for line, row in enumerate(rows[1:], start=2):
            if len(row) != len(self.header):
                raise InputError(
                    f"has {len(row)} fields; expected {len(self.header)}", path=path, line=line
                )
        columns = zip(*rows[1:], strict=True) if len(rows) > 1 else ([] for _ in self.header)
        self._columns = dict(zip(self.header, columns, strict=True))

    def __contains__(self, name: str) -> bool:
        return name in self._columns

    def finite(self, name: str, *, increasing: bool = False) -> NDArray[np.float64]:
        """Return a column of finite numbers, strictly increasing if asked for; or InputError."""
        values = self.numbers(name)
        wrong = ~np.isfinite(values)
        if increasing:
            wrong[1:] |= ~(np.diff(values) > 0.0)
        if wrong.any():
            row = int(np.argmax(wrong))
            expected = "a finite number" + (
                ", greater than in the row before" if increasing else ""
            )
            raise InputError(
                f"is {values[row]:.15g}; expected {expected}",
                path=self.path,
                line=row + 2,
                column=name,
            )
        return values

    def text(self, name: str) -> NDArray[np.str_]:
        """Return a column as text, shape (n,)."""
        return np.asarray(self._columns[name], dtype=np.str_)

    def numbers(self, name: str) -> NDArray[np.float64]:
        """Return a column as numbers, shape (n,); InputError where one is none."""
        column = self._columns[name]
        try:
            return np.array([float(value) for value in column], dtype=np.float64)
        except ValueError:
            for line, value in enumerate(column, start=2):
                if not _is_number(value):
                    raise InputError(
                        f"is {value!r}; expected a number", path=self.path, line=line, column=name
                    ) from None
            raise

    def stack(self, columns: Sequence[str]) -> NDArray[np.float64]:
        """Return finite columns beside each other, shape (n, len(columns))."""
        return np.stack([self.finite(name) for name in columns], axis=-1)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def load(folder: Path | str) -> Results:
    """Read the results that :func:`geograph.results.save` wrote.

    Raises
    ------
    InputError
        If a file is missing or not as it was written.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError("is no folder; expected one written by geograph smooth", path=folder)
    summary = _load_summary(folder / names.SUMMARY)
    track = load_track(folder / names.TRACK)
    return Results(
        name=str(summary["name"]),
        frame=cast("Frame", summary["frame"]),
        status=str(summary["status"]),
        **track,
        sensors=_load_places(folder / names.PLACES),
        platforms=_load_platforms(folder / names.PLATFORMS),
        errors=_load_errors(folder / names.SENSORS),
        curves=_load_curves(folder / names.CURVES) if (folder / names.CURVES).exists() else (),
        residuals=_load_residuals(folder / names.RESIDUALS),
        truth=load_truth(folder / names.TRUTH) if (folder / names.TRUTH).exists() else None,
        summary=summary,
    )


def _load_summary(path: Path) -> dict[str, Any]:
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror}); expected the results of geograph smooth",
            path=path,
        ) from None
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(f"is not JSON ({error})", path=path) from None
    for key in ("name", "frame", "status"):
        if not isinstance(summary, dict) or key not in summary:
            raise InputError(
                "key is missing; expected a summary of geograph", path=path, column=key
            )
    if summary["frame"] not in get_args(Frame):
        raise InputError(
            f"is {summary['frame']!r}; expected ecef or local", path=path, column="frame"
        )
    return dict(summary)


def load_track(path: Path) -> dict[str, Any]:
    """Read ``track.csv``: the fields of :class:`Results` that stand in it, by name."""
    table = Table(path, ("time_s", *names.POSITION, *names.COVARIANCE, *names.SEMI_AXES))
    covariance = _covariance(table)
    if not covariance.size:
        raise InputError("has no row; expected one for each knot", path=path)
    moving = all(name in table for name in names.VELOCITY)
    accelerating = all(name in table for name in names.ACCELERATION)
    return {
        "time_s": table.finite("time_s", increasing=True),
        "position_m": table.stack(names.POSITION),
        "position_covariance_m2": covariance,
        "velocity_m_s": table.stack(names.VELOCITY) if moving else None,
        "acceleration_m_s2": table.stack(names.ACCELERATION) if accelerating else None,
        "sigma_speed_m_s": table.numbers(names.SPEED[1]) if names.SPEED[1] in table else None,
        # Of a state that the data do not determine they may be infinite.
        "semi_axes_m": np.stack([table.numbers(name) for name in names.SEMI_AXES], axis=-1),
        "motion_covariance": _motion_covariance(table, covariance),
    }


def _motion_covariance(
    table: Table, position_covariance: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    # Earlier versions did not write it.
    if not all(name in table for name in names.MOTION_COVARIANCE):
        return None
    covariance = np.empty((position_covariance.shape[0], 6, 6))
    covariance[:, :3, :3] = position_covariance
    for name, (row, column) in names.MOTION_COVARIANCE.items():
        covariance[:, row, column] = covariance[:, column, row] = table.numbers(name)
    return covariance


def _covariance(table: Table) -> NDArray[np.float64]:
    covariance = np.empty((table.text("time_s").size, 3, 3))
    for name, (row, column) in names.COVARIANCE.items():
        covariance[:, row, column] = covariance[:, column, row] = table.numbers(name)
    return covariance


def load_truth(path: Path) -> Truth:
    """Read ``truth.csv`` of a results folder."""
    table = Table(path, ("time_s", *names.POSITION))
    if not table.text("time_s").size:
        raise InputError("has no row; expected one for each known position", path=path)
    moving = all(name in table for name in names.VELOCITY)
    velocity = table.stack(names.VELOCITY) if moving else None
    return Truth(
        time_s=table.finite("time_s"),
        position_m=table.stack(names.POSITION),
        velocity_m_s=velocity,
    )


def _load_errors(path: Path) -> tuple[ErrorState, ...]:
    table = Table(path, ("sensor", "state", "unit", "estimate", "sigma", "prior_sigma"))
    texts = (table.text(name).tolist() for name in ("sensor", "state", "unit"))
    numbers = (table.numbers(name).tolist() for name in ("estimate", "sigma", "prior_sigma"))
    return tuple(
        ErrorState(sensor=a, state=b, unit=c, estimate=d, sigma=e, prior_sigma=f)
        for a, b, c, d, e, f in zip(*texts, *numbers, strict=True)
    )


def _groups(*columns: NDArray[np.str_]) -> Iterable[tuple[tuple[str, ...], NDArray[np.bool_]]]:
    for key in dict.fromkeys(zip(*(column.tolist() for column in columns), strict=True)):
        rows = np.logical_and.reduce([c == k for c, k in zip(columns, key, strict=True)])
        yield key, rows


def _load_curves(path: Path) -> tuple[ErrorCurve, ...]:
    numbers = ("time_s", "estimate", "sigma", "prior_sigma")
    texts = ("sensor", "kind", "unit")
    table = Table(path, (*texts, *numbers))
    values = {name: table.numbers(name) for name in numbers}
    return tuple(
        ErrorCurve(
            sensor=key[0],
            kind=cast("ErrorKind", key[1]),
            unit=key[2],
            **{name: column[rows] for name, column in values.items()},
        )
        for key, rows in _groups(*(table.text(name) for name in texts))
    )


def _load_places(path: Path) -> tuple[SensorPath, ...]:
    table = Table(path, ("sensor", "axes", "time_s", *names.POSITION))
    time, position = table.numbers("time_s"), table.stack(names.POSITION)
    return tuple(
        SensorPath(sensor=key[0], axes=key[1], time_s=time[rows], position_m=position[rows])
        for key, rows in _groups(table.text("sensor"), table.text("axes"))
    )


def _load_platforms(path: Path) -> tuple[PlatformPath, ...]:
    if not path.exists():
        return ()
    table = Table(path, ("sensor", "time_s", *names.POSITION, *names.VELOCITY, *names.COVARIANCE))
    time, covariance = table.numbers("time_s"), _covariance(table)
    position, velocity = table.stack(names.POSITION), table.stack(names.VELOCITY)
    return tuple(
        PlatformPath(
            sensor=key[0],
            time_s=time[rows],
            position_m=position[rows],
            velocity_m_s=velocity[rows],
            position_covariance_m2=covariance[rows],
        )
        for key, rows in _groups(table.text("sensor"))
    )


# Versions that knew bearings alone did not write these.
_LATER_COLUMNS = ("reference", "emission")


def _load_residuals(path: Path) -> ResidualTable:
    columns = [entry.name for entry in dataclasses.fields(ResidualTable)]
    table = Table(path, [name for name in columns if name not in _LATER_COLUMNS])
    later = {
        name: table.text(name) if name in table else np.full(table.text("kind").shape, "")
        for name in _LATER_COLUMNS
    }
    return ResidualTable(
        **later,
        time_s=table.numbers("time_s"),
        sensor=table.text("sensor"),
        kind=table.text("kind"),
        unit=table.text("unit"),
        measured=table.numbers("measured"),
        predicted=table.numbers("predicted"),
        residual=table.numbers("residual"),
        sigma=table.numbers("sigma"),
        normalised=table.numbers("normalised"),
        weight=table.numbers("weight"),
        rejected=table.text("rejected") == "true",
        line=table.numbers("line").astype(np.int64),
    )
