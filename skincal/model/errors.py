"""The error for input that the operator can correct, and words for counts and channels in its sentences."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable

CTRL_C_EXIT_CODE = 130
"""After Ctrl-C: what a shell reports of a program that the signal ended."""
ERROR_SENTENCE_MAX_CHARS = 300
"""Five lines of a terminal. A quote in a sentence may be a whole file."""
MAX_WORD_CHARS_IN_LONG_SENTENCE = 80
"""Of a word, such as a path, in a sentence that is too long."""
UNPRINTABLE_CATEGORIES = ("Cc", "Cf", "Cs")
"""Unicode's categories of characters that move a terminal's cursor, reverse the order of letters, or are half a letter."""


class InputError(Exception):
    """Wrong input. The message says what was found, what was expected and what to do. Exit code 2, no traceback.

    Every reader of files and sessions raises it. The sentence quotes files and devices: control characters are replaced, and
    the middle is left out beyond `ERROR_SENTENCE_MAX_CHARS`.
    """

    def __init__(self, sentence: str) -> None:
        super().__init__(shortened(plain_text(sentence)))


def plain_text(text: str) -> str:
    """Replace control characters by question marks, so that a terminal shows one line and takes nothing for a command."""
    if text.isascii() and text.isprintable():
        return text
    return "".join("?" if unicodedata.category(letter) in UNPRINTABLE_CATEGORIES else letter for letter in text)


def shortened(sentence: str, max_chars: int = ERROR_SENTENCE_MAX_CHARS) -> str:
    """Shorten a sentence: first the middle of long words is left out, then the middle of the whole."""
    if len(sentence) <= max_chars:
        return sentence
    shorter = " ".join(
        _without_middle(word, MAX_WORD_CHARS_IN_LONG_SENTENCE, MAX_WORD_CHARS_IN_LONG_SENTENCE // 2)
        for word in sentence.split(" ")
    )
    return _without_middle(shorter, max_chars, max_chars * 2 // 3)


def _without_middle(text: str, max_chars: int, head: int) -> str:
    return text if len(text) <= max_chars else f"{text[:head]}\N{HORIZONTAL ELLIPSIS}{text[head + 1 - max_chars :]}"


MAX_LISTED_CHANNEL_RANGES = 8
"""Ranges of channels in a sentence before the number of further ones."""


def list_channels(channels: Iterable[int], max_ranges: int = MAX_LISTED_CHANNEL_RANGES) -> str:
    """Write channel numbers as ranges, such as `3, 204-215 and 2 more ranges`."""
    ranges: list[list[int]] = []
    for channel in sorted(int(channel) for channel in channels):
        if ranges and channel == ranges[-1][1] + 1:
            ranges[-1][1] = channel
        else:
            ranges.append([channel, channel])
    words = [str(first) if first == last else f"{first}-{last}" for first, last in ranges[:max_ranges]]
    left = len(ranges) - len(words)
    return ", ".join(words) + (f" and {left} more range{'s' if left > 1 else ''}" if left else "")


def plural(count: int, word: str) -> str:
    """Write `1 line`, `2 lines`."""
    return f"{count} {word}" if count == 1 else f"{count} {word}s"
