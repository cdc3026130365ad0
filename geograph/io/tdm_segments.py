"""CCSDS tracking data messages as segments: metadata and records, from either notation."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from geograph.errors import InputError
from geograph.io.ccsds_text import Entry, is_xml, kvn_entries
from geograph.io.messages import shown
from geograph.io.source import read_file
from geograph.io.xml_lines import Element, parse_xml

if TYPE_CHECKING:
    from pathlib import Path

_VERSION = "CCSDS_TDM_VERS"


@dataclass(frozen=True, eq=False)
class Record:
    """One tracking data record.

    Attributes
    ----------
    entry
        Its keyword, and where it stands.
    time, value
        The two parts of its value, as written.
    """

    entry: Entry
    time: str
    value: str


@dataclass(frozen=True, eq=False)
class Segment:
    """One segment of a message.

    Attributes
    ----------
    place, line
        The file, and the line at which it starts.
    metadata
        Entries by keyword.
    records
        In order.
    """

    place: Path
    line: int
    metadata: dict[str, Entry] = field(default_factory=dict)
    records: list[Record] = field(default_factory=list)


def read_segments(place: Path) -> list[Segment]:
    """Return the segments of a tracking data message in either notation.

    Raises
    ------
    InputError
        If it is none.
    """
    content = read_file(place)
    segments = _from_xml(content, place) if is_xml(content) else _from_kvn(content, place)
    if not any(segment.records for segment in segments):
        raise InputError("has no tracking data; expected at least one record", path=place)
    return segments


def _add_metadata(segment: Segment, entry: Entry) -> None:
    if entry.keyword in segment.metadata:
        entry.fail("is there twice; expected each keyword once in a segment's metadata")
    segment.metadata[entry.keyword] = entry


def _from_kvn(content: bytes, place: Path) -> list[Segment]:
    entries = kvn_entries(content, place)
    first = next(entries, None)
    if first is None or first.keyword != _VERSION:
        raise InputError(
            f"does not begin with {_VERSION}; expected a CCSDS tracking data message",
            path=place,
            line=1 if first is None else first.line,
        )
    segments: list[Segment] = []
    section = "header"
    # What must come before each delimiter, and what it begins.
    steps = {
        "META_START": (("header", "between"), "meta"),
        "META_STOP": (("meta",), "after meta"),
        "DATA_START": (("after meta",), "data"),
        "DATA_STOP": (("data",), "between"),
    }
    for entry in entries:
        if not entry.keyword:
            if entry.value not in steps:
                entry.fail(f"is {shown(entry.value)}; expected keyword = value")
            before, section_after = steps[entry.value]
            if section not in before:
                entry.fail(f"{entry.value} is out of place; expected META_START, META_STOP, "
                           "DATA_START and DATA_STOP in turn")  # fmt: skip
            section = section_after
            if entry.value == "META_START":
                segments.append(Segment(place, entry.line))
        elif section == "meta":
            _add_metadata(segments[-1], entry)
        elif section == "data":
            words = entry.value.split()
            if len(words) != 2:
                entry.fail(f"is {shown(entry.value)}; expected a time (2024-03-20T19:04:00.5) "
                           "and a measurement")  # fmt: skip
            segments[-1].records.append(Record(entry, words[0], words[1]))
        elif section != "header":
            entry.fail("is outside of metadata and data; expected META_START before it")
    if section not in ("between", "header"):
        raise InputError(
            "ends within a segment; expected DATA_STOP; is the file cut short?",
            path=place,
            line=segments[-1].line,
        )
    return segments


def _from_xml(content: bytes, place: Path) -> list[Segment]:
    root = parse_xml(content, place)
    if root.name == "ndm":
        messages = list(root.named("tdm"))
    else:
        messages = [root] if root.name == "tdm" else []
    if not messages:
        raise InputError(
            f"is XML of <{root.name[:40]}>; expected a CCSDS tracking data message, <tdm>",
            path=place,
            line=root.line,
        )
    segments = []
    for message in messages:
        for element in message.below("segment"):
            segment = Segment(place, element.line)
            for part in element.named("metadata"):
                for child in part.children:
                    if child.name != "COMMENT":
                        _add_metadata(segment, _entry(child, place))
            for part in element.named("data"):
                segment.records.extend(
                    _observation(child, place) for child in part.named("observation")
                )
            segments.append(segment)
    return segments


def _entry(element: Element, place: Path) -> Entry:
    return Entry(element.name, element.text.strip(), place, element.line)


def _observation(element: Element, place: Path) -> Record:
    epochs = list(element.named("EPOCH"))
    others = [child for child in element.children if child.name not in ("EPOCH", "COMMENT")]
    if len(epochs) != 1 or len(others) != 1:
        raise InputError(
            "observation has not one EPOCH and one measurement; expected both",
            path=place,
            line=element.line,
        )
    entry = _entry(others[0], place)
    return Record(entry, epochs[0].text.strip(), entry.value)
