"""Lines of a feed: what is a measurement, and what is said of what is none."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings import all_files, assert_equal, write_files

import geograph as gg
from geograph.errors import InputError
from geograph.feed import Assembler, Line, RowParser, json_lines
from geograph.feed.replay import rows_of
from geograph.sensors import Sensor

SENSORS = {name: Sensor(name=name, position_m=np.zeros(3), axes="xyz") for name in ("A", "B")}
BEARING = {
    "time_s": 1.0,
    "sensor": "A",
    "azimuth_deg": 30.0,
    "elevation_deg": 4.0,
    "sigma_deg": 0.1,
}
TDOA = {"time_s": 1, "sensor": "A", "reference": "B", "tdoa_s": 1e-6, "sigma_s": 1e-8}
FDOA = {
    "time_s": 1,
    "sensor": "A",
    "reference": "B",
    "fdoa_hz": 2.0,
    "carrier_hz": 1e9,
    "sigma_hz": 1.0,
}


def parse(text, number=1):
    data = text if isinstance(text, bytes) else text.encode()
    return RowParser("stdin").parse(Line(number, data))


def use(*values, speed=3e8):
    rows = [parse(json.dumps(value), number) for number, value in enumerate(values, start=1)]
    return Assembler(SENSORS, speed).check(rows)


@pytest.mark.parametrize(
    ("value", "table"),
    [
        (BEARING, "bearings"),
        ({"time_s": 1, "sensor": "A", "azimuth_rad": 1, "sigma_azimuth_rad": 0.1}, "bearings"),
        ({"emission": 7, "sensor": "A", "toa_s": 1.0, "sigma_s": 1e-8}, "arrivals"),
        (TDOA, "time_differences"),
        (FDOA | {"sigma_reference_hz": None}, "frequency_differences"),
        ({"time_s": None, "kind": "altitude_m", "value": 3.0, "sigma": 1.0}, "constraints"),
        ({"time_s": 4.0, "kind": "x_m", "value": -3.0, "sigma": 1.0}, "constraints"),
    ],
)
def test_the_kind_follows_from_the_columns_or_is_given(value, table):
    for given_value in (value, value | {"table": table}):
        row = parse(json.dumps(given_value))
        assert row.table == table
        assert Assembler(SENSORS, 3e8).check([row]).errors == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", r"stdin:1: '{' is not JSON \(Expecting property name .*\); expected one JSON object"),
        ("[1]", r"stdin:1: \[1\] is not a JSON object"),
        ("5", "stdin:1: 5 is not a JSON object"),
        ("{}", "stdin:1: found no keys; expected a measurement, which has one of azimuth_deg"),
        (b"\xff\xfe", "stdin:1: byte 0xff is not UTF-8"),
        ("[" * 5000, "stdin:1: is nested too deeply"),
        ('{"time_s":1,"time_s":2}', "stdin:1: 'time_s' is there twice"),
        ('{"time_s":1,"azimut_deg":2}', "column azimut_deg: .* did you mean azimuth_deg"),
        ('{"table":"bearing"}', "column table: unknown table 'bearing'; did you mean bearings"),
        ('{"table":7}', "column table: unknown table 7"),
        (json.dumps(BEARING | {"tdoa_s": 1}), "azimuth_deg and tdoa_s in one line"),
        (json.dumps(BEARING | {"colour": 1}), "stdin:1, column colour: unknown column 'colour'"),
        (json.dumps(BEARING | {"time_s": float("nan")}), "column time_s: 'nan' is not a number"),
        (json.dumps(BEARING | {"time_s": float("inf")}), "column time_s: 'inf' is infinite"),
        (json.dumps(BEARING | {"time_s": 10**400}), "column time_s: 'inf' is infinite"),
        (json.dumps(BEARING | {"time_s": "1"}), "column time_s: '1' is not a number"),
        (json.dumps(BEARING | {"time_s": True}), "column time_s: True is not a number"),
        (json.dumps(BEARING | {"time_s": None}), "column time_s: empty cell"),
        (json.dumps(BEARING | {"time_s": [1]}), r"column time_s: \[1\] is not a number"),
        (json.dumps(BEARING | {"sensor": 1}), "column sensor: 1 is not text; expected text"),
        (json.dumps(BEARING | {"sensor": None}), "column sensor: empty cell; expected text"),
        (
            '{"emission":true,"sensor":"A","toa_s":1,"sigma_s":1}',
            "True is not text; .* or a num",
        ),
    ],
)
def test_what_is_no_measurement_is_told_in_one_line(text, message):
    with pytest.raises(InputError, match=message) as raised:
        parse(text)
    assert "\n" not in str(raised.value)
    assert raised.value.line == 1


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (BEARING | {"sensor": "C"}, "stdin:1, column sensor: unknown sensor 'C'"),
        (
            BEARING | {"azimuth_deg": 400.0},
            "stdin:1, column azimuth_deg: 400; expected -360",
        ),
        (BEARING | {"time_s": 1e12}, "stdin:1, column time_s: 1000000000000; expected -1e"),
        (BEARING | {"sigma_deg": 0}, "stdin:1, column sigma_deg: 0; expected a sigma above 0"),
        ({"time_s": 1, "sensor": "A", "azimuth_deg": 3}, "stdin:1, column sigma_deg: empty cell"),
        (TDOA | {"reference": "A"}, "stdin:1, column reference: 'A' is its own reference"),
        (FDOA | {"carrier_hz": 0.0}, "stdin:1, column carrier_hz: 0"),
        ({"time_s": 1, "kind": "x", "value": 1, "sigma": 1}, "stdin:1, column kind: unknown kind"),
    ],
)
def test_values_are_checked_as_those_of_files_are(value, message):
    checked = use(value)
    assert checked.rows == checked.tables == []
    (error,) = checked.errors
    with pytest.raises(InputError, match=message):
        raise error


def test_the_bad_rows_of_a_batch_are_named_and_the_others_stay():
    again = {"emission": "e", "sensor": "A", "toa_s": 1.0, "sigma_s": 1e-8}
    checked = use(BEARING, BEARING | {"sensor": "C"}, again, again, TDOA, BEARING | {"time_s": 2})
    assert [row.number for row in checked.rows] == [1, 3, 5, 6]
    assert [error.line for error in checked.errors] == [2, 4]
    assert [len(table) for table in checked.tables] == [2, 1, 1]
    assert checked.tables[0].line.tolist() == [1, 6]


def test_angles_in_both_units_and_rows_without_elevation_stand_in_one_batch():
    radians = {"time_s": 1.0, "sensor": "B", "azimuth_rad": 0.5, "sigma_rad": 0.01}
    alone = {"time_s": 3.0, "sensor": "B", "azimuth_deg": 0.5, "sigma_azimuth_deg": 0.01}
    checked = use(BEARING, radians, alone)
    assert not checked.errors
    first, second = checked.tables
    assert np.isnan(first.elevation_rad).tolist() == [False, True]
    assert first.isotropic.tolist() == [True, False]
    assert second.azimuth_rad.tolist() == [0.5]


def test_time_differences_need_a_finite_speed():
    checked = use(BEARING, TDOA, speed=np.inf)
    assert len(checked.rows) == 1
    assert "propagation_speed_m_s is inf" in str(checked.errors[0])


def test_blank_lines_are_nothing_and_long_ones_are_told():
    assert parse("   \t ") is None
    for text, what in ((b"x", "is longer than 65536 bytes"), (b"", "ends in the middle")):
        with pytest.raises(InputError, match=what):
            RowParser("stdin").parse(Line(3, text, cut=True))


@given(st.binary(max_size=60) | st.text(max_size=60).map(str.encode))
@settings(max_examples=200)
def test_garbage_is_refused_by_name_and_by_nothing_else(data):
    if data.strip():
        with pytest.raises(InputError, match=r"^stdin:1[:,]"):
            parse(data)
    else:
        assert parse(data) is None


def test_a_recording_as_lines_reads_back_as_its_tables(tmp_path):
    recording = gg.read(write_files(tmp_path / "all", all_files()))
    lines = list(json_lines(recording))
    parser = RowParser("feed")
    rows = [parser.parse(Line(n, text.encode())) for n, text in enumerate(lines, start=1)]
    originals = rows_of(recording)
    assert [row.cells for row in rows] == [row.cells for row in originals]
    assert [row.key for row in rows] == [row.key for row in originals]
    times = [row.time_s for row in rows]
    assert times[0] is None
    assert times[1:] == sorted(times[1:])
    assert {(row.place.rpartition("/")[2], row.line) for row in originals} >= {
        ("arrivals.csv", 4),
        ("bearings.csv", 2),
        ("constraints.csv", 3),
    }
    assembler = Assembler(recording.sensors, recording.propagation_speed_m_s)
    checked = assembler.check(originals)
    assert not checked.errors
    found = {type(table).__name__: table for table in checked.tables}
    for table in (*recording.tables.values(), recording.constraints):
        order = np.argsort(table.line)
        other = found[type(table).__name__]
        again = np.argsort(other.line)
        for name in set(vars(table)) - {"emission", "emission_names"}:
            column, read = np.asarray(getattr(table, name)), np.asarray(getattr(other, name))
            np.testing.assert_array_equal(column[order], read[again], err_msg=name)
    assert_equal(recording, recording)
