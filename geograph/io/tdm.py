"""CCSDS tracking data messages (503.0-B-2), in keyword = value notation or XML.

Angles are azimuth (clockwise from north) and elevation, or right ascension and declination, which
become azimuth and elevation at the station (:mod:`geograph.earth`). Differenced data, PATH_2
less PATH_1, are differences of arrival time and of received frequency of the sensor at the end of
PATH_2 against that at the end of PATH_1.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from geograph.errors import InputError
from geograph.io.instants import SECOND_NS
from geograph.io.messages import listed, shown
from geograph.io.rows import Difference, ImportOptions, Sighting
from geograph.io.sightings import recording_of
from geograph.io.stations import matched
from geograph.io.tdm_keywords import FRAMES, PASSED_OVER, flags_to_ignore, why_not
from geograph.io.tdm_segments import Record, Segment, read_segments

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from geograph.io.instants import TimeSystem
    from geograph.recording import Recording


@dataclass
class _Collected:
    """What has been read of the files so far."""

    sightings: list[Sighting] = field(default_factory=list)
    differences: list[Difference] = field(default_factory=list)
    objects: dict[str, Record] = field(default_factory=dict)


def read_tdm(
    paths: Path | str | Sequence[Path | str],
    options: ImportOptions | None = None,
    *,
    ignore: Collection[str] = (),
    target: str | None = None,
) -> Recording:
    """Read tracking data messages of one object as one recording.

    Parameters
    ----------
    paths
        Files.
    options
        What they do not say: stations, sigmas, priors.
    ignore
        Keywords of records to be passed over although they would be refused, such as ``"RANGE"``;
        also a type of angles, ``"XSYE"``.
    target
        The participant to be located, where the files track several.

    Raises
    ------
    InputError
        If a file is no such message or holds what cannot be used; see docs/formats.md.
    """
    files = [Path(paths)] if isinstance(paths, (str, Path)) else [Path(path) for path in paths]
    chosen = ImportOptions() if options is None else options
    collected = _Collected()
    for file in files:
        segments = read_segments(file)
        carriers = _carriers(segments)
        records = (record for segment in segments for record in segment.records)
        keywords = tuple(dict.fromkeys(record.entry.keyword for record in records))
        for segment in segments:
            reader = _Reader(
                segment,
                chosen,
                carriers=carriers,
                keywords=keywords,
                ignore=frozenset(ignore),
                target=target,
            )
            reader.into(collected)
    if len(collected.objects) > 1:
        name, record = list(collected.objects.items())[1]
        record.entry.fail(
            f"is of {shown(name)}, after others of {shown(next(iter(collected.objects)))}; "
            "expected one object; name it (--target, or target=)"
        )
    if not collected.sightings and not collected.differences:
        of = f" of {shown(target)}" if target is not None else ""
        raise InputError(
            f"has no angles or differences{of} to be read; expected ANGLE_1, DOR, VLBI_DELAY or a "
            "differenced RECEIVE_FREQ",
            path=files[0],
        )
    return recording_of([*collected.sightings, *collected.differences], chosen, extra="ccsds")


def _carriers(segments: Sequence[Segment]) -> dict[str, list[tuple[int, float]]]:
    """Return the frequencies that participants transmit, by name: instants, hertz."""
    found: dict[str, list[tuple[int, float]]] = {}
    for segment in segments:
        for record in segment.records:
            keyword, _, number = record.entry.keyword.rpartition("_")
            name = segment.metadata.get(f"PARTICIPANT_{number}")
            if keyword == "TRANSMIT_FREQ" and name is not None:
                instant = record.entry.instant(record.time, _system(segment))
                found.setdefault(name.value, []).append(
                    (instant, record.entry.number(record.value))
                )
    return found


def _system(segment: Segment) -> TimeSystem:
    entry = segment.metadata.get("TIME_SYSTEM")
    if entry is None:
        raise InputError(
            "metadata have no TIME_SYSTEM; expected UTC, TAI, TT or GPS",
            path=segment.place,
            line=segment.line,
        )
    return entry.system()


class _Reader:
    """Reads one segment."""

    def __init__(
        self,
        segment: Segment,
        options: ImportOptions,
        *,
        carriers: dict[str, list[tuple[int, float]]],
        keywords: tuple[str, ...],
        ignore: frozenset[str],
        target: str | None,
    ) -> None:
        self.segment, self.options, self.carriers = segment, options, carriers
        self.keywords, self.ignore, self.target = keywords, ignore, target
        self.metadata = segment.metadata

    def into(self, collected: _Collected) -> None:
        """Add what the segment measured."""
        system = _system(self.segment)
        angles: dict[int, dict[str, Record]] = {}
        differenced = self._word("MODE") == "SINGLE_DIFF"
        for record in self.segment.records:
            keyword = record.entry.keyword
            if keyword in self.ignore or PASSED_OVER.fullmatch(keyword):
                continue
            if keyword in ("ANGLE_1", "ANGLE_2") and self._word("ANGLE_TYPE") in self.ignore:
                continue
            time = record.entry.instant(record.time, system)
            if keyword in ("ANGLE_1", "ANGLE_2") and not differenced:
                if keyword in angles.setdefault(time, {}):
                    record.entry.fail(f"is there twice at {shown(record.time)}; expected it once")
                angles[time][keyword] = record
            elif differenced and keyword in ("DOR", "VLBI_DELAY", "RECEIVE_FREQ"):
                self._add_difference(record, time, collected)
            else:
                self._refuse(record)
        if angles:
            self._add_angles(angles, collected)

    def _fail(self, message: str) -> NoReturn:
        raise InputError(message, path=self.segment.place, line=self.segment.line)

    def _word(self, keyword: str) -> str | None:
        entry = self.metadata.get(keyword)
        return None if entry is None else entry.value.upper()

    def _number(self, keyword: str) -> float:
        entry = self.metadata.get(keyword)
        return 0.0 if entry is None else entry.number()

    def _refuse(self, record: Record) -> NoReturn:
        keyword = record.entry.keyword
        reason = why_not(keyword, differenced=self._word("MODE") == "SINGLE_DIFF")
        if reason is not None:
            flags = flags_to_ignore(self.keywords, self.ignore)
            record.entry.fail(
                f"{keyword[:40]} cannot be used: {reason}; to read what else is there: {flags}"
            )
        mode = self._word("MODE")
        record.entry.fail(
            f"{shown(keyword)} with MODE {shown(mode) if mode else 'missing'} is not read; "
            "expected ANGLE_1 and ANGLE_2, or with MODE = SINGLE_DIFF DOR, VLBI_DELAY or "
            f"RECEIVE_FREQ; or ignore it (--ignore {keyword[:40]})"
        )

    def _path(self, keyword: str) -> list[tuple[str, str]]:
        """Return the participants along a path, as numbers and names."""
        entry = self.metadata[keyword]
        path = []
        for word in entry.value.split(","):
            name = self.metadata.get(f"PARTICIPANT_{word.strip()}")
            if name is None:
                entry.fail(f"names participant {shown(word)}, of which there is no PARTICIPANT_n")
            path.append((word.strip(), name.value))
        if len(path) < 2:
            entry.fail(f"is {shown(entry.value)}; expected two participants or more, as in 2,1")
        return path

    def _participants(self) -> tuple[str, str, float]:
        """Return the object and the sensor of angles, and the delay before its electronics."""
        if "PATH" in self.metadata:
            path = self._path("PATH")
            (_, seen), (number, sensor) = path[-2], path[-1]
            return seen, sensor, self._number(f"RECEIVE_DELAY_{number}")
        names = {
            key.rpartition("_")[2]: entry.value
            for key, entry in self.metadata.items()
            if re.fullmatch(r"PARTICIPANT_\d", key)
        }
        known = {
            number: name
            for number, name in names.items()
            if matched(name, self.options.stations) is not None
        }
        if len(known) != 1:
            self._fail(
                f"segment has no PATH and {len(known)} of its participants "
                f"({listed(names.values())}) are in the station list; expected PATH, or exactly "
                "one station among them"
            )
        ((number, sensor),) = known.items()
        others = [name for other, name in names.items() if other != number]
        return (others[0] if others else "UNKNOWN"), sensor, self._number(f"RECEIVE_DELAY_{number}")

    def _wanted(self, seen: str, record: Record, collected: _Collected) -> bool:
        if self.target is not None and seen != self.target:
            return False
        collected.objects.setdefault(seen, record)
        return True

    def _add_angles(self, angles: dict[int, dict[str, Record]], collected: _Collected) -> None:
        seen, sensor, delay = self._participants()
        if not self._wanted(seen, next(iter(next(iter(angles.values())).values())), collected):
            return
        self._check_time_tags()
        celestial, equinox = self._angle_type()
        first_add, second_add = self._corrections(celestial=celestial)
        for time, pair in angles.items():
            if "ANGLE_1" not in pair or ("ANGLE_2" not in pair and celestial):
                record = next(iter(pair.values()))
                record.entry.fail(
                    f"stands alone at {shown(record.time)}; expected "
                    f"{'ANGLE_1' if 'ANGLE_2' in pair else 'ANGLE_2'} of the same time"
                )
            one, two = pair["ANGLE_1"], pair.get("ANGLE_2")
            collected.sightings.append(
                Sighting(
                    tai_ns=time - round(delay * SECOND_NS),
                    sensor=sensor,
                    first_rad=_angle(one, first_add, 360.0),
                    second_rad=np.nan if two is None else _angle(two, second_add, 90.0),
                    kind="radec" if celestial else "azel",
                    equinox=equinox,
                    place=one.entry.place,
                    line=one.entry.line,
                )
            )

    def _check_time_tags(self) -> None:
        if self._word("TIMETAG_REF") == "TRANSMIT":
            self.metadata["TIMETAG_REF"].fail(
                "is TRANSMIT; expected measurements tagged with the time of reception"
            )

    def _angle_type(self) -> tuple[bool, float]:
        """Return whether angles are right ascension and declination, and of which equinox."""
        entry = self.metadata.get("ANGLE_TYPE")
        if entry is None:
            self._fail("metadata have no ANGLE_TYPE; expected AZEL or RADEC")
        kind = entry.value.upper()
        if kind == "AZEL":
            return False, np.nan
        if kind in ("XEYN", "XSYE"):
            entry.fail(
                f"{kind} is not read: where the angles of such a mount count from is settled "
                "between its parties and not by the standard; convert them to AZEL, or read what "
                f"else is there (--ignore {kind})"
            )
        if kind != "RADEC":
            entry.fail(f"is {shown(entry.value)}; expected AZEL or RADEC")
        frame = self.metadata.get("REFERENCE_FRAME")
        if frame is None:
            entry.fail("is RADEC without REFERENCE_FRAME; expected EME2000 or ICRF beside it")
        if frame.value.upper() not in FRAMES:
            frame.fail(
                f"{shown(frame.value)} is not read; expected one of {listed(FRAMES)}; right "
                "ascensions of date or of rotating axes have to be converted first"
            )
        return True, FRAMES[frame.value.upper()]

    def _corrections(self, *, celestial: bool) -> tuple[float, float]:
        """Return what is still to be added to the angles, degrees."""
        for keyword in ("CORRECTION_ABERRATION_YEARLY", "CORRECTION_ABERRATION_DIURNAL"):
            if celestial and self._number(keyword) != 0.0:
                self.metadata[keyword].fail(
                    "is not 0; expected directions against stars, to whose catalogue places no "
                    "aberration was applied; convert them back, and remove it"
                )
        return self._to_add("CORRECTION_ANGLE_1"), self._to_add("CORRECTION_ANGLE_2")

    def _to_add(self, keyword: str) -> float:
        """Return a correction that was not applied yet, else 0."""
        value = self._number(keyword)
        if value == 0.0:
            return 0.0
        applied = self._word("CORRECTIONS_APPLIED")
        if applied not in ("YES", "NO"):
            self.metadata[keyword].fail("is given without CORRECTIONS_APPLIED; expected YES or NO")
        return 0.0 if applied == "YES" else value

    def _add_difference(self, record: Record, time: int, collected: _Collected) -> None:
        for keyword in ("PATH_1", "PATH_2"):
            if keyword not in self.metadata:
                self._fail(f"metadata have no {keyword}; expected both with MODE = SINGLE_DIFF")
        first, second = self._path("PATH_1"), self._path("PATH_2")
        if first[:-1] != second[:-1] or first[-1] == second[-1]:
            self.metadata["PATH_2"].fail(
                f"is {shown(self.metadata['PATH_2'].value)} against "
                f"{shown(self.metadata['PATH_1'].value)}; "
                "expected paths that differ in the receiving participant alone"
            )
        (_, seen), reference, sensor = first[-2], first[-1], second[-1]
        if not self._wanted(seen, record, collected):
            return
        self._check_time_tags()
        for receiver, _ in (reference, sensor):
            if self._number(f"RECEIVE_DELAY_{receiver}") != 0.0:
                self.metadata[f"RECEIVE_DELAY_{receiver}"].fail(
                    "is not 0; whether it is in the difference is not settled by the standard; "
                    "take it out, and remove it"
                )
        value = record.entry.number(record.value)
        carrier, sigma, unit = np.nan, self.options.sigma_s, "s"
        if record.entry.keyword == "RECEIVE_FREQ":
            value += self._number("FREQ_OFFSET") + self._to_add("CORRECTION_RECEIVE")
            carrier = self._carrier(seen, time, record)
            sigma, unit = self.options.sigma_hz, "hz"
            time += self._to_middle()
        if sigma is None or not sigma > 0.0:
            record.entry.fail(
                f"has no sigma in this format; give sigma_{unit} (--sigma-{unit}), above 0"
            )
        collected.differences.append(
            Difference(
                tai_ns=time,
                sensor=sensor[1],
                reference=reference[1],
                value=value,
                sigma=sigma,
                carrier_hz=carrier,
                place=record.entry.place,
                line=record.entry.line,
            )
        )

    def _to_middle(self) -> int:
        """Return nanoseconds from a time tag to the middle of its integration interval."""
        side = {"START": 0.5, "END": -0.5}.get(self._word("INTEGRATION_REF") or "", 0.0)
        return round(side * self._number("INTEGRATION_INTERVAL") * SECOND_NS)

    def _carrier(self, seen: str, time: int, record: Record) -> float:
        """Return the frequency that the object emitted at a time, or first if that is later."""
        if self.options.carrier_hz is not None:
            carrier = self.options.carrier_hz
        elif seen in self.carriers:
            before = [pair for pair in self.carriers[seen] if pair[0] <= time]
            carrier = max(before)[1] if before else min(self.carriers[seen])[1]
        else:
            record.entry.fail(
                f"needs the frequency that {shown(seen)} emits; expected TRANSMIT_FREQ in the "
                "message, or carrier_hz (--carrier-hz)"
            )
        if not carrier > 0.0:
            record.entry.fail(f"has a carrier of {carrier:g} Hz; expected above 0")
        return carrier


def _angle(record: Record, correction_deg: float, limit_deg: float) -> float:
    """Return an angle in radians, its limits being those of what was written."""
    value = record.entry.number(record.value)
    if limit_deg == 90.0:
        value += correction_deg - (360.0 if value > 180.0 else 0.0)
        correction_deg = 0.0
    if not abs(value) <= limit_deg:
        record.entry.fail(
            f"is {shown(record.value)}; expected {-limit_deg:g} to {limit_deg:g} degrees; an "
            "elevation beyond the zenith is written with the opposite azimuth"
            if limit_deg == 90.0
            else f"is {shown(record.value)}; expected -360 to 360 degrees"
        )
    return float(np.radians(value + correction_deg))
