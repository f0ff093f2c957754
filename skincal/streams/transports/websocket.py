"""Websocket clients; each message becomes a packet."""

from __future__ import annotations

import time

from websockets.client import ClientProtocol
from websockets.frames import Frame, Opcode
from websockets.protocol import State
from websockets.uri import parse_uri

from skincal.devices.decoding import pack
from skincal.devices.link import FailureKind, Link, LinkError
from skincal.streams.transports import Opening
from skincal.streams.transports.tcp import TcpLink, closed_sentence

HANDSHAKE_TIMEOUT_S = 0.8


def open_transport(opening: Opening) -> Link:
    """Connect to the host and port of the address."""
    address = opening.address
    link = TcpLink(address.label, address.host, address.port)
    return WebSocketLink(address.label, link, address.host, address.port, address.route.message_max)


class WebSocketLink:
    """A websocket client; each text message is a packet.

    The library knows the protocol and no port: bytes in, messages and bytes to send out.
    """

    tried: tuple[int, ...] = ()

    def __init__(self, address: str, transport: Link, host: str, port: int, message_max: int) -> None:
        self._address, self._transport = address, transport
        self._protocol = ClientProtocol(parse_uri(f"ws://{f'[{host}]' if ':' in host else host}:{port}/"), max_size=message_max)
        self._message = b""
        try:
            self._protocol.send_request(self._protocol.connect())
            self._send()
            self._open()
        except BaseException:
            transport.close()
            raise

    def _open(self) -> None:
        end_s = time.monotonic() + HANDSHAKE_TIMEOUT_S
        self._early = b""
        while self._protocol.state is State.CONNECTING:
            left_s = end_s - time.monotonic()
            if left_s < 0 or self._protocol.handshake_exc is not None:
                raise LinkError(FailureKind.OTHER, f"{self._address}: what answers there is no websocket server.")
            self._early += self._receive_frames(self._transport.read(left_s))

    def _receive_frames(self, data: bytes) -> bytes:
        if not data:
            return b""
        self._protocol.receive_data(data)
        out = b""
        for event in self._protocol.events_received():
            if not isinstance(event, Frame) or event.opcode not in (Opcode.TEXT, Opcode.BINARY, Opcode.CONT):
                continue
            self._message += event.data
            if event.fin:
                out += pack(1, self._message)
                self._message = b""
        self._send()
        return out

    def _send(self) -> None:
        for data in self._protocol.data_to_send():
            if data:
                self._transport.write(data)

    def read(self, timeout_s: float) -> bytes:
        if self._early:
            early, self._early = self._early, b""
            return early
        if self._protocol.parser_exc is not None:
            why = f"{self._address}: it breaks the websocket protocol ({self._protocol.parser_exc}). It is read no further."
            raise LinkError(FailureKind.PROTOCOL_ERROR, why)
        self._require_open()
        return self._receive_frames(self._transport.read(timeout_s))

    def _require_open(self) -> None:
        if self._protocol.state is not State.OPEN:
            raise LinkError(FailureKind.VANISHED, closed_sentence(self._address))

    def write(self, data: bytes) -> None:
        """Send each line as a text message."""
        self._require_open()
        for line in data.splitlines():
            self._protocol.send_text(line)
        self._send()

    def close(self) -> None:
        self._transport.close()
