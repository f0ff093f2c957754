"""TCP connections."""

from __future__ import annotations

import contextlib
import socket

from skincal.devices.link import FailureKind, Link, LinkError
from skincal.streams.transports import Opening

READ_MAX_BYTES = 65536
CONNECT_TIMEOUT_S = 1.0
"""s. A host in the same room answers in milliseconds; a reader must be able to stop."""
KEEPALIVE_IDLE_S, KEEPALIVE_PROBE_S, KEEPALIVE_PROBES = 3, 2, 3
"""s, s: a dead server is noticed after 3 + 3 * 2 = 9 s of silence. By default systems wait for two hours."""
WRITE_TIMEOUT_S = 0.5
"""s. A command is a few bytes; a peer that accepts none for so long is stuck."""


def open_transport(opening: Opening) -> Link:
    """Connect to the host and port of the address."""
    address = opening.address
    return TcpLink(address.label, address.host, address.port)


def connect_tcp(address: str, host: str, port: int) -> socket.socket:
    """Open a connection; `address` is its name in sentences. Raises LinkError."""
    try:
        connection = socket.create_connection((host, port), CONNECT_TIMEOUT_S)
    except UnicodeError as error:
        raise LinkError(FailureKind.ABSENT, f"{address}: no host can have this name; check it.") from error
    except OverflowError as error:
        raise LinkError(FailureKind.ADDRESS, f"{address}: port {port} is not in 1 ... 65535.") from error
    except OSError as error:
        raise _connect_failure(address, error) from error
    try:
        enable_keepalive(connection)
    except OSError as error:  # macOS: EINVAL if the peer has already closed the connection
        connection.close()
        raise _connect_failure(address, error) from error
    return connection


class TcpLink:
    """A connection to a TCP server."""

    tried: tuple[int, ...] = ()

    def __init__(self, address: str, host: str, port: int) -> None:
        self._name = address
        self._socket = connect_tcp(address, host, port)

    def read(self, timeout_s: float) -> bytes:
        self._socket.settimeout(timeout_s)
        try:
            data = self._socket.recv(READ_MAX_BYTES)
        except (TimeoutError, BlockingIOError):  # the second with a timeout of 0
            return b""
        except OSError as error:
            raise LinkError(FailureKind.VANISHED, closed_sentence(self._name)) from error
        if not data:
            raise LinkError(FailureKind.VANISHED, closed_sentence(self._name))
        return data

    def write(self, data: bytes) -> None:
        self._socket.settimeout(WRITE_TIMEOUT_S)
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise LinkError(FailureKind.VANISHED, closed_sentence(self._name)) from error

    def close(self) -> None:
        self._socket.close()


def enable_keepalive(connection: socket.socket) -> None:
    """Let the system probe a silent server: one that lost its power does not close the connection.

    It is probed after `KEEPALIVE_IDLE_S` of silence, `KEEPALIVE_PROBES` times. A server that answers may stay silent.
    """
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    # macOS has its own name for the first option.
    idle = getattr(socket, "TCP_KEEPIDLE", getattr(socket, "TCP_KEEPALIVE", None))
    options = {
        idle: KEEPALIVE_IDLE_S,
        getattr(socket, "TCP_KEEPINTVL", None): KEEPALIVE_PROBE_S,
        getattr(socket, "TCP_KEEPCNT", None): KEEPALIVE_PROBES,
    }
    for option, value in options.items():
        if option is not None:
            with contextlib.suppress(OSError):  # a system that knows the name, and not the option
                connection.setsockopt(socket.IPPROTO_TCP, option, value)


def closed_sentence(address: str) -> str:
    """Sentence for a connection that the other side closed."""
    return f"{address}: the other side closed the connection; it is taken up again when the server is back."


def _connect_failure(address: str, error: OSError) -> LinkError:
    if isinstance(error, ConnectionRefusedError):
        sentence = f"{address}: connection refused; no program listens there, start it or check the port number."
        return LinkError(FailureKind.REFUSED, sentence)
    if isinstance(error, socket.gaierror):
        return LinkError(FailureKind.ABSENT, f"{address}: no host of this name is known; check the name, or give its number.")
    if isinstance(error, TimeoutError):
        return LinkError(
            FailureKind.ABSENT, f"{address}: no answer within {CONNECT_TIMEOUT_S:g} s; check the cable and the number."
        )
    return LinkError(FailureKind.OTHER, f"{address}: cannot connect: {error.strerror or error}.")
