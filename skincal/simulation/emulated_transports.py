"""Device ends of the links of makers' devices: TCP with a dialogue, UDP with a web page, pseudo-terminals."""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import time
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from skincal.model.readings import Stream
from skincal.simulation.emulated_devices import (
    ControllerTalk,
    NameTalk,
    PageTalk,
    RtdeController,
    RtdeTalk,
    SkinManagerTalk,
    XelaTalk,
    YarpTalk,
)
from skincal.simulation.emulated_skins import InspireTalk, make_talks, part_query
from skincal.simulation.emulated_trackers import TOOL_BODY, NdiTalk, QtmTalk, natnet_descriptions, natnet_server_info
from skincal.simulation.outlets import Outlet, PtyOutlet, TcpOutlet
from skincal.simulation.plain_talk import PlainTalk
from skincal.simulation.ros_outlets import RosOutlet

RDT_RECORD_BYTES = 36
ANSWERS_MAX_S = 0.05
"""s, longest time for the hosts of an Inspire hand to fetch one reading."""
YARP_PORTS = {
    Stream.WRENCH: "/icub/right_arm/analog:o",
    Stream.SKIN: "/icub/skin/right_forearm",
    Stream.JOINTS: "/icub/right_arm/state:o",
}
TALK_OF_DEVICE: Mapping[str, tuple[Callable[[], PlainTalk], str]] = MappingProxyType(
    {
        "xela": (XelaTalk, "xela://127.0.0.1:{}"),
        "robotiq-text": (PlainTalk, "robotiq://127.0.0.1:{}"),
        "ndi": (NdiTalk, "ndi://127.0.0.1:{}?body=02"),
        "qtm": (QtmTalk, f"qtm://127.0.0.1:{{}}?body={TOOL_BODY}"),
    }
)
"""Dialogue and address, with {} for the port's number, of devices at a TCP port."""


class TalkOutlet(TcpOutlet):
    """A TCP port with a dialogue for each host.

    `form` is the address, with {} for the port's number.
    """

    def __init__(self, talk: Callable[[], PlainTalk], form: str) -> None:
        super().__init__()
        self._talk = talk
        self._talks: dict[socket.socket, PlainTalk] = {}
        self.port: int = self._server.getsockname()[1]
        self.address = form.format(self.port)

    def poll(self) -> tuple[bool, bytes]:
        super().poll()
        for client, waiting in self._clients.items():
            if client not in self._talks:
                self._talks[client] = self._talk()
                waiting += self._talks[client].greeting
        self.write(b"")
        for client, talk in list(self._talks.items()):
            if talk.closing and not self._clients.get(client):
                self._drop(client)
        return False, b""

    def _read(self, client: socket.socket) -> bytes:
        data = super()._read(client)
        if data:
            talk = self._talks.setdefault(client, self._talk())
            self._clients[client] += talk.on_request(data)
        return data

    def _share(self, client: socket.socket, data: bytes) -> bytes:
        talk = self._talks.setdefault(client, self._talk())
        return talk.frame(data) if data and talk.ready else b""

    def _drop(self, client: socket.socket) -> None:
        self._talks.pop(client, None)
        super()._drop(client)


class YarpOutlet(TalkOutlet):
    """A port of a YARP network. It also runs the network's name server and skinManager."""

    def __init__(self, stream: Stream, names: dict[str, int], shared: tuple[TalkOutlet, TalkOutlet]) -> None:
        super().__init__(lambda: YarpTalk(self.port), "{}")
        self._shared = shared
        name = YARP_PORTS[stream]
        names[name] = self.port
        self.address = f"yarp://127.0.0.1:{shared[0].port}{name}"

    def poll(self) -> tuple[bool, bytes]:
        for outlet in self._shared:
            outlet.poll()
        return super().poll()

    def close(self) -> None:
        for outlet in self._shared:
            outlet.close()
        super().close()


class RdtOutlet:
    """A Net F/T: UDP records to the newest host, and its web page."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self._page = TalkOutlet(PageTalk, "{}")
        self._host: tuple[str, int] | None = None
        self.address = f"netft://127.0.0.1:{self._socket.getsockname()[1]}?page={self._page.port}"

    def poll(self) -> tuple[bool, bytes]:
        self._page.poll()
        # The system reports a host that left as an error of the next call.
        with contextlib.suppress(BlockingIOError, ConnectionError):
            while True:
                data, host = self._socket.recvfrom(64)
                if len(data) == 8 and data[:2] == b"\x12\x34":
                    (command,) = struct.unpack_from(">H", data, 2)
                    self._host = host if command == 2 else None
        return False, b""

    def write(self, data: bytes) -> None:
        for at in range(0, len(data), RDT_RECORD_BYTES):
            if self._host is not None:
                with contextlib.suppress(BlockingIOError, ConnectionError):
                    self._socket.sendto(data[at : at + RDT_RECORD_BYTES], self._host)

    def close(self) -> None:
        self._page.close()
        self._socket.close()


class NatNetOutlet:
    """Motive: it sends frames to the newest host, or to a multicast group of this computer."""

    def __init__(self, group: str = "", group_port: int = 0) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self._host: tuple[str, int] | None = (group, group_port) if group else None
        self._info = natnet_server_info(socket.inet_aton(group), group_port) if group else natnet_server_info()
        self._is_unicast = not group
        if group:
            self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        self.address = f"natnet://127.0.0.1:{self._socket.getsockname()[1]}?body={TOOL_BODY}"

    def poll(self) -> tuple[bool, bytes]:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            while True:
                data, host = self._socket.recvfrom(1024)
                if data[:2] == b"\x00\x00":
                    self._host = host if self._is_unicast else self._host
                    self._socket.sendto(self._info, host)
                elif data[:2] == b"\x04\x00":
                    self._socket.sendto(natnet_descriptions(), host)
        return False, b""

    def write(self, data: bytes) -> None:
        at = 0
        while at < len(data) and self._host is not None:
            end = at + 4 + int.from_bytes(data[at + 2 : at + 4], "little")
            with contextlib.suppress(BlockingIOError, ConnectionError):
                self._socket.sendto(data[at:end], self._host)
            at = end

    def close(self) -> None:
        self._socket.close()


class RobotiqOutlet(PtyOutlet):
    """An FT 300 at its serial adapter, silent until the host starts it."""

    def __init__(self) -> None:
        super().__init__()
        self.address = f"robotiq:{self.address}"
        self._streams = False

    def poll(self) -> tuple[bool, bytes]:
        _, said = super().poll()
        if b"\xff" * 50 in said:
            self._streams = False
        elif said.endswith(bytes.fromhex("0910019A0001020200CDCA")):
            super().write(bytes.fromhex("0910019A00012152"))
            self._streams = True
        return False, b""

    def write(self, data: bytes) -> None:
        if self._streams:
            super().write(data)


class SilentPtyOutlet(PtyOutlet):
    """A serial device that ignores commands."""

    def poll(self) -> tuple[bool, bytes]:
        came, _ = super().poll()
        return came, b""


class TalkPtyOutlet(PtyOutlet):
    """A serial device with a dialogue; `form` is the address, with {} for the port."""

    def __init__(self, talk: PlainTalk, form: str) -> None:
        super().__init__()
        self.address = form.format(self.address)
        self._talk = talk

    @property
    def _streams(self) -> bool:
        return self._talk.ready

    def poll(self) -> tuple[bool, bytes]:
        came, said = super().poll()
        if said:
            super().write(self._talk.on_request(said))
        return came, b""

    def write(self, data: bytes) -> None:
        if self._talk.ready:
            super().write(self._talk.frame(data))


class InspireOutlet(TalkOutlet):
    """An Inspire hand. It hands out each reading at once, as its hosts ask for it piece by piece."""

    def __init__(self, form: str) -> None:
        super().__init__(InspireTalk, form)

    def write(self, data: bytes) -> None:
        super().write(data)
        end_s = time.monotonic() + ANSWERS_MAX_S
        while self._has_waiting_host() and time.monotonic() < end_s:
            select.select(list(self._clients), [], [], ANSWERS_MAX_S / 10)
            self.poll()

    def _has_waiting_host(self) -> bool:
        return any(isinstance(talk, InspireTalk) and talk.is_waiting for talk in self._talks.values())


class ControllerOutlet(TalkOutlet):
    """The one port of a UR controller that sends several streams; `FieldOutlet` gives it those of the others."""

    def __init__(self, stream: Stream) -> None:
        super().__init__(ControllerTalk, "rtde://127.0.0.1:{}")
        self._controller, self._stream = RtdeController(), stream
        self._controller.add_stream(stream)

    def add_stream(self, stream: Stream) -> FieldOutlet:
        """Send another stream by the same port."""
        self._controller.add_stream(stream)
        return FieldOutlet(self, stream)

    def write(self, data: bytes) -> None:
        self.write_stream(self._stream, data)

    def write_stream(self, stream: Stream, data: bytes) -> None:
        """Take packets of one of its streams; send those that are complete."""
        super().write(self._controller.join(stream, data))


class FieldOutlet:
    """A further stream of a UR controller."""

    def __init__(self, port: ControllerOutlet, stream: Stream) -> None:
        self._port, self._stream, self.address = port, stream, port.address

    def poll(self) -> tuple[bool, bytes]:
        return False, b""

    def write(self, data: bytes) -> None:
        self._port.write_stream(self._stream, data)

    def close(self) -> None:
        """Leave the port open: it is closed with its own stream."""


class SkinManagerOutlet(TalkOutlet):
    """The RPC port of a skinManager without positions."""

    def __init__(self, channels: int) -> None:
        self.poses = np.zeros((channels, 7))
        super().__init__(lambda: SkinManagerTalk(self.port, self.poses), "{}")


class MakerOutlets:
    """Opens the outlets of one rig's devices. All ports of a YARP network share a name server and a skinManager.

    `channels` is the skin's width, for the skinManager; `emulated` names the maker's device of each stream.
    """

    def __init__(self, channels: int, emulated: Mapping[Stream, str] = MappingProxyType({})) -> None:
        self._has_controller = emulated.get(Stream.TOOL) == "rtde"
        self._controller: ControllerOutlet | None = None
        self._names: dict[str, int] = {}
        self._channels = channels
        self._shared: tuple[TalkOutlet, TalkOutlet] | None = None

    def _open_rtde(self, stream: Stream) -> Outlet:
        """Open a port for each stream, or one port for all if the controller sends poses of its tool."""
        if not self._has_controller:
            field = b"actual_q" if stream is Stream.JOINTS else b"ft_raw_wrench"
            return TalkOutlet(lambda: RtdeTalk(field), "rtde://127.0.0.1:{}")
        if self._controller is not None:
            return self._controller.add_stream(stream)
        self._controller = ControllerOutlet(stream)
        return self._controller

    def open(self, maker: str, stream: Stream, *, tcp: bool) -> Outlet:
        """Open the port where a simulated device sends its bytes; with `tcp`, serial devices get a TCP port instead."""
        match maker:
            case "yarp":
                if self._shared is None:
                    manager = SkinManagerOutlet(self._channels)
                    self._shared = TalkOutlet(lambda: NameTalk(self._names), "{}"), manager
                    self._names["/skinManager/rpc"] = manager.port
                return YarpOutlet(stream, self._names, self._shared)
            case "netft" | "natnet":
                return RdtOutlet() if maker == "netft" else NatNetOutlet()
            case "rtde":
                return self._open_rtde(stream)
            case "ros2":
                return RosOutlet(stream)
            case _ if maker in TALK_OF_DEVICE:
                return TalkOutlet(*TALK_OF_DEVICE[maker])
            case "inspire":
                return InspireOutlet(f"inspire://127.0.0.1:{{}}{part_query(maker, self._channels)}")
            case _ if maker in (talks := make_talks(self._channels)):
                query = part_query(maker, self._channels)
                if tcp:
                    return TalkOutlet(talks[maker], f"{maker}://127.0.0.1:{{}}{query}")
                return TalkPtyOutlet(talks[maker](), f"{maker}:{{}}{query}")
            case _ if tcp:
                return TalkOutlet(PlainTalk, "socket://127.0.0.1:{}")
            case _:
                return RobotiqOutlet() if maker == "robotiq" else SilentPtyOutlet()
