"""Read a segment's MCAP file record by record, up to the first damage.

The file may come from a stranger: sizes of records and chunks are checked before they are believed. The library parses the
content of a record. Indexes are never read, so damage in one of them hides nothing. Source: mcap.dev/spec.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Footer, McapRecord, Message, Metadata, Schema, Statistics
from mcap.stream_reader import CRCValidationError, breakup_chunk

from skincal.model.given import open_regular

EVENT_TOPIC = "/events"
RAW_TOPIC = "/raw/"
MAX_RECORD_BYTES = 64 << 20
"""Bytes of a record, and of an unpacked chunk: four times those of the writer."""
MAX_SUMMARY_BYTES = 64 << 20
"""Bytes of the index at the end: it grows by 2 kB a second, and segments end after five minutes."""
_MAGIC = b"\x89MCAP0\r\n"
_FOOTER_BYTES = 9 + 20 + len(_MAGIC)
"""The footer's record, and what follows it."""
_RECORD_HEAD = struct.Struct("<BQ")
_RECORD_READERS: dict[int, Callable[[ReadDataStream], McapRecord]] = {
    Opcode.CHUNK: Chunk.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
    Opcode.STATISTICS: Statistics.read,
    Opcode.DATA_END: DataEnd.read,
    Opcode.FOOTER: Footer.read,
}
"""Readers of the records that are needed; all others are skipped."""
DAMAGE_ERRORS = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,  # among them: bad UTF-8
    KeyError,
    IndexError,
    AssertionError,
    EOFError,
    OverflowError,
    MemoryError,
)
"""Errors of the MCAP library on damaged bytes."""


class DamagedError(Exception):
    """The rest of a file is damaged; the message says how."""


class McapFile:
    """A segment's MCAP file; its methods raise `DamagedError` at the first damage, `InputError` if it cannot be opened."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._good_bytes = 0
        self.complete = False
        """All data was read, though the index behind it may be damaged."""

    @property
    def lost(self) -> str:
        """Size of the unread rest of the file, in words."""
        size = self._path.stat().st_size
        return f"the last {size - self._good_bytes} of {size} bytes"

    def records(self) -> Iterator[McapRecord]:
        """Yield every record in order, and the checked content of a chunk in its place."""
        count = items = 0
        topics: dict[int, str] = {}
        with open_regular(self._path) as file:
            try:
                for record in _records(file):
                    if isinstance(record, Message):
                        count += 1
                        if is_item(topics[record.channel_id]):
                            if record.sequence != items:
                                raise DamagedError(f"item {items} is missing")
                            items += 1
                    elif isinstance(record, Channel):
                        topics[record.id] = record.topic
                    elif isinstance(record, Statistics) and record.message_count != count:
                        self.complete = False
                        raise DamagedError(f"{record.message_count - count} messages are missing")
                    # Only the index comes behind it.
                    self.complete |= isinstance(record, DataEnd)
                    if not self.complete:
                        self._good_bytes = file.tell()
                    yield record
            except DAMAGE_ERRORS as error:
                raise DamagedError(_words_of(error)) from None

    def items(self) -> Iterator[tuple[str, Message]]:
        """Yield each item of the segment, with its topic."""
        topics: dict[int, str] = {}
        for record in self.records():
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message) and is_item(topics[record.channel_id]):
                yield topics[record.channel_id], record


def is_item(topic: str) -> bool:
    """Whether a topic holds recorded input: bytes of a device, or events of its connection."""
    return topic == EVENT_TOPIC or topic.startswith(RAW_TOPIC)


def is_closed(path: Path) -> bool:
    """Whether an MCAP file ends with a whole index; its data is not read."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size < len(_MAGIC) + _FOOTER_BYTES:
            return False
        file.seek(-_FOOTER_BYTES, os.SEEK_END)
        tail = file.read(_FOOTER_BYTES)
        opcode, length, begin, _, checksum = struct.unpack_from("<BQQQI", tail)
        if (opcode, length) != (Opcode.FOOTER, 20) or not tail.endswith(_MAGIC):
            return False
        if not 0 < begin < size or size - begin > MAX_SUMMARY_BYTES:
            return False
        file.seek(begin)
        # The checksum is behind all that it covers.
        covered = file.read(size - begin)[: -len(_MAGIC) - 4]
    return checksum in (0, zlib.crc32(covered))


def _records(file: BinaryIO) -> Iterator[McapRecord]:
    """Yield the records of a file, and of its chunks in their place."""
    if file.read(len(_MAGIC)) != _MAGIC:
        raise DamagedError("it begins as no MCAP file does")
    record = None
    while not isinstance(record, Footer):
        head = file.read(_RECORD_HEAD.size)
        opcode, length = _RECORD_HEAD.unpack(head)
        if length > MAX_RECORD_BYTES:
            raise DamagedError(f"a record says it has {length} bytes; {MAX_RECORD_BYTES} at most were expected")
        content = file.read(length)
        if len(content) < length:
            raise EOFError
        if opcode not in _RECORD_READERS:
            continue
        record = _RECORD_READERS[opcode](ReadDataStream(BytesIO(content)))
        if isinstance(record, Chunk):
            _check_size(record)
            yield from breakup_chunk(record, validate_crc=True)
        else:
            yield record
    if file.read(len(_MAGIC)) != _MAGIC:
        raise EOFError


def _check_size(chunk: Chunk) -> None:
    """Refuse a chunk that claims to unpack to too much, or is packed in another way than the writer does."""
    if chunk.compression not in ("", "zstd"):
        raise DamagedError(f"a chunk is packed by {chunk.compression[:20]!r}; zstd was expected")
    if chunk.compression:
        # The zstd frame has a size of its own, which the library would believe.
        claimed = max(chunk.uncompressed_size, zstandard.frame_content_size(chunk.data))
        if claimed > MAX_RECORD_BYTES:
            raise DamagedError(f"a chunk says it unpacks to {claimed} bytes; {MAX_RECORD_BYTES} at most were expected")


def _words_of(error: Exception) -> str:
    """Describe the damage behind one of `DAMAGE_ERRORS`."""
    if isinstance(error, CRCValidationError):
        return "a checksum does not fit"
    if type(error).__name__ == "EndOfFile" or isinstance(error, EOFError | struct.error):
        return "it ends in the middle of a record"
    return "its bytes make no sense"
