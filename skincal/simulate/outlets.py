"""The ends of simulated links: TCP ports of this machine and pseudo-terminals."""

from __future__ import annotations

import contextlib
import os
import select
import socket
from typing import Protocol

from skincal.model.errors import InputError


class Outlet(Protocol):
    """One link's end on the board's side."""

    address: str
    """What a host opens."""

    def poll(self) -> tuple[bool, bytes]:
        """Return whether somebody came since the last call, and what was said to the board."""
        ...

    def write(self, data: bytes) -> None:
        """Send to those who listen, without ever waiting."""
        ...

    def close(self) -> None:
        """Hang up."""
        ...


PENDING_MAX = 1 << 20
"""Bytes. A TCP client that is this far behind is let go: about 20 s of 1 kHz wrenches."""
READ_SIZE = 4096


class TcpOutlet:
    """A port on this machine; every client gets the same bytes."""

    def __init__(self) -> None:
        # A port that is free, and for this machine alone.
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.setblocking(False)
        self._clients: dict[socket.socket, bytearray] = {}
        self.address = f"socket://127.0.0.1:{self._server.getsockname()[1]}"

    def poll(self) -> tuple[bool, bytes]:
        """Return whether somebody came since the last call, and what was sent to the board."""
        came = False
        with contextlib.suppress(BlockingIOError):
            while True:
                client, _ = self._server.accept()
                client.setblocking(False)
                # At once: small blocks would wait until the other side has acknowledged the one before.
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._clients[client] = bytearray()
                came = True
        # Over a copy, since a client that is gone is dropped meanwhile.
        return came, b"".join(self._read(client) for client in list(self._clients))

    def _read(self, client: socket.socket) -> bytes:
        try:
            data = client.recv(READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop(client)
        return data

    def write(self, data: bytes) -> None:
        """Send to every client what its connection takes; keep the rest for the next time."""
        for client, pending in list(self._clients.items()):
            pending += self._share(client, data)
            try:
                sent = client.send(pending) if pending else 0
            except BlockingIOError:
                sent = 0
            except OSError:
                self._drop(client)
                continue
            del pending[:sent]
            if len(pending) > PENDING_MAX:
                self._drop(client)

    def _share(self, client: socket.socket, data: bytes) -> bytes:
        """Return what of `data` a client gets."""
        del client
        return data

    def _drop(self, client: socket.socket) -> None:
        self._clients.pop(client, None)
        client.close()

    def close(self) -> None:
        """Close the port and every client."""
        for client in list(self._clients):
            self._drop(client)
        self._server.close()


class PtyOutlet:
    """A pseudo-terminal: a serial port without a cable. Linux and macOS only.

    Raises
    ------
    InputError
        This platform has none.
    """

    def __init__(self) -> None:
        if not hasattr(os, "openpty"):
            raise InputError("this platform has no pseudo-terminals; serve over TCP instead (--tcp).")
        import tty

        self._master, slave = os.openpty()
        self.address = os.ttyname(slave)
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        # Only the host keeps the slave open: so the kernel tells by a hang-up whether somebody listens.
        os.close(slave)
        self._poller = select.poll()
        self._poller.register(self._master, select.POLLIN)
        self._was_open = False

    def poll(self) -> tuple[bool, bytes]:
        """Return whether the port was opened since the last call, and what was written to it."""
        events = self._poller.poll(0)
        state = events[0][1] if events else 0
        open_now = not state & select.POLLHUP
        came = open_now and not self._was_open
        self._was_open = open_now
        data = b""
        # Also of one that has left: its last words.
        if state & select.POLLIN:
            with contextlib.suppress(BlockingIOError, OSError):
                data = os.read(self._master, READ_SIZE)
        return came, data

    def write(self, data: bytes) -> None:
        """Write what the port takes; the rest is lost, as in a serial port's overrun."""
        if self._was_open:
            with contextlib.suppress(BlockingIOError, OSError):
                os.write(self._master, data)

    def close(self) -> None:
        """Pull the plug: who has the port open gets an error."""
        if self._master >= 0:
            os.close(self._master)
            self._master = -1
