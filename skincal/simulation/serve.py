"""Devices served in real time at TCP ports or pseudo-terminals; to a host they look like hardware.

Like a board, an outlet sends whether or not a host listens. A host may leave and come back at any time.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from typing import Protocol

from skincal.model.readings import Stream
from skincal.simulation.emulated_transports import MakerOutlets
from skincal.simulation.outlets import Outlet, PtyOutlet, TcpOutlet
from skincal.streams.links import LinkSpec

MAX_CATCH_UP_TIME_S = 1.0
"""s. After a longer sleep of the machine the boards continue from now and skip the missed time."""


class DeviceSource(Protocol):
    """Devices whose readings are computed block by block."""

    now: float
    """s, end of the computed time."""
    block_s: float
    """s of readings that are computed at once."""
    emulated: Mapping[Stream, str]
    """Makers' devices that send a stream, by their names."""
    channels: int
    """Channels of the skin."""

    @property
    def links(self) -> dict[str, Stream]:
        """Name of each link and its stream."""
        ...

    def greeting(self, link: str) -> bytes:
        """Return the header that a board sends when a host connects or asks."""
        ...

    def advance(self) -> list[tuple[int, str, bytes]]:
        """Compute one block: (nanoseconds, link, bytes), sorted by time."""
        ...


class Server:
    """Serves simulated devices: an outlet for each link, and the loop that sends their bytes.

    Boards obey the commands of SKT/1 and SKB/1: `?` sends the header, `P` pauses, `S` continues.
    Raises InputError without `tcp` on a platform without pseudo-terminals.
    """

    def __init__(self, line: DeviceSource, *, tcp: bool) -> None:
        self._line = line
        self._outlets: dict[str, Outlet] = {}
        self._paused: set[str] = set()
        emulated, makers = line.emulated, MakerOutlets(line.channels, line.emulated)
        try:
            for name, stream in line.links.items():
                if stream in emulated:
                    self._outlets[name] = makers.open(emulated[stream], stream, tcp=tcp)
                else:
                    self._outlets[name] = TcpOutlet() if tcp else PtyOutlet()
        except BaseException:
            self.close()
            raise

    @property
    def links(self) -> tuple[LinkSpec, ...]:
        """Links for the host."""
        return tuple(LinkSpec(name, self._outlets[name].address, (stream,)) for name, stream in self._line.links.items())

    def run(self, stop: threading.Event, each: Callable[[], object] = lambda: None) -> None:
        """Play until `stop` is set; call `each` after each block."""
        start = time.monotonic() - self._line.now
        while not stop.is_set():
            late = time.monotonic() - start - self._line.now
            if late > MAX_CATCH_UP_TIME_S:
                start += late
            elif late < self._line.block_s:
                stop.wait(self._line.block_s - late)
                continue
            self._handle_commands()
            for _, link, data in self._line.advance():
                if link not in self._paused:
                    self._outlets[link].write(data)
            each()

    def _handle_commands(self) -> None:
        for name, outlet in self._outlets.items():
            connected, received = outlet.poll()
            if b"P" in received:
                self._paused.add(name)
            if b"S" in received or connected:
                self._paused.discard(name)
            if b"?" in received or connected:
                outlet.write(self._line.greeting(name))

    def close(self) -> None:
        for outlet in self._outlets.values():
            outlet.close()
