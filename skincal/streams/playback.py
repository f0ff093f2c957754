"""A file of raw bytes, as a port wrote them, played at the pace at which its device made them.

The device's clock in the bytes sets the pace; bytes without one come as fast as a port of the given baud rate sends them.
So arrival stamps mean what they mean for a port, and nothing that follows can tell the two apart.
"""

from __future__ import annotations

import math
import time
from pathlib import Path

from skincal.model.errors import InputError
from skincal.streams.formats.detect import Decoder
from skincal.streams.links import FailureKind, LinkFailure, LinkSpec

BLOCK_BYTES = 512
"""Bytes handed on together: three skin frames of 84 taxels."""
BITS_PER_BYTE = 10
"""Start bit, eight data bits, stop bit."""


class PlaybackLink:
    """Reads a file in real time; its end is a `LinkFailure` of kind ENDED."""

    def __init__(self, path: Path, spec: LinkSpec, baud: int) -> None:
        self._path = path
        try:
            self._file = path.open("rb")
            self._decoder = Decoder(spec.format, None, spec.carries)
        except FileNotFoundError as error:
            raise LinkFailure(FailureKind.ABSENT, f"There is no file {path}; check the name.") from error
        except OSError as error:
            raise LinkFailure(FailureKind.OTHER, f"{path} cannot be read: {error.strerror or error}.") from error
        except InputError as error:
            raise LinkFailure(FailureKind.ADDRESS, str(error)) from error
        self._byte_s = BITS_PER_BYTE / baud
        self._block: bytes | None = None
        self._started_s = time.monotonic()
        self._due_s = 0.0
        self._device_s = math.nan

    def read(self, timeout_s: float) -> bytes:
        """See `Link`."""
        if self._block is None:
            self._block = self._next_block()
        wait_s = self._started_s + self._due_s - time.monotonic()
        if wait_s > timeout_s:
            time.sleep(timeout_s)
            return b""
        if wait_s > 0:
            time.sleep(wait_s)
        block, self._block = self._block, None
        return block

    def _next_block(self) -> bytes:
        """Read the next block and find when it is due: as much later as its device's clock went on."""
        try:
            block = self._file.read(BLOCK_BYTES)
        except OSError as error:
            raise LinkFailure(FailureKind.OTHER, f"{self._path} cannot be read further: {error.strerror or error}.") from error
        if not block:
            raise LinkFailure(FailureKind.ENDED, f"{self._path} is at its end.")
        before = self._device_s
        for _, batch in self._decoder.feed(block, round(self._due_s * 1e9)):
            self._device_s = float(batch.device_s[-1])
        passed_s = self._device_s - before
        self._due_s += passed_s if passed_s >= 0 else len(block) * self._byte_s
        return block

    def write(self, data: bytes) -> None:
        """Do nothing: a recording takes no commands."""

    def close(self) -> None:
        """See `Link`."""
        self._file.close()
