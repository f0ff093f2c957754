"""The small file next to each segment: its events and results, one checked line each. Opening a session reads only these.

A line is a JSON array `["CHECKSUM", ITEMS, KEY, DOCUMENT]`. ITEMS is the number of the segment's items that are on the disk in
its MCAP file, which is written first. KEY names the poke of the document; a line directly behind one of the same key replaces
it. A line without KEY and DOCUMENT gives the number of items only. The last line has the word "closed" in their place.
CHECKSUM is the CRC-32, in hexadecimal, of the rest of the line and of all lines before, so that no line can be changed, lost
or moved unnoticed.
"""

from __future__ import annotations

import os
import zlib
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO

from skincal.model.errors import InputError
from skincal.model.given import read_regular

MAX_LINE_FILE_BYTES = 64 << 20
"""Bytes of the lines of a segment, which lasts five minutes: ten thousand pokes have 15 MB."""
TOTALS_KEY = "totals"
"""Key of counts: only the last of a file counts."""
_LINE_END = b"]\n"
_LINE_HEAD_BYTES = 12
"""Bytes in front of what the checksum covers: `["`, eight digits, `",`."""
_CLOSED_MARK = b'"closed"'


def lines_path(segment: Path) -> Path:
    """Path of the line file of a segment's MCAP file."""
    return segment.with_suffix(".jsonl")


class LineWriter:
    """Appends lines to a new file."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb")
        self._checksum = 0

    def add(self, items: int, key: str, document: bytes) -> None:
        """Append a document, JSON."""
        self._write(b'%d,"%s",%s' % (items, key.encode(), document))

    def confirm_items(self, items: int) -> None:
        """Record the number of items that are on the disk in the MCAP file."""
        self._write(b"%d" % items)

    def flush(self, *, sync: bool = False) -> None:
        """Hand everything to the system; with `sync` force it onto the disk."""
        self._file.flush()
        if sync:
            os.fsync(self._file.fileno())

    def fileno(self) -> int:
        return self._file.fileno()

    def end(self, items: int) -> IO[bytes]:
        """Write the closing line, and hand everything to the system; return the file, which is still open."""
        self._write(b"%d,%s" % (items, _CLOSED_MARK))
        self.flush()
        return self._file

    def close(self, items: int) -> None:
        """Write the closing line, and close the file."""
        os.fsync(self.end(items).fileno())
        self._file.close()

    def abandon(self) -> None:
        """Close the file without a closing line. Raises OSError: the disk refuses the buffer."""
        self._file.close()

    def _write(self, body: bytes) -> None:
        line, self._checksum = _checked_line(body, self._checksum)
        self._file.write(line)


def _checked_line(body: bytes, checksum: int) -> tuple[bytes, int]:
    """Make a line that follows one with this checksum; return it and its own checksum."""
    body += _LINE_END
    checksum = zlib.crc32(body, checksum)
    return b'["%08x",%s' % (checksum, body), checksum


@dataclass(frozen=True, slots=True)
class Lines:
    """Content of a line file up to its first damage."""

    documents: tuple[bytes, ...]
    """JSON; without replaced ones, counts last."""
    confirmed_items: int
    """Number of items that are on the disk in the MCAP file."""
    closed: bool
    """The closing line is there: no line is missing."""
    checksum: int
    size: int
    """Bytes of the part without damage."""
    lost: int
    """Bytes behind it."""


def read_lines(segment: Path) -> Lines | None:
    """Read the line file of a segment; `None` if it is missing or empty. Raises InputError: another program wrote it."""
    path = lines_path(segment)
    data = read_regular(path, MAX_LINE_FILE_BYTES) if path.exists() else b""
    kept: list[bytes] = []
    totals: list[bytes] = []
    body, last_key, checksum, size = b"0]\n", b'""', 0, 0
    # One by one up to the first damage: a list of all could need far more memory than the file.
    for line in BytesIO(data):
        found = zlib.crc32(line[_LINE_HEAD_BYTES:], checksum)
        if line[:_LINE_HEAD_BYTES] != b'["%08x",' % found:
            break
        body, checksum = line[_LINE_HEAD_BYTES:], found
        size += len(line)
        _, *rest = body.split(b",", 2)
        if len(rest) < 2:
            continue
        key, document = rest
        if key == b'"%s"' % TOTALS_KEY.encode():
            totals = [document]
            continue
        if key == last_key != b'""':
            kept.pop()
        kept.append(document)
        last_key = key
    documents = tuple(document[: -len(_LINE_END)] for document in kept + totals)
    try:
        items = int(body.split(b",")[0].removesuffix(_LINE_END))
    except ValueError:
        raise InputError(f"{path}: a line begins without a count of items; another program wrote it.") from None
    return Lines(documents, items, body.endswith(_CLOSED_MARK + _LINE_END), checksum, size, len(data) - size) if data else None


def write_closed_copy(path: Path, lines: Lines, target: Path) -> None:
    """Copy the part of a line file without damage into a new file, and close that."""
    with target.open("xb") as file:
        file.write(path.read_bytes()[: lines.size])
        file.write(_checked_line(b"%d,%s" % (lines.confirmed_items, _CLOSED_MARK), lines.checksum)[0])
        os.fsync(file.fileno())
