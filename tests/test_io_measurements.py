"""Tables of arrivals and differences, and the header's keys for them, are read as they stand."""

from __future__ import annotations

import dataclasses
import io
import math
import zipfile
from typing import TYPE_CHECKING

import numpy as np
import pytest
from recordings import ARRIVALS, FULL_HEADER, all_files, assert_equal, valid_files, write_files
from small_recordings import write_signals

import geograph as gg
from geograph.cli.run_convert import run_convert
from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.io.measurement_tables import MEASUREMENT_COLUMNS

if TYPE_CHECKING:
    from pathlib import Path

LOCAL = """\
format = 1
frame = "local"
propagation_speed_m_s = 343.0
propagation_sigma_m_s = 2.0
[sensors.A]
position_m = [0, 0, 0]
[sensors.B]
position_m = [10, 0, 0]
"""


def test_arrivals(tmp_path: Path) -> None:
    arrivals = gg.read(write_files(tmp_path, all_files())).arrivals
    assert arrivals is not None
    np.testing.assert_array_equal(arrivals.emission, [0, 0, 1, 0, 1])
    assert arrivals.emission_names == ("m7", "12")
    np.testing.assert_array_equal(arrivals.sensor, [0, 2, 0, 1, 3])
    np.testing.assert_array_equal(arrivals.toa_s, [1.0001, 1.0002, 2.5, 1.00035, 2.5003])
    np.testing.assert_array_equal(arrivals.sigma_s, [1e-7, 2e-7, 1e-7, 5e-7, 1e-7])
    np.testing.assert_array_equal(arrivals.line, [2, 3, 4, 5, 6])


def test_time_differences(tmp_path: Path) -> None:
    table = gg.read(write_files(tmp_path, all_files())).time_differences
    assert table is not None
    np.testing.assert_array_equal(table.time_s, [3.0, 3.0, 4.0])
    np.testing.assert_array_equal(table.sensor, [0, 1, 2])
    np.testing.assert_array_equal(table.reference, [2, 2, 0])
    np.testing.assert_array_equal(table.tdoa_s, [1.2e-4, -3.4e-4, -1e-4])
    np.testing.assert_array_equal(table.sigma_s, [1.5e-7, 2e-7, 1e-7])
    np.testing.assert_array_equal(table.sigma_reference_s, [1e-7, 1e-7, 0.0])
    np.testing.assert_array_equal(table.line, [2, 3, 4])


def test_frequency_differences(tmp_path: Path) -> None:
    table = gg.read(write_files(tmp_path, all_files())).frequency_differences
    assert table is not None
    np.testing.assert_array_equal(table.time_s, [3.0, 3.0, 4.0])
    np.testing.assert_array_equal(table.sensor, [0, 1, 3])
    np.testing.assert_array_equal(table.reference, [2, 2, 0])
    np.testing.assert_array_equal(table.fdoa_hz, [-120.5, 40.25, 7.0])
    np.testing.assert_array_equal(table.carrier_hz, [1.09e9, 1.09e9, 433.92e6])
    np.testing.assert_array_equal(table.sigma_hz, [2.0, 2.5, 1.0])
    np.testing.assert_array_equal(table.sigma_reference_hz, [0.5, 0.5, 0.0])
    np.testing.assert_array_equal(table.line, [2, 3, 4])


def test_header(tmp_path: Path) -> None:
    recording = gg.read(write_files(tmp_path, all_files()))
    assert recording.propagation_sigma_m_s == 0.5
    assert recording.sensors["C"].errors.clock_offset_s == 3.0 / SPEED_OF_LIGHT_M_S
    assert recording.sensors["C"].errors.frequency_offset_hz == 20.0
    assert recording.sensors["Plane"].platform_process_noise == 2.0
    assert recording.sensors["B two"].platform_process_noise is None
    assert recording.time_span_s == (1.0, 4.0)


def test_clocks_in_metres_are_those_in_seconds(tmp_path: Path) -> None:
    table = "emission,sensor,toa_s,sigma_s\n1,A,0.1,1e-4\n1,B,0.12,1e-4\n"
    seconds = "clock_offset_s = 2.0\nclock_drift_s_s = 0.5\nclock_instability_s_sqrt_s = 0.25\n"
    metres = "clock_offset_m = 686.0\nclock_drift_m_s = 171.5\nclock_instability_m_sqrt_s = 85.75\n"
    read = []
    for name, errors in (("s", seconds), ("m", metres)):
        header = f"{LOCAL}[sensors.A.errors]\n{errors}"
        files = {"recording.toml": header, "arrivals.csv": table}
        read.append(gg.read(write_files(tmp_path / name, files)))
    assert read[0].sensors["A"].errors.clock_instability_s_sqrt_s == 0.25
    assert_equal(*read)


@pytest.mark.parametrize("noise", ["0", "1.5"])
def test_platform_noise(tmp_path: Path, noise: str) -> None:
    old = "platform_process_noise = 2.0"
    files = all_files()
    assert old in files["recording.toml"]
    files["recording.toml"] = FULL_HEADER.replace(old, f"platform_process_noise = {noise}")
    recording = gg.read(write_files(tmp_path / "a", files))
    assert recording.sensors["Plane"].platform_process_noise == float(noise)
    assert_equal(recording, gg.write(recording, tmp_path / "b"))


@pytest.mark.parametrize("kept", MEASUREMENT_COLUMNS)
def test_one_table_is_enough(tmp_path: Path, kept: str) -> None:
    files = all_files()
    for name in MEASUREMENT_COLUMNS:
        if name != kept:
            del files[f"{name}.csv"]
    recording = gg.read(write_files(tmp_path / "a", files))
    assert list(recording.tables) == [kept]
    assert_equal(recording, gg.write(recording, tmp_path / "b"))


def test_headers_alone_beside_a_table_with_rows(tmp_path: Path) -> None:
    files = all_files()
    for name in MEASUREMENT_COLUMNS:
        if name != "time_differences":
            files[f"{name}.csv"] = files[f"{name}.csv"].splitlines()[0]
    recording = gg.read(write_files(tmp_path, files))
    assert list(recording.tables) == ["time_differences"]
    assert recording.bearings is None
    assert recording.arrivals is None
    assert recording.frequency_differences is None


@pytest.mark.parametrize("name", ["time_differences", "frequency_differences"])
def test_shared_sigmas_may_be_absent_or_empty(tmp_path: Path, name: str) -> None:
    files = all_files()
    rows = [line.split(",") for line in files[f"{name}.csv"].splitlines()]
    files[f"{name}.csv"] = "\n".join(",".join(row[:-1]) for row in rows)
    absent = gg.read(write_files(tmp_path / "absent", files))
    empty = [rows[0], *([*row[:-1], ""] for row in rows[1:])]
    files[f"{name}.csv"] = "\n".join(map(",".join, empty))
    assert_equal(absent, gg.read(write_files(tmp_path / "empty", files)))
    table = absent.tables[name]
    unit = "s" if name == "time_differences" else "hz"
    np.testing.assert_array_equal(getattr(table, f"sigma_reference_{unit}"), np.zeros(3))
    written = gg.write(absent, tmp_path / "written")
    assert_equal(absent, written)
    header = (tmp_path / "written" / f"{name}.csv").read_text().splitlines()[0]
    assert "reference_" not in header


def test_carriers_have_shared_sigmas_of_their_own(tmp_path: Path) -> None:
    files = all_files()
    files["frequency_differences.csv"] = (
        "time_s,sensor,reference,fdoa_hz,carrier_hz,sigma_hz,sigma_reference_hz\n"
        "3,A,C,1,1e9,2,0.5\n3,A,C,1,2e9,2,1\n"
    )
    table = gg.read(write_files(tmp_path, files)).frequency_differences
    assert table is not None
    np.testing.assert_array_equal(table.sigma_reference_hz, [0.5, 1.0])


@pytest.mark.parametrize(("speed", "reads"), [("1e-300", True), ("1e300", False)])
def test_speeds_without_a_sense(tmp_path: Path, speed: str, reads: bool) -> None:
    # No limit on a difference follows from the first, and none is small enough for the second.
    header = LOCAL.replace("343.0", speed)
    table = "time_s,sensor,reference,fdoa_hz,carrier_hz,sigma_hz\n1,A,B,1e14,1e15,1\n"
    write_files(tmp_path, {"recording.toml": header, "frequency_differences.csv": table})
    if reads:
        assert len(gg.read(tmp_path).tables) == 1
    else:
        with pytest.raises(gg.InputError, match="means speeds beyond that of light"):
            gg.read(tmp_path)


def test_order_of_rows_and_columns(tmp_path: Path) -> None:
    files = all_files()
    plain = gg.read(write_files(tmp_path / "a", files)).arrivals
    header, *rows = (line.split(",") for line in ARRIVALS.splitlines())
    order, columns = [3, 0, 4, 2, 1], [2, 0, 3, 1]
    mixed = [header, *(rows[index] for index in order)]
    files["arrivals.csv"] = "\n".join(",".join(row[c] for c in columns) for row in mixed)
    other = gg.read(write_files(tmp_path / "b", files)).arrivals
    assert plain is not None
    assert other is not None
    assert other.emission_names == ("m7", "12")
    np.testing.assert_array_equal(other.emission, plain.emission[order])
    np.testing.assert_array_equal(other.toa_s, plain.toa_s[order])
    np.testing.assert_array_equal(other.sensor, plain.sensor[order])


@pytest.mark.parametrize(
    ("labels", "names"),
    [
        ([7, 7, 12], ("7", "12")),
        ([-1.5, -1.5, 2.0], ("-1.5", "2.0")),
        (["a ", "a", "Größe, 2"], ("a", "Größe, 2")),
    ],
)
def test_labels_in_parquet(tmp_path: Path, labels: list[object], names: tuple[str, ...]) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    columns = {
        "emission": labels,
        "sensor": ["A", "B", "A"],
        "toa_s": [1.0, 1.1, 2.0],
        "sigma_s": [1e-3, 1e-3, 1e-3],
    }
    file = io.BytesIO()
    parquet.write_table(pyarrow.table(columns), file)
    folder = write_files(tmp_path / "a", {"recording.toml": LOCAL})
    write_files(folder, {"arrivals.parquet": file.getvalue()})
    recording = gg.read(folder)
    assert recording.arrivals is not None
    assert recording.arrivals.emission_names == names
    np.testing.assert_array_equal(recording.arrivals.emission, [0, 0, 1])
    np.testing.assert_array_equal(recording.arrivals.line, [2, 3, 4])
    for tables in ("csv", "parquet"):
        assert_equal(recording, gg.write(recording, tmp_path / tables, tables=tables))


def test_text_of_sensors_in_parquet_is_text_alone(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    columns = {"emission": [1], "sensor": [1], "toa_s": [1.0], "sigma_s": [1e-3]}
    for column, values in (("sensor", [1]), ("emission", [True])):
        file = io.BytesIO()
        table = columns | {"sensor": ["A"]} | {column: values}
        parquet.write_table(pyarrow.table(table), file)
        folder = tmp_path / column
        write_files(folder, {"recording.toml": LOCAL})
        write_files(folder, {"arrivals.parquet": file.getvalue()})
        with pytest.raises(gg.InputError, match=f"column {column}: holds .*; expected text"):
            gg.read(folder)


def test_zip(tmp_path: Path) -> None:
    plain = gg.read(write_files(tmp_path / "plain", all_files()))
    with zipfile.ZipFile(tmp_path / "pass.zip", "w") as archive:
        for name, text in all_files().items():
            archive.writestr(f"inside/{name}", text)
    assert_equal(plain, gg.read(tmp_path / "pass.zip"))


def test_many_emissions(tmp_path: Path) -> None:
    count = 30_000
    rows = [
        f"{i},{s},{0.01 * i + d!r},1e-4"
        for i in range(count)
        for s, d in zip("AB", (0.1, 0.2), strict=True)
    ]
    table = "emission,sensor,toa_s,sigma_s\n" + "\n".join(rows)
    files = {"recording.toml": LOCAL, "arrivals.csv": table}
    arrivals = gg.read(write_files(tmp_path, files)).arrivals
    assert arrivals is not None
    np.testing.assert_array_equal(arrivals.emission, np.arange(count).repeat(2))
    assert arrivals.emission_names[-1] == str(count - 1)


def test_truth_overlaps_any_table(tmp_path: Path) -> None:
    files = valid_files() | {"recording.toml": FULL_HEADER, "plane.csv": all_files()["plane.csv"]}
    files["truth.csv"] = "time_s,x_m,y_m,z_m\n4.5,6500000,0,0\n9,6500000,0,0\n"
    with pytest.raises(gg.InputError, match=r"covers 4\.5 to 9 s and the measurements 1 to 3 s"):
        gg.read(write_files(tmp_path / "a", files))
    files["arrivals.csv"] = "emission,sensor,toa_s,sigma_s\n1,A,5,1e-7\n1,C,5.001,1e-7\n"
    truth = gg.read(write_files(tmp_path / "b", files)).truth
    assert truth is not None
    assert math.isclose(truth.time_s[0], 4.5)


def test_tables_of_the_same_signals_agree(tmp_path: Path) -> None:
    folder = write_signals(
        tmp_path / "a", speed_m_s=343.0, sigma_m=1e-6, sigma_m_s=1e-6, carrier_hz=1000.0
    )
    recording = gg.read(folder)
    arrivals, times = recording.arrivals, recording.time_differences
    frequencies = recording.frequency_differences
    assert arrivals is not None
    assert times is not None
    assert frequencies is not None
    toa = arrivals.toa_s.reshape(-1, 5)
    # Six sigmas of the four noises that enter.
    tdoa = times.tdoa_s.reshape(-1, 4)
    np.testing.assert_allclose(toa[:, 1:] - toa[:, :1], tdoa, atol=6.0 * 2.0 * 1e-6 / 343.0)
    # 250 cycles are emitted in a quarter of a second; each sensor receives as many in its own time.
    received = 250.0 / np.diff(toa, axis=0)
    fdoa = frequencies.fdoa_hz.reshape(-1, 4)
    middle = 0.5 * (fdoa[1:] + fdoa[:-1])
    assert np.abs(fdoa).max() > 100.0
    # The square of 16 m of the path over 1200 m, of a Doppler shift of a fifth of the carrier.
    np.testing.assert_allclose(received[:, 1:] - received[:, :1], middle, atol=0.04)


@pytest.mark.parametrize("tables", ["csv", "parquet"])
def test_convert_command(tmp_path: Path, tables: str) -> None:
    original = gg.read(write_files(tmp_path / "a", all_files()))
    run_convert([tmp_path / "a", tmp_path / "b.zip"], {}, tables=tables, overwrite=False)
    assert_equal(original, dataclasses.replace(gg.read(tmp_path / "b.zip"), name="a"))
