"""Device ends of simulated links: TCP ports of this machine and pseudo-terminals."""

from __future__ import annotations

import contextlib
import os
import select
import socket
from typing import Protocol

from skincal.model.errors import InputError


class Outlet(Protocol):
    """Sending side of a simulated device's link."""

    address: str
    """Address for the host."""

    def poll(self) -> tuple[bool, bytes]:
        """Return whether a host connected since the last call, and the bytes it sent."""
        ...

    def write(self, data: bytes) -> None:
        """Send to connected hosts; never wait."""
        ...

    def close(self) -> None: ...


PENDING_MAX_BYTES = 1 << 20
"""A TCP client with more unsent bytes is disconnected: about 20 s of 1 kHz wrenches."""
READ_MAX_BYTES = 4096


class TcpOutlet:
    """A TCP port on this machine; every client receives the same bytes."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.setblocking(False)
        self._clients: dict[socket.socket, bytearray] = {}
        self.address = f"socket://127.0.0.1:{self._server.getsockname()[1]}"

    def poll(self) -> tuple[bool, bytes]:
        came = False
        with contextlib.suppress(BlockingIOError):
            while True:
                client, _ = self._server.accept()
                client.setblocking(False)
                # Otherwise small blocks wait for the acknowledgement of the one before.
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._clients[client] = bytearray()
                came = True
        return came, b"".join(self._read(client) for client in list(self._clients))

    def _read(self, client: socket.socket) -> bytes:
        try:
            data = client.recv(READ_MAX_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop(client)
        return data

    def write(self, data: bytes) -> None:
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
            if len(pending) > PENDING_MAX_BYTES:
                self._drop(client)

    def _share(self, client: socket.socket, data: bytes) -> bytes:
        """Prepare the bytes for one client."""
        del client
        return data

    def _drop(self, client: socket.socket) -> None:
        self._clients.pop(client, None)
        client.close()

    def close(self) -> None:
        for client in list(self._clients):
            self._drop(client)
        self._server.close()


class PtyOutlet:
    """A pseudo-terminal: a serial port without a cable. Linux and macOS only; raises InputError elsewhere."""

    def __init__(self) -> None:
        if not hasattr(os, "openpty"):
            raise InputError("this platform has no pseudo-terminals; serve over TCP instead (--tcp).")
        import tty

        self._master, slave = os.openpty()
        self.address = os.ttyname(slave)
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        # Only the host has the slave open, so that a hang-up shows that no host listens.
        os.close(slave)
        self._poller = select.poll()
        self._poller.register(self._master, select.POLLIN)
        self._was_open = False

    def poll(self) -> tuple[bool, bytes]:
        events = self._poller.poll(0)
        state = events[0][1] if events else 0
        open_now = not state & select.POLLHUP
        came = open_now and not self._was_open
        self._was_open = open_now
        data = b""
        # Also reads the last bytes of a host that left.
        if state & select.POLLIN:
            with contextlib.suppress(BlockingIOError, OSError):
                data = os.read(self._master, READ_MAX_BYTES)
        return came, data

    def write(self, data: bytes) -> None:
        """Write; bytes beyond the port's buffer are lost, as in a serial overrun."""
        if self._was_open:
            with contextlib.suppress(BlockingIOError, OSError):
                os.write(self._master, data)

    def close(self) -> None:
        if self._master >= 0:
            os.close(self._master)
            self._master = -1
