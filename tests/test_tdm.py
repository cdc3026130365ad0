"""CCSDS tracking data messages, against geometry and against an independent reader."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
import pytest
from made_pass import EPOCH, STATION_CSV, STATIONS, ecef, sightings, tdm, tdm_xml, utc

from geograph.errors import InputError
from geograph.io import ImportOptions, read_stations, read_tdm

if TYPE_CHECKING:
    from pathlib import Path

    from geograph.recording import Recording


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.fixture
def options(tmp_path: Path) -> ImportOptions:
    return ImportOptions(
        stations=read_stations(write(tmp_path / "stations.csv", STATION_CSV)), sigma_deg=0.01
    )


def check(recording: Recording, rows: list[tuple[float, str, float, float]]) -> None:
    bearings = recording.bearings
    assert bearings is not None
    assert recording.epoch == EPOCH
    assert recording.sensor_names == tuple(STATIONS)
    np.testing.assert_allclose(bearings.time_s, [row[0] for row in rows], atol=1e-6)
    names = [recording.sensor_names[index] for index in bearings.sensor]
    assert names == [row[1] for row in rows]
    np.testing.assert_allclose(np.degrees(bearings.azimuth_rad), [r[2] for r in rows], atol=1e-8)
    np.testing.assert_allclose(np.degrees(bearings.elevation_rad), [r[3] for r in rows], atol=1e-8)
    for name, sensor in recording.sensors.items():
        np.testing.assert_allclose(sensor.position_m, ecef(*STATIONS[name]), atol=1e-3)


def test_both_notations_against_what_was_written(tmp_path: Path, options: ImportOptions) -> None:
    rows = sightings()
    check(read_tdm(write(tmp_path / "a.tdm", tdm(rows)), options), rows)
    check(read_tdm(write(tmp_path / "b.tdm", tdm(rows, ordinal=True)), options), rows)
    check(read_tdm(write(tmp_path / "c.xml", tdm_xml(rows)), options), rows)
    message = re.sub(r"<\?.*\?>\n", "", tdm_xml(rows))
    check(read_tdm(write(tmp_path / "d.xml", f"<ndm>{message}</ndm>"), options), rows)


def test_an_independent_reader_reads_the_same(tmp_path: Path) -> None:
    ndm = pytest.importorskip("ccsds_ndm.ndm_io")
    rows = sightings()
    for name, text in (("a.tdm", tdm(rows)), ("b.xml", tdm_xml(rows))):
        message = ndm.NdmIo().from_path(write(tmp_path / name, text))
        segments = message.body.segment
        assert [segment.metadata.participant_1 for segment in segments] == list(STATIONS)
        first = [entry for entry in segments[0].data.observation if entry.angle_1 is not None]
        assert float(first[0].angle_1.value) == pytest.approx(rows[0][2], abs=1e-8)


@pytest.mark.parametrize(("system", "shift"), [("TAI", 37.0), ("TT", 69.184), ("GPS", 18.0)])
def test_time_systems(tmp_path: Path, options: ImportOptions, system: str, shift: float) -> None:
    rows = sightings(step_s=10.0)
    text = tdm(rows, system=system, shift_s=shift)
    check(read_tdm(write(tmp_path / "a.tdm", text), options), rows)


def test_participants_are_matched(tmp_path: Path, options: ImportOptions) -> None:
    rows = sightings(step_s=10.0)
    text = tdm(rows).replace("PARTICIPANT_1 = Alpha", "PARTICIPANT_1 = ALPHA")
    without_path = text.replace("MODE = SEQUENTIAL\nPATH = 2,1\n", "")
    for variant in (text, without_path):
        check(read_tdm(write(tmp_path / "a.tdm", variant), options), rows)
    radar = text.replace("PATH = 2,1", "PATH = 1,2,1")
    check(read_tdm(write(tmp_path / "a.tdm", radar), options), rows)


def test_corrections_and_delays(tmp_path: Path, options: ImportOptions) -> None:
    rows = sightings(step_s=10.0)
    plain = read_tdm(write(tmp_path / "a.tdm", tdm(rows)), options).bearings
    given = "CORRECTION_ANGLE_1 = 0.5\nCORRECTION_ANGLE_2 = -0.25\nCORRECTIONS_APPLIED = {}\n"
    delay = "RECEIVE_DELAY_1 = 0.05\n"
    assert plain is not None
    for applied, add in (("YES", (0.0, 0.0)), ("NO", (0.5, -0.25))):
        text = tdm(rows, keywords=given.format(applied) + delay)
        found = read_tdm(write(tmp_path / "b.tdm", text), options).bearings
        assert found is not None
        np.testing.assert_allclose(found.time_s, plain.time_s - 0.05, atol=1e-9)
        for after, before, angle in (
            (found.azimuth_rad, plain.azimuth_rad, add[0]),
            (found.elevation_rad, plain.elevation_rad, add[1]),
        ):
            np.testing.assert_allclose(np.degrees(after - before), angle, atol=1e-9)


def test_sigma_is_the_scatter_unless_given(tmp_path: Path, options: ImportOptions) -> None:
    text = tdm(sightings(sigma_deg=0.02, step_s=1.0))
    stations = ImportOptions(stations=options.stations)
    bearings = read_tdm(write(tmp_path / "a.tdm", text), stations).bearings
    assert bearings is not None
    # 118 directions less 16 parameters: good to 7 % at one sigma; the band is four of it.
    found = np.degrees(np.unique(bearings.sigma_azimuth_rad))
    assert ((found > 0.0144) & (found < 0.0256)).all()
    few = tdm(sightings(step_s=40.0))
    with pytest.raises(InputError, match=r"'Alpha' has 3 directions without a sigma.*sigma_deg"):
        read_tdm(write(tmp_path / "b.tdm", few), stations)


def test_azimuth_alone(tmp_path: Path, options: ImportOptions) -> None:
    text = re.sub(r"ANGLE_2 = .*\n", "", tdm(sightings(step_s=20.0)))
    bearings = read_tdm(write(tmp_path / "a.tdm", text), options).bearings
    assert bearings is not None
    assert np.isnan(bearings.elevation_rad).all()


DIFFERENCED = f"""\
CCSDS_TDM_VERS = 2.0
CREATION_DATE = {utc(0.0)}
ORIGINATOR = MADE
META_START
TIME_SYSTEM = UTC
PARTICIPANT_1 = Alpha
PARTICIPANT_2 = SAT
PARTICIPANT_3 = Bravo
MODE = SINGLE_DIFF
PATH_1 = 2,1
PATH_2 = 2,3
INTEGRATION_INTERVAL = 1.0
INTEGRATION_REF = END
META_STOP
DATA_START
TRANSMIT_FREQ_2 = {utc(0.0)} 437500000.0
DOR = {utc(10.0)} 1.25E-3
VLBI_DELAY = {utc(11.0)} -2.5e-4
RECEIVE_FREQ = {utc(12.0)} -1234.5
DATA_STOP
"""


def test_differences_are_path_2_less_path_1(tmp_path: Path, options: ImportOptions) -> None:
    chosen = ImportOptions(stations=options.stations, sigma_s=1e-7, sigma_hz=0.5)
    recording = read_tdm(write(tmp_path / "a.tdm", DIFFERENCED), chosen)
    times, frequencies = recording.time_differences, recording.frequency_differences
    assert times is not None
    assert frequencies is not None
    names = np.array(recording.sensor_names)
    for table in (times, frequencies):
        assert set(names[table.sensor]) == {"Bravo"}
        assert set(names[table.reference]) == {"Alpha"}
    assert times.tdoa_s.tolist() == [1.25e-3, -2.5e-4]
    assert times.time_s.tolist() == [10.0, 11.0]
    # The middle of the second that ended at the time tag.
    assert frequencies.time_s.tolist() == [11.5]
    assert frequencies.fdoa_hz.tolist() == [-1234.5]
    assert frequencies.carrier_hz.tolist() == [437.5e6]
    with pytest.raises(InputError, match=r"a.tdm:17, column DOR: has no sigma.*sigma_s"):
        read_tdm(tmp_path / "a.tdm", options)


def test_other_objects_and_other_measurements(tmp_path: Path, options: ImportOptions) -> None:
    rows = sightings(step_s=10.0)
    text = tdm(rows, extra=f"RANGE = {utc(1.0)} 812.5\nMAG = {utc(1.0)} 4.5\n")
    path = write(tmp_path / "a.tdm", text)
    with pytest.raises(InputError, match=r"column RANGE: RANGE cannot be used.*--ignore RANGE"):
        read_tdm(path, options)
    check(read_tdm(path, options, ignore=["RANGE"]), rows)
    other = tdm(rows).replace("2024-001A", "DEBRIS")
    paths = [write(tmp_path / "b.tdm", tdm(rows)), write(tmp_path / "c.tdm", other)]
    with pytest.raises(InputError, match=r"is of 'DEBRIS', after others of '2024-001A'"):
        read_tdm(paths, options)
    check(read_tdm(paths, options, target="DEBRIS"), rows)
    with pytest.raises(InputError, match="no angles or differences of 'X'"):
        read_tdm(paths, options, target="X")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("AZEL", "XEYN", r"a.tdm:11, column ANGLE_TYPE: XEYN is not read: .*convert them to AZEL"),
        ("AZEL", "XSYE", r"XSYE is not read"),
        ("AZEL", "RADEC", r"is RADEC without REFERENCE_FRAME; expected EME2000 or ICRF"),
        ("AZEL\n", "RADEC\nREFERENCE_FRAME = TOD_EARTH\n", r"column REFERENCE_FRAME: 'TOD_EARTH'"),
        ("AZEL\n", "AZEL\nTIMETAG_REF = TRANSMIT\n", r"column TIMETAG_REF: is TRANSMIT"),
        ("AZEL\n", "AZEL\nCORRECTION_ANGLE_1 = 1\n", r"given without CORRECTIONS_APPLIED"),
        ("TIME_SYSTEM = UTC", "TIME_SYSTEM = TDB", r":6, column TIME_SYSTEM: time system 'TDB' is"),
        ("TIME_SYSTEM = UTC\n", "", r"a.tdm:4: metadata have no TIME_SYSTEM"),
        ("= Alpha", "= Alfa", r"sensor 'Alfa' is not in the station list; did you mean Alpha\?"),
        ("PATH = 2,1", "PATH = 2,4", r"column PATH: names participant '4'"),
        ("ANGLE_1 = 2024-03-20T19:04:00.1", "ANGLE_1 = 2024-03-20T25:04:00.1", r"time of day 25"),
        (
            "ANGLE_1 = 2024",
            "ANGLE_1 = 2024-0 2024",
            r":14, column ANGLE_1: is '2024-0 .* a time \(2.*\) and",
        ),
        ("ANGLE_1 = ", "DOPPLER_INSTANTANEOUS = ", r"range rates are active measurements"),
        ("ANGLE_1 = ", "RECEIVE_FREQ = ", r"object's unknown oscillator; differences"),
        ("ANGLE_1 = ", "ANGLE_3 = ", r"'ANGLE_3' with MODE 'SEQUENTIAL' is not read"),
        ("CCSDS_TDM_VERS", "CCSDS_OEM_VERS", r"a.tdm:1: does not begin with CCSDS_TDM_VERS"),
        ("META_STOP\n", "", r"a.tdm:12, column DATA_START: |DATA_START is out of place"),
        ("ORIGINATOR", "Originator", r"a.tdm:3: has 'Originator' before its equals sign"),
    ],
)
def test_what_is_refused(
    tmp_path: Path, options: ImportOptions, old: str, new: str, expected: str
) -> None:
    text = tdm(sightings(step_s=10.0))
    assert old in text
    with pytest.raises(InputError, match=expected) as caught:
        read_tdm(write(tmp_path / "a.tdm", text.replace(old, new, 1)), options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("<tdm ", "<oem ", "is not well-formed"),
        ("<?xml version=\"1.0\" encoding=\"UTF-8\"?>", "<!DOCTYPE tdm [<!ENTITY a 'b'>]>",
         "b.xml:1: has a document type"),
        ("<EPOCH>", "<EPOCHS>", "not well-formed"),
        ("<ANGLE_1>", "<EPOCH/><ANGLE_1>", r"b.xml:9: observation has not one EPOCH"),
        ("AZEL", "XEYN", r"b.xml:7, column ANGLE_TYPE: XEYN"),
    ],
)  # fmt: skip
def test_what_is_refused_in_xml(
    tmp_path: Path, options: ImportOptions, old: str, new: str, expected: str
) -> None:
    text = tdm_xml(sightings(step_s=10.0))
    assert old in text
    with pytest.raises(InputError, match=expected) as caught:
        read_tdm(write(tmp_path / "b.xml", text.replace(old, new, 1)), options)
    assert "\n" not in str(caught.value)


def test_messages_of_nothing(tmp_path: Path, options: ImportOptions) -> None:
    head = "CCSDS_TDM_VERS = 2.0\n"
    with pytest.raises(InputError, match="has no tracking data"):
        read_tdm(write(tmp_path / "a.tdm", head), options)
    cut = tdm(sightings(step_s=10.0)).rpartition("DATA_STOP")[0]
    with pytest.raises(InputError, match=r"ends within a segment.*cut short"):
        read_tdm(write(tmp_path / "a.tdm", cut), options)
    with pytest.raises(InputError, match="has no position here; expected a station list"):
        read_tdm(write(tmp_path / "a.tdm", tdm()))


SPEC = """\
CCSDS_TDM_VERS = 1.0
\tCOMMENT a comment = with an equals sign
\tCREATION_DATE = 2016-366T23:00:00Z
\tORIGINATOR = MADE

META_START
COMMENT in metadata
TRACK_ID = 7
DATA_TYPES = ANGLE_1,ANGLE_2
TIME_SYSTEM = utc
PARTICIPANT_1 = SAT
PARTICIPANT_3 = Alpha
MODE = sequential
PATH = 3, 1 ,3
TIMETAG_REF = receive
ANGLE_TYPE = azel
CORRECTION_ANGLE_1 = 0.5
CORRECTIONS_APPLIED = no
META_STOP
DATA_START
COMMENT all azimuths first, around a leap second
ANGLE_1 = 2016-12-31T23:59:59.5 +3.598E+02
ANGLE_1 = 2016-366T23:59:60.5Z 1.0d0
ANGLE_1 = 2017-001T00:00:00.5 -.5
ANGLE_2 = 2016-366T23:59:59.5 1e1
ANGLE_2 = 2016-12-31T23:59:60.500000000 10.
ANGLE_2 = 2017-01-01T00:00:00.5 351
DATA_STOP
META_START
TIME_SYSTEM = GPS
PARTICIPANT_1 = Bravo
PARTICIPANT_2 = SAT
ANGLE_TYPE = AZEL
META_STOP
DATA_START
ANGLE_1 = 2017-01-01T00:00:18.5 10
ANGLE_2 = 2017-01-01T00:00:18.5 20
DATA_STOP
"""


def test_the_letter_of_the_standard(tmp_path: Path, options: ImportOptions) -> None:
    """Two segments, one of GPS time; days of the year, exponents, a leap second, wrapping."""
    recording = read_tdm(write(tmp_path / "a.tdm", SPEC), options)
    bearings = recording.bearings
    assert bearings is not None
    # 23:59:59.5, :60.5, 00:00:00.5 UTC are a second apart; GPS time is then 18 s ahead of UTC.
    np.testing.assert_allclose(bearings.time_s, [59.5, 60.5, 61.5, 61.5], atol=1e-9)
    azimuth, elevation = np.degrees(bearings.azimuth_rad), np.degrees(bearings.elevation_rad)
    np.testing.assert_allclose((azimuth + 1e-9) % 360.0, [0.3, 1.5, 0.0, 10.0], atol=1e-8)
    np.testing.assert_allclose(elevation, [10.0, 10.0, -9.0, 20.0], atol=1e-9)
    assert [recording.sensor_names[index] for index in bearings.sensor] == [
        *(["Alpha"] * 3),
        "Bravo",
    ]


def test_frequencies_are_corrected_and_their_carrier_is_that_of_the_time(
    tmp_path: Path, options: ImportOptions
) -> None:
    chosen = ImportOptions(stations=options.stations, sigma_s=1e-7, sigma_hz=0.5)
    add = "FREQ_OFFSET = 100\nCORRECTION_RECEIVE = 7\nCORRECTIONS_APPLIED = NO\nMETA_STOP\n"
    # Before the measurement, though after it as a text.
    later = f"TRANSMIT_FREQ_2 = 2024-080T19:04:11.5 4.4E8\nDOR = {utc(10.0)}"
    text = DIFFERENCED.replace("META_STOP\n", add).replace(f"DOR = {utc(10.0)}", later)
    frequencies = read_tdm(write(tmp_path / "a.tdm", text), chosen).frequency_differences
    assert frequencies is not None
    assert frequencies.fdoa_hz.tolist() == [-1234.5 + 107.0]
    assert frequencies.carrier_hz.tolist() == [440.0e6]
    for old, new, expected in (
        ("META_STOP", "TIMETAG_REF = TRANSMIT\nMETA_STOP", "column TIMETAG_REF: is TRANSMIT"),
        ("APPLIED = NO", "APPLIED = MAYBE", r"column CORRECTION_RECEIVE: is given without CORR"),
        ("SINGLE_DIFF", "A\x00B", r"'DOR' with MODE 'A\\x00B' is not read"),
        ("SINGLE_DIFF", "Z" * 999, r"with MODE 'Z{36}\.\.\.' is not read"),
        ("PATH_2 = 2,3", "PATH_2 = " + "1," * 999 + "3", r"column PATH_2: is '1,.*\.\.\.' against"),
    ):
        with pytest.raises(InputError, match=expected):
            read_tdm(write(tmp_path / "b.tdm", text.replace(old, new)), chosen)


def test_a_radars_message_is_read_for_its_angles(tmp_path: Path, options: ImportOptions) -> None:
    rows = sightings(step_s=10.0)
    extra = f"RANGE = {utc(1.0)} 900\nDOPPLER_INTEGRATED = {utc(1.0)} -1.5\n"
    text = tdm(rows, extra=extra)
    other = text.partition("META_START")[2].partition("DATA_STOP\n")[0].replace("AZEL", "XSYE")
    path = write(tmp_path / "a.tdm", f"{text}META_START{other}DATA_STOP\n")
    ignore = ["RANGE", "DOPPLER_INTEGRATED"]
    with pytest.raises(InputError, match=r"there: --ignore RANGE --ignore DOPPLER_INTEGRATED$"):
        read_tdm(path, options)
    with pytest.raises(InputError, match=r"XSYE is not read.*\(--ignore XSYE\)"):
        read_tdm(path, options, ignore=ignore)
    check(read_tdm(path, options, ignore=[*ignore, "XSYE"]), rows)


def test_the_scatter_of_a_fast_pass_seen_seldom(tmp_path: Path, options: ImportOptions) -> None:
    """A knot for ten directions would leave 36 times the noise that there is."""
    text = tdm(sightings(sigma_deg=0.002, step_s=8.0, last_s=320.0))
    stations = ImportOptions(stations=options.stations)
    bearings = read_tdm(write(tmp_path / "a.tdm", text), stations).bearings
    assert bearings is not None
    # 40 directions less some 18 parameters, twice: 11 % at one sigma; the band is four and a half.
    found = np.degrees(np.unique(bearings.sigma_azimuth_rad))
    assert ((found > 0.001) & (found < 0.003)).all()
