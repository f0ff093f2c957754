"""The interface of links, and the error that they raise."""

from __future__ import annotations

from enum import Enum
from typing import Protocol

from skincal.model.errors import plain_text, shortened


class FailureKind(Enum):
    """Reason why a link cannot be opened or read."""

    ADDRESS = "address not valid"
    ABSENT = "not there"
    IN_USE = "in use"
    DENIED = "permission denied"
    REFUSED = "refused"
    VANISHED = "vanished"
    PROTOCOL_ERROR = "bytes break the protocol"
    ENDED = "ended"
    OTHER = "other"


class LinkError(Exception):
    """A link cannot be opened, read or written; the message is a sentence for the operator.

    It may quote a device, so it is made plain and short, as an `InputError` is.
    """

    def __init__(self, kind: FailureKind, sentence: str) -> None:
        super().__init__(shortened(plain_text(sentence)))
        self.kind = kind


class Link(Protocol):
    """An open link. Every transport keeps five rules.

    1. It returns bytes. If the transport keeps messages apart, each becomes a packet (`skincal.devices.decoding.pack`).
    2. Every failure is a `LinkError` with a sentence on what happened and what to do.
    3. No call waits longer than `timeout_s`, or half a second to write.
    4. No thread or process of it outlives `close`.
    5. Whatever it learns outside the stream (a page, a type) it returns first, as a packet, so that a journal can be replayed.
    """

    @property
    def tried(self) -> tuple[int, ...]:
        """Baud rates that a search has tried so far, each once; empty without a search."""
        ...

    def read(self, timeout_s: float) -> bytes:
        """Return the available bytes, waiting at most `timeout_s` for the first; empty if none came. Raises LinkError."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes to the device. Raises LinkError."""
        ...

    def close(self) -> None:
        """Release the port. Raises nothing."""
        ...
