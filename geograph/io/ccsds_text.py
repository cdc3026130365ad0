"""Lines of CCSDS messages in keyword = value notation (503.0-B-2 and 502.0-B-3, section 4)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, NoReturn

from geograph.errors import InputError
from geograph.io.instants import known_system, parse_instant
from geograph.io.messages import shown
from geograph.io.source import decode

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from geograph.io.instants import TimeSystem

_KEYWORD = re.compile(r"[A-Z][A-Z0-9_]*", re.ASCII)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d{1,4})?", re.ASCII)


@dataclass(frozen=True)
class Entry:
    """A keyword with its value, and where it stands.

    Attributes
    ----------
    keyword, value
        As written, without blanks around; a line without ``=`` has all of it as its value and ""
        as its keyword.
    place, line
        The file and its line.
    """

    keyword: str
    value: str
    place: Path
    line: int

    def fail(self, message: str) -> NoReturn:
        """Raise InputError at this entry."""
        raise InputError(message, path=self.place, line=self.line, column=self.keyword or None)

    def number(self, text: str | None = None) -> float:
        """Return its value, or a part of it, as a finite number; or InputError."""
        given = self.value if text is None else text
        if _NUMBER.fullmatch(given) is None:
            self.fail(f"is {shown(given)}; expected a number")
        value = float(given.replace("d", "e").replace("D", "e"))
        if not abs(value) < 1e30:
            self.fail(f"is {shown(given)}; expected a finite number")
        return value

    def instant(self, text: str, system: TimeSystem) -> int:
        """Return a time in its value as an instant (:mod:`geograph.io.instants`); or InputError."""
        try:
            return parse_instant(text, system)
        except ValueError as error:
            self.fail(f"is {shown(text)}; {error}")

    def system(self) -> TimeSystem:
        """Return its value as a time system; or InputError."""
        try:
            return known_system(self.value.upper())
        except ValueError as error:
            self.fail(str(error))


def kvn_entries(content: bytes, place: Path) -> Iterator[Entry]:
    """Yield the lines of a message but for blank ones and comments.

    Raises
    ------
    InputError
        If the file is not text, or a keyword is none.
    """
    # Not splitlines, to which form feeds and the like are ends of lines too.
    text = decode(content, place).replace("\r\n", "\n").replace("\r", "\n")
    for number, line in enumerate(text.split("\n"), start=1):
        words = line.strip()
        if not words or words == "COMMENT" or words.startswith("COMMENT "):
            continue
        keyword, equals, value = words.partition("=")
        keyword = keyword.strip()
        if not equals:
            yield Entry("", words, place, number)
            continue
        if _KEYWORD.fullmatch(keyword) is None:
            raise InputError(
                f"has {shown(keyword)} before its equals sign; expected a keyword in capitals",
                path=place,
                line=number,
            )
        yield Entry(keyword, value.strip(), place, number)


def is_xml(content: bytes) -> bool:
    """Tell whether a message is in XML and not in keyword = value notation."""
    return content.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] == b"<"
