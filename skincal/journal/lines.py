"""The small file beside each segment: its events and notes, one checked line each. Opening a session reads nothing else.

A line is a JSON array `["CHECKSUM", ITEMS, KEY, DOCUMENT]`. ITEMS is how many items of the segment lie in its MCAP file for
sure: that file is written first. KEY names the poke that the document is about; right behind a line of the same key, it takes
that line's place. A line without KEY and DOCUMENT says only how many items there are, and one with the word "closed" that no
more come. CHECKSUM is the CRC-32, in hexadecimal, of what follows it in the line and of all lines before, so that no line can
be changed, lost or moved unseen.
"""

from __future__ import annotations

import os
import zlib
from dataclasses import dataclass
from pathlib import Path

from skincal.contacts.outcome import Contact
from skincal.journal.documents import Note, Taken, Totals

_END = b"]\n"
_HEAD = 12
"""Bytes before what the checksum covers: `["`, eight digits, `",`."""
_TOTALS, _NO_KEY, _CLOSED = b'"totals"', b'""', b'"closed"'


def lines_path(segment: Path) -> Path:
    """Return the file of lines beside a segment's MCAP file."""
    return segment.with_suffix(".jsonl")


def key_of(note: Note | None) -> str:
    """Return what a note may replace or be replaced by; empty where every one counts.

    The outcome of one poke replaces an earlier one of the same kind: a session that takes both is as if it had taken the
    second alone. What was a contact and is none any more leaves the steps of undo, so both are kept. Of counts the last count.
    """
    if isinstance(note, Totals):
        return "totals"
    if not isinstance(note, Taken) or note.dead is not None or len(note.outcomes) != 1:
        return ""
    outcome = note.outcomes[0][0]
    return f"{'contact' if isinstance(outcome, Contact) else 'rejection'} {outcome.poke}"


class LineWriter:
    """Appends lines to a file.

    Parameters
    ----------
    path : a file that does not exist yet, or the whole part of one that was read
    read : of that file
    """

    def __init__(self, path: Path, read: Lines | None = None) -> None:
        self._file = path.open("xb" if read is None else "r+b")
        self._sum = 0 if read is None else read.checksum
        self._file.seek(0, os.SEEK_END)

    def add(self, items: int, key: str, document: bytes) -> None:
        """Append a document, JSON."""
        self._add(b'%d,"%s",%s' % (items, key.encode(), document))

    def vouch(self, items: int) -> None:
        """Say that so many items lie in the MCAP file."""
        self._add(b"%d" % items)

    def flush(self, *, sync: bool = False) -> None:
        """Hand everything to the system; with `sync` to the medium."""
        self._file.flush()
        if sync:
            os.fsync(self._file.fileno())

    def close(self, items: int) -> None:
        """Say that no more come, and close the file."""
        self._add(b"%d,%s" % (items, _CLOSED))
        self.flush(sync=True)
        self._file.close()

    def abandon(self) -> None:
        """Close the file as it is; `OSError` where the disk refuses what is buffered."""
        self._file.close()

    def _add(self, body: bytes) -> None:
        body += _END
        self._sum = zlib.crc32(body, self._sum)
        self._file.write(b'["%08x",%s' % (self._sum, body))


@dataclass(frozen=True, slots=True)
class Lines:
    """What a file of lines says, up to its first damage."""

    documents: tuple[bytes, ...]
    """JSON; without those that others replaced, and counts last."""
    items: int
    """How many items lie in the MCAP file for sure."""
    closed: bool
    """All that was written is here."""
    checksum: int
    size: int
    """Bytes of the part without damage."""
    lost: int
    """Bytes behind it."""


def read_lines(segment: Path) -> Lines | None:
    """Return the lines beside a segment; None where there are none, as in older sessions."""
    data = lines_path(segment).read_bytes() if lines_path(segment).exists() else b""
    kept: list[bytes] = []
    totals: list[bytes] = []
    body, last_key, checksum, size = b"0]\n", b"", 0, 0
    for line in data.splitlines(keepends=True):
        found = zlib.crc32(line[_HEAD:], checksum)
        if line[:_HEAD] != b'["%08x",' % found:
            break
        body, checksum = line[_HEAD:], found
        size += len(line)
        _, *rest = body.split(b",", 2)
        if len(rest) < 2:
            continue
        key, document = rest
        if key == _TOTALS:
            totals = [document]
            continue
        if key == last_key != _NO_KEY:
            kept.pop()
        kept.append(document)
        last_key = key
    documents = tuple(document[: -len(_END)] for document in kept + totals)
    items = int(body.split(b",")[0].removesuffix(_END))
    return Lines(documents, items, body.endswith(_CLOSED + _END), checksum, size, len(data) - size) if data else None
