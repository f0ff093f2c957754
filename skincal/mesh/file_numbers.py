"""Numbers in the text of mesh files."""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable

import numpy as np

from skincal.geometry import FloatArray, IntArray

MAX_TEXT_MESH_BYTES = 64 << 20
"""Largest mesh in text: a word of some bytes takes forty while it is read. A million triangles of OBJ are 60 MB."""
NUMBER_TEXT_MAX_CHARS = 64
"""Longest number in text: a double needs 24. An array of words is as wide as the longest of them."""

WORDS_AT_ONCE = 8192
"""Words that become numbers in one call, in a millisecond or two."""


def decode_text(data: bytes) -> bytes:
    """Return a text without its byte order mark, in UTF-8 or an encoding that extends ASCII."""
    if len(data) > MAX_TEXT_MESH_BYTES:
        raise ValueError(f"{len(data)} bytes of text; {MAX_TEXT_MESH_BYTES} at most were expected: write it as a binary file")
    return drop_mark(data)


def is_utf16(data: bytes) -> bool:
    """Whether a text begins with the byte order mark of UTF-16."""
    return data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))


def drop_mark(data: bytes) -> bytes:
    """Drop a byte order mark; a text in UTF-16 becomes UTF-8."""
    if is_utf16(data):
        return data.decode("utf-16").encode()
    return data.removeprefix(codecs.BOM_UTF8)


def parse_numbers(words: list[bytes]) -> FloatArray:
    """Parse numbers, (n,)."""
    return _parse_all(words, float, parse_number, np.dtype(float))


def parse_wholes(words: list[bytes]) -> IntArray:
    """Parse whole numbers, (n,)."""
    return _parse_all(words, int, parse_whole, np.dtype(np.int64))


def _parse_all(
    words: list[bytes], convert: Callable[[bytes], float], parse: Callable[[bytes], float], kind: np.dtype
) -> np.ndarray:
    parts = [np.empty(0, dtype=kind)]
    # In blocks: so the reading thread lets the window's run.
    for start in range(0, len(words), WORDS_AT_ONCE):
        block = words[start : start + WORDS_AT_ONCE]
        longest = max(map(len, block))
        if longest > NUMBER_TEXT_MAX_CHARS:
            raise ValueError(f"a number of {longest} letters")
        try:
            # Not by an array of text: numpy drops zero bytes at the end of a word, as a cut file has them.
            parts.append(np.fromiter(map(convert, block), kind, len(block)))
            _python_number(b"".join(block))
        except ValueError:
            for word in block:
                parse(word)
            raise
        except OverflowError:
            raise ValueError("a whole number of more than 63 bits") from None
    return np.concatenate(parts)


def _python_number(word: bytes) -> bytes:
    """Return a word that Python reads as files mean it: 1_0 is 10 in Python alone."""
    if b"_" in word:
        raise ValueError
    return word


def show_word(word: bytes) -> str:
    """Decode a word for a sentence."""
    return word[:NUMBER_TEXT_MAX_CHARS].decode("utf-8", "replace")


def parse_whole(word: bytes) -> int:
    """Parse a whole number."""
    try:
        return int(_python_number(word))
    except ValueError:
        raise ValueError(f"{show_word(word)!r} is no whole number") from None


def parse_number(word: bytes) -> float:
    """Parse a number."""
    try:
        return float(_python_number(word))
    except ValueError:
        seen = show_word(word)
        if re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", seen):
            raise ValueError(f"the number {seen} has a decimal comma, where a point was expected") from None
        raise ValueError(f"{seen!r} is no number") from None
