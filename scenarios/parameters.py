"""The parameters of a kind of world as flat names and values, and their reading from text.

A kind is a frozen dataclass. Its numbers, words and tuples of them are its parameters, by the names
of the fields; those of a kind within a kind have a dot: ``stages.thrust_m_s2``.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from typing import TYPE_CHECKING, Any

from geograph.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

Scalar = bool | int | float | str | None
Value = Scalar | tuple[Scalar, ...]
"""Of a parameter: a number, a word, none, or several numbers or words."""

MOST = 1_000_000
"""Greatest count that a parameter may be: what is more fills the memory before it fails."""

_YES, _NO, _NONE = ("true", "yes", "on"), ("false", "no", "off"), "none"


def flat(kind: Any, *, hidden: Iterable[str] = ()) -> dict[str, Value]:
    """Return the parameters of a kind by name.

    Parameters
    ----------
    kind
        An instance of a dataclass.
    hidden
        Fields that are not to be set.
    """
    found: dict[str, Value] = {}
    for field in dataclasses.fields(kind):
        value = getattr(kind, field.name)
        if field.name in hidden:
            continue
        if dataclasses.is_dataclass(value):
            found |= {f"{field.name}.{name}": inner for name, inner in flat(value).items()}
        elif value is None or isinstance(value, bool | int | float | str):
            # What may be a kind of its own, and is none here, can not be given as text.
            if value is not None or _optional(kind, field.name):
                found[field.name] = value
        elif (
            isinstance(value, tuple)
            and value
            and all(isinstance(v, int | float | str) for v in value)
        ):
            found[field.name] = value
    return found


def changed(kind: Any, values: Mapping[str, Value]) -> Any:
    """Return a kind with other parameters.

    Parameters
    ----------
    kind
        An instance of a dataclass.
    values
        By the names of :func:`flat`.

    Raises
    ------
    ValueError
        If the kind refuses them.
    """
    own: dict[str, Any] = {}
    inner: dict[str, dict[str, Value]] = {}
    for name, value in values.items():
        first, _, rest = name.partition(".")
        if rest:
            inner.setdefault(first, {})[rest] = value
        else:
            own[first] = value
    for first, given in inner.items():
        own[first] = changed(getattr(kind, first), given)
    return dataclasses.replace(kind, **own)


def parse(kind: Any, name: str, text: str, *, hidden: Iterable[str] = ()) -> Value:
    """Return a parameter's value from text, of the type of its default.

    Several values are divided by colons, ``2:8``; a single one where two limits are wanted is both.

    Parameters
    ----------
    kind
        An instance of a dataclass with the defaults.
    name, text
        Of the parameter.
    hidden
        As in :func:`flat`.

    Raises
    ------
    InputError
        If there is no such parameter, or the text does not fit it.
    """
    known = flat(kind, hidden=hidden)
    if name not in known:
        raise InputError(f"unknown parameter {name!r}; {near(name, known)}")
    default = known[name]
    if text.casefold() == _NONE and _may_be_none(kind, name):
        return None
    if not isinstance(default, tuple):
        like = default if default is not None else 0.0
        return _scalar(like, name, text, none=_may_be_none(kind, name))
    parts = text.split(":")
    words = isinstance(default[0], str)
    if len(parts) == 1 and not words:
        parts *= len(default)
    if len(parts) != len(default) and not words:
        raise InputError(
            f"{name}={text}; expected {len(default)} numbers divided by colons, such as "
            f"{show(default)}, or one for all"
        )
    return tuple(_scalar(default[0], name, part) for part in parts)


def show(value: Value) -> str:
    """Return a value as the text from which :func:`parse` gives it."""
    if isinstance(value, tuple):
        return ":".join(show(part) for part in value)
    if value is None:
        return _NONE
    return str(value).lower() if isinstance(value, bool) else str(value)


def near(name: str, known: Iterable[str]) -> str:
    """Return what was expected instead of an unknown name: those like it, or else all."""
    names = list(known)
    close = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
    close += [other for other in names if name and name in other and other not in close][:3]
    return f"did you mean {' or '.join(close[:4])}?" if close else f"expected {', '.join(names)}"


def _scalar(like: Scalar, name: str, text: str, *, none: bool = False) -> Scalar:
    """Return text as a value of the type of another."""
    word = text.strip()
    if isinstance(like, bool):
        if word.casefold() in _YES or word.casefold() in _NO:
            return word.casefold() in _YES
        raise InputError(f"{name}={text}; expected true or false")
    if isinstance(like, str):
        return word
    try:
        number = float(word)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        what = "a whole number" if isinstance(like, int) else "a number"
        raise InputError(f"{name}={text}; expected {what}{' or none' if none else ''}")
    if not isinstance(like, int):
        return number
    if not number.is_integer() or not 0 <= number <= MOST:
        raise InputError(f"{name}={text}; expected a whole number from 0 to {MOST}")
    return int(number)


def _may_be_none(kind: Any, name: str) -> bool:
    first, _, rest = name.partition(".")
    return _may_be_none(getattr(kind, first), rest) if rest else _optional(kind, first)


def _optional(kind: Any, field_name: str) -> bool:
    """Tell whether a field may be a number or none, by its annotation."""
    (field,) = (field for field in dataclasses.fields(kind) if field.name == field_name)
    return str(field.type).replace(" ", "") in ("float|None", "int|None")
