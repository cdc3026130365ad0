"""CCSDS orbit ephemeris messages (502.0-B-3) as trajectories, in either notation."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from geograph.earth import earth_fixed_from_gcrs, earth_fixed_from_teme, frame_bias
from geograph.errors import InputError
from geograph.io.ccsds_text import Entry, is_xml, kvn_entries
from geograph.io.instants import SECOND_NS
from geograph.io.messages import shown
from geograph.io.source import read_file
from geograph.io.trajectories import Span, check_order, made_dense, seconds_after
from geograph.io.xml_lines import Element, parse_xml
from geograph.sensors import Trajectory

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

_VERSION = "CCSDS_OEM_VERS"
_EARTH_FIXED = re.compile(r"ITRF([- ]?\d{2,4})?|WGS[- ]?84|ITRS")
_INERTIAL = ("GCRF", "ICRF", "EME2000", "J2000")


@dataclass
class _Segment:
    """One segment: metadata, and states as their time and the words after it."""

    line: int
    metadata: dict[str, Entry] = field(default_factory=dict)
    states: list[tuple[Entry, str, list[str]]] = field(default_factory=list)


def read_oem(
    path: Path, epoch_tai_ns: int, span_s: Span, *, content: bytes | None = None
) -> Trajectory:
    """Read an ephemeris as a trajectory in ECEF.

    Parameters
    ----------
    path
        The message, in keyword = value notation or XML. States in an ITRF or WGS 84 are taken as
        they are, those in EME2000, ICRF, GCRF and TEME turned (:mod:`geograph.earth`).
    epoch_tai_ns
        Instant from which seconds count (:mod:`geograph.io.instants`).
    span_s
        What is wanted; points farther apart than 10 s are made denser
        (:func:`geograph.io.trajectories.made_dense`), on the axes of the message.
    content
        What the file holds, if it is in an archive.

    Raises
    ------
    InputError
        If it is no such message, its frame is not known, or times do not increase.
    """
    content = read_file(path) if content is None else content
    segments = _from_xml(content, path) if is_xml(content) else _from_kvn(content, path)
    times: list[int] = []
    lines: list[int] = []
    positions: list[list[float]] = []
    frames = set()
    for segment in segments:
        frames.add(_frame(segment, path))
        system = _metadata(segment, "TIME_SYSTEM", path).system()
        for entry, text, words in segment.states:
            moment = entry.instant(text, system)
            # Segments may share the point at which they meet.
            if times and moment == times[-1] and positions[-1] == _position(entry, words):
                continue
            times.append(moment)
            positions.append(_position(entry, words))
            lines.append(entry.line)
    if len(frames) > 1:
        raise InputError(
            f"has segments in {' and '.join(sorted(frames))}; expected one frame", path=path
        )
    tai = np.array(times, dtype=np.int64)
    check_order(path, tai, np.array(lines, dtype=np.int64))
    time, position = made_dense(seconds_after(tai, epoch_tai_ns), 1e3 * np.array(positions), span_s)
    return Trajectory(time, _earth_fixed(position, time, epoch_tai_ns, frames.pop(), path))


def _metadata(segment: _Segment, keyword: str, path: Path) -> Entry:
    entry = segment.metadata.get(keyword)
    if entry is None:
        raise InputError(
            f"metadata have no {keyword}; expected it in every segment",
            path=path,
            line=segment.line,
        )
    return entry


def _frame(segment: _Segment, path: Path) -> str:
    center = _metadata(segment, "CENTER_NAME", path)
    if center.value.upper() != "EARTH":
        center.fail(f"is {shown(center.value)}; expected EARTH")
    entry = _metadata(segment, "REF_FRAME", path)
    name = entry.value.upper()
    if _EARTH_FIXED.fullmatch(name):
        return "ITRF"
    if name not in (*_INERTIAL, "TEME"):
        entry.fail(
            f"is {shown(entry.value)}; expected an ITRF, WGS84, "
            + ", ".join((*_INERTIAL, "TEME"))
            + "; have the ephemeris written in one of these"
        )
    return name


def _position(entry: Entry, words: list[str]) -> list[float]:
    return [entry.number(word) for word in words[:3]]


def _earth_fixed(
    position_m: NDArray[np.float64],
    time_s: NDArray[np.float64],
    epoch_tai_ns: int,
    frame: str,
    path: Path,
) -> NDArray[np.float64]:
    if frame == "ITRF":
        return position_m
    tai = epoch_tai_ns + np.round(time_s * SECOND_NS).astype(np.int64)
    if frame == "TEME":
        turn = earth_fixed_from_teme(tai, path, "ccsds")
    else:
        turn = earth_fixed_from_gcrs(tai, path, "ccsds")
        if frame in ("EME2000", "J2000"):
            turn = turn @ frame_bias(path, "ccsds").T
    return np.asarray(np.einsum("nij,nj->ni", turn, position_m))


def _from_kvn(content: bytes, path: Path) -> list[_Segment]:
    entries = kvn_entries(content, path)
    first = next(entries, None)
    if first is None or first.keyword != _VERSION:
        raise InputError(
            f"does not begin with {_VERSION}; expected a CCSDS orbit ephemeris message",
            path=path,
            line=1 if first is None else first.line,
        )
    segments: list[_Segment] = []
    section = "header"
    for entry in entries:
        if entry.value == "META_START" and not entry.keyword:
            segments.append(_Segment(entry.line))
            section = "meta"
        elif entry.value == "META_STOP" and section == "meta":
            section = "data"
        elif entry.value == "COVARIANCE_START" and section == "data":
            section = "covariance"
        elif entry.value == "COVARIANCE_STOP" and section == "covariance":
            section = "data"
        elif section == "meta" and entry.keyword:
            segments[-1].metadata[entry.keyword] = entry
        elif section == "data" and not entry.keyword:
            words = entry.value.split()
            if len(words) not in (7, 10):
                entry.fail(
                    f"has {len(words)} words; expected a time, a position, a velocity and perhaps "
                    "an acceleration"
                )
            segments[-1].states.append((entry, words[0], words[1:]))
        elif section not in ("header", "covariance"):
            entry.fail(f"is {shown(entry.value)}; expected a state, or META_START")
    if section in ("meta", "covariance"):
        raise InputError(
            f"ends within {'metadata' if section == 'meta' else 'covariances'}; expected "
            f"{'META_STOP' if section == 'meta' else 'COVARIANCE_STOP'}; is the file cut short?",
            path=path,
            line=segments[-1].line,
        )
    return segments


def _from_xml(content: bytes, path: Path) -> list[_Segment]:
    root = parse_xml(content, path)
    messages = list(root.named("oem")) if root.name == "ndm" else [root]
    if not messages or any(message.name != "oem" for message in messages):
        raise InputError(
            f"is XML of <{root.name[:40]}>; expected a CCSDS orbit ephemeris message, <oem>",
            path=path,
            line=root.line,
        )
    segments = []
    for element in (found for message in messages for found in message.below("segment")):
        segment = _Segment(element.line)
        for part in element.named("metadata"):
            segment.metadata |= {
                child.name: Entry(child.name, child.text.strip(), path, child.line)
                for child in part.children
            }
        for part in element.named("data"):
            segment.states.extend(_state(child, path) for child in part.named("stateVector"))
        segments.append(segment)
    return segments


def _state(element: Element, path: Path) -> tuple[Entry, str, list[str]]:
    words = {child.name: child.text.strip() for child in element.children}
    for name in ("EPOCH", "X", "Y", "Z"):
        if name not in words:
            raise InputError(f"state has no {name}; expected it", path=path, line=element.line)
    entry = Entry("stateVector", "", path, element.line)
    return entry, words["EPOCH"], [words["X"], words["Y"], words["Z"]]
