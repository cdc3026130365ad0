"""XML files as elements that know their lines.

Python's own trees lose the lines, which messages need. Document types are refused: no format that
is read here has one, and entities can make a short file very long.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING
from xml.parsers import expat

from geograph.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_DEEPEST = 50


@dataclass(eq=False)
class Element:
    """One element.

    Attributes
    ----------
    name
        Without a prefix.
    attributes
        By name.
    line
        Line at which it starts.
    text
        Its own text, joined.
    children
        In order.
    """

    name: str
    attributes: dict[str, str]
    line: int
    text: str = ""
    children: list[Element] = field(default_factory=list)

    def named(self, name: str) -> Iterator[Element]:
        """Yield the children of a name."""
        return (child for child in self.children if child.name == name)

    def first(self, name: str) -> Element | None:
        """Return the first child of a name, or None."""
        return next(self.named(name), None)

    def below(self, name: str) -> Iterator[Element]:
        """Yield all elements of a name below this one, in order."""
        for child in self.children:
            if child.name == name:
                yield child
            yield from child.below(name)


def parse_xml(content: bytes, place: Path) -> Element:
    """Return the root of an XML file.

    Raises
    ------
    InputError
        If it is not well-formed, has a document type, or is nested too deeply.
    """
    parser = expat.ParserCreate()
    parser.buffer_text = True
    stack = [Element("", {}, 1)]

    def start(name: str, attributes: dict[str, str]) -> None:
        element = Element(name.rpartition(":")[2], attributes, parser.CurrentLineNumber)
        if len(stack) > _DEEPEST:
            raise InputError(
                f"elements are nested more than {_DEEPEST} deep; expected a plain document",
                path=place,
                line=element.line,
            )
        stack[-1].children.append(element)
        stack.append(element)

    def text(data: str) -> None:
        stack[-1].text += data

    def refuse(*_: object) -> None:
        raise InputError(
            "has a document type (<!DOCTYPE>), which is not read; expected a document without; "
            "remove it",
            path=place,
            line=parser.CurrentLineNumber,
        )

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: stack.pop()
    parser.CharacterDataHandler = text
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise InputError(
            f"is not well-formed XML ({expat.ErrorString(error.code)})",
            path=place,
            line=error.lineno,
        ) from None
    # Unknown encodings end in LookupError or ValueError.
    except (LookupError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"is not XML ({str(error)[:120]})", path=place) from None
    return stack[0].children[0]
