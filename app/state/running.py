"""What the program does with its devices; by itself, since the window has it before a session is there."""

from __future__ import annotations

from enum import Enum


class Running(Enum):
    """What the program does with its devices."""

    OPENING = "opening"
    STREAMING = "streaming"
    PAUSED = "paused"
    OFFLINE = "no device"
