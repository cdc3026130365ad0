"""Pieces of error messages: values shown short and on one line, suggestions for misspelt names."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

_LONGEST = 40


def shown(value: object) -> str:
    """Return a value as it may stand in a message: quoted, printable, at most 40 characters.

    >>> shown("twelve"), shown("a" * 100)
    ("'twelve'", "'aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa...'")
    """
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) >= 10**30:
        # Python refuses to print integers of thousands of digits.
        return "a huge integer"
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, str) and len(value) > _LONGEST:
        value = value[: _LONGEST - 4] + "..."
    text = ascii(value) if not str(value).isprintable() else repr(value)
    return text if len(text) <= 2 * _LONGEST else text[: _LONGEST - 4] + "..."


def plain(name: str) -> str:
    """Return a name as it stands in the place of a message: unquoted where that is harmless."""
    return name if name.isprintable() and 0 < len(name) <= _LONGEST else shown(name)


def listed(names: Iterable[str]) -> str:
    """Return names in a row, at most twelve of them.

    >>> listed(["a", "b"])
    'a, b'
    """
    row = [plain(name) for name in names]
    return ", ".join(row[:12]) + (f" and {len(row) - 12} more" if len(row) > 12 else "")


def expected_one_of(given: str, options: Iterable[str]) -> str:
    """Return what was expected in place of ``given``, with the nearest option if one is near.

    >>> expected_one_of("azimut_deg", ["azimuth_deg", "time_s"])
    'did you mean azimuth_deg? expected one of azimuth_deg, time_s'
    >>> expected_one_of("x", ["azimuth_deg", "time_s"])
    'expected one of azimuth_deg, time_s'
    """
    names = list(options)
    expected = f"expected one of {listed(names)}" if names else "expected nothing"
    near = nearest(given, names)
    return expected if near is None else f"did you mean {plain(near)}? {expected}"


def nearest(given: str, options: Iterable[str]) -> str | None:
    """Return the option that a misspelt name most likely means, or None."""
    by_folded = {name.casefold(): name for name in options}
    # Long names are cut: the comparison takes the square of the length.
    near = difflib.get_close_matches(given[:80].strip().casefold(), by_folded, n=1, cutoff=0.6)
    return by_folded[near[0]] if near else None
