"""Opens links: the transport of an address, what must be asked first, and the device's handshake."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

from skincal.devices.family import AUTO_FORMAT, DeviceAddress, Handshake, HandshakeError
from skincal.devices.link import FailureKind, Link, LinkError
from skincal.model.readings import Stream
from skincal.streams.transports import Opening, open_transport
from skincal.streams.transports.tcp import TcpLink
from skincal.streams.transports.udp import DatagramLink

HANDSHAKE_TIMEOUT_S = 0.8
"""s. A device that has not agreed to send by then speaks another protocol, or is silent."""
SERVER_ANSWER_TIMEOUT_S = 1.0
"""s for a page or the answer of a name server: machines of one room."""
ANSWER_MAX_BYTES = 1 << 20
"""A name server's answer has some 10,000 ports at most."""


def open_address(
    address: DeviceAddress,
    carries: tuple[Stream, ...] = (),
    format_name: str = AUTO_FORMAT,
    is_cancelled: Callable[[], bool] = lambda: False,
) -> Link:
    """Open what an address names. Raises LinkError."""
    route = address.route
    if route.prepare is not None:
        address = route.prepare(address, NetworkQuestions())
    try:
        link = open_transport(Opening(address, carries, format_name, is_cancelled))
    except LinkError as error:
        raise LinkError(error.kind, f"{error} {address.connect_hint}".rstrip()) from error
    handshake = address.handshake or (None if route.handshake is None else route.handshake(carries))
    if handshake is None and not address.first_bytes:
        return link
    handshake = handshake or Handshake()
    return HandshakeLink(address.text, link, handshake, address.first_bytes)


class NetworkQuestions:
    """Questions over TCP, each answered within `SERVER_ANSWER_TIMEOUT_S`."""

    def ask_tcp(self, where: str, host: str, port: int, request: bytes, end: bytes) -> bytes:
        """Send a request; return the answer up to its `end`, which is missing in an answer that is too long or too slow."""
        link, answer = TcpLink(where, host, port), b""
        end_s = time.monotonic() + SERVER_ANSWER_TIMEOUT_S
        try:
            link.write(request)
            while end not in answer and len(answer) < ANSWER_MAX_BYTES and (left_s := end_s - time.monotonic()) > 0:
                answer += link.read(left_s)
        except LinkError:
            # Most servers close the connection to end an answer.
            return answer
        finally:
            link.close()
        return answer

    def ask_udp(self, where: str, host: str, port: int, request: bytes, begin: bytes) -> bytes:
        """Send a datagram, and again each quarter of the time; return the first answer that begins with `begin`.

        Raises LinkError: none came within `SERVER_ANSWER_TIMEOUT_S`.
        """
        link = DatagramLink(where, host, port, kind=0)
        end_s = time.monotonic() + SERVER_ANSWER_TIMEOUT_S
        asked_s = -SERVER_ANSWER_TIMEOUT_S
        try:
            while (now_s := time.monotonic()) < end_s:
                if now_s - asked_s > SERVER_ANSWER_TIMEOUT_S / 4:
                    asked_s = now_s
                    link.write(request)
                for answer in link.read_datagrams(SERVER_ANSWER_TIMEOUT_S / 8):
                    if answer.startswith(begin):
                        return answer
        finally:
            link.close()
        raise LinkError(
            FailureKind.ABSENT, f"{where}: no answer within {SERVER_ANSWER_TIMEOUT_S:g} s; check the number, and its streaming."
        )

    def get_page(self, where: str, host: str, port: int, path: str) -> bytes:
        # Not http.client: its time limit starts again with each line, so a host that drips would hold the reader for minutes.
        request = f"GET {path} HTTP/1.0\r\nHost: {host}\r\n\r\n".encode()
        return self.ask_tcp(where, host, port, request, b"</netft").partition(b"\r\n\r\n")[2]


class HandshakeLink:
    """A transport and the handshake over it.

    The constructor waits until the device agrees to send, at most `HANDSHAKE_TIMEOUT_S`. It raises LinkError if it does not.
    """

    def __init__(self, address: str, transport: Link, handshake: Handshake, first_bytes: bytes = b"") -> None:
        self._address, self._transport, self._handshake = address, transport, handshake
        self._early, self._is_open = first_bytes, False
        self._last_data_s = time.monotonic()
        try:
            opening = handshake.opening()
            if opening:
                transport.write(opening)
            end_s = time.monotonic() + HANDSHAKE_TIMEOUT_S
            while not handshake.is_ready:
                # A device that keeps talking without agreeing must not fill the memory.
                if time.monotonic() > end_s or len(self._early) > ANSWER_MAX_BYTES:
                    raise LinkError(FailureKind.ABSENT, f"{address}: does not answer as it should; check what runs there.")
                self._early += self._receive(end_s - time.monotonic())
        except BaseException:
            transport.close()
            raise
        self._is_open = True

    @property
    def tried(self) -> tuple[int, ...]:
        return self._transport.tried

    def _receive(self, timeout_s: float) -> bytes:
        data = self._transport.read(max(timeout_s, 0.0))
        if data:
            try:
                answer = self._handshake.on_data(data)
            except HandshakeError as error:
                # While it is being opened, it is tried again.
                ending = " It is read no further." if self._is_open else ""
                raise LinkError(FailureKind.PROTOCOL_ERROR, f"{self._address}: {error}.{ending}") from error
            if answer:
                self._transport.write(answer)
        return data

    def read(self, timeout_s: float) -> bytes:
        if self._early:
            early, self._early = self._early, b""
            return early
        data = self._receive(min(timeout_s, self._handshake.silence_s))
        now_s = time.monotonic()
        if data:
            self._last_data_s = now_s
        elif now_s - self._last_data_s >= self._handshake.silence_s:
            self._last_data_s = now_s
            request = self._handshake.on_silence()
            if request:
                self._transport.write(request)
        return data

    def write(self, data: bytes) -> None:
        self._transport.write(data)

    def close(self) -> None:
        if self._handshake.closing_bytes:
            with contextlib.suppress(LinkError):
                self._transport.write(self._handshake.closing_bytes)
        self._transport.close()
