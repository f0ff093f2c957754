"""Writes an MCAP file, many messages at once: the bytes are those of the library's `Writer`, a message costs a tenth.

The library makes an object and a dozen small writes of each message, which is most of what recording 1 kHz costs. Here the
messages of a chunk, and their index, are packed together; every other record is written by the library's public classes.
Source: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import BinaryIO

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
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from skincal.geometry import IntArray

_MESSAGE = struct.Struct("<BQHIQQ")
_ENTRY = struct.Struct("<QQ")
_INDEX = struct.Struct("<BQHI")
_OF_LENGTH = 9
"""bytes of a record that its length leaves out: the kind and the length itself."""


class McapWriter:
    """Writes into a `file` that is open and empty; OSError where the disk refuses. Nothing lies in it before `flush`."""

    def __init__(self, file: BinaryIO, profile: str, library: str) -> None:
        self._file = file
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: Counter[int] = Counter()
        self._first: int | None = None
        self._last = 0
        self._begin_chunk()
        file.write(MCAP0_MAGIC)
        self._write(Header(profile, library))

    def _begin_chunk(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0
        # Of each channel, in the order of their first messages: time and place of each message.
        self._entries: dict[int, list[bytes]] = {}
        self._chunk_first, self._chunk_last = 1 << 64, 0

    def add_metadata(self, name: str, texts: Mapping[str, str]) -> None:
        """Write texts by their names, at once."""
        offset = self._file.tell()
        length = self._write(Metadata(name=name, metadata=dict(texts)))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Describe a kind of message; return its number."""
        self._schemas.append(Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name))
        self._put(_bytes_of(self._schemas[-1]))
        return len(self._schemas)

    def register_channel(self, topic: str, message_encoding: str, schema: int) -> int:
        """Describe a channel; return its number."""
        number = len(self._channels) + 1
        channel = Channel(id=number, topic=topic, message_encoding=message_encoding, schema_id=schema, metadata={})
        self._channels.append(channel)
        self._put(_bytes_of(channel))
        return number

    def add_message(self, channel: int, unix_ns: int, data: bytes, sequence: int = 0) -> None:
        """Add a message, made and recorded at one time."""
        self._note(channel, 1, unix_ns, unix_ns, _ENTRY.pack(unix_ns, self._size))
        head = _MESSAGE.pack(Opcode.MESSAGE, _MESSAGE.size - _OF_LENGTH + len(data), channel, sequence, unix_ns, unix_ns)
        self._put(head + data)

    def add_messages(self, channel: int, unix_ns: IntArray, data: NDArray[np.uint8]) -> None:
        """Add n > 0 messages of one size, (n, size), made and recorded at `unix_ns` (n,)."""
        count, size = data.shape
        kinds = {"kind": "u1", "length": "<u8", "channel": "<u2", "sequence": "<u4", "made": "<u8", "log": "<u8"}
        records = np.zeros(count, np.dtype([*kinds.items(), ("data", "u1", (size,))]))
        records["kind"], records["length"] = Opcode.MESSAGE, records.itemsize - _OF_LENGTH
        records["channel"], records["made"], records["log"], records["data"] = channel, unix_ns, unix_ns, data
        entries = np.empty((count, 2), "<u8")
        entries[:, 0], entries[:, 1] = unix_ns, self._size + records.itemsize * np.arange(count)
        self._note(channel, count, int(unix_ns.min()), int(unix_ns.max()), entries.tobytes())
        self._put(records.tobytes())

    def flush(self) -> None:
        """Write what is buffered as a chunk, and hand it to the system; a chunk without messages is not written."""
        if self._entries:
            self._end_chunk()
        self._file.flush()

    def finish(self) -> None:
        """Write what is buffered, and what finds it; the file stays open."""
        self.flush()
        self._write(DataEnd(0))
        start = self._file.tell()
        summary = RecordBuilder()
        offsets: list[SummaryOffset] = []
        statistics = Statistics(
            attachment_count=0, channel_count=len(self._channels), channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunks), message_count=self._counts.total(), metadata_count=len(self._metadata),
            message_start_time=self._first or 0, message_end_time=self._last, schema_count=len(self._schemas),
        )  # fmt: skip
        groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
            (Opcode.SCHEMA, self._schemas), (Opcode.CHANNEL, self._channels), (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks), (Opcode.ATTACHMENT_INDEX, []), (Opcode.METADATA_INDEX, self._metadata),
        ]  # fmt: skip
        for kind, records in groups:
            before = summary.count
            for record in records:
                record.write(summary)
            offsets.append(SummaryOffset(kind, start + before, summary.count - before))
        offsets_start = start + summary.count
        for offset in offsets:
            offset.write(summary)
        data = summary.end()
        head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offsets_start)
        self._file.write(data)
        self._write(Footer(start, offsets_start, zlib.crc32(head, zlib.crc32(data))))
        self._file.write(MCAP0_MAGIC)

    def _put(self, record: bytes) -> None:
        self._parts.append(record)
        self._size += len(record)

    def _note(self, channel: int, count: int, first: int, last: int, entries: bytes) -> None:
        self._counts[channel] += count
        self._first, self._last = first if self._first is None else min(first, self._first), max(last, self._last)
        self._chunk_first, self._chunk_last = min(first, self._chunk_first), max(last, self._chunk_last)
        self._entries.setdefault(channel, []).append(entries)

    def _end_chunk(self) -> None:
        data = b"".join(self._parts)
        packed = zstandard.compress(data)
        offset = self._file.tell()
        times = {"message_start_time": self._chunk_first, "message_end_time": self._chunk_last}
        length = self._write(Chunk("zstd", packed, uncompressed_crc=zlib.crc32(data), uncompressed_size=len(data), **times))
        start = at = offset + length
        offsets: dict[int, int] = {}
        for channel, parts in self._entries.items():
            entries = b"".join(parts)
            head = _INDEX.pack(Opcode.MESSAGE_INDEX, _INDEX.size - _OF_LENGTH + len(entries), channel, len(entries))
            self._file.write(head + entries)
            offsets[channel] = at
            at += len(head) + len(entries)
        sizes = {"compressed_size": len(packed), "uncompressed_size": len(data)}
        self._chunks.append(
            ChunkIndex(length, offset, "zstd", message_index_length=at - start, message_index_offsets=offsets, **times, **sizes)
        )
        self._begin_chunk()

    def _write(self, record: McapRecord) -> int:
        data = _bytes_of(record)
        self._file.write(data)
        return len(data)


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
