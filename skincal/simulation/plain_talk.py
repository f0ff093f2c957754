"""Dialogue of an emulated device with one host; the base of all others."""

from __future__ import annotations


class PlainTalk:
    """Dialogue of an emulated device that sends without a request, with one host."""

    ready = True
    """The host requests readings."""
    closing = False
    """The device closes the connection after the last byte."""
    greeting = b""
    """What it sends as soon as a host connects."""
    heard = b""
    """Bytes from the host that are not answered yet."""

    def on_request(self, data: bytes) -> bytes:
        """Return the answer to bytes from the host."""
        self.heard += data
        return b""

    def frame(self, data: bytes) -> bytes:
        """Wrap encoded readings as this host receives them."""
        return data
