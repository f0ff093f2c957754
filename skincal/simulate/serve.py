"""Plays a time line in real time: a device process that a program cannot tell from hardware.

Bytes come out at a TCP port or a pseudo-terminal. Like a board, an outlet goes on whether or not somebody listens: bytes
without a listener are gone, and a listener may leave and come back at any time.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import time
from collections.abc import Mapping
from typing import Protocol

from skincal.model.errors import InputError
from skincal.model.readings import Stream
from skincal.simulate.device import DeviceTimeline
from skincal.streams.links import LinkSpec

LATE_MAX_S = 1.0
"""s. When the machine slept longer than this, the boards go on from now rather than send it all at once."""


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


class Server:
    """One outlet a link, TCP ports on this machine or pseudo-terminals, and the loop that feeds them.

    Boards understand the commands of SKT/1 and SKB/1: `?` sends the header, `P` pauses, `S` starts again.

    Raises
    ------
    InputError
        Pseudo-terminals are wanted and this platform has none.
    """

    def __init__(self, line: DeviceTimeline, *, tcp: bool) -> None:
        self._line = line
        self._outlets: dict[str, Outlet] = {}
        speakers = line.settings.speakers
        try:
            if speakers:
                self._open_makers(speakers, tcp=tcp)
            for name in line.links:
                if name not in self._outlets:
                    self._outlets[name] = TcpOutlet() if tcp else PtyOutlet()
        except BaseException:
            self.close()
            raise
        self._paused: set[str] = set()

    def _open_makers(self, speakers: Mapping[Stream, str], *, tcp: bool) -> None:
        from skincal.simulate.outlets import MakerOutlets

        makers = MakerOutlets()
        for name, stream in self._line.links.items():
            if stream in speakers:
                self._outlets[name] = makers.open(speakers[stream], stream, tcp=tcp)

    @property
    def links(self) -> tuple[LinkSpec, ...]:
        """What a host opens."""
        return tuple(LinkSpec(name, self._outlets[name].address, (stream,)) for name, stream in self._line.links.items())

    def run(self, stop: threading.Event) -> None:
        """Play until `stop` is set."""
        start = time.monotonic() - self._line.now
        while not stop.is_set():
            late = time.monotonic() - start - self._line.now
            if late > LATE_MAX_S:
                start += late
            elif late < self._line.settings.block_s:
                stop.wait(self._line.settings.block_s - late)
                continue
            self._listen()
            for _, link, data in self._line.step():
                if link not in self._paused:
                    self._outlets[link].write(data)

    def _listen(self) -> None:
        for name, outlet in self._outlets.items():
            came, said = outlet.poll()
            if b"P" in said:
                self._paused.add(name)
            if b"S" in said or came:
                self._paused.discard(name)
            if b"?" in said or came:
                outlet.write(self._line.greeting(name))

    def close(self) -> None:
        """Close every outlet."""
        for outlet in self._outlets.values():
            outlet.close()


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
        if open_now and state & select.POLLIN:
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
