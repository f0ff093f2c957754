"""A journal's segment read record by record, up to its first damage.

What is read is always the beginning of what was written, never a wrong value and never a hole: chunks carry a checksum, items
carry their number, and a segment that was closed says how many messages it holds.

A sparse reader opens the chunks with messages of its topics alone, which it finds by the index that follows each chunk, and
steps over the others. That index is there as soon as the chunk is, so a segment that was cut off is read in the same way.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple, TypeAlias

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Footer, McapRecord, Metadata, Schema, Statistics
from mcap.stream_reader import StreamReader, get_chunk_data_stream


class DamagedError(Exception):
    """The bytes from here on cannot be believed."""


RECORD_LIMIT = 64 << 20
"""Bytes. A record that says it is larger is damaged: chunks hold a megabyte before compression."""
DAMAGE = (
    DamagedError,
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,  # among them: bad checksum, bad UTF-8
    KeyError,
    IndexError,
    AssertionError,
    EOFError,
    OverflowError,
    MemoryError,
)
"""What the MCAP library raises on damaged bytes."""
MAGIC = b"\x89MCAP0\r\n"
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_RECORD_HEAD = struct.Struct("<BQ")
HEAD_SIZE = _RECORD_HEAD.size
"""Bytes before a record's body: its kind and its length."""
_FOOTER_SIZE = 20
_END_HEAD = _RECORD_HEAD.pack(Opcode.FOOTER, _FOOTER_SIZE)
_INDEX_HEAD = struct.Struct("<HI")
_STEP = struct.Struct("<BQHI")
"""A record's head, and what follows in a message index: its channel and its size."""
_INDEX_ENTRY = 16
"""Bytes. An entry of a message index: time and place."""
CHUNK_HEAD = struct.Struct("<QQQII")
"""First and last time, size and checksum before compression, length of the compression's name."""
_SIZE = struct.Struct("<Q")
_BAD_SUM = "a checksum does not fit"
_INDEX, _CHUNK, _FOOTER, _MESSAGE = int(Opcode.MESSAGE_INDEX), int(Opcode.CHUNK), int(Opcode.FOOTER), int(Opcode.MESSAGE)
_FIRST, _LAST = int(Opcode.HEADER), int(Opcode.DATA_END)
"""Plain numbers: a day's segment has a million records, and an enum costs more than the rest of a step."""
_PARSED: dict[int, Callable[[ReadDataStream], McapRecord]] = {
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
    Opcode.STATISTICS: Statistics.read,
    Opcode.DATA_END: DataEnd.read,
    Opcode.FOOTER: Footer.read,
}


class RawMessage(NamedTuple):
    """One message of a chunk."""

    channel: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


SegmentRecord: TypeAlias = Schema | Channel | Metadata | RawMessage


class Span(NamedTuple):
    """Where a record's body lies in the file."""

    opcode: int
    start: int
    end: int


def spans(file: BinaryIO) -> Iterator[Span]:
    """Yield the place of every record outside of chunks, up to the footer; between two of them `file` may be moved.

    Raises
    ------
    DamagedError, EOFError
        At the first record that cannot be one, or that is cut off.
    """
    size = _begin(file)
    at, opcode = len(MAGIC), _FIRST
    while opcode != _FOOTER:
        file.seek(at)
        opcode, length = _RECORD_HEAD.unpack(file.read(_RECORD_HEAD.size))
        start = at + HEAD_SIZE
        at = _checked_end(opcode, start, length, size)
        yield Span(opcode, start, at)


def parts(file: BinaryIO) -> Iterator[tuple[Span, dict[int, int]]]:
    """Yield every record outside of chunks but for message indexes, each with what the indexes behind it count by channel.

    The last one before a damage comes without counts: some of its indexes may be cut off.

    Raises
    ------
    DamagedError, EOFError
        As for `spans`.
    """
    size = _begin(file)
    at, held, counts = len(MAGIC), Span(_FIRST, 0, 0), dict[int, int]()
    try:
        while held.opcode != _FOOTER:
            file.seek(at)
            head = file.read(_STEP.size)
            opcode, length, channel, entries = _STEP.unpack(head if len(head) == _STEP.size else _padded(head))
            start = at + HEAD_SIZE
            at = _checked_end(opcode, start, length, size)
            if opcode == _INDEX:
                counts[channel] = entries // _INDEX_ENTRY
                continue
            if held.start:
                yield held, counts
            held, counts = Span(opcode, start, at), {}
    except DAMAGE:
        yield held, {}
        raise
    yield held, counts


def _begin(file: BinaryIO) -> int:
    """Return the size of a file that begins as an MCAP file."""
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        raise DamagedError("it does not begin as an MCAP file")
    return size


def _padded(head: bytes) -> bytes:
    """Return the head of a file's last record, whose body may be shorter than that of a message index."""
    if len(head) < HEAD_SIZE:
        raise EOFError
    return head.ljust(_STEP.size)


def _checked_end(opcode: int, start: int, length: int, size: int) -> int:
    """Return where a record's body ends that can be one and is not cut off."""
    if not _FIRST <= opcode <= _LAST or length > RECORD_LIMIT:
        raise DamagedError("its bytes make no sense")
    if start + length > size:
        raise EOFError
    return start + length


def has_end(path: Path) -> bool:
    """Tell whether a file ends as one that was closed; what comes before is not looked at."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - len(_END_HEAD) - _FOOTER_SIZE - len(MAGIC)))
        end = file.read()
    return end.startswith(_END_HEAD) and end.endswith(MAGIC)


def read_body(file: BinaryIO, span: Span) -> bytes:
    """Return a record's body."""
    file.seek(span.start)
    return file.read(span.end - span.start)


def index_head(file: BinaryIO, span: Span) -> tuple[int, int]:
    """Return the channel and the number of messages of a message index."""
    file.seek(span.start)
    channel, size = _INDEX_HEAD.unpack(file.read(_INDEX_HEAD.size))
    return channel, size // _INDEX_ENTRY


def inner_spans(data: bytes) -> Iterator[Span]:
    """Yield the place of every record in an opened chunk."""
    at = 0
    while at < len(data):
        opcode, length = _RECORD_HEAD.unpack_from(data, at)
        at += _RECORD_HEAD.size
        yield Span(opcode, at, at + length)
        at += length


def message_head(data: bytes, span: Span) -> tuple[int, int]:
    """Return the channel and the time (ns) of a message in an opened chunk."""
    channel, _, log_ns, _ = _MESSAGE_HEAD.unpack_from(data, span.start)
    return channel, log_ns


def open_chunk(chunk: Chunk) -> bytes:
    """Return a chunk's records, checked.

    Raises
    ------
    DamagedError, or what the MCAP library raises
        They are not as they were written.
    """
    if chunk.uncompressed_size > RECORD_LIMIT or chunk.uncompressed_crc == 0:
        raise DamagedError("a chunk without size or checksum")
    if chunk.compression != "zstd":
        stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        return stream.read(size)
    data = zstandard.ZstdDecompressor().decompress(chunk.data, chunk.uncompressed_size)
    if zlib.crc32(data) != chunk.uncompressed_crc:
        raise DamagedError(_BAD_SUM)
    return data


def read_chunk(body: bytes) -> Chunk:
    """Return the chunk of a record's body, not yet opened; the library's own way takes three times as long."""
    begin, end, size, crc, length = CHUNK_HEAD.unpack_from(body)
    at = CHUNK_HEAD.size + length
    (held,) = _SIZE.unpack_from(body, at)
    return Chunk(
        compression=body[CHUNK_HEAD.size : at].decode(),
        data=body[at + _SIZE.size : at + _SIZE.size + held],
        message_end_time=end,
        message_start_time=begin,
        uncompressed_crc=crc,
        uncompressed_size=size,
    )


class SegmentReader:
    """Reads one segment once.

    Parameters
    ----------
    path : the file
    topics : read messages of topics that begin with one of these alone; None for all
    sparse : open the chunks alone that hold such messages; what lies in the others is not checked
    """

    def __init__(self, path: Path, topics: tuple[str, ...] | None = None, *, sparse: bool = False) -> None:
        self.path = path
        self.damage = ""
        """Why reading ended early; empty while nothing is wrong."""
        self.finished = False
        """The segment was closed by its writer and its index is whole."""
        self.data_complete = False
        """Everything that was written was read."""
        self.good_bytes = 0
        """Length of the part of the file that was read without fault."""
        self.messages = 0
        self._topics = topics
        self._sparse = sparse
        self._wanted: set[int] = set()
        self._described = False
        self._counted: int | None = None

    @property
    def whole(self) -> bool:
        """The segment was closed, and nothing is wrong with it."""
        return self.finished and self.data_complete and not self.damage

    def records(self) -> Iterator[SegmentRecord]:
        """Yield what the segment holds, in the order in which it was written; ends at the first damage."""
        with self.path.open("rb") as file:
            try:
                for record, end in self._selected(file) if self._sparse else _all_records(file):
                    yield from self._opened(record)
                    self._note(record, end)
            except DAMAGE as error:
                self.damage = words_of(error)
        if self._counted is not None:
            self.data_complete = self._counted == self.messages
            if not self.data_complete and not self.damage:
                self.damage = f"{self._counted - self.messages} messages are missing"

    def _selected(self, file: BinaryIO) -> Iterator[tuple[McapRecord, int]]:
        for span, counts in parts(file):
            if span.opcode == _CHUNK:
                # Channels are described in the first chunk; until then any chunk may hold one.
                if self._described and counts and self._wanted.isdisjoint(counts):
                    self.messages += sum(counts.values())
                    self.good_bytes = span.end
                else:
                    yield read_chunk(read_body(file, span)), span.end
            elif span.opcode in _PARSED:
                yield _PARSED[span.opcode](ReadDataStream(BytesIO(read_body(file, span)))), span.end

    def _opened(self, record: McapRecord) -> Iterator[SegmentRecord]:
        if isinstance(record, Chunk):
            yield from self._chunk(record)
        elif isinstance(record, Schema | Channel | Metadata) and not self.data_complete:
            self._learn(record)
            yield record

    def _note(self, record: McapRecord, end: int) -> None:
        if isinstance(record, DataEnd):
            self.data_complete = True
        elif isinstance(record, Statistics):
            self._counted = record.message_count
        elif isinstance(record, Footer):
            self.finished = True
        if not self.data_complete:
            self.good_bytes = end

    def _chunk(self, chunk: Chunk) -> Iterator[SegmentRecord]:
        data = open_chunk(chunk)
        for opcode, start, end in inner_spans(data):
            if opcode == _MESSAGE:
                self.messages += 1
                channel, sequence, log_ns, publish_ns = _MESSAGE_HEAD.unpack_from(data, start)
                if channel in self._wanted:
                    yield RawMessage(channel, sequence, log_ns, publish_ns, data[start + _MESSAGE_HEAD.size : end])
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                record = description(opcode, data[start:end])
                self._learn(record)
                yield record

    def _learn(self, record: Schema | Channel | Metadata) -> None:
        if isinstance(record, Channel):
            self._described = True
            if self._topics is None or record.topic.startswith(self._topics):
                self._wanted.add(record.id)


def _all_records(file: BinaryIO) -> Iterator[tuple[McapRecord, int]]:
    for record in StreamReader(file, emit_chunks=True, record_size_limit=RECORD_LIMIT).records:
        yield record, file.tell()


def description(opcode: int, body: bytes) -> Schema | Channel:
    """Return the schema or the channel of a record's body."""
    stream = ReadDataStream(BytesIO(body))
    return Schema.read(stream) if opcode == Opcode.SCHEMA else Channel.read(stream)


def words_of(error: Exception) -> str:
    """Say what is wrong with bytes that raised one of `DAMAGE`."""
    if isinstance(error, DamagedError):
        return str(error)
    if "EndOfFile" in type(error).__name__ or isinstance(error, EOFError | struct.error):
        return "it ends in the middle of a record"
    if "CRC" in type(error).__name__:
        return _BAD_SUM
    return "its bytes make no sense"
