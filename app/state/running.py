"""State of the devices. In a module of its own, since the window imports it before numpy."""

from __future__ import annotations

from enum import Enum


class Running(Enum):
    """State of the devices; the value is its name."""

    OPENING = "opening"
    STREAMING = "streaming"
    PAUSED = "paused"
    OFFLINE = "no device"
