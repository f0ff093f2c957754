"""What is said to a device: bytes heard in, bytes to send out; no port, no clock.

The transport asks: `opening` once it is open, `hear` for all that comes, `on_silence` when nothing came for `silence_s`, and
`farewell` before it closes. What the bytes mean is the affair of a decoder: a replay has the bytes, and nobody to talk to.
"""

from __future__ import annotations

import math


class DialogueError(Exception):
    """What came is no part of the protocol; the message is a sentence without the device's address."""


class Dialogue:
    """A device that needs to hear nothing; the others override what they need."""

    silence_s: float = math.inf
    farewell: bytes = b""

    def opening(self) -> bytes:
        """Return what is said first."""
        return b""

    def hear(self, data: bytes) -> bytes:
        """Return the answer to what came. Raises DialogueError."""
        del data
        return b""

    def on_silence(self) -> bytes:
        """Return what is said after a silence."""
        return b""

    @property
    def ready(self) -> bool:
        """Whether the device has agreed to send."""
        return True
