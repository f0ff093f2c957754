"""UDP with one host; each datagram becomes a packet."""

from __future__ import annotations

import contextlib
import select
import socket

from skincal.devices.decoding import pack
from skincal.devices.link import FailureKind, Link, LinkError
from skincal.streams.transports import Opening

DATAGRAM_MAX_BYTES = 1472
"""Longest datagram that passes Ethernet in one piece; no device here sends longer ones."""
MAX_DATAGRAMS_PER_READ = 64
"""More than come while a busy program waits 60 ms, at 1 kHz."""
RECEIVE_BUFFER_BYTES = 1 << 20
"""Buffer of the system for a program that is held up: some seconds at 1 kHz, each datagram with the system's own 700 bytes."""


def open_transport(opening: Opening) -> Link:
    """Connect to the host and port of the address."""
    address = opening.address
    return DatagramLink(address.label, address.host, address.port, address.route.message_kind)


class DatagramLink:
    """UDP with one host; each datagram is a packet of the given kind."""

    def __init__(self, address: str, host: str, port: int, kind: int) -> None:
        self._address, self._kind = address, kind
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

    def read(self, timeout_s: float) -> bytes:
        datagrams: list[bytes] = []
        try:
            if not select.select([self._socket], [], [], timeout_s)[0]:
                return b""
            while len(datagrams) < MAX_DATAGRAMS_PER_READ:
                datagrams.append(self._socket.recv(DATAGRAM_MAX_BYTES))
        except BlockingIOError:
            pass
        except OSError as error:
            if not datagrams:
                raise LinkError(FailureKind.REFUSED, _nobody(self._address)) from error
        return b"".join(pack(self._kind, datagram) for datagram in datagrams)

    def write(self, data: bytes) -> None:
        # What a full buffer or a host that is away does to a datagram is what the network may do, too: asked again later.
        with contextlib.suppress(OSError):
            self._socket.send(data)

    def close(self) -> None:
        self._socket.close()


def _nobody(address: str) -> str:
    return f"{address}: nothing listens there; switch the sensor on, or check the number."
