"""A segment's MCAP file, record by record, up to the first damage.

The file may be a stranger's, so nothing in it is believed before it is looked at: how long a record is, how large a chunk
becomes when it is unpacked. The library reads what one record holds; indexes are never read, so that what is wrong in one of
them hides nothing. Source: mcap.dev/spec.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, cast

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Footer, McapRecord, Message, Metadata, Schema, Statistics

from skincal.model.given import open_regular, parse_json

EVENT_TOPIC = "/events"
NOTE_TOPIC = "/session"
RAW_TOPIC = "/raw/"
MAX_RECORD_BYTES = 64 << 20
"""Bytes of a record, and of a chunk when it is unpacked: four times what the writer makes. What says more is damaged."""
MAX_SUMMARY_BYTES = 64 << 20
"""Bytes of the index at the end: it grows by 2 kB a second, and segments end after five minutes."""
_MAGIC = b"\x89MCAP0\r\n"
_FOOTER_BYTES = 9 + 20 + len(_MAGIC)
"""The footer's record, and what follows it."""
_RECORD_HEAD_STRUCT = struct.Struct("<BQ")
_MESSAGE_HEAD_STRUCT = struct.Struct("<HIQQ")
_RECORD_READERS: dict[int, Callable[[ReadDataStream], McapRecord]] = {
    Opcode.CHUNK: Chunk.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
    Opcode.STATISTICS: Statistics.read,
    Opcode.DATA_END: DataEnd.read,
    Opcode.FOOTER: Footer.read,
}
"""What reads the records that are looked at; all others are passed over."""
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
"""What the MCAP library raises on damaged bytes."""


class DamagedError(Exception):
    """What follows in a file cannot be believed; the message says why."""


class McapFile:
    """A segment's MCAP file; its methods raise `DamagedError` at the first damage, `InputError` where it cannot be opened."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._good_bytes = self._items = 0
        self._topics: dict[int, str] = {}
        self.complete = False
        """All data was read, though the index behind it may be damaged."""

    @property
    def lost(self) -> str:
        """Size of the unread rest of the file, in words."""
        size = self._path.stat().st_size
        return f"the last {size - self._good_bytes} of {size} bytes"

    def records(self) -> Iterator[McapRecord]:
        """Yield every record but chunks, whose content is yielded, checked, and indexes."""
        count = 0
        with open_regular(self._path) as file:
            try:
                for record in _records(file):
                    if isinstance(record, Message):
                        count += 1
                        self._demand_next(record)
                    elif isinstance(record, Channel):
                        self._topics[record.id] = record.topic
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

    def _demand_next(self, message: Message) -> None:
        if is_item(self._topics[message.channel_id]):
            if message.sequence != self._items:
                raise DamagedError(f"item {self._items} is missing")
            self._items += 1

    def messages(self) -> Iterator[tuple[str, Message]]:
        """Yield each message with its topic."""
        return ((self._topics[record.channel_id], record) for record in self.records() if isinstance(record, Message))

    def documents(self) -> Iterator[dict[str, Any]]:
        """Yield events and notes."""
        found = (message for topic, message in self.messages() if topic in (EVENT_TOPIC, NOTE_TOPIC))
        for count, message in enumerate(found):
            document = _document(message.data)
            # Without notes nothing counts the events alone; such a segment is played from its bytes in the end.
            if document.get("n", count) != count:
                raise DamagedError(f"note {count} is missing")
            yield document


def is_item(topic: str) -> bool:
    """Return whether messages of a topic are items of a segment."""
    return topic == EVENT_TOPIC or topic.startswith(RAW_TOPIC)


def is_closed(path: Path) -> bool:
    """Return whether an MCAP file ends with a whole index; what comes before is not looked at."""
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
        # The checksum stands behind all that it covers.
        covered = file.read(size - begin)[: -len(_MAGIC) - 4]
    return checksum in (0, zlib.crc32(covered))


def tells_all(path: Path) -> bool:
    """Return whether an MCAP file was closed and none of its events and notes is missing."""
    try:
        return is_closed(path) and sum(1 for _ in McapFile(path).documents()) > 0
    except DamagedError:
        return False


def _records(file: BinaryIO) -> Iterator[McapRecord]:
    """Yield the records of a file, and of its chunks in their place."""
    if file.read(len(_MAGIC)) != _MAGIC:
        raise DamagedError("it begins as no MCAP file does")
    for opcode, content in _framed(file):
        record = _parsed(opcode, content)
        if isinstance(record, Chunk):
            inner = (_parsed(*each) for each in _framed(BytesIO(_unpacked(record))))
            yield from (each for each in inner if isinstance(each, Schema | Channel | Message))
        elif record is not None:
            yield record
        if isinstance(record, Footer):
            if file.read(len(_MAGIC)) != _MAGIC:
                raise EOFError
            return
    raise EOFError


def _framed(stream: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Yield kind and content of each record; `EOFError` where the last one is cut."""
    while head := stream.read(_RECORD_HEAD_STRUCT.size):
        opcode, length = _RECORD_HEAD_STRUCT.unpack(head)
        if length > MAX_RECORD_BYTES:
            raise DamagedError(f"a record says it has {length} bytes; {MAX_RECORD_BYTES} at most were expected")
        content = stream.read(length)
        if len(content) < length:
            raise EOFError
        yield opcode, content


def _parsed(opcode: int, content: bytes) -> McapRecord | None:
    """Parse the content of a record; `None` for kinds that are skipped."""
    if opcode == Opcode.MESSAGE:
        channel, sequence, log_time, publish_time = _MESSAGE_HEAD_STRUCT.unpack_from(content)
        return Message(channel, log_time, content[_MESSAGE_HEAD_STRUCT.size :], publish_time, sequence)
    return _RECORD_READERS[opcode](ReadDataStream(BytesIO(content))) if opcode in _RECORD_READERS else None


def _unpacked(chunk: Chunk) -> bytes:
    """Return the bytes of a chunk; nothing is unpacked that says it becomes too large, or other than the writer packs it."""
    data = chunk.data
    if chunk.compression not in ("", "zstd"):
        raise DamagedError(f"a chunk is packed by {chunk.compression[:20]!r}; zstd was expected")
    if chunk.compression:
        # The frame says it, too, and would be believed.
        claimed = max(chunk.uncompressed_size, zstandard.frame_content_size(data))
        if claimed > MAX_RECORD_BYTES:
            raise DamagedError(f"a chunk says it unpacks to {claimed} bytes; {MAX_RECORD_BYTES} at most were expected")
        data = zstandard.decompress(data, chunk.uncompressed_size) if chunk.uncompressed_size else b""
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise DamagedError("a checksum does not fit")
    return data


def _document(data: bytes) -> dict[str, Any]:
    document = parse_json(data)
    if not isinstance(document, dict):
        raise DamagedError("an event or note is no table")
    return cast("dict[str, Any]", document)


def _words_of(error: Exception) -> str:
    """Describe the damage behind one of `DAMAGE_ERRORS`."""
    if "EndOfFile" in type(error).__name__ or isinstance(error, EOFError | struct.error):
        return "it ends in the middle of a record"
    return "its bytes make no sense"
