"""The journal and the output file: what a killed process or a full disk leaves of them."""

from __future__ import annotations

import errno
import json
import os
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geograph.errors import InputError
from geograph.feed import Journal, Row
from geograph.feed.intake import Batch
from geograph.feed.journal import Resumed
from geograph.feed.output import FileOutput
from geograph.feed.session import Counts, Known

HEADER = {"sensors or settings": "abc"}


def batch(first, count):
    rows = [
        Row(n, n + 1, "naïve.csv", "bearings", {"time_s": 0.1 * n, "sensor": "A", "x": None})
        for n in range(first, first + count)
    ]
    return Batch(rows, first + count - 1)


def write(path, batches):
    journal = Journal(path, HEADER)
    for each in batches:
        journal.append(each)
    journal.close()
    return path.read_bytes()


def read(path, header=HEADER):
    journal = Journal(path, header)
    journal.close()
    return journal.resumed


def test_what_is_written_is_read_back(tmp_path):
    batches = [batch(1, 3), batch(4, 1), batch(5, 2)]
    write(tmp_path / "j", batches)
    resumed = read(tmp_path / "j")
    assert resumed.batches == batches
    assert (resumed.last, resumed.torn_bytes) == (6, 0)
    assert [row.number for row in resumed.rows()] == [1, 2, 3, 4, 5, 6]
    write(tmp_path / "j", [batch(7, 1)])
    assert read(tmp_path / "j").last == 7


def test_cut_at_any_byte_all_whole_records_are_left(tmp_path):
    path = tmp_path / "j"
    whole = write(path, [batch(1, 2), batch(3, 1)])
    ends = [index + 1 for index, byte in enumerate(whole) if byte == ord("\n")]
    for size in sorted({*ends, *(end - 1 for end in ends), *range(0, len(whole), 11)}):
        path.write_bytes(whole[:size])
        resumed = read(path)
        records = sum(end <= size for end in ends)
        assert len(resumed.batches) == max(0, records - 1)
        assert resumed.torn_bytes == size - max([0, *(end for end in ends if end <= size)])
        # What is appended afterwards follows on a whole record.
        journal = Journal(path, HEADER)
        journal.append(batch(9, 1))
        journal.close()
        assert read(path).batches[-1] == batch(9, 1)


@given(data=st.data())
@settings(max_examples=60)
def test_a_byte_that_changed_is_never_taken_for_a_measurement(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("j") / "j"
    batches = [batch(1, 1), batch(2, 1), batch(3, 1)]
    whole = write(path, batches)
    content = bytearray(whole)
    at = data.draw(st.integers(0, len(content) - 1))
    content[at] ^= data.draw(st.integers(1, 255))
    path.write_bytes(content)
    last = whole.rfind(b"\n", 0, -1)
    if at <= last:
        with pytest.raises(InputError, match=r"is damaged|is not a journal"):
            read(path)
        assert path.read_bytes() == content
        return
    try:
        found = read(path).batches
    except InputError:
        # Its length is no longer one that could have been cut short.
        assert path.read_bytes() == content
    else:
        assert found == batches[:2]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"time_s,sensor\n1,A\n", "is not a journal of geograph and is not overwritten"),
        (b"my notes", "is not a journal of geograph and is not overwritten"),
    ],
)
def test_other_files_are_left_alone(tmp_path, content, message):
    path = tmp_path / "j"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        Journal(path, HEADER)
    assert path.read_bytes() == content


def test_other_configurations_versions_and_users_are_refused(tmp_path):
    path = tmp_path / "j"
    write(path, [batch(1, 1)])
    with pytest.raises(InputError, match="belongs to other sensors or settings"):
        Journal(path, {"sensors or settings": "abd"})
    first = Journal(path, HEADER)
    with pytest.raises(InputError, match="is in use by another process"):
        Journal(path, HEADER)
    first.close()
    with pytest.raises(InputError, match="cannot be opened"):
        Journal(tmp_path / "absent" / "j", HEADER)


def test_a_full_disk_leaves_whole_records_and_says_so(tmp_path, monkeypatch):
    path = tmp_path / "j"
    write(path, [batch(1, 2)])
    before = path.read_bytes()
    real = os.pwrite

    def full(descriptor, data, offset):
        room = len(before) + 30 - offset
        if room <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(descriptor, data[:room], offset)

    journal = Journal(path, HEADER)
    monkeypatch.setattr(os, "pwrite", full)
    with pytest.raises(OSError, match="No space left on device; the journal is whole") as raised:
        journal.append(batch(3, 2))
    assert raised.value.filename == str(path)
    assert path.read_bytes() == before
    monkeypatch.undo()
    # Room was made: it goes on.
    journal.append(batch(3, 2))
    journal.close()
    assert read(path).batches == [batch(1, 2), batch(3, 2)]


def test_known_rows_of_a_file_are_those_with_their_numbers():
    counts = Counts()
    known = Known(Resumed([batch(1, 2), Batch(batch(4, 1).rows, 6)]), numbered=True, counts=counts)
    line = SimpleNamespace(number=3, text=b"garbage")
    assert known(line)  # It was reported when it was read first.
    assert [known(row) for row in batch(1, 8).rows if row.number not in (3, 5, 6)] == [
        True,
        True,
        True,
        False,
        False,
    ]
    assert counts.known == 3
    other = Row(4, 5, "feed.jsonl", "bearings", {"time_s": 9.0})
    with pytest.raises(InputError, match=r"feed.jsonl:5: is not what the journal has of that line"):
        known(other)


def test_known_rows_of_a_pipe_are_those_that_say_the_same():
    counts = Counts()
    known = Known(Resumed([batch(1, 2)]), numbered=False, counts=counts)
    same, fresh = batch(1, 1).rows[0], batch(7, 1).rows[0]
    moved = Row(90, 90, "stdin", same.table, same.cells)
    assert [known(moved), known(fresh)] == [True, False]
    assert counts.known == 1


def line_of(update, final=False):
    facts = {"update": update} | ({"final": True} if final else {})
    return json.dumps(facts | {"x_m": 1.0}) + "\n"


def test_the_output_file_has_each_update_once_and_whole(tmp_path):
    path = tmp_path / "out.jsonl"
    output = FileOutput(path, resume=None)
    for update in (1, 2):
        output.write(line_of(update), update)
    output.close()
    with path.open("ab") as file:
        file.write(b'{"update": 3, "x_')
    output = FileOutput(path, resume=3)
    assert path.read_bytes().endswith(b"}\n")
    for update in (1, 2, 3):
        output.resume(line_of(update), update, last=update == 3)
    output.write(line_of(4), 4)
    output.write(line_of(4, final=True), 4, final=True)
    output.close()
    output = FileOutput(path, resume=4)
    output.resume(line_of(4), 4, last=True)
    output.write(line_of(4, final=True), 4, final=True)
    output.write(line_of(5), 5)
    output.close()
    lines = [json.loads(text) for text in path.read_text().splitlines()]
    assert [line["update"] for line in lines] == [1, 2, 3, 4, 4, 5]
    assert [line.get("final", False) for line in lines] == [False] * 4 + [True, False]
    FileOutput(path, resume=None).close()
    assert path.read_bytes() == b""


def test_the_output_file_is_not_another_one(tmp_path):
    path = tmp_path / "out.jsonl"
    path.write_text("precious\n")
    with pytest.raises(InputError, match="holds something else than lines of geograph track"):
        FileOutput(path, resume=None)
    assert path.read_text() == "precious\n"
    path.write_text(line_of(7))
    with pytest.raises(InputError, match="has a line of update 7, and the journal 3 updates"):
        FileOutput(path, resume=3)
    with pytest.raises(InputError, match="cannot be written"):
        FileOutput(tmp_path / "absent" / "out", resume=None)


def test_a_full_disk_leaves_whole_lines(tmp_path, monkeypatch):
    path = tmp_path / "out.jsonl"
    output = FileOutput(path, resume=None)
    output.write(line_of(1), 1)
    before, real = path.read_bytes(), os.pwrite

    def full(descriptor, data, offset):
        if offset > len(before):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(descriptor, data[:5], offset)

    monkeypatch.setattr(os, "pwrite", full)
    with pytest.raises(OSError, match="the file ends with a whole line"):
        output.write(line_of(2), 2)
    assert path.read_bytes() == before
    output.close()
