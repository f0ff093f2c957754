"""Parts of a device family's description: routes (address, transport, format), handshake, wiring and test vectors.

A family's file opens nothing itself. It knows no port and no clock, so that all of it can be tried with bytes alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Protocol

from skincal.devices.decoding import FrameDecoder
from skincal.model.readings import Stream

AUTO_FORMAT = "auto"
"""Format that is found from the bytes."""


class HandshakeError(Exception):
    """The device's answer breaks the protocol; the message is a sentence without the device's address."""


class Handshake:
    """Dialogue with a device: bytes received in, bytes to send out. The base class sends nothing.

    The link sends `opening` first, the answer of `on_data` to received bytes, `on_silence` after `silence_s` without bytes,
    and `closing_bytes` before it closes. A replay has the received bytes alone, so a decoder never depends on a handshake.
    """

    silence_s: float = math.inf
    closing_bytes: bytes = b""

    def opening(self) -> bytes:
        """Return the bytes to send first."""
        return b""

    def on_data(self, data: bytes) -> bytes:
        """Return the answer to received bytes. Raises HandshakeError."""
        del data
        return b""

    def on_silence(self) -> bytes:
        """Return the bytes to send after the device has been silent."""
        return b""

    @property
    def is_ready(self) -> bool:
        """Whether the device has agreed to send."""
        return True


class Form(Enum):
    """Syntax of an address after its scheme."""

    HOST = "//HOST:PORT"
    HOST_PATH = "//HOST:PORT/PATH"
    LISTEN = "//:PORT"
    HOST_OR_PORT = "//HOST, or a serial port after the third slash"
    SERIAL = "serial port"
    PATH = "/PATH"
    COMMAND = "command"


@dataclass(frozen=True, slots=True)
class Command:
    """A program whose output is read."""

    words: Sequence[str] | str
    """Words of the command; on Windows its line."""
    who: str
    """Name of the program in sentences."""
    first_bytes_max_s: float = 0.8
    """s, longest wait for the first bytes when it is opened."""
    has_input: bool = False
    """Whether it gets a stdin, whose end says that this program is gone."""
    is_driver: bool = False
    """Whether it stands for a device: its end means that the device vanished, and it must send bytes to count as open."""


@dataclass(frozen=True, slots=True)
class DeviceAddress:
    """A parsed device address, and what its transport opens."""

    text: str
    """The address as it was typed, for sentences."""
    route: Route
    host: str = ""
    """Empty for a serial port, or for a server that is to be looked up."""
    port: int = 0
    path: str = ""
    """Serial port, file, command, or port of a YARP network with its slash."""
    baud: int = 0
    """0 if the baud rate is to be searched."""
    options: Mapping[str, str] = field(default_factory=dict[str, str])
    place: str = ""
    """Where the device was found, for sentences; empty if the address says it."""
    connect_hint: str = ""
    """Sentence to add if the connection fails."""
    first_bytes: bytes = b""
    """Packets that the reader gets first: what was learnt outside the stream, such as a sensor's page."""
    command: Command | None = None
    group: tuple[str, int] | None = None
    """Multicast group and port of the host; `None` if it sends to this computer."""
    handshake: Handshake | None = None
    """Dialogue of this address; `None` for that of its route."""

    @property
    def label(self) -> str:
        """Name of the address in sentences."""
        return f"{self.text} {self.place}".strip()


class Questions(Protocol):
    """Questions over the network that a route may ask before its link opens. Each raises LinkError."""

    def ask_tcp(self, where: str, host: str, port: int, request: bytes, end: bytes) -> bytes:
        """Send a request over TCP; return the answer up to its `end`, which may be missing."""
        ...

    def ask_udp(self, where: str, host: str, port: int, request: bytes, begin: bytes) -> bytes:
        """Send a datagram; return the first answer that begins with `begin`."""
        ...

    def get_page(self, where: str, host: str, port: int, path: str) -> bytes:
        """Return a page by HTTP."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Route:
    """One way to reach the devices of a family."""

    usage: str
    """An example of an address, for sentences and the manual. The word before its colon is the scheme."""
    form: Form
    transport: str
    """Name in `skincal.streams.transports.FILE_OF_TRANSPORT`."""
    format: str = AUTO_FORMAT
    """Name of the decoder."""
    port: int = 0
    """TCP or UDP port if the address names none; 0: it must name one."""
    baud: int = 0
    """Baud rate if the address names none."""
    bauds: tuple[int, ...] = ()
    """Baud rates to try in turn if the address names none, in place of `baud`."""
    options: tuple[str, ...] = ()
    """Names that may follow `?`; a serial port always has `baud`."""
    handshake: Callable[[tuple[Stream, ...]], Handshake] | None = None
    """Makes the handshake for the streams that the link carries."""
    needs_every_byte: bool = False
    """Whether a gap makes the rest unreadable: the stream has a header page, or no marks between messages."""
    message_max: int = 0
    """Bytes of a message at most, for transports that keep messages apart."""
    message_kind: int = 1
    """Kind of packet that a message becomes."""
    check: Callable[[DeviceAddress], bool] = lambda _: True
    """Whether an address of the right form is possible."""
    prepare: Callable[[DeviceAddress, Questions], DeviceAddress] | None = None
    """Fills in what must be asked first. Raises LinkError."""

    @property
    def scheme(self) -> str:
        return self.usage.partition(":")[0]


def over_tcp(route: Route) -> Route:
    """Make the route to the same device behind a serial server, which hands on its bytes by TCP."""
    usage = f"{route.scheme}://192.168.1.5:4001"
    return replace(route, usage=usage, form=Form.HOST, transport="tcp", baud=0, bauds=())


@dataclass(frozen=True, slots=True)
class Vector:
    """Bytes that a device sent or its maker published, with the readings in them."""

    format: str
    carries: tuple[Stream, ...]
    data: bytes
    """Bytes from the start of a connection."""
    values: Sequence[Sequence[float]]
    """The readings in SI units, the streams one after the other, as `carries` orders them."""
    repeat: bytes = b""
    """End of `data` that a test may send again and again; empty if there is none."""
    channels: int | None = None


@dataclass(frozen=True, slots=True)
class Family:
    """Everything that the program knows of one family of devices."""

    routes: tuple[Route, ...]
    decoders: Mapping[str, type[FrameDecoder]] = field(default_factory=dict[str, type[FrameDecoder]])
    """Decoders by the name of their format. Names never change: journals have them."""
    vectors: tuple[Vector, ...] = ()
