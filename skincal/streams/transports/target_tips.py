"""Positions of the tip that a robot reports with its answers to targets (`docs/wire.md`): bytes from inside the program.

The server of the targets hands them in, so that they are recorded and replayed like the lines of any device.
"""

from __future__ import annotations

import contextlib
import queue
from weakref import WeakSet

from skincal.devices.link import Link
from skincal.geometry import FloatArray
from skincal.streams.transports import Opening

UNREAD_TIP_LINES_MAX = 1000
"""Lines that wait for a reader; the server accepts 50 a second."""


class TargetTipLink:
    """Lines `x y z` in metres, since it was opened."""

    tried: tuple[int, ...] = ()

    def __init__(self) -> None:
        self._lines: queue.Queue[bytes] = queue.Queue(UNREAD_TIP_LINES_MAX)
        _OPEN_LINKS.add(self)

    def add(self, line: bytes) -> None:
        with contextlib.suppress(queue.Full):
            self._lines.put_nowait(line)

    def read(self, timeout_s: float) -> bytes:
        try:
            lines = [self._lines.get(timeout=timeout_s)]
        except queue.Empty:
            return b""
        with contextlib.suppress(queue.Empty):
            while True:
                lines.append(self._lines.get_nowait())
        return b"".join(lines)

    def write(self, data: bytes) -> None:
        """Send nothing: a robot is asked by its targets."""

    def close(self) -> None:
        _OPEN_LINKS.discard(self)


_OPEN_LINKS: WeakSet[TargetTipLink] = WeakSet()


def open_transport(opening: Opening) -> Link:
    """Open a link to the robot that is asked for pokes, whether one is connected or not."""
    del opening
    return TargetTipLink()


def report_tip(place: FloatArray) -> None:
    """Pass the position (3,), metres, of a robot's tip to the open links."""
    line = (" ".join(f"{value:.6f}" for value in place) + "\n").encode()
    for link in list(_OPEN_LINKS):
        link.add(line)
