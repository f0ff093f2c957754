"""What a closed segment tells of its session, once more and in one piece.

Events and notes lie among the readings, so that nothing is lost in a crash; in hours of readings they are tens of thousands
of places to go to. A segment that is closed in good order therefore ends with its *outline*, an MCAP attachment: the lines of
its events and notes in their order, compressed. Left out is what the next line replaced (the first outcome of a poke by its
second, counts by newer counts), so that the same session comes of it, to the last bit.

The notes are the evidence. Where there is no outline, or it is damaged, they are read.
"""

from __future__ import annotations

import io
import os
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, Footer, SummaryOffset

from skincal.session.packed import Packed
from skincal.session.segment import DAMAGE, HEAD_SIZE, MAGIC, RECORD_LIMIT, DamagedError, has_end, inner_spans
from skincal.session.taken import Taken
from skincal.session.totals import Totals

NAME = "skincal outline"
MEDIA_TYPE = "application/x-ndjson+zstd"
_FOOTER_SIZE = 8 + 8 + 4
_CRC_SIZE = 4


class OutlineWriter:
    """Collects the lines of a segment, compressed as they come: some 200 bytes a poke."""

    def __init__(self) -> None:
        self._packed = Packed()
        self._held = b""
        self._note: Taken | None = None
        self._totals = b""

    def add(self, line: bytes, note: Taken | Totals | None) -> None:
        """Take the line of an event, or of a note."""
        if isinstance(note, Totals):
            self._totals = line
            return
        if not _replaces(note, self._note):
            self._pack(self._held)
        self._held, self._note = line, note

    def finish(self) -> bytes:
        """Return the outline; nothing may be added after it. Empty where it is too large for a reader."""
        self._pack(self._held)
        self._pack(self._totals)
        outline = self._packed.finish()
        return outline if len(outline) < RECORD_LIMIT // 2 else b""

    def _pack(self, line: bytes) -> None:
        if line:
            self._packed.add(line + b"\n")


def _replaces(new: Taken | None, old: Taken | None) -> bool:
    """Tell whether a session that takes `new` right after `old` is as if it had never taken `old`."""
    if new is None or old is None or new.dead is not None or old.dead is not None:
        return False
    if len(new.outcomes) != 1 or len(old.outcomes) != 1:
        return False
    (after, _), (before, _) = new.outcomes[0], old.outcomes[0]
    return after.poke == before.poke and type(after) is type(before)


def read_outline(path: Path) -> Iterator[str] | None:
    """Return the lines of a segment's outline; None where it has none that can be trusted."""
    if not has_end(path):
        return None
    try:
        with path.open("rb") as file:
            packed = _find(file)
    except (*DAMAGE, OSError):
        return None
    return None if packed is None else _lines(packed)


def _lines(packed: bytes) -> Iterator[str]:
    with zstandard.ZstdDecompressor().stream_reader(packed) as stream:
        yield from io.TextIOWrapper(stream, encoding="utf-8")


def _find(file: BinaryIO) -> bytes | None:
    """Return the outline of a file that ends as an MCAP file, checked."""
    end = file.seek(-(HEAD_SIZE + _FOOTER_SIZE + len(MAGIC)), os.SEEK_END)
    footer = Footer.read(_stream(file, end + HEAD_SIZE, _FOOTER_SIZE))
    if not footer.summary_offset_start:
        return None
    for body in _bodies(file, footer.summary_offset_start, end - footer.summary_offset_start, Opcode.SUMMARY_OFFSET):
        group = SummaryOffset.read(body)
        if group.group_opcode == Opcode.ATTACHMENT_INDEX:
            for entry in _bodies(file, group.group_start, group.group_length, Opcode.ATTACHMENT_INDEX):
                index = AttachmentIndex.read(entry)
                if index.name == NAME:
                    return _attached(file, index)
    return None


def _attached(file: BinaryIO, index: AttachmentIndex) -> bytes:
    (body,) = _bodies(file, index.offset, index.length, Opcode.ATTACHMENT)
    content = body.read(index.length - HEAD_SIZE)
    # The library passes over the checksum.
    if zlib.crc32(content[:-_CRC_SIZE]) != int.from_bytes(content[-_CRC_SIZE:], "little"):
        raise DamagedError("a checksum does not fit")
    attachment = Attachment.read(ReadDataStream(io.BytesIO(content)))
    if (attachment.name, attachment.media_type) != (NAME, MEDIA_TYPE):
        raise DamagedError("another attachment than its index says")
    return attachment.data


def _bodies(file: BinaryIO, start: int, size: int, opcode: int) -> Iterator[ReadDataStream]:
    """Yield the bodies of the records in a piece of the file, which are all of one kind."""
    if not 0 <= size <= RECORD_LIMIT:
        raise DamagedError("its bytes make no sense")
    file.seek(start)
    piece = file.read(size)
    for span in inner_spans(piece):
        if span.opcode != opcode or span.end > len(piece):
            raise DamagedError("its bytes make no sense")
        yield ReadDataStream(io.BytesIO(piece[span.start : span.end]))


def _stream(file: BinaryIO, start: int, size: int) -> ReadDataStream:
    file.seek(start)
    return ReadDataStream(io.BytesIO(file.read(size)))
