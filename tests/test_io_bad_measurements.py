"""Each kind of wrong arrival or difference, and wrong key for them, has its own message."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest
from recordings import FULL_HEADER, all_files, valid_files, write_files

import geograph as gg
from geograph.errors import InputError
from geograph.io.measurement_tables import MEASUREMENT_COLUMNS

if TYPE_CHECKING:
    from pathlib import Path

ARRIVALS, TIMES, FREQUENCIES = "arrivals.csv", "time_differences.csv", "frequency_differences.csv"
HEADER = "recording.toml"


def message_of(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        gg.read(path)
    text = str(caught.value)
    assert "\n" not in text
    return text


# File, what is replaced in it, by what, and the message.
CASES = {
    "emission empty": (ARRIVALS, "12,A", ",A", r"csv:4, column emission: empty cell; expected pr"),
    "emission control": (ARRIVALS, "12,A", "1\x012,A", r":4, column emission: '1\\x012'; expected"),
    "sensor twice": (
        ARRIVALS,
        "m7,B two",
        "m7,C",
        r"arrivals.csv:5, column sensor: 'C' is there twice; expected each sensor once in an "
        r"emission; emission 'm7' has it on line 3 already; remove one",
    ),
    "sensor": (ARRIVALS, "m7,C", "m7,B tow", r":3, column sensor: .*'B tow'; did you mean B two\?"),
    "no toa": (ARRIVALS, "1.0002", "", r"arrivals.csv:3, column toa_s: empty cell; expected a fin"),
    "huge toa": (ARRIVALS, "1.0002", "1e12", r":3, column toa_s: 10+; expected -1e\+11 to 1e\+11"),
    "zero sigma": (ARRIVALS, "2e-07", "0", r":3, column sigma_s: 0; expected a sigma above 0"),
    "tiny sigma": (ARRIVALS, "2e-07", "1e-16", r":3, column sigma_s: 1e-16; .*\(at least 1e-15 s"),
    "coarse toa": (
        ARRIVALS,
        "1.0002",
        "1.6e9",
        r"arrivals.csv:3, column toa_s: 1600000000; a number of that size is kept to 2.4e-07 s and "
        r"its sigma is 2e-07 s; .*put the epoch near",
    ),
    "toa outside": (
        ARRIVALS,
        "2.5003",
        "12.5",
        r"arrivals.csv:6, column toa_s: 12.5; outside the trajectory of sensor 'Plane'; expected 0",
    ),
    "arrival column": (ARRIVALS, "toa_s", "time_s", r":1, column time_s: unknown column 'time_s'"),
    "reference": (TIMES, "C,-0.00034", "D,1", r":3, column reference: unknown sensor 'D'; expecte"),
    "other sensor": (TIMES, "B two,C", "Btwo,C", r":3, column sensor: .*did you mean B two\?"),
    "no reference": (TIMES, "B two,C", "B two,", r":3, column reference: empty cell"),
    "own reference": (
        TIMES,
        "B two,C",
        "C,C",
        r"time_differences.csv:3, column reference: 'C' is its own reference; expected another",
    ),
    "tdoa": (TIMES, "-0.00034", "nan", r":3, column tdoa_s: 'nan' is not a number"),
    "difference sigma": (TIMES, "2e-07,", "-2e-07,", r":3, column sigma_s: -2e-07; expected a sig"),
    "shared negative": (TIMES, "2e-07,1e-07", "2e-07,-1", r":3, column sigma_reference_s: -1; exp"),
    "shared whole": (
        TIMES,
        "2e-07,1e-07",
        "2e-07,2e-07",
        r":3, column sigma_reference_s: 2e-07; expected less than sigma_s of that row",
    ),
    "shared differs": (
        TIMES,
        "2e-07,1e-07",
        "2e-07,5e-08",
        r":3, column sigma_reference_s: 5e-08; expected 1e-07 as on line 2, of the same signal",
    ),
    "sensor outside": (
        TIMES,
        "3.0,B two",
        "-1.0,B two",
        r"time_differences.csv:3, column time_s: -1; outside the trajectory of sensor 'B two'",
    ),
    "reference outside": (
        TIMES,
        "4.0,C,A",
        "14.0,C,Plane",
        r"time_differences.csv:4, column time_s: 14; outside the trajectory of sensor 'Plane'",
    ),
    "frequency outside": (
        FREQUENCIES,
        "4.0,Plane",
        "14.0,Plane",
        r"frequency_differences.csv:4, column time_s: 14; outside the trajectory of sensor 'Plane'",
    ),
    "zero carrier": (
        FREQUENCIES,
        "433920000.0",
        "0",
        r"frequency_differences.csv:4, column carrier_hz: 0; expected the frequency that the "
        r"object emits, above 0",
    ),
    "negative carrier": (FREQUENCIES, "433920000.0", "-1e9", r":4, column carrier_hz: -1000000000"),
    "carrier in GHz": (
        FREQUENCIES,
        "-120.5,1090000000.0",
        "-120.5,1.09",
        r":2, column fdoa_hz: -120.5; with carrier_hz of that row means speeds beyond that of li",
    ),
    "fdoa sigma": (FREQUENCIES, "2.5,0.5", "0,0.5", r":3, column sigma_hz: 0; expected a sigma"),
    "fdoa shared": (FREQUENCIES, "2.5,0.5", "2.5,3", r":3, column sigma_reference_hz: 3; expected"),
    "fdoa shared differs": (
        FREQUENCIES,
        "2.5,0.5",
        "2.5,",
        r":3, column sigma_reference_hz: 0; expected 0.5 as on line 2",
    ),
    "own reference of a frequency": (
        FREQUENCIES,
        "4.0,Plane,A",
        "4.0,A,A",
        r"'A' is its own refer",
    ),
    "speed sigma": (HEADER, "m_s = 0.5", "m_s = -0.5", r"propagation_sigma_m_s: prior sigma is -0"),
    "speed sigma inf": (
        HEADER,
        "m_s = 0.5",
        "m_s = inf",
        r"propagation_sigma_m_s: is inf; expecte",
    ),
    "speed sigma of no speed": (
        HEADER,
        "propagation_sigma_m_s",
        "propagation_speed_m_s = inf\npropagation_sigma_m_s",
        r"toml:5, column propagation_sigma_m_s: is 0.5 and propagation_speed_m_s is inf; expected",
    ),
    "speed of arrivals": (
        HEADER,
        "propagation_sigma_m_s = 0.5",
        "propagation_speed_m_s = inf",
        r"recording.toml:\d+, column sensors.C.errors.clock_offset_m: is 3 and propagation_speed",
    ),
    "clock in both": (
        HEADER,
        "clock_offset_m = 3.0",
        "clock_offset_m = 3.0\nclock_offset_s = 1e-8",
        r"errors.clock_offset_s: clock_offset_s is there beside clock_offset_m, the same in the "
        r"other unit; expected one of them; remove the other",
    ),
    "clock negative": (
        HEADER,
        "clock_offset_m = 3",
        "clock_offset_m = -3",
        r"sigma is -3; expected",
    ),
    "clock misspelt": (HEADER, "clock_offset_m", "clock_ofset_m", r"did you mean clock_offset_m\?"),
    "clock of a standstill": (
        HEADER,
        "propagation_sigma_m_s = 0.5",
        "propagation_speed_m_s = 1e-300",
        r"clock_offset_m: is 3 and propagation_speed_m_s 1e-300, .* give clock_offset_s instead",
    ),
    "platform negative": (
        HEADER,
        "noise = 2.0",
        "noise = -2.0",
        r"noise: is -2; expected at least",
    ),
    "platform text": (
        HEADER,
        "noise = 2.0",
        'noise = "2"',
        r"noise: is '2'; expected a finite num",
    ),
    "platform without fixes": (
        HEADER,
        'trajectory = "plane.csv"',
        "geodetic = [51.0, -1.5, 120.0]",
        r"sensors.Plane.platform_process_noise: is 2; expected a trajectory, whose points are fix",
    ),
    "platform without sigma": (
        HEADER,
        "position_noise_m = 15.0",
        "position_m = 15.0",
        r"platform_process_noise: is 2; expected position_noise_m above 0 in its errors, the sigma",
    ),
    "truth": (
        "truth.csv",
        "0.0,6500000.0,0.0,0.0\n4.0,",
        "100.0,6500000.0,0.0,0.0\n104.0,",
        r"truth.csv:2, column time_s: covers 100 to 104 s and the measurements 1 to 4 s",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_message(tmp_path: Path, case: str) -> None:
    name, old, new, expected = CASES[case]
    files = all_files()
    assert old in files[name]
    files[name] = files[name].replace(old, new, 1)
    assert re.search(expected, message_of(write_files(tmp_path, files)))


@pytest.mark.parametrize("name", [ARRIVALS, TIMES, FREQUENCIES])
def test_a_signal_of_no_speed(tmp_path: Path, name: str) -> None:
    header = FULL_HEADER.replace("propagation_sigma_m_s = 0.5", "propagation_speed_m_s = inf")
    header = header.replace("clock_offset_m = 3.0", "")
    files = valid_files() | {HEADER: header, "plane.csv": all_files()["plane.csv"]}
    assert gg.read(write_files(tmp_path, files)).propagation_speed_m_s == float("inf")
    assert re.search(
        rf"toml:4, column propagation_speed_m_s: is inf and {name} is there, .*expected a finite",
        message_of(write_files(tmp_path, files | {name: all_files()[name]})),
    )


def test_emissions_that_nobody_shares(tmp_path: Path) -> None:
    files = all_files()
    header, *rows = files[ARRIVALS].splitlines()
    numbered = [f"{number},{row.split(',', 1)[1]}" for number, row in enumerate(rows)]
    files[ARRIVALS] = "\n".join([header, *numbered])
    message = message_of(write_files(tmp_path, files))
    assert "arrivals.csv:2, column emission: no two rows of the table have the same" in message
    assert "expected rows of the same emission to have the same label" in message


def test_the_first_repeated_sensor_is_named(tmp_path: Path) -> None:
    files = all_files()
    files[ARRIVALS] = "emission,sensor,toa_s,sigma_s\n" + "\n".join(
        f"{emission},{sensor},1,1e-6" for emission, sensor in ("bC", "aA", "aC", "bC", "aA", "aA")
    )
    message = message_of(write_files(tmp_path, files))
    assert "arrivals.csv:5, column sensor: 'C' is there twice" in message
    assert "emission 'b' has it on line 2 already" in message


def test_no_row_in_any_table(tmp_path: Path) -> None:
    files = all_files()
    for name in MEASUREMENT_COLUMNS:
        files[f"{name}.csv"] = files[f"{name}.csv"].splitlines()[0]
    assert "bearings.csv: has no rows; expected at least one" in message_of(
        write_files(tmp_path, files)
    )


def test_no_table(tmp_path: Path) -> None:
    files = all_files()
    for name in MEASUREMENT_COLUMNS:
        del files[f"{name}.csv"]
    assert (
        "no table of measurements in it; expected at least one of bearings, arrivals, "
        "time_differences, frequency_differences (.csv or .parquet); add one"
    ) in message_of(write_files(tmp_path, files))


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("Arrivals.csv", "arrivals.csv"),
        ("arrival.parquet", "arrivals.parquet"),
        ("toa.csv", "arrivals.csv"),
        ("time-differences.csv", "time_differences.csv"),
        ("TDOA.csv", "time_differences.csv"),
        ("timedifference.csv", "time_differences.csv"),
        ("frequency differences.CSV", "frequency_differences.csv"),
        ("fdoa.csv", "frequency_differences.csv"),
        ("bearing.csv", "bearings.csv"),
    ],
)
def test_misspelt_tables(tmp_path: Path, name: str, meant: str) -> None:
    files = all_files()
    del files[meant.replace("parquet", "csv")]
    expected = f"{name}: is not a table's name; did you mean {meant}? rename it"
    assert expected in message_of(write_files(tmp_path, files | {name: "a\n1\n"}))


def test_other_files_are_left_alone(tmp_path: Path) -> None:
    files = all_files() | {"tdoa.csv": "a\n1\n", "times.csv": "b\n", "arrivals.txt": "c"}
    assert len(gg.read(write_files(tmp_path, files)).tables) == 4


@pytest.mark.parametrize("name", [ARRIVALS, TIMES, FREQUENCIES])
def test_both_formats(tmp_path: Path, name: str) -> None:
    other = name.replace("csv", "parquet")
    write_files(tmp_path, all_files() | {other: ""})
    assert f"both {name} and {other} are there; expected one" in message_of(tmp_path)


@pytest.mark.parametrize("name", [ARRIVALS, TIMES, FREQUENCIES])
@pytest.mark.parametrize("column", range(4))
def test_columns_that_must_be_there(tmp_path: Path, name: str, column: int) -> None:
    files = all_files()
    rows = [line.split(",") for line in files[name].splitlines()]
    gone = rows[0][column]
    files[name] = "\n".join(",".join(row[:column] + row[column + 1 :]) for row in rows)
    expected = f"{name}:1, column {gone}: column {gone} is missing"
    assert expected in message_of(write_files(tmp_path, files))
