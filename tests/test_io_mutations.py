"""Whatever is done to a recording, reading it succeeds or says in one line what is wrong."""

from __future__ import annotations

import io
import random
import shutil
import zipfile
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recordings import FULL_HEADER, all_files, write_files

import geograph as gg
from geograph.errors import InputError
from geograph.io import read_ecsv

if TYPE_CHECKING:
    from pathlib import Path

TOKENS = [
    "nan", "-inf", "1e999", "-1", "0", "1_0", "true", "''", '"', '""', "[]", "{}", "[[", "{a=1}",
    "9" * 400, "9" * 5000, "0x" + "f" * 300, "1e-320", "-0.0", "1979-05-27", "07:32:00",
    "1979-05-27T07:32:00", "0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-14:00", "\x00",
    "\u2028", "\ud7ff", "\x85", ",", ",,", ";", "\r", "\n", "\t", "#", "=", "[sensors]", "A", "é",
    "[" * 2000, "sensors.A = 1", "[sensors.A.errors.x]", "a.b.c = 1", "٣", "../../etc/passwd",
]  # fmt: skip
KEYS = [
    *("format", "frame", "epoch", "sensors", "smooth", "geodetic", "position_m", "trajectory"),
    *("axes", "errors", "correlation", "refraction", "motion", "process_noise", "loss", "terrain"),
    *("process_noise_along", "spacing_s", "max_iterations", "propagation_speed_m_s", '""', "é"),
    *(
        "azimuth_bias_deg",
        "azimuth_bias_rad",
        "clock_offset_s",
        "clock_offset_m",
        "frequency_offset_hz",
    ),
    *("propagation_sigma_m_s", "platform_process_noise", "position_noise_m"),
]
RELAXED = settings(
    max_examples=800,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def mutate_bytes(content: bytes, rng: random.Random) -> bytes:
    data = bytearray(content)
    kind = rng.randrange(4)
    if kind == 0:
        return bytes(data[: rng.randrange(len(data) + 1)])
    for _ in range(rng.choice([1, 1, 2, 8])):
        place = rng.randrange(len(data) + 1)
        if kind == 1 and data:
            data[place % len(data)] ^= 1 << rng.randrange(8)
        elif kind == 2:
            data[place:place] = rng.randbytes(rng.choice([1, 3, 30]))
        else:
            del data[place : place + rng.choice([1, 5, 50])]
    return bytes(data)


def mutate_lines(content: bytes, rng: random.Random) -> bytes:
    lines = content.decode().splitlines(keepends=True)
    if not lines:
        return content
    first, second = rng.randrange(len(lines)), rng.randrange(len(lines))
    kind = rng.randrange(3)
    if kind == 0:
        del lines[first]
    elif kind == 1:
        lines.insert(second, lines[first])
    else:
        lines[first], lines[second] = lines[second], lines[first]
    return "".join(lines).encode()


def mutate_column(content: bytes, rng: random.Random) -> bytes:
    rows = [line.split(",") for line in content.decode().splitlines()]
    column = rng.randrange(max(map(len, rows), default=1) or 1)
    double = rng.random() < 0.5
    for row in rows:
        if column < len(row):
            row[column : column + 1] = [row[column]] * 2 if double else []
    return "\n".join(",".join(row) for row in rows).encode()


def mutate_token(content: bytes, rng: random.Random) -> bytes:
    separators = ",\n=[]"
    text = content.decode()
    ends = [place for place, letter in enumerate(text) if letter in separators] or [0]
    start = rng.choice(ends) + 1
    end = next((place for place in ends if place >= start), len(text))
    return (text[:start] + rng.choice(TOKENS) + text[end:]).encode("utf-8", "surrogatepass")


MUTATIONS = [mutate_bytes, mutate_lines, mutate_column, mutate_token, mutate_token]


def reads_or_says_why(path: Path) -> None:
    message = ""
    try:
        read_ecsv(path) if path.suffix == ".ecsv" else gg.read(path)
    except InputError as error:
        message = str(error)
    assert "\n" not in message
    assert len(message) < 1000


def mutilated(files: dict[str, bytes], seed: int) -> dict[str, bytes]:
    rng = random.Random(seed)
    changed = dict(files)
    for _ in range(rng.choice([1, 1, 1, 2])):
        name = rng.choice(sorted(changed))
        try:
            changed[name] = rng.choice(MUTATIONS)(changed[name], rng)
        except UnicodeDecodeError:
            changed[name] = mutate_bytes(changed[name], rng)
    return changed


@RELAXED
@given(seed=st.integers(0, 2**63))
def test_mutilated_folders(tmp_path: Path, seed: int) -> None:
    files = {name: text.encode() for name, text in all_files().items()}
    shutil.rmtree(tmp_path / "x", ignore_errors=True)
    reads_or_says_why(write_files(tmp_path / "x", mutilated(files, seed)))


@settings(RELAXED, max_examples=400)
@given(seed=st.integers(0, 2**63))
def test_mutilated_parquet(tmp_path: Path, seed: int) -> None:
    pytest.importorskip("pyarrow")
    if not (tmp_path / "p").exists():
        write_files(tmp_path / "a", all_files())
        gg.write(gg.read(tmp_path / "a"), tmp_path / "p", tables="parquet")
    files = {entry.name: entry.read_bytes() for entry in (tmp_path / "p").iterdir()}
    rng = random.Random(seed)
    name = rng.choice(sorted(name for name in files if name.endswith(".parquet")))
    files[name] = mutate_bytes(files[name], rng)
    shutil.rmtree(tmp_path / "x", ignore_errors=True)
    reads_or_says_why(write_files(tmp_path / "x", files))


@settings(RELAXED, max_examples=400)
@given(seed=st.integers(0, 2**63))
def test_mutilated_zip(tmp_path: Path, seed: int) -> None:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in all_files().items():
            archive.writestr(zipfile.ZipInfo(name), text)
    path = tmp_path / "x.zip"
    path.write_bytes(mutate_bytes(file.getvalue(), random.Random(seed)))
    reads_or_says_why(path)


toml_values = st.recursive(
    st.sampled_from(TOKENS) | st.integers().map(str) | st.floats().map(repr),
    lambda inner: (
        st.lists(inner, max_size=4).map(lambda items: f"[{', '.join(items)}]")
        | inner.map(lambda item: f"{{ a = {item} }}")
    ),
    max_leaves=6,
)


@RELAXED
@given(
    place=st.integers(0, len(FULL_HEADER.splitlines())),
    key=st.sampled_from(KEYS),
    value=toml_values,
    replace=st.booleans(),
)
def test_values_of_wrong_types(
    tmp_path: Path, place: int, key: str, value: str, replace: bool
) -> None:
    files = all_files()
    lines = files["recording.toml"].splitlines()
    lines[place : place + replace] = [f"{key} = {value}"]
    files["recording.toml"] = "\n".join(lines)
    reads_or_says_why(write_files(tmp_path, files))


ECSV = """\
# %ECSV 0.9
# ---
# datatype:
# - {name: datetime, datatype: string}
# - {name: azimuth, unit: deg, datatype: float64}
# - {name: altitude, datatype: float64}
# delimiter: ','
# meta: !!omap
# - {obs_latitude: 52.5}
# - {obs_longitude: -1.45}
# - {obs_elevation: 80.0}
# - {camera_id: X1}
# schema: astropy-2.0
datetime,azimuth,altitude
""" + "".join(f"2021-02-28T21:54:1{i}.5,23{i}.25,3{i}.5\n" for i in range(9))


@settings(RELAXED, max_examples=300)
@given(seed=st.integers(0, 2**63))
def test_mutilated_ecsv(tmp_path: Path, seed: int) -> None:
    content = mutilated({"x": ECSV.encode()}, seed)["x"]
    (tmp_path / "x.ecsv").write_bytes(content)
    reads_or_says_why(tmp_path / "x.ecsv")
