"""Plays a time line in real time: a device process that a program cannot tell from hardware.

Bytes come out at a TCP port or a pseudo-terminal. Like a board, an outlet goes on whether or not somebody listens: bytes
without a listener are gone, and a listener may leave and come back at any time.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping

from skincal.model.readings import Stream
from skincal.simulate.device import DeviceTimeline
from skincal.simulate.outlets import Outlet, PtyOutlet, TcpOutlet
from skincal.streams.links import LinkSpec

LATE_MAX_S = 1.0
"""s. When the machine slept longer than this, the boards go on from now rather than send it all at once."""


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
        from skincal.simulate.emulated_transports import MakerOutlets

        makers = MakerOutlets(self._line.rig.scene.skin.channels)
        for name, stream in self._line.links.items():
            if stream in speakers:
                self._outlets[name] = makers.open(speakers[stream], stream, tcp=tcp)

    @property
    def links(self) -> tuple[LinkSpec, ...]:
        """What a host opens."""
        return tuple(LinkSpec(name, self._outlets[name].address, (stream,)) for name, stream in self._line.links.items())

    def run(self, stop: threading.Event, each: Callable[[], object] = lambda: None) -> None:
        """Play until `stop` is set; `each` is called after each block of readings."""
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
            each()

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
