"""Numbers in the text of mesh files."""

from __future__ import annotations

import codecs
import re

import numpy as np

from skincal.geometry import FloatArray, IntArray

MAX_TEXT_MESH_BYTES = 64 << 20
"""Largest mesh in text: a word of some bytes takes forty while it is read. A million triangles of OBJ are 60 MB."""
NUMBER_TEXT_MAX_CHARS = 64
"""Longest number in text: a double needs 24. An array of words is as wide as the longest of them."""


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
    _check_length(words)
    try:
        return np.array(words, dtype="S").astype(float)
    except ValueError:
        for word in words:
            parse_number(word)
        raise


def parse_wholes(words: list[bytes]) -> IntArray:
    """Parse whole numbers, (n,)."""
    _check_length(words)
    try:
        return np.array(words, dtype="S").astype(np.int64)
    except ValueError:
        for word in words:
            parse_whole(word)
        raise


def _check_length(words: list[bytes]) -> None:
    longest = max(map(len, words), default=0)
    if longest > NUMBER_TEXT_MAX_CHARS:
        raise ValueError(f"a number of {longest} letters")
    if any(b"_" in word for word in words):
        raise ValueError(f"{show_word(next(word for word in words if b'_' in word))!r} is no number")


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
