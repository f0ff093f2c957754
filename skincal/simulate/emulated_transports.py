"""The ends of the links of makers' devices: TCP with a talk, UDP with its page, a pseudo-terminal that hears commands."""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from skincal.model.readings import Stream
from skincal.simulate.emulated_devices import (
    DeviceTalk,
    NameTalk,
    PageTalk,
    PlainTalk,
    RtdeTalk,
    SkinManagerTalk,
    XelaTalk,
    YarpTalk,
)
from skincal.simulate.outlets import PtyOutlet, TcpOutlet

RDT_RECORD = 36


class TalkOutlet(TcpOutlet):
    """A TCP port where each host is talked to, and gets readings once it asked for them."""

    def __init__(self, talk: Callable[[], DeviceTalk], form: str) -> None:
        """Take who talks to a host, and the address around the port's number."""
        super().__init__()
        self._talk = talk
        self._talks: dict[socket.socket, DeviceTalk] = {}
        self.port: int = self._server.getsockname()[1]
        self.address = form.format(self.port)

    def poll(self) -> tuple[bool, bytes]:
        """Talk to every host; what they said is nobody else's affair."""
        super().poll()
        self.write(b"")
        for client, talk in list(self._talks.items()):
            if talk.over and not self._clients.get(client):
                self._drop(client)
        return False, b""

    def _read(self, client: socket.socket) -> bytes:
        data = super()._read(client)
        if data:
            talk = self._talks.setdefault(client, self._talk())
            self._clients[client] += talk.hear(data)
        return data

    def _share(self, client: socket.socket, data: bytes) -> bytes:
        talk = self._talks.setdefault(client, self._talk())
        return talk.wrap(data) if data and talk.ready else b""

    def _drop(self, client: socket.socket) -> None:
        self._talks.pop(client, None)
        super()._drop(client)


class YarpOutlet(TalkOutlet):
    """A port of a YARP network, and its part in the name server and the skinManager that all of them share."""

    def __init__(self, stream: Stream, names: dict[str, int], shared: tuple[TalkOutlet, TalkOutlet]) -> None:
        super().__init__(lambda: YarpTalk(self.port), "{}")
        self._shared = shared
        name = {Stream.WRENCH: "/icub/right_arm/analog:o", Stream.SKIN: "/icub/skin/right_forearm"}.get(
            stream, "/icub/right_arm/state:o"
        )
        names[name] = self.port
        self.address = f"yarp://127.0.0.1:{shared[0].port}{name}"

    def poll(self) -> tuple[bool, bytes]:
        """See `TalkOutlet`."""
        for outlet in self._shared:
            outlet.poll()
        return super().poll()

    def close(self) -> None:
        """See `TalkOutlet`."""
        for outlet in self._shared:
            outlet.close()
        super().close()


class RdtOutlet:
    """A Net F/T: UDP records to the last host that asked, and the page with the counts."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self._page = TalkOutlet(PageTalk, "{}")
        self._host: tuple[str, int] | None = None
        self.address = f"netft://127.0.0.1:{self._socket.getsockname()[1]}?page={self._page.port}"

    def poll(self) -> tuple[bool, bytes]:
        """Take requests: a second host steals the stream."""
        self._page.poll()
        # A host that has left is reported as an error of the next call; that is no affair of the sensor's.
        with contextlib.suppress(BlockingIOError, ConnectionError):
            while True:
                data, host = self._socket.recvfrom(64)
                if len(data) == 8 and data[:2] == b"\x12\x34":
                    (command,) = struct.unpack_from(">H", data, 2)
                    self._host = host if command == 2 else None
        return False, b""

    def write(self, data: bytes) -> None:
        """Send each record as a datagram."""
        for at in range(0, len(data), RDT_RECORD):
            if self._host is not None:
                with contextlib.suppress(BlockingIOError, ConnectionError):
                    self._socket.sendto(data[at : at + RDT_RECORD], self._host)

    def close(self) -> None:
        """Switch the sensor off."""
        self._page.close()
        self._socket.close()


class RobotiqOutlet(PtyOutlet):
    """An FT 300 at its adapter: silent until it is started."""

    def __init__(self) -> None:
        super().__init__()
        self.address = f"robotiq:{self.address}"
        self._streams = False

    def poll(self) -> tuple[bool, bytes]:
        """Start and stop as told."""
        _, said = super().poll()
        if b"\xff" * 50 in said:
            self._streams = False
        elif said.endswith(bytes.fromhex("0910019A0001020200CDCA")):
            super().write(bytes.fromhex("0910019A00012152"))
            self._streams = True
        return False, b""

    def write(self, data: bytes) -> None:
        """Send only what a started sensor does."""
        if self._streams:
            super().write(data)


class SilentPtyOutlet(PtyOutlet):
    """A serial device that hears nothing, or commands that change nothing here."""

    def poll(self) -> tuple[bool, bytes]:
        """See `PtyOutlet`."""
        came, _ = super().poll()
        return came, b""


MakerOutlet: TypeAlias = TalkOutlet | RdtOutlet | RobotiqOutlet | SilentPtyOutlet


class SkinManagerOutlet(TalkOutlet):
    """The RPC port of a skinManager that has no positions yet."""

    def __init__(self, channels: int) -> None:
        self.poses = np.zeros((channels, 7))
        super().__init__(lambda: SkinManagerTalk(self.port, self.poses), "{}")


class MakerOutlets:
    """Opens the outlets of one rig's devices; ports of a YARP network share one name server.

    Parameters
    ----------
    channels : of the skin, for the skinManager in that network
    """

    def __init__(self, channels: int) -> None:
        self._names: dict[str, int] = {}
        self._channels = channels
        self._shared: tuple[TalkOutlet, TalkOutlet] | None = None

    def open(self, maker: str, stream: Stream, *, tcp: bool) -> MakerOutlet:
        """Return the outlet of a maker's device; with `tcp` serial devices are behind a TCP port, too."""
        if maker == "yarp":
            if self._shared is None:
                manager = SkinManagerOutlet(self._channels)
                self._shared = TalkOutlet(lambda: NameTalk(self._names), "{}"), manager
                self._names["/skinManager/rpc"] = manager.port
            return YarpOutlet(stream, self._names, self._shared)
        if maker == "netft":
            return RdtOutlet()
        talks: dict[str, tuple[Callable[[], DeviceTalk], str]] = {
            "rtde": (lambda: RtdeTalk(b"actual_q" if stream is Stream.JOINTS else b"ft_raw_wrench"), "rtde://127.0.0.1:{}"),
            "xela": (XelaTalk, "xela://127.0.0.1:{}"),
            "robotiq-text": (PlainTalk, "robotiq://127.0.0.1:{}"),
        }
        if maker in talks:
            return TalkOutlet(*talks[maker])
        if tcp:
            return TalkOutlet(PlainTalk, "socket://127.0.0.1:{}")
        return RobotiqOutlet() if maker == "robotiq" else SilentPtyOutlet()
