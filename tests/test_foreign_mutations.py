"""Whatever is done to a file of another format, reading it succeeds or says in one line why not."""

from __future__ import annotations

import random
import re
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from made_pass import EPOCH, STATION_CSV, sightings, tdm, tdm_xml, utc
from test_io_mutations import mutilated
from test_mapped import MAPPING, NMEA, german, sentence
from test_optical import GOOD, MPC
from test_stations import TOML, earth_fixed_states, gpx, oem, tle
from test_tdm import DIFFERENCED

from geograph.errors import InputError
from geograph.io import (
    ImportOptions,
    read_iod,
    read_mapped,
    read_mpc,
    read_stations,
    read_tdm,
    read_uk,
)
from geograph.io.instants import from_datetime
from geograph.io.trajectories import read_trajectory

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

START = from_datetime(EPOCH)
STATIONS = STATION_CSV + "4353,52.1,4.4,20\n500,52.1,4.4,20\n"
ROWS = sightings(step_s=30.0)
RADEC = "ANGLE_TYPE = RADEC\nREFERENCE_FRAME = EME2000"
UK = "240010143532403201905000000000051103000000+300000003005\n"
LOG = "".join(
    sentence("DFBRG", time, "5200.3000", "N", "01030.0000", "W", "350.5", 20, 2.5, "010624")
    for time in ("120000.50", "120001.50")
)


def options() -> ImportOptions:
    from pathlib import Path
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as folder:
        (Path(folder) / "s.csv").write_text(STATIONS)
        stations = read_stations(Path(folder) / "s.csv")
    return ImportOptions(stations=stations, sigma_deg=0.1, sigma_s=1e-6, sigma_hz=1.0)


OPTIONS = options()


def mapped(path: Path) -> object:
    if path.suffix == ".log":
        return read_mapped(path, NMEA, OPTIONS)
    mapping = path.parent / "m.toml"
    if not mapping.exists():
        mapping.write_text(MAPPING)
    return read_mapped(path, mapping, OPTIONS)


def mapping_itself(path: Path) -> object:
    table = path.parent / "table.txt"
    if not table.exists():
        table.write_text(german())
    return read_mapped(table, path, OPTIONS)


WORD = re.compile(r"[^\s<>=,;]+")
WORDS = [
    *(
        "NaN",
        "Infinity",
        "1e400",
        "1" + "0" * 30,
        "1e29",
        "0000-00-00T00:00:00",
        "2024-366T00:00:00",
    ),
    *("2016-12-31T23:59:60.5", "9999-12-31T23:59:59.999999999", "&lol9;", "&#0;", "]]>", "<!--"),
    *(
        "<!DOCTYPE a [<!ENTITY x 'y'>]>",
        "UT1",
        "1,2",
        "360",
        "-90",
        "90.0000001",
        "%Y",
        "\x10",
        "²",
    ),
    *("9" * 400, "\x00", "\u2028", "'", "{", "*00", "PARTICIPANT_1", "١"),
]


def with_other_words(content: bytes, seed: int) -> bytes:
    """Put other words in the place of some, or one of the file's own in that of another."""
    rng = random.Random(seed)
    text = content.decode()
    for _ in range(rng.choice([1, 1, 2])):
        spans = [found.span() for found in WORD.finditer(text)]
        if not spans:
            break
        (start, end), (first, last) = rng.choice(spans), rng.choice(spans)
        text = text[:start] + rng.choice([*WORDS, text[first:last]]) + text[end:]
    return text.encode()


def ephemeris_xml() -> str:
    states = "".join(
        f"<stateVector><EPOCH>{utc(time)}</EPOCH>"
        + "".join(
            f"<{axis}>{value / 1e3:.6f}</{axis}>" for axis, value in zip("XYZ", place, strict=True)
        )
        + "</stateVector>\n"
        for time, place, _ in earth_fixed_states(90.0)
    )
    return (
        '<oem id="CCSDS_OEM_VERS" version="2.0"><body><segment>\n<metadata><CENTER_NAME>EARTH'
        "</CENTER_NAME><REF_FRAME>EME2000</REF_FRAME>\n<TIME_SYSTEM>TT</TIME_SYSTEM></metadata>"
        f"\n<data>{states}</data></segment></body></oem>\n"
    )


CASES: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "a.tdm": (tdm(ROWS), lambda p: read_tdm(p, OPTIONS)),
    "b.tdm": (DIFFERENCED, lambda p: read_tdm(p, OPTIONS)),
    "c.tdm": (tdm(ROWS).replace("ANGLE_TYPE = AZEL", RADEC), lambda p: read_tdm(p, OPTIONS)),
    "a.xml": (tdm_xml(ROWS), lambda p: read_tdm(p, OPTIONS)),
    "a.iod": (f"{GOOD}\n{GOOD.replace(' 65 ', ' 14 ')}\n", lambda p: read_iod(p, OPTIONS)),
    "a.uk": (UK, lambda p: read_uk(p, OPTIONS)),
    "a.mpc": (f"{MPC}\n{MPC}\n", lambda p: read_mpc(p, OPTIONS)),
    "a.txt": (german(), mapped),
    "a.log": (LOG, mapped),
    "map.toml": (MAPPING, mapping_itself),
    "s.toml": (TOML, read_stations),
    "s.csv": (STATIONS, read_stations),
    "a.gpx": (gpx(), lambda p: read_trajectory(p, START, (0.0, 60.0))),
    "a.tle": (tle(), lambda p: read_trajectory(p, START, (0.0, 60.0))),
    "a.oem": (
        oem("GCRF", earth_fixed_states(90.0)),
        lambda p: read_trajectory(p, START, (0.0, 60.0)),
    ),
    "oem.xml": (ephemeris_xml(), lambda p: read_trajectory(p, START, (0.0, 60.0))),
}


@pytest.mark.parametrize("name", list(CASES))
def test_the_whole_files_are_read(tmp_path: Path, name: str) -> None:
    text, read = CASES[name]
    (tmp_path / name).write_text(text)
    assert read(tmp_path / name) is not None


@pytest.mark.parametrize("name", list(CASES))
@settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(seed=st.integers(0, 2**63))
def test_mutilated_files(tmp_path: Path, name: str, seed: int) -> None:
    text, read = CASES[name]
    if seed % 2:
        content = with_other_words(text.encode(), seed)
    else:
        content = mutilated({"x": text.encode()}, seed)["x"]
    (tmp_path / name).write_bytes(content)
    message = ""
    try:
        read(tmp_path / name)
    except InputError as error:
        message = str(error)
    assert message == "" or message.isprintable()
    assert len(message) < 1000


def test_the_seeds_do_mutilate() -> None:
    text = tdm(ROWS).encode()
    changed = [mutilated({"x": text}, random.Random(n).getrandbits(60))["x"] for n in range(20)]
    assert sum(content != text for content in changed) > 15
