"""UDP with one host, or on a port where one host sends; each datagram becomes a packet, or lines of text."""

from __future__ import annotations

import contextlib
import select
import socket
import sys
import time

from skincal.devices.datagrams import DATAGRAM_MAX_BYTES as LISTENED_MAX_BYTES
from skincal.devices.datagrams import OTHER_SENDER_KIND, READING_KIND
from skincal.devices.decoding import pack, pack_all
from skincal.devices.family import AUTO_FORMAT, Form
from skincal.devices.link import FailureKind, Link, LinkError
from skincal.streams.transports import Opening

DATAGRAM_MAX_BYTES = 1472
"""Longest datagram that passes Ethernet in one piece; no device here sends longer ones."""
MAX_DATAGRAMS_PER_READ = 64
"""More than come while a busy program waits 60 ms, at 1 kHz."""
SENDER_SILENT_AFTER_S = 1.0
"""s. After this silence of its sender a port reads another one: a board that started again sends from another port."""
RECEIVE_BUFFER_BYTES = 1 << 20
"""Buffer of the system for a program that is held up: some seconds at 1 kHz, each datagram with the system's own 700 bytes."""


def open_transport(opening: Opening) -> Link:
    """Connect to the host and port of the address, or listen on its port."""
    address = opening.address
    if address.route.form is Form.LISTEN:
        return ListeningLink(address.label, address.port, is_text=address.route.format == AUTO_FORMAT)
    limit = address.route.message_max or DATAGRAM_MAX_BYTES
    link = DatagramLink(address.label, address.host, address.port, address.route.message_kind, limit)
    if address.group is not None:
        link.join(*address.group)
    return link


class DatagramLink:
    """UDP with one host; each datagram, of `limit` bytes at most, is a packet of the given kind."""

    tried: tuple[int, ...] = ()

    def __init__(self, address: str, host: str, port: int, kind: int, limit: int = DATAGRAM_MAX_BYTES) -> None:
        self._address, self._kind, self._limit = address, kind, limit
        self._group: socket.socket | None = None
        """Where the host multicasts."""
        try:
            family, *_, place = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
            # Connected: what others send does not arrive.
            self._socket.connect(place)
            self._socket.setblocking(False)
        except UnicodeError as error:
            raise LinkError(FailureKind.ABSENT, f"{address}: no host can have this name; check it.") from error
        except OSError as error:
            raise LinkError(FailureKind.ABSENT, f"{address}: cannot be reached: {error.strerror or error}.") from error

    def join(self, group: str, port: int) -> None:
        """Read what the host sends to a multicast group, too. Raises LinkError."""
        here = self._socket.getsockname()[0]
        listening = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            # Several programs of one computer may read a group.
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
            listening.bind(("" if sys.platform == "win32" else group, port))
            listening.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + socket.inet_aton(here))
            listening.setblocking(False)
        except OSError as error:
            listening.close()
            self.close()
            raise LinkError(
                FailureKind.IN_USE,
                f"{self._address}: it multicasts to {group}:{port}, which cannot be read ({error.strerror or error}); let it "
                "send by unicast.",
            ) from error
        self._group = listening

    def read(self, timeout_s: float) -> bytes:
        return pack_all(self._kind, self.read_datagrams(timeout_s))

    def read_datagrams(self, timeout_s: float) -> list[bytes]:
        """Return the datagrams of the host, waiting at most `timeout_s` for the first. Raises LinkError."""
        datagrams: list[bytes] = []
        try:
            ready = select.select([self._socket, *([] if self._group is None else [self._group])], [], [], timeout_s)[0]
            if self._group in ready:
                datagrams += self._read_group(self._group)
            while self._socket in ready and len(datagrams) < MAX_DATAGRAMS_PER_READ:
                datagrams.append(self._socket.recv(self._limit))
        except BlockingIOError:
            pass
        except OSError as error:
            if not datagrams:
                raise LinkError(FailureKind.REFUSED, _nobody(self._address)) from error
        return datagrams

    def _read_group(self, group: socket.socket) -> list[bytes]:
        """Return the datagrams of the group that the host sent; others may send there, too."""
        host, found = self._socket.getpeername()[0], list[bytes]()
        with contextlib.suppress(BlockingIOError):
            for _ in range(MAX_DATAGRAMS_PER_READ):
                data, sender = group.recvfrom(self._limit)
                found += [data] if sender[0] == host else []
        return found

    def write(self, data: bytes) -> None:
        # What a full buffer or a host that is away does to a datagram is what the network may do, too: asked again later.
        with contextlib.suppress(OSError):
            self._socket.send(data)

    def close(self) -> None:
        self._socket.close()
        if self._group is not None:
            self._group.close()


class ListeningLink:
    """A UDP port of this computer. The first sender is read, and none of the others: two boards would mix their readings."""

    tried: tuple[int, ...] = ()

    def __init__(self, address: str, port: int, *, is_text: bool) -> None:
        self._is_text = is_text
        self._sender: tuple[str, int] | None = None
        self._heard_s = 0.0
        self._others: set[tuple[str, int]] = set()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
            self._socket.bind(("", port))
            self._socket.setblocking(False)
        except OSError as error:
            self._socket.close()
            raise LinkError(
                FailureKind.IN_USE,
                f"{address}: port {port} cannot be opened ({error.strerror or error}); close the program that listens there, "
                "or let the sender use another port.",
            ) from error

    def read(self, timeout_s: float) -> bytes:
        if not select.select([self._socket], [], [], timeout_s)[0]:
            return b""
        found: list[bytes] = []
        with contextlib.suppress(OSError):  # no more wait, or a sender is gone
            while len(found) < MAX_DATAGRAMS_PER_READ:
                data, sender = self._socket.recvfrom(LISTENED_MAX_BYTES)
                found.append(self._accept(data, sender))
        return b"".join(found)

    def _accept(self, data: bytes, sender: tuple[str, int]) -> bytes:
        now_s = time.monotonic()
        if self._sender is None or now_s - self._heard_s > SENDER_SILENT_AFTER_S:
            self._sender = sender
            self._others.discard(sender)
        if sender != self._sender:
            return self._name_other(sender)
        self._heard_s = now_s
        if self._is_text:
            # A datagram is a whole line, with or without its end.
            return data if data.endswith((b"\n", b"\r")) else data + b"\n"
        return pack(READING_KIND, data)

    def _name_other(self, sender: tuple[str, int]) -> bytes:
        """Return a packet that names another sender once; text has no place for it."""
        if self._is_text or sender in self._others or len(self._others) >= MAX_DATAGRAMS_PER_READ:
            return b""
        self._others.add(sender)
        return pack(OTHER_SENDER_KIND, f"{sender[0]}:{sender[1]}".encode())

    def write(self, data: bytes) -> None:
        """Nothing is sent: a datagram of text or numbers needs no answer."""

    def close(self) -> None:
        self._socket.close()


def _nobody(address: str) -> str:
    return f"{address}: nothing listens there; switch the sensor on, or check the number."
