"""What the program does with its devices. By itself: the window has it before numpy, and all that stands on it, is imported."""

from __future__ import annotations

from enum import Enum


class Running(Enum):
    """What the program does with its devices."""

    OPENING = "opening"
    STREAMING = "streaming"
    PAUSED = "paused"
    OFFLINE = "no device"
