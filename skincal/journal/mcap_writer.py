"""Write an MCAP file, many messages at once.

The library writes one message at a time, which costs more than all other work of a recording at 1 kHz. This file collects the
messages of a chunk as bytes. Its output equals the library's bit for bit. Source: mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from io import BufferedWriter

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

from skincal.geometry import IntArray

CHUNK_MAX_BYTES = 256 << 10
"""A longer chunk ends without a flush: it takes 2 ms of the thread that records, which may be the window's."""
MCAP_MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEAD_BYTES = 9
"""Kind of a record (u8) and its length (u64)."""
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
"""Kind, length, channel, sequence, log time and publish time; the data follows."""
_MESSAGE_FIELDS_BYTES = _MESSAGE_HEAD.size - _RECORD_HEAD_BYTES
_MESSAGE_HEADS = np.dtype(
    [("kind", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
"""`_MESSAGE_HEAD` for arrays."""
_INDEX_HEAD = struct.Struct("<BQHI")
"""Kind, length, channel, and bytes of the index."""


def _record_bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


class McapWriter:
    """Writes chunks compressed by zstd, with all indexes. Each `flush` ends a chunk.

    Parameters
    ----------
    file : written from its present place; stays open
    profile, library : as in the file's header
    """

    def __init__(self, file: BufferedWriter, profile: str, library: str) -> None:
        self._file = file
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._metadata: list[MetadataIndex] = []
        self._chunks: list[ChunkIndex] = []
        self._messages = Counter[int]()
        """Number of messages by channel."""
        self._begin_chunk()
        file.write(MCAP_MAGIC + _record_bytes(Header(profile, library)))

    def _begin_chunk(self) -> None:
        self._parts: list[bytes] = []
        self._bytes = 0
        self._index: dict[int, list[int]] = {}
        """By channel: time and place of each message of the chunk, in turn."""

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a schema; return its number."""
        self._schemas.append(Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name))
        self._append(_record_bytes(self._schemas[-1]))
        return len(self._schemas)

    def register_channel(self, topic: str, message_encoding: str, schema_id: int) -> int:
        """Add a channel; return its number."""
        number = len(self._channels) + 1
        self._channels.append(Channel(number, topic, message_encoding, {}, schema_id))
        self._append(_record_bytes(self._channels[-1]))
        return number

    def add_metadata(self, name: str, texts: dict[str, str]) -> None:
        """Write texts by key, between the chunks."""
        record = _record_bytes(Metadata(name, texts))
        self._metadata.append(MetadataIndex(self._file.tell(), len(record), name))
        self._file.write(record)

    def _append(self, data: bytes) -> None:
        self._parts.append(data)
        self._bytes += len(data)

    def add_message(self, channel: int, unix_ns: int, data: bytes, sequence: int = 0) -> None:
        """Add a message to the chunk."""
        size, index = len(data), self._index.get(channel)
        if index is None:
            index = self._index[channel] = []
        index += (unix_ns, self._bytes)
        head = _MESSAGE_HEAD.pack(Opcode.MESSAGE, _MESSAGE_FIELDS_BYTES + size, channel, sequence, unix_ns, unix_ns)
        self._parts += (head, data)
        self._bytes += _MESSAGE_HEAD.size + size
        if self._bytes > CHUNK_MAX_BYTES:
            self._write_chunk()

    def add_messages(self, channel: int, unix_ns: IntArray, messages: NDArray[np.uint8]) -> None:
        """Add n messages of one length to the chunk: (n,) times, (n, bytes) data. Their sequence is 0."""
        count, size = messages.shape
        if not count:
            return
        records = np.zeros(count, np.dtype([("head", _MESSAGE_HEADS), ("data", "u1", (size,))]))
        head = records["head"]
        head["kind"], head["length"], head["channel"] = Opcode.MESSAGE, _MESSAGE_FIELDS_BYTES + size, channel
        head["log"] = head["publish"] = unix_ns
        records["data"] = messages
        index = self._index.setdefault(channel, [])
        for at, place in zip(unix_ns.tolist(), range(self._bytes, self._bytes + records.nbytes, records.itemsize), strict=True):
            index += (at, place)
        self._append(records.tobytes())
        if self._bytes > CHUNK_MAX_BYTES:
            self._write_chunk()

    def flush(self) -> None:
        """End the chunk, if it has messages, and hand everything to the system."""
        if self._index:
            self._write_chunk()
        self._file.flush()

    def _write_chunk(self) -> None:
        data = b"".join(self._parts)
        indexes = {channel: np.array(pairs, "<u8").reshape(-1, 2) for channel, pairs in self._index.items()}
        begin_ns = min(int(index[:, 0].min()) for index in indexes.values())
        end_ns = max(int(index[:, 0].max()) for index in indexes.values())
        packed = zstandard.compress(data)
        chunk = _record_bytes(Chunk("zstd", packed, end_ns, begin_ns, zlib.crc32(data), len(data)))
        start = self._file.tell()
        places: dict[int, int] = {}
        after = bytearray()
        for channel, index in indexes.items():
            self._messages[channel] += len(index)
            places[channel] = start + len(chunk) + len(after)
            fields_bytes = _INDEX_HEAD.size - _RECORD_HEAD_BYTES
            after += _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, fields_bytes + index.nbytes, channel, index.nbytes)
            after += index.tobytes()
        self._chunks.append(ChunkIndex(len(chunk), start, "zstd", len(packed), end_ns, len(after), places, begin_ns, len(data)))
        self._file.write(chunk + after)
        self._begin_chunk()

    def finish(self) -> None:
        """Write the last chunk and the summary; the file stays open."""
        self.flush()
        self._file.write(_record_bytes(DataEnd(0)))
        begin = self._file.tell()
        summary, offsets = bytearray(), bytearray()
        groups: dict[Opcode, list[bytes]] = {
            Opcode.SCHEMA: [_record_bytes(each) for each in self._schemas],
            Opcode.CHANNEL: [_record_bytes(each) for each in self._channels],
            Opcode.STATISTICS: [_record_bytes(self._statistics())],
            Opcode.CHUNK_INDEX: [_record_bytes(each) for each in self._chunks],
            Opcode.ATTACHMENT_INDEX: [],
            Opcode.METADATA_INDEX: [_record_bytes(each) for each in self._metadata],
        }
        for kind, records in groups.items():
            group = b"".join(records)
            offsets += _record_bytes(SummaryOffset(kind, begin + len(summary), len(group)))
            summary += group
        footer = Footer(begin, begin + len(summary), 0)
        tail = bytes(summary + offsets) + _record_bytes(footer)[:-4]
        self._file.write(tail + struct.pack("<I", zlib.crc32(tail)) + MCAP_MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self._messages),
            chunk_count=len(self._chunks),
            message_count=self._messages.total(),
            metadata_count=len(self._metadata),
            message_start_time=min((each.message_start_time for each in self._chunks), default=0),
            message_end_time=max((each.message_end_time for each in self._chunks), default=0),
            schema_count=len(self._schemas),
        )
