"""Consistent overhead byte stuffing: write bytes without the byte 0, so that 0 can end a frame.

A block is a code byte c and c - 1 bytes that are not 0; it stands for those bytes and a 0 after them, save where c is
255 or the block is the last. Source: Cheshire and Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Transactions on
Networking 7(2), 1999.
"""

from __future__ import annotations

FULL_BLOCK = 255
"""Code of a block of 254 bytes without a 0 after it."""


def encode(body: bytes) -> bytes:
    """Return `body` stuffed, without the 0 that ends a frame."""
    out = bytearray()
    parts = body.split(b"\x00")
    for part in parts:
        rest = part
        while len(rest) >= FULL_BLOCK - 1:
            out.append(FULL_BLOCK)
            out += rest[: FULL_BLOCK - 1]
            rest = rest[FULL_BLOCK - 1 :]
        out.append(len(rest) + 1)
        out += rest
    if len(parts[-1]) >= FULL_BLOCK - 1 and len(parts[-1]) % (FULL_BLOCK - 1) == 0:
        out.pop()
    return bytes(out)


def decode(piece: bytes) -> bytes | None:
    """Return what `piece` stands for; None if it is no stuffed piece.

    Parameters
    ----------
    piece : the bytes between two zeros, without either
    """
    if 0 in piece:
        return None
    if FULL_BLOCK in piece:
        return _decode_with_full_blocks(piece)
    out = bytearray(piece)
    end = len(out)
    at = 0
    while at < end:
        code = out[at]
        out[at] = 0
        at += code
    return bytes(memoryview(out)[1:]) if at == end and end else None


def _decode_with_full_blocks(piece: bytes) -> bytes | None:
    out = bytearray()
    end = len(piece)
    at = 0
    while at < end:
        code = piece[at]
        stop = at + code
        if stop > end:
            return None
        out += piece[at + 1 : stop]
        if code != FULL_BLOCK and stop < end:
            out.append(0)
        at = stop
    return bytes(out)
