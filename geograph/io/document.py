"""The TOML header as a document: values with their types checked, errors with their lines."""

from __future__ import annotations

import math
import re
import tomllib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NoReturn

from geograph.errors import InputError
from geograph.io.messages import expected_one_of, plain, shown
from geograph.io.source import decode

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

KeyPath = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Document:
    """A parsed TOML file.

    Parameters
    ----------
    place
        The file, for messages.
    text
        Its text, from which lines for messages are found.
    root
        The top table.
    """

    place: Path
    text: str
    root: dict[str, Any]

    @classmethod
    def parse(cls, content: bytes, place: Path) -> Document:
        """Return the document in a file's bytes; raises InputError if they are not TOML."""
        text = decode(content, place)
        if not text.strip():
            raise InputError("is empty; expected a recording's header in TOML", path=place)
        try:
            return cls(place, text, tomllib.loads(text.replace("\r\n", "\n")))
        except RecursionError:
            raise InputError("is nested too deeply; expected plain tables", path=place) from None
        # Integers of thousands of digits are a plain ValueError.
        except ValueError as error:
            _fail_syntax(str(error), text, place)

    def fail(self, path: KeyPath, message: str) -> NoReturn:
        """Raise InputError at a key."""
        raise InputError(
            message,
            path=self.place,
            line=_locate(self.text, path),
            column=".".join(plain(part) for part in path) if path else None,
        )

    def table(self, path: KeyPath, value: object, known: Iterable[str] | None) -> dict[str, Any]:
        """Return a value that must be a table, with none but known keys (None: any)."""
        if not isinstance(value, dict):
            self.fail(path, f"is {shown(value)}; expected a table, [{'.'.join(path)}]")
        if known is not None:
            options = list(known)
            for key in value:
                if key not in options:
                    self.fail(
                        (*path, key), f"unknown key {shown(key)}; {expected_one_of(key, options)}"
                    )
        return value

    def number(
        self,
        path: KeyPath,
        value: object,
        *,
        low: float = -math.inf,
        high: float = math.inf,
        infinite: bool = False,
    ) -> float:
        """Return a value that must be a finite number from ``low`` to ``high``."""
        expected = "expected a finite number" if not infinite else "expected a number or inf"
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            self.fail(path, f"is {shown(value)}; {expected}")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
            infinite = False
        if math.isnan(number) or (math.isinf(number) and not infinite):
            self.fail(path, f"is {shown(value)}; {expected}")
        if not low <= number <= high:
            self.fail(path, f"is {shown(value)}; {expected} from {low:.6g} to {high:.6g}")
        return number

    def text_of(self, path: KeyPath, value: object) -> str:
        """Return a value that must be text."""
        if not isinstance(value, str):
            self.fail(path, f"is {shown(value)}; expected text in quotes")
        return value

    def choice(self, path: KeyPath, value: object, options: Iterable[str]) -> str:
        """Return a value that must be one of some words."""
        names = list(options)
        text = self.text_of(path, value)
        if text not in names:
            self.fail(path, f"unknown {path[-1]} {shown(text)}; {expected_one_of(text, names)}")
        return text


def _fail_syntax(reason: str, text: str, place: Path) -> NoReturn:
    found = re.search(r"\s*\(at line (\d+), column \d+\)", reason)
    line = int(found[1]) if found else None
    reason = reason[: found.start()] if found else reason.replace(" (at end of document)", "")
    # The parser names the keys of a table that is declared twice as a tuple.
    twice = re.search(r"Cannot declare \('sensors', (['\"])(.*)\1\) twice", reason)
    if twice:
        first = _locate(text, ("sensors", twice[2]))
        before = f" (first on line {first})" if first is not None else ""
        raise InputError(
            f"duplicate sensor {shown(twice[2])}{before}; expected one table for each sensor; "
            "rename or remove one",
            path=place,
            line=line,
            column=f"sensors.{plain(twice[2])}",
        )
    raise InputError(
        f"is not valid TOML ({reason[:120]}); correct it there or just before",
        path=place,
        line=line,
    )


_KEY = re.compile(r"""\s*((?:[A-Za-z0-9_.\-\s]|"(?:[^"\\]|\\.)*"|'[^']*')+?)\s*=""")


def _locate(text: str, path: KeyPath) -> int | None:
    """Return the line that sets a key, or that of the nearest table around it.

    The parser keeps no lines, so this reads the file once more, line by line; it is only for
    messages, and a line within a long string may mislead it.
    """
    best, best_length = None, 0
    table: KeyPath = ()
    for number, line in enumerate(text.splitlines(), start=1):
        stripped = line.strip()
        if stripped.startswith("["):
            here = table = _keys_of(stripped)
        elif found := _KEY.match(line):
            here = table + _keys_of(f"{found[1]} = 0")
        else:
            continue
        common = here == path[: len(here)]
        if common and len(here) > best_length:
            best, best_length = number, len(here)
    return best


def _keys_of(line: str) -> KeyPath:
    try:
        node: Any = tomllib.loads(line)
    except (ValueError, RecursionError):
        return ("",)
    keys: list[str] = []
    while isinstance(node, (dict, list)) and node:
        if isinstance(node, dict):
            key = next(iter(node))
            keys.append(key)
            node = node[key]
        else:
            node = node[0]
    return tuple(keys)
