"""What every link can do, and how it fails: the words that ports, devices and their readers share."""

from __future__ import annotations

from enum import Enum
from typing import Protocol

from skincal.model.errors import plain_text, shortened


class FailureKind(Enum):
    """Why a link cannot be opened or read."""

    ADDRESS = "address not understood"
    ABSENT = "not there"
    IN_USE = "in use"
    DENIED = "permission denied"
    REFUSED = "refused"
    VANISHED = "vanished"
    NONSENSE = "speaks another language"
    ENDED = "ended"
    OTHER = "other"


class LinkFailure(Exception):  # noqa: N818 - most are no error: a port is unplugged, a file ends
    """A link cannot be opened, read or written; the message is a sentence for the operator.

    It may quote a device: it is made plain and short, as an `InputError` is.
    """

    def __init__(self, kind: FailureKind, sentence: str) -> None:
        super().__init__(shortened(plain_text(sentence)))
        self.kind = kind


class Link(Protocol):
    """An open link."""

    def read(self, timeout_s: float) -> bytes:
        """Return the bytes at hand, waiting at most `timeout_s` for the first; empty if none came. Raises LinkFailure."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes to the device. Raises LinkFailure."""
        ...

    def close(self) -> None:
        """Give the port back. Raises nothing."""
        ...
