"""Streams with faults in them: each ends as the clean stream does, each bad line is named once."""

from __future__ import annotations

import json
import random
import re
from collections import Counter
from dataclasses import replace
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest
from stand_in_engine import POISON_SIGMA_DEG, StandInEngine

from geograph.errors import InputError
from geograph.feed import Assembler, Line, RowParser, Session
from geograph.feed.intake import QUEUE_LENGTH, Intake
from geograph.sensors import Sensor

PLACES = {"A": [0.0, 0.0, 0.0], "B": [4000.0, 0.0, 0.0], "C": [0.0, 4000.0, 50.0]}
SENSORS = {
    name: Sensor(name=name, position_m=np.array(place), axes="xyz")
    for name, place in PLACES.items()
}
RECORDING = SimpleNamespace(sensors=SENSORS)
OBJECT = np.array([1500.0, 2500.0, 900.0])


class ListSource:
    place, numbered = "stdin", False

    def __init__(self, lines):
        self.lines = lines

    def items(self, stop):
        for number, text in enumerate(self.lines, start=1):
            if stop.is_set():
                return
            yield Line(number, text)


class Lines:
    """An output that keeps what it is given."""

    def __init__(self):
        self.values = []

    def write(self, line, update, *, final=False):
        assert line.endswith("\n")
        value = json.loads(line)
        assert (value["update"], value.get("final", False)) == (update, final)
        self.values.append(value)


def bearing(rng, time):
    name = rng.choice("ABC")
    x, y, z = OBJECT - PLACES[name]
    return {
        "time_s": time,
        "sensor": name,
        "azimuth_deg": float(np.degrees(np.arctan2(y, x))) + rng.gauss(0.0, 0.05),
        "elevation_deg": float(np.degrees(np.arctan2(z, np.hypot(x, y)))) + rng.gauss(0.0, 0.05),
        "sigma_deg": 0.05,
    }


def bad_line(rng, time):
    """Return a line that cannot be used, and what is said of it."""
    row = bearing(rng, time)
    kinds = [
        (row | {rng.choice(list(row)): float("nan")}, "nan"),
        (row | {"sensor": "Z"}, "unknown sensor 'Z'"),
        (row | {"sigma_deg": -1.0}, "expected a sigma above 0"),
        (row | {"elevation_deg": 90.5}, "expected -90 to 90"),
        (row | {"sigma_deg": POISON_SIGMA_DEG}, "ZeroDivisionError: an exception inside a factor"),
        (row | {"elevation_deg": 89.5}, "straight up, which is not determined"),
    ]
    text = json.dumps(row)
    garbage = [
        text[: rng.randrange(1, len(text))],
        rng.randbytes(20).replace(b"\n", b"?").hex(),
        "time_s,sensor,azimuth_deg",
        '{"a": [1, {"b": 2}]}',
    ]
    if rng.random() < 0.4:
        return rng.choice(garbage).encode(), ""
    value, said = rng.choice(kinds)
    return json.dumps(value).encode(), said


def run(lines, *, every_s=None):
    engine, output, reports = StandInEngine(RECORDING), Lines(), []
    session = Session(
        engine=engine,
        assembler=Assembler(SENSORS, 3e8),
        output=output,
        report=reports.append,
    )
    for batch in Intake(ListSource(lines), every_s=every_s, on_error=session.leave_out).batches():
        session.take(batch)
    return session, session.finish(), reports


def test_a_thousand_streams_with_faults_end_as_the_clean_ones():
    seen = Counter()
    for seed in range(1000):
        rng = random.Random(seed)
        lines, expected = [], {}
        clean = []
        for index in range(rng.randrange(2, 10)):
            # An indeterminate start: nothing but bad lines, or a single bearing, for a while.
            while rng.random() < 0.4:
                text, said = bad_line(rng, 0.1 * index)
                lines.append(text)
                expected[len(lines)] = said
            clean.append(json.dumps(bearing(rng, 0.1 * rng.randrange(20))).encode())
            lines.append(clean[-1])
        every_s = rng.choice([None, 0.25])
        session, estimate, reports = run(lines, every_s=every_s)
        numbers = [int(re.match(r"stdin:(\d+)", text)[1]) for text in reports]
        assert sorted(numbers) == sorted(expected), seed
        for number, text in zip(numbers, reports, strict=True):
            assert expected[number].casefold() in text.casefold(), (seed, text)
        assert session.counts.used == len(clean)
        assert session.counts.left_out == len(expected)
        alone = StandInEngine(RECORDING)
        parser = RowParser("clean")
        rows = [parser.parse(Line(n, text)) for n, text in enumerate(clean, start=1)]
        wanted = alone.update(Assembler(SENSORS, 3e8).tables(rows))
        assert sorted(session.engine.rows) == sorted(alone.rows)
        assert estimate.status == wanted.status
        if wanted.state is not None:
            np.testing.assert_array_equal(estimate.state, wanted.state)
            np.testing.assert_array_equal(estimate.covariance, wanted.covariance)
        seen.update(said or "garbage" for said in expected.values())
    assert len(seen) == 7
    assert min(seen.values()) > 100


def test_only_the_bad_row_of_a_batch_is_lost_whatever_the_engine_raises():
    rng = random.Random(1)
    rows = [bearing(rng, 0.1 * index) for index in range(64)]
    for index in (0, 17, 18, 63):
        rows[index] |= {"sigma_deg": POISON_SIGMA_DEG}
    session, _, reports = run([json.dumps(row).encode() for row in rows], every_s=1e6)
    assert [text.split(":")[1] for text in reports] == ["1", "18", "19", "64"]
    assert session.counts.used == 60
    assert session.counts.updates == 1


def test_batches_by_time_hold_rows_of_one_slot_and_older_ones_join():
    rng = random.Random(1)
    times = [0.1, 0.9, 1.0, 0.2, 1.9, 3.0, 2.0, 3.5]
    lines = [json.dumps(bearing(rng, time)).encode() for time in times]
    intake = Intake(ListSource(lines), every_s=1.0, on_error=pytest.fail)
    batches = [([row.time_s for row in batch.rows], batch.last) for batch in intake.batches()]
    assert batches == [([0.1, 0.9], 2), ([1.0, 0.2, 1.9], 5), ([3.0, 2.0, 3.5], 8)]


def test_arrivals_of_an_emission_stay_together():
    arrivals = [
        {"emission": label, "sensor": name, "toa_s": toa, "sigma_s": 1e-8}
        for label, name, toa in (("a", "A", 0.9), ("a", "B", 1.1), ("b", "A", 1.2), ("b", "B", 0.8))
    ]
    intake = Intake(
        ListSource([json.dumps(row).encode() for row in arrivals]),
        every_s=1.0,
        on_error=pytest.fail,
    )
    assert [len(batch.rows) for batch in intake.batches()] == [2, 2]


def test_what_waits_goes_into_one_update_and_a_full_queue_makes_the_reader_wait():
    rng = random.Random(1)
    count = 3 * QUEUE_LENGTH
    text = json.dumps(bearing(rng, 1.0)).encode()
    taken, filled = [], Event()

    class Counting(ListSource):
        def items(self, stop):
            for line in super().items(stop):
                taken.append(line.number)
                if len(taken) > QUEUE_LENGTH:
                    filled.set()
                yield line

    intake = Intake(Counting([text] * count), every_s=None, on_error=pytest.fail)
    batches = intake.batches()
    sizes = [len(next(batches).rows)]
    # The engine works: the reader may fill the queue, and then has one more line in its hand.
    assert filled.wait(30.0)
    ahead = len(taken) - sizes[0]
    assert ahead <= QUEUE_LENGTH + 1
    sizes += [len(batch.rows) for batch in batches]
    assert sum(sizes) == count
    assert max(sizes) == QUEUE_LENGTH


def test_what_a_source_raises_comes_out_after_what_it_gave():
    class Failing(ListSource):
        def items(self, stop):
            yield from super().items(stop)
            raise InputError("became shorter")

    line = json.dumps(bearing(random.Random(1), 1.0)).encode()
    rows = 0
    with pytest.raises(InputError, match="became shorter"):  # noqa: PT012
        for batch in Intake(Failing([line] * 3), every_s=None, on_error=pytest.fail).batches():
            rows += len(batch.rows)
    assert rows == 3


@pytest.mark.parametrize("numbered", [False, True])
def test_a_stop_uses_what_was_taken_from_a_pipe_and_leaves_the_rest_of_a_file(numbered):
    rng, given = random.Random(1), Event()
    lines = [json.dumps(bearing(rng, float(time))).encode() for time in range(10)]

    class Endless(ListSource):
        def items(self, stop):
            yield from super().items(Event())
            given.set()
            stop.wait()

    source = Endless(lines)
    source.numbered = numbered
    intake = Intake(source, every_s=1.0, on_error=pytest.fail)
    count = 0
    for batch in intake.batches():
        count += len(batch.rows)
        assert given.wait(30.0)
        intake.stop()
    assert count == (1 if numbered else 10)


def test_late_and_rejected_measurements_are_named_once():
    class Judging(StandInEngine):
        def update(self, measurements):
            found = super().update(measurements)
            late = ("bearings of A at 0.1 s, line 3",) if self.updates == 2 else ()
            rejected = ("bearings of B at 0.2 s, line 4",) if self.updates in (2, 3) else ()
            self.estimate = replace(found, late=late, rejected=rejected)
            return self.estimate

    rng, reports = random.Random(1), []
    session = Session(
        engine=Judging(RECORDING),
        assembler=Assembler(SENSORS, 3e8),
        output=Lines(),
        report=reports.append,
    )
    lines = [json.dumps(bearing(rng, float(time))).encode() for time in range(4)]
    for batch in Intake(ListSource(lines), every_s=1.0, on_error=pytest.fail).batches():
        session.take(batch)
    session.finish()
    assert reports == [
        "bearings of A at 0.1 s, line 3: came later than the lag allows and is not used",
        "bearings of B at 0.2 s, line 4: does not fit what came after it and is not used",
    ]
