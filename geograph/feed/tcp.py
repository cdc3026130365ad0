"""Lines that programs on this machine send over TCP."""

from __future__ import annotations

import ipaddress
import selectors
import socket
from typing import TYPE_CHECKING

from geograph.errors import InputError
from geograph.feed.rows import Line
from geograph.feed.sources import POLL_S, LineSplitter
from geograph.io.messages import shown

if TYPE_CHECKING:
    from collections.abc import Iterator
    from threading import Event

    from geograph.feed.rows import Row

_PIECE = 1 << 16


def parse_address(text: str) -> tuple[str, int]:
    """Return the host and port of a loopback address.

    >>> parse_address("127.0.0.1:4000"), parse_address("[::1]:0")
    (('127.0.0.1', 4000), ('::1', 0))

    Raises
    ------
    InputError
        If it is none.
    """
    host, colon, port = text.rpartition(":")
    bare = host.removeprefix("[").removesuffix("]")
    if not (colon and port.isascii() and port.isdigit() and int(port) <= 65535):
        raise InputError(
            f"--listen is {shown(text)}; expected ADDRESS:PORT, such as 127.0.0.1:4000"
        )
    try:
        loopback = bare == "localhost" or ipaddress.ip_address(bare).is_loopback
    except ValueError:
        loopback = False
    if not loopback:
        raise InputError(
            f"--listen is {shown(text)}; expected a loopback address (127.0.0.1, ::1 or "
            "localhost), for whoever can connect can send measurements, and nothing is encrypted; "
            "let lines from elsewhere in by a tunnel, such as ssh -R"
        )
    return ("127.0.0.1" if bare == "localhost" else bare), int(port)


class TcpSource:
    """Lines of all connections to a loopback port, numbered as they come in.

    Parameters
    ----------
    address
        Host and port; port 0: a free one.
    once
        Whether to end when all connections, of which there was one at least, are closed.

    Attributes
    ----------
    port
        Where it listens.

    Raises
    ------
    InputError
        If the port cannot be had.
    """

    numbered = False

    def __init__(self, address: tuple[str, int], *, once: bool = False) -> None:
        host, port = address
        self._once = once
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._listener = socket.socket(family, socket.SOCK_STREAM)
        try:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.bind((host, port))
            self._listener.listen()
        except OSError as error:
            self._listener.close()
            raise InputError(
                f"--listen {host}:{port} cannot be had ({error.strerror}); name another port, or "
                "0 for a free one"
            ) from None
        self._listener.setblocking(False)
        self.port = int(self._listener.getsockname()[1])
        self.place = f"[{host}]:{self.port}" if ":" in host else f"{host}:{self.port}"

    def items(self, stop: Event) -> Iterator[Line | Row]:
        """Yield lines of all connections."""
        number, open_ = 0, 0
        with selectors.DefaultSelector() as selector, self._listener:
            selector.register(self._listener, selectors.EVENT_READ)
            while not stop.is_set():
                for key, _ in selector.select(POLL_S):
                    if key.data is None:
                        accepted, _ = self._listener.accept()
                        selector.register(accepted, selectors.EVENT_READ, LineSplitter())
                        open_ += 1
                        continue
                    connection, splitter = key.fileobj, key.data
                    assert isinstance(connection, socket.socket)
                    data = _received(connection)
                    for text, cut in splitter.feed(data):
                        number += 1
                        yield Line(number, text, cut)
                    if data:
                        continue
                    selector.unregister(connection)
                    connection.close()
                    open_ -= 1
                    if splitter.rest():
                        # Half a line that happens to be JSON is still half a line.
                        number += 1
                        yield Line(number, b"", cut=True)
                    if self._once and not open_:
                        return


def _received(connection: socket.socket) -> bytes:
    try:
        return connection.recv(_PIECE)
    except OSError:
        # Reset by the other side: the end, as when it closes.
        return b""
