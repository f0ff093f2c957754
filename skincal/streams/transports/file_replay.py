"""Recorded files of raw bytes, read as if a device sent them."""

from __future__ import annotations

import math
import time
from pathlib import Path

from skincal.devices.link import FailureKind, Link, LinkError
from skincal.model.errors import InputError
from skincal.model.given import open_regular
from skincal.model.readings import Stream
from skincal.streams.decoders.auto_detect import LinkDecoder
from skincal.streams.transports import Opening

DEFAULT_BAUD_RATE = 115200
READ_BLOCK_BYTES = 512
"""Bytes of a file returned together: three skin frames of 84 taxels."""
SERIAL_BITS_PER_BYTE = 10
"""Start bit, eight data bits, stop bit."""


def open_transport(opening: Opening) -> Link:
    """Open the file of the address."""
    address = opening.address
    return FileReplayLink(Path(address.path), opening.format, opening.carries, address.baud or DEFAULT_BAUD_RATE)


class FileReplayLink:
    """A file of raw bytes, read at the pace of the device that sent them.

    The device's clock in the bytes sets the pace. Bytes without a clock come as fast as a port of the given baud rate sends
    them. So arrival stamps mean the same as those of a port. The end of the file is a `LinkError` of kind ENDED.
    """

    tried: tuple[int, ...] = ()

    def __init__(self, path: Path, format_name: str, carries: tuple[Stream, ...], baud: int) -> None:
        self._path = path
        try:
            self._file = open_regular(path, advice="check the name")
        except InputError as error:
            raise LinkError(FailureKind.OTHER if path.exists() else FailureKind.ABSENT, str(error)) from error
        try:
            self._decoder = LinkDecoder(format_name, None, carries)
        except InputError as error:
            self._file.close()
            raise LinkError(FailureKind.ADDRESS, str(error)) from error
        self._byte_s = SERIAL_BITS_PER_BYTE / baud
        self._block: bytes | None = None
        self._started_s = time.monotonic()
        self._due_s = 0.0
        self._device_s = math.nan

    def read(self, timeout_s: float) -> bytes:
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
        """Read the next block and compute its due time from the device's clock."""
        try:
            block = self._file.read(READ_BLOCK_BYTES)
        except OSError as error:
            raise LinkError(FailureKind.OTHER, f"{self._path} cannot be read further: {error.strerror or error}.") from error
        if not block:
            raise LinkError(FailureKind.ENDED, f"{self._path} is at its end.")
        before = self._device_s
        for _, batch in self._decoder.feed(block, round(self._due_s * 1e9)):
            self._device_s = float(batch.device_s[-1])
        passed_s = self._device_s - before
        # No clock, or none yet, is NaN, which is not >= 0 either.
        self._due_s += passed_s if passed_s >= 0 else len(block) * self._byte_s
        return block

    def write(self, data: bytes) -> None:
        """Do nothing: a recording accepts no commands."""

    def close(self) -> None:
        self._file.close()
