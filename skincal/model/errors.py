"""The exception for input that the user can mend, and the words for counts and channels in its sentences."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable

INTERRUPTED = 130
"""Exit code after Ctrl-C: what a shell reports of a program that the signal ended."""
SENTENCE_MOST = 300
"""Characters of a sentence: five lines of a terminal. What is quoted in it may be a file's whole content."""
WORD_MOST = 80
"""Characters of a word, such as a path, in a sentence that is too long."""
NOT_SHOWN = ("Cc", "Cf", "Cs")
"""Unicode's categories of what moves a terminal's cursor, turns the order of letters, or is half a letter."""


class InputError(Exception):
    """Input is at fault: the message says what was seen, what was expected and what to do. Exit code 2, no traceback.

    The sentence quotes files and devices: it is made plain, and its middle left out where it is longer than `SENTENCE_MOST`.
    """

    def __init__(self, sentence: str) -> None:
        super().__init__(shortened(plain_text(sentence)))


def plain_text(text: str) -> str:
    """Return text on one line that no terminal takes for an order: control characters are shown as question marks."""
    if text.isascii() and text.isprintable():
        return text
    return "".join("?" if unicodedata.category(letter) in NOT_SHOWN else letter for letter in text)


def shortened(sentence: str, most: int = SENTENCE_MOST) -> str:
    """Return a sentence of at most so many characters: long words lose their middle first, then the whole."""
    if len(sentence) <= most:
        return sentence
    shorter = " ".join(_short_word(word) for word in sentence.split(" "))
    if len(shorter) > most:
        head = most * 2 // 3
        shorter = f"{shorter[:head]}\N{HORIZONTAL ELLIPSIS}{shorter[head + 1 - most :]}"
    return shorter


def _short_word(word: str) -> str:
    if len(word) <= WORD_MOST:
        return word
    return f"{word[: WORD_MOST // 2]}\N{HORIZONTAL ELLIPSIS}{word[1 - WORD_MOST // 2 :]}"


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
