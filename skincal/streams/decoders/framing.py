"""How makers' bytes are cut into pieces: frames of one length, and packets of transports that keep messages apart."""

from __future__ import annotations

import struct
from collections.abc import Callable

PACKET = struct.Struct("<BI")
"""Kind and length of what follows."""


def pack(kind: int, payload: bytes) -> bytes:
    """Return a message as the journal keeps it: UDP and websockets part messages, and bytes alone would not.

    Parameters
    ----------
    kind : 0 to 255, the device's own affair
    """
    return PACKET.pack(kind, len(payload)) + payload


class Packets:
    """Cuts what `pack` made; a piece is the kind and the payload. After one beyond `limit`, bytes, nothing is a piece."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._rest = b""
        self._deaf = False

    @property
    def holds(self) -> bool:
        """See `Pieces`."""
        return bool(self._rest) or self._deaf

    def split(self, data: bytes) -> list[bytes | None]:
        """See `Pieces`."""
        pieces: list[bytes | None] = []
        rest, at = self._rest + data, 0
        while not self._deaf and len(rest) - at >= PACKET.size:
            kind, length = PACKET.unpack_from(rest, at)
            end = at + PACKET.size + length
            if length > self._limit:
                self._deaf = True
                pieces.append(None)
            elif end > len(rest):
                break
            else:
                pieces.append(bytes([kind]) + rest[at + PACKET.size : end])
                at = end
        self._rest = b"" if self._deaf else rest[at:]
        return pieces


class Frames:
    """Cuts frames of one `length` that begin with `head` and fit `good`; a run of other bytes is one None.

    After bytes that are no frame the search goes on at the next byte: a head may stand inside a frame, too. What the device
    says between frames, `between`, shorter than one, is as if it were not there.
    """

    def __init__(self, head: bytes, length: int, good: Callable[[bytes], bool], between: bytes = b"") -> None:
        self._head, self._length, self._good, self._between = head, length, good, between
        self._rest = b""
        self._lost = False

    @property
    def holds(self) -> bool:
        """See `Pieces`."""
        return bool(self._rest) or self._lost

    def split(self, data: bytes) -> list[bytes | None]:
        """See `Pieces`."""
        pieces: list[bytes | None] = []
        rest, at = self._rest + data, 0
        while len(rest) - at >= self._length:
            frame = rest[at : at + self._length]
            if frame.startswith(self._head) and self._good(frame):
                pieces.append(frame)
                at += self._length
                self._lost = False
                continue
            if self._between and not self._lost and rest.startswith(self._between, at):
                at += len(self._between)
                continue
            if not self._lost:
                pieces.append(None)
            self._lost = True
            found = rest.find(self._head, at + 1)
            at = found if found >= 0 else max(len(rest) - len(self._head) + 1, at + 1)
        self._rest = rest[at:]
        return pieces
