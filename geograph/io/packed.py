"""Fields of fixed-column reports of satellite observers: angles and sigmas packed into digits."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from geograph.errors import InputError
from geograph.io.messages import listed, shown
from geograph.io.source import decode, read_file

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from geograph.io.rows import Sighting

EQUINOXES = {
    "": float("inf"),
    "0": float("inf"),
    "1": 1855.0,
    "2": 1875.0,
    "3": 1900.0,
    "4": 1950.0,
    "5": 2000.0,
    "6": 2050.0,
}
"""Epoch codes of the IOD and UK formats: year of the equinox, infinite for that of date."""

_SHAPE = re.compile(r"(H+|D+)(M*)(S*)([dms]*)")


@dataclass(frozen=True)
class Line:
    """One line of a report.

    Attributes
    ----------
    text
        Without its end.
    place, number
        The file and the line's number.
    """

    text: str
    place: Path
    number: int

    def columns(self, first: int, last: int) -> str:
        """Return what stands in columns, counted from one, both included; blank beyond the end."""
        return self.text[first - 1 : last].ljust(last - first + 1)

    def fail(self, first: int, last: int, message: str) -> NoReturn:
        """Raise InputError at some columns."""
        place = str(first) if first == last else f"{first}-{last}"
        raise InputError(message, path=self.place, line=self.number, column=place)

    def angle_deg(self, first: int, last: int, shape: str) -> float:
        """Return an angle packed into columns, in degrees.

        Parameters
        ----------
        first, last
            The columns.
        shape
            What the digits are, such as ``HHMMSSs``, ``DDDMMmm`` or ``DDdddd``: hours or degrees,
            minutes, seconds, and decimals of the last of them. Blanks at the end are zeros: digits
            that were not given.
        """
        text = self.columns(first, last).rstrip()
        found = _SHAPE.fullmatch(shape)
        if found is None:
            raise ValueError(shape)
        if not (text.isdecimal() and text.isascii()) or len(text) < len(found[1]):
            self.fail(first, last, f"is {shown(text)}; expected digits {shape}")
        digits = text.ljust(len(shape), "0")
        value, place, unit = 0.0, 0, 15.0 if shape[0] == "H" else 1.0
        for position, part in enumerate(found.groups()[:3]):
            if not part:
                continue
            number = int(digits[place : place + len(part)])
            place += len(part)
            if position and number >= 60:
                self.fail(first, last, f"is {shown(text)}; expected digits {shape} below 60")
            value += number * unit
            last_unit, unit = unit, unit / 60.0
        decimals = digits[place:]
        if decimals:
            value += int(decimals) / 10.0 ** len(decimals) * last_unit
        return value

    def signed_deg(self, first: int, last: int, shape: str) -> float:
        """Return an angle with its sign (blank: plus) in the first of its columns, degrees."""
        sign = self.columns(first, first)
        if sign not in "+- ":
            self.fail(first, first, f"is {shown(sign)}; expected a sign")
        value = self.angle_deg(first + 1, last, shape)
        if value > 90.0:
            self.fail(first, last, f"is {value:.9g} degrees; expected 90 at most")
        return -value if sign == "-" else value

    def digits(self, first: int, last: int, what: str) -> int:
        """Return a whole number in columns; or InputError."""
        text = self.columns(first, last)
        if not (text.isdecimal() and text.isascii()):
            self.fail(first, last, f"is {shown(text)}; expected {what}")
        return int(text)


def report_lines(paths: Sequence[Path | str]) -> Iterator[Line]:
    """Yield the lines of files but for blank ones and those that begin with ``#``."""
    for path in map(Path, paths):
        text = decode(read_file(path), path).replace("\r\n", "\n").replace("\r", "\n")
        for number, line in enumerate(text.split("\n"), start=1):
            if line.strip() and not line.startswith("#"):
                yield Line(line.rstrip(), path, number)


def of_one_object(
    paths: Path | str | Sequence[Path | str],
    parse: Callable[[Line], tuple[tuple[str, ...], Sighting | None]],
    target: str | None,
    what: str,
) -> list[Sighting]:
    """Return the sightings of one object in reports.

    Parameters
    ----------
    paths
        The files.
    parse
        Returns the names of a line's object, and its sighting if it has one.
    target
        Name of the object, one of those; None where there is one alone.
    what
        The format, for messages.

    Raises
    ------
    InputError
        If there are several objects and none is named, or no sighting of it.
    """
    files = [paths] if isinstance(paths, (str, Path)) else list(paths)
    found: dict[tuple[str, ...], list[Sighting]] = {}
    for line in report_lines(files):
        names, sighting = parse(line)
        if sighting is not None:
            found.setdefault(names, []).append(sighting)
    if target is not None:
        chosen = [rows for names, rows in found.items() if target in names]
        if not chosen:
            raise InputError(
                f"target {shown(target)} is not in {what}; expected one of "
                + (listed(names[0] for names in found) or "its objects, and it has none"),
                path=files[0] if files else None,
            )
        return [row for rows in chosen for row in rows]
    if not found:
        raise InputError(f"has no position; expected {what}", path=files[0] if files else None)
    if len(found) > 1:
        raise InputError(
            f"has {len(found)} objects, {listed(names[0] for names in found)}; expected one; name "
            "it (--target, or target=)",
            path=files[0],
        )
    return next(iter(found.values()))
