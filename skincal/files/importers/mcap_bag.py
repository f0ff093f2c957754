"""MCAP files of any recorder as channels with messages of ROS: whole ones by their index, others from the beginning.

A channel is read if its messages are those of ROS (`cdr` or `ros1`), for any profile of the file. The others, such as JSON or
protobuf, are left out and named. A file without an index or end, such as that of a killed recorder, is read up to its last
whole record. Source: MCAP specification (mcap.dev/spec, well-known encodings mcap.dev/spec/registry).
"""

from __future__ import annotations

import contextlib
import math
import struct
from bisect import bisect_left
from collections import Counter
from collections.abc import Collection, Iterator
from io import BytesIO
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, ChunkIndex, Message, Schema
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.summary import Summary

from skincal.model.errors import InputError
from skincal.ros.types import full_type_name

MCAP_MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")
"""Operation and length."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, number, arrival and sending (ns)."""
OVERLAP_OF_CHUNKS_MAX_NS = 500_000_000
"""Arrivals in a chunk and the next one may overlap by this: late messages are written as they come."""
RECORD_MAX_BYTES = 1 << 30
"""Recorders make chunks of some MB. A damaged length must not fill the memory."""
_ROS_OF_ENCODING: dict[str, Literal[1, 2]] = {"cdr": 2, "ros1": 1}
"""Version of ROS by the encoding of a channel's messages."""
_SCHEMA_ENCODINGS = ("ros1msg", "ros2msg", "ros2idl", "omgidl", "", "unknown")
"""Encodings of definitions. The last two are written if the recorder found none: then the type may be a standard one."""


class _Arrived(NamedTuple):
    """A message as it was recorded."""

    log_time: int
    """Arrival, ns."""
    channel: int
    data: bytes


_log_time_of = attrgetter("log_time")


class McapFile:
    """An MCAP file that is open, with the methods of the readers of `rosbags`.

    Raises McapError: it is no MCAP file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path.open("rb")
        self.connections: list[Any] = []
        """Channels with messages of ROS, as `rosbags` describes them."""
        self.left_out: dict[str, str] = {}
        """Encoding of the other channels, by topic."""
        self.ros: Literal[1, 2] = 2
        self.start_time, self.end_time = 0, 0
        """First and last arrival, ns."""
        self.cut_off = ""
        """Why the file could not be read to its end; empty if it could."""
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._counts = Counter[int]()
        self._chunks: list[ChunkIndex] = []
        """By their first arrival; empty without an index."""
        try:
            if self._file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
                raise McapError("it is empty" if not path.stat().st_size else "it does not begin as an MCAP file")
            summary = self._find_index()
            self.is_indexed = summary is not None
            """Whether messages of any time are found without reading the others."""
            if summary is None:
                self._scan()
            self._describe_channels()
        except BaseException:
            self._file.close()
            raise

    def open(self) -> None:
        """Do nothing, since the file is open."""

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _find_index(self) -> Summary | None:
        """Read the summary at the end of the file; `None` if it is missing or incomplete."""
        summary = None
        with contextlib.suppress(Exception):  # a damaged end can raise anything in the library
            self._file.seek(0)
            summary = SeekingReader(self._file, record_size_limit=RECORD_MAX_BYTES).get_summary()
        if summary is None or summary.statistics is None or not summary.chunk_indexes:
            return None
        counts = summary.statistics.channel_message_counts
        if summary.statistics.message_count and not counts:
            return None
        indexed = {channel for chunk in summary.chunk_indexes for channel in chunk.message_index_offsets} | counts.keys()
        is_complete = indexed <= summary.channels.keys() and all(
            channel.schema_id in (0, *summary.schemas) for channel in summary.channels.values()
        )
        if not is_complete:
            return None
        self._chunks = sorted(summary.chunk_indexes, key=lambda chunk: (chunk.message_start_time, chunk.chunk_start_offset))
        self._schemas, self._channels, self._counts = summary.schemas, summary.channels, Counter(counts)
        self.start_time = summary.statistics.message_start_time
        self.end_time = summary.statistics.message_end_time
        return summary

    def _scan(self) -> None:
        """Read the whole file once, to know its channels, numbers of messages and times."""
        first, last = None, 0
        try:
            for record in self._records():
                if isinstance(record, Schema):
                    self._schemas[record.id] = record
                elif isinstance(record, Channel):
                    self._channels[record.id] = record
                elif isinstance(record, _Arrived):
                    self._counts[record.channel] += 1
                    first = record.log_time if first is None else min(first, record.log_time)
                    last = max(last, record.log_time)
        except Exception as error:  # noqa: BLE001 - damaged bytes can raise anything in the library
            why = " ".join(str(error).split()).rstrip(".") or type(error).__name__
            self.cut_off = "it has no end" if self._file.tell() >= self.path.stat().st_size else why
        self.start_time, self.end_time = first or 0, last

    def _records(self) -> Iterator[Any]:
        """Yield schemas, channels and messages from the beginning to the damage or the end, those of a chunk by arrival."""
        self._file.seek(0)
        for record in StreamReader(self._file, emit_chunks=True, record_size_limit=RECORD_MAX_BYTES).records:
            if isinstance(record, Message):
                yield _Arrived(record.log_time, record.channel_id, record.data)
            elif isinstance(record, Chunk):
                data = _unpack_chunk(record)
                yield from _definitions_in(data)
                yield from sorted(_messages_in(data), key=_log_time_of)
            else:
                yield record

    def _describe_channels(self) -> None:
        for channel in self._channels.values():
            schema = self._schemas.get(channel.schema_id)
            encoding = channel.message_encoding
            if encoding not in _ROS_OF_ENCODING:
                self.left_out[channel.topic] = encoding or "of no encoding"
            elif schema is None or schema.encoding not in _SCHEMA_ENCODINGS:
                self.left_out[channel.topic] = f"{encoding}, {f'defined by {schema.encoding}' if schema else 'without a type'}"
            else:
                try:
                    self.connections.append(self._connection(channel, schema))
                except InputError as error:
                    self.left_out[channel.topic] = f"{encoding}; {str(error).rstrip('.')}"
        versions = {_ROS_OF_ENCODING[each.ext.serialization_format] for each in self.connections}
        if versions == {1}:
            self.ros = 1
        elif len(versions) > 1:
            old = [each for each in self.connections if each.ext.serialization_format == "ros1"]
            self.connections = [each for each in self.connections if each not in old]
            self.left_out |= {each.topic: "ros1, next to messages of ROS 2" for each in old}

    def _connection(self, channel: Channel, schema: Schema) -> Any:
        from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat

        kind = {"": "NONE", "unknown": "NONE", "ros2idl": "IDL", "omgidl": "IDL"}.get(schema.encoding, "MSG")
        text = "" if kind == "NONE" else schema.data.decode(errors="replace")
        return Connection(
            channel.id,
            channel.topic,
            full_type_name(schema.name.replace("::", "/")),
            MessageDefinition(MessageDefinitionFormat[kind], text),
            "",
            self._counts[channel.id],
            ConnectionExtRosbag2(channel.message_encoding, []),
            self,
        )

    def messages(
        self, connections: Collection[Any], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Any, int, bytes]]:
        """Yield channel, arrival (ns) and bytes of the messages of some channels from `start` to before `stop`.

        Raises an exception of the library where the file is damaged. A missing end raises none, see `cut_off`.
        """
        of_channel = {each.id: each for each in connections}
        first, last = -1 if start is None else start, math.inf if stop is None else stop
        for log_time, channel, data in self._indexed(of_channel.keys(), first, last) if self.is_indexed else self._all():
            if channel in of_channel and first <= log_time < last:
                yield of_channel[channel], log_time, data

    @property
    def may_go_back(self) -> bool:
        """Whether chunks overlap in time as they do after the recorder's clock was set back, or one chunk holds all."""
        chunks = sorted(self._chunks, key=attrgetter("chunk_start_offset"))
        return len(chunks) == 1 or any(
            after.message_start_time < before.message_end_time - OVERLAP_OF_CHUNKS_MAX_NS for before, after in pairwise(chunks)
        )

    def in_file_order(self, connections: Collection[Any]) -> Iterator[tuple[Any, int, bytes]]:
        """Yield channel, arrival (ns) and bytes of the messages of some channels as they follow each other in the file."""
        of_channel = {each.id: each for each in connections}
        for each in sorted(self._chunks, key=attrgetter("chunk_start_offset")):
            self._file.seek(each.chunk_start_offset + RECORD_HEAD.size)
            for log_time, channel, data in _messages_in(_unpack_chunk(Chunk.read(ReadDataStream(self._file)))):
                if channel in of_channel:
                    yield of_channel[channel], log_time, data

    def _indexed(self, channels: Collection[int], first: float, last: float) -> Iterator[_Arrived]:
        """Yield the messages of the chunks that have some of the channels from `first` to before `last`, by arrival."""
        chunks = [
            each
            for each in self._chunks
            if each.message_start_time < last
            and each.message_end_time >= first
            and (not each.message_index_offsets or not each.message_index_offsets.keys().isdisjoint(channels))
        ]
        waiting: list[_Arrived] = []
        for number, each in enumerate(chunks):
            self._file.seek(each.chunk_start_offset + RECORD_HEAD.size)
            waiting += [m for m in _messages_in(_unpack_chunk(Chunk.read(ReadDataStream(self._file)))) if m.channel in channels]
            waiting.sort(key=_log_time_of)
            # Messages of the next chunks may come before.
            next_ns = chunks[number + 1].message_start_time if number + 1 < len(chunks) else math.inf
            ready = bisect_left(waiting, next_ns, key=_log_time_of)
            yield from waiting[:ready]
            del waiting[:ready]

    def _all(self) -> Iterator[_Arrived]:
        try:
            for record in self._records():
                if isinstance(record, _Arrived):
                    yield record
        except Exception:
            # The end of a cut file is known.
            if not self.cut_off:
                raise


def _unpack_chunk(chunk: Chunk) -> bytes:
    """Unpack the records of a chunk. Raises any exception: it is damaged."""
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    return stream.read(size)


def _heads_in(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield operation, begin and end of the records of a chunk. Raises ValueError, struct.error: a length is wrong."""
    at = 0
    while at < len(data):
        operation, length = RECORD_HEAD.unpack_from(data, at)
        at += RECORD_HEAD.size
        if at + length > len(data):
            raise ValueError("a record is longer than its chunk")
        yield operation, at, at + length
        at += length


def _definitions_in(data: bytes) -> Iterator[Schema | Channel]:
    for operation, begin, end in _heads_in(data):
        if operation in (Opcode.SCHEMA, Opcode.CHANNEL):
            kind = Schema if operation == Opcode.SCHEMA else Channel
            yield kind.read(ReadDataStream(BytesIO(data[begin:end])))


def _messages_in(data: bytes) -> Iterator[_Arrived]:
    # The library's own way takes five times as long.
    head, size = MESSAGE_HEAD, MESSAGE_HEAD.size
    for operation, begin, end in _heads_in(data):
        if operation == Opcode.MESSAGE:
            channel, _, log_time, _ = head.unpack_from(data, begin)
            yield _Arrived(log_time, channel, data[begin + size : end])
