"""Sources: pipes, files that grow, connections, recordings in step with a clock."""

from __future__ import annotations

import os
import socket
import threading
import time
from threading import Event

import numpy as np
import pytest
from small_recordings import write_signals, write_small

import geograph as gg
from geograph.errors import InputError
from geograph.feed.replay import ReplaySource
from geograph.feed.rows import LONGEST_LINE
from geograph.feed.sources import FileSource, LineSplitter, PipeSource
from geograph.feed.tcp import TcpSource, parse_address


def texts(items):
    return [(item.number, item.text, item.cut) for item in items]


def test_lines_are_cut_wherever_pieces_end():
    data = b"one\ntwo\r\n\n" + b"x" * (LONGEST_LINE + 5) + b"\nlast"
    wanted = [(b"one", False), (b"two", False), (b"", False), (b"x" * 100, True)]
    for size in (3, 1000, len(data)):
        splitter, found = LineSplitter(), []
        for start in range(0, len(data), size):
            found += splitter.feed(data[start : start + size])
        assert found == wanted
        assert splitter.rest() == b"last"


def test_a_pipe_gives_lines_until_it_is_closed():
    reading, writing = os.pipe()
    os.write(writing, b"a\nb\nc")
    os.close(writing)
    assert texts(PipeSource(reading).items(Event())) == [
        (1, b"a", False),
        (2, b"b", False),
        (3, b"c", False),
    ]
    os.close(reading)


def test_a_silent_pipe_ends_when_it_is_asked_to():
    reading, writing = os.pipe()
    stop = Event()
    threading.Timer(0.05, stop.set).start()
    assert texts(PipeSource(reading).items(stop)) == []
    os.close(writing)
    os.close(reading)


def test_a_file_is_read_once_or_followed(tmp_path):
    path = tmp_path / "feed.jsonl"
    path.write_bytes(b"a\nb")
    assert texts(FileSource(path).items(Event())) == [(1, b"a", False), (2, b"b", False)]
    stop = Event()
    found = FileSource(path, follow=True).items(stop)
    assert next(found) == (1, b"a", False)
    with path.open("ab") as file:
        file.write(b"b\nc\nd")
    # What is not ended may still be written to.
    assert texts([next(found), next(found)]) == [(2, b"bb", False), (3, b"c", False)]
    path.write_bytes(b"")
    with pytest.raises(InputError, match="became shorter while it was followed"):
        next(found)
    with pytest.raises(InputError, match="cannot be read"):
        FileSource(tmp_path / "absent")


def test_connections_are_read_side_by_side():
    source, stop, found = TcpSource(("127.0.0.1", 0), once=True), Event(), []
    thread = threading.Thread(target=lambda: found.extend(texts(source.items(stop))))
    thread.start()
    first = socket.create_connection(("127.0.0.1", source.port))
    second = socket.create_connection(("127.0.0.1", source.port))
    second.sendall(b"b1\nb2\nhal")
    second.close()
    deadline = time.monotonic() + 30.0
    while len(found) == 0 and thread.is_alive() and time.monotonic() < deadline:
        first.sendall(b"a1\n")
        first.close()
        thread.join(30.0)
    assert not thread.is_alive()
    assert sorted(text for _, text, _ in found) == [b"", b"a1", b"b1", b"b2"]
    assert sorted(number for number, _, _ in found) == [1, 2, 3, 4]
    assert [text for _, text, cut in found if cut] == [b""]
    assert source.place == f"127.0.0.1:{source.port}"


def test_a_listener_ends_when_it_is_asked_to_and_its_port_is_its_own():
    source, stop = TcpSource(("127.0.0.1", 0)), Event()
    with pytest.raises(InputError, match=r"cannot be had .*; name another port"):
        TcpSource(("127.0.0.1", source.port))
    stop.set()
    assert texts(source.items(stop)) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0.0.0.0:4000", "expected a loopback address .* whoever can connect"),
        ("192.168.1.2:4000", "expected a loopback address"),
        ("example.org:4000", "expected a loopback address"),
        ("[::]:4000", "expected a loopback address"),
        ("4000", "expected ADDRESS:PORT"),
        ("127.0.0.1:99999", "expected ADDRESS:PORT"),
        ("127.0.0.1:", "expected ADDRESS:PORT"),
    ],
)
def test_only_loopback_addresses_are_listened_on(text, message):
    with pytest.raises(InputError, match=message):
        parse_address(text)
    assert parse_address("localhost:1") == ("127.0.0.1", 1)


def test_a_recording_is_replayed_in_step_with_the_clock(tmp_path, monkeypatch):
    recording = gg.read(write_small(tmp_path / "small"))
    now, waits = [100.0], []

    class Clock(Event):
        def wait(self, timeout=None):
            waits.append(timeout)
            now[0] += timeout
            return False

    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    source = ReplaySource(recording, rate=2.0, begin_after=60)
    rows = list(source.items(Clock()))
    assert [row.number for row in rows] == list(range(1, 121))
    # Rows 61 to 120 span 4.75 s of the recording; those before are known and not waited for.
    assert len(waits) == 60
    np.testing.assert_allclose(now[0] - 100.0, 4.75 / 2.0)
    stopped = Event()
    stopped.set()
    assert list(source.items(stopped)) == []


def test_arrivals_of_an_emission_are_replayed_together(tmp_path):
    # The slow signal of an emission arrives after the next one was sent.
    recording = gg.read(write_signals(tmp_path / "s", tables=("arrivals",), speed_m_s=340.0))
    rows = ReplaySource(recording).rows
    labels = [row.cells["emission"] for row in rows]
    assert [label for i, label in enumerate(labels) if i == 0 or labels[i - 1] != label] == [
        str(number) for number in range(40)
    ]
    times = [row.time_s for row in rows]
    assert times != sorted(times)
