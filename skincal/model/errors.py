"""The exception for input that the user can mend, and the words for counts and channels in its sentences."""

from __future__ import annotations

from collections.abc import Iterable


class InputError(Exception):
    """Input is at fault: the message says what was seen, what was expected and what to do. Exit code 2, no traceback."""


MOST_NAMED = 8
"""Ranges that a sentence names before it says how many more there are."""


def list_channels(channels: Iterable[int], most: int = MOST_NAMED) -> str:
    """Return channel numbers as ranges, such as `3, 204-215 and 2 more ranges`."""
    ranges: list[list[int]] = []
    for channel in sorted(int(channel) for channel in channels):
        if ranges and channel == ranges[-1][1] + 1:
            ranges[-1][1] = channel
        else:
            ranges.append([channel, channel])
    words = [str(first) if first == last else f"{first}-{last}" for first, last in ranges[:most]]
    left = len(ranges) - len(words)
    return ", ".join(words) + (f" and {left} more range{'s' if left > 1 else ''}" if left else "")


def plural(count: int, word: str) -> str:
    """Return `1 line`, `2 lines`."""
    return f"{count} {word}" if count == 1 else f"{count} {word}s"
